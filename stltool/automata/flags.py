"""The paper's flag vector [Wang24, eq. 10 and 11], with its misprints corrected (docs/semantics.md §2).

    F[0,τ) ψ:  f ← τ           if ψ holds, else max(f − 1, 0)        χ = (f > 0)
    G[0,τ) ψ:  f ← min(f+1, τ) if ψ holds, else 0                    χ = (f = τ)

from f = 0, reading s₀ first. After step t, χ_i is the truth of φ_i for the window that *ends* at t. With equal windows
τ, φ at start k is g(χ) at t = k + τ − 1: an outer F decides true as soon as it holds, an outer G decides false as soon
as it fails, and at h = T + τ − 2 the remaining runs get the other verdict. With different windows, the χ_i refer to
different starts: this is the paper's approximation, and `exact` is False.
"""

from __future__ import annotations

import math
from decimal import Decimal

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import FALSE, TRUE, UNDECIDED, Part, Remembered, TaskAutomaton, Text
from stltool.errors import FragmentError
from stltool.logic.formula import Formula
from stltool.logic.fragment import Fragment, FragmentPart, check_fragment
from stltool.sizes import require_memory, require_numbered

SCALES = {"published": (-0.5, 0.5), "printed": (-1.9, -0.9), "shifted": (-0.9, 0.1)}
"""The rewards for χ = 0 and χ = 1 under an outer G. Printed is r − 0.9 with r = −e^(−βχ) [Wang24, eq. 12 and Table I],
up to e^(−50); the published runs used χ − 0.5."""


def surrogate_reward(automaton: TaskAutomaton, outer: str, scale: str = "published") -> NDArray[np.float64]:
    """(n_states,): the reward of arriving in each state, 2χ − 1 under an outer F and one of the `SCALES` under an outer
    G, where χ is the truth of the inner formula that its flags show [Wang24, eq. 12 up to e^−50, and Table I]."""
    low, high = (-1.0, 1.0) if outer == "F" else SCALES[scale]
    return np.where(automaton.verdict_rows[-1] == TRUE, high, low)


def flag_states(phi: Formula) -> int | None:
    """The number of flag vectors of a formula; None if it is outside the fragment."""
    try:
        return math.prod(part.tau + 1 for part in check_fragment(phi).parts)
    except FragmentError:
        return None


def flag_automaton(
    phi: Formula, fragment: Fragment, valuations: NDArray[np.bool_], encoding: str, limit: int | None = None
) -> TaskAutomaton:
    """The product of the fragment's flags: Π (τ_i + 1) states.

    It reads `valuations` (n, n_parts) of the parts' predicates. Raises SizeError, before allocating, if the tables
    would not fit.
    """
    taus = [part.tau for part in fragment.parts]
    shape = tuple(tau + 1 for tau in taus)
    n_states = math.prod(shape)
    per_state = 4 * len(valuations) + 4 * len(taus) + 8 * len(taus) + 3
    sizes = " × ".join(str(size) for size in shape)
    require_memory(
        n_states * per_state,
        f"the automaton of {phi}: {sizes} = {Decimal(n_states):.4g} states",
        "shorten the inner windows or coarsen the time step",
        limit,
    )
    require_numbered(n_states, f"flag vectors of {phi}", "shorten the inner windows or coarsen the time step")
    flags = np.indices(shape, dtype=np.int32).reshape(len(taus), n_states)
    delta = np.empty((len(valuations), n_states), dtype=np.int32)
    for letter, valuation in enumerate(valuations):
        after = [
            _update(part.operator, part.tau, bool(holds), flag)
            for part, holds, flag in zip(fragment.parts, valuation, flags, strict=True)
        ]
        delta[letter] = np.ravel_multi_index(after, shape)

    chi = [
        flag > 0 if part.operator == "F" else flag == part.tau for part, flag in zip(fragment.parts, flags, strict=True)
    ]
    holds = _combine(fragment, chi, n_states)
    starts, rows = _verdicts(fragment, holds, max(taus))
    return TaskAutomaton(
        formula=phi,
        encoding=encoding,
        exact=fragment.uniform,
        atoms=tuple(part.psi for part in fragment.parts),
        valuations=valuations,
        letter_of=np.arange(len(valuations), dtype=np.int32),
        delta=delta,
        initial=0,
        horizon=fragment.T + max(taus) - 2,
        verdict_starts=np.array(starts, dtype=np.int64),
        verdict_rows=np.array(rows, dtype=np.int8),
        memory=_Memory(fragment),
        parts=tuple(
            Part(part.formula, part.psi, part.tau - 1, "flag", part.tau + 1, part.tau + 1) for part in fragment.parts
        ),
        registers=np.ascontiguousarray(flags.T),
        register_names=tuple(f"flag of {part}" for part in fragment.parts),
    )


class _Memory:
    """What a flag vector remembers."""

    def __init__(self, fragment: Fragment) -> None:
        self._parts = fragment.parts

    def __call__(self, q: int, text: Text = str) -> tuple[Remembered, ...]:
        found: list[Remembered] = []
        for part in reversed(self._parts):
            q, flag = divmod(q, part.tau + 1)
            found.append(_flag(part, flag, text(part.psi)))
        return tuple(reversed(found))


def _flag(part: FragmentPart, flag: int, psi: str) -> Remembered:
    """A flag counts down for F, from the last time that ψ held, and up for G, while ψ holds."""
    if part.operator == "G":
        phrase = f"{psi} for {flag} step{'s' if flag != 1 else ''}" if flag else f"{psi} does not hold"
        return Remembered(phrase, flag, "done" if flag == part.tau else "open", psi, flag, part.tau)
    ago = part.tau - flag
    if flag == 0:
        phrase = f"{psi} not seen in {part.tau} steps"
    else:
        phrase = f"{psi} seen now" if ago == 0 else f"{psi} seen {ago} step{'s' if ago != 1 else ''} ago"
    return Remembered(phrase, ago, "done" if ago == 0 else "open", psi, ago, part.tau, risk=True)


def _update(operator: str, tau: int, holds: bool, flag: NDArray[np.int32]) -> NDArray[np.int32]:
    if operator == "F":
        return np.full_like(flag, tau) if holds else np.maximum(flag - 1, 0)
    return np.minimum(flag + 1, tau) if holds else np.zeros_like(flag)


def _combine(fragment: Fragment, chi: list[NDArray[np.bool_]], n_states: int) -> NDArray[np.bool_]:
    """g(χ) at every state, from the 2^n rows of its truth table."""
    n = len(chi)
    row = np.zeros(n_states, dtype=np.int64)
    for i, values in enumerate(chi):
        row |= values.astype(np.int64) << i
    table = np.empty(1 << n, dtype=np.bool_)
    for index in np.unique(row):
        table[index] = fragment.combine([bool(index >> i & 1) for i in range(n)])
    return table[row]


def _verdicts(fragment: Fragment, holds: NDArray[np.bool_], tau: int) -> tuple[list[int], list[NDArray[np.int8]]]:
    """Undecided before the first full window, then only one verdict is possible, at the horizon both are."""
    nothing = np.full(len(holds), UNDECIDED, dtype=np.int8)
    if fragment.outer == "F":
        running = np.where(holds, TRUE, UNDECIDED).astype(np.int8)
    else:
        running = np.where(holds, UNDECIDED, FALSE).astype(np.int8)
    final = np.where(holds, TRUE, FALSE).astype(np.int8)
    at = {0: nothing}
    at[tau - 1] = running
    at[fragment.T + tau - 2] = final
    return list(at), list(at.values())
