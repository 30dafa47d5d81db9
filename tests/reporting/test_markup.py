"""No text of a report's JSON becomes markup of its page; a page allows nothing but its own style sheet and script."""

import base64
import copy
import hashlib
import json
import re
from collections import Counter
from html.parser import HTMLParser

import jinja2
import numpy as np
import pytest

import stltool as stl
from stltool.checking.evidence import evidence_of
from stltool.errors import FileError
from stltool.files import MARK
from stltool.learning.sweep import Failure, RunResult
from stltool.reporting import (
    estimate_data,
    estimate_report,
    front_report,
    frontier_report,
    guarantee_data,
    load_report,
    monitor_data,
    monitor_report,
    parametric_data,
    parametric_report,
    render,
    report_data,
    robustness_data,
    robustness_report,
    sweep_data,
    verification_data,
)
from stltool.reporting.diagnosis import diagnosis_data
from tests.conftest import FACTORY, some

EVIL = (
    "EVIL</title></style></svg></code>]]>--><script>alert(1)</script><img src=x onerror=alert(1)>"
    "\" onload=\"x\" ' style='x' {{ 7 * 7 }}{% raw %} &lt;b&gt; javascript:alert(1) <svg/onload=x>"
)
# dictionaries with the user's names as keys
NAMED = ("labels", "signals", "settings", "params", "published", "names", "tasks", "probabilities", "weights",
         "automaton_states")  # fmt: skip


class Elements(HTMLParser):
    """The elements of a page with their attributes, and its texts."""

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.found, self.texts = [], []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.texts.append(data)

    def handle_comment(self, data):
        assert data.strip() == MARK

    def handle_decl(self, decl):
        assert decl == "doctype html"

    def handle_pi(self, data):
        raise AssertionError(f"an instruction: {data}")

    def unknown_decl(self, data):
        raise AssertionError(f"a section: {data}")


def require_safe(page):
    """Nothing of EVIL is more than text; everything that the page allows itself is its own."""
    elements = Elements(page)
    for tag, attributes in elements.found:
        assert tag not in ("img", "iframe", "object", "embed", "link", "base", "form", "image", "a")
        for name, value in attributes.items():
            assert not name.startswith("on")
            assert name not in ("style", "src", "action", "formaction", "srcset")
            assert "EVIL" not in (value or "")
            assert "javascript:" not in (value or "")
            if name in ("href", "xlink:href"):
                assert value.startswith("#")
    [style] = re.findall("<style>(.*?)</style>", page, flags=re.DOTALL)
    scripts = re.findall("<script([^>]*)>(.*?)</script>", page, flags=re.DOTALL)
    kinds, texts = zip(*scripts, strict=True)
    assert kinds in (("",), (' type="application/json" id="data"', ""))
    assert "EVIL" not in texts[-1]
    assert "<" not in "".join(texts[:-1])  # of the data
    assert sum(tag == "script" for tag, _ in elements.found) == len(scripts)
    digests = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in (style, texts[-1])]
    [policy] = [attributes["content"] for tag, attributes in elements.found
                if attributes.get("http-equiv") == "Content-Security-Policy"]  # fmt: skip
    assert policy == (
        f"default-src 'none'; style-src 'sha256-{digests[0]}'; script-src 'sha256-{digests[1]}'; base-uri 'none'; "
        "form-action 'none'"
    )
    assert page.index("Content-Security-Policy") < page.index("<style>")
    assert sum(tag == "style" for tag, _ in elements.found) == 1
    assert "EVIL" not in style
    return elements


def skeleton(elements):
    """How often there is each element with its attributes' names."""
    return Counter((tag, *sorted(attributes)) for tag, attributes in elements.found)


def poisoned(value, text, key=None):
    """The data with every text of the user's replaced, names as well; what belongs together still does."""
    if isinstance(value, str):
        return value if key in ("format", "end") else text + value
    if isinstance(value, list):
        return [poisoned(entry, text, "row" if key == "rows" else None) for entry in value]
    if isinstance(value, dict):
        named = key in NAMED or key == "row"
        return {text + name if named else name: poisoned(entry, text, name) for name, entry in value.items()}
    return value


def places(value, path=()):
    """Where the data has a text or a number, one place for entries of a list that are alike."""
    if isinstance(value, dict):
        for name, entry in value.items():
            yield from places(entry, (*path, name))
    elif isinstance(value, list):
        for i, entry in list(enumerate(value))[-1:]:
            yield from places(entry, (*path, i))
    elif path != ("format",):
        yield path


