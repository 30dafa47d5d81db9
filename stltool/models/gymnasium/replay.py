"""Does an environment behave as its table lists? Two thousand seeded steps of it are compared with P.

Actions are chosen so that the walk heads, according to the table, for the nearest untried pair of state and action. The
start of each episode must have a positive probability, and each step must be an outcome of P[s][a]: its successor, with
its reward and its `terminated`. Outcomes must also be as frequent as listed: with p_t the probability of the likeliest
(successor, terminated) of the t-th row, and X_t = 1 if that one occurred, else 0, Σ (X_t − p_t) is a martingale under P
however the actions are chosen, so by the Azuma–Hoeffding inequality

    |Σ (X_t − p_t)| > √(n/2 · ln(2/δ))     with probability at most δ = 10⁻⁹.

Rows that the walk does not reach are trusted, and so are frequencies that differ by less than this bound detects.
"""

from __future__ import annotations

import math
import operator
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.errors import ModelError
from stltool.models.gymnasium.episodes import old_api

Outcome: TypeAlias = tuple[float, int, float, bool]
"""(probability, successor, reward, terminated)"""

Rows: TypeAlias = Sequence[Sequence[Sequence[Outcome]]]

_STEPS, _EPISODE = 2000, 50  # in total, and at most per episode
_LOOK = 200  # states searched for an untried pair
_DELTA = 1e-9
_REMEDY = "use table=False (in a model file: table = false), a black box, or correct the table"
# options of known environments that their tables ignore
_NOT_LISTED = {"fickle_passenger": "the passenger may change the destination on the way"}


def require_listed(env: Any, title: str) -> None:
    """ModelError if an environment has an option that its table is known to ignore."""
    inner = env.unwrapped
    for option, what in _NOT_LISTED.items():
        if getattr(inner, option, False):
            raise ModelError(
                f"{title}: with {option}=True {what}, which its transition table does not list; leave the option out, "
                "or use table=False (in a model file: table = false), a black box"
            )


def require_replays(env: Any, title: str, rows: Rows, initial: NDArray[np.float64], listed: bool) -> None:
    """ModelError, naming state, action and what was seen, if the environment does what the table does not list.

    A table of probabilities alone is not `listed`: rewards are not compared, and episodes may end in states that no
    action leaves.
    """
    rng = np.random.default_rng(0)
    walk = _Walk(title, rows, initial, rng, listed and _keeps_rewards(env), listed)
    with _unseen(env) as stepped:
        state, left = -1, 0
        for _ in range(_STEPS):
            if not left:
                state, left = walk.start(_call(stepped.reset, title, "reset", seed=int(rng.integers(2**31)))), _EPISODE
            action = walk.choose(state)
            answer = _call(stepped.step, title, f"step({action})", action)
            state, over = walk.step(state, action, answer)
            left = 0 if over else left - 1
    walk.require_frequencies()


def _keeps_rewards(env: Any) -> bool:
    """Whether no wrapper changes rewards."""
    while env is not env.unwrapped:
        if any(base.__name__ == "RewardWrapper" for base in type(env).__mro__):
            return False
        env = env.env
    return True


@contextmanager
def _unseen(env: Any) -> Iterator[Any]:
    """The environment, without the rendering for people at every step."""
    inner = env.unwrapped
    if getattr(inner, "render_mode", None) != "human" and "HumanRendering" not in _wrappers(env):
        yield env
        return
    mode = getattr(inner, "render_mode", None)
    inner.render_mode = None
    try:
        yield inner
    finally:
        inner.render_mode = mode


def _wrappers(env: Any) -> list[str]:
    names = []
    while env is not env.unwrapped:
        names.append(type(env).__name__)
        env = env.env
    return names


def _call(method: Any, title: str, call: str, *arguments: Any, **named: Any) -> Any:
    try:
        return method(*arguments, **named)
    except Exception as error:  # any fault in there is the environment's
        raise ModelError(f"{title}: {call} raised {type(error).__name__}: {error}; correct the environment") from error


