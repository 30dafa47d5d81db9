"""What remains of a formula after reading letters: hash-consed residuals in negation normal form.

    ρ ::= false | true | ±atom | ∧{ρ} | ∨{ρ} | F[a,b] ρ | G[a,b] ρ | ρ U[a,b] ρ | ρ R[a,b] ρ

with R the dual of U. Progression: `progress(ρ, letter)` is ρ after one step, its windows counted from the next one:

    F[0,b] ρ → progress(ρ) ∨ F[0,b−1] ρ        F[a,b] ρ → F[a−1,b−1] ρ        G dually
    ρ U[0,b] σ → progress(σ) ∨ (progress(ρ) ∧ ρ U[0,b−1] σ)     ρ U[a,b] σ → progress(ρ) ∧ ρ U[a−1,b−1] σ

Residuals are kept small by equivalences: F splits over ∨ and G over ∧, nested windows of one kind are summed, adjacent
windows over one operand are joined, shifts move outwards, and operands implied by another are dropped. `implies` is
sound but not complete: states that it fails to merge are merged by minimisation. Residuals are integers: equal numbers
are equal residuals.

φ since[a,b] ψ is an atom, numbered behind those of the formula, whose value at a step is a residual: what is still
needed for it to hold there (true or false, unless φ or ψ looks ahead). registers.py computes it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypeAlias, TypeVar, assert_never

from stltool.errors import SizeError
from stltool.logic.formula import (
    Always,
    And,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Not,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    is_temporal,
)

Residual: TypeAlias = int
Letter: TypeAlias = tuple[bool, ...]
ByLetter: TypeAlias = tuple[Residual, ...]
"""One residual per letter."""
_Key: TypeAlias = tuple[object, ...]
_Made = TypeVar("_Made")

FALSE: Residual = 0
TRUE: Residual = 1


class PastAtom(NamedTuple):
    """left since[a,b] right; no b: back to step 0."""

    a: int
    b: int | None
    left: Residual
    right: Residual


class _Implied(dict[tuple[Residual, Residual], bool]):
    """Whether x ⇒ y, computed on first use; a dictionary, since loops look it up millions of times.

    SizeError for more than `most` pairs.
    """

    def __init__(self, find: Callable[[Residual, Residual], bool], most: float) -> None:
        self._find, self._most = find, most

    def __missing__(self, pair: tuple[Residual, Residual]) -> bool:
        if len(self) > self._most:
            raise SizeError(f"more than {self._most} pairs of residuals are compared")
        found = self[pair] = self._find(*pair)
        return found


class Residuals:
    """A table of residuals over given atoms, such as those of one formula. SizeError once `most` pairs are compared."""

    def __init__(self, atoms: Sequence[Formula], most: float = math.inf) -> None:
        self.atoms = tuple(atoms)
        self.past: list[PastAtom] = []  # those inside another come before it
        self._past_index: dict[PastAtom, int] = {}
        self._atom_index = {psi: i for i, psi in enumerate(self.atoms)}
        self._nodes: list[tuple] = [("false",), ("true",)]  # type: ignore[type-arg]
        self._ids: dict[_Key, Residual] = {("false",): FALSE, ("true",): TRUE}
        self.implied = _Implied(self._implies, most)
        self._horizons: dict[Residual, int] = {}
        self._atoms_in: dict[Residual, frozenset[int]] = {}
        self._negations: dict[Residual, Residual] = {}

    # ------------------------------------------------------------------------------------------ from formulas

    def residual(self, phi: Formula, negated: bool = False) -> Residual:
        """The residual for φ (or its negation) at the next step."""
        if not is_temporal(phi):
            return self._atom(phi, negated)
        match phi:
            case Not(arg):
                return self.residual(arg, not negated)
            case And(args):
                return (self.disj if negated else self.conj)(self.residual(arg, negated) for arg in args)
            case Or(args):
                return (self.conj if negated else self.disj)(self.residual(arg, negated) for arg in args)
            case Implies(left, right):
                parts = [self.residual(left, not negated), self.residual(right, negated)]
                return self.conj(parts) if negated else self.disj(parts)
            case Iff(left, right):
                same = [self.residual(left), self.residual(right, negated)]
                other = [self.residual(left, True), self.residual(right, not negated)]
                return self.disj([self.conj(same), self.conj(other)])
            case Eventually(interval, arg):
                make = self.always if negated else self.eventually
                return make(interval.a, interval.last, self.residual(arg, negated))
            case Always(interval, arg):
                make = self.eventually if negated else self.always
                return make(interval.a, interval.last, self.residual(arg, negated))
            case Until(interval, left, right):
                join = self.release if negated else self.until
                return join(interval.a, interval.last, self.residual(left, negated), self.residual(right, negated))
            case Release(interval, left, right):
                join = self.until if negated else self.release
                return join(interval.a, interval.last, self.residual(left, negated), self.residual(right, negated))
            case Once(interval, arg):
                return self._signed(self.since(interval.a, interval.b, TRUE, self.residual(arg)), negated)
            case Historically(interval, arg):
                return self._signed(self.since(interval.a, interval.b, TRUE, self.residual(arg, True)), not negated)
            case Since(interval, left, right):
                found = self.since(interval.a, interval.b, self.residual(left), self.residual(right))
                return self._signed(found, negated)
            case Trigger(interval, left, right):
                found = self.since(interval.a, interval.b, self.residual(left, True), self.residual(right, True))
                return self._signed(found, not negated)
            case Rise(arg):
                parts = [
                    self.residual(arg, negated),
                    self._signed(self.since(1, 1, TRUE, self.residual(arg)), not negated),
                ]
                return self.disj(parts) if negated else self.conj(parts)
            case Constant() | Label() | Comparison():
                raise AssertionError("a formula without temporal operators is an atom")
            case _:
                assert_never(phi)

    def _signed(self, x: Residual, negated: bool) -> Residual:
        return self.negation(x) if negated else x

    def since(self, a: int, b: int | None, left: Residual, right: Residual) -> Residual:
        """The atom left since[a,b] right."""
        if right == FALSE or b == 0 or (right == TRUE and a == 0):
            return right
        if left == FALSE:
            return right if a == 0 else FALSE
        node = self._nodes[right]
        if left == TRUE and node[0] == "atom" and node[1] >= len(self.atoms) and node[2]:
            inner = self.past[node[1] - len(self.atoms)]
            if inner.left == TRUE:  # windows of once add up, cuts included
                both = None if b is None or inner.b is None else b + inner.b
                return self.since(a + inner.a, both, TRUE, inner.right)
        key = PastAtom(a, b, left, right)
        if key not in self._past_index:
            self._past_index[key] = len(self.past)
            self.past.append(key)
        return self._node("atom", len(self.atoms) + self._past_index[key], True)

    def _atom(self, psi: Formula, negated: bool) -> Residual:
        while isinstance(psi, Not):
            psi, negated = psi.arg, not negated
        if isinstance(psi, Constant):
            return TRUE if psi.value != negated else FALSE
        return self._node("atom", self._atom_index[psi], not negated)

    def _node(self, *key: object) -> Residual:
        found = self._ids.get(key)
        if found is None:
            found = self._ids[key] = len(self._nodes)
            self._nodes.append(key)
        return found

    def __len__(self) -> int:
        return len(self._nodes)

    def node(self, x: Residual) -> tuple:  # type: ignore[type-arg]
        """(kind, operands…) of a residual."""
        return self._nodes[x]

    def negation(self, x: Residual) -> Residual:
        """¬x, in negation normal form."""
        if x not in self._negations:
            match self._nodes[x]:
                case ("false",):
                    result = TRUE
                case ("true",):
                    result = FALSE
                case ("atom", index, positive):
                    result = self._node("atom", index, not positive)
                case ("and", parts):
                    result = self.disj(self.negation(part) for part in parts)
                case ("or", parts):
                    result = self.conj(self.negation(part) for part in parts)
                case ("F", a, b, y):
                    result = self.always(a, b, self.negation(y))
                case ("G", a, b, y):
                    result = self.eventually(a, b, self.negation(y))
                case ("U", a, b, y, z):
                    result = self.release(a, b, self.negation(y), self.negation(z))
                case ("R", a, b, y, z):
                    result = self.until(a, b, self.negation(y), self.negation(z))
                case other:
                    raise AssertionError(other)
            self._negations[x] = result
        return self._negations[x]

    # ------------------------------------------------------------------------------------------ constructors

    def conj(self, parts: Iterable[Residual]) -> Residual:
        return self._combine("and", parts, TRUE, FALSE, "G")

    def disj(self, parts: Iterable[Residual]) -> Residual:
        return self._combine("or", parts, FALSE, TRUE, "F")

    def _combine(
        self, kind: str, parts: Iterable[Residual], neutral: Residual, absorbing: Residual, op: str
    ) -> Residual:
        nodes = self._nodes
        flat: set[Residual] = set()
        for part in parts:
            if part == absorbing:
                return absorbing
            node = nodes[part]
            if node[0] == kind:
                flat.update(node[1])
            else:
                flat.add(part)
        flat.discard(neutral)
        if len(flat) > 1:
            flat = self._joined(flat, op)
            flat = self._without_implied(flat, weaker=kind == "and")
        if len(flat) > 1:
            for x in flat:
                if nodes[x][0] == "atom" and self.negation(x) in flat:
                    return absorbing
        if not flat:
            return neutral
        return flat.pop() if len(flat) == 1 else self._node(kind, tuple(sorted(flat)))

    def _joined(self, parts: set[Residual], op: str) -> set[Residual]:
        """Join windows over one operand that overlap or touch: G under ∧, F under ∨."""
        nodes = self._nodes
        windows = [x for x in parts if nodes[x][0] == op]
        if len(windows) < 2 or len({nodes[x][3] for x in windows}) == len(windows):
            return parts
        joined = parts.difference(windows)
        spans: dict[Residual, list[tuple[int, int]]] = {}
        for _, a, b, operand in map(nodes.__getitem__, windows):
            spans.setdefault(operand, []).append((a, b))
        for operand, of_one in spans.items():
            of_one.sort()
            a, b = of_one[0]
            for c, d in of_one[1:]:
                if c <= b + 1:
                    b = max(b, d)
                else:
                    joined.add(self._node(op, a, b, operand))
                    a, b = c, d
            joined.add(self._node(op, a, b, operand))
        return joined

    def _without_implied(self, parts: set[Residual], weaker: bool) -> set[Residual]:
        implied = self.implied
        kept: list[Residual] = []
        for x in sorted(parts):
            for y in kept:
                if implied[y, x] if weaker else implied[x, y]:
                    break
            else:
                kept = [y for y in kept if not (implied[x, y] if weaker else implied[y, x])]
                kept.append(x)
        return set(kept)

    def eventually(self, a: int, b: int, x: Residual) -> Residual:
        return self._window("F", "or", self.disj, a, b, x)

    def always(self, a: int, b: int, x: Residual) -> Residual:
        return self._window("G", "and", self.conj, a, b, x)

    def _window(
        self, op: str, split: str, join: Callable[[Iterable[Residual]], Residual], a: int, b: int, x: Residual
    ) -> Residual:
        node = self._nodes[x]
        if x in (FALSE, TRUE):
            return x
        if node[0] == op:  # nested windows of one kind are summed
            return self._window(op, split, join, a + node[1], b + node[2], node[3])
        if node[0] == split:
            return join(self._window(op, split, join, a, b, part) for part in node[1])
        shift = self._offset(x)
        if shift:
            return self._window(op, split, join, a + shift, b + shift, self._earlier(x, shift))
        if a == b == 0:
            return x
        return self._node(op, a, b, x)

    def _offset(self, x: Residual) -> int:
        """The number of steps from now that x does not depend on."""
        match self._nodes[x]:
            case ("F", a, _, _) | ("G", a, _, _):
                return int(a)
            case ("and", parts) | ("or", parts):
                return min(self._offset(part) for part in parts)
            case _:
                return 0

    def _earlier(self, x: Residual, shift: int) -> Residual:
        match self._nodes[x]:
            case ("F", a, b, y):
                return self.eventually(a - shift, b - shift, y)
            case ("G", a, b, y):
                return self.always(a - shift, b - shift, y)
            case ("and", parts):
                return self.conj(self._earlier(part, shift) for part in parts)
            case ("or", parts):
                return self.disj(self._earlier(part, shift) for part in parts)
            case other:
                raise AssertionError(other)

    def until(self, a: int, b: int, x: Residual, y: Residual) -> Residual:
        if y == FALSE or (x == FALSE and a > 0):
            return FALSE
        if x == TRUE or b == 0:
            return self.eventually(a, b, y)
        if x == FALSE:
            return y
        if y == TRUE:
            return TRUE if a == 0 else self.always(0, a - 1, x)
        return self._node("U", a, b, x, y)

    def release(self, a: int, b: int, x: Residual, y: Residual) -> Residual:
        if y == TRUE or (x == TRUE and a > 0):
            return TRUE
        if x == FALSE or b == 0:
            return self.always(a, b, y)
        if x == TRUE:
            return y
        if y == FALSE:
            return FALSE if a == 0 else self.eventually(0, a - 1, x)
        return self._node("R", a, b, x, y)

    # ------------------------------------------------------------------------------------------ meaning

    def horizon(self, x: Residual) -> int:
        """The number of steps after the next one on which x can depend."""
        if x not in self._horizons:
            match self._nodes[x]:
                case ("and", parts) | ("or", parts):
                    value = max(self.horizon(part) for part in parts)
                case ("F", _, b, y) | ("G", _, b, y):
                    value = b + self.horizon(y)
                case ("U", _, b, y, z) | ("R", _, b, y, z):
                    value = b + max(self.horizon(y), self.horizon(z))
                case ("atom", index, _) if index >= len(self.atoms):
                    now = self.past[index - len(self.atoms)]
                    value = max(self.horizon(now.left) if now.b != 0 else 0, self.horizon(now.right) - now.a, 0)
                case _:
                    value = 0
            self._horizons[x] = value
        return self._horizons[x]

    def atoms_in(self, x: Residual) -> frozenset[int]:
        """The indices of the atoms that x reads, also through atoms of the past, which count, too."""
        if x not in self._atoms_in:
            node, own = self._nodes[x], frozenset[int]()
            below = node[1] if node[0] in ("and", "or") else node[3:]
            if node[0] == "atom":
                own, below = frozenset((node[1],)), ()
                if node[1] >= len(self.atoms):
                    below = self.past[node[1] - len(self.atoms)][2:]
            self._atoms_in[x] = own.union(*(self.atoms_in(part) for part in below))
        return self._atoms_in[x]

    def past_in(self, x: Residual) -> list[int]:
        """The numbers of the atoms of the past that x depends on, those inside another before it."""
        n = len(self.atoms)
        return sorted(index - n for index in self.atoms_in(x) if index >= n)

    def atom(self, index: int) -> Formula:
        """An atom as a formula."""
        if index < len(self.atoms):
            return self.atoms[index]
        a, b, left, right = self.past[index - len(self.atoms)]
        if left == TRUE:
            return Once(Interval(a, b), self.formula(right))
        return Since(Interval(a, b), self.formula(left), self.formula(right))

    def implies(self, x: Residual, y: Residual) -> bool:
        """Whether x ⇒ y follows from the structure. Sound; False may mean "not found"."""
        return self.implied[x, y]

    def _implies(self, x: Residual, y: Residual) -> bool:
        if x in (y, FALSE) or y == TRUE:
            return True
        if x == TRUE or y == FALSE:
            return False
        left, right = self._nodes[x], self._nodes[y]
        if left[0] == "or":
            return all(self.implies(part, y) for part in left[1])
        if right[0] == "and":
            return all(self.implies(x, part) for part in right[1])
        if left[0] == "and" and any(self.implies(part, y) for part in left[1]):
            return True
        if right[0] == "or" and any(self.implies(x, part) for part in right[1]):
            return True
        match left, right:
            case (("F", a, b, p), ("F", c, d, q)) if c <= a and b <= d and self.implies(p, q):
                return True
            case (("G", a, b, p), ("G", c, d, q)) if a <= c and d <= b and self.implies(p, q):
                return True
            case (("G", a, b, p), ("F", c, d, q)) if max(a, c) <= min(b, d) and self.implies(p, q):
                return True
            case (("U", a, b, p, q), ("U", c, d, r, s)) if (
                c <= a and b <= d and self.implies(p, r) and self.implies(q, s)
            ):
                return True
            case (("R", a, b, p, q), ("R", c, d, r, s)) if (
                a <= c and d <= b and self.implies(p, r) and self.implies(q, s)
            ):
                return True
            case (("U", a, b, _, q), ("F", c, d, s)) if c <= a and b <= d and self.implies(q, s):
                return True
            case (("G", a, b, p), ("R", c, d, _, s)) if a <= c and d <= b and self.implies(p, s):
                return True
        if left[0] == "G" and left[1] == 0 and self.implies(left[3], y):
            return True
        if right[0] == "F" and right[1] == 0 and self.implies(x, right[3]):
            return True
        if right[0] == "U" and right[1] == 0 and self.implies(x, right[4]):
            return True
        return bool(left[0] == "R" and left[1] == 0 and self.implies(left[4], y))

    # ------------------------------------------------------------------------------------------ text

    def formula(self, x: Residual) -> Formula:
        """The residual as a formula, windows counted from the next step."""
        match self._nodes[x]:
            case ("false",) | ("true",):
                return Constant(x == TRUE)
            case ("atom", index, positive):
                return self.atom(index) if positive else Not(self.atom(index))
            case ("and", parts):
                return And(tuple(self.formula(part) for part in parts))
            case ("or", parts):
                return Or(tuple(self.formula(part) for part in parts))
            case ("F", a, b, y):
                return Eventually(Interval(a, b), self.formula(y))
            case ("G", a, b, y):
                return Always(Interval(a, b), self.formula(y))
            case ("U", a, b, y, z):
                return Until(Interval(a, b), self.formula(y), self.formula(z))
            case ("R", a, b, y, z):
                return Release(Interval(a, b), self.formula(y), self.formula(z))
            case other:
                raise AssertionError(other)


class Progression:
    """The progression of residuals through a letter, for all letters at once."""

    def __init__(self, table: Residuals, letters: Sequence[Letter]) -> None:
        """`letters`: truth values of the table's atoms; those of atoms of the past come with `assign`."""
        self._table = table
        self._n_letters = len(letters)
        self._columns: dict[int, ByLetter] = {
            i: tuple([TRUE if letter[i] else FALSE for letter in letters]) for i in range(len(table.atoms))
        }
        self._known: dict[Residual, ByLetter] = {}

    def assign(self, index: int, values: ByLetter) -> None:
        """What an atom of the past still needs to hold at this step, before anything that reads it progresses."""
        self._columns[index] = values

    def __call__(self, x: Residual) -> ByLetter:
        """progress(x, letter) for every letter."""
        known = self._known.get(x)
        if known is None:
            known = self._known[x] = self._progress(x)
        return known

    def _progress(self, x: Residual) -> ByLetter:
        table = self._table
        match table.node(x):
            case ("false",) | ("true",):
                return self._always(x)
            case ("atom", index, positive):
                column = self._columns[index]
                return column if positive else tuple([table.negation(value) for value in column])
            case ("and", parts):
                return by_letter(table.conj, *map(self, parts))
            case ("or", parts):
                return by_letter(table.disj, *map(self, parts))
            case ("F", 0, b, y):
                return by_letter(table.disj, self(y), self._always(table.eventually(0, b - 1, y) if b else FALSE))
            case ("G", 0, b, y):
                return by_letter(table.conj, self(y), self._always(table.always(0, b - 1, y) if b else TRUE))
            case ("F", a, b, y):
                return self._always(table.eventually(a - 1, b - 1, y))
            case ("G", a, b, y):
                return self._always(table.always(a - 1, b - 1, y))
            case ("U", a, b, y, z):
                later = table.until(max(a - 1, 0), b - 1, y, z) if b else FALSE
                stay = by_letter(table.conj, self(y), self._always(later))
                return stay if a else by_letter(table.disj, self(z), stay)
            case ("R", a, b, y, z):
                later = table.release(max(a - 1, 0), b - 1, y, z) if b else TRUE
                stay = by_letter(table.disj, self(y), self._always(later))
                return stay if a else by_letter(table.conj, self(z), stay)
            case other:
                raise AssertionError(other)

    def _always(self, x: Residual) -> ByLetter:
        return (x,) * self._n_letters


def by_letter(make: Callable[[ByLetter], _Made], *columns: ByLetter) -> tuple[_Made, ...]:
    """`make` applied to the entries of each letter, once for letters that agree."""
    rows = list(zip(*columns, strict=True))
    made = {row: make(row) for row in dict.fromkeys(rows)}
    return tuple([made[row] for row in rows])
