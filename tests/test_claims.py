"""What README and docs claim: figures are what commands print, options exist, pictures are redrawn."""

import contextlib
import io
import itertools
import os
import re
import runpy
import shlex
import sys
from fractions import Fraction

import pytest
import typer

from stltool import cli
from tests.conftest import ROOT

sys.path.insert(0, str(ROOT / "docs"))
import claims

BOOK = claims.load()
PAGES = {name: path.read_text(encoding="utf-8") for name, path in claims.pages().items()}
[DEMO] = next(found.command for found in BOOK.claims if found.name == "demo")
QUICK = {}
for found in BOOK.claims:
    if found.kind == "quick" and not found.picture:  # tests/reporting/test_pictures.py draws those again
        QUICK.setdefault(found.command[0], []).append(found)


def page_of(claim):
    return (ROOT / claim.page).read_text(encoding="utf-8")


# ----------------------------------------------------------------------------------------------- figures


def execute(command, folder, fails):
    """As `claims.execute` does, but in this process."""
    words = shlex.split(command)
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        patch.chdir(folder)
        code = 0
        if words[0] == "stltool":
            patch.setattr(sys, "argv", words)
            with pytest.raises(SystemExit) as ended:
                cli.main()
            code = ended.value.code or 0
        elif words[1] == "-c":
            exec(words[2], {"__name__": "__main__"})
        elif words[1] == "-m":
            patch.setattr(sys, "argv", words[2:])
            patch.delitem(sys.modules, f"{words[2]}.__main__", raising=False)  # imported by other tests
            with pytest.raises(SystemExit) as ended:
                runpy.run_module(words[2], run_name="__main__", alter_sys=True)
            code = ended.value.code or 0
        else:
            patch.setattr(sys, "argv", words[1:])
            patch.syspath_prepend(str(ROOT / os.path.dirname(words[1])))
            runpy.run_path(str(ROOT / words[1]), run_name="__main__")
    assert (code == 2) == fails, err.getvalue()
    return err.getvalue() if fails else out.getvalue()


@pytest.mark.parametrize("command", QUICK, ids=[" ".join(command.split())[:60] for command in QUICK])
def test_quick_claims_hold(command, tmp_path, request):
    def once(command, folder, fails):
        if command == DEMO:  # pictures are drawn of it, too
            return (request.getfixturevalue("demo") / "printed").read_text(encoding="utf-8")
        return execute(command, folder, fails)

    runs = claims.Runs(tmp_path, once)
    absent = []
    for claim in QUICK[command]:
        if missing := claim.missing():
            absent.append(missing)
            continue
        stale = claims.check(claim, runs)
        assert stale == [], f"{claim.name}, in {claim.page}; `make claims UPDATE=1` writes what was measured"
    if len(absent) == len(QUICK[command]):
        pytest.skip(f"compares with files of others, which are absent: {absent[0]}")


@pytest.mark.parametrize("claim", BOOK.claims, ids=lambda claim: claim.name)
def test_every_claim_stands_on_its_page(claim):
    assert claims.find(claim, page_of(claim))


@pytest.mark.parametrize("claim", [c for c in BOOK.claims if c.kind != "quick"], ids=lambda claim: claim.name)
def test_claims_that_are_not_run_here_were_checked_as_they_stand(claim):
    """The page still says what it said when the claim was last checked."""
    checked = claims.recorded().get(claim.name)
    remedy = f"`make claims ONLY={claim.name}`"
    assert checked is not None, f"{claim.name} was never checked: {remedy}"
    assert checked["says"] == claims.digest(claim, page_of(claim)), f"{claim.page} has changed since: {remedy}"
    assert {"commit", "date", "machine"} <= set(checked)


@pytest.mark.parametrize("claim", [c for c in BOOK.claims if c.canary is not None], ids=lambda claim: claim.name)
def test_programs_of_claims_print_what_they_printed_when_the_claims_were_checked(claim, tmp_path):
    if missing := claim.missing():
        pytest.skip(f"{missing} is not here")
    assert claims.Runs(tmp_path, execute).of_canary(claim) == claims.recorded()[claim.name]["canary"], (
        f"the program has changed since: `make claims ONLY={claim.name} UPDATE=1`"
    )


def test_nothing_is_recorded_of_claims_that_are_gone():
    assert set(claims.recorded()) == {claim.name for claim in BOOK.claims if claim.kind != "quick"}


