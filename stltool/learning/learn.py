"""`learn`: a policy for a product, from something that only resets and steps."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.checking import check
from stltool.errors import SettingsError, near_misses
from stltool.files import require_replaceable
from stltool.learning.cfer import Cfer, FaithfulCfer
from stltool.learning.cfper import FaithfulCfper
from stltool.learning.checkpoint import load_checkpoint, save_checkpoint
from stltool.learning.counts import Counts
from stltool.learning.learner import Learner
from stltool.learning.model_based import ModelBased
from stltool.learning.naive import FaithfulNaive, Naive
from stltool.learning.naive_er import FaithfulNaiveER, NaiveER
from stltool.learning.problem import Problem
from stltool.learning.settings import Settings
from stltool.learning.trainer import Point, Progress, Trainer
from stltool.logic.fragment import check_fragment
from stltool.models.environment import Environment, Resettable, simulator
from stltool.policy import Policy, with_flags
from stltool.product import Product
from stltool.randomness import Purpose, generator, require_seed
from stltool.sizes import require_time

_FAITHFUL: dict[str, Callable[[Problem, Settings, str, np.random.Generator], Learner]] = {
    "naive": FaithfulNaive,
    "naive-er": FaithfulNaiveER,
    "cfer": FaithfulCfer,
    "cfper": FaithfulCfper,
}
_CORRECTED: dict[str, Callable[[Problem, Settings, np.random.Generator], Learner]] = {
    "naive": Naive,
    "naive-er": NaiveER,
    "cfer": Cfer,
    "model-based": ModelBased,
}
METHODS = tuple(dict.fromkeys([*_CORRECTED, *_FAITHFUL]))
_RATE = 1e6  # environment steps and updates a second, roughly

Shown = Callable[[int, int, int, float | None], None]
"""Called once an episode with (episode, episodes, environment steps, exact probability so far or None)."""


@dataclass(frozen=True, eq=False)
class Training:
    """A finished run: the policy at the end, the exact learning curve that led there, the transitions it saw.

    stopped_early  whether `stop_gap` or `most_steps` ended it before its episodes were over
    seconds        wall time, of a resumed run since it was resumed
    """

    policy: Policy
    history: list[Point]
    method: str
    faithful: bool
    seed: int
    settings: Settings
    counts: Counts
    seconds: float
    stopped_early: bool = False

    @property
    def episodes(self) -> int:
        return self.history[-1].episode

    @property
    def environment_steps(self) -> int:
        return self.history[-1].steps


def learn(
    product: Product,
    method: str = "cfer",
    *,
    faithful: bool = False,
    seed: int = 0,
    environment: Resettable | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    checkpoint_every: float = 30.0,
    progress: Shown | None = None,
    **settings: Any,
) -> Training:
    """Learn a policy without knowing the probabilities.

    method       "cfer", "model-based", "naive" or "naive-er": exact objective, γ = 1, Q carries the clock;
                 `faithful=True` runs "naive", "naive-er", "cfer" or "cfper" as published (docs/reproduction.md)
    seed         every random choice comes from it: same seed, same result
    environment  anything whose `reset()` and `step(i)` (the i-th available action of the current state) return the
                 index of a state as the model counts them. Default: the model, sampled
    checkpoint   a file that holds the whole run every `checkpoint_every` seconds, and at its end; `resume=True` goes on
                 from it, where there is one, to the same bits as an undisturbed run
    settings     fields of `Settings`, by name

    Raises SettingsError for what does not fit together, ModelError where the environment returns no state.
    """
    chosen = _checked(method, faithful, seed, product, settings)
    start = time.perf_counter()
    for_environment, for_learner = (
        generator(seed, purpose) for purpose in (Purpose.LEARNING_ENVIRONMENT, Purpose.LEARNER)
    )
    # as published, a policy remembers the flags of [Wang24]; whatever it remembers, `product` judges
    home = with_flags(product) if faithful else product
    problem = Problem.of(home)
    learner: Learner
    if faithful:
        learner = _FAITHFUL[method](problem, chosen, check_fragment(product.formula).outer, for_learner)
    else:
        learner = _CORRECTED[method](problem, chosen, for_learner)
    length = _episode_length(product, faithful)
    world = _environment(product, environment, for_environment, length)
    counts = Counts(product.model.n_choices, product.model.n_states)
    trainer = Trainer(
        problem, world, learner, chosen, for_learner, counts,
        episode_length=length,
        to_the_end=faithful,
        **_judge(home, product, chosen),
    )  # fmt: skip
    so_far, save = Progress(), None
    if checkpoint is not None:
        so_far, save = _checkpoints(
            Path(checkpoint), resume, checkpoint_every, trainer, product, method, faithful, seed
        )
    elif resume:
        raise SettingsError("resume=True needs the checkpoint to go on from; give checkpoint=FILE")
    trainer.run(so_far, shown=progress, between=save)
    return Training(
        Policy(home, learner.policy_table()), so_far.history, method, faithful, int(seed), chosen, counts,
        time.perf_counter() - start, so_far.finished and so_far.episode < chosen.episodes,
    )  # fmt: skip


def _checked(method: str, faithful: bool, seed: int, product: Product, settings: dict[str, Any]) -> Settings:
    if method not in METHODS:
        raise SettingsError(f"there is no method {method!r}; {near_misses(method, METHODS)}")
    if method not in (_FAITHFUL if faithful else _CORRECTED):
        instead = "it is no published method; leave faithful out" if faithful else "it exists as published only; set it"
        raise SettingsError(f"there is no {method} with faithful={faithful}: {instead}")
    require_seed(seed)
    if product.horizon < 1:
        raise SettingsError(f"{product.formula} is decided by the first state; there is nothing to learn")
    chosen = Settings.of(method, faithful, **settings)
    if chosen.factual_share is not None and not (faithful and method in ("cfer", "cfper")):
        raise SettingsError("factual_share balances the tuples of faithful cfer and cfper; leave it out here")
    length = _episode_length(product, faithful)
    if chosen.most_steps is not None and chosen.most_steps < length:
        raise SettingsError(f"most_steps is {chosen.most_steps}, and one episode takes {length}; allow at least one")
    require_time(
        chosen.episodes * (length + chosen.replays + chosen.batch * length / chosen.period),
        _RATE,
        f"{chosen.episodes} episodes of {length} steps",
        "shorten the windows or take fewer episodes",
    )
    return chosen


def _episode_length(product: Product, faithful: bool) -> int:
    """Transitions at most: as published T + τ, two more than the horizon."""
    return product.horizon + 2 if faithful else product.horizon


def _environment(product: Product, given: Resettable | None, rng: np.random.Generator, length: int) -> Environment:
    if given is None:
        return simulator(product.model, rng, length)
    return given if isinstance(given, Environment) else Environment(given.reset, given.step)


def _judge(home: Product, product: Product, settings: Settings) -> dict[str, Any]:
    """`evaluate` and `enough`: exact where the model is known."""
    if product.model.blackbox is not None:
        if settings.stop_gap is not None:
            raise SettingsError("stop_gap needs the exact optimum, and the model is a black box; set episodes instead")
        return {"evaluate": lambda table: None, "enough": lambda value: False}
    judge = home if home.automaton.exact else product
    best = check(product, keep_policy=False).probability if settings.stop_gap is not None else 0.0

    def evaluate(table: NDArray[Any]) -> float:
        return check(judge, Policy(home, table)).probability

    def enough(value: float) -> bool:
        return settings.stop_gap is not None and best - value <= settings.stop_gap

    return {"evaluate": evaluate, "enough": enough}


def _checkpoints(
    path: Path, resume: bool, every: float, trainer: Trainer, product: Product, method: str, faithful: bool, seed: int
) -> tuple[Progress, Callable[[Progress], None]]:
    """How far the run is, and what saves it from time to time."""
    generator = trainer.environment.generator
    if generator is None:
        raise SettingsError(
            "a run is resumed to the same bits only where the environment's random numbers are known; "
            "give an Environment with its generator, or leave checkpoint out"
        )
    require_replaceable(path)
    settings = dataclasses.asdict(trainer.settings)
    episodes = settings.pop("episodes")  # a resumed run may be given more
    what = {
        "task": str(product.formula), "encoding": product.automaton.encoding, "model": product.model.digest(),
        "automaton": product.automaton.digest(), "method": method, "faithful": faithful, "seed": int(seed), **settings,
    }  # fmt: skip
    generators = [trainer.rng, generator]
    so_far = Progress()
    if path.exists():
        if not resume:
            raise SettingsError(f"{path} exists; resume it (--resume), or delete it to begin anew")
        so_far = load_checkpoint(path, what, trainer.learner, trainer.counts, generators)
        if so_far.episode > episodes:
            raise SettingsError(f"{path} is {so_far.episode} episodes old already; episodes is {episodes}, give more")
    last = time.monotonic()

    def save(now: Progress) -> None:
        nonlocal last
        if trainer.ends(now) or time.monotonic() - last >= every:
            save_checkpoint(path, what, now, trainer.learner, trainer.counts, generators)
            last = time.monotonic()

    return so_far, save
