"""Falsification: what is found is a violation, what cannot be found ends with the budget, and a seed is a search."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import MissingExtraError
from stltool.models.environment import simulator
from stltool.testing import Signal, falsify, input_signals, replay, steer
from stltool.testing.falsification import steering
from stltool.testing.falsification.candidates import Candidates
from stltool.testing.falsification.dynamics import Dynamics, Surprise, _steps
from stltool.testing.falsification.inputs import Inputs
from stltool.testing.falsification.score import Scores
from stltool.testing.falsification.search import Portfolio
from stltool.testing.falsification.strict import Strictness
from stltool.testing.falsification.tried import Prefixes, Tried
from tests.conftest import many

METHODS = ("portfolio", "random", "annealing", "cma", "optuna")


class Integrator:
    """x' = u, in steps of 0.1, from x = 0.1 u: with |u| <= 1, x reaches at most 5.1 in 50 steps."""

    def __init__(self):
        self.calls = 0

    def __call__(self, inputs):
        self.calls += 1
        return {"x": 0.1 * np.cumsum(inputs["u"])}


U = {"u": Signal(-1, 1, points=5)}


@pytest.mark.parametrize("seed", range(3))
def test_what_only_the_extreme_input_violates_is_found(seed):
    result = falsify(Integrator(), "G[0,50] (x < 5.1 - 1e-9)", U, seed=seed)
    assert result.falsified
    assert result.executions <= 4  # rest, the two corners, and a uniform point
    assert result.points["u"].tolist() == [1.0] * 5


@pytest.mark.soak(only=True)
@pytest.mark.parametrize("method", METHODS)
def test_what_no_input_violates_ends_with_the_budget(method):
    system = Integrator()
    result = falsify(system, "G[0,50] (x < 5.2)", U, budget=14, method=method)
    assert not result
    assert system.calls == result.executions == len(result.history) == 14
    assert result.robustness == result.history.min() >= 0.1 - 1e-9


@pytest.mark.parametrize("method", METHODS)
def test_a_seed_is_a_search(method):
    phi = "G[0,50] (x < 4.6 | x > 4.7)"
    first, again, other = (falsify(Integrator(), phi, U, budget=14, seed=seed, method=method) for seed in (1, 1, 2))
    assert first.history.tolist() == again.history.tolist()
    assert first.code == again.code
    assert first.history.tolist() != other.history.tolist()


def test_the_result_is_the_execution_and_its_code_repeats_it():
    system = Integrator()
    result = falsify(system, "G[0,50] (x < 4.65 | x > 4.7)", {**U, "v": (0, 1)}, seed=3)
    assert result.falsified
    again = system(eval(result.code))
    assert np.array_equal(again["x"], result.trace["x"])
    assert not stl.satisfies(result.formula, result.trace)
    assert result.robustness == result.history[-1] == stl.monitor(result.formula, result.trace, at=0).robustness[0]
    assert result.robustness == pytest.approx(stl.robustness(result.formula, result.trace), abs=1e-14)
    assert not result.diagnosis.verdict


@pytest.mark.soak
def test_a_small_inner_region_is_found_sooner_than_by_chance():
    """Uniform points fall into it once in 318 times."""

    def bowl(inputs):
        return {"r": np.array([np.hypot(inputs["a"] - 0.3, inputs["b"] - 0.7)])}

    found = [
        falsify(bowl, "r > 0.0316227766", {"a": (0, 1), "b": (0, 1)}, budget=100, seed=seed).executions
        for seed in range(max(5, many(10)))
    ]
    assert np.median(found) < 40


def test_inputs_and_labels_may_be_named_by_the_formula():
    result = falsify(
        lambda inputs: {"on": inputs["u"] > 0.95}, "G[0,9] (on -> u > 0.97)", {"u": Signal(0, 1, points=5)}, budget=300
    )
    assert result.falsified
    assert result.trace["on"].dtype == bool
    assert not stl.satisfies(result.formula, result.trace)


