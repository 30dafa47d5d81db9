"""How two models differ, states and actions matched by their names.

Of a choice (a state with an action) that both models have, with successor distributions P and P',

    distance = ½ Σ_s |P(s) − P'(s)|        (total variation: no event differs by more)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.display import Card, Displayed, counted, listed
from stltool.models.mdp import MDP
from stltool.models.names import StateLookup

I64: TypeAlias = NDArray[np.int64]

_EQUAL = 1e-12  # by which probabilities that were read from different texts may miss each other
_SHOWN = 4  # names in a sentence


@dataclass(frozen=True, eq=False, repr=False)
class ModelDifferences(Displayed):
    """What differs between a first and a second model.

    states, actions   names in the first only, and in the second only
    signals, labels   name → the number of common states with another value; of a name in one model only, all of them
    choices           of common states: with an action that is available in the first only, and in the second only
    common            choices that both have;  successors  those of them with other possible successors;
                      probabilities  those with the same ones, in other proportions
    distance          the largest distance of a common choice, and `place`, where; None if probabilities are unknown, or
                      are intervals or depend on parameters
    start             the distance of the initial distributions; None if unknown
    """

    names: tuple[str, str]
    states: tuple[tuple[str, ...], tuple[str, ...]]
    actions: tuple[tuple[str, ...], tuple[str, ...]]
    signals: dict[str, int]
    labels: dict[str, int]
    choices: tuple[int, int]
    common: int
    successors: int | None
    probabilities: int | None
    distance: float | None
    place: str | None
    start: float | None

    @property
    def same(self) -> bool:
        """Whether no difference is known."""
        return not self.told

    @property
    def told(self) -> tuple[str, ...]:
        """The differences in words."""
        first, second = self.names
        lines: list[str] = []
        for what, (there, here) in (("state", self.states), ("action", self.actions)):
            for names, model in ((there, first), (here, second)):
                if names:
                    lines.append(f"{counted(len(names), what)} only in {model}: {listed(names, _SHOWN)}")
        for what, counts in (("signal", self.signals), ("label", self.labels)):
            lines += [f"{what} {name} differs in {counted(n, 'common state')}" for name, n in counts.items()]
        for n, model in zip(self.choices, (first, second), strict=True):
            if n:
                lines.append(f"{counted(n, 'choice')} of common states only in {model}")
        if self.successors:
            lines.append(f"{self.successors} of {self.common} common choices have other possible successors")
        if self.probabilities:
            lines.append(f"{self.probabilities} of {self.common} common choices have other probabilities")
        if self.distance is None:
            lines.append("the probabilities are not compared: those of one model are unknown, intervals or parametric")
        elif self.distance > _EQUAL:
            lines.append(f"the largest distance of a choice is {self.distance:.3g}, at {self.place}")
        if self.start is not None and self.start > _EQUAL:
            lines.append(f"the first states differ, by {self.start:.3g}")
        return tuple(lines)

    def _card(self) -> Card:
        first, second = self.names
        return Card(f"ModelDifferences: {first} and {second}", [{"differ": "; ".join(self.told) or "in nothing known"}])


def states_by_name(first: MDP, second: MDP) -> I64:
    """(n_states of the second,): the first's state of the same name, −1 if there is none."""
    if first.state_names is None and second.state_names is None:
        numbers = np.arange(second.n_states)
        return np.where(numbers < first.n_states, numbers, -1)
    lookup, found = StateLookup(first), np.full(second.n_states, -1, dtype=np.int64)
    for s in range(second.n_states):
        there = lookup.find(second.state_name(s))
        found[s] = -1 if there is None else there
    return found


def actions_by_name(first: MDP, second: MDP) -> I64:
    """(n_actions of the second,): the first's action of the same name, −1 if there is none."""
    number = {name: a for a, name in enumerate(first.action_names)}
    return np.array([number.get(name, -1) for name in second.action_names], dtype=np.int64)


