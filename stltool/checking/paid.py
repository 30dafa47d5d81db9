"""What a step costs, for the questions about costs: a cost of the model, a signal, a label, or a function.

A number given in fractions or decimals is that number; a double stands for its shortest decimal, as everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described
from stltool.errors import ArgumentError, NameLookupError, SettingsError
from stltool.logic.names import near_names
from stltool.models import MDP
from stltool.models.costs import Amounts, Cost
from stltool.models.fractions import over_one
from stltool.numbers import exact

CostFunction: TypeAlias = Callable[[str, str], float | Fraction]
Whole: TypeAlias = tuple[NDArray[Any], NDArray[Any] | None, int]


@dataclass(frozen=True, eq=False)
class Paid:
    """What a step costs, in doubles: before (C,) by choice, along (E,) by entry of the model's rows, or None.

    parts   the same as given: for each choice in two parts, and for each entry; those that are None cost nothing
    """

    name: str
    before: NDArray[np.float64]
    along: NDArray[np.float64] | None
    parts: tuple[Amounts | None, Amounts | None, Amounts | None]

    @classmethod
    def of(cls, caller: str, model: MDP, cost: str | CostFunction) -> Paid:
        """NameLookupError for a cost that the model does not have; ArgumentError for a bad function or answer."""
        owner = np.repeat(np.arange(model.n_states), np.diff(model.choice_start))
        if not isinstance(cost, str):
            answers = _asked(caller, model, cost, owner)
            return cls._made(getattr(cost, "__name__", "cost"), model.n_choices, None, answers, None)
        columns = {**model.signals, **model.labels}
        if cost in model.costs:
            if cost in columns:
                raise SettingsError(f"{cost} is a cost of the model and a signal or label; rename one of them")
            known: Cost = model.costs[cost]
            states = known.states.at(owner) if known.states is not None else None
            return cls._made(cost, model.n_choices, states, known.choices, known.transitions)
        if cost not in columns:
            raise NameLookupError(
                f"the model has no cost, signal or label {cost}; {near_names(cost, [*model.costs, *columns])}"
            )
        return cls._made(cost, model.n_choices, Amounts(columns[cost].astype(np.float64)[owner]), None, None)

    @classmethod
    def _made(
        cls, name: str, n_choices: int, states: Amounts | None, choices: Amounts | None, along: Amounts | None
    ) -> Paid:
        given = [part.values for part in (states, choices) if part is not None]
        before = sum(given, np.zeros(n_choices))
        return cls(name, before, None if along is None else along.values, (states, choices, along))

    @cached_property
    def exact(self) -> Whole:
        """(before, along, denominator): integers over one denominator, exactly as given."""
        shares = [part.exact if part is not None else None for part in self.parts]
        denominator = math.lcm(*(each.denominator for each in shares if each is not None))
        scaled = [
            each.numerator.astype(object) * (denominator // each.denominator) if each is not None else None
            for each in shares
        ]
        states, choices, along = scaled
        nothing = np.zeros(len(self.before), dtype=object)
        return sum((part for part in (states, choices) if part is not None), nothing), along, denominator

    @property
    def largest(self) -> float:
        """The most that a step can cost, in size."""
        return sum(float(np.abs(part).max(initial=0.0)) for part in self.arrays)

    @property
    def arrays(self) -> list[NDArray[np.float64]]:
        return [self.before] if self.along is None else [self.before, self.along]

    @property
    def nowhere_negative(self) -> bool:
        return all(bool((part >= 0).all()) for part in self.arrays)


def _asked(caller: str, model: MDP, cost: Any, owner: NDArray[np.int64]) -> Amounts:
    """(C,) the answers of a function. ArgumentError unless it is one, and answers with finite numbers."""
    what = "a cost's name, or a function of a state's and an action's name"
    if not callable(cost):
        raise ArgumentError(f"{caller}'s cost is {described(cost)}, not {what}; write, for example, 'energy'")
    answers: list[Fraction] = []
    for s, a in zip(owner.tolist(), model.choice_action.tolist(), strict=True):
        state, action = model.state_name(s), model.action_names[a]
        answer = cost(state, action)
        try:
            answers.append(exact(answer if isinstance(answer, Fraction) else float(answer)))
        except (TypeError, ValueError, OverflowError):  # NumberError is one
            raise ArgumentError(
                f"{caller}'s cost returned {described(answer)} for state {state}, action {action}; return a "
                "finite number"
            ) from None
    return Amounts.of_shares(*over_one(answers))