@given(st.data())
def test_signals_are_made_of_their_control_points(data):
    shape = data.draw(st.sampled_from(["constant", "linear"]))
    points, steps = data.draw(st.integers(1, 6)), data.draw(st.integers(1, 12))
    values = data.draw(st.lists(st.floats(-5, 5), min_size=points, max_size=points))
    found = Signal(-5, 5, points=points, shape=shape).samples(np.array(values), steps)
    for t in range(steps):
        if shape == "constant" or points == 1:
            expected = values[t * points // steps]
        else:
            at = t * (points - 1) / (steps - 1) if steps > 1 else 0
            expected = np.interp(at, range(points), values)
        assert found[t] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    "text", ["G[0,5] (x < 100 -> F[0,3] (y > 0.5))", "x == 1 | !(y <= -2 * x)", "(x > 0.5) U[0,6] (y - x < 0.1)"]
)
def test_scores_have_the_sign_of_robustness(text):
    rng, phi = np.random.default_rng(0), stl.parse(text)
    scores, expected = Scores(phi), []
    for _ in range(many(100)):
        trace = {"x": 100 * rng.normal(size=9), "y": rng.normal(size=9)}
        scores.add(trace)
        expected.append(stl.robustness(phi, trace))
    assert np.array_equal(np.sign(scores.values), np.sign(expected))


def test_the_learned_model_of_a_linear_system_predicts_it():
    rng = np.random.default_rng(0)
    inputs = np.repeat(rng.random((12, 6, 1)), 8, axis=1)
    signals = np.zeros((12, 48, 2))
    for k in range(47):
        x, v = signals[:, k].T
        signals[:, k + 1, 0], signals[:, k + 1, 1] = x + 0.1 * v, 0.9 * v - 0.1 * x + inputs[:, k, 0] - 0.5
    none = np.zeros((12, 0))
    model = Dynamics(inputs[:9], signals[:9], none[:9], rng)
    predicted = model.executed(inputs[9:], none[9:])
    assert np.abs(predicted - signals[9:]).max() < 0.02 * np.abs(signals).max()


def test_predictions_are_corrected_by_what_they_missed():
    traced, missed = np.array([[0.0, 0.0], [1.0, 1.0], [4.0, 4.0]]), np.array([0.5, -0.2, 0.1])
    surprise = Surprise(traced, missed)
    mean, deviation = surprise.at(np.concatenate([traced, [[1e6, 1e6]]]))
    assert mean[:3] == pytest.approx(missed, abs=1e-2)
    assert mean[3] == pytest.approx(0, abs=1e-9)
    assert deviation[:3].max() < 0.1 * deviation[3] == pytest.approx(0.1 * np.sqrt(np.mean(missed**2)), rel=1e-2)


TEXTS = (
    "(G[0,8] (x < 5)) -> (F[0,3] (y > 0))",
    "G[0,4] (x > 0 -> F[0,4] (y > 1))",
    "(x > y) U[0,8] (G[0,2] (y > 0) | x < -1)",
    "F[0,6] (x[t+2] > x)",
    "G[3,6] (once[0,2] (x > 1) -> F[0,2] (y > 0))",
)


@given(st.sampled_from(TEXTS), st.integers(0, 2**32 - 1))
def test_a_verdict_is_certain_when_every_continuation_agrees(text, seed):
    phi, rng = stl.parse(text), np.random.default_rng(seed)
    n = stl.horizon(phi) + 1
    trace = {"x": rng.normal(size=n).cumsum(), "y": rng.normal(size=n)}
    after = Prefixes(phi, np.arange(1, n)).certain(trace)
    verdict = stl.satisfies(phi, trace)
    continued = {
        name: np.concatenate([np.tile(row[:after], (50, 1)), rng.normal(0, 10, (50, n - after))], axis=1)
        for name, row in trace.items()
    }
    assert (stl.monitor(phi, continued, at=0).verdicts == verdict).all()


def test_what_cannot_violate_is_told_from_what_can():
    """The premise fails before the second control point: only the first had a part, as long as it is the same."""
    phi, inputs = stl.parse("(G[0,8] (x < 0.5)) -> (F[0,8] (x > 2))"), Inputs({"u": Signal(0, 1, points=3)}, 9)
    tried = Tried(phi, inputs)
    x = np.array([0.9, 0.2, 0.3])
    tried.add(x, inputs.values(x) | {"x": inputs.values(x)["u"]})
    assert tried.relevant.tolist() == [[True, False, False]]
    assert tried.settled(np.array([[0.9, 0.7, 0.1], [0.2, 0.2, 0.3]])).tolist() == [True, False]
    varied = Candidates(inputs, np.random.default_rng(0)).varied(
        np.repeat(tried.points, 30, 0), tried.relevant.repeat(30, 0)
    )
    assert (varied[:, 0] != 0.9).all()


