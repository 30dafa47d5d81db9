"""Ambiguities: positions in a text that other tools read differently, with the reading that applies here.

None of these is an error: the grammar gives every text one meaning. The advice is to add the parentheses, as
`stltool fmt` does. Conventions are differences that no parentheses settle. How STLRom, RTAMT and MATLAB read them:
docs/language.md, "What other tools read differently".
"""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import cast

from stltool.arguments import require
from stltool.errors import near_misses
from stltool.logic.builder import Builder
from stltool.logic.format import flat_text
from stltool.logic.formula import (
    And,
    Arithmetic,
    Call,
    Comparison,
    Composable,
    Constant,
    Eventually,
    Formula,
    Interval,
    Negate,
    Number,
    Or,
    Term,
    Until,
    term_variables,
    walk,
)
from stltool.logic.names import near_names, unquoted
from stltool.logic.printer import term_text
from stltool.logic.syntax import INFIXES, SOFT_WORDS, Branch, Document, Token, bare, branches
from stltool.logic.task import Task
from stltool.numbers import exact
from stltool.source import Span

_BINARY = ("iff", "xor", "implies", "or", "and", *INFIXES)
_LONGEST_READING = 300
_OPERAND = r"[\s(]*[\w.]+[\s)]*"
_ARITHMETIC = re.compile(rf"//(?=[\s(]*[\d.]){_OPERAND}(?:[-+*/^&|<>=!]+{_OPERAND})*")  # an operand, not a sentence


@dataclass(frozen=True, slots=True)
class Advice:
    """A position, and what to know about it."""

    span: Span
    message: str

    def __str__(self) -> str:
        return self.span.show(self.message)


def ambiguities(task: Task | Document) -> list[Advice]:
    """Every position in a task's text that other tools would read differently, in text order."""
    require(task, (Task, Document), "ambiguities' task")
    document = task.document if isinstance(task, Task) else task
    if document is None:
        return []  # composed without a text
    found = [advice for tree in document.trees for advice in _of_statement(document, tree)]
    found += _divisions(document)
    found += _undeclared(document)
    found += _misspelled(document)
    found += _quoted(document)
    found += _expected(document)
    found += _past_words(document)
    return sorted(found, key=lambda advice: advice.span.start)


def conventions(task: Task) -> list[Advice]:
    """Every until of a task whose definition differs between tools, with the text for the other one, in text order.

    Also every equality of values that a program would have computed in doubles: of decimals, it hardly ever holds. (The
    signals of a task on a model are the model's own numbers.) And every comparison with a quotient of numbers that is
    no double: signals are.
    """
    require(task, Task, "conventions' task")
    found: dict[int, Advice] = {}
    bodies = [*task.definitions.values(), *(line.formula for line in task.expectations), task.formula]
    for phi in (body._formula() for body in bodies if isinstance(body, Composable)):
        for node in walk(phi):
            if not isinstance(node, Until | Comparison) or node.span is None:
                continue
            if isinstance(node, Until):
                told = _until(node)
            else:
                told = _quotient(node) or ("" if task.model else _equality(node))
            if told:
                found.setdefault(node.span.start, Advice(node.span, told))
    return sorted(found.values(), key=lambda advice: advice.span.start)


def _until(phi: Until) -> str:
    """Where other tools define this until differently ("" if nowhere), each with the text that means it."""
    a, b = phi.interval.a, phi.interval.b
    told = []
    if a > 0 and phi.left != Constant(True):
        at_once = Until(Interval(0, None if b is None else b - a), phi.left, phi.right)
        late = Eventually(Interval(a, a), at_once)
        told.append(f"in MLTL only from the start of the window on, which is written {_cut(str(late))}")
    if not _contains(phi.right, And, phi.left) and not _contains(phi.left, Or, phi.right):
        both = Until(phi.interval, phi.left, And((phi.left, phi.right)))
        told.append(f"in Breach, and in RTAMT's dense time, at the last step, too, which is written {_cut(str(both))}")
    if not told:
        return ""
    return f"the left side of until must hold from now on, before the right side does; {'; '.join(told)}"


