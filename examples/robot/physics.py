"""The same robots in MuJoCo: bodies, motors, contacts and friction. `pip install 'stltool[robot]'`.

Motors are weak on purpose: strong ones make blocked tyres spin, and results then depend on the time step. Of two tyres
and the floor, the tyre's friction counts (`priority`), so a slipping one slips whatever the floor is like. Walls touch
the chassis only, or tyres would climb them.
"""

from __future__ import annotations

import os

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from examples.robot.floor import HALF, Floor
from examples.robot.kinematic import BASE, RADIUS, WHEEL, Floats

TIMESTEP = 0.01  # seconds; half of it changes rates of success by less than what a few hundred moves can tell

_FARTHEST = 3.0
"""Metres a second. MuJoCo resets a simulation that becomes unstable, once in some ten thousand moves, which puts its
robot into a corner. A robot that seems to be faster than this goes on from where it was, at rest."""

_COLOURS = {"A": ".25 .45 .85 1", "B": ".85 .3 .25 1", "C": ".3 .7 .35 1"}


def mjcf(floor: Floor, timestep: float = TIMESTEP) -> str:
    """The floor and one robot, in MuJoCo's XML."""
    w, h = floor.width, floor.height
    boxes = [(x, y, HALF, HALF) for x, y in floor.blocks]
    boxes += [(w / 2, -0.05, w / 2 + 0.1, 0.05), (w / 2, h + 0.05, w / 2 + 0.1, 0.05)]
    boxes += [(-0.05, h / 2, 0.05, h / 2), (w + 0.05, h / 2, 0.05, h / 2)]
    walls = "".join(f'<geom class="wall" pos="{x} {y} .12" size="{a} {b} .12"/>' for x, y, a, b in boxes)
    paint = "".join(
        f'<geom class="paint" type="box" pos="{x} {y} .001" size=".5 .5 .001" rgba="{_COLOURS[name]}"/>'
        for name, cells in floor.nominal.labels.items()
        for x, y in floor.centres[cells]
        if name in _COLOURS
    )
    oil = "".join(
        f'<geom class="paint" type="cylinder" pos="{patch.x} {patch.y} .002" size="{patch.radius} .001" '
        'rgba=".12 .1 .08 .85"/>'
        for patch in floor.oil
    )
    wheels = "".join(
        f'<body name="{name}" pos="0 {y} {WHEEL}"><joint name="{name}" axis="0 1 0" damping=".002"/>'
        f'<geom name="{name}" type="sphere" size="{WHEEL}" mass=".2" friction="1 .005 .0001" priority="1" '
        'rgba=".1 .1 .1 1"/></body>'
        for name, y in (("left", BASE / 2), ("right", -BASE / 2))
    )
    caster = 'type="sphere" size=".02" mass=".05" friction=".001 0 0" condim="1" priority="1"'
    motor = 'kv=".2" ctrlrange="-15 15" forcerange="-.45 .45"'
    return f"""<mujoco model="factory">
  <option timestep="{timestep}" integrator="implicitfast"><flag eulerdamp="disable"/></option>
  <visual><global offwidth="960" offheight="960"/><headlight ambient=".5 .5 .5"/></visual>
  <default>
    <default class="wall"><geom type="box" rgba=".45 .45 .48 1" friction=".1" contype="2" conaffinity="2"/></default>
    <default class="paint"><geom contype="0" conaffinity="0"/></default>
  </default>
  <worldbody>
    <light pos="{w / 2} {h / 2} 6" diffuse=".25 .25 .25" specular="0 0 0" castshadow="false"/>
    <geom name="floor" type="plane" size="{w / 2} {h / 2} .1" pos="{w / 2} {h / 2} 0" rgba=".6 .6 .58 1"
      friction="1 .005 .0001"/>
    {paint}{oil}{walls}
    <body name="robot"><freejoint name="robot"/>
      <geom type="cylinder" size="{RADIUS} .05" pos="0 0 .09" mass="3" friction=".1" contype="2" conaffinity="2"
        rgba=".95 .75 .2 1"/>
      <geom class="paint" type="box" size=".04 .015 .01" pos=".1 0 .15" mass=".01" rgba=".1 .1 .1 1"/>
      <geom pos=".12 0 .02" {caster}/><geom pos="-.12 0 .02" {caster}/>
      {wheels}
    </body>
  </worldbody>
  <actuator><velocity name="left" joint="left" {motor}/><velocity name="right" joint="right" {motor}/></actuator>
</mujoco>"""


class Physics:
    """n simulations of one robot each (see kinematic.py for what a plant is)."""

    def __init__(self, floor: Floor, n: int, timestep: float = TIMESTEP, threads: int | None = None) -> None:
        self.floor, self.n, self._timestep = floor, n, timestep
        self.model = mujoco.MjModel.from_xml_string(mjcf(floor, timestep))
        self._tyres = [self.model.geom(name).id for name in ("left", "right")]
        self.batch = Batch(self.model, nsim=n, nthread=threads or os.cpu_count() or 1)
        # arrays that the simulations read and write
        self._qpos, self._qvel, self._ctrl = (self.batch.bind(field) for field in ("qpos", "qvel", "ctrl"))
        self._friction = self.batch.expand("geom_friction")  # (n, geoms, 3): each simulation has its own

    def place(self, ids: NDArray[np.int64], pose: Floats) -> None:
        self.batch.reset(ids)
        q = np.zeros((len(ids), self.model.nq))
        q[:, :2], q[:, 3], q[:, 6] = pose[:, :2], np.cos(pose[:, 2] / 2), np.sin(pose[:, 2] / 2)
        self._qpos[ids] = q

    def pose(self, ids: NDArray[np.int64]) -> Floats:
        q = self._qpos[ids]
        w, x, y, z = q[:, 3:7].T
        return np.column_stack([q[:, 0], q[:, 1], np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))])

    def speed(self, ids: NDArray[np.int64]) -> Floats:
        found: Floats = self._qvel[ids, 6:8]
        return found

    def drive(self, ids: NDArray[np.int64], command: Floats, grip: Floats, seconds: float) -> None:
        self._ctrl[ids] = command
        for tyre, left in zip(self._tyres, grip.T, strict=True):
            self._friction[ids, tyre, 0] = left
        before = self.pose(ids)
        self.batch.step(ids, nstep=round(seconds / self._timestep))
        jumped = ~(np.abs(self.pose(ids)[:, :2] - before[:, :2]).max(axis=1) < _FARTHEST * seconds)
        if jumped.any():
            self.place(ids[jumped], before[jumped])


def picture(plant: Physics, i: int, pixels: int = 800) -> tuple[NDArray[np.uint8], tuple[float, float, float, float]]:
    """The floor of simulation i from above, (pixels, pixels, 3), and its extent on the floor: left, right, bottom, top.

    MuJoCo needs OpenGL: on a machine without a display set MUJOCO_GL=egl before this module is imported.
    """
    floor, model = plant.floor, plant.model
    data = plant.batch.get_data(i)
    mujoco.mj_forward(model, data)  # a copy of the state alone: where bodies are is computed here
    half = 0.53 * max(floor.width, floor.height)
    x, y = floor.width / 2, floor.height / 2
    camera = mujoco.MjvCamera()
    camera.lookat[:] = x, y, 0
    camera.distance = half / np.tan(np.radians(model.vis.global_.fovy / 2))
    camera.azimuth, camera.elevation = 90, -90
    renderer = mujoco.Renderer(model, pixels, pixels)
    try:
        renderer.update_scene(data, camera=camera)
        return np.array(renderer.render()), (x - half, x + half, y - half, y + half)
    finally:
        renderer.close()
