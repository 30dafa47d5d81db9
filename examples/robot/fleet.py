"""Robots as a black box: stltool resets them, steps them, and sees cells, nothing else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import stltool as stl
from examples.robot.controller import NOISE, Noise, Plant, Robots
from examples.robot.floor import Floor


class Fleet:
    """As many robots as the plant has, side by side (`stltool.models.environment.Batched`)."""

    def __init__(self, plant: Plant, rng: np.random.Generator, noise: Noise = NOISE) -> None:
        self.robots = Robots(plant, rng, noise)
        self.batch, self.generator = plant.n, rng

    def reset(self, n: int) -> NDArray[np.int64]:
        """The first n robots begin again in the start cell, heading east."""
        self._ids = np.arange(n)
        self.robots.place(self._ids, self.robots.floor.start)
        return self.robots.cells(self._ids)

    def step(self, actions: NDArray[np.int64]) -> NDArray[np.int64]:
        """One move of each robot; those with action −1 rest."""
        live = np.flatnonzero(np.asarray(actions) >= 0)
        self.robots.move(self._ids[live], np.asarray(actions)[live])
        return self.robots.cells(self._ids)


def black_box(floor: Floor, make_plant: Callable[[], Plant], noise: Noise = NOISE) -> stl.MDP:
    """An MDP whose states are the cells, labels and signals those of the nominal model, and probabilities unknown."""
    nominal = floor.nominal
    return stl.MDP.black_box(
        nominal.n_states, nominal.action_names, lambda rng: Fleet(make_plant(), rng, noise), signals=nominal.signals,
        labels=nominal.labels, state_names=[nominal.state_name(s) for s in range(nominal.n_states)], name="robot",
    )  # fmt: skip
