"""The exact automaton of any bounded formula: a small machine per part, then their product.

The root (or its negation) is a conjunction of parts (residuals.py splits outer G over ∧ and outer F over ∨):

    G[a,b] φ         a *watch*: φ must hold at every start k in a…b; judged at k + D, D = horizon(φ)
    F[a,b] φ         a watch over ¬φ, whose violation is a success and is remembered
    φ U[a,b] ψ       over atoms: open, fulfilled or broken; the clock of the verdict closes the window
    anything else    a *single* start: the residual itself, its windows counted down

A conjunction is false as soon as one part is, and true if all are, so all that a part needs to remember after its own
horizon is "has succeeded". Every machine is minimised before the product is taken, and so is the product.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import FALSE, UNDECIDED, Remembered, Starts, TaskAutomaton, Text
from stltool.automata.automaton import TRUE as HOLDS
from stltool.automata.machines import BAD, GOOD, Machine, machine_of
from stltool.automata.minimise import coarsest_partition, quotient
from stltool.automata.reach import reachable_pairs
from stltool.automata.residuals import Residual, Residuals
from stltool.automata.rows import distinct_rows
from stltool.errors import SizeError
from stltool.logic.formula import Formula
from stltool.logic.formula import horizon as formula_horizon
from stltool.sizes import memory_limit, require_memory


def window_automaton(
    phi: Formula,
    table: Residuals,
    root: Residual,
    valuations: NDArray[np.bool_],
    most_states: int,
    limit: int | None = None,
    any_step: bool = False,
) -> TaskAutomaton:
    """The automaton of φ, whose residual in `table` is `root`, over the given valuations of `table.atoms`.

    With `any_step`, runs may begin at any step of a trace, and it has `starts`. Raises SizeError if a part or the
    product grows over `most_states`, or the table over `limit` bytes.
    """
    letters = [tuple(row) for row in valuations.tolist()]
    flipped = table.node(root)[0] in ("or", "F")  # judge ¬φ, a conjunction, and invert the verdicts
    judged = table.negation(root) if flipped else root
    node = table.node(judged)
    parts = list(node[1]) if node[0] == "and" else [judged]
    allowed = memory_limit(limit)
    machines = [machine_of(table, part, letters, most_states, allowed, flipped, any_step) for part in parts]
    horizon = formula_horizon(phi)
    deltas, remembered, letter_of = _read_together(machines)
    starts, begins = _starts(machines, remembered, most_states, phi)
    index, delta = _reachable(machines, deltas, begins, most_states, allowed, phi)
    state = _places(index, begins)
    changes = sorted({0, *(t for m in machines for t in (m.first, m.last, m.last + 1) if t < horizon), horizon})
    rows = np.array([_conjunction(machines, index, t, horizon) for t in changes], dtype=np.int8)
    if flipped:
        rows = np.where(rows == UNDECIDED, UNDECIDED, HOLDS + FALSE - rows).astype(np.int8)
    if len(machines) > 1 or _tells_less(rows, machines[0]):
        classes = coarsest_partition(delta, rows)
        delta, representative = quotient(delta, classes)
        index, rows, state = index[:, representative], rows[:, representative], classes[state]
    different = [0] + [i for i in range(1, len(rows)) if (rows[i] != rows[i - 1]).any()]
    before = coarsest_partition(starts, state)
    starts, representative = quotient(starts, before)
    first, merged = distinct_rows(np.concatenate([delta, starts], axis=1))
    return TaskAutomaton(
        formula=phi,
        encoding="exact",
        exact=True,
        atoms=table.atoms,
        valuations=valuations,
        letter_of=merged[letter_of].astype(np.int32),
        delta=np.ascontiguousarray(delta[first]),
        initial=0,
        horizon=horizon,
        verdict_starts=np.array([changes[i] for i in different], dtype=np.int64),
        verdict_rows=np.ascontiguousarray(rows[different]),
        memory=_Memory(machines, index),
        parts=tuple(machine.part for machine in machines),
        starts=Starts(np.ascontiguousarray(starts[first]), state[representative].astype(np.int32))
        if any_step
        else None,
    )


def _read_together(
    machines: Sequence[Machine],
) -> tuple[list[NDArray[np.int32]], list[NDArray[np.int32]], NDArray[np.int64]]:
    """Each machine's delta, and that of its starts, over the letters that some machine distinguishes; and the letter
    of each valuation."""
    small, remembered, reads = [], [], []
    for machine in machines:
        first, equal = distinct_rows(np.concatenate([machine.delta, machine.starts.delta], axis=1))
        small.append(machine.delta[first])
        remembered.append(machine.starts.delta[first])
        reads.append(equal[machine.reads])
    together = np.stack(reads, axis=1)
    first, letter_of = distinct_rows(together)
    rows = [together[first, j] for j in range(len(machines))]
    return (
        [d[r] for d, r in zip(small, rows, strict=True)],
        [d[r] for d, r in zip(remembered, rows, strict=True)],
        letter_of,
    )


def _starts(
    machines: Sequence[Machine], deltas: Sequence[NDArray[np.int32]], most_states: int, phi: Formula
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """What can be remembered when a run begins, as delta, and the machines' states then, (n_machines, n)."""

    def guard(n: int) -> None:
        if n > most_states:
            raise SizeError(f"{phi} can begin in over {most_states} ways, by what is remembered of the past")

    delta, index = deltas[0], [np.arange(deltas[0].shape[1])]
    for other in deltas[1:]:
        known, inner, delta = reachable_pairs(delta, other, [(0, 0)], guard)
        index = [*(states[known] for states in index), inner]
    begins = [machine.starts.state[states] for machine, states in zip(machines, index, strict=True)]
    return delta, np.stack(begins).astype(np.int64)


