"""The exact fraction and the enclosures around it, against a Fraction a state; QComp's published rationals."""

import itertools
import json
import tomllib
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.automata import FALSE, TRUE
from stltool.checking import bounds
from stltool.checking.fixed import fixed_point
from stltool.checking.induction import EVERYTHING, Following, Game, layers_of, solve
from stltool.checking.induction.arithmetic import Digits
from stltool.checking.rational import exact_probability
from stltool.errors import ArgumentError, ModelError, SettingsError, SizeError
from tests import oracles, qcomp
from tests.conftest import DATA, OUTSIDE, many, needs_outside

FORMULAS = ["F[0,6] (A & B)", "G[0,5] F[0,2] A", "F[0,2] G[0,3] (A | B)", "A U[1,7] B", "G[0,3] (A -> F[1,3] B)"]
DENOMINATORS = [1, 2, 10, 16, 300, 997, 10**6, 3 * 10**11, 10**17]


def instances(count, seed):
    """Random products, their kinds of denominators and formulas in turn."""
    rng = np.random.default_rng(seed)
    kinds = itertools.cycle(itertools.product(DENOMINATORS, FORMULAS))
    for _, (denominator, text) in zip(range(count), kinds, strict=False):
        yield rng, stl.build_product(oracles.random_model(rng, denominator), stl.parse(text))


def policies(rng, product):
    """A deterministic policy of each step, and a mixed one."""
    shape = (product.horizon, *product.shape)
    yield stl.Policy(product, rng.integers(0, 2, shape).astype(np.int16))
    weights = rng.random((*product.shape, 2))
    yield stl.Policy(product, weights / weights.sum(axis=-1, keepdims=True))


@pytest.mark.soak
def test_no_enclosure_ever_misses_the_exact_value():
    """Thousands of answers: maximum, minimum, policies; doubles, fixed point, both engines."""
    answers = 0
    for rng, product in instances(many(150), seed=1):
        small = fixed_point(product.model) is not None
        for maximize, policy in ((True, None), (False, None), *((True, policy) for policy in policies(rng, product))):
            truth = oracles.layered_value(product, policy, maximize)
            deterministic = policy is None or policy.deterministic
            for arithmetic in ["auto", "double"] + ["fixed"] * (small and deterministic):
                for engine in ("nodes", "words"):
                    result = stl.check(product, policy, maximize=maximize, arithmetic=arithmetic, engine=engine)
                    assert result.lower <= truth <= result.upper
                    assert result.lower <= result.probability <= result.upper
                    assert result.upper - result.lower < (1e-13 if arithmetic != "fixed" else 1e-8)
                    answers += 1
    assert answers > many(2500)


@pytest.mark.soak
def test_the_fraction_is_the_fraction():
    for rng, product in instances(many(90), seed=2):
        for maximize, policy in ((True, None), (False, None), *((True, policy) for policy in policies(rng, product))):
            truth = oracles.layered_value(product, policy, maximize)
            result = stl.check(product, policy, maximize=maximize, exact=True)
            assert (result.fraction, result.arithmetic) == (truth, "rational")
            assert result.lower <= truth <= result.upper <= np.nextafter(result.lower, 2)
            allowed = EVERYTHING if policy is None else Following(policy.form)
            layers = layers_of(Game.of(product), TRUE if maximize else FALSE, allowed)
            assert exact_probability(layers, product.model, maximize, in_digits=False)[0] == truth
            if policy is None:  # the policy that comes with it attains the value exactly
                assert oracles.layered_value(product, result.policy) == truth


def test_fixed_point_is_exact_until_it_must_round():
    """With D = 2, sixty sweeps divide evenly: the enclosure is one number."""
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]]], {"x": [0, 1]})
    result = stl.check(stl.build_product(model, stl.parse("F[0,50] x > 0")), arithmetic="fixed")
    assert result.lower == result.upper == 1 - 2.0**-50
    late = stl.check(stl.build_product(model, stl.parse("G[0,70] x < 1")), arithmetic="fixed")
    assert late.lower == 0 < Fraction(1, 2**70) < late.upper
    assert stl.check(stl.build_product(model, stl.parse("G[0,70] x < 1"))).arithmetic == "double"  # sharper there


def test_width_at_horizon_1000(floor5):
    product = stl.build_product(floor5, stl.parse("G[0,991] F[0,9] A"))
    assert product.horizon == 1000
    fixed, double = (stl.check(product, keep_policy=False, arithmetic=a) for a in ("auto", "double"))
    exact = stl.check(product, keep_policy=False, exact=True)
    assert (fixed.arithmetic, double.arithmetic) == ("fixed", "double")
    assert fixed.upper - fixed.lower < 1e-13
    assert double.upper - double.lower < 4e-12
    for result in (fixed, double):
        assert result.lower <= exact.fraction <= result.upper


