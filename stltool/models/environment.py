"""The environment that a learner is given: it can only be reset and stepped.

A learner never looks at the probabilities it is to learn. If the environment simulates a model, `tables` lets whole
episodes run compiled (kernels/learning.py). They are bit for bit the same as episodes stepped one by one, which a test
checks, so the tables reveal nothing that `reset` and `step` would not.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described
from stltool.errors import ArgumentError, ModelError
from stltool.kernels.tuples import Tables
from stltool.models.mdp import MDP


class Resettable(Protocol):
    """Any black box over the model's states: `Environment`, or an object of the user's in its place."""

    def reset(self) -> int: ...
    def step(self, action: int, /) -> int: ...


def require_environment(environment: object, what: str) -> None:
    """ArgumentError unless `environment` has reset and step, or is None."""
    if environment is not None and not all(callable(getattr(environment, name, None)) for name in ("reset", "step")):
        raise ArgumentError(
            f"{what} is {described(environment)}, which has no reset() and step(i); give an object with both, which "
            "return the index of a state"
        )


@dataclass(frozen=True, slots=True)
class Environment:
    """`reset()` → first state; `step(i)` → next state after the i-th available action of the current one.

    generator  the source of all its random numbers, and its only state between episodes; None if there is other state:
               a run can then not be resumed
    tables     the model that it simulates, one number of `generator` per reset and per step; None: a black box
    """

    reset: Callable[[], int]
    step: Callable[[int], int]
    generator: np.random.Generator | None = None
    tables: Tables | None = None


def cumulated(model: MDP) -> NDArray[np.float64]:
    """(n_transitions,): cumulative probabilities within each row; the last entry of a row is its total.

    Summed row by row, not as differences of one long sum, which would lose small probabilities in large models.
    """
    sums = model.probability.copy()
    length = np.diff(model.row_start)
    longest_first = np.argsort(-length, kind="stable")
    start, shorter = model.row_start[:-1][longest_first], -length[longest_first]
    for k in range(1, -int(shorter[0])):
        entry = start[: np.searchsorted(shorter, -k)] + k
        sums[entry] += sums[entry - 1]
    return sums


def simulator(model: MDP, rng: np.random.Generator, steps: int | None = None) -> Environment:
    """An environment that samples the model's transitions; for a black box, its own environment, checked.

    steps   length of an episode, if known: an environment whose episodes are known to be shorter is refused at once
    """
    return sampler(model, steps)(rng)


def sampler(model: MDP, steps: int | None = None) -> Callable[[np.random.Generator], Environment]:
    """A function from generators to simulators of one model, which share its tables."""
    blackbox = model.blackbox
    if blackbox is not None:
        return lambda rng: _guarded(model, blackbox(rng, steps))
    model.require_points()
    tables = Tables(model.choice_start, model.row_start, model.target, cumulated(model), np.cumsum(model.initial))
    choice_start, row_start, target = model.choice_start.tolist(), model.row_start.tolist(), model.target
    sums, first = tables.sums, tables.first

    def simulate(rng: np.random.Generator) -> Environment:
        state = -1

        def reset() -> int:
            nonlocal state
            state = min(int(first.searchsorted(rng.random() * first[-1], side="right")), len(first) - 1)
            return state

        def step(action: int) -> int:
            nonlocal state
            choice = choice_start[state] + action
            if not choice_start[state] <= choice < choice_start[state + 1]:
                raise IndexError(f"state {state} has no available action number {action}")
            lo, hi = row_start[choice], row_start[choice + 1]
            row = sums[lo:hi]
            index = int(row.searchsorted(rng.random() * row[-1], side="right"))
            state = int(target[lo + min(index, hi - lo - 1)])
            return state

        return Environment(reset, step, rng, tables)

    return simulate


def _guarded(model: MDP, environment: Resettable) -> Environment:
    """A black box whose answers are checked to be states of the model; it is always stepped, even if it has tables."""

    def reset() -> int:
        return require_state(environment.reset(), "reset()", model.n_states, model.name)

    def step(action: int) -> int:
        return require_state(environment.step(action), f"step({action})", model.n_states, model.name)

    return Environment(reset, step, getattr(environment, "generator", None))


def require_state(answer: object, call: str, n_states: int, name: str) -> int:
    """The answer of an environment as the index of a state; ModelError if it is not one."""
    try:
        s = operator.index(answer)  # type: ignore[arg-type]  # anything but an integer is refused here
    except TypeError:
        s = -1
    if not 0 <= s < n_states:
        raise ModelError(
            f"the environment's {call} returned {described(answer)}, which is not a state of {name}; "
            f"return the index of a state, 0 … {n_states - 1}"
        )
    return s
