"""Texts whose plain numbers are seconds, read with lines for step and unit, against their seconds taken literally."""

import math
import operator
import re
import tomllib
from bisect import bisect_left, bisect_right
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.logic.formula import Composable, variables
from stltool.logic.printer import with_names
from stltool.logic.syntax import bare, branches, read
from stltool.source import Source
from tests.conftest import DATA, OUTSIDE, needs_outside

COMPARE = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
COMPUTE = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}
CALL = {"abs": abs, "min": min, "max": max}
STEPS = 60


class Missing(Exception):
    """A sample that the trace does not have."""


class Literal:
    """The definitions of a text on a trace whose samples have times in seconds; windows are cut at its end."""

    def __init__(self, text, samples, step):
        trees = read(Source("text", text), "task").trees
        params = [part for tree in trees if tree.data == "params" for part in branches(tree)]
        self.params = {}
        for part in params:
            self.params[str(part.children[0])] = self.number(part.children[1])
        self.definitions = {str(t.children[0]): branches(t.children[1])[0] for t in trees if t.data == "definition"}
        self.samples = samples
        self.times = [i * step for i in range(STEPS)]
        self.at = {time: i for i, time in enumerate(self.times)}
        self.known = {}

    def number(self, tree):
        """A constant."""
        tree = bare(tree)
        match tree.data:
            case "number":
                return Fraction(str(tree.children[0]))
            case "name":
                return self.params[str(tree.children[0])]
            case "negate":
                return -self.number(tree.children[0])
            case "binary":
                left, op, right = tree.children
                return COMPUTE[str(op)](self.number(left), self.number(right))
        raise AssertionError(tree.data)

    def value(self, tree, i):
        """A term at sample i."""
        tree = bare(tree)
        match tree.data:
            case "number":
                return self.number(tree)
            case "negate":
                return -self.value(tree.children[0], i)
            case "binary":
                left, op, right = tree.children
                return COMPUTE[str(op)](self.value(left, i), self.value(right, i))
            case "call":
                return CALL[str(tree.children[0])](*(self.value(part, i) for part in branches(tree)[1:]))
        name = str(tree.children[0])
        if tree.data == "sample":
            index = bare(tree.children[1])
            shift = Fraction(0)
            if index.data == "binary":
                _, op, seconds = index.children
                shift = COMPUTE[str(op)](Fraction(0), self.number(seconds))
            if self.times[i] + shift not in self.at:
                raise Missing
            return self.samples[name][self.at[self.times[i] + shift]]
        if name in self.params:
            return self.params[name]
        return self.value(self.definitions[name], i) if name in self.definitions else self.samples[name][i]

    def window(self, tree, i):
        """The samples in the interval of an operator, from sample i."""
        interval = next((part for part in branches(tree) if part.data == "interval"), None)
        if interval is None:
            return range(i, STEPS)
        _, lower, upper, _ = interval.children
        first = bisect_left(self.times, self.times[i] + self.number(lower))
        return range(first, bisect_right(self.times, self.times[i] + self.number(upper)))

    def holds(self, tree, i):
        tree = bare(tree)
        key = id(tree), i
        if key not in self.known:
            self.known[key] = self._holds(tree, i)
        return self.known[key]

    def _holds(self, tree, i):
        parts = branches(tree)
        match tree.data:
            case "name":
                return self.holds(self.definitions[str(parts[0])], i)
            case "comparison":
                try:
                    return COMPARE[str(parts[1])](self.value(parts[0], i), self.value(parts[2], i))
                except Missing:
                    return False
            case "not":
                return not self.holds(parts[0], i)
            case "and":
                return all(self.holds(part, i) for part in parts)
            case "or":
                return any(self.holds(part, i) for part in parts)
            case "implies":
                return not self.holds(parts[0], i) or self.holds(parts[1], i)
            case "eventually":
                return any(self.holds(parts[-1], j) for j in self.window(tree, i))
            case "always":
                return all(self.holds(parts[-1], j) for j in self.window(tree, i))
            case "until":
                return any(
                    self.holds(parts[-1], j) and all(self.holds(parts[0], k) for k in range(i, j))
                    for j in self.window(tree, i)
                )
        raise AssertionError(tree.data)


def a_trace(names, text, rng):
    """Samples near the numbers of the text, which stay for some steps."""
    numbers = sorted({Fraction(n) for n in re.findall(r"\d+\.?\d*(?:e-?\d+)?|\.\d+", text)})
    near = [n + d for n in numbers for d in (-1, Fraction(-1, 100), 0, Fraction(1, 100), 1)]
    trace = {}
    for name in names:
        few, samples = rng.choice(len(near), size=3), []
        for _ in range(STEPS):
            stays = bool(samples) and rng.random() < 0.7
            samples.append(samples[-1] if stays else near[few[rng.integers(3)]])
        trace[name] = samples
    return trace


