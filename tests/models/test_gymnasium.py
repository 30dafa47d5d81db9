"""Gymnasium environments as models, and models as environments, against what the environments themselves do."""

import math
import sys
from fractions import Fraction
from unittest import mock

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.display import StateNames
from stltool.errors import MissingExtraError, ModelError, SettingsError, SizeError
from stltool.models.environment import simulator
from stltool.models.gymnasium import replay
from tests.conftest import many
from tests.models.gymnasium_envs import Listed, Scripted

LAKE = {"goal": {15}, "hole": {5, 7, 11, 12}}
CROSSING = stl.parse("!hole U[0,80] goal")


def newest(name):
    """The id of an environment's newest version in this gymnasium."""
    return max((key for key in gymnasium.registry if key.startswith(name + "-v")), key=lambda key: int(key[-1]))


def lake(**options):
    return stl.from_gymnasium(gymnasium.make("FrozenLake-v1"), LAKE, **options)


def rows_of(model):
    """(state, action) → {successor: probability}"""
    found = {}
    for s in range(model.n_states):
        for c in range(model.choice_start[s], model.choice_start[s + 1]):
            entries = slice(model.row_start[c], model.row_start[c + 1])
            row = zip(model.target[entries].tolist(), model.probability[entries].tolist(), strict=True)
            found[s, int(model.choice_action[c])] = dict(row)
    return found


# ------------------------------------------------------------------------------------------------ transition tables


@pytest.mark.parametrize("name", ["FrozenLake", "CliffWalking"])
def test_a_table_becomes_the_exact_model(name):
    name = newest(name)
    env = gymnasium.make(name)
    model = stl.from_gymnasium(env)
    P = env.unwrapped.P
    ends = {s2 for s in P for a in P[s] for _, s2, _, terminated in P[s][a] if terminated}
    assert 0 < len(ends) < len(P)
    expected = {}
    for s in P:
        for a in P[s]:
            row = {s: 1.0} if s in ends else {}
            for p, s2, _, _ in P[s][a] if s not in ends else []:
                row[int(s2)] = row.get(int(s2), 0.0) + p
            expected[s, a] = row
    found = rows_of(model)
    assert found.keys() == expected.keys()
    for place, row in expected.items():
        assert found[place] == pytest.approx(row, abs=1e-15)
    assert model.initial.tolist() == env.unwrapped.initial_state_distrib.tolist()
    assert (model.name, model.blackbox, model.state_name(3), model.action_names[1]) == (name, None, "3", "1")


def test_taxi_serves_all_whose_shortest_way_is_short_enough():
    env = gymnasium.make(newest("Taxi"))
    P, decode = env.unwrapped.P, lambda s: list(env.unwrapped.decode(s))
    model = stl.from_gymnasium(env, {"done": lambda s: decode(s)[2] == decode(s)[3]})
    steps, layer = {}, {s for s in range(500) if decode(s)[2] == decode(s)[3]}
    while layer:  # breadth first, backwards
        steps |= dict.fromkeys(layer, 1 + max(steps.values(), default=-1))
        layer = {s for s in P if s not in steps and any(P[s][a][0][1] in steps for a in P[s])}
    assert max(steps.values()) > 15
    for h in (5, 11, 15):
        near = math.fsum(p for s, p in enumerate(env.unwrapped.initial_state_distrib) if steps[s] <= h)
        assert stl.check(stl.build_product(model, stl.parse(f"F[0,{h}] done"))).probability == pytest.approx(near)


# ------------------------------------------------------------------------------- tables that are not the dynamics


class Otherwise(Listed):
    """Lists P, and does what `turn` makes of its outcomes: (times it was asked, state, action, outcome) → outcome."""

    def __init__(self, P, turn, **named):
        super().__init__(P, **named)
        self.turn, self.asked = turn, 0

    def step(self, action):
        before, self.asked = self.s, self.asked + 1
        s2, reward, terminated, truncated, info = super().step(action)
        self.s, reward, terminated = self.turn(self.asked, before, action, (s2, reward, terminated))
        return self.s, reward, terminated, truncated, info


COIN = {s: {a: [(0.5, 0, 0.0, False), (0.5, 1, 1.0, False)] for a in (0, 1)} for s in (0, 1, 2)}
"""Three states, of which the last is never reached."""


@pytest.mark.parametrize(
    ("turn", "says"),
    [
        (lambda n, s, a, o: (2, *o[1:]) if (s, a) == (1, 1) else o, "action 1 in state 1 led to state 2 with reward"),
        (lambda n, s, a, o: (2, *o[1:]) if n == 700 else o, "led to state 2 with reward"),
        (lambda n, s, a, o: (7, *o[1:]) if n == 3 else o, "led to state 7 with reward"),
        (lambda n, s, a, o: (o[0], 1.0 - o[1], o[2]), "action . in state 0 led to state . with reward"),
        (lambda n, s, a, o: (o[0], o[1], n == 50), "terminated=True, which P.*does not list; use table=False"),
        (
            lambda n, s, a, o: (n % 8 == 0, float(n % 8 == 0), False),
            "likeliest outcome of P.s..a. occurred .* times, and the table",
        ),
        (lambda n, s, a, o: 1 / 0, r"step\(.\) raised ZeroDivisionError: division by zero; correct the environment"),
    ],
)
def test_a_table_that_is_not_what_the_environment_does_is_refused(turn, says):
    for table in ("auto", True):
        with pytest.raises(ModelError, match=says):
            stl.from_gymnasium(Otherwise(COIN, turn), table=table)
    assert stl.from_gymnasium(Otherwise(COIN, turn), table=False).blackbox is not None
    assert stl.from_gymnasium(Otherwise(COIN, lambda n, s, a, o: o)).blackbox is None


