"""The executions so far, and what they say of others that have not been made.

The verdict of an execution is often certain long before its end: an implication holds as soon as its premise fails. A
system that is causal answers the same until then to every input that is the same until then, so that none of those can
violate the requirement. That is used twice: an input is varied where it had a part in its verdict, and proposals that
cannot violate are passed over. Those that are drawn at random are never, in case the system is not causal.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from stltool.errors import StlToolError
from stltool.logic.formula import Formula, atoms, delay
from stltool.monitoring import monitor
from stltool.monitoring.kleene import Kleene, Trits, skeleton
from stltool.testing.falsification.inputs import F64, Inputs
from stltool.testing.falsification.score import Scores, comparisons

_SAME = 1e-4  # of a range: within it, points are taken to be the same


class Tried:
    """points (n, dimension) in order of execution; relevant (n, dimension): what had a part in their verdicts."""

    def __init__(self, phi: Formula, inputs: Inputs) -> None:
        self._inputs, self._prefixes = inputs, Prefixes(phi, inputs.begins)
        self.scores = Scores(phi)
        self.points = np.empty((0, inputs.dimension))
        self.relevant = np.empty((0, inputs.dimension), np.bool_)

    def __len__(self) -> int:
        return len(self.points)

    def add(self, x: F64, trace: Mapping[str, F64]) -> None:
        self.points = np.append(self.points, x[None], axis=0)
        self.relevant = np.append(self.relevant, self._inputs.relevant(self._prefixes.certain(trace))[None], axis=0)
        self.scores.add(trace)

    @property
    def best(self) -> NDArray[np.int64]:
        """Indices of executions, the nearest to a violation first."""
        return np.argsort(self.scores.values, kind="stable")

    def settled(self, x: F64) -> NDArray[np.bool_]:
        """(m,): whether an execution excludes that points (m, dimension) violate."""
        found = np.zeros(len(x), np.bool_)
        for point, relevant in zip(self.points, self.relevant, strict=True):
            found |= (np.abs(x[:, relevant] - point[relevant]) < _SAME).all(axis=1)
        return found


class Prefixes:
    """After which of the given numbers of samples the verdict of a trace at step 0 is certain, in Kleene's logic.

    Not before the end for a formula whose comparisons read earlier samples.
    """

    def __init__(self, phi: Formula, lengths: NDArray[np.int64]) -> None:
        self._atoms = {str(i): atom for i, atom in enumerate(atoms(phi))}
        self._lengths = np.empty(0, np.int64) if any(map(delay, comparisons(phi))) else lengths
        if len(self._lengths):
            self._machine = Kleene(skeleton(phi, {atom: name for name, atom in self._atoms.items()}))

    def certain(self, trace: Mapping[str, F64]) -> int:
        """The least of the lengths at which it is; the trace's where there is none, or that cannot be judged."""
        steps = len(next(iter(trace.values())))
        if not len(self._lengths):
            return steps
        columns: dict[str, Trits] = {}
        for name, atom in self._atoms.items():
            try:
                truth = monitor(atom, trace, semantics="boolean").verdicts
            except StlToolError:  # a term without a value somewhere, which the formula does not look at
                return steps
            assert truth is not None  # asked for
            known = np.arange(steps) < self._lengths[:, None] - (steps - len(truth))
            columns[name] = np.where(known, np.resize(2 * truth.astype(np.int8) - 1, steps), 0).astype(np.int8)
        decided = self._machine.judge(columns, steps)[:, 0] != 0 if columns else np.zeros(0, np.bool_)
        return int(self._lengths[np.argmax(decided)]) if decided.any() else steps
