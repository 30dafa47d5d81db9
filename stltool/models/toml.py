"""Model files in TOML: read with decimals kept, and the lines at fault found again."""

from __future__ import annotations

import re
import tomllib
from decimal import Decimal
from pathlib import Path
from typing import Any

from stltool.errors import ModelError
from stltool.files import read_text


class Fault(ModelError):
    """What is wrong at one place of a file: a key, or a key of a table."""

    def __init__(self, place: tuple[str, ...], message: str) -> None:
        super().__init__(message)
        self.place = place


def read_toml(path: Path) -> tuple[dict[str, Any], str]:
    """A file's table, and its text."""
    text = read_text(path, "model file")
    try:
        return tomllib.loads(text, parse_float=Decimal), text
    except (ValueError, RecursionError) as error:
        raise ModelError(f"{path}: not valid TOML: {error}") from None


def line_of(text: str, *place: str) -> str:
    """ ", line N" for a key, or a table's key, where it stands on a line of its own; else nothing."""
    table = ""
    for number, line in enumerate(text.splitlines(), start=1):
        found = re.match(r"""\s*(?:\[\s*(?P<table>[^\[\]]+?)\s*\]\s*(?:#.*)?$|["']?(?P<key>[^"'=]+?)["']?\s*=)""", line)
        if found is None:
            continue
        if found["table"] is not None:
            table = found["table"].strip("\"'")
        if place == ((table,) if found["table"] is not None else (table, found["key"]) if table else (found["key"],)):
            return f", line {number}"
    return ""
