"""The tree of reasons behind a verdict, and that tree in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.display import cut
from stltool.errors import TraceError
from stltool.logic.formula import Comparison, Constant, Formula, Label, Not
from stltool.logic.printer import Text
from stltool.logic.quantities import Ticks
from stltool.logic.semantics import robustness

_LONGEST = 100  # characters of a formula
_WIDTH = 112  # of a line with two parts
_RANGES, _VALUES = 3, 4  # ranges of steps, and values of a signal, that are listed


@dataclass(frozen=True, eq=False)
class Reason:
    """A sub-formula that has one truth value at some steps, and the operands that decide it.

    steps        (n,) int64, ascending
    parts        which operands decide, each at the steps at which it is needed; none for what is read from the samples
    values       the samples at `steps` of the signals that a label or a comparison reads
    awaited      whether it is the operand of a failed eventually or until: it does not come throughout `steps`
    last, next   if so: the last step before and the first after at which it holds; None if there is none
    decided      whether the trace decides that there is none before, and none after
    """

    formula: Formula
    holds: bool
    steps: NDArray[np.int64]
    parts: tuple[Reason, ...] = ()
    values: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    awaited: bool = False
    last: int | None = None
    next: int | None = None
    decided: tuple[bool, bool] = (True, True)

    def between(self, last: int | None, next_: int | None, decided: tuple[bool, bool]) -> Reason:
        """The same, as what did not come."""
        return replace(self, awaited=True, last=last, next=next_, decided=decided)


def ranges_of(steps: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Ascending steps as ranges first … last."""
    breaks = np.flatnonzero(np.diff(steps) != 1)
    firsts, lasts = np.append(steps[:1], steps[breaks + 1]), np.append(steps[breaks], steps[-1:])
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


def time_text(step: int, ticks: Ticks | None) -> str:
    """The time of a step: 4.1 s; without a declared step, its number."""
    return str(step) if ticks is None else ticks.text(step)


def steps_text(steps: NDArray[np.int64], ticks: Ticks | None) -> str:
    """`at step 3`, `at steps 4 … 6`, `at 0.4 … 0.6 s (steps 4 … 6)`, `at 17 steps from 3 to 90`."""
    ranges = ranges_of(steps)
    if len(ranges) > _RANGES:
        numbers = f"{len(steps)} steps from {ranges[0][0]} to {ranges[-1][1]}"
        first, last = time_text(ranges[0][0], ticks), time_text(ranges[-1][1], ticks)
        return f"at {numbers}" if ticks is None else f"at {len(steps)} steps from {first} to {last}"
    if ticks is None:
        return f"at step{'s'[: len(steps) != 1]} {_listed([_range(a, b) for a, b in ranges])}"
    unit = f" {ticks.unit}"
    times = _listed([_range(ticks.text(a).removesuffix(unit if a != b else ""), ticks.text(b), a == b)
                     for a, b in ranges])  # fmt: skip
    return f"at {times} ({steps_text(steps, None).removeprefix('at ')})"


def _range(first: object, last: object, single: bool | None = None) -> str:
    return f"{first}" if (first == last if single is None else single) else f"{first} … {last}"


def _listed(texts: list[str]) -> str:
    return texts[0] if len(texts) == 1 else f"{', '.join(texts[:-1])} and {texts[-1]}"


def sentences(reason: Reason, ticks: Ticks | None = None, text: Text = str) -> list[str]:
    """One line for each sub-formula, operands below it and indented; a single operand without parts in its line."""
    return ["  " * depth + line for depth, line in _lines(reason, 0, ticks, text)]


def _lines(reason: Reason, depth: int, ticks: Ticks | None, text: Text) -> Iterator[tuple[int, str]]:
    while isinstance(reason.formula, Not) and reason.parts:
        reason = reason.parts[0]
    parts = [_unwrapped(part) for part in reason.parts]
    if not parts:
        yield depth, _leaf(reason, ticks, text)
        return
    head = f"{_shown(reason.formula, text)} {'holds' if reason.holds else 'fails'} {steps_text(reason.steps, ticks)}"
    if reason.awaited:
        head += _neighbours(reason, ticks)
    if len(parts) == 1 and not parts[0].parts:
        line = f"{head}: {_leaf(parts[0], ticks, text)}"
        if 2 * depth + len(line) <= _WIDTH:
            yield depth, line
            return
    yield depth, f"{head}:"
    for part in parts:
        yield from _lines(part, depth + 1, ticks, text)


def _unwrapped(reason: Reason) -> Reason:
    """Without negations."""
    while isinstance(reason.formula, Not) and reason.parts:
        [inner] = reason.parts
        reason = inner if not reason.awaited else inner.between(reason.last, reason.next, reason.decided)
    return reason


def _leaf(reason: Reason, ticks: Ticks | None, text: Text) -> str:
    """What is read from the samples."""
    phi, where = reason.formula, steps_text(reason.steps, ticks)
    if isinstance(phi, Constant):
        return f"{phi} is {'true' if reason.holds else 'false'} by itself"
    if reason.awaited:
        where = where.replace("at ", "throughout " if len(reason.steps) > 1 else "at ", 1)
    if isinstance(phi, Label):
        told = f"{text(phi)} is {'true' if reason.holds else 'false'} {where}"
    else:
        told = f"{_shown(phi, text)} {'holds' if reason.holds else 'fails'} {where}"
    details = []
    if isinstance(phi, Comparison):
        details = [_values(name, values) for name, values in reason.values.items()]
        details += _short(phi, reason)
    elif not isinstance(phi, Label):
        details = ["whatever the samples are"]
    if details:
        told += f" with {', '.join(details)}" if reason.values else f" ({details[0]})"
    return told + (_neighbours(reason, ticks) if reason.awaited else "")


def _values(name: str, values: NDArray[Any]) -> str:
    listed = values.tolist()
    if len(set(listed)) == 1 or len(listed) <= _VALUES:
        return f"{name} = {', '.join(f'{value:.6g}' for value in (dict.fromkeys(listed)))}"
    return f"{name} from {min(listed):.6g} to {max(listed):.6g}"


def _short(phi: Comparison, reason: Reason) -> list[str]:
    """By how much an inequality fails at a single step."""
    if reason.holds or len(reason.steps) != 1 or phi.op in ("==", "!="):
        return []
    try:
        margin = robustness(phi, {name: [float(values[0])] for name, values in reason.values.items()})
    except TraceError:
        return []
    return [f"short by {-margin:.6g}"] if margin else ["exactly on the border"]


def _neighbours(reason: Reason, ticks: Ticks | None) -> str:
    """When it held before and after, and by when it was needed."""
    word = "true" if isinstance(reason.formula, Label) else "held"
    if reason.holds:  # awaited is its negation
        return ""
    told = []
    if reason.last is not None:
        told.append(f"last {word} at {time_text(reason.last, ticks)}")
    elif reason.decided[0]:
        told.append(f"never {word} before")
    if reason.next is not None:
        told.append(f"next at {time_text(reason.next, ticks)}")
    elif reason.decided[1]:
        told.append("not again")
    return "; " + ", ".join([*told, f"needed by {time_text(int(reason.steps[-1]), ticks)}"])


def _shown(phi: Formula, text: Text) -> str:
    return cut(text(phi), _LONGEST)
