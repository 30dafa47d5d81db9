"""Models that are functions: the answers of the same model stored, to the bit, and every bad row refused by name."""

import subprocess
import sys

import numpy as np
import pytest

import stltool as stl
from stltool.errors import ModelError

DENOMINATOR = 1000


def tables(seed, n_states=30, n_actions=3, k=4):
    """Successors and whole numbers over 1000, some 0, some successors repeated."""
    rng = np.random.default_rng(seed)
    successors = rng.integers(0, n_states, (n_states, n_actions, k))
    cuts = np.sort(rng.integers(0, DENOMINATOR + 1, (n_states, n_actions, k - 1)), axis=2)
    shares = np.diff(cuts, axis=2, prepend=0, append=DENOMINATOR)
    return successors, shares


def matrices(successors, shares):
    """The same as one matrix per action, of texts."""
    n_states, n_actions, _ = shares.shape
    sums = np.zeros((n_actions, n_states, n_states), dtype=np.int64)
    for s, a in np.ndindex(n_states, n_actions):
        np.add.at(sums[a, s], successors[s, a], shares[s, a])
    return sums


def both(seed, as_doubles, monkeypatch, task="F[0,6] a & G[0,5] !b", **changes):
    successors, shares = tables(seed)
    rng = np.random.default_rng(seed + 1000)
    columns = {
        "signals": {"x": np.arange(30.0)}, "labels": {"a": rng.random(30) < 0.2, "b": rng.random(30) < 0.1},
        "initial": np.where(np.arange(30) < 4, 0.25, 0.0),
    }  # fmt: skip
    sums = matrices(successors, shares)
    if as_doubles:
        dense = (sums / DENOMINATOR).transpose(1, 0, 2)  # one entry a successor, so that nothing is added in doubles
        model = stl.MDP.from_function(30, 3, lambda s, a: (np.tile(np.arange(30), (len(s), 1)), dense[s, a]), **columns)
        stored = stl.MDP.from_arrays(sums / DENOMINATOR, **columns)
    else:
        step = lambda s, a: (successors[s, a], shares[s, a])  # noqa: E731
        model = stl.MDP.from_function(30, 3, step, denominator=DENOMINATOR, **columns)
        texts = np.array([f"{k}/{DENOMINATOR}" for k in sums.ravel().tolist()]).reshape(sums.shape)
        stored = stl.MDP.from_arrays(texts, **columns)
    monkeypatch.setattr("stltool.models.mdp._FEW", 0)
    monkeypatch.setattr("stltool.models.mdp.READ_EXACTLY", 0)
    return [stl.build_product(m, stl.parse(task)) for m in (model, stored)]


def told(result):
    arrays = result.policy.form.arrays() if result.policy is not None else {}
    return (result.probability, result.lower, result.upper), {k: v.tolist() for k, v in arrays.items()}


@pytest.mark.parametrize("engine", ["nodes", "words"])
@pytest.mark.parametrize("seed", range(5))
def test_the_same_model_stored(seed, engine, monkeypatch):
    made, held = both(seed, False, monkeypatch)
    for maximize in (True, False):
        for arithmetic in ("double", "fixed"):
            options = {"maximize": maximize, "engine": engine, "arithmetic": arithmetic}
            assert told(stl.check(made, **options)) == told(stl.check(held, **options))
        one, other = (stl.check(p, maximize=maximize, engine=engine, exact=True) for p in (made, held))
        assert one.fraction == other.fraction
    assert "rows" not in vars(made.model)
    assert made.model.digest() == held.model.digest()
    assert made.model.n_transitions == held.model.n_transitions


@pytest.mark.parametrize("engine", ["nodes", "words"])
@pytest.mark.parametrize("seed", range(5))
def test_the_same_doubles_stored(seed, engine, monkeypatch):
    """Their enclosures may differ: it is not known of a model that is not whole which decimals it means."""
    made, held = both(seed, True, monkeypatch)
    for maximize in (True, False):
        one, other = (stl.check(p, maximize=maximize, engine=engine, arithmetic="double") for p in (made, held))
        assert one.probability == other.probability
        assert told(one)[1] == told(other)[1]
        assert one.lower <= other.probability <= one.upper
        again = stl.check(made, stl.Policy(made, other.policy.form), engine=engine, arithmetic="double")
        assert again.probability == one.probability
    assert "rows" not in vars(made.model)


