"""Automata of formulas that look back: registers against the slow semantics, on every trace and on random ones."""

import functools
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata.compile import atoms_of
from stltool.automata.registers import Recorder, _sequences
from stltool.automata.residuals import Residuals
from stltool.errors import FragmentError, SizeError
from stltool.logic.formula import (
    FUTURE,
    Always,
    Eventually,
    Historically,
    Interval,
    Not,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    children,
    has_past,
    walk,
    with_children,
)
from stltool.testing import formulas, mdps, traces
from tests.automata.judging import every_trace, judge, judge_all, truth_of_all
from tests.conftest import MORE, many


def mixed(**options):
    """Formulas that look back somewhere."""
    return formulas(past=True, **options).filter(has_past)


@given(mixed(labels=("a", "b"), signals=(), longest=2, max_leaves=5))
@settings(max_examples=many(250))
def test_every_trace_is_judged_right(phi):
    """First decided verdict = slow semantics, on all traces of h + 1 <= 5 steps over two atoms."""
    if stl.horizon(phi) > 4:
        return
    everything = every_trace(stl.horizon(phi) + 1)
    expected = stl.monitor(phi, everything, semantics="boolean").verdicts[:, 0]
    assert (judge_all(stl.compile_automaton(phi), everything) == expected).all()
    few = {name: values[::37] for name, values in everything.items()}
    assert (truth_of_all(phi, few) == expected[::37]).all()


@pytest.mark.soak
@given(mixed(labels=("a", "b"), signals=(), longest=3, max_leaves=6))
@settings(max_examples=many(40))
def test_every_trace_of_up_to_eight_steps(phi):
    h = stl.horizon(phi)
    if h > 7:
        return
    everything = every_trace(h + 1)
    few = everything if MORE > 1 else {name: values[:: 1 + (len(values) >> 13)] for name, values in everything.items()}
    try:
        automaton = stl.compile_automaton(phi, most_states=3_000)
    except SizeError:
        return
    expected = stl.monitor(phi, few, semantics="boolean").verdicts[:, 0]
    assert (judge_all(automaton, few) == expected).all()


@given(phi=mixed(), data=st.data())
@settings(max_examples=many(150))
def test_random_traces(phi, data):
    try:
        automaton = stl.compile_automaton(phi, memory_limit=2_000_000, most_states=3_000)
    except SizeError:
        return
    assert automaton.horizon == stl.horizon(phi)
    for _ in range(3):
        trace = data.draw(traces(stl.horizon(phi) + 1))
        verdict = judge(automaton, trace)
        assert verdict is not None
        assert verdict[0] == stl.satisfies(phi, trace)


PATTERNS = [
    "G[0,3] once[0,3] a",  # a at step 0 only: a register is the trace's, not a start's
    "G[5,6] once[4,6] a",  # a register runs while a window waits
    "G[0,4] (rise a -> F[0,2] b)",
    "F[1,5] ((F[0,1] a) since[0,2] b)",
    "G[0,4] historically[1,2] F[0,1] a",
    "F[0,5] (a trigger[1,3] !b)",
    "G[0,3] (a -> once[2,3] F[0,4] b)",
    "F[0,6] (once[2,2] a & once[1,3] (b & prev b))",
    "G[0,5] ((historically[0,1] once[0,2] a) | b)",
    "F[0,3] prev prev (a U[0,2] prev b)",
    "(G[0,3] (a -> once b)) & F[2,5] ((!a) since a)",
    "F[2,6] ((rise (a | b)) & fall prev a)",
    "once[0,3] a",
    "historically[1,2] F[0,3] a",
    "F[3,6] once[1,2] (b since[1,inf] a)",
]


def right_on_every_trace(text):
    phi = stl.parse(text)
    everything = every_trace(stl.horizon(phi) + 1)
    expected = stl.monitor(phi, everything, semantics="boolean").verdicts[:, 0]
    return (judge_all(stl.compile_automaton(phi), everything) == expected).all()


@pytest.mark.parametrize("text", PATTERNS)
def test_patterns_on_every_trace(text):
    assert right_on_every_trace(text)


