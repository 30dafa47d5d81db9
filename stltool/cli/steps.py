"""Steps shared by several commands: from arguments to a product, settings, and text for the terminal."""

from __future__ import annotations

import importlib
import itertools
import os
import re
import shlex
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand

from stltool.arguments import described
from stltool.cli.options import READ, ModelReading
from stltool.errors import InexactEncodingWarning, PolicyError, SettingsError, StlSyntaxError, near_misses
from stltool.numbers import NumberError, read
from stltool.streams import say

if TYPE_CHECKING:
    from stltool.automata import TaskAutomaton
    from stltool.checking import CheckResult
    from stltool.kernels import Group
    from stltool.learning import Learner, Training
    from stltool.logic.task import Task
    from stltool.models import MDP
    from stltool.policy import Policy
    from stltool.product import JointProduct, Product
    from stltool.reporting.records import GuaranteeRecord
    from stltool.transfer import Transferred


NATURES = {
    "against": "against: at every step, adversarial nature picks the probabilities in their intervals",
    "with": "with: at every step, cooperative nature picks the probabilities in their intervals",
    "nominal": "nominal: a fixed probability inside every interval",
}


def nature_text(nature: str, model: MDP) -> str:
    """What nature does, in a line."""
    text = NATURES[nature]
    if not model.parameters or nature == "nominal":
        return text
    parameters = " and ".join(f"{one.name} in {one.domain}" for one in model.parameters)
    return f"{text.partition(' picks ')[0]} picks {parameters}"


def make_product(
    task: Path,
    model: Path | None,
    param: list[str] | None,
    name: str | None,
    encoding: str,
    quiet: bool,
    kernels: Sequence[Group] = (),
    nominal: bool = False,
    reading: ModelReading = READ,
) -> Product:
    """The product of a task file and its model, with the kernels that the command needs loaded; those of checking are
    loaded where a check is large enough for them."""
    from stltool.kernels import warm_up
    from stltool.reporting.terminal import kernels_ready

    product = load_product(task, model, param, name, encoding, nominal, reading)
    if kernels:
        with kernels_ready(quiet):
            warm_up(*kernels)
    return product


def load_product(
    task: Path,
    model: Path | None,
    param: list[str] | None,
    name: str | None,
    encoding: str,
    nominal: bool = False,
    reading: ModelReading = READ,
) -> Product:
    (loaded,), world = load_with_model(task, model, param, [name], reading)
    if nominal and not world.uncertain:
        raise SettingsError("--nominal: the model's probabilities are not intervals; leave out --nominal")
    return bind(loaded, world.nominal() if nominal else world, encoding)


def load_policy_product(
    task: Path, model: Path | None, param: list[str] | None, name: str | None, encoding: str, reading: ModelReading
) -> Product:
    """The product that a policy of another model was made on: of `--policy-model`, or of the task file's model line.

    Of -p, it has the params of the task; parameters of the model are those of the model that is judged.
    """
    import stltool as stl

    plain = stl.load_task(task, task=name)
    if model is None and plain.model is None:
        raise SettingsError(
            "--transfer: the model that the policy was made for is not known, as the task file names none; add "
            "--policy-model FILE"
        )
    own = [pair for pair in param or [] if pair.partition("=")[0].strip() in plain.params]
    return load_product(task, model, own, name, encoding, reading=reading)


def moved_policy(product: Product, file: Path, home: Product) -> Transferred:
    """The policy of a file, made on `home`, for another product."""
    import stltool as stl
    from stltool.transfer import transferred

    try:
        policy = stl.load_policy(file, home)
    except PolicyError as error:
        remedy = "; or name that model: --policy-model FILE" if "is for the model" in str(error) else ""
        raise PolicyError(f"{error}{remedy}") from None
    return transferred(product, policy)


_FILES = {
    ".txt",
    ".toml",
    ".csv",
    ".tsv",
    ".json",
    ".npz",
    ".parquet",
    ".policy",
    ".md",
    ".py",
    ".tra",
    ".umb",
    ".drn",
    ".prism",
    ".jani",
}