@pytest.mark.parametrize(
    ("reset", "step", "says"),
    [
        (lambda env: env.s, None, r"reset.seed=….* returned int \d, not .observation, info.; it follows the older gym"),
        (
            lambda env: ("x", {}),
            None,
            "reset.. started in .'x', .*, to which initial_state_distrib gives no probability",
        ),
        (
            None,
            lambda env: (env.s, 0.0, False, {}),
            "returned 4 values, not .observation, reward, terminated, truncated",
        ),
        (None, lambda env: ("x", 0.0, False, False, {}), "returned the observation 'x', which is not in its space"),
    ],
)
def test_answers_that_are_none_are_told_while_a_table_is_tried(reset, step, says):
    class Odd(Listed):
        def reset(self, **named):
            answer = super().reset(**named)
            return reset(self) if reset else answer

        def step(self, action):
            answer = super().step(action)
            return step(self) if step else answer

    with pytest.raises(ModelError, match=says):
        stl.from_gymnasium(Odd(COIN))


def test_starts_that_the_distribution_does_not_list_are_refused():
    env = Listed(COIN, first=(0.5, 0.5))
    env.initial_state_distrib = np.array([0.5, 0.0, 0.5])
    with pytest.raises(
        ModelError, match=r"reset\(\) started in state 1, to which initial_state_distrib gives no probab"
    ):
        stl.from_gymnasium(env)


def test_rewards_of_reward_wrappers_are_not_held_against_the_table():
    env = gymnasium.wrappers.TransformReward(Listed(COIN), lambda reward: reward - 7)
    assert stl.from_gymnasium(env).blackbox is None


def test_what_is_shown_to_people_is_not_shown_while_a_table_is_tried():
    class Shown(Listed):
        metadata = {"render_modes": ["human"]}  # noqa: RUF012
        render_mode = "human"

        def step(self, action):
            assert self.render_mode is None
            return super().step(action)

    env = Shown(COIN)
    assert stl.from_gymnasium(env).blackbox is None
    assert env.render_mode == "human"


@pytest.mark.parametrize("table", ["auto", True])
def test_fickle_passengers_are_refused_by_name(table):
    env = gymnasium.make(newest("Taxi"), fickle_passenger=True)
    with pytest.raises(
        ModelError, match="with fickle_passenger=True the passenger may change .*; leave the option out"
    ):
        stl.from_gymnasium(env, table=table)
    assert stl.from_gymnasium(env, table=False).blackbox is not None


@pytest.mark.parametrize("seed", range(4))
def test_fickle_passengers_are_found_without_their_name(monkeypatch, seed):
    """The replay alone finds what few episodes do, whatever its random numbers are."""
    generator = np.random.default_rng
    monkeypatch.setattr("stltool.models.gymnasium.table.require_listed", lambda *_: None)
    monkeypatch.setattr(np.random, "default_rng", lambda _: generator(seed))
    with pytest.raises(
        ModelError, match="its transition table does not describe its behaviour: action .* does not list"
    ):
        stl.from_gymnasium(gymnasium.make(newest("Taxi"), fickle_passenger=True))


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("Taxi", {"is_rainy": True}), ("CliffWalkingSlippery", {}), ("FrozenLake8x8", {"success_rate": 0.7}),
        ("FrozenLake", {"is_slippery": False}),
    ],
)  # fmt: skip
def test_tables_of_known_environments_are_what_they_do(name, options):
    assert stl.from_gymnasium(gymnasium.make(newest(name), **options), table=True).blackbox is None


def test_thirds_of_the_lake_are_thirds_on_request():
    exact = lake(normalize=True)
    assert exact.exact().denominator == 3
    assert "rescaled" in exact.notes["normalize"]
    product = stl.build_product(exact, stl.parse("!hole U[0,9] goal"))
    found = stl.check(product, exact=True)
    assert found.fraction.denominator % 3 == 0
    doubles = stl.check(stl.build_product(lake(), stl.parse("!hole U[0,9] goal")))
    assert doubles.lower <= found.fraction <= doubles.upper
    with pytest.raises(ModelError, match=r"so there is no exact answer; .*normalize=True"):
        stl.check(stl.build_product(lake(), stl.parse("!hole U[0,9] goal")), exact=True)


@st.composite
def tables(draw):
    """A toy-text table over 2 to 4 states with outcomes in quarters."""
    n_states, n_actions = draw(st.integers(2, 4)), draw(st.integers(1, 2))
    outcome = st.tuples(st.integers(0, n_states - 1), st.just(0.0), st.booleans())
    shares = st.sampled_from([(1.0,), (0.5, 0.5), (0.25, 0.75), (0.5, 0.25, 0.25), (0.0, 1.0)])

    def row():
        return [(p, *draw(outcome)) for p in draw(shares)]

    return {s: {a: row() for a in range(n_actions)} for s in range(n_states)}


@settings(max_examples=many(100))
@given(tables())
def test_tables_mean_what_their_episodes_do(P):
    """Against runs written down in Fractions: they stay where they end."""
    going_on, ended, todo = {0}, set(), [0]
    while todo:
        for outcomes in P[todo.pop()].values():
            for p, s2, _, terminated in outcomes:
                if p and terminated:
                    ended.add(s2)
                elif p and s2 not in going_on:
                    going_on.add(s2)
                    todo.append(s2)
    env = Listed(P)

    def read(env, **options):
        with mock.patch.object(replay, "_STEPS", 100):  # a replay for each of the examples
            return stl.from_gymnasium(env, **options)

    if going_on & ended:
        with pytest.raises(ModelError, match="both with terminated=True and before the end, .* use ends='apart'"):
            read(env)
    last = len(P) - 1

    def value(s, end, t):
        if s == last:
            return Fraction(1)
        if t == 5 or end:
            return Fraction(0)
        return max(sum(Fraction(p) * value(s2, e, t + 1) for p, s2, _, e in P[s][a]) for a in P[s])

    for ends in ["apart"] if going_on & ended else ["apart", "merged"]:
        product = stl.build_product(read(env, labels={"last": {last}}, ends=ends), stl.parse("F[0,5] last"))
        assert stl.check(product).probability == pytest.approx(float(value(0, False, 0)), abs=1e-14)


