"""The documentation site: what it takes from the code is up to date, both builders accept it, no page asks others."""

import importlib.util
import re
import subprocess
import sys

import pytest

import stltool as stl
from tests.conftest import ROOT

sys.path.insert(0, str(ROOT / "docs"))
import generated


def test_the_table_of_operators_is_the_grammar_s():
    assert (ROOT / "docs" / "language.md").read_text("utf-8") == generated.language(), "run python docs/generated.py"


TEXTS = {
    "always": "{}[0,2] a",
    "eventually": "{}[0,2] a",
    "until": "a {}[0,2] b",
    "not": "{} a",
    **dict.fromkeys(("and", "or", "implies", "if and only if", "exclusive or"), "a {} b"),
}


@pytest.mark.parametrize("name", TEXTS)
def test_all_spellings_of_an_operator_mean_the_same(name):
    spellings = generated.spellings(generated.OPERATORS[name])
    assert len(set(spellings)) == len(spellings)
    assert {stl.parse(TEXTS[name].format(one)) for one in spellings} == {stl.parse(TEXTS[name].format(spellings[0]))}


def test_no_operator_is_left_out():
    listed = {one for those in generated.OPERATORS.values() for one in ([those] if isinstance(those, str) else those)}
    grammar = (ROOT / "grammars" / "stl.lark").read_text("utf-8")
    terminals = set(re.findall(r"^([A-Z_]+)(?:\.-?\d+)?:", grammar, flags=re.MULTILINE))
    lines = {"_MODEL", "_PARAM", "_SIGNAL", "_STEP", "_UNIT", "_EXPECT", "ASSIGN", "STRING", "COMMENT"}
    brackets = {"LPAR", "RPAR", "LSQB", "RSQB", "COMMA", "COLON", "_DOTS"}
    assert terminals == listed | lines | brackets | {"NAME", "DOTTED", "NUMBER", "TIME", "STEPS", "MICROSECONDS"}


def test_the_reference_has_every_public_name():
    found = [name for _, modules in generated.PAGES.values() for name in generated.names_of(modules)]
    assert sorted(found) == sorted(stl.__all__)
    page = generated.page("Checking", ("checking",))
    assert "## stl.check\n\n```py\ncheck(\n    product,\n    policy=None,\n" in page
    assert "### CheckResult.at_least" in page


def test_the_architecture_names_every_folder():
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    assert set(re.findall(r"^\| `(\w+)/` ", page, flags=re.MULTILINE)) == {"grammars"} | {
        path.parent.name for path in (ROOT / "stltool").glob("*/__init__.py")
    }
    for folder, file in re.findall(r"^\| `(\w+)/` .* `(\w+\.\w+)`", page, flags=re.MULTILINE):
        base = ROOT if folder == "grammars" else ROOT / "stltool"
        assert (base / folder / file).is_file(), f"{folder}/{file}"


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    generated.site(folder)
    return folder


@pytest.mark.parametrize("builder", ["zensical", "mkdocs"])
def test_both_builders_accept_it(builder, sources):
    if importlib.util.find_spec(builder) is None:
        pytest.skip(f"{builder} is not installed")
    command = [sys.executable, "-m", builder, "build", "--strict", "--config-file", f"{builder}.yml"]
    done = subprocess.run(command, cwd=sources, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = {path.relative_to(sources / "site"): path.read_text("utf-8") for path in (sources / "site").rglob("*.html")}
    assert len(pages) > len(list((ROOT / "docs").glob("*.md")))
    for name, text in pages.items():
        loaded = re.findall(r'<(?:script|img|link)[^>]*?(?:src|href)="(?:https?:)?//[^"]*"', text)
        assert loaded == [], f"{name} asks others for what it shows"
