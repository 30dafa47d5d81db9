"""The command line in the tests' own process: all its tests are in this folder."""

import sys

import pytest

from stltool import cli


@pytest.fixture
def stltool(monkeypatch, capsys):
    """Run the command line in this process: (exit code, stdout, stderr), without how far a slow machine is."""
    monkeypatch.setattr("stltool.log.LOG._write", lambda line: None)

    def run(*args):
        monkeypatch.setattr(sys, "argv", ["stltool", *map(str, args)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        output = capsys.readouterr()
        assert "Traceback" not in output.err
        return ended.value.code or 0, output.out, output.err

    return run