def test_states_that_no_run_reaches_may_be_entered_both_ways():
    P = {0: {0: [(1.0, 1, 0, False)]}, 1: {0: [(1.0, 0, 0, False)]}, 2: {0: [(1.0, 1, 0, True)]}}
    assert rows_of(stl.from_gymnasium(Listed(P))) == {(0, 0): {1: 1.0}, (1, 0): {0: 1.0}, (2, 0): {1: 1.0}}


@pytest.mark.parametrize(
    ("row", "says"),
    [
        (
            [(0.5, 0, 0, False)],
            r"the probabilities of P\[0\]\[0\] sum to 0.5, not 1; correct the table, or use table=False",
        ),
        ([(0.5, 0, 0, False), (0.500001, 1, 0, False)], r"the probabilities of P\[0\]\[0\] sum to 1.000001"),
        ([(1.0 + 1e-6, 0, 0, False)], "is not a .probability, next state 0 … 1"),
        ([(math.nan, 0, 0, False)], "contains .nan, 0, 0, False., which is not"),
        ([(-0.5, 0, 0, False), (1.5, 0, 0, False)], "contains .-0.5"),
        ([(1.0, 2, 0, False)], "next state 0 … 1, reward, terminated"),
        ([(1.0, 0.5, 0, False)], "is not a .probability"),
        ([(1.0, 0, False)], "is not a .probability"),
        ([(1.0, 0, 0, "no")], "is not a .probability"),
        ([], "sum to 0, not 1"),
    ],
)
def test_tables_that_are_none_are_refused(row, says):
    with pytest.raises(ModelError, match=says):
        stl.from_gymnasium(Listed({0: {0: row}, 1: {0: [(1.0, 1, 0, False)]}}))


def test_rows_that_nearly_sum_to_one_are_kept_as_given():
    near = [(1 / 3, 0, 0, False), (2 / 3 + 1e-12, 1, 0, False)]
    model = stl.from_gymnasium(Listed({0: {0: near}, 1: {0: [(1.0, 1, 0, False)]}}))
    assert rows_of(model)[0, 0] == {0: 1 / 3, 1: 2 / 3 + 1e-12}


def test_first_states_without_a_distribution():
    P = {s: {0: [(1.0, s, 0, False)]} for s in range(2)}
    assert stl.from_gymnasium(Listed(P, (0.0, 1.0), distribution=False)).initial.tolist() == [0, 1]
    with pytest.raises(ModelError, match="starts in several states, but has no initial_state_distrib"):
        stl.from_gymnasium(Listed(P, (0.5, 0.5), distribution=False))


class Rows(Listed):
    """An environment whose P is an array (S, A, S), or of another form; if `ends`, runs end in the last state."""

    def __init__(self, array, form=lambda array: array, ends=True):
        n = len(array)
        P = [[[(array[s, a, t], t, 1.0, ends and t == n - 1) for t in range(n)] for a in range(len(array[s]))]
             for s in range(n)]  # fmt: skip
        super().__init__(P)
        self._listed, self.P = P, form(array)

    def step(self, action):
        shown, self.P = self.P, self._listed
        try:
            return super().step(action)
        finally:
            self.P = shown


@pytest.fixture
def corridor():
    """(S, A, S): wait, or go on with .75; the last of three states cannot be left."""
    rows = np.zeros((3, 2, 3))
    rows[:, 0] = np.eye(3)
    rows[0, 1, :2] = rows[1, 1, 1:] = 0.25, 0.75
    rows[2, 1, 2] = 1
    return rows


@pytest.mark.parametrize(
    "form",
    [
        lambda array: array,
        list,
        np.ndarray.tolist,
        lambda array: {s: dict(enumerate(rows)) for s, rows in enumerate(array)},
    ],
    ids=["array", "list of arrays", "lists", "dicts"],
)
@pytest.mark.parametrize("ends", [True, False])
def test_an_array_of_probabilities_is_a_table(corridor, form, ends):
    model = stl.from_gymnasium(Rows(corridor, form, ends), {"goal": {2}})
    assert (model.blackbox, model.n_transitions) == (None, 8)
    product = stl.build_product(model, stl.parse("F[0,3] goal"))
    assert stl.check(product, exact=True).fraction == Fraction(27, 32)
    assert stl.from_gymnasium(Rows(corridor, form), ends="apart").n_states == 6


