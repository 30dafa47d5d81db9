"""Refusals of formulas and task files: the tables of tests/logic, and files with many faults."""

import contextlib
from pathlib import Path

import stltool as stl
from stltool.logic.quantities import quantity
from tests.conftest import DATA
from tests.golden.capture import refusal, rows
from tests.logic import test_compose, test_expectation, test_fragment, test_language, test_lint, test_parser

TASK = 'model "floor.toml"\nparam T = 10, tau = T/2\nnear := x < 0.5\npatrolling := G[0,T) F[0,tau) near\n'

# text of a task file, and what it is read with
FILES = [
    ("", {}),
    (TASK, {"params": {"tua": 3}}),
    (TASK, {"params": {"T": "many"}}),
    (TASK, {"params": {"T": float("nan")}}),
    (TASK, {"params": {"T": "3s"}}),
    (TASK, {"task": "patroling"}),
    ("step = 0.5s\nparam d = 3s\nr := F[0,d] A", {"params": {"d": 3}}),
    ("param t1=1\nparam t1=2\nr := F[0,t1] A", {}),
    ("param inf = 3\nr := F[0,inf] a", {}),
    ('model "floor.toml\na := (b & F[0,3] c\nd := G[0,2 a\n', {}),
    ("".join(f"a{i} := F[2,1] A\n" for i in range(40)), {}),
    ("x = 0.1s\nr := A", {}),
    ("r := A", {"step": "3"}),
    ("param T = 10, T = 11\nnear := x <\nr := F[0,T] near\ns := F[0,tau] A & § B\nq := G[5,3] (A & near)\n", {}),
]


def entries():
    for text, *_ in test_parser.REFUSED:
        yield given("formula", text), refusal(stl.parse, text)
    for text in ("!" * 5000 + "a", "   ", "# a comment alone", "a & " * 600_000, "always a", "a until b", "F(2,inf] a"):
        yield given("formula", text), refusal(stl.parse, text)
    for text, params in (("G[0,5] (x > y)", {"G": 3}), ("F[0,5] a", {"Q": 3})):
        yield given(f"formula with {params}", text), refusal(stl.parse, text, params)
    for table in (rows(test_parser.test_a_task_file_with_a_slip_is_refused), test_language.REFUSED):
        for text, *_ in table:
            yield given("task file", text), refusal(stl.parse_task, text)
    for line, *_ in rows(test_expectation.test_a_slip_is_refused_with_its_place_and_a_remedy):
        yield given("expectation", line), refusal(stl.parse_task, f"r := a\n{line}")
    for text, options in FILES:
        step = {"step": options.pop("step")} if "step" in options else {}
        read = stl.parse if step else stl.parse_task
        yield given(f"task file with {options | step}", text), refusal(read, text, **options, **step)
        options |= step
    for dialect in sorted((DATA / "dialects").iterdir()):
        if dialect.suffix == ".stl":
            with contextlib.suppress(AssertionError):
                yield f"task file {dialect.name}", refusal(stl.parse_task, dialect.read_text(encoding="utf-8"))
    for text, _ in rows(test_language.test_durations_with_a_number_that_is_none):
        yield given("time", text), refusal(quantity, "tau", text)
    for data in (b"\x89PNG\r\n\x1a\n\0\0\0", b"a := \xff\xfe b"):
        Path("task.stl").write_bytes(data)
        yield f"file {data!r}", refusal(stl.load_task, "task.stl")
    yield "no file", refusal(stl.load_task, "none.stl")
    yield "a folder", refusal(stl.load_task, ".")
    for text, *_ in rows(test_fragment.test_a_refusal_names_the_sub_formula_at_fault):
        yield given("fragment", text), refusal(stl.check_fragment, stl.parse(text))
    for number, (slip, _) in enumerate(rows(test_compose.test_slips_are_refused_with_a_sentence), start=1):
        yield f"composed {number}", refusal(slip)
    yield from warnings()


def warnings():
    """What could be read in two ways."""
    texts = [f"r := {text}" for text, _ in rows(test_lint.test_an_ambiguous_text_is_told_with_its_reading)]
    lines = [line for line, _ in rows(test_expectation.test_what_is_suspicious_is_told)]
    texts += [f"param p = 0\npatrolling := F[0,3] A\n{line}" for line in lines]
    for text in (*texts, "r := x > 5 // 2\n", "signal speed\nr := speeed > 3", "patrolling := A\nr := patroling"):
        yield given("ambiguities", text), "\n".join(map(str, stl.ambiguities(stl.parse_task(text))))


def given(what, text):
    shown = text if len(text) < 400 else f"{text[:60]} … {len(text)} characters"
    return f"{what}: {shown}" if "\n" not in shown else f"{what}:\n{shown}".rstrip()
