"""The figures of README and docs, checked against the commands that produce them: `make claims`.

docs/claims.toml lists them. A claim names its page, the text with its figures in braces (or the first line of a table
or of a block of output, or a picture), the command that produces them, how the figures are found in its output, and how
far they may be off. Whatever else looks like a figure on a page is listed there as `plain`, with the reason why it is
not a measurement; tests/test_claims.py fails on a figure that is neither.

    make claims                         check the quick claims, which the test suite checks too
    make claims CLASS=minutes           quick, minutes, bench (up to an hour, alone on the machine), or all
    make claims ONLY=monitors,front     claims by name
    make claims UPDATE=1                write what was measured into the pages
    make claims CLASS=all LIST=1        show them, and when they were last checked

Claims of the classes `minutes` and `bench` are not run by the test suite. docs/claims.json keeps for each when, at
which commit and on which machine it was last found to hold, and a digest of what the page said then: a page that has
changed since fails the tests until the claim is checked again. So does a program that has changed, where a claim has a
canary: a short run of the same program, which the test suite runs, and whose output is kept as a digest too.
"""

from __future__ import annotations

import argparse
import datetime
import hashlib
import importlib.util
import json
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
BOOK = ROOT / "docs" / "claims.toml"
RECORD = ROOT / "docs" / "claims.json"
OUTSIDE = Path(os.environ.get("STLTOOL_OUTSIDE_DATA", ROOT.parent / "shared" / "data"))
CLASSES = ("quick", "minutes", "bench")

_SPACES = " \u00a0\u202f"
NUMBER = rf"[−-]?\d+(?:[{_SPACES}]\d{{3}}(?!\d))*(?:\.\d+)?(?:e[+−-]?\d+)?(?:/\d+)?"
_FIGURE = re.compile(r"(?<![\w.])\d+(?:[.,]\d+)*(?:e[+−-]?\d+)?")  # what looks like one; P1 or s₀ does not
_PLACEHOLDER = re.compile(r"\{(\w+)\}")
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
_SECONDS = re.compile(r"\b\d+(?:\.\d+)?(?:e-\d+)? (m?s)\b")
_SOURCES = {"find", "json", "seconds"}
_TOLERANCES = {"relative", "at_least", "at_most"}
_CLAIM_KEYS = {
    "name", "page", "text", "table", "block", "picture", "command", "canary", "class", "values", "columns", "relative",
    "absolute", "needs", "fails",
}  # fmt: skip


class ClaimError(Exception):
    """A claim that cannot be checked as it is written."""


@dataclass(frozen=True)
class Output:
    """What a claim's commands printed, in their order, and how long each took."""

    text: str
    seconds: tuple[float, ...]


@dataclass(frozen=True)
class Value:
    """How one figure is found in a command's output, and how far it may be from the page's.

    find     a regular expression whose first group is the figure;  json  a pointer into the JSON object printed
    seconds  the time of the command with this number, from 0
    scale    what a measured number is multiplied by
    relative r   |measured − stated| ≤ r·|stated|;   at_least r   measured ≥ r·stated;   at_most r   measured ≤ r·stated
    none of them: the measured number, written with as many digits, is the page's
    """

    find: str | None = None
    json: str | None = None
    seconds: int | None = None
    scale: float = 1.0
    relative: float | None = None
    at_least: float | None = None
    at_most: float | None = None

    def measured(self, output: Output) -> str:
        if self.find is not None:
            found = re.search(self.find, output.text, flags=re.MULTILINE)
            if found is None:
                raise ClaimError(f"the output has nothing like {self.find}")
            return found[1]
        if self.seconds is not None:
            return repr(output.seconds[self.seconds])
        value: Any = json.loads(output.text)
        for step in (self.json or "").strip("/").split("/"):
            try:
                value = value[int(step)] if isinstance(value, list) else value[step]
            except (LookupError, TypeError, ValueError):
                raise ClaimError(f"the JSON printed has nothing at {self.json}") from None
        return value if isinstance(value, str) else repr(value)

    def holds(self, stated: str, measured: str) -> bool:
        if stated == measured:
            return True
        try:
            page, run = number(stated), number(measured) * Fraction(self.scale)
        except ValueError:
            return False
        if self.relative is not None:
            return abs(run - page) <= Fraction(self.relative) * abs(page)
        if self.at_least is not None:
            return run >= Fraction(self.at_least) * page
        if self.at_most is not None:
            return run <= Fraction(self.at_most) * page
        return alike_in_style(run, stated) == stated

    def text(self, stated: str, measured: str) -> str:
        """The measured figure in the style of the stated one."""
        try:
            return alike_in_style(number(measured) * Fraction(self.scale), stated)
        except ValueError:
            return measured


