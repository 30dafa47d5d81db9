"""pytest plugin: task files as tests, fixtures that judge what tests record, pages of failures (docs/testing.md).

pytest loads this module in every run where stltool is installed, so it imports nothing of stltool until a test needs
it.
PYTEST_DONT_REWRITE
"""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from stltool.checking import CheckResult
    from stltool.gate import Gate, Verified
    from stltool.logic.expectation import Expectation
    from stltool.logic.formula import Formula
    from stltool.logic.task import Task
    from stltool.testing import Recorder
    from stltool.testing.coverage import CoverageReport

_LONGEST_NAME = 120
_FACET = re.compile(rb"^\s*facet\s", re.MULTILINE)
_BINARY = re.compile(rb"[\x00-\x08\x0e-\x1f]")
_EXPECT = re.compile(rb"\bexpect\b")
_COVERAGE: pytest.StashKey[CoverageReport] = pytest.StashKey()
_ASKED: pytest.StashKey[list[tuple[str, int]]] = pytest.StashKey()  # file and number of what is expected of all tests
_REMOTE: pytest.StashKey[bool] = pytest.StashKey()  # whether tests ran in processes of their own
_FAILED: pytest.StashKey[list[str]] = pytest.StashKey()  # what was expected of them and does not hold
_PAGE = "stl_report"  # the user property that holds a page's path


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("stltool", "signal temporal logic (stltool)")
    group.addoption(
        "--stl-report", metavar="FOLDER", help="write a page about each failure of an expectation, a trace or a bound"
    )
    group.addoption(
        "--stl-coverage",
        action="store_true",
        help="report how often premises held and parts of formulas mattered on the traces that tests judged",
    )
    parser.addini("stl_files", "collect .stl files with expect lines as tests", type="bool", default=False)


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        "stl(formula, **options): the formula of stl_monitor(), and options of its Recorder; tests from .stl files "
        "have this marker, too",
    )
    if config.getoption("stl_coverage"):
        _collect(config)
    folder = config.getoption("stl_report")
    if folder is None:
        return
    from stltool.errors import FileError
    from stltool.files import require_folder

    absolute = config.invocation_params.dir / folder
    try:
        require_folder(absolute)
    except FileError as error:
        raise pytest.UsageError(f"--stl-report {folder}: {error}") from None
    config.option.stl_report = str(absolute)  # what xdist hands to its workers


def _collect(config: pytest.Config) -> None:
    """From now on, what is judged is counted."""
    if _COVERAGE not in config.stash:
        from stltool.testing import collect_coverage

        stack = ExitStack()
        config.stash[_COVERAGE] = stack.enter_context(collect_coverage())
        config.add_cleanup(stack.close)


# ------------------------------------------------------------------------------------------------------- task files


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> StlFile | None:
    if file_path.suffix.lower() == ".stl" and parent.config.getini("stl_files") and _has_expectations(file_path):
        return StlFile.from_parent(parent, path=file_path)
    return None


def _has_expectations(path: Path) -> bool:
    """Whether this is a task file with expectations; what else has the suffix are 3-D meshes, binary or as text."""
    from stltool.logic.syntax import LONGEST_TEXT

    try:
        if path.stat().st_size > LONGEST_TEXT:
            return False
        data = path.read_bytes()
    except OSError:
        return False
    task = b":=" in data and _EXPECT.search(data) is not None
    return task and not _BINARY.search(data) and not _FACET.search(data)


class ExpectationFailed(AssertionError):
    """An expectation does not hold, is undecided, or cannot be judged; the message is the whole explanation."""

    def __init__(self, message: str, verified: Verified) -> None:
        super().__init__(message)
        self.verified = verified


class StlFile(pytest.File):
    """A task file. Its models are read, and its products built, once for all its tests of one process."""

    _read: tuple[Gate, Task] | Exception | None = None

    def collect(self) -> Iterable[pytest.Item]:
        from stltool.errors import StlToolError
        from stltool.logic.parser import survey_task

        try:
            found = survey_task(self.path)
        except StlToolError as error:
            raise self.CollectError(str(error)) from None
        if found.faults:
            raise self.CollectError("\n\n".join(found.faults))
        from stltool.gate import traces_of

        seen: set[str] = set()
        for number, expectation in enumerate(found.expectations):
            asked = expectation.written.removeprefix("expect ")
            if len(asked) > _LONGEST_NAME or asked in seen:
                asked = f"{asked[:_LONGEST_NAME]}, line {_line(expectation)}"
            seen.add(asked)
            counts = expectation.question == "cover" and not traces_of(found.expectations, expectation)
            yield StlItem.from_parent(
                self, name=f"expect[{asked}]", number=number, line=_line(expectation), counts=counts
            )

    def read(self) -> tuple[Gate, Task]:
        """What judges, and the task; raises StlToolError with all faults of the file, also the second time."""
        if self._read is None:
            from stltool.errors import StlToolError
            from stltool.gate import Gate

            gate = Gate()
            try:
                (task,) = gate.read([self.path])
                self._read = gate, task
            except StlToolError as error:
                self._read = error
        if isinstance(self._read, Exception):
            raise self._read
        return self._read

    def teardown(self) -> None:
        self._read = None  # models and products are large


