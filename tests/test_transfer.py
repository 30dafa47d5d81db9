"""Policies on other models: against the policy's decisions written out by name, and what is told of the difference."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool import cli
from stltool.errors import PolicyError, SettingsError
from stltool.models.compare import compare
from stltool.models.mdp import MDP
from tests.checking.test_check import products, random_policy
from tests.conftest import FACTORY, many


def shuffled(model, rng):
    """The same model with states and actions in another order, and other probabilities on the same transitions."""
    states, actions = rng.permutation(model.n_states), rng.permutation(model.n_actions)
    place, number = np.argsort(states), np.argsort(actions)
    rows = np.zeros((model.n_actions, model.n_states, model.n_states))
    for s in range(model.n_states):
        for c in range(model.choice_start[s], model.choice_start[s + 1]):
            entries = slice(model.row_start[c], model.row_start[c + 1])
            p = model.probability[entries] * (0.5 + rng.random(entries.stop - entries.start))
            np.add.at(rows[number[model.choice_action[c]], place[s]], place[model.target[entries]], p / p.sum())
    return MDP.from_arrays(
        rows, {name: values[states] for name, values in model.signals.items()}, initial=model.initial[states],
        labels={name: holds[states] for name, holds in model.labels.items()},
        action_names=[model.action_names[a] for a in actions], name="shuffled",
        state_names=[model.state_name(s) for s in states],
    )  # fmt: skip


@given(products(), st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
@settings(max_examples=many(60))
def test_a_policy_acts_there_by_names(product, seed, timed, mixed):
    """P there is that of a table that is translated state by state and action by action."""
    rng = np.random.default_rng(seed)
    names = [f"state {s}" for s in range(product.model.n_states)]
    home = stl.build_product(named_states(product.model, names), product.formula)
    other = stl.build_product(shuffled(home.model, rng), product.formula)
    policy = random_policy(home, rng, timed, mixed)
    found = stl.check(other, policy, transfer=True)
    here, there = other.model, home.model
    if other.automaton.digest() != home.automaton.digest():
        return
    translated = np.zeros((*((home.horizon,) if timed else ()), *other.shape, here.most_choices))
    for s in range(here.n_states):
        u = names.index(here.state_name(s))
        own = [here.action_names[a] for a in here.choice_action[here.choice_start[s] : here.choice_start[s + 1]]]
        for i, c in enumerate(range(there.choice_start[u], there.choice_start[u + 1])):
            weight = policy.table[..., u, :, i] if mixed else policy.table[..., u, :] == i
            translated[..., s, :, own.index(there.action_names[there.choice_action[c]])] = weight
    expected = stl.check(other, stl.Policy(other, translated if mixed else translated.argmax(axis=-1)))
    assert found.probability == pytest.approx(expected.probability, abs=1e-14)
    assert found.lower <= expected.upper and expected.lower <= found.upper  # noqa: PT018
    again = stl.check(other, found.policy)  # as it acts here, an ordinary policy
    assert again.probability == found.probability
    assert found.transfer.states == found.transfer.actions == ((), ())
    assert (found.transfer.signals, found.transfer.labels, found.transfer.successors) == ({}, {}, 0)


def named_states(model, names):
    return replace(model, state_names=names)


def corridor(n=4, p=0.9, labels=None, actions=("left", "right"), name="corridor"):
    """Cells in a row, A at the end; a move succeeds with probability p."""
    rows = np.zeros((2, n, n))
    for s in range(n):
        for a, step in enumerate((-1, 1)):
            goal = min(max(s + step, 0), n - 1)
            rows[a, s, goal] += p
            rows[a, s, s] += 1 - p
    labels = labels or {"A": [s == n - 1 for s in range(n)]}
    states = [f"cell {s}" for s in range(n)]
    return MDP.from_arrays(rows, {}, labels=labels, action_names=list(actions), state_names=states, name=name)


def test_other_probabilities_are_told_and_judged():
    phi = stl.parse("F[0,5] A")
    policy = stl.check(stl.build_product(corridor(), phi)).policy
    found = stl.check(stl.build_product(corridor(p=0.5, name="ice"), phi), policy, transfer=True)
    assert found.probability == pytest.approx(stl.check(stl.build_product(corridor(p=0.5), phi)).probability)
    assert found.transfer.told == (
        "6 of 8 common choices have other probabilities",
        "the largest distance of a choice is 0.4, at state cell 0, action right",
    )
    assert not found.transfer.same
    same = stl.check(stl.build_product(corridor(), phi), policy, transfer=True)
    assert (same.transfer.told, same.transfer.same) == ((), True)


def test_all_kinds_of_differences():
    first = corridor()
    second = corridor(6, 1.0, {"A": [0, 0, 1, 1, 0, 0], "B": [0] * 6}, ("right", "wait"), "other")
    found = compare(first, second)
    assert found.states == ((), ("cell 4", "cell 5"))
    assert found.actions == (("left",), ("wait",))
    assert (found.labels, found.signals) == ({"A": 1, "B": 4}, {})
    assert (found.choices, found.common) == ((4, 4), 4)  # right, which leads left there
    assert found.distance == pytest.approx(1.0)
    assert any("cell 4, cell 5" in line for line in found.told)
    hidden = MDP.black_box(4, 2, lambda rng: None, labels={"A": [0, 0, 0, 1]})
    assert any("not compared" in line for line in compare(first, hidden).told)


def test_what_the_policy_does_not_know_is_told_where_runs_meet_it():
    phi = stl.parse("F[0,5] A")
    policy = stl.check(stl.build_product(corridor(), phi)).policy
    longer = stl.build_product(corridor(6, labels={"A": [0, 0, 0, 0, 0, 1]}), phi)
    right = stl.Policy(policy.home, np.ones(policy.home.shape, dtype=int))
    with pytest.raises(PolicyError, match="the policy knows no state cell 4, which runs under it reach at step 4"):
        stl.check(longer, right, transfer=True)
    other = stl.build_product(corridor(actions=("left", "walk")), phi)
    with pytest.raises(PolicyError, match="the policy takes right at step 0, state cell 0; .*does not have it"):
        stl.check(other, policy, transfer=True)
    with pytest.raises(
        PolicyError, match="no action of corridor has the name of one of corridor.*such as left, here a"
    ):
        stl.check(stl.build_product(corridor(actions=("a", "b")), phi), policy, transfer=True)
    with pytest.raises(PolicyError, match="is for the task F.*, not for G"):
        stl.check(stl.build_product(corridor(), stl.parse("G[0,5] !A")), policy, transfer=True)
    with pytest.raises(SettingsError, match="is for a policy of another model; give one"):
        stl.check(longer, transfer=True)
    with pytest.raises(PolicyError, match="is for the model corridor"):
        stl.check(longer, policy)


def test_memory_follows_the_run_there():
    """What is remembered of labels is that of the model that is judged: A and B have changed places."""
    phi = stl.parse("F[0,6] (A & F[0,5] B)")
    here, there = {"A": [1, 0, 0, 0], "B": [0, 0, 0, 1]}, {"A": [0, 0, 0, 1], "B": [1, 0, 0, 0]}
    home = stl.build_product(corridor(p=1.0, labels=here), phi)
    policy = stl.check(home).policy
    other = stl.build_product(corridor(p=1.0, labels=there), phi)
    assert stl.check(home, policy).probability == 1
    found = stl.check(other, policy, transfer=True)
    assert found.transfer.labels == {"A": 2, "B": 2}
    assert found.probability == 0  # before A it waits for it where it was, in cell 0


def test_labels_that_never_held_together_are_not_remembered():
    phi = stl.parse("F[0,4] (A & F[0,4] B)")
    home = stl.build_product(corridor(labels={"A": [0, 1, 0, 0], "B": [0, 0, 0, 1]}), phi)
    policy = stl.check(home).policy
    at_once = stl.build_product(corridor(labels={"A": [0, 1, 0, 0], "B": [0, 1, 0, 1]}), phi)
    with pytest.raises(PolicyError, match="does not know what to remember at step 1 in state cell 1: what holds there"):
        stl.check(at_once, policy, transfer=True)
    decided = stl.parse("F[0,5] B")  # which ends there
    policy = stl.check(stl.build_product(home.model, decided)).policy
    assert stl.check(stl.build_product(at_once.model, decided), policy, transfer=True).probability > 0.9


def told(monkeypatch, capsys, *args):
    """What a command that succeeds prints."""
    monkeypatch.setattr(sys, "argv", ["stltool", *map(str, args)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert not ended.value.code
    return capsys.readouterr().out


def test_the_command(monkeypatch, capsys, tmp_path):
    text = (FACTORY / "floor-5x5.toml").read_text()
    (tmp_path / "rough.toml").write_text(text.replace('"93/100"', '"0.8"').replace('"7/300"', '"1/15"'))
    small = [str(FACTORY / "patrolling.stl"), "-p", "T=5", "-p", "tau=5"]
    for kind in ("npz", "csv"):
        policy = tmp_path / f"p.{kind}"
        told(monkeypatch, capsys, "check", *small, "--save-policy", policy)
        asked = ["check", *small, "--model", tmp_path / "rough.toml", "--policy", policy, "--transfer"]
        out = told(monkeypatch, capsys, *asked)
        assert "policy's model  113 of 162 common choices have other probabilities; the largest distance" in out
        assert "the policy                 0.36845795555555" in out
        data = json.loads(told(monkeypatch, capsys, *asked, "--json", "--policy-model", FACTORY / "floor-5x5.toml"))
        assert data["transfer"]["other_probabilities"] == 113
        same = [*asked[:6], "-p", "success=0.8", *asked[8:]]  # the task's own model, with another parameter
        assert "the policy                 0.3684579555555555" in told(monkeypatch, capsys, *same)
