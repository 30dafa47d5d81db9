"""The model-based learner's plans against backward induction over all states, memories and steps, bit for bit."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import TRUE, UNDECIDED
from stltool.checking.induction import Single
from stltool.checking.induction.anywhere import Anywhere, From
from stltool.kernels import exploring
from stltool.kernels.tuples import with_children
from stltool.learning.counts import Counts
from stltool.learning.explorer import Explorer
from stltool.learning.model_based import Planner
from stltool.learning.optimism import NEXT_TO_NOTHING, doubt, paradise, unrefuted
from stltool.learning.problem import Problem
from tests.checking.test_check import products
from tests.conftest import many


def counted(product, rng, share):
    """Some transitions of some choices, wherever they lead."""
    model = product.model
    counts = Counts(model.n_choices, model.n_states)
    tried = np.flatnonzero(rng.random(model.n_choices) < share)
    choice = np.repeat(tried, rng.integers(1, 6, size=len(tried)))
    counts.add(choice, rng.integers(model.n_states, size=len(choice)))
    return counts


def early(product):
    """With the automaton of a learner, which decides runs as soon as the letters do."""
    return dataclasses.replace(product, automaton=Problem.of(product).automaton)


def dense(product, counts, outside, since, optimistic, modest):
    """The first best choices (h, S, Q) of steps since … h−1, each sum added in order, outside last.

    outside (n_choices,) is the share of each choice that leads there; modest: which is worth no more than the best
    state to a choice that has been tried.
    """
    problem, automaton = Problem.of(product), product.automaton
    h, S, visits = automaton.horizon, problem.n_states, counts.visits
    known = {}
    for c, s, n in zip(counts.choice.tolist(), counts.target.tolist(), counts.seen.tolist(), strict=True):
        known.setdefault(c, []).append((s, n))
    values = (automaton.verdicts(h) == TRUE) * np.ones((S, 1))
    table = np.zeros(problem.shape, dtype=int)
    for t in range(h - 1, since - 1, -1):
        verdicts, new = automaton.verdicts(t), np.empty_like(values)
        worth = paradise(t, h) if optimistic else NEXT_TO_NOTHING
        for s, q in np.ndindex(values.shape):
            sums, top = [], max(values[x, product.enter(x, q)] for x in range(S))
            for c in range(problem.first_choice[s], problem.first_choice[s + 1]):
                total = 0.0
                for x, n in known.get(c, ()):
                    total += n * ((1 - outside[c]) / visits[c]) * values[x, product.enter(x, q)]
                sums.append(total + outside[c] * (min(top, worth) if modest and visits[c] else worth))
            table[t, s, q] = int(np.argmax(sums))
            new[s, q] = max(sums) if verdicts[q] == UNDECIDED else verdicts[q] == TRUE
        values = new
    return table


def shares(counts, optimism, caution):
    """Of hope, or of doubt where there is no optimism."""
    visits = counts.visits
    return unrefuted(visits, 1 / (1 + optimism)) if optimism else doubt(visits, caution)


def required(product, counts, outside, since, optimistic):
    product, problem = early(product), Problem.of(product)
    wanted, h, Q = dense(product, counts, outside, since, optimistic, True), product.horizon, product.automaton.n_states
    planner = Planner(problem, counts)
    learned = planner.learned(counts.seen.astype(np.float64), outside)
    anywhere = Anywhere(problem.automaton, problem.letter, problem.first_choice, np.uint8)
    table = anywhere.plan(
        learned, np.array([paradise(t, h) if optimistic else NEXT_TO_NOTHING for t in range(h)]), since
    )
    listed = anywhere.listed(table, np.int16)
    for t in range(since, h):
        s, q = np.divmod(anywhere.codes(t), Q)
        assert np.array_equal(table[t, s, q], wanted[t, s, q])
        assert np.array_equal(listed.at(t, s, q), wanted[t, s, q])
        assert int(np.bitwise_count(listed.words(t)[1]).sum()) == len(s)
    # only where the transitions seen lead from one of those
    if since == h or not len(anywhere.codes(since)):
        return
    wanted, planner = dense(product, counts, outside, since, optimistic, False), Planner(problem, counts, most=0)
    s, q = (int(i) for i in np.divmod(anywhere.codes(since)[-1], Q))
    if optimistic:
        plan = planner.plan_from(learned, since, s, q).form
    else:
        first = From(Single(problem.automaton.with_outcome(TRUE)), since, q)
        plan = planner._induct(learned, False, first, np.array([s]))
    reached, after = {(s, q)}, {}
    for c, target in zip(counts.choice.tolist(), counts.target.tolist(), strict=True):
        after.setdefault(int(np.searchsorted(problem.first_choice, c, side="right")) - 1, set()).add(target)
    for t in range(since, h):
        reached = {(x, m) for x, m in reached if product.automaton.verdicts(t)[m] == UNDECIDED}
        if reached:
            s, q = np.array(sorted(reached)).T
            assert np.array_equal(plan.at(t - since, s, q), wanted[t, s, q])
            assert [plan.one(t - since, *pair) for pair in sorted(reached)] == wanted[t, s, q].tolist()
        assert int(np.bitwise_count(plan.words(t - since)[1]).sum()) == len(reached)
        reached = {(y, product.enter(y, m)) for x, m in reached for y in after.get(x, ())}


@given(products(states=4), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.3, 2.0]), st.integers(0, 1), st.data())
@settings(max_examples=many(50))
def test_plans_are_those_of_all_pairs(product, seed, optimism, share, data):
    if product.horizon == 0:
        return
    counts = counted(product, np.random.default_rng(seed), 0.3 + 0.7 * share)
    outside = shares(counts, optimism, data.draw(st.sampled_from([0.0, 0.1, 2.0])))
    since = data.draw(st.integers(0, product.horizon))
    required(product, counts, outside, since, optimism > 0)


@pytest.mark.parametrize("optimistic", [True, False])
def test_more_memory_than_a_word_holds(optimistic):
    model = stl.MDP.from_arrays([np.eye(3)] * 2, {}, labels={"a": [1, 0, 0], "b": [0, 1, 0]}, initial=0)
    product = stl.build_product(model, stl.parse("G[0,4] (F[0,11] a & F[0,11] b)"))
    assert product.automaton.n_states > 64
    counts = counted(product, np.random.default_rng(5), 0.7)
    outside = shares(counts, 0.3 * optimistic, 0.1)
    required(product, counts, outside, product.horizon - 12, optimistic)


@given(products(states=4))
@settings(max_examples=many(40))
def test_wherever_a_run_can_be_is_planned_for(product):
    """F_t has whatever a run reaches."""
    automaton, n = product.automaton, product.automaton.n_states
    first = np.arange(product.model.n_states + 1)
    anywhere = Anywhere(automaton, product.letter, first, np.uint8)
    pairs = {(s, product.enter(s, automaton.initial)) for s in range(product.model.n_states)}
    for t in range(product.horizon):
        pairs = {(s, q) for s, q in pairs if automaton.verdicts(t)[q] == UNDECIDED}
        assert set(anywhere.codes(t).tolist()) == {s * n + q for s, q in pairs}
        pairs = {(x, product.enter(x, q)) for _, q in pairs for x in range(product.model.n_states)}


def ahead(product, values, unseen, t, q, s):
    """What is hoped for in s, if it is entered with memory q after step t, though not by a transition seen."""
    letter, m = product.letter[s], product.enter(s, q)
    verdict = product.automaton.verdicts(t + 1)[m]
    if verdict != UNDECIDED:
        return float(verdict == TRUE)
    return max(paradise(t + 1, product.horizon) * (letter in unseen), values.get((s, m), 0.0))


def explored(product, counts, level, since, s, q):
    """By (t, s, q) that transitions lead to from there: the first best choice, −2 if nothing is hoped for there."""
    h, first = product.horizon, Problem.of(product).first_choice
    known, visits = {}, counts.visits
    for c, x, n in zip(counts.choice.tolist(), counts.target.tolist(), counts.seen.tolist(), strict=True):
        known.setdefault(c, []).append((x, n))
    after = {
        x: {y for c in range(first[x], first[x + 1]) for y, _ in known.get(c, ())} for x in range(len(product.letter))
    }
    seen = {x for x, to in after.items() if to} | {y for to in after.values() for y in to}
    unseen = {letter for x, letter in enumerate(product.letter) if x not in seen}
    layers = [{(s, q)}]
    for t in range(since, h):
        layers[-1] = {(x, m) for x, m in layers[-1] if product.automaton.verdicts(t)[m] == UNDECIDED}
        layers.append({(y, product.enter(y, m)) for x, m in layers[-1] for y in after[x]})
    values, found = {}, {}
    for t in range(h - 1, since - 1, -1):
        verdicts, new = product.automaton.verdicts(t + 1), {}
        for x, m in layers[t - since]:
            worth = paradise(t, h)
            top = min(worth, max(ahead(product, values, unseen, t, m, y) for y in range(len(product.letter))))
            sums = []
            for c in range(first[x], first[x + 1]):
                hope = 1.0 - math.exp(level / visits[c]) if visits[c] else 1.0
                share, total = (1.0 - hope) / max(visits[c], 1), 0.0
                for y, n in known.get(c, ()):
                    to = product.enter(y, m)
                    value = float(verdicts[to] == TRUE) if verdicts[to] != UNDECIDED else values[y, to]
                    total += n * share * value
                sums.append(total + hope * (top if visits[c] else worth))
            new[x, m] = max(sums)
            found[t, x, m] = int(np.argmax(sums)) if new[x, m] > 0 else -2
        values = new
    return found


def route_found(explorer, since):
    """A plan's choices by (t, s, q)."""
    route, found = explorer.route, {}
    for t, x in np.argwhere(route.group[since:] >= 0).tolist():
        g = route.group[since + t, x]
        for i in range(route.first[g], route.first[g + 1]):
            found[since + t, x, int(route.memory[i])] = int(route.choice[i])
    return found


