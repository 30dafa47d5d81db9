"""The plugin for pytest, in runs within a test: what is collected, what failures say, which pages there are."""

import json
import re
import struct
import subprocess
import sys
import tomllib

import pytest

import stltool as stl
from stltool.testing import Recorder, assert_probability
from stltool.testing.pages import write_failure_page
from tests.conftest import ROOT

pytest_plugins = ["pytester"]

PLUGIN = "stltool.pytest_plugin"
TASK = """model "two.tra"
reached := F[0,2] there
expect Pmax(reached) >= 0.99  # exactly
expect Pmax(reached) >= 0.995
expect holds(G[0,2] level > 0, trace "log.csv")
expect Pmax(reached) >= 0.99
"""
FILES = {
    "gate.stl": TASK,
    "two.tra": "2 2 3\n0 0 0 0.1\n0 0 1 0.9\n1 0 1 1\n",
    "two.lab": '0="init" 1="there"\n0: 0\n1: 1\n',
    "log.csv": "level\n1\n0.5\n-0.25\n",
}
TESTS = """
import pytest

@pytest.mark.stl("G[0,3] level < 5")
def test_early(stl_monitor):
    record = stl_monitor()
    for step in range(4):
        record(level=3 * step)
        assert step < 2, "the violation is raised at once"

@pytest.mark.stl("F[0,3] level > 5", online=False)
def test_late(stl_monitor):
    record = stl_monitor()
    for step in range(4):
        record(level=step)

def test_kept(stl_monitor):
    record, other = stl_monitor("F[0,1] level > 5"), stl_monitor("G[0,1] level > 5", end="cut")
    record(level=6)
    other(level=6)

def test_own_failure_counts(stl_monitor):
    stl_monitor("F[0,3] level > 5")(level=1)
    raise RuntimeError("of the test")

def test_caught(stl_monitor):
    try:
        stl_monitor("G[0,3] level < 7")(level=8)
    except AssertionError:
        pass

def test_nothing_recorded(stl_monitor):
    stl_monitor("F[0,3] level > 5")

def test_no_formula(stl_monitor):
    stl_monitor()
"""
PAGES = """
import stltool as stl
from stltool.testing import assert_probability

PRODUCT = stl.build_product(stl.load_model("two.tra"), stl.parse("F[0,2] there"))

def test_bound():
    assert_probability(PRODUCT, at_least=0.995)

def test_shown(stl_report):
    assert stl_report(stl.check(PRODUCT), name="best").is_file()
"""


COVERED = """
from stltool.testing import assert_trace
import stltool as stl

PHI = stl.parse("G[0,2] (request -> level > 3)")

def test_asked():
    assert_trace(PHI, {"request": [True, False, False], "level": [4, 0, 0]})

def test_idle(stl_monitor):
    record = stl_monitor(PHI)
    for step in range(3):
        record(request=False, level=0)
"""
COVERAGE = """\
G[0,2] (request -> level > 3)
  2 traces: 2 passed, 1 of them vacuously (a premise held nowhere)
  part                     held   failed     open  mattered
  request -> level > 3        6        0        0         2
  request (premise)           1        5        0         2
  level > 3                   1        5        0         1
"""


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """All modules that tests and pages need: what a run within a test imports is dropped after it."""
    folder = tmp_path_factory.mktemp("loaded")
    model = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]]], {}, labels={"there": [0, 1]})
    with pytest.raises(AssertionError) as failure:
        assert_probability(stl.build_product(model, stl.parse("F[0,2] there")), at_least=0.9)
    assert write_failure_page(failure.value, folder / "bound.html")
    with pytest.raises(AssertionError) as failure:
        Recorder("G[0,1] x > 0")(x=0)
    assert write_failure_page(failure.value, folder / "trace.html")


@pytest.fixture
def project(pytester, loaded):
    """A project whose ini file asks for task files."""
    pytester.makeini("[pytest]\nstl_files = true\naddopts = --strict-markers\nfilterwarnings = error\n")
    for name, text in FILES.items():
        (pytester.path / name).write_text(text, encoding="utf-8")
    return pytester


def run(pytester, *options):
    return pytester.runpytest_inprocess("-p", PLUGIN, "-p", "no:cacheprovider", *options)


def test_every_expectation_is_a_test(project):
    (project.path / "sub").mkdir()
    (project.path / "sub" / "test_plain.py").write_text("def test_plain(): pass\n")
    done = run(project, "-v", "gate.stl", "sub")
    done.assert_outcomes(passed=3, failed=2)
    done.stdout.fnmatch_lines_random([
        "gate.stl::expect[[]Pmax(reached) >= 0.99[]] PASSED*",
        "gate.stl::expect[[]Pmax(reached) >= 0.995[]] FAILED*",
        "gate.stl::expect[[]Pmax(reached) >= 0.99, line 6[]] PASSED*",
        "gate.stl:4: expect Pmax(reached) >= 0.995",
        "  does not hold: P = 0.99*",
        'gate.stl:5: expect holds(G[[]0,2[]] (level > 0), trace "log.csv")',
        "  does not hold: robustness -0.25",
        "  G[[]0,2[]] (level > 0) fails at step 0: level > 0 fails at step 2 with level = -0.25*",
    ])  # fmt: skip
    assert "Traceback" not in done.stdout.str()
    assert "pytest_plugin.py" not in done.stdout.str()


