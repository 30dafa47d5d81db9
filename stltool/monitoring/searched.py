"""Early verdicts by search, for formulas whose automaton is too large and on which three-valued truth is not exact.

Kleene's evaluation (early.py, "structure") leaves a step open as long as its parts do, although all continuations may
agree. After every sample each of these steps is looked at, letters being the truth assignments that can occur:

    constant      its verdicts if the trace went on with one letter for ever, for each letter: all steps at once, by
                  three-valued truth. Two verdicts: the step is open, and no engine could decide it
    otherwise     one verdict v. With ρ the residual of the step (automata/residuals.py), look for letters after which
                  ρ, or ¬ρ, whichever gives the other verdict, is true. A residual is true on the constant trace λ^ω if

                      ±atom: λ says so      F ρ, G ρ: ρ is      ρ U[a,b] σ: σ is, and ρ or a = 0      ρ R[a,b] σ: dually

                  so one search ends at the first residual that some λ^ω makes true. If there is none among all
                  residuals that can be reached, every continuation gives v, and the step is decided

Both ends are proofs, so a verdict is as early as can be. What residuals were found to allow is remembered, up to a
bound. A search that takes too long is cut off: its step is left to Kleene's evaluation, and `exact` is over.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata.residuals import FALSE, TRUE, Progression, Residual, Residuals
from stltool.errors import SizeError
from stltool.logic.formula import Formula, atoms
from stltool.monitoring.kleene import Kleene, skeleton
from stltool.monitoring.starts import Found

_MOST_VISITED = 500  # residuals, of all searches after a sample
_MOST_KEPT = 20_000  # residuals in a table
_MOST_COMPARED = 200_000  # pairs of them


class Searched:
    """The open steps of a running trace.

    letters  (n_letters, n_atoms) bool, the truths of the formula's atoms that can occur at a step
    exact    whether every verdict so far came as soon as all continuations agreed
    """

    def __init__(self, phi: Formula, letters: NDArray[np.bool_], horizon: int) -> None:
        self._phi, self._letters, self._horizon = phi, letters, horizon
        self._signed = np.where(letters, np.int8(1), np.int8(-1))
        self._read = np.zeros(2 * (horizon + 1), dtype=np.int64)  # the last letters, up to `_end`
        self._end = self.n_steps = 0
        self._open: list[int] = []
        self._told: dict[int, bool] = {}
        self._given_up: set[int] = set()
        self.exact = True
        self._begin()

    def _begin(self) -> None:
        names = {psi: str(i) for i, psi in enumerate(atoms(self._phi))}
        self._machine = Kleene(skeleton(self._phi, names))
        self._residuals = _Satisfiable(self._phi, self._letters)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_machine", "_residuals")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._begin()

    @property
    def nbytes(self) -> int:
        return self._read.nbytes

    def verdict(self, step: int) -> bool | None:
        """The verdict of one of the last steps, if it was decided here."""
        return self._told.get(step)

    def read(self, letters: NDArray[np.int64], n_new: int, decided: Collection[int]) -> list[Found]:
        """The steps that are decided by n_new samples, besides those that are `decided` otherwise.

        letters  of the last of these samples, at least horizon + 1 of them if there are so many new ones
        """
        for letter in letters[-min(n_new, self._horizon + 1) :].tolist():
            if self._end == len(self._read):
                self._read[: self._horizon] = self._read[self._end - self._horizon :]
                self._end = self._horizon
            self._read[self._end] = letter
            self._end += 1
        first = max(self.n_steps, self.n_steps + n_new - self._horizon)  # earlier ones were decided on the way
        self.n_steps += n_new
        oldest = self.n_steps - self._horizon
        self._open = [t for t in (*self._open, *range(first, self.n_steps)) if t >= oldest and t not in decided]
        self._told = {t: verdict for t, verdict in self._told.items() if t >= oldest - 1}
        self._given_up = {t for t in self._given_up if t >= oldest}
        found = list(self._decide()) if self._open else []
        self._told |= dict(found)
        told = dict(found)
        self._open = [t for t in self._open if t not in told]
        return found

    def _decide(self) -> Iterable[Found]:
        known = self.n_steps - self._open[0]
        history = self._read[self._end - known : self._end]
        verdicts = self._constant(history)[:, np.array(self._open) - self._open[0]]
        left = _MOST_VISITED
        for i in np.flatnonzero((verdicts == verdicts[0]).all(axis=0)).tolist():
            step, verdict = self._open[i], bool(verdicts[0, i] > 0)
            if step in self._given_up:
                continue
            try:
                other, visited = self._residuals.search(history[step - self._open[0] :].tolist(), not verdict, left)
            except (SizeError, RecursionError):
                other, visited = None, 0
            left -= visited
            if other is False:
                yield step, verdict
            elif other is None:
                self._given_up.add(step)
                self.exact = False
            if self._residuals.full:
                self._residuals = _Satisfiable(self._phi, self._letters)

    def _constant(self, history: NDArray[np.int64]) -> NDArray[np.int8]:
        """(n_letters, n_known): the verdicts at the known steps if the trace goes on with one letter."""
        known = len(history)
        columns = {}
        for i, by_letter in enumerate(self._signed.T):
            column = np.empty((len(by_letter), known + self._horizon), dtype=np.int8)
            column[:, :known], column[:, known:] = by_letter[history], by_letter[:, None]
            columns[str(i)] = column
        found: NDArray[np.int8] = self._machine.judge(columns, known + self._horizon)
        return found


class _Satisfiable:
    """Residuals of a formula, and whether some continuation makes them true; `full`: make a new one."""

    def __init__(self, phi: Formula, letters: NDArray[np.bool_]) -> None:
        self._table = Residuals(atoms(phi), _MOST_COMPARED)
        self._root = self._table.residual(phi)
        self._progress = Progression(self._table, [tuple(row) for row in letters.tolist()])
        self._all = (1 << len(letters)) - 1
        self._holding = [sum(1 << i for i in np.flatnonzero(column).tolist()) for column in letters.T]  # letters' bits
        self._constant: dict[Residual, int] = {FALSE: 0, TRUE: self._all}
        self._known: dict[Residual, bool] = {FALSE: False, TRUE: True}

    @property
    def full(self) -> bool:
        return len(self._table) > _MOST_KEPT or len(self._table.implied) > _MOST_COMPARED

    def search(self, letters: list[int], wanted: bool, most: int) -> tuple[bool | None, int]:
        """Whether some continuation of these letters has the wanted verdict, None if over `most` residuals were to be
        visited; and how many were."""
        x = self._root
        for letter in letters:
            x = self._progress(x)[letter]
        return self._satisfiable(x if wanted else self._table.negation(x), most)

    def _satisfiable(self, x: Residual, most: int) -> tuple[bool | None, int]:
        before: dict[Residual, Residual | None] = {x: None}
        waiting, visited = [x], 0
        while waiting:
            now = waiting.pop()
            if self._known.get(now, False) or self._by_constant(now):
                back: Residual | None = now
                while back is not None:
                    self._known[back] = True
                    back = before[back]
                return True, visited
            if now in self._known:
                continue
            if visited == most:
                return None, visited
            visited += 1
            for after in self._progress(now):
                if after not in before:
                    before[after] = now
                    waiting.append(after)
        self._known |= dict.fromkeys(before, False)
        return False, visited

    def _by_constant(self, x: Residual) -> int:
        """The letters, by bits, whose repetition makes x true."""
        if x not in self._constant:
            match self._table.node(x):
                case ("atom", index, positive):
                    found = self._holding[index] if positive else self._all & ~self._holding[index]
                case ("and", parts):
                    found = self._all
                    for part in parts:
                        found &= self._by_constant(part)
                case ("or", parts):
                    found = 0
                    for part in parts:
                        found |= self._by_constant(part)
                case ("F", _, _, y) | ("G", _, _, y):
                    found = self._by_constant(y)
                case ("U", a, _, y, z):
                    found = self._by_constant(z) & (self._by_constant(y) if a else self._all)
                case ("R", a, _, y, z):
                    found = self._by_constant(z) | (self._by_constant(y) if a else 0)
                case other:
                    raise AssertionError(other)
            self._constant[x] = found
        return self._constant[x]
