"""What is compiled beforehand is what is used: not the same kernels for read-only, strided or wider arrays."""

import subprocess
import sys

from tests.conftest import ROOT


def test_nothing_is_compiled_or_loaded_after_the_warm_up():
    """In a process of its own, since a kernel is loaded once a process: three seconds, most of them numba's import."""
    command = [sys.executable, "-W", "ignore", "-m", "tests.kernels.warmed_up"]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert (ran.returncode, ran.stdout) == (0, "no other type was needed\n"), ran.stderr
