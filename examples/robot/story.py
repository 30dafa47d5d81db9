"""Learn from the robots, promise by fresh runs, and compare with what models predict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import stltool as stl
from examples.robot.controller import Plant, Robots
from examples.robot.fleet import Fleet, black_box
from examples.robot.floor import FACTORY, Floor
from examples.robot.kinematic import Floats
from examples.robot.walk import Walk, by_action_before, by_heading, predicted, random_walk, table

MakePlant = Callable[[int], Plant]
"""From a number of robots to a plant of so many."""


@dataclass(frozen=True, eq=False)
class Judged:
    """A policy, what each model says of it, and what fresh runs of the robots show."""

    name: str
    policy: stl.Policy
    nominal: float
    cells: float
    headings: float
    runs: stl.Estimate


@dataclass(frozen=True, eq=False)
class Story:
    """All that `make robot` shows. `tests` are Markov tests, by what they ask; `track` (n, 3) poses of one run."""

    product: stl.Product
    walk: Walk
    never: tuple[int, int]
    tests: dict[str, stl.MarkovTest]
    training: stl.Training
    judged: tuple[Judged, ...]
    promise: stl.Estimate
    track: Floats
    satisfied: bool

    @property
    def success(self) -> float:
        """The share of moves towards another cell that ended there."""
        moves = self.walk.goal != self.walk.cell
        return float((self.walk.next_cell == self.walk.goal)[moves].mean())


def patrolling(window: int) -> stl.Task:
    """The paper's task: at any moment of the shift, visit A and B within `window` moves each."""
    return stl.load_task(FACTORY / "patrolling.stl", params={"T": window, "tau": window})


def story(
    floor: Floor,
    make_plant: MakePlant,
    *,
    window: int,
    robots: int,
    moves: int,
    episodes: int,
    runs: int,
    seed: int = 0,
    told: Callable[[str], None] = lambda text: None,
) -> Story:
    """See the module's text.

    robots    that move side by side;  moves of the random walk, all robots together
    episodes  of learning;  runs: fresh ones for each policy
    told      receives a line about each part that begins
    """
    task = patrolling(window)
    product = stl.build_product(black_box(floor, lambda: make_plant(robots)), task)
    walks, actions = (np.random.default_rng([seed, part]) for part in (0, 1))
    told(f"a random walk of {moves} moves")
    walk = random_walk(Fleet(make_plant(robots), walks), actions, max(1, moves // robots))
    told("tests of the Markov assumption")
    tests = {
        "the cell, given the heading": stl.markov_test(by_heading(walk), seed=seed),
        "the cell, given the action before": stl.markov_test(by_action_before(walk), seed=seed),
        "cell and heading, given the action before": stl.markov_test(by_action_before(walk, heading=True), seed=seed),
    }
    (cells, never_cells), (headings, never_headings) = table(walk), table(walk, heading=True)
    told(f"learning: {episodes} episodes")
    training = stl.learn(product, "model-based", episodes=episodes, evaluate_every=episodes, seed=seed)
    policies = {
        "optimum of the nominal model": stl.check(stl.build_product(floor.nominal, task)).policy,
        "optimum of the table of cells": stl.check(stl.build_product(cells, task)).policy,
        "learned on the robots": training.policy,
    }
    judged = []
    for name, policy in policies.items():
        told(f"{runs} fresh runs: {name}")
        complete = stl.Policy(product, np.maximum(policy.table, 0))  # where no run of the model led: stay
        fresh = stl.estimate(product, complete, runs=runs, seed=seed)
        judged.append(
            Judged(
                name, complete, predicted(complete, floor.nominal), predicted(complete, cells),
                predicted(complete, headings), fresh,
            )
        )  # fmt: skip
    learned = judged[-1]
    told("a run of the learned policy")
    track, satisfied = run_of(product, learned.policy, make_plant(1), seed)
    return Story(
        product, walk, (never_cells, never_headings), tests, training, tuple(judged), learned.runs, track, satisfied
    )


def run_of(product: stl.Product, policy: stl.Policy, plant: Plant, seed: int) -> tuple[Floats, bool]:
    """The poses (n, 3) of one robot under a policy, twenty a second, until the task is decided, and its verdict."""
    robots, only = Robots(plant, np.random.default_rng([seed, 2])), np.array([0])
    robots.place(only, robots.floor.start)
    track: list[Floats] = [plant.pose(only)]
    runner = stl.Runner(product, policy)
    while (action := runner.act(int(robots.cells(only)[0]))) is not None:
        robots.move(only, np.array([product.model.action_names.index(action)]), track)
    return np.concatenate(track), bool(runner.verdict)
