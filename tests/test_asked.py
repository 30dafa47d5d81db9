"""Policies that are functions: as good as the table of their answers, and asked once where runs can get."""

from collections import Counter
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.errors import PolicyError, SettingsError
from tests import oracles
from tests.checking.test_batched import SideBySide
from tests.checking.test_black_box import hidden
from tests.conftest import many

TASKS = ["F[0,3] A", "G[0,2) F[0,2) A", "A U[0,3] B", "F[0,2] (A & F[0,2] B)", "A"]


def rule(step, state, memory, actions):
    """Some action, by everything it may depend on."""
    return actions[(7 * step + 3 * state + memory) % len(actions)]


def table_of(product):
    """The same rule as a table over everything."""
    model = product.model
    table = np.zeros((product.horizon, *product.shape), dtype=np.int64)
    for t, s, q in np.ndindex(table.shape):
        n = int(np.diff(model.choice_start)[s])
        table[t, s, q] = rule(t, s, q, range(n))
    return stl.Policy(product, table)


def reached(product, policy):
    """Every undecided (t, s, q) that runs under the policy reach, one successor after another."""
    model, found = product.model, set()
    here = {(s, product.enter(s, product.automaton.initial)) for s in np.flatnonzero(model.initial).tolist()}
    for t in range(product.horizon):
        here = {(s, q) for s, q in here if product.automaton.verdicts(t)[q] == UNDECIDED}
        found |= {(t, s, q) for s, q in here}
        after = set()
        for s, q in here:
            entry = policy.at(t, [s], [q])[0]
            for i in [int(entry)] if np.ndim(entry) == 0 else np.flatnonzero(entry).tolist():
                c = model.choice_start[s] + i
                after |= {
                    (s2, product.enter(s2, q)) for s2 in model.target[slice(*model.row_start[c : c + 2])].tolist()
                }
        here = after
    return found


@given(st.integers(0, 2**32 - 1), st.sampled_from(TASKS), st.booleans())
@settings(max_examples=many(30))
def test_a_function_is_worth_what_the_table_of_its_answers_is(seed, text, batched):
    product = stl.build_product(oracles.random_model(np.random.default_rng(seed), 5), stl.parse(text))
    asked = Counter()

    def one(here):
        asked[here.step, here.state, here.memory] += 1
        return rule(here.step, here.state, here.memory, here.actions)

    def all_at_once(here):
        asked.update(zip([here.step] * len(here), here.state.tolist(), here.memory.tolist(), strict=True))
        options = [np.flatnonzero(row) for row in here.available]
        return [rule(here.step, s, q, a) for s, q, a in zip(here.state, here.memory, options, strict=True)]

    policy = stl.Policy.from_function(product, all_at_once if batched else one, batched=batched)
    table = table_of(product)
    assert stl.check(product, policy, exact=True).fraction == stl.check(product, table, exact=True).fraction
    assert set(asked) == reached(product, table)
    found = stl.check(product, policy)
    assert found.probability == stl.check(product, table).probability
    assert stl.estimate(product, policy, runs=200).satisfied == stl.estimate(product, table, runs=200).satisfied
    assert set(asked.values()) <= {1}  # nothing is asked again
    assert policy.kind == "time-dependent, deterministic"


@given(st.integers(0, 2**32 - 1), st.sampled_from(TASKS), st.booleans())
@settings(max_examples=many(20))
def test_weights_are_followed(seed, text, batched):
    product = stl.build_product(oracles.random_model(np.random.default_rng(seed), 4), stl.parse(text))
    model = product.model
    counts = np.diff(model.choice_start)

    def shares(step, state, memory, n):
        share = (1 + np.arange(n) + state + step + memory) % 3 + (np.arange(n) == 0)
        return share / share.sum()

    def one(here):
        return dict(zip(here.actions, shares(here.step, here.state, here.memory, len(here.actions)), strict=True))

    def all_at_once(here):
        weights = np.zeros(here.available.shape, dtype=np.float32)  # in which they do not quite sum to 1
        for i in range(len(here)):
            options = np.flatnonzero(here.available[i])
            weights[i, options] = shares(here.step, here.state[i], here.memory[i], len(options))
        return weights

    table = np.zeros((product.horizon, *product.shape, model.most_choices))
    for t, s, q in np.ndindex(table.shape[:3]):
        table[t, s, q, : counts[s]] = shares(t, s, q, counts[s])
    policy = stl.Policy.from_function(product, all_at_once if batched else one, batched=batched, mixed=True)
    exact, near = stl.check(product, stl.Policy(product, table)), stl.check(product, policy)
    assert near.probability == pytest.approx(exact.probability, abs=1e-6 if batched else 1e-12)
    assert near.lower <= stl.check(product, policy, exact=True).fraction <= near.upper
    if not batched:
        found = stl.estimate(product, policy, runs=300, seed=1)
        assert found.satisfied == stl.estimate(product, stl.Policy(product, table), runs=300, seed=1).satisfied
        if policy.form._known and product.horizon:
            assert not stl.Policy.from_function(product, one).deterministic  # as its first answer is


