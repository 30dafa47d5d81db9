"""Samples on the border of a comparison: in vectors as one by one, and one by one only where the page says so."""

import math
from contextlib import contextmanager
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import stltool as stl
from stltool.logic.formula import COMPARATORS, Arithmetic, Call, Comparison, Negate, Number, Variable
from stltool.logic.semantics import robustness, satisfies
from stltool.monitoring import borders, comparisons, offline
from stltool.monitoring.borders import differences, in_kernel, judged, possible
from stltool.monitoring.comparisons import Predicate
from stltool.monitoring.doubles import bounded


@contextmanager
def compiled(wanted):
    """Comparisons are judged by the kernel, or in numpy."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (borders, comparisons):
            patch.setattr(module, "COMPILED_FROM", 1 if wanted else 10**9)
        patch.setattr(borders, "_seen", 2**60)
        yield


def polynomials(names="xyz"):
    leaves = st.sampled_from(names).map(Variable) | st.sampled_from([0.0, 0.1, 2.0, 0.25, 3e-7, 1e22]).map(Number)

    def grow(below):
        return st.one_of(
            below.map(Negate),
            st.builds(Arithmetic, st.sampled_from("+-*"), below, below),
            st.builds(Arithmetic, st.just("^"), below, st.sampled_from([1.0, 2.0, 3.0]).map(Number)),
            st.builds(Call, st.just("abs"), st.tuples(below)),
            st.builds(Call, st.sampled_from(["min", "max"]), st.tuples(below, below) | st.tuples(below, below, below)),
        )

    return st.recursive(leaves, grow, max_leaves=5)


def rooted():
    root = st.builds(Call, st.just("sqrt"), st.tuples(polynomials()))
    return st.tuples(root, polynomials()) | st.tuples(polynomials(), root) | st.tuples(polynomials(), polynomials())


decimal = st.builds(lambda n, k: n / 10**k, st.integers(-50, 50), st.integers(0, 3))
double = st.floats(-1e6, 1e6, allow_nan=False)


@given(
    sides=rooted(), op=st.sampled_from(COMPARATORS), samples=st.lists(st.tuples(*[decimal | double] * 3), min_size=1)
)
@example(  # y³ has more places than are computed with
    sides=(Call("sqrt", (Variable("x"),)), Arithmetic("^", Variable("y"), Number(3.0))),
    op=">",
    samples=[(0.25, 1 / 3, 0.0)],
)
@example(sides=(Call("sqrt", (Variable("x"),)), Variable("x")), op="<", samples=[(0.0, 0.0, 0.0)])
def test_every_settled_sample_is_as_in_the_slow_semantics(sides, op, samples):
    node = Comparison(op, *sides)
    if not possible(node) or not Predicate(node).names:
        return
    names = list(Predicate(node).names)
    rows = dict(zip("xyz", np.array(samples).T, strict=True))
    columns = {name: rows[name] for name in names}
    for t in range(len(samples)):
        one = {name: values[t : t + 1] for name, values in columns.items()}
        with np.errstate(all="ignore"):
            sign, margin, settled = differences(node, one, np.array([_apart(node, one)]))
        if settled[0]:
            plain = {name: values.tolist() for name, values in one.items()}
            assert satisfies(node, plain) == {
                "<": sign[0] < 0, "<=": sign[0] <= 0, ">": sign[0] > 0, ">=": sign[0] >= 0, "==": sign[0] == 0,
                "!=": sign[0] != 0,
            }[op]  # fmt: skip
            assert robustness(Comparison(">", *sides), plain) == margin[0]


def _apart(node, one):
    """|left − right| from above: not only of samples on the border."""
    plain = {name: values.tolist() for name, values in one.items()}
    try:
        return abs(robustness(Comparison(">", node.left, node.right), plain)) * (1 + 1e-12)
    except stl.StlToolError:
        return math.inf


@given(
    term=polynomials("xy"),
    root=st.booleans(),
    turned=st.booleans(),
    op=st.sampled_from(COMPARATORS),
    samples=st.lists(
        st.tuples(decimal | double, decimal | double, st.integers(-3, 3) | st.just("rounded")), min_size=1
    ),
)
def test_the_kernel_decides_samples_on_the_border(term, root, turned, op, samples):
    """z is the other side, give or take a few units in the last place; the same as in numpy, bit for bit."""
    side = Call("sqrt", (term,)) if root else term
    node = Comparison(op, Variable("z"), side) if turned else Comparison(op, side, Variable("z"))
    if not possible(node) or not in_kernel(node):
        return
    columns = {name: np.array([sample[i] for sample in samples]) for i, name in enumerate("xy")}
    with np.errstate(all="ignore"):
        value = np.broadcast_to(bounded(side, columns)[0], len(samples))
        steps = [0 if sample[2] == "rounded" else sample[2] for sample in samples]
        z = np.where(
            [sample[2] == "rounded" for sample in samples], np.round(value, 4), value + steps * np.spacing(value)
        )
    defined = np.isfinite(z)
    columns = {name: values[defined] for name, values in {**columns, "z": z}.items()}
    columns = {name: values for name, values in columns.items() if name in Predicate(node).names}
    n = int(defined.sum())
    if n == 0:
        return
    truth, margin = np.empty((1, n), np.bool_), np.empty((1, n))
    with np.errstate(all="ignore"):
        rows = {name: values.reshape(1, n) for name, values in columns.items()}
        left_over = judged(node, rows, truth, margin)
        only = np.empty((1, n), np.bool_)
        left_of_truth = judged(node, rows, only, None)
        left, right, error = Predicate(node)._sides(columns)
    near = ~(np.abs(left - right) > error)
    for t in range(n):
        one = {name: values[t : t + 1].tolist() for name, values in columns.items()}
        if left_of_truth is None or not left_of_truth[0, t]:
            assert only[0, t] == satisfies(node, one)
        if left_over is None or not left_over[0, t]:
            assert truth[0, t] == satisfies(node, one)
            if near[t]:
                assert margin[0, t] == robustness(node, one)
    found = []
    for wanted in (False, True):
        with compiled(wanted), np.errstate(all="ignore"):
            unknown = Predicate(node).judge(rows, truth, margin, False)
            found.append((truth.tobytes(), margin.tobytes(), str(unknown)))
    assert found[0] == found[1]


def borders_of(text, rng, n):
    """Samples of which each is on the text's border, or next to it, computed or measured."""
    x, y = np.round(rng.random((2, n)) * 100 + 0.01, 2)
    k = np.arange(1, n + 1)
    match text:
        case "x + y <= z":
            return x, y, np.round(x + y, 2)
        case "x + y >= z":
            x = x + rng.random(n)
            return x, y, x + y
        case "x * y == z":
            return x, y, np.round(x * y, 4)
        case "2*x - y < z":
            return x, y, 2 * x - y
        case "x^2 + y^2 > z^2" | "sqrt(x^2 + y^2) <= z" | "z >= sqrt(x*x + y*y)":
            return np.round(0.03 * k, 2), np.round(0.04 * k, 2), np.round(0.05 * k, 2) + 0.01 * (k % 5 == 0)
        case "max(x, y + 1) >= z":
            return x, y, np.round(np.maximum(x, y + 1), 2)
        case "min(x, y + 1) <= z":
            return x, y, np.round(np.minimum(x, y + 1), 2)
        case "abs(x - y) != z":
            return x, y, np.round(np.abs(x - y), 2)
    raise AssertionError(text)


