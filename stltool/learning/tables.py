"""The two Q-tables: the stationary one of [Wang24] on its surrogate reward, the exact one that carries the clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.automata.flags import surrogate_reward
from stltool.automata.reach import open_pairs
from stltool.display import counted
from stltool.kernels.tuples import Surrogate
from stltool.learning.counts import Counts
from stltool.learning.kept import Kept
from stltool.learning.optimism import doubt, nothing
from stltool.learning.problem import Problem
from stltool.sizes import require_memory, require_numbered

_WAYS_OUT = "shorten the windows, or use model-based, which needs no table"


class SurrogateTable:
    """Q(s, q, a) on the surrogate reward, as published: stationary, discounted, bootstrapping past the end.

    The reward is `surrogate_reward` of the automaton state that a step arrives in.
    """

    def __init__(self, problem: Problem, alpha: float, gamma: float, scale: str, outer: str) -> None:
        automaton = problem.automaton
        shape = (problem.n_states, automaton.n_states, problem.most_choices)
        require_memory(
            2 * 8 * math.prod(map(float, shape)),
            f"a Q-table of {' × '.join(map(str, shape))} entries",
            "shorten the windows",
        )
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


class Entries:
    """The *entries* of a state: the pairs (t, q) in which a run that has just read its letter can be, undecided.

    Later steps come first. E: the most that a state has; two more, E and E + 1, stand for the verdicts. `tables`: how
    many tables of values by entry there will be. SizeError if they would not fit into memory.

    numbers    (n_letters,): how many there are by letter; pairs: their t and q
    bounds     (n_letters, h + 1): how many there are of step t and later: those of t are bounds[t+1] … bounds[t] − 1
    index      (n_letters, h, Q): the entry of (t, q), −1 if there is none
    successor  (n_letters, n_letters, E): by the letters of s and s', the entry that a transition leads to
    """

    def __init__(self, problem: Problem, tables: int = 1) -> None:
        automaton, n_letters = problem.automaton, problem.automaton.n_letters
        self.problem, self.pairs = problem, open_pairs(automaton)
        self.numbers = np.array([len(q) for _, q in self.pairs], dtype=np.int64)
        self.bounds = np.zeros((n_letters, automaton.horizon + 1), dtype=np.int64)
        for letter, (t, _) in enumerate(self.pairs):
            self.bounds[letter] = np.searchsorted(-t, -np.arange(automaton.horizon + 1), side="right")
        self.E = E = int(self.numbers.max())
        require_numbered(E, "pairs of step and automaton state", _WAYS_OUT)
        require_memory(
            4 * (n_letters * n_letters * E + n_letters * automaton.horizon * automaton.n_states),
            f"the successors of {E} entries under {n_letters} letters",
            _WAYS_OUT,
        )
        S, C, _ = self.shape
        values = 8 * tables * float(S) * (C * E + E + 2)
        policies = 2 * np.dtype(problem.choice_type).itemsize * math.prod(map(float, problem.shape))
        require_memory(
            values + policies, f"{counted(tables, 'Q-table')} of {S} × {C} × {E} entries, and policies,", _WAYS_OUT
        )
        self.index = np.full((n_letters, automaton.horizon, automaton.n_states), -1, dtype=np.int32)
        for letter, (t, q) in enumerate(self.pairs):
            self.index[letter, t, q] = np.arange(len(t))
        self.successor = np.zeros((n_letters, n_letters, E), dtype=np.int32)
        for letter, (t, q) in enumerate(self.pairs):
            for after in range(n_letters):
                self.successor[letter, after, : len(t)] = self._at(after, t + 1, automaton.delta[after, q])

    @property
    def shape(self) -> tuple[int, int, int]:
        """(S, C, E)."""
        return self.problem.n_states, self.problem.most_choices, self.E

    def _at(self, letter: int, t: NDArray[Any], q: NDArray[Any]) -> NDArray[np.int32]:
        """The entries of (t, q), or of its verdict, in a state of that letter."""
        automaton = self.problem.automaton
        verdict = np.array([automaton.verdicts(step) for step in range(automaton.horizon + 1)])[t, q]
        known = self.index[letter, np.minimum(t, automaton.horizon - 1), q]
        return np.where(verdict == TRUE, self.E + 1, np.where(verdict == FALSE, self.E, known)).astype(np.int32)

    def is_open(self, t: NDArray[Any], s: NDArray[Any], q: NDArray[Any]) -> NDArray[np.bool_]:
        """Whether there is an entry for each (t, s, q)."""
        open_: NDArray[np.bool_] = self.index[self.problem.letter[s], t, q] >= 0
        return open_


class ExactTable:
    """Q_t(s, q, a) on the exact objective: γ = 1, value 1 or 0 where a run is decided.

    A share of every choice's value is that of being outside (learning/optimism.py): of doubt, where that is next to
    nothing; or of hope, where it is a paradise.

    Q (S, C, E), V (S, E + 2): by entries, V the best of Q, then 0 and 1, the values of verdicts
    worth (n_letters, E): of being outside, by its value after each step t
    """

    def __init__(self, entries: Entries, worth: Callable[[Any], Any]) -> None:
        self.entries, problem = entries, entries.problem
        self.worth = np.zeros((problem.automaton.n_letters, entries.E))
        for letter, (t, _) in enumerate(entries.pairs):
            self.worth[letter, : len(t)] = worth(t)
        self.Q = self._untried()
        self.V = np.zeros((problem.n_states, entries.E + 2))
        self.V[:, :-2], self.V[:, -1] = self.Q.max(axis=1), 1.0

    def _available(self) -> NDArray[np.bool_]:
        """Which choices exist: (S, C)."""
        problem = self.entries.problem
        return np.arange(problem.most_choices) < problem.n_choices[:, None]

    def _untried(self) -> NDArray[np.float64]:
        """Q before anything is tried."""
        worth = self.worth[self.entries.problem.letter]
        return np.where(self._available()[:, :, None], worth[:, None, :], 0.0)

    def best(self, t: int, s: int, q: int, chance: float) -> int:
        """The best choice in (t, s, q), ties broken by `chance` in [0, 1)."""
        from stltool.kernels import learning

        letter, n_choices, _ = self.entries.problem.lists
        return learning.clocked_best(self.Q, s, int(self.entries.index[letter[s], t, q]), n_choices[s], chance)

    def policy_table(self) -> NDArray[Any]:
        """The greedy policy, the first of ties: (h, S, Q) choices."""
        problem, automaton = self.entries.problem, self.entries.problem.automaton
        table = np.zeros((automaton.horizon, problem.n_states, automaton.n_states), dtype=problem.choice_type)
        for s, letter in enumerate(problem.letter):
            t, q = self.entries.pairs[letter]
            table[t, s, q] = self.Q[s, : problem.n_choices[s], : len(t)].argmax(axis=0)
        return table


class ClockedTable(ExactTable):
    """Learned by the updates of single entries, with doubt, and step sizes max(least_step, 1/n).

    visits   (S, C, E): how often each was updated
    """

    def __init__(self, entries: Entries, caution: float, least_step: float) -> None:
        super().__init__(entries, nothing)
        self.visits, self.caution, self.least_step = np.zeros(entries.shape, dtype=np.int64), caution, least_step

    def update(self, t: int, s: int, q: int, a: int, s2: int) -> None:
        """The factual update of one entry."""
        from stltool.kernels import learning

        entries, letter = self.entries, self.entries.problem.letter
        entry = int(entries.index[letter[s], t, q])
        self.visits[s, a, entry] += 1
        share = float(doubt(self.visits[s, a, entry], self.caution))
        value = float(self.V[s2, entries.successor[letter[s], letter[s2], entry]])
        value = (1 - share) * value + share * float(self.worth[letter[s], entry])
        n_choices = int(entries.problem.n_choices[s])
        learning.clocked_update(self.Q, self.V, self.visits, s, a, entry, n_choices, value, self.least_step)

    def arrays(self) -> dict[str, Kept]:
        """Everything, for a checkpoint."""
        return {"Q": Kept(self.Q, 0, 1), "V": Kept(self.V, 0, 1), "visits": Kept(self.visits, 0)}

    def check(self) -> None:
        """ValueError if the arrays contradict each other."""
        problem = self.entries.problem
        available = self._available()
        best = np.where(available[:, :, None], self.Q, 0).max(axis=1)
        if not np.array_equal(self.V, np.concatenate([best, np.tile([0.0, 1.0], (len(best), 1))], axis=1)):
            raise ValueError("V is not the best of Q")
        if self.Q[~available].any() or self.visits[~available].any():
            raise ValueError("Q or visits have values for choices that do not exist")
        open_ = np.arange(self.entries.E) < self.entries.numbers[problem.letter][:, None]
        tried = (self.visits > 0) & open_[:, None, :]
        if (self._untried() != self.Q)[~tried].any():
            raise ValueError("Q has learned about choices that were never tried")
        if self.visits[~tried].any():
            raise ValueError("visits are of steps at which the task is decided")

    def require_visits(self, counts: Counts) -> None:
        """ValueError unless every counted transition was one visit, and there are no others."""
        problem = self.entries.problem
        s = np.repeat(np.arange(problem.n_states), problem.n_choices)
        per_choice = self.visits.sum(axis=2, dtype=np.int64)
        if not np.array_equal(per_choice[s, np.arange(len(s)) - problem.first_choice[s]], counts.visits):
            raise ValueError("visits are not those that were counted")
