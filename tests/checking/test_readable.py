"""Trees in place of policies: the text is the policy, its P is exact, and it is as good as was asked for."""

import re
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.checking.readable import Node, Question, _Features, _Situations, _together, _Tree
from stltool.errors import PolicyError, SettingsError, SizeError
from stltool.reporting.figures import leaves_curve
from stltool.reporting.trees import tree_data
from tests import oracles
from tests.conftest import many
from tests.reporting.svg import Picture

TASKS = ["F[0,3] A", "G[0,2) F[0,2) A", "A U[0,3] B", "F[0,2] (A & F[0,2] B)", "(F[0,2] A) & (G[0,1] F[0,1] B)"]


def random_policy(product, rng):
    counts = np.diff(product.model.choice_start)
    return stl.Policy(product, rng.integers(0, counts[:, None], (product.horizon, *product.shape)))


def followed(tree):
    """The policy that a reader of the printed rules follows, who knows what the names in brackets count."""
    product = tree.product
    called = {formula: name for name, formula in product.definitions.items()}
    tracks = {f"[{t.name}]": t.level_of for t in product.automaton.tracks(lambda phi: called.get(phi, str(phi)))}
    lines = tree.rules.splitlines()

    def value(here, name):
        if " - " in name:
            one, other = name.split(" - ")
            return value(here, one) - value(here, other)
        if name == "steps_left":
            return here.to_go
        return tracks[name][here.memory] if name in tracks else here.signals[name]

    def holds(here, condition):
        found = re.fullmatch(r"(.*) (<=|>=|<|>) (\S+)", condition)
        if found is None:
            name = condition.removeprefix("!")
            return (name in here.labels) != condition.startswith("!")
        left, right = value(here, found[1]), float(found[3])
        return {"<=": left <= right, ">": left > right, "<": left < right, ">=": left >= right}[found[2]]

    def act(here):
        i, indent = 0, 0
        while True:
            line = lines[i]
            if ":" not in line:
                return line.strip()
            condition, _, action = line.strip().rpartition(":")
            deep = len(line) - len(line.lstrip())
            if deep == indent and holds(here, condition):
                if action:
                    return action.strip()
                indent += 4
            i += 1

    return stl.Policy.from_function(product, act)


@given(st.integers(0, 2**32 - 1), st.sampled_from(TASKS), st.booleans())
@settings(max_examples=many(8))
def test_the_rules_are_the_policy_and_p_is_theirs(seed, text, optimal):
    rng = np.random.default_rng(seed)
    product = stl.build_product(oracles.random_model(rng, 5), stl.parse(text))
    policy = None if optimal else random_policy(product, rng)
    tree = stl.policy_tree(product, policy, price=0.05)
    assert tree.met
    assert tree.given.probability == (stl.check(product, policy) if policy else stl.check(product)).probability
    assert tree.check.probability >= tree.given.probability - 0.05 - 1e-12
    reader = followed(tree)
    assert stl.check(product, reader).probability == pytest.approx(tree.check.probability, abs=1e-12)
    exact = stl.check(product, tree.policy, exact=True).fraction
    assert Fraction(tree.check.lower) <= exact <= Fraction(tree.check.upper)
    assert tree.leaves == sum(1 for line in tree.rules.splitlines() if not line.endswith(":"))
    sizes, values = zip(*tree.curve, strict=True)
    assert list(sizes) == sorted(set(sizes))
    assert list(values) == sorted(set(values))
    assert (tree.leaves, pytest.approx(tree.check.probability, abs=1e-12)) in tree.curve or tree.leaves > sizes[-1] - 1


@given(st.integers(0, 2**32 - 1), st.sampled_from(TASKS))
@settings(max_examples=many(20))
def test_its_arrays_are_the_product(seed, text):
    """P, visits and Q of any policy, against the checker and a walk over all runs."""
    rng = np.random.default_rng(seed)
    product = stl.build_product(oracles.random_model(rng, 5), stl.parse(text))
    policy = random_policy(product, rng)
    found = _Situations(product, policy, None)
    p, v, q = found.values(found.given)
    assert p == pytest.approx(stl.check(product, policy).probability, abs=1e-12)
    assert found.values(np.full(len(found), -1))[0] == pytest.approx(stl.check(product).probability, abs=1e-12)
    visits = found.visits(found.given)
    place = {
        (t, s, q): i for i, (t, s, q) in enumerate(zip(*(x.tolist() for x in (found.t, found.s, found.q)), strict=True))
    }
    here = {}
    for s in np.flatnonzero(product.model.initial).tolist():
        key = (s, product.enter(s, product.automaton.initial))
        here[key] = here.get(key, 0.0) + product.model.initial[s]
    for t in range(product.horizon):
        after = {}
        for (s, m), share in here.items():
            if product.automaton.verdicts(t)[m] != UNDECIDED:
                continue
            i = place[t, s, m]
            assert visits[i] == pytest.approx(share, abs=1e-12)
            visits[i] = 0
            c = product.model.choice_start[s] + found.given[i]
            for k in range(product.model.row_start[c], product.model.row_start[c + 1]):
                key = (int(product.model.target[k]), product.enter(int(product.model.target[k]), m))
                after[key] = after.get(key, 0.0) + share * product.model.probability[k]
        here = after
    assert abs(visits).max(initial=0) < 1e-12
    taken = found.by_action(q, -1.0)
    action = [
        product.model.choice_action[product.model.choice_start[s] + c]
        for s, c in zip(found.s, found.given, strict=True)
    ]
    assert taken[np.arange(len(found)), action] == pytest.approx(v, abs=1e-12)


