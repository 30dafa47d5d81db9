"""Tasks that tolerate a shift in time: "the time robustness of φ is at least k", as a formula, in its two readings.

**"predicates"**: the right time robustness θ of [Donze10], by min and max over the formula (`time_robustness` of
semantics.py), where a predicate's is the number of steps for which it keeps its truth, with the sign of its truth. For
k ≥ 1, θ(φ) ≥ k asks every predicate, wherever it is read, to be as it should for k more steps:

    p  ⟶  G[0,k] p   under an even number of negations,        p  ⟶  F[0,k] p   under an odd one,

since ¬F[0,k] p = G[0,k] ¬p. Every predicate may then be late by up to k steps, each reading of it by its own number.

**"task"**: the whole task holds from each of the steps 0 … k on, G[0,k] φ: all of the run is late by the same number.

Without operators of the past, the first implies the second. Shifted to the left, both are the same formulas, judged k
steps earlier.
"""

from __future__ import annotations

from typing import Literal, TypeAlias, get_args

from stltool.arguments import one_of, whole
from stltool.logic.formula import Always, Comparison, Eventually, Formula, Interval, Label, formula_of
from stltool.logic.polarity import with_predicates
from stltool.logic.task import Task

Reading: TypeAlias = Literal["predicates", "task"]
READINGS: tuple[Reading, ...] = get_args(Reading)


def time_shifted(phi: Formula | Task, steps: int, reading: Reading = "predicates") -> Formula:
    """φ with time robustness of at least so many steps; φ itself for 0.

    reading  "predicates": every predicate keeps its truth for as many steps, wherever it is read; "task": φ holds from
             each of the next `steps` steps on, too
    """
    formula = formula_of(phi, "time_shifted's formula")
    steps = whole(steps, "time_shifted's steps", least=0)
    one_of(reading, "reading", READINGS)
    if steps == 0:
        return formula
    window = Interval(0, steps)
    if reading == "task":
        return Always(window, formula)

    def lasting(psi: Comparison | Label, positive: bool) -> Formula:
        return Always(window, psi, span=psi.span) if positive else Eventually(window, psi, span=psi.span)

    return with_predicates(formula, lasting)
