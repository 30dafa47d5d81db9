"""The canonical layout of task files, as written by `stltool fmt`.

One statement per line; operators in their short spelling; parentheses as the printer sets them (redundant ones are
removed, and those that make all tools agree on the meaning are added); statements over 100 characters broken at their
operators. Names, params, numbers, the form of intervals and all comments are kept; so are blank lines between
statements, at most one each. The result is parsed and compared with the original: if the meaning changed, nothing is
written.
"""

from __future__ import annotations

import re
from collections import deque
from typing import cast

from stltool.arguments import require
from stltool.errors import StlSyntaxError
from stltool.logic.formula import ArithmeticOperator
from stltool.logic.printer import STRENGTH, Kind, computed, needs_parentheses, negated
from stltool.logic.syntax import (
    INFINITY,
    INFIXES,
    PAST_PREFIXES,
    Branch,
    Comment,
    Document,
    Token,
    bare,
    branches,
    read,
    refuse,
)
from stltool.source import Source

WIDTH = 100
_INDENT = 4
_SIGNS = {
    "and": "&", "or": "|", "implies": "->", "iff": "<->", "xor": "xor", **dict(zip(INFIXES, INFIXES, strict=True)),
    "until": "U",
}  # fmt: skip
_TEMPORAL = {"eventually": "F", "always": "G", **dict(zip(PAST_PREFIXES, PAST_PREFIXES, strict=True))}
_PREFIXES = {"not": "!", **_TEMPORAL}
_COMPARATORS = {"≤": "<=", "≥": ">=", "≠": "!="}


def format_task(text: str, name: str = "task") -> str:
    """The text of a task file in its canonical layout. Raises StlSyntaxError if it does not parse."""
    require(text, str, "format_task's text", "write it in quotes, or read the file: path.read_text()")
    require(name, str, "format_task's name")
    document = read(Source(name, text), "task")
    refuse(document.faults)
    try:
        for _ in range(len(document.comments) + 2):  # a moved comment may change line breaks: repeat
            laid_out = _Layout(document).text()
            if laid_out == document.source.text:
                break
            again = read(Source(name, laid_out), "task")
            if _skeletons(again) != _skeletons(document) or _comments(again) != _comments(document):
                raise AssertionError(f"{name}: the canonical layout would change the meaning; nothing was written")
            document = again
    except RecursionError:
        raise StlSyntaxError(f"{name}: operators are nested too deeply to be formatted; define parts by name") from None
    return laid_out


def _comments(document: Document) -> list[str]:
    return [_comment_text(comment) for comment in document.comments]


def _skeletons(document: Document) -> list[object]:
    """The statements without parentheses, positions and spellings; each param of a line counts as a line."""
    found: list[object] = []
    for tree in document.trees:
        parts = branches(tree) if tree.data in ("params", "signals") else [tree]
        found += [(str(tree.data), _skeleton(part)) for part in parts]
    return found


def _skeleton(item: Branch | Token) -> object:
    if isinstance(item, Token):
        if item.type == "STEPS":
            return _time(item)
        return "inf" if item.lower() in INFINITY else _COMPARATORS.get(str(item), str(item))
    tree = bare(item)
    return (str(tree.data), *(_skeleton(part) for part in tree.children))


# --------------------------------------------------------------------------------------------------- one line


def flat_text(tree: Branch) -> str:
    """A formula or a term on one line, with the parentheses that the printer would set."""
    tree = bare(tree)
    parts = branches(tree)
    match tree.data:
        case "formula":
            return flat_text(parts[0])
        case "and" | "or" | "implies" | "iff" | "xor":
            return f" {_sign(tree)} ".join(_operand(part) for part in parts)
        case data if data in INFIXES:
            return f"{_operand(parts[0])} {_sign(tree)} {_operand(parts[-1])}"
        case data if data in _PREFIXES:
            return _sign(tree) + _operand(parts[-1], prefix=True)
        case "comparison" | "chained":
            return " ".join(_comparator(part) if isinstance(part, Token) else _term(part)[0] for part in tree.children)
        case _:
            return _term(tree)[0]


def expectation_text(tree: Branch) -> str:
    """An expectation on one line."""
    opening, body, closing = _expectation(tree)
    return f"{opening}{flat_text(body)}{closing}"