TEXTS = (
    "x + y <= z", "x + y >= z", "x * y == z", "2*x - y < z", "x^2 + y^2 > z^2", "sqrt(x^2 + y^2) <= z",
    "z >= sqrt(x*x + y*y)", "max(x, y + 1) >= z", "min(x, y + 1) <= z", "abs(x - y) != z",
)  # fmt: skip


@pytest.mark.parametrize("text", ["sqrt(x^2 + y^2) <= z", "z > sqrt(x^2 + y^2)", "x + y <= z"])
def test_some_samples_of_a_tile_are_near(text):
    """Every third one is far from the border, every fifth of the others a little; none is left over."""
    rng, n = np.random.default_rng(3), 700
    k = rng.integers(1, 1000, n)
    z = np.where(np.arange(n) % 3 == 0, k * 0.9, np.round(k * (0.05 if "sqrt" in text else 0.07), 2))
    z = np.where(np.arange(n) % 5 == 0, np.nextafter(z, 99), z)
    trace = {"x": np.round(k * 0.03, 2), "y": np.round(k * 0.04, 2), "z": z}
    truth, margin = np.empty(n, np.bool_), np.empty(n)
    node = stl.parse(text)
    assert judged(node, {name: trace[name] for name in Predicate(node).names}, truth, margin) is None
    assert truth.tolist() == [satisfies(node, trace, t) for t in range(n)]
    assert margin[np.arange(n) % 3 > 0].tolist() == [robustness(node, trace, t) for t in range(n) if t % 3 > 0]


