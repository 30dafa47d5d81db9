"""What a formula means before any model, against brute force over every trace."""

import dataclasses
import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata.reachable import Effort, ReachableVerdicts, differ, shortest_run
from stltool.automata.samples import Samples, truth_along
from stltool.automata.vacuity import meaning
from stltool.errors import ArgumentError, SettingsError, SizeError, StlSyntaxError
from stltool.logic.feasible import feasible_valuations, leaves
from stltool.logic.formula import (
    Always,
    And,
    Comparison,
    Constant,
    Eventually,
    Iff,
    Interval,
    Label,
    Not,
    Release,
    Until,
    children,
    walk,
    with_children,
)
from stltool.logic.occurrences import occurrences
from stltool.testing import formulas, traces
from tests.automata.judging import every_trace
from tests.conftest import many

A = Label("a")
VACUOUS = "is vacuous; with {} in its place, the task still means {}\n"


# ------------------------------------------------------------------------------------------- brute force


def every(phi, letters, n_steps=None):
    """The truth of φ on every sequence of n_steps (its length) letters (name → value), (n_letters,) * n_steps."""
    n = stl.horizon(phi) + 1
    truth = [
        stl.satisfies(phi, {name: [letter[name] for letter in word] for name in letters[0]})
        for word in itertools.product(letters, repeat=n)
    ]
    more = (n_steps or n) - n
    truth = np.array(truth).reshape((len(letters),) * n + (1,) * more)
    return np.broadcast_to(truth, (len(letters),) * (n + more))


def truths(phi, letters):
    """The truth of each label and comparison at each letter."""
    traces = [{name: [value] for name, value in letter.items()} for letter in letters]
    return [tuple(stl.satisfies(leaf, trace) for leaf in leaves(phi)) for trace in traces]


def places(phi, path=()):
    yield path, phi
    for i, child in enumerate(children(phi)):
        yield from places(child, (*path, i))


def replaced(phi, path, new):
    if not path:
        return new
    operands = list(children(phi))
    operands[path[0]] = replaced(operands[path[0]], path[1:], new)
    return with_children(phi, tuple(operands))


def changed(phi, path, constant, letters):
    return every(replaced(phi, path, Constant(constant)), letters, stl.horizon(phi) + 1)


def idle_places(phi, truth, letters):
    """path → the constants that can stand there, for the largest occurrences that are vacuous."""
    found = {}
    for path, part in places(phi):
        outer = any(path[: len(known)] == known for known in found)
        if path and not outer and any(isinstance(node, Label | Comparison) for node in walk(part)):
            same = [c for c in (True, False) if (changed(phi, path, c, letters) == truth).all()]
            if same:
                found[path] = same
    return found


def shortest(truth, verdict):
    """The fewest letters that make sure of a verdict."""
    for n in range(truth.ndim + 1):
        sure = (truth == verdict).reshape((*truth.shape[:n], -1)).all(axis=-1)
        if sure.any():
            return n
    return None


def assert_right(phi, letters, found, complete=True):
    """A meaning against brute force: `complete` if everything must have been found and proved."""
    truth = every(phi, letters)
    assert found.can_hold in ((truth.any(),) if complete else (truth.any(), True, None))
    assert found.can_fail in ((not truth.all(),) if complete else (not truth.all(), True, None))
    assert {type(value) for value in (found.can_hold, found.can_fail)} <= {bool, type(None)}
    if not complete:
        for part in found.vacuous:
            assert (changed(phi, part.path, part.constant, letters) == truth).all()
        return
    assert found.status == "decided"
    assert found.shortest
    rows = {row: i for i, row in enumerate(truths(phi, letters))}
    for verdict, example in ((True, found.holds), (False, found.fails)):
        least = shortest(truth, verdict)
        assert (example is None) == (least is None)
        if example is not None:
            assert example.n_steps == least
            word = [rows[row] for row, count in example.runs for _ in range(count)]
            assert (truth[tuple(word)] == verdict).all()
    if truth.any() and not truth.all():
        expected = idle_places(phi, truth, letters)
        assert [part.path for part in found.vacuous] == list(expected)
        for part in found.vacuous:
            assert part.constant in expected[part.path]
            assert dict(places(phi))[part.path] is part.part
            assert (every(part.formula, letters, truth.ndim) == truth).all()
        assert found.because is None
    else:
        assert found.vacuous == ()
        part, value = found.because
        assert (every(part, letters) == value).all()


