"""Who is told of every trace that assertions, recorders and machines judge: coverage, while it is collected."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from numpy.typing import ArrayLike

from stltool.logic.formula import Formula
from stltool.logic.task import Task
from stltool.monitoring.samples import End

LISTENERS: list[Callable[[Formula | Task, Mapping[str, ArrayLike], int, End], None]] = []


def tell(phi: Formula | Task, signals: Mapping[str, ArrayLike], t: int, end: End) -> None:
    """This trace was judged at step t, whatever the verdict is."""
    for listener in LISTENERS:
        listener(phi, signals, t, end)
