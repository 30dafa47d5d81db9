"""Names in a text: as they are, or in double quotes where they would not be read as names.

In quotes a name may hold anything but a line break; a double quote is doubled: "a ""raw"" one".
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from stltool.errors import near_misses

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(?:\.[A-Za-z_][A-Za-z0-9_]*)*")
_TEMPORAL = {"F", "G", "U", "ev", "alw", "once", "historically", "prev", "rise", "fall", "since", "trigger", "release",
             "weak_until"}  # fmt: skip
_IN_ANY_CASE = {
    "always", "globally", "eventually", "finally", "until", "true", "false", "and", "or", "not", "xor", "implies",
    "iff", "inf", "infinity", "nan",
}  # fmt: skip
_NAMES_TOO = {  # where no line of a task file, and no call, can begin
    "model", "param", "signal", "step", "steps", "unit", "expect", "input", "output", "abs", "min", "max", "sqrt",
}  # fmt: skip


def written(name: str) -> str:
    """A label or a signal as a text names it: in quotes if it would not be read as a name without them."""
    stem = name.removesuffix("_")  # Breach writes always_[0,5]
    word = stem in _TEMPORAL or stem.lower() in _IN_ANY_CASE or name in _NAMES_TOO
    if _NAME.fullmatch(name) and not word:
        return name
    doubled = name.replace('"', '""')
    return f'"{doubled}"'


def unquoted(text: str) -> str:
    """The name that a text names; for one without quotes, the text itself."""
    return text[1:-1].replace('""', '"') if text.startswith('"') else text


def can_be_written(name: str) -> bool:
    """Whether a text can name it."""
    return name != "" and not re.search(r"[\r\n]", name)


def near_names(name: str, known: Iterable[str]) -> str:
    """A hint, like `near_misses`, with the names as a text names them."""
    return near_misses(name, known, written)
