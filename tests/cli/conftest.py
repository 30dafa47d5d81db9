"""The command line in the tests' own process: all its tests are in this folder."""

import re
import sys

import pytest

from stltool import cli


@pytest.fixture
def stltool(monkeypatch, capsys):
    """Run the command line in this process: (exit code, stdout, stderr without what a slow or new machine adds)."""

    def run(*args):
        monkeypatch.setattr(sys, "argv", ["stltool", *map(str, args)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        output = capsys.readouterr()
        assert "Traceback" not in output.err
        err = re.sub(
            r"^((stltool \w+|loading the numerical kernels): .* so far|compiling the numerical kernels .*)\n",
            "",
            output.err,
            flags=re.MULTILINE,
        )
        return ended.value.code or 0, output.out, err

    return run
