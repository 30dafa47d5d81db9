"""Black boxes whose signals are real: predicates are read where the box is, and learners index their tables by cells.

A cell is a set of observations, by which a learner tells where it is; a task's predicates may be true in one part of it
and false in another. So when a task is bound (stltool/product.py), a state becomes a cell *and* the truth of the task's
k atoms there,

    state = cell · 2^k + Σ_i 2^i · [atom i holds],

and the letter of a state is exact, however coarse the cells. What is not exact: that a run goes on from a state in the
same way wherever in its cell it is. Verdicts, and with them bounds from fresh runs, do not depend on that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from stltool.display import StateNames
from stltool.errors import SettingsError, SizeError
from stltool.models.environment import Environment
from stltool.sizes import require_numbered

if TYPE_CHECKING:
    from stltool.models.mdp import MDP

CELLS = (
    "states are cells of what is observed: the task is read from the real signals, so verdicts and bounds from fresh "
    "runs are exact, but runs may go on differently within a cell, so what is concluded from counted transitions takes "
    "cells for states"
)
ALIKE = "that runs go on alike wherever in a cell they are"
_MOST_ATOMS = 16


class Atom(NamedTuple):
    """A Boolean formula that a task reads: its text, its truth given signals and labels, its name if it is a label."""

    text: str
    holds: Callable[[Mapping[str, float], Mapping[str, bool]], bool]
    label: str | None


class Sensor(Protocol):
    """A run of the black box: `reset()` and `step(i)` return a cell; then, what is sensed there."""

    @property
    def signals(self) -> Mapping[str, float]: ...
    @property
    def labels(self) -> Mapping[str, bool]: ...
    @property
    def observation(self) -> object: ...
    def reset(self) -> int: ...
    def step(self, action: int, /) -> int: ...


@dataclass(frozen=True, eq=False)
class Sensing:
    """What a black box senses at each step: the names of signals and labels; `begin` as `MDP.blackbox`, a sensor.

    space   of the environment's own observations

    atoms   once a task is bound, its atoms
    """

    signals: tuple[str, ...]
    labels: tuple[str, ...]
    begin: Callable[[np.random.Generator, int | None], Sensor]
    space: object
    atoms: tuple[Atom, ...] | None = None

    def bound(self, model: MDP, atoms: Sequence[Atom]) -> tuple[MDP, NDArray[np.bool_], NDArray[np.int32]]:
        """The model over states that decide the atoms; the valuations (2^k, k), and which one each state has (n,).

        SettingsError if a task is bound already; SizeError if there would be too many states.
        """
        if self.atoms is not None:
            raise SettingsError(
                f"the states of {model.name} are those of one task, as its predicates are read from real signals; "
                "build the product from the model as it was loaded"
            )
        k, cells = len(atoms), model.n_states
        if k > _MOST_ATOMS:
            raise SizeError(f"a task with {k} predicates on real signals; at most {_MOST_ATOMS} can be told apart")
        n = cells << k
        require_numbered(n, "states: cells and what holds there", "use fewer cells")
        valuations = (np.arange(1 << k)[:, None] >> np.arange(k)) & 1 == 1
        which = np.tile(np.arange(1 << k, dtype=np.int32), cells)
        held = replace(self, atoms=tuple(atoms))

        def name(s: int) -> str:
            cell, code = divmod(s, 1 << k)
            return ", ".join([model.state_name(cell), *(atom.text for i, atom in enumerate(atoms) if code >> i & 1)])

        made = type(model).black_box(
            n,
            model.action_names,
            lambda rng: held.environment(rng, None),
            labels={atom.label: valuations[which, i] for i, atom in enumerate(atoms) if atom.label is not None},
            name=model.name,
        )
        return (
            replace(made, blackbox=held.environment, state_names=StateNames(n, name), sensing=held, notes=model.notes),
            valuations,
            which,
        )

    def environment(self, rng: np.random.Generator, steps: int | None) -> Environment:
        """The states of a bound task as the black box goes through them."""
        sensor, atoms = self.begin(rng, steps), self.atoms
        assert atoms is not None

        def state(cell: int) -> int:
            code = sum(atom.holds(sensor.signals, sensor.labels) << i for i, atom in enumerate(atoms))
            return (cell << len(atoms)) + code

        step = lambda i: state(sensor.step(i))  # noqa: E731
        return Environment(lambda: state(sensor.reset()), step, rng, observed=lambda: sensor.observation)
