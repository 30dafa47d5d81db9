"""Random walks of the robots, and the tables that they fill."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import stltool as stl
from examples.robot.fleet import Fleet
from examples.robot.floor import Floor

SECTORS = 8
"""Headings are told apart to within 45°; sector 0 is centred on east."""

Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Walk:
    """Moves of random walks, each array (n,): the cell and heading sector before and after, the action, and 1 + the
    action before it, 0 for the first move after a reset."""

    floor: Floor
    cell: Ints
    sector: Ints
    action: Ints
    before: Ints
    next_cell: Ints
    next_sector: Ints

    def __len__(self) -> int:
        return len(self.cell)

    @property
    def goal(self) -> Ints:
        """The cell at which each move aimed."""
        return self.floor.target[self.cell, self.action]


def random_walk(fleet: Fleet, rng: np.random.Generator, moves: int, every: int = 18) -> Walk:
    """All robots of a fleet make so many moves at random, beginning again after `every` moves."""
    n, rows = fleet.batch, []
    for k in range(moves):
        if k % every == 0:
            cell, before = fleet.reset(n), np.zeros(n, dtype=np.int64)
            sector = sectors(fleet)
        action = rng.integers(0, len(fleet.robots.floor.nominal.action_names), n)
        after = fleet.step(action)
        rows.append([cell, sector, action, before, after, sectors(fleet)])
        cell, sector, before = after, rows[-1][-1], action + 1
    return Walk(fleet.robots.floor, *(np.concatenate(column) for column in zip(*rows, strict=True)))


def sectors(fleet: Fleet) -> Ints:
    """(n,): the heading sector of each robot of a fleet."""
    heading = fleet.robots.plant.pose(np.arange(fleet.batch))[:, 2]
    return np.round(heading / (2 * np.pi / SECTORS)).astype(np.int64) % SECTORS


# ------------------------------------------------------------------------------------------------------ is it Markov?


def by_heading(walk: Walk) -> stl.Counts:
    """Is the cell a state? Choices are (cell, action), contexts are headings."""
    floor = walk.floor.nominal
    counts = stl.Counts(floor.n_choices, floor.n_states, SECTORS)
    counts.add(walk.cell * len(floor.action_names) + walk.action, walk.next_cell, walk.sector)
    return counts


def by_action_before(walk: Walk, heading: bool = False) -> stl.Counts:
    """Is the cell a state, or the cell with a heading? Contexts are the actions before."""
    floor = walk.floor.nominal
    actions, kinds = len(floor.action_names), SECTORS if heading else 1
    state = walk.cell * SECTORS + walk.sector if heading else walk.cell
    counts = stl.Counts(floor.n_choices * kinds, floor.n_states, actions + 1)
    counts.add(state * actions + walk.action, walk.next_cell, walk.before)
    return counts


# ------------------------------------------------------------------------------------------------------------ tables


def table(walk: Walk, heading: bool = False) -> tuple[stl.MDP, int]:
    """The model that the relative frequencies of a walk are, and how many of its choices were never tried: those stay
    where they are. States are cells, or cells × heading sectors."""
    nominal, kinds = walk.floor.nominal, SECTORS if heading else 1
    S, A = nominal.n_states * kinds, len(nominal.action_names)
    here = walk.cell * kinds + walk.sector * heading
    there = walk.next_cell * kinds + walk.next_sector * heading
    seen = np.zeros((A, S, S))
    np.add.at(seen, (walk.action, here, there), 1)
    never = seen.sum(axis=2) == 0
    action, state = np.nonzero(never)
    seen[action, state, state] = 1
    model = stl.MDP.from_arrays(
        seen / seen.sum(axis=2, keepdims=True),
        {name: np.repeat(values, kinds) for name, values in nominal.signals.items()},
        initial=walk.floor.start * kinds,
        labels={name: np.repeat(values, kinds) for name, values in nominal.labels.items()},
        action_names=nominal.action_names,
        name="table of cells and headings" if heading else "table of cells",
    )
    return model, int(never.sum())


def predicted(policy: stl.Policy, model: stl.MDP) -> float:
    """What a table says of a policy over cells."""
    product = stl.build_product(model, policy.home.formula)
    kinds = model.n_states // policy.home.model.n_states
    return stl.check(product, stl.Policy(product, np.repeat(policy.table, kinds, axis=-2))).probability
