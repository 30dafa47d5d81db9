"""Where the .lark files are: inside the package in a wheel, beside it in a checkout."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def grammar_text(name: str) -> str:
    """The text of `grammars/NAME`."""
    for folder in (_PACKAGE / "grammars", _PACKAGE.parent / "grammars"):
        if (folder / name).is_file():
            return (folder / name).read_text(encoding="utf-8")
    raise FileNotFoundError(f"the grammar {name} is missing from this installation; reinstall stltool")