class StlItem(pytest.Item):
    """One `expect` line; `counts`: over what all tests judge, so it is the last one."""

    def __init__(self, *, number: int, line: int, counts: bool, **more: Any) -> None:
        super().__init__(**more)
        self.number, self.line, self.counts = number, line, counts
        self.add_marker("stl")

    def runtest(self) -> None:
        assert isinstance(self.parent, StlFile)
        if self.counts and hasattr(self.config, "workerinput"):
            pytest.skip("counted at the end, over all processes")
        gate, task = self.parent.read()
        expectation = task.expectations[self.number]
        if self.counts:
            verified = _counted(task, expectation, self.config.stash[_COVERAGE])
        else:
            verified = gate.judge(task, expectation)
        if verified.verdict != "holds":
            raise ExpectationFailed(_told(verified, self.location[0]), verified)

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        from stltool.errors import StlToolError

        if isinstance(excinfo.value, (ExpectationFailed, StlToolError)):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int, str]:
        return self.path, self.line - 1, self.name


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: isinstance(item, StlItem) and item.counts)


def pytest_collection_finish(session: pytest.Session) -> None:
    """What tests judge is counted if an expectation asks for it."""
    asked = [item for item in session.items if isinstance(item, StlItem) and item.counts]
    if asked:
        session.config.stash[_ASKED] = [(str(item.path), item.number) for item in asked]
        _collect(session.config)


def _counted(task: Task, expectation: Expectation, coverage: CoverageReport) -> Verified:
    """An expectation about what all tests judged."""
    from stltool.gate import covered
    from stltool.testing import Coverage

    return covered(task, expectation, coverage.get(str(expectation.formula)) or Coverage(expectation.formula))


@pytest.hookimpl(wrapper=True)
def pytest_runtestloop(session: pytest.Session) -> Generator[None, object, object]:
    """Where the tests ran in processes of their own, what they judged is known only now."""
    result = yield
    config = session.config
    if not config.stash.get(_REMOTE, False) or session.shouldfail or session.shouldstop:
        return result
    from stltool.logic.parser import survey_task

    told = config.stash.setdefault(_FAILED, [])
    asked: list[tuple[str, int]] = config.stash.get(_ASKED, [])
    for path, number in asked:
        task = survey_task(Path(path)).task
        if task is None:  # the file has changed meanwhile
            continue
        verified = _counted(task, task.expectations[number], config.stash[_COVERAGE])
        if verified.verdict != "holds":
            told.append(_told(verified, path))
    session.testsfailed += len(told)
    return result


def _line(expectation: Expectation) -> int:
    return expectation.span.line if expectation.span is not None else 1


def _told(verified: Verified, file: str) -> str:
    """What `stltool verify` shows of it."""
    from stltool.gate import Verification
    from stltool.reporting import verification_data
    from stltool.reporting.verification import asked_text, enclosure_text, explained, found_text

    (row,) = verification_data(Verification((verified.path,), (verified,)))["expectations"]
    lines = [f"{file}:{row['line']}: expect {asked_text(row)}"]
    found = ", ".join(filter(None, [found_text(row), enclosure_text(row)]))
    lines.append(f"  {row['verdict']}{': ' if found else ''}{found}")
    lines += [f"  {line}".rstrip() for line in (explained(row) or "").splitlines()]
    return "\n".join(lines)


# --------------------------------------------------------------------------------------------------------- fixtures

_RECORDERS: pytest.StashKey[list[Recorder]] = pytest.StashKey()


@pytest.fixture
def stl_monitor(request: pytest.FixtureRequest) -> Callable[..., Recorder]:
    """stl_monitor(formula, **options): a Recorder, judged at the latest when the test function returns.

    Without a formula, that of the test's marker: @pytest.mark.stl("G[0,9] x < 5", end="cut"). Options are those of
    stltool.testing.Recorder.
    """
    from stltool.errors import SettingsError
    from stltool.testing import Recorder

    recorders = request.node.stash.setdefault(_RECORDERS, [])
    marker = request.node.get_closest_marker("stl")

    def monitored(phi: Formula | Task | str | None = None, *given: Any, **options: Any) -> Recorder:
        if phi is None:
            if marker is None or not marker.args:
                raise SettingsError(
                    "stl_monitor() has no formula; give one, stl_monitor('G[0,9] x < 5'), or mark the test with "
                    "@pytest.mark.stl('G[0,9] x < 5')"
                )
            phi, options = marker.args[0], {**marker.kwargs, **options}
        recorder = Recorder(phi, *given, **options)
        recorders.append(recorder)
        return recorder

    return monitored


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> Generator[None, object, object]:
    result = yield
    for recorder in pyfuncitem.stash.get(_RECORDERS, ()):
        if not recorder.closed or recorder.verdict is False:  # a program may have caught what was raised
            _judge(recorder)
    return result


