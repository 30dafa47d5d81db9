"""The running automaton judges every step of every trace, and has as few states as can tell them apart."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata.minimise import coarsest_partition
from stltool.automata.running import satisfied_in
from stltool.errors import SizeError
from stltool.monitoring.states import truth
from stltool.testing import formulas
from tests.automata.judging import judge
from tests.conftest import many

LABELS = ("a", "b")


def verdicts(automaton, trace):
    """What the automaton says after each letter, (n,) bool."""
    n = len(trace["a"])
    values = np.stack([truth(psi, {}, trace, n) for psi in automaton.atoms], axis=1)
    q, found = automaton.initial, []
    for letter in automaton.letters_at(values).tolist():
        q = int(automaton.delta[letter, q])
        found.append(satisfied_in(automaton)[q])
    return np.array(found)


@settings(max_examples=many(100))
@given(
    formulas(LABELS, (), longest=3, max_leaves=4, horizon=5) | formulas(LABELS, (), longest=2, past=True, horizon=4),
    st.integers(0, 2**32 - 1),
)
def test_every_step_is_judged(phi, seed):
    automaton, h = stl.compile_automaton(phi, "running"), stl.horizon(phi)
    if not automaton.atoms:
        return
    rng = np.random.default_rng(seed)
    trace = {name: rng.random(h + 12) < rng.choice([0.3, 0.5, 0.8]) for name in LABELS}
    wanted = [stl.satisfies(phi, trace, t) for t in range(12)]
    found = verdicts(automaton, trace)
    assert found[h:].tolist() == wanted
    assert found[:h].all()  # of starts before step 0
    assert judge(automaton, trace) == (wanted[0], h)


@pytest.mark.parametrize(
    ("text", "states"),
    [
        ("a", 2), ("F[2,2] a", 4), ("F[0,3] a", 5), ("G[0,3] a", 14), ("a & F[1,1] a", 5), ("once[0,3] a", 5),
        ("prev a", 4),
    ],
)  # fmt: skip
def test_there_are_no_more_states_than_needed(text, states):
    """Worked out by hand. F[0,3] a remembers how long ago a was, up to 4 steps. G[0,3] a remembers how long ago it was
    not, d = 0 … 3 steps, and of how many starts up to then the verdict is still to come, 1 … 4 − d; or it was not not
    since the beginning, 0 … 3 steps ago."""
    automaton = stl.compile_automaton(stl.parse(text), "running")
    classes = coarsest_partition(automaton.delta, satisfied_in(automaton).astype(np.int8))
    assert len(set(classes.tolist())) == automaton.n_states
    assert automaton.n_states == states


def test_states_are_told_in_words():
    automaton = stl.compile_automaton(stl.parse("F[0,2] a"), "running")
    told = set(automaton.state_names)
    assert "the window that began 2 steps ago is violated; 2 are open, of which the oldest began 1 steps ago: " in str(
        sorted(told)
    )


def test_what_is_too_large_is_refused():
    with pytest.raises(SizeError, match="running automaton of .* grows over 200 states: it follows every window"):
        stl.compile_automaton(stl.parse("G[0,9] (F[0,9] a & F[0,9] b)"), "running", most_states=200)
    with pytest.raises(SizeError, match="follows 1000000001 starts"):
        stl.compile_automaton(stl.parse("F[0,1000000000] a"), "running")
    with pytest.raises(SizeError, match="running automaton of .*, over 285 states of 20 ages, would take"):
        stl.compile_automaton(stl.parse("G[0,9] (F[0,9] a & F[0,9] b)"), "running", memory_limit=50_000)