def test_small_models_are_as_if_they_were_stored(monkeypatch):
    made, held = both(0, True, monkeypatch)
    monkeypatch.undo()
    small, same = (stl.build_product(p.model, p.formula) for p in (made, held))
    for options in ({}, {"exact": True}, {"arithmetic": "fixed"}):
        one, other = stl.check(small, **options), stl.check(same, **options)
        assert (told(one), one.fraction, one.arithmetic) == (told(other), other.fraction, other.arithmetic)
    assert stl.sample_run(small, seed=3).states == stl.sample_run(same, seed=3).states


def test_calls_are_cut_into_blocks(monkeypatch):
    made, held = both(1, False, monkeypatch)
    whole = held.model.rows
    monkeypatch.setattr("stltool.models.function._BLOCK", 40)
    found = made.model.source.rows(np.arange(30))
    for name in ("choice_start", "row_start", "target", "probability", "numerator"):
        assert np.array_equal(getattr(found, name), getattr(whole, name)), name


@pytest.mark.soak(only=True)
def test_a_function_compiled_by_numba():
    numba = pytest.importorskip("numba")

    @numba.njit(cache=True)  # by far the most of this test's time
    def step(s, a):
        successors, shares = np.empty((len(s), 2), dtype=np.int64), np.empty((len(s), 2))
        for i in range(len(s)):
            successors[i, 0], successors[i, 1] = min(s[i] + a[i], 9), s[i]
            shares[i] = 0.75, 0.25
        return successors, shares

    model = stl.MDP.from_function(10, ["stay", "on"], step, labels={"end": lambda s: s == 9})
    product = stl.build_product(model, stl.parse("F[0,9] end"))
    assert stl.check(product, exact=True).fraction == stl.check(product).probability == 0.75**9


def test_what_a_state_has():
    step = lambda s, a: (np.minimum(s + a, 3)[:, None], np.where((s == 3) & (a == 1), 0.0, 1.0)[:, None])  # noqa: E731
    available = np.ones((4, 2), dtype=bool)
    available[3, 1] = False
    model = stl.MDP.from_function(4, 2, step, available=available, labels={"end": lambda s: s == 3})
    assert model.n_choices == model.n_transitions == 7
    assert model.choice_action.tolist() == [0, 1, 0, 1, 0, 1, 0]
    assert stl.check(stl.build_product(model, stl.parse("F[0,3] end"))).probability == 1.0
    without = stl.MDP.from_function(4, 2, step, labels={"end": lambda s: s == 3})
    with pytest.raises(ModelError, match=r"state 3, action 1: all probabilities are 0; define with `available`"):
        stl.check(stl.build_product(without, stl.parse("F[0,3] end & G[0,4] !end")))


def only_at(s, a, state, action, usual, instead):
    """`usual` for every pair, `instead` for one."""
    found = np.tile(usual, (len(s), 1))
    found[(s == state) & (a == action)] = instead
    return found


def both_ways(s, a):
    return np.stack([s, (s + 1) % 5], axis=1)


BAD = {
    "sum": (
        lambda s, a: (both_ways(s, a), only_at(s, a, 2, 1, [0.5, 0.5], [0.5, 0.4])),
        "state c, action up: the probabilities sum to 0.9, not 1",
    ),
    "negative": (
        lambda s, a: (both_ways(s, a), only_at(s, a, 2, 1, [0.5, 0.5], [1.5, -0.5])),
        "state c, action up: 1.5 to state c is not a probability",
    ),
    "nan": (
        lambda s, a: (both_ways(s, a), only_at(s, a, 3, 0, [0.5, 0.5], [1.0, np.nan])),
        "state d, action stay: nan to state e is not a probability",
    ),
    "outside": (
        lambda s, a: (both_ways(s, a) + only_at(s, a, 1, 1, [0, 0], [0, 7]), only_at(s, a, 9, 9, [0.5, 0.5], 0)),
        "state b, action up: step leads to state 9; states are numbered 0 … 4",
    ),
    "below": (
        lambda s, a: (both_ways(s, a) - only_at(s, a, 1, 1, [0, 0], [9, 0]), only_at(s, a, 9, 9, [0.5, 0.5], 0)),
        "state b, action up: step leads to state -8; states are numbered 0 … 4",
    ),
}