LETTERS = [{"a": a, "b": b} for a in (False, True) for b in (False, True)]


def asked(phi, evidence, **options):
    """The meaning of φ; without made-up traces, what matters is proved by automata too."""
    with pytest.MonkeyPatch.context() as patch:
        if evidence == "proof alone":
            patch.setattr(Samples, "notice", lambda *_: False)
        return meaning(phi, **options)


both_ways = pytest.mark.parametrize("evidence", ["with evidence", "proof alone"])


@both_ways
@given(phi=formulas(labels=("a", "b"), signals=(), longest=2, max_leaves=5))
@settings(max_examples=many(120))
def test_every_answer_over_labels_is_that_of_brute_force(evidence, phi):
    if stl.horizon(phi) > 2:
        return
    assert_right(phi, LETTERS, asked(phi, evidence))


def compared(max_leaves=5):
    """Formulas over comparisons of one variable with constants, and a label."""
    texts = ("x > 0", "x >= 1", "0 > x", "x <= 0", "2 * x == 1", "x != 1", "1 - x <= 1", "abs(x) < 1", "3 > 2", "a")
    leaf = st.sampled_from([stl.parse(text) for text in texts])
    shapes = formulas(labels=("a",), signals=(), longest=1, max_leaves=max_leaves)

    @st.composite
    def filled(draw):
        def fill(phi):
            return draw(leaf) if isinstance(phi, Label) else with_children(phi, tuple(map(fill, children(phi))))

        return fill(draw(shapes))

    return filled()


GRID = [{"x": x, "a": a} for x in (-2, -1, -0.5, 0, 0.25, 0.5, 0.75, 1, 1.5, 2, 3) for a in (False, True)]


@both_ways
@given(phi=compared())
@settings(max_examples=many(80))
def test_every_answer_over_one_variable_is_that_of_brute_force(evidence, phi):
    if stl.horizon(phi) > 1:
        return
    found = asked(phi, evidence)
    different = dict(zip(truths(phi, GRID), GRID, strict=True))  # one letter a truth assignment: brute force must end
    assert_right(phi, list(different.values()), found)


@given(phi=formulas(labels=("a",), longest=2, max_leaves=5), data=st.data())
@settings(max_examples=many(120))
def test_no_trace_contradicts_a_warning(phi, data):
    """Whatever is compared with whatever."""
    found = meaning(phi)
    for _ in range(3):
        trace = data.draw(traces(stl.horizon(phi) + 1))
        truth = stl.satisfies(phi, trace)
        assert found.can_hold is not False or not truth
        assert found.can_fail is not False or truth
        assert all(stl.satisfies(part.formula, trace) == truth for part in found.vacuous)


@both_ways
@given(phi=formulas(labels=("a", "b"), signals=(), longest=2, max_leaves=6), effort=st.integers(0, 300))
@settings(max_examples=many(100))
def test_giving_up_is_said_and_never_guessed(evidence, phi, effort):
    if stl.horizon(phi) > 2:
        return
    found, full = asked(phi, evidence, most_effort=effort), asked(phi, evidence)
    assert_right(phi, LETTERS, found, complete=False)
    assert found.can_hold in (None, full.can_hold)
    assert found.can_fail in (None, full.can_fail)
    if found.status == "decided":
        assert [part.path for part in found.vacuous] == [part.path for part in full.vacuous]
    else:
        assert found.status.startswith("not decided: whether ")
        assert found.warnings()[-1] == found.status


# ------------------------------------------------------------------------------------------- words


