"""The two Q-tables: the stationary one of [Wang24] on its surrogate reward, the exact one that carries the clock."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.automata.flags import surrogate_reward
from stltool.automata.reach import open_pairs
from stltool.kernels.tuples import Surrogate
from stltool.learning.counts import Counts
from stltool.learning.kept import Kept
from stltool.learning.problem import Problem
from stltool.sizes import require_memory, require_numbered


class SurrogateTable:
    """Q(s, q, a) on the surrogate reward, as published: stationary, discounted, bootstrapping past the end.

    The reward is `surrogate_reward` of the automaton state that a step arrives in.
    """

    def __init__(self, problem: Problem, alpha: float, gamma: float, scale: str, outer: str) -> None:
        automaton = problem.automaton
        shape = (problem.n_states, automaton.n_states, problem.most_choices)
        _require_table(shape)
        self.Q = np.zeros(shape)
        unavailable = np.arange(shape[2]) >= problem.n_choices[:, None, None]
        self.Q[np.broadcast_to(unavailable, shape)] = -np.inf
        self.reward = surrogate_reward(automaton, outer, scale)
        self.kernel = Surrogate(self.Q, self.reward, alpha, gamma)

    @property
    def greatest(self) -> float:
        """A bound on the size of values: a discounted sum of rewards, with allowance for rounding."""
        discount = self.kernel.gamma
        bound = float(abs(self.reward).max()) / (1 - discount) if discount < 1 else float(np.finfo(np.float64).max)
        return min(bound * (1 + 1e-6), float(np.finfo(np.float64).max))

    def policy_table(self) -> NDArray[Any]:
        """The greedy policy, uniform over ties: (S, Q, C) weights."""
        best = self.Q.max(axis=2, keepdims=True) == self.Q
        weights: NDArray[np.float64] = best / best.sum(axis=2, keepdims=True)
        return weights


class ClockedTable:
    """Q_t(s, q, a) on the exact objective: γ = 1, value 1 or 0 where a run is decided, learned backwards in t.

    Stored only for *entries*: the pairs (t, q) in which a run that has just read the state's letter can be with nothing
    decided, later steps first. Q (S, C, E) and V (S, E+2): the last two are 0 and 1, the values of verdicts. Values
    start at 0; step sizes are max(least_step, 1/n).

    visits  (S, C, E) or, where a transition updates all entries, (S, C): how often each was updated by real steps
    """

    def __init__(self, problem: Problem, least_step: float, caution: float, count_every_entry: bool) -> None:
        automaton, n_letters = problem.automaton, problem.automaton.n_letters
        self._problem, self._least, self._caution = problem, least_step, caution
        open_ = open_pairs(automaton)
        self.entries = np.array([len(q) for _, q in open_], dtype=np.int64)
        E = int(self.entries.max())
        require_numbered(E, "pairs of step and automaton state", "shorten the windows")
        shape = (problem.n_states, problem.most_choices, E)
        _require_table(shape)
        require_memory(
            4 * (n_letters * n_letters * E + n_letters * automaton.horizon * automaton.n_states),
            f"the successors of {E} entries under {n_letters} letters",
            "shorten the windows",
        )
        self.Q, self.V = np.zeros(shape), np.zeros((problem.n_states, E + 2))
        self.V[:, -1] = 1.0
        self.visits = np.zeros(shape if count_every_entry else shape[:2], dtype=np.int64)
        self._pairs = open_
        self._index = np.full((n_letters, automaton.horizon, automaton.n_states), -1, dtype=np.int32)
        for letter, (t, q) in enumerate(open_):
            self._index[letter, t, q] = np.arange(len(t))
        self._successor = np.zeros((n_letters, n_letters, E), dtype=np.int32)
        for letter, (t, q) in enumerate(open_):
            for after in range(n_letters):
                self._successor[letter, after, : len(t)] = self._entries_at(after, t + 1, automaton.delta[after, q])

    def _entries_at(self, letter: int, t: NDArray[Any], q: NDArray[Any]) -> NDArray[np.int32]:
        """Where V has the value of (t, q) in a state of that letter."""
        automaton, E = self._problem.automaton, self.Q.shape[2]
        verdict = np.array([automaton.verdicts(step) for step in range(automaton.horizon + 1)])[t, q]
        known = self._index[letter, np.minimum(t, automaton.horizon - 1), q]
        return np.where(verdict == TRUE, E + 1, np.where(verdict == FALSE, E, known)).astype(np.int32)

    def best(self, t: int, s: int, q: int, chance: float) -> int:
        """The best choice in (t, s, q), ties broken by `chance` in [0, 1)."""
        values = self.Q[s, : self._problem.n_choices[s], self._index[self._problem.letter[s], t, q]]
        ties = np.flatnonzero(values == values.max())
        return int(ties[int(chance * len(ties))])

    def update(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None:
        """The factual update of one entry."""
        from stltool.kernels import learning

        letter = self._problem.letter
        entry = int(self._index[letter[s], t, q])
        value = float(self.V[s2, self._successor[letter[s], letter[s2], entry]])
        learning.clocked_update(
            self.Q, self.V, self.visits, s, a, entry, int(self._problem.n_choices[s]), value, self._least
        )

    def update_all(self, rows: NDArray[np.int32]) -> None:
        """Every entry that real transitions rows (n, 3) of (s, a, s') speak for, in their order."""
        from stltool.kernels import learning

        learning.clocked_transitions(
            self.Q, self.V, self.visits, self._problem.letter, self.entries, self._successor, self._problem.n_choices,
            self._least, np.ascontiguousarray(rows),
        )  # fmt: skip

    def policy_table(self) -> NDArray[Any]:
        """The greedy policy over tried choices, the first of ties: (h, S, Q) choices."""
        problem, automaton = self._problem, self._problem.automaton
        table = np.zeros((automaton.horizon, problem.n_states, automaton.n_states), dtype=problem.choice_type)
        visits = self.visits if self.visits.ndim == 3 else self.visits[:, :, None]
        trust = visits / (visits + self._caution)
        for s, letter in enumerate(problem.letter):
            t, q = self._pairs[letter]
            values = np.where(visits[s] > 0, trust[s] * self.Q[s], -1.0)[: problem.n_choices[s], : len(t)]
            table[t, s, q] = values.argmax(axis=0)
        return table

    def arrays(self) -> dict[str, Kept]:
        """Everything that learning changes."""
        return {"Q": Kept(self.Q, 0, 1), "V": Kept(self.V, 0, 1), "visits": Kept(self.visits, 0)}

    def check(self) -> None:
        """ValueError if the arrays contradict each other."""
        n_choices, E = self._problem.n_choices, self.Q.shape[2]
        available = np.arange(self.Q.shape[1]) < n_choices[:, None]
        best = np.where(available[:, :, None], self.Q, 0).max(axis=1)
        if not np.array_equal(self.V, np.concatenate([best, np.tile([0.0, 1.0], (len(best), 1))], axis=1)):
            raise ValueError("V is not the best of Q")
        if self.Q[~available].any() or self.visits[~available].any():
            raise ValueError("Q or visits have values for choices that do not exist")
        entries = np.arange(E) < self.entries[self._problem.letter][:, None]
        per_entry = self.visits if self.visits.ndim == 3 else self.visits[:, :, None]
        tried = (per_entry > 0) & entries[:, None, :]
        if self.Q[~tried].any():
            raise ValueError("Q has values for choices that were never tried")
        if self.visits.ndim == 3 and self.visits[~tried].any():
            raise ValueError("visits are of steps at which the task is decided")

    def require_visits(self, counts: Counts) -> None:
        """ValueError unless every counted transition was one visit, and there are no others."""
        per_choice = self.visits.sum(axis=2, dtype=np.int64) if self.visits.ndim == 3 else self.visits
        s = np.repeat(np.arange(self._problem.n_states), self._problem.n_choices)
        if not np.array_equal(per_choice[s, np.arange(len(s)) - self._problem.first_choice[s]], counts.visits):
            raise ValueError("visits are not those that were counted")

    def is_open(self, t: NDArray[Any], s: NDArray[Any], q: NDArray[Any]) -> NDArray[np.bool_]:
        """Whether there is an entry for each (t, s, q)."""
        open_: NDArray[np.bool_] = self._index[self._problem.letter[s], t, q] >= 0
        return open_


def _require_table(shape: tuple[int, ...]) -> None:
    entries = int(np.prod([float(n) for n in shape]))
    require_memory(2 * 8 * entries, f"a Q-table of {' × '.join(str(n) for n in shape)} entries", "shorten the windows")
