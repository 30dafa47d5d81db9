"""`shield`: no policy that obeys is below what is promised, held against trees of histories in fractions."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import TRUE, UNDECIDED
from stltool.checking.shield import _Unfolded
from stltool.errors import FileError, InfeasibleError, PolicyError, SettingsError
from tests import oracles
from tests.checking.test_check import products
from tests.conftest import ROOT, many

FACTORY = ROOT / "examples" / "factory"


@pytest.fixture(scope="module")
def patrol():
    """The scenario P1 of the paper."""
    task = stl.load_task(FACTORY / "patrolling.stl", {"T": 10, "tau": 10})
    return stl.build_product(stl.load_model(FACTORY / "floor-5x5.toml"), task)


def walk(shield, pick):
    """P of all runs, by histories in fractions; pick(allowed, values) → the value of a situation."""
    product = shield.product
    model, automaton = product.model, product.automaton

    def value(s, q, t, spent):
        verdict = automaton.verdicts(t)[q]
        if verdict != UNDECIDED:
            return Fraction(int(verdict == TRUE))
        allowed = shield.allows(t, s, q, spent)
        assert allowed[shield.best(t, s, q)]
        values = []
        for i in np.flatnonzero(allowed).tolist():
            c, after = int(model.choice_start[s]) + i, shield.spend(t, s, q, i, spent)
            entries = range(model.row_start[c], model.row_start[c + 1])
            values.append(
                sum(
                    Fraction(float(model.probability[k]))
                    * value(int(model.target[k]), product.enter(int(model.target[k]), q), t + 1, after)
                    for k in entries
                )
            )
        return pick(values)

    start = oracles.initial(model)
    return sum((p * value(s, product.enter(s, automaton.initial), 0, 0) for s, p in start), Fraction(0))


@st.composite
def shields(draw):
    product = draw(products())
    best = stl.check(product)
    assume(best.lower > 0.01 and product.horizon > 0)
    share = draw(st.sampled_from([Fraction(3, 10), Fraction(3, 5), Fraction(9, 10), Fraction(1)]))
    rule = draw(st.sampled_from(["static", "ratio"]))
    return stl.shield(product, Fraction(best.lower) * share, rule, levels=draw(st.sampled_from([1, 5, 16])))


@given(shields())
@settings(max_examples=many(30))
def test_the_least_probability_is_that_of_all_histories(shield):
    """And it keeps the promise."""
    least = walk(shield, min)
    assert Fraction(shield.least.lower) <= least <= Fraction(shield.least.upper)
    assert abs(Fraction(shield.least.value) - least) <= Fraction(1, 10**12)
    assert least >= shield.at_least
    even = walk(shield, lambda values: sum(values) / len(values))
    assert float(even) == pytest.approx(shield.uniform, abs=1e-12)


@given(shields(), st.integers(0, 2**32 - 1))
@settings(max_examples=many(10))
def test_random_policies_that_obey_keep_the_promise(shield, seed):
    """They remember their history, and mix."""
    rng = np.random.default_rng(seed)

    def mixed(values):
        weights = [Fraction(int(w)) for w in rng.integers(1, 100, len(values))]
        return sum(w * v for w, v in zip(weights, values, strict=True)) / sum(weights)

    assert walk(shield, mixed) >= shield.at_least


@pytest.mark.parametrize(("rule", "levels"), [("static", 64), ("ratio", 64), ("ratio", 255)])
def test_at_the_maximum_only_optimal_actions_are_left(rule, levels):
    """Two actions, worth 1/2 and 1/4, exactly; and a second step at which both are worth the same. With 255 levels,
    what an action costs that is never allowed does not fit into a byte."""
    first, second = [[0, 0.5, 0.5], [0, 1, 0], [0, 0, 1]], [[0, 0.25, 0.75], [0, 1, 0], [0, 0, 1]]
    model = stl.MDP.from_arrays([first, second], {"x": [0, 1, 2]}, labels={"A": [0, 1, 0]}, initial=0)
    product = stl.build_product(model, stl.parse("F[0,2] A"))
    shield = stl.shield(product, 0.5, rule, levels=levels)
    q = product.enter(0, product.automaton.initial)
    assert shield.allows(0, 0, q).tolist() == [True, False]
    assert shield.least.lower == shield.least.upper == 0.5
    wider = stl.shield(product, 0.25, rule, levels=levels)
    assert wider.allows(0, 0, q).tolist() == [True, True]
    with pytest.raises(PolicyError, match=r"is refused at step 0.*allowed"):
        shield.spend(0, 0, q, 1)
    with pytest.raises(InfeasibleError, match=r"cannot be promised: its maximum P\* is 0\.5"):
        stl.shield(product, 0.50001, rule)


def test_what_is_sure_can_be_promised():
    """P = 1 by the graph alone, through rows whose doubles do not sum to 1 in any exact way."""
    third = 1 / 3
    safe = [[third, third, third], [third, third, third], [third, third, third]]
    risky = [[third, third, third], [0.1, 0.2, 0.7], [0.3, 0.3, 0.4]]
    model = stl.MDP.from_arrays([safe, risky], {"x": [0, 1, 2]}, labels={"A": [1, 1, 1]})
    product = stl.build_product(model, stl.parse("F[1,3] A & x >= 0"))
    for rule in ("static", "ratio"):
        assert stl.shield(product, 1, rule).least.lower == 1


def test_promising_again_after_every_loss_breaks_the_promise(patrol):
    """The naive rule: an action is allowed if it is worth c, and only the best one where none is."""
    unfolded, c = _Unfolded(patrol), 0.95
    ends = np.array([0.0, 1.0])
    costs, values = [], ends
    for step in reversed(unfolded.steps):
        (edges,) = step.edges
        worth = unfolded._sums(edges, values, unfolded._probability)
        top = np.maximum.reduceat(worth, edges.choices[:-1])
        needed = np.minimum(c, np.repeat(top, np.diff(edges.choices)))
        costs.append((worth < needed).astype(np.uint8))
        values = np.concatenate([ends, top])
    naive = unfolded.least(costs[::-1], 0)[0]
    assert naive.upper < c
    assert naive.value == pytest.approx(0.8972, abs=5e-5)


@pytest.mark.parametrize(
    ("rule", "least", "uniform", "share"), [("static", 0.9509, 0.9709, 0.629), ("ratio", 0.9510, 0.9574, 0.648)]
)
def test_patrolling(patrol, rule, least, uniform, share, tmp_path):
    shield = stl.shield(patrol, 0.95, rule)
    assert shield.least.lower >= 0.95
    assert shield.least.value == pytest.approx(least, abs=5e-5)
    assert shield.uniform == pytest.approx(uniform, abs=5e-5)
    assert shield.share == pytest.approx(share, abs=5e-4)
    shield.save(tmp_path / "mask.npz")
    again = stl.Shield.load(tmp_path / "mask.npz", patrol)
    assert (again.at_least, again.rule, again.levels) == (0.95, rule, shield.levels)
    assert again.least == shield.least
    assert len(again.layers) == len(shield.layers)
    assert all(mine.same(theirs) for mine, theirs in zip(shield.layers, again.layers, strict=True))


@pytest.mark.soak
def test_policies_that_obey_are_judged(patrol):
    """Judged by `check`, exactly as any policy."""
    shield, rng = stl.shield(patrol, 0.95), np.random.default_rng(0)
    width = patrol.model.most_choices
    for _ in range(many(10)):
        table = np.zeros((patrol.horizon, *patrol.shape, width))
        table[..., 0] = 1.0
        for layer in shield.layers:
            for i, code in enumerate(layer.codes.tolist()):
                allowed = layer.cost[layer.start[i] : layer.start[i + 1]] == 0
                weights = rng.random(len(allowed)) ** 4 * allowed
                s, q = divmod(code, patrol.shape[1])
                table[layer.first : layer.last + 1, s, q] = 0
                table[layer.first : layer.last + 1, s, q, : len(allowed)] = weights / weights.sum()
        assert stl.check(patrol, stl.Policy(patrol, table)).probability >= 0.95


@pytest.fixture(scope="module")
def two_steps():
    """Two states in a row with a lazy action, worth 9/10 each."""
    go, lazy = np.eye(4)[[1, 2, 2, 3]], np.array([[0, 0.9, 0, 0.1], [0, 0, 0.9, 0.1], [0, 0, 1, 0], [0, 0, 0, 1]])
    model = stl.MDP.from_arrays([go, lazy], {"x": [0, 1, 2, 3]}, labels={"A": [0, 0, 1, 0]}, initial=0)
    return stl.build_product(model, stl.parse("F[0,2] A"))


def test_an_allowance_is_spent_once(two_steps):
    """Lazy once keeps 0.85, lazy twice does not: the ratio rule allows either, but not both."""
    shield = stl.shield(two_steps, 0.85, "ratio")
    q = two_steps.enter(0, two_steps.automaton.initial)
    q1 = two_steps.enter(1, q)
    assert shield.allows(0, 0, q).tolist() == [True, True]
    assert shield.allows(1, 1, q1, 0).tolist() == [True, True]
    spent = shield.spend(0, 0, q, 1)
    assert shield.allows(1, 1, q1, spent).tolist() == [True, False]
    assert shield.allowance(0) == 1 > shield.allowance(spent) >= 0
    assert shield.least.value == pytest.approx(0.9)


def test_faults_are_told(two_steps, patrol, tmp_path):
    shield = stl.shield(two_steps, 0.85)
    with pytest.raises(PolicyError, match="no run of the model can be at step 0, state 1"):
        shield.allows(0, 1, two_steps.automaton.initial)
    with pytest.raises(SettingsError, match="between 0 and 1"):
        stl.shield(two_steps, 1.5)
    path = tmp_path / "mask.npz"
    with pytest.raises(PolicyError, match=r"saved as \.npz"):
        shield.save(tmp_path / "mask.csv")
    shield.save(path)
    with pytest.raises(PolicyError, match="the shield is for the task"):
        stl.Shield.load(path, patrol)
    with pytest.raises(FileError, match="there is no such shield file"):
        stl.Shield.load(tmp_path / "none.npz", two_steps)
    Path(tmp_path / "other.npz").write_bytes(b"not an archive")
    with pytest.raises(FileError, match="would be lost"):
        shield.save(tmp_path / "other.npz")
    with pytest.raises(PolicyError, match="not a shield of this version"):
        stl.Shield.load(tmp_path / "other.npz", two_steps)


def test_a_mask_that_was_widened_in_its_file_is_refused(two_steps, tmp_path):
    path = tmp_path / "mask.npz"
    stl.shield(two_steps, 0.95).save(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    assert arrays["cost"].any()
    arrays["cost"] = np.zeros_like(arrays["cost"])
    np.savez(path, **arrays)
    with pytest.raises(PolicyError, match="does not keep P >="):
        stl.Shield.load(path, two_steps)
    arrays["cost"] = np.ones_like(arrays["cost"])
    np.savez(path, **arrays)
    with pytest.raises(PolicyError, match="damaged"):
        stl.Shield.load(path, two_steps)


FLOOR = """
kind = "grid"
map = '''
..A
.W.
S..
'''
moves = "cross"
success = "8/10"
"""


def trained(env, rng, aim, episodes=40):
    """The Q-values of an agent that has learned under the shield: to satisfy, to violate, or whatever it likes."""
    values, likes = {}, {}
    for episode in range(episodes):
        observation, _ = env.reset(seed=int(rng.integers(2**31)) if episode == 0 else None)
        over, path = False, []
        while not over:
            key = situation(observation)
            free = env.action_masks().nonzero()[0].tolist()
            known = values.setdefault(key, dict.fromkeys(free, 1.0))
            assert set(known) == set(free)
            action = max(known, key=lambda a: (known[a], rng.random())) if rng.random() > 0.2 else int(rng.choice(free))
            if aim == "own":
                path.append((key, action, likes.setdefault((observation["state"], action), rng.random())))
            else:
                path.append((key, action, 0.0))
            observation, reward, over, _, info = env.step(action)
            assert not info["replaced"]
        gain = {"satisfy": reward, "violate": -reward, "own": 0.0}[aim]
        for key, action, liked in reversed(path):
            gain += liked
            values[key][action] += 0.3 * (gain - values[key][action])
    return values


def situation(observation):
    return tuple(float(np.ravel(observation[name])[0]) for name in sorted(observation))


def judged(env, shield, values):
    """P of the greedy agent, exactly; where it has never been, the worst of what it may do."""
    product, env = shield.product, env.unwrapped
    model, automaton, known = product.model, product.automaton, {}

    def value(s, q, t, spent):
        verdict = automaton.verdicts(t)[q]
        if verdict != UNDECIDED:
            return Fraction(int(verdict == TRUE))
        if (s, q, t, spent) not in known:
            observation = dict(env.observation(t, s, q))
            if shield.levels:
                observation["allowance"] = np.float32(shield.allowance(spent))
            learned = values.get(situation(observation))
            free = np.flatnonzero(shield.allows(t, s, q, spent)).tolist()
            first = int(model.choice_start[s])
            if learned is not None:
                best = max(learned, key=lambda a: (learned[a], -a))
                free = [i for i in free if model.choice_action[first + i] == best]
                assert free
            options = []
            for i in free:
                after, entries = shield.spend(t, s, q, i, spent), range(*model.row_start[first + i : first + i + 2])
                there = [(Fraction(float(model.probability[k])), int(model.target[k])) for k in entries]
                options.append(sum(p * value(u, product.enter(u, q), t + 1, after) for p, u in there))
            known[s, q, t, spent] = min(options)
        return known[s, q, t, spent]

    return sum(p * value(s, product.enter(s, automaton.initial), 0, 0) for s, p in oracles.initial(model))


@pytest.mark.soak
@pytest.mark.parametrize("rule", ["static", "ratio"])
def test_agents_trained_under_the_shield_keep_its_promise(rule, tmp_path):
    """None of them is below c, not even those that are rewarded for violating the task."""
    (tmp_path / "floor.toml").write_text(FLOOR)
    model = stl.load_model(tmp_path / "floor.toml")
    product = stl.build_product(model, stl.parse("F[0,6] A & G[0,6] !W"))
    best = stl.check(product)
    promise = Fraction(best.lower) * Fraction(9, 10)
    shield = stl.shield(product, promise, rule)
    found = {}
    for agent in range(max(5, many(25))):  # in CI fifty with each rule
        env, aim = stl.to_gymnasium(product, shield=shield), ("satisfy", "violate", "own")[agent % 3]
        p = judged(env, shield, trained(env, np.random.default_rng([agent, rule == "ratio"]), aim))
        assert promise <= p <= Fraction(best.upper) + Fraction(1, 10**9)
        found.setdefault(aim, []).append(p)
    assert max(found["satisfy"]) > min(found["violate"])
