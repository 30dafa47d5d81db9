"""What is known about a formula when only some samples of a trace are: its atoms, at every step, in three values.

An atom is a formula without temporal operators. With the set K of signals known at a step, its value is decided if all
truth assignments of its labels and comparisons agree that can occur with the values that these signals have. So
`x > 2 | x <= 3` is true without any sample, `max(x, y) > 3` is true if x = 5 is known, and `x + y > 3` is unknown until
both are known.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stltool.logic.feasible import feasible_valuations, leaves, realised, tabulated
from stltool.logic.formula import Comparison, Formula, Negate, Number, Term, Variable, atoms, label_names, variables
from stltool.logic.occurrences import polarities
from stltool.logic.occurring import occurring, sharing
from stltool.logic.shifts import with_variables
from stltool.monitoring.blocks import Block, Machine
from stltool.monitoring.kleene import Trits
from stltool.monitoring.program import compile_formula

Known = NDArray[np.bool_]
"""Which samples are known: (steps, signals), signals in alphabetical order."""

_MOST_ROOMS = 1000  # combinations of known values whose truth assignments are found out,
_MOST_HARD = 30  # and of these, such that comparisons with numbers in the place of known signals still share signals
MOST_ROWS = 1024  # truth assignments of one atom, or of atoms that share signals
_MOST_SIGNALS = 6  # of one atom; more are known only all together
_NOT_YET = 2  # an entry of a table that was not needed so far


def names_of(phi: Formula) -> tuple[str, ...]:
    """The signals and labels that a formula reads, in alphabetical order."""
    return tuple(sorted({**variables(phi), **label_names(phi)}))


def truth_along(phi: Formula, block: Block) -> Trits:
    """The truth of a formula without temporal operators at every step of a block of one trace; 0 without a value."""
    columns = {name: block.columns[name] for name in names_of(phi)}
    if not columns:  # a constant comparison
        columns = dict(block.columns)
    found = Machine(compile_formula(phi), margins=False).run(Block(columns, 1, block.steps))[0][0]
    return np.where(found, np.int8(1), np.int8(-1)) if found.dtype == np.bool_ else found.copy()


class Agreeing:
    """Which of the truth assignments of some labels and comparisons can occur where some of their signals are known.

    The known signals have their values at a step; all others are free. Sets of signals are given by bits, in the order
    of `names`. `doubt` says why an assignment may have been kept that does not occur; None if there was none so far.
    """

    def __init__(self, read: tuple[Formula, ...], rows: NDArray[np.bool_], names: Sequence[str], block: Block) -> None:
        self.read, self.rows = read, rows
        self.doubt: str | None = None
        self.along = np.zeros((block.steps, len(read)), dtype=np.int8)
        for i, leaf in enumerate(read):
            self.along[:, i] = truth_along(leaf, block)
        self._names = tuple(names)
        self._needs = [sum(1 << self._names.index(name) for name in names_of(leaf)) for leaf in read]
        self._independent = realised(read)
        self._block = block
        self._rooms = self._hard = 0
        self._found: dict[tuple[int, bytes, tuple[float, ...]], NDArray[np.bool_]] = {}

    def __call__(self, step: int, mask: int) -> NDArray[np.bool_]:
        """(n_rows,) bool"""
        partly = [] if self._independent else [i for i, needs in enumerate(self._needs) if needs & ~mask]
        values = self._values(step, partly, mask)
        key = mask, self.along[step].tobytes(), tuple(values.values())
        if key not in self._found:
            agree = np.ones(len(self.rows), dtype=np.bool_)
            for column, (needs, value) in enumerate(zip(self._needs, self.along[step].tolist(), strict=True)):
                if needs & mask == needs and value:
                    agree &= self.rows[:, column] == (value > 0)
            if partly:
                agree &= self._possible(partly, values)
            self._found[key] = agree
        return self._found[key]

    def _values(self, step: int, partly: Sequence[int], mask: int) -> dict[str, float]:
        """The known values of the signals of these comparisons."""
        read = {name for i in partly for name in variables(self.read[i])}
        names = [name for i, name in enumerate(self._names) if mask >> i & 1 and name in read]
        return {name: float(self._block.columns[name][0, step]) for name in names}

    def _possible(self, partly: Sequence[int], values: Mapping[str, float]) -> NDArray[np.bool_]:
        """The rows that are possible for comparisons of which something is unknown."""
        self._rooms += 1
        if self._rooms > _MOST_ROOMS:
            self.doubt = "the samples are too many to find out which comparisons can hold together at each"
            return np.ones(len(self.rows), dtype=np.bool_)
        rest = tuple(_with_values(self.read[i], values) for i in partly)
        rows, exact = feasible_valuations(rest, MOST_ROWS)
        if exact and not realised(rest):
            self._hard += 1
            rows, exact = occurring(rest, rows) if self._hard <= _MOST_HARD else (rows, False)
        if not exact:
            self.doubt = "which comparisons can hold together is known in part only"
        possible = set(map(bytes, rows))
        return np.array([bytes(row) in possible for row in np.ascontiguousarray(self.rows[:, partly])], dtype=np.bool_)


def _with_values(leaf: Formula, values: Mapping[str, float]) -> Formula:
    """The comparison with numbers for some of its signals."""
    if not isinstance(leaf, Comparison):
        return leaf

    def number(variable: Variable) -> Term:
        if variable.name not in values:
            return variable
        value = Number(abs(values[variable.name]))
        return Negate(value) if values[variable.name] < 0 else value

    return with_variables(leaf, number)


class Atom:
    """The values of one atom along a trace, given what is known."""

    def __init__(self, psi: Formula, names: tuple[str, ...], block: Block) -> None:
        mine = names_of(psi)
        self.formula = psi
        self.columns = np.array([names.index(name) for name in mine], dtype=np.int64)
        self.actual = truth_along(psi, block)
        read = leaves(psi)
        rows, complete = feasible_valuations(read, MOST_ROWS) if read else (np.ones((1, 0), np.bool_), True)
        self._truth = tabulated((psi,), read, rows)[:, 0]
        self._agreeing = Agreeing(read, rows, mine, block)
        self.free = self._agreed(self._agreeing(0, 0)) if complete else 0
        self._table: NDArray[np.int8] | None = None
        if complete and 1 < len(mine) <= _MOST_SIGNALS:
            what = self._agreeing.along  # decides what is known, if comparisons are independent
            if not realised(read):
                what = np.concatenate([what, np.stack([block.columns[name][0] for name in mine], axis=1)], axis=1)
            _, self._first, which = np.unique(what, axis=0, return_index=True, return_inverse=True)
            self._row = which.reshape(-1)
            self._table = np.full((1 << len(mine), len(self._first)), _NOT_YET, dtype=np.int8)

    @property
    def partial(self) -> bool:
        """Whether it can be decided by some of its signals."""
        return self._table is not None

    def values(self, known: Known, first: int = 0) -> Trits:
        """The values at the steps first, first + 1, …, of which `known` (steps, signals) samples are known."""
        actual = self.actual[first : first + len(known)]
        mine = known[:, self.columns]
        if self._table is None:
            return np.where(mine.all(axis=1), actual, np.int8(self.free))
        masks = mine @ (1 << np.arange(mine.shape[1]))
        row = self._row[first : first + len(known)]
        found = self._table[masks, row]
        if (found == _NOT_YET).any():
            for mask, which in np.unique(np.stack([masks, row], axis=1)[found == _NOT_YET], axis=0).tolist():
                self._table[mask, which] = self._partial(mask, which)
            found = self._table[masks, row]
        return np.where(masks == (1 << mine.shape[1]) - 1, actual, found)

    def _partial(self, mask: int, which: int) -> int:
        return self._agreed(self._agreeing(int(self._first[which]), mask))

    def _agreed(self, rows: NDArray[np.bool_]) -> int:
        truth = self._truth[rows]
        return 1 if truth.all() else 0 if truth.any() else -1


@dataclass(frozen=True, eq=False)
class Knowledge:
    """The atoms of a formula along a trace; `facts` are the columns of labels that are the same on every trace."""

    phi: Formula
    names: tuple[str, ...]
    block: Block
    atoms: tuple[Atom, ...]
    facts: tuple[int, ...] = ()

    def values(self, known: Known, first: int = 0) -> NDArray[np.int8]:
        """(n_atoms, steps) int8: the atoms at the steps first, first + 1, …"""
        found = [atom.values(known, first) for atom in self.atoms]
        return np.stack(found) if found else np.empty((0, len(known)), dtype=np.int8)


def knowledge_of(phi: Formula, block: Block, facts: Container[str] = ()) -> Knowledge:
    """The atoms of φ along a block of one trace."""
    names = names_of(phi)
    columns = tuple(i for i, name in enumerate(names) if name in facts)
    return Knowledge(phi, names, block, tuple(Atom(psi, names, block) for psi in atoms(phi)), columns)


def one_sided(phi: Formula) -> bool:
    """Whether Kleene's evaluation decides φ as soon as all completions agree, whichever samples are known.

    Each atom must occur in one polarity. If atoms share signals, then for whatever is known of these, one assignment
    that can occur must be the worst for all of the atoms, and one the best.
    """
    signs = polarities(phi)
    if 0 in signs.values():
        return False
    psis = tuple(signs)
    return all(_has_extremes({psis[i]: signs[psis[i]] for i in group}) for group in sharing(psis))


def _has_extremes(signs: dict[Formula, int]) -> bool:
    """Whether, for whatever is known of their signals, one assignment is the worst for all atoms, and one the best."""
    if len(signs) == 1:
        return True
    read = tuple(dict.fromkeys(leaf for psi in signs for leaf in leaves(psi)))
    names = sorted({name for leaf in read for name in names_of(leaf)})
    rows, complete = feasible_valuations(read, MOST_ROWS)
    if not complete or len(names) > _MOST_SIGNALS:
        return False
    signed = tabulated(tuple(signs), read, rows) == (np.array(list(signs.values())) > 0)
    for mask in range(1 << len(names)):
        known = {name for i, name in enumerate(names) if mask >> i & 1}
        columns = [i for i, leaf in enumerate(read) if known.issuperset(names_of(leaf))]
        classes = np.unique(rows[:, columns], axis=0, return_inverse=True)[1].reshape(-1)
        for one in range(int(classes.max()) + 1):
            values = signed[classes == one]
            for extreme in (values.all(axis=0), values.any(axis=0)):
                if not (values == extreme).all(axis=1).any():
                    return False
    return True