def require_declared_there(step: str | None, unit: str | None) -> None:
    """SettingsError if --step or --unit is given next to a task file."""
    for option, value in (("step", step), ("unit", unit)):
        if value is not None:
            raise SettingsError(
                f"--{option} {value}: a task file declares its own {option}; write {option} = {value} there"
            )


def load_task_or_formula(
    text: str, params: list[str] | None, name: str | None, step: str | None = None, unit: str | None = None
) -> Task:
    """A task file if one of that name exists or the name ends in .stl, otherwise `text` parsed as a formula.

    Operators without an interval are allowed: whatever cannot judge them refuses them.
    """
    import stltool as stl
    from stltool.errors import FileError, StlSyntaxError, near_misses
    from stltool.logic.parser import formula_task

    path, values = Path(text), read_params(params)
    try:
        is_file = path.is_file()
    except OSError:  # too long for a name: a formula
        is_file = False
    if is_file or text.endswith(".stl"):
        siblings = [] if is_file else [other.name for other in path.parent.glob("*.stl")]
        if siblings and not path.exists():
            raise FileError(f"{text}: there is no such task file; {near_misses(path.name, siblings)}")
        require_declared_there(step, unit)
        return stl.load_task(path, values, name, unbounded=True)
    if path.suffix in _FILES and re.fullmatch(r"[\w.]+", text):  # a name with dots, too, but hardly meant as one
        raise FileError(f"{text}: there is no such task file; a label of that name is in quotes: '\"{text}\"'")
    if name is not None:
        raise SettingsError(f"--task {name}: a formula has no definitions to choose from; leave out --task")
    try:
        return formula_task(text, values, step=step, unbounded=True, unit=unit)
    except StlSyntaxError as fault:
        if re.fullmatch(r"[\w.~:/\\-]+", text):  # it looks like a path
            raise StlSyntaxError(f"{fault}\n(read as a formula: there is no file {text})") from None
        raise


def make_joint_product(
    task: Path,
    names: list[str],
    model: Path | None,
    param: list[str] | None,
    encoding: str,
    quiet: bool,
    reading: ModelReading = READ,
) -> JointProduct:
    """The joint product of the definitions `names` of a task file."""
    import stltool as stl

    loaded, world = load_with_model(task, model, param, names, reading)
    with warnings_shown():
        joint = stl.build_joint_product(world, loaded, encoding)  # type: ignore[arg-type]
    _tell(itertools.chain(*(product.notes for product in joint.tasks)))
    return joint


def load_with_model(
    task: Path,
    model: Path | None,
    param: list[str] | None,
    names: Sequence[str | None],
    reading: ModelReading = READ,
    unbounded: bool = False,
) -> tuple[list[Task], MDP]:
    """Definitions of a task file and its model. -p gives values to params of the task, and to parameters of the model
    that the task does not declare; `unbounded` allows operators without an interval."""
    import stltool as stl
    from stltool.errors import StlToolError

    def loaded(params: dict[str, str]) -> list[Task]:
        return [stl.load_task(task, params, name, unbounded) for name in names]

    params = read_params(param)
    try:
        tasks = loaded(params)
    except StlToolError:
        tasks = loaded({})
        of_model = {key: value for key, value in params.items() if key not in tasks[0].params}
        world, rest = model_with(model if model is not None else tasks[0].model, of_model, tasks[0], reading)
        known = [one.name for one in world.family.parameters] if world.family is not None else []
        if not of_model:
            raise  # what the task says
        if unknown := [key for key in rest if key not in known]:
            every = [*tasks[0].params, *known, *(of_model.keys() - rest.keys())]
            raise StlSyntaxError(
                f"{task}: there is no param {unknown[0]} to override; {near_misses(unknown[0], every)}"
            ) from None
        given = loaded({key: params[key] for key in params if key not in of_model})
        return given, world.at(**rest) if rest else world
    return tasks, task_model(tasks[0], model, reading)


