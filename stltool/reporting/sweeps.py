"""Sweeps as plain data, and as a page, a table, curves and a picture."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, cast

import numpy as np

from stltool.checking.encodings import Story
from stltool.files import begins, is_data, is_marked, require_folder, require_result, write_result
from stltool.learning.settings import recorded
from stltool.learning.sweep import Failure, Method, RunResult, Scenario, Sweep, SweepResult
from stltool.reporting.curves import quartile_curves, write_csv
from stltool.reporting.data import SWEEP_FORMAT
from stltool.reporting.records import (
    FailureRecord,
    MethodRecord,
    ScenarioRecord,
    SectionRecord,
    SweepRecord,
    SweepResultRecord,
)
from stltool.reporting.story import story_sections

_NEAR = 0.99  # fraction of the optimum from which a task is considered learned
_COLUMNS = ("scenario", "method", "median", "q1", "q3", "least", "greatest", "published", "optimum",
            "environment_steps", "near_optimum_at", "regret", "wall_seconds", "seeds")  # fmt: skip
_POINTS = ("scenario", "method", "seed", "episode", "steps", "probability")
_FILES: dict[str, tuple[str, Callable[[Path], bool]]] = {
    "report.html": ("page", is_marked),
    "report.json": ("report", is_data),
    "table.csv": ("table", begins(*_COLUMNS)),
    "curves.csv": ("table", begins(*_POINTS)),
    "figure.svg": ("picture", is_marked),
    "figure.png": ("picture", is_marked),
}


def sweep_data(
    result: SweepResult,
    command: str | None = None,
    sections: Sequence[Mapping[str, Any]] = (),
    stories: Sequence[Story] = (),
) -> SweepRecord:
    """Everything that a sweep's report shows; scenarios and methods without a finished run are left out.

    `sections` appear below the table: {"title": …, "text": …, "rows": [{column: value}], "figure": …} each, the figure
    as for `figures.line_chart`, or None; before them the claims of [Wang24], if `stories` are given.
    """
    sweep = result.sweep
    found: dict[tuple[str, str], list[RunResult]] = {}
    for run in result.runs:
        found.setdefault((run.scenario, run.method), []).append(run)
    scenarios = [scenario for scenario in sweep.scenarios if any(key[0] == scenario.id for key in found)]
    methods = [method for method in sweep.methods if any(key[1] == method.id for key in found)]
    sections = [*story_sections([one for one in stories if any(key[0] == one.scenario for key in found)]), *sections]
    described = [_scenario_data(scenario) for scenario in scenarios]
    return {
        "format": SWEEP_FORMAT,
        "version": metadata.version("stltool"),
        "name": sweep.name,
        "command": command,
        "columns": sweep.columns,
        "settings": dict(sweep.settings),
        "methods": [_method_data(method) for method in methods],
        "scenarios": described,
        "results": [
            _result_data(sweep, scenario, method, found[scenario.id, method.id], shown["optimum"])
            for scenario, shown in zip(scenarios, described, strict=True)
            for method in methods
            if (scenario.id, method.id) in found
        ],
        "runs": {"finished": len(result.runs), "failed": len(result.failures), "all": len(sweep.runs())},
        "failures": failures_data(result.failures),
        "sections": [_section_data(section) for section in sections],
    }


def _section_data(section: Mapping[str, Any]) -> SectionRecord:
    return {
        "title": section["title"],
        "text": section.get("text", ""),
        "rows": section.get("rows", []),
        "figure": section.get("figure"),
    }


def _method_data(method: Method) -> MethodRecord:
    return {"id": method.id, "name": method.name, "faithful": method.faithful, "settings": dict(method.settings)}


def _scenario_data(scenario: Scenario) -> ScenarioRecord:
    product, best = scenario.product, scenario.optimum
    return {
        "id": scenario.id,
        "task": product.task_name,
        "formula": str(product.formula),
        "model": scenario.model.name,
        "model_digest": scenario.model.digest(),
        "params": {name: str(value) for name, value in scenario.task.params.items()},
        "horizon": product.horizon,
        "states": product.shape[0],
        "automaton_states": product.shape[1],
        "settings": dict(scenario.settings),
        "optimum": best.probability,
        "optimum_lower": best.lower,
        "optimum_upper": best.upper,
    }


def _result_data(
    sweep: Sweep, scenario: Scenario, method: Method, runs: list[RunResult], optimum: float
) -> SweepResultRecord:
    """One scenario with one method, over its seeds; `settings` are those of the learner, `budget` those of the runs."""
    learner, budget = sweep.settled(scenario, method)
    final = np.array([run.probability[-1] for run in runs])
    q1, median, q3 = np.quantile(final, [0.25, 0.5, 0.75]).tolist()
    curve = quartile_curves([(run.steps, run.probability) for run in runs])
    near = (steps for steps, value in zip(curve["steps"], curve["median"], strict=True) if value >= _NEAR * optimum)
    return {
        "scenario": scenario.id,
        "method": method.id,
        "settings": recorded(learner),
        "budget": recorded(budget),
        "seeds": [run.seed for run in runs],
        "median": median,
        "q1": q1,
        "q3": q3,
        "least": float(final.min()),
        "greatest": float(final.max()),
        "published": scenario.published.get(method.id),
        "optimum": optimum,
        "environment_steps": int(np.median([run.steps[-1] for run in runs])),
        "near_optimum_at": next(near, None),
        "regret": float(np.median([regret(run.episode, run.probability, optimum) for run in runs])),
        "seconds": float(np.median([run.seconds for run in runs])),
        "curve": curve,
        "runs": [
            {"seed": run.seed, "episode": run.episode, "steps": run.steps, "probability": run.probability}
            for run in runs
        ],
    }


def regret(episode: Sequence[int], probability: Sequence[float], optimum: float) -> float:
    """Σ P* − P(π_k) over all episodes k = 1, 2, …, π_k the policy learned by then.

    Between two evaluations P is taken to change linearly, from 0 before the first episode.
    """
    every = np.arange(1, episode[-1] + 1)
    return float((optimum - np.interp(every, [0, *episode], [0.0, *probability])).sum())


def failures_data(failures: Sequence[Failure]) -> list[FailureRecord]:
    """Failed runs, grouped by scenario, method and reason."""
    grouped: dict[tuple[str, str, str], list[int]] = {}
    for failure in failures:
        grouped.setdefault((failure.scenario, failure.method, failure.message), []).append(failure.seed)
    return [
        {"scenario": scenario, "method": method, "seeds": seeds, "message": message}
        for (scenario, method, message), seeds in grouped.items()
    ]


def failure_text(failure: FailureRecord) -> str:
    """P1 cfer, seeds 0, 1: why."""
    seeds = ", ".join(map(str, failure["seeds"]))
    many = "s" if len(failure["seeds"]) > 1 else ""
    return f"{failure['scenario']} {failure['method']}, seed{many} {seeds}: {failure['message']}"


def result_rows(data: SweepRecord) -> list[dict[str, str]]:
    """The table as text, one row per scenario and method."""
    some_published = any(result["published"] is not None for result in data["results"])
    rows = []
    for result in data["results"]:
        published = {"published": _figure(result["published"])} if some_published else {}
        rows.append({
            "scenario": result["scenario"],
            "method": result["method"],
            "seeds": str(len(result["seeds"])),
            "P median": _figure(result["median"]),
            "[q1, q3]": f"[{_figure(result['q1'])}, {_figure(result['q3'])}]",
            "least": _figure(result["least"]),
            "greatest": _figure(result["greatest"]),
            **published,
            "P*": _figure(result["optimum"]),
            f"{_NEAR:g} P* at": "–" if result["near_optimum_at"] is None else str(result["near_optimum_at"]),
            "steps": str(result["environment_steps"]),
            "regret": f"{result['regret']:.4g}",
            "time": f"{result['seconds']:.2f} s",
        })  # fmt: skip
    return rows


def _figure(value: float | None) -> str:
    """Four decimals; a value below 1 is never shown as 1."""
    if value is None:
        return ""
    return f"{min(value, 0.9999) if value < 1 else value:.4f}"


def panel_title(scenario: ScenarioRecord) -> str:
    """P1: patrolling, floor-5x5, T = 10, tau = 10."""
    params = (f"{name} = {value}" for name, value in scenario["params"].items())
    return f"{scenario['id']}: " + ", ".join([scenario["task"], scenario["model"], *params])


def require_sweep(folder: str | Path) -> None:
    """Raise an error, before the work, if the files of a sweep could not be written after it."""
    require_folder(folder)
    for name, (what, known) in _FILES.items():
        require_result(Path(folder) / name, what, known)


def write_sweep(data: SweepRecord, folder: str | Path) -> list[Path]:
    """report.html, report.json, table.csv, curves.csv, figure.svg and figure.png; their paths.

    Each is written whole or not at all; page and pictures are made before any file is written.
    """
    from stltool.reporting.figures import learning_curves
    from stltool.reporting.page import render

    require_sweep(folder)
    svg, png = str(learning_curves(data, "svg")), learning_curves(data, "png")
    page = render(data, svg)
    paths = [Path(folder) / name for name in _FILES]
    write_result(paths[1], json.dumps(data, indent=1) + "\n", *_FILES["report.json"])
    write_result(paths[0], page, *_FILES["report.html"])
    write_csv(paths[2], "table", _COLUMNS, (
        [*(columns[name.removeprefix("wall_")] for name in _COLUMNS[:-1]), len(columns["seeds"])]
        for columns in cast(list[dict[str, Any]], data["results"])
    ))  # fmt: skip
    points = (
        (result["scenario"], result["method"], run["seed"], *point)
        for result in data["results"]
        for run in result["runs"]
        for point in zip(run["episode"], run["steps"], run["probability"], strict=True)
    )
    write_csv(paths[3], "table", _POINTS, points)
    write_result(paths[4], svg, *_FILES["figure.svg"])
    write_result(paths[5], png, *_FILES["figure.png"])
    return paths
