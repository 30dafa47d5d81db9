"""What a REPL and a notebook show: three lines of text and a small table of every public class's objects."""

import contextlib
import inspect
from html.parser import HTMLParser
from typing import get_args

import numpy as np
import pytest

import stltool as stl
from stltool.display import Card, cut

SETUP = """
from pathlib import Path

import numpy as np
import stltool as stl

# names that would be markup if they were not escaped
rows = [[["0.5", "0.5", "0"], ["0.1", "0.8", "0.1"], ["0", "0", "1"]]] * 2
model = stl.MDP.from_arrays(
    rows, {"x": [0.0, 0.5, 1.0]}, labels={"A": [0, 1, 0], "B": [0, 0, 1]}, action_names=["<b>N</b>", "S & E"],
    state_names=["<i>0</i>", "1", "2"], name="<script>alert(1)</script>",
)
task = stl.parse_task("param T = 3\\nreach := F[0,T] A & G[0,1] (x < 0.9)")
product = stl.build_product(model, task)
best = stl.check(product)
joint = stl.build_joint_product(model, {"reach": task, "stay": stl.parse("G[0,2] (x < 0.9)")})
blurred = stl.MDP.from_intervals([[[0.5, 0.2], [0.3, 0.3]]], [[[0.8, 0.5], [0.7, 0.7]]], {}, labels={"A": [1, 0]})
training = stl.learn(product, "naive", episodes=30)
signals = {"x": np.linspace(0, 1, 40).reshape(4, 10)}
online = stl.OnlineMonitor(stl.parse("F[0,2] (x > 0.5)"))
Path("task.stl").write_text("reach := F[0,3] A\\n")
Path("model.toml").write_text('kind = "grid"\\nmap = "SA"\\ncell = 1\\nmoves = "cross"\\nsuccess = 1\\n')
Path("sweep.toml").write_text(
    '[sweep]\\nname = "small"\\nseeds = 2\\nsettings = { episodes = 9 }\\n[[method]]\\nname = "naive"\\n'
    '[[scenario]]\\nid = "R1"\\ntask = "task.stl"\\nmodel = "model.toml"\\n'
)
sweep = stl.load_sweep("sweep.toml")
Path("expected.stl").write_text('model "model.toml"\\nreach := F[0,3] A\\nexpect Pmax(reach) >= 1\\n')

class Walk:
    def reset(self): return 0
    def step(self, i): return 1

family = stl.MDP.from_arrays([[["p", "1-p"], [0, 1]]], {}, labels={"A": [0, 1]}, parameters={"p": (0.5, 1)})
of_family = stl.build_product(family, stl.parse("F[0,2] A"))
hidden = stl.MDP.black_box(2, 1, lambda rng: Walk(), labels={"A": [0, 1]})
"""