def _expectation(tree: Branch) -> tuple[str, Branch, str]:
    """What comes before the formula, the formula, and what comes after it."""
    at = next(i for i, part in enumerate(tree.children) if not isinstance(part, Token))
    body = bare(branches(cast(Branch, tree.children[at]))[0])
    rest = deque(tree.children[at + 1 :])
    closing = ""
    while rest and not isinstance(rest[0], Token):
        closing += f", {' '.join(map(str, cast(Branch, rest.popleft()).children))}"
    closing += ")"
    if rest:
        closing += f" {_comparator(cast(Token, rest.popleft()))} {_bound(cast(Branch, rest.popleft()))}"
    return f"expect {' '.join(map(str, tree.children[:at]))}(", body, closing


def _bound(tree: Branch) -> str:
    """A fraction of two numbers is one number, so it has no spaces."""
    tree = bare(tree)
    parts = branches(tree)
    if tree.data == "binary" and str(parts[1]) == "/" and parts[0].data == parts[2].data == "number":
        return f"{_term(parts[0])[0]}/{_term(parts[2])[0]}"
    return _term(tree)[0]


def _sign(tree: Branch) -> str:
    """An operator with its interval, as written before or between its operands."""
    interval = next((_interval(part) for part in branches(tree) if part.data == "interval"), "")
    if tree.data in _SIGNS:
        return _SIGNS[tree.data] + interval
    return _PREFIXES[tree.data] + interval + ("" if tree.data == "not" else " ")


def _interval(tree: Branch) -> str:
    opening, lower, upper, closing = cast(tuple[Token, Branch, Branch, Token], tuple(tree.children))
    end = bare(upper)
    endless = end.data == "name" and str(end.children[0]).lower() in INFINITY
    return f"{opening}{_term(lower)[0]},{'inf' if endless else _term(upper)[0]}{closing}"


def _comparator(token: Token) -> str:
    return _COMPARATORS.get(str(token), str(token))


def _time(text: str) -> str:
    """A time as written; `5 steps` with one space."""
    return re.sub(r"[ \t]*(steps?)$", r" \1", text)


def _operand(tree: Branch, prefix: bool = False) -> str:
    bracketed = not (prefix and bare(tree).data == "not")  # of a long chain, each would look through the rest
    return f"({flat_text(tree)})" if bracketed and needs_parentheses(_kind(tree), prefix) else flat_text(tree)


def _kind(tree: Branch) -> Kind:
    inner = tree = bare(tree)
    while inner.data == "not":
        inner = bare(branches(inner)[0])
    match tree.data:
        case "not":
            return "temporal" if inner.data in _TEMPORAL else "not"
        case data if data in _TEMPORAL:
            return "temporal"
        case "comparison" | "chained" | "binary" | "negate":
            return "comparison"
        case data:
            return "binary" if data in _SIGNS else "atom"


def _term(tree: Branch) -> tuple[str, int]:
    tree = bare(tree)
    parts = branches(tree)
    match tree.data:
        case "negate":
            return negated(_term(parts[0])), STRENGTH["negate"]
        case "binary":
            op = cast(ArithmeticOperator, str(parts[1]))
            return computed(op, _term(parts[0]), _term(parts[2])), STRENGTH[op]
        case "call":
            return f"{parts[0]}({', '.join(_term(part)[0] for part in parts[1:])})", STRENGTH["atom"]
        case "sample":
            return f"{parts[0]}[{_term(parts[1])[0]}]", STRENGTH["atom"]
        case "time":
            return _time(str(parts[0])), STRENGTH["atom"]
        case "number" | "name" | "quoted" | "true" | "false":
            return str(parts[0]), STRENGTH["atom"]
        case _:
            return f"({flat_text(tree)})", STRENGTH["atom"]  # a Boolean among numbers: refused when the nodes are built


# --------------------------------------------------------------------------------------------------- lines


