"""Text → the trees of its statements, with a message for every fault: the only module that imports lark.

A text is split into tokens, tokens into statements, and each statement is parsed by itself: `name :=` and the first
words of the other lines occur nowhere else, so a fault in one statement does not affect the next one, and all faults
are reported together. No character is dropped: one that begins no token of the grammar is a fault at that position.
"""

from __future__ import annotations

import difflib
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from typing import TypeAlias, cast

from lark import Lark, Tree
from lark import Token as Token  # the builder and the formatter use tokens, too
from lark.exceptions import UnexpectedInput, UnexpectedToken
from lark.parsers.lalr_interactive_parser import InteractiveParser

from stltool.errors import MOST_FAULTS, StlSyntaxError, all_told
from stltool.grammar import grammar_text
from stltool.source import Source, Span
from stltool.streams import control_character

Branch: TypeAlias = Tree[Token]

LONGEST_TEXT = 2_000_000  # characters; a trace that was given instead of a task file must not fill memory
MOST_STATEMENTS = 20_000  # some seconds, and some hundred megabytes of trees
_EQUAL_HINT = "write == to compare, := to define"
INFIXES = ("until", "weak_until", "release", "since", "trigger")  # temporal operators between two operands
PAST_PREFIXES = ("once", "historically", "prev", "rise", "fall")
# Words that are operators only where a name cannot stand, and nowhere in a text that gives a name to them.
_PREFIX_WORDS = tuple(f"_{word.upper()}" for word in PAST_PREFIXES)
_INFIX_WORDS = tuple(f"_{word.upper()}" for word in INFIXES[1:])
SOFT_WORDS = (*PAST_PREFIXES, *INFIXES[1:])
_NO_INTERVAL = ("prev", "rise", "fall")
_TEMPORAL = ("_EVENTUALLY", "_ALWAYS", "_UNTIL", "_ONCE", "_HISTORICALLY", *_INFIX_WORDS)
_TEMPORAL_WORDS = ("always", "globally", "eventually", "finally", "until", "once", "historically", *INFIXES[1:])
WORDS = (
    "always", "globally", "eventually", "finally", "until", "true", "false", "and", "or", "not", "xor", "implies",
    "iff",
)  # fmt: skip
_LINE_WORDS = {
    "_MODEL": "model",
    "_PARAM": "param",
    "_SIGNAL": "signal",
    "_STEP": "step",
    "_UNIT": "unit",
    "_EXPECT": "expect",
}

# Operators of other tools that do not exist here, and what to write instead.
_NEXT = "there is no operator {word}; for the next step, write F[1,1] a"
_WORD = "there is no operator {word}; write {instead}"
_ELSEWHERE = {
    **{
        word: _WORD.replace("{instead}", instead)
        for words, instead in (
            (("O",), "once[0,5] a"),
            (("H",), "historically[0,5] a"),
            (("Y", "previous"), "prev a"),
            (("S",), "a since[0,5] b"),
            (("R", "releases"), "a release[0,5] b"),
            (("W", "weakuntil"), "a weak_until[0,5] b"),
        )
        for word in words
    },
    **dict.fromkeys(("next", "X"), _NEXT),
    "pow": "there is no function {word}; write a^b",
    "imply": "there is no operator {word}; write implies, or ->",
    "exp": "there is no function {word}; record it as a signal of its own (there are abs, min, max, sqrt)",
}

INFINITY = ("inf", "infinity", "∞")  # in any case
_PRISM_QUESTIONS = ("P", "Pmax", "Pmin")

_BRACKETS = {"LPAR": "parenthesis", "RPAR": "parenthesis", "LSQB": "bracket", "RSQB": "bracket"}
_NESTING = {"LPAR": 1, "LSQB": 1, "RPAR": -1, "RSQB": -1}

