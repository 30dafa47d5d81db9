"""A policy as a file of plain Python acts as the policy does."""

import ast
import itertools
import re
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import PolicyError, SizeError
from stltool.exporting.standalone import MOST_LINES, to_python
from stltool.reached import reachable
from tests import oracles
from tests.checking.test_black_box import hidden
from tests.checking.test_check import products, random_policy
from tests.conftest import FACTORY, many


def program(text):
    """The names that a file defines, without running it as a command."""
    found = {"__name__": "policy"}
    exec(compile(text, "policy.py", "exec"), found)
    return found


def acts_alike(product, policy, text):
    """In every situation that runs can come to, whatever is done before."""
    found, model, automaton = program(text), product.model, product.automaton
    own, outcomes = found["Policy"](), oracles.outcomes_of(product)
    for t, q in itertools.product(range(product.horizon + 1), range(automaton.n_states)):
        verdicts = outcomes(t, q)
        assert own.verdict_of(t, q) == (None if len(verdicts) > 1 else verdicts == {1})
    assert found["START"] == automaton.initial
    for s in range(model.n_states):
        assert found["NEXT"][found["STATES"][model.state_name(s)]] == automaton.delta[product.letter[s]].tolist()
    for t, codes in enumerate(reachable(product)):
        for s, q in zip(*np.divmod(codes, automaton.n_states), strict=True):
            if len(outcomes(t, int(q))) == 1:
                continue
            taken = policy.form.at(t, np.array([s]), np.array([q]))[0]
            names = [
                model.action_names[a] for a in model.choice_action[model.choice_start[s] : model.choice_start[s + 1]]
            ]
            action = own.choose(t, model.state_name(int(s)), int(q))
            if policy.deterministic:
                assert action == names[taken]
            else:
                assert action == {name: weight for name, weight in zip(names, taken, strict=False) if weight > 0}


@given(products(), st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
@settings(max_examples=many(60))
def test_it_acts_as_the_policy_in_every_situation(product, seed, timed, mixed):
    policy = random_policy(product, np.random.default_rng(seed), timed, mixed)
    text = to_python(product, policy)
    acts_alike(product, policy, text)
    own, runner, model = program(text)["Policy"](), stl.Runner(product, policy), product.model
    states = np.random.default_rng(seed).integers(0, model.n_states, product.horizon + 1)
    for s in states.tolist():  # any states, expected or not: the verdict follows
        try:
            action = runner.act(s)
        except PolicyError:
            return
        try:
            mine = own.act(model.state_name(s))
        except LookupError:  # a situation that no run comes to
            return
        words = re.sub(r" \(\d+\)$", "", own.remembered)  # states that are told alike are numbered
        assert (own.verdict, own.step, words) == (runner.verdict, runner.step, runner.remembered or "nothing")
        assert mixed or mine == action


def test_the_factory(patrolling):
    policy = stl.check(patrolling).policy
    text = to_python(patrolling, policy)
    acts_alike(patrolling, policy, text)
    assert "task    patrolling := G[0,4] ((F[0,4] A) & (F[0,4] (x < 0.4 & y > 0.6)))\n" in text
    assert "P       0.737948 that a run satisfies the task, within [0.73794757279958" in text
    assert "    '(1,0)': {7: [(0, 0, 'NE')], " in text


@pytest.mark.parametrize("T", [5, 12])
def test_it_is_short_plain_and_depends_on_nothing(floor10, T):
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": T, "tau": T})
    text = to_python(stl.build_product(floor10, task), stl.check(stl.build_product(floor10, task)).policy)
    assert text.count("\n") <= MOST_LINES
    tree = ast.parse(text)
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    assert imported <= set(sys.stdlib_module_names)
    assert not any(isinstance(node, ast.ImportFrom) for node in ast.walk(tree))
    called = {node.func.id for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    assert not called & {"eval", "exec", "compile", "open", "__import__"}
    assert "stltool" not in text.replace("Generator: stltool", "")


def test_it_runs_isolated_as_a_command(patrolling, tmp_path):
    (tmp_path / "policy.py").write_text(to_python(patrolling, stl.check(patrolling).policy))

    def told(*states):
        command = [sys.executable, "-I", tmp_path / "policy.py"]
        done = subprocess.run(command, input="\n".join(states), capture_output=True, text=True, cwd=tmp_path)
        return done.returncode, done.stdout.split(), done.stderr

    runner = stl.Runner(patrolling)
    states = ["(1,0)", "(2,1)", "(3,1)", "(2,2)", "(1,3)", "(2,2)", "(3,1)", "(2,2)", "(1,3)"]
    expected = [action for action in map(runner.act, states) if action is not None]
    assert told(*states) == (0, [*expected, "satisfied"], "")
    assert told(*states[:2]) == (0, [*expected[:2], "undecided"], "")
    assert told(*["(1,0)"] * 6)[1][-1] == "violated"
    assert told("(1,9)") == (2, [], "error: there is no state '(1,9)'; did you mean (1,4) or (1,3) or (1,1)?\n")


def test_names_of_any_spelling_and_policies_of_any_origin(floor5, patrolling, flagged):
    model = stl.MDP.from_arrays(
        [np.eye(2), np.eye(2)[::-1]], {}, labels={"A": [0, 1]}, name='a\\"""b\n', action_names=["'\\n", '"""'],
        state_names=["\n'", '"""\\'],
    )  # fmt: skip
    product = stl.build_product(model, stl.parse("F[0,2] A"))
    acts_alike(product, stl.check(product).policy, to_python(product, stl.check(product).policy))
    policy = stl.learn(flagged, "cfer", episodes=30, seed=0).policy  # which has a memory of its own
    both, through = policy.on(patrolling)
    if (through.form.at(0, np.array([15]), np.array([both.enter(15, both.automaton.initial)])) >= 0).all():
        own, runner = program(to_python(patrolling, policy))["Policy"](), stl.Runner(patrolling, policy)
        assert own.act("(1,0)") == runner.act("(1,0)")
    unknown = stl.build_product(hidden(floor5), stl.parse("F[0,3] A"))
    assert "P       not known" in to_python(unknown, stl.learn(unknown, episodes=20).policy)


def test_a_policy_of_another_task_or_too_large_an_automaton(patrolling, floor5, monkeypatch):
    policy = stl.check(patrolling).policy
    with pytest.raises(PolicyError, match="not for F"):
        to_python(stl.build_product(floor5, stl.parse("F[0,5) A")), policy)
    monkeypatch.setattr("stltool.exporting.standalone._MOST_MOVES", 10)
    with pytest.raises(SizeError, match="too many for a program; save the policy as .json, and use stl.Runner"):
        to_python(patrolling, policy)
