"""What the documentation takes from the code.

python docs/generated.py             writes the table of operators in docs/language.md, from grammars/stl.lark
python docs/generated.py --site DIR  what the site is built from: the pages of docs/, and reference/*.md from the
                                     signatures and docstrings of the public names and from every command's --help
                                     (make docs)
"""

from __future__ import annotations

import argparse
import dataclasses
import inspect
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import stltool as stl
import stltool.testing
from stltool.grammar import grammar_text

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))  # the tests know how to list commands

# terminal → the row it belongs to; a test asks the parser whether all spellings of a row mean the same
OPERATORS = {
    "always": "_ALWAYS",
    "eventually": "_EVENTUALLY",
    "until": "_UNTIL",
    "weak until": "_WEAK_UNTIL",
    "release": "_RELEASE",
    "once": "_ONCE",
    "historically": "_HISTORICALLY",
    "since": "_SINCE",
    "trigger": "_TRIGGER",
    "previous step": "_PREV",
    "rise, fall": ("_RISE", "_FALL"),
    "not": "_NOT",
    "and": "_AND",
    "or": "_OR",
    "implies": "_IMPLIES",
    "if and only if": "_IFF",
    "exclusive or": "_XOR",
    "constants": ("TRUE", "FALSE"),
    "comparisons": "COMPARATOR",
    "arithmetic": ("PLUS", "MINUS", "TIMES", "DIVIDE", "POWER", "FUNCTION"),
}

# page → title, and the modules whose public names it lists
PAGES = {
    "formulas": ("Formulas and tasks", ("logic",)),
    "monitoring": ("Monitors", ("monitoring", "diagnosis")),
    "models": ("Automata, models and products", ("automata", "models", "product", "envs", "policy")),
    "checking": ("Checking", ("checking", "gate")),
    "learning": ("Learning and guarantees", ("learning",)),
    "reporting": ("Reports, exports and errors", ("exporting", "reporting", "errors")),
}


def spellings(terminal: str) -> list[str]:
    """The spellings of an operator, in the grammar's order."""
    line = re.search(rf"^{terminal}(?:\.\d+)?: (.*)$", grammar_text("stl.lark"), flags=re.MULTILINE)
    assert line, f"the grammar has no terminal {terminal}"
    found: list[str] = []
    for literal, pattern in re.findall(r'"((?:[^"\\]|\\.)*)"|/((?:[^/\\]|\\.)*)/', line[1]):
        if literal:
            found.append(literal.replace("\\\\", "\\"))
            continue
        group, word = re.match(r"\(\?:([^()]*)\)|([^(]*)", pattern).groups()  # type: ignore[union-attr]
        found += (group or word).replace("\\[", "[").replace("\\]", "]").split("|")
    return list(dict.fromkeys(found))


def operators() -> str:
    """The table of docs/language.md."""
    rows = ["| | spellings |", "|---|---|"]
    for name, terminals in OPERATORS.items():
        those = [terminals] if isinstance(terminals, str) else terminals
        shown = " ".join(f"`{one}`" for terminal in those for one in spellings(terminal))
        rows.append(f"| {name} | {shown.replace('|', chr(92) + '|')} |")
    return "\n".join(rows)


def names_of(modules: tuple[str, ...]) -> list[str]:
    """The public names that come from these modules, in the order of stltool/__init__.pyi."""
    stub = (HERE.parent / "stltool" / "__init__.pyi").read_text(encoding="utf-8")
    found: list[str] = []
    for module, block in re.findall(r"^from \.([\w.]+) import (\([^)]*\)|.*)$", stub, flags=re.MULTILINE):
        if module.split(".")[0] in modules:
            found += re.findall(r"\w+ as (\w+)", block)
    return found


def page(title: str, modules: tuple[str, ...]) -> str:
    parts = [f"# {title}", "From the docstrings; `import stltool as stl`."]
    for name in names_of(modules):
        parts += entry(f"stl.{name}", getattr(stl, name), "##")
    return "\n\n".join(parts) + "\n"


def testing() -> str:
    """The page of stltool.testing, which is imported by itself."""
    parts = ["# Tests of your own", "From the docstrings; `from stltool.testing import ...`."]
    for name in stltool.testing.__all__:
        parts += entry(name, getattr(stltool.testing, name), "##")
    return "\n\n".join(parts) + "\n"


def entry(name: str, thing: Any, level: str) -> Iterator[str]:
    """A heading, the signature, the docstring; of a class its public members, too."""
    yield f"{level} {name}"
    if isinstance(thing, type):
        if not issubclass(thing, BaseException | dict) and not getattr(thing, "_is_protocol", False):
            yield signature(name, thing)
    elif callable(thing):
        yield signature(name, thing)
    yield from prose(thing)
    if isinstance(thing, type):
        for member, value in members(thing):
            short = name.removeprefix("stl.")
            if isinstance(value, property) or hasattr(value, "func"):  # cached_property
                yield f"{level}# {short}.{member}"
                yield from prose(getattr(value, "func", getattr(value, "fget", None)))
            else:
                yield from entry(f"{short}.{member}", value, level + "#")


