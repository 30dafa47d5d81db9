"""The trees of a text → nodes, with params and definitions substituted and intervals closed and in integer steps.

The grammar (grammars/stl.lark) has one ladder of operators for Booleans and numbers; they are distinguished here. No
token is dropped or guessed at: a tree without a case here is an error, and so is a number where a Boolean is needed. A
statement that fails is reported with its position, and the next ones are still read; statements that refer to a name
it would have defined are skipped, since nothing can be said about them.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from fractions import Fraction
from typing import NoReturn, TypeVar, cast, get_args

from stltool.display import cut
from stltool.errors import StlSyntaxError, named, near_misses
from stltool.logic.expectation import (
    ASKED,
    OF_A_PART,
    OF_THE_WHOLE,
    RELATIONS,
    Asked,
    Expectation,
    Measure,
    Relation,
)
from stltool.logic.format import expectation_text, flat_text
from stltool.logic.formula import (
    DEEPEST,
    LARGEST_BOUND,
    MOST_NODES,
    Always,
    And,
    Arithmetic,
    ArithmeticOperator,
    Call,
    Comparator,
    Comparison,
    Constant,
    Eventually,
    Formula,
    FunctionName,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Negate,
    Not,
    Number,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Term,
    Trigger,
    Until,
    Variable,
    operands,
    walk,
)
from stltool.logic.names import unquoted, written
from stltool.logic.printer import term_text
from stltool.logic.quantities import STEP, UNITS, Duration, Quantity, one
from stltool.logic.shifts import settled
from stltool.logic.syntax import INFINITY, INFIXES, PAST_PREFIXES, WORDS, Branch, SyntaxFault, Token, bare, branches
from stltool.numbers import NumberError, double, number_text, read
from stltool.source import Source, Span

FORMULAS = get_args(Formula)
_COMPARATOR_SPELLINGS = {"≤": "<=", "≥": ">=", "≠": "!="}
_LARGEST_BITS = 4000
_LARGEST_POWER = 1000
_ENDLESS = {"always": "G", "eventually": "F", "until": "U", "release": "release", "weak_until": "weak_until"}
_ONE_STEP = Interval(1, 1)
_T = TypeVar("_T")


class _At(StlSyntaxError):
    """A message with its position in the text."""

    def __init__(self, span: Span, message: str) -> None:
        super().__init__(span.show(message))
        self.start = span.start


class _PassedOver(Exception):
    """A statement refers to a name whose definition is faulty."""


def _mentions_t(tree: Branch) -> bool:
    return any(str(part.children[0]) == "t" for part in tree.find_data("name"))


class Builder:
    """Turns trees into nodes, with the params and definitions read so far."""

    def __init__(
        self,
        source: Source,
        params: Mapping[str, Quantity] | None = None,
        overrides: Mapping[str, Quantity] | None = None,
        step: Duration | None = None,
        unit: Duration | None = None,
        unbounded: bool = False,
        faulty: Iterable[str] = (),
        lines: bool = True,
    ) -> None:
        self.source = source
        self.params: dict[str, Quantity] = dict(params or {})
        self.overrides = overrides or {}
        self.step = step
        self.unit = unit
        self.trees: list[Branch] = []
        self.lines = lines  # whether the text is a file, which may have lines of its own for these
        self.seen: set[str] = set()  # kinds of lines of which a file has only one
        self.unbounded = unbounded
        self.definitions: dict[str, Formula | Term] = {}
        self.signals: dict[str, Span] = {}
        self.model: str | None = None
        self.expectations: list[Expectation] = []
        self.faults: list[SyntaxFault] = []
        self.faulty = set(faulty)
        self.example = "10"  # a value that a missing param could have
        self.given: dict[str, Quantity] = {}  # params as given on their lines, without overrides
        self.names_used: dict[str, Span] = {}  # labels and signals, with their first position
        self.budget = MOST_NODES
        self.sizes: dict[str, int] = {}  # operators and operands of each definition

    # ------------------------------------------------------------------------------------------ statements

    def statements(self, trees: Iterable[Branch]) -> None:
        """Read the statements of a task file; what is wrong with them is collected in `faults`."""
        self.trees = trees = list(trees)
        self.look_ahead(trees)
        order = {"signals": 0, "expectation": 2}  # signal lines apply to the whole file, and all of it to expectations
        for tree in sorted(trees, key=lambda tree: order.get(str(tree.data), 1)):
            self.attempt(tree)

    def look_ahead(self, trees: list[Branch]) -> None:
        """The step and the unit, which apply to the whole file. What is wrong with their lines is reported later."""
        if any(tree.data in ("step", "unit") for tree in trees):
            ahead = Builder(self.source, overrides=self.overrides, faulty=self.faulty)
            for tree in trees:
                if tree.data in ("step", "unit", "params"):
                    ahead.attempt(tree)
            self.step, self.unit = ahead.step, ahead.unit
            self.faulty |= ahead.faulty & {"step =", "unit ="}

    def attempt(self, tree: Branch) -> None:
        """Read a statement; what is wrong with it is collected."""
        try:
            self.statement(tree)
            return
        except _At as error:
            self.faults.append(SyntaxFault(error.start, str(error)))
        except RecursionError:
            self.faults.append(SyntaxFault(tree.meta.start_pos, str(self.too_deep())))
        except _PassedOver:
            pass
        lines = branches(tree) if tree.data == "params" else [tree] if tree.data == "definition" else []
        self.faulty.update(str(line.children[0]) for line in lines)

    def statement(self, tree: Branch) -> None:
        match tree.data:
            case "model":
                if self.model is not None:
                    self.fail(tree, "this is a second model line; a task file has only one")
                self.model = unquoted(str(tree.children[0]))
                if not self.model:
                    self.fail(tree, 'the model line names no file; write, for example, model "floor.toml"')
            case "params":
                for part in branches(tree):
                    self.param(part)
            case "signals":
                for token in cast(list[Token], tree.children):
                    self.require_name(token)
                    self.signals.setdefault(unquoted(str(token)), self.span(token))
            case "step":
                self.step_line(tree)
            case "unit":
                self.unit_line(tree)
            case "definition":
                self.definition(tree)
            case "expectation":
                self.expectations.append(self.expectation(tree))
            case other:
                raise AssertionError(f"the grammar's rule {other} has no builder")

    def param(self, tree: Branch) -> None:
        token, expression = cast(tuple[Token, Branch], tuple(tree.children))
        name, value = str(token), self.constant(expression)  # checked even if it is overridden
        if self.given.get(name) == value:
            return  # Breach's files repeat params; the same value again is harmless
        self.claim(token, "param")
        taken = self.overrides.get(name, value)
        if isinstance(value, Duration) and not isinstance(taken, Duration):
            self.fail(tree, f"{name} is a time; override it with a unit, as in -p {name}={value}")
        if isinstance(taken, Duration) and not isinstance(value, Duration):
            self.fail(tree, f"{name} is a plain number; override it without a unit, as in -p {name}=20")
        self.given[name], self.params[name] = value, taken

    def step_line(self, tree: Branch) -> None:
        if "step" in self.seen:
            self.fail(tree, "this is a second step line; a task file has only one")
        self.seen.add("step")
        known = self.faulty & {"step ="}
        self.faulty.add("step =")  # until it is read: the times of the file depend on it
        value = self.constant(branches(tree)[0])
        if not isinstance(value, Duration) or value.seconds <= 0 or value.steps:
            self.fail(tree, "the step must be a positive time with a unit; write, for example, step = 0.1s")
        self.step = value
        self.faulty -= {"step ="} - known

    def unit_line(self, tree: Branch) -> None:
        if "unit" in self.seen:
            self.fail(tree, "this is a second unit line; a task file has only one")
        self.seen.add("unit")
        known = self.faulty & {"unit ="}
        self.faulty.add("unit =")
        given = tree.children[0]
        name = str(given) if isinstance(given, Token) else str(given.children[0]) if given.data == "name" else ""
        value: Quantity | None = one(name)
        if value is None and (name in self.params or not name):
            value = self.constant(cast(Branch, given))
        if not isinstance(value, Duration) or min(value.seconds, value.steps) < 0 or value == Duration(Fraction(0)):
            self.fail(tree, "the unit must be a unit of time, or step; write, for example, unit = s or unit = step")
        self.unit = value
        self.faulty -= {"unit ="} - known

    def definition(self, tree: Branch) -> None:
        token, body = cast(tuple[Token, Branch], tuple(tree.children))
        body = branches(body)[0]
        before = self.budget
        node = self.term(body) if self.is_term(body) else self.formula(body)
        self.sizes[str(token)] = before - self.budget + sum(1 for _ in body.iter_subtrees())
        self.claim(token, "definition")
        self.definitions[str(token)] = node

    def claim(self, token: Token, what: str) -> None:
        name = str(token)
        if name.lower() in INFINITY:
            self.fail(token, f"{name} is reserved for intervals without an end; rename this {what}")
        if name in self.params or name in self.definitions:
            self.fail(token, f"{name} is defined twice; rename this {what}")
        if name in self.signals:
            self.fail(token, f"{name} is a signal (line {self.signals[name].line}); rename this {what}")
        if name in self.names_used:
            place = self.names_used[name]
            if place.start > (token.start_pos or 0) and place.line == self.span(token).line:
                self.fail(token, f"{name} is defined in terms of itself; rename this {what}")
            self.fail(
                token,
                f"{name} is used as a label or signal on line {place.line}, before this {what}; "
                f"rename this {what}, or move it up if line {place.line} refers to it",
            )

    # ------------------------------------------------------------------------------------------ expectations

    def expectation(self, tree: Branch) -> Expectation:
        at = next(i for i, part in enumerate(tree.children) if not isinstance(part, Token))
        words = cast(list[Token], tree.children[:at])
        body = bare(branches(cast(Branch, tree.children[at]))[0])
        rest = list(tree.children[at + 1 :])
        said: list[list[Token]] = []
        while rest and not isinstance(rest[0], Token):
            said.append(cast(list[Token], cast(Branch, rest.pop(0)).children))
        question, robust = self.asked(words)
        if question == "cover":
            return self.cover(tree, words[-1], body, said, rest)
        for more in said[1:]:
            self.fail(more[0], f"{question} takes one file at most; leave this out")
        file = self.file_of(question, words[-1], said[0] if said else [])
        formula = self.expected(body, question)
        written = str(body.children[0]) if body.data == "name" else None
        relation, bound = self.bound_of(tree, question, words[-1], rest)
        return Expectation(
            question,
            formula,
            written if written in self.definitions else None,
            relation,
            bound,
            robust,
            file if question == "P" else None,
            file if question == "holds" else None,
            written=expectation_text(tree),
            span=self.span(tree),
        )

    def expected(self, body: Branch, question: Asked) -> Formula:
        """What an expectation is about; what monitors judge may have no end."""
        unbounded, self.unbounded = self.unbounded, self.unbounded or question in ("holds", "cover")
        try:
            formula = self.formula(body)
        finally:
            self.unbounded = unbounded
        self.require_shallow(formula)
        return formula

    def cover(
        self, tree: Branch, at: Token, body: Branch, said: list[list[Token]], rest: list[Token | Branch]
    ) -> Expectation:
        """A count over traces: of a part of a definition, or of the whole."""
        found: dict[str, list[Token]] = {}
        for words in said:
            word = str(words[0])
            kind = "measure" if word in (*OF_A_PART, *OF_THE_WHOLE) else word
            needs = {"measure": None, "of": "NAME", "trace": "STRING"}
            if kind not in needs:
                known = near_misses(word, {"of", "trace", *OF_A_PART, *OF_THE_WHOLE})
                self.fail(words[0], f"{word} is not something to say of a count; {known}")
            if kind in found:
                self.fail(words[0], f"{word} is said after {found[kind][0]}; leave one of them out")
            if (words[1].type if len(words) > 1 else None) != needs[kind]:
                told = {
                    "measure": f"nothing follows {word}; write {word}",
                    "of": "of takes the name of a definition, without quotes; write of NAME",
                    "trace": 'a file name belongs in double quotes here; write trace "log.csv"',
                }
                self.fail(words[-1], told[kind])
            found[kind] = words
        part = self.expected(body, "cover")
        name = self.whole_of(at, found["of"][1] if "of" in found else None)
        itself = str(body.children[0]) if body.data == "name" else ""
        if "of" not in found and itself in self.definitions and part not in walk(cast(Formula, self.definitions[name])):
            name = itself
        whole = cast(Formula, self.definitions[name])
        parts = {str(one): one for one in walk(whole)}
        if part not in parts.values():
            shown = ", ".join(cut(text, 40) for text in [*parts][1:7])
            others = f"its parts are {shown}{', …' if len(parts) > 7 else ''}" if shown else "it has no parts"
            self.fail(
                body, f"{cut(str(part), 60)} is not a part of {name}; {others}; for another definition, write of NAME"
            )
        measure = cast(Measure, str(found["measure"][0]) if "measure" in found else "held")
        measures = OF_THE_WHOLE if part == whole else OF_A_PART
        if measure not in measures:
            what = "the whole" if part == whole else "a part"
            self.fail(found["measure"][0], f"{measure} is not counted of {what}; write {', '.join(measures)}")
        file = unquoted(str(found["trace"][1])) if "trace" in found else None
        if file == "":
            self.fail(found["trace"][1], 'this names no file; write, for example, trace "log.csv"')
        relation, bound = self.bound_of(tree, "cover", at, rest)
        return Expectation(
            "cover", whole, name, relation, bound, trace=file, part=part, measure=measure,
            written=expectation_text(tree), span=self.span(tree),
        )  # fmt: skip

    def whole_of(self, at: Token, named: Token | None) -> str:
        """The definition whose parts are counted: the last one, unless it is named."""
        defined = [str(tree.children[0]) for tree in self.trees if tree.data == "definition"]
        if named is None and self.faulty:  # the last one may be faulty
            raise _PassedOver
        if named is None and not defined:
            self.fail(at, "cover counts parts of a definition, and the file has none; write one, such as r := F[0,9] a")
        name = str(named) if named is not None else defined[-1]
        if name in self.faulty:
            raise _PassedOver
        if name not in self.definitions:
            self.fail(named or at, f"there is no definition {name}; {near_misses(name, self.definitions)}")
        if not isinstance(self.definitions[name], FORMULAS):
            self.fail(named or at, f"{name} is a number; write of NAME with a definition that is a formula")
        return name

    def asked(self, words: list[Token]) -> tuple[Asked, bool]:
        """The question, and whether it is robust."""
        first, question = words[0], str(words[-1])
        if len(words) > 1 and str(first) != "robust":
            self.fail(first, f"expected robust or a question, found {first}; {near_misses(str(first), ['robust'])}")
        if question not in ASKED:
            close = near_misses(question, ASKED)
            known = "write Pmax, Pmin, P (of a policy), holds (on a trace) or cover (a count)"
            known = close if close.startswith("did") else known
            self.fail(words[-1], f"{question} is not something to expect; {known}")
        if question in ("holds", "cover") and len(words) > 1:
            self.fail(first, "robust is for probabilities that are intervals; a trace has none, so leave robust out")
        return question, len(words) > 1

    def file_of(self, question: Asked, at: Token, named: list[Token]) -> str | None:
        """The file that a question needs."""
        needed = {"P": ("policy", "p.npz"), "holds": ("trace", "log.csv")}.get(question)
        if not named:
            if needed is not None:
                word, example = needed
                over = ", or Pmax or Pmin over all policies" if question == "P" else ""
                self.fail(at, f'{question} needs a {word}; write {question}(…, {word} "{example}"){over}')
            return None
        word = str(named[0])
        if needed is None:
            of = 'for the probability of one policy, write P(…, policy "p.npz")' if word == "policy" else "leave it out"
            self.fail(named[0], f"{question} is over all policies and takes no {word}; {of}")
        if word != needed[0]:
            self.fail(named[0], f'{question} needs a {needed[0]}, not a {word}; write {needed[0]} "{needed[1]}"')
        if len(named) < 2 or named[1].type != "STRING":
            self.fail(named[-1], f'a file name belongs in double quotes here; write {word} "{needed[1]}"')
        if not (file := unquoted(str(named[1]))):
            self.fail(named[1], f'this names no file; write, for example, {word} "{needed[1]}"')
        return file

    def bound_of(
        self, tree: Branch, question: Asked, at: Token, rest: list[Token | Branch]
    ) -> tuple[Relation | None, Fraction | None]:
        """The bound that a probability, or a count, is compared with."""
        example, what = ("100", "a count") if question == "cover" else ("0.95", "a probability")
        if question == "holds":
            if rest:
                self.fail(cast(Token, rest[0]), "a formula holds on a trace or does not; leave the bound out")
            return None, None
        if not rest:
            asked = f"expect {self.span(tree).text()[7:].strip()}"
            self.fail(at, f"{question} needs a bound; write, for example, {asked} >= {example}")
        written, place = cast(Token, rest[0]), cast(Branch, rest[1])
        relation = _COMPARATOR_SPELLINGS.get(str(written), str(written))
        if relation not in RELATIONS:
            line = self.span(tree).text()
            before = line[: cast(int, written.start_pos) - tree.meta.start_pos].strip()
            least, most = (
                f"{before} {sign} {line[cast(int, written.end_pos) - tree.meta.start_pos :].strip()}"
                for sign in ((">=", "<=") if relation == "==" else (">", "<"))
            )
            both = f"write both {least} and {most}" if relation == "==" else f"write {least}, or {most}"
            self.fail(written, f"{what} is compared by >=, <=, > or <; for {relation}, {both}")
        self.example, before = example, self.example
        try:
            value = self.constant(place)
        finally:
            self.example = before
        if question == "cover":
            if isinstance(value, Duration) or value < 0 or value.denominator != 1:
                self.fail(place, f"expected a count, an integer from 0 up, found {self.span(place).text()}; write 100")
            return relation, value
        if isinstance(value, Duration):
            self.fail(place, "expected a probability, found a time; write a number such as 0.95 or 19/20")
        if not 0 <= value <= 1:
            self.fail(
                place, f"{number_text(value)} is not a probability, which lies between 0 and 1; write another bound"
            )
        return relation, value

    # ------------------------------------------------------------------------------------------ truth values

    def spend(self, tree: Branch, nodes: int) -> None:
        self.budget -= nodes
        if self.budget < 0:
            self.fail(tree, f"this formula has more than {MOST_NODES} operators; use definitions less often")

    def whole_formula(self, tree: Branch) -> Formula:
        """The formula of a text that contains nothing else."""
        self.trees = [tree]
        try:
            return self.formula(branches(tree)[0])
        except RecursionError:
            raise self.too_deep() from None

    def formula(self, tree: Branch) -> Formula:
        tree = bare(tree)
        span = self.span(tree)
        parts = branches(tree)
        match tree.data:
            case "true" | "false":
                return Constant(tree.data == "true", span=span)
            case "name":
                return self.named_formula(tree)
            case "quoted":
                return self.quoted_formula(tree)
            case "not":
                return Not(self.formula(parts[0]), span=span)
            case "and":
                return And(tuple(self.formula(part) for part in parts), span=span)
            case "or":
                return Or(tuple(self.formula(part) for part in parts), span=span)
            case "implies":
                self.require_no_comparison(tree)
                return Implies(self.formula(parts[0]), self.formula(parts[1]), span=span)
            case "iff":
                return Iff(self.formula(parts[0]), self.formula(parts[1]), span=span)
            case "xor":
                return Not(Iff(self.formula(parts[0]), self.formula(parts[1]), span=span), span=span)
            case "eventually":
                return Eventually(self.interval(tree), self.formula(parts[-1]), span=span)
            case "always":
                return Always(self.interval(tree), self.formula(parts[-1]), span=span)
            case "until":
                return Until(self.interval(tree), self.formula(parts[0]), self.formula(parts[-1]), span=span)
            case "release":
                return Release(self.interval(tree), self.formula(parts[0]), self.formula(parts[-1]), span=span)
            case "weak_until":
                return self.weak_until(tree)
            case "once":
                return Once(self.interval(tree), self.formula(parts[-1]), span=span)
            case "historically":
                return Historically(self.interval(tree), self.formula(parts[-1]), span=span)
            case "since":
                return Since(self.interval(tree), self.formula(parts[0]), self.formula(parts[-1]), span=span)
            case "trigger":
                return Trigger(self.interval(tree), self.formula(parts[0]), self.formula(parts[-1]), span=span)
            case "prev":
                return Once(_ONE_STEP, self.formula(parts[0]), span=span)
            case "rise":
                return Rise(self.formula(parts[0]), span=span)
            case "fall":
                return Rise(Not(self.formula(parts[0]), span=span), span=span)
            case "comparison":
                left, op, right = parts
                return settled(Comparison(self.comparator(op), self.term(left), self.term(right), span=span))
            case "chained":
                self.fail(tree, f"comparisons cannot be chained; write ({self.unchained(tree)})")
            case "number" | "binary" | "negate" | "call" | "time" | "sample":
                self.fail(tree, f"expected a Boolean expression, found a number; compare it, as in {span.text()} > 0")
            case other:
                raise AssertionError(f"the grammar's rule {other} has no builder")

    def require_no_comparison(self, tree: Branch) -> None:
        """Refuse `x => 5`: beside a number, => is meant to compare."""
        left, right = branches(tree)
        sign = self.source.text[left.meta.end_pos : right.meta.start_pos]
        if "=>" in sign and (self.is_term(left) or self.is_term(right)):
            shown = f"{self.span(left).text()} >= {self.span(right).text()}"
            self.fail(tree, f"=> means implies, but a number is next to it; to compare, write {shown}")

    def weak_until(self, tree: Branch) -> Formula:
        """φ weak_until[a,b] ψ is (φ U[a,b] ψ) ∨ G[0,b] φ."""
        interval, span, parts = self.interval(tree), self.span(tree), branches(tree)
        left, right = self.formula(parts[0]), self.formula(parts[-1])
        self.spend(tree, sum(1 for _ in walk(left)))  # it stands twice
        stays = Always(Interval(0, interval.b), left, span=span)
        return Or((Until(interval, left, right, span=span), stays), span=span)

    def named_formula(self, tree: Branch) -> Formula:
        name, span = str(tree.children[0]), self.span(tree)
        if name in self.definitions:
            node = self.definitions[name]
            if isinstance(node, FORMULAS):
                self.spend(tree, self.sizes[name])
                return cast(Formula, node)
            self.fail(tree, f"expected a Boolean expression, but {name} is a number; compare it, as in {name} > 0")
        self.pass_over(name)
        if name in self.params:
            self.fail(tree, f"expected a Boolean expression, but {name} is a param; compare something with it")
        if name in self.signals:
            self.fail(tree, f"expected a Boolean expression, but {name} is a signal; compare it, as in {name} > 0")
        self.refuse_word(tree, name)
        self.names_used.setdefault(name, span)
        return Label(name, span=span)

    def quoted_formula(self, tree: Branch) -> Formula:
        """A name in quotes is a label or a signal, whatever is defined."""
        name = unquoted(str(self.require_name(cast(Token, tree.children[0]))))
        if name in self.signals:
            shown = f"{written(name)} is a signal; compare it, as in {written(name)} > 0"
            self.fail(tree, f"expected a Boolean expression, but {shown}")
        return Label(name, span=self.span(tree))

    def require_name(self, token: Token) -> Token:
        if str(token) == '""':
            self.fail(token, "these quotes hold no name; write the name of a label or a signal between them")
        return token

    def refuse_word(self, tree: Branch, name: str) -> None:
        """`True` is not taken for a label: a capitalised keyword is a slip."""
        if name.lower() in WORDS:
            self.fail(tree, f"keywords are lower case; write {name.lower()} (a signal of that name: {written(name)})")
        if name.lower() in (*INFINITY, "nan"):
            self.fail(tree, f"{name} is not a number with which a signal can be compared; leave the comparison out")

    def pass_over(self, name: str) -> None:
        if name in self.faulty and name not in self.params:
            raise _PassedOver

    def given_later(self, name: str, tree: Branch) -> int | None:
        """The line of a param behind a place that uses it."""
        for line in self.trees:
            for part in branches(line) if line.data == "params" else []:
                token = cast(Token, part.children[0])
                if str(token) == name and cast(int, token.start_pos) > tree.meta.start_pos:
                    return self.span(token).line
        return None

    def comparator(self, token: Branch | Token) -> Comparator:
        return cast(Comparator, _COMPARATOR_SPELLINGS.get(str(token), str(token)))

    def unchained(self, tree: Branch) -> str:
        """`2 < x < 4` → `x > 2 & x < 4`."""
        mirror = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}
        terms = [self.term(part) for part in branches(tree)[::2]]
        ops = [self.comparator(cast(Token, part)) for part in tree.children[1::2]]
        pairs = []
        for left, op, right in zip(terms, ops, terms[1:], strict=False):
            flip = isinstance(left, Number) and not isinstance(right, Number)
            a, o, b = (right, mirror[op], left) if flip else (left, op, right)
            pairs.append(f"{term_text(a)} {o} {term_text(b)}")
        return " & ".join(pairs)

    # ------------------------------------------------------------------------------------------ intervals

    def interval(self, operator: Branch) -> Interval:
        """The interval of a temporal operator, closed and in integer steps."""
        tree = next((part for part in branches(operator) if part.data == "interval"), None)
        word = str(operator.data)
        if tree is None:
            return self.endless(self.operator_span(operator), word, 0)
        opening, lower, upper, closing = cast(tuple[Token, Branch, Branch, Token], tuple(tree.children))
        a = self.whole_steps(lower)
        if a < 0:
            self.fail(lower, f"the interval starts at step {a}; steps count from 0")
        first = a + (opening == "(")
        end = bare(upper)
        if end.data == "name" and str(end.children[0]).lower() in INFINITY:
            return self.endless(self.span(tree), word, first)
        b = self.whole_steps(upper)
        last = b - (closing == ")")
        if last < first:
            low, high = flat_text(lower), flat_text(upper)
            example = f"[{high},{low}]" if 0 <= b < a else f"[{low},{high}]" if a <= b else f"[0,{low}]"
            shown = f"{opening}{low},{high}{closing}"
            self.fail(tree, f"the interval {shown} is empty; write, for example, {example}")
        return Interval(first, last)

    def endless(self, place: Span, word: str, first: int) -> Interval:
        """An interval without an end; the past needs none, since it begins with the trace."""
        if word in _ENDLESS and not self.unbounded:
            raise _At(
                place,
                f"{word} needs an interval with an end here, such as {_ENDLESS[word]}[{first},{first + 10}] "
                "(only monitors and check --for-ever can do without: stltool monitor, or unbounded=True; a label of "
                "that name is in quotes: "
                f'"{_ENDLESS[word]}")',
            )
        return Interval(first, None)

    def whole_steps(self, tree: Branch) -> int:
        """The number of steps of a bound."""
        value = self.constant(tree)
        size = abs(value.seconds) + abs(value.steps) if isinstance(value, Duration) else abs(value)
        if size > LARGEST_BOUND:
            self.fail(tree, "this bound is out of range; use larger time steps")
        plain = not isinstance(value, Duration)
        if size and self.faulty & {"step =", "unit ="}:
            raise _PassedOver
        if not isinstance(value, Duration):
            if self.unit is None and self.step is not None and value:
                self.ambiguous(tree, value, self.step)
            value = (self.unit or STEP).times(value)
        steps = value.in_steps(self.step)
        if steps is None:
            example = self.declare([("step", str(self.fitting_step(value.seconds)))])
            self.fail(tree, f"this bound is a time, but no step is declared; {example}")
        if steps.denominator != 1:
            self.no_multiple(tree, value, steps, plain)
        if abs(steps) > LARGEST_BOUND:
            self.fail(tree, "this bound is out of range; use larger time steps")
        return steps.numerator

    def ambiguous(self, tree: Branch, value: Fraction, step: Duration) -> NoReturn:
        """Refuse a plain number that could be a time or a number of steps."""
        unit = "s" if step.seconds < UNITS["min"] else "min" if step.seconds < UNITS["h"] else "h"
        duration = Duration(value * UNITS[unit])
        time = f"{number_text(value)}{unit}"
        count = duration.seconds / step.seconds
        name = bare(tree)
        shown = f"{flat_text(tree)} = {number_text(value)}" if name.data != "number" else number_text(value)
        if value.denominator != 1 and count.denominator != 1:
            near = " or ".join(str(step.times(Fraction(n))) for n in (math.floor(count), math.ceil(count)))
            self.fail(
                tree,
                f"{shown} is neither an integer number of steps nor, as {time}, a multiple of the step, {step}; "
                f"write {near}",
            )
        steps = Duration(Fraction(0), value)
        readings, lines = [], []
        if count.denominator == 1:
            readings.append((time, f"{time} ({Duration(Fraction(0), count)})"))
            lines.append(("unit", unit))
        if value.denominator == 1:
            readings.append((str(steps), f"{steps} ({step.times(value)})"))
            lines.append(("unit", "step"))
        prefix = f"param {flat_text(tree)} = " if name.data == "name" else ""
        write = " or ".join(f"{prefix}{short}" for short, _ in readings) if name.data in ("name", "number") else ""
        self.fail(
            tree,
            f"{shown} could be {' or '.join(told for _, told in readings)}: a step is declared, but no unit of plain "
            f"numbers; {'write ' + write + ', or ' if write else ''}{self.declare(lines)}",
        )

    def declare(self, values: list[tuple[str, str]], both: bool = False) -> str:
        """How to declare one of some values of the step and the unit, or both."""
        joint = " and " if both else " or "
        if self.lines:
            lines = joint.join(f"{word} = {value}" for word, value in values)
            return f"add {'the lines' if both else 'a line'} {lines}"
        return f"give {joint.join(named(word, f'{word}={value!r}') for word, value in values)}"

    def fitting_step(self, seconds: Fraction) -> Duration:
        """A step of which this bound is a multiple, and all bounds of the text, as far as their numbers show."""
        kinds = ("interval", "sample")
        intervals = [part for tree in self.trees for kind in kinds for part in tree.find_data(kind)]
        used = {str(part.children[0]) for tree in intervals for part in tree.find_data("name")}
        params = [part for tree in self.trees if tree.data == "params" for part in branches(tree)]
        found = [seconds]
        for tree in intervals + [part for part in params if str(part.children[0]) in used]:
            for part in (*tree.find_data("number"), *tree.find_data("time")):
                with contextlib.suppress(StlSyntaxError):  # reported where it stands
                    value = self.constant(part)
                    found.append(value.seconds if isinstance(value, Duration) else value)
        whole = math.lcm(*(value.denominator for value in found))
        return Duration(Fraction(1, 10 if 10 % whole == 0 else whole))

    def no_multiple(self, tree: Branch, value: Duration, steps: Fraction, plain: bool) -> NoReturn:
        """Refuse a bound that lies between two steps."""
        near = [Fraction(math.floor(steps)), Fraction(math.ceil(steps))]
        unit = self.unit if plain else None
        if value.seconds and self.step is not None:
            if unit is not None and unit.seconds and not unit.steps:
                times = [number_text(n * self.step.seconds / unit.seconds) for n in near]
            else:
                times = [str(self.step.times(n)) for n in near]
            self.fail(tree, f"{value} is not a multiple of the step, {self.step}; write {times[0]} or {times[1]}")
        shown = number_text(value.steps)
        low, high = (number_text(n) if plain else str(Duration(Fraction(0), n)) for n in near)
        seconds = ""
        if plain and unit is None:
            lines = [("step", str(self.fitting_step(value.steps))), ("unit", "s")]
            seconds = f"; for times in seconds, {self.declare(lines, both=True)}"
        self.fail(tree, f"the bound {shown} is not an integer number of steps; write {low} or {high}{seconds}")

    # ------------------------------------------------------------------------------------------ numbers

    def is_term(self, tree: Branch) -> bool:
        tree = bare(tree)
        if tree.data == "name":
            name = str(tree.children[0])
            known = self.definitions.get(name)
            return (
                name in self.params or name in self.signals or (known is not None and not isinstance(known, FORMULAS))
            )
        if tree.data == "quoted":
            return unquoted(str(tree.children[0])) in self.signals
        return tree.data in ("number", "time", "binary", "negate", "call", "sample")

    def term(self, tree: Branch) -> Term:
        tree = bare(tree)
        span = self.span(tree)
        parts = tree.children
        match tree.data:
            case "number":
                return Number(self.literal_float(cast(Token, parts[0])), span=span)
            case "name":
                return self.named_term(tree)
            case "quoted":
                return Variable(unquoted(str(self.require_name(cast(Token, parts[0])))), span=span)
            case "sample":
                return self.sample(tree)
            case "negate":
                return Negate(self.term(branches(tree)[0]), span=span)
            case "binary":
                left, op, right = cast(tuple[Branch, Token, Branch], tuple(parts))
                return Arithmetic(cast(ArithmeticOperator, str(op)), self.term(left), self.term(right), span=span)
            case "call":
                args = tuple(self.term(part) for part in branches(tree)[1:])
                return self.wrapped(tree, lambda: Call(cast(FunctionName, str(parts[0])), args, span=span))
            case "time":
                self.fail(tree, "expected a plain number, found a time; times occur only in intervals and params")
            case "comparison" | "chained" | "true" | "false" | "not" | "and" | "or":
                self.fail(tree, "expected a number, found a Boolean expression; check the parentheses")
            case "implies" | "iff" | "xor" | "eventually" | "always":
                self.fail(tree, "expected a number, found a Boolean expression; check the parentheses")
            case data if data in INFIXES or data in PAST_PREFIXES:
                self.fail(tree, "expected a number, found a Boolean expression; check the parentheses")
            case other:
                raise AssertionError(f"the grammar's rule {other} has no builder")

    def named_term(self, tree: Branch) -> Term:
        name = str(tree.children[0])
        if name in self.params:
            value = self.param_value(tree, self.params[name])
            number = Number(abs(value), span=self.span(tree))
            return Negate(number, span=self.span(tree)) if value < 0 else number
        self.pass_over(name)
        if name in self.definitions:
            node = self.definitions[name]
            if isinstance(node, FORMULAS):
                self.fail(tree, f"expected a number, but {name} is Boolean; use it without comparing")
            self.spend(tree, self.sizes[name])
            return cast(Term, node)
        return self.variable(tree, name)

    def sample(self, tree: Branch) -> Term:
        """Breach's `x[t]`: the value of the signal at the evaluation step; `x[t+k]` and `x[t-k]`: at others."""
        token, index = cast(tuple[Token, Branch], tuple(tree.children))
        name, quoted = unquoted(str(token)), token.type == "STRING"
        delay = -self.shift(tree, index)
        if quoted:
            return Variable(unquoted(str(self.require_name(token))), delay, span=self.span(tree))
        if name in self.params or name in self.definitions:
            self.fail(tree, f"{name} is a {'param' if name in self.params else 'definition'}, not a signal; drop [t]")
        self.pass_over(name)
        return replace(self.variable(tree, name), delay=delay)

    def shift(self, tree: Branch, index: Branch) -> int:
        """How many steps after t a sample is read: 0 for t, 2 for t + 2."""
        index = bare(index)
        parts = branches(index)
        if index.data == "name" and str(parts[0]) == "t":
            return 0
        if index.data == "binary" and str(parts[1]) in "+-":
            left, right = parts[0], parts[2]
            if _mentions_t(left):
                return self.shift(tree, left) + (1 if str(parts[1]) == "+" else -1) * self.whole_steps(right)
            if str(parts[1]) == "+":
                return self.whole_steps(left) + self.shift(tree, right)
        name = str(tree.children[0])
        self.fail(
            tree,
            f"a sample is read at the step t, or some steps after or before it; write {name}[t], {name}[t+1] or "
            f"{name}[t-1]",
        )

    def variable(self, tree: Branch, name: str) -> Variable:
        span = self.span(tree)
        self.refuse_word(tree, name)
        self.names_used.setdefault(name, span)
        return Variable(name, span=span)

    def param_value(self, tree: Branch, value: Quantity) -> float:
        if isinstance(value, Duration):
            self.fail(tree, "expected a plain number, found a time; times occur only in intervals and params")
        try:
            number = float(value)
        except OverflowError:
            self.fail(tree, "the value of this param is too large to be compared with a signal; use a smaller one")
        if number == 0 and value != 0:
            self.fail(tree, "the value of this param is too small to be compared with a signal; use a larger one, or 0")
        return number

    def literal_float(self, token: Token) -> float:
        try:
            value, exact_value = double(str(token)), read(str(token))
        except NumberError as error:
            self.fail(token, str(error))
        if value == 0 and exact_value != 0:
            self.fail(token, f"{token} is too small for a double (the smallest is 5e-324); write 0, or a larger number")
        return value

    # ------------------------------------------------------------------------------------------ exact constants

    def constant(self, tree: Branch) -> Quantity:
        """The exact value of an expression over numbers, times and params."""
        tree = bare(tree)
        parts = branches(tree)
        match tree.data:
            case "number":
                return self.literal(tree, str(parts[0]))
            case "time":
                digits = str(parts[0]).rstrip("".join([*UNITS, "step \t"]))
                unit = one(str(parts[0])[len(digits) :].strip())
                assert unit is not None  # the grammar knows no others
                return unit.times(self.literal(tree, digits))
            case "name":
                name = str(parts[0])
                if name not in self.params:
                    self.pass_over(name)
                    if name in self.definitions:
                        self.fail(tree, f"{name} is a definition; for a number in bounds, write param {name} = …")
                    if (later := self.given_later(name, tree)) is not None:
                        self.fail(tree, f"{name} is a param of line {later}, which comes later; move it up")
                    close = near_misses(name, self.params)
                    given = f"give it a value: param {name} = {self.example}"
                    known = close if close.startswith("did") else f"{given}; {close}" if self.params else given
                    self.fail(tree, f"{name} is not a param; {known}")
                return self.params[name]
            case "negate":
                return self.negative(self.constant(parts[0]))
            case "call":
                return self.constant_call(tree)
            case "binary":
                return self.constant_binary(tree)
            case "sample" | "quoted":
                self.fail(tree, "expected a constant, found a signal; write a number or a param")
            case _:
                self.fail(tree, "expected a number, found a Boolean expression; write a number or a param")

    def literal(self, tree: Branch, text: str) -> Fraction:
        try:
            return read(text)
        except NumberError as error:
            self.fail(tree, str(error))

    def constant_call(self, tree: Branch) -> Quantity:
        function, *args = branches(tree)
        values = [self.constant(arg) for arg in args]
        self.wrapped(tree, lambda: Call(cast(FunctionName, str(function)), (Number(0.0),) * len(values)))
        name = str(function)
        if name not in ("abs", "min", "max"):
            self.fail(tree, f"{name} has no exact value; write the number itself")
        if any(isinstance(value, Duration) for value in values):
            values = [self.as_time(tree, value) for value in values]
        plain = self.comparable(tree, values)
        if name == "abs":
            return values[0] if plain[0] >= 0 else self.negative(values[0])
        return values[plain.index(min(plain) if name == "min" else max(plain))]

    def negative(self, value: Quantity) -> Quantity:
        return value.times(Fraction(-1)) if isinstance(value, Duration) else -value

    def as_time(self, tree: Branch, value: Quantity) -> Duration:
        """A plain number next to a time is one if its unit is declared."""
        if isinstance(value, Duration):
            return value
        if self.unit is None:
            self.fail(tree, "a time and a plain number cannot be combined; give both a unit, or neither")
        return self.unit.times(value)

    def comparable(self, tree: Branch, values: list[Quantity]) -> list[Fraction]:
        """Plain numbers, or times in one unit."""
        times = [value for value in values if isinstance(value, Duration)]
        if not times:
            return [value for value in values if not isinstance(value, Duration)]
        if not any(time.steps for time in times):
            return [time.seconds for time in times]
        steps = [time.in_steps(self.step) for time in times]
        if None in steps:
            if "step =" in self.faulty:
                raise _PassedOver
            example = self.declare([("step", "0.1s")])
            self.fail(tree, f"this combines times with steps, but no step is declared; {example}")
        return cast("list[Fraction]", steps)

    def constant_binary(self, tree: Branch) -> Quantity:
        left, token, right = cast(tuple[Branch, Token, Branch], tuple(tree.children))
        x, y, op = self.constant(left), self.constant(right), str(token)
        if op in "+-" and (isinstance(x, Duration) or isinstance(y, Duration)):
            other = self.as_time(tree, y)
            result: Quantity = self.as_time(tree, x) + (other if op == "+" else other.times(Fraction(-1)))
        elif isinstance(x, Duration) and isinstance(y, Duration) and op == "/":
            result = self.computed(tree, op, *self.comparable(tree, [x, y]))
        elif isinstance(x, Duration) and not isinstance(y, Duration) and op in "*/":
            result = x.times(self.computed(tree, op, Fraction(1), y))
        elif isinstance(y, Duration) and not isinstance(x, Duration) and op == "*":
            result = y.times(x)
        elif isinstance(x, Duration) or isinstance(y, Duration):
            self.fail(tree, "this is not a time; times can be added, and multiplied or divided by plain numbers")
        else:
            result = self.computed(tree, op, x, y)
        for value in (result.seconds, result.steps) if isinstance(result, Duration) else (result,):
            if max(value.numerator.bit_length(), value.denominator.bit_length()) > _LARGEST_BITS:
                self.fail(tree, "this value is out of range: it has too many digits; use a simpler number")
        return result

    def computed(self, tree: Branch, op: str, a: Fraction, b: Fraction) -> Fraction:
        match op:
            case "+":
                return a + b
            case "-":
                return a - b
            case "*":
                return a * b
            case "/":
                if b == 0:
                    self.fail(tree, "division by zero; use another divisor")
                return a / b
            case "^":
                large = max(a.numerator.bit_length(), a.denominator.bit_length()) * abs(b) > _LARGEST_BITS
                if b.denominator != 1 or abs(b) > _LARGEST_POWER or (a == 0 and b < 0) or large:
                    self.fail(tree, f"this power is out of range; exponents are integers up to {_LARGEST_POWER}")
                return a**b.numerator
            case other:
                raise AssertionError(f"the grammar's operator {other} has no meaning")

    # ------------------------------------------------------------------------------------------ positions

    def span(self, item: Branch | Token) -> Span:
        if isinstance(item, Token):
            return Span(self.source, item.start_pos or 0, item.end_pos or 0)
        return Span(self.source, item.meta.start_pos, item.meta.end_pos)

    def operator_span(self, tree: Branch) -> Span:
        """The position of the operator itself: its word is not part of the tree."""
        parts = branches(tree)
        start = parts[0].meta.end_pos if tree.data in INFIXES else tree.meta.start_pos
        text = self.source.text[start : parts[-1].meta.start_pos]
        found = re.search(r"\w+|[^\s\w([]+|\[\]", text)
        return Span(self.source, start + found.start(), start + found.end()) if found else self.span(tree)

    def fail(self, item: Branch | Token, message: str) -> NoReturn:
        raise _At(self.span(item), message)

    def wrapped(self, tree: Branch, build: Callable[[], _T]) -> _T:
        """The error of a node constructor, with its position."""
        try:
            return build()
        except StlSyntaxError as error:
            self.fail(tree, str(error))

    def require_shallow(self, phi: Formula) -> None:
        """Later traversals recurse; the limit is a depth that all of them can handle."""
        level: list[Formula | Term] = [phi]
        for _ in range(DEEPEST):
            level = [child for node in level for child in operands(node)]
            if not level:
                return
        raise self.too_deep()

    def too_deep(self) -> StlSyntaxError:
        return StlSyntaxError(
            f"{self.source.name}: operators are nested too deeply (over {DEEPEST} levels); simplify the formula, or "
            "write a & b & c in one level"
        )