def test_decimals_mean_themselves():
    """0.1 is 1/10, as a double, a text, a Fraction."""
    rows = [[0.1, 0.9], [0.3, 0.7]]
    given = [rows, [[str(p) for p in row] for row in rows], [[Fraction(str(p)) for p in row] for row in rows]]
    for transitions in given:
        model = stl.MDP.from_arrays([transitions], {"x": [0, 1]})
        assert model.exact().denominator == 10
        result = stl.check(stl.build_product(model, stl.parse("G[0,3] x < 1")), exact=True)
        assert result.fraction == Fraction(1, 1000)


def test_values_of_several_digits_are_put_together():
    """In units of 10^-48, which takes four words of digits."""
    model = stl.MDP.from_arrays([[["0.876543", "0.123457"], ["0", "1"]]], {"x": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,8] x == 1"))
    layers = layers_of(Game.of(product), TRUE, EVERYTHING)
    arithmetic = Digits(layers.rows.denominator, True)
    found = solve(layers, arithmetic, True)
    assert Fraction(arithmetic.number(found.entry[0]), arithmetic.one) == 1 - Fraction("0.876543") ** 8


def test_an_exact_answer_needs_exact_rows():
    third = 1 / 3
    model = stl.MDP.from_arrays([[[third, third, third], [0, 1, 0], [0, 0, 1]]], {"x": [0, 1, 2]})
    product = stl.build_product(model, stl.parse("F[0,3] x > 1"))
    with pytest.raises(ModelError, match=r"state 0, action 0: the probabilities sum to 1 − .*fractions, such as"):
        stl.check(product, exact=True)
    with pytest.raises(SettingsError, match="a small common denominator"):
        stl.check(product, arithmetic="fixed")
    result = stl.check(product)
    assert result.lower <= Fraction(13, 27) <= result.upper
    start = stl.MDP.from_arrays([np.eye(3)], {"x": [0, 1, 2]}, initial=[third] * 3)
    with pytest.raises(ModelError, match="the initial distribution: the probabilities sum to 1 − "):
        stl.check(stl.build_product(start, stl.parse("F[0,3] x > 1")), exact=True)


def test_weights_that_exceed_one_compound():
    """Weights may sum to 1 + 1e-9; over 5000 steps that is not h times the excess but its power."""
    model = stl.MDP.from_arrays([[["0.9999999999", "0.0000000001"], ["0", "1"]]] * 2, {"x": [0, 1]})
    product = stl.build_product(model, stl.parse("G[0,5000] x < 1"))
    weights = np.full((*product.shape, 2), 0.5 + 4.5e-10)
    policy = stl.Policy(product, weights)
    enclosed, exact = (stl.check(product, policy, exact=exact) for exact in (False, True))
    assert enclosed.lower <= exact.fraction <= enclosed.upper


def test_wide_denominators_do_not_wrap():
    """Rows over 2^63 and more: their sums need Python's integers."""
    rows = [
        ["0.4000000000000000001", "0.3000000000000000001", "0.2999999999999999998"],
        ["0", "1", "0"],
        ["0", "0", "1"],
    ]
    texts = stl.MDP.from_arrays([rows], {"x": [0, 1, 2]})
    assert not any(texts.exact().defects(texts.row_start))
    product = stl.build_product(texts, stl.parse("F[0,3] x == 1"))
    assert stl.check(product, exact=True).fraction == oracles.layered_value(product)
    for seed in range(20):
        model = stl.MDP.from_arrays(np.random.default_rng(seed).dirichlet(np.ones(10), (1, 10)), {"x": np.arange(10)})
        result = stl.check(stl.build_product(model, stl.parse("F[0,3] x == 1")))
        assert result.upper - result.lower < 1e-12


def test_large_models_in_doubles_are_not_read_as_fractions(monkeypatch):
    """Reading millions of doubles exactly would take longer than the check; the a-priori bound needs none of it."""
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]]], {"x": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,50] x > 0"))
    assert stl.check(product).arithmetic == "fixed"
    monkeypatch.setattr(bounds, "READ_EXACTLY", 2)
    monkeypatch.setattr(stl.MDP, "exact", None)
    result = stl.check(product)
    assert result.arithmetic == "double"
    assert result.lower <= 1 - 2.0**-50 <= result.upper


def test_doubles_mean_the_same_beside_fractions():
    rows = [[0.1 + 0.2, 0.7], [0, 1]]  # sum to 1 as binary numbers, not as decimals
    alone = stl.MDP.from_arrays([rows], {"x": [0, 1]})
    beside = stl.MDP.from_arrays([rows, [["1/3", "2/3"], ["1", "0"]]], {"x": [0, 1]}, ["1/2", "1/2"])
    for model in (alone, beside):
        assert not any(model.exact().defects(model.row_start))
    assert oracles.choices(alone, 0)[0] == oracles.choices(beside, 0)[0]


