"""P from every situation under a policy, against the checker started there."""

import numpy as np
import pytest

import stltool as stl
from stltool.automata import TRUE, UNDECIDED
from stltool.checking.situations import NO_ACTION, Situations, policy_numbers, reachable
from stltool.errors import SizeError
from tests.conftest import many
from tests.reporting.test_twin import random_product


def brute(product, policy, t, s, q):
    """P from (t, s, q) by the definition, one path after another."""
    verdict = product.automaton.verdicts(t)[q]
    if verdict != UNDECIDED:
        return float(verdict == TRUE)
    return after(product, policy, t, s, q, int(policy.at(t, s, q)[0]))


def after(product, policy, t, s, q, i):
    model = product.model
    c = model.choice_start[s] + i
    entries = range(model.row_start[c], model.row_start[c + 1])
    targets = [(model.probability[k], int(model.target[k])) for k in entries if model.probability[k] > 0]
    return sum(p * brute(product, policy, t + 1, u, product.enter(u, q)) for p, u in targets)


@pytest.mark.parametrize("seed", range(many(6)))
def test_values_and_choices_are_those_of_the_definition(seed):
    rng = np.random.default_rng(seed)
    product = random_product(rng, n=4)
    policy = stl.check(product).policy
    here = Situations(product, policy)
    some = [
        (t, *divmod(code, product.automaton.n_states)) for t, codes in enumerate(here.nodes) for code in codes.tolist()
    ]
    late = [node for node in some if node[0] >= product.horizon - 3]
    for t, s, q in late:
        assert here.known(t, s, q)
        assert here.value(t, s, q) == pytest.approx(brute(product, policy, t, s, q), abs=1e-14)
        wanted = [after(product, policy, t, s, q, i) for i in range(len(here.choices(t, s, q)))]
        assert here.choices(t, s, q) == pytest.approx(wanted, abs=1e-14)
        assert here.weights(t, s, q).sum() == 1


def test_the_first_values_add_up_to_the_probability(patrolling):
    for policy in (stl.check(patrolling).policy, stl.learn(patrolling, "cfer", episodes=20, seed=0).policy):
        here, automaton = Situations(patrolling, policy), patrolling.automaton
        first = np.flatnonzero(patrolling.model.initial).tolist()
        total = sum(
            patrolling.model.initial[s] * here.value(0, s, patrolling.enter(s, automaton.initial)) for s in first
        )
        assert total == pytest.approx(stl.check(patrolling, policy).probability, abs=1e-14)


@pytest.mark.parametrize("mixed", [False, True])
def test_a_function_has_no_action_where_its_runs_do_not_come(mixed):
    """It goes to A at once, where all is decided; the other choice goes to another state, which leads there."""
    transitions = np.array([[[0, 1, 0], [0, 1, 0], [0, 1, 0]], [[0, 0, 1], [0, 1, 0], [0, 0, 1]]], dtype=float)
    model = stl.MDP.from_arrays(transitions, {}, labels={"A": np.array([False, True, False])})
    product = stl.build_product(model, stl.parse("F[0,3] A"))
    policy = stl.Policy.from_function(product, lambda here: [1.0, 0.0] if mixed else 0, mixed=mixed)
    nodes = reachable(product)
    assert len(nodes) > 1
    assert min(map(len, nodes)) > 0
    numbers, mixtures = policy_numbers(product, policy, nodes)
    assert numbers.tolist() == [0] * len(nodes[0]) + [NO_ACTION] * sum(map(len, nodes[1:]))
    assert mixtures.shape == (0, 2)


def test_what_is_reached_is_counted_before_it_is_kept(patrolling, monkeypatch):
    assert reachable(patrolling, most_nodes=10) is None
    assert reachable(patrolling, most_edges=10) is None
    nodes = reachable(patrolling)
    numbers, mixtures = policy_numbers(patrolling, stl.check(patrolling).policy, nodes)
    assert len(numbers) == sum(map(len, nodes))
    assert mixtures.shape == (0, 9)
    monkeypatch.setattr("stltool.checking.situations.reachable", lambda product: None)
    with pytest.raises(SizeError, match="shorten the windows"):
        Situations(patrolling, stl.check(patrolling).policy)
