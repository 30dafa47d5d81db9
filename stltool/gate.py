"""`verify`: whether task files keep what they promise. Every `expect` line is judged, and the answers are collected.

Each model is read once, each product built once, and each question answered once, however many expectations share it.
A probability is compared with its bound by its enclosure; if the bound lies inside, by the exact fraction, unless that
would take too long. All files are read before anything is computed.

`robust` asks for what is guaranteed whatever the probabilities are in their intervals, so nature opposes the claim: it
minimises the probability in claims of >= and >, and maximises it in claims of <= and <.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, TypeAlias, cast

from stltool.arguments import function, mapping, require
from stltool.arguments import path as path_of
from stltool.checking import CheckResult, check, robust_check, write_certificate
from stltool.checking.certificate import require_certificate_file
from stltool.checking.induction import Progress
from stltool.diagnosis import Diagnosis, diagnose
from stltool.display import Card, Displayed, counted
from stltool.errors import ModelError, SettingsError, SizeError, StlToolError, TraceError, all_told, near_misses
from stltool.files import require_folder
from stltool.logic.expectation import Expectation, Relation
from stltool.logic.formula import Formula, horizon, is_bounded, label_names, variables
from stltool.logic.parser import Survey, survey_task
from stltool.logic.quantities import ParamValue
from stltool.logic.task import Task
from stltool.models import MDP, load_model
from stltool.models.loading import Deadlocks, Loading
from stltool.monitoring import MonitorResult, monitor
from stltool.monitoring.coverage import Coverage, idle_premises
from stltool.monitoring.logs import Log, Reading
from stltool.monitoring.logs.clock import TOLERANCE, Resample
from stltool.monitoring.logs.recording import Missing
from stltool.policy import load_policy
from stltool.product import Product, build_product, require_names
from stltool.sizes import require_limit, seconds_of

Verdict: TypeAlias = Literal["holds", "does not hold", "undecided", "error"]
DecidedBy: TypeAlias = Literal["enclosure", "fraction", "trace"]
Stage: TypeAlias = Callable[[str], AbstractContextManager[Progress | None]]

EXACT_SECONDS = 60.0  # that an exact fraction may take, by estimate
_VERDICTS: dict[bool | None, Verdict] = {True: "holds", False: "does not hold", None: "undecided"}


@dataclass(frozen=True)
class Certified:
    """A certificate that was written, the bounds it proves, and whether these decide the expectation."""

    path: Path
    lower: Fraction
    upper: Fraction
    decides: bool


@dataclass(frozen=True, repr=False)
class Verified(Displayed):
    """One expectation, and how it was judged.

    verdict      "holds", "does not hold", "undecided" (the bound lies inside the enclosure), or "error"
    decided_by   "enclosure", "fraction" or "trace"; None without a verdict, and `reason` states why, or that a trace
                 satisfies the formula only because a premise never held
    result       the check, with its product; `monitored` the verdicts on a trace, of which step 0 counts
    diagnosis    why a trace fails, in a batch the first that does
    coverage, count   what traces say about the formula, and the number of it that `expect cover(…)` asks for
    """

    path: Path
    task: Task
    expectation: Expectation
    verdict: Verdict
    decided_by: DecidedBy | None = None
    reason: str | None = None
    result: CheckResult | None = None
    monitored: MonitorResult | None = None
    diagnosis: Diagnosis | None = None
    certificate: Certified | None = None
    coverage: Coverage | None = None
    count: int | None = None
    seconds: float = 0.0

    @property
    def line(self) -> int:
        """The expectation's line in its file."""
        return self.expectation.span.line if self.expectation.span is not None else 1

    def _card(self) -> Card:
        facts = {"decided by": self.decided_by, "reason": self.reason}
        return Card(f"Verified: {self.verdict}, {self.path}:{self.line}: {self.expectation.written}", [facts])


