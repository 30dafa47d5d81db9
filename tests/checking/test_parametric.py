"""P as a function of a parameter, against coefficients in fractions, trees of all histories, and points."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.automata import TRUE
from stltool.checking.induction import EVERYTHING, Bernstein, ExactBernstein, Game, layers_of, solve
from stltool.checking.polynomial import Polynomial, greatest, halves, least, value
from stltool.errors import ModelError, PolicyError, SettingsError, SizeError
from tests import oracles
from tests.conftest import FACTORY, many

KINDS = [
    ("p", "1-p"), ("1-p", "p"), ("1/3+2*p/3", "2*(1-p)/3"), ("p", "(1-p)/2", "(1-p)/2"), ("1/4", "3/4"), ("1",),
]  # fmt: skip
FORMULAS = ["F[0,3] A", "G[0,3] !B", "(!B) U[0,3] A", "G[0,2] F[0,1] A", "F[0,1] G[0,1] (A | B)", "A & F[1,2] B"]
DOMAIN = Fraction(3, 10), Fraction(9, 10)


def random_product(rng):
    """Three states with rows that rise and fall in p, or do not depend on it."""
    rows = np.full((2, 3, 3), "0", dtype="<U10")
    for a, s in np.ndindex(2, 3):
        kind = KINDS[rng.integers(len(KINDS))]
        rows[a, s, rng.permutation(3)[: len(kind)]] = kind
    rows[0, 0] = "p", "1-p", "0"
    labels = {name: rng.integers(2, size=3) for name in "AB"}
    start = ["1/2", "0", "1/2"] if rng.integers(2) else 0
    family = stl.MDP.from_arrays(rows, {}, start, labels, parameters={"p": DOMAIN})
    return stl.build_product(family, stl.parse(FORMULAS[rng.integers(len(FORMULAS))]))


def at(product, p):
    return replace(product, model=product.model.at(p=p))


def random_policy(product, rng, mixed):
    shape = product.horizon, *product.shape
    if not mixed:
        return stl.Policy(product, rng.integers(2, size=shape))
    return stl.Policy(product, rng.dirichlet((1, 1), size=shape))


def inside(coefficients, exact, rounding=1e-12):
    below, above = coefficients
    assert all(a <= c <= b for a, c, b in zip(below, exact, above, strict=True))
    assert (above - below).max() < rounding


@pytest.mark.parametrize("seed", sorted({3, 7, *range(many(15))}))  # in 3 and 7, p matters to a mixture
def test_coefficients_are_those_in_fractions_and_values_those_of_all_histories(seed):
    rng = np.random.default_rng(seed)
    product = random_product(rng)
    policies = [random_policy(product, rng, mixed) for mixed in (False, True)]
    for policy in policies:
        found = stl.parametric(product, policy)
        (piece,) = found.pieces
        inside((piece.below, piece.above), oracles.bernstein(product, policy, *DOMAIN))
    wide = {best: stl.parametric(product, maximize=best, tol=2.0) for best in (True, False)}
    for best, found in wide.items():
        (piece,) = found.pieces
        end = piece.above if best else piece.below
        for c, exact in zip(end, oracles.bernstein(product, None, *DOMAIN, maximize=best), strict=True):
            assert c == pytest.approx(float(exact), rel=1e-12, abs=1e-300)
    for p in (DOMAIN[0], Fraction(1, 2), Fraction(int(rng.integers(300, 900)), 1000), DOMAIN[1]):
        member = at(product, p)
        for policy in policies:
            lower, upper = stl.parametric(product, policy).at(p)
            exact = oracles.policy_value(member, stl.Policy(member, policy.table))
            assert lower <= exact <= upper <= lower + 1e-12
        for best, found in wide.items():
            lower, upper = found.at(p)
            assert lower <= oracles.optimum(member.model, product.formula, best) <= upper


@pytest.mark.parametrize("maximize", [True, False])
def test_pieces_enclose_the_optimum_within_the_tolerance(maximize):
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 8, "tau": 8})
    product = stl.build_product(stl.load_model(task.model), task)
    found = stl.parametric(product, over={"success": (0.5, 1)}, tol=1e-3, maximize=maximize)
    assert found.status == "complete"
    assert found.gap <= 1e-3
    ends = [(piece.lower, piece.upper) for piece in found.pieces]
    assert [ends[0][0], *(b for _, b in ends)] == [*(a for a, _ in ends), Fraction(1)]
    for p in (0.5, 0.61, 0.87, 1):
        exact = stl.check(replace(product, model=product.model.at(success=p)), maximize=maximize)
        lower, upper = found.at(p)
        assert lower <= exact.lower
        assert exact.upper <= upper
        assert upper - lower <= 1e-3 + 1e-12
    for piece in found.pieces:  # each has a policy, which its lower (upper) polynomial belongs to
        own = stl.parametric(product, piece.policy, over={"success": (piece.lower, piece.upper)}).pieces[0]
        mine, theirs = (own.below, piece.below) if maximize else (own.above, piece.above)
        assert np.allclose(mine, theirs, rtol=0, atol=1e-15)
    few = stl.parametric(product, over={"success": (0.5, 1)}, tol=1e-9, most_pieces=3, maximize=maximize)
    assert len(few.pieces) <= 3
    assert ("apart after" in few.status) == (few.gap > 1e-9)


@pytest.mark.parametrize("seed", range(many(8)))
def test_the_smallest_value_that_is_enough(seed):
    rng = np.random.default_rng(500 + seed)
    product = random_product(rng)
    policy = random_policy(product, rng, mixed=False)
    for own, best in ((None, True), (None, False), (policy, True)):
        found = stl.parametric(product, own, maximize=best, tol=1e-3)

        def exact(p, own=own, best=best):
            member = at(product, p)
            if own is not None:
                return oracles.policy_value(member, stl.Policy(member, own.table))
            return oracles.optimum(member.model, product.formula, best)

        bound = Fraction(float(rng.uniform(found.least[0], found.greatest[0])))
        first = found.smallest(bound)
        assert DOMAIN[0] <= first.below
        for p in {Fraction(k, 20) for k in range(6, 19)}:
            assert p >= first.below or exact(p) < bound
        if first.enough is not None:
            assert first.enough >= first.below
            assert exact(first.enough) >= bound
            if first.policy is not None:
                member = at(product, first.enough)
                assert oracles.policy_value(member, stl.Policy(member, first.policy.table)) >= bound
        assert found.smallest(1.01) is None
        assert found.smallest(0)[:2] == (DOMAIN[0], DOMAIN[0])
        for piece in found.pieces:  # one policy on all of a piece
            if piece.optimal:
                for x in (Fraction(1, 3), Fraction(5, 7)):
                    p = piece.lower + x * (piece.upper - piece.lower)
                    member = at(product, p)
                    mine = oracles.policy_value(member, stl.Policy(member, piece.policy.table))
                    assert abs(mine - exact(p)) < 1e-12


@pytest.mark.parametrize("seed", range(many(15)))
def test_polynomials_of_policies_without_rounding(seed):
    rng = np.random.default_rng(2000 + seed)
    product = random_product(rng)
    for policy in (random_policy(product, rng, mixed) for mixed in (False, True)):
        found = stl.parametric(product, policy, exact=True)
        (piece,) = found.pieces
        own = piece.exact
        assert list(own.raised(product.horizon).coefficients) == oracles.bernstein(product, policy, *DOMAIN)
        assert (piece.optimal, piece.proved, piece.known) == (None, False, own)
        assert found.gap <= 2.0**-53
        for p in (DOMAIN[0], Fraction(int(rng.integers(300, 900)), 1000), DOMAIN[1]):
            member = at(product, p)
            exact = stl.check(member, stl.Policy(member, policy.table), exact=True).fraction
            assert found.exactly_at(p) == exact == sum(a * p**k for k, a in enumerate(own.powers))
            lower, upper = found.at(p)
            assert lower <= exact <= upper
            assert upper <= np.nextafter(lower, 2)
        for bound in {*own.ends, Fraction(1, 3)}:  # a bound that is attained, too
            least, most = min(own.coefficients), max(own.coefficients)
            assert found.at_least(bound) is True or least < bound
            assert found.at_most(bound) is True or most > bound
            assert found.at_least(bound) is not True or min(own.ends) >= bound
            assert found.at_most(bound) is not True or max(own.ends) <= bound
        alone = stl.parametric(product, policy, over={"p": ("1/2", "1/2")}, exact=True)
        assert alone.pieces[0].exact.powers == (found.exactly_at("1/2"),)


@pytest.mark.parametrize("seed", range(many(10)))
@pytest.mark.parametrize("maximize", [True, False])
def test_a_policy_is_proved_optimal_only_where_no_other_is_better(seed, maximize):
    rng = np.random.default_rng(3000 + seed)
    product = random_product(rng)
    found = stl.parametric(product, exact=True, maximize=maximize, tol=1e-2)
    assert found.status == "complete"
    assert found.exact
    for piece in found.pieces:
        own = stl.parametric(product, piece.policy, over={"p": (piece.lower, piece.upper)}, exact=True).pieces[0].exact
        assert own == piece.exact
        assert piece.proved == (piece.known is not None) == (piece.optimal is True)
        for x in (Fraction(0), Fraction(int(rng.integers(1, 100)), 100), Fraction(1)):
            p = piece.lower + x * (piece.upper - piece.lower)
            exact = oracles.optimum(at(product, p).model, product.formula, maximize)
            assert piece.exact.at(p) <= exact if maximize else piece.exact.at(p) >= exact
            lower, upper = found.at(p)
            assert lower <= exact <= upper
            if piece.proved:
                assert found.exactly_at(p) == exact
    inside = stl.parametric(product, exact=True, maximize=maximize, tol=1e-300, most_pieces=4)
    assert len(inside.pieces) == 1 if found.pieces[0].proved and len(found.pieces) == 1 else 1 < len(inside.pieces) <= 4


def test_a_switch_of_policies_is_never_inside_a_proved_piece():
    """Action 0 reaches A with p, action 1 with 1/3: they are equal at 1/3, which halving does not meet."""
    rows = [[["1-p", "p"], [0, 1]], [["2/3", "1/3"], [0, 1]]]
    model = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 1]}, parameters={"p": (0, 1)})
    product = stl.build_product(model, stl.parse("F[0,1] A"))
    found = stl.parametric(product, exact=True, tol=1e-3)
    (open_piece,) = [piece for piece in found.pieces if not piece.proved]
    assert open_piece.lower < Fraction(1, 3) < open_piece.upper
    assert found.exactly_at("1/3") is None
    assert found.exactly_at("1/4") == Fraction(1, 3)
    assert found.exactly_at("93/100") == Fraction(93, 100)
    assert found.at_least(Fraction(1, 3)) is None
    assert found.at_most(1) is True
    assert found.at_most(0.999) is False
    assert found.pieces[-1].exact.text("p") == "p"
    assert stl.parametric(product, over={"p": ("1/3", 1)}, exact=True).at_least(Fraction(1, 3)) is True
    assert stl.parametric(product, over={"p": ("1/3", 1)}).at_least(Fraction(1, 3)) is None  # in doubles
    with pytest.raises(SettingsError, match="exact=True"):
        stl.parametric(product).exactly_at("1/2")


@pytest.mark.parametrize(
    ("powers", "text"),
    [((0,), "0"), (("1/2", -1, 3), "3*p^2 - p + 0.5"), ((0, 0, -1), "-p^2"), (("-1/3", 0, 0, "2/3"), "2/3*p^3 - 1/3")],
)
def test_polynomials_as_text(powers, text):
    a = [Fraction(one) for one in powers]
    n = len(a) - 1
    on_unit = [sum(Fraction(math.comb(i, k), math.comb(n, k)) * a[k] for k in range(i + 1)) for i in range(n + 1)]
    found = Polynomial(Fraction(0), Fraction(1), tuple(on_unit))
    assert found.powers == found.raised(n + 2).powers == tuple(a)
    assert found.text("p") == text
    assert found.at(Fraction(2, 7)) == sum(b * Fraction(2, 7) ** k for k, b in enumerate(a))


def test_polynomials_that_are_too_large_are_refused():
    model = stl.MDP.from_arrays(
        [[["1-p", "p"], [f"{'3' * 40}/1{'0' * 40}", f"6{'6' * 38}7/1{'0' * 40}"]]], {}, labels={"A": [0, 1]},
        parameters={"p": (0, 1)},
    )  # fmt: skip
    product = stl.build_product(model, stl.parse("F[0,40] G[0,1] A"))
    policy = stl.check(at(product, "1/2")).policy
    for own in (None, stl.Policy(product, policy.form)):
        with pytest.raises(SizeError, match=r"exact polynomials of degree 41 on .* would take .* compute in doubles"):
            stl.parametric(product, own, exact=True, memory_limit=50_000)
        assert stl.parametric(product, own, memory_limit=50_000).status == "complete"
    endless = stl.build_product(model, stl.parse("F[0,800] G[0,1] A"))
    with pytest.raises(SizeError, match="would take"):
        stl.parametric(endless, exact=True, memory_limit=2 * 10**6)
    rows = [[[0.3333333333333333, 0.6666666666666666], ["p", "1-p"]]]
    family = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 1]}, parameters={"p": (0, 1)})
    uneven = stl.build_product(family, stl.parse("F[0,2] A"))
    with pytest.raises(ModelError, match="so there is no exact answer"):
        stl.parametric(uneven, exact=True)


def test_a_function_that_is_not_monotone():
    """p² + (1−p)², least at ½: neither end is."""
    rows = [[["0", "p", "1-p", 0], [0, "p", 0, "1-p"], [0, 0, "1-p", "p"], [0, 0, 0, 1]]]
    model = stl.MDP.from_arrays(rows, {}, labels={"out": [0, 0, 0, 1]}, parameters={"p": (0, 1)})
    product = stl.build_product(model, stl.parse("G[0,2] !out"))
    found = stl.parametric(product)
    assert found.smallest(0.9)[:2] == (0, 0)
    first = stl.parametric(product, over={"p": ("0.3", 1)}).smallest(0.82)
    assert first.below <= Fraction(9, 10) <= first.enough < Fraction(9, 10) + Fraction(1, 10**9)
    assert Fraction(9, 10) - first.below < Fraction(1, 10**9)
    assert found.least[0] <= 0.5 <= found.least[1] <= found.least[0] + 1e-6
    assert found.greatest == pytest.approx((1, 1), abs=1e-12)
    assert found.at_least(0.499) is True
    assert found.at_least(0.501) is False
    assert found.at_most(0.9) is False
    assert found.at_least(0.5) is None
    assert found.at(0.25) == pytest.approx((0.625, 0.625), abs=1e-12)
    tied = stl.robust_check(product)  # nature takes p = 0 first, then p = 1
    assert tied.upper < 1e-14


@pytest.mark.parametrize("seed", range(many(10)))
def test_robust_checks_pick_the_parameter_of_every_row(seed):
    rng = np.random.default_rng(1000 + seed)
    product = random_product(rng)
    for maximize in (True, False):
        for nature in ("against", "with"):
            found = stl.robust_check(product, maximize=maximize, nature=nature)
            minimal = maximize == (nature == "against")
            exact = oracles.tied_optimum(product.model, product.formula, maximize, minimal)
            assert found.lower <= exact <= found.upper
            assert found.upper - found.lower < 1e-10


def test_engines_agree():
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5})
    product = stl.build_product(stl.load_model(task.model).family, task)
    found = {}
    for engine in ("nodes", "words"):
        layers = layers_of(Game.of(product), TRUE, EVERYTHING, engine=engine)
        arithmetic = Bernstein(product.horizon, {"success": Fraction(1, 3)}, {"success": Fraction(1)}, True)
        found[engine] = solve(layers, arithmetic, True).entry
        exactly = ExactBernstein({"success": Fraction(1, 3)}, {"success": Fraction(1)}, True)
        found[f"{engine}, exactly"] = solve(layers, exactly, True).entry
        scaled = found[f"{engine}, exactly"][0]  # of a lower degree: all is decided before the horizon
        c = tuple(Fraction(b, math.comb(exactly.degree, i) * exactly.one) for i, b in enumerate(scaled))
        raised = Polynomial(Fraction(1, 3), Fraction(1), c).raised(product.horizon).coefficients
        assert found[engine][0] == pytest.approx([float(one) for one in raised], rel=1e-13)
        assert found[engine][0, -1] == 1
    assert found["nodes"].shape == (1, product.horizon + 1)
    assert np.array_equal(found["nodes"], found["words"])
    assert np.array_equal(found["nodes, exactly"], found["words, exactly"])


@pytest.mark.parametrize("formula", ["A", "!A", "F[0,3] (A | !A)", "F[0,0] A"])
def test_decided_tasks(formula):
    model = stl.MDP.from_arrays([[["p", "1-p"], [0, 1]]], {}, labels={"A": [1, 0]}, parameters={"p": (0, 1)})
    product = stl.build_product(model, stl.parse(formula))
    expected = float(stl.check(at(product, 1)).probability)
    assert stl.parametric(product).at("1/3") == pytest.approx((expected, expected), abs=1e-13)


def test_polynomials():
    rng = np.random.default_rng(0)
    for _ in range(20):
        c = rng.random(rng.integers(1, 9))
        n = len(c) - 1
        left, right = halves(c)
        for x in rng.random(5):
            exact = sum(math.comb(n, i) * x**i * (1 - x) ** (n - i) * ci for i, ci in enumerate(c))
            half, place = (left, 2 * x) if x < 0.5 else (right, 2 * x - 1)
            assert value(c, x, 1 - x) == pytest.approx(exact, rel=1e-12)
            assert value(half, place, 1 - place) == pytest.approx(exact, rel=1e-12)
        seen = [value(c, x, 1 - x) for x in np.linspace(0, 1, 401)]
        (low, attained, _), (high, reached, _) = least(c, 1e-9), greatest(c, 1e-9)
        assert low - 1e-12 <= min(seen) <= attained + 1e-4
        assert reached - 1e-4 <= max(seen) <= high + 1e-12
        assert attained - low <= 1e-9
        assert high - reached <= 1e-9


def test_what_does_not_fit_is_refused():
    rng = np.random.default_rng(0)
    product = random_product(rng)
    with pytest.raises(SettingsError, match="do not depend on parameters"):
        stl.parametric(stl.build_product(oracles.random_model(rng, 4), stl.parse("F[0,1] A")))
    with pytest.raises(SettingsError, match="no parameter q"):
        stl.parametric(product, over={"q": (0, 1)})
    with pytest.raises(SettingsError, match="positive number"):
        stl.parametric(product, tol=0)
    rows, domains = [[["p", "1-p"], ["q", "1-q"]]], {"p": (0, 1), "q": (0, 1)}
    two = stl.build_product(
        stl.MDP.from_arrays(rows, {}, labels={"A": [1, 0]}, parameters=domains), stl.parse("F[0,1] A")
    )
    with pytest.raises(SettingsError, match="one parameter, the model has p and q"):
        stl.parametric(two)
    other = random_product(np.random.default_rng(7))
    with pytest.raises(PolicyError):
        stl.parametric(product, random_policy(other, rng, False))


def test_several_parameters_are_refused_and_the_others_can_be_fixed():
    rows = [[["1-p", "p", 0], ["1-q", 0, "q"], [0, 0, 1]]]
    model = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 0, 1]}, parameters={"p": (0, 1), "q": (0, 1)})
    phi = stl.parse("F[0,3] A")
    with pytest.raises(SettingsError, match="one parameter, the model has p and q; fix the others with from_family"):
        stl.parametric(stl.build_product(model, phi))
    fixed = stl.MDP.from_family(lambda p: model.at(p=p, q="1/2"), {"p": (0, 1)})
    lower, upper = stl.parametric(stl.build_product(fixed, phi)).at("3/4")
    exact = stl.check(stl.build_product(model.at(p="3/4", q="1/2"), phi)).probability
    assert lower <= exact <= upper
