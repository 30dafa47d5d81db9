"""Verdicts as early as can be, against every sequence of letters."""

import itertools

import numpy as np
import pytest
from hypothesis import given

import stltool as stl
from stltool.automata import FALSE, TRUE, UNDECIDED, reachable
from stltool.automata.reachable import decided_early
from tests.checking.test_check import products


@given(products(longest=3))
def test_a_run_is_decided_as_soon_as_its_verdict_is_certain(product):
    automaton, letters = product.automaton, np.unique(product.letter).tolist()
    early = decided_early(automaton, product.letter)
    n = automaton.horizon + 1
    truth = {word: automaton.judge(word)[0] for word in itertools.product(letters, repeat=n)}
    for length in range(1, n + 1):
        for prefix in itertools.product(letters, repeat=length):
            ends = {truth[prefix + rest] for rest in itertools.product(letters, repeat=n - length)}
            q = automaton.initial
            for letter in prefix:
                q = int(automaton.delta[letter, q])
            verdict = UNDECIDED if len(ends) == 2 else TRUE if ends == {True} else FALSE
            if automaton.judge(prefix) is None:  # once decided, the state no longer counts
                assert early.verdicts(length - 1)[q] == verdict


def test_what_can_no_longer_begin_is_lost():
    """F[0,9] G[0,9] A: after step 8 outside A, step 9 is still to come, the last start; after step 9, all is lost."""
    model = stl.MDP.from_arrays([np.eye(2)], {}, labels={"A": [True, False]})
    product = stl.build_product(model, stl.parse("F[0,9] G[0,9] A"))
    early, outside = decided_early(product.automaton, product.letter), product.enter(1, product.automaton.initial)
    assert [early.verdicts(t)[outside] for t in (8, 9, 17)] == [UNDECIDED, FALSE, FALSE]
    assert product.automaton.verdicts(17)[outside] == UNDECIDED
    never = decided_early(product.automaton, product.letter[1:])  # if there is no A
    assert never.verdicts(0)[outside] == FALSE


def test_long_windows_cost_their_states_and_large_automata_stay_as_they_are(monkeypatch):
    model = stl.MDP.from_arrays([np.eye(2)], {}, labels={"A": [True, False]})
    product = stl.build_product(model, stl.parse("F[0,1000000] A"))
    early = decided_early(product.automaton, product.letter)
    assert len(early.verdict_starts) <= 2
    monkeypatch.setattr(reachable, "_MOST_VERDICTS", 1000)
    assert decided_early(product.automaton, product.letter) is product.automaton


@pytest.mark.parametrize("horizon", [5, 1_000_000])
def test_verdicts_are_total_at_the_horizon(horizon):
    model = stl.MDP.from_arrays([np.eye(2)], {}, labels={"A": [True, False]})
    product = stl.build_product(model, stl.parse(f"G[0,{horizon}] A"))
    early = decided_early(product.automaton, product.letter)
    assert (early.verdicts(horizon) != UNDECIDED).all()