@dataclass(frozen=True, repr=False)
class Verification(Displayed):
    """All expectations of some task files, in order; `quiet` are the files without any."""

    files: tuple[Path, ...]
    results: tuple[Verified, ...]
    quiet: tuple[Path, ...] = ()
    seconds: float = 0.0

    @property
    def holds(self) -> bool:
        """Whether every expectation holds."""
        return all(result.verdict == "holds" for result in self.results)

    def count(self) -> dict[Verdict, int]:
        """The number of expectations with each verdict."""
        verdicts: tuple[Verdict, ...] = ("holds", "does not hold", "undecided", "error")
        return {verdict: sum(result.verdict == verdict for result in self.results) for verdict in verdicts}

    def _card(self) -> Card:
        found = "; ".join(f"{n} {verdict}" for verdict, n in self.count().items() if n)
        rows = [(result.verdict, f"{result.path}:{result.line}", result.expectation.written) for result in self.results]
        title = f"Verification: {counted(len(self.results), 'expectation')}: {found}"
        return Card(title, [{"files": len(self.files)}], (("verdict", "at", "expectation"), rows))


def verify(
    files: str | Path | Sequence[str | Path],
    *,
    params: Mapping[str, ParamValue] | None = None,
    normalize: bool = False,
    initial: str | int | Sequence[str | int] | None = None,
    deadlocks: Deadlocks = "loop",
    certificates: str | Path | None = None,
    exact_seconds: float = EXACT_SECONDS,
    memory_limit: int | None = None,
    stage: Stage | None = None,
    time: str | None = None,
    resample: Resample | None = None,
    tolerance: float = TOLERANCE,
    decimal: str = ".",
    missing: Missing = "error",
) -> Verification:
    """Judge every expectation of one or several task files.

    params          values of params, in every file that has one of that name; the others are values of parameters of
                    the models
    normalize, initial, deadlocks     how models are read: as for `load_model`
    certificates    a folder that receives a certificate of every probability, unless parameters have no value
    exact_seconds   where a bound lies inside an enclosure, the exact fraction is computed if it takes no longer than
                    this, by estimate; otherwise the expectation is undecided
    time, resample, tolerance, decimal, missing     how traces are read: as for `load_trace`
    stage           called with the title of each longer step; returns a context manager that yields a progress
                    function (done, total), or None

    Raises StlToolError, before anything is computed, with all faults of the files: texts that do not parse, models,
    policies and traces that are missing, files without any expectation. What goes wrong later (a policy of another
    model, a product that would not fit into memory) is the "error" of that expectation; the others are judged.
    """
    start = perf_counter()
    paths = _paths(files)
    mapping(params, "verify's params", "{'T': 20}", optional=True)
    reading = Reading(time, resample, tolerance, decimal, missing)
    loading = Loading.of(normalize, initial, deadlocks)
    function(stage, "verify's stage")
    seconds = seconds_of(exact_seconds, "exact_seconds")
    memory_limit = require_limit(memory_limit) if memory_limit is not None else None
    folder = path_of(certificates, "verify's certificates") if certificates is not None else None
    told = _staged(stage) if stage is not None else lambda title: nullcontext()
    gate = Gate(dict(params or {}), loading, seconds, memory_limit, told, reading)
    tasks = gate.read(paths)
    if folder is not None:
        require_folder(folder)
        gate.certificates_in(folder, tasks)
    results = [gate.judge(task, expectation) for task in tasks for expectation in task.expectations]
    quiet = tuple(path for path, task in zip(paths, tasks, strict=True) if not task.expectations)
    return Verification(tuple(paths), tuple(results), quiet, perf_counter() - start)


def _staged(stage: Stage) -> Stage:
    """ArgumentError if what the function returns is not a context manager."""

    def staged(title: str) -> AbstractContextManager[Progress | None]:
        made = stage(title)
        require(
            made, AbstractContextManager, "what verify's stage returns", "return one, e.g. contextlib.nullcontext()"
        )
        return made

    return staged


def _paths(files: object) -> list[Path]:
    if isinstance(files, str | Path):
        files = [files]
    require(files, (list, tuple), "verify's files", "give one path, or a list of them")
    paths = [path_of(file, "one of verify's files") for file in cast(list[object], files)]
    if not paths:
        raise SettingsError("verify's files are an empty list; name a task file")
    return list(dict.fromkeys(paths))


def task_reads(task: Task) -> Iterator[Path]:
    """The policies and traces that a task's expectations name."""
    for expectation in task.expectations:
        for file in (expectation.policy, expectation.trace):
            if file is not None:
                yield task.folder / file