def with_evil_at(data, path):
    data = copy.deepcopy(data)
    *way, last = path
    inside = data
    for step in way:
        inside = inside[step]
    inside[last] = EVIL
    return data


@pytest.fixture(scope="module")
def checked():
    """A report with all that a report can have."""
    model = stl.load_model(FACTORY / "floor-5x5.toml")
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 2, "tau": 5})
    product = stl.build_product(model, task)
    run = stl.learn(product, "cfer", episodes=40, seed=1)
    judged = stl.estimate(product, run.policy, runs=50, side="lower", seed=2)
    found = [stl.guarantee(product, run.policy, run.counts), guarantee_data(judged)]
    checks = [stl.check(product, exact=True), stl.check(product, run.policy)]
    data = report_data(checks, run, source="task", command="stltool run", guarantees=found,
                       estimates=[stl.estimate(product, run.policy, runs=50, seed=4)],
                       asked=[{"claim": "P >= 1/2", "holds": True}],
                       evidence=evidence_of(product, run.policy, 0))  # fmt: skip
    data["exact_encoding"] = False  # for the warning
    return json.loads(json.dumps(data))


@pytest.fixture(scope="module")
def black_box(checked):
    refused = {"refused": "the model is a black box"}
    return {**checked, "checks": [], "why": None, "run": None, "floors": [], "transitions": None, "explorer": refused}


@pytest.fixture(scope="module")
def verified(tmp_path_factory):
    folder = tmp_path_factory.mktemp("verified")
    (folder / "log.csv").write_text("x\n1\n0\n")
    (folder / "no.npz").write_text("no policy")
    (folder / "task.stl").write_text(
        f'model "{FACTORY}/floor-5x5.toml"\nreach := F[0,2] A\nexpect Pmax(reach) >= 4433/5000\n'
        'expect Pmax(reach) >= 1/2\nexpect P(reach, policy "no.npz") <= 0\n'
        'expect holds(F[0,1] x > 0, trace "log.csv")\n'
    )
    found = stl.verify(folder / "task.stl", certificates=folder, exact_seconds=0)
    return json.loads(json.dumps(verification_data(found, "stltool verify")))


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweep") / "small.toml"
    path.write_text(f"""
        [sweep]
        name = "small"
        settings = {{ episodes = 10 }}
        [[method]]
        name = "cfer"
        settings = {{ optimism = 0.8 }}
        [[scenario]]
        id = "R"
        task = "{FACTORY}/reaching.stl"
        params = {{ T = 2, tau = 3 }}
        settings = {{ optimism = 0.9 }}
        published = {{ cfer = 0.25 }}
    """)
    runs = [RunResult("R", "cfer", seed, [2, 4], [10, 20], [0.1, 0.2], "0" * 64, 1.0) for seed in range(3)]
    figure = {"x": "share", "y": "P", "lines": [{"name": "first", "x": [0, 1], "y": [1, 2]}]}
    sections = [{"title": "title", "text": "text", "rows": [{"column": "value"}], "figure": figure}]
    result = stl.SweepResult(stl.load_sweep(path), runs, [Failure("R", "cfer", 4, "why")], 0)
    return json.loads(json.dumps(sweep_data(result, "stltool sweep", sections)))


@pytest.fixture(scope="module")
def front():
    tasks = [stl.load_task(FACTORY / "tradeoff.stl", params={"T": 2, "tau": 5}, task=name)
             for name in ("charging", "patrolling")]  # fmt: skip
    joint = stl.build_joint_product(stl.load_model(tasks[0].model), tasks)
    return json.loads(json.dumps(front_report(stl.pareto(joint, points=3), "stltool pareto")))


@pytest.fixture(scope="module")
def monitored():
    task = stl.parse_task("param T = 2\nhigh := x > 0.5\nkept := F[0,T] high")
    signals = {"x": np.array([1.0, 0, 0, 0, 0, 1, 1])}
    data = monitor_data(stl.monitor(task, signals), task, "log.csv")
    data["why"] = diagnosis_data(stl.diagnose(task, signals, 1))
    return json.loads(json.dumps(monitor_report(data, signals, task, "stltool monitor")))


@pytest.fixture(scope="module")
def estimated():
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 2, "tau": 5})
    product = stl.build_product(stl.load_model(task.model), task)
    best = stl.check(product)
    data = estimate_data(stl.estimate(product, best.policy, runs=50), product, best.policy, best)
    return json.loads(json.dumps(estimate_report(data, product, "stltool estimate")))


