"""Sweeps: every scenario with every method and every seed, with the same result however they are run.

A run is a pure function of its content: formula, model, method, settings, seed. A digest of these, the stored format
and the version of stltool is its *key*. A finished run is one file, `runs/<scenario>/<method>/seed-<n>.json`, written
whole or not at all, with its key; a file with another key counts as not done. So a sweep that was killed at any point
continues where it stopped, and ends in runs of the same bytes as one that was not; wall times are stored in separate
files.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import os
import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from importlib import metadata
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from stltool.arguments import described, function, require, texts, whole
from stltool.arguments import path as path_of
from stltool.checking import CheckResult, check
from stltool.choices import Choices
from stltool.display import Card, Displayed, counted, listed, probability_text
from stltool.errors import FileError, SettingsError, StlToolError, named, near_misses
from stltool.files import is_data, require_folder, require_own, write_result
from stltool.kernels import warm_up
from stltool.learning.learn import learn
from stltool.learning.learner import Learner
from stltool.learning.methods import make
from stltool.learning.pool import require_main_process, spread
from stltool.learning.settings import Budget, recorded, settings_of, split
from stltool.logic.formula import horizon
from stltool.logic.parser import parse
from stltool.logic.task import Task
from stltool.models import MDP
from stltool.product import Product, build_product

FORMAT = "stltool-run-1"
_RUN = "run of a sweep"
_MOST_SEEDS = 1_000_000
_SHOWN = 10  # rows of results in a notebook
_PROBE = 10  # episodes from which times are estimated


@dataclass(frozen=True)
class Method:
    """A learner with settings of its own; `id` names it in tables and folders."""

    id: str
    learner: type[Learner[Any]]
    settings: Mapping[str, Any]

    @property
    def name(self) -> str:
        return self.learner.name

    @property
    def faithful(self) -> bool:
        return self.learner.published


@dataclass(frozen=True, eq=False, repr=False)
class Scenario(Displayed):
    """A task on a model, with settings; `published` are figures by method id, shown next to those of the sweep."""

    id: str
    task: Task
    model: MDP
    settings: Mapping[str, Any]
    published: Mapping[str, float]

    def _card(self) -> Card:
        return Card(
            f"Scenario {self.id}: {self.task}", [{"model": self.model.name, "published": self.published or None}]
        )

    @functools.cached_property
    def product(self) -> Product:
        return build_product(self.model, self.task)

    @functools.cached_property
    def optimum(self) -> CheckResult:
        """The check over all policies."""
        return check(self.product, keep_policy=False)


@dataclass(frozen=True, eq=False)
class Run:
    """One training run, all that a worker needs."""

    scenario: str
    method: str
    seed: int
    formula: str
    model: MDP
    learner: Learner[Any]
    budget: Budget
    version: str

    @property
    def name(self) -> str:
        return f"{self.scenario} {self.method} seed {self.seed}"

    @functools.cached_property
    def key(self) -> str:
        """A SHA-256 of everything that the result depends on."""
        learner, budget = self.learner, self.budget
        content = [FORMAT, self.version, self.formula, self.model.digest(), learner.name, learner.published,
                   recorded(learner), recorded(budget), self.seed]  # fmt: skip
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    @property
    def work(self) -> float:
        """The relative cost of the run, very roughly: its steps."""
        return float(self.budget.episodes) * (horizon(parse(self.formula)) + 2)


@dataclass(frozen=True, eq=False)
class RunResult:
    """A finished run: its exact learning curve, a digest of the final policy's table, and its wall time."""

    scenario: str
    method: str
    seed: int
    episode: list[int]
    steps: list[int]
    probability: list[float]
    policy: str
    seconds: float


class Failure(NamedTuple):
    """A run that ended without a result, and why."""

    scenario: str
    method: str
    seed: int
    message: str