@dataclass(frozen=True)
class _Asked:
    """A question that several expectations may share."""

    product: Product
    question: str
    policy: Path | None
    minimal: bool | None  # nature's aim; None: one distribution

    @property
    def key(self) -> tuple[Any, ...]:
        policy = self.policy.resolve() if self.policy is not None else None
        return id(self.product), self.question, policy, self.minimal


@dataclass
class Gate:
    """Judges the expectations of task files one by one: `read`, then `judge`. What they share is computed once.

    The fields up to `reading` are the settings of `verify`.
    """

    params: dict[str, ParamValue] = field(default_factory=dict)
    loading: Loading = field(default_factory=Loading)
    exact_seconds: float = EXACT_SECONDS
    memory_limit: int | None = None
    stage: Stage = lambda title: nullcontext()
    reading: Reading = field(default_factory=Reading)
    loaded: dict[Path, MDP] = field(default_factory=dict)
    models: dict[tuple[Path, frozenset[str]], MDP] = field(default_factory=dict)  # with values of these parameters
    products: dict[tuple[int, Formula], Product] = field(default_factory=dict)
    checked: dict[tuple[Any, ...], CheckResult] = field(default_factory=dict)
    exactly: dict[tuple[Any, ...], CheckResult | str] = field(default_factory=dict)
    certificate_names: dict[tuple[Path, Expectation], Path] = field(default_factory=dict)  # the first of that name
    certificates_of_name: Counter[Path] = field(default_factory=Counter)
    certified: dict[tuple[Any, ...], tuple[Path, Fraction, Fraction]] = field(default_factory=dict)
    covered: dict[tuple[Any, ...], Coverage] = field(default_factory=dict)

    # ------------------------------------------------------------------------------------------------------- reading

    def read(self, paths: Sequence[Path]) -> list[Task]:
        """The tasks, with their models read; StlToolError lists all faults."""
        tasks: list[Task] = []
        faults: list[str] = []
        named: set[str] = set()
        for path in paths:
            try:
                read = survey_task(path, self.params)
            except StlToolError as error:
                faults.append(str(error))
                continue
            named |= read.params
            faults += read.faults
            faults += [fault for fault in dict.fromkeys(self._faults(read)) if fault not in faults]
            tasks += [read.task] if read.task is not None else []
        if not faults and not any(task.expectations for task in tasks):
            files = ", ".join(map(str, paths))
            faults.append(
                f"{files}: no expectations to verify; add a line such as expect Pmax({tasks[-1].name}) >= 0.95"
            )
        if not faults:
            faults += self._unused(named.union(*(values for _, values in self.models)))
        timed = any(task.step is not None and any(one.trace for one in task.expectations) for task in tasks)
        if not faults and not timed and (given := self.reading.times_asked):
            faults.append(
                f"{given}: no task file that declares a step has an expectation on a trace; leave it out, or add a "
                "line such as step = 0.1s"
            )
        if len(faults) == 1:
            raise StlToolError(faults[0])
        if faults:
            raise StlToolError(all_told(faults))
        return tasks

    def _unused(self, named: set[str]) -> list[str]:
        """The given params that are of no file and no model."""
        unused = self.params.keys() - named
        known = named.union(*map(_parameters, self.loaded.values())) if unused else named
        says = "no task file has a param, and no model a parameter, of this name"
        return [f"{name}: {says}; {near_misses(name, known)}" for name in sorted(unused)]

    def _faults(self, read: Survey) -> list[str]:
        """What is wrong with the expectations that could be read, before any of them is judged."""
        faults = []
        for expectation in read.expectations:
            for file, what in ((expectation.policy, "policy file"), (expectation.trace, "trace file")):
                if file is not None and not (read.path.parent / file).is_file():
                    path = read.path.parent / file
                    fault = "is not a regular file" if path.exists() else "does not exist"
                    faults.append(_at(expectation, f"the {what} {path} {fault}; paths are relative to the task file"))
            if expectation.question in ("holds", "cover"):
                continue
            try:
                horizon(expectation.formula)
            except StlToolError as error:
                faults.append(str(error))
            if read.model is None:
                if not read.faults:  # one of them may be the model line's
                    told = 'the task file names no model; add a line such as model "floor.toml"'
                    faults.append(_at(expectation, told))
                continue
            try:
                model = self._model(read.model, read.params)
                unfit = _unfit(expectation, model)
                if unfit is not None:
                    faults.append(_at(expectation, unfit))
                    continue
                task = read.task if expectation.name is not None else None
                require_names(model, expectation.formula, task, tuple(read.definitions))
            except StlToolError as error:
                faults.append(str(error))
        return faults

    def _model(self, path: Path, declared: Iterable[str]) -> MDP:
        """The model of a task file with these params; its parameters have the values given for other names."""
        place = path.resolve()
        if place not in self.loaded:
            with self.stage(f"reading {path}"):
                self.loaded[place] = load_model(path, **{**vars(self.loading), "initial": self.loading.initial or None})
        model = self.loaded[place]
        others = self.params.keys() - set(declared)
        names = frozenset(others.intersection(_parameters(model)) if others else ())
        if (place, names) not in self.models:
            values: Any = {name: self.params[name] for name in names}
            self.models[place, names] = model.at(**values) if names else model
        return self.models[place, names]

    # ------------------------------------------------------------------------------------------------------- judging

    def judge(self, task: Task, expectation: Expectation) -> Verified:
        """The verdict on an expectation of a task that `read` returned."""
        start = perf_counter()
        path = task.path
        assert path is not None  # it was read from a file
        try:
            if expectation.question == "holds":
                found = self._on_trace(task, expectation)
            elif expectation.question == "cover":
                found = self._on_traces(task, expectation)
            else:
                found = self._probability(task, expectation)
        except StlToolError as error:
            found = Verified(path, task, expectation, "error", reason=_as_written(str(error), task, expectation))
        return replace(found, seconds=perf_counter() - start)

    def _on_trace(self, task: Task, expectation: Expectation) -> Verified:
        assert expectation.trace is not None
        assert task.path is not None
        phi = expectation.formula
        with self.stage(f"judging {expectation.asked}"):
            log = self._log(task, phi, expectation.trace)
            with _of_file(task.folder / expectation.trace):
                found = monitor(phi, log.signals, end="error" if is_bounded(phi) else "cut")
        assert found.verdicts is not None
        verdict = _VERDICTS[bool(found.verdicts[..., 0].all())]
        why = None
        reason = _vacuously(phi, log) if verdict == "holds" else None
        if verdict != "holds":
            with self.stage(f"finding why {expectation.asked} fails") as bar:
                verdicts = found.verdicts
                failing = int(verdicts[:, 0].argmin()) if verdicts.ndim == 2 else None
                one = {name: values if failing is None else values[failing] for name, values in log.signals.items()}
                why = diagnose(replace(task, formula=phi), one, end=found.end, progress=bar)
        return Verified(task.path, task, expectation, verdict, "trace", reason, monitored=found, diagnosis=why)

    def _log(self, task: Task, phi: Formula, file: str) -> Log:
        names = {**variables(phi), **label_names(phi)}
        if not names:
            raise SettingsError(f"{phi}: this formula is constant; name a signal or a label of the trace")
        reading = self.reading if task.step is not None else self.reading.untimed()
        return reading.log(task.folder / file, list(names), task.step, label_names(phi))

    def _on_traces(self, task: Task, expectation: Expectation) -> Verified:
        phi, files = expectation.formula, traces_of(task.expectations, expectation)
        if not files:
            trace = 'trace "log.csv"'
            raise SettingsError(
                f"{expectation.subject} is counted over traces, and there are none; name one, cover(…, {trace}), or "
                f"judge the formula on one, expect holds({expectation.name or phi}, {trace}); stltool monitor "
                "--coverage and pytest count theirs"
            )
        key = task.path, phi, files
        if key not in self.covered:
            coverage = Coverage(phi)
            with self.stage(f"counting for {expectation.asked}"):
                for file in files:
                    log = self._log(task, phi, file)
                    with _of_file(task.folder / file):
                        coverage.add_all(log.signals)
            self.covered[key] = coverage
        return covered(task, expectation, self.covered[key])

    def _probability(self, task: Task, expectation: Expectation) -> Verified:
        assert task.path is not None
        relation, bound = expectation.relation, expectation.bound
        assert relation is not None
        assert bound is not None
        asked = self._asked(task, expectation)
        result = self._answer(asked, expectation)
        by: DecidedBy
        holds, by, reason = decided(result, relation, bound), "enclosure", None
        if holds is None:
            exact = self._exactly(asked, expectation)
            if isinstance(exact, CheckResult):
                result, holds, by = exact, decided(exact, relation, bound), "fraction"
            else:
                reason = f"the bound lies inside the enclosure, and {exact}"
        done = Verified(
            task.path, task, expectation, _VERDICTS[holds], by if holds is not None else None, reason, result
        )
        name = self.certificate_names.get((task.path, expectation))
        if name is None or asked.product.model.parameters:  # without values they have no certificate
            return done
        return replace(done, certificate=self._certify(asked, done, name))

    def _asked(self, task: Task, expectation: Expectation) -> _Asked:
        assert task.model is not None
        model, phi = self._model(task.model, task.params), expectation.formula
        key = (id(model), phi)
        if key not in self.products:
            given = replace(task, name=expectation.name, formula=phi) if expectation.name is not None else phi
            with self.stage(f"compiling {expectation.subject}"):
                self.products[key] = build_product(model, given)
        minimal = expectation.relation in (">=", ">") if expectation.robust else None
        policy = task.folder / expectation.policy if expectation.policy is not None else None
        return _Asked(self.products[key], expectation.question, policy, minimal)

    def _answer(self, asked: _Asked, expectation: Expectation) -> CheckResult:
        if asked.key not in self.checked:
            self.checked[asked.key] = self._compute(asked, expectation, exact=False)
        return self.checked[asked.key]

    def _exactly(self, asked: _Asked, expectation: Expectation) -> CheckResult | str:
        """The exact answer, or why there is none."""
        if asked.minimal is not None and asked.product.model.parameters:
            return "there is no exact arithmetic for parameters without values"
        if asked.key not in self.exactly:
            try:
                self.exactly[asked.key] = self._compute(asked, expectation, exact=True)
            except SizeError as error:
                self.exactly[asked.key] = f"the exact fraction is not computed: {str(error).partition(';')[0]}"
            except ModelError as error:
                self.exactly[asked.key] = f"there is no exact fraction: {error}"
        return self.exactly[asked.key]

    def _compute(self, asked: _Asked, expectation: Expectation, exact: bool) -> CheckResult:
        product, maximize = asked.product, asked.question != "Pmin"
        policy = load_policy(asked.policy, product) if asked.policy is not None else None
        options: dict[str, Any] = {"maximize": maximize, "keep_policy": False, "memory_limit": self.memory_limit}
        how = " as a fraction" if exact else ""
        with self.stage(f"checking {expectation.asked}{how}") as progress:
            if exact:
                options |= {"exact": True, "time_limit": self.exact_seconds}
            if asked.minimal is not None:
                nature: Literal["against", "with"] = "against" if asked.minimal == maximize else "with"
                return robust_check(product, policy, nature=nature, progress=progress, **options)
            return check(product, policy, progress=progress, **options)

    # -------------------------------------------------------------------------------------------------- certificates

    def certificates_in(self, folder: Path, tasks: Sequence[Task]) -> None:
        """Choose a file for every certificate, before the work; FileError if one cannot be written."""
        asked: Counter[Path] = Counter()
        for task in tasks:
            for expectation in task.expectations:
                if expectation.question in ("holds", "cover"):
                    continue
                assert task.path is not None
                subject = expectation.name if expectation.name is not None else f"line-{expectation.span.line}"  # type: ignore[union-attr]
                first = folder / f"{task.path.stem}-{subject}-{expectation.question}.jsonl.gz"
                asked[first] += 1
                require_certificate_file(_numbered(first, asked[first]))
                self.certificate_names[task.path, expectation] = first

    def _certify(self, asked: _Asked, done: Verified, first: Path) -> Certified:
        """The certificate of an answer; expectations that share it share the file."""
        assert done.result is not None
        key = (*asked.key, done.result.fraction is not None)
        if key not in self.certified:
            self.certificates_of_name[first] += 1
            path = _numbered(first, self.certificates_of_name[first])
            with self.stage(f"certifying {done.expectation.asked}") as progress:
                lower, upper = write_certificate(done.result, path, self.memory_limit, progress)
            self.certified[key] = (path, lower, upper)
        path, lower, upper = self.certified[key]
        relation, bound = done.expectation.relation, done.expectation.bound
        assert relation is not None
        assert bound is not None
        proves = _compared(relation, bound, lower, upper)
        return Certified(path, lower, upper, proves is not None)


