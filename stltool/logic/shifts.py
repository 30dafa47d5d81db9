"""Comparisons that read several steps: their normal form, and the same formula with a signal for each of them.

    x[t+1] - x > d  =  F[1,1] (x - x[t-1] > d)          x[t-1] > d  =  once[1,1] (x > d)

In normal form a comparison reads its latest sample at the evaluation step, and is false, with robustness −inf, at the
steps before its earliest sample exists. Its negation is therefore not the opposite comparison.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import assert_never

from stltool.logic.formula import (
    And,
    Arithmetic,
    Call,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Interval,
    Label,
    Negate,
    Number,
    Once,
    Term,
    Variable,
    children,
    delay,
    distinct,
    label_names,
    read_by,
    variables,
    with_children,
)


def settled(phi: Comparison) -> Formula:
    """The normal form of a comparison whose variables may read any steps."""
    delays = [variable.delay for variable in read_by(phi)]
    latest = min(delays, default=0)
    if latest == 0:
        return phi
    rest = Comparison(phi.op, moved(phi.left, -latest), moved(phi.right, -latest), span=phi.span)
    window = Interval(abs(latest), abs(latest))
    return (Eventually if latest < 0 else Once)(window, rest, span=phi.span)


def moved(term: Term, steps: int) -> Term:
    """The term as it was some steps before, or will be, if `steps` is negative."""
    return _with_variables(term, lambda variable: replace(variable, delay=variable.delay + steps))


def with_variables(phi: Comparison, new: Callable[[Variable], Term]) -> Comparison:
    """The comparison with other terms for its variables."""
    return Comparison(phi.op, _with_variables(phi.left, new), _with_variables(phi.right, new), span=phi.span)


def _with_variables(term: Term, new: Callable[[Variable], Term]) -> Term:
    match term:
        case Number():
            return term
        case Variable():
            return new(term)
        case Negate(arg):
            return Negate(_with_variables(arg, new), span=term.span)
        case Arithmetic(op, left, right):
            return Arithmetic(op, _with_variables(left, new), _with_variables(right, new), span=term.span)
        case Call(function, args):
            return Call(function, tuple(_with_variables(arg, new) for arg in args), span=term.span)
        case _:
            assert_never(term)


def has_delays(phi: Formula) -> bool:
    """Whether a comparison of the formula reads earlier steps."""
    return any(isinstance(node, Comparison) and delay(node) for node in distinct(phi))


@dataclass(frozen=True, slots=True)
class Delayed:
    """The same formula for what reads one step at a time, and what it reads instead.

    signals   those that hold earlier samples of another one: (signal, steps)
    starts    labels that hold from some step on
    """

    formula: Formula
    signals: Mapping[str, tuple[str, int]]
    starts: Mapping[str, int]

    @property
    def longest(self) -> int:
        """The greatest number of steps, 0 if there are none."""
        return max((steps for _, steps in self.signals.values()), default=0)

    def shown(self, phi: Formula) -> Formula:
        """Part of the formula as it is written: x[t-3] for the signal that holds earlier samples of x."""

        def read(variable: Variable) -> Variable:
            name, steps = self.signals.get(variable.name, (variable.name, 0))
            return Variable(name, steps, span=variable.span)

        def of_earlier(node: Formula) -> Comparison | None:
            match node:
                case And((Once(_, Constant(True)), Comparison() as c)) | (Comparison() as c):
                    return c if any(v.name in self.signals for v in read_by(c)) else None
            return None

        def restored(node: Formula) -> Formula:
            c = of_earlier(node)
            assert c is not None
            return with_variables(c, read)

        return replaced(phi, lambda node: of_earlier(node) is not None, restored)


def delayed(phi: Formula, once: bool = False) -> Delayed:
    """φ with a signal for every earlier sample, and once[k,k] true in front of each comparison that needs it to exist.

    Behind F[k,k], samples of up to k steps before exist. With `once`, once[k,k] of a comparison is one that reads the
    samples k steps before, and labels take the place of once[k,k] true: no operator of the past is added. For what does
    not know how these signals arise, they are independent of others.
    """

    def reads_back(node: Formula) -> bool:
        if isinstance(node, Once) and isinstance(node.arg, Comparison):
            own = node.interval.a == node.interval.b and node.interval.a > 0
            return once and own and bool(variables(node.arg))
        return (isinstance(node, Comparison) and delay(node) > 0) or reads_ahead(node)

    if not any(reads_back(node) for node in distinct(phi)):
        return Delayed(phi, {}, {})
    taken = {*variables(phi), *label_names(phi)}
    names: dict[str | tuple[str, int], str] = {}

    def name_of(what: str | tuple[str, int], shown: str) -> str:
        if what not in names:
            while shown in taken:
                shown += "'"
            taken.add(shown)
            names[what] = shown
        return names[what]

    def read(variable: Variable) -> Variable:
        if not variable.delay:
            return variable
        name = name_of((variable.name, variable.delay), f"{variable.name}[t-{variable.delay}]")
        return Variable(name, span=variable.span)

    def guarded(node: Formula) -> Formula:
        if isinstance(node, Eventually):
            assert isinstance(node.arg, Comparison)
            return Eventually(node.interval, with_variables(node.arg, read), span=node.span)
        c, back = (node.arg, node.interval.a) if isinstance(node, Once) else (node, 0)
        assert isinstance(c, Comparison)
        steps = delay(c) + back
        start: Formula = Once(Interval(steps, steps), Constant(True))
        if once:
            start = Label(name_of(f"{steps}", f"step >= {steps}"))
        plain = with_variables(c, lambda variable: read(replace(variable, delay=variable.delay + back)))
        return And((start, plain), span=node.span)

    formula = replaced(phi, reads_back, guarded)
    signals = {name: what for what, name in names.items() if isinstance(what, tuple)}
    return Delayed(formula, signals, {name: int(what) for what, name in names.items() if isinstance(what, str)})


def reads_ahead(phi: Formula) -> bool:
    """Whether this is F[k,k] of a comparison of several steps, all of which exist then."""
    match phi:
        case Eventually(Interval(a, b), Comparison() as c):
            return a == b and 0 < delay(c) <= a
        case _:
            return False


def replaced(phi: Formula, which: Callable[[Formula], bool], new: Callable[[Formula], Formula]) -> Formula:
    """φ with some sub-formulas replaced, outside in; the rest stays the same objects, and shared ones stay shared."""
    known: dict[int, Formula] = {}

    def visit(node: Formula) -> Formula:
        if id(node) not in known:
            known[id(node)] = new(node) if which(node) else below(node)
        return known[id(node)]

    def below(node: Formula) -> Formula:
        before = children(node)
        after = tuple(map(visit, before))
        return node if all(a is b for a, b in zip(before, after, strict=True)) else with_children(node, after)

    return visit(phi)