class SweepProgress(NamedTuple):
    """Runs done and to do in this call, environment steps so far, and roughly the share of the time that has passed."""

    done: int
    total: int
    steps: int
    share: float


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(Displayed):
    """Scenarios × methods × seeds.

    columns  panels in a row of the figure
    story    whether the report shows the surrogate's gap and the encodings' sizes, too (reporting/story.py)
    """

    name: str
    scenarios: tuple[Scenario, ...]
    methods: tuple[Method, ...]
    seeds: tuple[int, ...]
    settings: Mapping[str, Any]
    columns: int
    story: bool

    def _card(self) -> Card:
        parts = ((self.scenarios, "scenario"), (self.methods, "method"), (self.seeds, "seed"))
        return Card(
            f"Sweep {self.name}: {' x '.join(counted(len(part), what) for part, what in parts)}",
            [
                {"scenarios": listed((scenario.id for scenario in self.scenarios), 12)},
                {"methods": listed(method.id for method in self.methods)},
            ],
        )

    def select(
        self,
        scenarios: Sequence[str] | None = None,
        methods: Sequence[str] | None = None,
        seeds: int | Sequence[int] | None = None,
    ) -> Sweep:
        """A part of the sweep, in its order; `seeds` as in the file: a number or a list, which may contain others."""
        scenarios = texts(scenarios, "select's scenarios") if scenarios is not None else None
        methods = texts(methods, "select's methods") if methods is not None else None
        return dataclasses.replace(
            self,
            scenarios=_chosen(self.scenarios, scenarios, "scenario"),
            methods=_chosen(self.methods, methods, "method"),
            seeds=self.seeds if seeds is None else read_seeds(seeds),
        )

    def settled(self, scenario: Scenario, method: Method) -> tuple[Learner[Any], Budget]:
        """The learner and the budget of a method in a scenario: the sweep's settings, overridden by the
        scenario's, overridden by the method's. Of the first two, each method uses those it has."""
        shared = {**self.settings, **scenario.settings}
        budget, _ = split({**shared, **method.settings})
        own = {name: value for name, value in shared.items() if name in settings_of(method.learner)}
        return make(method.learner, {**own, **split(method.settings)[1]}), Budget(**budget)

    def runs(self) -> list[Run]:
        """The cross product, scenario by scenario."""
        version = metadata.version("stltool")
        return [
            Run(
                scenario.id, method.id, seed, str(scenario.task.formula), scenario.model,
                *self.settled(scenario, method), version,
            )
            for scenario in self.scenarios for method in self.methods for seed in self.seeds
        ]  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class SweepResult(Displayed):
    """The finished runs of a sweep, in order, and the failed ones; `skipped` runs were finished earlier.

    damaged    files of runs that were changed since, or cut: such a run counts as not done
    """

    sweep: Sweep
    runs: list[RunResult]
    failures: list[Failure]
    skipped: int
    damaged: list[str] = field(default_factory=list)

    def _card(self) -> Card:
        ends: dict[tuple[str, str], list[float]] = {}
        for run in self.runs:
            ends.setdefault((run.scenario, run.method), []).append(run.probability[-1])
        rows = [(*key, len(found), *map(probability_text, (min(found), max(found)))) for key, found in ends.items()]
        return Card(
            f"SweepResult: {counted(len(self.runs), 'run')} finished, {len(self.failures)} failed",
            [
                {"sweep": self.sweep.name, "finished before": self.skipped},
                {"first failure": self.failures[0].message if self.failures else None},
            ],
            (("scenario", "method", "runs", "least P at the end", "greatest"), rows[:_SHOWN]),
            more=max(0, len(rows) - _SHOWN),
        )


def run_sweep(
    sweep: Sweep,
    folder: str | Path,
    *,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Callable[[SweepProgress], None] | None = None,
) -> SweepResult:
    """Do the runs that `folder` does not have yet, and return them all.

    workers    processes (default: the machine's cores); 1 runs everything in this one
    cluster    the address of a dask scheduler whose workers do the runs instead; results come back here
    progress   called when a run is done

    Raises SettingsError if workers or cluster are not available, FileError if another sweep uses the folder. A run that
    fails is listed among the failures of the result, and the others continue. An interrupt loses the unfinished runs.
    """
    require(sweep, Sweep, "run_sweep's sweep")
    folder = path_of(folder, "run_sweep's folder")
    require(cluster, str, "run_sweep's cluster", "write the scheduler's address in quotes", optional=True)
    function(progress, "run_sweep's progress")
    workers = whole(workers, "workers", least=1) if workers is not None else os.cpu_count() or 1
    require_main_process()
    require_folder(folder)
    with _locked(folder):
        finished, waiting, damaged = _plan(sweep, folder)
        for place in (place for run in waiting for place in _place(folder, run)):
            require_own(place, _RUN, is_data)
        failures: list[Failure] = []
        skipped, steps, done = len(finished), 0, 0
        if cluster is None:
            _warm_up(waiting)  # compiled once, here, not by each worker
        pace = _Pace(waiting)
        with closing(spread(_execute, waiting, workers, cluster)) as outcomes:
            for run, outcome in outcomes:
                done += 1
                pace.passed(run, outcome.seconds if isinstance(outcome, RunResult) else 0.0)
                if isinstance(outcome, RunResult):
                    _store(folder, run, outcome)
                    finished[run.name] = outcome
                    steps += outcome.steps[-1]
                else:
                    failures.append(Failure(run.scenario, run.method, run.seed, outcome))
                if progress is not None:
                    progress(SweepProgress(done, len(waiting), steps, pace.share))
    order = {run.name: i for i, run in enumerate(sweep.runs())}
    failures.sort(key=lambda failure: order[f"{failure.scenario} {failure.method} seed {failure.seed}"])
    return SweepResult(sweep, [finished[name] for name in order if name in finished], failures, skipped, damaged)


