"""Joint memory of several tasks, step by step: what is known after step t until every task is decided.

    layer t:  (q₁ … q_N) after reading s_t, where q_i = • from the step at which task i was decided
    δ_t(λ, (q₁ … q_N)) = (q₁' … q_N'),   q_i' = δ_i(λ, q_i), or • if verdict_{t+1}(q_i') is decided

A verdict depends on the step, and an automaton forgets it afterwards, so the step is part of the memory: the layers,
one after another, are the states of one automaton. The verdict itself is reported on the transition into • and need not
be stored: no later reward depends on it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import TRUE, UNDECIDED, TaskAutomaton
from stltool.display import Card, Displayed, counted
from stltool.errors import SizeError
from stltool.sizes import require_memory, require_numbered

DECIDED = -1
_LAYER_BYTES = 1000  # of even the smallest layer
_LARGEST_CODE = 2**62


@dataclass(frozen=True, eq=False)
class Layer:
    """The memory of N tasks at one step.

    states   (n, N) int32, distinct rows: each task's automaton state, DECIDED once the task is decided
    delta    (n_letters, n) int32: the row of the next layer after reading a letter; zeros in the last layer
    holds    (N, n_letters, n) bool: whether reading that letter decides the task as true
    """

    states: NDArray[np.int32]
    delta: NDArray[np.int32]
    holds: NDArray[np.bool_]

    @property
    def decided(self) -> NDArray[np.bool_]:
        """(n,): whether every task is decided."""
        result: NDArray[np.bool_] = (self.states == DECIDED).all(axis=1)
        return result


@dataclass(frozen=True, eq=False, repr=False)
class JointAutomaton(Displayed):
    """The layer before s₀ is read (`start`, one state), and those after steps 0 … h, the longest horizon of the tasks.

    States are numbered from the start, then layer by layer; the state of the last layer has a self-loop.
    """

    automata: tuple[TaskAutomaton, ...]
    start: Layer
    layers: tuple[Layer, ...]

    initial = 0

    def _card(self) -> Card:
        return Card(
            f"JointAutomaton: {counted(self.n_states, 'state')}, {counted(len(self.automata), 'task')}",
            [{"horizon": self.horizon, "encoding": self.encoding}],
        )

    @property
    def horizon(self) -> int:
        return len(self.layers) - 1

    @property
    def encoding(self) -> str:
        return self.automata[0].encoding

    @cached_property
    def offsets(self) -> NDArray[np.int64]:
        """(h + 2,): the number of each layer's first state, and the total number of states."""
        return np.cumsum([1, *(len(layer.states) for layer in self.layers)])

    @property
    def n_states(self) -> int:
        return int(self.offsets[-1])

    @cached_property
    def delta(self) -> NDArray[np.int32]:
        """(n_letters, n_states) int32. Raises SizeError if it would not fit: repeated layers are stored again."""
        n_letters = len(self.start.delta)
        require_memory(
            8 * n_letters * self.n_states,
            f"the table of a joint automaton of {self.n_states} states over {n_letters} letters",
            "shorten the windows",
        )
        into = [*self.offsets[:-1], self.offsets[-2]]
        parts = [layer.delta + first for layer, first in zip((self.start, *self.layers), into, strict=True)]
        return np.concatenate(parts, axis=1).astype(np.int32)

    def describe(self, q: int) -> str:
        """What a state remembers, task by task."""
        if q == self.initial:
            return "at the start"
        t = int(np.searchsorted(self.offsets, q, side="right")) - 1
        states = self.layers[t].states[q - self.offsets[t]].tolist()
        told = ("decided" if i == DECIDED else a.describe(i) for a, i in zip(self.automata, states, strict=True))
        return f"after step {t}: {' | '.join(told)}"

    def digest(self) -> str:
        """A SHA-256 of everything that a policy depends on."""
        sha = hashlib.sha256("|".join(automaton.digest() for automaton in self.automata).encode())
        sha.update(str(self.delta.shape).encode() + self.delta.tobytes())
        return sha.hexdigest()


