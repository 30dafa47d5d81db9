"""The widths of integers at their borders: what does not fit is wider, or refused, and never wraps."""

import math
import subprocess
import sys
import tempfile
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

import stltool as stl
from stltool import sizes
from stltool.automata import TRUE
from stltool.automata.samples import truth_along
from stltool.checking.induction import Game, layers_of
from stltool.errors import SizeError
from stltool.learning.problem import Problem
from stltool.learning.tables import Entries
from stltool.logic.formula import Always, And, Eventually, Interval, Label, Or
from stltool.product import joined
from stltool.sizes import integer_type, require_numbered
from tests.conftest import FACTORY
from tests.sources import sources

MOST = 2**31 - 2


@pytest.mark.parametrize(
    ("largest", "expected"),
    [
        (0, np.int16), (2**15 - 1, np.int16), (2**15, np.int32), (2**31 - 1, np.int32), (2**31, np.int64),
        (2**63 - 1, np.int64),
    ],
)  # fmt: skip
def test_a_type_holds_its_largest_number_and_minus_one(largest, expected):
    assert integer_type(largest) is expected
    assert np.array([largest, -1], dtype=expected).tolist() == [largest, -1]


def test_more_than_can_be_numbered_is_refused():
    require_numbered(MOST, "states", "take fewer")
    with pytest.raises(
        SizeError, match=r"2147483647 states are more than can be numbered \(at most 2147483646\); take"
    ):
        require_numbered(MOST + 1, "states", "take fewer")


def test_the_last_number_and_the_number_of_all_with_one_more_are_int32():
    assert np.array([MOST - 1, MOST, MOST + 1]).astype(np.int32).tolist() == [MOST - 1, MOST, MOST + 1]


# ------------------------------------------------------------------------------------------ all that is numbered


def line(n):
    """A walk along n states, with labels at its ends."""
    matrix = sparse.csr_array(np.roll(np.eye(n), 1, axis=1))
    return {"transitions": [matrix], "signals": {}, "labels": {"A": np.arange(n) == 0, "B": np.arange(n) == n - 1}}


def from_intervals(n):
    given = line(n)
    matrices = given.pop("transitions")
    return stl.MDP.from_intervals(matrices, matrices, **given)


def explicit(n):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "walk.tra")
        path.write_text(f"{n} {n}\n" + "".join(f"{s} {(s + 1) % n} 1\n" for s in range(n)))
        return stl.load_model(path)


def grid(n):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "floor.toml")
        path.write_text(f'kind = "grid"\nmap = """\nS{"." * (n - 1)}\n"""\n')
        return stl.load_model(path)


MODELS = {
    "arrays": lambda n: stl.MDP.from_arrays(**line(n)),
    "intervals": from_intervals,
    "explicit": explicit,
    "grid": grid,
    "black box": lambda n: stl.MDP.black_box(n, 1, lambda rng: None),
    "actions": lambda n: stl.MDP.from_arrays([np.eye(1)] * n, {}),
}


@pytest.mark.parametrize("model", MODELS)
def test_a_model_is_refused_beyond_what_can_be_numbered(monkeypatch, model):
    monkeypatch.setattr(sizes, "_MOST_NUMBERED", 20)
    MODELS[model](20)
    with pytest.raises(SizeError, match=r"21 .* more than can be numbered \(at most 20\)"):
        MODELS[model](21)


def automaton(text, encoding):
    """The size of a task's automaton, and what makes it."""

    def build():
        return stl.build_product(stl.MDP.from_arrays(**line(4)), stl.parse(text), encoding)

    return build().automaton.n_states, build


def joint():
    def build():
        tasks = {"one": stl.parse("F[0,3] A"), "two": stl.parse("G[0,4] F[0,2] B")}
        return stl.build_joint_product(stl.MDP.from_arrays(**line(4)), tasks)

    return build().automaton.n_states, build


def policys_memory():
    """A policy with flags, judged on the exact automaton."""
    model = stl.MDP.from_arrays(**line(4))
    exact, flags = (stl.build_product(model, stl.parse("F[0,9] (G[0,4] A & G[0,4] B)"), e) for e in ("exact", "paper"))
    return joined(exact, flags)[0].automaton.n_states, lambda: joined(exact, flags)


def parts():
    """The exact automaton of two watches, multiplied before it is minimised."""
    _, build = automaton("G[0,9] ((F[0,3] A) & (F[0,5] B))", "exact")
    return math.prod(part.states for part in build().automaton.parts), build


def entries():
    model = stl.MDP.from_arrays(**line(4))
    product = stl.build_product(model, stl.parse("G[0,4] F[0,2] B"))
    return Entries(Problem.of(product)).E, lambda: stl.learn(product, "cfer", episodes=1, seed=0)


AUTOMATA = {
    "flags": lambda: automaton("F[0,9] (G[0,4] A & G[0,4] B)", "paper"),
    "histories": lambda: automaton("F[0,9] (G[0,4] A & G[0,4] B)", "history"),
    "joint": joint,
    "a policy's memory": policys_memory,
    "parts": parts,
    "entries": entries,
}


@pytest.mark.parametrize("what", AUTOMATA)
def test_memory_is_refused_beyond_what_can_be_numbered(monkeypatch, what):
    size, build = AUTOMATA[what]()
    monkeypatch.setattr(sizes, "_MOST_NUMBERED", size)
    build()
    monkeypatch.setattr(sizes, "_MOST_NUMBERED", size - 1)
    with pytest.raises(SizeError, match="more than can be numbered"):
        build()