def _places(index: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.int64]:
    """The columns of `index` that are those of `wanted`."""
    number = {column.tobytes(): i for i, column in enumerate(np.ascontiguousarray(index.T))}
    return np.array([number[column.tobytes()] for column in np.ascontiguousarray(wanted.T)], dtype=np.int64)


def _reachable(
    machines: Sequence[Machine],
    deltas: Sequence[NDArray[np.int32]],
    begins: NDArray[np.int64],
    most_states: int,
    allowed: int,
    phi: Formula,
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """index (n_machines, n_states): the machines' states in each combination that is reachable from those of `begins`
    (n_machines, n); and delta over these.

    Machine by machine: the combinations of the first few are a projection of those of all, hence never more.
    """

    def guard(n_states: int) -> None:
        if n_states > most_states:
            sizes = " × ".join(str(machine.n_states) for machine in machines)
            raise SizeError(
                f"the automaton of {phi} is a product of parts with {sizes} states, of which over {most_states} are "
                "reachable; check the parts one by one, shorten their windows, or raise most_states"
            )
        require_memory(
            16 * n_states * len(delta),
            f"the automaton of {phi}, over {n_states} states and {len(delta)} letters,",
            "shorten the windows, or compile it for a model in which few letters occur",
            allowed,
        )

    # the machine numbered innermost comes last: long counters are traversed once
    order = sorted(range(len(machines)), key=lambda j: (-_breaks(deltas[j]), -j))
    delta = deltas[order[0]]
    guard(delta.shape[1])
    index = [np.arange(delta.shape[1])]
    for i, j in enumerate(order[1:]):
        so_far = _places(np.stack(index), begins[order[: i + 1]])
        pairs = sorted(set(zip(so_far.tolist(), begins[j].tolist(), strict=True)))
        known, inner, delta = reachable_pairs(delta, deltas[j], pairs, guard)
        index = [*(states[known] for states in index), inner]
    return np.stack(index)[np.argsort(order)], delta


def _breaks(delta: NDArray[np.int32]) -> float:
    """How often, per state, a letter leads neighbouring states neither to one state nor to neighbours.

    The machine with the fewest such breaks is numbered innermost, so that δ consists of long shifts and constants,
    along which backward induction gathers values and shifts sets of states stored as bits.
    """
    steps = np.diff(delta, axis=1)
    breaks = np.count_nonzero((steps != 0) & (steps != 1)) / len(delta)
    return float((1 + breaks) / delta.shape[1])


def _conjunction(machines: Sequence[Machine], index: NDArray[np.int64], t: int, horizon: int) -> NDArray[np.int8]:
    """The verdict at step t: false if a part has failed, true if all hold."""
    failed = np.zeros(index.shape[1], dtype=np.bool_)
    holding = np.ones(index.shape[1], dtype=np.bool_)
    for machine, states in zip(machines, index, strict=True):
        outcome = machine.outcome[states]
        over = t >= machine.last
        good = outcome == GOOD
        bad = (outcome == BAD) & (machine.first <= t <= machine.last)
        if machine.good_at_end:
            good |= over & ~bad
        else:
            bad |= over & ~good
        failed |= bad
        holding &= good
    verdict = np.where(failed, FALSE, np.where(holding, HOLDS, UNDECIDED)).astype(np.int8)
    assert t < horizon or (verdict != UNDECIDED).all()
    return verdict


def _tells_less(rows: NDArray[np.int8], machine: Machine) -> bool:
    """Whether the verdicts, which follow from a single machine's outcomes, distinguish fewer of its states."""
    _, first = np.unique(machine.outcome, return_index=True)
    return len(distinct_rows(rows[:, first].T)[0]) < len(first)


class _Memory:
    """What the machine of every part remembers."""

    def __init__(self, machines: Sequence[Machine], index: NDArray[np.int64]) -> None:
        self._memories = [machine.memory for machine in machines]
        self._index = index.astype(np.int32)

    def __call__(self, q: int, text: Text = str) -> tuple[Remembered, ...]:
        return tuple(memory(i, text) for memory, i in zip(self._memories, self._index[:, q].tolist(), strict=True))
