"""Gymnasium environments with discrete actions → MDP; the way back is stltool/envs.

    stl.from_gymnasium(gymnasium.make("FrozenLake-v1"), labels={"goal": {15}})

Toy-text environments list their transitions, P[s][a] = [(probability, next state, reward, terminated), …]; these become
exact MDPs. All others become black boxes (`MDP.black_box`), which the adapter below resets and steps.

After `terminated`, a run stays in its last state, both in the table (an absorbing row) and in a black box, so windows
that extend past the end read that state. An observation that occurs both during an episode and at its end (a hand in
Blackjack after sticking) is not a state of an MDP: `ends="apart"` doubles the states, S + s being s after the end.

Each episode is seeded with one number drawn from the run's generator, env.reset(seed=…), so that generator is the only
state kept between episodes.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described, flag, mapping, one_of, texts
from stltool.arguments import require as require_kind
from stltool.display import StateNames
from stltool.errors import ModelError, SettingsError
from stltool.extras import require
from stltool.models.environment import BlackBox, Environment
from stltool.models.gymnasium.episodes import Episodes, Shared
from stltool.models.gymnasium.spaces import (
    LabelGiven,
    Observations,
    SignalGiven,
    actions_of,
    env_name,
    observation_text,
)
from stltool.models.gymnasium.table import read_table, without_table
from stltool.models.mdp import MDP
from stltool.models.normalize import NOTHING
from stltool.models.sensing import CELLS, Sensing
from stltool.sizes import require_memory

if TYPE_CHECKING:
    from stltool.models.gymnasium.cells import Sensor

CellsGiven: TypeAlias = Mapping[str, Any] | Callable[[Any], int]


def require_gymnasium() -> Any:
    """The gymnasium package; MissingExtraError, with the command to install it, if it is missing."""
    return require("gymnasium", "a Gymnasium environment")


def from_gymnasium(
    env: Any,
    labels: Mapping[str, LabelGiven] | None = None,
    signals: Mapping[str, SignalGiven] | None = None,
    *,
    table: bool | Literal["auto"] = "auto",
    ends: Literal["merged", "apart"] = "merged",
    name: str | None = None,
    action_names: Sequence[str] | None = None,
    normalize: bool = False,
    cells: CellsGiven | None = None,
    n_cells: int | None = None,
) -> MDP:
    """The MDP of a Gymnasium environment with S observations and A actions, in the order of its spaces.

    labels     name → function of an observation, returning a Boolean; or the observations where it holds; or S Booleans
    signals    name → function of an observation, returning a real; or S reals
    table      "auto": the exact MDP if the environment lists its transitions, else a black box; True: the exact MDP or
               an error; False: a black box, the table is not read
    ends       "merged": no run continues from a state in which another ends, else a ModelError; "apart": 2·S states,
               S + s for runs that have ended at observation s
    action_names   A names (default: the numbers of the actions)
    normalize  rescale rows of the table that miss a sum of 1 by at most 1/1000, so that they sum to 1 exactly: thirds
               given as 0.333… become 1/3 (models/normalize.py); `notes` of the model reports what changed

    cells      for observations that are not finitely many, or too many: what a learner's table is indexed by. Signal →
               edges between cells, ascending, or the width of cells of a signal with bounds; or a function of an
               observation that returns a cell's number, below `n_cells`

    An observation is an integer for `Discrete` (from its `start`), and a tuple of all components in order for `Tuple`,
    `Dict`, `MultiDiscrete`, `MultiBinary` and `Box` of integers. With `cells` the model is a black box, and signals are
    functions of the real observation, or numbers of its components; labels are functions of it. Tasks are read from
    these (stltool/models/sensing.py), not from cells. A label may also be the text "info.KEY", the truth of what `info`
    has under that key, or `stltool.models.gymnasium.cells.OfStep`, a function of the step.

    A vector environment (`gymnasium.make_vec`) is a black box that takes as many runs at once as it has environments.
    A black box shares `env`: one run at a time, or one batch. Raises ModelError, naming the space or the row, if
    environment, labels or signals do not fit, if `table=True` and there is no table, or if the environment deviates
    from its table: it is reset and stepped up to 2000 times to check this.
    """
    require_gymnasium()
    if not isinstance(table, bool) and not (isinstance(table, str) and table == "auto"):
        raise SettingsError(f'table is {described(table)}; choose "auto", True or False')
    one_of(ends, "ends", ("merged", "apart"))
    normalize = flag(normalize, "normalize")
    labels = mapping(labels, "from_gymnasium's labels", "{'goal': {15}}", optional=True)
    signals = mapping(signals, "from_gymnasium's signals", "{'x': [0.0, 0.5]}", optional=True)
    require_kind(name, str, "from_gymnasium's name", optional=True)
    if action_names is not None:
        action_names = texts(action_names, "from_gymnasium's action_names")
    title = env_name(env)
    from stltool.models.gymnasium.cells import of_step  # gymnasium is slow to load
    from stltool.models.gymnasium.vector import Single, Vectors, is_vector

    vector = is_vector(env)
    if vector and (cells is not None or any(map(of_step, labels.values()))):
        raise SettingsError(
            f"{title} is a vector environment, whose runs are read by their observations alone; give one of its "
            "environments for cells and labels of steps"
        )
    if vector and table is True:
        raise ModelError(f"{title} is a vector environment, which has no table; give one of its environments")
    if cells is not None or any(map(of_step, labels.values())):
        return _sensed(env, labels, signals, table, name or title, action_names, cells, n_cells)
    if n_cells is not None:
        raise SettingsError("n_cells is the number of cells of a function; give cells, too, or leave it out")
    one: Any = Single(env) if vector else env
    observations = Observations.of(one)
    first_action, n_actions = actions_of(one, title)
    apart = ends == "apart"
    size = observations.n_states * (2 if apart else 1)
    columns = len(labels) + len(signals)
    require_memory(
        size * (40 + 8 * columns + 20 * n_actions), f"{title} with {size} observations", "make its spaces smaller"
    )
    if action_names is None:
        action_names = [str(first_action + a) for a in range(n_actions)]
    names = StateNames(size, functools.partial(_state_name, observations))
    facts: dict[str, Any] = {
        "labels": {key: _twice(observations.label(key, given), apart) for key, given in labels.items()},
        "signals": {key: _twice(observations.signal(key, given), apart) for key, given in signals.items()},
        "state_names": names,
        "name": name if name is not None else title,
    }
    if len(action_names) != n_actions:
        raise ModelError(f"{title}: {len(action_names)} action names for {n_actions} actions")
    missing = without_table(env, title, observations, first_action, n_actions) if not vector else "several at once"
    if table is True and missing:
        raise ModelError(f"{missing}; use table=False (learn and estimate do not need a table)")
    if table is not False and not missing:
        matrices, initial = read_table(env, title, observations, n_actions, apart, normalize)
        return MDP.from_arrays(matrices, initial=initial, action_names=action_names, normalize=normalize, **facts)
    text = lambda s: str(observations.observation(s))  # noqa: E731
    shared = Shared(
        env, title, observations.space, observations.index, text, observations.n_states, first_action, apart
    )

    def episodes(rng: np.random.Generator, steps: int | None) -> BlackBox:
        if vector:
            return Vectors(shared, observations, rng, steps)
        adapter = Episodes(shared, rng, steps)
        return Environment(adapter.reset, adapter.step, rng)

    model = MDP.black_box(size, list(action_names), lambda rng: episodes(rng, None), **facts)
    return replace(model, blackbox=episodes, notes={"normalize": NOTHING.format("unknown")} if normalize else {})


def _sensed(
    env: Any,
    labels: Mapping[str, Any],
    signals: Mapping[str, Any],
    table: bool | str,
    name: str,
    action_names: Sequence[str] | None,
    cells: CellsGiven | None,
    n_cells: int | None,
) -> MDP:
    """A black box whose states are cells, once where runs go on, and once where they have ended."""
    from stltool.models.gymnasium.cells import Senses, Sensor

    if table is True:
        raise SettingsError("a model of cells has no table; leave table=True out, or cells and labels of steps")
    senses = Senses.of(env, signals, labels, cells, n_cells)
    title, n = senses.title, senses.cells.n
    first_action, n_actions = actions_of(env, title)
    if action_names is None:
        action_names = [str(first_action + a) for a in range(n_actions)]
    if len(action_names) != n_actions:
        raise ModelError(f"{title}: {len(action_names)} action names for {n_actions} actions")
    shared = Shared(env, title, senses.space, lambda _: -1, senses.cells.name, n, first_action, apart=True)

    def begin(rng: np.random.Generator, steps: int | None) -> Sensor:
        return Sensor(shared, senses, rng, steps)

    def episodes(rng: np.random.Generator, steps: int | None) -> Environment:
        sensor = begin(rng, steps)
        return Environment(sensor.reset, sensor.step, rng)

    def cell_name(s: int) -> str:
        ended, cell = divmod(s, n)
        return senses.cells.name(cell) + (", ended" if ended else "")

    model = MDP.black_box(2 * n, list(action_names), lambda rng: episodes(rng, None), name=name)
    sensing = Sensing(tuple(signals), tuple(labels), begin, senses.space)
    return replace(
        model, blackbox=episodes, state_names=StateNames(2 * n, cell_name), sensing=sensing, notes={"cells": CELLS}
    )


def _state_name(observations: Observations, s: int) -> str:
    ended, s = divmod(s, observations.n_states)
    return observation_text(observations.observation(s)) + (" ended" if ended else "")


def _twice(column: NDArray[Any], apart: bool) -> NDArray[Any]:
    return np.tile(column, 2) if apart else column
