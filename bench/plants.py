"""Systems to falsify, written from their published equations, with the requirements of ARCH-COMP's falsification track.

Automatic transmission (AT) [Hoxha14]: throttle (percent) and brake (ft·lb) to speed (mph), rpm and gear. MathWorks'
example "Modeling an Automatic Transmission Controller", whose tables and constants these are:

    I_e Ṅ_e = T_e(throttle, N_e) − T_i      T_i = (N_e / K(r))²     r = N_in / N_e     N_in = R_gear N_out
    I_v Ṅ_w = R_fd T_out − T_load           T_out = R_gear R(r) T_i                     N_out = R_fd N_w
    T_load = sgn(v) (40 + 0.02 v² + brake)                                              v = 2π · 60/5280 N_w

A gear is changed once the speed has been beyond the threshold of gear and throttle for 0.08 s.

Chasing cars (CC) [Hu00]: five cars, the first driven by throttle and brake in [0, 1] towards negative positions, the
others as below; they begin at 0, 10, 20, 30, 40 with v = 0, the others in "keeping".

    the first   v̇ = −throttle − brake · v,  ẏ = v
    chasing     v̇ = 1,  ẏ = −v      until the distance to the car ahead is <= 10: keeping
    keeping     v̇ = 0,  ẏ = v       until it is >= 15: chasing, or <= 5: braking
    braking     v̇ = −v, ẏ = −v      until it is >= 20: chasing

(In "keeping" the published model has ẏ = v, not −v, and so has this one.)

A nonlinear system (NL) [Abbas13], from two initial values in [−1, 1]:

    ẋ₁ = x₁ − x₂ + 0.1 t,   ẋ₂ = x₂ cos(2π x₂) − x₁ sin(2π x₁) + 0.1 t
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numba import njit

AHEAD = 0.1  # seconds a sample
PIECE = 5.0  # seconds between discontinuities of an input: ARCH-COMP's second instance

_THROTTLE = np.array([0.0, 20, 30, 40, 50, 60, 70, 80, 90, 100])
_RPM = np.array([799.9, 1200, 1600, 2000, 2400, 2800, 3200, 3600, 4000, 4400, 4800])
_TORQUE = np.array([
    [-40.0, 215, 245, 264, 264, 267, 267, 267, 267, 267],
    [-44, 117, 208, 260, 279, 290, 297, 301, 301, 301],
    [-49, 85, 178, 241, 282, 293, 305, 308, 312, 312],
    [-53, 66, 148, 219, 275, 297, 305, 312, 319, 319],
    [-57, 44, 122, 193, 260, 290, 305, 319, 327, 327],
    [-61, 29, 104, 167, 238, 275, 301, 323, 327, 334],
    [-65, 10, 85, 152, 223, 260, 293, 319, 327, 334],
    [-70, -2, 66, 133, 208, 256, 282, 316, 327, 334],
    [-74, -13, 48, 119, 189, 234, 267, 297, 312, 319],
    [-78, -22, 33, 96, 171, 212, 249, 279, 293, 305],
    [-82, -32, 18, 85, 152, 193, 226, 253, 267, 275],
])  # fmt: skip
_SPEED_RATIO = np.array([0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.81, 0.82, 0.83, 0.84, 0.85, 0.86, 0.87, 0.88,
                         0.89, 0.9, 0.92, 0.94])  # fmt: skip
_K = np.array([137.4652, 137.0650, 135.8644, 135.6644, 137.5653, 140.3666, 145.2689, 152.8725, 162.9773, 164.2779,
               166.1788, 167.9797, 170.0807, 172.7820, 175.3832, 179.5852, 183.5871, 189.8901, 197.6938, 215.9024,
               244.5160])  # fmt: skip
_TORQUE_RATIO = np.array([2.232, 2.075, 1.975, 1.846, 1.72, 1.564, 1.409, 1.254, 1.096, 1.08, 1.061, 1.043, 1.028,
                          1.012, 1.002, 1.002, 1.001, 0.998, 0.999, 1.001, 1.002])  # fmt: skip
_GEAR_RATIO = np.array([2.393, 1.45, 1.0, 0.677])
_UP_AT = np.array([0.0, 25, 35, 50, 90, 100])
_UP = np.array([[10.0, 10, 15, 23, 40, 40], [30, 30, 30, 41, 70, 70], [50, 50, 50, 60, 100, 100]])
_DOWN_AT = np.array([0.0, 5, 40, 50, 90, 100])
_DOWN = np.array([[5.0, 5, 5, 5, 30, 30], [20, 20, 25, 30, 50, 50], [35, 35, 40, 50, 80, 80]])


@njit(cache=True)
def _between(x: float, xs: np.ndarray, ys: np.ndarray) -> float:
    """Linear interpolation; the last pieces go on beyond the ends."""
    i = min(max(np.searchsorted(xs, x) - 1, 0), len(xs) - 2)
    return ys[i] + (x - xs[i]) / (xs[i + 1] - xs[i]) * (ys[i + 1] - ys[i])


@njit(cache=True)
def _engine_torque(throttle: float, rpm: float) -> float:
    i = min(max(np.searchsorted(_RPM, rpm) - 1, 0), len(_RPM) - 2)
    lower, upper = _between(throttle, _THROTTLE, _TORQUE[i]), _between(throttle, _THROTTLE, _TORQUE[i + 1])
    return lower + (rpm - _RPM[i]) / (_RPM[i + 1] - _RPM[i]) * (upper - lower)


@njit(cache=True)
def _transmission(throttle: np.ndarray, brake: np.ndarray, sample: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n = len(throttle)
    speed, rpm, gears = np.zeros(n), np.zeros(n), np.zeros(n)
    wheel, engine, gear, over, under = 0.0, 1000.0, 1, 0.0, 0.0
    to_mph = 2 * math.pi * 60 / 5280
    inner = 10
    dt = sample / inner
    for i in range(n):
        speed[i], rpm[i], gears[i] = wheel * to_mph, engine, gear
        for _ in range(inner):
            v = wheel * to_mph
            above = gear < 4 and v > _between(throttle[i], _UP_AT, _UP[gear - 1])
            below = gear > 1 and v < _between(throttle[i], _DOWN_AT, _DOWN[gear - 2])
            over, under = over + dt if above else 0.0, under + dt if below else 0.0
            if over >= 0.08:
                gear, over = gear + 1, 0.0
            elif under >= 0.08:
                gear, under = gear - 1, 0.0
            ratio = _GEAR_RATIO[gear - 1]
            slip = ratio * 3.23 * wheel / engine
            impeller = (engine / _between(slip, _SPEED_RATIO, _K)) ** 2
            out = ratio * _between(slip, _SPEED_RATIO, _TORQUE_RATIO) * impeller
            engine += dt * (_engine_torque(throttle[i], engine) - impeller) / 0.02199
            engine = min(max(engine, 600.0), 6000.0)
            load = 40 + 0.02 * v * v + brake[i]
            wheel = max(wheel + dt * (3.23 * out - load) / 12.0941, 0.0)
    return speed, rpm, gears


def transmission(inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    speed, rpm, gear = _transmission(inputs["throttle"], inputs["brake"], AHEAD)
    return {"speed": speed, "rpm": rpm, "gear": gear}


_CHASING, _KEEPING, _BRAKING = 0, 1, 2


@njit(cache=True)
def _cars(throttle: np.ndarray, brake: np.ndarray, sample: float) -> np.ndarray:
    n = len(throttle)
    found = np.zeros((5, n))
    y = np.array([0.0, 10, 20, 30, 40])
    v = np.zeros(5)
    mode = np.array([-1, 1, 1, 1, 1])
    inner = 10
    dt = sample / inner
    for i in range(n):
        found[:, i] = y
        for _ in range(inner):
            for car in range(1, 5):
                gap = y[car] - y[car - 1]
                if mode[car] == 0:
                    if gap <= 10:
                        mode[car] = 1
                elif mode[car] == 1:
                    if gap >= 15:
                        mode[car] = 0
                    elif gap <= 5:
                        mode[car] = 2
                elif gap >= 20:
                    mode[car] = 0
            for car in range(1, 5):
                if mode[car] == 0:
                    y[car] -= dt * v[car]
                    v[car] += dt
                elif mode[car] == 1:
                    y[car] += dt * v[car]
                else:
                    y[car] -= dt * v[car]
                    v[car] -= dt * v[car]
            y[0] += dt * v[0]
            v[0] += dt * (-throttle[i] - brake[i] * v[0])
    return found


def cars(inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    found = _cars(inputs["throttle"], inputs["brake"], AHEAD)
    return {f"y{car + 1}": found[car] for car in range(5)}


@njit(cache=True)
def _nonlinear(a: float, b: float, n: int, sample: float) -> np.ndarray:
    found = np.zeros((2, n))
    inner = 10
    dt = sample / inner
    for i in range(n):
        found[0, i], found[1, i] = a, b
        for k in range(inner):
            t = i * sample + k * dt
            da = a - b + 0.1 * t
            db = b * math.cos(2 * math.pi * b) - a * math.sin(2 * math.pi * a) + 0.1 * t
            a, b = a + dt * da, b + dt * db
    return found


def nonlinear(inputs: Mapping[str, Any]) -> dict[str, np.ndarray]:
    found = _nonlinear(float(inputs["a"]), float(inputs["b"]), 201, 0.01)
    return {"x": found[0], "y": found[1]}


class Plant(NamedTuple):
    """A system, and the ranges of its inputs: signals that may change every PIECE seconds, or numbers."""

    run: Callable[[Mapping[str, Any]], dict[str, np.ndarray]]
    signals: Mapping[str, tuple[float, float]]
    numbers: Mapping[str, tuple[float, float]]
    step: str


AT = Plant(transmission, {"throttle": (0, 100), "brake": (0, 325)}, {}, "0.1s")
CC = Plant(cars, {"throttle": (0, 1), "brake": (0, 1)}, {}, "0.1s")
NL = Plant(nonlinear, {}, {"a": (-1, 1), "b": (-1, 1)}, "0.01s")


def _shift(gear: int) -> str:
    return f"G[0,30s] (!(gear == {gear}) & X(gear == {gear}) -> G[0.1s,2.5s] (gear == {gear}))".replace(
        "X(", "F[0.1s,0.1s] ("
    )


REQUIREMENTS: dict[str, tuple[Plant, str]] = {
    "AT1": (AT, "G[0,20s] (speed < 120)"),
    "AT2": (AT, "G[0,10s] (rpm < 4750)"),
    **{f"AT5{gear}": (AT, _shift(gear)) for gear in (1, 2, 3, 4)},
    "AT6a": (AT, "(G[0,30s] (rpm < 3000)) -> (G[0,4s] (speed < 35))"),
    "AT6b": (AT, "(G[0,30s] (rpm < 3000)) -> (G[0,8s] (speed < 50))"),
    "AT6c": (AT, "(G[0,30s] (rpm < 3000)) -> (G[0,20s] (speed < 65))"),
    "CC1": (CC, "G[0,100s] (y5 - y4 <= 40)"),
    "CC2": (CC, "G[0,70s] F[0,30s] (y5 - y4 >= 15)"),
    "CC3": (CC, "G[0,80s] ((G[0,20s] (y2 - y1 <= 20)) | (F[0,20s] (y5 - y4 >= 40)))"),
    "CC4": (CC, "G[0,65s] F[0,30s] G[0,5s] (y5 - y4 >= 8)"),
    "CC5": (CC, "G[0,72s] F[0,8s] ((G[0,5s] (y2 - y1 >= 9)) -> (G[5s,20s] (y5 - y4 >= 9)))"),
    "CCx": (CC, "(G[0,50s] (y2 - y1 > 7.5)) & (G[0,50s] (y3 - y2 > 7.5)) & (G[0,50s] (y4 - y3 > 7.5))"
                " & (G[0,50s] (y5 - y4 > 7.5))"),
    "NL": (NL, "G[0,2s] (x < -1.6 | x > -1.4 | y < -1.1 | y > -0.9)"),
}  # fmt: skip