@pytest.mark.parametrize("method", ["cfer", "naive", "naive-er"])
def test_tables_that_would_not_fit_are_refused_before_memory_is_taken(monkeypatch, method):
    """With the way out, which works."""
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 10, "tau": 10})
    product = stl.build_product(stl.load_model(FACTORY / "floor-5x5.toml"), task)
    most = 900_000  # bytes; each table takes 1.1 million
    monkeypatch.setattr(sizes, "_LITTLE", 0)
    monkeypatch.setattr(sizes, "memory_limit", lambda given: most)
    assert stl.learn(product, "model-based", episodes=1).episodes == 1
    tracemalloc.start()
    with pytest.raises(SizeError, match=r"Q-tables? of 18 × 9 × \d+ entries, .* use model-based, which needs no table"):
        stl.learn(product, method, episodes=1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < most


# ---------------------------------------------------------------------------------------------------- counts, steps


@pytest.mark.parametrize("n", [2**15 - 1, 2**15, 2**16, 2**16 + 1])
def test_operands_are_counted_whatever_their_number(n):
    """65536 that hold would be none in int16."""
    labels = tuple(Label(f"a{i}") for i in range(n))
    holds, fails = np.ones((1, 1), dtype=np.bool_), np.zeros((1, 1), dtype=np.bool_)
    assert truth_along(And(labels), [holds] * n).all()
    assert not truth_along(And(labels), [holds] * (n - 1) + [fails]).any()
    assert truth_along(Or(labels), [holds] * n).all()
    assert not truth_along(Or(labels), [fails] * n).any()


@pytest.mark.parametrize("last", [2**15 - 2, 2**15 - 1, 2**31 - 2, 2**31 - 1, 2**40])
def test_steps_of_any_horizon(last):
    product = stl.build_product(stl.MDP.from_arrays(**line(4)), stl.parse(f"F[0,{last}] B"))
    assert layers_of(Game.of(product), TRUE).reached.last == 2
    late = replace(product, model=stl.MDP.from_arrays([np.eye(4)], {}, labels=product.model.labels))
    assert layers_of(Game.of(late), TRUE).reached.last == last - 1  # A for ever
    assert stl.check(late).probability == 0


# ------------------------------------------------------------------------------------- integers that a caller brings


def test_what_the_doors_make_of_an_integer_is_used():
    """`whole` returns an int: whoever goes on with what was given goes on with an int8, say."""
    thrown_away = [
        f"{path}, line {line}"
        for path, source in sources().items()
        for line, function in source.statements
        if function == "whole"
    ]
    assert not thrown_away


@pytest.fixture(scope="module")
def product():
    return stl.build_product(stl.MDP.from_arrays(**line(4)), stl.parse("G[0,4] F[0,2] B"))


WINDOW = stl.parse("F[100,120] A")
TRACE = {"A": np.arange(300) == 210}
QUESTIONS = {
    "satisfies": lambda product, n: stl.satisfies(WINDOW, TRACE, n),
    "robustness": lambda product, n: stl.robustness(WINDOW, TRACE, n),
    "horizon": lambda product, n: stl.horizon(Always(Interval(n, n), Eventually(Interval(n, n), Label("A")))),
    "likely_runs": lambda product, n: stl.likely_runs(product, satisfied=True, count=n).runs,
    "estimate": lambda product, n: (stl.estimate(product, stl.check(product).policy, runs=n, seed=n)).satisfied,
    "sprt": lambda product, n: stl.sprt(product, stl.check(product).policy, 0.5, most_runs=n, seed=n).runs,
    "learn": lambda product, n: stl.learn(product, "cfer", episodes=n, most_steps=n, evaluate_every=n, seed=n).history,
    "black_box": lambda product, n: stl.MDP.black_box(n, n, lambda rng: None).n_choices,
    "check": lambda product, n: stl.check(stl.build_product(product.model, WINDOW, most_states=n)).probability,
}


@pytest.mark.parametrize("question", QUESTIONS)
@pytest.mark.parametrize("kind", [np.int8, np.uint8])
def test_narrow_integers_are_taken_for_what_they_are(product, question, kind):
    """100 and 120 make 220, which is -36 in int8."""
    ask = QUESTIONS[question]
    assert ask(product, kind(100)) == ask(product, 100)


# --------------------------------------------------------------------------------- limits of the operating system


def test_an_address_space_limit_is_the_memory_there_is():
    """In a process of its own, which takes what it may and is refused a little more."""
    code = """
import resource, psutil, stltool as stl
from stltool import sizes
resource.setrlimit(resource.RLIMIT_AS, (psutil.Process().memory_info().vms + 50_000_000, resource.RLIM_INFINITY))
print(sizes.memory_limit())
try:
    sizes.require_memory(60e6, "this", "take less")
except stl.StlToolError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    limit, message = done.stdout.splitlines()
    assert 30_000_000 < int(limit) <= 40_000_000
    assert message.startswith("this would take 60 MB of memory;")


def test_a_containers_limit_is_the_memory_there_is(tmp_path, monkeypatch):
    group = tmp_path / "outer" / "inner"
    group.mkdir(parents=True)
    (tmp_path / "outer" / "memory.max").write_text("1000\n")
    (tmp_path / "outer" / "memory.current").write_text("400\n")
    for most, left in (("max", [600]), ("700", [300, 600]), ("nonsense", [600])):
        (group / "memory.max").write_text(most)
        (group / "memory.current").write_text("400")
        with monkeypatch.context() as patch:
            patch.setattr(Path, "read_text", reading_group("/outer/inner", Path.read_text))
            assert sizes._left_by_container(tmp_path) == left
    assert sizes._left_by_container(tmp_path / "none") == []


def reading_group(name, read):
    return lambda path, *given: f"1:x:/\n0::{name}\n" if str(path) == "/proc/self/cgroup" else read(path, *given)