def test_an_array_that_is_not_what_the_environment_does_is_refused(corridor):
    env = Rows(corridor)
    env.P = corridor[[0, 2, 2]]
    with pytest.raises(ModelError, match=r"does not describe its behaviour: action 0 in state 1 led to state 1 with"):
        stl.from_gymnasium(env)
    open_ended = Rows(corridor)
    open_ended._listed[0][1] = [(0.25, 0, 1.0, False), (0.75, 1, 1.0, True)]  # ends where the array goes on
    with pytest.raises(ModelError, match=r"led to state 1 with reward 1.0 and terminated=True, which P\[0\]\[1\]"):
        stl.from_gymnasium(open_ended)
    env.P = corridor.transpose(1, 0, 2)
    with pytest.raises(
        ModelError, match=r"P has shape \(2, 3, 3\), \(actions, states, states\); give P\[s\]\[a\], an array"
    ):
        stl.from_gymnasium(env)
    env.P = np.eye(4)  # an array of the environment's own, which is no table
    assert stl.from_gymnasium(env).blackbox is not None


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ([0.5, 0.5, 0.1], r"the probabilities of P\[0\]\[0\] sum to 1.1, not 1"),
        ([1.5, -0.5, 0], r"P\[0\]\[0\] is 1.5 for state 0; give the probabilities of the 3 states"),
        ([math.nan, 1, 0], r"P\[0\]\[0\] is nan for state 0"),
        ([1.0], r"P\[0\]\[0\] is \[1.0\]; give the probabilities of the 3 states"),
    ],
)
def test_rows_that_are_no_distributions_are_refused(corridor, row, says):
    with pytest.raises(ModelError, match=says):
        stl.from_gymnasium(Rows(corridor, lambda array: [[row, *array[0].tolist()[1:]], *array.tolist()[1:]]))


def test_a_table_counts_only_for_the_environment_that_it_is_of():
    assert lake(table=True).blackbox is None
    assert lake(table=False).blackbox is not None

    class Sticky(gymnasium.ActionWrapper):
        def action(self, action):
            return 0

    sticky = Sticky(gymnasium.make("FrozenLake-v1"))
    assert stl.from_gymnasium(sticky).blackbox is not None
    with pytest.raises(
        ModelError, match="wrapper Sticky may change what its transition table describes; use table=False"
    ):
        stl.from_gymnasium(sticky, table=True)
    scaled = gymnasium.wrappers.TransformReward(gymnasium.make("FrozenLake-v1"), lambda r: 2 * r)
    assert stl.from_gymnasium(scaled).blackbox is None
    for env in (gymnasium.make("Blackjack-v1"), Scripted((0, {}))):
        assert stl.from_gymnasium(env).blackbox is not None
        with pytest.raises(ModelError, match="has no transition table"):
            stl.from_gymnasium(env, table=True)
    with pytest.raises(SettingsError, match="table is 'yes'; choose \"auto\", True or False"):
        lake(table="yes")


# ------------------------------------------------------------------------------------------------------ black boxes


def test_a_black_box_moves_as_its_table_says():
    known, unknown = lake(), lake(table=False)
    assert (unknown.n_states, unknown.action_names) == (known.n_states, known.action_names)
    assert {name: held.tolist() for name, held in unknown.labels.items()} == {
        name: held.tolist() for name, held in known.labels.items()
    }
    environment, rng = simulator(unknown, np.random.default_rng(5), 60), np.random.default_rng(6)
    counts = np.zeros((16, 4, 16))
    for _ in range(600):
        s = environment.reset()
        assert s == 0
        for a in rng.integers(4, size=60).tolist():
            s2 = environment.step(a)
            counts[s, a, s2] += 1
            s = s2
    expected = np.zeros((16, 4, 16))
    for (s, a), row in rows_of(known).items():
        expected[s, a, list(row)] = list(row.values())
    visits = counts.sum(axis=2, keepdims=True)
    assert (visits > 0).all(axis=1).sum() == 16  # every hole, and the goal
    assert (counts[expected == 0] == 0).all()
    spread = np.sqrt(expected * (1 - expected) * visits)
    assert (abs(counts - expected * visits) <= 4.5 * spread + 1e-9).all()
    assert (counts[5].sum(axis=1) == counts[5, :, 5]).all()  # after its end, a run stays


@pytest.fixture(scope="module")
def trainings():
    """Both lakes with what was learned on them."""
    found = []
    for model in (lake(), lake(table=False)):
        product = stl.build_product(model, CROSSING)
        found.append((product, stl.learn(product, episodes=300, seed=3)))
    return found


@pytest.mark.soak(only=True)
def test_the_lake_is_learned_with_and_without_its_table(trainings, tmp_path):
    (known, by_table), (unknown, by_steps) = trainings
    best = stl.check(known).probability
    assert best == pytest.approx(0.693482, abs=5e-7)
    assert stl.check(known, by_table.policy).probability > 0.95 * best
    transferred = stl.Policy(known, by_steps.policy.table)
    exact = stl.check(known, transferred).probability
    assert exact > 0.95 * best
    assert {point.probability for point in by_steps.history} == {None}
    found = stl.estimate(unknown, by_steps.policy, runs=400, seed=3)
    assert found.lower <= exact <= found.upper
    assert stl.sprt(unknown, by_steps.policy, 0.5, seed=3).verdict == "holds"
    run = stl.sample_run(unknown, by_steps.policy, seed=0)
    assert run.satisfied == (run.states[-1] == 15)
    assert run.states[0] == 0
    by_steps.policy.save(tmp_path / "p.npz")
    assert (stl.load_policy(tmp_path / "p.npz", unknown).table == by_steps.policy.table).all()
    with pytest.raises(stl.StlToolError, match="is for the model FrozenLake-v1 .*, not for FrozenLake-v1"):
        stl.load_policy(tmp_path / "p.npz", known)


def test_same_seed_same_result(trainings):
    unknown, run = trainings[1]
    again = stl.build_product(lake(table=False), CROSSING)
    few = [stl.learn(p, episodes=40, seed=3).policy.table for p in (again, unknown)]
    assert (few[0] == few[1]).all()
    first, second = (stl.estimate(p, run.policy, runs=100, seed=1) for p in (again, unknown))
    assert (first.satisfied, first.steps) == (second.satisfied, second.steps)
    counts = {stl.estimate(unknown, run.policy, runs=100, seed=seed).steps for seed in range(4)}
    assert len(counts) == 4


