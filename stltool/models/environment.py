"""What a learner is handed: something that only resets and steps.

The simulator's model and random numbers live in closures; nothing that it is made of can be reached from it, so a
learner cannot look at the probabilities it is to learn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stltool.models.mdp import MDP

_BLOCK = 4096  # random numbers drawn at a time


class Resettable(Protocol):
    """Any black box with the model's states: what `Environment` is, and what users may hand over instead of it."""

    def reset(self) -> int: ...
    def step(self, action: int, /) -> int: ...


@dataclass(frozen=True, slots=True)
class Environment:
    """`reset()` → first state; `step(i)` → next state after the i-th available action of the current one."""

    reset: Callable[[], int]
    step: Callable[[int], int]


def cumulated(model: MDP) -> NDArray[np.float64]:
    """(n_transitions,): the probabilities summed up within each row, a row's last entry its total.

    Row by row, not as differences of one long sum: those would lose small probabilities in large models.
    """
    sums = model.probability.copy()
    length = np.diff(model.row_start)
    longest_first = np.argsort(-length, kind="stable")
    start, shorter = model.row_start[:-1][longest_first], -length[longest_first]
    for k in range(1, -int(shorter[0])):
        entry = start[: np.searchsorted(shorter, -k)] + k
        sums[entry] += sums[entry - 1]
    return sums


def simulator(model: MDP, rng: np.random.Generator) -> Environment:
    """Sample the model's transitions with the given generator."""
    model.require_points()
    sums = cumulated(model)
    first = np.cumsum(model.initial)
    choice_start, row_start = model.choice_start.tolist(), model.row_start.tolist()
    target = model.target
    state = -1
    numbers: list[float] = []

    def uniform() -> float:
        if not numbers:
            numbers.extend(rng.random(_BLOCK).tolist())
        return numbers.pop()

    def reset() -> int:
        nonlocal state
        state = min(int(first.searchsorted(uniform() * first[-1], side="right")), len(first) - 1)
        return state

    def step(action: int) -> int:
        nonlocal state
        choice = choice_start[state] + action
        if not choice_start[state] <= choice < choice_start[state + 1]:
            raise IndexError(f"state {state} has no available action number {action}")
        lo, hi = row_start[choice], row_start[choice + 1]
        row = sums[lo:hi]
        index = int(row.searchsorted(uniform() * row[-1], side="right"))
        state = int(target[lo + min(index, hi - lo - 1)])
        return state

    return Environment(reset, step)