# class → an expression with an object of it, and what a reader looks for
CELLS = {
    "Formula": ("task.formula", "F[0,3] A"),
    "Task": ("task", "reach := "),
    "Fragment": ("stl.check_fragment(stl.parse('G[0,3] (F[0,2] A & F[0,4] B)'))", "F[0,5) B"),
    "Meaning": ("stl.meaning(task)", "can hold: yes"),
    "MonitorResult": ("stl.monitor(stl.parse('x < 0.5'), signals)", "4 traces of 10 samples"),
    "Diagnosis": ("stl.diagnose(stl.parse('F[0,2] A'), {'A': [0, 0, 1]})", "Diagnosis: holds at step 0, 1 cause"),
    "SmoothRobustness": ("stl.smooth_robustness(stl.parse('F[0,2] (x > 0.5)'), signals, 10.0)", "beta 10"),
    "Recording": ("stl.Recording({'x': [1, 2]}, times=[0, 0.5], clock='column t')", "Recording of 1 signal"),
    "OnlineMonitor": ("online", "0 samples read"),
    "Decisions": ("stl.OnlineMonitor(stl.parse('x > 0.5')).feed({'x': [0.2, 0.7]})", "2 steps"),
    "Decision": ("stl.OnlineMonitor(stl.parse('x > 0.5')).feed({'x': 0.1})[0]", "false"),
    "TaskAutomaton": ("product.automaton", "letters"),
    "MDP": ("model", "3 states, 2 actions"),
    "Product": ("product", "3 model states"),
    "JointProduct": ("joint", "stay := "),
    "ProductMDP": ("stl.product_mdp(product)", "maximum: Pmax=? [ F"),
    "Policy": ("best.policy", "time-dependent, deterministic"),
    "CheckResult": ("best", "P = "),
    "StateValues": ("stl.check(product, values='all').values", "P from each of 3 states"),
    "Run": ("stl.sample_run(product, seed=3)", "seed: 3"),
    "Counterfactual": ("stl.counterfactual(product, stl.sample_run(product, seed=3))", "would have made P = "),
    "Runner": ("stl.Runner(product)", "before the first state, undecided"),
    "Frontier": ("stl.frontier(model, stl.parse_task('param n = 1\\nr := F[0,n] A'), 0.5, {'n': [1, 2]})", "bisection"),
    "CostDistribution": ("stl.cost_distribution(product, 'A', 2)", "P(task and A <= c)"),
    "LongRun": ("stl.long_run(product)", "share = "),
    "ExpectedCost": ("stl.expected_cost(product, 'x')", "E[x] = "),
    "Estimate": ("stl.estimate(product, runs=50, seed=4)", "of 50 runs satisfied"),
    "SequentialTest": ("stl.sprt(product, at_least=0.9, most_runs=500)", "P >= 0.9"),
    "LikelyRuns": ("stl.likely_runs(product)", "violating run"),
    "Sensitivity": ("stl.sensitivity(product)", "states that move P most"),
    "Shield": ("stl.shield(product, 0.5)", "under every policy"),
    "StationaryResult": ("stl.stationary(product)", "proved to be the best"),
    "SurrogateResult": (
        "stl.surrogate_optimum(stl.build_product(model, stl.parse('F[0,3] A')), gamma=0.9)",
        "discounted",
    ),
    "Tradeoff": ("stl.tradeoff(joint, 'reach', at_least={'stay': 0.5})", "P(stay) >= 0.5"),
    "ParametricResult": ("stl.parametric(stl.build_product(family, stl.parse('F[0,2] A')))", "for p in [0.5, 1]"),
    "RobustnessDistribution": ("stl.robustness_distribution(model, stl.parse('F[0,2] x > 0.5'))", "the maximum"),
    "TimeDistribution": ("stl.time_distribution(model, stl.parse('F[0,2] x > 0.5'), 1)", "k from 0 to 1"),
    "PolicyTree": ("stl.policy_tree(product)", "leaves, P = "),
    "Verification": ("stl.verify('expected.stl')", "1 expectation: 1 holds"),
    "Verified": ("stl.verify('expected.stl').results[0]", "Verified: holds, expected.stl:3"),
    "Gap": ("stl.optimality_gap(of_family, None, stl.Counts(2, 2), parameters='model')", "p in [0.5, 1]"),
    "Front": ("stl.pareto(joint)", "reach and stay"),
    "Training": ("training", "naive, 30 episodes"),
    "Guarantee": ("stl.guarantee(product, training.policy, training.counts)", "with confidence 99 %"),
    "Counts": ("training.counts", "choices never tried"),
    "MarkovTest": ("stl.markov_test(training.counts)", "not rejected"),
    "Sweep": ("sweep", "1 scenario x 1 method x 2 seeds"),
    "SweepResult": ("stl.run_sweep(sweep, 'swept', workers=1)", "2 runs finished"),
    "Cfer": ("stl.Cfer(optimism=0.5)", "optimism"),
    "ModelBased": ("stl.ModelBased()", "caution"),
    "Naive": ("stl.Naive()", "least_step"),
    "NaiveER": ("stl.NaiveER()", "batch"),
    "PublishedCfer": ("stl.PublishedCfer()", "gamma"),
    "PublishedCfper": ("stl.PublishedCfper()", "gamma"),
    "PublishedNaive": ("stl.PublishedNaive()", "gamma"),
    "PublishedNaiveER": ("stl.PublishedNaiveER()", "gamma"),
}

