"""The τ-MDP encoding [Aksaray16]: store the last τ letters and evaluate the inner formula on them.

For Φ = F[a,b] φ or G[a,b] φ with D = horizon(φ), a state is the last D + 1 letters, or all letters so far:
Σ_{i ≤ D+1} |Λ|^i states. After step t the window starts at k = t − D; an outer F decides true if φ holds there, an
outer G decides false if it fails. Any other formula counts as G[0,0]. It is exact, and the baseline that blows up: its
size is predicted before it is built. Formulas of the past are counted, with the steps that they look back, not built.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import FALSE, TRUE, UNDECIDED, Part, Remembered, TaskAutomaton, Text
from stltool.errors import FragmentError
from stltool.logic.formula import (
    PAST,
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
    horizon,
    lookback,
    walk,
)
from stltool.sizes import require_memory, require_numbered

_Truth: TypeAlias = NDArray[np.bool_]
_LONGEST_NAME = 4  # letters shown of a history


def history_length(phi: Formula) -> int:
    """The number of recent steps that the encoding stores: τ if φ is in the fragment of [Wang24]."""
    _, _, inner = _outer(phi)
    back, steps = lookback(inner), horizon(phi) + 1
    return min(horizon(inner) + 1 + back, steps) if back is not None else steps


def history_states(phi: Formula, n_letters: int) -> int | float:
    """The number of histories, predicted before anything is built; inf beyond the range of doubles."""
    longest = history_length(phi)
    if n_letters == 1:
        return longest + 1
    if longest * math.log2(n_letters) > 1000:
        return math.inf
    return int((n_letters ** (longest + 1) - 1) // (n_letters - 1))


def history_automaton(
    phi: Formula, atoms: tuple[Formula, ...], valuations: _Truth, limit: int | None = None
) -> TaskAutomaton:
    """The automaton whose states are histories.

    Raises SizeError before allocating, and FragmentError for operators of the past.
    """
    for node in walk(phi):
        if isinstance(node, PAST):
            message = f"the history encoding cannot judge {node}, which looks back; use the exact encoding"
            raise FragmentError(node.span.show(message) if node.span is not None else message)
    operator, interval, inner = _outer(phi)
    depth, n = horizon(inner) + 1, len(valuations)
    predicted = history_states(phi, n)
    require_memory(
        predicted * (4 * n + 8 * depth + 100),
        f"the history encoding of {phi}: {n} letters over {depth} steps, {predicted:.4g} states",
        "use the exact encoding",
        limit,
    )
    n_states = int(predicted)
    require_numbered(n_states, f"histories of {phi}", "use the exact encoding")
    # states in order of length; a history of length l with letters λ₁ … λ_l (oldest first) has index
    # offset[l] + Σ λ_i n^(l−i)
    offset = np.cumsum([0] + [n**length for length in range(depth + 1)])
    delta = np.empty((n, n_states), dtype=np.int32)
    for length in range(depth + 1):
        code = np.arange(n**length)
        kept = code if length < depth else code % n ** (depth - 1)
        for letter in range(n):
            delta[letter, offset[length] : offset[length + 1]] = offset[min(length + 1, depth)] + kept * n + letter
    full = np.arange(n**depth)
    steps = [full // n ** (depth - 1 - i) % n for i in range(depth)]
    truth = {atom: [valuations[step, i] for step in steps] for i, atom in enumerate(atoms)}
    holds = np.zeros(n_states, dtype=np.bool_)
    holds[offset[depth] :] = _Histories(truth, len(full)).truth(inner, 0)

    undecided = np.full(n_states, UNDECIDED, dtype=np.int8)
    running = np.where(holds, TRUE, UNDECIDED) if operator == "F" else np.where(holds, UNDECIDED, FALSE)
    final = np.where(holds, TRUE, FALSE)
    at = {0: undecided}
    at[interval.a + depth - 1] = running.astype(np.int8)
    at[interval.last + depth - 1] = final.astype(np.int8)
    return TaskAutomaton(
        formula=phi,
        encoding="history",
        exact=True,
        atoms=atoms,
        valuations=valuations,
        letter_of=np.arange(n, dtype=np.int32),
        delta=delta,
        initial=0,
        horizon=horizon(phi),
        verdict_starts=np.array(list(at), dtype=np.int64),
        verdict_rows=np.array(list(at.values()), dtype=np.int8),
        memory=_Memory(atoms, valuations),
        parts=(Part(phi, inner, depth - 1, "history", n_states, n_states),),
    )


def _outer(phi: Formula) -> tuple[str, Interval, Formula]:
    match phi:
        case Eventually(interval, arg):
            return "F", interval, arg
        case Always(interval, arg):
            return "G", interval, arg
        case _:
            return "G", Interval(0, 0), phi


class _Histories:
    """Truth at a position of every full history; each (φ, k) is computed once.

    It is found again by the object φ, so only parts of the formula itself are asked for, which live on.
    """

    def __init__(self, atoms: dict[Formula, list[_Truth]], n: int) -> None:
        self._atoms, self._n = atoms, n
        self._known: dict[tuple[int, int], _Truth] = {}

    def truth(self, phi: Formula, k: int) -> _Truth:
        key = (id(phi), k)
        if key not in self._known:
            self._known[key] = self._atoms[phi][k] if phi in self._atoms else self._truth(phi, k)
        return self._known[key]

    def _truth(self, phi: Formula, k: int) -> _Truth:
        match phi:
            case Constant(value):
                return np.full(self._n, value)
            case Not(arg):
                return ~self.truth(arg, k)
            case And(args):
                return ~_any(~self.truth(arg, k) for arg in args)
            case Or(args):
                return _any(self.truth(arg, k) for arg in args)
            case Implies(left, right):
                return ~self.truth(left, k) | self.truth(right, k)
            case Iff(left, right):
                return ~(self.truth(left, k) ^ self.truth(right, k))
            case Eventually(interval, arg):
                return _any(self.truth(arg, k + u) for u in range(interval.a, interval.last + 1))
            case Always(interval, arg):
                return ~_any(~self.truth(arg, k + u) for u in range(interval.a, interval.last + 1))
            case Until(interval, left, right):
                result = np.zeros(self._n, dtype=np.bool_)
                so_far = np.ones(self._n, dtype=np.bool_)
                for u in range(interval.last + 1):
                    if u >= interval.a:
                        result |= so_far & self.truth(right, k + u)
                    so_far &= self.truth(left, k + u)
                return result
            case Release(interval, left, right):
                result, unreleased = np.ones((2, self._n), dtype=np.bool_)
                for u in range(interval.last + 1):
                    if u >= interval.a:
                        result &= ~unreleased | self.truth(right, k + u)
                    unreleased &= ~self.truth(left, k + u)
                return result
            case Once() | Historically() | Since() | Trigger() | Rise():
                raise AssertionError("histories of formulas of the past are refused")
            case Label() | Comparison():
                raise AssertionError(f"{phi} is not an atom of this automaton")
            case _:
                assert_never(phi)


def _any(values: Iterable[_Truth]) -> _Truth:
    result: _Truth = np.logical_or.reduce(list(values))
    return result


class _Memory:
    """The last letters, newest first, given by the atoms that held."""

    def __init__(self, atoms: tuple[Formula, ...], valuations: _Truth) -> None:
        self._letters = [[atom for atom, holds in zip(atoms, row, strict=True) if holds] for row in valuations.tolist()]

    def __call__(self, q: int, text: Text = str) -> tuple[Remembered, ...]:
        return (Remembered(self._phrase(q, text), rank=q),)

    def _phrase(self, q: int, text: Text) -> str:
        n, length = len(self._letters), 0
        while q >= n**length:  # q minus the number of shorter histories: its digits are letters, newest lowest
            q -= n**length
            length += 1
        if not length:
            return "at the start"
        if length > _LONGEST_NAME:
            return f"{self._word(q % n, text)} after …"
        return " after ".join(self._word(q // n**i % n, text) for i in range(length))

    def _word(self, letter: int, text: Text) -> str:
        return "{" + ", ".join(map(text, self._letters[letter])) + "}"