# What the parser expected, in words. A test checks that every terminal of the grammar is listed.
_OPERATORS = (
    "_IFF",
    "_XOR",
    "_IMPLIES",
    "_OR",
    "_AND",
    "_UNTIL",
    *_INFIX_WORDS,
    "COMPARATOR",
    "PLUS",
    "MINUS",
    "TIMES",
    "DIVIDE",
    "POWER",
)
_TERM_STARTS = ("NAME", "DOTTED", "STRING", "NUMBER", "TIME", "STEPS", "FUNCTION", "LPAR", "MINUS", "PLUS")
_FORMULA_STARTS = (*_TERM_STARTS, "TRUE", "FALSE", "_NOT", "_EVENTUALLY", "_ALWAYS", *_PREFIX_WORDS)
TERMINAL_WORDS = {
    **dict.fromkeys(_OPERATORS, "an operator"),
    **dict.fromkeys(_FORMULA_STARTS, "a formula"),
    **dict.fromkeys(("NAME", "DOTTED"), "a name"),
    "NUMBER": "a number",
    **dict.fromkeys(("TIME", "STEPS", "MICROSECONDS"), "a time"),
    "FUNCTION": "a function",
    "LPAR": "'('",
    **dict.fromkeys(("PLUS", "MINUS"), "a sign"),
    "RPAR": "')'",
    "LSQB": "'['",
    "RSQB": "']'",
    "COMMA": "','",
    "COLON": "':'",
    "_DOTS": "'..'",
    "ASSIGN": "':='",
    "EQUAL": "'='",
    "SEMICOLON": "';'",
    "STRING": "a name in quotes",
    **{terminal: f"a {word} line" for terminal, word in _LINE_WORDS.items()},
    "_EXPECT": "an expect line",
    "COMMENT": "a comment",
    "$END": "the end",
}


@dataclass(frozen=True, slots=True)
class Comment:
    """A comment, including its mark: the characters `start … end-1`."""

    start: int
    end: int
    text: str


@dataclass(frozen=True, slots=True)
class SyntaxFault:
    """A message, ready to print, about position `start`; `names` are those that the statement would define.

    It is empty for a fault that is only counted, after `MOST_FAULTS` others.
    """

    start: int
    message: str
    names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Document:
    """A parsed text: a tree per statement (or that of a single formula), comments, names, and its faults."""

    source: Source
    trees: tuple[Branch, ...] = field(repr=False)
    comments: tuple[Comment, ...] = field(repr=False)
    names: frozenset[str] = field(repr=False)
    faults: tuple[SyntaxFault, ...] = field(repr=False)


def branches(tree: Branch) -> list[Branch]:
    """Those children of a tree that are trees."""
    return cast(list[Branch], tree.children)


def bare(tree: Branch) -> Branch:
    """A tree without the parentheses around it."""
    while tree.data == "parentheses":
        tree = branches(tree)[0]
    return tree


@cache
def _lark() -> Lark:
    # the basic lexer: a word is the same token everywhere
    return Lark(
        grammar_text("stl.lark"),
        parser="lalr",
        lexer="basic",
        start=["statement", "formula"],
        propagate_positions=True,
        maybe_placeholders=False,
    )


def _lexed(text: str) -> Iterator[Token]:
    """Its tokens, by the parser's own lexer: `Lark.lex` would build another, which takes longer than the rest."""
    lexer = _lark().parse_interactive(text, start="formula").lexer_thread
    return cast(Iterator[Token], lexer.lex(None))  # type: ignore[no-untyped-call]


def read(source: Source, start: str) -> Document:
    """The trees of a task file (`start` "task") or of one formula ("formula")."""
    if len(source.text) > LONGEST_TEXT:
        raise StlSyntaxError(
            f"{source.name}: the text has {len(source.text)} characters, more than the limit of {LONGEST_TEXT}; "
            "put traces into files of their own"
        )
    if start == "formula" and not source.text.strip():
        raise StlSyntaxError(f"{source.name}: the text is empty; write a formula, such as F[0,10] A")
    tokens, foreign = _tokens(source)
    tokens, unclear = _with_names(source, tokens)
    foreign = sorted([*foreign, *unclear], key=lambda fault: fault.start)
    broken = {fault.start for fault in foreign}
    trees, faults = [], list(foreign)
    pieces = _statements(tokens) if start == "task" else [tokens]
    if len(pieces) > MOST_STATEMENTS:
        raise StlSyntaxError(
            f"{source.name}: the text has {len(pieces)} statements, more than the limit of {MOST_STATEMENTS}; "
            "split it into several task files"
        )
    for piece, begin, end in _places(pieces, len(source.text)):
        if any(begin <= place < end for place in broken):
            faults = [replace(f, names=_defined(piece)) if begin <= f.start < end else f for f in faults]
            continue  # what follows an unknown character cannot be interpreted
        result = _parse(source, "statement" if start == "task" else start, piece, len(faults) < MOST_FAULTS)
        if isinstance(result, SyntaxFault):
            faults.append(result)
        else:
            trees.append(result)
    faults.sort(key=lambda fault: fault.start)
    names = frozenset(str(token) for token in tokens if token.type == "NAME")
    return Document(source, tuple(trees), tuple(_comments(source, tokens, broken)), names, tuple(faults))


