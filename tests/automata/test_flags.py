"""The paper's flags: exact when all inner windows are equal, wrong both ways when they are not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.automata.compare import disagreement, with_formula
from stltool.errors import FragmentError, InexactEncodingWarning, SettingsError, SizeError
from stltool.reporting.data import disagreement_data
from stltool.testing import flag_formulas, traces
from tests.automata.judging import every_trace, judge, judge_all, truth_of_all

SEMANTICS_EXAMPLE = "F[0,3) (F[0,2) a & G[0,4) b)"  # docs/semantics.md §2


@given(phi=flag_formulas(), data=st.data())
def test_equal_windows_are_exact(phi, data):
    automaton = stl.compile_automaton(phi, "paper")
    assert automaton.exact
    assert automaton.horizon == stl.horizon(phi)
    assert (automaton.verdicts(automaton.horizon) != UNDECIDED).all()
    assert automaton.n_states == np.prod([part.tau + 1 for part in stl.check_fragment(phi).parts])
    trace = data.draw(traces(stl.horizon(phi) + 1))
    assert judge(automaton, trace)[0] == stl.satisfies(phi, trace)


def test_flags_of_always_count_every_step():
    for text in ("F[0,1] G[0,3] a", "G[0,1] F[0,3] a", "F[0,1] (G[0,2] a & G[0,2] b)"):
        phi = stl.parse(text)
        everything = every_trace(stl.horizon(phi) + 1)
        assert (judge_all(stl.compile_automaton(phi, "paper"), everything) == truth_of_all(phi, everything)).all()


def test_a_flag_counts_up_to_its_window():
    parts = paper("G[0,3] (F[0,2] a & F[0,4] b)").parts
    assert [(str(part.obligation), part.delay, part.explored, part.states) for part in parts] == [
        ("a", 2, 4, 4), ("b", 4, 6, 6),
    ]  # fmt: skip


def paper(text):
    with pytest.warns(InexactEncodingWarning, match="only approximates"):
        return stl.compile_automaton(stl.parse(text), "paper")


def test_different_windows_are_wrong_both_ways():
    automaton = paper(SEMANTICS_EXAMPLE)
    assert not automaton.exact
    everything = every_trace(6)
    said, true = judge_all(automaton, everything), truth_of_all(automaton.formula, everything)
    assert (said & ~true).any()
    assert (~said & true).any()
    only_at_3 = {"a": np.arange(6) == 3, "b": np.ones(6, dtype=bool)}
    assert stl.satisfies(automaton.formula, only_at_3)


def test_the_shortest_disagreement_is_one_and_shortest():
    automaton = paper(SEMANTICS_EXAMPLE)
    found = disagreement_data(with_formula(automaton))
    n = automaton.horizon + 1
    trace = {name: np.array([step[name] for step in found["steps"]] + [False] * n)[:n] for name in ("a", "b")}
    assert stl.satisfies(automaton.formula, trace) == found["formula_is"] != found["encoding_says"]
    assert judge(automaton, trace)[0] == found["encoding_says"]
    # no shorter prefix decides both, differently, on any trace
    everything = every_trace(n)
    exact = stl.compile_automaton(automaton.formula)
    shortest = n
    for i in range(len(everything["a"])):
        one = {name: values[i] for name, values in everything.items()}
        (v, t), (w, u) = judge(automaton, one), judge(exact, one)
        if v != w:
            shortest = min(shortest, max(t, u) + 1)
    assert len(found["steps"]) == shortest


def test_disagreements_are_of_labels_not_of_predicates():
    """`a & b` cannot hold without `a`: the trace is told by labels, so it can happen."""
    found = with_formula(paper("G[0,3] (F[0,2] (a & b) & F[0,4] a)"))
    assert all({str(leaf) for leaf in step} == {"a", "b"} for step in found.steps)


def test_a_search_too_large_is_given_up_in_words(monkeypatch):
    monkeypatch.setattr("stltool.automata.compare._MOST_VISITED", 50_000)
    with pytest.raises(SizeError, match="no disagreement searched for: over 50000 pairs of states would have to"):
        with_formula(paper("G[0,20] ((F[0,6] a & G[0,7] b) | (F[0,5] c & F[0,8] d))"))


def test_equal_automata_do_not_disagree():
    phi = stl.parse("G[0,4) (F[0,3) a & F[0,3) b)")
    flags, exact = stl.compile_automaton(phi, "paper"), stl.compile_automaton(phi)
    symbols = exact.valuations
    assert disagreement(flags, exact, flags.letters_at(symbols), exact.letters_at(symbols)) is None
    assert with_formula(flags) is None


def test_automata_of_other_horizons_are_compared_to_the_end_of_the_longer():
    short, long = (stl.compile_automaton(stl.parse(text)) for text in ("F[0,1] a", "F[0,3] a"))
    for left, right in ((short, long), (long, short)):
        letters = [automaton.letters_at(short.valuations) for automaton in (left, right)]
        found = disagreement(left, right, *letters)
        assert short.valuations[found].tolist() == [[False], [False], [True]]


def test_outside_the_fragment_the_paper_has_no_encoding():
    with pytest.raises(FragmentError, match="use the exact encoding"):
        stl.compile_automaton(stl.parse("G[0,5] F[0,3] G[0,2] a"), "paper")


def test_sizes_are_refused_before_memory_is_taken():
    with pytest.raises(SizeError, match=r"1000000001 × 1000000001"):
        stl.compile_automaton(stl.parse("G[0,10^9) (F[0,10^9) a & F[0,10^9) b)"), "paper")
    with pytest.raises(SettingsError, match="encoding is 'fast'; choose exact, paper, history, running or safety"):
        stl.compile_automaton(stl.parse("F[0,1] a"), "fast")


def test_states_are_told_by_their_flags():
    automaton = stl.compile_automaton(stl.parse("G[0,5) (F[0,5) A & G[0,5) B)"), "paper")
    assert automaton.describe(6 * 2 + 5) == "A seen 3 steps ago; B for 5 steps"
    assert automaton.describe(6 * 5) == "A seen now; B does not hold"
    assert automaton.describe(1) == "A not seen in 5 steps; B for 1 step"
    assert automaton.digest() == stl.compile_automaton(automaton.formula, "paper").digest()
    assert automaton.digest() != stl.compile_automaton(automaton.formula).digest()


@pytest.mark.filterwarnings("ignore::stltool.errors.InexactEncodingWarning")
def test_only_valuations_that_occur_are_compared():
    """x > 2 without x > 1 does not occur: the trace on which they differ is one of x."""
    phi = stl.parse("G[0,3] (F[0,4] x > 1 & F[0,2] x > 2)")
    borders = [atom.right.value for atom in stl.compile_automaton(phi, "paper").atoms]

    def truths(levels):
        return np.array([[level > border for border in borders] for level in levels])

    flags = stl.compile_automaton(phi, "paper", truths([0, 1.5, 3]))
    found = with_formula(flags)
    levels = [(0, 1.5, 3)[sum(step.values())] for step in found.steps]
    assert all(holds == (level > leaf.right.value) for level, step in zip(levels, found.steps, strict=True)
               for leaf, holds in step.items())  # fmt: skip
    assert flags.judge(flags.letters_at(truths(levels)))[0] == found.encoding_says
    after = [0] * (stl.horizon(phi) + 1 - len(levels))  # the verdict is known before
    assert stl.satisfies(phi, {"x": np.array(levels + after)}) == found.formula_is != found.encoding_says
