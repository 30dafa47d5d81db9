"""The explorer's engine, a twin of the checker in JavaScript, against the checker: in node, where there is one."""

import itertools
import json
import shutil
import subprocess
from functools import partial

import numpy as np
import pytest

import stltool as stl
from stltool.checking.situations import Situations, policy_numbers, reachable
from stltool.reporting.explorer import _array, _fitting, automaton_data, explorer_data
from tests.conftest import FACTORY, ROOT, many

ENGINE = ROOT / "stltool" / "reporting" / "templates" / "engine.js"
pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="the engine runs in node, which is absent")


def run_twin(product, policy, edits=(), file=None, maximize=True, judge=stl.check):
    """The explorer's data of a policy, and what the engine makes of it."""
    checked = judge(product, policy, maximize=maximize)
    data = explorer_data(product, checked, judge(product, maximize=maximize), None, False)
    assert "refused" not in data
    home, _ = policy.on(product)
    return checked, data, in_node(home, data, edits, file)


def in_node(product, data, edits, file=None):
    automaton = automaton_data(product.automaton)
    given = {"explorer": data, "automaton": automaton, "edits": list(edits), "file": str(file or "")}
    command = ["node", ROOT / "tests" / "reporting" / "twin.js", ENGINE]
    done = subprocess.run(command, input=json.dumps(given), capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def random_product(rng, n=6):
    """A model with states of one to three choices, some of whose transitions have probability 0, and a task on it."""
    rows = rng.dirichlet(np.full(n, 0.4), size=(3, n))
    rows[rows < 0.05] = 0
    rows /= rows.sum(axis=2, keepdims=True)
    available = rng.random((3, n)) < 0.7
    available[0] = True
    labels = {name: rng.random(n) < 0.35 for name in "ab"}
    initial = rng.dirichlet(np.ones(n))
    rows[~available] = 0  # a row of zeros: the action is not available
    model = stl.MDP.from_arrays(rows, {}, labels=labels, initial=initial)
    text = rng.choice(["G[0,3] F[0,3] a", "F[0,6] (a & F[1,2] b)", "!a U[1,6] b", "F[0,4] G[0,2] a | G[0,5] !b"])
    return stl.build_product(model, stl.parse(str(text)))


def random_edits(product, rng, count):
    nodes = np.concatenate(reachable(product))
    if not len(nodes):
        return []
    chosen = rng.integers(len(nodes), size=count)
    sizes = np.diff(product.model.choice_start)[nodes[chosen] // product.automaton.n_states]
    return [(int(n), int(rng.integers(size))) for n, size in zip(chosen, sizes, strict=True)]


def edited(product, policy, edits):
    """The same edits made in Python, as a dense table by step."""
    nodes = reachable(product)
    numbers, _ = policy_numbers(product, policy, nodes)
    for n, i in edits:
        numbers[n] = i
    table = np.full((product.horizon, *product.shape), -1)
    step = np.repeat(np.arange(len(nodes)), [len(layer) for layer in nodes])
    table[step, *np.divmod(np.concatenate(nodes), product.automaton.n_states)] = numbers
    return stl.Policy(product, table)


@pytest.mark.parametrize("seed", range(many(6)))
def test_edits_have_the_probability_that_the_checker_finds(tmp_path, seed):
    rng = np.random.default_rng(seed)
    product = random_product(rng)
    policy = stl.check(product).policy
    edits, file = random_edits(product, rng, 20), tmp_path / "edited.npz"
    checked, data, found = run_twin(product, policy, edits, file)
    assert (found["nodes"], found["checksum"]) == (data["claim"]["nodes"], data["claim"]["checksum"])
    assert found["probability"] == pytest.approx(checked.probability, abs=1e-12)
    assert found["optimum"] == pytest.approx(data["claim"]["optimum"], abs=1e-12)
    assert found["undone"] == found["probability"]  # bit for bit
    if not edits:
        return
    exported = stl.load_policy(file, product)
    judged = stl.check(product, exported).probability
    assert found["edited"][-1] == pytest.approx(judged, abs=1e-12)
    assert judged == pytest.approx(stl.check(product, edited(product, policy, edits)).probability, abs=1e-12)


def test_the_factorys_policy_value_for_value(patrolling, tmp_path):
    learned = stl.learn(patrolling, "cfer", episodes=40, seed=1).policy
    rng = np.random.default_rng(0)
    edits, file = random_edits(patrolling, rng, 20), tmp_path / "edited.npz"
    checked, _, found = run_twin(patrolling, learned, edits, file)
    assert found["probability"] == pytest.approx(checked.probability, abs=1e-12)
    judged = stl.check(patrolling, stl.load_policy(file, patrolling)).probability
    assert found["edited"][-1] == pytest.approx(judged, abs=1e-12)
    here = Situations(patrolling, learned)
    step = np.repeat(np.arange(len(here.nodes)), list(map(len, here.nodes))).tolist()
    pairs = [divmod(code, patrolling.automaton.n_states) for code in np.concatenate(here.nodes).tolist()]
    values = [here.value(t, s, q) for t, (s, q) in zip(step, pairs, strict=True)]
    assert found["values"] == pytest.approx(values, abs=1e-15)
    [worst] = stl.likely_runs(patrolling, learned, count=1).runs
    assert found["worst"]["p"] == pytest.approx(worst.probability, rel=1e-9)
    assert tuple(step[0] for step in found["worst"]["steps"]) == worst.states
    [best] = stl.likely_runs(patrolling, learned, count=1, satisfied=True).runs
    assert found["best"]["p"] == pytest.approx(best.probability, rel=1e-9)


@pytest.mark.parametrize("stationary", [True, False])
def test_mixed_policies_keep_their_mixtures(patrolling, tmp_path, stationary):
    rng = np.random.default_rng(3)
    steps = () if stationary else (patrolling.horizon,)
    weights = rng.dirichlet(np.full(9, 0.3), size=(*steps, *patrolling.shape))
    weights[..., 0, :] = np.eye(9)[4]  # some take one action for certain
    policy = stl.Policy(patrolling, weights)
    edits, file = random_edits(patrolling, rng, 5), tmp_path / "edited.npz"
    checked, data, found = run_twin(patrolling, policy, edits, file)
    assert found["probability"] == pytest.approx(checked.probability, abs=1e-12)
    exported = stl.load_policy(file, patrolling)
    assert not exported.deterministic
    assert found["edited"][-1] == pytest.approx(stl.check(patrolling, exported).probability, abs=1e-12)
    [worst] = stl.likely_runs(patrolling, policy, count=1).runs
    assert found["worst"]["p"] == pytest.approx(worst.probability, rel=1e-9)
    assert data["arrays"]["mixtures"][1]


def test_a_policy_without_an_action_somewhere_has_no_value_there(patrolling, tmp_path):
    """The optimal policy, silent where no run under it comes: P is known, until an edit leads there."""
    best = stl.check(patrolling).policy
    nodes = reachable(patrolling)
    _, _, found = run_twin(patrolling, best)
    unreached = np.flatnonzero(np.array(found["visits"]) == 0)
    table = edited(patrolling, best, []).table.copy()
    step = np.repeat(np.arange(len(nodes)), [len(layer) for layer in nodes])
    s, q = np.divmod(np.concatenate(nodes), patrolling.automaton.n_states)
    table[step[unreached], s[unreached], q[unreached]] = -1
    silent = stl.Policy(patrolling, table)
    rng = np.random.default_rng(0)
    start = [(0, i) for i in range(9)]
    checked, _, found = run_twin(patrolling, silent, [*start, *random_edits(patrolling, rng, 3)], tmp_path / "e.npz")
    assert found["probability"] == pytest.approx(checked.probability, abs=1e-12)
    assert [found["values"][n] is None for n in unreached] == [True] * len(unreached)
    assert None in found["edited"]  # another first action leads where the policy takes none
    assert found["undone"] == found["probability"]
    stl.load_policy(tmp_path / "e.npz", patrolling)


def test_the_worst_policy_is_explored_against_the_least_probability(patrolling):
    worst = stl.check(patrolling, maximize=False)
    _, data, found = run_twin(patrolling, worst.policy, maximize=False)
    assert data["claim"]["maximize"] is False
    assert found["optimum"] == pytest.approx(worst.probability, abs=1e-12)


def widened(product, rng):
    """The model with intervals around its probabilities, some of which begin at 0."""
    model = product.model
    below, above = rng.uniform(0, 0.3, size=(2, model.n_transitions))
    lower, upper = np.maximum(model.probability - below, 0), np.minimum(model.probability + above, 1)
    shape, entries = (model.n_states, model.n_states), []
    choices = [(s, i) for s in range(model.n_states) for i in range(model.choice_start[s + 1] - model.choice_start[s])]
    for c, (s, i) in enumerate(choices):
        rows = slice(model.row_start[c], model.row_start[c + 1])
        entries += [(i, s, u, a, b) for u, a, b in zip(model.target[rows], lower[rows], upper[rows], strict=True)]
    ends = np.zeros((2, 3, *shape))
    for i, s, u, a, b in entries:
        ends[:, i, s, u] = a, b
    made = stl.MDP.from_intervals(*ends, {}, labels=model.labels, initial=model.initial)
    return stl.build_product(made, product.formula)


@pytest.mark.parametrize("nature", ["against", "with"])
@pytest.mark.parametrize("maximize", [True, False])
@pytest.mark.parametrize("seed", range(many(3)))
def test_nature_picks_as_in_the_robust_check_also_after_edits(tmp_path, seed, maximize, nature):
    rng = np.random.default_rng(seed)
    product = widened(random_product(rng), rng)
    judge = partial(stl.robust_check, nature=nature)
    policy = judge(product, maximize=maximize).policy
    edits, file = random_edits(product, rng, 12), tmp_path / "edited.npz"
    checked, data, found = run_twin(product, policy, edits, file, maximize, judge)
    assert data["nature"] == {"minimal": maximize == (nature == "against")}
    assert (found["nodes"], found["checksum"]) == (data["claim"]["nodes"], data["claim"]["checksum"])
    assert found["probability"] == pytest.approx(checked.probability, abs=1e-12)
    assert found["optimum"] == pytest.approx(checked.probability, abs=1e-12)
    assert found["undone"] == found["probability"]
    if edits:
        judged = judge(product, stl.load_policy(file, product), maximize=maximize)
        assert found["edited"][-1] == pytest.approx(judged.probability, abs=1e-12)


def test_mixed_policies_under_nature(patrolling, tmp_path):
    """On the rough floor, whose rows have up to nine successors; nature knows which choice a mixture has taken."""
    product = stl.build_product(stl.load_model(FACTORY / "floor-5x5-uncertain.toml"), patrolling.formula)
    rng = np.random.default_rng(5)
    policy = stl.Policy(product, rng.dirichlet(np.full(9, 0.3), size=product.shape))
    edits, file = random_edits(product, rng, 5), tmp_path / "edited.npz"
    checked, _, found = run_twin(product, policy, edits, file, judge=stl.robust_check)
    assert found["probability"] == pytest.approx(checked.probability, abs=1e-12)
    judged = stl.robust_check(product, stl.load_policy(file, product))
    assert found["edited"][-1] == pytest.approx(judged.probability, abs=1e-12)


@pytest.mark.parametrize("seed", range(many(3)))
def test_transitions_of_probability_0_lead_nowhere(seed):
    """Models drop them when they are made, so they are put into the page's data: one more in every row, to a state that
    no run comes to."""
    rng = np.random.default_rng(seed)
    rows = rng.dirichlet(np.ones(4), size=(2, 5))
    rows = np.concatenate([rows, np.zeros((2, 5, 1))], axis=2)
    labels = {"a": rng.random(5) < 0.4, "b": rng.random(5) < 0.4}
    model = stl.MDP.from_arrays(rows, {}, labels=labels)
    product = stl.build_product(model, stl.parse("G[0,3] F[0,2] (a | b)"))
    policy = stl.check(product).policy
    edits = random_edits(product, rng, 12)
    _, data, found = run_twin(product, policy, edits)
    at = np.array([rng.integers(a, b + 1) for a, b in itertools.pairwise(model.row_start.tolist())])
    arrays = data["arrays"]
    arrays["row_start"] = _fitting(model.row_start + np.arange(model.n_choices + 1))
    arrays["target"] = _fitting(np.insert(model.target, at, 4))
    values, index = np.unique(np.insert(model.probability, at, 0.0), return_inverse=True)
    arrays["values"], arrays["value"] = _array(values, "f8"), _fitting(index)
    again = in_node(product, data, edits)
    assert set(again) == set(found)
    for name in ("nodes", "checksum", "probability", "values", "optimum", "visits", "edited", "undone"):
        assert again[name] == found[name]
    for name in ("best", "worst"):
        assert (again[name] and again[name]["p"]) == (found[name] and found[name]["p"])


@pytest.mark.parametrize("mixed", [False, True])
def test_of_many_situations_those_of_the_policy_are_explored(tmp_path, monkeypatch, patrolling, mixed):
    """Their values and runs are those of all; an edit among them has its exact P, one that leads elsewhere has none."""
    rng = np.random.default_rng(0)
    policy = stl.check(patrolling).policy
    if mixed:
        table = np.eye(9)[policy.table]
        table[..., 4, :] = rng.dirichlet(np.full(9, 0.3), size=table.shape[:-2])
        policy = stl.Policy(patrolling, table)
    _, _, whole = run_twin(patrolling, policy)
    codes = np.concatenate(reachable(patrolling))
    monkeypatch.setattr("stltool.checking.situations.reachable", lambda product: None)
    checked, data, found = run_twin(patrolling, policy)
    assert (data["whole"], data["claim"]["optimum"]) == (False, None)
    assert found["nodes"] == data["claim"]["nodes"] < len(codes)
    assert found["checksum"] == data["claim"]["checksum"]
    assert found["probability"] == pytest.approx(checked.probability, abs=1e-12)
    there = [p for p in whole["visits"] if p > 0]
    assert found["visits"] == pytest.approx(there, rel=1e-12)
    assert found["values"] == pytest.approx([v for v, p in zip(whole["values"], whole["visits"], strict=True) if p > 0])
    assert found["worst"] == whole["worst"]
    with pytest.raises(stl.StlToolError, match="more than"):
        Situations(patrolling, policy)
    first = run_twin(patrolling, policy, [(0, i) for i in range(9)])[2]["edited"]  # another first action
    assert None in first
    monkeypatch.undo()
    for i in [i for i, p in enumerate(first) if p is not None and not mixed]:
        judged = stl.check(patrolling, edited(patrolling, policy, [(0, i)]))
        assert first[i] == pytest.approx(judged.probability, abs=1e-12)


def test_a_policy_with_its_own_memory_is_explored_and_not_exported(patrolling, flagged):
    policy = stl.Policy(flagged, stl.check(flagged).policy.table)
    checked, data, found = run_twin(patrolling, policy)
    assert found["probability"] == pytest.approx(checked.probability, abs=1e-12)
    assert data["header"] is None
    assert "remembers more" in data["no_export"]


def test_a_joint_policy_is_explored_with_all_that_it_remembers(floor5, monkeypatch):
    tasks = [stl.load_task(FACTORY / "tradeoff.stl", params={"T": 2, "tau": 5}, task=name)
             for name in ("charging", "patrolling")]  # fmt: skip
    joint = stl.build_joint_product(floor5, tasks)
    policy = stl.tradeoff(joint, objective="patrolling", at_least={"charging": 0}).policy
    checked, data, found = run_twin(joint.tasks[1], policy)
    assert found["probability"] == pytest.approx(checked.probability, abs=1e-12)
    assert data["header"] is None
    monkeypatch.setattr("stltool.reporting.explorer._MOST_MEMORIES", 10)
    refused = explorer_data(joint.tasks[1], checked, None, None, False)
    assert "too many to choose among" in refused["refused"]


def test_a_function_is_asked_only_where_its_runs_come(patrolling):
    asked = set()

    def stay(situation):
        asked.add((situation.step, situation.state, situation.memory))
        return "stay" if situation.step else "NE"

    policy = stl.Policy.from_function(patrolling, stay)
    stl.check(patrolling, policy)
    before = len(asked)
    checked, _, found = run_twin(patrolling, policy)
    assert len(asked) == before
    assert found["probability"] == pytest.approx(checked.probability, abs=1e-12)
