"""The nine moves, as a low-level controller drives them: turn towards the centre of the cell aimed at, go there, stop.

A move takes `MOVE` seconds whatever happens, so steps of the task last equally long. It fails because the position is
measured only now and then, with noise, and reckoned from the wheels in between; because wheels are not equal; because a
tyre loses its grip at times, and on oil; and because the time runs out, the sooner the farther the robot has to turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from examples.robot.floor import Floor
from examples.robot.kinematic import BASE, WHEEL, Floats

MOVE, TICK, FIX = 3.0, 0.05, 0.5
"""Seconds: of a move, between two commands to the wheels, between two measured positions."""
_SPEED, _TURN, _FASTEST = 0.7, 3.0, 15.0  # m/s, rad/s, and rad/s of a wheel


class Plant(Protocol):
    """Robots that can be driven: see kinematic.py."""

    floor: Floor
    n: int

    def place(self, ids: NDArray[np.int64], pose: Floats) -> None: ...
    def pose(self, ids: NDArray[np.int64]) -> Floats: ...
    def speed(self, ids: NDArray[np.int64]) -> Floats: ...
    def drive(self, ids: NDArray[np.int64], command: Floats, grip: Floats, seconds: float) -> None: ...


@dataclass(frozen=True)
class Noise:
    """Standard deviations and probabilities; `Noise.none()` is a robot that does as it is told.

    position, heading   of a measured pose, metres and radians
    gain                of each wheel relative to its command, drawn for every move
    slip                probability that one tyre loses its grip in a move, for some of `slips_for` seconds
    oil                 probability that a tyre does so when it touches oil
    grip                what is then left of it; above 0, or MuJoCo's contacts are unstable
    """

    position: float = 0.04
    heading: float = 0.05
    gain: float = 0.06
    slip: float = 0.2
    oil: float = 0.6
    grip: float = 0.05
    slips_for: tuple[float, float] = (1.0, 3.0)

    @classmethod
    def none(cls) -> Noise:
        return cls(position=0, heading=0, gain=0, slip=0, oil=0)


NOISE = Noise()


class Robots:
    """The robots of a plant, and one move at a time of some of them."""

    def __init__(self, plant: Plant, rng: np.random.Generator, noise: Noise = NOISE) -> None:
        self.plant, self.floor, self.rng, self.noise = plant, plant.floor, rng, noise

    def place(self, ids: NDArray[np.int64], cell: int | NDArray[np.int64], heading: float | Floats = 0.0) -> None:
        """Put robots into the centres of cells, at rest; a heading of 0 is east."""
        pose = np.zeros((len(ids), 3))
        pose[:, :2], pose[:, 2] = self.floor.centres[cell], heading
        self.plant.place(ids, pose)

    def cells(self, ids: NDArray[np.int64]) -> NDArray[np.int64]:
        return self.floor.cells(self.plant.pose(ids)[:, :2])

    def move(self, ids: NDArray[np.int64], actions: NDArray[np.int64], track: list[Floats] | None = None) -> None:
        """Each of the robots makes the move of that number; `track` receives their poses after every tick."""
        noise, rng, n = self.noise, self.rng, len(ids)
        goal = self.floor.centres[self.floor.target[self.cells(ids), actions]]
        gain = 1 + noise.gain * rng.standard_normal((n, 2))
        begin = rng.uniform(0, 0.6 * MOVE, (n, 2))  # of a slip, for each tyre
        begin[np.arange(n), rng.integers(0, 2, n)] = np.inf
        begin[rng.random(n) >= noise.slip] = np.inf
        lasts = rng.uniform(*noise.slips_for, (n, 2))
        slippery = rng.random((n, 2)) < noise.oil
        belief = np.empty((n, 3))
        there = np.zeros(n, dtype=np.bool_)
        for tick in range(round(MOVE / TICK)):
            true = self.plant.pose(ids)
            if tick % round(FIX / TICK) == 0:
                belief = true + rng.standard_normal((n, 3)) * [noise.position, noise.position, noise.heading]
            command, there = _towards(goal, belief, there)
            now = tick * TICK
            begin[(begin > now) & slippery & self.floor.oily(_tyres(true))] = now
            grip = np.where((begin <= now) & (now < begin + lasts), noise.grip, 1.0)
            self.plant.drive(ids, command * gain, grip, TICK)
            _reckon(belief, WHEEL * self.plant.speed(ids))
            if track is not None:
                track.append(self.plant.pose(ids))


def _towards(goal: Floats, belief: Floats, there: NDArray[np.bool_]) -> tuple[Floats, NDArray[np.bool_]]:
    """Commands (n, 2) to the wheels, and which robots believe that they have arrived.

    Arrived is who comes within 6 cm of the goal, until 15 cm away from it again.
    """
    to = goal - belief[:, :2]
    distance = np.hypot(to[:, 0], to[:, 1])
    there = distance < np.where(there, 0.15, 0.06)
    ahead = wrapped(np.arctan2(to[:, 1], to[:, 0]) - belief[:, 2])
    turn = np.where(there, 0, np.clip(4 * ahead, -_TURN, _TURN))
    forward = np.where(there | (np.abs(ahead) > 0.5), 0, np.minimum(_SPEED, 2 * distance) * np.cos(ahead))
    command = np.stack([forward - turn * (BASE / 2), forward + turn * (BASE / 2)], axis=1) / WHEEL
    return np.clip(command, -_FASTEST, _FASTEST), there


def _reckon(belief: Floats, rolled: Floats) -> None:
    """Move a believed pose by what the wheels rolled, in m/s, as if they had not slipped."""
    v, turn = rolled.sum(axis=1) * (TICK / 2), (rolled[:, 1] - rolled[:, 0]) * (TICK / BASE)
    middle = belief[:, 2] + turn / 2
    belief[:, 0] += v * np.cos(middle)
    belief[:, 1] += v * np.sin(middle)
    belief[:, 2] += turn


def _tyres(pose: Floats) -> Floats:
    """(n, 2, 2): where the left and the right tyre touch the floor."""
    across = np.stack([-np.sin(pose[:, 2]), np.cos(pose[:, 2])], axis=1) * (BASE / 2)
    return np.stack([pose[:, :2] + across, pose[:, :2] - across], axis=1)


def wrapped(angle: Floats) -> Floats:
    """The same angle in [−π, π)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