@pytest.mark.parametrize("name", PAGES)
def test_every_figure_is_a_claim_or_plain(name):
    left = claims.uncovered(BOOK, name, PAGES[name])
    told = [f"{name}, line {line}: {figure} in {text!r}" for line, figure, text in left]
    assert told == [], "list them in docs/claims.toml: as claims, or as plain with the reason"


@pytest.mark.parametrize("plain", BOOK.plain, ids=lambda plain: f"{plain.page}: {plain.patterns[0][:30]}")
def test_every_plain_entry_speaks_of_something(plain):
    assert plain.why
    texts = PAGES.values() if plain.page == "*" else [PAGES[plain.page]]
    for pattern in plain.patterns:
        assert any(re.search(pattern, text, flags=re.MULTILINE) for text in texts), pattern


def test_every_picture_is_a_claim():
    pictures = {str(path.relative_to(ROOT)) for path in (ROOT / "docs").glob("*.svg")}
    assert pictures == {claim.page for claim in BOOK.claims if claim.picture}
    shown = {
        str(((ROOT / name).parent / target).resolve().relative_to(ROOT))
        for name, page in PAGES.items()
        for target in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page)
    }
    assert shown == pictures


# ------------------------------------------------------------------------------------- commands and options


def command_line():
    """Command → its options."""
    group = typer.main.get_command(cli.app)
    return {
        name: {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
        for name, command in group.commands.items()
    }


def readme_table():
    """(command, rest of its row) of every row of README's table of commands, continued lines joined."""
    (table,) = re.findall(r"## The command line\n\n```\n(.*?)```", PAGES["README.md"], flags=re.DOTALL)
    rows = re.sub(r"\n +", " ", table).splitlines()
    return [re.fullmatch(r"stltool (\S+) (.*)", row).groups() for row in rows]


def options_named(text):
    return set(re.findall(r"(?<![\w-])--[a-z][\w-]*", text))


def test_readmes_table_has_every_command_and_only_options_that_exist():
    commands = command_line()
    rows = readme_table()
    named = {command for command, _ in rows} | set(re.findall(r"stltool (\w+)", " ".join(rest for _, rest in rows)))
    assert named == set(commands)
    for command, rest in rows:
        own = set(commands[command])
        for other in re.findall(r"stltool (\w+)", rest):
            own |= commands[other]
        assert options_named(rest) - own == set(), command


def test_options_that_pages_name_exist():
    """In prose and tables, of any command; others belong to a program that is named with them."""
    known = set().union(*command_line().values()) | {"--help", "--version", "--install-completion"}
    known |= set(re.findall(r'"(--stl-[\w-]+)"', (ROOT / "stltool" / "pytest_plugin.py").read_text(encoding="utf-8")))
    for name, page in PAGES.items():
        prose = re.sub(r"```.*?```", "", page, flags=re.DOTALL)
        assert options_named(prose) - known == set(), name


# --------------------------------------------------------------------------------------------- the checker itself


def book(entry, plain=()):
    full = {"name": "x", "page": "page.md", "class": "quick", "command": "true", **entry}
    return claims._claim(full)


def output(text, *seconds):
    return claims.Output(text, seconds)


@pytest.mark.parametrize(
    ("stated", "measured", "tolerance", "holds"),
    [
        ("0.74", "0.7379", {}, True),
        ("0.738", "0.7374", {}, False),
        ("4.4e−06", "4.4321e-06", {}, True),
        ("4.4e−06", "4.5e-06", {}, False),
        ("1.4e+09", "1.4e+09", {}, True),
        ("16 687", "16687", {}, True),
        ("16 687", "16688", {}, False),
        ("66", "65960000", {"scale": 1e-6}, True),
        ("2/3", "2/3", {}, True),
        ("472", "400", {"at_least": 0.8}, True),
        ("472", "300", {"at_least": 0.8}, False),
        ("472", "9000", {"at_least": 0.8}, True),
        ("1.1", "1.3", {"at_most": 1.2}, True),
        ("1.1", "1.4", {"at_most": 1.2}, False),
        ("10", "14", {"relative": 0.5}, True),
        ("10", "16", {"relative": 0.5}, False),
        ("10", "ten", {}, False),
    ],
)
def test_tolerances(stated, measured, tolerance, holds):
    value = claims.Value(find="(.*)", **tolerance)
    assert value.holds(stated, measured) is holds
    if not holds and measured != "ten" and not tolerance:
        assert value.holds(value.text(stated, measured), measured)  # what an update would write


def test_a_text_is_found_wherever_its_lines_break_and_amended_in_its_style(tmp_path):
    claim = book({"text": "some {n} runs in {t} s", "values": {"n": {"find": "n=(.*)"}, "t": {"seconds": 0}}})
    page = "It took some\n16 687 runs\nin 2 s, at most 3.\n"
    found = list(claims.differences(claim, page, output("n=12345.2\n", 2.2)))
    assert [(d.stated, d.measured) for d in found] == [("16 687", "12 345")]
    path = tmp_path / "page.md"
    path.write_text(page)
    claims.amend(path, found)
    assert path.read_text() == page.replace("16 687", "12 345")
    with pytest.raises(claims.ClaimError, match="0 times"):
        claims.find(claim, page.replace("runs", "walks"))
    with pytest.raises(claims.ClaimError, match="2 times"):
        claims.find(claim, page * 2)
    with pytest.raises(claims.ClaimError, match="nothing like"):
        list(claims.differences(claim, page, output("m=1\n", 2.2)))


def test_tables_differ_row_by_row_and_columns_have_tolerances(tmp_path):
    claim = book({"table": "| a |", "columns": {"s": 0.5}})
    free = book({"table": "| a |", "columns": {"s": "any"}})
    page = "x\n\n| a | s |\n|---|---|\n| 1 | 2.0 |\n| 2 | 4.0 |\n\ny\n"
    assert list(claims.differences(claim, page, output("| a | s |\n|---|---|\n| 1 | 2.9 |\n| 2 | 3.0 |"))) == []
    assert list(claims.differences(free, page, output("| a | s |\n|---|---|\n| 1 | 99 |\n| 2 | – |"))) == []
    (one,) = claims.differences(claim, page, output("| a | s |\n|---|---|\n| 1 | 2.9 |\n| 5 | 3.0 |"))
    assert one.measured == "| 5 | 4.0 |"  # what is within its tolerance stays
    found = list(claims.differences(claim, page, output("| a | s |\n|---|---|\n| 1 | 2.0 |\n| 3 | 4.0 |\n")))
    path = tmp_path / "page.md"
    path.write_text(page)
    claims.amend(path, found)
    assert path.read_text() == page.replace("| 2 | 4.0 |", "| 3 | 4.0 |")
    longer = "| a | s |\n|---|---|\n| 1 | 2.0 |\n| 2 | 4.0 |\n| 3 | 4.0 |\n"
    claims.amend(path, list(claims.differences(claim, path.read_text(), output(longer))))
    assert longer in path.read_text()
    with pytest.raises(claims.ClaimError, match="no such table"):
        list(claims.differences(claim, page, output("nothing")))


def test_blocks_are_part_of_the_output_but_for_seconds():
    claim = book({"block": "$ echo", "command": "echo 'a  b'"})
    page = "```\n$ echo 'a  b'\nP   0.5   1.0 s\nend\n```\n"
    assert list(claims.differences(claim, page, output("first\nP  0.5  3.1 s\nend\nmore\n"))) == []
    (difference,) = claims.differences(claim, page, output("first\nP  0.6  3.1 s\nend\nmore\n"))
    assert page[: difference.start] + difference.measured + page[difference.end :] == (
        "```\n$ echo 'a  b'\nP  0.6  3.1 s\nend\n```\n"
    )
    with pytest.raises(claims.ClaimError, match="another command"):
        list(claims.differences(book({"block": "$ echo", "command": "echo c"}), page, output("")))


def test_pictures_may_differ_by_a_hair_and_by_names():
    claim = book({"picture": True})
    page = '<svg><metadata>1</metadata><g id="a_1"/><g id="b"><path d="M 1 2.5" clip-path="url(#p12)"/></g></svg>'
    same = '<svg><g id="c"><path d="M 1 2.501" clip-path="url(#q)"/></g></svg>'
    assert list(claims.differences(claim, page, output(same))) == []
    assert list(claims.differences(claim, page, output(same.replace("2.501", "2.6"))))


def test_what_is_a_figure_and_what_covers_it():
    claim = book({"text": "takes {t} s", "values": {"t": {"find": "(.*)"}}})
    other = book({"text": "takes {_} s of {m} MB", "values": {"m": {"find": "(.*)"}}})
    plain = claims.Plain("*", (r"Python 3\.11",), "a requirement")
    page = """# A page
It takes 2.5 s of 17 MB with Python 3.11, P1 and s₀, `x > 4`, [a link](page-7.html).

    a formula 8

```python
9
```

```
10
```

```console
11
```
"""
    one, both = claims.Book((claim,), (plain,)), claims.Book((claim, other), (plain,))
    assert [(line, figure) for line, figure, _ in claims.uncovered(one, "page.md", page)] == [(2, "17"), (11, "10")]
    assert [figure for _, figure, _ in claims.uncovered(both, "page.md", page)] == ["10"]
    alone = claims.uncovered(claims.Book((other,), (plain,)), "page.md", page)
    assert [figure for _, figure, _ in alone] == ["2.5", "10"]
    readme = claims.uncovered(claims.Book((), (plain,)), "README.md", page)  # whose console blocks no test runs
    assert [figure for _, figure, _ in readme] == ["2.5", "17", "10", "11"]


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ({"text": "{a}"}, "the text has"),
        ({"text": "1", "table": "|"}, "give one of"),
        ({}, "give one of"),
        ({"text": "1", "class": "slow"}, "class is slow"),
        ({"text": "1", "class": "quick", "canary": "stltool --version"}, "drop canary"),
        ({"text": "1", "colour": "red"}, "unknown keys colour"),
        ({"text": "{a}", "values": {"a": {}}}, "one of find, json and seconds"),
        ({"text": "{a}", "values": {"a": {"find": "x", "relative": 1, "at_least": 1}}}, "one tolerance at most"),
    ],
)
def test_bad_entries_are_refused(entry, says):
    with pytest.raises(claims.ClaimError, match=says):
        book(entry)


