"""A failure prints what was drawn as Python code, or task text, that makes it again."""

import ast
import re
import runpy

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.logic.formula import Formula, Not
from stltool.testing import formulas, interval_mdps, mdps, policies, satisfying_traces, task_files, traces
from stltool.testing.printing import code
from tests.conftest import many


def falsifying(strategy):
    """What Hypothesis prints of the argument of a test that fails."""

    shortly = [Phase.generate, Phase.shrink]  # without Hypothesis' comments on which parts matter

    @settings(max_examples=5, database=None, print_blob=False, derandomize=True, phases=shortly)
    @given(strategy)
    def test(one):
        raise AssertionError

    with pytest.raises(AssertionError) as failed:
        test()
    text = "\n".join(failed.value.__notes__)
    return re.search(r"\(\s*one=(.*?),\s*\)\s*$", text, flags=re.DOTALL)[1]


@pytest.fixture
def again(tmp_path):
    """The object that code makes."""

    def made(text, **named):
        (tmp_path / "program.py").write_text(f"import stltool as stl\nfound = {text}\n", encoding="utf-8")
        return runpy.run_path(str(tmp_path / "program.py"), init_globals=named)["found"]

    return made


def test_formulas_print_as_text(again):
    printed = falsifying(formulas(labels=("goal",), signals=()).filter(lambda phi: isinstance(phi, Not)))
    assert printed.startswith("stl.parse('!")
    assert isinstance(again(printed), Formula.__args__)
    assert falsifying(formulas(max_leaves=1)) == "stl.parse('a')"
    long = " & ".join(f"label{i}" for i in range(100))
    assert again(code(stl.parse(long))) == stl.parse(long)


def test_traces_print_as_lists():
    printed = falsifying(satisfying_traces(stl.parse("F[0,2] (a & x > 5)")))
    trace = ast.literal_eval(printed)
    assert trace["a"] == [True, False, False]
    assert stl.satisfies(stl.parse("F[0,2] (a & x > 5)"), trace)
    assert ast.literal_eval(falsifying(traces(2, signals={"x": (1, 2)}))) == {"x": [1.0, 1.0]}


@given(model=st.one_of(mdps(), mdps(exact=True), interval_mdps(states=2)))
@settings(max_examples=many(100))
def test_models_print_as_code(model):
    found = {}
    exec(f"found = {code(model)}", {"stl": stl}, found)
    assert found["found"].digest() == model.digest()
    assert found["found"].rows.given_exactly == model.rows.given_exactly


def test_large_and_unknown_models_print_as_before():
    model = stl.MDP.from_function(500, 1, lambda s, a: (s[:, None], np.ones((len(s), 1))))
    assert code(model) == repr(model)
    assert code("text") == "'text'"


def test_products_policies_and_tasks_print_as_code(again):
    model = stl.MDP.from_arrays([[[1, 0], [0, 1]], [[0, 1], [1, 0]]], {}, labels={"a": [0, 1]}, state_names=["s", "t"])
    product = stl.build_product(model, stl.parse("F[0,2] a"), encoding="paper")
    twin = again(code(product))
    assert (twin.automaton.encoding, twin.model.digest(), list(twin.model.state_names)) == (
        "paper",
        model.digest(),
        ["s", "t"],
    )
    policy = again(falsifying(policies(product)), product=product)
    assert stl.check(product, policy).probability == stl.check(product, policy).lower
    best = stl.check(product).policy
    assert code(best) == repr(best)  # its choices are no table
    task = stl.parse_task("param T = 3\nreach := F[0,T] a")
    assert again(code(task)) == task
    assert stl.parse_task(ast.literal_eval(falsifying(task_files()))).name == "task"
