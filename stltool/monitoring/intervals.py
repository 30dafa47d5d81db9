"""The robustness interval of a step whose samples have not all arrived: [lower, upper] contains the final value.

In negation normal form robustness is monotone in the margins of literals, so it is evaluated twice, with the margins
that are not known at −∞ and at +∞. It shrinks with every sample. If every predicate occurs in one polarity, both ends
are reached by real continuations; otherwise the interval may be wider than that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.logic.formula import Constant, Formula, Label, Not, children, with_children
from stltool.logic.rewrite import negation_normal_form
from stltool.monitoring.blocks import Block, Machine
from stltool.monitoring.comparisons import Predicate
from stltool.monitoring.program import Instruction, compile_formula

NEGATED = "\0"  # begins the name of a negated label, and no name in a text
MOST_SHARED = 10**9  # shared operands are evaluated once


class Enclosure:
    """A formula's robustness at the steps of traces of which only a beginning is known."""

    def __init__(self, phi: Formula, earlier: Mapping[str, int]) -> None:
        self._machine = _OfKnown(positive(negation_normal_form(phi, MOST_SHARED)), earlier)

    def at(self, columns: Mapping[str, NDArray[np.float64]], step: int, first: int) -> tuple[float, float]:
        """Lower and upper end at one of the steps of which the samples are given, the first being step `first`."""
        # one unknown sample stands for all later ones, as what is held is its interval; windows of the past need more
        program = self._machine.program
        more = min(program.settling, program.horizon or 0) + 1
        samples: dict[str, NDArray[Any]] = {}
        for name in self._machine.program.variables:
            samples[name] = np.append(columns[name], np.zeros(more)).reshape(1, -1)
        for name in self._machine.program.labels:
            truth = np.append(columns[name.removeprefix(NEGATED)] != 0.0, np.zeros(more, np.bool_)).reshape(1, -1)
            samples[name] = ~truth if name.startswith(NEGATED) else truth
        n = next(iter(samples.values())).shape[1] if samples else step + more
        block = Block(samples, 1, n, "hold", wide=True, first=first)
        lower, upper = (self._machine.at(block, step, more, unknown) for unknown in (-np.inf, np.inf))
        return lower, upper


class _OfKnown(Machine):
    """Margins, those of literals at the last steps being given."""

    def __init__(self, phi: Formula, earlier: Mapping[str, int]) -> None:
        super().__init__(replace(compile_formula(phi), earlier=earlier), truth=False, margins=True)
        self._unknown, self._last = 0.0, 0

    def at(self, block: Block, step: int, last: int, unknown: float) -> float:
        self._unknown, self._last = unknown, last
        [found] = self.run(block)
        return float(found[0, step])

    def _load(self, now: Instruction, number: int, block: Block, truth: Any, margins: Any) -> None:
        super()._load(now, number, block, truth, margins)
        if isinstance(now.atom, Label) or (isinstance(now.atom, Predicate) and now.atom.names):
            margins.values[number][block.steps - self._last : block.steps] = self._unknown


def positive(phi: Formula) -> Formula:
    """φ in negation normal form, with new names for negated labels; shared operands stay shared."""
    known: dict[int, Formula] = {}

    def of(node: Formula) -> Formula:
        found = known.get(id(node))
        if found is None:
            if isinstance(node, Not) and isinstance(node.arg, Label):
                found = Label(NEGATED + node.arg.name)
            elif isinstance(node, Constant):
                found = node
            else:
                found = with_children(node, tuple(of(child) for child in children(node)))
            known[id(node)] = found
        return found

    return of(phi)
