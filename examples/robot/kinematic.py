"""A plant without physics: wheels follow their commands with a lag, and what is left of their grip moves the robot.

A *plant* is n robots, each on a floor of its own. `ids` select some of them.

    place(ids, pose)                        put them at poses (m, 3) of (x, y, heading), at rest
    pose(ids)                               (m, 3) true poses
    speed(ids)                              (m, 2) speeds of the left and the right wheel in rad/s, as encoders see them
    drive(ids, command, grip, seconds)      hold wheel commands (m, 2) in rad/s; grip (m, 2): what is left of each
                                            tyre's, from 0 to 1
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from examples.robot.floor import HALF, Floor

Floats = NDArray[np.float64]

RADIUS, BASE, WHEEL = 0.16, 0.24, 0.06
"""Of the body, between the wheels, and of a wheel: metres."""
_LAG, _STEP = 0.06, 0.025  # seconds: of a wheel behind its command; of the integration


class Kinematic:
    """n robots in numpy. Walls push a disc out along their normal."""

    def __init__(self, floor: Floor, n: int) -> None:
        self.floor, self.n = floor, n
        self._pose, self._speed = np.zeros((n, 3)), np.zeros((n, 2))

    def place(self, ids: NDArray[np.int64], pose: Floats) -> None:
        self._pose[ids], self._speed[ids] = pose, 0

    def pose(self, ids: NDArray[np.int64]) -> Floats:
        return self._pose[ids]

    def speed(self, ids: NDArray[np.int64]) -> Floats:
        return self._speed[ids]

    def drive(self, ids: NDArray[np.int64], command: Floats, grip: Floats, seconds: float) -> None:
        pose, speed = self._pose[ids], self._speed[ids]
        decay = np.exp(-_STEP / _LAG)
        for _ in range(round(seconds / _STEP)):
            speed = command + (speed - command) * decay
            ground = WHEEL * speed * grip
            v, turn = ground.sum(axis=1) * (_STEP / 2), (ground[:, 1] - ground[:, 0]) * (_STEP / BASE)
            middle = pose[:, 2] + turn / 2
            pose[:, 0] += v * np.cos(middle)
            pose[:, 1] += v * np.sin(middle)
            pose[:, 2] += turn
            self._keep_out(pose[:, :2])
        self._pose[ids], self._speed[ids] = pose, speed

    def _keep_out(self, xy: Floats) -> None:
        np.clip(xy, RADIUS, [self.floor.width - RADIUS, self.floor.height - RADIUS], out=xy)
        x, y = (np.abs(xy[:, i, None] - self.floor.blocks[:, i]) < HALF + RADIUS for i in range(2))
        robot, block = np.nonzero(x & y)
        if not len(robot):
            return
        away = xy[robot] - self.floor.blocks[block]
        gap = away - np.clip(away, -HALF, HALF)
        distance = np.hypot(gap[:, 0], gap[:, 1])
        hit = distance < RADIUS
        near = np.maximum(distance[hit], 1e-9)[:, None]
        np.add.at(xy, robot[hit], gap[hit] / near * (RADIUS - near))
