"""A policy in a robot's software: the runner against the automaton, the table and the checker."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.checking.situations import Situations
from stltool.errors import ArgumentError, NameLookupError, PolicyError, SettingsError, SizeError
from tests.checking.test_black_box import hidden
from tests.checking.test_check import products, random_policy
from tests.conftest import many


@given(products(), st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
@settings(max_examples=many(60))
def test_a_run_is_that_of_the_policy_and_its_verdict_that_of_the_trace(product, seed, timed, mixed):
    rng = np.random.default_rng(seed)
    policy = random_policy(product, rng, timed, mixed)
    runner, here, model = stl.Runner(product, policy, seed=seed), Situations(product, policy), product.model
    assert runner.probability == pytest.approx(stl.check(product, policy).probability, abs=1e-13)
    for _ in range(2):
        runner.reset()
        s, trace, q = int(rng.choice(model.n_states, p=model.initial)), [], product.automaton.initial
        while runner.verdict is None:
            t, q = len(trace), product.enter(s, q)
            trace.append(s)
            action = runner.act(s)
            assert (runner.step, runner.state) == (t, model.state_name(s))
            assert runner.probability == pytest.approx(here.value(t, s, q), abs=1e-13)
            if action is None:
                break
            assert action in runner.actions
            names = [
                model.action_names[a] for a in model.choice_action[model.choice_start[s] : model.choice_start[s + 1]]
            ]
            assert here.weights(t, s, q)[names.index(action)] > 0
            c = model.choice_start[s] + names.index(action)
            entries = slice(model.row_start[c], model.row_start[c + 1])
            s = int(rng.choice(model.target[entries], p=model.probability[entries]))
        signals = {name: values[trace] for name, values in {**model.signals, **model.labels}.items()}
        longest = {name: np.append(values, [values[-1]] * product.horizon) for name, values in signals.items()}
        if len(trace) == product.horizon + 1:
            assert runner.verdict == stl.satisfies(product.formula, longest)
        assert runner.verdict is not None
        assert (runner.act(s), runner.step, runner.actions) == (None, len(trace) - 1, ())
        assert runner.probability == runner.verdict


def test_p_under_a_mixture_is_that_of_the_checker(patrolling):
    weights = np.random.default_rng(0).random((*patrolling.shape, 9)) ** 4
    best = stl.check(patrolling).policy.table
    for mixture in (0.2, 0.5):
        rows = mixture * weights / weights.sum(axis=-1, keepdims=True) + (1 - mixture) * np.eye(9)[best]
        policy = stl.Policy(patrolling, rows)
        assert stl.Runner(patrolling, policy).probability == pytest.approx(stl.check(patrolling, policy).probability)


def test_shares_of_a_mixture_are_drawn(patrolling):
    weights = np.zeros((*patrolling.shape, 9))
    weights[..., 1], weights[..., 4] = 0.25, 0.75
    runner = stl.Runner(patrolling, stl.Policy(patrolling, weights), seed=1)
    drawn = []
    for _ in range(400):
        runner.reset()
        drawn.append(runner.act("(1,0)"))
    names = patrolling.model.action_names
    assert set(drawn) == {names[1], names[4]}
    assert 70 < drawn.count(names[1]) < 130  # 100 expected, deviation 8.7
    again = stl.Runner(patrolling, stl.Policy(patrolling, weights), seed=1)
    assert again.act("(1,0)") == drawn[0]


def test_states_by_name_number_and_what_is_seen(patrolling):
    number = patrolling.model.state_names.index("(1,0)")
    for state in (
        "(1,0)",
        " (1, 0)",
        number,
        np.int32(number),
        {"x": 0.3, "y": 0.1},
        {"x": "0.3", "y": np.float32(0.1)},
    ):
        runner = stl.Runner(patrolling)
        assert runner.act(state) == "NE"
        assert (runner.state, runner.step) == ("(1,0)", 0)
        assert runner.remembered == "at_A not seen for 1 step; at_B not seen for 1 step"


@pytest.mark.parametrize(
    ("state", "error", "says"),
    [
        ("(1,9)", NameLookupError, r"there is no state '\(1,9\)'; did you mean \(1,4\) or "),
        (18, SettingsError, "act's state is 18"),
        (-1, SettingsError, "act's state is -1"),
        (True, ArgumentError, "act's state is True"),
        (0.5, ArgumentError, "give its name, its number, or the values of signals and labels"),
        ({"x": 0.3}, NameLookupError, r"x = 0.3: 4 states with this, \(1,4\), .*; give y or A or B or C, too"),
        ({}, NameLookupError, "nothing: 18 states with this"),
        ({"x": 0.31, "y": 0.1}, NameLookupError, r"no such state; the nearest is \(1,0\), with x = 0.3, y = 0.1"),
        ({"x": 0.3, "z": 0.1}, NameLookupError, "the model has no signal or label 'z'; known names"),
        ({"x": "left", "y": 0.1}, ArgumentError, "the value of x"),
        ({"x": float("nan"), "y": 0.1}, ArgumentError, "the value of x"),
    ],
)
def test_unknown_states_leave_the_run_as_it_was(patrolling, state, error, says):
    runner, twin = stl.Runner(patrolling), stl.Runner(patrolling)
    runner.act("(1,0)")
    twin.act("(1,0)")
    with pytest.raises(error, match=says):
        runner.act(state)
    assert (runner.step, runner.state) == (0, "(1,0)")
    assert (runner.act("(2,1)"), runner.remembered) == (twin.act("(2,1)"), twin.remembered)


def test_states_without_names_are_numbers(tmp_path):
    model = stl.MDP.from_arrays([np.eye(2)], {}, labels={"A": [0, 1], "B": [0, 1]})
    runner = stl.Runner(stl.build_product(model, stl.parse("F[0,2] A")))
    assert runner.act("0") == "0"
    with pytest.raises(NameLookupError, match="there is no state '2'; its states are numbered from 0 to 1"):
        runner.act("2")
    assert runner.act({"A": True}) is None
    assert runner.verdict is True


def test_a_state_that_the_model_does_not_expect_is_gone_on_from(patrolling):
    """Someone carries the robot elsewhere: memory and P follow, to the same value as from the checker started there."""
    policy = stl.check(patrolling).policy
    runner = stl.Runner(patrolling, policy)
    runner.act("(1,0)")
    runner.act("(3,1)")  # two cells at once
    lucky = runner.probability
    assert runner.verdict is None
    model = patrolling.model
    s, t, q = model.state_names.index("(3,1)"), 1, runner._q

    def value(t, s, q):
        verdict = patrolling.automaton.verdicts(t)[q]
        if verdict >= 0:
            return float(verdict)
        c = model.choice_start[s] + int(policy.at(t, s, q)[0])
        entries = range(model.row_start[c], model.row_start[c + 1])
        return sum(
            model.probability[k] * value(t + 1, model.target[k], patrolling.enter(model.target[k], q)) for k in entries
        )

    assert lucky == pytest.approx(value(t, s, q), abs=1e-12)


def test_a_silent_policy_says_where_and_the_run_stays(patrolling):
    policy = stl.Policy(patrolling, np.full(patrolling.shape, -1))
    runner = stl.Runner(patrolling, policy)
    with pytest.raises(PolicyError, match=r"defines no action at step 0, state \(1,0\)"):
        runner.act("(1,0)")
    assert runner.step is None
    assert np.isnan(runner.probability)


def test_policies_with_a_memory_of_their_own(patrolling, flagged):
    policy = stl.learn(flagged, "cfer", episodes=50, seed=0).policy
    runner = stl.Runner(patrolling, policy)
    assert runner.probability == pytest.approx(stl.check(patrolling, policy).probability, abs=1e-13)
    assert runner.act("(1,0)") in patrolling.model.action_names
    assert "the policy: " in runner.remembered


def test_a_black_box_has_verdicts_but_no_probabilities(floor5):
    product = stl.build_product(hidden(floor5), stl.parse("F[0,3] A"))
    runner = stl.Runner(product, stl.learn(product, episodes=20).policy)
    assert runner.act("(1,0)") is not None
    with pytest.raises(SettingsError, match="probabilities of hidden are unknown"):
        runner.probability  # noqa: B018
    assert runner.act("(3,1)") is None
    assert runner.verdict is True
    with pytest.raises(SettingsError, match="is a black box, whose optimal policy is not known; give Runner a policy"):
        stl.Runner(product)


def test_too_many_situations_leave_act_at_work(patrolling, monkeypatch):
    monkeypatch.setattr("stltool.checking.runner._MOST_NODES", 3)
    runner = stl.Runner(patrolling)
    assert runner.act("(1,0)") == "NE"
    with pytest.raises(SizeError, match="act and verdict work without it"):
        runner.probability  # noqa: B018


@pytest.mark.parametrize("rule", ["static", "ratio"])
def test_a_shield_is_obeyed_whatever_the_policy(patrolling, rule):
    """The worst policy, replaced where it is refused: every action is allowed, and the promise is kept."""
    promise = 0.9 * stl.check(patrolling).probability
    shield = stl.shield(patrolling, promise, rule, levels=16)
    worst = stl.check(patrolling, maximize=False).policy
    runner, model, rng = stl.Runner(patrolling, worst, shield=shield), patrolling.model, np.random.default_rng(1)
    satisfied, replaced, runs = 0, 0, 150
    for _ in range(runs):
        runner.reset()
        s, q, spent = int(rng.choice(model.n_states, p=model.initial)), patrolling.automaton.initial, 0
        while (action := runner.act(s)) is not None:
            t, q = runner.step, patrolling.enter(s, q)
            names = [model.action_names[a] for a in model.choice_action[model.choice_start[s] :][: len(runner.actions)]]
            spent = shield.spend(t, s, q, names.index(action), spent)  # refused actions raise
            assert runner.allowance == shield.allowance(spent)
            replaced += runner.replaced
            c = model.choice_start[s] + names.index(action)
            entries = slice(model.row_start[c], model.row_start[c + 1])
            s = int(rng.choice(model.target[entries], p=model.probability[entries]))
        assert not runner.replaced
        satisfied += runner.verdict
    assert replaced > 0
    assert satisfied / runs >= promise - 0.15  # more than three standard deviations


def test_a_shield_belongs_to_the_product(patrolling):
    other = stl.build_product(patrolling.model, stl.parse("F[0,5] A"))
    with pytest.raises(PolicyError, match="the shield is for the task"):
        stl.Runner(patrolling, shield=stl.shield(other, 0.1))
    runner = stl.Runner(patrolling, shield=stl.shield(patrolling, 0.1))
    with pytest.raises(SettingsError, match="with a shield, P is not that of the policy"):
        _ = runner.probability
    flags = stl.build_product(patrolling.model, patrolling.formula, "paper")
    with pytest.raises(PolicyError, match="build the product with the shield's encoding"):
        stl.Runner(flags, shield=stl.shield(patrolling, 0.1))
