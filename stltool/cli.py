"""The command line: parse arguments, call the public API, print. Exit codes: 0 done, 1 the asked bound does not hold,
2 the input is at fault (a message on stderr, no traceback), 3 stltool itself is.
"""

from __future__ import annotations

import json
import shlex
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from stltool.errors import FragmentError, InexactEncodingWarning, SettingsError, SizeError, StlToolError

if TYPE_CHECKING:
    from stltool.automata import TaskAutomaton
    from stltool.learning import Training
    from stltool.logic.task import Task
    from stltool.models import MDP
    from stltool.product import Product

app = typer.Typer(
    help="Signal temporal logic tasks on Markov decision processes, learned and verified exactly.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)

TaskFile = Annotated[Path, typer.Argument(help="task file (.stl)", show_default=False)]
Model = Annotated[Path | None, typer.Option("--model", help="model file; default: the task file's model line")]
Params = Annotated[
    list[str] | None, typer.Option("--param", "-p", metavar="NAME=VALUE", help="override a param of the file")
]
TaskName = Annotated[str | None, typer.Option("--task", help="the definition to use; default: the last one")]
Encoding = Annotated[str, typer.Option("--encoding", help="exact, paper (the paper's flags) or history (the τ-MDP)")]
AsJson = Annotated[bool, typer.Option("--json", help="print one JSON object instead of a table")]
Method = Annotated[str, typer.Option("--method", "-m", help="naive, naive-er or cfer")]
Faithful = Annotated[bool, typer.Option("--faithful", help="the method as published, its slips included")]
Episodes = Annotated[int, typer.Option("--episodes", "-e", help="training episodes")]
Seed = Annotated[int, typer.Option("--seed", "-s", help="seed of every random choice")]
Set = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="a learner's setting, e.g. replays=50")
]


@app.command()
def run(
    task: TaskFile,
    model: Model = None,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    method: Method = "cfer",
    faithful: Faithful = False,
    episodes: Episodes = 1000,
    seed: Seed = 0,
    setting: Set = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="folder for the results; default: out/NAME")] = None,
    as_json: AsJson = False,
) -> None:
    """Learn a policy, check it exactly, write the report: the main job."""
    import stltool as stl
    from stltool.files import read_text, require_folder
    from stltool.reporting import report_data, write_report
    from stltool.reporting.terminal import print_checks, print_facts, progress_bar

    product = _product(task, model, param, name, encoding, as_json)
    folder = out if out is not None else Path("out") / product.task_name
    require_folder(folder)
    with progress_bar("checking the optimum", quiet=as_json) as bar:
        best = stl.check(product, progress=bar)
    with progress_bar(f"learning ({method})", quiet=as_json) as bar:
        training = stl.learn(
            product, method, faithful=faithful, episodes=episodes, seed=seed, progress=bar, **_settings(setting)
        )
    mine = stl.check(product, training.policy)
    command = "stltool " + shlex.join(sys.argv[1:])
    data = report_data([best, mine], training, source=read_text(task, "task file"), command=command, seed=seed)
    training.policy.save(folder / "policy.npz")
    write_report(data, folder / "report.html")
    if as_json:
        print(json.dumps(data))
        return
    print_facts({
        "task": f"{product.task_name} := {product.formula}",
        "product": f"{product.shape[0]} model states × {product.shape[1]} automaton states, horizon {product.horizon}",
        "learned": _learned(training),
    })  # fmt: skip
    print_checks(data["checks"])
    print_facts({"report": folder / "report.html", "data": folder / "report.json", "policy": folder / "policy.npz"})