def test_what_would_not_fit_is_refused_first(floor5):
    product = stl.build_product(floor5, stl.parse("G[0,900] F[0,50] A"))
    with pytest.raises(SizeError, match=r"exact arithmetic on .* over 950 steps would take"):
        stl.check(product, exact=True, keep_policy=False, memory_limit=1_500_000)


def test_unknown_settings_are_named(patrolling):
    with pytest.raises(SettingsError, match="arithmetic is 'float'; choose auto, double or fixed"):
        stl.check(patrolling, arithmetic="float")
    with pytest.raises(ArgumentError, match="check's progress is 3, not a function"):
        stl.check(patrolling, progress=3)


# --------------------------------------------------------------------------------------------------------- QComp


PUBLISHED = tomllib.loads((DATA / "qcomp.toml").read_text(encoding="utf-8"))


def has_the_size(model, published):
    sizes = (model.n_states, model.n_choices, model.n_transitions)
    return sizes == (published["states"], published["choices"], published["transitions"])


@pytest.mark.soak(only=True)
def test_resource_gathering_to_the_last_digit(tmp_path):
    published = PUBLISHED["resource_gathering"]
    value = Fraction(published["value"])
    model = stl.load_model(qcomp.resource_gathering(tmp_path))
    assert has_the_size(model, published)
    product = stl.build_product(model, stl.parse(published["formula"]))
    result = stl.check(product, exact=True, keep_policy=False)
    assert result.fraction == value == Fraction(40402280165576036172779067978949245387, 5 * 10**37)
    enclosed = stl.check(product, keep_policy=False)
    assert enclosed.lower <= value <= enclosed.upper
    assert enclosed.upper - enclosed.lower < 6e-15


def approaches(model, text, maximize, value, short, late=1000):
    """P of a bounded reach grows with its bound towards the published value without one."""
    bounds = []
    for k in (200, late):
        product = stl.build_product(model, stl.parse(text.replace("K", str(k))))
        bounds.append(stl.check(product, maximize=maximize, keep_policy=False))
    assert bounds[0].lower <= bounds[1].upper
    assert bounds[1].lower <= value
    assert value - Fraction(bounds[1].upper) < short


@pytest.mark.parametrize("published", PUBLISHED["consensus"], ids=lambda published: f"K={published['K']}")
@pytest.mark.parametrize("side", ["minimum", "maximum"])
def test_unbounded_published_values_are_approached_from_below(published, side, tmp_path):
    model = stl.load_model(qcomp.consensus(tmp_path, published["K"]))
    assert has_the_size(model, published)
    value, late = Fraction(published[side]["value"]), {2: 1000, 4: 4000}[published["K"]]
    approaches(model, published[side]["formula"], side == "maximum", value, 1e-9, late)


@needs_outside("qcomp")
@pytest.mark.parametrize(
    ("name", "prop", "text", "maximize", "short"),
    [
        ("consensus_2_2", 'Pmin=? [F "finished_ones"]', "F[0,K] finished_ones", False, 1e-9),
        ("consensus_2_2", 'Pmax=? [F "finished_disagree"]', "F[0,K] finished_disagree", True, 1e-9),
        ("zeroconf_dl_1000_1_true_10", 'Pmax=? [!"fresh" U "late"]', "!fresh U[0,K] late", True, 1e-14),
        ("zeroconf_dl_1000_1_true_10", 'Pmin=? [!"fresh" U "late"]', "!fresh U[0,K] late", False, 1e-14),
    ],
)
def test_the_benchmarks_own_files(name, prop, text, maximize, short):
    listed = json.loads((OUTSIDE / "qcomp" / f"{name}.json").read_text(encoding="utf-8"))
    value = {entry["property"]: Fraction(entry["value"]) for entry in listed["expected"]}[prop]
    approaches(stl.load_model(OUTSIDE / "qcomp" / f"{name}.tra"), text, maximize, value, short)


@pytest.mark.soak(only=True)
@needs_outside("qcomp")
def test_the_models_written_anew_are_the_benchmarks(tmp_path):
    """The same sizes, and the same probabilities as fractions, as the published files."""
    pairs = [
        (qcomp.resource_gathering(tmp_path), "resource_gathering_200_15_15", "F[0,90] success", True),
        (qcomp.consensus(tmp_path, 2), "consensus_2_2", "F[0,40] finished_ones", False),
        (qcomp.consensus(tmp_path, 4), "consensus_2_4", "F[0,60] finished_disagree", True),
    ]
    for ours, theirs, text, maximize in pairs:
        models = [stl.load_model(path) for path in (ours, OUTSIDE / "qcomp" / f"{theirs}.tra")]
        fractions = []
        for model in models:
            product = stl.build_product(model, stl.parse(text))
            fractions.append(stl.check(product, maximize=maximize, exact=True, keep_policy=False).fraction)
        assert fractions[0] == fractions[1]
        assert models[0].n_transitions == models[1].n_transitions
