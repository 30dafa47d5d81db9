"""The model-based learner's plans against backward induction over all states, memories and steps, bit for bit."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import FALSE, TRUE, UNDECIDED
from stltool.checking.induction import Single
from stltool.checking.induction.anywhere import Anywhere, From
from stltool.learning.counts import Counts
from stltool.learning.model_based import Planner
from stltool.learning.optimism import doubt, paradise, unrefuted
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
        worth = paradise(t, h) if optimistic else 0.0
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
    table = anywhere.plan(learned, np.array([paradise(t, h) if optimistic else 0.0 for t in range(h)]), since)
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
        first = From(Single(problem.automaton.with_outcome(FALSE)), since, q)
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