def test_a_task_that_can_never_hold_names_the_part_at_fault():
    found = meaning(stl.parse("G[0,3] b &\n  F[0,3] (a & (x > 5 & x < 3))", name="task.stl"))
    assert (found.can_hold, found.can_fail, found.holds, found.vacuous) == (False, True, None, ())
    assert found.fails.runs == ()
    assert found.warnings() == [
        "task.stl, line 2, column 16: this task can never hold: x > 5 & x < 3 never holds\n"
        "      F[0,3] (a & (x > 5 & x < 3))\n"
        "                   ^^^^^^^^^^^^^"
    ]
    assert found.data()["because"] == {"part": "x > 5 & x < 3", "line": 2, "column": 16, "always": False}
    assert found.data()["fails"] == []


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("F[0,3] a & G[0,3] !a", "column 1: this task can never hold\n"),
        ("G[0,5] (a -> F[0,5] a)", "column 9: this task holds on every trace: a -> (F[0,5] a) always holds\n"),
        ("!(G[0,4] b & (x > 3 & x < 2))", "column 15: this task holds on every trace: x > 3 & x < 2 never holds\n"),
        ("(x > 3 & x < 2) U[1,4] a", "column 2: this task can never hold: x > 3 & x < 2 never holds\n"),
        ("F[0,3] true & false", "column 1: this task can never hold\n"),
        ("F[0,3] a -> F[0,4] a", "column 1: this task holds on every trace\n"),
        ("(F[0,2] a) xor (F[0,2] a)", "column 1: this task can never hold: (F[0,2] a) <-> (F[0,2] a) always holds\n"),
        ("a & 2 > 3", "column 5: this task can never hold: 2 > 3 never holds\n"),
        ("true", "column 1: this task holds on every trace\n"),
        (
            "F[0,5] (x > 5 & x < 3) | G[0,3] a",
            "column 1: F[0,5] (x > 5 & x < 3) " + VACUOUS.format("false", "G[0,3] a"),
        ),
        ("G[0,5] (a | b) & G[0,5] b", "column 1: G[0,5] (a | b) " + VACUOUS.format("true", "G[0,5] b")),
        ("G[0,5] (x > 5 & x > 3)", "column 17: x > 3 " + VACUOUS.format("true", "G[0,5] (x > 5)")),
        (
            "(F[0,5] a) <-> (F[0,5] (a | b) & F[0,3] a)",
            "column 17: F[0,5] (a | b) " + VACUOUS.format("true", "(F[0,5] a) <-> (F[0,3] a)"),
        ),
    ],
)
def test_warnings(text, says):
    found = meaning(stl.parse(text))
    assert found.status == "decided"
    (warning,) = found.warnings()
    assert warning.startswith(f"formula, line 1, {says}")
    json.dumps(found.data(), allow_nan=False)


@pytest.mark.parametrize(
    "text",
    [
        "G[0,20] (speed < 120)",
        "F[0,2] (pos > 3.2) & F[2,3] G[0,1] inside & G[4,6] close",
        "G[0,9] (a -> F[0,9] b)",
        "G[0,9] (F[0,9] a & F[0,9] b)",
        "G[1,37] (far -> F[0,2] G[0,1] !far)",
        "G[0,30] ((!g & F[1,1] g) -> F[1,1] G[0,5] g)",
        "F[0,9] (a U[0,5] b)",
        "(F[0,3] a) xor (G[0,3] b)",
        "x > y & y < z",
        "sqrt(x) > 2 & x < 4",
    ],
)
def test_no_warning_where_everything_matters(text):
    found = meaning(stl.parse(text))
    assert found.warnings() == []
    assert found.data()["vacuous"] == []


def test_parts_that_stand_in_for_each_other_are_told_each():
    found = meaning(stl.parse("F[0,3] a & G[0,2] b & F[0,3] a"))
    warnings = found.warnings()
    assert len(warnings) == 3
    assert warnings[2] == "each part is considered by itself: once one is removed, the others may matter"
    assert [part["column"] for part in found.data()["vacuous"]] == [1, 23]
    assert found.data()["vacuous"][0] == {
        "part": "F[0,3] a", "line": 1, "column": 1, "uses": 1, "constant": True, "means": "(G[0,2] b) & (F[0,3] a)",
    }  # fmt: skip


def test_a_definition_that_matters_in_one_use_only():
    task = stl.parse_task("home := F[0,3] (x > 1)\ntask := home & (home | a)")
    (warning,) = meaning(task.formula).warnings()
    assert "column 17: (F[0,3] (x > 1)) | a is vacuous" in warning
    task = stl.parse_task("home := x > 1\ntask := F[0,3] home & G[0,3] (home | a) & F[0,2] home")
    (warning,) = meaning(task.formula).warnings()
    assert "F[0,3] (x > 1) is vacuous" in warning
    task = stl.parse_task("home := x > 1\ntask := G[0,3] (home & (x > 2 | home)) & F[0,4] (!home | x > 5)")
    assert any("x > 1, in one of its 3 uses, is vacuous" in text for text in meaning(task.formula).warnings())


