"""What runs reach, step by step, within a memory limit: layers are kept at checkpoints, the others computed again.

With n layers of b bytes and every k-th of them kept, n/k · b bytes are kept and k · b recomputed at a time: at the
memory limit k grows until both fit (k = √n at best). Recomputing a layer costs one more forward step.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple


class Stretch(NamedTuple):
    """Steps first … last, which share a layer."""

    first: int
    last: int
    layer: Any


class Reached:
    """Layers of steps 0, 1, … by stretches, each made from the one before: after(layer, t) is that of step t + 1.

    `most` is the number of bytes that the kept layers may take together; beyond it, fewer are kept.
    """

    def __init__(self, after: Callable[[Any, int], Any], most: float) -> None:
        self._after, self._most = after, most
        self._steps: list[tuple[int, int]] = []
        self._kept: dict[int, tuple[Any, int]] = {}
        self._every = 1
        self.bytes = 0

    def __len__(self) -> int:
        return len(self._steps)

    @property
    def last(self) -> int:
        """The last step that has a layer; −1 if none has."""
        return self._steps[-1][1] if self._steps else -1

    def add(self, first: int, last: int, layer: Any, n_bytes: int) -> None:
        """The next stretch, whose layer takes n_bytes."""
        i = len(self._steps)
        self._steps.append((first, last))
        if i % self._every:
            return
        self._kept[i] = (layer, n_bytes)
        self.bytes += n_bytes
        while self.bytes > self._most and len(self._kept) > 1:
            self._every *= 2
            for j in [j for j in self._kept if j % self._every]:
                self.bytes -= self._kept.pop(j)[1]

    def __iter__(self) -> Iterator[Stretch]:
        layer = None
        for i, (first, last) in enumerate(self._steps):
            layer = self._kept[i][0] if i in self._kept else self._after(layer, first - 1)
            yield Stretch(first, last, layer)

    def back(self, before: int | None = None) -> Iterator[Stretch]:
        """The stretches from the last one back, or those before step `before`: the first of them ends there."""
        n = len(self._steps) if before is None else sum(first < before for first, _ in self._steps)
        for begin in range((n - 1) // self._every * self._every, -1, -self._every):
            layers = [self._kept[begin][0]]
            for first, _ in self._steps[begin + 1 : min(begin + self._every, n)]:
                layers.append(self._after(layers[-1], first - 1))
            for i in range(begin + len(layers) - 1, begin - 1, -1):
                first, last = self._steps[i]
                yield Stretch(first, last if before is None else min(last, before - 1), layers.pop())
