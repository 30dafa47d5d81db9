"""The standard streams as the command line needs them, whatever they are connected to.

Whatever is printed goes through `say`, or a Screen (screen.py): control characters of names, files and messages are
shown, never obeyed.

If a stream's encoding lacks a character (a redirect on Windows, `PYTHONIOENCODING=ascii`), a readable substitute is
printed: tau, x, ->, <=. If the reader has stopped (`| head`), the rest is dropped, and the exit code is unchanged.
"""

from __future__ import annotations

import codecs
import errno
import io
import os
import re
import sys
import unicodedata
from typing import Any

_STAND_INS = {
    "×": "x", "·": "*", "−": "-", "–": "-", "—": "-", "…": "...", "•": "*", "→": "->", "←": "<-", "↔": "<->", "⇒": "=>",
    "≤": "<=", "≥": ">=", "≠": "!=", "≈": "~", "∞": "inf", "∧": "&", "∨": "|", "¬": "!", "∈": "in", "∑": "sum",
    "‘": "'", "’": "'", "“": '"', "”": '"', "█": "#", "✓": "yes", "✗": "no", "\u0303": "~",
    "↑": "^", "↓": "v", "↗": "/", "↙": "/", "↘": "\\", "↖": "\\",
}  # fmt: skip


# what moves the cursor, recolours or retitles a terminal, or turns the order of letters around
_OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


def prepare() -> None:
    """Make stdout and stderr print what they can, and survive a reader that stops."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if not isinstance(stream, io.TextIOWrapper):
            continue
        stream.flush()
        try:
            raw = None if stream.isatty() else _Outlet(stream.fileno(), "wb", closefd=False)
        except OSError:  # not connected to a file, as in tests
            raw = None
        if raw is None:
            stream.reconfigure(errors="stltool")
        else:
            options: dict[str, Any] = {"encoding": stream.encoding, "line_buffering": stream.line_buffering}
            setattr(sys, name, io.TextIOWrapper(io.BufferedWriter(raw), errors="stltool", **options))


def escaped(text: str) -> str:
    """The text with control characters as \\x1b; line ends and tabs stay."""
    return _OBEYED.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def control_character(text: str) -> str:
    """The first control character of a text as U+001B; "" if there is none. Readers refuse names that hold one."""
    found = _OBEYED.search(text)
    return f"U+{ord(found[0]):04X}" if found is not None else ""


def printable(text: str) -> str:
    """The text as stdout will show it, so that columns can be measured."""
    encoding = sys.stdout.encoding or "utf-8"
    return escaped(text).encode(encoding, errors="stltool").decode(encoding)


def say(text: str = "", end: str = "\n", error: bool = False, flush: bool = False) -> None:
    """Print a text on stdout or stderr."""
    print(escaped(text), end=end, file=sys.stderr if error else sys.stdout, flush=flush)


class _Outlet(io.FileIO):
    """A file that discards output once it cannot be written; silently if the reader has stopped."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as error:
            nothing = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nothing, self.fileno())
            os.close(nothing)
            if error.errno not in (errno.EPIPE, errno.EINVAL):  # on Windows, EINVAL means a closed pipe
                raise
            return super().write(data)


def stand_in(character: str) -> str:
    """The substitute for a character that an encoding lacks: one or a few ASCII characters."""
    if character in _STAND_INS:
        return _STAND_INS[character]
    words = unicodedata.name(character, "").split()
    if words[:1] == ["GREEK"] and words[2:3] == ["LETTER"]:
        letter = words[3].lower()
        return letter.capitalize() if words[1] == "CAPITAL" else letter
    if words[:2] == ["BOX", "DRAWINGS"]:
        return {"HORIZONTAL": "-", "VERTICAL": "|"}.get(" ".join(words[3:]), "+")
    return character.encode("ascii", errors="backslashreplace").decode()


def _replace(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    return "".join(map(stand_in, error.object[error.start : error.end])), error.end


codecs.register_error("stltool", _replace)