def test_formulas_without_a_text_are_told_too():
    found = meaning(Always(Interval(0, 1), Iff(A, A)))
    assert found.warnings() == ["this task holds on every trace: a <-> a always holds"]
    assert found.data()["because"] == {"part": "a <-> a", "always": True}


def test_the_shortest_examples():
    found = meaning(stl.parse("G[0,5] F[0,5] (x > 1 & a)"))
    assert str(found.holds) == "x > 1, a for 6 steps"
    assert str(found.fails) == "x <= 1, !a for 6 steps"
    assert found.data()["fails"] == [{"steps": 6, "truth": {"x > 1": False, "a": False}}]
    assert (str(meaning(stl.parse("true")).holds), meaning(stl.parse("true")).holds.n_steps) == ("any trace", 0)
    assert meaning(stl.parse("true")).fails is None


# ------------------------------------------------------------------------------------------- bounds


def test_samples_of_other_steps_are_told_as_they_are_written():
    told = meaning(stl.parse("F[0,2] (x[t-1] < x)"))
    assert str(told.holds) == "!(x[t-1] < x) for 1 step; x[t-1] < x for 1 step"
    assert str(told.fails) == "!(x[t-1] < x) for 3 steps"
    [part] = meaning(stl.parse("G[0,3] (x[t+1] > x & (x[t+1] > x | x > 7))")).vacuous
    assert (str(part.part), str(part.formula)) == ("(F[1,1] (x > x[t-1])) | x > 7", "G[1,4] (x > x[t-1])")
    [part] = meaning(stl.parse("F[0,3] (x[t-1] > x & (x[t-1] > x | b))")).vacuous
    assert (str(part.part), str(part.formula)) == ("x[t-1] > x | b", "F[0,3] (x[t-1] > x)")
    never = meaning(stl.parse("a & (x[t+2] > x & x[t+2] <= x)"))
    assert str(never.because[0]) == "(F[2,2] (x > x[t-2])) & (F[2,2] (x <= x[t-2]))"


def test_long_windows_cost_what_their_states_do():
    found = meaning(stl.parse("G[0,100000000000000] a & F[0,5] b & F[0,99999999999999] a"))
    assert found.holds.n_steps == 10**14 + 1
    assert len(found.holds.runs) <= 3
    assert found.fails.n_steps == 1
    assert [str(part.part) for part in found.vacuous] == ["F[0,99999999999999] a"]
    turns = meaning(stl.parse("G[0,1000000] ((a -> F[1,1] !a) & (!a -> F[1,1] a))"))
    assert (turns.status, turns.can_hold, turns.holds, turns.fails.n_steps) == ("decided", True, None, 2)
    assert turns.warnings() == []


def test_whatever_follows_an_example_its_verdict_stands():
    for text in [
        "G[0,30] F[0,20] a & F[10,45] G[0,4] (b & !a)",
        "F[0,30] (a & F[3,5] (b & F[1,1] !a))",
        "G[3,40] (a -> F[2,9] b)",
        "G[0,40] (a -> F[1,1] !a) & F[0,40] (a & b) & G[20,45] (b <-> a)",
        "(a U[20,40] b) & G[0,15] !b",
        "F[30,40] G[0,9] (a | b) & F[35,40] !b",
        "(a <-> b) & G[0,3] b & (a U[0,20] !b)",
        "(G[0,21] b) | F[0,20] !b | a & b",
        "G[0,60] ((a -> F[1,1] !a) & (!a -> F[1,1] a)) & F[0,3] b",
    ]:
        phi = stl.parse(text)
        found, rng = meaning(phi), np.random.default_rng(0)
        assert found.shortest
        for verdict, example in ((True, found.holds), (False, found.fails)):
            word = [dict(zip(map(str, example.leaves), row, strict=True)) for row, n in example.runs for _ in range(n)]
            for rate in (0.0, 0.1, 0.5, 0.9, 1.0):
                trace = {name: [step[name] for step in word] + (rng.random(100) < rate).tolist() for name in ("a", "b")}
                assert stl.satisfies(phi, trace) == verdict, text


LARGE = "G[0,100] (a -> G[0,100] b)"


