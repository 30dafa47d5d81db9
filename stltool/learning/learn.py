"""`learn`: a policy for a product, from an environment that can only be reset and stepped."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described, flag, function, real
from stltool.arguments import path as path_of
from stltool.automata import TRUE, UNDECIDED
from stltool.checking import check
from stltool.checking.statistical import require_confidence
from stltool.choices import Form
from stltool.display import Card, Displayed, counted, probability_text
from stltool.errors import SettingsError, named
from stltool.learning.checkpoint import (
    kept_arrays,
    load_checkpoint,
    require_checkpoint,
    require_generators,
    save_checkpoint,
)
from stltool.learning.counts import Counts
from stltool.learning.gap import Certifier, Gap
from stltool.learning.interrupt import Interrupt, interruptible
from stltool.learning.judged import settled
from stltool.learning.learner import Learner, require_learner
from stltool.learning.methods import METHODS, class_of, make
from stltool.learning.problem import Problem
from stltool.learning.settings import Budget, recorded
from stltool.learning.trainer import Point, Progress, Status, Trainer
from stltool.models.environment import BlackBox, Environment, guarded, require_environment, simulator
from stltool.policy import Policy, require_door, with_flags
from stltool.product import Product, first_verdicts, with_early_verdicts
from stltool.randomness import Purpose, generator, require_seed
from stltool.sizes import require_time

_SHOWN = 10  # points of the learning curve in a notebook
_RATE = 1e6  # environment steps per second, roughly

Shown = Callable[[int, int, int, float | None], None]
"""Called once per episode with (episode, episodes, environment steps, exact probability so far or None)."""


@dataclass(frozen=True, eq=False, repr=False)
class Training(Displayed):
    """A finished run: the policy at the end, the exact learning curve that led there, the transitions it saw.

    learner    the method with its settings; budget: the settings of the run
    status     how it ended: "complete" (all episodes), "within the gap" (`stop_gap`), "gap
               certified" (`until_gap`), "out of steps" (`most_steps`), or
               "nothing to learn" (the first state decides the task, so all policies are equally good)
    gap        with `until_gap`: what its transitions prove about the policy's distance to the optimum
    seconds    wall time, for a resumed run since it was resumed
    """

    policy: Policy
    history: list[Point]
    learner: Learner[Any]
    budget: Budget
    seed: int
    counts: Counts
    seconds: float
    status: Status = "complete"
    gap: Gap | None = None

    def _card(self) -> Card:
        home = self.policy.home
        assert isinstance(home, Product)  # learners do not support joint products
        last = self.history[-1].probability
        step = -(-len(self.history) // _SHOWN)
        points = self.history[::-step][::-1]
        rows = [(point.episode, point.steps, _shown(point.probability)) for point in points]
        published = " as published" if self.faithful else ""
        return Card(
            f"Training: {self.method}{published}, {counted(self.episodes, 'episode')}, "
            f"{counted(self.environment_steps, 'environment step')}, {self.status}",
            [
                {"P of the policy": _shown(last), "seed": self.seed, "seconds": f"{self.seconds:.3g}"},
                {"task": f"{home.task_name} := {home.formula}", "model": home.model.name},
            ],
            (("episode", "environment steps", "P of the policy"), rows),
        )

    @property
    def method(self) -> str:
        """The method's name."""
        return self.learner.name

    @property
    def faithful(self) -> bool:
        """Whether the method is one as published."""
        return self.learner.published

    @property
    def settings(self) -> dict[str, Any]:
        """The settings of the method by name."""
        return recorded(self.learner)

    @property
    def stopped_early(self) -> bool:
        """Whether `stop_gap` or `most_steps` ended it before its last episode."""
        return (
            self.status in ("within the gap", "gap certified", "out of steps") and self.episodes < self.budget.episodes
        )

    @property
    def settled(self) -> bool | None:
        """Whether P has come to rest: it changed by at most 1/100 in the last quarter of the episodes.

        None if P is not known, or was evaluated fewer than three times.
        """
        return settled(self.history)

    @property
    def advice(self) -> str | None:
        """What to do if P has not come to rest; None if it has, if that is not known, or if the gap ended the run."""
        if self.settled is not False or self.status == "within the gap":
            return None
        return "not settled: more episodes" + ("" if self.method == "model-based" else ", or model-based")

    @property
    def episodes(self) -> int:
        return self.history[-1].episode

    @property
    def environment_steps(self) -> int:
        return self.history[-1].steps


def _shown(probability: float | None) -> str:
    return probability_text(probability) if probability is not None else "unknown: the model is a black box"