def refuse(faults: Sequence[SyntaxFault]) -> None:
    """StlSyntaxError with all faults in text order, if there are any."""
    if not faults:
        return
    raise StlSyntaxError(all_told([fault.message for fault in sorted(faults, key=lambda fault: fault.start)]))


# --------------------------------------------------------------------------------------------------- tokens


def _tokens(source: Source) -> tuple[list[Token], list[SyntaxFault]]:
    """All tokens, and a fault for every character that begins no token."""
    tokens: list[Token] = []
    faults: list[SyntaxFault] = []
    offset = 0
    while True:
        try:
            for token in _lexed(source.text[offset:] if offset else source.text):
                if token.type == "STRING" and (control := control_character(token)):
                    message = f"this name has the control character {control}; remove it"
                    place = offset + cast(int, token.start_pos)
                    faults.append(SyntaxFault(place, Span(source, place, place + len(token)).show(message)))
                if token.type == "DOTTED":
                    token.type = "NAME"
                tokens.append(_shifted(token, offset) if offset else token)
        except UnexpectedInput as error:
            place = offset + (error.pos_in_stream or 0)
            faults.append(SyntaxFault(place, _foreign(source, place)))
            offset = place + len(_glued(source.text, place))
            if len(faults) < MOST_FAULTS:
                continue
        return tokens, faults


_OPERAND_ENDS = ("NAME", "NUMBER", "TIME", "STEPS", "TRUE", "FALSE", "STRING", "RPAR", "RSQB")
_OPERAND_STARTS = (
    "NAME", "NUMBER", "TIME", "STEPS", "FUNCTION", "TRUE", "FALSE", "LPAR", "STRING", "_NOT", "_EVENTUALLY", "_ALWAYS",
    *_PREFIX_WORDS,
)  # fmt: skip


def _with_names(source: Source, tokens: list[Token]) -> tuple[list[Token], list[SyntaxFault]]:
    """The tokens, with `once`, `since` and their like as names wherever they are names; faults where it is unclear.

    They are names if the text gives that name to a definition, param or signal. Otherwise a prefix word is an operator
    if an operand or an interval follows, where a name could only be followed by an operator, and an infix word is one
    behind an operand, where no name can stand.
    """
    soft = (*_PREFIX_WORDS, *_INFIX_WORDS)
    if not any(token.type in soft for token in tokens):
        return tokens, []
    declared, intervals = _declared(tokens), _intervals(tokens)
    found: list[Token] = []
    faults: list[SyntaxFault] = []
    opened: list[bool] = []  # for every open bracket, whether it is that of an interval
    behind = False  # whether the last token ends an operand
    for i, token in enumerate(tokens):
        follows = tokens[i + 1].type if i + 1 < len(tokens) else "$END"
        operator = token.type in soft and str(token) not in declared and follows not in ("ASSIGN", "EQUAL")
        if operator and token.type in _INFIX_WORDS:
            operator = behind
        elif operator and follows == "LSQB":
            operator = i + 1 in intervals
        elif operator and follows in ("PLUS", "MINUS") and not behind:
            message = (
                f"{token} before a sign may be the operator or a signal; write {token} ({tokens[i + 1]} …) for the "
                f'operator, or "{token}" for the signal'
            )
            faults.append(SyntaxFault(cast(int, token.start_pos), _span(source, token).show(message)))
        elif operator:
            operator = follows in _OPERAND_STARTS
        if token.type in soft and not operator:
            token = Token("NAME", token.value, start_pos=token.start_pos, end_pos=token.end_pos)
        behind = token.type in _OPERAND_ENDS
        if token.type in ("LPAR", "LSQB"):
            opened.append(bool(found) and found[-1].type in _TEMPORAL and i in intervals)
        elif token.type in ("RPAR", "RSQB") and opened:
            behind = not opened.pop()
        found.append(token)
    return found, faults


