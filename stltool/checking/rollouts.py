"""Verdicts of independent runs: of the model, all at once, or of anything that resets and steps: one by one, or as
many at once as it takes (`Batched`).

Runs are made in blocks of fixed size, each from its own random stream (randomness.py), in lock step: at step t one
uniform number for each run that is still undecided (two if the policy is mixed), in the order of the runs. So verdicts
depend on the seed alone, not on threads. They are returned in the order of the runs, never in the order in which runs
end: verdicts of short runs would come first, and a sequential test would be biased towards them.

Successors are found by inversion, u · (the row's sum) in the row's partial sums: rows that sum to 1 only approximately
are scaled. With 53 random bits per step, the distribution of runs is off by less than 10⁻¹⁵ times steps times row
length.
"""

from __future__ import annotations

import itertools
import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.asked import Asked
from stltool.automata import TRUE, UNDECIDED
from stltool.choices import Rules, Through
from stltool.models.environment import BlackBox, Runs, batch_of, cumulated, hidden_in, require_state
from stltool.policy import Policy, silence
from stltool.product import Product
from stltool.randomness import Purpose, generator, require_seed

Verdicts: TypeAlias = NDArray[np.bool_]
Draw: TypeAlias = Callable[[NDArray[np.int32]], NDArray[np.float64]]
"""Uniform numbers in [0, 1) for the runs with these numbers."""

# parts of a purpose's random numbers
_BLOCKS, _ENVIRONMENT, _CHOICES = 0, 1, 2
BLOCK = 1 << 14  # runs in lock step; their arrays fit into a processor's level-2 cache