def _equality(phi: Comparison) -> str:
    """What to know about an equality of computed values ("" if it is none)."""
    if phi.op not in ("==", "!="):
        return ""
    computed = [side for side in (phi.left, phi.right) if _is_computed(side)]
    if not computed:
        return ""
    within = Comparison(
        "<=" if phi.op == "==" else ">", Call("abs", (Arithmetic("-", phi.left, phi.right),)), Number(1e-9)
    )
    return (
        f"compares decimals exactly, and {_cut(term_text(computed[0]))} that was computed in doubles is hardly ever "
        f"the decimal that the other side prints as; for a tolerance, write {_cut(str(within))}"
    )


def _quotient(phi: Comparison) -> str:
    """What to know about a comparison with a quotient such as 1/3 ("" if there is none, or a double is it)."""
    for side in (phi.left, phi.right):
        term = side.arg if isinstance(side, Negate) else side
        if not isinstance(term, Arithmetic) or term.op != "/":
            continue
        left, sign = (term.left.arg, -1) if isinstance(term.left, Negate) else (term.left, 1)
        if isinstance(left, Number) and isinstance(term.right, Number) and term.right.value:
            value = sign * exact(left.value) / exact(term.right.value)
            if abs(value) <= sys.float_info.max and exact(near := float(value)) != value:
                return (
                    f"{term_text(term)} is computed exactly, and no double is it: signals that were written so are "
                    f"{near!r}; to compare with that, write it, or a param: param c = {term_text(term)}"
                )
    return ""


def _is_computed(term: Term) -> bool:
    """Whether signals are combined in it, or a root or power taken."""
    match term:
        case Negate(arg):
            return _is_computed(arg)
        case Arithmetic(op, left, right):
            signals = (bool(term_variables(left)), bool(term_variables(right)))
            return all(signals) or (op == "^" and any(signals)) or _is_computed(left) or _is_computed(right)
        case Call(function, args):
            rooted = function == "sqrt" and any(map(term_variables, args))
            return rooted or any(map(_is_computed, args))
        case _:
            return False


def _contains(phi: Formula, kind: type[And] | type[Or], part: Formula) -> bool:
    """Whether φ is a conjunction (disjunction) with that part, or the part itself."""
    return phi == part or part == Constant(True) or (isinstance(phi, kind) and part in phi.args)


def about_expectations(task: Task) -> list[Advice]:
    """Those about expectations alone: what they refer to is not defined, or their bound decides them."""
    return list(_expected(task.document)) if task.document is not None else []


def _of_statement(document: Document, statement: Branch) -> Iterator[Advice]:
    """Outside in; below a reported position only what is in parentheses is examined again."""
    stack: list[tuple[Branch, bool]] = [(statement, False)]
    while stack:
        tree, told = stack.pop()
        why = None if told else _differs(tree)
        if why is not None:
            yield Advice(_span(document, tree), f"{why}; here it means {_cut(flat_text(tree))}")
        inside = (told or why is not None) and tree.data != "parentheses"
        stack += [(part, inside) for part in reversed(tree.children) if not isinstance(part, Token)]


def _differs(tree: Branch) -> str | None:
    """Why other tools might read this operator and its operands differently; None where they would not."""
    if tree.data == "binary":
        left, op, right = branches(tree)
        chained = str(op) == "^" and "binary" in (left.data, right.data)
        return "a^b^c is read from the left by some tools (MATLAB), from the right by others" if chained else None
    if tree.data not in _BINARY:
        return None
    operands = [part for part in branches(tree) if part.data != "interval"]
    kinds = {str(part.data) for part in operands}
    if tree.data == "or" and "and" in kinds:
        return "'and' next to 'or' without parentheses is read from left to right by some tools (STLRom)"
    if tree.data == "implies" and "implies" in kinds:
        return "a chain of '->' is read from the left by some tools (RTAMT), from the right by others"
    if tree.data in ("iff", "xor") and kinds & {"iff", "xor"}:
        return "a chain of '<->' and 'xor' without parentheses is read differently by different tools"
    if tree.data in ("implies", "iff", "xor") and kinds & set(_BINARY):
        sign = {"implies": "->", "iff": "<->", "xor": "xor"}[tree.data]
        return f"the precedence of '{sign}' over other operators differs between tools"
    if (infix := next((word for word in INFIXES if word in kinds), None)) is not None:
        return f"the precedence of '{infix}' over other operators differs between tools"
    if any(_ends_in_temporal(part) for part in operands[:-1]):
        return (
            "the scope of the temporal operator ends before the next operator; in Storm and PRISM it extends over all "
            f"that follows, which is written {_cut(flat_text(_extended(tree)))}"
        )
    return None


