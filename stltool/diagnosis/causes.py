"""A minimal set of samples that force a verdict: with them fixed, all others may change freely.

A set of samples (signal, step) is a *cause* if every trace that agrees on it has the verdict. Supersets of causes are
causes, so a cause is minimal if no single sample can be left out. The one given is the least in colexicographic order:
samples are left out from the latest step backwards (within a step from the last name backwards), so its latest sample
is as early as in any cause.

    Kleene     leave out the longest block before the last kept sample that can go, found by doubling and bisection; a
               set is a cause if Kleene's evaluation decides the formula on it. Samples on a path on which every
               alternative is needed (`Sheet.critical`) are kept without a test
    automaton  one sweep backwards. good_s is the set of automaton states from which every continuation that agrees with
               the samples kept at steps s, s + 1, … gets the verdict; the sample can go if δ(λ, q_s) is in good_{s+1}
               for every letter λ that agrees with what is kept at step s, q_s being the state that the trace reaches.
               Where the last sample is held, good is found for each letter that goes on from there

Kleene's test is exact for formulas that are `one_sided`; for others the automaton's is, if it is small enough. Where
neither is, Kleene's cause is still minimal if for each of its samples there is a trace that agrees on all others and
has the other verdict; such traces are sought among a few (`each_is_needed`).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import FALSE, TRUE, UNDECIDED
from stltool.automata.compile import compile_automaton
from stltool.diagnosis.knowledge import Agreeing, Knowledge, Known, one_sided
from stltool.diagnosis.sheet import Sheet
from stltool.errors import FragmentError, SizeError
from stltool.logic.feasible import feasible_valuations, leaves, realised, tabulated
from stltool.logic.formula import Eventually, Formula, Interval, atoms
from stltool.monitoring.kleene import Kleene, skeleton

Progress = Callable[[int, int], None]

_MOST_TRIED = 200_000_000  # values of atoms, of all traces in which a sample is changed
_RANDOM = 8  # of these traces
_MOST_VALUATIONS, _MOST_STATES = 256, 2000  # of the automaton
_QUIET, _OFTEN = 0.5, 0.2  # seconds before the first call of `progress`, and between calls
_PATIENCE = 4  # samples kept one after another by tests, before critical ones are sought


@dataclass(frozen=True, eq=False)
class Cause:
    """The samples of a cause, (steps, signals) bool, and why it may not be minimal; None if it is."""

    kept: Known
    doubt: str | None


def find_cause(known: Knowledge, at: int, truth: bool, fixed: int | None, progress: Progress | None = None) -> Cause:
    """The colex-least cause of the verdict `truth` at step `at` of the block.

    Samples from step `fixed` on are one sample, which is held.
    """
    if not known.names:
        return Cause(np.zeros((known.block.steps, 0), dtype=np.bool_), None)
    doubt = None
    independent = realised(leaves(known.phi))
    if not independent or not one_sided(known.phi):
        why = "a part matters in both directions" if independent else "comparisons share signals"
        try:
            return by_automaton(known, at, truth, fixed)
        except (SizeError, FragmentError) as refusal:
            doubt = f"{why}, and {refusal}"
    kept = by_kleene(known, at, truth, fixed, progress)
    needed = doubt is None or (fixed is None and each_is_needed(known, at, truth, kept))
    return Cause(kept, None if needed else doubt)


# --------------------------------------------------------------------------------------------------------- by Kleene


class _Trial:
    """The samples kept so far, and whether they force the verdict."""

    def __init__(self, known: Knowledge, at: int, truth: bool) -> None:
        self.knowledge, self.at, self.wanted = known, at, 1 if truth else -1
        n = known.block.steps
        self.width = len(known.names)
        self.kept: Known = np.ones((n, self.width), dtype=np.bool_)
        self.values = known.values(self.kept)
        names = {atom.formula: str(i) for i, atom in enumerate(known.atoms)}
        self._machine = Kleene(skeleton(known.phi, names))

    def holds(self) -> bool:
        columns = {str(i): row[None] for i, row in enumerate(self.values)} or {"": np.zeros((1, 1), np.int8)}
        block = self.knowledge.block
        return bool(self._machine.judge(columns, block.steps, block.end)[0, self.at] == self.wanted)

    def without(self, first: int, stop: int) -> bool:
        """Leave out the samples first … stop − 1 of the flat order, if the others still force the verdict."""
        flat = self.kept.reshape(-1)
        a, b = first // self.width, (stop - 1) // self.width + 1
        kept, values = flat[first:stop].copy(), self.values[:, a:b].copy()
        flat[first:stop] = False
        self.kept[a:b, self.knowledge.facts] = True
        self.values[:, a:b] = self.knowledge.values(self.kept[a:b], a)
        if self.holds():
            return True
        flat[first:stop], self.values[:, a:b] = kept, values
        return False

    def without_held(self, first: int, column: int) -> None:
        """Leave out a signal at the steps from `first` on, if the others still force the verdict."""
        if column in self.knowledge.facts:
            return
        values = self.values[:, first:].copy()
        self.kept[first:, column] = False
        self.values[:, first:] = self.knowledge.values(self.kept[first:], first)
        if not self.holds():
            self.kept[first:, column], self.values[:, first:] = True, values

    def critical(self) -> NDArray[np.bool_]:
        """Samples that surely cannot be left out, in the flat order."""
        sheet = Sheet(self.knowledge, self.kept)
        found = np.zeros_like(self.kept)
        for atom, needed in zip(self.knowledge.atoms, sheet.critical(self.at), strict=True):
            steps = np.flatnonzero(needed)
            for column in atom.columns.tolist():
                less = self.kept[steps]
                less[:, column] = False
                for step, row in zip(steps.tolist(), less, strict=True) if atom.partial else ():
                    found[step, column] |= atom.values(row[None], step)[0] == 0
                if not atom.partial:
                    found[steps, column] |= atom.free == 0
        return found.reshape(-1)


def by_kleene(
    known: Knowledge, at: int, truth: bool, fixed: int | None = None, progress: Progress | None = None
) -> Known:
    """The least set on which Kleene's evaluation decides; samples from step `fixed` on are one sample.

    That one is as good, or as bad, at every step, so Kleene's evaluation is exact for it where it is for others.
    """
    trial = _Trial(known, at, truth)
    if fixed is not None:
        for column in reversed(range(trial.width)):
            trial.without_held(fixed, column)
    total = end = trial.kept.size if fixed is None else fixed * trial.width
    critical = np.zeros(trial.kept.size, dtype=np.bool_)
    tested, patience = 0, _PATIENCE
    told = time.monotonic() + _QUIET
    while end > 0:
        if progress is not None and time.monotonic() > told:
            progress(total - end, total)
            told = time.monotonic() + _OFTEN
        others = np.flatnonzero(~critical[:end])
        end = int(others[-1]) + 1 if len(others) else 0  # what is critical is kept
        gone = _longest(trial, end)
        end -= gone
        tested += end > 0
        end -= end > 0  # the next one is needed
        if tested >= patience:
            before = int(critical.sum())
            critical = trial.critical()
            patience = _PATIENCE if critical[:end].sum() > before else 2 * patience
            tested = 0
    return trial.kept


def _longest(trial: _Trial, end: int) -> int:
    """Leave out the longest block of samples that ends at `end`; its length."""
    gone, step = 0, 1
    while gone < end:
        step = min(step, end - gone)
        if not trial.without(end - gone - step, end - gone):
            break
        gone += step
        step *= 2
    else:
        return gone
    low, high = 0, step  # of the next `step`, `low` have gone, `high` cannot
    while high - low > 1:
        middle = (low + high) // 2
        if trial.without(end - gone - middle, end - gone - low):
            low = middle
        else:
            high = middle
    return gone + low


# ------------------------------------------------------------------------------------------------------ by automaton


def by_automaton(known: Knowledge, at: int, truth: bool, fixed: int | None = None) -> Cause:
    """The least cause; SizeError with the reason if there is no automaton for it, or none small enough.

    Samples from step `fixed` on are one sample.
    """
    n = known.block.steps if fixed is None else fixed + 1
    held = known.block.end == "hold" or fixed is not None
    if known.block.end == "cut" or (held and known.facts):
        raise SizeError("the automaton judges whole windows only")
    phi = Eventually(Interval(at, at), known.phi) if at else known.phi
    read = leaves(phi)
    rows, complete = feasible_valuations(read, _MOST_VALUATIONS)
    if not complete:
        raise SizeError(f"its labels and comparisons have more than {_MOST_VALUATIONS} truth assignments")
    table = tabulated(atoms(phi), read, rows)
    try:
        automaton = compile_automaton(phi, valuations=np.unique(table, axis=0), most_states=_MOST_STATES)
    except SizeError:
        raise SizeError(f"its automaton has more than {_MOST_STATES} states") from None
    letters = _Letters(known, read, rows, automaton.letters_at(table))
    if not letters.total:
        raise SizeError("a comparison has no value at some step")
    wanted = TRUE if truth else FALSE

    q, states, settled = automaton.initial, [], n
    for step in range(n):  # the states that the trace reaches, up to the first decided verdict
        states.append(q)
        q = int(automaton.delta[letters.of(step, letters.all)[0], q])
        if automaton.verdicts(min(step, automaton.horizon))[q] != UNDECIDED:
            settled = step
            break

    good = np.ones((automaton.n_letters, automaton.n_states), dtype=np.bool_)  # by the letter that led there
    every = np.arange(automaton.n_letters)[:, None]
    kept = np.zeros((known.block.steps, len(known.names)), dtype=np.bool_)
    facts = sum(1 << column for column in known.facts)
    for step in reversed(range(automaton.horizon + 1 if held else n)):
        verdicts = automaton.verdicts(min(step, automaton.horizon))
        good = np.where(verdicts == UNDECIDED, good, verdicts == wanted)
        if step >= n:  # the letter of the last sample goes on
            good = good[every, automaton.delta]
            continue
        mask = facts if step > settled else letters.all
        for column in reversed(range(len(known.names)) if step <= settled else ()):
            less = mask & ~(1 << column)
            allowed = letters.of(step, less)
            if column not in known.facts and good[allowed, automaton.delta[allowed, states[step]]].all():
                mask = less
        kept[step] = [mask >> column & 1 for column in range(len(known.names))]
        allowed = letters.of(step, mask)
        before = good[allowed[:, None], automaton.delta[allowed]].all(axis=0)
        good = np.broadcast_to(before, good.shape)
    kept[n:] = kept[n - 1]
    return Cause(kept, letters.doubt)


class _Letters:
    """The letters at each step that agree with the signals known there, a bit for each; of valuations, in order."""

    def __init__(
        self, known: Knowledge, read: tuple[Formula, ...], rows: NDArray[np.bool_], letter: NDArray[np.integer[Any]]
    ) -> None:
        self.all = (1 << len(known.names)) - 1
        self._letter, self._agreeing = letter, Agreeing(read, rows, known.names, known.block)
        self.total = bool(self._agreeing.along.all())
        self._known: dict[bytes, NDArray[np.integer[Any]]] = {}

    @property
    def doubt(self) -> str | None:
        """Why some of the letters found so far might not occur."""
        return self._agreeing.doubt

    def of(self, step: int, mask: int) -> NDArray[np.integer[Any]]:
        agree = self._agreeing(step, mask)
        key = agree.tobytes()
        if key not in self._known:
            self._known[key] = np.unique(self._letter[agree])
        return self._known[key]


# -------------------------------------------------------------------------------------------------- one by one


def each_is_needed(known: Knowledge, at: int, truth: bool, kept: Known) -> bool:
    """Whether for each kept sample some trace agrees on all others and has the other verdict. False: none was found.

    At a step, the atoms take the values of one of the truth assignments that can occur there. Tried are traces that
    everywhere come as near as possible to one assignment, the given trace, and random ones, each with every assignment
    at the step of the sample.
    """
    read = leaves(known.phi)
    rows, complete = feasible_valuations(read, _MOST_VALUATIONS)
    if not complete:
        return False
    letters = _Letters(known, read, rows, np.arange(len(rows)))
    psis = [atom.formula for atom in known.atoms]
    signed = np.where(tabulated(psis, read, rows), np.int8(1), np.int8(-1))
    n, bits = known.block.steps, 1 << np.arange(len(known.names))
    masks = (kept @ bits).tolist()
    samples = [place for place in np.argwhere(kept).tolist() if place[1] not in known.facts]
    if not letters.total or len(samples) * n * len(rows) * (len(rows) + _RANDOM + 1) > _MOST_TRIED:
        return False
    rng = np.random.default_rng(0)
    apart = (rows[:, None] != rows[None]).sum(axis=2)
    chosen = np.empty((len(rows) + _RANDOM + 1, n), dtype=np.int64)  # of each trace, at each step, the assignment
    for step, mask in enumerate(masks):
        allowed = letters.of(step, mask)
        chosen[: len(rows), step] = allowed[apart[:, allowed].argmin(axis=1)]
        chosen[len(rows) : -1, step] = rng.choice(allowed, _RANDOM)
        chosen[-1, step] = letters.of(step, letters.all)[0]
    machine = Kleene(skeleton(known.phi, {psi: str(i) for i, psi in enumerate(psis)}))
    for step, column in samples:
        allowed = letters.of(step, masks[step] & ~(1 << column))
        traces = np.repeat(chosen, len(allowed), axis=0)
        traces[:, step] = np.tile(allowed, len(chosen))
        columns = {str(i): signed[:, i][traces] for i in range(len(psis))}
        if not (machine.judge(columns, n, known.block.end)[:, at] == (-1 if truth else 1)).any():
            return False
    return letters.doubt is None
