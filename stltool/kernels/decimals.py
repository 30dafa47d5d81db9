"""The decimals that doubles print as: whole numbers m and places k with repr(x) = m / 10^k, without printing.

For a = |x| and e = ⌊log₁₀ a⌋, numbers of 15, 16 and 17 digits are tried, k = 14 − e and up:

    15   m = the whole number nearest to a·10^k, if m / 10^k is a. At most one decimal of 15 digits reads as a, and a
         decimal that short is what a prints as.
    16   m nearest to a·10^k exactly (product and error of [Dekker71]), if it reads as a: if |m − a·10^k| is less than
         half a unit in the last place of a.
    17   m nearest to a·10^k: 17 digits always suffice, and the nearest is printed.

k is −1, and m says nothing, where the choice is close (half-way between two m, at the end of the range that reads as a,
powers of two, whose lower neighbour is nearer) or a lies outside 1e-5 … 1e15.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.jit import kernel
from stltool.kernels.twofold import product

F64: TypeAlias = NDArray[np.float64]
I64: TypeAlias = NDArray[np.int64]

_LEAST_EXPONENT = -30  # of the powers of two whose decimal exponents are listed
POWERS = np.array([10.0**k for k in range(23)])  # exact
EXPONENTS = np.array([math.floor(math.log10(2.0) * n) for n in range(_LEAST_EXPONENT, 60)], dtype=np.int64)
"""⌊log₁₀ 2^n⌋: no power of two but 1 is near enough to a power of ten for the logarithm's rounding to matter."""


@kernel
def decimals(x: F64, powers: F64, exponents: I64, m: I64, places: I64) -> None:
    for i in range(x.shape[0]):
        a = abs(x[i])
        m[i], places[i] = 0, -1
        if a == 0.0:
            places[i] = 0
            continue
        if not 1e-5 <= a < 1e15:
            continue
        fraction, exponent = math.frexp(a)
        if fraction == 0.5:
            continue
        e = exponents[exponent - 1 - _LEAST_EXPONENT]
        next_power = powers[e + 1] if e >= -1 else 1.0 / powers[-e - 1]
        if a >= next_power:
            e += 1
        k = 14 - e
        whole = np.rint(a * powers[k])
        if whole / powers[k] == a:
            m[i], places[i] = (np.int64(whole) if x[i] > 0 else -np.int64(whole)), k
            continue
        half = math.ldexp(1.0, exponent - 54)  # of a unit in the last place of a
        for k in range(15 - e, 17 - e):
            high, error = product(a, powers[k])
            low = math.floor(high)
            rest = (high - low) + error
            nearest = math.floor(rest + 0.5)
            distance = abs(nearest - rest)
            room = half * powers[k]
            if distance > 0.5 - 1e-9 or (k == 15 - e and abs(distance - room) < 1e-9 * room):
                break
            if distance < room or k == 16 - e:
                found = np.int64(low) + np.int64(nearest)
                m[i], places[i] = (found if x[i] > 0 else -found), k
                break
