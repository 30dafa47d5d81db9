"""The running automaton judges every step of every trace, and has as few states as can tell them apart."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata.minimise import coarsest_partition
from stltool.automata.running import satisfied_in
from stltool.errors import InexactEncodingWarning, SizeError
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
    assert judge(automaton, trace) == (wanted[0], h)


@settings(max_examples=many(100))
@given(
    formulas(LABELS, (), longest=3, max_leaves=3, horizon=4) | formulas(LABELS, (), longest=2, past=True, horizon=3),
    st.integers(0, 2**32 - 1),
)
def test_safety_fails_once_and_for_ever(phi, seed):
    """Not before the first start whose window fails, and at the latest when its window ends."""
    with pytest.warns(InexactEncodingWarning, match="judges .* at every step, not only at the first"):
        automaton = stl.compile_automaton(phi, "safety")
    if not automaton.atoms:
        return
    h, rng = stl.horizon(phi), np.random.default_rng(seed)
    trace = {name: rng.random(h + 12) < rng.choice([0.3, 0.6, 0.9]) for name in LABELS}
    wanted = [stl.satisfies(phi, trace, t) for t in range(12)]
    found = verdicts(automaton, trace)
    for t in range(12):
        assert found[t] or not all(wanted[: t + 1])
        assert not found[t + h] or all(wanted[: t + 1])
    assert (np.diff(found.astype(int)) <= 0).all()


def test_states_say_which_windows_are_open_or_lost():
    automaton = stl.compile_automaton(stl.parse("G[0,3] a"), "running")
    told = {automaton.describe(q) for q in range(automaton.n_states)}
    first = "the window that began 3 steps ago is violated"
    assert told == {
        "the window that began 3 steps ago is satisfied; 3 are open, of which the oldest began 2 steps ago: a so far",
        f"{first}; 3 are open, of which the oldest began 2 steps ago: a so far",
        f"{first}; 1 later one, too, since 2 steps ago, will be violated; "
        "2 are open, of which the oldest began 1 step ago: a so far",
        f"{first}; 2 later ones, too, since 2 steps ago, will be violated; "
        "1 is open, of which the oldest began 0 steps ago: a so far",
        f"{first}; 3 later ones, too, since 2 steps ago, will be violated",
    }


@pytest.mark.parametrize(
    ("text", "states"),
    [
        ("a", 2), ("G[0,30] a", 2), ("F[0,3] a", 5), ("G[0,4] (F[0,4] a & F[0,4] b)", 26), ("once[0,3] a", 5),
        ("a -> F[1,2] b", 4),
    ],
)  # fmt: skip
def test_safety_remembers_what_is_open(text, states):
    """Worked out by hand: the steps since a, up to 3, and failure; a pair of such; the steps since an a without b."""
    with pytest.warns(InexactEncodingWarning):
        assert stl.compile_automaton(stl.parse(text), "safety").n_states == states


@pytest.mark.parametrize(
    ("text", "states"),
    [
        ("a", 2), ("F[2,2] a", 2), ("F[0,3] a", 5), ("G[0,3] a", 5), ("a & F[1,1] a", 3), ("once[0,3] a", 5),
        ("prev a", 4),
    ],
)  # fmt: skip
def test_there_are_no_more_states_than_needed(text, states):
    """Worked out by hand. F[0,3] a remembers how long ago a was, up to 4 steps, and G[0,3] a how long ago it was not;
    F[2,2] a only its last value."""
    automaton = stl.compile_automaton(stl.parse(text), "running")
    classes = coarsest_partition(automaton.delta, satisfied_in(automaton).astype(np.int8))
    assert len(set(classes.tolist())) == automaton.n_states
    assert automaton.n_states == states


def test_states_are_told_in_words():
    automaton = stl.compile_automaton(stl.parse("F[0,2] a"), "running")
    told = set(automaton.state_names)
    assert "the window that began 2 steps ago is violated; 2 are open, of which the oldest began 1 step ago: " in str(
        sorted(told)
    )


def test_what_is_too_large_is_refused():
    with pytest.raises(SizeError, match="running automaton of .* grows over 200 states: it follows every window"):
        stl.compile_automaton(stl.parse("G[0,9] (F[0,9] a & F[0,9] b)"), "running", most_states=200)
    with pytest.raises(SizeError, match="follows 1000000001 starts"):
        stl.compile_automaton(stl.parse("F[0,1000000000] a"), "running")
    with pytest.raises(SizeError, match="running automaton of .*, over 225 states of 20 ages, would take"):
        stl.compile_automaton(stl.parse("G[0,9] (F[0,9] a & F[0,9] b)"), "running", memory_limit=50_000)