def test_a_run_is_resumed_to_the_same_bits(tmp_path):
    product = stl.build_product(lake(table=False), CROSSING)
    whole = stl.learn(product, episodes=60, seed=2)
    file = tmp_path / "run.npz"
    stl.learn(product, episodes=25, seed=2, checkpoint=file)
    resumed = stl.learn(
        stl.build_product(lake(table=False), CROSSING), episodes=60, seed=2, checkpoint=file, resume=True
    )
    assert (resumed.policy.table == whole.policy.table).all()
    assert resumed.environment_steps == whole.environment_steps


@pytest.mark.soak(only=True)
def test_a_tuple_of_observations_is_learned():
    """Blackjack: (the player's sum, the dealer's card, whether an ace counts 11), and no table."""
    model = stl.from_gymnasium(
        gymnasium.make("Blackjack-v1"),
        {"bust": lambda hand: hand[0] > 21},
        {"total": lambda hand: hand[0]},
        action_names=["stick", "hit"],
        ends="apart",
    )
    assert model.n_states == 2 * 704
    assert (model.state_name(704), model.signals["total"][-1]) == ("(0,0,0) ended", 31)
    assert (model.state_name(13 * 22 + 7 * 2 + 1), model.signals["total"][13 * 22]) == ("(13,7,1)", 13)
    product = stl.build_product(model, stl.parse("F[0,4] total >= 19 & G[0,4] !bust"))
    policy = stl.learn(product, "model-based", episodes=500, seed=0).policy
    stick = stl.Policy(product, np.zeros(product.shape, dtype=int))
    assert stl.estimate(product, policy, runs=1000).lower > stl.estimate(product, stick, runs=1000).upper


def test_cliffs_are_walked_along():
    model = stl.from_gymnasium(gymnasium.make(newest("CliffWalking")), {"goal": [47]}, table=False)
    product = stl.build_product(model, stl.parse("F[0,13] goal"))  # the shortest way
    policy = stl.learn(product, "model-based", episodes=300, seed=0).policy
    table = stl.build_product(
        stl.from_gymnasium(gymnasium.make(newest("CliffWalking")), {"goal": [47]}), product.formula
    )
    assert stl.check(table, stl.Policy(table, policy.table)).probability == 1


# ----------------------------------------------------------------------------------------------------------- spaces


def step_of(observation, terminated=False, truncated=False):
    return observation, 0.0, terminated, truncated, {}


NESTED = spaces.Tuple([spaces.Discrete(2, start=5), spaces.Tuple([spaces.Discrete(2), spaces.MultiDiscrete([2, 2])])])


@pytest.mark.parametrize(
    ("space", "observations", "states", "names"),
    [
        (spaces.Discrete(3, start=-1), [-1, np.int64(0), np.array(1)], [0, 1, 2], ["-1", "0", "1"]),
        (spaces.MultiDiscrete([2, 3]), [np.array([1, 2]), np.array([0, 1])], [5, 1], ["(0,0)", "(0,1)"]),
        (spaces.MultiDiscrete([[2], [2]]), [np.array([[1], [0]])], [2], ["(0,0)", "(0,1)"]),
        (
            NESTED,
            [(6, (0, np.array([1, 0]))), (5, (1, np.array([0, 1])))],
            [10, 5],
            ["(5,0,0,0)", "(5,0,0,1)"],
        ),
        (spaces.MultiBinary(2), [np.array([1, 0], dtype=np.int8)], [2], ["(0,0)", "(0,1)"]),
        (
            spaces.Box(np.array([-1, 3]), np.array([1, 4]), dtype=np.int64),
            [np.array([0, 4]), np.array([-1, 3])],
            [3, 0],
            ["(-1,3)", "(-1,4)"],
        ),
        (
            spaces.Dict(a=spaces.Discrete(2, start=1), b=spaces.MultiBinary([2])),
            [{"a": 2, "b": np.array([0, 1], dtype=np.int8)}, {"b": np.array([1, 0], dtype=np.int8), "a": 1}],
            [5, 2],
            ["(1,0,0)", "(1,0,1)"],
        ),
    ],
    ids=["start", "multi", "matrix", "nested", "binary", "integers", "dict"],
)  # fmt: skip
def test_observations_are_numbered(space, observations, states, names):
    first, *others = observations
    env = Scripted((first, {}), [step_of(o) for o in others], space, spaces.Discrete(2, start=3))
    model = stl.from_gymnasium(env, {"there": [plain(first)]})
    environment = simulator(model, np.random.default_rng(0))
    assert [environment.reset(), *(environment.step(1) for _ in others)] == states
    assert env.taken == [4] * len(others)  # actions count from their start
    assert model.action_names == ("3", "4")
    assert [model.state_name(s) for s in range(len(names))] == names
    assert np.flatnonzero(model.labels["there"]).tolist() == states[:1]


def plain(observation):
    """An observation in components, as labels list it."""
    if isinstance(observation, dict):
        return [n for key in sorted(observation) for n in np.ravel(observation[key]).tolist()]
    if isinstance(observation, tuple | np.ndarray) and np.ndim(np.array(observation, dtype=object)):
        return [n for part in observation for n in np.ravel(plain(part)).tolist()]
    return int(observation)