def test_what_is_too_large_for_automata_is_shown_by_traces_where_it_can():
    rarely = f"{LARGE} & G[0,100] (a & b & !c & d & !e)"  # on one of the traces
    for text, status in ((LARGE, "decided"), (rarely, "not decided: whether a is vacuous, and 1 other part")):
        found = meaning(stl.parse(text))
        assert found.status.startswith(status)
        assert (found.can_hold, found.can_fail, found.shortest) == (True, True, False)
        for example, verdict in ((found.holds, True), (found.fails, False)):
            steps = [row for row, count in example.runs for _ in range(count)]
            trace = {str(leaf): [row[i] for row in steps] for i, leaf in enumerate(example.leaves)}
            assert stl.satisfies(found.formula, trace) == verdict


def test_what_is_too_large_for_automata_is_proved_nearby_where_it_can():
    found = meaning(stl.parse(f"{LARGE} & G[0,5] (b -> F[0,5] b) & F[0,3] (c | c & a)"))
    assert found.status == "decided"
    vacuous = [(str(part.part), part.constant) for part in found.vacuous]
    assert vacuous == [("G[0,5] (b -> (F[0,5] b))", True), ("c & a", False)]


@pytest.mark.soak(only=True)
def test_what_is_too_large_for_both_is_said():
    found = meaning(stl.parse(f"{LARGE} & G[0,50] (a -> G[0,60] b)"))
    status = "not decided: whether G[0,50] (a -> (G[0,60] b)) is vacuous: its automaton has more than 5000 states"
    assert (found.status, found.vacuous, found.can_hold) == (status, (), True)
    assert found.warnings() == [status]
    weaker = "G[0,50] (a -> G[0,60] b) & (G[0,50] (a -> G[0,61] b) | G[0,51] (a -> G[0,59] b))"
    two = meaning(stl.parse(f"{LARGE} & {weaker}"))
    assert "is vacuous, and 1 other part: " in two.status
    wide = meaning(stl.parse(" & ".join(f"F[0,2] l{i} & F[0,3] (l{i} | l{i + 1})" for i in range(12))))
    assert (wide.can_hold, wide.can_fail) == (True, True)
    assert wide.status.startswith("not decided: whether F[0,3] (l0 | l1) is vacuous, and 11 other parts: its labels ")
    never = meaning(stl.parse("G[0,9] (" + " & ".join(f"l{i}" for i in range(12)) + ") & F[0,9] !l3"))
    assert never.status.startswith("not decided: whether the task can hold: its labels and comparisons have more than")
    assert (never.can_hold, never.can_fail, never.holds) == (None, True, None)


def test_deep_formulas_are_no_trouble():
    phi = A
    for i in range(180):
        phi = (Always if i % 2 else Eventually)(Interval(0, 1), phi)
    found = meaning(phi)
    assert (found.status, found.can_hold, found.can_fail, found.shortest) == ("decided", True, True, False)
    found = meaning(And((phi, Not(Eventually(Interval(0, 1), phi)))))
    assert found.status.startswith(
        "not decided: whether the task can hold: it nests temporal operators 181 deep, more than 8"
    )


def test_formulas_of_too_many_operators_are_left_alone():
    found = meaning(stl.parse(" & ".join(f"F[0,{i}] a" for i in range(1200))))
    assert found.status == "not decided: the formula has 2401 operators and operands, more than 2000"
    assert (found.can_hold, found.can_fail, found.warnings()) == (None, None, [found.status])
    assert found.data()["because"] is None


def test_many_parts_end_with_the_effort():
    found = meaning(stl.parse(" & ".join(f"F[0,{i % 30}] l{i % 9}" for i in range(600))))
    assert found.status.endswith("the search exceeds the limit of 60000 states times letters")
    assert (found.can_hold, found.can_fail) == (True, True)


def test_texts_stay_readable():
    found = meaning(stl.parse("F[0,3] a & F[0,3] a & " + " & ".join(f"F[{i},{2 * i}] b{i % 3}" for i in range(90))))
    assert all(len(warning.splitlines()[0]) < 500 for warning in found.warnings())
    assert any(" …" in warning for warning in found.warnings())


# ------------------------------------------------------------------------------------------- a model's letters


def test_letters_of_a_model_make_more_warnings():
    phi = stl.parse("F[0,3] a & G[0,3] (b | x > y)")
    assert [str(leaf) for leaf in leaves(phi)] == ["a", "b", "x > y"]
    exclusive = np.array([[True, False, False], [False, True, True], [False, False, False]])
    assert meaning(phi, exclusive).can_hold is False
    always = np.array([[True, True, False], [False, True, True], [False, True, False]])
    assert [str(part.part) for part in meaning(phi, always).vacuous] == ["G[0,3] (b | x > y)"]
    assert meaning(phi).warnings() == []