@app.command()
def check(
    task: TaskFile,
    policy: Annotated[
        Path | None, typer.Option("--policy", help="policy file (.npz) or Q-table (.csv); default: the best of all")
    ] = None,
    minimize: Annotated[bool, typer.Option("--minimize", help="the least instead of the greatest probability")] = False,
    at_least: Annotated[
        float | None, typer.Option("--at-least", metavar="P", help="exit code 1 unless the probability is at least P")
    ] = None,
    save_policy: Annotated[
        Path | None, typer.Option("--save-policy", metavar="FILE", help="write the optimal policy (.npz)")
    ] = None,
    model: Model = None,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """The exact probability that the task holds: of the best policy, or of a given one."""
    import stltool as stl
    from stltool.policy import require_policy_file
    from stltool.reporting import check_data
    from stltool.reporting.terminal import print_checks, print_facts, progress_bar

    if at_least is not None and not 0 <= at_least <= 1:
        raise SettingsError(f"--at-least {at_least}: a probability lies between 0 and 1")
    product = _product(task, model, param, name, encoding, as_json, learning=False)
    chosen = stl.load_policy(policy, product) if policy is not None else None
    if save_policy is not None:
        require_policy_file(save_policy)
    with progress_bar("checking", quiet=as_json) as bar:
        optimum = stl.check(product, maximize=not minimize, keep_policy=save_policy is not None, progress=bar)
    result = optimum if chosen is None else stl.check(product, chosen)
    if save_policy is not None and optimum.policy is not None:
        optimum.policy.save(save_policy)
    data = check_data(result, optimum)
    if at_least is not None:
        data["at_least"], data["holds"] = at_least, result.lower >= at_least
    if as_json:
        print(json.dumps(data))
    else:
        print_facts({"task": f"{product.task_name} := {product.formula}"})
        print_checks([check_data(optimum), data] if chosen is not None else [data])
        if at_least is not None:
            print_facts({f"P >= {at_least}": _verdict(result.lower, result.upper, at_least)})
    if at_least is not None and not data["holds"]:
        raise typer.Exit(1)


@app.command()
def learn(
    task: TaskFile,
    out: Annotated[Path, typer.Option("--out", "-o", help="policy file to write (.npz)", show_default=False)],
    method: Method = "cfer",
    faithful: Faithful = False,
    episodes: Episodes = 1000,
    seed: Seed = 0,
    setting: Set = None,
    model: Model = None,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """Learn a policy without knowing the probabilities, and save it."""
    import stltool as stl
    from stltool.policy import require_policy_file
    from stltool.reporting import training_data
    from stltool.reporting.terminal import print_facts, progress_bar

    require_policy_file(out)
    product = _product(task, model, param, name, encoding, as_json)
    with progress_bar(f"learning ({method})", quiet=as_json) as bar:
        training = stl.learn(
            product, method, faithful=faithful, episodes=episodes, seed=seed, progress=bar, **_settings(setting)
        )
    training.policy.save(out)
    if as_json:
        print(json.dumps({"task": product.task_name, "formula": str(product.formula), **training_data(training)}))
        return
    print_facts({
        "learned": _learned(training),
        "exact P": f"{training.history[-1].probability:.12g}",
        "policy": out,
    })  # fmt: skip


@app.command()
def explain(
    task: TaskFile,
    model: Model = None,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """What a task says: horizon, decomposition along the paper's fragment, automaton and product sizes."""
    import stltool as stl
    from stltool.reporting.data import disagreement_data, encoding_sizes, part_data, product_data
    from stltool.reporting.terminal import print_facts, print_table
    from stltool.sizes import bytes_text

    loaded = stl.load_task(task, _params(param), name)
    facts: dict[str, Any] = {
        "task": loaded.name,
        "formula": str(loaded.formula),
        "params": {key: str(value) for key, value in loaded.params.items()},
        "horizon": stl.horizon(loaded.formula),
        "samples_needed": stl.horizon(loaded.formula) + 1,
    }
    try:
        fragment = stl.check_fragment(loaded.formula)
        facts["fragment"] = {
            "outer": f"{fragment.outer}[0,{fragment.T})",
            "parts": [str(part) for part in fragment.parts],
            "equal_windows": fragment.uniform,
        }
    except FragmentError as refusal:
        facts["fragment"] = {"refused": str(refusal)}
    try:
        if model is not None or loaded.model is not None:
            product = _bind(loaded, _load_model(loaded, model), encoding)
            automaton = product.automaton
            facts |= product_data(product)
            facts["check_bytes"] = product.check_bytes()
        else:
            automaton = _compile(loaded, encoding)
            facts["automaton_states"] = automaton.n_states
        facts |= encoding_sizes(automaton)
        facts["parts"] = part_data(automaton)
        if not automaton.exact:
            try:
                facts["disagrees_on"] = disagreement_data(automaton)
            except SizeError as refusal:
                facts["disagreement"] = str(refusal)
    except (FragmentError, SizeError) as refusal:
        facts["automaton"] = {"refused": str(refusal)}
    if as_json:
        print(json.dumps(facts))
        return
    shown = {
        key.replace("_", " "): value
        for key, value in facts.items()
        if not isinstance(value, dict) and "digest" not in key
    }
    for key in ("flag states", "history states"):
        if key in shown:
            size = shown[key]
            large = isinstance(size, int) and size >= 10**9
            shown[key] = "no such encoding" if size is None else f"{Decimal(size):.3g}" if large else size
    shown["params"] = ", ".join(f"{key} = {value}" for key, value in facts["params"].items()) or "none"
    for key in ("fragment", "automaton"):
        for detail, value in facts.get(key, {}).items():
            shown[f"{key} {detail}".replace("_", " ")] = ", ".join(value) if isinstance(value, list) else value
    if "check_bytes" in facts:
        shown["check bytes"] = bytes_text(facts["check_bytes"])
        shown["actions"] = ", ".join(facts["actions"])
    shown.pop("parts", None)
    trace = facts.get("disagrees_on")
    print_facts(shown)
    if "parts" in facts:
        typer.echo("\nparts of the automaton (a start's truth is known `delay` steps after it):")
        print_table(facts["parts"])
    if trace is not None:
        typer.echo(
            "\na shortest trace on which the encoding and the formula disagree (without a model, comparisons are"
        )
        typer.echo("taken as independent of each other):")
        print_table(trace["steps"])
        typer.echo(f"the encoding says {trace['encoding_says']}, the formula is {trace['formula_is']}")


@app.command()
def export(
    task: TaskFile,
    to: Annotated[str, typer.Option("--to", help="dot: the task's automaton for Graphviz")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="file to write; default: print it")] = None,
    model: Model = None,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
) -> None:
    """The task's automaton in another format: states say what they remember, edges which labels take them."""
    import stltool as stl
    from stltool.automata.graph import to_dot
    from stltool.files import write_atomically

    if to != "dot":
        raise SettingsError(f"--to {to}: there is no such format; known: dot")
    loaded = stl.load_task(task, _params(param), name)
    if model is not None or loaded.model is not None:
        automaton = _bind(loaded, _load_model(loaded, model), encoding).automaton
    else:
        automaton = _compile(loaded, encoding)
    text = to_dot(automaton)
    if out is not None:
        write_atomically(out, text)
    else:
        typer.echo(text, nl=False)


@app.command()
def report(
    data: Annotated[list[Path], typer.Argument(help="report.json files of earlier runs", show_default=False)],
) -> None:
    """Make the HTML page of a report again from its JSON, beside it."""
    from stltool.files import write_atomically
    from stltool.reporting import load_report, render
    from stltool.reporting.terminal import print_facts

    for path in data:
        page = path.with_suffix(".html")
        write_atomically(page, render(load_report(path)))
        print_facts({"report": page})


# --------------------------------------------------------------------------------------------------- shared steps


def _product(
    task: Path,
    model: Path | None,
    param: list[str] | None,
    name: str | None,
    encoding: str,
    quiet: bool,
    learning: bool = True,
) -> Product:
    import stltool as stl
    from stltool import kernels
    from stltool.reporting.terminal import kernels_ready

    loaded = stl.load_task(task, _params(param), name)
    product = _bind(loaded, _load_model(loaded, model), encoding)
    with kernels_ready(quiet):
        kernels.warm_up(learning)
    return product


def _load_model(task: Task, model: Path | None) -> MDP:
    import stltool as stl

    path = model if model is not None else task.model
    if path is None:
        raise SettingsError(f'{task.path}: no model; add a line such as model "floor.toml", or give --model FILE')
    return stl.load_model(path)


def _bind(task: Task, model: MDP, encoding: str) -> Product:
    import stltool as stl

    with _warnings_shown():
        return stl.build_product(model, task, encoding)  # type: ignore[arg-type]  # checked there, with a message


def _compile(task: Task, encoding: str) -> TaskAutomaton:
    import stltool as stl

    with _warnings_shown():
        return stl.compile_automaton(task.formula, encoding)  # type: ignore[arg-type]  # checked there, with a message


@contextmanager
def _warnings_shown() -> Iterator[None]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InexactEncodingWarning)
        yield
    for warning in caught:
        typer.echo(f"warning: {warning.message}", err=True)


def _params(pairs: list[str] | None) -> dict[str, str]:
    return dict(_pair(pair, "-p T=20") for pair in pairs or [])


def _settings(pairs: list[str] | None) -> dict[str, Any]:
    """Settings of a learner: numbers where they look like numbers."""
    settings: dict[str, Any] = {}
    for pair in pairs or []:
        key, text = _pair(pair, "--set replays=50")
        if key in ("episodes", "seed", "method", "faithful", "product", "progress"):
            raise SettingsError(f"--set {key}: there is an option or argument of its own for it; see --help")
        for kind in (int, float, str):
            try:
                settings[key] = kind(text)
                break
            except ValueError:
                continue
    return settings


def _pair(text: str, example: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise SettingsError(f"{text!r} is not NAME=VALUE; write for example {example}")
    return key.strip(), value.strip()


def _learned(training: Training) -> str:
    episodes, steps = training.settings.episodes, training.environment_steps
    method = training.method + (" as published" if training.faithful else "")
    return f"{method}, {episodes} episodes, {steps} environment steps, {training.seconds:.1f} s"


def _verdict(lower: float, upper: float, bound: float) -> str:
    if lower >= bound:
        return "holds"
    return "does not hold" if upper < bound else "not decided: the bound lies inside the enclosure"


def main() -> None:
    """The entry point: runs the app; a fault of the user's input ends with its message and exit code 2."""
    try:
        app()
    except StlToolError as fault:
        _end(str(fault), 2)
    except (MemoryError, RecursionError) as fault:
        _end(f"too large for this machine ({type(fault).__name__}); shorten the windows or simplify the task", 2)
    except OSError as fault:
        _end(f"{fault.filename or 'output'}: {fault.strerror}", 2)
    except Exception:  # our own fault: shown whole, and not mistaken for exit code 1, "does not hold"
        traceback.print_exc()
        _end("this is a fault of stltool, not of your input; please report it with the lines above", 3)


def _end(message: str, code: int) -> NoReturn:
    from stltool.reporting.terminal import error

    error(message)
    sys.exit(code)
