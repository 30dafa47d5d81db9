"""`learn`: a policy for a product, from a simulator alone."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.checking import check
from stltool.errors import SettingsError, near_misses
from stltool.learning.cfer import Cfer, FaithfulCfer
from stltool.learning.naive import FaithfulNaive, Naive
from stltool.learning.naive_er import FaithfulNaiveER, NaiveER
from stltool.learning.problem import Problem
from stltool.learning.settings import Settings
from stltool.learning.trainer import Learner, Point, train
from stltool.logic.fragment import check_fragment
from stltool.models.environment import simulator
from stltool.policy import Policy, with_flags
from stltool.product import Product
from stltool.sizes import require_time

_FAITHFUL: dict[str, Callable[[Problem, Settings, str, np.random.Generator], Learner]] = {
    "naive": FaithfulNaive,
    "naive-er": FaithfulNaiveER,
    "cfer": FaithfulCfer,
}
_CORRECTED: dict[str, Callable[[Problem, Settings, np.random.Generator], Learner]] = {
    "naive": Naive,
    "naive-er": NaiveER,
    "cfer": Cfer,
}
METHODS = tuple(_CORRECTED)
_RATE = 1e5  # environment steps a second, roughly


@dataclass(frozen=True, eq=False)
class Training:
    """A finished run: the greedy policy at the end, and the exact learning curve that led there."""

    policy: Policy
    history: list[Point]
    method: str
    faithful: bool
    seed: int
    settings: Settings
    seconds: float

    @property
    def environment_steps(self) -> int:
        return self.history[-1].steps


def learn(
    product: Product,
    method: str = "cfer",
    *,
    faithful: bool = False,
    seed: int = 0,
    progress: Callable[[int, int, float], None] | None = None,
    **settings: Any,
) -> Training:
    """Learn a policy without knowing the probabilities.

    method     "naive", "naive-er" or "cfer"; `faithful=True` runs it as published (reproduction.md), the default
               corrects it: exact objective, γ = 1, Q carries the clock
    seed       every random choice comes from it: same seed, same result
    settings   fields of `Settings`, by name; `progress(episode, episodes, probability)` is called once an episode
    """
    if method not in METHODS:
        raise SettingsError(f"there is no method {method!r}; {near_misses(method, METHODS)}")
    known = [field.name for field in dataclasses.fields(Settings)]
    for name in settings:
        if name not in known:
            raise SettingsError(f"there is no setting {name!r}; {near_misses(name, known)}")
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise SettingsError(f"seed is {seed!r}; it must be a whole number from 0")
    if product.horizon < 1:
        raise SettingsError(f"{product.formula} is decided by the first state; there is nothing to learn")
    chosen = Settings(**settings)
    episode_length = product.horizon + 2 if faithful else product.horizon
    require_time(
        chosen.episodes * (episode_length + chosen.replays + chosen.batch * episode_length / chosen.period),
        _RATE,
        f"{chosen.episodes} episodes of {episode_length} steps",
        "shorten the windows or take fewer episodes",
    )
    start = time.perf_counter()
    for_environment, for_learner = (np.random.default_rng(s) for s in np.random.SeedSequence(int(seed)).spawn(2))
    learner: Learner
    # as published, a policy remembers the paper's flags; whatever it remembers, `product` judges
    home = with_flags(product) if faithful else product
    judge = home if home.automaton.exact else product
    problem = Problem.of(home)
    if faithful:
        outer = check_fragment(product.formula).outer
        learner = _FAITHFUL[method](problem, chosen, outer, for_learner)
    else:
        learner = _CORRECTED[method](problem, chosen, for_learner)

    def evaluate(table: NDArray[Any]) -> float:
        return check(judge, Policy(home, table)).probability

    history = train(
        problem,
        simulator(product.model, for_environment),
        learner,
        chosen,
        for_learner,
        episode_length=episode_length,
        read_first_state=not faithful,
        evaluate=evaluate,
        progress=progress,
    )
    policy = Policy(home, learner.policy_table())
    return Training(policy, history, method, faithful, int(seed), chosen, time.perf_counter() - start)
