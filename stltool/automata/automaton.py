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
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import require, whole
from stltool.display import Card, Displayed, StateNames, counted, listed
from stltool.logic.formula import Formula
from stltool.logic.printer import Text as Text  # what the memory of states is written in

UNDECIDED, FALSE, TRUE = -1, 0, 1
_SHOWN = 10  # parts listed in a notebook


@dataclass(frozen=True)
class Remembered:
    """What one part of an automaton remembers in one of its states.

    phrase   in words
    rank     its position among what the part can remember: a slider goes through the phrases in this order
    status   "open"; "due": the next step decides the oldest obligation; "done": nothing is pending, or the part has
             succeeded; "failed"
    subject  what is counted, or ""
    number   of steps, up to `limit`, if it counts; else None
    risk     whether a larger number brings failure nearer; else success
    """

    phrase: str
    rank: int = 0
    status: Literal["open", "due", "done", "failed"] = "open"
    subject: str = ""
    number: int | None = None
    limit: int | None = None
    risk: bool = False


class Memory(Protocol):
    """What state q remembers, one entry for each part; formulas are written by `text`."""

    def __call__(self, q: int, text: Text = str) -> tuple[Remembered, ...]: ...


@dataclass(frozen=True, eq=False)
class Track:
    """What one part of an automaton can remember: `levels` in ascending order, and the level of each state, (n,)."""

    name: str
    levels: tuple[Remembered, ...]
    level_of: NDArray[np.int32]


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


@dataclass(frozen=True, eq=False)
class Starts:
    """Where a run begins at any step of a trace: with what is remembered of the steps before.

    delta  (n_letters, n) int32: over what can be remembered; 0 is nothing, before the first letter
    state  (n,) int32: the automaton's state in which a run then begins
    """

    delta: NDArray[np.int32]
    state: NDArray[np.int32]


@dataclass(frozen=True, eq=False, repr=False)
class TaskAutomaton(Displayed):
    """A deterministic automaton over letters, with verdicts that depend on the step.

    formula     the formula that it judges
    encoding    "exact" | "paper" | "history" | "running" | "safety", as requested
    exact       whether its verdicts always equal the truth of the formula
    atoms       ψ₁ … ψ_m: the Boolean formulas whose truth it reads
    valuations  (n_valuations, m) bool: the truth assignments that it accepts
    letter_of   (n_valuations,) int32: their letters; valuations that no state distinguishes share one
    delta       (n_letters, n_states) int32
    initial     q₀, before s₀ is read
    horizon     h: the step by which every run is decided
    verdict_starts  (k,) int64, ascending from 0: row i of `verdict_rows` applies from step verdict_starts[i] on
    verdict_rows    (k, n_states) int8: TRUE, FALSE or UNDECIDED
    memory      what each state remembers, part by part, in terms of the formula
    parts       its parts, with delays and sizes
    registers   (n_states, n_registers) int32: the flags, by `register_names` (no columns for other encodings)
    starts      where runs begin that do not begin at step 0, if it was compiled for them; their verdicts are counted
                from their own first step
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
    memory: Memory
    parts: tuple[Part, ...]
    registers: NDArray[np.int32] = field(default_factory=lambda: np.empty((0, 0), dtype=np.int32))
    register_names: tuple[str, ...] = ()
    starts: Starts | None = None

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
        row: NDArray[np.int8] = self.verdict_rows[self.verdict_starts.searchsorted(t, side="right") - 1]
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
            memory=_WithOutcome(self.memory, self.n_states),
            registers=np.empty((0, 0), dtype=np.int32),
            register_names=(),
        )

    def describe(self, q: int) -> str:
        """What state q remembers, in terms of the formula."""
        remembered = self.memory(whole(q, "the automaton's state q", 0, self.n_states - 1))
        return "; ".join(one.phrase for one in remembered)

    @property
    def state_names(self) -> Sequence[str]:
        """(n_states,): what each state remembers, made on demand."""
        return StateNames(self.n_states, self.describe)

    def tracks(self, text: Text = str) -> tuple[Track, ...]:
        """What each part can remember, as data: for sliders, tables and pictures of the memory."""
        rows = [self.memory(q, text) for q in range(self.n_states)]
        if len({len(row) for row in rows}) > 1:  # of a product with an outcome
            rows = [(Remembered("; ".join(one.phrase for one in row), rank=q),) for q, row in enumerate(rows)]
        formulas = [text(part.formula) for part in self.parts]
        tracks = []
        for i, column in enumerate(zip(*rows, strict=True)):
            levels = sorted(dict.fromkeys(column), key=lambda one: (one.rank, one.phrase))
            number = {one: level for level, one in enumerate(levels)}
            subject = next((one.subject for one in levels if one.subject), "")
            name = subject or (formulas[i] if i < len(formulas) else f"memory {i + 1}")
            tracks.append(Track(name, tuple(levels), np.array([number[one] for one in column], dtype=np.int32)))
        return tuple(tracks)

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
    """What the states remember, and the added one."""

    def __init__(self, memory: Memory, n_states: int) -> None:
        self._memory, self._n = memory, n_states

    def __call__(self, q: int, text: Text = str) -> tuple[Remembered, ...]:
        return self._memory(q, text) if q < self._n else (Remembered("the outcome"),)
