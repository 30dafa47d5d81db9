"""A few lines of text that show where the parts of a formula hold along a trace."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.diagnosis import Diagnosis
from stltool.display import cut
from stltool.errors import StlToolError
from stltool.logic.formula import Comparison, Constant, Formula, Label, Not, distinct, label_names, variables
from stltool.monitoring.offline import monitor

_WIDTH, _BEFORE = 64, 8  # steps shown, and those of them before the first cause
_NAMES = 36  # characters of a formula
_ROWS = 10

HOLDS, FAILS, UNDECIDED = "#", ".", " "


def timeline(found: Diagnosis, signals: Mapping[str, ArrayLike]) -> list[str]:
    """Rows of `#` (holds), `.` (fails) and blanks (not decided): the parts of the formula outside in, then the causes.

    At most 64 steps are shown, from shortly before the first cause on; all of a shorter trace.
    """
    length = max((len(np.atleast_1d(np.asarray(signals[name]))) for name in found.values), default=0)
    if not length:
        return []
    marked = sorted({step for steps in found.causes.values() for step in steps.tolist()})
    first = max(0, min(marked or [found.step]) - _BEFORE) if length > _WIDTH else 0
    last = min(length, first + _WIDTH)
    parts = [part for part in dict.fromkeys(distinct(found.formula)) if not isinstance(part, Not | Constant)]
    leaves = [part for part in parts if isinstance(part, Label | Comparison)]
    operators = [part for part in parts if not isinstance(part, Label | Comparison)]
    shown = [*operators[: max(1, _ROWS - len(leaves))], *leaves[: _ROWS - 1]]
    rows = [(cut(found.text(part), _NAMES), _row(part, signals, found, first, last)) for part in shown]
    causes = "".join("^" if step in marked else " " for step in range(first, last)).rstrip()
    head = "step" if first == 0 else f"step {first} …"
    rows = [(head, _ruler(first, last)), *rows, *([("causes", causes)] if causes else [])]
    width = max(len(name) for name, _ in rows)
    more = len(parts) - len(shown)
    lines = [f"{name:<{width}}  {row}".rstrip() for name, row in rows]
    return [*lines, *([f"and {more} more parts"] if more > 0 else [])]


def _row(part: Formula, signals: Mapping[str, ArrayLike], found: Diagnosis, first: int, last: int) -> str:
    read = {name: signals[name] for name in {**variables(part), **label_names(part)}}
    try:
        verdicts: NDArray[np.bool_] | None = monitor(part, read or signals, found.end, "boolean").verdicts
    except StlToolError:  # a term without a value, or a window that is longer than the trace
        verdicts = None
    known = [] if verdicts is None else verdicts.tolist()
    return "".join(
        (HOLDS if known[step] else FAILS) if step < len(known) else UNDECIDED for step in range(first, last)
    ).rstrip()


def _ruler(first: int, last: int) -> str:
    """The last digit of every step."""
    return "".join(str(step % 10) for step in range(first, last))
