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
from stltool.learning.optimism import hope, paradise
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
        self._problem, self.least_step, self._caution = problem, least_step, caution
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
        self.pairs = open_
        self._index = np.full((n_letters, automaton.horizon, automaton.n_states), -1, dtype=np.int32)
        for letter, (t, q) in enumerate(open_):
            self._index[letter, t, q] = np.arange(len(t))
        self.successor = np.zeros((n_letters, n_letters, E), dtype=np.int32)
        for letter, (t, q) in enumerate(open_):
            for after in range(n_letters):
                self.successor[letter, after, : len(t)] = self._entries_at(after, t + 1, automaton.delta[after, q])

    def _entries_at(self, letter: int, t: NDArray[Any], q: NDArray[Any]) -> NDArray[np.int32]:
        """Where V has the value of (t, q) in a state of that letter."""
        automaton, E = self._problem.automaton, self.Q.shape[2]
        verdict = np.array([automaton.verdicts(step) for step in range(automaton.horizon + 1)])[t, q]
        known = self._index[letter, np.minimum(t, automaton.horizon - 1), q]
        return np.where(verdict == TRUE, E + 1, np.where(verdict == FALSE, E, known)).astype(np.int32)

    def best(self, t: int, s: int, q: int, chance: float) -> int:
        """The best choice in (t, s, q), ties broken by `chance` in [0, 1)."""
        return self.best_of(self.Q, t, s, q, chance)

    def best_of(self, values: NDArray[np.float64], t: int, s: int, q: int, chance: float) -> int:
        """The same by other values (S, C, E)."""
        here = values[s, : self._problem.n_choices[s], self._index[self._problem.letter[s], t, q]]
        ties = np.flatnonzero(here == here.max())
        return int(ties[int(chance * len(ties))])

    def update(self, t: int, s: int, q: int, a: int, s2: int, q2: int) -> None:
        """The factual update of one entry."""
        from stltool.kernels import learning

        letter = self._problem.letter
        entry = int(self._index[letter[s], t, q])
        value = float(self.V[s2, self.successor[letter[s], letter[s2], entry]])
        learning.clocked_update(
            self.Q, self.V, self.visits, s, a, entry, int(self._problem.n_choices[s]), value, self.least_step
        )

    def update_all(self, rows: NDArray[np.int32]) -> None:
        """Every entry that real transitions rows (n, 3) of (s, a, s') speak for, in their order."""
        from stltool.kernels import learning

        learning.clocked_transitions(
            self.Q, self.V, self.visits, self._problem.letter, self.entries, self.successor, self._problem.n_choices,
            self.least_step, np.ascontiguousarray(rows),
        )  # fmt: skip

    def policy_table(self) -> NDArray[Any]:
        """The greedy policy over tried choices, the first of ties: (h, S, Q) choices."""
        problem, automaton = self._problem, self._problem.automaton
        table = np.zeros((automaton.horizon, problem.n_states, automaton.n_states), dtype=problem.choice_type)
        visits = self.visits if self.visits.ndim == 3 else self.visits[:, :, None]
        trust = visits / (visits + self._caution)
        for s, letter in enumerate(problem.letter):
            t, q = self.pairs[letter]
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


class HopefulTable:
    """U_t(s, q, a), learned beside a `ClockedTable` from the same transitions, with optimism (learning/optimism.py).

    A choice that was never tried is worth a paradise, so that going where nothing has been tried is worth as much: U
    explores deeply. U (S, C, E) and W (S, E+2) as Q and V there.
    """

    def __init__(self, problem: Problem, table: ClockedTable, optimism: float) -> None:
        self._problem, self._table, self._optimism = problem, table, optimism
        E, h = table.Q.shape[2], problem.automaton.horizon
        self._paradise = np.zeros((problem.automaton.n_letters, E))
        for letter, (t, _) in enumerate(table.pairs):
            self._paradise[letter, : len(t)] = paradise(t, h)
        _require_table(table.Q.shape)
        available = np.arange(table.Q.shape[1]) < problem.n_choices[:, None]
        self.U = np.where(available[:, :, None], self._paradise[problem.letter][:, None, :], 0.0)
        self.W = np.zeros((problem.n_states, E + 2))
        self.W[:, :E], self.W[:, -1] = self.U.max(axis=1), 1.0

    def best(self, t: int, s: int, q: int, chance: float) -> int:
        """The most hopeful choice in (t, s, q), ties broken by `chance` in [0, 1)."""
        return self._table.best_of(self.U, t, s, q, chance)

    def update_all(self, rows: NDArray[np.int32]) -> None:
        """After the same update of the other table."""
        from stltool.kernels import learning

        table, problem = self._table, self._problem
        hopes = hope(table.visits, table.visits.sum(axis=1, keepdims=True) / problem.n_choices[:, None], self._optimism)
        learning.hopeful_transitions(
            self.U, self.W, table.visits, problem.letter, table.entries, table.successor, problem.n_choices,
            table.least_step, hopes, self._paradise, np.ascontiguousarray(rows),
        )  # fmt: skip

    def arrays(self) -> dict[str, Kept]:
        """Everything that learning changes."""
        return {"U": Kept(self.U, 0, 1), "W": Kept(self.W, 0, 1)}

    def check(self) -> None:
        """ValueError if the arrays contradict each other or the other table."""
        available = np.arange(self.U.shape[1]) < self._problem.n_choices[:, None]
        if not np.array_equal(self.W[:, :-2], np.where(available[:, :, None], self.U, 0).max(axis=1)):
            raise ValueError("W is not the best of U")
        if (self.W[:, -2:] != [0.0, 1.0]).any() or self.U[~available].any():
            raise ValueError("U or W have values for what does not exist")
        untried = available & (self._table.visits == 0)
        if (self._paradise[self._problem.letter][:, None, :] != self.U)[untried].any():
            raise ValueError("U has learned about choices that were never tried")


def _require_table(shape: tuple[int, ...]) -> None:
    entries = int(np.prod([float(n) for n in shape]))
    require_memory(2 * 8 * entries, f"a Q-table of {' × '.join(str(n) for n in shape)} entries", "shorten the windows")
