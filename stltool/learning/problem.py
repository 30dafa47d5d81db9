"""What a learner knows: the task automaton, the labels, and the number of actions per state; no probabilities.

The automaton decides a run as soon as no sequence of the model's letters can change the verdict any more. That is more
than it does itself: after step 9, `F[0,9] G[0,9] A` is lost outside A, but decided only at the end. A learner that
hopes would otherwise hope for a success where none is possible, and never avoid such situations.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stltool.automata import TaskAutomaton
from stltool.product import Product, with_early_verdicts
from stltool.sizes import IntegerType, integer_type


@dataclass(frozen=True, eq=False)
class Problem:
    """letter (n_states,): the automaton's letter of each model state; n_choices (n_states,): available actions."""

    automaton: TaskAutomaton
    letter: NDArray[np.int32]
    n_choices: NDArray[np.int64]

    @classmethod
    def of(cls, product: Product) -> Problem:
        return cls(with_early_verdicts(product).automaton, product.letter, np.diff(product.model.choice_start))

    @property
    def n_states(self) -> int:
        return len(self.letter)

    @property
    def most_choices(self) -> int:
        return int(self.n_choices.max())

    @property
    def choice_type(self) -> IntegerType:
        """As in the model."""
        return integer_type(self.most_choices - 1)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(horizon, model states, automaton states): of a policy's table that depends on the step."""
        return self.automaton.horizon, self.n_states, self.automaton.n_states

    @functools.cached_property
    def first_choice(self) -> NDArray[np.int64]:
        """(n_states + 1,): where each state's choices begin, when all are numbered consecutively."""
        return np.concatenate([[0], np.cumsum(self.n_choices)]).astype(np.int64)

    @functools.cached_property
    def lists(self) -> tuple[list[int], list[int], list[int]]:
        """letter, n_choices and first_choice as lists, which are faster for single steps."""
        return self.letter.tolist(), self.n_choices.tolist(), self.first_choice[:-1].tolist()