def test_only_windows_of_once_add_up():
    assert right_on_every_trace("F[2,3] once[0,1] (b since[0,1] a)")
    assert right_on_every_trace("G[2,3] historically[0,1] (b since[1,1] a)")
    assert right_on_every_trace("F[2,3] prev (b since a)")
    for text, same in (("once[1,2] once[0,1] a", "once[1,3] a"), ("once[1,2] once a", "once[1,inf] a")):
        left, right = (stl.compile_automaton(stl.parse(f"F[2,9] {past}", unbounded=True)) for past in (text, same))
        assert (left.n_states, left.delta.tolist()) == (right.n_states, right.delta.tolist())


def test_sizes():
    """One more than the states of the window, for a failure: counts of minimal Mealy machines, found by search."""
    for text, states in [
        ("G[0,50] (a -> once[0,5] b)", 7),
        ("G[0,50] once[0,5] F[0,3] a", 10),
        ("G[0,60] ((F[0,3] a) since[0,4] b)", 24),
        ("G[0,60] (a since[0,20] F[0,10] b)", 32),
        ("G[0,60] (rise a -> F[0,3] b)", 6),
        ("G[0,60] ((prev once[3,8] a) | F[0,6] b)", 85),
        ("G[0,1000] (a -> once[0,50] b)", 52),
        *((f"G[0,90] (b -> once[0,{n}] a)", n + 2) for n in (1, 4, 9)),
        *((f"G[0,90] (b -> once[2,{n + 1}] a)", n + 4) for n in (1, 4, 9)),
        *((f"G[0,90] (b -> once[3,{n + 2}] a)", n + 8) for n in (2, 4, 9)),
        *((f"G[0,90] (b -> once[{n},{n}] a)", 2**n + 1) for n in (1, 4, 7)),
        *((f"G[0,90] (historically[0,{n}] once[0,{n}] a | b)", k + 1) for n, k in ((1, 3), (2, 5), (3, 8), (4, 12))),
    ]:
        assert stl.compile_automaton(stl.parse(text)).n_states == states, text


def test_what_must_remember_too_much_is_refused_with_the_count():
    with pytest.raises(SizeError, match=r"once\[30,30\] a alone has 1\.07e\+09, since it must remember when a held"):
        stl.compile_automaton(stl.parse("G[0,90] (b -> once[30,30] a)"))
    with pytest.raises(SizeError, match="over 300 states; shorten its inner windows"):  # of a past of a past
        stl.compile_automaton(stl.parse("G[0,90] (b -> once[30,30] (a since[0,3] c))"), most_states=300)
    assert stl.compile_automaton(stl.parse("G[0,90] once[30,30] a")).n_states == 2  # false at step 0
    assert stl.compile_automaton(stl.parse("F[0,5] once[30,30] a")).n_states <= 7


@pytest.mark.parametrize("width", [1, 2, 3, 5])
def test_the_count_is_that_of_the_sequences(width):
    for length in range(width, 9):
        good = 0
        for bits in itertools.product((0, 1), repeat=length):
            runs = [(i == 0, bit, len(list(run))) for i, (bit, run) in enumerate(itertools.groupby(bits))]
            good += all(bit == 0 or first or size >= width for first, bit, size in runs)
        assert _sequences(length, width) == good
    a, b = 3, 3 + width - 1
    explored = stl.compile_automaton(stl.parse(f"G[0,90] (b -> once[{a},{b}] a)")).n_states
    assert explored <= _sequences(b, width) + 1