@pytest.mark.parametrize(
    ("space", "outside"),
    [
        (spaces.Discrete(3), [3, -1, 1.0, "1", None, np.array([1]), (1,)]),
        (spaces.Discrete(3, start=1), [0, 4]),
        (spaces.MultiDiscrete([2, 3]), [np.array([2, 0]), np.array([0, -1]), np.array([0.0, 1.0]), np.array([1]), 1]),
        (spaces.Tuple((spaces.Discrete(2), spaces.Discrete(2))), [(0,), (0, 1, 0), (0, 2), 1, "01"]),
        (spaces.Dict(a=spaces.Discrete(2)), [{}, {"b": 0}, {"a": 0, "b": 0}, {"a": 2}, 0]),
        (spaces.MultiBinary(2), [np.array([0, 2]), np.array([0]), np.array([0.0, 1.0])]),
        (spaces.Box(0, 3, (1,), np.int32), [np.array([4]), np.array([-1]), np.array([1.0]), 1]),
    ],
    ids=["discrete", "start", "multi", "tuple", "dict", "binary", "integers"],
)
def test_environments_that_leave_their_space(space, outside):
    inside = space.sample()
    for observation in outside:
        stepping = stl.from_gymnasium(Scripted((inside, {}), [step_of(inside), step_of(observation)], space))
        environment = simulator(stepping, np.random.default_rng(0))
        environment.reset()
        environment.step(1)
        with pytest.raises(ModelError) as refusal:
            environment.step(0)
        assert f"Scripted: step(0) returned the observation {observation!r} at step 2" in str(refusal.value)
        assert f"not in its space {space}; correct" in str(refusal.value)
        with pytest.raises(ModelError, match=r"reset\(seed=…\) returned the observation .* at step 0, which is not in"):
            simulator(stl.from_gymnasium(Scripted((observation, {}), (), space)), np.random.default_rng(0)).reset()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            {"observation_space": spaces.Box(0, 1)},
            "its observations are Box.*, which are not finitely many; divide them into cells, .* wrap it in",
        ),
        ({"observation_space": spaces.Dict(a=spaces.Box(0, 1))}, "its observations are Dict"),
        ({"observation_space": spaces.Box(0, 255, (9, 9), np.uint8)}, "its space Box.* has about 10.195 observations"),
        ({"observation_space": spaces.Tuple((spaces.Discrete(2), spaces.Box(0, 1)))}, "its observations are Tuple"),
        ({"observation_space": spaces.Tuple(())}, "its observations are Tuple"),
        ({"action_space": spaces.Box(0, 1)}, "its actions are Box.* wrap it in a gymnasium.ActionWrapper"),
        ({"action_space": spaces.MultiDiscrete([2, 2])}, "its actions are MultiDiscrete"),
        ({"action_space": spaces.Discrete(10**9)}, r"its space Discrete\(1000000000\) has more than 33554432 actions"),
    ],
)
def test_other_spaces_are_refused(options, says):
    with pytest.raises((ModelError, SizeError), match=f"Scripted: {says}"):
        stl.from_gymnasium(Scripted((0, {}), **options))
    with pytest.raises(ModelError, match="str: its observations are None"):
        stl.from_gymnasium("FrozenLake-v1")


@pytest.mark.parametrize(
    ("space", "says"),
    [
        (spaces.Discrete(10**8), r"its space Discrete\(100000000\) has 100000000 observations, and at most 33554432"),
        (spaces.MultiDiscrete([10**6, 10**6]), r"its space MultiDiscrete\(.*\) has 1000000000000 observations"),
        (spaces.MultiDiscrete([10] * 50), r"its space MultiDiscrete\(.*\.\.\. has about 10\^50 observations"),
    ],
)
def test_spaces_too_large_to_list_are_refused_at_once(space, says):
    def never(observation):
        raise AssertionError

    with pytest.raises(SizeError, match=f"Scripted: {says}.* wrap it in a gymnasium.ObservationWrapper"):
        stl.from_gymnasium(Scripted((0, {}), observation_space=space), {"a": never}, {"b": never})
    with mock.patch("stltool.sizes.memory_limit", return_value=10**6), pytest.raises(SizeError, match="of memory"):
        stl.from_gymnasium(Scripted((0, {}), observation_space=spaces.Discrete(10**5)), {"a": never})


def test_names_of_states_are_made_when_they_are_shown():
    model = stl.from_gymnasium(Scripted((0, {}), observation_space=spaces.Discrete(3, start=7)), ends="apart")
    assert list(model.state_names) == ["7", "8", "9", "7 ended", "8 ended", "9 ended"]
    assert isinstance(model.state_names, StateNames)


# --------------------------------------------------------------------------------------- environments that misbehave


@pytest.mark.parametrize(
    ("answers", "says"),
    [
        ([(0, 0.0, False, {})], r"step\(1\) returned 4 values, not .* older gym API"),
        ([7], r"step\(1\) returned int 7, not .observation, reward, terminated, truncated, info."),
        (
            [(1, 0.0, np.array([True, False]), False, {})],
            r"step\(1\) returned terminated = array.* return Booleans",
        ),
        (
            [(1, 0.0, False, "no", {})],
            r"step\(1\) returned terminated = False and truncated = 'no' at step 1; return Booleans",
        ),
        ([step_of(1), RuntimeError("motor lost")], r"step\(1\) raised RuntimeError at step 2: motor lost"),
    ],
)
def test_steps_that_fail(answers, says):
    product = stl.build_product(stl.from_gymnasium(Scripted((0, {}), answers), {"two": {2}}), stl.parse("F[0,5] two"))
    always = stl.Policy(product, np.ones(product.shape, dtype=int))
    for ask in (
        lambda: stl.estimate(product, always, runs=3),
        lambda: stl.sample_run(product, always, seed=0),
    ):
        with pytest.raises(ModelError, match=f"Scripted: {says}"):
            ask()
    with pytest.raises(ModelError, match="Scripted: step"):
        stl.learn(product, episodes=3)


def test_whatever_has_spaces_resets_and_steps_will_do():
    class Bare:
        observation_space, action_space = spaces.Discrete(2), spaces.Discrete(2)

        def reset(self, seed):
            return 0, {}

        def step(self, action):
            return action, 0.0, False, False, {}

    for table in ("auto", False):
        product = stl.build_product(stl.from_gymnasium(Bare(), {"one": {1}}, table=table), stl.parse("F[0,1] one"))
        assert stl.estimate(product, stl.learn(product, episodes=20).policy, runs=5).satisfied == 5


