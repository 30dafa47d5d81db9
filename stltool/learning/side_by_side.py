"""Episodes of one learner side by side, on a black box that takes many runs at once (`Batched`).

Each episode is played by the learner in a thread of its own, and threads take turns: one runs at a time, in the order
of the episodes, from one `episode.step` to the next. When all have chosen, the black box takes one step, and they go
on. So nothing happens at the same time but the black box's runs, and the same seed gives the same result.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from stltool.learning.episode import Episode
from stltool.models.environment import Environment, Runs

MOST = 512  # episodes at once, each with a thread


def play(
    runs: Runs,
    begin: Callable[[Environment, int], Episode],
    learn: Callable[[Episode], None],
    numbers: Sequence[int],
) -> list[Episode]:
    """Play the episodes of these numbers side by side, each begun by `begin` and played by `learn`."""
    lanes = [_Lane() for _ in numbers]
    first = runs.reset(len(lanes)).tolist()
    episodes = [
        begin(Environment(partial(int, s), lane.step), number)
        for s, lane, number in zip(first, lanes, numbers, strict=True)
    ]
    try:
        for lane, episode in zip(lanes, episodes, strict=True):
            lane.start(partial(learn, episode))
        while any(lane.asks for lane in lanes):
            after = runs.step(np.array([lane.choice if lane.asks else -1 for lane in lanes], dtype=np.int64))
            for lane, s in zip(lanes, after.tolist(), strict=True):
                if lane.asks:
                    lane.go_on(s)
    finally:
        for lane in lanes:
            lane.stop()
    return episodes


class _Stopped(BaseException):
    """Ends an episode's thread where another one has failed; no learner catches it by accident."""


class _Lane:
    """One episode's thread, which runs only while `start` or `go_on` waits for it.

    asks    whether it waits for the answer to `choice`; otherwise it has ended
    """

    def __init__(self) -> None:
        self.asks, self.choice = False, -1
        self._answer, self._stopped = -1, False
        self._fault: BaseException | None = None
        self._mine, self._others = threading.Lock(), threading.Lock()  # whose turn it is: each is let go by the other
        self._mine.acquire()
        self._others.acquire()
        self._thread: threading.Thread | None = None

    def start(self, play: Callable[[], None]) -> None:
        self._thread = threading.Thread(target=self._run, args=(play,), daemon=True)
        self._thread.start()
        self._wait()

    def go_on(self, answer: int) -> None:
        self._answer, self.asks = answer, False
        self._mine.release()
        self._wait()

    def stop(self) -> None:
        """End the thread, in the middle of its episode if need be."""
        if self.asks:
            self._stopped, self.asks = True, False
            self._mine.release()
        if self._thread is not None:
            self._thread.join()

    def step(self, choice: int) -> int:
        """In its thread: the state after a choice."""
        self.choice, self.asks = choice, True
        self._others.release()
        self._mine.acquire()
        if self._stopped:
            raise _Stopped
        return self._answer

    def _run(self, play: Callable[[], None]) -> None:
        try:
            play()
        except _Stopped:
            return
        except BaseException as fault:  # raised again where it is waited for
            self._fault = fault
        self._others.release()

    def _wait(self) -> None:
        self._others.acquire()
        if self._fault is not None:
            raise self._fault
