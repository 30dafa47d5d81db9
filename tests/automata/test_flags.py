"""The specification: the first decided verdict equals the truth of the formula at 0, for every trace."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.errors import FragmentError, InexactEncodingWarning, SettingsError, SizeError
from stltool.logic.predicates import truth
from stltool.testing import flag_formulas, traces


def judge(automaton, trace):
    """The automaton's verdict on a trace, its letters read off the atoms' truth."""
    n = len(next(iter(trace.values())))
    labels = {name: trace[name] for name in ("a", "b", "c")}
    signals = {name: trace[name] for name in ("x", "y")}
    valuations = np.stack([truth(psi, signals, labels, (n,)) for psi in automaton.atoms], axis=1)
    index = {tuple(row): i for i, row in enumerate(automaton.letters.tolist())}
    return automaton.judge([index[tuple(row)] for row in valuations.tolist()])


@given(phi=flag_formulas(), data=st.data())
def test_verdict_equals_the_slow_semantics(phi, data):
    automaton = stl.compile_automaton(phi)
    assert automaton.exact
    assert automaton.horizon == stl.horizon(phi)
    trace = data.draw(traces(stl.horizon(phi) + 1))
    verdict = judge(automaton, trace)
    assert verdict is not None
    assert verdict[0] == stl.satisfies(phi, trace)


@given(flag_formulas())
def test_every_verdict_has_fallen_at_the_horizon(phi):
    automaton = stl.compile_automaton(phi)
    assert (automaton.verdicts(automaton.horizon) != UNDECIDED).all()
    assert automaton.n_states == np.prod([part.tau + 1 for part in stl.check_fragment(phi).parts])


@given(phi=flag_formulas(), data=st.data())
def test_live_states_are_those_that_some_undecided_run_visits(phi, data):
    automaton = stl.compile_automaton(phi)
    live = automaton.live()
    q = automaton.initial
    for t in range(automaton.horizon):
        q = int(automaton.delta[data.draw(st.integers(0, automaton.n_letters - 1)), q])
        if automaton.verdicts(t)[q] != UNDECIDED:
            return
        assert live[t, q]


def test_the_papers_flags_are_not_the_formula_when_windows_differ():
    """The example of semantics.md §2: b always true, a at step 3 only."""
    phi = stl.parse("F[0,3) (F[0,2) a & G[0,4) b)")
    with pytest.warns(InexactEncodingWarning, match="approximation"):
        automaton = stl.compile_automaton(phi, "paper")
    assert not automaton.exact
    n = stl.horizon(phi) + 1
    zeros = np.zeros(n)
    wrong = []
    for code in range(2**n):
        a = np.array([code >> t & 1 for t in range(n)], dtype=bool)
        trace = {"a": a, "b": np.ones(n, dtype=bool), "c": zeros.astype(bool), "x": zeros, "y": zeros}
        verdict = judge(automaton, trace)
        assert verdict is not None
        if verdict[0] != stl.satisfies(phi, trace):
            wrong.append(stl.satisfies(phi, trace))
    assert set(wrong) == {True, False}  # it errs both ways


def test_exact_refuses_what_the_flags_would_get_wrong():
    with pytest.raises(FragmentError) as caught:
        stl.compile_automaton(stl.parse("F[0,3) (F[0,2) a & G[0,4) b)"))
    message = str(caught.value)
    assert "line 1, column 9" in message
    assert "F[0,2) a, G[0,4) b" in message
    assert "use encoding paper" in message


def test_sizes_are_refused_before_memory_is_taken():
    with pytest.raises(SizeError, match=r"1000000001 × 1000000001"):
        stl.compile_automaton(stl.parse("G[0,10^9) (F[0,10^9) a & F[0,10^9) b)"))
    many = " | ".join(f"F[0,1] l{i}" for i in range(20))
    with pytest.raises(SizeError, match="20 different predicates"):
        stl.compile_automaton(stl.parse(many))
    with pytest.raises(SettingsError, match="no encoding 'fast'; choose one of"):
        stl.compile_automaton(stl.parse("F[0,1] a"), "fast")


def test_states_are_told_by_their_flags():
    automaton = stl.compile_automaton(stl.parse("G[0,5) (F[0,5) A & F[0,5) B)"))
    assert automaton.describe(6 * 2 + 5) == "flag of F[0,5) A: 2, flag of F[0,5) B: 5"
    assert automaton.digest() == stl.compile_automaton(automaton.formula).digest()
    assert automaton.digest() != stl.compile_automaton(stl.parse("G[0,5) (F[0,5) A & F[0,5) C)")).digest()