@pytest.mark.parametrize("points", [1, 3])
@pytest.mark.parametrize("shape", ["constant", "linear"])
def test_a_coordinate_is_relevant_from_the_sample_on_that_it_changes(points, shape):
    inputs = Inputs({"u": Signal(2, 3, points=points, shape=shape), "a": (0, 1)}, 8)
    x = np.full(points + 1, 0.5)
    for samples in range(1, 9):
        for i, relevant in enumerate(inputs.relevant(samples)[:points]):
            y = x.copy()
            y[i] = 0.8
            same = np.array_equal(inputs.values(x)["u"][:samples], inputs.values(y)["u"][:samples])
            assert relevant == (not same)
            assert same or i == 0 or inputs.begins.min() < samples
    assert inputs.relevant(1)[-1]


def test_time_tells_how_near_a_mode_is_to_a_violation():
    phi = stl.parse("G[0,40] (on & !stop -> G[0,10] on)")
    strictness = Strictness(phi)
    on, stop = np.zeros((4, 51)), np.ones((4, 51))
    for row, lasts in zip(on, (9, 14, 20, 51), strict=True):
        row[5 : 5 + lasts] = 1
    stop[:, 5] = 0
    shares = strictness.of({"on": on, "stop": stop})
    assert shares[0] == 0 < shares[1] < shares[2] < shares[3] == 1
    assert not Strictness(stl.parse("G[0,40] on & F[0,5] stop"))  # nothing to make stricter within the trace


def test_time_steers_where_all_margins_are_the_same():
    """Only a pulse that ends within two of the fifteen control points violates."""

    def system(inputs):
        on = inputs["u"] > 0.5
        return {"on": on & (np.arange(90) >= 10)}

    phi = stl.parse("G[0,60] (rise(on) -> G[0,25] on)")
    scores = Scores(phi)
    for lasts in (0, 31, 40, 60, 70, 80):
        on = np.zeros(86)
        on[5 : 5 + lasts] = 1
        scores.add({"on": on})
    assert scores.by_time
    assert len(set(scores.values)) > 2
    assert np.argmin(scores.values) == 1
    assert falsify(system, phi, {"u": Signal(0, 1, points=15)}, steps=90, budget=60).falsified


def test_the_first_inputs_are_at_rest_then_each_alone_at_its_far_end():
    inputs = Inputs({"u": Signal(-1, 3, points=2), "a": (0, 5), "v": Signal(-4, 0, points=1), "b": (1, 2)}, 8)
    corners = Candidates(inputs, np.random.default_rng(0)).corners()
    rest = np.array([0.25, 0.25, 1.0, 0.0, 0.0])  # u, u, v, a, b
    assert corners[0].tolist() == rest.tolist()
    for corner, (first, end, far) in zip(
        corners[1:], [(0, 2, 1.0), (2, 3, 0.0), (3, 4, 1.0), (4, 5, 1.0)], strict=False
    ):
        expected = rest.copy()
        expected[first:end] = far
        assert corner.tolist() == expected.tolist()
    assert corners[5].tolist() == [1, 1, 0, 1, 1]
    assert len(corners) > 6
    assert all(set(corner) <= {0.0, 1.0} for corner in corners[5:])
    assert len({corner.tobytes() for corner in corners}) == len(corners)


def test_pieces_move_grow_and_shrink_as_wholes():
    inputs = Inputs({"u": Signal(0, 1, points=12)}, 12)
    x = np.repeat([[0.2, 0.7, 0.4]], [4, 5, 3], axis=1)
    found = Candidates(inputs, np.random.default_rng(0)).varied(np.repeat(x, 400, axis=0))
    shapes = {tuple(np.flatnonzero(np.diff(row)) + 1) for row in found}
    levels = [row for row in found if tuple(np.flatnonzero(np.diff(row)) + 1) == (4, 9)]
    assert len({row[5] for row in levels}) > 20  # the same pieces, another level
    assert {(3, 9), (5, 9), (4, 8), (4, 10)} <= shapes  # the same levels, earlier or later
    moved = [row for row in found if tuple(np.flatnonzero(np.diff(row)) + 1) == (5, 9)]
    assert any(row.tolist() == [0.2] * 5 + [0.7] * 4 + [0.4] * 3 for row in moved)


def test_most_coordinates_move_together_by_little_or_by_much():
    inputs = Inputs({"u": Signal(0, 1, points=10), "a": (0, 1)}, 10)
    x = np.full((400, inputs.dimension), 0.5)
    moved = Candidates(inputs, np.random.default_rng(0)).moved(x)
    assert ((moved >= 0) & (moved <= 1)).all()
    share = (moved != x).mean(axis=1)
    assert 0.4 < share.mean() < 0.9
    assert share.max() == 1
    sizes = np.array([np.abs(row[row != 0.5] - 0.5).mean() for row in moved if (row != 0.5).any()])
    assert np.quantile(sizes, 0.9) > 2.5 * np.quantile(sizes, 0.1)