@dataclass(frozen=True)
class Claim:
    """One entry of docs/claims.toml; exactly one of `text`, `table`, `block` and `picture` says what is claimed.

    `canary` is a quick command whose output is the same as long as that of `command` is.
    """

    name: str
    page: str
    command: tuple[str, ...]
    kind: str
    canary: str | None = None
    text: str | None = None
    table: str | None = None
    block: str | None = None
    picture: bool = False
    values: Mapping[str, Value] = field(default_factory=dict)
    columns: Mapping[str, float | str] = field(default_factory=dict)
    relative: float = 0.0
    absolute: float = 0.0
    needs: tuple[str, ...] = ()
    fails: bool = False

    def missing(self) -> str | None:
        """What the command needs and this machine does not have."""
        for need in self.needs:
            if not (OUTSIDE / need).exists() if "/" in need else importlib.util.find_spec(need) is None:
                return need
        return None


@dataclass(frozen=True)
class Plain:
    """Text with numbers that are no measurements, on one page or, with page "*", on any."""

    page: str
    patterns: tuple[str, ...]
    why: str


@dataclass(frozen=True)
class Book:
    claims: tuple[Claim, ...]
    plain: tuple[Plain, ...]


@dataclass(frozen=True)
class Difference:
    """A place where page and command disagree: the span in the page, what stands there, what was measured."""

    start: int
    end: int
    stated: str
    measured: str

    def __str__(self) -> str:
        return f"stated {self.stated.strip()}, measured {self.measured.strip()}"


def load(path: Path = BOOK) -> Book:
    """The claims, each checked for what it must say."""
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    claims = tuple(_claim(entry) for entry in data["claim"])
    names = [claim.name for claim in claims]
    if twice := {name for name in names if names.count(name) > 1}:
        raise ClaimError(f"two claims are called {', '.join(sorted(twice))}")
    return Book(claims, tuple(Plain(**{**entry, "patterns": tuple(entry["patterns"])}) for entry in data["plain"]))


def _claim(entry: dict[str, Any]) -> Claim:
    name = entry.get("name", "a claim without name")
    if unknown := set(entry) - _CLAIM_KEYS:
        raise ClaimError(f"{name}: unknown keys {', '.join(sorted(unknown))}")
    if sum(key in entry for key in ("text", "table", "block", "picture")) != 1:
        raise ClaimError(f"{name}: give one of text, table, block and picture")
    if entry["class"] not in CLASSES:
        raise ClaimError(f"{name}: class is {entry['class']}; choose one of {', '.join(CLASSES)}")
    if "canary" in entry and entry["class"] == "quick":
        raise ClaimError(f"{name}: the test suite runs quick claims themselves; drop canary")
    values = {key: Value(**given) for key, given in entry.get("values", {}).items()}
    for key, given in entry.get("values", {}).items():
        if len(set(given) & _SOURCES) != 1 or len(set(given) & _TOLERANCES) > 1:
            raise ClaimError(f"{name}: value {key} needs one of find, json and seconds, and one tolerance at most")
    named = set(_PLACEHOLDER.findall(entry.get("text", ""))) - {"_"}
    if named != set(values):
        raise ClaimError(f"{name}: the text has {{{', '.join(sorted(named))}}}, values are {', '.join(sorted(values))}")
    commands = entry["command"]
    given = {key: entry[key] for key in entry if key not in ("class", "command", "values", "needs", "text")}
    return Claim(
        **given,
        kind=entry["class"],
        command=(commands,) if isinstance(commands, str) else tuple(commands),
        text=entry["text"].strip() if "text" in entry else None,
        values=values,
        needs=tuple(entry.get("needs", ())),
    )


