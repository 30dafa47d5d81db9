"""Progress in logs: lines on stderr, at least one every ten seconds, whatever is running.

The work in progress is a stack of stages; the innermost reports its title and progress. A thread prints a line if none
was printed for `EVERY` seconds, so a single step that takes an hour is reported, too.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from stltool.screen import Screen

EVERY = 10.0  # seconds


@dataclass
class Stage:
    """A stage of work: its start and progress. The first line is due after `patience` seconds."""

    title: str
    began: float
    patience: float
    note: str = ""


class Log:
    """`write` prints a line, `clock` returns seconds; without `watched`, nothing is printed unless `beat` is called.

    quiet   whether nothing is printed at all
    """

    def __init__(
        self,
        write: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        watched: bool = True,
    ) -> None:
        self._write, self._clock, self._watched = write, clock, watched
        self.quiet = False
        self._stages: list[Stage] = []
        self._last = clock()
        self._lock = threading.RLock()
        self._changed = threading.Event()

    @contextmanager
    def stage(self, title: str, patience: float | None = None) -> Iterator[Stage]:
        """A stage that may take long; `patience` if its first line should come earlier than usual."""
        with self._lock:
            stage = Stage(title, self._clock(), EVERY if patience is None else patience)
            if not self._stages:
                self._last = stage.began
            self._stages.append(stage)
            if self._watched and len(self._stages) == 1:
                threading.Thread(target=self._watch, daemon=True).start()
        self._changed.set()  # its first line may be due earlier than others
        try:
            yield stage
        finally:
            with self._lock:
                self._stages.remove(stage)
            self._changed.set()

    def say(self, line: str) -> None:
        """Print a line, unless `quiet`; the next one is due `EVERY` seconds later."""
        with self._lock:
            self._last = self._clock()
            if not self.quiet:
                self._write(line)

    def beat(self) -> float:
        """Print a line if one is due; returns seconds until the next one, infinite if no stage is active."""
        with self._lock:
            if not self._stages:
                return float("inf")
            stage, now = self._stages[-1], self._clock()
            due = max(self._last, stage.began) + stage.patience
            due = min(due, self._last + EVERY)
            if now < due:
                return due - now
            passed = now - stage.began
            told = [stage.note] * bool(stage.note) + [f"{passed:.0f} s so far"] * (passed >= EVERY or bool(stage.note))
            self.say(f"{stage.title}: {', '.join(told)}" if told else f"{stage.title} …")
            stage.patience = EVERY
            return EVERY

    def _watch(self) -> None:
        """The thread, running as long as there is a stage."""
        with suppress(OSError, ValueError):  # stderr is closed
            while True:
                self._changed.clear()
                wait = self.beat()
                if wait == float("inf"):
                    return
                self._changed.wait(wait)


def _print(line: str) -> None:
    Screen(stderr=True).print(line)


LOG = Log(_print)
"""The log of this process."""