def _extended(tree: Branch) -> Branch:
    """What an operator and its operands mean if the scope of a temporal operator is all that follows it."""
    parts = branches(tree)
    at = next(i for i, part in enumerate(parts) if _ends_in_temporal(part))
    chain, inner = [], parts[at]
    while inner.data == "not" or _ends_in_temporal(inner):
        chain.append(inner)
        inner = branches(inner)[-1]
    scope = type(tree)(tree.data, [inner, *parts[at + 1 :]])
    for prefix in reversed(chain):
        scope = type(tree)(prefix.data, [*prefix.children[:-1], scope])
    return type(tree)(tree.data, [*parts[:at], scope]) if at else scope


def _cut(reading: str) -> str:
    return reading if len(reading) <= _LONGEST_READING else f"{reading[:_LONGEST_READING]} …"


def _ends_in_temporal(tree: Branch) -> bool:
    while tree.data == "not":
        tree = branches(tree)[-1]
    return tree.data in ("eventually", "always")


def _past_words(document: Document) -> Iterator[Advice]:
    """Words that could be operators of the past and are names here, and the operator that RTAMT reads differently."""
    names = {"definition": "a definition", "param": "a param", "sample": "a signal", "name": "a label or signal"}
    told: set[str] = set()
    for kind, what in names.items():
        for tree in document.trees:
            tokens = tree.children if tree.data == "signals" else (part.children[0] for part in tree.find_data(kind))
            for token in tokens:
                word = str(token)
                if isinstance(token, Token) and word in SOFT_WORDS and word not in told:
                    told.add(word)
                    place = Span(document.source, _start(token), _start(token) + len(word))
                    said = "a signal" if tree.data == "signals" else what
                    yield Advice(place, f"{word} is {said} here, not the operator; rename it to use both")
    previous = [part for tree in document.trees for part in tree.find_data("prev")]
    for tree in sorted(previous, key=lambda tree: tree.meta.start_pos)[:1]:
        yield Advice(
            _span(document, tree),
            "prev is false at step 0, where RTAMT's prev is true (its s_prev is false); for that reading, write "
            "historically[1,1]",
        )


def _divisions(document: Document) -> Iterator[Advice]:
    """`x > 5 // 2`: what follows // is a comment, which a Python reader may take for a division."""
    for comment in document.comments:
        before = document.source.text[: comment.start].rpartition("\n")[2].rstrip()
        if re.search(r"[\w)\]]$", before) and _ARITHMETIC.fullmatch(comment.text):
            span = Span(document.source, comment.start, comment.start + 2)
            yield Advice(span, "// begins a comment; write / for a division, or # for a comment")


def _undeclared(document: Document) -> Iterator[Advice]:
    """Signals that the file's signal lines do not declare."""
    lines = {
        kind: [tree for tree in document.trees if tree.data == kind]
        for kind in ("signals", "params", "definition", "expectation")
    }
    declared = {unquoted(str(name)) for tree in lines["signals"] for name in tree.children}
    if not declared:
        return
    lines_declare = sorted(declared)
    known = {str(param.children[0]) for tree in lines["params"] for param in branches(tree)}
    known |= {str(tree.children[0]) for tree in lines["definition"]} | declared
    for tree in lines["definition"] + lines["expectation"]:
        for token in _signal_names(tree):
            name = unquoted(str(token))
            if name not in (known if token.type == "NAME" else declared):
                (known if token.type == "NAME" else declared).add(name)
                place = Span(document.source, _start(token), _start(token) + len(token))
                yield Advice(place, f"{token} is not declared on a signal line; {near_names(name, lines_declare)}")