def _declared(tokens: Sequence[Token]) -> dict[str, Token]:
    """The names that definitions, params and signal lines give, with their tokens there."""
    names: dict[str, Token] = {}
    line = ""
    for i, token in enumerate(tokens):
        follows = tokens[i + 1].type if i + 1 < len(tokens) else "$END"
        if token.type in _LINE_WORDS or follows == "ASSIGN":
            line = token.type
        first = tokens[i - 1].type in (line, "COMMA") if i else False
        if follows == "ASSIGN" or (line == "_PARAM" and first and follows == "EQUAL") or (line == "_SIGNAL" and first):
            names.setdefault(str(token), token)
    return names


def _intervals(tokens: Sequence[Token]) -> set[int]:
    """The brackets, by their token, that hold an interval: each has a comma, a colon or dots of its own."""
    holding: set[int] = set()
    opened: list[int] = []
    for i, token in enumerate(tokens):
        if _NESTING.get(token.type, 0) > 0:
            opened.append(i)
        elif _NESTING.get(token.type, 0) < 0:
            del opened[-1:]
        elif token.type in ("COMMA", "COLON", "_DOTS") and opened:
            holding.add(opened[-1])
    return holding


def _shifted(token: Token, offset: int) -> Token:
    start, end = cast(int, token.start_pos), cast(int, token.end_pos)
    return Token(token.type, token.value, start_pos=start + offset, end_pos=end + offset)


def _glued(text: str, place: int) -> str:
    """The text at a position where no token begins: a quote to the end of its line, a number followed by letters,
    braces or single quotes with what they hold, or a single character.
    """
    found = re.compile(r"\.*\w+|\.+|\"[^\r\n]*|\{[^{}\r\n]*\}|'[^'\r\n]*'").match(text, place)
    return found.group() if found else text[place]


def _foreign(source: Source, place: int) -> str:
    character = source.text[place]
    shown = repr(character) if character.isprintable() else f"U+{ord(character):04X}"
    before = source.text[:place].rpartition("\n")[2]
    if character == '"':
        example = 'model "floor.toml"' if before.split()[:1] == ["model"] else 'F[0,5] "at goal"'
        message = f"this quote is not closed; close it on the same line, as in {example}"
    elif character in "²³":
        message = f"write ^{'2' if character == '²' else '3'} for a power"
    elif re.search(r"\b(?:policy|trace)\s+\S*$", before) and before.split()[:1] == ["expect"]:
        message = 'a file name belongs in double quotes here; write, for example, policy "p.npz"'
    elif before.split()[:1] == ["model"]:
        message = 'a file name belongs in double quotes on a model line; write model "floor.toml"'
    elif character == "'":
        name = _glued(source.text, place).strip("'")
        message = f'names that need quotes have double ones; write "{name or "at goal"}"'
    elif character == "." and re.search(r"[A-Za-z_]\w*$", before):
        message = "unexpected dot; in a name, a letter follows it, as in car.speed"
    elif character.isalpha():
        start = re.search(r"\w*$", before)
        word = (start.group() if start else "") + _glued(source.text, place)
        behind = source.text[place + len(_glued(source.text, place)) :]
        if re.match(r"[ \t]*:=", behind) or (before.split()[:1] == ["param"] and "=" not in before):
            message = f"the name of a definition or a param cannot contain {shown}; use a-z, A-Z, 0-9 and _"
        else:
            message = f'a name cannot contain {shown} unless it is in quotes; write "{word}"'
    elif character == ".":
        message = "unexpected dot; dots occur in numbers, such as 0.5, and in intervals, such as [0..5]"
    elif not character.isascii() and character.isnumeric():
        message = f"{shown} is not a digit; use the digits 0 to 9"
    elif character.isdigit():
        message = "this number runs into letters; put an operator or a space between them"
    elif character == "=":
        message = f"unexpected '='; {_EQUAL_HINT}"
    elif character in "{}":
        inside = _glued(source.text, place)[1:-1]
        operator = re.search(r"([A-Za-z]+|\[\]|<>|[□◇𝒰])_?\s*$", before)
        interval = operator is not None and re.fullmatch(r"[^,]+,[^,]+", inside)
        message = f"unexpected {character!r}; " + (
            "a set is written as comparisons: (mode == 1 | mode == 2)"
            if operator and operator[1] == "in"
            else f"an interval is in brackets: {operator[1]}[{inside}]"
            if operator and interval
            else "group with parentheses, ( and ); intervals are in brackets, as in F[0,10]"
        )
    elif character == "?" and re.search(r"=\s*$", before):
        message = (
            "=? asks for a probability, as in PRISM; write the formula alone and use stltool check, or state a bound "
            "in a task file: expect Pmax(name) >= 0.95"
        )
    elif character == "%" and before.split()[:1] == ["expect"] and before[-1:].isdigit():
        message = "unexpected '%'; write a percentage as a decimal or a fraction, such as 0.95 or 95/100"
    elif character == "%":
        message = "unexpected '%'; begin comments with # or //"
    else:
        message = f"unexpected character {shown}; remove it, or write the operator as a word"
    return Span(source, place, place + 1).show(message)


