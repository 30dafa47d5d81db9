"""What the kinds have in common: rows of other tests' tables, refusals, and commands run in this process."""

import contextlib
import io
import os
import re
import shlex
import sys
import tempfile
from pathlib import Path
from unittest import mock

from stltool import cli
from stltool.errors import StlToolError

SECONDS = re.compile(r"\b\d+(\.\d+)?(e-\d+)? s\b")
ENVIRONMENT = {"COLUMNS": "120", "NO_COLOR": "1", "TERM": "dumb"}


def rows(test):
    """The rows of a parametrized test, each a tuple."""
    mark = next(mark for mark in test.pytestmark if mark.name == "parametrize")
    names, values = mark.args
    single = isinstance(names, str) and "," not in names
    return [(row,) if single else row for row in values]


def refusal(act, *given, **named):
    """The message with which a call is refused."""
    try:
        act(*given, **named)
    except (StlToolError, TypeError, ValueError) as error:
        return str(error)
    raise AssertionError(f"{given} {named} is not refused")


@contextlib.contextmanager
def folder():
    """An empty folder to work in, so that messages name files alone; what would make output vary is fixed."""
    with (
        tempfile.TemporaryDirectory() as made,
        contextlib.chdir(made),
        memory(2_000_000_000),
        mock.patch("stltool.log.LOG._write"),  # how far a slow machine is
        mock.patch.dict(os.environ, ENVIRONMENT),
    ):
        yield Path(made).resolve()


@contextlib.contextmanager
def memory(available):
    """A machine with so many bytes free, which are asked for however little is needed."""
    machine = mock.Mock(available=available)
    with mock.patch("psutil.virtual_memory", return_value=machine), mock.patch("stltool.sizes._LITTLE", 0):
        yield


def command(*arguments):
    """Run the command line in this process: (exit code, stdout, stderr)."""
    streams = [io.TextIOWrapper(io.BytesIO(), encoding="utf-8", newline="\n") for _ in range(2)]
    code = 0
    with (
        mock.patch.object(sys, "argv", ["stltool", *map(str, arguments)]),
        contextlib.redirect_stdout(streams[0]),
        contextlib.redirect_stderr(streams[1]),
    ):
        try:
            cli.main()
        except SystemExit as ended:
            code = ended.code or 0
    texts = []
    for stream in streams:
        stream.flush()
        texts.append(stream.buffer.getvalue().decode())
    return code, *texts


def shown(*arguments):
    """A command as it is typed."""
    return "$ " + shlex.join(["stltool", *map(str, arguments)])


def said(code, out, err):
    """What a command printed, as an entry's text; what differs from run to run is replaced."""
    parts = [out, *(f"stderr: {line}" for line in err.splitlines()), *([f"exit code {code}"] if code else [])]
    return SECONDS.sub("# s", "\n".join(part.rstrip() for part in parts if part))