@given(
    phi=formulas(labels=("a", "b"), signals=(), longest=2, max_leaves=3), a=st.integers(0, 2), width=st.integers(0, 2)
)
@settings(max_examples=many(60))
def test_identities_of_windows(phi, a, width):
    """Each side's automaton says the same on every trace, cuts at step 0 included."""
    b = a + width
    if stl.horizon(phi) > 2:
        return
    pairs = [
        (f"once[{a},{b}] P", f"once[{a},{a}] once[0,{width}] P"),
        (f"F[0,{b}] historically[{a},{b}] P", f"F[0,{b}] !once[{a},{b}] !P"),
        ("G[0,3] (Q since[1,3] P)", "G[0,3] ((historically[0,0] Q) & (once[1,1] (Q since[0,2] P)))"),
        ("F[1,3] prev P", "F[0,2] P"),
    ]
    for left, right in pairs:
        one, other = (stl.parse(text.replace("P", f"({phi})").replace("Q", "(a | b)")) for text in (left, right))
        everything = every_trace(1 + max(stl.horizon(one), stl.horizon(other)), labels=("a", "b"))
        few = {name: values[:: 1 + len(values) // 5000] for name, values in everything.items()}
        n = 1 + stl.horizon(one), 1 + stl.horizon(other)
        verdicts = [
            judge_all(stl.compile_automaton(psi), {name: values[:, :steps] for name, values in few.items()})
            for psi, steps in zip((one, other), n, strict=True)
        ]
        assert (verdicts[0] == verdicts[1]).all()


def reach(phi):
    """How far the parts of φ look ahead, one inside the other; operators of the past take nothing off."""
    below = max(map(reach, children(phi)), default=0)
    return below + (phi.interval.b if isinstance(phi, FUTURE) else 0)


def delayed(phi, by):
    """P_D(φ), which looks back only: φ held D steps before, at a step that exists; for D >= reach(φ)."""
    guard = Once(Interval(by, by), stl.parse("true"))
    if not any(isinstance(node, FUTURE) for node in walk(phi)):
        return Once(Interval(by, by), phi)
    within = max(map(reach, children(phi)))
    match phi:
        case Eventually(interval, arg):
            window = Interval(by - interval.b - within, by - interval.a - within)
            return guard & Once(window, delayed(arg, within))
        case Always(interval, arg):
            return guard & ~delayed(Eventually(interval, Not(arg)), by)
        case Until(interval, left, right):  # at each possible step of its witness
            alternatives = [
                stl.F(right, u, u) & (stl.G(left, 0, u - 1) if u else stl.parse("true"))
                for u in range(interval.a, interval.b + 1)
            ]
            return guard & functools.reduce(Or.__or__, (delayed(one, by) for one in alternatives))
        case Release(interval, left, right):
            return guard & ~delayed(Until(interval, Not(left), Not(right)), by)
        case Once(interval, arg):
            return Once(Interval(by - within, by - within), Once(interval, delayed(arg, within))) & guard
        case Historically(interval, arg):
            return guard & ~delayed(Once(interval, Not(arg)), by)
        case Since(interval, left, right):
            since = Since(interval, delayed(left, within), delayed(right, within))
            return guard & Once(Interval(by - within, by - within), since)
        case Trigger(interval, left, right):
            return guard & ~delayed(Since(interval, Not(left), Not(right)), by)
        case Rise(arg):
            return delayed(arg & ~stl.prev(arg), by)
        case _:
            return guard & with_children(phi, tuple(delayed(child, by) for child in children(phi)))


@pytest.mark.soak
@given(phi=mixed(longest=2, max_leaves=4), data=st.data())
@settings(max_examples=many(60))
def test_what_looks_ahead_inside_the_past_may_also_be_delayed(phi, data):
    """A second oracle: φ at 0 is F[D,D] P_D(φ), in which nothing of the past looks ahead."""
    steps = reach(phi)
    if steps > 7:
        return
    other = stl.F(delayed(phi, steps), steps, steps)
    trace = data.draw(traces(steps + 1))
    wanted = stl.monitor(other, trace, semantics="boolean").verdicts[0]
    assert stl.satisfies(phi, trace) == wanted
    try:
        automaton = stl.compile_automaton(phi, most_states=3_000)
    except SizeError:
        return
    assert judge(automaton, {name: values[: stl.horizon(phi) + 1] for name, values in trace.items()})[0] == wanted


def test_questions_on_models():
    """P of a task that looks back equals P of one that does not and means the same, whoever asks."""
    model = stl.MDP.from_arrays(
        [[[0.5, 0.5, 0], [0.2, 0.3, 0.5], [0.4, 0, 0.6]], [[0.1, 0, 0.9], [0, 1, 0], [0.3, 0.3, 0.4]]],
        {"x": [0.0, 1.0, 2.0]},
        labels={"a": [1, 0, 0], "b": [0, 0, 1]},
    )
    for back, ahead in (
        ("F[2,5] (b & once[1,1] a)", "F[1,4] (a & F[1,1] b)"),
        ("G[1,6] (b -> prev (x > 0))", "G[0,5] ((F[1,1] b) -> x > 0)"),
        ("F[1,6] rise b", "F[0,5] (!b & F[1,1] b)"),
        ("F[2,5] (a since[2,2] b)", "F[0,3] (b & G[1,2] a)"),
    ):
        one, other = (stl.build_product(model, stl.parse(text)) for text in (back, ahead))
        for maximize in (True, False):
            left, right = stl.check(one, maximize=maximize), stl.check(other, maximize=maximize)
            assert left.probability == pytest.approx(right.probability, abs=1e-12), back
        best = stl.check(one)
        assert stl.check(one, best.policy).probability == pytest.approx(best.probability, abs=1e-12)
        estimate = stl.estimate(one, best.policy, runs=400, seed=0)
        assert estimate.lower <= best.probability <= estimate.upper


@given(model=mdps(states=3, actions=2), phi=mixed(max_leaves=3, longest=2), data=st.data())
@settings(max_examples=many(40))
def test_the_optimum_is_that_of_the_unfolded_runs(model, phi, data):
    """Against enumeration of all runs, with the verdict of the slow semantics at their end."""
    h = stl.horizon(phi)
    if h > 3:
        return
    product = stl.build_product(model, phi)
    names = {**model.signals, **model.labels}

    def value(run):
        if len(run) == h + 1:
            return float(stl.satisfies(phi, {name: np.asarray(column)[run] for name, column in names.items()}))
        s, rows = run[-1], model.matrix().toarray()
        choices = range(model.choice_start[s], model.choice_start[s + 1])
        return max(sum(p * value([*run, s2]) for s2, p in enumerate(rows[c]) if p) for c in choices)

    wanted = sum(p * value([s]) for s, p in enumerate(np.asarray(model.initial)) if p)
    assert stl.check(product).probability == pytest.approx(wanted, abs=1e-9)


def test_other_encodings_refuse_the_past():
    phi = stl.parse("G[0,5] once[0,2] a")
    with pytest.raises(FragmentError, match=r"past: once\[0,2\] a looks back"):
        stl.compile_automaton(phi, "paper")
    with pytest.raises(FragmentError, match=r"the history encoding cannot judge once\[0,2\] a, which looks back"):
        stl.compile_automaton(phi, "history")


def test_meaning_and_vacuity_of_the_past():
    assert stl.meaning(stl.parse("F[0,3] (prev false)")).can_hold is False
    assert stl.meaning(stl.parse("prev a")).can_hold is False  # judged at step 0
    assert stl.meaning(stl.parse("historically[1,5] a")).can_fail is False
    found = stl.meaning(stl.parse("F[0,4] (a & once[0,2] a)"))
    assert "once[0,2] a is vacuous" in " ".join(found.warnings())
    assert stl.meaning(stl.parse("F[0,4] (a & once[1,2] b)")).vacuous == ()


@pytest.mark.parametrize(
    "text",
    [
        "F[0,3] (b & rise F[0,1] a)", "G[1,3] (a | rise (a U[0,1] b))", "F[0,2] (b since[0,2] F[0,2] a)",
        "G[0,2] (a | (F[0,2] b) since[0,1] a)", "F[1,2] ((G[0,2] a) since[1,2] b)", "G[0,3] (b | once[0,0] F[0,2] a)",
    ],
)  # fmt: skip
def test_a_past_of_a_future_on_every_trace(text):
    phi = stl.parse(text)
    traces = every_trace(stl.horizon(phi) + 1)
    expected = stl.monitor(phi, traces, at=0).verdicts[:, 0]
    assert np.array_equal(judge_all(stl.compile_automaton(phi), traces), expected)


def test_states_say_what_they_remember():
    automaton = stl.compile_automaton(stl.parse("G[0,20] (a -> once[0,3] b)"))
    phrases = {one.phrase for q in range(automaton.n_states) for one in automaton.memory(q)}
    assert any(phrase.endswith("so far; b 2 steps ago") for phrase in phrases), phrases
    assert any(phrase.endswith("so far; b 1 step ago") for phrase in phrases), phrases
    automaton = stl.compile_automaton(stl.parse("G[0,20] ((F[0,2] a) since[0,3] b)"))
    phrases = {one.phrase for q in range(automaton.n_states) for one in automaton.memory(q)}
    assert any(phrase.endswith("b 2 steps ago if F[0,1] a") for phrase in phrases), phrases


def test_a_register_is_read_for_each_letter():
    """Two letters that agree on the atoms but not on the past give different values after one another."""
    phi = stl.parse("F[0,3] (prev a & b)")
    table = Residuals(atoms_of(phi))
    table.residual(phi)
    recorder = Recorder(table, table.past_in(table.residual(phi)), [(False, True), (True, True)])
    first = recorder.read(recorder.empty)
    seen = [recorder.read(registers) for registers in first.registers]
    prev_a = table.residual(stl.parse("prev a"))
    assert [reading.after(prev_a)[0] for reading in seen] == [0, 1]
