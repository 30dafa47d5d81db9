"""Random faults in a room of stltool, one at a time, and whether the room's quick tests find them (bench/mutants.md).

    pip install coverage
    python bench/mutants.py logic --count 300 --out out/mutants

works in a copy. First the room's tests run once, to learn which of them execute which line, and how long each takes.
Then each fault runs the tests that execute its line, the shortest first, until one fails. A fault is an exchanged
comparison or operator, a negated condition, a number that is one more, a statement left out, min for max, any for all.
Faults in texts of messages, in annotations and in `repr` are not made.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import resource
import shutil
import sys
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
COPIED = ("stltool", "grammars", "tests", "examples", "docs", "bench", "pyproject.toml", "README.md")
QUIET = ("-W", "ignore::pytest.PytestAssertRewriteWarning")  # Hypothesis is imported before pytest begins
MOST_SECONDS = 15.0  # of tests for one fault, unless asked otherwise
LONGEST = 3.0  # of one test
OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Add, ast.FloorDiv: ast.Mult, ast.Div: ast.Mult, ast.Mod: ast.Add, ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd, ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
NAMES = {"min": "max", "max": "min", "any": "all", "all": "any"}


@dataclass
class Fault:
    """A place in a file, and what stands there instead."""

    file: str
    line: int
    before: str
    after: str
    start: int
    stop: int


def faults_of(copy: Path, path: Path) -> Iterator[Fault]:
    """Every fault of a file of the copy; positions are in bytes."""
    text = path.read_text(encoding="utf-8")
    starts = [0]
    for line in text.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def fault(node: Any, after: str) -> Fault:
        start = starts[node.lineno - 1] + node.col_offset
        stop = starts[node.end_lineno - 1] + node.end_col_offset
        before = text.encode()[start:stop].decode()
        return Fault(str(path.relative_to(copy)), node.lineno, before, after, start, stop)

    def changed(node: Any, field: str, value: Any) -> str:
        old = getattr(node, field)
        setattr(node, field, value)
        try:
            return f"({ast.unparse(node)})"
        finally:
            setattr(node, field, old)

    stack: list[ast.AST] = [ast.parse(text)]
    while stack:
        node = stack.pop()
        match node:
            case (
                ast.Raise()
                | ast.JoinedStr()
                | ast.Assert()
                | ast.Import()
                | ast.ImportFrom()
                | ast.AnnAssign(value=None)
            ):
                continue
            case ast.FunctionDef(name=name) if name in ("_card", "__repr__", "__str__"):
                continue
            case ast.FunctionDef():
                stack += [*node.body, *node.args.defaults, *(one for one in node.args.kw_defaults if one is not None)]
                continue
            case ast.AnnAssign(value=value):
                stack.append(value)  # type: ignore[arg-type]
                continue
            case ast.Compare(ops=[op]) if type(op) in OPERATORS:
                yield fault(node, changed(node, "ops", [OPERATORS[type(op)]()]))
            case ast.BoolOp(op=op) | ast.BinOp(op=op) if type(op) in OPERATORS:
                yield fault(node, changed(node, "op", OPERATORS[type(op)]()))
            case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
                yield fault(node, f"({ast.unparse(operand)})")
            case ast.Constant(value=bool() as value):
                yield fault(node, str(not value))
            case ast.Constant(value=int() as value):
                yield fault(node, str(value + 1))
            case ast.Call(func=ast.Name(id=name)) if name in NAMES:
                yield fault(node.func, NAMES[name])
            case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
                yield fault(test, f"(not ({ast.unparse(test)}))")
            case ast.AugAssign() | ast.Expr(value=ast.Call()) | ast.Continue() | ast.Break():
                yield fault(node, "pass")
        stack += ast.iter_child_nodes(node)


def preload() -> None:
    """What every process needs, once; nothing of stltool."""
    import hypothesis.stateful
    import lark
    import numba
    import numpy
    import pytest
    import scipy.sparse

    assert all((hypothesis, lark, numba, numpy, pytest, scipy))


def child(copy: Path, log: Path, seconds: float, run: Any) -> int | None:
    """The exit code of run() in a process of its own; None if it took too long."""
    pid = os.fork()
    if not pid:
        log.parent.mkdir(parents=True, exist_ok=True)
        out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(out, 1)
        os.dup2(out, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 5))
        os.environ.update(STLTOOL_MORE="0.1", HYPOTHESIS_PROFILE="ci", PYTHONPATH=str(copy))
        os.chdir(copy)
        sys.path.insert(0, str(copy))
        code = 99
        try:
            code = int(run())
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    _, status = os.waitpid(pid, 0)
    return os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else None


def surveyed(
    copy: Path, room: str, out: Path, tests: list[str]
) -> tuple[dict[str, dict[int, list[str]]], dict[str, float]]:
    """Which tests execute which line of which file, and the seconds that each takes."""
    kept = out / f"{room}.covered.json"
    if not kept.exists():

        def run() -> int:
            import coverage
            import pytest

            taken: dict[str, float] = {}
            watch = coverage.Coverage(data_file=None, source_pkgs=["stltool"], config_file=False)

            class Watching:
                @pytest.hookimpl(wrapper=True)
                def pytest_runtest_protocol(self, item: Any) -> Any:
                    watch.switch_context(item.nodeid)
                    start = time.process_time()
                    result = yield
                    taken[item.nodeid] = time.process_time() - start
                    return result

            watch.start()
            code = pytest.main(
                ["-q", "-n", "0", "-p", "no:cacheprovider", "-m", "not slow", *QUIET, *tests], [Watching()]
            )
            watch.stop()
            data, found = watch.get_data(), {}
            for file in data.measured_files():
                if f"/stltool/{room}/" in file:
                    found[file.rpartition("/stltool/")[2]] = data.contexts_by_lineno(file)
            kept.write_text(json.dumps([found, taken]), encoding="utf-8")
            return int(code)

        child(copy, out / f"{room}.survey.log", 3000, run)
    found, taken = json.loads(kept.read_text(encoding="utf-8"))
    lines = {file: {int(line): tests for line, tests in rows.items()} for file, rows in found.items()}
    return lines, taken


def chosen(fault: Fault, lines: dict[str, dict[int, list[str]]], taken: dict[str, float], seconds: float) -> list[str]:
    """The tests that execute the fault's line, shortest first; of a line outside functions, those of the file."""
    rows = lines.get(fault.file.removeprefix("stltool/"), {})
    tests = {test for test in rows.get(fault.line, []) if test in taken}
    if not tests and "" in rows.get(fault.line, []):
        tests = {test for row in rows.values() for test in row if test in taken}
    picked, total = [], 0.0
    for test in sorted(tests, key=lambda test: taken[test]):
        if taken[test] > LONGEST or total + taken[test] > seconds:
            break
        picked.append(test)
        total += taken[test]
    return picked