# ------------------------------------------------------------------------------------------------------- numbers


def number(text: str) -> Fraction:
    """A figure as pages write it: a thin or plain space between thousands, − for minus, 1.4e−06, 3/4."""
    plain = re.sub(rf"[{_SPACES}]", "", text.strip()).replace("−", "-")
    return Fraction(plain)


def alike_in_style(value: Fraction, like: str) -> str:
    """The number written as another one is: as many digits, the same exponent, minus and thousands."""
    digits = re.sub(rf"[{_SPACES}]", "", like)
    if "/" in digits:
        return f"{value.numerator}/{value.denominator}"
    mantissa, _, exponent = digits.replace("−", "-").partition("e")
    decimals = len(mantissa.partition(".")[2])
    if exponent:
        text = f"{float(value):.{decimals}e}"
        head, _, power = text.partition("e")
        width = len(exponent.lstrip("+-"))
        sign = "-" if power.startswith("-") else "+" if exponent.startswith("+") else ""
        text = f"{head}e{sign}{power.lstrip('+-').lstrip('0').rjust(width, '0')}"
    else:
        text = f"{float(value):.{decimals}f}" if decimals else str(round(value))
    for space in _SPACES:
        if space in like:
            whole, dot, rest = text.partition(".")
            text = f"{int(whole):,}".replace(",", space) + dot + rest
    return text.replace("-", "−") if "−" in like else text


def alike(stated: str, measured: str, relative: float = 0.0, absolute: float = 0.0) -> bool:
    """Whether two texts are the same but for spaces, seconds, and numbers that far apart."""
    pieces = [re.split(rf"({NUMBER})", re.sub(r"\s+", " ", _SECONDS.sub(r"# \1", text))) for text in (stated, measured)]
    if len(pieces[0]) != len(pieces[1]):
        return False
    for i, (a, b) in enumerate(zip(*pieces, strict=True)):
        if a.strip() != b.strip():
            if i % 2 == 0 or not (relative or absolute):
                return False
            x, y = number(a), number(b)
            if abs(x - y) > Fraction(relative) * abs(x) + Fraction(absolute):
                return False
    return True


# --------------------------------------------------------------------------------------------- claims in their page


def find(claim: Claim, page: str) -> re.Match[str]:
    """Where the page makes the claim: once, or a ClaimError. A text's figures are the groups of their names."""
    if claim.text is not None:
        found = list(re.finditer(_template(claim.text), page))
        what = f"the text {claim.text!r}"
    elif claim.table is not None:
        found = list(re.finditer(rf"^{re.escape(claim.table)}.*\n(?:\|.*\n)+", page, flags=re.MULTILINE))
        what = f"a table that begins with {claim.table!r}"
    elif claim.block is not None:
        found = [fence for fence in _FENCE.finditer(page) if fence[2].startswith(claim.block)]
        what = f"a block that begins with {claim.block!r}"
    else:
        found = [match] if (match := re.match(r"(?s).*", page)) else []
        what = "a picture"
    if len(found) != 1:
        raise ClaimError(f"{claim.page} has {what} {len(found)} times")
    return found[0]


def _template(text: str) -> str:
    seen: set[str] = set()

    def group(name: str) -> str:
        if name == "_":
            return NUMBER
        if name in seen:
            return f"(?P={name})"
        seen.add(name)
        return f"(?P<{name}>{NUMBER})"

    pieces = _PLACEHOLDER.split(text)
    literal = [r"\s+".join(map(re.escape, re.split(r"\s+", piece))) for piece in pieces[::2]]
    return literal[0] + "".join(group(name) + rest for name, rest in zip(pieces[1::2], literal[1:], strict=True))


def differences(claim: Claim, page: str, output: Output) -> Iterator[Difference]:
    """Where the page says something else than the commands' output."""
    match = find(claim, page)
    if claim.text is not None:
        for name, value in claim.values.items():
            measured = value.measured(output)
            if not value.holds(match[name], measured):
                yield Difference(match.start(name), match.end(name), match[name], value.text(match[name], measured))
    elif claim.table is not None:
        yield from _table_differences(claim, match, output.text)
    elif claim.block is not None:
        yield from _block_differences(claim, match, output.text)
    elif not alike(_drawing(page), _drawing(output.text), absolute=0.01):
        yield Difference(match.start(), match.end(), "another picture", output.text)


