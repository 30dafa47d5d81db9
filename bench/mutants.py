"""Random faults in a room of stltool, one at a time, and whether the room's quick tests find them (bench/mutants.md).

    pip install coverage
    python bench/mutants.py logic automata --seed 2 --count 150 --out out/mutants

works in a copy. First a room's tests run once, to learn which of them execute which line, and how long each takes.
Then each fault runs the tests that execute its line, the shortest first, until one fails. A fault is an exchanged
comparison or operator, a negated condition, a number that is one more, a statement left out, min for max, any for all.
Faults in texts of messages, in annotations and in `repr` are not made. Rooms take turns; what is in out/mutants is
not tried again, so that a run that was stopped goes on.

Each fault runs in a fork of a process that has imported whatever the tests need but the room and what imports it, and
has loaded the kernels, whose machine code stays valid: no fault is made in stltool/kernels.
"""

from __future__ import annotations

import argparse
import ast
import functools
import importlib
import json
import os
import random
import resource
import shutil
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parent.parent
COPIED = ("stltool", "grammars", "tests", "examples", "docs", "bench", "pyproject.toml", "README.md")
QUIET = ("-W", "ignore::pytest.PytestAssertRewriteWarning")  # Hypothesis is imported before pytest begins
MOST_SECONDS = 8.0  # of tests for one fault, unless asked otherwise
TURN = 10  # faults of a room, before it is the next room's turn
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


def preload(modules: Sequence[str]) -> None:
    """Import what is no part of stltool, and let the compiler load what it needs."""
    import numba
    import numpy as np

    for name in modules:
        if name.partition(".")[0] not in ("stltool", "tests", "bench"):
            imported(name)
    numba.njit(lambda x: x.sum() + x.argsort()[0])(np.ones(2))


def imported(name: str) -> bool:
    try:
        importlib.import_module(name)
    except Exception:  # some are made by others when these run
        return False
    return True


def preload_others(modules: Sequence[str]) -> None:
    """Import the parts of stltool that do not import the room, and load every kernel of theirs that is on disk."""
    for name in modules:
        imported(name)
    from numba.core.caching import IndexDataCacheFile

    from stltool.kernels.cache import folders
    from stltool.kernels.compiling import Kernel, Part

    for name in [name for name in modules if name.startswith("stltool.kernels.")]:
        for kernel in vars(sys.modules[name]).values():
            if not isinstance(kernel, Kernel) or isinstance(kernel, Part) or kernel.__module__ != name:
                continue
            for folder in folders()[0]:
                for file in sorted(folder.glob(f"{vars(kernel)['_cache']._name}-*.nbi")):
                    for signature, _ in IndexDataCacheFile(str(folder), file.stem, folder.name)._load_index():
                        kernel.compile(signature)


def beside(room: str, modules: Sequence[str]) -> list[str]:
    """Of modules, those of stltool whose import does not import the room; the process is of no use after it."""
    found = []
    for name in modules:
        if not name.startswith("stltool"):
            continue
        before = set(sys.modules)
        whole = imported(name)
        new = set(sys.modules) - before
        if any(f"{one}.".startswith(f"stltool.{room}.") for one in new):
            for one in new:
                if one.startswith("stltool"):
                    del sys.modules[one]
        elif whole:
            found.append(name)
    return found


def child(log: Path | None, seconds: float, run: Callable[[], int]) -> int | None:
    """The exit code of run() in a process of its own; None if it took too long."""
    sys.stdout.flush()
    pid = os.fork()
    if not pid:
        if log is not None:
            log.parent.mkdir(parents=True, exist_ok=True)
            out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(out, 1)
            os.dup2(out, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 5))
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


class Survey(NamedTuple):
    """lines     file → line → the tests that execute it;  seconds: that each test takes
    modules   that the tests import, in order;  others: those of stltool that do not import the room"""

    lines: dict[str, dict[int, list[str]]]
    seconds: dict[str, float]
    modules: list[str]
    others: list[str]


@functools.cache
def surveyed(room: str, out: Path) -> Survey:
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
                ["-q", "-n", "0", "-p", "no:cacheprovider", "-m", "not slow", *QUIET, f"tests/{room}"], [Watching()]
            )
            watch.stop()
            data, found = watch.get_data(), {}
            for file in data.measured_files():
                if f"/stltool/{room}/" in file:
                    found[file.rpartition("/stltool/")[2]] = data.contexts_by_lineno(file)
            kept.write_text(json.dumps([found, taken, list(sys.modules)]), encoding="utf-8")
            return int(code)

        child(out / f"{room}.survey.log", 3000, run)
    found, taken, modules = json.loads(kept.read_text(encoding="utf-8"))
    lines = {file: {int(line): tests for line, tests in rows.items()} for file, rows in found.items()}
    importable = out / f"{room}.others.json"
    if not importable.exists():

        def find() -> int:
            preload(modules)
            importable.write_text(json.dumps(beside(room, modules)), encoding="utf-8")
            return 0

        child(out / f"{room}.survey.log", 3000, find)
    return Survey(lines, taken, modules, json.loads(importable.read_text(encoding="utf-8")))


def chosen(fault: Fault, survey: Survey, seconds: float) -> list[str]:
    """The tests that execute the fault's line, shortest first; of a line outside functions, those of the file."""
    lines, taken = survey.lines, survey.seconds
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