def learn(
    product: Product,
    method: str | Learner[Any] | None = None,
    *,
    faithful: bool = False,
    episodes: int = 1000,
    evaluate_every: int = 20,
    most_steps: int | None = None,
    stop_gap: float | None = None,
    until_gap: float | None = None,
    confidence: float = 0.99,
    seed: int = 0,
    environment: BlackBox | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    checkpoint_every: float = 30.0,
    progress: Shown | None = None,
    **settings: Any,
) -> Training:
    """Learn a policy without knowledge of the probabilities.

    method        a learner, such as `Cfer(optimism=0.5)` or one of your own (docs/learning.md); or a name:
                  "model-based" (default), "cfer", "naive", "naive-er" (exact objective, γ = 1, Q carries the clock),
                  with `faithful=True` "cfer" (default), "naive", "naive-er", "cfper" as published
                  (docs/reproduction.md)
    settings      with a name: fields of its class, such as `optimism=0.5`
    episodes      training episodes
    evaluate_every   episodes between exact evaluations of the learned policy, the points of the learning curve
    most_steps    stop before the total of environment steps could exceed this
    stop_gap      stop once an evaluation is within this of the exact optimum (known models only)
    until_gap     stop once the transitions alone prove, with this `confidence`, that the policy is within this of the
                  optimum (`optimality_gap`; docs/guarantees.md): tied if the model's rows depend on parameters (of
                  grids: always), unless the data contradict that. The policy learned is then the one that is optimal at
                  the estimates of the parameters
    seed          an integer from 0, the source of all random choices: same seed, same result
    environment   anything whose `reset()` and `step(i)` (the i-th available action of the current state) return the
                  index of a state of the model. Default: the model, sampled
    checkpoint    a file to which the whole run is saved every `checkpoint_every` seconds, at its end, and when it is
                  interrupted (Ctrl-C); `resume=True` continues from it, if it exists, with bit for bit the same result
                  as an uninterrupted run (of one on a batched black box, to more episodes: if the first number of them
                  was a multiple of its batch)

    Raises SettingsError for inconsistent arguments, ModelError if the environment does not return a state, and
    FileError if the checkpoint cannot be written; all but the second before the first episode.
    """
    require_door("learn", product)
    flag(faithful, "learn's faithful")
    flag(resume, "learn's resume")
    require_environment(environment, "learn's environment")
    function(progress, "learn's progress")
    if checkpoint is not None:
        checkpoint = path_of(checkpoint, "learn's checkpoint")
    if real(checkpoint_every, "checkpoint_every", "30") < 0:
        raise SettingsError(f"{named('checkpoint_every')} is {checkpoint_every}; give seconds from 0")
    learner = _learner(method, faithful, settings)
    budget = Budget(episodes=episodes, evaluate_every=evaluate_every, most_steps=most_steps, stop_gap=stop_gap)
    seed = require_seed(seed)
    start = time.perf_counter()
    rng, rng_of_environment = (generator(seed, one) for one in (Purpose.LEARNER, Purpose.LEARNING_ENVIRONMENT))
    decided = _decided(product, known_start=environment is None)
    # as published, a policy is over the flags of [Wang24]; it is always judged on `product`
    home = with_flags(product) if learner.published and decided is None else product
    length = product.horizon + 2 if learner.published else product.horizon
    _require_length(budget, length)
    require_checkpoint(checkpoint, resume)
    world = _environment(product, environment, rng_of_environment, length)
    judge = _Judge(home, product, budget)
    require_confidence(confidence)
    if until_gap is not None and not 0 < real(until_gap, "until_gap", "0.01") < 1:
        raise SettingsError(f"{named('until_gap')} is {until_gap}; give a probability between 0 and 1, such as 0.01")
    if until_gap is not None and learner.published:
        raise SettingsError(f"{named('until_gap')} is not for methods as published; leave one of the two out")
    counts = Counts(product.model.n_choices, product.model.n_states, product.model.n_choices + 1)
    problem = Problem.of(home)
    state = learner.start(problem, counts, rng) if decided is None else None
    certifier = None
    if until_gap is not None and decided is None:
        certifier = Certifier(home, product, counts, float(until_gap), confidence)
    trainer = Trainer(
        problem, world, learner, state, budget, rng, counts, length, judge.known, judge.evaluate, judge.enough,
        certifier,
    )  # fmt: skip
    with interruptible(checkpoint is not None) as interrupt:
        so_far, save = Progress(), None
        if checkpoint is not None:
            what = _identity(product, learner, budget, seed)
            if until_gap is not None:
                what |= {"until_gap": float(until_gap), "confidence": float(confidence)}
            kept = _Checkpoint(Path(checkpoint), what, trainer, checkpoint_every, interrupt)
            so_far, save = kept.begin(), kept.save
        if decided is not None and so_far.status is None:
            so_far = Progress(status="nothing to learn", history=[Point(0, 0, decided.value, time.time())])
            if save is not None:
                save(so_far)
        trainer.run(so_far, shown=progress, between=save)
    table: NDArray[Any] | Form = np.zeros(home.shape, dtype=np.int64)
    if state is not None:
        table = learner.policy(state)
    policy, gap = Policy(home, table), None
    if certifier is not None:
        gap = certifier.last if certifier.last is not None else certifier(lambda: table)  # resumed at its end
        policy = gap.policy
    return Training(
        policy, so_far.history, learner, budget, seed, counts, time.perf_counter() - start,
        so_far.status or "complete", gap,
    )  # fmt: skip


