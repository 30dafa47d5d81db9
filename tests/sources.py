"""What stltool's modules import and call, read once for all tests that look at it."""

import ast
import functools
from pathlib import Path
from typing import NamedTuple

from tests.conftest import ROOT

PACKAGE = ROOT / "stltool"


class Source(NamedTuple):
    """imports: all of them, hints: those for annotations alone; attributes: the last names of all a.b(…);
    statements: (line, f) of each f(…) whose value is thrown away."""

    imports: list[ast.Import | ast.ImportFrom]
    hints: list[ast.Import | ast.ImportFrom]
    attributes: set[str]
    statements: list[tuple[int, str]]


@functools.cache
def sources() -> dict[Path, Source]:
    """Of every module, by its path within the package."""
    return {path.relative_to(PACKAGE): _source(path) for path in sorted(PACKAGE.rglob("*.py"))}


def _source(path: Path) -> Source:
    found = Source([], [], set(), [])
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        match node:
            case ast.Import() | ast.ImportFrom():
                found.imports.append(node)
            case ast.If(test=ast.Name(id="TYPE_CHECKING")):
                found.hints.extend(below for below in ast.walk(node) if isinstance(below, ast.Import | ast.ImportFrom))
            case ast.Call(func=ast.Attribute(attr=name)):
                found.attributes.add(name)
            case ast.Expr(value=ast.Call(func=ast.Name(id=name))):
                found.statements.append((node.lineno, name))
    return found
