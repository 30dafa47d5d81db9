"""The specification: the first decided verdict equals the truth of the formula at 0, for every trace."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.automata.compile import atoms_of
from stltool.automata.residuals import FALSE, TRUE, Progression, Residuals
from stltool.errors import SizeError
from stltool.logic.formula import Always, And, Eventually, Interval, Label, Not, Or, Until, atoms, temporal_depth
from stltool.testing import flag_formulas, formulas, traces
from tests.automata.judging import every_trace, judge, judge_all, truth_of_all
from tests.conftest import MORE, many

EXACT = ("exact", "history")


@st.composite
def deep_formulas(draw, depth=4, longest=3):
    """Formulas whose temporal operators are nested at least `depth` deep."""
    phi = draw(formulas(max_leaves=2, longest=2))
    while temporal_depth(phi) < depth:
        a, width = draw(st.integers(0, longest)), draw(st.integers(0, longest))
        window = Interval(a, a + width)
        other = draw(formulas(max_leaves=2, longest=2))
        wrap = draw(st.sampled_from(["F", "G", "U", "R", "and", "or", "not"]))
        phi = {
            "F": Eventually(window, phi), "G": Always(window, phi), "U": Until(window, other, phi),
            "R": Until(window, phi, other), "and": And((phi, other)), "or": Or((other, phi)), "not": Not(phi),
        }[wrap]  # fmt: skip
    return phi


def compiled(phi, encoding="exact"):
    try:
        return stl.compile_automaton(phi, encoding, memory_limit=2_000_000, most_states=3_000)
    except SizeError:
        return None


@pytest.mark.parametrize(
    "text",
    [
        "(a release[0,0] a) <-> (a release[0,0] !a)",
        "(a release[0,2] b) & (b release[1,2] a | !(a release[0,1] c))",
    ],
)
def test_parts_of_release_do_not_take_one_anothers_place(text):
    """Histories know the parts of a formula by their objects."""
    phi = stl.parse(text)
    automaton = compiled(phi, "history")
    for row in itertools.product((False, True), repeat=9):
        trace = {"a": np.array(row[:3]), "b": np.array(row[3:6]), "c": np.array(row[6:])}
        assert judge(automaton, trace)[0] == stl.satisfies(phi, trace)


@pytest.mark.parametrize("encoding", EXACT)
@given(phi=st.one_of(formulas(), flag_formulas(equal=False)), data=st.data())
@settings(max_examples=many(200))
def test_verdict_equals_the_slow_semantics(encoding, phi, data):
    automaton = compiled(phi, encoding)
    if automaton is None:
        return
    assert automaton.exact
    assert automaton.horizon == stl.horizon(phi)
    assert (automaton.verdicts(automaton.horizon) != UNDECIDED).all()
    for _ in range(3):
        trace = data.draw(traces(stl.horizon(phi) + 1))
        verdict = judge(automaton, trace)
        assert verdict is not None
        assert verdict[0] == stl.satisfies(phi, trace)


@given(phi=deep_formulas(), data=st.data())
@settings(max_examples=many(80))
def test_deep_nesting_with_mixed_windows(phi, data):
    automaton = compiled(phi)
    if automaton is None:
        return
    for _ in range(3):
        trace = data.draw(traces(stl.horizon(phi) + 1))
        verdict = judge(automaton, trace)
        assert verdict is not None
        assert verdict[0] == stl.satisfies(phi, trace)


@given(formulas(labels=("a", "b"), signals=(), longest=2, max_leaves=6))
@settings(max_examples=many(60))
def test_every_single_trace_is_judged_right(phi):
    if stl.horizon(phi) > 4:
        return
    everything = every_trace(stl.horizon(phi) + 1)
    expected = truth_of_all(phi, everything)
    histories = stl.compile_automaton(phi).n_letters ** (stl.horizon(phi) + 1)
    for encoding in EXACT:
        if encoding != "history" or histories < 100_000:  # otherwise it has millions of states
            assert (judge_all(stl.compile_automaton(phi, encoding), everything) == expected).all()


@pytest.mark.parametrize(
    "text",
    [
        "F[0,2] (F[0,1] a & G[0,3] b)",  # the example that the paper's flags get wrong
        "G[0,2] (a -> G[0,2] b)",
        "G[0,2] (a -> F[1,3] b)",
        "G[1,3] F[0,2] a & F[0,4] b",
        "(G[0,2] a) -> (G[0,4] b)",
        "(G[0,2] a) <-> (F[0,3] b)",
        "F[2,4] (a U[1,2] b)",
        "!(a U[1,4] b) | G[2,3] a",
        "(a U[1,3] b) & F[2,4] a",
        "!(a U[0,2] b) & G[3,4] a",
        "(a U[0,1] b) & !(b U[2,4] a)",
        "G[0,2] (F[0,1] a | G[0,2] b)",
        "(F[0,1] a | G[0,2] b) & (F[1,3] a | b)",
        "G[0,2] ((!a & F[1,1] a) -> F[1,1] G[0,1] a)",
        "F[0,1] (a & F[0,1] (b & F[0,2] !a))",
        "G[2,4] (a | b)",
        "a & !b",
        "true",
        "F[0,3] false",
        "true release[0,2] a",
        "(b | F[1,1] b) release[0,2] a",
        "(b | F[1,1] b) release[1,3] (a | G[0,1] b)",
        "(a U[0,2] b) | G[0,2] (a release[0,1] b)",
    ],
)
def test_patterns_on_every_trace(text):
    phi = stl.parse(text)
    everything = every_trace(stl.horizon(phi) + 1)
    assert (judge_all(stl.compile_automaton(phi), everything) == truth_of_all(phi, everything)).all()


@pytest.mark.parametrize(
    "text",
    [
        "G[0,2] (a -> F[1,2] b)",
        "F[1,2] (a & G[0,2] b)",
        "F[0,2] (a U[1,2] b)",
        "G[0,2] (b | (a release[0,2] b))",
        "(F[0,1] a) <-> (G[1,3] b)",
    ],
)
def test_histories_on_every_trace(text):
    phi = stl.parse(text)
    automaton = stl.compile_automaton(phi, "history")
    everything = every_trace(stl.horizon(phi) + 1)
    assert (judge_all(automaton, everything) == truth_of_all(phi, everything)).all()
    assert (automaton.verdicts(automaton.horizon) != UNDECIDED).all()
    assert (automaton.verdicts(automaton.horizon - 1) == UNDECIDED).any()
    assert [part.delay for part in automaton.parts] == [stl.horizon(automaton.parts[0].obligation)]


@given(phi=flag_formulas())
def test_never_more_states_than_the_flags_when_windows_are_equal(phi):
    exact, flags = stl.compile_automaton(phi), stl.compile_automaton(phi, "paper")
    assert exact.n_states <= flags.n_states


@given(phi=flag_formulas(longest=2), data=st.data())
def test_the_flags_stand_in_where_the_windows_explode(phi, data):
    def explode(*_):
        raise SizeError("too large")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stltool.automata.compile.window_automaton", explode)
        automaton = stl.compile_automaton(phi)
    assert (automaton.encoding, automaton.exact) == ("exact", True)
    trace = data.draw(traces(stl.horizon(phi) + 1))
    assert judge(automaton, trace)[0] == stl.satisfies(phi, trace)


def test_small_where_small_is_possible():
    for text, states in [
        ("G[0,99] F[0,99] a", 101),
        ("F[0,99] G[0,99] a", 101),
        ("G[0,99] (F[0,99] a & F[0,99] b)", 101**2),
        ("G[0,99] (a -> F[0,99] b)", 101),  # response: the oldest open request says it all
        ("F[0,9] F[0,4] a", 2),
        ("(G[0,29] p) -> (G[0,3] q)", 3),
        ("G[30,630] (p < 14.2)", 2),
        ("G[30,630] F[0,5] p", 7),
        ("a U[0,500] b", 3),
        ("a U[20,500] b & !(c U[0,300] a)", 50),
        ("G[0,64] F[0,29] G[0,5] p", 200),
        ("F[0,9] G[0,4] c & G[0,9] (F[0,4] a & F[0,4] b)", 160),
    ]:
        assert stl.compile_automaton(stl.parse(text)).n_states <= states, text


def test_too_large_says_which_part_and_the_ways_out():
    phi = stl.parse("F[0,9] c & G[0,20] ((a & F[0,20] b) -> (F[3,19] (b & G[0,9] a) | F[0,20] G[2,6] !a))")
    with pytest.raises(SizeError) as caught:
        stl.compile_automaton(phi, most_states=300)
    message = str(caught.value)
    assert "F[2,22] G[0,4] !a" in message  # the part that explodes, not the whole formula
    assert "F[0,9] c" not in message
    assert "grows over 300 states; shorten its inner windows" in message
    many = stl.parse(" & ".join(f"(G[0,9] F[0,20] l{i})" for i in range(8)))
    with pytest.raises(SizeError, match=r"product of parts with 22 × 22 × .* of which over 5000 are reachable"):
        stl.compile_automaton(many, most_states=5000)
    with pytest.raises(SizeError, match="20 different predicates"):
        stl.compile_automaton(stl.parse(" | ".join(f"F[0,1] l{i}" for i in range(20))))


def test_valuations_that_nothing_tells_apart_share_a_letter():
    automaton = stl.compile_automaton(stl.parse("G[0,5] (a | F[0,3] (a & b))"))
    assert len(automaton.valuations) == 4 or len(automaton.valuations) == 2 ** len(automaton.atoms)
    assert automaton.n_letters < len(automaton.valuations)
    assert len(np.unique(automaton.delta, axis=0)) == automaton.n_letters


# ------------------------------------------------------------------------------------------- residuals


@given(phi=formulas(labels=("a", "b"), signals=(), longest=3), data=st.data())
@settings(max_examples=many(150))
def test_progress_keeps_the_meaning(phi, data):
    """trace ⊨ φ at 0  iff  the rest of the trace ⊨ progress(φ, first letter) at 0."""
    table = Residuals(atoms(phi))
    x = table.residual(phi)
    n = stl.horizon(phi) + 2
    trace = data.draw(traces(n, labels=("a", "b"), signals=()))
    expected = stl.satisfies(phi, trace)
    assert stl.satisfies(table.formula(x), trace) == expected
    assert stl.satisfies(table.formula(table.negation(x)), trace) != expected
    letter = tuple(stl.satisfies(atom, trace) for atom in table.atoms)
    opposite = tuple(not value for value in letter)
    progressed, other = Progression(table, [letter, opposite])(x)
    rest = {name: values[1:] for name, values in trace.items()}
    assert stl.satisfies(table.formula(progressed), rest) == expected
    assert Progression(table, [opposite])(x) == (other,)


def related_formulas():
    """F, G, U and its dual over the same few operands with every window up to [2,2], some under one more operator."""
    windows = [f"[{a},{b}]" for a in range(3) for b in range(a, 3)]
    plain = [f"{op}{w} {p}" for op in "FG" for w in windows for p in ("a", "!a", "b", "(a & b)")]
    until = [
        f"{n}({p} U{w} {q})" for n in ("", "!") for w in windows for p, q in (("a", "b"), ("!a", "b"), ("a", "!b"))
    ]
    deep = [f"{op}[0,1] {inner}" for op in "FG" for inner in ("F[0,1] a", "G[0,1] a", "(a U[0,1] b)", "F[1,2] b")]
    both = [f"({x}) {op} ({y})" for op in "&|" for x in plain[::5] for y in until[::7]]
    return [stl.parse(text) for text in ["a", "!a", *plain, *until, *deep, *both]]


@pytest.mark.soak
def test_implication_seen_is_implication():
    """On every trace, for every pair; and it is seen often enough to be worth its name."""
    family = related_formulas()[:: 2 if MORE < 1 else 1]  # a quarter of the pairs
    everything = every_trace(4)
    truths = np.array([truth_of_all(phi, everything) for phi in family])
    table = Residuals((Label("a"), Label("b"), And((Label("a"), Label("b")))))
    residuals = [table.residual(phi) for phi in family]
    implied = ~(truths[:, None, :] & ~truths[None, :, :]).any(axis=2)
    seen = np.array([[table.implies(x, y) for y in residuals] for x in residuals])
    assert not (seen & ~implied).any()
    assert seen.sum() > 0.3 * implied.sum()


def test_residuals_are_kept_small():
    table = Residuals((Label("a"), Label("b")))

    def same(left, right):
        assert table.residual(stl.parse(left)) == table.residual(stl.parse(right))

    same("F[0,3] F[1,2] a", "F[1,5] a")
    same("G[0,3] (F[0,2] a & F[0,2] b)", "G[0,3] F[0,2] a & G[0,3] F[0,2] b")
    same("G[0,4] a & G[3,9] a", "G[0,9] a")
    same("F[0,4] a & F[1,2] a", "F[1,2] a")
    same("F[0,3] G[2,5] a", "F[2,5] G[0,3] a")
    same("!(a U[0,3] b)", "!(a U[0,3] b) & !(a U[0,2] b)")
    same("true U[1,3] b", "F[1,3] b")
    assert table.residual(stl.parse("F[0,3] (a & G[0,2] false)")) == FALSE
    assert table.residual(stl.parse("F[0,3] (a | G[0,2] true)")) == TRUE
    assert table.negation(TRUE) == FALSE
    assert atoms_of(stl.parse("F[0,1] (a | b) & G[0,1] !(a | b)")) == (Or((Label("a"), Label("b"))),)
