"""A policy on another model with the same names: what is done there, and how the models differ.

A policy is a function of the step, the model's state and what is remembered of the run. On another model the state is
the one of the same name; what is remembered follows the run there, through its labels and signals, by the policy's own
automaton; and the action is the one of the same name. Where the policy's model has no such state, or the action is not
available, the policy is not defined: PolicyError if runs come there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata import UNDECIDED, TaskAutomaton
from stltool.choices import F64, Form, Indices, distinct
from stltool.display import Card, Displayed
from stltool.errors import PolicyError
from stltool.logic.formula import Formula
from stltool.models import MDP
from stltool.models.compare import ModelDifferences, actions_by_name, compare, states_by_name
from stltool.monitoring.states import truth
from stltool.policy import Binding, Policy, require_door
from stltool.product import JointProduct, Product, joined

I64: TypeAlias = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Transferred:
    """A policy for another product, and how that product's model differs from its own."""

    policy: Policy
    differences: ModelDifferences


def transferred(product: Product, policy: Policy) -> Transferred:
    """`policy` for `product`, whose model has the same state and action names as the policy's.

    Raises PolicyError if it is for another task, or if no state or no action has a name that both models know.
    """
    require_door("transfer", product, policy)
    home = policy.home
    replace(policy.binding, model_digest=Binding.of(product).model_digest).require(product, "the policy")
    there, here = home.model, product.model
    if there.sensing is not None or here.sensing is not None:
        raise PolicyError(
            "a policy over the cells of a black box with real signals cannot be transferred: their states are those of "
            "one task"
        )
    state, action = states_by_name(there, here), actions_by_name(there, here)
    for found, what, names in (
        (state, "state", [there.state_name(0), here.state_name(0)]),
        (action, "action", [there.action_names[0], here.action_names[0]]),
    ):
        if (found < 0).all():
            raise PolicyError(
                f"no {what} of {here.name} has the name of one of {there.name}, the policy's model (there such as "
                f"{names[0]}, here {names[1]}); a policy is transferred by names"
            )
    judge, memory = _remembering(product, home)
    form = Elsewhere(judge, home, policy.form, state, _choices(there, here, state, action), memory)
    return Transferred(Policy(judge, form), compare(there, here))


def _remembering(product: Product, home: Product | JointProduct) -> tuple[Product, I64]:
    """`product`, or its join with the policy's automaton; and that automaton's state in each of its states.

    One past the last: not defined, after a state in which something holds that holds in no state of the policy's model.
    """
    if isinstance(home, Product) and home.automaton.digest() == product.automaton.digest():
        return product, np.arange(product.automaton.n_states)
    atoms = _atoms(home)
    known = {row.tobytes(): letter for row, letter in zip(_truth(atoms, home.model), home.letter.tolist(), strict=True)}
    letter = np.array([known.get(row.tobytes(), -1) for row in _truth(atoms, product.model)], dtype=np.int32)
    if not (letter < 0).any():
        return joined(product, replace(home, model=product.model, letter=letter))
    if isinstance(home, JointProduct):
        s = int(np.flatnonzero(letter < 0)[0])
        raise PolicyError(
            f"what holds in state {product.model.state_name(s)} holds in no state of {home.model.name}, so a policy "
            "for several tasks does not know what to remember there; check it on its own model"
        )
    automaton: TaskAutomaton = home.automaton.with_outcome(UNDECIDED)
    letter[letter < 0] = home.automaton.n_letters
    return joined(product, replace(home, model=product.model, letter=letter, automaton=automaton))


def _atoms(home: Product | JointProduct) -> list[Formula]:
    products = home.tasks if isinstance(home, JointProduct) else (home,)
    return list(dict.fromkeys(psi for one in products for psi in one.automaton.atoms))


def _truth(atoms: list[Formula], model: MDP) -> NDArray[np.bool_]:
    """(n_states, atoms): which atoms hold where."""
    columns = [truth(psi, model.signals, model.labels, model.n_states) for psi in atoms]
    return np.ascontiguousarray(np.stack(columns, axis=1)) if columns else np.zeros((model.n_states, 0), dtype=np.bool_)


