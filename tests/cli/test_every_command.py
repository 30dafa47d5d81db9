"""What holds of every command: one JSON object, any encoding, a reader that leaves, a disk that is full."""

import io
import json
import os
import shlex
import subprocess
import sys

import pytest

from stltool import cli, log, streams
from stltool.log import Log
from tests.cli.every import CASES, COMMANDS, PRINTED, make_inputs, print_json
from tests.conftest import MORE, PATROLLING, some

HELP = [[], *([name] for name in COMMANDS)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("inputs")
    make_inputs(made)
    return made


@pytest.fixture
def printed(folder, tmp_path, monkeypatch):
    """Run the command line in this process with files of an encoding: (exit code, stdout, stderr)."""

    def run(encoding, *arguments):
        files = [tmp_path / "stdout", tmp_path / "stderr"]
        monkeypatch.chdir(folder)
        with files[0].open("w", encoding=encoding) as out, files[1].open("w", encoding=encoding) as err:
            monkeypatch.setattr(sys, "argv", ["stltool", *arguments])
            monkeypatch.setattr(sys, "stdout", out)
            monkeypatch.setattr(sys, "stderr", err)
            with pytest.raises(SystemExit) as ended:
                cli.main()
            sys.stdout.flush()
            sys.stderr.flush()
        return ended.value.code or 0, *(file.read_bytes() for file in files)

    return run


def started(*arguments, cwd, **options):
    command = [sys.executable, "-m", "stltool", *arguments]
    return subprocess.run(command, cwd=cwd, stderr=subprocess.PIPE, **options)


def no_constant(text):
    raise AssertionError(f"{text} is no JSON")


def test_every_command_has_a_case_and_json():
    assert set(CASES) == set(COMMANDS)
    assert [name for name, command in COMMANDS.items() if "as_json" not in {p.name for p in command.params}] == []


@pytest.mark.parametrize("name", CASES)
def test_help_ends_with_an_example_that_is_a_command(name):
    said, _, example = COMMANDS[name].epilog.partition(": ")
    program, command, *arguments = shlex.split(example)
    assert (said, program, command) == ("Example", "stltool", name)
    given = COMMANDS[name].make_context(name, arguments).params
    assert set(given) == {parameter.name for parameter in COMMANDS[name].params} - {"help"}


@pytest.mark.soak
def test_json_is_one_object_and_nothing_else(once):
    printed = once("json", print_json)
    for name in PRINTED:
        out, err = ((printed / f"{name}.{kind}").read_bytes() for kind in ("out", "err"))
        assert isinstance(json.loads(out, parse_constant=no_constant), dict), name
        assert out.count(b"\n") == 1, name
        assert b"error" not in err, name  # on a slow machine it says how far it is
    assert (printed / "end.out").read_bytes() == b""


@pytest.mark.soak
@pytest.mark.parametrize("name", list(CASES) if MORE > 1 else ["explain"])
def test_so_it_is_of_a_process_of_its_own(folder, name):
    """A second each, so `make test` starts one of those that load little."""
    done = started(name, *CASES[name], "--json", cwd=folder, stdout=subprocess.PIPE)
    assert done.returncode == 0, done.stderr
    assert isinstance(json.loads(done.stdout, parse_constant=no_constant), dict)
    assert done.stdout.count(b"\n") == 1


@pytest.mark.soak
@pytest.mark.parametrize(
    ("name", "encoding"), [*((name, "ascii") for name in CASES), *((name, "cp1252") for name in some(CASES))]
)
def test_every_command_prints_in_any_encoding(printed, name, encoding):
    code, out, err = printed(encoding, name, *CASES[name])
    assert (code, b"fault of stltool" in err) == (0, False), err
    printed_text = out.decode(encoding)
    assert printed_text or name in ("fmt", "lint")  # which have nothing to say of a file in order
    assert "\\u" not in printed_text  # a stand-in that nobody can read
    assert "\\x" not in printed_text


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_every_help_prints_in_any_encoding(printed, encoding):
    for arguments in HELP:
        code, out, err = printed(encoding, *arguments, "--help")
        assert (code, err) == (0, b"")
        lines = out.decode(encoding).splitlines()
        assert "\\u" not in "".join(lines)
        assert len({len(line) for line in lines if line.startswith(("|", "+"))}) == 1  # the frames are straight


def test_columns_are_measured_as_they_are_printed(printed):
    _, out, _ = printed("ascii", "surrogate", *CASES["surrogate"])
    heading, *rows = out.decode().splitlines()[2:]
    assert rows[0].startswith("discounted gamma = 0.999  ")
    assert rows[0].index("0.999") + len("0.999  ") == heading.index("P, ties at random")


LIGHT = """
import sys
from stltool.cli import main
sys.argv = ["stltool", *sys.argv[1:]]
try:
    main()
finally:
    assert not {"numpy", "numba", "scipy", "matplotlib"} & set(sys.modules)
"""


@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["check", "--help"]])
def test_what_computes_nothing_loads_nothing_heavy(arguments):
    done = subprocess.run([sys.executable, "-c", LIGHT, *arguments], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_stand_ins():
    shown = "τ × Φ₁ ≤ 1 → … ─│└ “é” 漢"
    assert shown.encode("ascii", errors="stltool").decode() == 'tau x Phi\\u2081 <= 1 -> ... -|+ "\\xe9" \\u6f22'
    assert shown.encode("cp1252", errors="stltool").decode("cp1252") == ("tau × Phi\\u2081 <= 1 -> … -|+ “é” \\u6f22")
    assert "τ".encode(errors="stltool").decode() == "τ"
    assert "\udcff".encode(errors="stltool") == b"\\udcff"  # of a file's name that is no text
    assert streams.stand_in("█") == "#"


def test_texts_of_files_stay_whole(folder, tmp_path):
    """What a filter prints is a file's content: UTF-8, not the terminal's encoding, and no stand-ins."""
    text = "# Straße → τ\np := F[0,3] A\n".encode()
    env = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = started("fmt", "-", cwd=tmp_path, input=text, stdout=subprocess.PIPE, env=env)
    assert (done.returncode, done.stdout, done.stderr) == (0, text, b"")


@pytest.mark.skipif(sys.platform == "win32", reason="its pipes end otherwise")
@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["--help"], 0),
        (["check", *CASES["check"], "--json"], 0),
        (["check", *CASES["check"], "--at-most", "0.5"], 1),
        (["check", "none.stl"], 2),
    ],
)
def test_who_reads_no_further_changes_nothing(folder, arguments, code):
    """As of `stltool ... | head`: no word about it, and the exit code is the command's."""
    read, write = os.pipe()
    os.close(read)
    done = started(*arguments, cwd=folder, stdout=write)
    os.close(write)
    assert (done.returncode, b"Traceback" in done.stderr, b"Broken" in done.stderr) == (code, False, False)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_what_cannot_be_written_is_told(folder):
    with open("/dev/full", "w") as full:
        done = started("check", *CASES["check"], cwd=folder, stdout=full)
    told = [line for line in done.stderr.splitlines() if not line.endswith(b" s so far")]  # on a slow machine
    assert (done.returncode, told) == (2, [b"error: output: No space left on device"])


def test_every_command_is_watched_off_a_terminal(stltool, monkeypatch):
    """Also where it shows no bar, and also with --json; on a terminal nothing is added."""
    seen = []

    class Spy(Log):
        def stage(self, title, patience=None):
            seen.append(title)
            return super().stage(title, patience)

    monkeypatch.setattr(log, "LOG", Spy(lambda line: None, watched=False))
    assert stltool("explain", "F[0,3] A", "--json")[0] == 0
    assert seen == ["stltool explain"]
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    stltool("explain", "F[0,3] A", "--json")
    assert isinstance(sys.stderr, io.TextIOBase)


def test_a_command_whose_kernels_are_loaded_says_nothing(stltool):
    for _ in range(2):
        code, _, err = stltool("check", PATROLLING, "-p", "T=2", "-p", "tau=2")
    assert (code, err) == (0, "")