# others that a session shows
MORE = {
    "a long formula": ("stl.parse(' & '.join(f'F[0,{i}] A' for i in range(500)))", "..."),
    "a model with intervals": ("blurred", "intervals"),
    "a black box": ("stl.MDP.black_box(2, 2, lambda rng: None)", "a black box"),
    "a gap without a tie": ("stl.optimality_gap(product, best.policy, training.counts)", "P* - P(policy) <="),
    "a model with a parameter": ("family", "depend on p in [0.5, 1]"),
    "a robust check": ("stl.robust_check(stl.build_product(blurred, stl.parse('F[0,3] A')))", "adversarial nature"),
    "an exact check": ("stl.check(product, exact=True)", "7/8"),
    "a policy's check": ("stl.check(product, training.policy)", "of the policy"),
    "a likely run": ("stl.likely_runs(product).runs[0]", "violated"),
    "an expression": ("2 * stl.signal('x') + 1", "2 * x + 1"),
    "verdicts alone": ("stl.monitor(stl.parse('x < 0.5'), signals, semantics='boolean')", "traces with a violation"),
    "a single trace": ("stl.monitor(stl.parse('x < 0.5'), {'x': [0.1, 0.9]})", "first violation: at step 1"),
    "counts": ("training.counts", "transitions of 6 choices"),
    "a training on a black box": (
        "stl.learn(stl.build_product(hidden, stl.parse('F[0,2] A')), episodes=2)",
        "unknown: the model is a black box",
    ),
    "a policy for two tasks": ("stl.tradeoff(joint, 'stay').policy", "mixed"),
}


def test_every_public_class_is_shown():
    classes = {name for name in stl.__all__ if inspect.isclass(getattr(stl, name))} | {"Formula"}
    assert classes - {"StlToolError", "Learner"} == set(CELLS)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    with contextlib.chdir(tmp_path_factory.mktemp("session")):
        names = {}
        exec(SETUP, names)
        yield names


@pytest.mark.parametrize("name", [*CELLS, *MORE])
def test_three_lines_of_text_at_most(name, session):
    expression, wanted = {**CELLS, **MORE}[name]
    thing = eval(expression, session)
    if name in CELLS:
        kinds = get_args(stl.Formula) if name == "Formula" else (getattr(stl, name),)
        assert isinstance(thing, kinds)
    text = repr(thing)
    if name != "Decision":  # a named tuple shows itself as one
        assert wanted in text
    assert len(text.splitlines()) <= 3
    assert max(map(len, text.splitlines())) <= 310
    assert text.isascii()


@pytest.mark.parametrize("name", [*CELLS, *MORE])
def test_what_hangs_on_an_object_is_short_too(name, session):
    """Arrays apart, which numpy shortens itself."""
    thing = eval({**CELLS, **MORE}[name][0], session)
    for key in dir(thing):
        value = getattr(thing, key) if not key.startswith("_") and not callable(getattr(thing, key, None)) else None
        for part in value if isinstance(value, list | tuple) else [value]:
            if not isinstance(part, np.ndarray):
                assert len(repr(part).splitlines()) <= 3, key
                assert len(repr(part)) < 500, key


class Tags(HTMLParser):
    """Text and tags of a page; every tag must be closed."""

    def __init__(self, page):
        super().__init__()
        self.open, self.seen, self.text = [], set(), []
        self.feed(page)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        self.seen.add(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.mark.soak(only=True)
def test_a_notebook_shows_every_object_as_a_table(tmp_path, monkeypatch):
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    monkeypatch.setenv("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    cells = {**CELLS, **MORE}
    book = nbformat.v4.new_notebook()
    book.cells = [nbformat.v4.new_code_cell(source) for source in (SETUP, *(cell for cell, _ in cells.values()))]
    nbclient.NotebookClient(
        book, timeout=600, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    ).execute()
    for cell, (name, (_, wanted)) in zip(book.cells[1:], cells.items(), strict=True):
        data = next(output["data"] for output in cell.outputs if output["output_type"] == "execute_result")
        page = Tags(data["text/html"])
        assert page.seen <= {"div", "strong", "table", "tr", "th", "td", "p"}, name
        value = wanted.partition(": ")[2] or wanted
        assert value in " ".join(page.text) or name == "a long formula", name
        assert len(data["text/html"]) < 20_000, name
    shown = "".join(cell.outputs[-1]["data"]["text/html"] for cell in book.cells[1:])
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in shown
    assert "&lt;b&gt;N&lt;/b&gt;" in shown
    assert "S &amp; E" in shown


def test_what_is_long_is_cut():
    assert cut("a" * 50, 10) == "aaaaaaa..."
    assert cut("two\nlines", 20) == "two lines"
    card = Card("title", [{"a": 1, "none": None}, {"b": "x" * 500}, {"c": 3}], (("h",), [("<",)] * 2), more=7)
    assert card.text().splitlines()[:2] == ["title", "  a: 1"]
    assert [len(line) for line in card.text().splitlines()] == [5, 6, 120]
    assert "<td>&lt;</td>" in card.html()
    assert "<p>7 more</p>" in card.html()
    assert "none" not in card.html()
