"""Report data → one self-contained HTML page; written together with the JSON it was made from."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any, cast

import jinja2

from stltool.arguments import described, require
from stltool.arguments import path as path_of
from stltool.checking import CheckResult, Estimate, StationaryResult
from stltool.checking.evidence import evidence_of
from stltool.display import NATURES
from stltool.errors import ArgumentError, FileError
from stltool.files import MARK, is_data, read_text, require_result, write_result
from stltool.learning import Guarantee, Training
from stltool.learning.markov import tested
from stltool.numbers import bound_texts, difference_text, most_text, probability_text, within_text
from stltool.product import Product
from stltool.randomness import require_seed
from stltool.reporting.answers import (
    FRONTIER_FORMAT,
    PARAMETRIC_FORMAT,
    ROBUSTNESS_FORMAT,
    frontier_content,
    parametric_content,
    robustness_content,
)
from stltool.reporting.data import FORMAT, SWEEP_FORMAT, VERIFY_FORMAT, policy_shown, report_data
from stltool.reporting.guarantees import guarantee_rows, looser_note
from stltool.reporting.headline import headline
from stltool.reporting.pages import (
    ESTIMATE_FORMAT,
    FRONT_FORMAT,
    MONITOR_FORMAT,
    TEST_FORMAT,
    certificate_bounds,
    estimate_content,
    front_content,
    monitor_content,
)
from stltool.reporting.records import SweepRecord
from stltool.reporting.runs import trace_text, verdict_text
from stltool.reporting.what_if import best_of_steps, chance_text
from stltool.reporting.words import run_sentences, sensitivity_sentences


def report(
    results: CheckResult | Sequence[CheckResult],
    training: Training | None = None,
    path: str | Path | None = None,
    *,
    source: str | None = None,
    command: str | None = None,
    seed: int = 0,
    estimates: Sequence[Estimate] = (),
    guarantees: Sequence[Guarantee | Estimate] = (),
    stationary: Sequence[StationaryResult] = (),
    product: Product | None = None,
) -> None:
    """Write a page at `path` (.html), and next to it the JSON that it is made from.

    results     checks of one task on one model; those of a given policy are shown next to the optimum
    training    a training, for its learning curve
    source, command   the text of the task file, and the command that repeats the run
    seed        of the run that is shown
    estimates   of the policy shown (the given one, else the optimal one), from runs
    stationary  what the best policies have that do not know the step
    guarantees  for the policy shown, from data. A black box has no results: `stl.report([], training, path,
                guarantees=[found])` reports the policy of `training`, on `product` (default: the policy's own)

    Raises SettingsError for results of several tasks or models, FileError if the files cannot be written.
    """
    if isinstance(training, str | PathLike):
        raise ArgumentError(
            f"report's training is {described(training)}, not a Training or None; the path comes third: "
            "stl.report(results, None, path)"
        )
    require(training, Training, "report's training", optional=True)
    target = path_of(path, "report's path")
    for value, name in ((source, "source"), (command, "command")):
        require(value, str, f"report's {name}", optional=True)
    require(product, Product, "report's product", optional=True)
    checks: list[CheckResult] = _each(
        [results] if isinstance(results, CheckResult) else results, CheckResult, "results"
    )
    seed = require_seed(seed)
    policy, home = policy_shown(checks, training) if checks or training is not None else (None, product)
    at = product if product is not None else home
    data = report_data(
        checks,
        training,
        source=source,
        command=command,
        evidence=evidence_of(at, policy, seed, why=bool(checks)) if at is not None else None,
        markov=tested(training) if training is not None else None,
        estimates=_each(estimates, Estimate, "estimates"),
        guarantees=_each(guarantees, (Guarantee, Estimate), "guarantees"),
        stationary=_each(stationary, StationaryResult, "stationary"),
        product=product,
    )
    write_report(data, target)


def _each(given: object, kinds: type | tuple[type, ...], name: str) -> list[Any]:
    require(given, (list, tuple), f"report's {name}", "give a list of them")
    assert isinstance(given, list | tuple)
    for one in given:
        require(one, kinds, f"one of report's {name}")
    return list(given)


def require_report(path: str | Path) -> None:
    """Raise an error, before the work, if the two files of a report could not be written after it."""
    path = Path(path)
    if path.suffix.lower() == ".json":
        other = path.with_suffix(".html").name
        raise FileError(f"{path}: the page would replace its JSON file; use another name, such as {other}")
    require_result(path, "page")
    require_result(path.with_suffix(".json"), "report", is_data)


def write_report(data: Mapping[str, Any], path: str | Path) -> None:
    """Both files of a report, each whole or not at all; the page is made before either is written."""
    path = Path(path)
    require_report(path)
    page = render(data)
    write_result(path.with_suffix(".json"), json.dumps(data, indent=1) + "\n", "report", is_data)
    write_result(path, page, "page")


def load_report(path: str | Path) -> dict[str, Any]:
    """The data in a report's JSON file."""
    return read_report(path)[0]


def read_report(path: str | Path) -> tuple[dict[str, Any], str]:
    """The same with the page, which is made to see whether the data are whole."""
    text = read_text(path, "report")
    try:
        data = json.loads(text)
        page = render(data)  # fails if anything is missing or of another type
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, jinja2.TemplateError):
        raise FileError(
            f"{path}: not the JSON file of a report of this version; write one with stltool run, sweep, or --report"
        ) from None
    return dict(data), page


