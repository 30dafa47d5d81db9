"""What a learner is handed: something that only resets and steps.

A learner never looks at the probabilities it is to learn. Where the environment simulates a model, `tables` lets whole
episodes run compiled (kernels/learning.py); they are the same to the bit as episodes stepped one by one, which a test
holds, so nothing is learned from the tables that `reset` and `step` would not have told.
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
    """Any black box with the model's states: what `Environment` is, and what users may hand over instead of it."""

    def reset(self) -> int: ...
    def step(self, action: int, /) -> int: ...


def require_environment(environment: object, what: str) -> None:
    """ArgumentError unless it resets and steps, or is None."""
    if environment is not None and not all(callable(getattr(environment, name, None)) for name in ("reset", "step")):
        raise ArgumentError(
            f"{what} is {described(environment)}, which has no reset() and step(i); give an object with both, which "
            "return the index of a state"
        )


@dataclass(frozen=True, slots=True)
class Environment:
    """`reset()` → first state; `step(i)` → next state after the i-th available action of the current one.

    generator  where all its random numbers come from, and all that it keeps between two episodes; None where that is
               not so, and a run cannot be resumed
    tables     the model that it simulates, one number of `generator` for a reset and one for a step; None: a black box
    """

    reset: Callable[[], int]
    step: Callable[[int], int]
    generator: np.random.Generator | None = None
    tables: Tables | None = None


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


def simulator(model: MDP, rng: np.random.Generator, steps: int | None = None) -> Environment:
    """Sample the model's transitions with the given generator; a black box's own environment, guarded.

    steps   that an episode will have: an environment whose episodes are known to be shorter is refused at once
    """
    return sampler(model, steps)(rng)


def sampler(model: MDP, steps: int | None = None) -> Callable[[np.random.Generator], Environment]:
    """What makes simulators of one model from generators; they share its tables."""
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
    """A black box whose answers are states of the model; it is stepped, whatever tables it may have."""

    def reset() -> int:
        return require_state(environment.reset(), "reset()", model.n_states, model.name)

    def step(action: int) -> int:
        return require_state(environment.step(action), f"step({action})", model.n_states, model.name)

    return Environment(reset, step, getattr(environment, "generator", None))


def require_state(answer: object, call: str, n_states: int, name: str) -> int:
    """What an environment returned, as a state's index; ModelError where it is none."""
    try:
        s = operator.index(answer)  # type: ignore[arg-type]  # what is no whole number is refused here
    except TypeError:
        s = -1
    if not 0 <= s < n_states:
        raise ModelError(
            f"the environment's {call} returned {described(answer)}, which is no state of {name}; "
            f"return a state's index, 0 … {n_states - 1}"
        )
    return s
