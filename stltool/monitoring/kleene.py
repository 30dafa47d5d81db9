"""Three-valued truth [Kleene38]: the verdicts of a formula some of whose atoms are not known.

−1, 0, 1 stand for false, unknown, true; ¬, ∧, ∨ are negation, min and max, so the passes of blocks.py apply as they
are. A decided value is right whatever the unknown atoms are. The converse holds if every atom occurs in one polarity
and all of them can be at their worst, and at their best, at once (stltool/diagnosis/knowledge.py checks that).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.logic.formula import Constant, Formula, Label, Not, children, is_temporal, with_children
from stltool.monitoring.blocks import Block, BlockEnd, Machine
from stltool.monitoring.program import Instruction, compile_formula

Trits = NDArray[np.int8]
"""−1, 0, 1 for false, unknown, true."""


class Kleene(Machine):
    """A formula over labels, ready to judge arrays of −1, 0, 1."""

    def __init__(self, phi: Formula) -> None:
        super().__init__(compile_formula(phi), truth=True, margins=False)
        self._kleene = True

    def judge(self, labels: Mapping[str, Trits], steps: int, end: BlockEnd = "open") -> Trits:
        """The values at the decided steps, (rows, decided); `labels` maps names to arrays (rows, steps).

        The result is valid until the next call.
        """
        rows = next((len(values) for values in labels.values()), 1)
        [found] = self.run(Block(labels, rows, steps, end))
        return found

    def _load(self, now: Instruction, number: int, block: Block, truth: Any, margins: Any) -> None:
        if isinstance(now.atom, Label) and truth is not None:
            truth.fresh(number)[...] = block.columns[now.atom.name]
        else:
            super()._load(now, number, block, truth, margins)


def skeleton(phi: Formula, atoms: Mapping[Formula, str]) -> Formula:
    """φ with a label in the place of every atom; `atoms` names those of `logic.formula.atoms`."""
    if is_temporal(phi) or isinstance(phi, Not):
        return with_children(phi, tuple(skeleton(child, atoms) for child in children(phi)))
    return phi if isinstance(phi, Constant) else Label(atoms[phi])