@pytest.mark.parametrize("batched", [False, True])
def test_a_file_may_list_a_state_s_actions_in_any_order(tmp_path, batched):
    rows = ["2 4 5", "0 0 1 1 b", "0 1 0 1 a", "1 0 1 1 a", "1 1 0 1/2 b", "1 1 1 1/2 b"]
    (tmp_path / "m.tra").write_text("\n".join(rows) + "\n")
    (tmp_path / "m.lab").write_text('0="init" 1="deadlock" 2="here"\n0: 0\n1: 2\n')
    model = stl.load_model(tmp_path / "m.tra")
    assert model.action_names[model.choice_action[0]] == "b"
    for name, p in (("a", 0), ("b", 0.5)):
        product = stl.build_product(model, stl.parse("F[1,1] G[0,1] here"))
        number = model.action_names.index(name)
        asked = (lambda here, n=number: np.full(len(here), n)) if batched else (lambda here, n=name: n)
        assert stl.check(product, stl.Policy.from_function(product, asked, batched=batched)).probability == p
        sure = (lambda here, n=number: np.eye(2)[np.full(len(here), n)]) if batched else (lambda here, n=name: {n: 1})
        assert stl.check(product, stl.Policy.from_function(product, sure, batched=batched, mixed=True)).probability == p


def test_what_it_sees(floor5):
    task = stl.parse("F[0,6] (A & F[0,3] x > 0.5)")
    product = stl.build_product(floor5, task)
    seen, seen_together = [], []

    def look(here):
        seen.append(here)
        return "E"

    def look_at_all(here):
        seen_together.append(here)
        return ["E"] * len(here)

    one = stl.check(product, stl.Policy.from_function(product, look))
    assert stl.check(product, stl.Policy.from_function(product, look_at_all, batched=True)) is not None
    assert one.probability > 0
    first = seen[0]
    s = int(floor5.initial.argmax())
    assert (first.step, first.to_go, first.state, first.name) == (0, 9, s, "(1,0)")
    assert first.signals == {"x": 0.3, "y": 0.1}
    assert first.labels == frozenset()
    assert first.actions == floor5.action_names
    for here in seen:
        assert here.remembered == product.automaton.describe(here.memory)
        assert here.labels == {name for name, holds in floor5.labels.items() if holds[here.state]}
        assert here.to_go == product.horizon - here.step > 0
    assert any("A" in here.labels for here in seen)
    assert sum(map(len, seen_together)) == len(seen)
    for here in seen_together:
        assert here.available.shape == (len(here), 9)
        assert here.available.all()
        assert (here.labels["A"] == floor5.labels["A"][here.state]).all()
        assert (here.signals["x"] == floor5.signals["x"][here.state]).all()


def test_other_encodings_and_questions(floor5, tmp_path):
    task = stl.parse("G[0,5) (F[0,5) A & F[0,5) (x < 0.4 & y > 0.6))")
    product = stl.build_product(floor5, task)
    best = stl.check(product).policy
    act = lambda here: int(best.at(here.step, [here.state], [here.memory])[0])  # noqa: E731
    policy = stl.Policy.from_function(product, act)
    exact = stl.check(product, best).probability
    for encoding in ("exact", "paper", "history"):
        other = stl.build_product(floor5, task, encoding)
        assert stl.check(other, policy).probability == pytest.approx(exact, abs=1e-15)
        assert stl.estimate(other, policy, runs=100).satisfied == stl.estimate(product, best, runs=100).satisfied
    assert stl.sample_run(product, policy, seed=3) == stl.sample_run(product, best, seed=3)
    lower, upper = stl.write_certificate(stl.check(product, policy), tmp_path / "c.jsonl.gz")
    assert lower <= exact <= upper
    assert stl.certify(tmp_path / "c.jsonl.gz")["lower"] == str(lower)
    policy.save(tmp_path / "p.npz")  # the table of its answers where runs get
    loaded = stl.load_policy(tmp_path / "p.npz", product)
    assert stl.check(product, loaded).probability == stl.check(product, policy).probability
    table = loaded.table
    assert {tuple(map(int, place)) for place in np.argwhere(table >= 0)} == reached(product, best)
    assert "a function" in repr(policy)
    with pytest.raises(SettingsError, match="a policy that is a function does not run on a cluster"):
        stl.check(product, policy, cluster="tcp://127.0.0.1:1")