def tried(copy: Path, fault: Fault, tests: Sequence[str], log: Path, seconds: float) -> str:
    """killed, survived, timeout, or not imported: the fault is noticed before any test runs."""
    file = copy / fault.file
    data, times = file.read_bytes(), file.stat()
    file.write_bytes(data[: fault.start] + fault.after.encode() + data[fault.stop :])

    def run() -> int:
        import pytest

        sys.dont_write_bytecode = True
        return int(pytest.main(["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--tb=line", *QUIET, *tests]))

    try:
        code = child(log, seconds, run)
    finally:
        file.write_bytes(data)
        os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert code not in (5, 99), log.read_text(encoding="utf-8")[-2000:]  # no tests; none could be run
    known = {None: "timeout", 0: "survived", 1: "killed"}
    return known.get(code, "not imported")


def slow_ones(fault: Fault, room: str, survey: Survey) -> list[str]:
    """pytest's arguments for the slow tests of the files whose quick tests execute the fault's line."""
    rows = survey.lines.get(fault.file.removeprefix("stltool/"), {})
    files = {test.partition("::")[0] for test in rows.get(fault.line, [])}
    return ["-m", "slow", *(sorted(file for file in files if file) or [f"tests/{room}"])]


def rows_of(file: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []


def cpu_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def turn(copy: Path, room: str, faults: Sequence[Fault], survey: Survey, asked: argparse.Namespace, out: Path) -> int:
    """Try the faults, in a process that is of no use after it."""
    preload(survey.modules)
    preload_others(survey.others)
    if not (sound := out / f"{room}.sound").exists():
        unchanged = Fault(faults[0].file, 0, "", "", 0, 0)
        quick = [test for test, seconds in survey.seconds.items() if seconds <= 20 / len(survey.seconds)]
        outcome = tried(copy, unchanged, quick, out / f"{room}.log", 600)
        assert outcome == "survived", f"the tests of {room} fail without a fault"
        sound.touch()
    for fault in faults:
        tests = slow_ones(fault, room, survey) if asked.again else chosen(fault, survey, asked.seconds)
        most = 300 if asked.again else 3 * sum(survey.seconds[test] for test in tests) + 10
        start = cpu_of_children()
        outcome = tried(copy, fault, tests, out / f"{room}.log", most) if tests else "not executed"
        seconds = round(cpu_of_children() - start, 2)
        row = {**asdict(fault), "outcome": outcome, "tests": len(tests), "seconds": seconds}
        with results_of(room, asked, out).open("a", encoding="utf-8") as results:
            results.write(json.dumps(row) + "\n")
        if outcome == "survived":
            print(f"{fault.file}:{fault.line}: {fault.before} -> {fault.after}", flush=True)
    return 0


def to_try(copy: Path, room: str, asked: argparse.Namespace, out: Path) -> list[Fault]:
    """Those of the room that are asked for, and have not been tried."""
    if asked.again:
        rows = rows_of(out / f"{room}.{asked.seed}.jsonl")
        faults = [
            Fault(**{key: row[key] for key in Fault.__annotations__}) for row in rows if row["outcome"] == "survived"
        ]
    else:
        files = sorted((copy / "stltool" / room).rglob("*.py"))
        faults = [fault for path in files for fault in faults_of(copy, path)]
        random.Random(asked.seed).shuffle(faults)
        print(f"{room}: {len(faults)} faults can be made", flush=True)
    known = {(row["file"], row["start"], row["after"]) for row in rows_of(results_of(room, asked, out))}
    return [one for one in faults[: asked.count] if (one.file, one.start, one.after) not in known]


def results_of(room: str, asked: argparse.Namespace, out: Path) -> Path:
    return out / f"{room}.{asked.seed}{'.again' if asked.again else ''}.jsonl"


def main() -> None:
    """Try so many faults of some rooms, and list those that no test found."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("rooms", nargs="+")
    parser.add_argument("--count", type=int, default=300, help="faults of each room")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=MOST_SECONDS, help="of tests for one fault")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "mutants")
    parser.add_argument("--again", action="store_true", help="try those that survived on the slow tests of these files")
    asked = parser.parse_args()
    out = asked.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    copy = out / "copy"
    if not copy.exists():
        for name in COPIED:
            (shutil.copytree if (ROOT / name).is_dir() else shutil.copy2)(ROOT / name, copy / name)
    os.environ.update(STLTOOL_MORE="0.1", HYPOTHESIS_PROFILE="ci", PYTHONPATH=str(copy))
    os.chdir(copy)
    sys.path.insert(0, str(copy))
    left = {room: to_try(copy, room, asked, out) for room in asked.rooms}
    while any(left.values()):
        for room in [room for room, faults in left.items() if faults]:
            survey = surveyed(room, out)
            now, left[room] = left[room][:TURN], left[room][TURN:]
            code = child(None, 10_000, functools.partial(turn, copy, room, now, survey, asked, out))
            assert code == 0, f"{room}: see above"
    for room in asked.rooms:
        counts = Counter(row["outcome"] for row in rows_of(results_of(room, asked, out)))
        print(f"{room}: {counts.total()} faults were tried: {dict(counts)}")


if __name__ == "__main__":
    main()