@pytest.mark.parametrize(
    "wrong", [np.ones((2, 3), dtype=bool), np.ones((0, 2), dtype=bool), np.ones((2, 2)), np.ones(2, dtype=bool)]
)
def test_letters_of_another_shape_are_refused(wrong):
    with pytest.raises(SettingsError, match="one row or more and 2 columns, one for each of leaves"):
        meaning(stl.parse("a & b"), wrong)


def test_formulas_without_a_horizon_are_refused():
    with pytest.raises(StlSyntaxError, match="no horizon"):
        meaning(Always(Interval(0, None), A))
    with pytest.raises(ArgumentError, match="parse it: stl.parse"):
        meaning("a")


# ------------------------------------------------------------------------------------------- the parts of the search


def looks_ahead(phi):
    """By how many steps any part does, without what operators of the past make up for."""
    window = phi.interval.b if isinstance(phi, Eventually | Always | Until | Release) else 0
    return window + max(map(looks_ahead, children(phi)), default=0)


@pytest.mark.parametrize(
    "text",
    ["a since b", "a since[0,1] b", "a since[1,2] b", "a since[2,inf] b", "a trigger[0,1] b", "a trigger[1,3] b"],
)
def test_truth_along_of_the_past_on_every_trace(text):
    phi, everything = stl.parse(text), every_trace(4)
    found = truth_along(phi, [everything[name].T for name in "ab"])
    expected = stl.monitor(phi, everything, end="cut", semantics="boolean").verdicts
    assert (expected == found.T).all()


@given(formulas(labels=("a", "b"), signals=(), longest=3, past=True), st.data())
def test_truth_along_is_the_slow_semantics(phi, data):
    n_steps = looks_ahead(phi) + 3
    cases = [data.draw(traces(n_steps, labels=("a", "b"), signals=())) for _ in range(2)]
    columns = {name: np.stack([case[name] for case in cases], axis=1) for name in ("a", "b")}

    def along(psi):
        match psi:
            case Label(name):
                return columns[name]
            case Constant(value):
                return np.full((n_steps, 2), value)
            case _:
                return truth_along(psi, [along(child) for child in children(psi)])

    truth = along(phi)[:3]
    assert truth.T.tolist() == [[stl.satisfies(phi, case, t) for t in range(3)] for case in cases]


@given(formulas(labels=("a", "b"), signals=(), longest=3), st.data())
def test_evidence_is_what_replacing_shows(phi, data):
    """Made-up traces are judged as the slow semantics does, and what makes a difference on some of them is noticed."""
    read = leaves(phi)
    valuations, _ = feasible_valuations(read, 100)
    samples = Samples(occurrences(phi), {leaf: i for i, leaf in enumerate(read)}, valuations, stl.horizon(phi) + 1)
    assert samples.letters.shape == (stl.horizon(phi) + 1, 1024)
    chosen = range(0, 1024, 97)
    words = valuations[samples.letters[:, chosen]]
    cases = [{str(leaf): words[:, k, i] for i, leaf in enumerate(read)} for k in range(len(chosen))]
    judged = [stl.satisfies(phi, case) for case in cases]
    assert samples.verdicts[chosen].tolist() == judged
    i = data.draw(st.integers(0, len(occurrences(phi)) - 1))
    constant = data.draw(st.booleans())
    other = replaced(phi, occurrences(phi)[i].path, Constant(constant))
    if [stl.satisfies(other, case) for case in cases] != judged:
        assert samples.notice(i, constant, Effort(10**6))
    elif (every_word(other, read, samples, valuations) == samples.verdicts).all():
        assert not samples.notice(i, constant, Effort(10**6))


def every_word(phi, read, samples, valuations):
    """The truth of a formula on all made-up traces."""
    columns = {leaf: valuations[samples.letters, i] for i, leaf in enumerate(read)}

    def along(psi):
        if isinstance(psi, Constant):
            return np.full(samples.letters.shape, psi.value)
        return columns[psi] if psi in columns else truth_along(psi, [along(child) for child in children(psi)])

    return along(phi)[0]


SMALL = formulas(labels=("a",), signals=(), longest=2, max_leaves=4)


