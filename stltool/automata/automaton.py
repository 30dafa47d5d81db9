"""The task automaton: the one object every back end consumes (semantics.md §2).

    (Q, q₀, Λ, δ : Λ × Q → Q, h, verdict_t : Q → {true, false, undecided} for t = 0 … h)

with q_t = δ(L(s_t), q_{t−1}), q_{−1} = q₀ and verdict_h total. Its specification is one sentence: **the first decided
verdict along s₀ s₁ … s_h equals the truth of the formula at 0 on that trace.** A property test holds it against
`logic/semantics.py`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stltool.logic.formula import Formula

UNDECIDED, FALSE, TRUE = -1, 0, 1


@dataclass(frozen=True, eq=False)
class TaskAutomaton:
    """A deterministic automaton over letters, with verdicts that depend on the step.

    formula     what it judges
    encoding    "exact" | "paper", as asked for
    exact       whether its verdicts are proven equal to the formula
    atoms       ψ₁ … ψ_m: the Boolean formulas whose valuation is a letter
    letters     (n_letters, m) bool: the valuations it reads
    delta       (n_letters, n_states) int32
    initial     q₀, before s₀ is read
    horizon     h: the step at which every verdict has fallen
    verdict_starts  (k,) int64, ascending from 0: row i of `verdict_rows` holds from step verdict_starts[i] on
    verdict_rows    (k, n_states) int8: TRUE, FALSE or UNDECIDED
    registers   (n_states, n_registers) int32: what each state remembers, by `register_names`
    """

    formula: Formula
    encoding: str
    exact: bool
    atoms: tuple[Formula, ...]
    letters: NDArray[np.bool_]
    delta: NDArray[np.int32]
    initial: int
    horizon: int
    verdict_starts: NDArray[np.int64]
    verdict_rows: NDArray[np.int8]
    registers: NDArray[np.int32]
    register_names: tuple[str, ...]

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

    def judge(self, letters: Iterable[int]) -> tuple[bool, int] | None:
        """The first decided verdict along a sequence of letters and its step; None if it ends undecided."""
        q = self.initial
        for t, letter in enumerate(letters):
            q = int(self.delta[letter, q])
            verdict = int(self.verdicts(min(t, self.horizon))[q])
            if verdict != UNDECIDED:
                return verdict == TRUE, t
        return None

    def live(self) -> NDArray[np.bool_]:
        """(h, n_states): whether a run can be in q after step t with nothing decided so far."""
        live = np.zeros((self.horizon, self.n_states), dtype=np.bool_)
        reached = self.delta[:, self.initial]
        for t in range(self.horizon):
            live[t, reached] = True
            live[t] &= self.verdicts(t) == UNDECIDED
            reached = self.delta[:, live[t]]
        return live

    def describe(self, q: int) -> str:
        """What state q remembers, in the formula's terms."""
        values = zip(self.register_names, self.registers[q], strict=True)
        return ", ".join(f"{name}: {value}" for name, value in values)

    def digest(self) -> str:
        """A SHA-256 over everything that a policy depends on."""
        sha = hashlib.sha256()
        sha.update(f"{self.formula}|{self.encoding}|{self.initial}|{self.horizon}".encode())
        for array in (self.letters, self.delta, self.verdict_starts, self.verdict_rows):
            sha.update(str(array.shape).encode() + np.ascontiguousarray(array).tobytes())
        return sha.hexdigest()