def _numbered(first: Path, number: int) -> Path:
    """a.jsonl.gz, a-2.jsonl.gz, a-3.jsonl.gz, …"""
    return first if number == 1 else first.with_name(f"{first.name.removesuffix('.jsonl.gz')}-{number}.jsonl.gz")


def _vacuously(phi: Formula, log: Log) -> str | None:
    """What a pass does not say: premises that held at no step of any trace."""
    idle = idle_premises(phi, log.signals)
    if not idle:
        return None
    told = "its premise {} holds at no step" if len(idle) == 1 else "its premises {} hold at no step"
    return f"vacuously: {told.format(' and '.join(idle))}"


def traces_of(expectations: Sequence[Expectation], expectation: Expectation) -> tuple[str, ...]:
    """The traces over which a count is: its own, or those on which the file judges the same formula."""
    if expectation.trace is not None:
        return (expectation.trace,)
    same = (one for one in expectations if one.question == "holds" and one.formula == expectation.formula)
    return tuple(dict.fromkeys(one.trace for one in same if one.trace is not None))


def counted_over(task: Task, coverage: Coverage) -> list[Verified]:
    """The counts that a task file expects of its task over any traces, judged on what was counted."""
    asked = (one for one in task.expectations if one.question == "cover" and one.trace is None)
    return [covered(task, one, coverage) for one in asked if one.formula == coverage.formula]