def tried(copy: Path, fault: Fault, tests: Sequence[str], log: Path, seconds: float = 4 * MOST_SECONDS) -> str:
    """killed, survived, timeout, or not imported: the fault is noticed before any test runs."""
    file = copy / fault.file
    data, times = file.read_bytes(), file.stat()
    file.write_bytes(data[: fault.start] + fault.after.encode() + data[fault.stop :])

    def run() -> int:
        import pytest

        sys.dont_write_bytecode = True
        return int(pytest.main(["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--tb=line", *QUIET, *tests]))

    try:
        code = child(copy, log, seconds, run)
    finally:
        file.write_bytes(data)
        os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert code not in (5, 99), log.read_text(encoding="utf-8")[-2000:]  # no tests; none could be run
    known = {None: "timeout", 0: "survived", 1: "killed"}
    return known.get(code, "not imported")


def again(copy: Path, room: str, out: Path, lines: dict[str, dict[int, list[str]]], taken: dict[str, float]) -> None:
    """Run the slow tests next to those that a fault survived."""
    done = out / f"{room}.again.jsonl"
    before = set(done.read_text(encoding="utf-8").splitlines()) if done.exists() else set()
    known = {(one["file"], one["start"], one["after"]) for one in map(json.loads, before)}
    for text in (out / f"{room}.jsonl").read_text(encoding="utf-8").splitlines():
        row = json.loads(text)
        fault = Fault(**{key: row[key] for key in Fault.__annotations__})
        if row["outcome"] != "survived" or (fault.file, fault.start, fault.after) in known:
            continue
        files = {test.partition("::")[0] for test in lines[fault.file.removeprefix("stltool/")].get(fault.line, [])}
        tests = sorted(file for file in files if file) or [f"tests/{room}"]
        outcome = tried(copy, fault, ["-m", "slow", *tests], out / "again.log", 300)
        with done.open("a", encoding="utf-8") as results:
            results.write(json.dumps({**asdict(fault), "outcome": outcome}) + "\n")


def main() -> None:
    """Try so many faults of a room, and list those that no test found."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("room")
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--skip", type=int, default=0, help="so many were tried before")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=MOST_SECONDS, help="of tests for one fault")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "mutants")
    parser.add_argument("--tests", nargs="*", help="default: the room's folder")
    parser.add_argument("--again", action="store_true", help="try those that survived on the slow tests of these files")
    asked = parser.parse_args()
    preload()
    out = asked.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    copy = out / "copy"
    if not copy.exists():
        for name in COPIED:
            (shutil.copytree if (ROOT / name).is_dir() else shutil.copy2)(ROOT / name, copy / name)
    lines, taken = surveyed(copy, asked.room, out, asked.tests or [f"tests/{asked.room}"])
    if asked.again:
        again(copy, asked.room, out, lines, taken)
        return
    every = [fault for path in sorted((copy / "stltool" / asked.room).rglob("*.py")) for fault in faults_of(copy, path)]
    random.Random(asked.seed).shuffle(every)
    if not (sound := out / f"{asked.room}.sound").exists():
        unchanged, quick = Fault(every[0].file, 0, "", "", 0, 0), [test for test in taken if taken[test] <= LONGEST]
        assert tried(copy, unchanged, quick, out / "last.log", 2000) == "survived", "the tests fail without a fault"
        sound.touch()
    counts: Counter[str] = Counter()
    by_file: defaultdict[str, int] = defaultdict(int)
    with (out / f"{asked.room}.jsonl").open("a", encoding="utf-8") as results:
        for fault in every[asked.skip : asked.skip + asked.count]:
            tests = chosen(fault, lines, taken, asked.seconds)
            outcome = tried(copy, fault, tests, out / "last.log") if tests else "not executed"
            counts[outcome] += 1
            by_file[fault.file] += outcome == "survived"
            results.write(json.dumps({**asdict(fault), "outcome": outcome, "tests": len(tests)}) + "\n")
            results.flush()
            if outcome == "survived":
                print(f"{fault.file}:{fault.line}: {fault.before} -> {fault.after}", flush=True)
    print(f"{asked.room}: {len(every)} faults can be made, {sum(counts.values())} were: {dict(counts)}")


if __name__ == "__main__":
    main()