def test_roots_of_what_is_below_zero_by_less_than_doubles_say():
    for z in (0.0, 1.0):
        with pytest.raises(stl.errors.TraceError, match="no value for the operands"):
            stl.monitor(stl.parse("sqrt(-(x*x)) <= z"), {"x": [0.0, 1e-200], "z": [z, z]})


def test_quotients_of_wide_whole_numbers_are_the_nearest_doubles():
    """Beyond 2^53 a division of doubles would round twice."""
    rng, n = np.random.default_rng(0), 500
    whole, places = rng.integers(-(2**62), 2**62, n) | 1, rng.integers(1, 19, n)
    exact = borders._Exact({"x": np.zeros(n)})
    found = exact.quotient(whole, places)
    assert exact.settled.mean() > 0.99
    for near, w, k in zip(found[exact.settled], whole[exact.settled], places[exact.settled], strict=True):
        assert near == float(Fraction(int(w), 10 ** int(k)))


def test_differences_of_roots_near_the_border_are_the_nearest_doubles():
    """√A − B, where A = B² + D/10^K is decimal; its slow twin has a hundred digits."""
    rng, n = np.random.default_rng(0), 300
    b = rng.integers(10**3, 10**5, n)
    d = (rng.uniform(-1, 1, n) * 2.0**-46 * (b / 100) ** 2 * 10**18).astype(np.int64)
    exact = borders._Exact({"x": np.zeros(n)})
    found = exact.over_sum(d, np.full(n, 18), (b.astype(np.uint64), np.full(n, 2)), b / 100)
    assert exact.settled.mean() > 0.9
    with localcontext(prec=100):
        for near, side, apart in zip(found[exact.settled], b[exact.settled], d[exact.settled], strict=True):
            side = Decimal(int(side)) / 100
            assert near == float((side**2 + Decimal(int(apart)).scaleb(-18)).sqrt() - side)


@pytest.mark.parametrize("text", TEXTS)
@pytest.mark.parametrize("kernel", [False, True])
def test_whole_columns_of_borders(text, kernel, monkeypatch):
    asked = []
    slow = Predicate._settle
    monkeypatch.setattr(Predicate, "_settle", lambda self, *sample: asked.append(sample) or slow(self, *sample))
    n = 400
    trace = dict(zip("xyz", borders_of(text, np.random.default_rng(5), n), strict=True))
    phi = stl.parse(text)
    with compiled(kernel):
        result = stl.monitor(phi, trace, semantics="both")
    assert result.verdicts.tolist() == [satisfies(phi, trace, t) for t in range(n)]
    assert result.robustness.tolist() == pytest.approx([robustness(phi, trace, t) for t in range(n)], rel=1e-12)
    assert len(asked) <= 0.05 * n, len(asked)


@pytest.mark.parametrize("text", [text for text in TEXTS if in_kernel(stl.parse(text))])
@pytest.mark.parametrize("factor", [1.0, 1 / 3])  # a third of them: numbers of many digits, far from a product's border
def test_the_kernel_judges_as_numpy_does(text, factor):
    n, predicate = 600, Predicate(stl.parse(text))  # more than two tiles
    rows = np.array(borders_of(text, np.random.default_rng(6), n)) * factor
    rows[:, 300:420] += 1.0  # of the second tile, not all are near
    columns = {name: values.reshape(2, 300) for name, values in zip("xyz", rows, strict=True)}
    found = []
    for wanted in (False, True):
        padded = np.empty((2, 310), np.bool_), np.empty((2, 310))
        truth, margin = (array[:, :300] for array in padded)
        with compiled(wanted), np.errstate(all="ignore"):
            assert predicate.judge(columns, truth, margin, False) == (None, False)
            found.append((truth.tobytes(), margin.tobytes()))
            for one in ((truth.copy(), None), (None, margin.copy())):
                assert predicate.judge(columns, *one, False) == (None, False)
                assert all(a is None or a.tobytes() == b.tobytes() for a, b in zip(one, (truth, margin), strict=True))
    assert found[0] == found[1]


