"""What a machine remembers of the past: one register for each atom φ since[a,b] ψ.

    R = [(age, ρ)], youngest first: ρ is what "ψ at now − age, and φ ever since" still needs

It begins empty, for windows are cut at step 0, and it is counted by the clock of the trace, whatever starts and windows
of the future are pending. Reading a letter, with the values of atoms of the past inside this one known:

    E = [(0, progress(ψ))] + [(age + 1, progress(ρ) ∧ progress(φ)) for (age, ρ) in R]
    value of the atom = ⋁ {ρ : (age, ρ) in E, a ≤ age ≤ b}, a residual; true or false if φ and ψ do not look ahead
    R = E without what cannot matter any more:
        ρ = false; age ≥ b, whose next age is behind the window
        (age, ρ) if a younger (age′, ρ′) has ρ ⇒ ρ′ and age′ ≥ a − 1: in the window from the next step on, and longer
        (age, ρ) between a younger (age′, ρ′) and an older (age″, ρ″) with ρ ⇒ ρ′, ρ ⇒ ρ″ and age″ − age′ ≤ b − a + 1:
            when the older one leaves the window, the younger one has entered it
    Without b, what is in the window stays there: these entries are one, of age a.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from stltool.automata.residuals import (
    FALSE,
    TRUE,
    ByLetter,
    Letter,
    PastAtom,
    Progression,
    Residual,
    Residuals,
    by_letter,
)

Register: TypeAlias = tuple[tuple[int, Residual], ...]
Registers: TypeAlias = tuple[Register, ...]


@dataclass(frozen=True, slots=True)
class Reading:
    """What reading any letter does: the progression of residuals, and the registers after each letter."""

    after: Progression
    registers: tuple[Registers, ...]


class Recorder:
    """Reads letters into the registers of some atoms of the past."""

    def __init__(self, table: Residuals, own: Sequence[int], letters: Sequence[Letter]) -> None:
        """`own`: their numbers, those inside another first."""
        self.own = tuple(own)
        self._table, self._letters = table, letters
        self._known: dict[Registers, Reading] = {}

    @property
    def n_letters(self) -> int:
        return len(self._letters)

    @property
    def empty(self) -> Registers:
        return ((),) * len(self.own)

    def read(self, registers: Registers) -> Reading:
        known = self._known.get(registers)
        if known is None:
            known = self._known[registers] = self._read(registers)
        return known

    def _read(self, registers: Registers) -> Reading:
        table, n_letters = self._table, len(self._letters)
        after = Progression(table, self._letters)
        columns: list[list[Register]] = []
        for number, register in zip(self.own, registers, strict=True):
            atom = table.past[number]
            entries: list[tuple[int, ByLetter]] = [(0, after(atom.right))]
            stays = after(atom.left)
            entries += [(age + 1, by_letter(table.conj, after(x), stays)) for age, x in register]
            inside = [xs for age, xs in entries if age >= atom.a]
            value = by_letter(table.disj, *inside) if inside else (FALSE,) * n_letters
            after.assign(len(table.atoms) + number, value)
            ages = [age for age, _ in entries]
            rows = zip(*(xs for _, xs in entries), strict=True)
            columns.append([self._kept(atom, list(zip(ages, row, strict=True))) for row in rows])
        return Reading(after, tuple(zip(*columns, strict=True)))

    def _kept(self, atom: PastAtom, entries: list[tuple[int, Residual]]) -> Register:
        a, b = atom.a, atom.b
        implied = self._table.implied
        if b is None:
            inside = self._table.disj(x for age, x in entries if age >= a)
            entries = [(age, x) for age, x in entries if age < a] + [(a, inside)]
        kept: list[tuple[int, Residual]] = []
        for age, x in entries:
            if x == FALSE or (b is not None and age >= b):
                continue
            if any(before >= a - 1 and implied[x, y] for before, y in kept):
                continue
            while len(kept) > 1 and b is not None:
                (young, y), (_, middle) = kept[-2:]
                if age - young > b - a + 1 or not implied[middle, y] or not implied[middle, x]:
                    break
                kept.pop()
            kept.append((age, x))
        return tuple(kept)

    def too_many(self, most: int, horizon: float) -> tuple[int, int] | None:
        """The number of an atom whose register alone has more than `most` states, and how many; None if there is none.

        Windows that reach back further than `horizon` steps do not count: they are cut.

        Without another ψ, the window's truth at the next b steps is a sequence in which "true" lasts b − a + 1 steps,
        except at the beginning: each is a state, if ψ is a predicate and every step counts.
        """
        table = self._table
        for number in self.own:
            a, b, left, right = table.past[number]
            node = table.node(right)
            if left != TRUE or b is None or b > horizon or node[0] != "atom" or node[1] >= len(table.atoms):
                continue
            if len({letter[node[1]] for letter in self._letters}) == 2:
                count = _sequences(b, b - a + 1)
                if count > most:
                    return number, count
        return None


def _sequences(length: int, shortest: int) -> int:
    """The sequences of truth values in which "true" lasts at least `shortest` steps, except at the beginning."""
    ends_false = [1]  # by length; the empty sequence counts
    total = 0  # of those in `ends_false` that are long enough for another stretch of "true"
    for n in range(1, length + 1):
        if n - 1 - shortest >= 1:
            total += ends_false[n - 1 - shortest]
        ends_false.append(ends_false[n - 1] + total + (1 if n > 1 else 0))
    last = sum(ends_false[n] for n in range(1, length - shortest + 1))
    return ends_false[length] + last + 1