@pytest.mark.parametrize("engine", ["nodes", "words"])
@pytest.mark.parametrize(("step", "says"), BAD.values(), ids=BAD)
def test_bad_rows_are_refused_when_they_are_made(step, says, engine, monkeypatch):
    monkeypatch.setattr("stltool.models.mdp.READ_EXACTLY", 0)
    model = stl.MDP.from_function(5, ["stay", "up"], step, state_names=list("abcde"), labels={"end": lambda s: s == 4})
    with pytest.raises(ModelError) as refusal:
        stl.check(stl.build_product(model, stl.parse("F[0,9] end")), engine=engine)
    assert str(refusal.value) == says


@pytest.mark.parametrize(
    ("step", "options", "says"),
    [
        (lambda s, a: s, {}, "step returned an array"),
        (lambda s, a: (s, s), {}, "step returned successors of shape (2,) for 2 pairs; return two arrays"),
        (lambda s, a: (s[:, None], np.ones((2, 2))), {}, "and probabilities of shape (2, 2)"),
        (lambda s, a: (s[:, None] * 1.0, np.ones((2, 1))), {}, "successors of type float64; return integers"),
        (lambda s, a: (s[:, None], np.array([["1"], ["1"]])), {}, "probabilities of type <U1; return doubles"),
        (lambda s, a: (s[:, None], np.ones((2, 1))), {"denominator": 3}, "with a denominator, return integers"),
        (lambda s, a: (s[:, None], np.full((2, 1), 2)), {"denominator": 3}, "probabilities sum to 2/3, not 1"),
        (lambda s, a: (s[:, None], np.full((2, 1), 0.5)), {}, "state 0, action 0: the probabilities sum to 0.5, not 1"),
        (lambda s, a: ([[1], [1, 2]], np.ones((2, 1))), {}, "rows of unequal lengths"),
        (None, {}, "step is None; give a function"),
    ],
)  # fmt: skip
def test_functions_that_do_not_fit_are_refused_at_once(step, options, says):
    with pytest.raises(ModelError) as refusal:
        stl.MDP.from_function(4, 2, step, **options)
    assert says in str(refusal.value)


def test_as_many_successors_every_time():
    def step(s, a):
        k = 1 + len(s) % 2
        return np.tile(s[:, None], (1, k)), np.full((len(s), k), 1.0 / k)

    with pytest.raises(ModelError, match="step returned 1 successors for each pair, but 2 before"):
        stl.MDP.from_function(4, 1, step).source.rows(np.arange(4))


LARGE = r"""
import resource, sys
import numpy as np
import psutil
import stltool as stl

DX, DY = np.array([0, 1, -1, 0, 0]), np.array([0, 0, 0, 1, -1])

def floor(n):
    def step(s, a):
        x, y = s % n, s // n
        to = np.clip(y + DY[a], 0, n - 1) * n + np.clip(x + DX[a], 0, n - 1)
        return np.stack([to, s], axis=1), np.tile([9, 1], (len(s), 1))
    middle = n // 2 * n + n // 2
    goal = lambda s: s == middle + 3 * n + 3
    return stl.MDP.from_function(n * n, 5, step, denominator=10, initial=middle, labels={"A": goal})

for n in (20, 1000):
    if n == 1000:
        before = psutil.Process().memory_info().vms
        resource.setrlimit(resource.RLIMIT_AS, (before + 150_000_000, resource.RLIM_INFINITY))
    found = stl.check(stl.build_product(floor(n), stl.parse("F[0,10] A")), engine=sys.argv[1])
    print(found.probability, found.lower, found.upper, found.engine)
"""


@pytest.mark.soak(only=True)
@pytest.mark.parametrize("engine", ["nodes", "words"])
def test_a_million_cells_in_a_small_address_space(engine):
    """All ten million entries would take 120 MB, and as much again while they are made."""
    done = subprocess.run([sys.executable, "-c", LARGE, engine], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    small, large = done.stdout.splitlines()
    assert small == large
    assert 0.9 < float(small.split()[0]) < 1