@pytest.mark.parametrize(
    "text", ["sqrt(x^2 + y^2) <= z", "z > sqrt(x*y + 0.1)", "x^2 - y^2 != z", "x*y > -z", "x*y*w <= z", "w^3 + x >= z"]
)
def test_computed_doubles_are_settled_in_vectors(text, monkeypatch):
    """Of 16 and 17 digits, some in the unit interval, some large, each on the border or a few units beside it."""
    rng, n = np.random.default_rng(8), 600
    x, y = rng.random((2, n)) * 10.0 ** rng.integers(-2, 3, n)
    w = rng.random(n) + 0.1
    right = {
        "sqrt(x^2 + y^2) <= z": np.hypot(x, y),
        "z > sqrt(x*y + 0.1)": np.sqrt(x * y + 0.1),
        "x^2 - y^2 != z": x**2 - y**2,
        "x*y > -z": -x * y,
        "x*y*w <= z": x * y * w,
        "w^3 + x >= z": w**3 + x,
    }[text]
    z = right * (1 + rng.integers(-2, 3, n) * 2.0**-52)
    asked = []
    slow = Predicate._settle
    monkeypatch.setattr(Predicate, "_settle", lambda self, *sample: asked.append(sample) or slow(self, *sample))
    phi, trace = stl.parse(text), {"x": x, "y": y, "z": z, "w": w}
    with compiled(True):
        result = stl.monitor(phi, trace, semantics="both")
    assert len(asked) <= 0.05 * n, len(asked)
    assert result.verdicts.tolist() == [satisfies(phi, trace, t) for t in range(n)]
    margins = [robustness(phi, trace, t) for t in range(n)]
    scale = np.maximum(np.maximum(x, y), w) ** (
        1 if "sqrt" in text else 3 if "w" in text else 2
    )  # margins that are not near 0 are those of doubles
    assert (np.abs(result.robustness - margins) <= 1e-14 * scale).all()
    assert np.sign(result.robustness).tolist() == np.sign(margins).tolist()


@pytest.mark.parametrize("text", ["x + y <= z", "x * y == z"])
@pytest.mark.parametrize("end", ["error", "cut", "hold"])
def test_batches_of_borders(text, end, monkeypatch):
    """Where rows are padded, a comparison's values are not together in memory."""
    phi = stl.parse(f"F[0,3] ({text})")
    trace = dict(zip("xyz", np.array(borders_of(text, np.random.default_rng(7), 60)).reshape(3, 5, 12), strict=True))
    for quickly in (False, True):
        monkeypatch.setattr(offline, "worthwhile", lambda samples, quickly=quickly: quickly)
        found = stl.monitor(phi, trace, end)
        for row in range(5):
            one = {name: values[row].tolist() for name, values in trace.items()}
            one |= {name: [*values, *values[-1:] * 3] for name, values in one.items() if end == "hold"}
            steps = range(9 if end != "hold" else 12)
            assert found.verdicts[row, : len(steps)].tolist() == [satisfies(phi, one, t) for t in steps]
            assert found.robustness[row, : len(steps)].tolist() == [robustness(phi, one, t) for t in steps]


def test_terms_that_are_not_decided_here():
    for text in ("x / y > 1", "x^0.5 > y", "x^y > 1", "sqrt(x) > sqrt(y)", "sqrt(sqrt(x)) > y", "x^9 > y", "x > 1e-60"):
        assert not possible(stl.parse(text)), text
    for text in ("x^8 > y", "sqrt(x) > y + 1", "x + 1e22 > y", "abs(x) + max(x, y, 1) > 0.1"):
        assert possible(stl.parse(text)), text


def test_choices_among_signals_are_plain():
    for text in ("max(x, y) >= x", "abs(x) <= max(x, -x, 1)", "min(x, 3) < -y"):
        assert Predicate(stl.parse(text)).plain, text
    x, y = np.random.default_rng(0).normal(size=(2, 300)).round(1)
    for text in ("max(x, y) >= x", "max(x, y) > x", "abs(x) <= max(x, -x, 0.3)", "min(x, 3) < -y", "abs(-x) == x"):
        phi = stl.parse(text)
        result = stl.monitor(phi, {"x": x, "y": y}, semantics="both")
        assert result.verdicts.tolist() == [satisfies(phi, {"x": x, "y": y}, t) for t in range(300)], text
        online = stl.OnlineMonitor(phi)
        margins = [d.robustness for a, b in zip(x, y, strict=True) for d in online.feed({"x": a, "y": b})]
        assert margins == result.robustness.tolist(), text
