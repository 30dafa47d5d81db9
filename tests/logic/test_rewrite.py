"""Negation normal form and simplification keep truth and robustness, and do what they say."""

import functools
import math
import operator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import ArgumentError, SizeError
from stltool.logic import rewrite
from stltool.logic.formula import (
    FUTURE,
    PAST,
    Always,
    And,
    Comparison,
    Constant,
    Eventually,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Not,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    children,
    is_bounded,
    walk,
    with_children,
)
from stltool.logic.rewrite import negation_normal_form, operator_count, simplify
from stltool.testing import formulas, traces
from stltool.testing.formulas import intervals
from tests.conftest import many

NAMES = {"labels": ("a", "b"), "signals": ("x", "y")}


def alike(longest=3, endless=False):
    """Formulas over few operands and windows, so that the rules have something to join, drop and absorb."""
    leaves = st.sampled_from([stl.parse(t) for t in ("a", "b", "x > 0", "0 < x", "y >= 1", "x == 1", "true", "false")])
    windows = intervals(longest)
    if endless:
        windows |= st.integers(0, 2).map(lambda a: Interval(a, None))

    earlier = intervals(longest) | st.integers(0, 2).map(lambda a: Interval(a, None))

    def grow(below):
        several = st.lists(below, min_size=2, max_size=4).map(tuple)
        return st.one_of(
            several.map(And), several.map(Or), below.map(Not), st.builds(Implies, below, below),
            st.builds(Iff, below, below), st.builds(Eventually, windows, below), st.builds(Always, windows, below),
            st.builds(Until, windows, below, below), st.builds(Release, windows, below, below),
            st.builds(Once, earlier, below), st.builds(Historically, earlier, below), below.map(Rise),
            st.builds(Since, earlier, below, below), st.builds(Trigger, earlier, below, below),
        )  # fmt: skip

    return st.recursive(leaves, grow, max_leaves=9)


def value(phi, trace, t, negate, cut):
    """The slow semantics of any formula, by ¬ alone (`not` for truth, minus for robustness) on a trace of n steps.

    `cut`: windows hold the steps there are, perhaps none. Otherwise the last step is held for ever, and a window
    without an end need not look further than it.
    """
    last = len(trace["x"]) - 1
    bottom, top = (False, True) if negate is operator.not_ else (-math.inf, math.inf)

    def at(psi, t):
        return value(psi, trace, t, negate, cut)

    def window(interval):
        first, end = t + interval.a, last if interval.b is None else t + interval.b
        return range(first, (min(end, last) if cut else max(end, first)) + 1)

    def earlier(interval):
        return range(0 if interval.b is None else max(t - interval.b, 0), t - interval.a + 1)

    match phi:
        case Constant() | Label() | Comparison():
            judge = stl.satisfies if negate is operator.not_ else stl.robustness
            return judge(phi, trace, min(t, last))
        case Not(arg):
            return negate(at(arg, t))
        case And(args):
            return min(at(arg, t) for arg in args)
        case Or(args):
            return max(at(arg, t) for arg in args)
        case Implies(left, right):
            return max(negate(at(left, t)), at(right, t))
        case Iff(left, right):
            return min(max(negate(at(left, t)), at(right, t)), max(at(left, t), negate(at(right, t))))
        case Eventually(interval, arg):
            return max((at(arg, u) for u in window(interval)), default=bottom)
        case Always(interval, arg):
            return min((at(arg, u) for u in window(interval)), default=top)
        case Until(interval, left, right):
            return max(
                (min([at(right, u)] + [at(left, v) for v in range(t, u)]) for u in window(interval)), default=bottom
            )
        case Release(interval, left, right) | Trigger(interval, left, right):
            dual = Until if isinstance(phi, Release) else Since
            return negate(at(dual(interval, Not(left), Not(right)), t))
        case Once(interval, arg):
            return max((at(arg, u) for u in earlier(interval)), default=bottom)
        case Historically(interval, arg):
            return min((at(arg, u) for u in earlier(interval)), default=top)
        case Since(interval, left, right):
            witnesses = (min([at(right, u)] + [at(left, v) for v in range(u + 1, t + 1)]) for u in earlier(interval))
            return max(witnesses, default=bottom)
        case Rise(arg):
            return min(at(arg, t), negate(at(Once(Interval(1, 1), arg), t)))
    raise AssertionError(phi)


def assert_same(left, right, trace, t=0, cut=False):
    for negate in (operator.not_, operator.neg):
        assert value(left, trace, t, negate, cut) == value(right, trace, t, negate, cut)


