"""Ctrl-C between two episodes: a run that is to be saved is not interrupted in the middle of one."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType


@dataclass
class Interrupt:
    """Whether the user has asked to stop."""

    asked: bool = False


@contextmanager
def interruptible(deferred: bool) -> Iterator[Interrupt]:
    """If `deferred`, the first SIGINT only sets `asked`; the second one interrupts at once, as usual.

    Nothing changes outside the main thread, or if the process handles or ignores SIGINT in its own way.
    """
    interrupt = Interrupt()
    usual = signal.getsignal(signal.SIGINT)
    mine = threading.current_thread() is threading.main_thread() and usual is signal.default_int_handler
    if not (deferred and mine):
        yield interrupt
        return

    def note(number: int, frame: FrameType | None) -> None:
        if interrupt.asked:
            signal.default_int_handler(number, frame)
        interrupt.asked = True

    signal.signal(signal.SIGINT, note)
    try:
        yield interrupt
    finally:
        signal.signal(signal.SIGINT, usual)