def test_a_test_is_chosen_by_its_name_or_by_the_marker(project):
    project.makepyfile("def test_plain(): pass")
    run(project, "gate.stl::expect[Pmax(reached) >= 0.99]").assert_outcomes(passed=1)
    run(project, "-m", "stl", "-k", "line or plain").assert_outcomes(passed=1, deselected=4)


def test_files_are_collected_where_the_ini_file_asks_for_it(project):
    project.makepyfile("def test_plain(): pass")
    run(project, "-o", "stl_files=false").assert_outcomes(passed=1)


def mesh():
    """A binary mesh of one triangle, with the two words in its free header."""
    return b"x := 1; expect".ljust(80, b"\0") + struct.pack("<I12fH", 1, *[0.0] * 12, 0)


OTHERS = {
    "a binary mesh": mesh(),
    "one without zero bytes": b"x := 1; expect".ljust(80) + b"\x01" * 54 + b"\xff",
    "a mesh as text": b"solid expect := part\n  facet normal 0 0 1\n outer loop\n endloop\n endfacet\nendsolid",
    "a task without expectations": b"reached := F[0,2] there\n",
    "a comment": b"# what we expect\nreached := F[0,2] there\n",
    "expectations without definitions": b'expect holds(G[0,2] level > 0, trace "log.csv")\n',
    "nothing": b"",
}


@pytest.mark.parametrize("content", OTHERS.values(), ids=OTHERS)
def test_what_has_no_expectations_is_passed_over_in_silence(project, content):
    (project.path / "gate.stl").unlink()
    (project.path / "Part.STL").write_bytes(content)
    done = run(project)
    assert done.ret == pytest.ExitCode.NO_TESTS_COLLECTED
    assert "Part" not in done.stdout.str() + done.stderr.str()


def test_a_file_that_cannot_be_read_is_an_error_of_its_own(project):
    (project.path / "bad.stl").write_text("a := F[0,2] (x >\nb := G[0,2 x > 0\nexpect Pmax(a) >= 0.5\n")
    done = run(project)
    done.assert_outcomes(errors=1)
    done.stdout.fnmatch_lines(["*bad.stl, line 1*", "*bad.stl, line 2*"])
    assert "Traceback" not in done.stdout.str()


def test_a_missing_model_fails_each_expectation_with_the_reason(project):
    (project.path / "two.tra").unlink()
    done = run(project, "-k", "995 or holds")
    done.assert_outcomes(failed=2, deselected=2)
    done.stdout.fnmatch_lines(["*two.tra*"])
    assert "Traceback" not in done.stdout.str()


def test_stl_monitor_judges_what_a_test_records(project):
    project.makepyfile(TESTS)
    done = run(project, "test_stl_monitor_judges_what_a_test_records.py")
    done.assert_outcomes(passed=1, failed=6)
    text = done.stdout.str()
    assert "G[0,3] (level < 5) fails at step 0: level < 5 fails at step 2 with level = 6" in text
    assert "AssertionError: the violation is raised at once" not in text
    assert "level > 5 fails throughout steps 0 … 3 with level = 0, 1, 2, 3" in text
    assert "RuntimeError: of the test" in text
    assert "level < 7 fails at step 0 with level = 8" in text
    assert "nothing was recorded; record at least one sample" in text
    assert "stl_monitor() has no formula; give one" in text
    assert "hidden" not in text


def test_failures_have_pages(project):
    project.makepyfile(TESTS + PAGES)
    done = run(project, "--stl-report", "out", "-k", "995 or holds or early or late or bound or shown or own")
    done.assert_outcomes(passed=1, failed=6, deselected=6)
    pages = sorted((project.path / "out").glob("*/*.html"))
    done.stdout.fnmatch_lines_random([str(page) for page in pages])
    formats = [json.loads(page.with_suffix(".json").read_text())["format"].split("/")[0] for page in pages]
    assert len(pages) == 6  # none of a failure that is the test's own
    assert len(set(formats)) == 3

    (project.path / "log.csv").write_text("level\n1\n0.5\n0.25\n")
    run(project, "--stl-report", "out", "-k", "holds").assert_outcomes(passed=1, deselected=12)
    left = sorted((project.path / "out").glob("*/*.html"))
    assert [page for page in pages if page not in left] == [page for page in pages if "holds" in str(page)]
    assert not [folder for folder in (project.path / "out").iterdir() if not any(folder.iterdir())]


def test_a_folder_for_pages_that_cannot_be_is_refused_at_the_start(project):
    done = run(project, "--stl-report", "log.csv")
    assert done.ret == pytest.ExitCode.USAGE_ERROR
    done.stderr.fnmatch_lines(["*--stl-report log.csv: *is not a writable directory; name another"])


