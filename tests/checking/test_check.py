"""`check` against the enumeration of all history-dependent policies, and its laws."""

import dataclasses
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.checking.check import double_errors
from stltool.errors import PolicyError, SizeError
from stltool.logic.formula import Not
from stltool.testing import flag_formulas, formulas, mdps
from tests import oracles
from tests.conftest import OUTSIDE, ROOT, many, needs_outside

LABELS = ("a", "b", "c")


@st.composite
def products(draw, longest=2, **options):
    """Random tiny models with tasks of any kind; histories up to five steps."""
    model = draw(mdps(**options))
    flags = flag_formulas(longest=longest, equal=False)
    phi = draw(st.one_of(flags, formulas(longest=longest, max_leaves=5, horizon=2 * longest + 1)))
    return stl.build_product(model, phi)


def close(result, exact):
    assert abs(Fraction(result.probability) - exact) <= Fraction(1, 10**12)
    assert Fraction(result.lower) <= exact <= Fraction(result.upper)
    assert result.status == "complete"


@given(products())
@settings(max_examples=many(60))
def test_optimum_equals_the_tree_of_all_histories(product):
    model, phi = product.model, product.formula
    close(stl.check(product), oracles.optimum(model, phi))
    close(stl.check(product, maximize=False), oracles.optimum(model, phi, maximize=False))


@given(products(longest=1, states=2, single_start=True))
@settings(max_examples=many(40))
def test_optimum_equals_the_enumeration_of_all_policies(product):
    model, phi = product.model, product.formula
    close(stl.check(product), oracles.enumerated_optimum(model, phi))
    close(stl.check(product, maximize=False), oracles.enumerated_optimum(model, phi, maximize=False))


@given(products())
def test_maximum_and_minimum_are_dual(product):
    """P_max(Φ) = 1 − P_min(¬Φ)."""
    negated = stl.build_product(product.model, Not(product.formula))
    best, worst = stl.check(product), stl.check(negated, maximize=False)
    assert best.probability == pytest.approx(1 - worst.probability, abs=1e-12)
    assert stl.check(product, maximize=False).probability <= best.upper


def random_policy(product, rng, timed, mixed):
    n_choices = np.diff(product.model.choice_start)
    shape = (product.horizon, *product.shape) if timed else product.shape
    if not mixed:
        return stl.Policy(product, (rng.random(shape) * n_choices[:, None]).astype(int))
    weights = rng.random((*shape, n_choices.max())) * (np.arange(n_choices.max()) < n_choices[:, None, None])
    return stl.Policy(product, weights / weights.sum(axis=-1, keepdims=True))