def _choices(there: MDP, here: MDP, state: I64, action: I64) -> I64:
    """(n_states here, choices there): the choice here that has the action of a choice there; −1 if there is none."""
    found = np.full((here.n_states, there.most_choices), -1, dtype=np.int64)
    s = np.repeat(np.arange(here.n_states), np.diff(here.choice_start))
    number = np.arange(here.n_choices) - here.choice_start[s]
    a = action[here.choice_action]
    same = np.full((there.n_states, there.n_actions), -1, dtype=np.int64)
    theirs = np.repeat(np.arange(there.n_states), np.diff(there.choice_start))
    same[theirs, there.choice_action] = np.arange(there.n_choices) - there.choice_start[theirs]
    known = (state[s] >= 0) & (a >= 0)
    s, number, a = s[known], number[known], a[known]
    choice = same[state[s], a]
    found[s[choice >= 0], choice[choice >= 0]] = number[choice >= 0]
    return found


class Elsewhere(Displayed):
    """A form of choices (choices.py): those of a policy of another model."""

    def __init__(
        self, product: Product, home: Product | JointProduct, form: Form, state: I64, choice: I64, memory: I64
    ) -> None:
        self._product, self._home, self._form = product, home, form
        self._state, self._choice, self._memory = state, choice, memory

    def _card(self) -> Card:
        return Card(f"Elsewhere: {self._form!r}"[:100])

    @property
    def deterministic(self) -> bool:
        return self._form.deterministic

    @property
    def stationary(self) -> bool:
        return self._form.stationary

    def at(self, t: int, s: Indices, q: Indices) -> NDArray[Any]:
        found, unknown = self._found(t, s, q)
        for i in np.flatnonzero(unknown)[:1].tolist():
            raise PolicyError(self._why(t, int(s[i]), int(q[i])))
        return found

    def row(self, t: int) -> NDArray[Any]:
        """Without an action where the policy is not defined."""
        s, q = np.divmod(np.arange(self._product.n_states), self._product.automaton.n_states)
        found = self._found(t, s, q)[0]
        kind = self._product.model.choice_type if self.deterministic else found.dtype
        return found.reshape(*self._product.shape, *found.shape[1:]).astype(kind, copy=False)

    def alike(self, t: int) -> tuple[int, int]:
        return self._form.alike(t)

    def mixtures(self) -> F64:
        """The weights of the policy itself, over as many choices as states have here."""
        rows, width = self._form.mixtures(), self._product.model.most_choices
        wide = np.zeros((len(rows), max(width, rows.shape[1])))
        wide[:, wide.shape[1] - rows.shape[1] :] = rows  # ascending: zeros first
        return distinct(wide[:, wide.shape[1] - width :])[0]

    def _found(self, t: int, s: Indices, q: Indices) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Choices or weights, and where the policy is not defined, or takes what is not available."""
        there, m = self._state[s], self._memory[q]
        known = (there >= 0) & (m < self._home.automaton.n_states)
        taken = self._form.at(t, there[known], m[known])
        here = self._choice[np.asarray(s)[known]]
        lacking = np.zeros(len(s), dtype=np.bool_)
        found: NDArray[Any]
        if self.deterministic:
            found = np.full(len(s), -1, dtype=np.int64)
            mapped = np.where(taken >= 0, here[np.arange(len(taken)), np.maximum(taken, 0)], -1)
            found[known] = mapped
            lacking[known] = (taken >= 0) & (mapped < 0)
        else:
            found = np.zeros((len(s), self._product.model.most_choices))
            owner, i = np.nonzero(taken)
            mapped = here[owner, i]
            row, fits = np.flatnonzero(known)[owner], mapped >= 0
            found[row[fits], mapped[fits]] = taken[owner[fits], i[fits]]
            lacking[row[~fits]] = True
        return found, ~known | lacking

    def _why(self, t: int, s: int, q: int) -> str:
        product, home = self._product, self._home
        place = product.describe(s * product.automaton.n_states + q, t)
        there, m = int(self._state[s]), int(self._memory[q])
        if there < 0:
            return f"the policy knows no state {product.model.state_name(s)}, which runs under it reach at step {t}"
        if m >= home.automaton.n_states:
            return (
                f"the policy does not know what to remember at step {t} in state {product.model.state_name(s)}: what "
                f"holds there, or did before, holds in no state of its model, {home.model.name}"
            )
        taken = self._form.at(t, np.array([there]), np.array([m]))[0]
        used = np.flatnonzero(taken) if taken.ndim else np.array([int(taken)])
        i = int(used[self._choice[s][used] < 0][0])
        action = home.model.action_names[home.model.choice_action[home.model.choice_start[there] + i]]
        return f"the policy takes {action} at {place}, where this model does not have it"