def _learner(method: str | Learner[Any] | None, faithful: bool, settings: dict[str, Any]) -> Learner[Any]:
    """The requested learner, given by name or as an object."""
    if method is None or isinstance(method, str):
        return make(class_of(method, faithful), settings)
    if isinstance(method, type) and issubclass(method, Learner):
        raise SettingsError(f"method is the class {method.__name__}; give a learner, {method.__name__}(…)")
    if not isinstance(method, Learner):
        raise SettingsError(f"method is {described(method)}; give a learner, or one of the names {', '.join(METHODS)}")
    require_learner(method)
    if faithful:
        raise SettingsError("faithful=True selects among names; leave it out if method is a learner")
    if settings:
        raise SettingsError(
            f"{', '.join(settings)}: give settings to the learner itself, as in {type(method).__name__}"
            f"({next(iter(settings))}=…)"
        )
    recorded(method)
    return method


def _require_length(budget: Budget, length: int) -> None:
    if budget.most_steps is not None and budget.most_steps < length:
        raise SettingsError(
            f"{named('most_steps')} is {budget.most_steps}, and one episode takes {length}; allow at least one"
        )
    require_time(
        float(budget.episodes) * length, _RATE, f"{budget.episodes} episodes of {length} steps",
        "shorten the windows or take fewer episodes",
    )  # fmt: skip


def _environment(product: Product, given: BlackBox | None, rng: np.random.Generator, length: int) -> Environment:
    if given is None:
        return simulator(product.model, rng, length)
    return given if isinstance(given, Environment) else guarded(product.model, given)


@dataclass(frozen=True)
class _Decided:
    """The probability of a task decided by its first state; None if that state is unknown."""

    value: float | None


def _decided(product: Product, known_start: bool) -> _Decided | None:
    """Whether every run is decided at its first state; None if one is not."""
    known_start = known_start and product.model.blackbox is None
    states = np.flatnonzero(product.model.initial) if known_start else np.arange(product.model.n_states)
    verdicts = first_verdicts(with_early_verdicts(product), states)  # as in `Problem`
    if (verdicts == UNDECIDED).any():
        return None
    if known_start:
        return _Decided(check(product, keep_policy=False).probability)
    satisfied = verdicts == TRUE
    return _Decided(float(satisfied[0]) if satisfied.all() or not satisfied.any() else None)


class _Judge:
    """`evaluate` and `enough` of a trainer: exact if the model is known."""

    def __init__(self, home: Product, product: Product, budget: Budget) -> None:
        self.known = product.model.blackbox is None
        if not self.known and budget.stop_gap is not None:
            raise SettingsError(
                f"{named('stop_gap')} needs the exact optimum, and the model is a black box; set {named('episodes')} "
                "instead"
            )
        self._home, self._product = home, home if home.automaton.exact else product
        self._gap = budget.stop_gap
        self._best = check(product, keep_policy=False).probability if budget.stop_gap is not None else 0.0

    def evaluate(self, table: NDArray[Any] | Form) -> float | None:
        return check(self._product, Policy(self._home, table)).probability if self.known else None

    def enough(self, value: float) -> bool:
        return self._gap is not None and self._best - value <= self._gap


def _identity(product: Product, learner: Learner[Any], budget: Budget, seed: int) -> dict[str, Any]:
    """The properties, by name, that a checkpoint must share; not the number of episodes, which may be increased."""
    limits = recorded(budget)
    del limits["episodes"]
    return {
        "task": str(product.formula), "encoding": product.automaton.encoding, "model": product.model.digest(),
        "automaton": product.automaton.digest(), "method": learner.name, "faithful": learner.published, "seed": seed,
        **limits, **{f"setting {name}": value for name, value in recorded(learner).items()},
    }  # fmt: skip


class _Checkpoint:
    """The checkpoint file of a run: resuming from it, and saving to it."""

    def __init__(self, path: Path, what: dict[str, Any], trainer: Trainer, every: float, interrupt: Interrupt) -> None:
        if trainer.environment.generator is None:
            raise SettingsError(
                "a run can be resumed exactly only if the environment's random numbers are known; "
                f"give an Environment with its generator, or leave {named('checkpoint')} out"
            )
        self._path, self._what, self._trainer, self._every, self._interrupt = path, what, trainer, every, interrupt
        self._generators = [trainer.rng, trainer.environment.generator]
        require_generators(self._generators)
        kept_arrays(trainer)
        self._last = time.monotonic()

    def begin(self) -> Progress:
        """The progress of the run."""
        path = self._path
        if not path.exists():
            return Progress()
        return load_checkpoint(path, self._what, self._trainer, self._generators)

    def save(self, now: Progress) -> None:
        """Between two episodes: save the run when it is time, at its end, and before an interrupt."""
        due = time.monotonic() - self._last >= self._every
        if due or self._trainer.ends(now) or self._interrupt.asked:
            save_checkpoint(self._path, self._what, now, self._trainer, self._generators)
            self._last = time.monotonic()
        if self._interrupt.asked:
            raise KeyboardInterrupt