@dataclass(eq=False)
class _Walk:
    """The pairs tried so far, and the outcomes."""

    title: str
    rows: Rows
    initial: NDArray[np.float64]
    rng: np.random.Generator
    rewards: bool
    ends: bool

    def __post_init__(self) -> None:
        self.untried: dict[int, list[int]] = {}
        self.came = self.expected = 0.0
        self.steps = 0

    def start(self, answer: Any) -> int:
        if not (isinstance(answer, tuple) and len(answer) == 2):
            raise old_api(self.title, "reset(seed=…)", answer, "(observation, info)")
        try:
            state = operator.index(answer[0])
            known = 0 <= state < len(self.rows)
        except (TypeError, LookupError):
            state, known = -1, False
        if not known or not self.initial[state] > 0:
            seen = f"state {state}" if known else repr(answer)
            raise ModelError(
                f"{self.title}: reset() started in {seen}, to which initial_state_distrib gives no probability; "
                "correct it, or use table=False"
            )
        return state

    def choose(self, state: int) -> int:
        """The first action on the way to the nearest untried pair, according to the table."""
        queue, seen = deque([(state, -1)]), {state}
        while queue and len(seen) < _LOOK:
            s, first = queue.popleft()
            untried = self.actions(s)
            if untried:
                return first if first >= 0 else untried[int(self.rng.integers(len(untried)))]
            for a, outcomes in enumerate(self.rows[s]):
                for _, s2, _, terminated in outcomes:
                    if s2 not in seen and not terminated:
                        seen.add(s2)
                        queue.append((s2, a if first < 0 else first))
        return int(self.rng.integers(len(self.rows[state])))

    def actions(self, state: int) -> list[int]:
        """The actions that have not been tried in a state."""
        return self.untried.setdefault(state, list(range(len(self.rows[state]))))

    def step(self, state: int, action: int, answer: Any) -> tuple[int, bool]:
        """The state after a step, and whether the episode is over; checked against the table."""
        if action in self.actions(state):
            self.actions(state).remove(action)
        if not (isinstance(answer, tuple) and len(answer) == 5):
            form = "(observation, reward, terminated, truncated, info)"
            raise old_api(self.title, f"step({action})", answer, form)
        observation, reward, terminated, truncated, _ = answer
        try:
            s2, terminated = operator.index(observation), bool(terminated)
        except TypeError:
            raise ModelError(
                f"{self.title}: step({action}) returned the observation {observation!r}, which is not in its space; "
                "correct the environment"
            ) from None
        outcomes = self.rows[state][action]
        over = terminated or bool(truncated)
        if not self.ends and 0 <= s2 < len(self.rows) and all(to == s2 for row in self.rows[s2] for _, to, _, _ in row):
            terminated = False  # staying there says the same
        fits = [p for p, to, _, ends in outcomes if (to, ends) == (s2, terminated)]
        worth = [r for _, to, r, ends in outcomes if (to, ends) == (s2, terminated)]
        if not fits or (self.rewards and not any(_same(reward, one) for one in worth)):
            raise ModelError(
                f"{self.title}: its transition table does not describe its behaviour: action {action} in state {state} "
                f"led to state {s2} with reward {reward} and terminated={terminated}, which P[{state}][{action}] "
                f"does not list; {_REMEDY}"
            )
        share: dict[tuple[int, bool], float] = {}
        for p, to, _, ends in outcomes:
            share[to, ends] = share.get((to, ends), 0.0) + p
        likeliest = max(share, key=lambda one: share[one])
        self.came += likeliest == (s2, terminated)
        self.expected += share[likeliest]
        self.steps += 1
        return s2, over

    def require_frequencies(self) -> None:
        if abs(self.came - self.expected) > math.sqrt(self.steps / 2 * math.log(2 / _DELTA)):
            raise ModelError(
                f"{self.title}: its transition table does not describe its behaviour: in {self.steps} steps the "
                f"likeliest outcome of P[s][a] occurred {self.came:.0f} times, and the table predicts "
                f"{self.expected:.0f}; {_REMEDY}"
            )


def _same(one: Any, other: Any) -> bool:
    try:
        return math.isclose(float(one), float(other), rel_tol=1e-9, abs_tol=1e-12)
    except (TypeError, ValueError):
        return bool(one == other)