def test_in_a_black_box_it_is_asked_where_runs_are(floor5):
    known = stl.build_product(floor5, stl.parse("F[0,6] (A & F[0,3] x < 0.5)"))
    unknown = stl.build_product(hidden(floor5), known.formula)
    asked = []

    def act(here):
        asked.append((here.step, here.state, here.memory))
        return rule(here.step, here.state, here.memory, here.actions)

    policy = stl.Policy.from_function(unknown, act)
    table = stl.Policy(unknown, table_of(known).table)
    assert stl.estimate(unknown, policy, runs=50).satisfied == stl.estimate(unknown, table, runs=50).satisfied
    assert len(asked) == len(set(asked)) > 10
    fleet = SideBySide(floor5, 20)
    assert stl.estimate(unknown, policy, runs=50, environment=fleet).runs == 50
    run = stl.learn(unknown, "model-based", episodes=200)
    start = int(floor5.initial.argmax())
    assert (
        stl.guarantee(unknown, policy, run.counts, start=start).lower
        == stl.guarantee(unknown, table, run.counts, start=start).lower
    )
    with pytest.raises(PolicyError, match="acts in a black box, whose reach is not known has no table"):
        policy.table  # noqa: B018
    mixes = stl.Policy.from_function(unknown, lambda here: np.full(9, 1 / 9), mixed=True)
    assert stl.estimate(unknown, mixes, runs=5).runs == 5
    with pytest.raises(PolicyError, match="mixes actions has no table"):
        mixes.table  # noqa: B018


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ("up", r"returned 'up' at step 0, state 0; x = 0; A; .*, which is not an action; known names: go, stay"),
        ("goo", "which is not an action; did you mean go"),
        (2, "returned 2 at step 0, state 0.*; return an action's name, or its number, 0 … 1$"),
        (True, "returned True at step 0"),
        (-1, "returned -1 at step 0"),
        (0.0, "returned 0.0 at step 0"),
        ("go", "returned go at step 0, state 0; x = 0; A; .*, where it is not available; choose among stay"),
        (None, "the policy defines no action at step 0, state 0"),
        (ZeroDivisionError("oh"), "the policy function raised ZeroDivisionError at step 0, state 0; x = 0; A; .*: oh"),
    ],
)
@pytest.mark.parametrize("batched", [False, True])
def test_answers_that_are_no_actions_are_refused(answer, says, batched):
    stay, go = [[1, 0], [0, 1]], [[0, 0], [0.5, 0.5]]
    model = stl.MDP.from_arrays([stay, go], {"x": [0.0, 1.0]}, labels={"A": [1, 0]}, action_names=["stay", "go"])
    product = stl.build_product(model, stl.parse("F[0,2] x > 0"))

    def act(here):
        if isinstance(answer, Exception):
            raise answer
        return [answer] * len(here) if batched else answer

    with pytest.raises(PolicyError, match=says):
        stl.check(product, stl.Policy.from_function(product, act, batched=batched))


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ({"stay": 0.5}, r"weights \[0.5, 0.0\] at step 0, state 0.* are not a distribution"),
        ({"stay": 1.5, "go": -0.5}, "are not a distribution"),
        ({"stay": 0.5, "go": 0.5}, "returned go at step 0.*, where it is not available"),
        ({"stay": 0.5, "away": 0.5}, "returned 'away' at .*, which is not an action"),
        ([1.0, 0.0, 0.0], "returned .* at .*; return 2 weights, one an action"),
        ([np.nan, 0.0], "are not a distribution"),
        (["a", "b"], "return 2 weights"),
        (None, "returned None at step 0.*; a function that mixes actions returns weights everywhere"),
        ({None: 1.0}, "returned None at step 0"),
    ],
)
def test_weights_that_are_none_are_refused(answer, says):
    stay, go = [[1, 0], [0, 1]], [[0, 0], [0.5, 0.5]]
    model = stl.MDP.from_arrays([stay, go], {"x": [0.0, 1.0]}, labels={"A": [1, 0]}, action_names=["stay", "go"])
    product = stl.build_product(model, stl.parse("F[0,2] x > 0"))
    with pytest.raises(PolicyError, match=says):
        stl.check(product, stl.Policy.from_function(product, lambda here: answer, mixed=True))


def test_a_mixture_may_be_sure_and_a_batch_has_its_size(floor5):
    product = stl.build_product(floor5, stl.parse("F[0,3] A"))
    sure = stl.Policy.from_function(product, lambda here: "E", mixed=True)
    plain = stl.Policy.from_function(product, lambda here: np.array([4]))  # as networks answer
    assert stl.check(product, sure, exact=True).fraction == stl.check(product, plain, exact=True).fraction
    with pytest.raises(PolicyError, match="for 1 situations; return an action for each: a list, or an array of shape"):
        stl.check(product, stl.Policy.from_function(product, lambda here: [1, 2], batched=True))
    with pytest.raises(PolicyError, match=r"return weights of shape \(1, 9\)"):
        stl.check(product, stl.Policy.from_function(product, lambda here: [1, 2], batched=True, mixed=True))
    with pytest.raises(PolicyError, match="or give mixed=True for weights"):
        stl.check(product, stl.Policy.from_function(product, lambda here: np.full(9, 1 / 9), mixed=False))


def test_exact_weights_are_kept():
    product = stl.build_product(
        stl.MDP.from_arrays([[[1, 0], [0, 1]], [[0, 1], [0, 1]]], {}, labels={"A": [0, 1]}), stl.parse("F[0,1] A")
    )
    half = stl.Policy.from_function(product, lambda here: [0.5, 0.5])
    assert stl.check(product, half, exact=True).fraction == Fraction(1, 2)
