"""Formula → an equivalent formula: negation normal form, and simplification.

Truth and robustness are values in a chain (false < true, or −inf … inf) whose order negation reverses. Every rewriting
here is valid in each such chain, so it preserves both, at every step:

    ¬(φ U[a,b] ψ) = ¬φ release[a,b] ¬ψ                      ¬(φ since[a,b] ψ) = ¬φ trigger[a,b] ¬ψ
    rise φ = φ ∧ historically[1,1] ¬φ                       once[a,b] once[c,d] φ = once[a+c,b+d] φ
    ¬(φ ↔ ψ) = ¬φ ↔ ψ = (φ ∧ ¬ψ) ∨ (¬φ ∧ ψ)                 ¬(s > t) = s ≤ t, ¬(s = t) = s ≠ t
    F[a,b] F[c,d] φ = F[a+c,b+d] φ                           F[a,b] φ ∨ F[c,d] φ = F[min(a,c),max(b,d)] φ  if they touch
    F[a,b] φ ∨ F[a,b] ψ = F[a,b] (φ ∨ ψ)                     φ ∧ (φ ∨ ψ) = φ             and the duals of these

φ ∨ ¬φ has robustness |φ|, so it is replaced by true only if φ contains labels alone, whose robustness is infinite.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias, assert_never

from stltool.arguments import flag, whole
from stltool.errors import SizeError
from stltool.logic.formula import (
    Always,
    And,
    Comparator,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Not,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    children,
    delay,
    formula_of,
    walk,
)
from stltool.logic.task import Task
from stltool.source import Span

MOST_OPERATORS = 200_000
_DEEPEST = 200  # later traversals recurse

OPPOSITE: dict[Comparator, Comparator] = {"<": ">=", ">=": "<", ">": "<=", "<=": ">", "==": "!=", "!=": "=="}
MIRROR: dict[Comparator, Comparator] = {"<": ">", ">": "<", "<=": ">=", ">=": "<=", "==": "==", "!=": "!="}

_WindowNode: TypeAlias = Eventually | Always | Once | Historically
_Window: TypeAlias = type[Eventually] | type[Always] | type[Once] | type[Historically]
_Join: TypeAlias = type[Until] | type[Release] | type[Since] | type[Trigger]
_FUTURE: tuple[_Window, _Window] = (Eventually, Always)
_PAST: tuple[_Window, _Window] = (Once, Historically)
_AHEAD: tuple[_Window | _Join, ...] = (Eventually, Always, Until, Release)
_SOME: tuple[_Window | _Join, ...] = (Eventually, Once, Until, Since)  # "at some step"; the others: "at every step"
_DUAL_WINDOW: dict[_Window, _Window] = {
    Eventually: Always, Always: Eventually, Once: Historically, Historically: Once,
}  # fmt: skip
_DUAL_JOIN: dict[_Join, _Join] = {Until: Release, Release: Until, Since: Trigger, Trigger: Since}


def operator_count(phi: Formula) -> int:
    """The number of operators (a & b & c has two), which `simplify` never increases."""
    return sum(_own_operators(node) for node in walk(phi))


def _own_operators(phi: Formula) -> int:
    operands = len(children(phi))
    return operands - 1 if isinstance(phi, And | Or) else min(operands, 1)


# --------------------------------------------------------------------------------------- negation normal form


def negation_normal_form(phi: Formula | Task, most_operators: int = MOST_OPERATORS) -> Formula:
    """φ with negations in front of labels, and of comparisons that read earlier steps, only, and without -> and <->.

    Truth and robustness stay the same at every step, also for traces that end inside a window. An equivalence and a
    rise repeat their operands: SizeError if this gives more than `most_operators`.
    """
    phi = formula_of(phi, "negation_normal_form's formula")
    most_operators = whole(most_operators, "most_operators", least=0)
    known: dict[tuple[int, bool], Formula] = {}  # by identity: hashing a deep node would traverse all of it
    result = _nnf(phi, False, known)
    size, depth = _measures(result)
    if size > most_operators:
        raise SizeError(
            f"the negation normal form has {float(size):.3g} operators, over {most_operators}: each level of "
            "equivalences or rises doubles it; nest them less, or evaluate the formula as it is"
        )
    if depth > max(_DEEPEST, _measures(phi)[1]):
        raise SizeError(
            f"the negation normal form nests operators {depth} deep, over {_DEEPEST}; nest equivalences and rises "
            "less, or evaluate the formula as it is"
        )
    return result


def _nnf(phi: Formula, negated: bool, known: dict[tuple[int, bool], Formula]) -> Formula:
    """φ or ¬φ; repeated operands share one node, so time and memory stay linear."""
    found = known.get((id(phi), negated))
    if found is None:
        found = known[id(phi), negated] = _nnf_node(phi, negated, known)
    return found


def _nnf_node(phi: Formula, negated: bool, known: dict[tuple[int, bool], Formula]) -> Formula:
    span = phi.span
    match phi:
        case Constant(value):
            return Constant(value != negated, span=span)
        case Label():
            return Not(phi, span=span) if negated else phi
        case Comparison() if delay(phi):  # false at steps before its samples exist, as its opposite would be
            return Not(phi, span=span) if negated else phi
        case Comparison(op, left, right):
            return Comparison(OPPOSITE[op], left, right, span=span) if negated else phi
        case Not(arg):
            return _nnf(arg, not negated, known)
        case And(args) | Or(args):
            kind = And if isinstance(phi, And) != negated else Or
            return kind(tuple([_nnf(arg, negated, known) for arg in args]), span=span)
        case Implies(left, right):
            junction = And if negated else Or
            return junction((_nnf(left, not negated, known), _nnf(right, negated, known)), span=span)
        case Iff(left, right):
            p, q = _nnf(left, False, known), _nnf(right, False, known)
            not_p, not_q = _nnf(left, True, known), _nnf(right, True, known)
            if negated:
                return Or((And((p, not_q), span=span), And((not_p, q), span=span)), span=span)
            return And((Or((not_p, q), span=span), Or((p, not_q), span=span)), span=span)
        case Eventually(interval, arg) | Always(interval, arg) | Once(interval, arg) | Historically(interval, arg):
            window = _DUAL_WINDOW[type(phi)] if negated else type(phi)
            return window(interval, _nnf(arg, negated, known), span=span)
        case (
            Until(interval, left, right)
            | Release(interval, left, right)
            | Since(interval, left, right)
            | Trigger(interval, left, right)
        ):
            join = _DUAL_JOIN[type(phi)] if negated else type(phi)
            return join(interval, _nnf(left, negated, known), _nnf(right, negated, known), span=span)
        case Rise(arg):
            p, not_p = _nnf(arg, False, known), _nnf(arg, True, known)
            if negated:
                return Or((not_p, Once(Interval(1, 1), p, span=span)), span=span)
            return And((p, Historically(Interval(1, 1), not_p, span=span)), span=span)
        case _:
            assert_never(phi)


def _measures(phi: Formula) -> tuple[int, int]:
    """Operators and depth of a formula whose nodes may be shared; each node is visited once."""
    known: dict[int, tuple[int, int]] = {}
    stack = [phi]
    while stack:
        node = stack[-1]
        missing = [child for child in children(node) if id(child) not in known]
        if missing:
            stack.extend(missing)
            continue
        stack.pop()
        below = [known[id(child)] for child in children(node)]
        size = _own_operators(node) + sum(size for size, _ in below)
        known[id(node)] = (size, 1 + max((depth for _, depth in below), default=-1))
    return known[id(phi)]


# ------------------------------------------------------------------------------------------- simplification

_Junction: TypeAlias = type[And] | type[Or]


def simplify(phi: Formula | Task, cut: bool = False) -> Formula:
    """An equivalent formula with at most as many operators, usually fewer; the result is a fixed point.

    Truth and robustness are the same at every step of every trace that is long enough for φ (a window without an end is
    assumed to contain a step); with `cut`, also for traces that end inside or before a window and are judged on their
    remaining steps, where F[2,3] true may be false. The horizon does not grow. Nodes that remain keep their source
    positions. A term without a value (1/0) no longer raises an error if it is removed.
    """
    return _Simplifier(flag(cut, "simplify's cut")).of(formula_of(phi, "simplify's formula")).formula


@dataclass(slots=True, eq=False)
class _Reduced:
    """A simplified formula and what the rules need to know about it.

    key        equal keys imply equivalent formulas (up to the order of operands, and x > 0 for 0 < x)
    operands   the parts under its operator
    operators  their number
    growth     operators of its negation minus its own: at most 1, since ¬ can be prefixed
    crisp      whether it has no comparison: its robustness is always infinite
    negation   its negation, once computed
    """

    key: int
    formula: Formula
    operands: tuple[_Reduced, ...]
    operators: int
    growth: int
    crisp: bool
    negation: _Reduced | None = None


class _Simplifier:
    """Builds simplified parts from simplified parts, inside out; no rule applies to what a method returns."""

    def __init__(self, cut: bool) -> None:
        self.cut = cut
        self._keys: dict[tuple[object, ...], int] = {}

    def of(self, phi: Formula) -> _Reduced:
        match phi:
            case Constant(value):
                return self.constant(value, phi.span)
            case Label(name):
                return self._part(phi, ("label", name), (), growth=1, crisp=True)
            case Comparison():
                return self.comparison(phi)
            case Not(arg):
                return self.negate(self.of(arg), phi.span)
            case And(args):
                return self.junction(And, [self.of(arg) for arg in args], phi.span)
            case Or(args):
                return self.junction(Or, [self.of(arg) for arg in args], phi.span)
            case Implies(left, right):
                return self.implies(self.of(left), self.of(right), phi.span)
            case Iff(left, right):
                return self.iff(self.of(left), self.of(right), phi.span)
            case Eventually(interval, arg) | Always(interval, arg) | Once(interval, arg) | Historically(interval, arg):
                return self.window(type(phi), interval, self.of(arg), phi.span)
            case (
                Until(interval, left, right)
                | Release(interval, left, right)
                | Since(interval, left, right)
                | Trigger(interval, left, right)
            ):
                return self.until(type(phi), interval, self.of(left), self.of(right), phi.span)
            case Rise(arg):
                return self.rise(self.of(arg), phi.span)
            case _:
                assert_never(phi)

    def _part(
        self, phi: Formula, key: tuple[object, ...], operands: Sequence[_Reduced], growth: int, crisp: bool = False
    ) -> _Reduced:
        return _Reduced(
            key=self._keys.setdefault(key, len(self._keys)),
            formula=phi,
            operands=tuple(operands),
            operators=_own_operators(phi) + sum(part.operators for part in operands),
            growth=min(growth, 1),
            crisp=all(part.crisp for part in operands) if operands else crisp,
        )

    def constant(self, value: bool, span: Span | None) -> _Reduced:
        return self._part(Constant(value, span=span), ("constant", value), (), growth=0, crisp=True)

    def comparison(self, phi: Comparison) -> _Reduced:
        op, left, right = phi.op, phi.left, phi.right
        if op in (">", ">="):
            op, left, right = MIRROR[op], right, left
        return self._part(phi, (op, left, right), (), growth=1 if delay(phi) else 0)

    # ------------------------------------------------------------------------------------------ Boolean operators

    def negate(self, x: _Reduced, span: Span | None = None) -> _Reduced:
        """¬x, moved inwards if that makes it smaller."""
        if x.negation is None or x.negation.operators > x.operators + x.growth:
            negation = self._negation(x, span if span is not None else x.formula.span)
            x.negation = negation
            if negation.negation is None:
                negation.negation = x
        return x.negation

    def _negation(self, x: _Reduced, span: Span | None) -> _Reduced:
        phi, operands = x.formula, x.operands
        match phi:
            case Constant(value):
                return self.constant(not value, phi.span)
            case Comparison(op, left, right) if not delay(phi):
                return self.comparison(Comparison(OPPOSITE[op], left, right, span=phi.span))
            case Not():
                return operands[0]
            case _ if x.growth == 1:
                return self._part(Not(phi, span=span), ("not", x.key), (x,), growth=-1)
            case And():
                return self.junction(Or, [self.negate(part) for part in operands], phi.span)
            case Or():
                return self.junction(And, [self.negate(part) for part in operands], phi.span)
            case Implies():
                return self.junction(And, [operands[0], self.negate(operands[1])], phi.span)
            case Iff():
                if operands[0].growth <= operands[1].growth:
                    return self.iff(self.negate(operands[0]), operands[1], phi.span)
                return self.iff(operands[0], self.negate(operands[1]), phi.span)
            case Eventually(interval, _) | Always(interval, _) | Once(interval, _) | Historically(interval, _):
                return self.window(_DUAL_WINDOW[type(phi)], interval, self.negate(operands[0]), phi.span)
            case Until(interval, _, _) | Release(interval, _, _) | Since(interval, _, _) | Trigger(interval, _, _):
                p, q = map(self.negate, operands)
                return self.until(_DUAL_JOIN[type(phi)], interval, p, q, phi.span)
            case Label() | Comparison() | Rise():
                raise AssertionError("its negation is larger")
            case _:
                assert_never(phi)

    def implies(self, left: _Reduced, right: _Reduced, span: Span | None) -> _Reduced:
        if isinstance(left.formula, Constant):
            return right if left.formula.value else self.constant(True, span)
        if isinstance(right.formula, Constant):
            return right if right.formula.value else self.negate(left)
        if left.growth < 0:
            return self.junction(Or, [self.negate(left), right], span)
        if left.key == right.key and left.crisp:
            return self.constant(True, span)
        growth = right.growth  # ¬(φ → ψ) = φ ∧ ¬ψ
        return self._part(
            Implies(left.formula, right.formula, span=span), ("->", left.key, right.key), (left, right), growth
        )

    def iff(self, left: _Reduced, right: _Reduced, span: Span | None) -> _Reduced:
        for one, other in ((left, right), (right, left)):
            if isinstance(one.formula, Constant):
                return other if one.formula.value else self.negate(other)
        if left.crisp and right.crisp:
            if left.key == right.key:
                return self.constant(True, span)
            if self.negate(left).key == right.key:
                return self.constant(False, span)
        if left.growth + right.growth < 0:
            return self.iff(self.negate(left), self.negate(right), span)
        key = ("<->", *sorted((left.key, right.key)))
        growth = min(left.growth, right.growth)
        return self._part(Iff(left.formula, right.formula, span=span), key, (left, right), growth)

    def junction(self, kind: _Junction, parts: Iterable[_Reduced], span: Span | None) -> _Reduced:
        """And or Or of any number of parts."""
        neutral = kind is And
        rest = list(parts)
        while True:
            flat: dict[int, _Reduced] = {}
            for part in rest:
                for piece in part.operands if isinstance(part.formula, kind) else (part,):
                    if isinstance(piece.formula, Constant):
                        if piece.formula.value != neutral:
                            return piece
                    else:
                        flat.setdefault(piece.key, piece)
            rest = self._joined(kind, flat)
            if len(rest) == len(flat):
                break
        if any(part.crisp and self.negate(part).key in flat for part in rest):
            return self.constant(not neutral, span)
        dual = Or if kind is And else And
        rest = [p for p in rest if not (isinstance(p.formula, dual) and any(q.key in flat for q in p.operands))]
        if len(rest) < 2:
            return rest[0] if rest else self.constant(neutral, span)
        key = (kind, *sorted(part.key for part in rest))
        growth = sum(part.growth for part in rest)
        return self._part(kind(tuple([part.formula for part in rest]), span=span), key, rest, growth)

    # ------------------------------------------------------------------------------------------ windows

    def window(self, kind: _Window, interval: Interval, x: _Reduced, span: Span | None) -> _Reduced:
        """F, G, once or historically of a part."""
        phi = x.formula
        a, b = interval.a, interval.b
        if isinstance(phi, Constant) and (phi.value != (kind in _SOME) or a == 0 or not self._cut(kind)):
            return x  # an empty window, possible only with a cut, is false for F and once, true for G and historically
        if b == 0:
            return x
        if isinstance(phi, _FUTURE if kind in _AHEAD else _PAST) and self._adds_up(kind, interval, phi):
            inner = phi.interval
            kind = kind if isinstance(phi, kind) or self._is_step(inner, kind) else type(phi)
            b = None if b is None or inner.b is None else b + inner.b
            return self.window(kind, Interval(a + inner.a, b), x.operands[0], span)
        if self._is_step(interval, kind):
            kind = Eventually  # F[k,k] and G[k,k] are the same: one is used
        return self._part(kind(interval, phi, span=span), (kind, a, b, x.key), (x,), x.growth)

    def _adds_up(self, kind: _Window, outer: Interval, phi: _WindowNode) -> bool:
        return isinstance(phi, kind) or self._is_step(outer, kind) or self._is_step(phi.interval, kind)

    def _cut(self, kind: _Window | _Join) -> bool:
        """Whether windows of this kind may be cut: those of the past always are, at step 0."""
        return self.cut or kind not in _AHEAD

    def _is_step(self, interval: Interval, kind: _Window) -> bool:
        """Whether "some" and "every" agree on it: one step that certainly exists."""
        return interval.a == interval.b and not self._cut(kind)

    def until(self, kind: _Join, interval: Interval, left: _Reduced, right: _Reduced, span: Span | None) -> _Reduced:
        """Until or since of two parts; or release or trigger, to which the dual rules apply."""
        a, b = interval.a, interval.b
        top = kind in _SOME  # what true is to until, false is to release
        some, every = _FUTURE if kind in _AHEAD else _PAST
        if not top:
            some, every = every, some
        if b == 0 or (isinstance(right.formula, Constant) and (a == 0 or right.formula.value != top)):
            return right
        if isinstance(left.formula, Constant):
            if left.formula.value == top:
                return self.window(some, interval, right, span)
            return right if a == 0 else left
        if isinstance(right.formula, Constant) and not self._cut(kind):  # true, satisfied at step a at the earliest
            return self.window(every, Interval(0, a - 1), left, span)
        if left.key == right.key and (a == 0 or not self._cut(kind)):
            return self.window(every, Interval(0, a), left, span)
        return self._part(
            kind(interval, left.formula, right.formula, span=span),
            (kind, a, b, left.key, right.key),
            (left, right),
            growth=left.growth + right.growth,  # of the dual of the negated parts
        )

    def rise(self, x: _Reduced, span: Span | None) -> _Reduced:
        if isinstance(x.formula, Constant) and not x.formula.value:
            return x
        return self._part(Rise(x.formula, span=span), ("rise", x.key), (x,), growth=1)

    def _joined(self, kind: _Junction, flat: dict[int, _Reduced]) -> list[_Reduced]:
        """The operands of an And (an Or) with windows joined, those of the future and those of the past."""
        for every in (Always, Historically):
            flat = {part.key: part for part in self._joined_windows(kind, flat, every)}
        return list(flat.values())

    def _joined_windows(self, kind: _Junction, flat: dict[int, _Reduced], every: _Window) -> list[_Reduced]:
        """The operands of an And (an Or) with windows of `every` (Always or Historically) and its dual joined.

        Under And: G windows over the same operand are joined if they touch, F windows over the same operand are removed
        if another operand implies them, and G of equal windows are joined; under Or dually. An operand without a
        temporal operator counts as its own window [0,0].
        """
        own: _Window = every if kind is And else _DUAL_WINDOW[every]
        windows = (own, _DUAL_WINDOW[own])
        groups: dict[int, list[_Reduced]] = {}
        for part in flat.values():
            if isinstance(part.formula, windows):
                groups.setdefault(part.operands[0].key, []).append(part)
        rest = dict(flat)  # key → what now replaces that operand
        for operand, parts in groups.items():
            if operand in flat:
                parts.insert(0, flat[operand])
            parts = [part for part in parts if rest.get(part.key) is part]
            if len(parts) > 1:
                self._join_windows(own, operand, parts, rest)
        equal: dict[Interval, list[_Reduced]] = {}
        for key, part in rest.items():
            if key == part.key and isinstance(part.formula, windows) and self._is_own(own, part.formula):
                equal.setdefault(part.formula.interval, []).append(part)
        for interval, parts in equal.items():
            if len(parts) > 1:
                span = parts[0].formula.span
                inner = self.junction(kind, [part.operands[0] for part in parts], span)
                _replace(rest, parts, self.window(own, interval, inner, span))
        return list(rest.values())

    def _is_own(self, own: _Window, phi: _WindowNode) -> bool:
        return isinstance(phi, own) or self._is_step(phi.interval, own)

    def _join_windows(self, own: _Window, operand: int, parts: list[_Reduced], rest: dict[int, _Reduced]) -> None:
        """Join the windows over one operand, updating `rest`."""
        runs: list[tuple[int, float, list[_Reduced]]] = []  # windows of kind `own`, joined where they touch
        others: list[tuple[int, float, _Reduced]] = []
        for a, b, part in sorted(((*_ends(part, operand), part) for part in parts), key=lambda window: window[:2]):
            phi = part.formula
            if part.key != operand and isinstance(phi, _WindowNode) and not self._is_own(own, phi):
                others.append((a, b, part))
            elif runs and a <= runs[-1][1] + 1:
                start, end, joined = runs[-1]
                joined.append(part)
                runs[-1] = (start, max(end, b), joined)
            else:
                runs.append((a, b, [part]))
        inside: float | None = None  # the earliest end among those that start later
        for a, b, part in sorted(others, key=lambda window: (-window[0], window[1])):  # contained windows come first
            before = bisect.bisect_right(runs, b, key=lambda run: run[0]) - 1
            meets = before >= 0 and runs[before][1] >= a
            if self._cut(own):  # a G implies an F only through an existing step, and only step 0 is sure to exist
                meets = meets and a == 0 == runs[0][0]
            if meets or (inside is not None and inside <= b):
                del rest[part.key]
            inside = b if inside is None else min(inside, b)
        for start, end, joined in runs:
            if len(joined) > 1:
                x = joined[0] if joined[0].key == operand else joined[0].operands[0]
                interval = Interval(start, None if end == math.inf else int(end))
                _replace(rest, joined, self.window(own, interval, x, joined[0].formula.span))


def _ends(part: _Reduced, operand: int) -> tuple[int, float]:
    """The first and the last step of a window; [0,0] for the operand itself."""
    phi = part.formula
    if part.key == operand or not isinstance(phi, _WindowNode):
        return 0, 0
    return phi.interval.a, math.inf if phi.interval.b is None else phi.interval.b


def _replace(rest: dict[int, _Reduced], parts: Sequence[_Reduced], new: _Reduced) -> None:
    """Replace the first of `parts` by `new` and remove the others."""
    rest[parts[0].key] = new
    for part in parts[1:]:
        del rest[part.key]