@pytest.mark.soak(only=True)
def test_tests_are_shared_among_processes(project):
    """With xdist: every expectation once, pages are listed, and there is one report on coverage."""
    project.makepyfile(test_covered=COVERED)
    (project.path / "more.stl").write_text(
        'a := level > 0\nexpect holds(a, trace "log.csv")\nexpect holds(!(level < 0), trace "log.csv")'
    )
    command = [sys.executable, "-m", "pytest", "-p", PLUGIN, "-n", "2", "-k", "holds or covered", "--stl-report", "out"]
    done = subprocess.run([*command, "--stl-coverage"], cwd=project.path, capture_output=True, text=True)
    assert COVERAGE in done.stdout
    assert "1 failed, 4 passed" in done.stdout
    (page,) = (project.path / "out").glob("*/report.html")
    assert str(page) in done.stdout


def test_pytest_finds_it_by_its_entry_point():
    points = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["pytest11"]
    assert points == {PLUGIN: PLUGIN}  # one name, or `-p` would load it a second time


def test_the_example_of_the_page_passes_and_would_fail(pytester, loaded):
    page = (ROOT / "docs" / "testing.md").read_text(encoding="utf-8")
    (block,) = [one for one in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL) if "stl_monitor" in one]
    pytester.makepyfile(test_page=block, test_late=block.replace("step >= 9", "step >= 12"))
    done = run(pytester, "--strict-markers")
    done.assert_outcomes(passed=1, failed=1)
    assert "level > 3 fails throughout steps 7 … 11 with level = 0" in done.stdout.str()


def test_coverage_of_formulas_is_reported_at_the_end(pytester, loaded):
    pytester.makepyfile(COVERED)
    assert "coverage of formulas" not in run(pytester).stdout.str()
    assert COVERAGE in run(pytester, "--stl-coverage").stdout.str()
    told = run(pytester, "--stl-coverage", "-k", "idle").stdout.str()
    assert "the premise request held at no step" in told
    assert "level > 3 mattered in no trace" in told
    assert "no test judged a trace" in run(pytester, "--stl-coverage", "-k", "nothing").stdout.str()


ANSWERS = """answers := G[0,2] (request -> level > 3)
expect cover(request) >= 2  # over all tests
expect cover(request) >= 3
expect cover(answers, vacuous, trace "log.csv") <= 1
expect cover(answers, vacuous, trace "log.csv") < 1
"""
ASKING = """
import stltool as stl

PHI = stl.load_task("answers.stl")

def test_one(stl_monitor):
    record = stl_monitor(PHI)
    for step in range(3):
        record(request=step == 1, level=5)

def test_other(stl_monitor):
    record = stl_monitor(PHI)
    for step in range(3):
        record(request=step == 2, level=5)
"""


@pytest.fixture
def asking(project):
    (project.path / "answers.stl").write_text(ANSWERS, encoding="utf-8")
    (project.path / "log.csv").write_text("request,level\n0,1\n0,1\n0,1\n", encoding="utf-8")
    (project.path / "test_z.py").write_text(ASKING, encoding="utf-8")
    return project


def test_counts_are_judged_over_all_tests(asking):
    done = run(asking, "-v", "answers.stl", "test_z.py")
    done.assert_outcomes(passed=4, failed=2)
    done.stdout.fnmatch_lines([
        'answers.stl::expect[[]cover(answers, vacuous, trace "log.csv") < 1[]] FAILED*',
        "test_z.py::test_other PASSED*",
        "answers.stl::expect[[]cover(request) >= 2[]] PASSED*",
        "answers.stl::expect[[]cover(request) >= 3[]] FAILED*",
    ])  # fmt: skip
    done.stdout.fnmatch_lines([
        "answers.stl:3: expect cover(request) >= 3",
        "  does not hold: 2 steps of 2 traces",
        "  G[[]0,2[]] (request -> level > 3)",
        "*stltool: coverage of formulas*",
        "  request (premise) * 2 * 4 *",
    ])  # fmt: skip


def test_nothing_is_counted_if_no_test_judges_the_formula(asking):
    done = run(asking, "answers.stl", "-k", "request")
    done.assert_outcomes(failed=2, deselected=2)
    done.stdout.fnmatch_lines(["  does not hold: 0 steps of 0 traces"])


@pytest.mark.soak(only=True)
def test_counts_of_xdist_are_judged_at_the_end(asking):
    options = "-p", PLUGIN, "-p", "no:cacheprovider", "-n", "2", "-k", "not trace", "answers.stl", "test_z.py"
    done = asking.runpytest_subprocess(*options)
    done.assert_outcomes(passed=2, skipped=2, deselected=0)
    assert done.ret == 1  # although no test fails by itself
    done.stdout.fnmatch_lines([
        "*stltool: an expectation of all tests*",
        "*answers.stl:3: expect cover(request) >= 3",
        "  does not hold: 2 steps of 2 traces",
    ])  # fmt: skip
    assert "expect cover(request) >= 2\n" not in done.stdout.str()
