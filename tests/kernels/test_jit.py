"""Machine code on disk: never older than any source, kept where it can be, written by many at once."""

import os
import shutil
import subprocess
import sys
import time

import pytest
from numba.core import config

from stltool.kernels import cache, jit
from stltool.reporting.terminal import kernels_ready, progress_bar
from tests.conftest import MORE, ROOT

KERNELS = ROOT / "stltool" / "kernels"

INNER = """
from stltool.kernels.jit import kernel

@kernel
def inner(x):
    return x + 1
"""
OUTER = """
from stltool.kernels.inner import inner
from stltool.kernels.jit import kernel

@kernel
def outer(x):
    return 10 * inner(x)
"""


@pytest.fixture
def package(tmp_path):
    """A package of two small kernels, the one in a file of its own and called by the other."""
    folder = tmp_path / "stltool" / "kernels"
    folder.mkdir(parents=True)
    (folder.parent / "__init__.py").touch()
    for name in ("__init__.py", "jit.py", "cache.py", "compiling.py"):
        shutil.copy(KERNELS / name, folder / name)
    (folder / "inner.py").write_text(INNER)
    (folder / "outer.py").write_text(OUTER)
    return folder


def started(package, code):
    """A process that runs `code` on that package; numba's settings are its defaults."""
    settings = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    return subprocess.Popen(
        [sys.executable, "-c", code],
        env={**settings, "PYTHONPATH": str(package.parents[1])},
        cwd=package.parents[1],
        text=True,
        stdout=subprocess.PIPE,
    )


def words(process):
    """What it printed."""
    out, _ = process.communicate()
    assert process.returncode == 0
    return out.split()


# ----------------------------------------------------------------------------------------------- never out of date


def test_a_kernels_callers_in_other_files_change_with_it(package):
    """Three processes of some two seconds each, most of it numba's own import and compiling."""
    code = """
from stltool.kernels import jit
from stltool.kernels.outer import outer

told = []
with jit.compiling(told.append):
    value = outer(1)
print(value, told)
"""
    assert words(started(package, code)) == ["20", "[True]"]
    (before,) = package.glob("__pycache__/numba-*")
    assert words(started(package, code)) == ["20", "[]"]  # loaded
    (package / "inner.py").write_text(INNER.replace("x + 1", "x + 2"))
    assert words(started(package, code)) == ["30", "[True]"]
    (after,) = package.glob("__pycache__/numba-*")  # the old one is gone
    assert after != before


@pytest.mark.soak(only=True)
def test_an_edit_while_a_process_runs_is_not_taken_for_what_the_process_has_read(package):
    code = """
from pathlib import Path
from stltool.kernels import inner

source = Path(inner.__file__)
source.write_text(source.read_text().replace("x + 1", "x + 20"))
from stltool.kernels.outer import outer

print(outer(1), outer.stats.cache_path)
"""
    assert words(started(package, code)) == ["20", "None"]  # the old `inner`, on no disk
    assert not list(package.glob("__pycache__/numba-*/outer*"))
    assert words(started(package, "from stltool.kernels.outer import outer; print(outer(1))")) == ["210"]


def test_the_digest_is_of_every_source(package, monkeypatch):
    monkeypatch.setattr(jit, "HERE", package)
    seen = {jit._digest(jit._files())}
    for change in (
        lambda: (package / "inner.py").write_text(INNER.replace("x + 1", "x + 2")),
        lambda: (package / "inner.py").rename(package / "moved.py"),
        lambda: (package / "another.py").touch(),
    ):
        change()
        assert jit._digest(jit._files()) not in seen
        seen.add(jit._digest(jit._files()))
    (package / "notes.txt").touch()
    assert jit._digest(jit._files()) in seen
    monkeypatch.setattr(jit, "HERE", package / "archive.zip")
    assert jit._files() == ()


@pytest.mark.parametrize("setting", cache._CODE_SETTINGS)
def test_what_compiles_is_part_of_the_folders_name(monkeypatch, setting):
    before = cache.compiler()
    assert cache.compiler() == before
    monkeypatch.setattr(config, setting, 77)
    assert cache.compiler() != before