class _Layout:
    """Lines, with every comment near its original position."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.source = document.source.text
        self.pending = deque(document.comments)
        self.lines: list[str] = []
        self.end = 0  # where the last formatted item ends in the source
        self.commented = -1  # the last line with a comment

    def text(self) -> str:
        for tree in self.document.trees:
            start = tree.meta.start_pos
            self.flush(start, "")
            self.blank_line(start)
            self.statement(tree)
            self.end = tree.meta.end_pos
        self.flush(len(self.source) + 1, "")
        return "\n".join(self.lines) + "\n" if self.lines else ""

    def blank_line(self, start: int) -> None:
        """Keep one blank line if there were any."""
        gap = self.source[self.end : start].replace("\r\n", "\n").replace("\r", "\n")
        if self.lines and sum(1 for line in gap.split("\n")[1:-1] if not line.strip(" \t\f;")) > 0:
            self.lines.append("")

    def flush(self, until: int, pad: str) -> None:
        """Write the comments before a position: at the end of the line they followed, or on lines of their own."""
        while self.pending and self.pending[0].start < until:
            comment = self.pending.popleft()
            text = _comment_text(comment)
            behind = self.source[self.document.source.line_start(comment.start) : comment.start].strip()
            if behind and self.lines and self.lines[-1] and self.commented < len(self.lines):
                self.lines[-1] += f"  {text}"
            else:
                if pad == "":
                    self.blank_line(comment.start)
                self.lines.append(pad + text)
            self.commented = len(self.lines)
            self.end = max(self.end, comment.end)

    def statement(self, tree: Branch) -> None:
        match tree.data:
            case "model":
                self.lines.append(f"model {tree.children[0]}")
            case "step":
                self.lines.append(f"step = {_term(branches(tree)[0])[0]}")
            case "unit":
                given = tree.children[0]
                self.lines.append(f"unit = {given if isinstance(given, Token) else _term(given)[0]}")
            case "params":
                self.list("param", [(p.meta.start_pos, f"{p.children[0]} = {_value(p)}") for p in branches(tree)])
            case "signals":
                names = cast(list[Token], tree.children)
                word = re.match(r"(?:input |output )?", re.sub(r"\s+", " ", self.source[tree.meta.start_pos :][:40]))
                assert word is not None  # it may be empty
                self.list(f"{word.group()}signal", [(cast(int, name.start_pos), str(name)) for name in names])
            case "definition":
                body = bare(branches(branches(tree)[1])[0])
                line = f"{tree.children[0]} := {flat_text(body)}"
                if self.fits(line, tree) or not _breakable(body):
                    self.lines.append(line)
                else:
                    self.lines.append(f"{tree.children[0]} :=")
                    self.block(body, _INDENT)
            case "expectation":
                self.expectation(tree)
            case other:
                raise AssertionError(f"the grammar's rule {other} has no layout")

    def expectation(self, tree: Branch) -> None:
        opening, body, closing = _expectation(tree)
        line = f"{opening}{flat_text(body)}{closing}"
        if self.fits(line, tree) or not _breakable(body):
            self.lines.append(line)
            return
        self.lines.append(opening)
        self.block(body, _INDENT)
        self.flush(body.meta.end_pos, " " * _INDENT)
        self.lines.append(closing)

    def list(self, word: str, items: list[tuple[int, str]]) -> None:
        """Several params or signals on one line; on several lines if there are comments between them."""
        line = f"{word} {', '.join(text for _, text in items)}"
        if len(line) <= WIDTH and not (self.pending and self.pending[0].start < items[-1][0]):
            self.lines.append(line)
            return
        for start, text in items:
            self.flush(start, "")
            self.lines.append(f"{word} {text}")

    def fits(self, line: str, tree: Branch) -> bool:
        return len(line) <= WIDTH and not (self.pending and self.pending[0].start < tree.meta.end_pos)

    def block(self, tree: Branch, indent: int, lead: str = "") -> None:
        """A formula on lines of its own; `lead` precedes it on the first."""
        tree = bare(tree)
        pad = " " * indent
        self.flush(tree.meta.start_pos, pad)
        line = f"{pad}{lead}{flat_text(tree)}"
        if self.fits(line, tree):
            self.lines.append(line)
        elif tree.data in _SIGNS:
            operands = [part for part in branches(tree) if part.data != "interval"]
            sign = _sign(tree)
            for i, part in enumerate(operands):
                self.operand(part, indent, f"{sign} " if i else lead, prefix=False)
        elif tree.data in _PREFIXES:
            self.operand(branches(tree)[-1], indent, lead + _sign(tree), prefix=True)
        else:
            self.lines.append(line)

    def operand(self, part: Branch, indent: int, lead: str, prefix: bool) -> None:
        pad = " " * indent
        self.flush(part.meta.start_pos, pad)
        line = f"{pad}{lead}{_operand(part, prefix)}"
        if self.fits(line, part) or not _breakable(part):
            self.lines.append(line)
        elif needs_parentheses(_kind(part), prefix):
            self.lines.append(f"{pad}{lead}(")
            self.block(part, indent + _INDENT)
            self.flush(part.meta.end_pos, pad + " " * _INDENT)
            self.lines.append(f"{pad})")
        else:
            self.block(part, indent, lead)


def _breakable(tree: Branch) -> bool:
    return bare(tree).data in _SIGNS or bare(tree).data in _PREFIXES


def _value(param: Branch) -> str:
    return _term(branches(param)[1])[0]


def _comment_text(comment: Comment) -> str:
    text = comment.text.removeprefix("//") if comment.text.startswith("//") else comment.text.removeprefix("#")
    glued = not text or text[0] in "#! \t"
    return f"#{text if glued else ' ' + text}".rstrip()