def test_make_claims_tells_updates_and_records(tmp_path, monkeypatch):
    """The whole program on a page of its own: stale, then mended, then kept with date and commit."""
    (tmp_path / "docs").mkdir()
    for name in ("bench", "examples"):
        (tmp_path / name).mkdir()
    page, record = tmp_path / "README.md", tmp_path / "docs" / "claims.json"
    page.write_text("It has 3 parts in 4 rooms.\n")
    (tmp_path / "docs" / "claims.toml").write_text(
        """
        plain = []
        [[claim]]
        name = "parts"
        page = "README.md"
        class = "minutes"
        text = "has {n} parts in {m} rooms"
        command = "python -c 'print(5, 4)'"
        values.n = { find = '^(\\d+)' }
        values.m = { find = ' (\\d+)' }
        """
    )
    monkeypatch.setattr(claims, "ROOT", tmp_path)
    monkeypatch.setattr(claims, "RECORD", record)
    book = claims.load(tmp_path / "docs" / "claims.toml")
    monkeypatch.setattr(claims, "load", lambda: book)
    told = []
    assert claims.main(["--class", "quick"], told.append) == 0
    assert told == ["0 claims, 0 stale"]
    assert claims.main(["--class", "minutes"], told.append) == 1
    assert "STALE" in told[1]
    assert told[2].strip() == "line 1: stated 3, measured 5"
    assert "UPDATE=1" in told[3]
    assert not record.exists()
    assert claims.main(["--only", "parts", "--update"], told.append) == 0
    assert page.read_text() == "It has 5 parts in 4 rooms.\n"
    assert claims.recorded()["parts"]["says"] == claims.digest(book.claims[0], page.read_text())
    assert claims.main(["--class", "all"], told.append) == 0
    assert told[-2].startswith("holds")
    assert claims.main(["--class", "all", "--list"], told.append) == 0
    assert re.match(r"minutes +parts +README.md +last on \d{4}-\d\d-\d\d at ", told[-1])


def test_numbers_read_and_written_alike():
    for text in ("7", "0.50", "16 687", "1.40e−06", "6.8e-08", "1.4e+09", "−3", "73/100"):
        assert claims.alike_in_style(claims.number(text), text) == text
    assert claims.number("1.5e−03") == Fraction(3, 2000)
    assert list(itertools.starmap(claims.alike, [("a 1", "a  1"), ("a 1", "a 2"), ("1 b", "1 c")])) == [
        True,
        False,
        False,
    ]