def finished_runs(sweep: Sweep, folder: str | Path) -> SweepResult:
    """The runs of the sweep in `folder`; nothing is run."""
    finished, _, damaged = _plan(sweep, Path(folder))
    return SweepResult(sweep, list(finished.values()), [], len(finished), damaged)


def estimated_seconds(sweep: Sweep, folder: str | Path) -> dict[tuple[str, str], float]:
    """Approximate seconds per seed for each scenario and method still to be run, from a few episodes of it.

    Three short runs measure a start, an episode and an evaluation.
    """
    _, waiting, _ = _plan(sweep, Path(folder))
    _warm_up(waiting)
    seconds = {}
    for run in {(run.scenario, run.method): run for run in waiting}.values():
        few = _seconds(run, _PROBE, _PROBE)
        evaluation = max(0.0, _seconds(run, _PROBE, 1) - few) / (_PROBE - 1)
        episode = max(0.0, _seconds(run, 10 * _PROBE, 10 * _PROBE) - few) / (9 * _PROBE)
        start = max(0.0, few - evaluation - _PROBE * episode)
        evaluations = -(-run.budget.episodes // run.budget.evaluate_every)
        seconds[run.scenario, run.method] = start + run.budget.episodes * episode + evaluations * evaluation
    return seconds


def _seconds(run: Run, episodes: int, evaluate_every: int) -> float:
    """Wall time of the run with other settings, the better of two; 0 if it fails."""
    short = dataclasses.replace(run.budget, episodes=episodes, evaluate_every=evaluate_every)
    outcomes = [_execute(dataclasses.replace(run, budget=short)) for _ in range(2)]
    return min(outcome.seconds if isinstance(outcome, RunResult) else 0.0 for outcome in outcomes)


def read_seeds(given: Any) -> tuple[int, ...]:
    """Seeds as a number of them (3: 0, 1, 2) or as a list of different integers from 0."""
    if type(given) is int and given > _MOST_SEEDS:
        raise SettingsError(f"{named('seeds')} is {described(given)}; write a number up to {_MOST_SEEDS}")
    seeds = list(range(given)) if type(given) is int else given
    fine = isinstance(seeds, list | tuple) and all(type(seed) is int and seed >= 0 for seed in seeds)
    if not fine or not seeds or len(set(seeds)) < len(seeds):
        raise SettingsError(
            f"{named('seeds')} is {described(given)}; write a number of seeds, or a list of different integers from 0"
        )
    return tuple(seeds)


# ------------------------------------------------------------------------------------------------------ the runs


class _Pace:
    """The share of the time that has passed: runs are expected to take as long as earlier ones, or by `work`."""

    def __init__(self, waiting: Sequence[Run]) -> None:
        self._left: dict[tuple[str, str], int] = {}
        self._seen: dict[tuple[str, str], list[float]] = {}
        self._work = {(run.scenario, run.method): run.work for run in waiting}
        for run in waiting:
            group = run.scenario, run.method
            self._left[group] = self._left.get(group, 0) + 1

    def passed(self, run: Run, seconds: float) -> None:
        group = run.scenario, run.method
        self._left[group] -= 1
        self._seen.setdefault(group, []).append(seconds)

    @property
    def share(self) -> float:
        spent = sum(sum(seconds) for seconds in self._seen.values())
        worked = sum(self._work[group] * len(seconds) for group, seconds in self._seen.items())
        left = 0.0
        for group, count in self._left.items():
            seen = self._seen.get(group)
            left += count * (sum(seen) / len(seen) if seen else self._work[group] * spent / worked)
        return spent / (spent + left) if spent else 0.0


def _execute(run: Run) -> RunResult | str:
    """In a worker: the result, or why there is none."""
    try:
        here = metadata.version("stltool")
        if here != run.version:
            return f"the worker has stltool {here}, and the sweep has {run.version}; install the same version on both"
        warm_up(*run.learner.kernels)
        start = time.perf_counter()
        product = build_product(run.model, parse(run.formula))
        training = learn(product, run.learner, seed=run.seed, **recorded(run.budget))
    except StlToolError as error:
        return str(error)
    except Exception:  # our own fault: reported in full, and the other runs continue
        return f"a bug in stltool, please report it:\n{traceback.format_exc()}"
    form, sha = training.policy.form, hashlib.sha256()
    for array in form.arrays().values() if isinstance(form, Choices) else [training.policy.table]:
        sha.update(f"{array.dtype.str}{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return RunResult(
        run.scenario, run.method, run.seed,
        [point.episode for point in training.history],
        [point.steps for point in training.history],
        [cast(float, point.probability) for point in training.history],  # the model is known
        sha.hexdigest(),
        time.perf_counter() - start,
    )  # fmt: skip


def _warm_up(runs: Iterable[Run]) -> None:
    """Load the kernels that these runs need."""
    warm_up(*sorted({group for run in runs for group in run.learner.kernels}))


# ------------------------------------------------------------------------------------------------------ the store


def _place(folder: Path, run: Run) -> tuple[Path, Path]:
    """The files of a run: its result, and its wall time."""
    where = folder / "runs" / run.scenario / run.method
    return where / f"seed-{run.seed}.json", where / f"seed-{run.seed}.time.json"


def _store(folder: Path, run: Run, result: RunResult) -> None:
    place, clock = _place(folder, run)
    times = {"format": FORMAT, "key": run.key, "seconds": result.seconds}
    write_result(clock, json.dumps(times) + "\n", _RUN, is_data)
    found = dataclasses.asdict(result)
    del found["seconds"]
    content = {"format": FORMAT, "key": run.key, "digest": _digest(found), **found}
    # last: its existence marks the run as finished
    write_result(place, json.dumps(content, indent=1) + "\n", _RUN, is_data)


def _digest(found: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()


def _plan(sweep: Sweep, folder: Path) -> tuple[dict[str, RunResult], list[Run], list[str]]:
    """The finished runs, and those to be run: seed by seed, the longest first within each seed, so that every part has
    early results and no long run is left for the end. Also the files of runs that are damaged.
    """
    finished, waiting, damaged = {}, [], []
    for run in sweep.runs():
        try:
            found = _stored(folder, run)
        except _Damaged as error:
            found = None
            damaged.append(str(error))
        if found is not None:
            finished[run.name] = found
        else:
            waiting.append(run)
    turn = {seed: i for i, seed in enumerate(sweep.seeds)}
    waiting.sort(key=lambda run: (turn[run.seed], -run.work))
    return finished, waiting, damaged


class _Damaged(Exception):
    """A stored run that was not written so; the file."""


def _stored(folder: Path, run: Run) -> RunResult | None:
    """The finished run, None if there is none, or one with another key."""
    place, clock = _place(folder, run)
    if not place.exists() or not clock.exists():
        return None  # never finished
    try:
        content, timed = (json.loads(path.read_text(encoding="utf-8")) for path in (place, clock))
        if content.pop("key") != run.key or timed["key"] != run.key or content.pop("format") != FORMAT:
            return None  # of other settings, or of another version
        digest = content.pop("digest")
        found = RunResult(**content, seconds=timed["seconds"])
        if digest != _digest(content) or not _is_of(run, found):
            raise _Damaged(str(place))
        return found
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        raise _Damaged(str(place)) from None


def _is_of(run: Run, found: RunResult) -> bool:
    """Whether a result is one that the run can have."""
    counts = (found.episode, found.steps)
    return (
        (found.scenario, found.method, found.seed) == (run.scenario, run.method, run.seed)
        and type(found.policy) is str
        and type(found.seconds) is float
        and 0 <= found.seconds < float("inf")
        and 0 < len(found.episode) == len(found.steps) == len(found.probability)
        and all(type(n) is int and n >= 0 for count in counts for n in count)
        and all(a < b for a, b in pairwise(found.episode))
        and all(a <= b for a, b in pairwise(found.steps))
        and all(type(p) is float and 0 <= p <= 1 for p in found.probability)
    )


def _locked(folder: Path) -> Any:
    """The lock of the folder, which is released when the process that holds it ends."""
    from filelock import FileLock, Timeout

    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / "sweep.lock")
    try:
        return lock.acquire(timeout=0)
    except Timeout:
        raise FileError(
            f"{folder}: another sweep is running there; wait until it ends, or name another folder (--out)"
        ) from None


def _chosen(known: Iterable[Any], ids: Sequence[str] | None, kind: str) -> tuple[Any, ...]:
    known = tuple(known)
    if ids is None:
        return known
    for wanted in ids:
        if wanted not in [one.id for one in known]:
            raise SettingsError(f"the sweep has no {kind} {wanted!r}; {near_misses(wanted, [one.id for one in known])}")
    return tuple(one for one in known if one.id in ids)
