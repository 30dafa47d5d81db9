"""`long_run` against the enumeration of policies that know the last states, exact chains, Storm, and runs."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.checking.averages import Game, _steps, exact_average, greatest_average
from stltool.checking.long_run import QUESTIONS, Forever
from stltool.errors import ModelError, PolicyError, SettingsError, SizeError
from stltool.models import save_model
from stltool.testing import mdps, policies
from tests import endless
from tests.conftest import PATROLLING, many

SMALL = 1e-9
TASKS = st.sampled_from(
    (
        "A", "F[0,1] A", "G[0,1] A", "F[1,1] A", "F[0,2] (A & B)", "A -> F[1,2] B", "A until[0,2] B",
        "A <-> F[1,1] A", "F[0,1] A & F[0,1] B",
    )
).map(stl.parse)  # fmt: skip
models = mdps(labels=("A", "B"), signals=(), exact=True)


def agrees(found, truth):
    """Whether an enclosure contains the truth, and is narrow."""
    return Fraction(found.lower) <= truth <= Fraction(found.upper) and found.upper - found.lower < SMALL


@given(models, TASKS)
@settings(max_examples=many(40))
def test_optima_are_those_of_all_policies(model, phi):
    """Of policies that know the last h + 1 states, one by one; and the policy found is worth what was promised."""
    worth = endless.values(model, phi)
    assume(worth is not None)
    worth = list(worth)
    forever = Forever(stl.build_product(model, phi, "running"))
    for asked in QUESTIONS:
        for maximize in (True, False):
            truth = (max if maximize else min)(one[asked] for one in worth)
            exactly, found = forever.ask(asked, maximize, exact=True), forever.ask(asked, maximize)
            assert exactly.fraction == truth
            assert agrees(exactly, truth)
            assert agrees(found, truth)
            assert endless.of_policy(exactly.product, exactly.policy)[asked] == truth
            assert abs(endless.of_policy(found.product, found.policy)[asked] - truth) < SMALL


@given(st.data(), models, TASKS)
@settings(max_examples=many(40))
def test_a_policys_values_are_those_of_its_chain(data, model, phi):
    product = stl.build_product(model, phi, data.draw(st.sampled_from(["exact", "running"])))
    policy = data.draw(policies(product).filter(lambda one: one.stationary))
    for asked in QUESTIONS:
        found = stl.long_run(product, asked, policy)
        exactly = stl.long_run(product, asked, policy, exact=True, maximize=False)  # of one policy, all the same
        truth = endless.of_policy(*policy.on(found.product))[asked]
        assert exactly.fraction == truth
        assert agrees(found, truth)
        assert (found.question, found.policy) == ("policy", policy)


# ------------------------------------------------------------------------------------------- worked out by hand


def chain(rows, **labels):
    return stl.MDP.from_arrays([rows], {}, labels=labels)


def all_of(model, text, **options):
    product = stl.build_product(model, stl.parse(text), "running")
    found = [stl.long_run(product, asked, **options) for asked in QUESTIONS]
    return [(one.lower, one.upper) for one in found]


def test_a_clock_is_as_certain_as_it_is_periodic():
    """Of the windows [t, t+1] of a cycle of 3 states two contain the first one; a longer one always does."""
    cycle = chain([[0, 1, 0], [0, 0, 1], [1, 0, 0]], A=[1, 0, 0])
    (share, *others) = all_of(cycle, "F[0,1] A")
    assert agrees_with(share, Fraction(2, 3))
    assert others == [(0, 0), (1, 1), (0, 0)]
    assert all_of(cycle, "F[0,2] A") == [(1, 1)] * 4
    least, *others = all_of(cycle, "F[0,1] A", maximize=False)  # without choices, the same
    assert agrees_with(least, Fraction(2, 3))
    assert others == [(0, 0), (1, 1), (0, 0)]


def test_the_best_part_of_a_component_is_reached_and_kept():
    """A long way round, on which a policy may turn back: the run goes to the last state, where A holds, and stays; or
    it goes and comes back for ever."""
    n = 6
    forth, back = np.zeros((n, n)), np.zeros((n, n))
    for s in range(n):
        forth[s, min(s + 1, n - 1)] = back[s, max(s - 1, 0)] = 1
    labels = {"A": np.arange(n) == n - 1, "B": np.isin(np.arange(n), [0, 2])}
    model = stl.MDP.from_arrays([back, forth], {}, labels=labels)
    assert all_of(model, "A") == [(1, 1), (0, 0), (1, 1), (1, 1)]
    assert all_of(model, "A", maximize=False) == [(0, 0)] * 4
    assert all_of(model, "!B") == [(1, 1), (0, 0), (1, 1), (1, 1)]
    swings = stl.long_run(stl.build_product(model, stl.parse("B & F[1,1] !B")), exact=True)
    assert swings.fraction == Fraction(1, 2)
    assert endless.of_policy(swings.product, swings.policy)["share"] == Fraction(1, 2)


def test_components_are_left_for_better_ones():
    """A state to stay in, and one to visit from there, which has a gamble: A for ever with probability 1/4, B for ever
    otherwise. Going to and fro for ever shows A at every other step."""
    rows = np.zeros((2, 4, 4), dtype=object)
    rows[0, 0, 0] = rows[0, 1, 0] = rows[0, 2, 2] = rows[0, 3, 3] = rows[1, 0, 1] = 1
    rows[1, 1, 2], rows[1, 1, 3] = Fraction(1, 4), Fraction(3, 4)
    model = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 1, 1, 0], "B": [0, 0, 0, 1]})
    found = {asked: stl.long_run(stl.build_product(model, stl.parse("A")), asked, exact=True) for asked in QUESTIONS}
    assert [one.fraction for one in found.values()] == [Fraction(1, 2), 0, 1, Fraction(1, 4)]
    best = stl.long_run(stl.build_product(model, stl.parse("B")), exact=True)
    assert best.fraction == Fraction(3, 4)
    for asked, one in (*found.items(), ("share", best)):
        assert endless.of_policy(one.product, one.policy)[asked] == one.fraction
    least = stl.long_run(stl.build_product(model, stl.parse("B")), "recurrence", maximize=False, exact=True)
    assert least.fraction == 0


def agrees_with(bounds, truth):
    return Fraction(bounds[0]) <= truth <= Fraction(bounds[1]) and bounds[1] - bounds[0] < 1e-12


def test_what_is_kept_once_is_kept_for_ever():
    """The run is absorbed where A holds with probability 1/3, after one step in which it does not."""
    model = chain([["0", "1/3", "2/3"], [0, 1, 0], [0, 0, 1]], A=[0, 1, 0])
    share, always, recurrence, persistence = all_of(model, "A")
    assert always == (0, 0)
    for bounds in (share, recurrence, persistence, all_of(model, "F[0,1] A")[1]):
        assert agrees_with(bounds, Fraction(1, 3))


def test_renewal_of_a_machine():
    """It works until it breaks, with probability 1/10 a step, and is repaired with probability 1/2: it works in 5/6 of
    the steps. Of windows of 3 steps from t on, one without any work needs two failing repairs: 1/6 · 1/4."""
    machine = chain([["9/10", "1/10"], ["1/2", "1/2"]], works=[1, 0])
    product = stl.build_product(machine, stl.parse("F[0,2] works"))
    assert stl.long_run(product, exact=True).fraction == 1 - Fraction(1, 6) * Fraction(1, 4)
    assert stl.long_run(stl.build_product(machine, stl.parse("works")), exact=True).fraction == Fraction(5, 6)
    assert [stl.long_run(product, asked).value for asked in QUESTIONS[1:]] == [0, 1, 0]


def test_least_and_greatest_may_need_memory():
    """Of three steps some are in A, some in B and two neighbours in the same: A A B B …; a policy of the state alone
    stays somewhere for ever, or alternates."""
    rows = [[[1, 0], [0, 1]], [[0, 1], [1, 0]]]
    model = stl.MDP.from_arrays(rows, {}, labels={"A": [1, 0], "B": [0, 1]}, action_names=["stay", "go"])
    text = "F[0,2] A & F[0,2] B & ((A <-> F[1,1] A) | (F[1,1] A <-> F[2,2] A))"
    product = stl.build_product(model, stl.parse(text))
    best = stl.long_run(product, exact=True)
    tables = [np.tile(np.array(pair)[:, None], best.product.shape[1]) for pair in np.ndindex(2, 2)]
    stays = [stl.long_run(product, policy=stl.Policy(best.product, table)) for table in tables]
    assert best.fraction == 1
    assert [one.upper for one in stays] == [0] * 4


def test_rare_exits_widen_the_enclosure_and_fractions_do_not_mind():
    """1/10¹² of leaving towards A, twice as much towards nothing."""
    rare = Fraction(1, 10**12)
    rows = [[[1 - 3 * rare, rare, 2 * rare], [0, 1, 0], [0, 0, 1]]]
    model = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 1, 0]})
    product = stl.build_product(model, stl.parse("F[0,1] A"), "running")
    found = stl.long_run(product)
    assert stl.long_run(product, exact=True).fraction == Fraction(1, 3)
    assert Fraction(found.lower) <= Fraction(1, 3) <= Fraction(found.upper)
    assert found.upper - found.lower < 0.01


def test_rows_of_doubles_that_miss_1_widen_the_enclosure():
    rows = np.array([[[0.9 + 4e-10, 0.1], [0.5, 0.5]]])
    product = stl.build_product(stl.MDP.from_arrays(rows, {}, labels={"A": [1, 0]}), stl.parse("A"))
    found = stl.long_run(product)
    assert found.lower <= 5 / 6 <= found.upper
    assert 1e-10 < found.upper - found.lower < 1e-7
    with pytest.raises(ModelError, match="so there is no exact answer"):
        stl.long_run(product, exact=True)


def test_steps_to_the_end_are_at_least_what_they_are_made_of():
    """y >= 1 + A y, in fractions, whatever gets what rows may lack."""
    from scipy.sparse import csr_array

    rows = np.array([[0.1, 0.3, 0.2], [0.7, 0.1, 0.0], [0.0, 1 / 3, 0.6], [0.2, 0.2, 0.3]])
    game = Game(csr_array(rows), np.array([0, 2, 3, 4]), 3, 1e-9)
    found = _steps(game, np.array([0, 2, 3]))
    exact = [Fraction(value) for value in found.tolist()]
    for row, owner in zip(rows.tolist(), game.owner.tolist(), strict=True):
        most = sum(Fraction(p) * y for p, y in zip(row, exact, strict=True)) + Fraction(game.defect) * max(exact)
        assert exact[owner] >= 1 + most


def test_averages_of_a_slow_and_periodic_component():
    """Value iteration alone would take millions of sweeps: a ring of 300 states, with a choice to wait."""
    from scipy.sparse import csr_array

    n = 300
    rows = [[((i + 1) % n, 1.0)] if k == 0 else [(i, 1 - 1e-6), ((i + 1) % n, 1e-6)] for i in range(n) for k in (0, 1)]
    data = [(c, j, p) for c, row in enumerate(rows) for j, p in row]
    matrix = csr_array(([p for *_, p in data], ([c for c, *_ in data], [j for _, j, _ in data])), shape=(2 * n, n))
    reward = np.zeros(n)
    reward[7] = 1.0
    lower, upper, picks = greatest_average(Game(matrix, np.arange(0, 2 * n + 1, 2), 2, 0.0), reward)
    truth = 1e6 / (1e6 + n - 1)  # waiting at the reward
    assert lower <= truth <= upper
    assert upper - lower < 1e-6
    assert picks[7] % 2 == 1


def test_policies_of_several_classes_are_led_to_their_best(monkeypatch):
    """Policy iteration alone, from the policy that stays wherever it is, ends with the one that goes to the reward."""
    from scipy.sparse import csr_array

    monkeypatch.setattr("stltool.checking.averages._SWEEPS", 1)
    n, good = 7, 4
    rows = [[[(i, Fraction(1))], [((i + 1) % n, Fraction(1))]] for i in range(n)]
    target = [row[0][0] for choices in rows for row in choices]
    matrix = csr_array((np.ones(2 * n), (np.arange(2 * n), target)), shape=(2 * n, n))
    reward = (np.arange(n) == good).astype(float)
    lower, upper, picks = greatest_average(Game(matrix, np.arange(0, 2 * n + 1, 2), 1, 0.0), reward)
    assert (lower <= 1, upper) == (True, 1)
    assert lower > 1 - 1e-12
    wanted = [int(i != good) for i in range(n)]
    assert (picks - np.arange(0, 2 * n, 2)).tolist() == wanted
    assert exact_average(rows, [Fraction(int(r)) for r in reward], [0] * n) == (1, wanted)


# ------------------------------------------------------------------------------------------- larger, and others


def test_patrolling_for_ever(floor5):
    """Windows are violated again and again, but hardly ever; the best policy shows it in a run."""
    task = stl.load_task(PATROLLING, params={"T": 5, "tau": 5})
    forever = Forever(stl.build_product(floor5, task, "running"))
    best = forever.ask("share")
    assert best.upper - best.lower < 1e-11
    assert best.lower > stl.check(stl.build_product(floor5, task)).upper  # of the first window alone, from a cold start
    again = stl.long_run(forever.given, policy=best.policy)
    assert again.lower <= best.upper
    assert best.upper - again.lower < 1e-9
    assert [forever.ask(asked).value for asked in QUESTIONS[1:]] == [0, 1, 0]
    assert [forever.ask(asked, maximize=False).value for asked in QUESTIONS] == [0] * 4
    share = endless.simulated(floor5, best.product, best.policy, 20_000, np.random.default_rng(0))
    assert abs(share - best.value) < 0.05  # some 8 standard deviations of independent windows


@given(mdps(labels=("A", "B"), signals=(), exact=True, single_start=True), TASKS)
@settings(max_examples=many(20))
def test_storm_agrees(tmp_path_factory, model, phi):
    """On the graph of the running product, written as a model of its own: questions of Storm's, long-run averages
    among them."""
    stormpy = pytest.importorskip("stormpy", reason="outside judge absent: stormpy (pip install stltool[peers])")
    forever = Forever(stl.build_product(model, phi, "running"))
    path = tmp_path_factory.mktemp("storm") / "endless.drn"
    asked_of = {
        "share": 'LRA{}=? ["good"]', "always": 'P{}=? [G "good"]', "recurrence": 'P{}=? [G F "good"]',
        "persistence": 'P{}=? [F G "good"]',
    }  # fmt: skip
    for asked, template in asked_of.items():
        _, graph, _ = forever.safe if asked == "always" else forever.running
        if not graph.satisfied.any():  # a label of no state is not written
            continue
        rows = np.zeros((int(np.diff(graph.choice_start).max()), graph.n, graph.n), dtype=object)
        for i in range(graph.n):
            for k, row in enumerate(graph.exactly(np.arange(graph.choice_start[i], graph.choice_start[i + 1]))):
                for j, p in row:
                    rows[k, i, j] += p
        save_model(stl.MDP.from_arrays(rows, {}, int(graph.first[0]), {"good": graph.satisfied}), path)
        built = stormpy.build_model_from_drn[float](str(path))
        for maximize in (True, False):
            (question,) = stormpy.parse_properties(template.format("max" if maximize else "min"))
            answer = stormpy.model_checking(built, question, only_initial_states=True)
            theirs = answer.get_value(built.initial_states[0])
            assert forever.ask(asked, maximize).value == pytest.approx(theirs, abs=1e-5)


# --------------------------------------------------------------------------------------------------- policies


def test_policies_are_saved_and_judged_again(tmp_path, floor5):
    task = stl.load_task(PATROLLING, params={"T": 5, "tau": 5})
    product = stl.build_product(floor5, task)
    best = stl.long_run(product)
    best.policy.save(tmp_path / "ever.npz")
    again = stl.long_run(product, policy=stl.load_policy(tmp_path / "ever.npz", product))
    assert again.lower <= best.upper
    assert best.upper - again.lower < 1e-9
    first = [stl.check(one, best.policy) for one in (product, best.product)]  # of the first window
    assert abs(first[0].probability - first[1].probability) < 1e-12


def test_policies_that_end_are_refused(floor5):
    product = stl.build_product(floor5, stl.load_task(PATROLLING, params={"T": 5, "tau": 5}))
    with pytest.raises(PolicyError, match="depends on the step and ends after 8 steps"):
        stl.long_run(product, policy=stl.check(product).policy)
    joint = stl.build_joint_product(floor5, {"A": stl.parse("F[0,3] A"), "B": stl.parse("F[0,3] B")})
    table = np.zeros(joint.shape, dtype=int)
    with pytest.raises(PolicyError, match="depends on the step"):
        stl.long_run(joint.tasks[0], policy=stl.Policy(joint, table))


def test_policies_without_an_action_are_refused(floor5):
    product = stl.build_product(floor5, stl.parse("F[0,3] A"), "running")
    with pytest.raises(PolicyError, match="defines no action at state .*; give it an action there"):
        stl.long_run(product, policy=stl.Policy(product, np.full(product.shape, -1)))


def test_what_cannot_be_asked(floor5):
    product = stl.build_product(floor5, stl.parse("F[0,3] A"))
    with pytest.raises(SettingsError, match="asked is 'often'; choose share, always, recurrence or persistence"):
        stl.long_run(product, "often")
    with pytest.raises(SizeError, match="a graph of .* successors that runs can reach"):
        stl.long_run(stl.build_product(floor5, stl.parse("F[0,3] A"), "running"), memory_limit=20_000)
