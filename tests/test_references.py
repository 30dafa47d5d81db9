"""Citations resolve: keys stand in docs/references.md, pages and their sections exist, links lead somewhere."""

import re
import tomllib

import pytest
import yaml

import stltool as stl
from tests.conftest import ROOT

TREES = ("stltool", "tests", "bench", "docs", "examples", "grammars")
ENDINGS = {".py", ".lark", ".stl", ".toml"}
SOURCES = sorted(path for tree in TREES for path in (ROOT / tree).rglob("*") if path.suffix in ENDINGS)
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md"))]
REFERENCES = (ROOT / "docs" / "references.md").read_text(encoding="utf-8")
KEYS = set(re.findall(r"^- \*\*\[(\w+)\]\*\*", REFERENCES, flags=re.MULTILINE))

KEY = re.compile(r"\[([A-Z][a-z]+\d\d)(?:, [^\]\n]+(?:\n[^\]\n]+)?)?\]")
PAGE = re.compile(r"(?<![\w/.\-\"])((?:[\w-]+/)*[\w-]+\.md)\b(?: §(\d+)|, \"([^\"]+)\")?")


def text(path):
    return path.read_text(encoding="utf-8")


def cited(source):
    """The keys that a text cites."""
    return set(KEY.findall(source))


def unresolved(source):
    """Citations of pages in a text that lead nowhere: a page, a numbered section, or a title."""
    wrong = []
    for name, number, title in PAGE.findall(re.sub(r"\n\s*", " ", source)):
        page = ROOT / name
        if not page.exists():
            wrong.append(f"{name}: no such page; pages are cited from the root of the repository, such as docs/{name}")
        elif number and not re.search(rf"^## {number}\. ", text(page), flags=re.MULTILINE):
            wrong.append(f"{name} §{number}: no such section")
        elif title and not re.search(rf"^#+ {re.escape(title)}$", text(page), flags=re.MULTILINE):
            wrong.append(f"{name}, {title!r}: no such heading")
    return wrong


def anchors(page):
    """The anchors of a page's headings, as web pages of Markdown make them."""
    headings = re.findall(r"^#+ (.+)$", text(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_what_counts_as_a_citation():
    assert cited("see [Wang24, eq. 5] and [Ville39]; a[A1], [Table I], x[ab12]") == {"Wang24", "Ville39"}
    assert cited("[Puterman94, Prop. 6.6.5\nand Th. 6.6.6]") == {"Puterman94"}
    assert unresolved('(docs/semantics.md §2) and docs/language.md, "What other tools\nread differently"') == []
    assert len(unresolved('semantics.md §1, docs/semantics.md §9, docs/language.md, "Nothing"')) == 3


def test_every_key_is_listed_and_every_entry_is_cited():
    found = {path: cited(text(path)) for path in [*SOURCES, *PAGES] if path != ROOT / "tests" / "test_references.py"}
    assert {str(path): keys - KEYS for path, keys in found.items() if keys - KEYS} == {}
    elsewhere = {key for path, keys in found.items() if path.name != "references.md" for key in keys}
    assert KEYS - elsewhere == set()


def test_pages_that_sources_cite_exist():
    wrong = {str(path): unresolved(text(path)) for path in SOURCES if path.name != "test_references.py"}
    assert {path: places for path, places in wrong.items() if places} == {}


def test_the_paper_is_named_by_its_key():
    """A module that speaks of the paper says which; equations, tables and algorithms come with the key."""
    for path in SOURCES:
        if path.suffix == ".py" and path.is_relative_to(ROOT / "stltool"):
            source = text(path)
            if re.search(r"\bpaper\b(?!\")", re.sub(r"\"paper\"|the paper encoding", "", source)):
                assert "Wang24" in source or "Wang et al." in source, path
            assert not re.search(r"\bpaper,? (eq\.|Table|Algorithm|Alg\.|§)", source), path


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_of_pages_lead_somewhere(page):
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]+))?\)", text(page)):
        if target.startswith("reference/"):  # made with the site, whose builders follow its links (test_site.py)
            continue
        other = (page.parent / target).resolve() if target else page
        assert other.exists(), f"{page.name}: {target}"
        assert not anchor or anchor in anchors(other), f"{page.name}: {target}#{anchor}"


def bibtex(source):
    """Field → text of the one BibTeX entry in a page."""
    (entry,) = re.findall(r"```bibtex\n@\w+\{\w+,\n(.*?)\n\}\n```", source, flags=re.DOTALL)
    return dict(re.findall(r"^\s*(\w+)\s*=\s*\{(.*)\},?$", entry, flags=re.MULTILINE))


def test_the_paper_is_cited_alike_everywhere():
    """README, references, package and CITATION.cff: the same title, journal, volume, pages, year and DOI."""
    paper = bibtex(REFERENCES)
    assert set(paper) == {"title", "author", "journal", "volume", "pages", "year", "doi"}
    assert bibtex(text(ROOT / "README.md")) == paper
    package = re.sub(r"\s+", " ", stl.__doc__)
    assert all(paper[field] in package for field in ("title", "journal", "doi", "year"))
    cff = citation()
    (reference,) = cff["references"]
    start, end = paper["pages"].split("--")
    assert reference == {
        "type": "article",
        "authors": [{"family-names": family, "given-names": given} for family, given in authors(paper["author"])],
        "title": paper["title"], "journal": paper["journal"], "volume": int(paper["volume"]),
        "start": int(start), "end": int(end), "year": int(paper["year"]), "doi": paper["doi"],
    }  # fmt: skip


def authors(names):
    return [name.split(", ") for name in names.split(" and ")]


def test_citation_cff_agrees_with_the_project():
    project = tomllib.loads(text(ROOT / "pyproject.toml"))["project"]
    cff = citation()
    assert (cff["cff-version"], cff["type"]) == ("1.2.0", "software")
    assert (cff["title"], str(cff["version"])) == (project["name"], project["version"])
    assert (cff["abstract"], cff["license"]) == (project["description"], project["license"])
    assert cff["authors"] == [{"name": "stltool maintainers"}]


def citation():
    return yaml.safe_load(text(ROOT / "CITATION.cff"))