def _table_differences(claim: Claim, match: re.Match[str], output: str) -> Iterator[Difference]:
    """Row by row; cells of a column with a tolerance are compared as numbers, with tolerance "any" not at all."""
    try:
        measured = find(claim, output.rstrip() + "\n")[0].splitlines()
    except ClaimError as error:
        raise ClaimError(f"the output is no such table: {error}") from None
    stated = match[0].splitlines()
    if stated[0] != measured[0] or len(stated) != len(measured):
        yield Difference(*match.span(), match[0], "\n".join(measured) + "\n")
        return
    tolerances = [claim.columns.get(cell, claim.relative) for cell in _cells(stated[0])]
    place = match.start()
    for row, run in zip(stated, measured, strict=True):
        cells, others = _cells(row), _cells(run)
        if len(cells) != len(others):
            raise ClaimError(f"the output's row {run} has {len(others)} cells, the page's {len(cells)}")
        pairs = zip(cells, others, tolerances, strict=True)
        kept = [a if r == "any" or alike(a, b, float(r)) else b for a, b, r in pairs]
        if kept != cells:
            yield Difference(place, place + len(row), row, f"| {' | '.join(kept)} |")
        place += len(row) + 1


def _cells(row: str) -> list[str]:
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", row)[1:-1]]


def _block_differences(claim: Claim, match: re.Match[str], output: str) -> Iterator[Difference]:
    """The block's lines must come one after another in the output; a first line "$ command" is the command's."""
    start, text = match.start(2), match[2].rstrip("\n")
    if text.startswith("$ "):
        shown, _, text = text.partition("\n")
        if shlex.split(shown[2:]) != shlex.split(claim.command[-1]):
            raise ClaimError(f"the page shows another command: {shown[2:]}")
        start += len(shown) + 1
    stated, measured = text.split("\n"), output.rstrip("\n").split("\n")
    tries = ["\n".join(measured[i : i + len(stated)]) for i in range(max(1, len(measured) - len(stated) + 1))]
    if not any(alike(text, lines, claim.relative, claim.absolute) for lines in tries):
        first = next((i for i, line in enumerate(measured) if line.split()[:1] == stated[0].split()[:1]), 0)
        run = "\n".join(line.rstrip() for line in measured[first : first + len(stated)])
        yield Difference(start, start + len(text), text, run)


def _drawing(svg: str) -> str:
    """What a picture shows: without names of its parts, parts without content, and notes about the file."""
    svg = re.sub(r"(?s)<metadata>.*?</metadata>", "", svg)
    svg = re.sub(r"<g id=\"[^\"]*\"/>", "", svg)
    return re.sub(r" id=\"[^\"]*\"|#[\w-]+(?=[\")])", "", svg)


def digest(claim: Claim, page: str) -> str:
    """What the page says there, in short: spaces do not count."""
    match = find(claim, page)
    told = [match[name] for name in sorted(claim.values)] if claim.text is not None else [match[0]]
    return _short_digest("\n".join(told))


def _short_digest(text: str) -> str:
    """Of a text, whatever its spaces."""
    return hashlib.sha256(re.sub(r"\s+", " ", text).encode()).hexdigest()[:16]


# -------------------------------------------------------------------------------------- what no claim speaks of