def render(data: Mapping[str, Any], curves: str | None = None) -> str:
    """The HTML page. Its pictures are made here, from numbers and names, or in the page, by its own script; nothing is
    loaded from elsewhere, and the content security policy allows only the page's own style sheet and script. `curves`
    are those of a sweep, if drawn already."""
    if data["format"] == SWEEP_FORMAT:
        return render_sweep(data, curves)
    return _RENDERED[data["format"]](data)


def render_report(data: Mapping[str, Any]) -> str:
    """The page of a run or a check (`report_data`)."""
    why = data.get("why")  # missing in reports of earlier versions
    found = data.get("guarantees")  # these, too
    guarantees = guarantee_rows(found, data["checks"]) if found else []
    return _page(
        "report.html",
        {"explorer": data.get("explorer"), "automaton": data.get("automaton")},
        data=data,
        head=headline(data, guarantees),
        why=why,
        why_sentences=run_sentences(why) if why else [],
        sensitive_sentences=sensitivity_sentences(why["sensitive"]) if why else [],
        guarantees=guarantees,
        looser=looser_note(found or []),
        curve=curve_picture(data),
        gaps=gap_picture(data),
        floors=run_pictures(data),
        likely_floors=likely_pictures(data),
        bound_texts=bound_texts,
        certified=certificate_bounds(data["certificate"]) if data.get("certificate") else None,
        trace_text=trace_text,
        verdict_text=verdict_text,
        best_of_steps=best_of_steps,
        chance_text=chance_text,
    )


def curve_picture(data: Mapping[str, Any]) -> str | None:
    """The learning curve of a report, if it has an exact one."""
    from stltool.reporting.figures import learning_curve

    if not data["training"] or not data["checks"]:
        return None
    maximum = next((check for check in data["checks"] if check["question"] == "maximum"), None)
    return learning_curve(data["training"]["history"], maximum and maximum["probability"])


def gap_picture(data: Mapping[str, Any]) -> str | None:
    """The certified gap over environment steps, if it was asked for."""
    from stltool.reporting.figures import gap_curve

    gap = data["training"] and data["training"].get("gap")
    return gap_curve(data["training"]["history"], gap["without_data"]) if gap else None