def test_patrolling_in_a_few_leaves(patrolling):
    calls = []
    tree = stl.policy_tree(patrolling, progress=lambda done, total: calls.append((done, total)))
    assert tree.met
    assert tree.leaves <= 12
    assert calls[0] == (4, 200)
    told = "\n".join(tree.legend)
    assert "[at_B]: 0 nothing pending, 1 at_B not seen for 1 step" in told
    for name, value in re.findall(r"(\[\w+\]) <= (\d+)", tree.rules):  # what a condition asks is told on both sides
        for k in (int(value), int(value) + 1):
            assert f"{k} {tree.memory[name][k]}" in told
    assert len(repr(tree).splitlines()) <= 3


def test_where_few_leaves_do_not_suffice_it_says_so(patrolling):
    tree = stl.policy_tree(patrolling, price=1e-6, most_leaves=3)
    assert not tree.met
    assert tree.leaves <= 3


def test_a_tree_of_one_leaf_takes_one_action(patrolling):
    tree = stl.policy_tree(patrolling, price=1e-6, most_leaves=1)
    assert (tree.leaves, tree.met, len(tree.curve)) == (1, False, 1)


def test_a_task_that_the_first_state_decides(floor5):
    product = stl.build_product(floor5, stl.parse("!A"))
    tree = stl.policy_tree(product)
    assert (tree.check.probability, tree.leaves) == (1, 1)


@pytest.mark.parametrize(("actions", "leaves"), [("abcd", 4), ("abab", 2), ("aabc", 3), ("aaaa", 1), ("abba", 4)])
def test_equal_parts_of_a_tree_are_counted_once(actions, leaves):
    """Of two questions below the first, which ask the same."""
    nothing = np.empty(0, np.int64)
    left, right = np.array([1, 3, 5, -1, -1, -1, -1]), np.array([2, 4, 6, -1, -1, -1, -1])
    action = np.array([0, 0, 0, *map(ord, actions)])
    tree = _Tree(left, right, np.zeros(7, np.int64), np.zeros(7), action, nothing, nothing, 0.5)
    assert tree.leaves == leaves


def test_a_tree_may_ask_for_signals_labels_and_what_the_memory_counts():
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0.5, 0.5]]], {"x": [0, 1]}, labels={"a": [0, 1], "b": [1, 0]})
    for text, counts in (("G[0,3] (F[0,2] a & F[0,2] b)", ["[a]", "[b]", "[a] - [b]"]), ("F[0,3] a", ["[F[0,3] a]"])):
        asked = _Features(stl.build_product(model, stl.parse(text)))
        assert asked.names == ["x", "a", "b", *counts, "steps_left"]


def test_a_question_that_makes_no_difference_is_not_asked():
    asked = Question("x < 2", "x >= 2")
    one, other = (Node(share, None, asked, Node(share / 2, "N"), Node(share / 2, "E")) for share in (0.4, 0.6))
    both = _together(one, other)
    assert list(both.lines()) == list(one.lines())
    assert (both.share, both.yes.share, both.no.action) == (1.0, 0.5, "E")


def test_the_curve_is_drawn_as_it_is(patrolling):
    tree = stl.policy_tree(patrolling, price=1e-6, most_leaves=5)
    picture = Picture(leaves_curve(tree_data(tree), "svg"))
    (panel,) = picture.panels
    (drawn,) = panel.shapes("curve")
    expected = [(leaves, tree.given.probability - p) for leaves, p in tree.curve]
    assert drawn == pytest.approx(np.array(expected), rel=0.02)
    assert panel.levels("price") == pytest.approx([1e-6], rel=0.02)


def test_what_it_refuses(patrolling, floor5):
    with pytest.raises(SettingsError, match="price is 0.0; give a number between 0 and 1"):
        stl.policy_tree(patrolling, price=0.0)
    shape = (*patrolling.shape, patrolling.model.most_choices)
    mixed = stl.Policy(patrolling, np.full(shape, 1 / patrolling.model.most_choices))
    with pytest.raises(SettingsError, match="needs a deterministic policy"):
        stl.policy_tree(patrolling, mixed)
    with pytest.raises(SizeError, match="take more memory than is available; shorten the windows"):
        stl.policy_tree(patrolling, stl.check(patrolling).policy, memory_limit=10_000)
    with pytest.raises(PolicyError, match="defines no action"):
        stl.policy_tree(patrolling, stl.Policy(patrolling, np.full(patrolling.shape, -1)))