@pytest.fixture(scope="module")
def margins():
    task = stl.load_task(FACTORY / "margins.stl", params={"T": 2, "tau": 4})
    model = stl.load_model(FACTORY / "floor-5x5.toml")
    found = robustness_data(task, model, stl.robustness_distribution(model, task))
    return json.loads(json.dumps(robustness_report(task, found, found, "stltool check")))


@pytest.fixture(scope="module")
def varied():
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 2, "tau": 4})
    found = stl.parametric(stl.build_product(stl.load_model(FACTORY / "floor-5x5-p.toml"), task), over={"p": (0.8, 1)})
    data = parametric_data(found) | {"at_least": 0.5, "holds": False, "decided": True, "smallest": None}
    return json.loads(json.dumps(parametric_report(found, data, "stltool check")))


@pytest.fixture(scope="module")
def relaxed():
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 2, "tau": 4})
    found = stl.frontier(stl.load_model(task.model), task, 0.5, {"T": [1, 2], "tau": [4, 6]})
    return json.loads(json.dumps(frontier_report(found, "stltool frontier")))


KINDS = [
    "checked", "black_box", "swept", "verified", "front", "monitored", "estimated", "margins", "varied", "relaxed",
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_texts_stay_texts(kind, request):
    data = request.getfixturevalue(kind)
    plain = require_safe(render(poisoned(data, "some words ")))
    evil = poisoned(data, EVIL)
    elements = require_safe(render(json.loads(json.dumps(evil))))
    assert skeleton(elements) == skeleton(plain)
    texts = " ".join(elements.texts)
    seen = {key: value for key, value in data.items() if key not in ("explorer", "automaton")}  # drawn by the script
    wanted = [value for value in strings(seen) if not value.startswith("stltool-")]
    assert texts.count("EVIL</title>") > len(set(wanted)) / 2  # the page shows what it should show, as text
    assert "{{ 7 * 7 }}" in texts
    assert "49" not in "".join(re.findall(r"EVIL.*?onload=x>", texts))


def strings(value):
    if isinstance(value, dict):
        return [text for entry in value.values() for text in strings(entry)]
    if isinstance(value, list):
        return [text for entry in value for text in strings(entry)]
    return [value] if isinstance(value, str) else []


@pytest.mark.soak
@pytest.mark.parametrize("kind", KINDS)
def test_a_text_in_the_place_of_anything_stays_a_text_or_is_refused(kind, request, monkeypatch):
    """Pictures are drawn only where the place is of a picture: they take most of the time."""
    data = request.getfixturevalue(kind)
    drawn = {
        "values",
        "pieces",
        "params",
        "probes",
        "steps",
        "floors",
        "states",
        "state_indices",
        "history",
        "columns",
        "curve",
        "figure",
        "corners",
        "robustness",
    }
    shown = refused = 0
    tried = some(places(data))
    for path in tried:
        with monkeypatch.context() as patch:
            if not drawn.intersection(path):
                for name in ("figures.learning_curve", "figures.learning_curves", "figures.line_chart",
                             "figures.pareto_front", "figures.survival", "figures.parameter_curve",
                             "figures.frontier_picture", "floor.floor_map"):  # fmt: skip
                    patch.setattr(f"stltool.reporting.{name}", lambda *args: "")
            try:
                page = render(with_evil_at(data, path))
            except (ValueError, TypeError, LookupError, AttributeError, jinja2.TemplateError):
                refused += 1
                continue
        require_safe(page)
        shown += 1
    assert shown > 0.3 * len(tried)
    assert refused > 0.03 * len(tried) - 1  # in `make test` they are few


@pytest.mark.parametrize("figure", ["<svg onload='alert(1)'></svg>", {"svg": "<svg>"}, ["<svg>"], 7])
def test_markup_is_no_figure(swept, tmp_path, figure):
    data = copy.deepcopy(swept)
    data["sections"][0]["figure"] = figure
    (tmp_path / "report.json").write_text(json.dumps(data))
    with pytest.raises(FileError, match="not the JSON file of a report"):
        load_report(tmp_path / "report.json")


def test_names_of_a_model_and_a_task_stay_texts():
    """The same from the other end: what Python objects are called."""
    model = stl.MDP.from_arrays([np.eye(2)], {"x": [0, 1]}, labels={"A": [0, 1]}, initial=[0.5, 0.5],
                                action_names=["<img src=x onerror=alert(1)>"])  # fmt: skip
    product = stl.build_product(model, stl.parse("F[0,2) A"))
    page = render(report_data([stl.check(product)], source="</pre><script>alert(1)</script>"))
    require_safe(page)
    assert "&lt;img src=x onerror=alert(1)&gt;" in page