def join_automata(
    automata: Sequence[TaskAutomaton],
    letters: NDArray[np.int32],
    memory_limit: int | None = None,
    most_states: int | None = None,
) -> JointAutomaton:
    """The joint memory of several automata; `letters` (n_letters, N): each joint letter as each automaton reads it.

    Raises SizeError before a layer is built that would not fit, and for more than `most_states`.
    """
    horizon = max(automaton.horizon for automaton in automata)
    sizes = " × ".join(str(automaton.n_states) for automaton in automata)
    what = f"a joint automaton of {sizes} automaton states over {horizon} steps"
    remedy = "shorten the windows, or trade fewer tasks off"
    require_memory(horizon * _LAYER_BYTES, what, remedy, memory_limit)
    taken, n_states = 0, 1
    states = np.array([[automaton.initial for automaton in automata]], dtype=np.int32)
    changes = {t for automaton in automata for t in automaton.verdict_starts.tolist()}
    layers: list[Layer] = []
    for t in range(horizon + 1):
        if layers and t not in changes and np.array_equal(states, layers[-1].states):
            layers.append(layers[-1])  # repeated until a verdict changes
        else:
            cells = len(letters) * len(states)
            taken += cells * (4 + len(automata)) + _LAYER_BYTES
            require_memory(taken + (40 + 8 * len(automata)) * cells, what, remedy, memory_limit)
            layer, states = _read(automata, letters, states, t)
            layers.append(layer)
        n_states += len(states)
        if most_states is not None and n_states > most_states:
            raise SizeError(f"{what} has more than {most_states} states; {remedy}")
        require_numbered(n_states, f"states of the joint automaton over {t} steps", remedy)
    nowhere = np.zeros((len(letters), len(states)), dtype=np.int32)
    last = Layer(states, nowhere, np.zeros((len(automata), *nowhere.shape), dtype=np.bool_))
    return JointAutomaton(tuple(automata), layers[0], (*layers[1:], last))


def _read(
    automata: Sequence[TaskAutomaton], letters: NDArray[np.int32], states: NDArray[np.int32], t: int
) -> tuple[Layer, NDArray[np.int32]]:
    """The layer with these states, which reads step t, and the states of the next layer."""
    after = np.empty((len(automata), len(letters), len(states)), dtype=np.int32)
    holds = np.empty(after.shape, dtype=np.bool_)
    for i, automaton in enumerate(automata):
        still = states[:, i] != DECIDED
        after[i] = automaton.delta[letters[:, i]][:, np.maximum(states[:, i], 0)]
        verdict = automaton.verdicts(t)[after[i]]
        holds[i] = still & (verdict == TRUE)
        after[i][~still | (verdict != UNDECIDED)] = DECIDED
    columns = after.reshape(len(automata), -1)
    first, number = _distinct(columns, [automaton.n_states + 1 for automaton in automata])
    layer = Layer(states, number.reshape(holds.shape[1:]).astype(np.int32), holds)
    return layer, np.ascontiguousarray(columns[:, first].T)


def _distinct(columns: NDArray[np.int32], sizes: Sequence[int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The first position of each distinct column (N,) of automaton states, and the distinct column of each column.

    In lexicographic order, the last automaton first. Column codes are integers below the product of `sizes`, or ranks
    among the codes that occur if that product is too large.
    """
    codes, width = np.zeros(columns.shape[1], dtype=np.int64), 1
    for states, size in zip(columns[::-1], sizes[::-1], strict=True):
        if width * size > _LARGEST_CODE:
            known, codes = np.unique(codes, return_inverse=True)
            width = len(known)
        codes = codes * size + (states + 1)
        width *= size
    _, first, number = np.unique(codes, return_index=True, return_inverse=True)
    return first, number