def judge_by(product: Product, nature: str | None) -> tuple[Product, Callable[..., CheckResult]]:
    """The product to judge and the function for it: `check`, or for intervals `robust_check` with that nature (default:
    against). "nominal" is the ordinary check of the product with the nominal probabilities.
    """
    import stltool as stl

    if not product.model.uncertain:
        if nature is not None:
            raise SettingsError(f"--nature {nature}: the model's probabilities are not intervals; leave out --nature")
        return product, stl.check
    if nature == "nominal":
        return replace(product, model=product.model.nominal()), stl.check
    if nature is not None and nature not in NATURES:
        raise SettingsError(f"--nature {nature}: choose {', '.join(NATURES)}")
    return product, partial(stl.robust_check, nature=nature or "against")  # type: ignore[arg-type]  # checked above


def require_points(model: MDP, option: str) -> None:
    """SettingsError, in terms of `stltool check`, unless the probabilities are known numbers."""
    if model.uncertain and not model.parameters:
        raise SettingsError(f"{option} needs probabilities without intervals; add --nominal")
    model.require_points()


def model_with(
    path: Path | None, values: dict[str, str], task: Task, reading: ModelReading
) -> tuple[MDP, dict[str, str]]:
    """The model with the values of its program's constants, and the other values."""
    from stltool.models.formats.language import constants_of

    names = constants_of(path) if path is not None and values else []
    constants = {name: value for name, value in values.items() if name in names}
    rest = {name: value for name, value in values.items() if name not in names}
    return task_model(task, path, reading, constants), rest


def task_model(
    task: Task, model: Path | None, reading: ModelReading = READ, constants: dict[str, str] | None = None
) -> MDP:
    """The given model, or that of the task file; what its reader changed is reported on stderr."""
    import stltool as stl
    from stltool.reporting.terminal import note

    path = model if model is not None else task.model
    if path is None:
        remedy = 'add a line such as model "floor.toml", or give --model FILE'
        raise SettingsError(f"{task.path}: the task file names no model; {remedy}")
    loaded = stl.load_model(path, **reading.arguments(), constants=constants)
    for key in ("normalize", "cells", "deadlocks"):
        if key in loaded.notes:
            note(f"{path}: {loaded.notes[key]}")
    return loaded


def converted_model(path: Path, param: list[str] | None, reading: ModelReading) -> MDP:
    """A model file that is to be written in another format, with everything that its reader noted on stderr."""
    import stltool as stl
    from stltool.models.formats.language import constants_of
    from stltool.reporting.terminal import note

    values = read_params(param)
    names = constants_of(path) if values else []
    loaded = stl.load_model(
        path, **reading.arguments(), constants={name: values.pop(name) for name in names if name in values}
    )
    for said in loaded.notes.values():
        note(f"{path}: {said}")
    if reading.initial and "init" in loaded.labels:  # which says where runs start in the other file, too
        loaded = replace(loaded, labels={**loaded.labels, "init": loaded.initial > 0})
    return loaded.at(**values) if values else loaded


def bind(task: Task, model: MDP, encoding: str) -> Product:
    import stltool as stl

    with warnings_shown():
        product = stl.build_product(model, task, encoding)  # type: ignore[arg-type]  # checked there, with a message
    _tell(product.notes)
    return product


def _tell(notes: Iterable[str]) -> None:
    from stltool.reporting.terminal import note

    for told in notes:
        note(told)


def compile_task(task: Task, encoding: str) -> TaskAutomaton:
    import stltool as stl

    with warnings_shown():
        return stl.compile_automaton(task.formula, encoding)  # type: ignore[arg-type]  # checked there, with a message


def require_one_policy(file: Path | None, function: str | None) -> str | None:
    """The policy as the user named it, by a file or by a function; None if there is none."""
    if file is not None and function is not None:
        raise SettingsError("--policy and --policy-function each give a policy; keep one of them")
    return str(file) if file is not None else function


def given_policy(product: Product, file: Path | None, function: str | None) -> Policy | None:
    """The policy of `--policy` or `--policy-function`."""
    import stltool as stl

    if function is not None:
        return stl.Policy.from_function(product, imported(function, "--policy-function"))
    return stl.load_policy(file, product) if file is not None else None