def _comments(source: Source, tokens: Sequence[Token], broken: set[int]) -> Iterator[Comment]:
    """The comments: between tokens there are only spaces, comments and characters already reported as faults."""
    text, start = source.text, 0
    for token in [*tokens, None]:
        stop = len(text) if token is None else cast(int, token.start_pos)
        gap = text[start:stop]
        if not gap.isspace() and not any(start <= place < stop for place in broken):
            for found in re.finditer(r"#[^\r\n]*|//[^\r\n]*", gap):
                yield Comment(start + found.start(), start + found.end(), found.group())
        start = stop if token is None else cast(int, token.end_pos)


def _statements(tokens: list[Token]) -> list[list[Token]]:
    """The tokens of each statement."""
    starts = [i for i, token in enumerate(tokens) if i == 0 or token.type in _LINE_WORDS or _defines(tokens, i)]
    return [tokens[i:j] for i, j in pairwise([*starts, len(tokens)])]


def _places(pieces: Sequence[list[Token]], length: int) -> Iterator[tuple[list[Token], int, int]]:
    """Each piece with its range of positions, up to the next piece; the ranges cover the text."""
    starts = [0, *(cast(int, piece[0].start_pos) for piece in pieces[1:]), length + 1]
    return zip(pieces, starts, starts[1:], strict=False)


def _defines(tokens: Sequence[Token], i: int) -> bool:
    follows = i + 1 < len(tokens) and tokens[i + 1].type == "ASSIGN"
    return tokens[i].type == "NAME" and follows and (i == 0 or tokens[i - 1].type != "_PARAM")


def _defined(tokens: Sequence[Token]) -> tuple[str, ...]:
    """The names that a statement defines, as far as its tokens show."""
    marks = ("ASSIGN", "EQUAL")
    if tokens and tokens[0].type == "_PARAM":
        return tuple(str(t) for b, t in pairwise(tokens) if t.type == "NAME" and b.type in ("_PARAM", "COMMA"))
    if tokens and tokens[0].type in ("_STEP", "_UNIT"):
        return (f"{tokens[0]} =",)
    return tuple(str(t) for t, n in pairwise(tokens) if t.type == "NAME" and n.type in marks)


# --------------------------------------------------------------------------------------------------- statements


def _parse(source: Source, start: str, tokens: list[Token], told: bool) -> Branch | SyntaxFault:
    """The tree of a statement. Looking for what to write instead takes long: it is done for faults that are `told`."""
    machine = _lark().parse_interactive(start=start)
    for i, token in enumerate(tokens):
        try:
            if token.type == "_ALWAYS" and i and _empty_interval(tokens[i - 1], token):
                message = f"{tokens[i - 1]}[] could be an empty interval or two operators; write F[0,10] a, or F (G a)"
                return SyntaxFault(cast(int, token.start_pos), _span(source, token).show(message), _defined(tokens))
            machine.feed_token(token)
        except UnexpectedToken:
            message = _unexpected(source, machine, tokens, i) if told else ""
            return SyntaxFault(cast(int, token.start_pos), message, _defined(tokens))
    try:
        return cast(Branch, machine.feed_eof(tokens[-1] if tokens else None))  # type: ignore[no-untyped-call]
    except UnexpectedToken:
        place = cast(int, tokens[-1].end_pos) if tokens else 0
        message = _unexpected(source, machine, tokens, len(tokens)) if told else ""
        return SyntaxFault(place, message, _defined(tokens))


def _empty_interval(before: Token, token: Token) -> bool:
    word = str(before).rstrip("_")[-1:].isalpha() or str(before).endswith("_")
    return before.type in _TEMPORAL and word and str(token) == "[]" and _touch(before, token)


def _touch(before: Token, after: Token) -> bool:
    return before.end_pos == after.start_pos


