"""The environment that a learner is given: it can only be reset and stepped.

A learner never looks at the probabilities it is to learn. If the environment simulates a model, `tables` lets whole
episodes run compiled (kernels/learning.py). They are bit for bit the same as episodes stepped one by one, which a test
checks, so the tables reveal nothing that `reset` and `step` would not.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import described, whole
from stltool.errors import ArgumentError, ModelError
from stltool.kernels.tuples import Tables
from stltool.models.mdp import MDP


class Resettable(Protocol):
    """Any black box over the model's states: `Environment`, or an object of the user's in its place."""

    def reset(self) -> int: ...
    def step(self, action: int, /) -> int: ...


class Batched(Protocol):
    """A black box that takes many runs at once, side by side: a vectorised simulator, a fleet of robots.

    batch            an attribute, by which stltool recognises it: the most runs it can take at once, from 1
    reset(n)         forget all runs and begin n new ones, 1 <= n <= batch: their first states (n,)
    step(actions)    (n,) int64, for each run the number of an available action of its state: the states after it (n,)

    States are integers in the model's order. A run that is over gets action -1, and its answer is not read: the
    simulator may leave it where it is, or step it anyhow. Runs must be independent of each other, as those of
    `Resettable` are. An attribute `generator`, if it is the only state that is kept between two calls of reset, makes
    learning from it resumable.
    """

    batch: int

    def reset(self, n: int, /) -> ArrayLike: ...
    def step(self, actions: NDArray[np.int64], /) -> ArrayLike: ...


BlackBox: TypeAlias = Resettable | Batched
"""One run at a time, or many."""


def require_environment(environment: object, what: str) -> None:
    """ArgumentError unless `environment` has reset and step, or is None."""
    if environment is None:
        return
    if not all(callable(getattr(environment, name, None)) for name in ("reset", "step")):
        raise ArgumentError(
            f"{what} is {described(environment)}, which has no reset() and step(i); give an object with both, which "
            "return the index of a state"
        )
    batch_of(environment, what)


def batch_of(environment: object, what: str) -> int | None:
    """How many runs it takes at once; None: one by one. SettingsError if its `batch` is not an integer from 1."""
    given = getattr(environment, "batch", None)
    return None if given is None else whole(given, f"the batch of {what}", 1)


@dataclass(frozen=True, slots=True)
class Environment:
    """`reset()` → first state; `step(i)` → next state after the i-th available action of the current one.

    generator  the source of all its random numbers, and its only state between episodes; None if there is other state:
               a run can then not be resumed
    tables     the model that it simulates, one number of `generator` per reset and per step; None: a black box
    runs       the same as many runs at once, if it is a `Batched` one
    observed   what the environment itself observes now, if its states are cells of that
    """

    reset: Callable[[], int]
    step: Callable[[int], int]
    generator: np.random.Generator | None = None
    tables: Tables | None = None
    runs: Runs | None = None
    observed: Callable[[], Any] | None = None


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
    if model.blackbox is not None:
        return lambda rng: guarded(model, hidden_in(model, rng, steps))
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


def hidden_in(model: MDP, rng: np.random.Generator, steps: int | None) -> BlackBox:
    """The environment of a black-box model; ArgumentError if it cannot be reset and stepped."""
    assert model.blackbox is not None
    environment = model.blackbox(rng, steps)
    require_environment(environment, f"the environment of {model.name}")
    return environment


def guarded(model: MDP, environment: BlackBox) -> Environment:
    """A black box, one run at a time, whose answers are checked to be states of the model. It is always stepped, even
    if it has tables; of a batched one, one run is taken."""
    generator = getattr(environment, "generator", None)
    batch = batch_of(environment, f"the environment of {model.name}")
    if batch is not None:
        runs = Runs(environment, batch, model.n_states, model.name)
        one_of_them = lambda: int(runs.reset(1)[0]), lambda i: int(runs.step(np.array([i]))[0])
        return Environment(*one_of_them, generator, runs=runs)
    one: Any = environment

    def reset() -> int:
        return require_state(one.reset(), "reset()", model.n_states, model.name)

    def step(action: int) -> int:
        return require_state(one.step(action), f"step({action})", model.n_states, model.name)

    return Environment(reset, step, generator, observed=getattr(environment, "observed", None))


class Runs:
    """A batched black box whose answers are checked to be states; a run that is over stays in its state.

    batch   the most runs at once
    """

    def __init__(self, environment: Any, batch: int, n_states: int, name: str) -> None:
        self.batch, self._environment, self._n_states, self._name = batch, environment, n_states, name
        self._states = np.empty(0, dtype=np.int64)

    def reset(self, n: int) -> NDArray[np.int64]:
        found = self._environment.reset(n)
        self._states = require_states(found, f"reset({n})", np.ones(n, dtype=np.bool_), self._n_states, self._name)
        return self._states

    def step(self, actions: NDArray[np.int64]) -> NDArray[np.int64]:
        found = self._environment.step(actions.copy())  # whatever is done to it in there
        after = require_states(found, "step(actions)", actions >= 0, self._n_states, self._name)
        self._states = np.where(actions >= 0, after, self._states)
        return self._states


def require_states(answer: object, call: str, wanted: NDArray[np.bool_], n_states: int, name: str) -> NDArray[np.int64]:
    """The answer of a batched environment, (n,) states; ModelError if one of those `wanted` (n,) is not a state."""
    n = len(wanted)
    try:
        states = np.asarray(answer)
    except ValueError:  # rows of different lengths
        states = np.empty(0)
    if states.shape != (n,) or states.dtype.kind not in "iu":
        shown = f"{states.dtype} of shape {states.shape}" if states.ndim else described(answer)
        raise ModelError(
            f"the environment's {call} returned {shown}, not the states of {n} runs of {name}; "
            f"return integers of shape ({n},)"
        )
    outside = np.flatnonzero(wanted & ((states < 0) | (states >= n_states)))
    if outside.size:
        raise ModelError(
            f"the environment's {call} returned {states[outside[0]]} for run {outside[0]}, which is not a state of "
            f"{name}; return the index of a state, 0 … {n_states - 1}"
        )
    return states.astype(np.int64)


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