def is_nnf(phi):
    return all(
        isinstance(node.arg, Label) if isinstance(node, Not) else not isinstance(node, Implies | Iff | Rise)
        for node in walk(phi)
    )


def test_operators_are_counted_as_written():
    counts = {"a": 0, "x > 1": 0, "!a": 1, "a | b | c": 2, "a & b": 1, "a -> b": 1, "F[0,1] a": 1, "a U[0,1] !b": 2}
    assert {text: operator_count(stl.parse(text)) for text in counts} == counts


REWRITINGS = (negation_normal_form, simplify)


@pytest.mark.parametrize("rewrite", REWRITINGS)
@given(phi=alike() | formulas(**NAMES), data=st.data())
@settings(max_examples=many(250))
def test_truth_and_robustness_stay_on_every_trace_that_is_long_enough(rewrite, phi, data):
    new = rewrite(phi)
    t = data.draw(st.integers(0, 2))
    trace = data.draw(traces(t + stl.horizon(phi) + 1, **NAMES))
    assert stl.horizon(new) <= stl.horizon(phi)
    assert stl.satisfies(new, trace, t) == stl.satisfies(phi, trace, t)
    assert stl.robustness(new, trace, t) == stl.robustness(phi, trace, t)


@pytest.mark.parametrize("rewrite", [*REWRITINGS, lambda phi: simplify(phi, cut=True)], ids=["nnf", "held", "cut"])
@given(phi=alike(2, endless=True), data=st.data())
@settings(max_examples=many(150))
def test_windows_without_an_end_and_windows_that_are_cut(rewrite, phi, data):
    new = rewrite(phi)
    trace = data.draw(traces(data.draw(st.integers(1, 3)), **NAMES))
    t = data.draw(st.integers(0, len(trace["x"]) - 1))
    if rewrite is not simplify:
        assert_same(phi, new, trace, t, cut=True)
    assert_same(phi, new, trace, t)
    assert not is_bounded(phi) or is_bounded(new)


@given(phi=alike(endless=True) | formulas(**NAMES))
@settings(max_examples=many(250))
def test_normal_forms_are_normal(phi):
    assert is_nnf(negation_normal_form(phi))
    for cut in (False, True):
        once = simplify(phi, cut)
        assert simplify(once, cut) == once
        assert operator_count(once) <= operator_count(phi)


def formula(text):
    """The formula of a text in which windows to step 99 have no end."""

    def endless(phi):
        new = with_children(phi, tuple(endless(child) for child in children(phi)))
        if isinstance(new, FUTURE + PAST) and not isinstance(new, Rise) and new.interval.b == 99:
            new = type(new)(Interval(new.interval.a, None), *children(new))
        return new

    return endless(stl.parse(text))


def rules(table):
    """The entries of a table of rewritings, each told as `text => what becomes of it`."""
    entries = [entry.strip() for line in table.splitlines() if "=>" in line for entry in line.split(";")]
    return [tuple(entry.split(" => ")) for entry in entries]