def _span(source: Source, token: Token) -> Span:
    return Span(source, cast(int, token.start_pos), cast(int, token.end_pos))


def _unexpected(source: Source, machine: InteractiveParser, tokens: Sequence[Token], i: int) -> str:
    """The message for token i: what was found, what was expected, and what to write instead."""
    accepts = cast(set[str], machine.accepts())  # type: ignore[no-untyped-call]
    accepted = {name for name in accepts if name in TERMINAL_WORDS} or {"$END"}
    if i < len(tokens):
        found, span = f"unexpected {str(tokens[i])!r}", _span(source, tokens[i])
    else:
        place = cast(int, tokens[-1].end_pos) if tokens else 0
        whole = not source.text[place:].strip() or machine.parser_state.parse_conf.start == "formula"
        found, span = f"the {'text' if whole else 'statement'} ends here", Span(source, place, place + 1)
    bracket, instead = _bracket_hint(source, tokens, i, accepted)
    if not instead:
        hint = _hint(source, tokens, i, accepted) or "expected " + _expected(accepted)
        bracket = f"{hint}; {bracket}" if bracket else hint
    return span.show(f"{found}; {bracket}")


def _bracket_hint(source: Source, tokens: Sequence[Token], i: int, accepted: set[str]) -> tuple[str, bool]:
    """What is wrong with the brackets around token i ("" if nothing), and whether that is the whole fault."""
    kind = tokens[i].type if i < len(tokens) else "$END"
    opened = _open_bracket(tokens, i)
    if kind in ("RPAR", "RSQB") and opened < 0:
        return f"there is no open {_BRACKETS[kind]} here; remove it, or open one earlier", True
    if opened < 0 or (_all_closed(tokens, i) and not (kind == "RSQB" and tokens[opened].type == "LPAR")):
        return "", False
    place = _span(source, tokens[opened])
    behind = opened > 0 and tokens[opened - 1].type in _TEMPORAL
    interval = behind and (tokens[opened].type == "LSQB" or "RSQB" in accepted)
    where = f"line {place.line}, column {place.column}"
    told = f"the {'interval' if interval else _BRACKETS[tokens[opened].type]} opened at {where} is not closed"
    closers = [closer for name, closer in (("RSQB", "]"), ("RPAR", ")")) if name in accepted]
    if not closers or (tokens[opened].type == "LPAR" and not interval and kind not in ("$END", "RSQB")):
        return told, False
    before = "" if kind == "$END" else f" before {str(tokens[i])!r}"
    return f"{told}; write {' or '.join(closers)}{before}", True


def _all_closed(tokens: Sequence[Token], i: int) -> bool:
    """Whether token i and those after it close every bracket left open before it; the ) of an interval counts, too."""
    depth = 0
    for token in tokens[:i]:
        depth = max(0, depth + _NESTING.get(token.type, 0))
    for token in tokens[i:]:
        depth += _NESTING.get(token.type, 0)
    return depth <= 0