@given(SMALL, SMALL)
def test_two_automata_differ_where_some_trace_tells_them_apart(phi, psi):
    letters = [{"a": False}, {"a": True}]
    n_steps = max(stl.horizon(phi), stl.horizon(psi)) + 1
    if n_steps > 6:
        return
    reachable, read = [], []
    for formula in (phi, psi):
        automaton = stl.compile_automaton(formula)
        truth = [[stl.satisfies(atom, {"a": [value]}) for atom in automaton.atoms] for value in (False, True)]
        read.append(automaton.letters_at(np.array(truth, dtype=bool).reshape(2, len(automaton.atoms))))
        reachable.append(ReachableVerdicts(automaton, read[-1], Effort(10**6)))
    one, other = every(phi, letters, n_steps), every(psi, letters, n_steps)
    assert differ(*reachable, *read, Effort(10**6)) == (one != other).any()
    assert [reachable[0].can_become(verdict) for verdict in (0, 1)] == [not one.all(), one.any()]


def test_a_way_that_stays_in_a_state_takes_the_letter_that_keeps_it():
    """State 1 comes from 0 by letter 0 and is kept by letter 1 only; 2 and 4 hold, reached in the last step."""
    automaton = dataclasses.replace(
        stl.compile_automaton(A),
        delta=np.array([[1, 3, 3, 3, 3], [4, 1, 3, 3, 3], [0, 2, 3, 3, 3]], dtype=np.int32),
        horizon=500,
        verdict_starts=np.array([0, 500]),
        verdict_rows=np.array([[-1] * 5, [0, 0, 1, 0, 1]], dtype=np.int8),
    )
    reachable = ReachableVerdicts(automaton, np.arange(3, dtype=np.int32), Effort(10**5))
    word = [letter for letter, count in shortest_run(reachable, 1, Effort(10**5)) for _ in range(count)]
    assert (len(word), automaton.judge(word)) == (501, (True, 500))
    assert shortest_run(reachable, 0, Effort(10**5)) == [(1, 1)]


def test_verdicts_that_fall_late_are_compared_too():
    """Neither automaton sees before its horizon that it has only one verdict to give."""
    letters = np.zeros(2, dtype=np.int32)  # none that matters
    reachable = []
    for text in ("G[0,2] (a -> F[0,2] a)", "F[0,2] (a & G[0,2] !a)"):
        automaton = stl.compile_automaton(stl.parse(text))
        assert (automaton.verdicts(0) == -1).all()
        reachable.append(ReachableVerdicts(automaton, letters, Effort(1000)))
    assert [[one.can_become(verdict) for verdict in (0, 1)] for one in reachable] == [[False, True], [True, False]]
    assert differ(*reachable, letters, letters, Effort(1000))


def test_effort_is_counted():
    effort = Effort(10)
    effort.spend(6)
    effort.spend_cells(3999)
    assert effort.left == 0
    with pytest.raises(SizeError, match="the search exceeds the limit of 10 states"):
        effort.spend(1)
    assert effort.left == 0
    automaton = stl.compile_automaton(stl.parse("G[0,50] (F[0,50] a & F[0,50] b)"))
    letters = np.arange(automaton.n_letters, dtype=np.int32)
    with pytest.raises(SizeError, match="the search exceeds the limit of 100 states times letters"):
        ReachableVerdicts(automaton, letters, Effort(100))
    reachable, few = ReachableVerdicts(automaton, letters, Effort(10**5)), letters % 2
    small = ReachableVerdicts(stl.compile_automaton(stl.parse("a")), few, Effort(100))
    with pytest.raises(SizeError, match="the search exceeds the limit"):
        shortest_run(reachable, 1, Effort(5))
    with pytest.raises(SizeError, match="the search exceeds the limit"):
        differ(reachable, reachable, letters, letters, Effort(100))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stltool.automata.reachable._MOST_PAIRS", 1000)
        with pytest.raises(SizeError, match="two automata with 2602 and 2602 states are too large for a comparison"):
            differ(reachable, reachable, letters, letters, Effort(10**9))
        patch.setattr("stltool.automata.reachable._MOST_PAIRS", 8000)
        with pytest.raises(SizeError, match="the comparison exceeds the limit of 8000 transitions"):
            differ(reachable, small, letters, few, Effort(10**9))
    assert differ(reachable, small, letters, few, Effort(10**6))
