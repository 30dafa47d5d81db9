"""One episode, as a learner plays it: the model state, the automaton state, and `step`.

Every transition is counted before `step` returns. Episodes that run entirely in a compiled kernel are `record`ed.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata import TRUE, UNDECIDED
from stltool.errors import SettingsError
from stltool.learning.counts import Counts
from stltool.learning.problem import Problem
from stltool.models.environment import Environment, require_state


class Episode:
    """An episode that has begun, of at most `length` steps.

    number    counted from 0
    length    the maximum number of steps; `over` when they are done
    together  the learner may play so many episodes one after the other in place of this one, and record them all
    batch     the numbers of the episodes that are played side by side with it, its own among them; None: it is alone
    rng       the source of the learner's random numbers
    t, s, q   the current step, model state, and automaton state after reading it
    played    the episodes that were played: 1, or `together`
    verdict   whether the task is satisfied; None until the run is decided. Further steps may still be taken, to explore
    """

    __slots__ = (
        "_actions", "_before", "_counts", "_delta", "_first_choice", "_letter", "_n_choices", "_problem", "_states",
        "batch", "environment", "length", "number", "played", "q", "rng", "s", "t", "together", "verdict",
    )  # fmt: skip

    def __init__(
        self,
        problem: Problem,
        environment: Environment,
        counts: Counts,
        rng: np.random.Generator,
        number: int,
        length: int,
        batch: range | None = None,
        together: int = 1,
    ) -> None:
        self._problem, self._counts = problem, counts
        self._letter, self._n_choices, self._first_choice = problem.lists
        self._delta = problem.automaton.delta
        self.environment, self.rng, self.number, self.length, self.batch = environment, rng, number, length, batch
        self.together, self.played = together, 1
        self.t, self.s = 0, require_state(environment.reset(), "reset()", problem.n_states, "the model")
        self.q = int(self._delta[self._letter[self.s], problem.automaton.initial])
        self.verdict: bool | None = None
        self._states: Any = [self.s]  # lists, or the arrays that were recorded
        self._actions: Any = []
        self._before = 0  # the context of the next transition: 1 + the choice before it
        self._judge()

    @property
    def over(self) -> bool:
        """Whether no step is left."""
        return self.t >= self.length

    @property
    def n_choices(self) -> int:
        """The number of choices in the current state."""
        return self._n_choices[self.s]

    @property
    def stuck(self) -> bool:
        """Whether the last step led nowhere, and no choice of this state ever did."""
        s = self.s
        if not self.t or self._states[-2] != s:
            return False
        first = self._first_choice[s]
        rows = slice(*np.searchsorted(self._counts.choice, [first, first + self._n_choices[s]]))
        return bool((self._counts.target[rows] == s).all())

    def step(self, choice: int) -> None:
        """Take a choice (0 … n_choices − 1): t, s, q and verdict change.

        Raises SettingsError if there is no such choice or no step left, ModelError if the environment returns
        something that is not a state.
        """
        s = self.s
        try:
            a = operator.index(choice)
        except TypeError:
            a = -1
        if not 0 <= a < self._n_choices[s] or self.over:
            raise SettingsError(
                f"the learner took choice {choice!r} at step {self.t} in state {s}, which has {self._n_choices[s]} "
                f"choices, counted from 0; an episode has {self.length} steps"
            )
        after = require_state(self.environment.step(a), f"step({a}) in state {s}", len(self._n_choices), "the model")
        taken = self._first_choice[s] + a
        self._counts.add_one(taken, after, self._before)
        self._before = taken + 1
        self._states.append(after)
        self._actions.append(a)
        self.t += 1
        self.s, self.q = after, int(self._delta[self._letter[after], self.q])
        if self.verdict is None:
            self._judge()

    def _judge(self) -> None:
        automaton = self._problem.automaton
        if self.t <= automaton.horizon:
            verdict = automaton.verdicts(self.t)[self.q]
            if verdict != UNDECIDED:
                self.verdict = bool(verdict == TRUE)

    def record(self, states: NDArray[np.int32], actions: NDArray[np.int32]) -> None:
        """All steps of an episode that a kernel took: states (n+1,) and choices (n,). No verdict is stored."""
        taken = self._problem.first_choice[states[:-1]] + actions
        self._counts.add_known(taken, states[1:], np.concatenate([[self._before], taken + 1])[:-1])
        self._states, self._actions = states, actions
        self.t, self.s = len(actions), int(states[-1])

    def record_all(self, choice: NDArray[np.int64], target: NDArray[np.int32], context: NDArray[np.int64]) -> None:
        """All steps of the episodes that it stands for, as they are counted; t is then the number of them all."""
        self._counts.add_known(choice, target, context)
        self.played, self.t = self.together, len(choice)

    def transitions(self) -> NDArray[np.int32]:
        """(t, 3): s, a, s' of every step so far."""
        states = np.array(self._states, dtype=np.int32)
        return np.stack([states[:-1], np.array(self._actions, dtype=np.int32), states[1:]], axis=1)