def test_resets_that_fail():
    def reset_of(env):
        return simulator(stl.from_gymnasium(env), np.random.default_rng(0)).reset()

    with pytest.raises(ModelError, match=r"reset\(seed=…\) returned int 0, not .observation, info.; .* older gym API"):
        reset_of(Scripted(0))

    class Old(Scripted):
        def reset(self):
            return 0

    with pytest.raises(ModelError, match=r"Old: reset\(seed=…\) raised TypeError at step 0"):
        reset_of(Old(0))


def test_episodes_shorter_than_the_horizon():
    product = stl.build_product(lake(table=False), stl.parse("!hole U[0,101] goal"))
    policy = stl.Policy(product, np.zeros(product.shape, dtype=int))
    says = (
        r"cut off \(truncated\) after 100 steps, .* needs 101; make it with gymnasium.make\(…, max_episode_steps=101\)"
    )
    for ask in (
        lambda: stl.learn(product, episodes=1),
        lambda: stl.estimate(product, policy, runs=1),
        lambda: stl.sample_run(product, policy, seed=0),
    ):
        with pytest.raises(ModelError, match=says):  # known beforehand
            ask()
    longer = stl.from_gymnasium(gymnasium.make("FrozenLake-v1", max_episode_steps=101), LAKE, table=False)
    assert stl.learn(stl.build_product(longer, product.formula), episodes=1).environment_steps > 0
    assert stl.check(stl.build_product(lake(), product.formula)).probability > 0.7  # a table has no limit

    cut = [step_of(1), step_of(1), step_of(0, truncated=True), step_of(2)]
    model = stl.from_gymnasium(Scripted((0, {}), cut), {"two": {2}})
    short, long = (stl.build_product(model, stl.parse(f"F[0,{h}] two")) for h in (3, 4))
    assert stl.estimate(short, stl.Policy(short, np.zeros(short.shape, dtype=int)), runs=2).satisfied == 0
    with pytest.raises(ModelError, match="after 3 steps, and the task needs 4; .*max_episode_steps=4"):
        stl.estimate(long, stl.Policy(long, np.zeros(long.shape, dtype=int)), runs=2)
    environment = simulator(model, np.random.default_rng(0))
    environment.reset()
    with pytest.raises(ModelError, match="needs more; .*max_episode_steps=…"):
        [environment.step(0) for _ in range(4)]


def test_an_end_is_no_cut():
    env = Scripted((0, {}), [step_of(2, terminated=True, truncated=True)])
    product = stl.build_product(stl.from_gymnasium(env, {"two": {2}}), stl.parse("G[1,5] two"))
    policy = stl.Policy(product, np.zeros(product.shape, dtype=int))
    assert stl.estimate(product, policy, runs=3).satisfied == 3
    assert env.taken == [0]


def test_an_observation_before_and_at_the_end():
    answers = [step_of(1), step_of(1, terminated=True)]
    environment = simulator(stl.from_gymnasium(Scripted((0, {}), answers)), np.random.default_rng(0))
    environment.reset()
    environment.step(0)
    with pytest.raises(ModelError, match="the observation 1 occurred both during an episode and at its end, .*apart"):
        environment.step(0)
    again = Scripted((0, {}), [step_of(0, terminated=True)])
    environment = simulator(stl.from_gymnasium(again), np.random.default_rng(0))
    environment.reset()
    with pytest.raises(ModelError, match="the observation 0 occurred both"):
        environment.step(0)
    apart = stl.from_gymnasium(Scripted((0, {}), answers), {"one": [1]}, {"x": [0, 1, 2]}, ends="apart")
    environment = simulator(apart, np.random.default_rng(0))
    assert [environment.reset(), *(environment.step(0) for _ in range(3))] == [0, 1, 4, 4]
    assert (apart.state_name(4), apart.labels["one"][4], apart.signals["x"][4]) == ("1 ended", True, 1)
    with pytest.raises(SettingsError, match="choose merged or apart"):
        stl.from_gymnasium(again, ends="both")


def test_runs_at_the_same_time_need_an_environment_each():
    model = lake(table=False)
    first, second = (simulator(model, np.random.default_rng(i)) for i in range(2))
    first.reset()
    second.reset()
    second.step(0)
    with pytest.raises(ModelError, match="another run has reset this environment"):
        first.step(0)


def test_without_gymnasium_it_says_what_to_install(monkeypatch, floor5):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    for ask in (lambda: stl.from_gymnasium(None), lambda: stl.to_gymnasium(floor5)):
        with pytest.raises(MissingExtraError, match=r"pip install 'stltool\[gymnasium\]'"):
            ask()


# ------------------------------------------------------------------------------------------------ labels and signals


@pytest.mark.parametrize(
    "given_as",
    [
        lambda s: s in (1, 2), lambda s: np.bool_(s in (1, 2)), {1, 2}, frozenset([1, 2]), [1, 2], (2, 1), range(1, 3),
        [False, True, True], np.array([False, True, True]), np.array([1, 2]), iter([1, 2]),
    ],
)  # fmt: skip
def test_labels_are_given_in_several_ways(given_as):
    model = stl.from_gymnasium(Scripted((0, {})), {"A": given_as})
    assert model.labels["A"].tolist() == [False, True, True]