def compare(text, step):
    """Whether each definition holds at each sample, as monitored and literally; the verdicts found."""
    found = set()
    rng = np.random.default_rng(len(text))
    task = stl.parse_task(f"step = {float(step)}s\nunit = s\n{text}", unbounded=True)
    formulas = {name: phi for name, phi in task.definitions.items() if isinstance(phi, Composable)}
    names = sorted({name for phi in formulas.values() for name in variables(phi)})
    trace = a_trace(names, text, rng)
    literal = Literal(text, trace, step)
    signals = {name: np.array(samples, dtype=float) for name, samples in trace.items()}
    for name, phi in formulas.items():
        verdicts = stl.monitor(phi, signals, end="cut", semantics="boolean").verdicts.tolist()
        assert verdicts == [literal.holds(literal.definitions[name], i) for i in range(STEPS)], name
        found |= set(verdicts)
    return found


@pytest.mark.parametrize(
    ("name", "step"),
    [("boiler", "0.5"), ("lift", "0.05"), ("patterns", "0.05"), ("pendulum", "10"), ("pendulum", "2.5")],
)
def test_files_in_the_dialects_of_breach_and_rlrom(name, step):
    assert compare((DATA / "dialects" / f"{name}.stl").read_text(), Fraction(step)) == {True, False}


STEP_OF = {
    "breach/AFC_simple_spec": "0.5", "breach/Autotrans_spec": "0.01", "breach/stlib": "0.01", "rlrom/cartpole": "10",
    "rlrom/minigrid": "50",
}  # fmt: skip
NO_SECONDS = {"AT5_g1 [FalStar, discrete]": "its `next` is one step, whatever that is in seconds"}


@needs_outside("stl")
def test_every_file_of_breach_and_rlrom_is_read():
    found = [path for path in (OUTSIDE / "stl").rglob("*") if path.is_file() and path.parent != OUTSIDE / "stl"]
    assert {path.relative_to(OUTSIDE / "stl").as_posix() for path in found} == {f"{name}.stl" for name in STEP_OF}


@needs_outside("stl")
@pytest.mark.parametrize(("name", "step"), STEP_OF.items())
def test_files_of_breach_and_rlrom(name, step):
    assert compare((OUTSIDE / "stl" / f"{name}.stl").read_text(), Fraction(step)) == {True, False}


def bounds_step(text):
    """The longest step of which all bounds are multiples."""
    bounds = [Fraction(bound) for pair in re.findall(r"\[([\d.]+),([\d.]+)\]", text) for bound in pair]
    one = math.lcm(*(bound.denominator for bound in bounds))
    return Fraction(math.gcd(*(int(bound * one) for bound in bounds)), one)


def test_the_requirements_of_arch_comp():
    listed = tomllib.loads((DATA / "arch-comp.toml").read_text())["requirement"]
    texts = [re.sub(r"(\d)s\b", r"\1", one["formula"]) for one in listed if not one.get("next")]
    assert len(texts) == 24
    assert set().union(*(compare(f"r := {text}", bounds_step(text)) for text in texts)) == {True, False}


@needs_outside("stl")
def test_the_requirements_of_arch_comp_as_transcribed():
    rows = [line.split(" ; ") for line in (OUTSIDE / "stl" / "arch_comp_neutral.txt").read_text().splitlines()
            if not line.startswith("#")]  # fmt: skip
    names = [name for name, *_ in rows]
    assert len(names) == len(set(names)) == 25
    assert set(NO_SECONDS) < set(names)
    texts = [formula for name, formula, *_ in rows if name not in NO_SECONDS]
    assert set().union(*(compare(f"r := {text}", bounds_step(text)) for text in texts)) == {True, False}


def test_formulas_are_written_with_their_definitions_and_times():
    task = stl.parse_task("step = 0.5s\nunit = s\nhold := G[0,1] a & x > 0\nr := F[0,3] hold | once[1,2] b -> !hold")
    text = with_names({"hold": task.formulas["hold"]}, task.ticks)
    assert text(task.formula) == "((F[0,3s] hold) | (once[1s,2s] b)) -> !hold"
    assert text(stl.parse("true & b U[0,1] (rise c)")) == "true & (b U[0,0.5s] (rise c))"
    assert text(stl.parse("once b", unbounded=True)) == "once[0,inf) b"