SIMPLER = """
    # constants
    !true | a => a  ;  a & false => false  ;  a | b | true => true  ;  true & true => true  ;  true -> a => a
    false -> a => true  ;  a -> true => true  ;  a -> false => !a  ;  x > 0 -> false => x <= 0  ;  a <-> true => a
    false <-> a => !a  ;  F[0,2] false | a => a  ;  F[0,2] true & a => a  ;  G[0,2] (a -> true) => true
    G[0,99] false => false
    # negation
    !!a => a  ;  !(x > 0) => x <= 0  ;  !(x == 0) & !(x != 1) => x != 0 & x == 1
    !(x < 0 & x <= 2) => x >= 0 | x > 2  ;  !(F[0,2] !a) => G[0,2] a  ;  !(G[0,2] x > 0) => F[0,2] (x <= 0)
    !(F[0,2] a) => !(F[0,2] a)  ;  !(!a | !b) => a & b  ;  !(!a & b) => a | !b  ;  !(a & b) => !(a & b)
    !(a & b & !c) => !(a & b & !c)  ;  !(a -> !b) => a & b  ;  !(a -> b) => !(a -> b)  ;  !a -> b => a | b
    x > 0 -> a => x > 0 -> a  ;  !(!a <-> b) => a <-> b  ;  !(a <-> x > 0) => a <-> x <= 0
    !a <-> !b => a <-> b  ;  !a <-> b => !a <-> b  ;  !a <-> x > 0 => a <-> x <= 0
    !(a U[0,2] b) => !(a U[0,2] b)  ;  !(a <-> b) => !(a <-> b)
    G[0,1] a -> !(G[0,1] b) => (G[0,1] a) -> !(G[0,1] b)  ;  !!(G[0,1] a -> !(G[0,1] b)) => !(G[0,1] (a & b))
    !!(G[0,1] x > 0 -> !(G[0,1] y > 0)) => F[0,1] (x <= 0 | y <= 0)
    # operands that repeat, absorb, contradict
    a & (b & a) & (c & b) => a & b & c  ;  a | (b | c) | b => a | b | c  ;  (a & b) | (b & a) => a & b
    x > 0 & 0 < x => x > 0  ;  (a <-> b) | (b <-> a) => a <-> b  ;  (a -> b) & (b -> a) => (a -> b) & (b -> a)
    x > 0 & x >= 0 => x > 0 & x >= 0  ;  x == 1 & 1 == x => x == 1 & 1 == x  ;  a & (b | a) => a
    a | c | (b & a) => a | c  ;  a & (b & a | c) => a & ((b & a) | c)  ;  a & !a & b => false
    F[0,1] a | b | G[0,1] !a => true  ;  x > 0 | x <= 0 => x > 0 | x <= 0  ;  a -> a => true
    x > 0 -> x > 0 => x > 0 -> x > 0  ;  a <-> a => true  ;  a <-> !a => false
    x > 0 <-> x > 0 => x > 0 <-> x > 0  ;  x > 0 <-> x <= 0 => x > 0 <-> x <= 0
    # windows
    F[0,0] G[0,0] a => a  ;  F[0,3] F[1,2] a => F[1,5] a  ;  G[1,3] G[0,99] a => G[1,99] a
    F[0,99] F[2,3] a => F[2,99] a  ;  F[0,3] G[1,2] a => F[0,3] G[1,2] a  ;  F[0,1] a | F[2,3] a => F[0,3] a
    F[0,1] a | F[3,3] a => (F[0,1] a) | (F[3,3] a)  ;  G[2,5] a & G[0,3] a => G[0,5] a
    G[0,1] a & G[4,5] a & G[2,3] a => G[0,5] a  ;  G[0,6] a & G[1,2] a & G[7,7] a => G[0,7] a
    F[0,1] a | F[1,99] a => F[0,99] a  ;  a & G[1,3] a => G[0,3] a  ;  a | F[2,3] a => a | (F[2,3] a)
    F[0,5] a & F[1,2] a => F[1,2] a  ;  F[0,5] a & F[1,6] a => (F[0,5] a) & (F[1,6] a)
    G[1,2] a | G[0,2] a | G[1,5] a => G[1,2] a  ;  F[1,5] a & F[1,2] a & F[1,3] a => F[1,2] a
    a | G[1,99] a => a | (G[1,99] a)  ;  F[0,99] a & F[2,7] a => F[2,7] a  ;  a & F[0,3] a => a
    G[0,2] a & F[0,3] a => G[0,2] a  ;  F[0,2] a | G[0,9] a => F[0,2] a
    F[1,2] a | G[3,9] a => (F[1,2] a) | (G[3,9] a)  ;  F[1,2] a | F[1,2] b | c => (F[1,2] (a | b)) | c
    G[0,99] a & G[0,99] b => G[0,99] (a & b)  ;  F[1,2] a & F[1,2] b => (F[1,2] a) & (F[1,2] b)
    G[1,2] a & G[1,2] (a | b) => G[1,2] a  ;  G[0,2] a & G[0,2] b & G[3,4] (b & a) => G[0,4] (a & b)
    F[0,1] a | F[0,1] !a => true  ;  F[0,1] a & b & F[1,2] a & F[0,3] a => (F[0,1] a) & b & (F[1,2] a)
    (G[0,3] a) & (G[2,5] a) & (G[1,2] G[0,3] a) => G[0,5] a
    (F[0,1] a) & G[1,2] ((F[0,1] a) & b) => (F[0,1] a) & (G[1,2] ((F[0,1] a) & b))
    (G[0,3] b U[0,1] a) & G[1,2] (G[0,3] b U[0,1] a) & c => (G[0,2] ((G[0,3] b) U[0,1] a)) & c
    # until
    a U[0,0] b => b  ;  a U[1,2] false => false  ;  a U[0,2] true => true  ;  true U[1,2] a => F[1,2] a
    false U[0,2] a => a  ;  false U[1,2] a => false  ;  a U[0,3] a => a  ;  true U[1,99] a => F[1,99] a
    a U[0,2] b => a U[0,2] b
"""


def test_what_becomes_of():
    for text, simple in rules(SIMPLER):
        phi, expected = formula(text), formula(simple)
        for cut in (False, True):
            assert simplify(phi, cut) == expected, text