@pytest.mark.parametrize(
    ("given_as", "says"),
    [
        ([0, 1, 1], "label A lists 1 twice; to give one value per state, write True and False, not 1 and 0"),
        ([True, False], "label A has 2 Booleans; give 3 in the order of the states"),
        ({True}, "label A has 1 Booleans"),
        ([True, 2, False], "label A: True is not an observation of Scripted, which has Discrete"),
        ([0, 3], "label A: 3 is not an observation"),
        ([-1], "label A: -1 is not an observation"),
        ([1.0, 0.0, 0.0], "label A: 1.0 is not an observation"),
        ([(1,)], r"label A: \(1,\) is not an observation"),
        ("A", "label A is 'A'; give a function of an observation"),
        (3, "label A is 3; give a function"),
        ({1: True}, "label A is a dict of 1; give"),
        (lambda s: s, "label A is 0 for observation 0; return True or False"),
    ],
)
def test_labels_that_could_mean_two_things_are_refused(given_as, says):
    with pytest.raises(ModelError, match=says):
        stl.from_gymnasium(Scripted((0, {})), {"A": given_as})


def test_zero_and_one_of_two_states():
    two = Scripted((0, {}), observation_space=spaces.Discrete(2))
    with pytest.raises(ModelError, match=r"label A is \[1, 0\], which can be a list of observations or of values"):
        stl.from_gymnasium(two, {"A": [1, 0]})
    assert stl.from_gymnasium(two, {"A": {0, 1}}).labels["A"].all()
    assert stl.from_gymnasium(two, {"A": [0]}).labels["A"].tolist() == [True, False]
    assert not stl.from_gymnasium(two, {"A": []}).labels["A"].any()


def test_signals_are_numbers_of_each_state():
    env = Scripted((0, {}), observation_space=spaces.MultiDiscrete([2, 2]))
    model = stl.from_gymnasium(env, {"B": [(1, 0), [0, 1]]}, {"sum": sum, "x": [0, 1, 2, 3.5]})
    assert (model.signals["sum"].tolist(), model.signals["x"].tolist()) == ([0, 1, 1, 2], [0, 1, 2, 3.5])
    assert model.labels["B"].tolist() == [False, True, True, False]
    for wrong in ("1234", {0, 1, 2, 3}, {0: 1}, ["a"] * 4, [1j] * 4, lambda o: "x"):
        with pytest.raises(ModelError, match="signal x does not contain numbers.*; give 4 of them"):
            stl.from_gymnasium(env, signals={"x": wrong})
    with pytest.raises(ModelError, match=r"signal x has shape \(3,\); one number for each of 4 states"):
        stl.from_gymnasium(env, signals={"x": [1, 2, 3]})
    with pytest.raises(ModelError, match="1 action names for 2 actions"):
        stl.from_gymnasium(env, action_names=["go"])


# --------------------------------------------------------------------------------------------- models as environments


UNREGISTERED = "ignore:.*Not able to test alternative render modes due to the environment not having a spec"


@pytest.mark.filterwarnings(UNREGISTERED)
def test_a_model_is_an_environment(floor5):
    env = stl.to_gymnasium(floor5)
    check_env(env)
    assert (env.observation_space, env.action_space) == (spaces.Discrete(18), spaces.Discrete(9))

    def walk(seed):
        s, info = env.reset(seed=seed)
        assert info["state"] == floor5.state_name(s)
        return [s, *(env.step(a)[0] for a in [1, 7, 4, 0, 2] * 4)]

    assert walk(1) == walk(1) != walk(2)
    _, reward, terminated, truncated, info = env.step(0)
    assert (reward, terminated, truncated, info["action_mask"].tolist()) == (0.0, False, False, [1] * 9)
    with pytest.raises(ModelError, match="action 9 is not one of 0 … 8"):
        env.step(9)
    with pytest.raises(ModelError, match="call reset"):
        stl.to_gymnasium(floor5).step(0)
    with pytest.raises(SettingsError, match="choose error or stay"):
        stl.to_gymnasium(floor5, "wait")


def test_estimates_on_a_models_environment_contain_the_exact_probability(floor5):
    product = stl.build_product(floor5, stl.parse("G[0,4] (F[0,4] A & F[0,4] B)"))
    policy = stl.learn(product, episodes=60, seed=0).policy
    exact = stl.check(product, policy).probability
    assert 0.05 < exact < 0.99
    env = stl.to_gymnasium(floor5)
    labels = dict(floor5.labels)
    unknown = stl.build_product(stl.from_gymnasium(env, labels, floor5.signals), product.formula)
    assert unknown.model.blackbox is not None
    found = stl.estimate(unknown, stl.Policy(unknown, policy.table), runs=1500, seed=4)
    assert found.lower <= exact <= found.upper
    assert found.upper - found.lower < 0.08


@pytest.mark.filterwarnings(UNREGISTERED)
def test_actions_that_a_state_does_not_have():
    go, back = np.array([[0.0, 1], [0, 0]]), np.array([[0.0, 0], [1, 0]])
    model = stl.MDP.from_arrays([go, back], {}, action_names=["go", "back"])
    env = stl.to_gymnasium(model)
    assert env.reset(seed=0)[1]["action_mask"].tolist() == [1, 0]
    with pytest.raises(ModelError, match="action back is not available in state 0, which has go; follow info"):
        env.step(1)
    assert env.step(0)[0] == 1
    assert env.step(1)[0] == 0
    staying = stl.to_gymnasium(model, unavailable="stay")
    check_env(staying)
    staying.reset(seed=0)
    assert [staying.step(a)[0] for a in (1, 0, 0, 1)] == [0, 1, 1, 0]


def test_a_models_environment_goes_on_with_its_generator(floor5):
    """A reset without a seed begins another episode of the same generator."""
    env = stl.to_gymnasium(floor5)

    def episodes():
        env.reset(seed=8)
        for _ in range(3):
            yield [env.step(1)[0] for _ in range(6)]
            env.reset()

    first, second = list(episodes()), list(episodes())
    assert first == second
    assert any(first[0] != other for other in first[1:])