class Rollouts:
    """Iterate over the verdicts (n,) bool of `runs` runs of a policy, a batch at a time.

    `environment` replaces the model: its `reset()` and `step(i)` return the index of a state in the model's order, or
    `reset(n)` and `step(actions)` those of n runs (`Batched`), and the model's probabilities are not read. A black-box
    model has its own. Runs are fresh: they share no random number
    with another `purpose` under the same seed. `steps` counts the steps of the batches returned so far. Raises
    PolicyError, naming the state, if the policy defines no action there; ModelError if the environment returns
    something that is not a state.
    """

    def __init__(
        self,
        product: Product,
        policy: Policy,
        runs: int,
        seed: int,
        environment: BlackBox | None = None,
        purpose: Purpose = Purpose.ESTIMATE,
    ) -> None:
        self._own = environment is None and product.model.blackbox is not None
        if environment is None and not self._own:
            product.model.require_points()
        self.product, self.policy = policy.on(product)
        self.runs = runs
        self.steps = 0
        self.seed, self._purpose = require_seed(seed), purpose
        self._environment = environment

    def __iter__(self) -> Iterator[Verdicts]:
        self.steps = 0
        environment = self._environment
        if self._own:
            environment = hidden_in(self.product.model, self._stream(_ENVIRONMENT), self.product.horizon)
        if environment is None:
            found = self._simulated()
        elif (batch := batch_of(environment, "the environment")) is not None:
            found = self._side_by_side(environment, batch)
        else:
            found = self._observed(environment)
        for verdicts, steps in found:
            self.steps += steps
            yield verdicts

    def _stream(self, *part: int) -> np.random.Generator:
        return generator(self.seed, self._purpose, *part)

    # -------------------------------------------------------------------------------------------- the model itself

    def _simulated(self) -> Iterator[tuple[Verdicts, int]]:
        """Blocks in order, a few ahead in threads; numba and numpy release the interpreter."""
        sums = cumulated(self.product.model)
        sizes = enumerate(min(BLOCK, self.runs - first) for first in range(0, self.runs, BLOCK))
        workers = min(os.cpu_count() or 1, -(-self.runs // BLOCK))

        def block(number: int, size: int) -> tuple[Verdicts, int]:
            rng = self._stream(_BLOCKS, number)
            return follow(self.product, self.policy, sums, size, lambda live: rng.random(len(live)))

        with ThreadPoolExecutor(workers) as pool:
            blocks = (pool.submit(block, *numbered) for numbered in sizes)
            ahead = deque(itertools.islice(blocks, workers))
            while ahead:
                yield ahead.popleft().result()
                ahead.extend(itertools.islice(blocks, 1))

    # ------------------------------------------------------------------------------------------------ a black box

    def _observed(self, environment: Any) -> Iterator[tuple[Verdicts, int]]:
        product, policy = self.product, self.policy
        automaton, model = product.automaton, product.model
        rng = self._stream(_CHOICES)
        for _ in range(self.runs):
            t, s = 0, require_state(environment.reset(), "reset()", model.n_states, model.name)
            q = product.enter(s, automaton.initial)
            while automaton.verdicts(t)[q] == UNDECIDED:
                i = choice(product, policy, s, q, t, rng)
                call = f"step({i}) in state {model.state_name(s)}"
                s = require_state(environment.step(i), call, model.n_states, model.name)
                q = product.enter(s, q)
                t += 1
            yield np.array([automaton.verdicts(t)[q] == TRUE]), t

    def _side_by_side(self, environment: BlackBox, batch: int) -> Iterator[tuple[Verdicts, int]]:
        """As many runs at once as the environment takes, in lock step. Those that are decided wait for the others."""
        product, policy = self.product, self.policy
        runs = Runs(environment, batch, product.model.n_states, product.model.name)
        rng = self._stream(_CHOICES)
        for first in range(0, self.runs, batch):
            n = min(batch, self.runs - first)
            lanes = Lanes(product, runs.reset(n))
            steps = 0
            while len(lanes.open):
                steps += len(lanes.open)
                actions = np.full(n, -1)
                actions[lanes.open] = lanes.choices(policy, rng)
                lanes.enter(runs.step(actions))
            yield lanes.outcome == TRUE, steps


class Lanes:
    """Runs of a product in lock step.

    t, s, q   the step; (n,) the model and automaton states;  outcome (n,) the verdicts;  open: the runs without one
    """

    def __init__(self, product: Product, first: NDArray[np.int64]) -> None:
        self._product = product
        self.t, self.s = 0, first
        self.q = product.automaton.delta[product.letter[first], product.automaton.initial]
        self.outcome = product.automaton.verdicts(0)[self.q]
        self.open = np.flatnonzero(self.outcome == UNDECIDED)

    def choices(self, policy: Policy, rng: np.random.Generator) -> NDArray[Any]:
        """What the policy does in the open runs; one random number for each if it is mixed."""
        s, q = self.s[self.open], self.q[self.open]
        return taken(self._product, policy, self.t, s, q, lambda: rng.random(len(s)))

    def enter(self, s: NDArray[np.int64]) -> None:
        """The states after a step; runs that are decided stay as they were."""
        automaton, open_ = self._product.automaton, self.open
        self.t, self.s = self.t + 1, s
        q = automaton.delta[self._product.letter[s[open_]], self.q[open_]]
        self.q[open_] = q
        self.outcome[open_] = automaton.verdicts(self.t)[q]
        self.open = open_[self.outcome[open_] == UNDECIDED]


def taken(
    product: Product,
    policy: Policy,
    t: int,
    s: NDArray[Any],
    q: NDArray[Any],
    draw: Callable[[], NDArray[np.float64]],
) -> NDArray[Any]:
    """What the policy does in runs at (t, s, q), (n,) each; draws a uniform number for each if it is mixed."""
    found = policy.form.at(t, s, q)
    if not policy.deterministic:
        below = found.cumsum(axis=1)
        _require_action(product, t, s, q, below[:, -1] == 0)
        drawn: NDArray[Any] = (below <= draw()[:, None] * below[:, -1:]).sum(axis=1)
        return drawn
    _require_action(product, t, s, q, found < 0)
    return found


def _require_action(product: Product, t: int, s: NDArray[Any], q: NDArray[Any], silent: NDArray[np.bool_]) -> None:
    for i in np.flatnonzero(silent)[:1].tolist():
        raise silence(product, int(s[i]), int(q[i]), t)


def choice(product: Product, policy: Policy, s: int, q: int, t: int, rng: np.random.Generator) -> int:
    """What the policy does in one run; one random number if it is mixed."""
    entry = policy.form.at(t, np.array([s]), np.array([q]))[0]
    if not policy.deterministic:
        if not entry.any():
            raise silence(product, s, q, t)
        return int(rng.choice(len(entry), p=entry / entry.sum()))
    if entry < 0:
        raise silence(product, s, q, t)
    return int(entry)


def follow(product: Product, policy: Policy, sums: NDArray[np.float64], runs: int, draw: Draw) -> tuple[Verdicts, int]:
    """Runs in lock step from the first state to the verdict: verdicts (runs,) and the number of steps.

    `sums` are the model's `cumulated` probabilities.
    """
    from stltool.kernels import rollout

    model, automaton = product.model, product.automaton
    number = np.arange(runs, dtype=np.int32)
    first = np.flatnonzero(model.initial)
    entry = np.cumsum(model.initial[first])
    s = first[np.searchsorted(entry, draw(number) * entry[-1], side="right")].astype(np.int32)
    q = automaton.delta[product.letter[s], automaton.initial]
    outcome = automaton.verdicts(0)[q]
    open_ = outcome == UNDECIDED
    s, q, number = s[open_], q[open_], number[open_]
    t, steps = 0, 0
    while len(s):
        choice = np.empty(len(s), dtype=np.int32)
        if isinstance(policy.form, Asked | Through | Rules):  # of a function, asked only where runs are
            choice[:] = taken(product, policy, t, s, q, partial(draw, number))
        elif policy.deterministic:
            silent = rollout.pick(policy.row(t), s, q, choice)
            if silent >= 0:
                raise silence(product, int(s[silent]), int(q[silent]), t)
        else:
            rollout.mix(policy.row(t), draw(number), s, q, choice)
        t, steps = t + 1, steps + len(s)
        live = rollout.move(
            model.choice_start, model.row_start, model.target, sums, product.letter, automaton.delta,
            automaton.verdicts(t), choice, draw(number), s, q, number, outcome,
        )  # fmt: skip
        s, q, number = s[:live], q[:live], number[:live]
    return outcome == TRUE, steps