CUT = """
    # only where the windows are there
    !(F[1,2] true) => false => G[1,2] false  ;  F[1,2] true | G[1,2] false => true => true
    F[1,2] true => true => F[1,2] true  ;  G[1,2] false => false => G[1,2] false
    G[2,2] a => F[2,2] a => G[2,2] a  ;  F[2,2] G[0,3] a => G[2,5] a => F[2,2] G[0,3] a
    F[0,3] G[1,1] a => F[1,4] a => F[0,3] G[1,1] a  ;  F[0,99] G[1,1] a => F[1,99] a => F[0,99] G[1,1] a
    F[1,1] a & F[1,1] b => F[1,1] (a & b) => (F[1,1] a) & (F[1,1] b)
    F[1,1] a & G[2,3] a => G[1,3] a => (F[1,1] a) & (G[2,3] a)
    G[1,2] a & F[0,1] a => G[1,2] a => (G[1,2] a) & (F[0,1] a)  ;  a U[2,4] true => G[0,1] a => a U[2,4] true
    a U[2,4] a => G[0,2] a => a U[2,4] a
"""


def test_windows_with_a_step_between_them_are_not_joined():
    for text in ("a | F[2,3] a", "a & G[2,3] a", "(F[0,1] a) | F[3,4] a", "a | once[2,3] a"):
        assert simplify(stl.parse(text)) == stl.parse(text)
    for text, simple in (("a | F[1,3] a", "F[0,3] a"), ("(G[0,1] a) & G[2,4] a", "G[0,4] a")):
        assert simplify(stl.parse(text)) == stl.parse(simple)


@pytest.mark.parametrize(("text", "simple", "when_cut"), rules(CUT))
def test_what_becomes_of_windows_that_may_be_cut(text, simple, when_cut):
    assert simplify(formula(text)) == formula(simple)
    assert simplify(formula(text), cut=True) == formula(when_cut)


NORMAL = """
    !(x >= 0 -> !a) => x >= 0 & a  ;  a -> b => !a | b  ;  !!a & !true => a & false
    !(x != 1 | a) => x == 1 & !a  ;  a <-> b => (!a | b) & (a | !b)  ;  a xor b => (a & !b) | (!a & b)
    !(F[1,2] G[0,99] a) => G[1,2] F[0,99] !a  ;  !(a U[2,3] b) => !a release[2,3] !b  ;  !!(a U[1,3] b) => a U[1,3] b
    !(a release[1,3] !b) => !a U[1,3] b  ;  !(a since[0,3] b) => !a trigger[0,3] !b  ;  !prev a => historically[1,1] !a
    !once[2,3] a => historically[2,3] !a  ;  rise a => a & historically[1,1] !a  ;  !fall a => a | prev !a
    !(a weak_until[1,99] b) => (!a release[1,99] !b) & (F[0,99] !a)
"""


@pytest.mark.parametrize(("text", "normal"), rules(NORMAL))
def test_negation_normal_forms(text, normal):
    assert negation_normal_form(formula(text)) == formula(normal)


def test_nodes_that_survive_keep_their_places():
    phi = stl.parse("!(F[0,3] !alpha) & (beta | !(x > 0)) & true")
    for rewritten in (negation_normal_form(phi), simplify(phi)):
        places = {node.span.text() for node in walk(rewritten) if isinstance(node, Label | Comparison)}
        assert places == {"alpha", "beta", "x > 0"}
    merged = simplify(stl.parse("a & F[0,2] b & G[1,2] c & G[1,2] d"))
    assert [part.span.text() for part in merged.args] == ["a", "F[0,2] b", "G[1,2] c"]
    assert simplify(stl.parse("G[0,5] (a -> b)")).span.text() == "G[0,5] (a -> b)"


def nested(wrap, depth):
    phi = Label("a")
    for i in range(depth):
        phi = wrap(phi, i)
    return phi


@pytest.mark.parametrize(
    "wrap",
    [
        lambda phi, i: Not(And((Label(f"l{i}"), phi))),
        lambda phi, i: Not(Or((stl.parse(f"x > {i}"), phi))),
        lambda phi, i: (Eventually if i % 2 else Always)(Interval(0, i), phi),
        lambda phi, i: Until(Interval(0, 2), phi, Label(f"l{i % 3}")),
        lambda phi, i: Implies(phi, Label(f"l{i}")),
    ],
)
def test_deep_formulas_are_no_trouble(wrap):
    phi = nested(wrap, 99)
    for rewritten in (negation_normal_form(phi), simplify(phi)):
        assert operator_count(rewritten) <= operator_count(phi) + 198