def run_pictures(data: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The floor of a report with the sampled run; of a composition, that of each member, with its name."""
    from stltool.reporting.floor import floor_map

    states = data["run"]["states"] if data["run"] else None
    return [(floor["member"], floor_map(floor, states, f"floor{floor['member']}")) for floor in data["floors"]]


def likely_pictures(data: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The same with the most probable violation, if there is one."""
    from stltool.reporting.floor import floor_map

    runs = data["why"]["runs"] if data.get("why") else []
    return [
        (floor["member"], floor_map(floor, run["state_indices"], f"likely{floor['member']}"))
        for run in runs[:1] for floor in data["floors"]
    ]  # fmt: skip


def render_verification(data: Mapping[str, Any]) -> str:
    """The page of a verification (`verification_data`)."""
    from stltool.reporting import verification

    return _page(
        "verify.html",
        None,
        data=data,
        asked_text=verification.asked_text,
        counts_text=verification.counts_text,
        enclosure_text=verification.enclosure_text,
        explained=verification.explained,
        found_text=verification.found_text,
        place_text=verification.place_text,
    )


def render_sweep(data: Mapping[str, Any], curves: str | None = None) -> str:
    """The page of a sweep (`sweep_data`)."""
    from stltool.reporting import sweeps
    from stltool.reporting.figures import learning_curves, line_chart

    if curves is None and data["results"]:
        curves = str(learning_curves(data, "svg"))
    charts = [section["figure"] and line_chart(section["figure"], f"section-{i}")
              for i, section in enumerate(data["sections"])]  # fmt: skip
    return _page(
        "sweep.html",
        None,
        data=data,
        rows=sweeps.result_rows(cast(SweepRecord, data)),
        curves=curves,
        charts=charts,
        failure_text=sweeps.failure_text,
        panel_title=sweeps.panel_title,
    )


def _rendered(
    template: str, content: Callable[[Mapping[str, Any]], dict[str, Any]]
) -> Callable[[Mapping[str, Any]], str]:
    """The page of a template, from the data and from what `content` makes of them."""
    return lambda data: _page(template, None, data=data, **content(data))


_RENDERED: dict[str, Callable[[Mapping[str, Any]], str]] = {
    FORMAT: render_report,
    VERIFY_FORMAT: render_verification,
    FRONT_FORMAT: _rendered("front.html", front_content),
    MONITOR_FORMAT: _rendered("monitor.html", monitor_content),
    ROBUSTNESS_FORMAT: _rendered("answer.html", robustness_content),
    PARAMETRIC_FORMAT: _rendered("answer.html", parametric_content),
    FRONTIER_FORMAT: _rendered("answer.html", frontier_content),
    ESTIMATE_FORMAT: _rendered("estimate.html", estimate_content),
    TEST_FORMAT: _rendered("estimate.html", estimate_content),
}


_EXPLORER = ("elements", "data", "numbers", "policy", "view", "names", "picture", "sliders", "place", "run", "edits",
             "automaton", "start")  # fmt: skip


@cache
def _templates() -> jinja2.Environment:
    loader = jinja2.PackageLoader("stltool.reporting", "templates")
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["probability"] = probability_text
    environment.globals.update(within_text=within_text, difference_text=difference_text, most_text=most_text)
    environment.globals.update(natures=NATURES, mark=MARK)
    return environment


def _page(template: str, payload: object, **content: Any) -> str:
    """A page; `payload` is what its explorer's script reads, None without one."""
    css = _source("page.css")
    script = _source("theme.js") + (_explorer() if payload is not None else "")
    policy = (
        f"default-src 'none'; style-src {_digest(css)}; script-src {_digest(script)}; base-uri 'none'; "
        "form-action 'none'"
    )
    inside = None
    if payload is not None:  # no "</script>" and no "<!--" in there
        inside = json.dumps(payload, separators=(",", ":"), allow_nan=False)
        inside = inside.replace("<", "\\u003c")
    page = _templates().get_template(template)
    return page.render(css=css, script=script, policy=policy, payload=inside, **content)


@cache
def _explorer() -> str:
    """The engine, and what is seen of it: one function, whose parts are files in this order, so that each knows the
    names of all."""
    parts = (_source(f"explorer/{name}.js") for name in _EXPLORER)
    return "\n".join(["", _source("engine.js"), "(() => {", *parts, "})();", ""])


def _source(name: str) -> str:
    """A style sheet or a script as it stands."""
    environment = _templates()
    assert environment.loader is not None
    return environment.loader.get_source(environment, name)[0]


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode('utf-8')).digest()).decode('ascii')}'"