def covered(task: Task, expectation: Expectation, coverage: Coverage) -> Verified:
    """Whether what traces say is as much as is expected."""
    assert task.path is not None
    assert expectation.relation is not None
    assert expectation.bound is not None
    count = coverage.count(expectation)
    verdict = _VERDICTS[_compared(expectation.relation, expectation.bound, Fraction(count), Fraction(count))]
    reason = None if verdict == "holds" else coverage.report()
    return Verified(
        task.path, task, expectation, verdict, "trace", reason=reason, coverage=coverage, count=count
    )  # fmt: skip


@contextmanager
def _of_file(file: Path) -> Iterator[None]:
    """What is wrong with a trace is told with its file; advice on `end` does not apply."""
    try:
        yield
    except TraceError as error:
        raise TraceError(f"{file}: {str(error).partition(', or end=')[0]}") from None


def decided(result: CheckResult, relation: Relation, bound: Fraction) -> bool | None:
    """Whether the exact probability satisfies the relation; None if the bound lies inside the enclosure."""
    if result.fraction is not None:
        return _compared(relation, bound, result.fraction, result.fraction)
    return _compared(relation, bound, Fraction(result.lower), Fraction(result.upper))


def _compared(relation: Relation, bound: Fraction, lower: Fraction, upper: Fraction) -> bool | None:
    """Whether all of [lower, upper] satisfies the relation, or none of it; None if some of it does."""
    if relation in (">=", "<"):
        at_least = True if lower >= bound else False if upper < bound else None
        return at_least if relation == ">=" or at_least is None else not at_least
    at_most = True if upper <= bound else False if lower > bound else None
    return at_most if relation == "<=" or at_most is None else not at_most


def _parameters(model: MDP) -> list[str]:
    """The names of a model's parameters."""
    return [one.name for one in model.family.parameters] if model.family is not None else []


def _unfit(expectation: Expectation, model: MDP) -> str | None:
    """Why a question cannot be asked of this model."""
    if model.blackbox is not None:
        return (
            f"{model.name} is a black box, whose probabilities are unknown; an expectation needs a model, and stltool "
            "estimate --at-least tests a bound by runs"
        )
    if model.uncertain and not expectation.robust:
        return f"the probabilities of {model.name} are intervals; write robust {expectation.question}(…)"
    if expectation.robust and not model.uncertain:
        return f"the probabilities of {model.name} are not intervals; leave robust out"
    return None


def _as_written(message: str, task: Task, expectation: Expectation) -> str:
    """A message with the expectation's file as the task file names it, so that reports are the same everywhere."""
    for file in (expectation.policy, expectation.trace):
        message = message.replace(str(task.folder / file), file) if file is not None else message
    return message


def _at(expectation: Expectation, message: str) -> str:
    return expectation.span.show(message) if expectation.span is not None else message
