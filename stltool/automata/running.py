"""The running automaton: after every letter, whether the formula holds at the step `horizon` steps ago.

It runs for ever, where the other encodings end at the horizon h. A state is what is still open of the last h + 1
starts: class by class, one for each age k = 0 … h,

    c_h(q) = verdict_h(q)        c_k(q) = verdict_k(q) if decided, else the classes c_{k+1}(δ_λ q) for every letter λ

of the states q of the exact automaton, in which each start has an instance of its own. Starts that agree in class have
the same verdict whatever follows, and a class whose successors all have one verdict is that verdict: so two states that
differ are told apart by some continuation, and there are no fewer. Before step 0, the first letter is taken to have
been read for ever: verdicts of starts before step 0 mean nothing, and states that only a beginning would need are
spared.

The state after h + 1 letters has the verdict of step 0: with it, the running automaton is a task automaton like others.

The *safety automaton* is for G Φ: once a start has failed, or must fail, it stays in one state, so all it remembers are
the starts that are open. Those before step 0 have succeeded. It decides against a run whose window fails at any step
from 0 to h, hence Φ itself not exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import FALSE, TRUE, UNDECIDED, Remembered, TaskAutomaton, Text
from stltool.automata.minimise import coarsest_partition, quotient
from stltool.display import counted
from stltool.errors import SizeError
from stltool.sizes import memory_limit, require_memory

_OPEN = 2  # classes from here on are undecided
_MOST_CELLS = 50_000_000  # ages times states of the exact automaton times letters


def running_automaton(
    base: TaskAutomaton, most_states: int, limit: int | None = None, safety: bool = False
) -> TaskAutomaton:
    """The running automaton, or the safety automaton, of the formula of `base`, which is exact and has `starts`.

    Raises SizeError if it grows over `most_states`, or its table over `limit` bytes.
    """
    assert base.starts is not None
    h, phi = base.horizon, base.formula
    encoding = "safety" if safety else "running"
    if (h + 1) * base.delta.size > _MOST_CELLS:
        raise SizeError(
            f"the {encoding} automaton of {phi} follows {h + 1} starts through {base.n_states} states; shorten the "
            "windows"
        )
    start, after, of_age = _classes(base)
    first = start[:-1]  # of the classes of each age, in one numbering
    n_letters = base.n_letters
    entered = of_age[0][base.delta[:, base.starts.state]]  # the class of a start that begins with a letter
    row = np.zeros(h + 2, dtype=np.int32)  # what is remembered, then a class for each age
    if safety:
        row[1:] = first + TRUE
    else:
        row[1] = entered[0, 0]
        for k in range(h):
            row[k + 2] = after[0, row[k + 1]]
    failed = np.concatenate([[0], first + FALSE]).astype(np.int32)
    known: dict[bytes, int] = {row.tobytes(): 0}
    rows, waiting, moves = [row[None]], row[None], []
    allowed = memory_limit(limit)
    while len(waiting):
        memory = waiting[:, 0]
        new = np.empty((n_letters, *waiting.shape), dtype=np.int32)
        new[:, :, 0] = base.starts.delta[:, memory]
        new[:, :, 1] = entered[:, memory]
        new[:, :, 2:] = after[:, waiting[:, 1:-1]]
        flat = new.reshape(-1, new.shape[2])
        if safety:
            before = np.tile((waiting[:, 1:] == failed[1:]).any(axis=1), n_letters)
            flat[before | (flat[:, 1:] == failed[1:]).any(axis=1)] = failed
        numbers, fresh = [], []
        for i, one in enumerate(flat):
            key = one.tobytes()
            number = known.get(key)
            if number is None:
                number = known[key] = len(known)
                fresh.append(i)
            numbers.append(number)
        moves.append(np.array(numbers, dtype=np.int32).reshape(n_letters, -1))
        waiting = flat[fresh]
        rows.append(waiting)
        if len(known) > most_states:
            raise SizeError(
                f"the {encoding} automaton of {phi} grows over {most_states} states: it follows every window of the "
                f"last {h} steps; shorten the windows, or raise most_states"
            )
        require_memory(
            12 * len(known) * len(row),
            f"the {encoding} automaton of {phi}, over {len(known)} states of {len(row)} ages,",
            "shorten the windows",
            allowed,
        )
    table, delta = np.concatenate(rows), np.concatenate(moves, axis=1)
    satisfied = table[:, -1] == first[-1] + TRUE  # of the safety automaton: none has failed
    classes = coarsest_partition(delta, satisfied.astype(np.int8))  # what is remembered may be more than needed
    delta, representative = quotient(delta, classes)
    verdict = np.where(satisfied[representative], TRUE, FALSE).astype(np.int8)
    early = np.where(safety & (verdict == FALSE), FALSE, UNDECIDED).astype(np.int8)
    return replace(
        base,
        encoding=encoding,
        exact=not safety,
        delta=delta,
        initial=int(classes[0]),
        verdict_starts=np.array([0, h] if h else [0], dtype=np.int64),
        verdict_rows=np.array([early, verdict] if h else [verdict], dtype=np.int8),
        memory=_Windows(base, table[representative, 1:] - first, of_age, safety),
        registers=np.empty((0, 0), dtype=np.int32),
        register_names=(),
        starts=None,
    )


def satisfied_in(automaton: TaskAutomaton) -> NDArray[np.bool_]:
    """(n_states,) of a running automaton: whether the formula holds at the step `horizon` steps ago; of a safety
    automaton: whether no start has failed, or must fail."""
    held: NDArray[np.bool_] = automaton.verdicts(automaton.horizon) == TRUE
    return held


def _classes(base: TaskAutomaton) -> tuple[NDArray[np.int64], NDArray[np.int32], list[NDArray[np.int64]]]:
    """The classes of the states at each age, numbered through all ages.

    start  (h + 2,): those of age k are start[k] … start[k+1]−1, of which the first two are FALSE and TRUE
    after  (n_letters, start[-1]): the class one step older; of age h: itself
    of_age (h + 1) arrays (n_states,): the class of each state, counted within its age
    """
    h, n_letters = base.horizon, base.n_letters
    of_age: list[NDArray[np.int64]] = [np.where(base.verdicts(h) == TRUE, TRUE, FALSE).astype(np.int64)]
    moves: list[NDArray[np.int64]] = [np.tile(np.array([FALSE, TRUE]), (n_letters, 1))]
    for k in range(h - 1, -1, -1):
        then = of_age[-1][base.delta]  # (n_letters, n_states)
        verdict = base.verdicts(k).astype(np.int64)
        same = (then == then[0]).all(axis=0) & (then[0] < _OPEN)
        found = np.where(verdict != UNDECIDED, verdict, np.where(same, then[0], UNDECIDED))
        opened = np.flatnonzero(found == UNDECIDED)
        columns, which = np.unique(then[:, opened], axis=1, return_inverse=True)
        found[opened] = _OPEN + which.ravel()
        decided = np.tile(np.array([FALSE, TRUE]), (n_letters, 1))
        moves.append(np.concatenate([decided, columns], axis=1))
        of_age.append(found)
    of_age, moves = of_age[::-1], moves[::-1]
    start = np.cumsum([0] + [table.shape[1] for table in moves])
    older = [*start[1 : h + 1].tolist(), int(start[h])]
    after = np.concatenate([table + begins for table, begins in zip(moves, older, strict=True)], axis=1)
    return start, after.astype(np.int32), of_age


class _Windows:
    """What each start within the horizon still needs, of which the oldest open one is told in words."""

    def __init__(
        self, base: TaskAutomaton, rows: NDArray[np.int64], of_age: Sequence[NDArray[np.int64]], safety: bool
    ) -> None:
        self._memory, self._rows, self._of_age = base.memory, rows.astype(np.int32), of_age
        self._safety = safety

    def __call__(self, q: int, text: Text = str) -> tuple[Remembered, ...]:
        row = self._rows[q]
        if self._safety and row[-1] == FALSE:
            return (Remembered("a window has been violated, or must be", rank=q, status="failed"),)
        verdict = "satisfied" if row[-1] == TRUE else "violated"
        told = [f"the window that began {counted(len(row) - 1, 'step')} ago is {verdict}"]
        failed, opened = np.flatnonzero(row[:-1] == FALSE), np.flatnonzero(row[:-1] >= _OPEN)
        if failed.size:
            since = counted(int(failed[-1]), "step")
            told.append(f"{counted(len(failed), 'later one')}, too, since {since} ago, will be violated")
        if opened.size:
            age = int(opened[-1])
            state = int(np.flatnonzero(self._of_age[age] == row[age])[0])
            kept = ", ".join(one.phrase for one in self._memory(state, text))
            told.append(
                f"{len(opened)} {'is' if len(opened) == 1 else 'are'} open, of which the oldest began "
                f"{counted(age, 'step')} ago: {kept}"
            )
        return (Remembered("; ".join(told), rank=q, status="open" if opened.size else "done"),)
