"""`stationary` against the enumeration of all deterministic policies of (s, q), or of s, each in fractions."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.checking.stationary import _Asked
from stltool.errors import SettingsError, SizeError
from tests import dense, oracles
from tests.checking.test_check import products, random_policy
from tests.conftest import FACTORY, many

SMALL = Fraction(1, 10**8)


def enumerated(product, memory):
    """P of every deterministic policy that does not know the step, as it differs in what can be reached."""
    pairs = set().union(*dense.reached(product)) if product.horizon else set()
    places = sorted({s if memory == "none" else (s, q) for s, q in pairs})
    counts = np.diff(product.model.choice_start)
    options = [range(counts[place if memory == "none" else place[0]]) for place in places]
    if math.prod(map(len, options)) > 64:
        assume(False)
    for picks in itertools.product(*options):
        table = np.zeros(product.shape, dtype=int)
        for place, pick in zip(places, picks, strict=True):
            table[place] = pick  # a whole row where nothing is remembered
        yield at_start(product, stl.Policy(product, table))


def at_start(product, policy):
    first = dense.layers(product, policy=policy)[0]
    starts = oracles.initial(product.model)
    return sum((p * first[s][product.enter(s, product.automaton.initial)] for s, p in starts), Fraction(0))


def small(seed):
    """Three states, three actions, and tasks that want different actions at different times."""
    model = oracles.random_model(np.random.default_rng(seed), 10, n_states=3, n_actions=3)
    texts = ("F[1,2] A & F[3,4] B", "G[0,3] (A | F[0,1] B)", "F[2,4] G[0,1] A", "(!B U[0,3] A) & F[3,4] B")
    return stl.build_product(model, stl.parse(texts[seed % 4]))


@given(products(states=3, longest=1), st.sampled_from(["automaton", "none"]), st.booleans())
@settings(max_examples=many(60))
def test_what_is_proved_is_the_best_of_all(product, memory, maximize):
    best = (max if maximize else min)(enumerated(product, memory))
    result = stl.stationary(product, memory=memory, maximize=maximize)
    assert result.proved
    assert abs(Fraction(result.probability) - best) < SMALL
    assert Fraction(result.best.lower) <= at_start(product, result.policy) <= Fraction(result.best.upper)
    beyond = Fraction(result.bound) - best
    assert 0 <= (beyond if maximize else -beyond) < SMALL
    assert result.gap == pytest.approx(abs(float(best) - result.optimum.probability), abs=1e-8)
    assert (result.policy.stationary, result.policy.deterministic) == (True, True)
    if memory == "none":
        assert (result.policy.row(0) == result.policy.row(0)[:, :1]).all()


@pytest.mark.parametrize("most", [2, 3, 4, 5])
def test_a_bound_is_that_of_the_most_promising_of_what_is_left(most):
    """A product where other parts that are left promise less than the best policy has."""
    product = small(11)
    best = max(enumerated(product, "none"))
    assert Fraction(stl.stationary(product, memory="none", most=most).bound) >= best


@given(products(states=3, longest=1), st.sampled_from(["automaton", "none"]), st.booleans(), st.integers(0, 3))
@settings(max_examples=many(60))
def test_a_search_that_stops_early_is_still_right(product, memory, maximize, most):
    """Its bound holds, what it found is below that, and it does not claim more."""
    every = list(enumerated(product, memory))
    result = stl.stationary(product, memory=memory, maximize=maximize, most=most)
    best = max(every) if maximize else min(every)
    assert result.nodes <= most
    assert (Fraction(result.bound) - best) * (1 if maximize else -1) >= 0
    assert any(abs(Fraction(result.probability) - p) < SMALL for p in every)
    if result.proved:
        assert abs(Fraction(result.probability) - best) < SMALL
    assert ("proved" in result.status) == result.proved
    for found in result.candidates:
        assert any(abs(Fraction(found.probability) - p) < SMALL for p in every)
    first = result.candidates[0].probability
    assert first == (max if maximize else min)(found.probability for found in result.candidates)
    assert first == pytest.approx(result.probability, abs=1e-12)


@pytest.mark.soak
@pytest.mark.parametrize("maximize", [True, False])
@pytest.mark.parametrize("seed", range(many(12)))
def test_what_a_switch_gains_is_the_derivative(seed, maximize):
    """∂P towards a choice in a place, against a policy that takes it now and then."""
    product, rng = small(seed), np.random.default_rng(seed)
    asked = _Asked(product, "automaton", maximize, "auto", None)
    policy = random_policy(product, rng, timed=False, mixed=False)
    chosen = policy.row(0).astype(np.int64).ravel()
    p, gain = asked.judge(asked.form(chosen))
    exact = at_start(product, policy)
    assert asked.sign * p == pytest.approx(float(exact), abs=1e-12)
    share, most = Fraction(1, 2**20), product.model.most_choices
    pairs = sorted(set().union(*dense.reached(product, policy)))
    for s, q in [pairs[i] for i in rng.permutation(len(pairs))[:3]]:
        for c in range(np.diff(product.model.choice_start)[s]):
            weights = np.eye(most)[policy.row(0)]
            weights[s, q] = float(1 - share) * weights[s, q] + float(share) * np.eye(most)[c]
            moved = at_start(product, stl.Policy(product, weights))
            slope = float((moved - exact) / share) * asked.sign
            assert gain[s * product.shape[1] + q, c] == pytest.approx(slope, abs=1e-4)


@given(products(states=3, longest=1))
@settings(max_examples=many(20))
def test_engines_find_the_same(product):
    one, other = (stl.stationary(product, engine=engine) for engine in ("nodes", "words"))
    assert (one.probability, one.bound, one.candidates) == (other.probability, other.bound, other.candidates)


def corridor():
    """Three cells in a row: the first has A, the last B, the middle is one sure step from both."""
    go = np.zeros((2, 3, 3))
    for a, step in enumerate((-1, 1)):
        for s in range(3):
            go[a, s, min(max(s + step, 0), 2)] = 1
    labels = {"A": [1, 0, 0], "B": [0, 0, 1]}
    return stl.MDP.from_arrays(
        go, {"x": range(3)}, 1, labels, action_names=["W", "E"], state_names=["left", "middle", "right"]
    )


def test_memory_is_worth_something():
    """A and B, on both sides: without memory the middle cannot lead both ways."""
    both = stl.build_product(corridor(), stl.parse("F[0,8] A & F[0,8] B"))
    assert stl.stationary(both).probability == 1
    none = stl.stationary(both, memory="none")
    assert (none.probability, none.gap, none.bound, none.proved) == (0, 1, 0, True)
    assert none.status == "proved to be the best deterministic memoryless policy"


def test_a_clock_is_worth_something():
    """The safe way takes two steps, the bold one a step with ¾ and else leads back: with one step left it is better."""
    safe, bold = np.zeros((2, 4, 4))
    safe[0, 1] = safe[1, 2] = safe[2, 2] = safe[3, 3] = 1
    bold[0, [0, 2]] = 0.25, 0.75
    bold[1, 0] = bold[2, 2] = bold[3, 3] = 1
    back = np.zeros((4, 4))
    back[0, 0] = back[1, 1] = back[2, 2] = back[3, 3] = 1
    start = np.array([0.5, 0, 0, 0.5])
    slow = back.copy()
    slow[3] = [1, 0, 0, 0]
    model = stl.MDP.from_arrays([safe, np.where(np.arange(4)[:, None] == 3, slow, bold)], {"x": range(4)}, start,
                                {"goal": [0, 0, 1, 0]})  # fmt: skip
    product = stl.build_product(model, stl.parse("F[0,2] goal"))
    result = stl.stationary(product)
    # from state 3 one step is left in state 0, from the other start two: bold twice is 15/16, safe is 1 or 0
    assert result.optimum.probability == pytest.approx(0.5 * 1 + 0.5 * 0.75)
    assert result.probability == pytest.approx(0.5 * 15 / 16 + 0.5 * 0.75)
    assert result.proved
    assert result.gap == pytest.approx(1 / 32)


def test_the_floor_without_a_clock(floor5):
    tour = stl.build_product(floor5, stl.parse("F[0,3) (F[0,6) A & F[0,6) B & F[0,6) C)"))
    with_memory, without = stl.stationary(tour), stl.stationary(tour, memory="none")
    assert with_memory.probability == pytest.approx(with_memory.optimum.probability, abs=1e-12)
    assert without.proved
    assert without.probability == pytest.approx(0.89536043, abs=1e-8)
    again = stl.check(tour, without.policy)
    assert (again.probability, again.lower, again.upper) == (
        without.probability, without.best.lower, without.best.upper,
    )  # fmt: skip


def test_policies_survive_their_file(patrolling, tmp_path):
    for memory in ("automaton", "none"):
        result = stl.stationary(patrolling, memory=memory, most=3)
        result.policy.save(tmp_path / "p.npz")
        loaded = stl.load_policy(tmp_path / "p.npz", patrolling)
        assert loaded.kind == "stationary, deterministic"
        assert stl.check(patrolling, loaded).probability == result.probability


def test_a_formula_that_the_first_state_decides(floor5):
    for text, p in (("A", 0.0), ("!A", 1.0)):
        result = stl.stationary(stl.build_product(floor5, stl.parse(text)))
        assert (result.probability, result.bound, result.gap, result.proved) == (p, p, 0, True)


def test_progress_counts_relaxations():
    calls = []
    product = stl.build_product(stl.load_model(FACTORY / "floor-5x5.toml"), stl.parse("F[0,6) A & F[0,6) B"))
    result = stl.stationary(product, memory="none", progress=lambda done, total: calls.append((done, total)))
    assert calls == [(n + 1, 200) for n in range(result.nodes)]
    assert result.nodes > 0


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"most": -1}, "most is -1"),
        ({"tolerance": 0.0}, "tolerance is 0.0; it must be between 0 and 1"),
        ({"tolerance": math.nan}, "tolerance is nan"),
        ({"memory": "clock"}, "memory is 'clock'"),
    ],
)
def test_impossible_settings_are_refused(patrolling, options, says):
    with pytest.raises(SettingsError, match=says):
        stl.stationary(patrolling, **options)


def test_what_would_not_fit_is_refused(patrolling):
    with pytest.raises(SizeError, match="would take"):
        stl.stationary(patrolling, memory_limit=10_000)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(many(40)))
def test_memoryless_policies_where_the_first_guess_is_seldom_right(seed):
    """Three states that want different actions at different times: every one of the 27 policies, in fractions."""
    product = small(seed)
    best = max(enumerated(product, "none"))
    result = stl.stationary(product, memory="none")
    assert result.proved
    assert abs(Fraction(result.probability) - best) < SMALL
    assert 0 <= Fraction(result.bound) - best < SMALL