def uncovered(book: Book, name: str, page: str) -> list[tuple[int, str, str]]:
    """(line, figure, its line of text) of every figure on a page that is neither claimed nor plain.

    Not looked at: blocks that the test suite runs (console in docs, python), or that are code (toml, bibtex), indented
    formulas, code within lines, and the targets of links.
    """
    rest = list(page)

    def blank(start: int, end: int) -> None:
        for i in range(start, end):
            if rest[i] != "\n":
                rest[i] = " "

    for fence in _FENCE.finditer(page):
        if fence[1] in ("python", "toml", "bibtex") or (fence[1] == "console" and name != "README.md"):
            blank(*fence.span())
    for hidden in (r"^    .*$", r"``?[^`\n]+``?", r"\]\([^)\s]+\)"):
        for match in re.finditer(hidden, "".join(rest), flags=re.MULTILINE):
            if not any(fence.start() <= match.start() < fence.end() for fence in _FENCE.finditer(page)):
                blank(*match.span())
    for claim in book.claims:
        if claim.page == name:
            match = find(claim, page)
            start = match.start()
            for a, b in _others(claim.text, match[0]) if claim.text is not None else ():
                blank(start, match.start() + a)  # a figure that is left to another claim stays
                start = match.start() + b
            blank(start, match.end())
    for plain in book.plain:
        if plain.page in ("*", name):
            for pattern in plain.patterns:
                for match in re.finditer(pattern, page, flags=re.MULTILINE):
                    blank(*match.span())
    lines = page.splitlines()
    left = "".join(rest).splitlines()
    return [(i + 1, m[0], lines[i].strip()) for i, line in enumerate(left) for m in _FIGURE.finditer(line)]


def _others(template: str, text: str) -> list[tuple[int, int]]:
    """The spans, within a claim's text and in order, of figures that it leaves to another claim: {_}."""
    numbered = iter(range(len(template)))
    named = re.sub(r"\{_\}", lambda _: f"{{other_{next(numbered)}}}", template)
    match = re.fullmatch(_template(named), text)
    assert match is not None
    return [match.span(name) for name in match.groupdict() if name.startswith("other_")]


def pages(root: Path = ROOT) -> dict[str, Path]:
    """Name → path of the pages whose figures must be claims."""
    return {str(p.relative_to(root)): p for p in [root / "README.md", *sorted((root / "docs").glob("*.md"))]}


# ------------------------------------------------------------------------------------------------------- running


def execute(command: str, folder: Path, fails: bool = False) -> str:
    """What a command prints in a process of its own; where it is to fail, what it says then."""
    words = shlex.split(command)
    if words[0] in ("stltool", "python"):
        words[:1] = [sys.executable] + ["-m", "stltool"] * (words[0] == "stltool")
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "PYTHONIOENCODING": "utf-8"}
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, encoding="utf-8", env=environment)
    if (done.returncode == 2) != fails or done.returncode > 2:  # 1 is an answer: a bound that does not hold
        raise ClaimError(f"{command} ended with exit code {done.returncode}: {done.stderr.strip()[-500:]}")
    return done.stderr if fails else done.stdout


class Runs:
    """Commands run so far: claims that begin with the same command share its folder and what was run there."""

    def __init__(self, folder: Path, execute: Callable[[str, Path, bool], str] = execute) -> None:
        self._folder, self._execute = folder, execute
        self._folders: dict[str, Path] = {}
        self._done: dict[tuple[Path, str], tuple[str, float]] = {}

    def of(self, claim: Claim) -> Output:
        here = self._folders.get(claim.command[0])
        if here is None:
            here = self._folders[claim.command[0]] = self._folder / str(len(self._folders))
            furnish(here)
        done = [self._run(command, here, claim.fails) for command in claim.command]
        text = "".join(text for text, _ in done)
        if claim.picture:
            text = (here / Path(claim.page).name).read_text(encoding="utf-8")
        return Output(text, tuple(seconds for _, seconds in done))

    def of_canary(self, claim: Claim) -> str | None:
        """A digest of what the claim's canary prints; None if it has none."""
        if claim.canary is None:
            return None
        here = self._folder / "canary"
        if not here.exists():
            furnish(here)
        return _short_digest(self._run(claim.canary, here, False)[0])

    def _run(self, command: str, here: Path, fails: bool) -> tuple[str, float]:
        key = (here, command)
        if key not in self._done:
            start = time.perf_counter()
            text = self._execute(command.replace("$OUTSIDE", shlex.quote(str(OUTSIDE))), here, fails)
            self._done[key] = (text, time.perf_counter() - start)
        return self._done[key]


def furnish(folder: Path) -> None:
    """What commands may read: the examples, copied, and links to the programs of bench and docs."""
    folder.mkdir(parents=True)
    shutil.copytree(ROOT / "examples", folder / "examples")
    for name in ("bench", "docs"):
        (folder / name).symlink_to(ROOT / name, target_is_directory=True)


