"""The task automaton, the object that every back end uses (docs/semantics.md §2).

    (Q, q₀, Λ, δ : Λ × Q → Q, h, verdict_t : Q → {true, false, undecided} for t = 0 … h)

with q_t = δ(L(s_t), q_{t−1}), q_{−1} = q₀ and verdict_h total. Its specification is one sentence: **the first decided
verdict along s₀ s₁ … s_h equals the truth of the formula at step 0 of that trace.** A property test checks this
against `logic/semantics.py`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import require, whole
from stltool.display import Card, Displayed, StateNames, counted, listed
from stltool.logic.formula import Formula

UNDECIDED, FALSE, TRUE = -1, 0, 1
_SHOWN = 10  # parts listed in a notebook


@dataclass(frozen=True)
class Part:
    """One part of an automaton's construction: what it tracks, and how.

    obligation  the formula that must hold at every start; its truth is known `delay` steps after the start
    method      "flag" (a counter), "oldest" or "each" (pending starts), "until" (open or ended), "single" (windows
                counted down), "history"
    explored    states found before minimisation; `states`: after it
    """

    formula: Formula
    obligation: Formula
    delay: int
    method: str
    explored: int
    states: int


@dataclass(frozen=True, eq=False, repr=False)
class TaskAutomaton(Displayed):
    """A deterministic automaton over letters, with verdicts that depend on the step.

    formula     the formula that it judges
    encoding    "exact" | "paper" | "history", as requested
    exact       whether its verdicts always equal the truth of the formula
    atoms       ψ₁ … ψ_m: the Boolean formulas whose truth it reads
    valuations  (n_valuations, m) bool: the truth assignments that it accepts
    letter_of   (n_valuations,) int32: their letters; valuations that no state distinguishes share one
    delta       (n_letters, n_states) int32
    initial     q₀, before s₀ is read
    horizon     h: the step by which every run is decided
    verdict_starts  (k,) int64, ascending from 0: row i of `verdict_rows` applies from step verdict_starts[i] on
    verdict_rows    (k, n_states) int8: TRUE, FALSE or UNDECIDED
    state_names (n_states,): what each state remembers, in terms of the formula
    parts       its parts, with delays and sizes
    registers   (n_states, n_registers) int32: the flags, by `register_names` (no columns for other encodings)
    """

    formula: Formula
    encoding: str
    exact: bool
    atoms: tuple[Formula, ...]
    valuations: NDArray[np.bool_]
    letter_of: NDArray[np.int32]
    delta: NDArray[np.int32]
    initial: int
    horizon: int
    verdict_starts: NDArray[np.int64]
    verdict_rows: NDArray[np.int8]
    state_names: Sequence[str]
    parts: tuple[Part, ...]
    registers: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 0), dtype=np.int32))
    register_names: tuple[str, ...] = ()

    def _card(self) -> Card:
        exact = self.encoding if self.exact else f"{self.encoding} (an approximation)"
        rows = [(str(part.formula), part.delay, part.method, part.states) for part in self.parts[:_SHOWN]]
        return Card(
            f"TaskAutomaton: {counted(self.n_states, 'state')}, {counted(self.n_letters, 'letter')}",
            [
                {"formula": self.formula},
                {"horizon": self.horizon, "encoding": exact, "reads": listed(map(str, self.atoms))},
            ],
            (("part", "delay", "method", "states"), rows),
            more=max(0, len(self.parts) - _SHOWN),
        )

    @property
    def n_states(self) -> int:
        return int(self.delta.shape[1])

    @property
    def n_letters(self) -> int:
        return int(self.delta.shape[0])

    def verdicts(self, t: int) -> NDArray[np.int8]:
        """verdict_t of every state, (n_states,) int8."""
        row: NDArray[np.int8] = self.verdict_rows[np.searchsorted(self.verdict_starts, t, side="right") - 1]
        return row

    def judge(self, letters: Sequence[int]) -> tuple[bool, int] | None:
        """The first decided verdict along a sequence of letters, and its step; None if it remains undecided."""
        require(letters, (list, tuple, np.ndarray), "judge's letters", "give letters as integers")
        q = self.initial
        for t, letter in enumerate(letters):
            q = int(self.delta[whole(letter, "one of judge's letters", 0, self.n_letters - 1), q])
            verdict = int(self.verdicts(min(t, self.horizon))[q])
            if verdict != UNDECIDED:
                return verdict == TRUE, t
        return None

    def with_outcome(self, verdict: int) -> TaskAutomaton:
        """Add a last letter and a last state: the letter leads every run to that state, whose verdict is `verdict`."""
        delta = np.full((self.n_letters + 1, self.n_states + 1), self.n_states, dtype=np.int32)
        delta[:-1, :-1] = self.delta
        decided = np.full((len(self.verdict_rows), 1), verdict, dtype=np.int8)
        return replace(
            self,
            delta=delta,
            verdict_rows=np.concatenate([self.verdict_rows, decided], axis=1),
            state_names=StateNames(self.n_states + 1, _WithOutcome(self.state_names)),
            registers=np.empty((0, 0), dtype=np.int32),
            register_names=(),
        )

    def describe(self, q: int) -> str:
        """What state q remembers, in terms of the formula."""
        return self.state_names[whole(q, "the automaton's state q", 0, self.n_states - 1)]

    def letters_at(self, truth: NDArray[np.bool_]) -> NDArray[np.int32]:
        """The letters of truth assignments (n, m), all of which the automaton must accept."""
        known = {row.tobytes(): letter for row, letter in zip(self.valuations, self.letter_of.tolist(), strict=True)}
        return np.array([known[row.tobytes()] for row in np.ascontiguousarray(truth)], dtype=np.int32)

    def digest(self) -> str:
        """A SHA-256 of everything that a policy depends on."""
        sha = hashlib.sha256()
        sha.update(f"{self.formula}|{self.encoding}|{self.initial}|{self.horizon}".encode())
        for array in (self.valuations, self.letter_of, self.delta, self.verdict_starts, self.verdict_rows):
            sha.update(str(array.shape).encode() + np.ascontiguousarray(array).tobytes())
        return sha.hexdigest()


class _WithOutcome:
    """Names of the states, and of the added one."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names

    def __call__(self, q: int) -> str:
        return self._names[q] if q < len(self._names) else "the outcome"
