"""Processes of the tests' own, and a sweep that runs long enough to be killed in."""

import contextlib
import os
import signal
import subprocess
import sys

import psutil

from tests.conftest import FACTORY, ROOT

# runs long enough to be killed in, whatever their speed: evaluations cost milliseconds each
LONG = f"""
[sweep]
seeds = 6
settings = {{ episodes = 15, evaluate_every = 1 }}
[[method]]
name = "cfer"
faithful = true
[[scenario]]
id = "P"
task = "{FACTORY}/patrolling.stl"
model = "{FACTORY}/floor-10x10.toml"
params = {{ T = 10, tau = 5 }}
"""


@contextlib.contextmanager
def running(*command, cwd=ROOT):
    """A process group of its own, all of which is gone afterwards."""
    process = subprocess.Popen(
        [sys.executable, *map(str, command)],
        cwd=cwd, start_new_session=True, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def children(process):
    return [
        child for child in psutil.Process(process.pid).children(recursive=True)
        if "spawn_main" in " ".join(child.cmdline())
    ]  # fmt: skip
