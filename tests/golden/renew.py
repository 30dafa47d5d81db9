"""Write the golden files again: `python -m tests.golden.renew [KIND ...]`."""

import sys
from pathlib import Path

from tests.conftest import ROOT
from tests.golden import arguments, files, helps, language, options, pages, terminal
from tests.golden.capture import folder

KINDS = {
    "help": helps.entries,  # --help of every command
    "language": language.entries,  # refusals of formulas and task files
    "files": files.entries,  # of models, traces, policies, certificates, sweeps, checkpoints, reports
    "arguments": arguments.entries,  # of the library's public functions
    "options": options.entries,  # of the command line
    "terminal": terminal.entries,  # what commands print
    "pages": pages.entries,  # the words of HTML reports and pictures
}


def path_of(kind):
    return Path(__file__).with_name(f"{kind}.txt")


def text_of(kind):
    """The whole golden file: what was given, indented what was said."""
    blocks = [f"# python -m tests.golden.renew {kind}"]
    with folder() as here:
        for given, said in KINDS[kind]():
            lines = "\n".join(f"    {line}".rstrip() for line in said.splitlines())
            blocks.append(f"{given}\n{lines}".rstrip().replace(f"{here}/", "").replace(f"{ROOT}/", ""))
    return "\n\n".join(blocks) + "\n"


if __name__ == "__main__":
    for kind in sys.argv[1:] or KINDS:
        path_of(kind).write_text(text_of(kind), encoding="utf-8")