def test_mixed_points_have_coordinates_at_ends():
    inputs = Inputs({"u": Signal(0, 1, points=10)}, 10)
    found = Candidates(inputs, np.random.default_rng(0)).mixed(400)
    assert 0.3 < np.isin(found, [0, 1]).mean() < 0.5
    assert len(np.unique(found)) > 2000


def test_points_are_random_where_scores_lead_nowhere_or_nothing_finds_better_ones():
    """Flat scores: random points alone. Scores of pure noise: random points among the others."""
    inputs, rng = Inputs({"u": Signal(0, 1, points=6)}, 6), np.random.default_rng(0)
    for noisy in (False, True):
        portfolio = Portfolio(stl.parse("x > 0"), inputs, np.random.default_rng(0))
        asked = []
        portfolio._proposal = lambda kind, ask=portfolio._proposal, asked=asked: (asked.append(kind), ask(kind))[1]
        for _ in range(100):
            portfolio.tell(portfolio.ask(), {"x": np.array([2 + noisy * rng.random()])})
        assert (asked[20:].count("random") == len(asked[20:])) != noisy
        assert asked[20:].count("random") >= 8


def test_the_model_sees_the_shortest_inner_window():
    assert _steps(stl.parse("G[0,999] (x > 0)"), 1000) == 64
    assert _steps(stl.parse("G[0,900] (x > 0 -> F[1,101] (G[0,1] (y > 0)))"), 1000) == 160
    assert _steps(stl.parse("(G[0,900] (F[0,100] (x > 0))) & (F[0,3] (x > 1))"), 1000) == 100
    assert _steps(stl.parse("G[0,999] (F[0,0] (x > 0))"), 1000) == 64


def test_variations_start_afresh_where_the_best_lead_no_further():
    portfolio = Portfolio(stl.parse("x > 0"), Inputs({"u": (0, 1)}, 1), np.random.default_rng(0))
    for i in range(85):
        portfolio.tell(np.array([0.5]), {"x": np.array([1.0 if i == 30 else 2.0 + i / 100])})
        if i == 69:
            assert portfolio._worth_varying()[0] == 30
    assert portfolio._worth_varying().tolist() == [80, 81, 82, 83, 84]


def test_an_impulse_changes_one_input_for_a_while():
    inputs = Inputs({"u": Signal(-1, 3, points=4), "v": Signal(2, 6, points=4), "a": (-4, -2)}, 8)
    candidates = Candidates(inputs, np.random.default_rng(0))
    assert candidates.rest().tolist() == [0.25] * 4 + [0.0] * 4 + [1.0]  # 0, 2 and -2 are nearest to zero
    for x in candidates.impulses(50):
        changes = [len(np.flatnonzero(np.diff(x[a:b]))) for a, b in inputs.places]
        assert max(changes) <= 2
        assert min(changes) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"system": 3}, "falsify's system is 3, not a function"),
        ({"inputs": {}}, "inputs are empty"),
        ({"inputs": {"u": (1, 1)}}, r"range of the input u is \(1, 1\); its low end must be below"),
        ({"inputs": {"u": 3}}, r"the input u is 3; give its range, \(low, high\), or a Signal"),
        ({"budget": 0}, "budget is 0; it must be an integer from 1"),
        ({"method": "luck"}, "method is 'luck'; choose portfolio, random"),
        ({"phi": "G (x > 0)"}, "needs an interval with an end"),
        ({"seed": -1}, "seed is -1"),
        ({"system": lambda inputs: {"x": [0.0]}}, r"signal x is of shape \(1,\); return at least 6 samples"),
        ({"system": lambda inputs: {"x": "up"}}, "signal x is 'up'; return at least 6 samples"),
        ({"system": lambda inputs: [0.0] * 6}, "the system's signals are .*, not a mapping"),
        ({"system": lambda inputs: {"X": [0.0] * 6}}, "returns no signal x, which the formula names; did you mean X"),
    ],
)
def test_bad_arguments_are_told(change, message):
    given = {"system": Integrator(), "phi": "G[0,5] (x < 9)", "inputs": U, "budget": 3, **change}
    with pytest.raises(stl.StlToolError, match=message):
        falsify(given.pop("system"), given.pop("phi"), given.pop("inputs"), **given)


