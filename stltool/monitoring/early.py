"""Verdicts as soon as every continuation of the trace agrees: which engine an online monitor runs (kernels/streams.py).

**Automaton.** Let E_c(q) be what is certain in state q of the automaton of φ after c + 1 letters:

    E_h = verdict_h        E_c(q) = verdict_c(q) if decided, else v if E_{c+1}(δ(λ,q)) = v for every λ, else open

over the letters λ that can occur, as far as that is known (logic/occurring.py). The first E that is not open is the
earliest possible verdict. δ has no clock, so open starts that are in one state stay together. If, among the pairs
(c, q) that can be reached with nothing decided, E_c(q) is decided from some c = first(q) on, with one outcome, it
suffices to look at the oldest start of each state ("coalesced"). Otherwise every open step has a state of its own
("each"). A start of a formula that looks back begins in the state that says what is remembered (`Starts`), which one
more small automaton keeps track of.

**Structure.** For formulas whose automaton is too large: three-valued truth [Kleene38] of every
sub-formula, with the samples that are still to come unknown. It is exact if every atom (maximal sub-formula without a
temporal operator) occurs in one polarity, and all of them can be at their worst, and at their best, at once: the lower
value is then that of one real continuation. Otherwise a verdict may come late, at the latest when all samples are
there, never wrongly; then, of formulas that do not look back, the steps that it leaves open are searched for
continuations of both verdicts (searched.py).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import FALSE, UNDECIDED, TaskAutomaton
from stltool.automata.compile import compile_running
from stltool.errors import SizeError
from stltool.logic.feasible import feasible_valuations, leaves, tabulated
from stltool.logic.formula import LARGEST_BOUND, Formula, atoms, has_past, horizon, variables
from stltool.logic.occurrences import polarities
from stltool.logic.occurring import occurring, sharing

Ints: TypeAlias = NDArray[np.int64]

MOST_STATES = 5000
LONGEST, MOST_LETTERS = 2000, 64  # horizon and letters of a search
MOST_LEAVES = 12  # the letters are tabulated by the truth of all leaves
_MOST_VALUATIONS = 1024
_MOST_WORK = 20_000_000  # entries of δ looked up in closing the verdicts, at least this many per clock:
_LEAST_WORK = 2000
_MOST_STEPS = 20_000  # steps of δ that are explored, of a formula that looks back: about a second
_MOST_COMPARED = 100_000  # pairs of residuals: about a second
_LONGEST_EACH = 1000  # open steps, each with a state of its own
OPEN, NO, YES = 0, 1, 2


class Early(NamedTuple):
    """How early a monitor decides: `exact` if as soon as every continuation agrees, else perhaps later, never wrongly.

    engine  "automaton", or "structure" for formulas whose automaton is too large; "search" where three-valued truth is
            not exact, so that continuations are sought as well; "network" for formulas that look back without a limit
            and whose automaton is too large: their steps are decided when their samples are there
    why     in words
    """

    engine: Literal["automaton", "structure", "search", "network"]
    exact: bool
    why: str


@dataclass(frozen=True, eq=False)
class Engine:
    """The tables of an engine; those of an automaton are empty for "structure" and "search".

    leaves   the labels and comparisons whose truths form the code of a letter, the first in the lowest bit
    letter   (2^n_leaves,) letters by code                      delta  (n_letters, n_states)
    starts   (n_letters, n) what is remembered when a run begins, 0 at first; begins (n,): the state in which it does
    first    (n_states,) the clock from which a state is decided, as `outcome` (n_states,) says: NO or YES
    closed   (horizon + 1, n_states) E; None if `first` and `outcome` say it all
    atoms    (n_letters, n_atoms) bool, for "search": the truths of the formula's atoms by letter
    """

    early: Early
    leaves: tuple[Formula, ...] = ()
    letter: Ints | None = None
    delta: Ints | None = None
    starts: Ints | None = None
    begins: Ints | None = None
    first: Ints | None = None
    outcome: Ints | None = None
    closed: Ints | None = None
    atoms: NDArray[np.bool_] | None = None


def engine_of(phi: Formula, earlier: Mapping[str, int] = MappingProxyType({})) -> Engine:
    """The engine of a formula with a horizon: its automaton if that is small enough, else its structure.

    `earlier`: the signals that are earlier samples of others, so that perhaps not every sequence of letters can occur,
    and how many steps before.
    """
    read = leaves(phi)
    valuations, complete = feasible_valuations(read, _MOST_VALUATIONS)
    sharp = False
    if complete and not (horizon(phi) == 0 and has_past(phi)):
        valuations, sharp = occurring(read, valuations, earlier)
    truths = tabulated(atoms(phi), read, valuations if complete else valuations[:0])
    why = f"the formula has {len(read)} labels and comparisons, over {MOST_LEAVES}"
    if horizon(phi) == 0 and has_past(phi):
        return Engine(Early("structure", True, "no step depends on a later sample"))
    if horizon(phi) > LARGEST_BOUND:
        why = f"the horizon is over {LARGEST_BOUND:.0e}"
    elif complete and len(read) <= MOST_LEAVES:
        try:
            letters = np.unique(truths, axis=0)
            most = min(MOST_STATES, _MOST_STEPS // len(letters)) if has_past(phi) else MOST_STATES
            automaton = compile_running(phi, letters, most, _MOST_COMPARED)
            engine = _of_automaton(automaton, read, valuations, truths, sharp, earlier)
        except SizeError:
            engine = None
        if engine is not None:
            return engine
        why = "the automaton of the formula is too large"
    if _extremes_meet(phi, earlier):
        return Engine(Early("structure", True, f"{why}; every predicate occurs in one polarity"))
    why += "; a predicate occurs in two polarities, or depends on another"
    if complete and len(read) <= MOST_LEAVES and horizon(phi) <= LONGEST and not has_past(phi):
        letters, which = np.unique(truths, axis=0, return_inverse=True)
        if len(letters) <= MOST_LETTERS:
            letter = _by_code(read, valuations, which.reshape(-1), earlier)
            return Engine(Early("search", sharp, why), read, letter, atoms=letters)
    return Engine(Early("structure", False, why))


def _of_automaton(
    automaton: TaskAutomaton,
    read: tuple[Formula, ...],
    valuations: NDArray[np.bool_],
    truths: NDArray[np.bool_],
    sharp: bool,
    earlier: Mapping[str, int],
) -> Engine | None:
    """The engine of an automaton; None if its verdicts take too long to close."""
    runs = _closed(automaton)
    if runs is None:
        return None
    table = _decided_from(automaton, runs)
    closed = None
    if table is None:
        if automaton.horizon > _LONGEST_EACH:
            return None
        closed = np.concatenate([np.tile(row, (last - first + 1, 1)) for first, last, row in reversed(runs)])
    letter = _by_code(read, valuations, automaton.letters_at(truths), earlier)
    states = f"its automaton has {automaton.n_states} states"
    why = states if sharp else f"{states}; its predicates depend on each other in ways that are not examined"
    first, outcome = table if table is not None else (None, None)
    starts = automaton.starts
    assert starts is not None
    return Engine(
        Early("automaton", sharp, why), read, letter, automaton.delta.astype(np.int64), starts.delta.astype(np.int64),
        starts.state.astype(np.int64), first, outcome, closed,
    )  # fmt: skip


def _by_code(
    read: tuple[Formula, ...],
    valuations: NDArray[np.bool_],
    letters: NDArray[np.integer[Any]],
    earlier: Mapping[str, int],
) -> Ints:
    """The letters of valuations (n, n_leaves) by the code of their leaves.

    At the first steps, leaves that read earlier samples have no truth, and what stands in its place may not occur with
    that of the others. Such a code has the letter of one that occurs, and is the same in all that have one by then.
    """
    codes = valuations @ (1 << np.arange(len(read))) if len(read) else np.zeros(len(valuations), dtype=np.int64)
    found = np.zeros(1 << len(read), dtype=np.int64)
    found[codes] = letters
    begins = np.array([max((earlier.get(name, 0) for name in variables(leaf)), default=0) for leaf in read])
    if begins.any():
        others = np.setdiff1d(np.arange(len(found)), codes)
        rank = np.empty(len(read), dtype=np.int64)
        rank[np.argsort(-begins, kind="stable")] = np.arange(len(read))  # what begins first is in the highest bits

        def ranked(some: Ints) -> Ints:
            number: Ints = ((some[:, None] >> np.arange(len(read)) & 1) << rank).sum(axis=1)
            return number

        nearest = (ranked(others)[:, None] ^ ranked(codes)).argmin(axis=1)
        found[others] = letters[nearest]
    return found


def _closed(automaton: TaskAutomaton) -> list[tuple[int, int, Ints]] | None:
    """E in runs of equal clocks, from the last: (first clock, last clock, (n_states,)). None if there are too many."""
    delta, starts = automaton.delta, automaton.verdict_starts
    c = automaton.horizon
    row = _outcomes(automaton.verdicts(c))
    runs = [(c, c, row)]
    work = 0
    while c > 0:
        c -= 1
        work += max(_LEAST_WORK, delta.size)
        if work > _MOST_WORK:
            return None
        after = row[delta]
        agreed = np.where((after == after[0]).all(axis=0), after[0], OPEN)
        own = _outcomes(automaton.verdicts(c))
        closed = np.where(own != OPEN, own, agreed)
        same = np.array_equal(closed, row)
        if same:  # so it is down to the clock at which the automaton's own verdicts change
            c = int(starts[np.searchsorted(starts, c, side="right") - 1])
            runs[-1] = (c, runs[-1][1], row)
        else:
            runs.append((c, c, closed))
        row = closed
    return runs


def _outcomes(verdicts: NDArray[np.int8]) -> Ints:
    return np.where(verdicts == UNDECIDED, OPEN, np.where(verdicts == FALSE, NO, YES)).astype(np.int64)


def _decided_from(automaton: TaskAutomaton, runs: Sequence[tuple[int, int, Ints]]) -> tuple[Ints, Ints] | None:
    """For each state the clock from which it is decided, and its outcome; None if some state has no such clock.

    Only pairs of clock and state that can be reached with nothing decided before count.
    """
    never = automaton.horizon + 1
    first = np.full(automaton.n_states, never, dtype=np.int64)
    outcome = np.zeros(automaton.n_states, dtype=np.int64)
    last_open = np.full(automaton.n_states, -1, dtype=np.int64)
    before = np.zeros(automaton.n_states, dtype=np.bool_)
    assert automaton.starts is not None
    before[automaton.starts.state] = True
    reached = before
    for start, last, row in reversed(runs):
        c = start
        while c <= last:
            now = np.zeros_like(before)
            now[automaton.delta[:, before]] = True
            stays = c > start and np.array_equal(now, reached)  # so it is to the end of the run
            reached, decided, still = now, now & (row != OPEN), now & (row == OPEN)
            if (outcome[decided & (first < never)] != row[decided & (first < never)]).any():
                return None
            first[decided & (first == never)] = c
            outcome[decided] = row[decided]
            c = last if stays else c
            last_open[still] = c
            before = still
            c += 1
    return None if (first <= last_open).any() else (first, outcome)


def _extremes_meet(phi: Formula, earlier: Collection[str]) -> bool:
    """Whether every atom occurs in one polarity, and all can be at their worst at once, and at their best."""
    signs = polarities(phi)
    psis = tuple(signs)
    return 0 not in signs.values() and all(
        _meet([psis[i] for i in group], [signs[psis[i]] for i in group], earlier) for group in sharing(psis)
    )


def _meet(psis: Sequence[Formula], signs: Sequence[int], earlier: Collection[str]) -> bool:
    """The same for atoms that share signals."""
    read = tuple(dict.fromkeys(leaf for psi in psis for leaf in leaves(psi)))
    valuations, complete = feasible_valuations(read, _MOST_VALUATIONS)
    if not complete:
        return False
    valuations, sharp = occurring(read, valuations, earlier)
    truths, best = tabulated(psis, read, valuations), np.array(signs) > 0
    return sharp and bool((truths == best).all(axis=1).any() and (truths == ~best).all(axis=1).any())
