"""Sums of two doubles [Dekker71], and powers of ten as such."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import binding
from numba import types
from numba.extending import intrinsic

from stltool.kernels.jit import compiles, part

MOST_PLACES = 76
HIGH = np.array([float(10**k) for k in range(MOST_PLACES + 1)])
LOW = np.array([float(10**k - int(high)) for k, high in enumerate(HIGH)])
"""10^k is the sum of both; for k > 44 to 2⁻¹⁰⁶ of it."""

_SPLIT = 134217729.0  # 2^27 + 1
_FUSED = compiles() and bool(binding.get_host_cpu_features().get("fma", False))


def _rounded_once(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """a·b + c."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), generate


_fused: Any = intrinsic(_rounded_once)


@part
def product(a: float, b: float) -> tuple[float, float]:
    """a·b as a sum of two doubles, exactly, if nothing over- or underflows."""
    p = a * b
    if _FUSED:
        return p, _fused(a, b, -p)
    c = _SPLIT * a
    ah = c - (c - a)
    al = a - ah
    c = _SPLIT * b
    bh = c - (c - b)
    bl = b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl


@part
def divided(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    """A quotient of sums of two doubles, to some 2⁻¹⁰⁰ of it."""
    first = a / b
    high, error = product(first, b)
    return first, (((a - high) - error) + (a_low - first * b_low)) / b


@part
def rounded(high: float, low: float, relative: float) -> tuple[float, bool]:
    """The nearest double, and whether that is certain."""
    room = relative * abs(high)
    result = high + (low - room)
    return result + 0.0, result == high + (low + room)


@part
def root_minus(high: float, low: float, value: float, rest: float, b: float) -> tuple[float, bool]:
    """The nearest double of √A − B and whether that is certain, for A − B² and B > 0 as sums of two doubles.

    √A − B = (A − B²) / (√A + B), and √A + B is 2B + (√A − B), of which a rough value is enough. With B in doubles, b,
    it is seen whether `value` is B, or is without its upper digits.
    """
    rough = high / (2 * value) if value > 0 else np.inf
    if not (abs(value - b) <= 1e-9 * b and abs(rough) < 2.0**-45 * b):
        return 0.0, False
    total = 2 * value + rough
    part = total - 2 * value
    rest = ((2 * value - (total - part)) + (rough - part)) + 2 * rest
    high, low = divided(high, low, total, rest)
    return rounded(high, low, 2.0**-85)
