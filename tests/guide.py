"""The steps of docs/from-assert.md, for its test, and for the trial of the built wheel."""

import re
from pathlib import Path

PAGE = Path(__file__).resolve().parent.parent / "docs" / "from-assert.md"
_STEP = re.compile(r"Save this as `([^`]+)`:\n\n```\w*\n(.*?)```|```\n\$ pytest(.*?)\n(.*?)```", re.DOTALL)


def steps() -> list[tuple[str, str, str, str]]:
    """In order: (file, its content, "", ""), or ("", "", the options of pytest, lines that it prints)."""
    return _STEP.findall(PAGE.read_text(encoding="utf-8"))