def planned(explorer, level, since, s, q):
    """The plan from there, by (t, s, q), with every transition's frequency as it was counted."""
    explorer._make_room(1)
    explorer.walked.weight[:] = explorer.walked.seen
    explorer.route.level[0] = level
    while not exploring.plan(*explorer._all, since, s, q):
        explorer.chart = with_children(explorer.chart)
    return route_found(explorer, since)


@given(products(states=4), st.integers(0, 2**32 - 1), st.sampled_from([0.0, -1e-9, -0.5, -3.0, -700.0]), st.data())
@settings(max_examples=many(60))
def test_what_transitions_lead_to_is_planned_for(product, seed, level, data):
    product, rng = early(product), np.random.default_rng(seed)
    problem, counts = Problem.of(product), counted(product, rng, rng.random())
    if product.horizon == 0:
        return
    since = data.draw(st.integers(0, product.horizon - 1))
    anywhere = Anywhere(problem.automaton, problem.letter, problem.first_choice, np.uint8)
    if not len(anywhere.codes(since)):
        return
    s, q = divmod(int(data.draw(st.sampled_from(anywhere.codes(since).tolist()))), product.automaton.n_states)
    explorer = Explorer(problem, counts)
    for _ in range(3):  # later plans find what the first one left behind
        assert planned(explorer, level, since, s, q) == explored(product, counts, level, since, s, q)
        c, x = int(rng.integers(counts.n_choices)), int(rng.integers(counts.n_states))
        exploring.count(explorer.walked, explorer.route, c, x, 1.0)
        counts.add([c], [x])
        explorer.walked.known[:] = Explorer(problem, counts).walked.known


@pytest.mark.parametrize("n_actions", [1, 4, 9, 17, 40])
@pytest.mark.parametrize("seed", range(4))
def test_what_is_hoped_for_does_not_depend_on_the_order_of_states(seed, n_actions):
    """Many states with few letters, and more choices than a block has."""
    rng = np.random.default_rng(seed)
    rows = rng.random((n_actions, 12, 12)) * (rng.random((n_actions, 12, 12)) < 0.2) + 1e-3
    letter = rng.permutation(12) % 4
    labels = {"a": letter % 2 == 1, "b": letter // 2 == 1}
    model = stl.MDP.from_arrays(rows / rows.sum(axis=2, keepdims=True), {}, labels=labels, initial=0)
    product = early(stl.build_product(model, stl.parse("F[0,5) G[0,3) a & G[0,4) F[0,4) b")))
    counts = counted(product, rng, 0.9)
    explorer, q = Explorer(Problem.of(product), counts), product.enter(0, product.automaton.initial)
    for level in (-0.1, -3.0):
        assert planned(explorer, level, 0, 0, q) == explored(product, counts, level, 0, 0, q)