def _hint(source: Source, tokens: Sequence[Token], i: int, accepted: set[str]) -> str | None:
    """What to write instead, for common slips."""
    token = tokens[i] if i < len(tokens) else None
    kind = token.type if token is not None else "$END"
    before = tokens[i - 1] if i else None
    last = before.type if before is not None else ""
    opened = _open_bracket(tokens, i)
    if tokens and tokens[0].type == "_EXPECT" and (expected := _expectation_hint(tokens, i, accepted)) is not None:
        return expected
    if kind in ("COMMA", "COLON", "_DOTS") and opened > 0 and tokens[opened].type == "LSQB":
        word = tokens[opened - 1]
        if word.type == "NAME":
            if str(word) in SOFT_WORDS and (given := _declared(_tokens(source)[0]).get(str(word))) is not None:
                line = _span(source, given).line
                return f"{word} is a name in this file, as line {line} defines it; rename it there to use the operator"
            close = difflib.get_close_matches(str(word).rstrip("_"), _TEMPORAL_WORDS, n=1, cutoff=0.7)
            known = f"did you mean {close[0]}?" if close else "F, G, U and their words do"
            return _elsewhere(tokens, opened - 1) or f"{word} does not take an interval; {known}"
    if opened > 0 and tokens[opened - 1].type in _TEMPORAL and "_DOTS" in accepted:
        bracketed = tokens[opened].type == "LSQB"  # in parentheses there may be a formula
        if (found := _interval_hint(tokens, i, opened) if bracketed else None) is not None:
            return found
    if kind in ("COMPARATOR", "EQUAL") and last in _TEMPORAL:
        return _prism_hint(tokens, i)
    if kind == "ASSIGN" and tokens[0].type == "_PARAM":
        return f"a param line uses =; write param {before} = 5"
    if kind == "EQUAL" and i + 1 < len(tokens) and str(tokens[i + 1])[:1] in "<>" and _touch(tokens[i], tokens[i + 1]):
        return f"write {tokens[i + 1]}= for ={tokens[i + 1]}"
    if kind == "EQUAL":
        return f"write {before} without the second =" if last == "COMPARATOR" else _EQUAL_HINT
    ahead = tokens[i + 1].type if i + 1 < len(tokens) else ""
    if last in ("NAME", "NUMBER") and (str(token) == "<>" or (str(token) == "~" and ahead == "EQUAL")):
        return "write != for not equal"
    if kind in ("COMPARATOR", "EQUAL") and str(before) in ("~", "<>"):
        return "write != for not equal"
    if kind in ("_UNTIL", *_INFIX_WORDS) and "_AND" in accepted:
        written = "until" if kind == "_UNTIL" else str(token).rstrip("_")
        return f"{written} cannot be chained; put one of them in parentheses"
    if kind == "LSQB" and str(before) in _NO_INTERVAL:
        return f"{before} takes no interval; for a window of the past, write once[0,5] a"
    if kind == "_DOTS" or (kind == "TIME" and last == "NAME"):
        return None
    for place in (i - 1, i):
        if 0 <= place < len(tokens) and (other := _elsewhere(tokens, place)) is not None:
            return other
    if i == 1 and str(before) == "model":
        return 'a file name belongs in double quotes on a model line; write model "floor.toml"'
    if last == "NAME" and kind == "LPAR" and str(before) in ("signal", "input", "output"):
        return f"{before}(…) numbers the signals, as in FalCAuN; write the name of the signal, such as speed"
    if i == 1 and last == "NAME":
        close = difflib.get_close_matches(str(before), list(_LINE_WORDS.values()), n=1, cutoff=0.7)
        if close:
            return f"did you mean {close[0]}?"
    if kind == "STRING" and i + 1 < len(tokens) and tokens[i + 1].type == "ASSIGN":
        return "a definition has a name without quotes, of letters, digits and _"
    for near in (before, token):
        if near is not None and near.type == "NAME" and str(near).lower() in (*WORDS, *SOFT_WORDS):
            if str(near) in SOFT_WORDS:
                return f"{near} is a name here, not the operator; rename it to use both, or check what stands around it"
            return f"keywords are lower case; write {str(near).lower()}"
    if last == "NAME" and kind == "LPAR":
        return f"{before} is not a function (there are abs, min, max, sqrt); put an operator before '('"
    if kind == "NAME" and i + 1 < len(tokens) and tokens[i + 1].type == "EQUAL":
        return f"write {token} := … to define it, or param {token} = … for a number"
    if token is not None and i and kind == "NAME" and str(token).lower() in ("expect", "expects", "expected"):
        return "an expect line begins with its question; write, for example, expect Pmax(name) >= 0.95"
    operands = ("NAME", "STRING", "NUMBER", "TIME", "STEPS")
    if kind in operands and last in (*operands, "RPAR", "RSQB"):
        return f"expected an operator between {str(before)!r} and {str(token)!r}"
    if kind in ("_EVENTUALLY", "_ALWAYS", "_NOT", *_PREFIX_WORDS) and "_AND" in accepted:
        return f"expected an operator before {str(token)!r}"
    if kind == "LSQB" and i > 2 and str(tokens[i - 3]) in _PRISM_QUESTIONS and tokens[i - 2].type == "COMPARATOR":
        question, bound = tokens[i - 3], " ".join(map(str, tokens[i - 2 : i]))
        return (
            f"{question} {bound} […] bounds a probability, as in PRISM; write the formula alone, and its bound in a "
            f"task file: expect Pmax(name) {bound}"
        )
    if kind == "LSQB" and last in ("NUMBER", "RPAR", "RSQB"):
        return "an interval belongs directly after its operator, as in F[0,10]"
    return None


