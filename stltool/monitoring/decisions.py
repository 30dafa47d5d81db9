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

    # _runs are what one sample decides, in any order: for neighbours with one verdict the first one's code and their
    # number (kernels/streams.py), 64 bits each. They are decoded when looked at, since making a hundred objects takes
    # longer than deciding a hundred steps.
    __slots__ = ("_decoded", "_runs")
    _runs: bytes
    _decoded: _Arrays

    def __init__(self, steps: NDArray[np.int64], verdicts: NDArray[np.bool_], robustness: NDArray[np.float64]) -> None:
        self._decoded = steps, verdicts, robustness

    @classmethod
    def _of_runs(cls, runs: bytes) -> Decisions:
        made = cls.__new__(cls)
        made._runs = runs
        return made

    @property
    def _arrays(self) -> _Arrays:
        if not hasattr(self, "_decoded"):
            runs = np.frombuffer(self._runs, np.int64).reshape(-1, 2)
            codes, lengths = runs[np.argsort(runs[:, 0])].T
            n = int(lengths.sum())
            steps = np.repeat((codes >> 3) - (np.cumsum(lengths) - lengths), lengths) + np.arange(n)
            self._decoded = steps, np.repeat(codes & 2 == 2, lengths), np.full(n, np.nan)
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
        return sum(memoryview(self._runs).cast("q")[1::2]) if hasattr(self, "_runs") else len(self.steps)

    def __iter__(self) -> Iterator[Decision]:
        if hasattr(self, "_runs"):
            words = memoryview(self._runs).cast("q").tolist()
            for code, length in sorted(zip(words[::2], words[1::2], strict=True)):
                for step in range(code >> 3, (code >> 3) + length):
                    yield new(Decision, (step, code & 2 == 2, None))
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