def _judge(recorder: Recorder) -> None:
    """Close it. No line of the test is shown, since none of them raises: the report has the explanation alone."""
    from stltool.errors import StlToolError

    try:
        recorder.close()
    except (AssertionError, StlToolError) as error:
        raise pytest.fail.Exception(str(error), pytrace=False) from error


@pytest.fixture
def stl_report(request: pytest.FixtureRequest) -> Callable[..., Path]:
    """stl_report(results, **options): writes the page of one or several checks, as stl.report does; returns its path.

    The page is in the folder of --stl-report, otherwise in the test's temporary folder. `name` is its file name.
    """
    import stltool as stl

    folder = request.config.getoption("stl_report")
    home = _home(folder, request.node.nodeid) if folder is not None else request.getfixturevalue("tmp_path")

    def reported(results: CheckResult | list[CheckResult], *, name: str = "checks", **options: Any) -> Path:
        path: Path = home / f"{name}.html"
        stl.report(results, path=path, **options)
        request.node.user_properties.append((_PAGE, str(path)))
        return path

    return reported


# ------------------------------------------------------------------------------------------------- pages of failures


def _home(folder: str, nodeid: str) -> Path:
    """A test's own folder: its name, readable, and what tells it apart from others that read alike."""
    readable = re.sub(r"[^A-Za-z0-9_.]+", "-", nodeid).strip("-.")[:80]
    return Path(folder, f"{readable}-{hashlib.sha256(nodeid.encode()).hexdigest()[:6]}")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    folder = item.config.getoption("stl_report")
    failure: str | None = None
    if folder is not None and call.when == "call":
        path = _home(folder, item.nodeid) / "report.html"
        try:
            if call.excinfo is not None and _written(call.excinfo.value, path):
                item.user_properties.append((_PAGE, str(path)))
            else:
                _remove_older(path)
        except Exception as error:  # a page must not hide why a test failed
            failure = f"the page {path} is not written: {error}"
    report = yield
    if failure is not None:
        report.sections.append(("stltool", failure))
    return report


def _written(failure: BaseException, path: Path) -> bool:
    """Whether there is something to write about this failure, which then is written."""
    if isinstance(failure, pytest.fail.Exception) and failure.__cause__ is not None:
        failure = failure.__cause__
    if isinstance(failure, ExpectationFailed):
        from stltool.testing.pages import write_expectation_page

        write_expectation_page(failure.verified, path)
        return True
    if isinstance(failure, AssertionError) and "stltool.testing" in sys.modules:
        from stltool.testing.pages import write_failure_page

        return write_failure_page(failure, path)
    return False


def _remove_older(page: Path) -> None:
    """The page of an earlier run in which this test failed."""
    for file in (page, page.with_suffix(".json")):
        file.unlink(missing_ok=True)
    if page.parent.is_dir() and not any(page.parent.iterdir()):
        page.parent.rmdir()


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    pages = list(dict.fromkeys(_pages(terminalreporter.stats)))
    if pages:
        terminalreporter.section("stltool: pages")
        for page in pages:
            terminalreporter.line(page)
    for told in config.stash.get(_FAILED, []):
        terminalreporter.section("stltool: an expectation of all tests")
        terminalreporter.line(told)
    coverage = config.stash.get(_COVERAGE, None)
    if coverage is not None:
        terminalreporter.section("stltool: coverage of formulas")
        terminalreporter.line(coverage.report() or "no test judged a trace by an assertion or a recorder of stltool")


def _pages(stats: dict[str, list[Any]]) -> Iterator[str]:
    for reports in stats.values():
        for report in reports:
            yield from (value for name, value in getattr(report, "user_properties", ()) if name == _PAGE)


# ------------------------------------------------------------------------------------------------ coverage with xdist


def pytest_sessionfinish(session: pytest.Session) -> None:
    coverage = session.config.stash.get(_COVERAGE, None)
    if coverage is not None and hasattr(session.config, "workeroutput"):  # a worker's
        session.config.workeroutput["stl_coverage"] = {text: one.counts() for text, one in coverage.items()}
        session.config.workeroutput["stl_asked"] = session.config.stash.get(_ASKED, [])


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    output = getattr(node, "workeroutput", {})  # a worker that crashed has none
    if "stl_coverage" in output:
        _collect(node.config)
        node.config.stash[_COVERAGE].merge(output["stl_coverage"])
        node.config.stash[_ASKED] = [(path, number) for path, number in output["stl_asked"]]
        node.config.stash[_REMOTE] = True