def _interval_hint(tokens: Sequence[Token], i: int, opened: int) -> str | None:
    """What to write for an interval with one bound."""
    operator, bound = str(tokens[opened - 1]), tokens[opened + 1 : i]
    if i < len(tokens) and tokens[i].type == "RSQB" and len(bound) == 1 and bound[0].type in ("NUMBER", "TIME", "NAME"):
        return f"an interval needs two bounds; from now to {bound[0]}, as in MLTL, is {operator}[0,{bound[0]}]"
    return "an interval needs two integer bounds, such as F[0,10]"


def _prism_hint(tokens: Sequence[Token], i: int) -> str:
    """What to write for PRISM's `F<=5 a`, or for a signal that has the name of an operator."""
    operator, sign = str(tokens[i - 1]), str(tokens[i])
    bound = str(tokens[i + 1]) if i + 1 < len(tokens) and tokens[i + 1].type in ("NUMBER", "TIME", "NAME") else "5"
    until, at, since = f"[0,{bound}]", f"[{bound},{bound}]", f"[{bound},inf)"
    intervals = {"<=": until, "≤": until, "<": f"[0,{bound})", "=": at, "==": at,
                 ">=": since, "≥": since, ">": f"({bound},inf)"}  # fmt: skip
    if sign not in intervals:
        return f'{operator} is an operator; for a signal of that name, write "{operator}" {sign} {bound}'
    return (
        f"for PRISM's {operator}{sign}{bound}, write {operator}{intervals[sign]}; "
        f'for a signal called {operator}, write "{operator}" {sign} {bound}'
    )


def _expectation_hint(tokens: Sequence[Token], i: int, accepted: set[str]) -> str | None:
    """What to write instead on an expect line."""
    before, kind = str(tokens[i - 1]), tokens[i].type if i < len(tokens) else "$END"
    if "LPAR" in accepted and i <= 3 and all(t.type == "NAME" for t in tokens[1:i]):
        return "write a question with what it is about in parentheses, such as expect Pmax(name) >= 0.95"
    if kind in ("_AND", "_OR") and _open_bracket(tokens, i) < 0:
        return "expectations are judged one by one; write each on a line of its own"
    if kind == "EQUAL" and tokens[i - 1].type != "COMPARATOR":
        return "a probability is compared by >=, <=, > or <; for equality, write two lines, one with >= and one with <="
    if kind == "STRING":
        return 'a file name belongs after policy or trace; write, for example, policy "p.npz"'
    if before in ("policy", "trace") and i > 1 and tokens[i - 2].type == "COMMA":
        example = "p.npz" if before == "policy" else "log.csv"
        return f'a file name belongs in double quotes here; write {before} "{example}"'
    return None


def _open_bracket(tokens: Sequence[Token], i: int) -> int:
    """The last bracket or parenthesis before token i that is still open, or −1."""
    depth = 0
    for k in range(min(i, len(tokens)) - 1, -1, -1):
        if tokens[k].type in ("RPAR", "RSQB"):
            depth += 1
        elif tokens[k].type in ("LPAR", "LSQB"):
            if depth == 0:
                return k
            depth -= 1
    return -1


def _elsewhere(tokens: Sequence[Token], i: int) -> str | None:
    """What to write for an operator of another tool, with the interval that stands behind it."""
    known = _ELSEWHERE.get(str(tokens[i]).rstrip("_")) if tokens[i].type == "NAME" else None
    if known is None:
        return None
    written = list(itertools.takewhile(lambda token: token.type not in ("RSQB", "LPAR"), tokens[i + 1 : i + 7]))
    closed = tokens[i + 1 + len(written) :][:1]
    if written and written[0].type == "LSQB" and closed and closed[0].type == "RSQB":
        known = known.replace("[0,5]", "".join(map(str, [*written, *closed])))
    return known.format(word=tokens[i])


def _expected(accepted: set[str]) -> str:
    words: list[str] = []
    rest = set(accepted)
    if rest.issuperset(_LINE_WORDS):
        rest -= {*_LINE_WORDS, "NAME", "SEMICOLON"}
        words.append("the next line (model, param, signal, step, unit, expect or name := formula)")
    if rest.issuperset(_FORMULA_STARTS):
        rest -= set(_FORMULA_STARTS)
        words.append("a formula")
    elif rest.issuperset(_TERM_STARTS):
        rest -= set(_FORMULA_STARTS)
        words.append("a number, a signal or an arithmetic expression")
    words += sorted({TERMINAL_WORDS[terminal] for terminal in rest})
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