def imported(text: str, option: str) -> Callable[..., Any]:
    """The function MODULE:FUNCTION. Only what is written on the command line is imported, nothing that a file names."""
    module, colon, name = text.partition(":")
    if not (colon and all(map(str.isidentifier, (*module.split("."), *name.split("."))))):
        raise SettingsError(f"{option} {text}: write MODULE:FUNCTION, such as my_agent:act")
    folder = os.getcwd()
    if folder not in sys.path and "" not in sys.path:
        sys.path.insert(0, folder)
    try:
        found: Any = importlib.import_module(module)
    except Exception as error:  # whatever the module does when it is imported
        raise SettingsError(f"{option} {text}: importing {module} raised {type(error).__name__}: {error}") from error
    for part in name.split("."):
        if not hasattr(found, part):
            public = [other for other in vars(found) if not other.startswith("_")] if hasattr(found, "__dict__") else []
            raise SettingsError(f"{option} {text}: there is no {part} in it; {near_misses(part, public)}")
        found = getattr(found, part)
    if not callable(found):
        raise SettingsError(f"{option} {text}: {name} is {described(found)}, not a function; name a function")
    function: Callable[..., Any] = found
    return function


@contextmanager
def warnings_shown() -> Iterator[None]:
    from stltool.reporting.terminal import warn

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InexactEncodingWarning)
        yield
    for warning in caught:
        warn(str(warning.message))


def read_params(pairs: list[str] | None) -> dict[str, str]:
    values: dict[str, str] = {}
    for pair in pairs or []:
        name, value = read_pair(pair, "-p T=20")
        if name in values:
            raise SettingsError(f"-p {name} is given twice, {values[name]} and {value}; give it once")
        values[name] = value
    return values


def read_learner(method: str | None, faithful: bool, pairs: list[str] | None) -> Learner[Any]:
    """The learner of that name with the settings that `--set` gives it."""
    from stltool.learning.methods import class_of, make, require_setting
    from stltool.learning.settings import Budget, settings_of

    cls = class_of(method, faithful)
    settings: dict[str, Any] = {}
    for pair in pairs or []:
        name, text = read_pair(pair, "--set optimism=0.5")
        if name in settings:
            raise SettingsError(f"--set {name} is given twice; give it once")
        if name in ("seed", "method", "faithful", *settings_of(Budget)):
            raise SettingsError(f"--set {name}: this setting has its own option; use --{name.replace('_', '-')}")
        require_setting(cls, name)
        try:
            settings[name] = settings_of(cls)[name].read(text)
        except SettingsError as error:
            raise SettingsError(f"--set {error}") from None
    return make(cls, settings)


