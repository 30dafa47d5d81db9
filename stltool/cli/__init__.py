"""The command line: parse arguments, call the public API, print.

Exit codes: 0 done, 1 the given bound does not hold or a monitored step is violated, 2 the input is at fault (a message
on stderr, no traceback), 3 stltool itself is.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

from stltool import streams
from stltool.cli.app import app
from stltool.errors import StlToolError

# each module registers its command, in the order of --help
# isort: off
from stltool.cli import run, check, verify, why, counterfactual, play, surrogate, tradeoff, pareto, frontier, shield
from stltool.cli import certify, estimate
from stltool.cli import learn, sweep, monitor, explain, fmt, lint, convert, export, report, diff, new, doctor

__all__ = [
    "app", "certify", "check", "convert", "counterfactual", "diff", "doctor", "estimate", "explain", "export",
    "fmt", "frontier", "learn", "lint", "main", "monitor", "new", "pareto", "play", "report", "run", "shield",
    "surrogate", "sweep", "tradeoff", "verify", "why",
]  # fmt: skip


def main() -> None:
    """The entry point: runs the app; faults in the user's input end with a message and exit code 2."""
    streams.prepare()
    try:
        try:
            with _heard_of():
                app(prog_name="stltool")
        finally:
            sys.stdout.flush()  # a failed write is reported here, not when Python exits
    except StlToolError as fault:
        _end(str(fault), 2)
    except (MemoryError, RecursionError) as fault:
        _end(f"too large for this machine ({type(fault).__name__}); shorten the windows or simplify the task", 2)
    except OSError as fault:
        _end(f"{fault.filename or 'output'}: {fault.strerror or fault}", 2)
    except Exception:  # our own fault: shown with its traceback, and distinct from exit code 1, "does not hold"
        traceback.print_exc()
        _end("this is a bug in stltool, not in your input; please report it with the lines above", 3)


@contextmanager
def _heard_of() -> Iterator[None]:
    """If the output goes to a log, report every ten seconds that a long command is still running."""
    if sys.stderr.isatty():
        yield
        return
    from stltool.log import LOG

    with LOG.stage(" ".join(["stltool", *sys.argv[1:2]])):
        yield


def _end(message: str, code: int) -> NoReturn:
    from stltool.reporting.terminal import error

    error(message)
    sys.exit(code)
