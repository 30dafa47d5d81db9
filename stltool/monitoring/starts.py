"""The open steps of a running trace in Python: of formulas that look back without a limit (others: kernels)."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable

from stltool.monitoring.early import OPEN, YES, Engine

Found = tuple[int, bool]
"""A step, and its verdict."""


class OpenSteps:
    """The steps that are not decided, by the state of the engine's automaton; in each state, the oldest first."""

    def __init__(self, engine: Engine) -> None:
        assert engine.letter is not None
        assert engine.delta is not None
        assert engine.starts is not None
        assert engine.begins is not None
        self.n_steps = 0
        self._start = 0
        self._letter = engine.letter.tolist()
        self._delta, self._starts = engine.delta.tolist(), engine.starts.tolist()
        self._begins = engine.begins.tolist()
        self._engine = engine
        self._open: dict[int, deque[int]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._open.values()))

    def read(self, truths: list[bool]) -> list[Found]:
        """The steps that are decided by the next sample, by the truths of the engine's leaves there; in order."""
        letter = self._letter[sum(truth << i for i, truth in enumerate(truths))]
        row, now = self._delta[letter], self.n_steps
        self._open.setdefault(self._begins[self._start], deque()).append(now)
        self._start = self._starts[letter][self._start]
        self.n_steps += 1
        found: list[Found] = []
        after: dict[int, deque[int]] = {}
        for before, steps in self._open.items():
            q = row[before]
            left = self._decide(q, steps, now, found)
            if left:
                after[q] = deque(heapq.merge(after[q], left)) if q in after else left
        self._open = after
        return sorted(found)

    def decided(self, verdict: Callable[[int, int], bool | None]) -> list[Found]:
        """The open steps that have a verdict by state and clock, in any order; they are open no longer."""
        found: list[Found] = []
        for q, steps in list(self._open.items()):
            known = {step: verdict(q, self.n_steps - 1 - step) for step in steps}
            found += [(step, value) for step, value in known.items() if value is not None]
            self._open[q] = deque(step for step in steps if known[step] is None)
            if not self._open[q]:
                del self._open[q]
        return found

    def copied(self) -> OpenSteps:
        """What reads on by itself."""
        other = OpenSteps.__new__(OpenSteps)
        other.__dict__.update(self.__dict__)
        other._open = {q: steps.copy() for q, steps in self._open.items()}
        return other

    def _decide(self, q: int, steps: deque[int], now: int, found: list[Found]) -> deque[int]:
        """Move the steps in state q that are decided to `found`; the others."""
        engine = self._engine
        if engine.closed is not None:
            left: deque[int] = deque()
            for step in steps:
                value = engine.closed[now - step, q]
                if value == OPEN:
                    left.append(step)
                else:
                    found.append((step, bool(value == YES)))
            return left
        assert engine.first is not None
        assert engine.outcome is not None
        while steps and now - steps[0] >= engine.first[q]:
            found.append((steps.popleft(), bool(engine.outcome[q] == YES)))
        return steps