@pytest.mark.parametrize("module", ["numba", "llvmlite", "numpy"])
def test_so_is_the_version_of_each(monkeypatch, module):
    before = cache.compiler()
    monkeypatch.setattr(sys.modules[module], "__version__", "0.0")
    assert cache.compiler() != before


def test_the_digest_takes_no_time():
    def seconds():
        start = time.perf_counter()
        assert jit._digest(jit._files()) == jit.SOURCES
        return time.perf_counter() - start

    assert min(seconds() for _ in range(30)) < 0.002
    assert len(jit._files()) > 8


# -------------------------------------------------------------------------------------------------- where it is kept


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """The package folder of an installation, the user's cache folder, and one that the user chose."""
    package, home, chosen = (tmp_path / name for name in ("package", "home", "chosen"))
    package.mkdir()
    monkeypatch.setattr(cache, "HERE", package)
    monkeypatch.setattr(config, "CACHE_DIR", "")
    for name in ("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.setenv(name, str(home))
    return package, home, chosen


def test_the_package_folder_comes_first(installed):
    package, *others = installed
    _, written = cache.folders()
    assert written.parent == package / "__pycache__"
    assert written.is_dir()
    assert not any(other.exists() for other in others)


def test_a_package_folder_that_cannot_be_written_falls_back_to_the_users_cache(installed):
    package, home, chosen = installed
    (package / "__pycache__").touch()  # no folder can be made there, not by root either
    readable, written = cache.folders()
    assert home in written.parents
    assert written.is_dir()
    assert readable == [written]
    assert not chosen.exists()


def test_two_installations_share_no_folder(installed, monkeypatch):
    (installed[0] / "__pycache__").touch()
    one = cache.folders()[1]
    another = installed[0] / "another"
    another.mkdir()
    (another / "__pycache__").touch()
    monkeypatch.setattr(cache, "HERE", another)
    assert cache.folders()[1].parent != one.parent
    assert one.is_dir()


def test_without_any_place_each_process_compiles(installed, monkeypatch, capsys):
    package, home, _ = installed
    (package / "__pycache__").touch()
    home.touch()
    assert cache.folders() == ([], None)
    monkeypatch.setattr(cache, "_folders", cache.folders)
    assert declared()(1) == 11
    with kernels_ready():
        assert declared()(1) == 11
    assert "in every run; set NUMBA_CACHE_DIR to a writable folder" in capsys.readouterr().err


def test_numbas_own_setting_is_kept_to(installed, monkeypatch):
    package, home, chosen = installed
    monkeypatch.setattr(config, "CACHE_DIR", str(chosen))
    assert chosen in cache.folders()[1].parents
    assert not home.exists()
    assert not list(package.iterdir())


@pytest.fixture
def places(tmp_path, monkeypatch):
    """Three places, the first of which can be read only."""
    found = [tmp_path / name for name in ("installed", "mine", "never")]
    for place in found:
        place.mkdir()
    monkeypatch.setattr(cache, "_places", lambda: iter(found))
    can_write = cache._can_write
    monkeypatch.setattr(cache, "_can_write", lambda folder: found[0] not in folder.parents and can_write(folder))
    return found


def test_code_that_somebody_compiled_for_all_is_read(places):
    name = f"numba-{jit.SOURCES}-{cache.compiler()}"
    assert cache.folders() == ([places[1] / name], places[1] / name)
    (places[0] / name).mkdir()
    assert cache.folders() == ([places[0] / name, places[1] / name], places[1] / name)
    assert not list(places[2].iterdir())


def test_what_nobody_can_use_is_removed(places):
    others = {
        "other sources": (f"numba-{'0' * 16}-{cache.compiler()}", 0),
        "another compiler": (f"numba-{jit.SOURCES}-{'0' * 16}", 0),
        "another compiler, long ago": (f"numba-{jit.SOURCES}-{'1' * 16}", 31),
        "something else": ("anything", 1000),
    }
    for place in places:
        for name, days in others.values():
            (place / name).mkdir()
            (place / name / "file").touch()
            os.utime(place / name, (time.time() - 86400 * days,) * 2)
    mine = cache.folders()[1]
    assert {folder.name for folder in places[1].iterdir()} == {others["another compiler"][0], "anything", mine.name}
    for place in places[::2]:
        assert {folder.name for folder in place.iterdir()} == {name for name, _ in others.values()}
    os.utime(mine, (0, 0))
    cache.folders()
    assert time.time() - mine.stat().st_mtime < 60  # it is in use


# ------------------------------------------------------------------------------------------------------ many at once


def plain(x):
    return x + 10


def declared():
    """The kernel of `plain` as a process that starts now has it."""
    return jit.kernel(plain)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where kernels that are declared from now on are kept."""
    folder = tmp_path / "numba"
    monkeypatch.setattr(cache, "_folders", lambda: ([tmp_path / "empty", folder], folder))
    return folder


def compiles(kernel, x):
    """Whether kernel(x) compiles it, with the right value either way."""
    told = []
    with jit.compiling(told.append):
        assert kernel(x) == x + 10
    return told == [True]


def test_a_kernel_is_compiled_once_for_each_signature(folder):
    assert [compiles(declared(), x) for x in (1, 1, 2.5, 2, 3.5)] == [True, False, True, False, False]
    assert len(list(folder.iterdir())) == 4
    assert declared().stats.cache_path == str(folder)


@pytest.mark.soak(only=True)
def test_processes_that_compile_at_once(package):
    """The same kernels, and different signatures of one kernel, in different orders, and in the same one."""
    code = "from stltool.kernels.outer import outer; print(*(outer(x) for x in {}))"
    orders = {"(1, 2.5)": ["20", "35.0"], "(2.5, 1)": ["35.0", "20"], "(1, 2.5) ": ["20", "35.0"]}
    running = {order: started(package, code.format(order)) for order in list(orders)[: 3 if MORE > 1 else 2]}
    for order, process in running.items():
        assert words(process) == orders[order]
    (kept,) = package.glob("__pycache__/numba-*")
    assert len(list(kept.iterdir())) == 2 * 2 * 2  # an index and code: each of two kernels, for each of two types


def test_a_folder_removed_under_a_process_costs_nothing_but_time(folder):
    kernel = declared()
    assert compiles(kernel, 1)
    shutil.rmtree(folder)
    assert compiles(kernel, 2.5)
    assert not compiles(declared(), 2.5)


def test_a_disk_that_takes_nothing_does_not_end_the_run(folder):
    kernel = declared()
    folder.touch()
    assert compiles(kernel, 1)
    assert compiles(declared(), 1)


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("content", [b"", b"\x80\x05garbage", None], ids=["empty", "garbage", "half"])
def test_a_damaged_file_is_compiled_again(folder, ending, content):
    assert compiles(declared(), 1)
    (file,) = folder.glob(f"*.{ending}")
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2] if content is None else content)
    assert compiles(declared(), 1)
    assert not compiles(declared(), 1)


# --------------------------------------------------------------------------------------------------- what is said


def test_compiling_is_announced_once_and_loading_never(folder, capsys):
    for expected in ("compiling the numerical kernels (some seconds, once for this version)\n", ""):
        with kernels_ready():
            kernel = declared()
            assert (kernel(1), kernel(2.5)) == (11, 12.5)
        assert capsys.readouterr().err == expected
    with kernels_ready(quiet=True):
        assert declared()(True) == 11
    assert capsys.readouterr().err == ""


def test_kernels_that_a_check_compiles_are_announced_with_its_progress(folder, capsys):
    for expected in ("compiling the numerical kernels (some seconds, once for this version)\n", ""):
        with progress_bar("checking"):
            assert declared()(1) == 11
        assert capsys.readouterr().err == expected
    with progress_bar("checking", quiet=True):
        assert declared()(2.5) == 12.5
    assert capsys.readouterr().err == ""


def test_nobody_is_told_after_the_block(folder):
    told = []
    with jit.compiling(told.append):
        pass
    assert declared()(1) == 11
    assert told == []