def check(claim: Claim, runs: Runs) -> list[Difference]:
    """Where the claim's page and its commands disagree."""
    page = (ROOT / claim.page).read_text(encoding="utf-8")
    find(claim, page)
    return list(differences(claim, page, runs.of(claim)))


def recorded() -> dict[str, Any]:
    return json.loads(RECORD.read_text(encoding="utf-8")) if RECORD.exists() else {}


def record(claim: Claim, page: str, seconds: float, canary: str | None) -> None:
    """Keep that the claim held just now, and what its canary printed."""
    known = recorded()
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty=, changed"], cwd=ROOT, capture_output=True, text=True
    ).stdout.strip()
    known[claim.name] = {
        "says": digest(claim, page),
        "date": str(datetime.date.today()),
        "commit": commit,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
        "seconds": round(seconds, 1),
        **({"canary": canary} if canary is not None else {}),
    }
    RECORD.write_text(json.dumps(dict(sorted(known.items())), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def amend(path: Path, found: Sequence[Difference]) -> None:
    """Write what was measured into the page, from the end so that places stay."""
    text = path.read_text(encoding="utf-8")
    for difference in sorted(found, key=lambda d: d.start, reverse=True):
        text = text[: difference.start] + difference.measured + text[difference.end :]
    path.write_text(text, encoding="utf-8")


def _listed(claim: Claim) -> str:
    """A claim with its page, its class, and when it was last found to hold."""
    last = recorded().get(claim.name)
    when = "in every test run" if claim.kind == "quick" else "never checked"
    if last is not None:
        when = f"last on {last['date']} at {last['commit']}, {last['machine']}"
    return f"{claim.kind:8} {claim.name:20} {claim.page:24} {when}"


def _told(claim: Claim, runs: Runs, update: bool, echo: Callable[[str], None]) -> bool:
    """Check one claim, say how it went, and keep that it held; whether it was not stale."""
    if missing := claim.missing():
        echo(f"not run  {claim.name}: {missing} is not here")
        return True
    path, start = ROOT / claim.page, time.perf_counter()
    try:
        found, canary = check(claim, runs), None
        seconds = time.perf_counter() - start
        if claim.kind != "quick" and (update or not found):
            canary = runs.of_canary(claim)
    except ClaimError as error:
        echo(f"FAILED   {claim.name}: {error}")
        return False
    what = "STALE" if found and not update else "updated" if found else "holds"
    echo(f"{what:8} {claim.name}, in {claim.page}  ({seconds:.1f} s)")
    page = path.read_text(encoding="utf-8")
    for difference in found:
        line = page[: difference.start].count("\n") + 1
        echo(f"           line {line}: {difference}"[:2000] if not claim.picture else "           another picture")
    if found and update:
        amend(path, found)
    if claim.kind != "quick" and what != "STALE":
        record(claim, path.read_text(encoding="utf-8"), seconds, canary)
    return what != "STALE"


def main(arguments: Sequence[str] | None = None, echo: Callable[[str], None] = print) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--class", dest="kind", default="quick", choices=[*CLASSES, "all"])
    parser.add_argument("--only", default="", help="names of claims, separated by commas")
    parser.add_argument("--update", action="store_true", help="write what was measured into the pages")
    parser.add_argument("--list", action="store_true", help="only show when claims were last checked")
    asked = parser.parse_args(arguments)
    book, names = load(), [name for name in asked.only.split(",") if name]
    if unknown := set(names) - {claim.name for claim in book.claims}:
        parser.error(f"there is no claim {', '.join(sorted(unknown))}")
    chosen = [c for c in book.claims if (c.name in names if names else asked.kind in (c.kind, "all"))]
    if asked.list:
        for claim in chosen:
            echo(_listed(claim))
        return 0
    stale = 0
    with tempfile.TemporaryDirectory() as folder:
        runs = Runs(Path(folder))
        for claim in chosen:
            stale += not _told(claim, runs, asked.update, echo)
    remedy = "" if not stale or asked.update else "; with UPDATE=1 the pages are made to say what was measured"
    echo(f"{len(chosen)} claims, {stale} stale{remedy}")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