@pytest.mark.parametrize("points", [0, 2.5])
def test_a_signal_has_control_points(points):
    with pytest.raises(stl.StlToolError, match="points is"):
        Signal(0, 1, points=points)


def test_an_exception_of_the_system_comes_with_the_inputs():
    def system(inputs):
        raise ZeroDivisionError("as it happens")

    with pytest.raises(ZeroDivisionError, match="as it happens") as raised:
        falsify(system, "G[0,5] (x < 9)", {"a": (2, 3)})
    assert "under the inputs {'a': 2." in raised.value.__notes__[0] or "{'a': 3.0}" in raised.value.__notes__[0]


@pytest.mark.soak(only=True)
def test_what_a_system_returns_besides_is_used_if_it_can_be():
    """Words, numbers, gaps, and a signal that is not always there, in all kinds of proposals."""
    calls = []

    def system(inputs):
        calls.append(inputs)
        x = 0.1 * np.cumsum(inputs["u"])
        some = {"seldom": x} if len(calls) % 3 else {}
        return {"x": x, "name": "tank", "count": 3, "gap": np.where(x > 0, x, np.nan), "huge": 1e200 * x, **some}

    result = falsify(system, "G[0,50] (x < 5.2)", U, budget=24)
    assert result.executions == 24
    assert {"x"} <= set(result.trace) <= {"x", "seldom", "gap"}


def test_a_missing_optimiser_names_its_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "cma", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'stltool\[falsify\]'"):
        falsify(Integrator(), "G[0,5] (x < 9)", U, method="cma")


# ------------------------------------------------------------------------------------------------------- Hypothesis


def test_every_conjunct_steers_on_its_own(monkeypatch):
    told = {}
    monkeypatch.setattr(steering, "target", lambda value, label: told.__setitem__(label, value))
    trace = {"x": [0.5, 2.0], "y": [1.0, 3.0]}
    assert steer("(G[0,1] (x > 0)) & (F[0,1] (y > 2))", trace) == 0.5
    assert told == {"robustness of G[0,1] (x > 0)": -0.5, "robustness of F[0,1] (y > 2)": -1.0}


@given(input_signals({"u": Signal(2, 4, points=3), "a": (5, 6)}, steps=7))
def test_input_signals_are_those_of_a_system(inputs):
    assert inputs["u"].shape == (7,)
    assert 2 <= inputs["u"].min() <= inputs["u"].max() <= 4
    assert 5 <= inputs["a"] <= 6


# ------------------------------------------------------------------------------------------------------------ replay


@pytest.fixture(scope="module")
def slippery():
    """From state 0 one reaches 1 with probability 3/4, else stays; only 1 is A."""
    model = stl.MDP.from_arrays([[[0.25, 0.75], [0, 1]]], {}, labels={"A": [0, 1]})
    return stl.build_product(model, stl.parse("F[0,2] A"))


def test_the_most_probable_violation_is_replayed_on_a_black_box(slippery):
    box = simulator(slippery.model, np.random.default_rng(0))
    result = replay(slippery, box, attempts=400)
    assert result.run.probability == result.chance == 1 / 16
    assert result.reproduced
    assert result.furthest == (0, 0, 0)
    assert result.missed == (15 / 16) ** result.attempts


def test_a_black_box_that_does_not_follow_the_model_is_told(slippery):
    class Sure:
        def reset(self):
            return 0

        def step(self, action):
            return 1

    result = replay(slippery, Sure(), attempts=20)
    assert not result
    assert (result.attempts, result.furthest) == (20, (0, 1))
    assert result.missed == pytest.approx((15 / 16) ** 20)


def test_what_cannot_be_violated_has_no_replay(slippery):
    product = stl.build_product(slippery.model, stl.parse("F[0,2] (A | !A)"))
    with pytest.raises(stl.StlToolError, match="no run of this policy violates the task"):
        replay(product, simulator(product.model, np.random.default_rng(0)))
    with pytest.raises(stl.StlToolError, match="environment is None"):
        replay(slippery, None)


def test_numbers_and_signals_share_the_cube():
    cube = Inputs({"a": (0, 10), "u": Signal(2, 4, points=2), "b": (-1, 1)}, 4)
    values = cube.values(np.array([0.0, 1.0, 0.5, 0.25]))
    assert list(values) == ["a", "u", "b"]
    assert (values["a"], values["b"], values["u"].tolist()) == (5.0, -0.5, [2.0, 2.0, 4.0, 4.0])
