"""The words of HTML pages and of the pictures in them."""

import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

from tests.cli.every import CASES, make_inputs
from tests.conftest import ROOT
from tests.golden.capture import SECONDS, command, shown

DIGEST = re.compile(r"[0-9a-f]{16}")
PAGES = {
    "out/report.html": ["run", *CASES["run"]],
    "decided/report.html": ["run", "decided.stl", "--out", "decided"],
    "verified/report.html": ["verify", *CASES["verify"], "--report", "verified"],
    "lake/report.html": ["run", "crossing-blackbox.stl", "-p", "T=10", "-e", "20", "--rollouts", "9", "--out", "lake"],
    "swept/report.html": ["sweep", *CASES["sweep"]],
    "log.svg": ["monitor", "G[0,1] x > 0", "trace.csv", "--plot", "log.svg"],
    "front.svg": ["pareto", *CASES["pareto"], "--plot", "front.svg"],
}


def entries():
    make_inputs(Path())
    for name in ("crossing-blackbox.stl", "lake-blackbox.toml"):
        shutil.copy(ROOT / "examples" / "frozenlake" / name, name)
    Path("decided.stl").write_text('model "floor-5x5.toml"\ndecided := F[0,3] !A\n')
    for path, arguments in PAGES.items():
        code, _, err = command(*arguments)
        assert code in (0, 1), err
        lines = Words(Path(path).read_text(encoding="utf-8")).lines
        yield f"{path}: {shown(*arguments)}", SECONDS.sub("# s", "\n".join(dict.fromkeys(lines)))


class Words(HTMLParser):
    """The texts of a page, an element a line; numbers alone and digests are left out."""

    INLINE = ("a", "b", "code", "em", "i", "span", "strong", "sub", "sup", "tspan")

    def __init__(self, page):
        super().__init__()
        self.lines, self._inside = [""], []
        self.feed(page)
        lines = (" ".join(line.split()) for line in self.lines)
        self.lines = [line for line in lines if any(map(str.isalpha, line)) and not DIGEST.fullmatch(line)]

    def handle_starttag(self, tag, attrs):
        self._inside.append(tag)
        if tag not in self.INLINE:
            self.lines.append("")
        for name, value in attrs:
            if name in ("alt", "title", "aria-label"):
                self.lines.append(f"{name}: {value}")

    def handle_endtag(self, tag):
        while self._inside and self._inside.pop() != tag:
            pass
        if tag not in self.INLINE:
            self.lines.append("")

    def handle_data(self, data):
        if not {"style", "script", "metadata"} & set(self._inside):
            self.lines[-1] += data