@pytest.mark.soak(only=True)
def test_large_formulas_take_no_time_squared():
    n = 20_000
    labels = [Label(f"l{i}") for i in range(n)]
    assert simplify(And(tuple(labels) * 2)) == And(tuple(labels))
    shrinking = Or(tuple(Always(Interval(n - i, n + i + 1), labels[0]) for i in range(n)))
    assert simplify(shrinking) == shrinking.args[0]
    windows = [(Always if i % 2 else Eventually)(Interval(2 * i, 2 * i), labels[0]) for i in range(n)]
    assert operator_count(simplify(And(tuple(windows)))) == 2 * n - 2
    assert simplify(And(tuple(Eventually(Interval(0, i), labels[0]) for i in range(n)))) == labels[0]


def test_a_negation_is_made_once():
    made = []
    with pytest.MonkeyPatch.context() as patch:
        once = rewrite._Simplifier._negation
        patch.setattr(rewrite._Simplifier, "_negation", lambda self, x, span: made.append(x) or once(self, x, span))
        simplify(nested(lambda phi, i: Not(And((stl.parse(f"x > {i}"), phi if i else stl.parse("y > 0")))), 100))
    assert 100 <= len(made) <= 400


def test_what_doubles_too_often_is_refused():
    with pytest.raises(SizeError, match=r"has 572 operators, over 500: each level of equivalences"):
        negation_normal_form(nested(lambda phi, i: Iff(Label(f"l{i}"), phi), 7), most_operators=500)
    assert operator_count(negation_normal_form(nested(lambda phi, i: Iff(Label(f"l{i}"), phi), 7), 572)) == 572
    with pytest.raises(SizeError, match="over 200000"):
        negation_normal_form(nested(lambda phi, i: Iff(Label(f"l{i}"), phi), 150))
    twelve = nested(lambda phi, i: Iff(Label(f"l{i}"), phi), 12)
    deep = functools.reduce(lambda phi, i: (Eventually if i % 2 else Always)(Interval(0, 1), phi), range(185), twelve)
    with pytest.raises(SizeError, match=r"the negation normal form nests operators 210 deep, over 200"):
        negation_normal_form(deep)
    with pytest.raises(ArgumentError, match="parse it: stl.parse"):
        negation_normal_form("a")
    with pytest.raises(ArgumentError, match="parse it: stl.parse"):
        simplify("a")


@pytest.mark.parametrize(("kind", "dual"), [("U", "release"), ("since", "trigger")])
def test_a_negated_until_or_since_does_not_grow(kind, dual):
    """Until release and trigger were nodes, each negated until doubled its operands."""
    phi = nested(lambda phi, i: stl.parse(f"!(l{i} {kind}[0,2] a)") if not i else Not(with_left(kind, phi)), 80)
    assert operator_count(negation_normal_form(phi)) <= operator_count(phi) + 80
    assert str(negation_normal_form(stl.parse(f"!(a {kind}[1,3] !b)"))) == f"!a {dual}[1,3] b"
    assert str(simplify(stl.parse(f"!(!a {kind}[1,3] !b)"))) == f"a {dual}[1,3] b"


def with_left(kind, phi):
    return (Until if kind == "U" else Since)(Interval(0, 2), phi, Label("b"))


@pytest.mark.parametrize(
    ("text", "simple"),
    [
        ("once[1,2] once[0,3] a", "once[1,5] a"),
        ("historically[0,1] a & historically[2,4] a", "historically[0,4] a"),
        ("once[0,1] a | once[1,inf] a", "once a"),
        ("once[1,2] a & once[1,3] a", "once[1,2] a"),
        ("historically[0,2] a & once[0,1] a", "historically[0,2] a"),
        ("historically[1,2] a & once[1,1] a", "(historically[1,2] a) & (prev a)"),  # no step 1 before: true and false
        ("prev true", "prev true"),  # false at step 0
        ("once true", "true"),
        ("historically[2,3] false", "historically[2,3] false"),  # true before step 2
        ("a since true", "true"),
        ("true since[1,2] a", "once[1,2] a"),
        ("a since[0,3] a", "a"),
        ("a since[1,3] a", "a since[1,3] a"),
        ("rise false", "false"),
        ("rise true", "rise true"),  # true at step 0
        ("!once[0,3] !a", "historically[0,3] a"),
        ("F[1,2] prev a", "F[1,2] prev a"),
    ],
)
def test_windows_of_the_past_are_joined_as_far_as_their_cuts_allow(text, simple):
    assert str(simplify(stl.parse(text))) == simple