@given(products(), st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
@settings(max_examples=many(60))
def test_a_policys_value_equals_the_tree_of_its_runs(product, seed, timed, mixed):
    policy = random_policy(product, np.random.default_rng(seed), timed, mixed)
    result = stl.check(product, policy)
    close(result, oracles.policy_value(product, policy))
    assert result.probability <= stl.check(product).upper + 1e-15
    assert result.probability >= stl.check(product, maximize=False).lower - 1e-15


@given(products())
def test_the_optimal_policy_attains_the_optimum(product):
    for maximize in (True, False):
        best = stl.check(product, maximize=maximize)
        assert stl.check(product, best.policy).probability == best.probability
        assert stl.check(product, maximize=maximize, keep_policy=False).probability == best.probability


@given(products(states=4, actions=3), st.integers(0, 2**32 - 1))
def test_engines_agree(product, seed):
    rng = np.random.default_rng(seed)
    policies = [None] + [random_policy(product, rng, timed, mixed) for timed in (0, 1) for mixed in (0, 1)]
    for policy in policies:
        one, other = (stl.check(product, policy, engine=engine) for engine in ("nodes", "words"))
        assert (one.probability, one.lower, one.upper) == (other.probability, other.lower, other.upper)


def test_threads_change_nothing(floor10, monkeypatch):
    task = stl.load_task(ROOT / "examples/factory/patrolling.stl")
    product = stl.build_product(floor10, task)
    alone = stl.check(product, engine="words", threads=1)
    monkeypatch.setattr("stltool.checking.induction.words._WORTH_WORDS", 1)
    together = stl.check(product, engine="words", threads=4)
    assert together.probability == alone.probability
    assert np.array_equal(together.policy.table, alone.policy.table)


def test_sanity_figures_of_the_design(floor5, floor10):
    factory = ROOT / "examples" / "factory"

    def optimum(model, task, **params):
        return stl.check(stl.build_product(model, stl.load_task(factory / task, params=params))).probability

    assert optimum(floor5, "patrolling.stl", T=5, tau=5) == pytest.approx(0.737948, abs=5e-7)
    assert optimum(floor10, "charging.stl", T=10, tau=5) == pytest.approx(0.999971, abs=5e-7)
    assert optimum(floor5, "charging.stl", T=10, tau=5) > 0.999999


@pytest.mark.parametrize("tau", [5, 10])
def test_optima_of_the_papers_scenarios(floor5, floor10, tau):
    """Lower bounds and figures of the scenario table (docs/reproduction.md)."""
    factory = ROOT / "examples" / "factory"
    for model in (floor5, floor10):
        reach = stl.load_task(factory / "reaching.stl", params={"T": 10, "tau": tau})
        assert stl.check(stl.build_product(model, reach)).probability >= 0.9999
    patrol = [(floor5, 10, 0.99999), (floor5, 15, 0.99999), (floor10, 10, 0.99829), (floor10, 15, 0.99999)]
    for model, T, figure in patrol:
        task = stl.load_task(factory / "patrolling.stl", params={"T": T, "tau": T})
        assert stl.check(stl.build_product(model, task)).probability == pytest.approx(figure, abs=1e-5)


@needs_outside("published-policies")
@pytest.mark.parametrize(
    ("table", "floor", "task", "T", "figure"),
    [
        ("CFER_tau5_grid5_0905.csv", "floor5", "patrolling.stl", 5, 0.649272),
        ("naive_tau5_grid5_0905.csv", "floor5", "patrolling.stl", 5, 0.015475),
        ("naiveER_tau5_grid10_0905.csv", "floor10", "charging.stl", 10, 0.978223),
    ],
)
def test_published_q_tables_have_their_known_probability(request, table, floor, task, T, figure):
    task = stl.load_task(ROOT / "examples" / "factory" / task, params={"T": T, "tau": 5})
    product = stl.build_product(request.getfixturevalue(floor), task)
    policy = stl.Policy.from_q_table(OUTSIDE / "published-policies" / table, product)
    result = stl.check(product, policy)
    assert result.probability == pytest.approx(figure, abs=1e-6)
    assert result.probability <= stl.check(product).upper


def test_a_stationary_policy_can_be_strictly_worse():
    """Try again while there is time, take the risk at the last step: the clock is needed."""
    goal, dead = [0, 1, 0], [0, 0, 1]
    model = stl.MDP.from_arrays(
        [[[0.7, 0.3, 0], goal, dead], [[0, 0.5, 0.5], goal, dead]],
        {"x": [0, 1, 2]},
        labels={"goal": [0, 1, 0]},
        action_names=["try", "risk"],
    )
    product = stl.build_product(model, stl.parse("F[0,3] goal"))
    best = stl.check(product)
    assert best.probability == pytest.approx(1 - 0.7 * 0.7 * 0.5)
    assert [int(best.policy.row(t)[0, 0]) for t in range(3)] == [0, 0, 1]
    stationary = [
        stl.check(product, stl.Policy(product, np.full(product.shape, choice))).probability for choice in (0, 1)
    ]
    assert stationary == pytest.approx([1 - 0.7**3, 0.5])
    assert max(stationary) < best.probability


def test_undefined_states_are_named_when_they_can_be_reached(patrolling):
    table = stl.check(patrolling).policy.table.copy()
    s = int(patrolling.model.initial.argmax())
    table[0, s, :] = -1
    with pytest.raises(
        PolicyError, match=r"defines no action at step 0, state \(1,0\); x = 0.3, y = 0.1[^|]*, which is"
    ):
        stl.check(patrolling, stl.Policy(patrolling, table))
    silent = stl.Policy(patrolling, np.full_like(table, -1))
    with pytest.raises(PolicyError, match=r"defines no action at step 0, state \(1,0\); [^|]*, which is"):
        stl.check(patrolling, silent)
    with pytest.raises(PolicyError, match="defines no action at step 0"):
        stl.sample_run(patrolling, stl.Policy(patrolling, table), seed=0)
    table = stl.check(patrolling).policy.table.copy()
    table[0, s - 1, :] = -1  # never there at step 0
    assert stl.check(patrolling, stl.Policy(patrolling, table)).probability == stl.check(patrolling).probability


def test_silent_places_are_told_apart(patrolling):
    """Reachable ones first, by name; the others by number."""
    table = np.full((8, *patrolling.shape), -1, dtype=np.int16)
    with pytest.raises(PolicyError, match=r"no action at step 0, state \(1,0\).*, which is reachable under it \(467"):
        stl.check(patrolling, stl.Policy(patrolling, table))
    table = stl.check(patrolling).policy.table[0].copy()  # stationary
    corners = [patrolling.model.state_names.index(name) for name in ("(0,0)", "(4,4)")]
    table[:] = 0
    table[int(patrolling.model.initial.argmax())] = 3  # W, towards the corner; elsewhere it stays
    table[corners] = -1
    with pytest.raises(PolicyError) as refusal:
        stl.check(patrolling, stl.Policy(patrolling, table))
    message = str(refusal.value)
    assert "at step 1, state (0,0)" in message
    assert "state (4,4)" not in message
    assert "others are not" in message


def test_an_enormous_horizon_is_no_more_than_the_steps_until_all_repeat(floor5):
    """The enclosure still counts a rounding for each step: at some length nothing is left of it."""
    for horizon, widest in ((10**8, 1e-6), (10**15, 1)):
        product = stl.build_product(floor5, stl.parse(f"G[0,{horizon}) F[0,10) A"))
        for engine in ("nodes", "words"):
            result = stl.check(product, engine=engine)
            assert result.sweeps < 10_000
            assert 0 <= result.lower <= result.probability <= result.upper <= 1
            assert result.upper - result.lower <= widest
            assert stl.check(product, result.policy, engine=engine).probability == result.probability


def test_what_would_not_fit_is_refused_before_memory_is_taken(floor5):
    product = stl.build_product(floor5, stl.parse("G[0,50) F[0,10) A"))
    for engine in ("nodes", "words"):
        with pytest.raises(SizeError, match=r"checking 198 product states.* would take .* of memory; 1 kB may be used"):
            stl.check(product, engine=engine, memory_limit=1000)
    with pytest.raises(SizeError, match="would take"):
        stl.build_product(floor5, stl.parse("G[0,5) F[0,5) A"), memory_limit=100)


def test_a_policy_of_another_task_or_model_is_refused(patrolling, floor5, floor10):
    policy = stl.check(patrolling).policy
    other_task = stl.build_product(floor5, stl.parse("F[0,5) A"))
    with pytest.raises(PolicyError, match=r"the policy is for the task G\[0,4\].*not for F\[0,4\] A"):
        stl.check(other_task, policy)
    other_model = stl.build_product(floor10, patrolling.formula)
    with pytest.raises(PolicyError, match=r"for the model floor-5x5 .*not for floor-10x10"):
        stl.check(other_model, policy)


def test_a_formula_that_the_first_state_decides(floor5):
    for text, value in (("A", 0.0), ("!A", 1.0), ("x < 0.4 & !B", 1.0), ("true", 1.0)):
        product = stl.build_product(floor5, stl.parse(text))
        result = stl.check(product)
        assert (result.probability, result.sweeps) == (value, 0)
        assert stl.check(product, result.policy).probability == value


@pytest.mark.parametrize("excess", [9e-10, -8e-10])
def test_rows_that_do_not_sum_to_one_widen_the_enclosure(excess):
    """What a row lacks or exceeds may belong to any successor; the enclosure holds either way and stays in [0, 1]."""
    rows = [[[0.5, 0.5 + excess], [0, 1]]]
    model = stl.MDP.from_arrays(rows, {"x": [0, 1]}, labels={"A": [1, 1]})
    surely = stl.check(stl.build_product(model, stl.parse("G[0,200] (A | x > 5)")))
    never = stl.check(stl.build_product(model, stl.parse("F[0,200] (!A & x < 5)")))
    for result in (surely, never):
        assert 0 <= result.lower <= result.probability <= result.upper <= 1
    assert surely.upper == 1
    assert surely.lower <= 1 - never.lower
    assert 1 - never.upper <= surely.upper


def test_models_given_in_fractions_have_no_defect(floor5):
    """Their rows sum to 1 as given, so what cannot happen has the enclosure [0, 0]."""
    never = stl.check(stl.build_product(floor5, stl.parse("F[0,50] (A & B)")))
    assert (never.lower, never.probability, never.upper) == (0, 0, 0)


def test_a_probability_below_the_doubles_is_not_zero():
    """1e-200 twice underflows to 0; the enclosure knows (and that the rows exceed 1 by 1e-200)."""
    tiny = 1e-200
    model = stl.MDP.from_arrays([[[1 - tiny, tiny, 0], [1 - tiny, 0, tiny], [0, 0, 1]]], {"x": [0, 1, 2]})
    result = stl.check(stl.build_product(model, stl.parse("G[2,2] (x > 1)")))
    assert result.probability == 0
    assert 0 < result.upper < 1e-199


@pytest.mark.parametrize("engine", ["nodes", "words"])
def test_progress_counts_steps_forward_and_back(patrolling, engine):
    calls = []
    stl.check(patrolling, engine=engine, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(t, 16) for t in [*range(8), *range(9, 17)]]


def test_what_the_graph_decides_is_certain(floor5, floor10):
    """No rounding decides 0 and 1: models whose rows do not sum to 1 in doubles have certain answers too."""
    for model in (floor5, floor10):
        unreachable = stl.check(stl.build_product(model, stl.parse("F[0,2] C")))
        assert (unreachable.certain, unreachable.lower, unreachable.upper) == (True, 0, 0)
        standing = stl.check(stl.build_product(model, stl.parse("G[0,9] !C")))
        assert (standing.certain, standing.lower, standing.upper) == (True, 1, 1)
        likely = stl.check(stl.build_product(model, stl.parse("F[0,30] C")))
        assert not likely.certain
        never = stl.check(stl.build_product(model, stl.parse("F[0,30] C")), maximize=False)
        assert (never.certain, never.probability) == (True, 0)
        found = [result.certainty for result in (unreachable, standing, likely, never)]
        assert found[:2] == ["no policy can satisfy it", "some policy satisfies it surely"]
        assert found[2:] == [None, "some policy surely does not satisfy it"]
    thirds = stl.MDP.from_arrays([[[1 / 3, 1 / 3, 1 / 3], [0, 1, 0], [0, 0, 1]]], {}, labels={"a": [0, 1, 1]})
    surely = stl.check(stl.build_product(thirds, stl.parse("G[1,1] a -> G[2,3] a")))
    assert (surely.certain, surely.lower, surely.upper) == (True, 1, 1)
    mixed = stl.MDP.from_arrays([[[1, 0], [0, 1]]], {}, initial=[0.25, 0.75], labels={"a": [1, 0]})
    halves = stl.check(stl.build_product(mixed, stl.parse("F[0,3] a")))
    assert (halves.certain, halves.probability) == (False, 0.25)


@pytest.mark.parametrize("engine", ["nodes", "words"])
@pytest.mark.parametrize("options", [{}, {"arithmetic": "double"}, {"exact": True}, {"maximize": False}], ids=str)
def test_values_of_all_states_are_those_of_beginning_there(floor5, engine, options):
    product = stl.build_product(floor5, stl.parse("F[0,6] C & G[0,3] !B"))
    found = stl.check(product, values="all", engine=engine, **options)
    assert found.probability == stl.check(product, **options).probability
    for s in range(floor5.n_states):
        one = (np.arange(floor5.n_states) == s).astype(np.int64)
        there = dataclasses.replace(floor5, initial=one.astype(float), exact_initial=None)
        alone = stl.build_product(there, product.formula)
        assert found.values[s].value == pytest.approx(stl.check(alone, **options).probability, abs=1e-14)


def test_sampled_runs_are_runs_of_the_policy(patrolling):
    best = stl.check(patrolling)
    runs = [stl.sample_run(patrolling, best.policy, seed) for seed in range(400)]
    for run in runs[:50]:
        padded = [*run.states, *[run.states[-1]] * (9 - len(run.states))]
        if run.satisfied:
            assert oracles.holds(patrolling.model, patrolling.formula, padded)
        assert len(run.states) == len(run.actions) + 1 == len(run.memory)
    frequency = np.mean([run.satisfied for run in runs])
    assert abs(frequency - best.probability) < 5 * np.sqrt(best.probability * (1 - best.probability) / len(runs))


def test_what_the_initial_distribution_misses_counts_where_it_is_used():
    """Ten times a little over 0.1; the values of single states know nothing of it."""
    model = stl.MDP.from_arrays(np.eye(10)[None], {}, [0.1 + 1e-13] * 10, {"a": [1] * 5 + [0] * 5})
    product = stl.build_product(model, stl.parse("G[0,2] a"))
    defect = model.initial_defect
    assert defect > 0
    assert double_errors(product, model.rows, None)[1] >= defect
    assert double_errors(product, model.rows, None, started=False)[1] == 0