def read_pair(text: str, example: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise SettingsError(f"{text!r} is not NAME=VALUE; write, for example, {example}")
    return key.strip(), value.strip()


def training_text(training: Training) -> str:
    if training.status == "nothing to learn":
        return "nothing: the first state decides the task, so all policies are equally good"
    episodes, steps = training.episodes, training.environment_steps
    method = training.method + (" as published" if training.faithful else "")
    ended = f"; ended {training.status}" if training.stopped_early else ""
    ended += f"; {training.advice}" if training.advice is not None else ""
    return f"{method}, {episodes} episodes, {steps} environment steps, {training.seconds:.1f} s{ended}"


def gap_facts(training: Training) -> dict[str, str]:
    """What the transitions prove about the distance to the optimum, if that was asked for."""
    from stltool.numbers import ceiling_text

    gap = training.gap
    if gap is None:
        return {}
    at = ", ".join(f"{one.name} = {float(one.estimate):.6g}" for one in gap.parameters)
    return {
        "certified": f"within {ceiling_text(gap.upper)} of the optimum with confidence {100 * gap.confidence:.12g} % "
        f"(without data: {ceiling_text(gap.without_data)})" + (f"; the policy is optimal for {at}" if at else ""),
        "assumes": gap.assumes,
        **({"looser": gap.looser} if gap.looser is not None else {}),
        **({"refused": gap.refused} if gap.refused is not None else {}),
    }


def this_command(*more: str) -> str:
    """The command line as given, quoted for a shell, with more options."""
    return shlex.join(["stltool", *sys.argv[1:], *more])


@contextmanager
def resumable(checkpoint: Path | None, nothing_before: str = "the end of the first episode") -> Iterator[None]:
    """On Ctrl-C, report what is kept and the command that continues; exit code 130."""
    from stltool.reporting.terminal import error

    try:
        yield
    except KeyboardInterrupt:
        if checkpoint is None:
            error("interrupted; nothing is kept (with --checkpoint FILE, a run can be resumed)")
        elif not checkpoint.exists():
            error(f"interrupted before {nothing_before}; there is nothing to resume")
        else:
            more = [] if "--resume" in sys.argv else ["--resume"]
            error(f"interrupted; the run is kept in {checkpoint}; resume it with\n{this_command(*more)}")
        raise typer.Exit(130) from None


def train(product: Product, learner: Learner[Any], quiet: bool, **arguments: Any) -> Training:
    """`learn` with a progress bar."""
    import stltool as stl
    from stltool.reporting.terminal import progress_bar

    with progress_bar(f"learning ({learner.name})", quiet=quiet) as bar:
        return stl.learn(product, learner, progress=bar, **arguments)


class LearnerCommand(TyperCommand):
    """A command whose --help ends with every method's settings, read from the learner classes."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        from stltool.learning.methods import methods_text

        super().format_help(ctx, formatter)
        say(f"\n{methods_text()}")


def split_episodes(split: float, episodes: int, rollouts: int) -> tuple[int, int]:
    """The episodes to learn in, and the fresh runs."""
    if rollouts != ROLLOUTS:
        raise SettingsError("--split and --rollouts each give the number of fresh runs; keep one of them")
    learning = round(split * episodes) if 0 < split < 1 else 0
    if not 0 < learning < episodes:
        raise SettingsError(
            f"--split {split:g}: of {episodes} episodes, it leaves none to learn in or none to judge by; give a share "
            "such as 0.2, and more episodes"
        )
    return learning, episodes - learning


ROLLOUTS = 10_000
"""Fresh runs, unless their number is given."""


def guarantees_of(
    product: Product, training: Training, confidence: float, rollouts: int, quiet: bool
) -> list[GuaranteeRecord]:
    """Lower bounds for a learned policy, as data: from the transitions it was learned from, also if the model's rows
    are tied by a parameter, from fresh runs, and the best of the last two.

    For a black box only from fresh runs, since its initial distribution is unknown.
    """
    import stltool as stl
    from stltool.errors import TieError
    from stltool.reporting import guarantee_data, refused_data
    from stltool.reporting.terminal import progress_bar, warn

    found = []
    for support in ("unknown", "known") if product.model.blackbox is None else ():
        with progress_bar("guarantee from the learning data", quiet=quiet) as bar:
            bound = stl.guarantee(
                product, training.policy, training.counts, confidence=confidence, support=support, progress=bar
            )
        found.append(guarantee_data(bound))
    policy, counts = training.policy, training.counts
    tied = product.model.family is not None
    if tied:
        try:
            bound = stl.guarantee(product, policy, counts, confidence=confidence, parameters="model")
            found.append(guarantee_data(bound))
        except TieError as error:
            tied = False
            warn(str(error))
            found.append(refused_data(str(error), int(counts.visits.sum()), confidence))
    if rollouts:
        with progress_bar("fresh runs", quiet=quiet) as bar:
            runs = stl.estimate(
                product, training.policy, runs=rollouts, confidence=confidence, side="lower", seed=training.seed,
                progress=bar,
            )  # fmt: skip
        found.append(guarantee_data(runs))
        if tied:
            best = stl.guarantee(product, policy, counts, confidence=confidence, parameters="model", fresh=runs)
            found.append(guarantee_data(best))
    return found


def read_probability(text: str, option: str) -> Fraction:
    """A probability as typed: a decimal or a fraction, exactly."""
    try:
        value = read(text)
    except NumberError as error:
        raise SettingsError(f"{option}: {error}; write a probability such as 0.95 or 19/20") from None
    if not 0 <= value <= 1:
        raise SettingsError(f"{option} {text}: a probability lies between 0 and 1")
    return value
