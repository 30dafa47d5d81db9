"""The verdicts of a formula's parts along a trace: where each of them holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.errors import TraceError
from stltool.logic.formula import Comparison, Constant, Formula, Label, Not, label_names, variables, walk
from stltool.monitoring.offline import monitor
from stltool.monitoring.samples import End


@dataclass(frozen=True, eq=False)
class PartVerdicts:
    """Where a part holds, (n_decided,) bool; None if it has no value somewhere, such as 1/0."""

    formula: Formula
    verdicts: NDArray[np.bool_] | None


def part_verdicts(
    phi: Formula, signals: Mapping[str, ArrayLike], end: End, most: int
) -> tuple[list[PartVerdicts], int]:
    """The verdicts of the first parts of φ on one trace, outside in, and how many more there are.

    The parts are the distinct sub-formulas below the root, without negations, labels, comparisons and constants.
    """
    plain = (Not, Label, Comparison, Constant)
    parts = list(dict.fromkeys(node for node in walk(phi) if node is not phi and not isinstance(node, plain)))
    found = []
    for part in parts[:most]:
        read = {name: signals[name] for name in {**variables(part), **label_names(part)}}
        try:
            verdicts = monitor(part, read or signals, end, "boolean").verdicts
        except TraceError:
            verdicts = None
        found.append(PartVerdicts(part, verdicts))
    return found, len(parts) - len(found)