def _misspelled(document: Document) -> Iterator[Advice]:
    """Names that resemble definitions or params of the file but are read as labels."""
    known = {str(tree.children[0]) for tree in document.trees if tree.data == "definition"}
    known |= {str(p.children[0]) for tree in document.trees if tree.data == "params" for p in branches(tree)}
    declared = {unquoted(str(name)) for tree in document.trees if tree.data == "signals" for name in tree.children}
    names = [cast(Token, part.children[0]) for tree in document.trees for part in tree.find_data("name")]
    first = {str(token): token for token in sorted(names, key=_start, reverse=True)}
    for name in first.keys() - known - declared:
        close = difflib.get_close_matches(name, known, n=1, cutoff=0.85)
        if close and not _siblings(name, close[0]):
            place = Span(document.source, _start(first[name]), _start(first[name]) + len(name))
            yield Advice(place, f"{name} is read as a signal or label; did you mean {close[0]}?")


def _quoted(document: Document) -> Iterator[Advice]:
    """Labels in quotes that have the name of a definition or param, which they do not mean."""
    kinds = [(str(tree.children[0]), "definition", tree) for tree in document.trees if tree.data == "definition"]
    params = (part for tree in document.trees if tree.data == "params" for part in branches(tree))
    kinds += [(str(part.children[0]), "param", part) for part in params]
    known = {name: (kind, _span(document, tree).line) for name, kind, tree in kinds}
    for tree in document.trees:
        for part in tree.find_data("quoted"):
            name = unquoted(str(part.children[0]))
            if name in known:
                kind, line = known[name]
                yield Advice(
                    _span(document, part),
                    f"in quotes, {name} is the label or signal of that name, not the {kind} on line {line}; leave out "
                    "the quotes if that is meant",
                )


def _expected(document: Document) -> Iterator[Advice]:
    """Expectations about what the file does not define, and those that hold, or fail, whatever the model is."""
    told = {advice.span.start for advice in _misspelled(document)}
    trees = [tree for tree in document.trees if tree.data == "expectation"]
    if not trees:
        return
    defined = {str(tree.children[0]) for tree in document.trees if tree.data == "definition"}
    builder = Builder(document.source, unbounded=True)
    builder.statements(document.trees)  # what is wrong with them is not reported here
    for expectation in builder.expectations:
        if expectation.trivial is not None and expectation.span is not None:
            yield Advice(expectation.span, f"{expectation.trivial}; write another bound")
    for tree in trees:
        body = bare(branches(next(part for part in branches(tree) if not isinstance(part, Token)))[0])
        if body.data == "name" and str(body.children[0]) not in defined:
            token = cast(Token, body.children[0])
            if _start(token) not in told:
                place = Span(document.source, _start(token), _start(token) + len(token))
                known = near_misses(str(token), defined)
                yield Advice(place, f"{token} is not defined here and is read as a label at step 0; {known}")


def _siblings(name: str, other: str) -> bool:
    """Whether names belong to one family: they differ in a digit (gear1, gear2), or have parts (visit_a, visits_a)."""
    parts, others = name.split("_"), other.split("_")
    return re.sub(r"\d", "", name) == re.sub(r"\d", "", other) or (len(parts) == len(others) > 1)


def _start(token: Token) -> int:
    return token.start_pos or 0


def _signal_names(tree: Branch) -> Iterator[Token]:
    """Names that stand for numbers: in comparisons, and before [t]."""
    stack: list[tuple[Branch, bool]] = [(tree, False)]
    while stack:
        part, number = stack.pop()
        if part.data == "sample" or (part.data in ("name", "quoted") and number):
            yield part.children[0]  # type: ignore[misc]  # the name itself
            continue
        number = number or part.data in ("comparison", "chained", "binary", "negate", "call")
        stack += [(child, number) for child in reversed(part.children) if not isinstance(child, Token)]


def _span(document: Document, tree: Branch) -> Span:
    return Span(document.source, tree.meta.start_pos, tree.meta.end_pos)
