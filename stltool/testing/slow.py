"""Signals that change by at most so much from step to step, in traces with a wanted verdict.

Backwards from the step d at which the verdict becomes certain, in the automaton's states q, over sets of values of the
slow signals, each a union of boxes in rationals:

    A_d(q)  =  everything if verdict_d(q) is the wanted one
    A_t(q)  =  V_{t+1}(q), widened by the changes, if verdict_t(q) is open
    V_t(q)  =  ⋃_λ  box(λ) ∩ A_t(δ(λ, q))                                                     t = d … 0

where box(λ) holds the values at which the comparisons have the truth that λ says. So x is in V_t(q) if and only if the
wanted verdict can still be reached from x. That is exact as long as each slow signal is compared with constants alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.errors import SizeError
from stltool.logic.regions import Choices, Draw, Span, Values

Box: TypeAlias = tuple[Span, ...]

MOST_BOXES = 400  # of one state at one step
_MOST_EFFORT = 100_000  # steps times states times kinds of letters


class Slow:
    """The slow signals `names`, with the most that each changes in a step.

    boxes    of each truth assignment λ: where the slow signals may be
    kinds    of each assignment: the number of its (letter, boxes), which `letters` and `rows` are by
    """

    def __init__(
        self, changes: Mapping[str, Fraction], boxes: Sequence[Sequence[Box]], letter_of: Sequence[int]
    ) -> None:
        self.names, self._most = tuple(changes), tuple(changes.values())
        numbers: dict[tuple[int, tuple[Box, ...]], int] = {}
        self.rows: list[list[int]] = []
        for row, (letter, here) in enumerate(zip(letter_of, boxes, strict=True)):
            number = numbers.setdefault((int(letter), tuple(here)), len(numbers))
            if number == len(self.rows):
                self.rows.append([])
            self.rows[number].append(row)
        self._letters = [letter for letter, _ in numbers]
        self._boxes = [here for _, here in numbers]

    def reach(self, delta: NDArray[np.int32], win: NDArray[np.bool_], initial: int) -> list[dict[int, list[Box]]]:
        """V_t(q) for t = 0 … d, of the states that can be reached; `win` is (d + 1, n_states), without any values."""
        d = len(win) - 1
        if (d + 1) * delta.shape[1] * len(self._boxes) > _MOST_EFFORT:
            raise SizeError("most_change is too much work for so many steps and states; shorten the formula's windows")
        reached = [{initial}]
        for t in range(d):
            ahead = {int(q) for q in np.unique(delta[:, sorted(reached[-1])])}
            reached.append({q for q in ahead if win[t][q]})
        found: list[dict[int, list[Box]]] = [{}] * (d + 1)
        for t in range(d, -1, -1):
            found[t] = {}
            for q in reached[t]:
                here = (one for kind in range(len(self._boxes)) for one in self._pieces(delta, win, found, t, q, kind))
                if boxes := _merged(here):
                    found[t][q] = boxes
        return found

    def _pieces(
        self, delta: NDArray[np.int32], win: NDArray[np.bool_], found: list[dict[int, list[Box]]], t: int, q: int,
        kind: int,
    ) -> Iterator[Box]:  # fmt: skip
        """box(λ) ∩ A_t(δ(λ, q)) for the assignments of a kind."""
        after = int(delta[self._letters[kind], q])
        if not win[t][after]:
            return
        if t == len(win) - 1:
            yield from self._boxes[kind]
            return
        for ahead in found[t + 1].get(after, ()):
            wider = tuple(_widened(span, most) for span, most in zip(ahead, self._most, strict=True))
            for box in self._boxes[kind]:
                if (piece := _met(box, wider)) is not None:
                    yield piece

    def options(
        self, delta: NDArray[np.int32], win: NDArray[np.bool_], found: list[dict[int, list[Box]]], t: int, q: int,
        before: Values | None,
    ) -> dict[int, list[Box]]:  # fmt: skip
        """For each assignment that keeps the verdict in reach, where the slow signals may be next."""
        allowed: dict[int, list[Box]] = {}
        for kind, rows in enumerate(self.rows):
            pieces = self._pieces(delta, win, found, t, q, kind) if t < len(win) else iter(self._boxes[kind])
            here = [piece for piece in (self._near(box, before) for box in pieces) if piece is not None]
            if here:
                allowed.update((row, here) for row in rows)
        return allowed

    def _near(self, box: Box, before: Values | None) -> Box | None:
        """The part of a box that can be reached in one step, if it has decimals."""
        part: Box | None = box
        if before is not None:
            around = [
                Span(before[name] - most, before[name] + most)
                for name, most in zip(self.names, self._most, strict=True)
            ]
            part = _met(box, around)
        return part if part is not None and all(Choices.within(span) is not None for span in part) else None

    def pick(self, box: Box, draw: Draw) -> Values:
        """Values of the slow signals in a box that `options` gave."""
        values: Values = {}
        for name, span in zip(self.names, box, strict=True):
            choices = Choices.within(span)
            assert choices is not None  # as `_near` has found
            values[name] = choices.pick(draw)
        return values


def _widened(span: Span, most: Fraction) -> Span:
    return Span(
        None if span.low is None else span.low - most, None if span.high is None else span.high + most, span.low_open,
        span.high_open,
    )  # fmt: skip


def _met(box: Sequence[Span], other: Sequence[Span]) -> Box | None:
    """What two boxes share; None if it is empty."""
    shared = tuple(_both(a, b) for a, b in zip(box, other, strict=True))
    return None if any(span.empty for span in shared) else shared


def _both(a: Span, b: Span) -> Span:
    low, low_open = max(((a.low, a.low_open), (b.low, b.low_open)), key=_start)
    high, high_open = min(((a.high, a.high_open), (b.high, b.high_open)), key=_stop)
    return Span(low, high, low_open, high_open)


def _start(end: tuple[Fraction | None, bool]) -> tuple[bool, Fraction, bool]:
    return end[0] is not None, end[0] or Fraction(0), end[1]


def _stop(end: tuple[Fraction | None, bool]) -> tuple[bool, Fraction, bool]:
    return end[0] is None, end[0] or Fraction(0), not end[1]


def _merged(boxes: Iterable[Box]) -> list[Box]:
    """The same set in fewer boxes: without those inside others; of one signal, without any that touch."""
    kept: list[Box] = []
    for box in dict.fromkeys(boxes):
        if any(_inside(box, other) for other in kept):
            continue
        kept = [other for other in kept if not _inside(other, box)]
        kept.append(box)
        if len(box) == 1:
            kept = [(span,) for span in _joined([span for (span,) in kept])]
        if len(kept) > MOST_BOXES:
            raise SizeError(
                f"most_change of {len(box)} signals leads to over {MOST_BOXES} boxes of values; give it for fewer"
            )
    return kept


def _inside(box: Box, other: Box) -> bool:
    return all(_both(a, b) == a for a, b in zip(box, other, strict=True))


def _joined(spans: list[Span]) -> list[Span]:
    """Spans that overlap or touch as one, ascending."""
    joined: list[Span] = []
    for span in sorted(spans, key=lambda one: _start((one.low, one.low_open))):
        last = joined[-1] if joined else None
        if last is not None and (
            last.high is None or span.low is None or span.low < last.high
            or (span.low == last.high and not (span.low_open and last.high_open))
        ):  # fmt: skip
            far = max(((last.high, last.high_open), (span.high, span.high_open)), key=_stop)
            joined[-1] = Span(last.low, far[0], last.low_open, far[1])
        else:
            joined.append(span)
    return joined