def members(thing: type) -> list[tuple[str, Any]]:
    """Public methods and properties that a class, or a part mixed into it, defines and documents."""
    fields = {field.name for field in dataclasses.fields(thing)} if dataclasses.is_dataclass(thing) else set()
    found = []
    parts = [part for part in thing.__mro__[1:] if part.__bases__ == (object,) and "__init__" not in vars(part)]
    values: dict[str, Any] = {}
    for part in reversed([thing, *(part for part in parts if part.__module__.startswith("stltool"))]):
        values |= vars(part)
    for name, value in values.items():
        if name.startswith("_") or name in fields:
            continue
        value = value.__func__ if isinstance(value, classmethod | staticmethod) else value
        if inspect.isfunction(value) or isinstance(value, property) or hasattr(value, "func"):
            asked = getattr(value, "func", None) or getattr(value, "fget", None) or value
            if inspect.getdoc(asked):
                found.append((name, value))
    return found


def signature(name: str, thing: Callable[..., Any]) -> str:
    """How it is called: names and defaults; what types are taken stands in the docstring."""
    short = name.removeprefix("stl.")
    parameters = []
    for one in inspect.signature(thing).parameters.values():
        if one.name not in ("self", "cls"):
            parameters.append(one.replace(annotation=inspect.Parameter.empty, default=_default(one.default)))
    text = str(inspect.Signature(parameters))
    line = f"{short}{text}"
    if len(line) > 100:
        line = f"{short}(\n" + "".join(f"    {part},\n" for part in _split(text[1:-1])) + ")"
    return f"```py\n{line}\n```"


class _Shown:
    """A default value as it is shown."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text


def _default(value: Any) -> Any:
    if value is inspect.Parameter.empty or value is None or isinstance(value, bool | int | float | str | tuple):
        return value
    return _Shown(getattr(value, "__name__", "..."))


def _split(text: str) -> list[str]:
    """Parameters between commas outside brackets and quotes."""
    return re.findall(r"(?:[^,(\[{']|'[^']*'|[(\[{][^)\]}]*[)\]}])+", text.replace(", ", ","))


def prose(thing: Any) -> Iterator[str]:
    """A docstring in Markdown: paragraphs as they are; columns, lists and examples as they stand in the code."""
    for block in re.split(r"\n\s*\n", inspect.getdoc(thing) or ""):
        if block.lstrip().startswith(">>>"):
            yield f"```pycon\n{block}\n```"
        elif re.search(r"\S {2,}\S|^\s", block, flags=re.MULTILINE):
            yield f"```text\n{block.rstrip()}\n```"
        elif block:
            yield re.sub(r"(?<!`)([*<_])(?=[^`]*(?:`[^`]*`[^`]*)*$)", r"\\\1", block)


def commands() -> str:
    """Every command's help."""
    from tests.golden.helps import entries

    parts = ["# Commands", "What `stltool COMMAND --help` says."]
    for given, said in entries():
        name = given.removesuffix("--help").strip()
        parts += [f"## {name}", f"```text\n{said.rstrip()}\n```"]
    return "\n\n".join(parts) + "\n"


def language() -> str:
    """docs/language.md with its table as the grammar has it."""
    before, start, rest = (HERE / "language.md").read_text(encoding="utf-8").partition("<!-- operators, generated -->")
    _, end, after = rest.partition("<!-- end -->")
    assert start, "docs/language.md has no place for the table of operators"
    assert end, "docs/language.md has no end of the table of operators"
    return f"{before}{start}\n\n{operators()}\n\n{end}{after}"


def site(folder: Path) -> None:
    """The settings of the two builders, all pages and pictures, and the schema that a page links to."""
    reference = folder / "pages" / "reference"
    reference.mkdir(parents=True, exist_ok=True)
    for path in HERE.glob("*.yml"):
        shutil.copy(path, folder)
    for path in [*HERE.glob("*.md"), *HERE.glob("*.svg"), HERE / "reports.schema.json"]:
        shutil.copy(path, folder / "pages")
    for name, (title, modules) in PAGES.items():
        (reference / f"{name}.md").write_text(page(title, modules), encoding="utf-8")
    (reference / "testing.md").write_text(testing(), encoding="utf-8")
    (reference / "commands.md").write_text(commands(), encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--site", type=Path, metavar="DIR")
    asked = parser.parse_args()
    if asked.site:
        site(asked.site)
    else:
        (HERE / "language.md").write_text(language(), encoding="utf-8")


if __name__ == "__main__":
    main()