def compare(first: MDP, second: MDP) -> ModelDifferences:
    """How the second model differs from the first."""
    state, action = states_by_name(first, second), actions_by_name(first, second)
    shared = np.flatnonzero(state >= 0)
    theirs = np.ones(first.n_states, dtype=np.bool_)
    theirs[state[shared]] = False
    lost = tuple(first.state_name(s) for s in np.flatnonzero(theirs).tolist())
    new = tuple(second.state_name(s) for s in np.flatnonzero(state < 0).tolist())
    actions = tuple(name for name in first.action_names if name not in second.action_names)
    others = tuple(name for name in second.action_names if name not in first.action_names)
    known, known_here = _choices(first), _choices(second)
    # of the second's choices, the code that the first would have: state and action there
    s, a = np.divmod(known_here, second.n_actions)
    both = (state[s] >= 0) & (action[a] >= 0)
    code = np.where(both, state[s] * first.n_actions + action[a], -1)
    common = np.isin(code, known)
    of_common_states = np.isin(known // first.n_actions, state[shared])
    only = (int((of_common_states & ~np.isin(known, code)).sum()), int(((state[s] >= 0) & ~common).sum()))
    successors = probabilities = distance = place = start = None
    if all(m.blackbox is None and not m.uncertain and not m.parameters for m in (first, second)):
        numbers = np.where(state >= 0, state, first.n_states + np.arange(second.n_states))
        apart, moved = _distances(first, second, numbers, code, common)
        successors, probabilities = int(moved.sum()), int((~moved & (apart > _EQUAL)).sum())
        distance = float(apart.max(initial=0.0))
        if len(apart):
            place = second.place(int(np.flatnonzero(common)[apart.argmax()]))
        began = np.zeros(first.n_states + second.n_states)
        began[: first.n_states] = first.initial
        np.subtract.at(began, numbers, second.initial)
        start = float(abs(began).sum() / 2)
    return ModelDifferences(
        (first.name, second.name), (lost, new), (actions, others), _values(first.signals, second.signals, state),
        _values(first.labels, second.labels, state), only, int(common.sum()), successors, probabilities, distance,
        place, start,
    )  # fmt: skip


def _choices(model: MDP) -> I64:
    """state · A + action of each choice."""
    state = np.repeat(np.arange(model.n_states), np.diff(model.choice_start))
    codes: I64 = state * model.n_actions + model.choice_action
    return codes


def _values(first: Any, second: Any, state: I64) -> dict[str, int]:
    shared = np.flatnonzero(state >= 0)
    counts = {}
    for name in dict.fromkeys((*first, *second)):
        if name in first and name in second:
            n = int((first[name][state[shared]] != second[name][shared]).sum())
        else:
            n = len(shared)
        if n:
            counts[name] = n
    return counts


def _distances(
    first: MDP, second: MDP, numbers: I64, code: I64, common: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Of the common choices: how far their distributions are apart, and whether their successors differ."""
    total = first.n_states + second.n_states
    rank = {int(c): i for i, c in enumerate(code[common].tolist())}
    there = np.array([rank.get(c, -1) for c in _choices(first).tolist()], dtype=np.int64)
    here = np.full(len(code), -1, dtype=np.int64)
    here[common] = np.arange(len(rank))
    keys, shares = [], []
    for model, number, targets in ((first, there, np.arange(first.n_states)), (second, here, numbers)):
        owner = np.repeat(number, np.diff(model.row_start))
        used = (owner >= 0) & (model.probability > 0)
        keys.append(owner[used] * total + targets[model.target[used]])
        shares.append(model.probability[used])
    found, place = np.unique(np.concatenate(keys), return_inverse=True)
    p = np.zeros((2, len(found)))
    np.add.at(p[0], place[: len(keys[0])], shares[0])
    np.add.at(p[1], place[len(keys[0]) :], shares[1])
    apart, moved = np.zeros(len(rank)), np.zeros(len(rank), dtype=np.bool_)
    np.add.at(apart, found // total, abs(p[0] - p[1]) / 2)
    moved[found[(p > 0).sum(axis=0) == 1] // total] = True
    return apart, moved
