"""The verdicts that an online monitor tells: one, or those of a block of samples."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from stltool.display import Card, Displayed, counted

_Arrays: TypeAlias = tuple[NDArray[np.int64], NDArray[np.bool_], NDArray[np.float64]]
new = tuple.__new__  # a named tuple's own constructor takes twice the time


class Decision(NamedTuple):
    """The verdict at one step, and its robustness; None if that was not waited for."""

    step: int
    verdict: bool
    robustness: float | None

    def _repr_html_(self) -> str:
        verdict = "true" if self.verdict else "false"
        robustness = "not final" if self.robustness is None else self.robustness
        return Card(f"Decision: {verdict} at step {self.step}", [{"robustness": robustness}]).html()


class Decisions(Displayed, Sequence[Decision]):
    """Several decisions, by step: a sequence of `Decision`, equal to any sequence of the same ones.

    steps       (n,) int64, ascending
    verdicts    (n,) Booleans
    robustness  (n,) float64; NaN if it was not waited for
    """

    # _codes are what one sample decides, 64-bit codes in any order (kernels/streams.py). They are decoded when looked
    # at, since making a hundred objects takes longer than deciding a hundred steps.
    __slots__ = ("_codes", "_decoded")
    _codes: bytes
    _decoded: _Arrays

    def __init__(self, steps: NDArray[np.int64], verdicts: NDArray[np.bool_], robustness: NDArray[np.float64]) -> None:
        self._decoded = steps, verdicts, robustness

    @classmethod
    def _of_codes(cls, codes: bytes) -> Decisions:
        made = cls.__new__(cls)
        made._codes = codes
        return made

    @property
    def _arrays(self) -> _Arrays:
        if not hasattr(self, "_decoded"):
            codes = np.sort(np.frombuffer(self._codes, np.int64))
            self._decoded = codes >> 3, codes & 2 == 2, np.full(len(codes), np.nan)
        return self._decoded

    @property
    def steps(self) -> NDArray[np.int64]:
        return self._arrays[0]

    @property
    def verdicts(self) -> NDArray[np.bool_]:
        return self._arrays[1]

    @property
    def robustness(self) -> NDArray[np.float64]:
        return self._arrays[2]

    def __len__(self) -> int:
        return len(self._codes) // 8 if hasattr(self, "_codes") else len(self.steps)

    def __iter__(self) -> Iterator[Decision]:
        if hasattr(self, "_codes"):
            for code in sorted(memoryview(self._codes).cast("q")):
                yield new(Decision, (code >> 3, code & 2 == 2, None))
            return
        for step, verdict, value in zip(*(array.tolist() for array in self._arrays), strict=True):
            yield new(Decision, (step, verdict, None if math.isnan(value) else value))

    @overload
    def __getitem__(self, at: int) -> Decision: ...
    @overload
    def __getitem__(self, at: slice) -> Decisions: ...
    def __getitem__(self, at: int | slice) -> Decision | Decisions:
        if isinstance(at, slice):
            return Decisions(self.steps[at], self.verdicts[at], self.robustness[at])
        step, verdict, value = (array[at].item() for array in self._arrays)
        return Decision(step, verdict, None if math.isnan(value) else value)

    def __eq__(self, other: object) -> Any:
        return [*self] == [*other] if isinstance(other, Sequence) else NotImplemented

    __hash__ = None  # type: ignore[assignment]  # as of lists

    def _card(self) -> Card:
        facts = {"violated at": counted(int((~self.verdicts).sum()), "step")}
        return Card(f"Decisions: {counted(len(self), 'step')}", [facts])
