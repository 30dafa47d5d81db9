"""The decimals that doubles print as: whole numbers m and places k with repr(x) = m / 10^k, without printing.

For a = |x| and e = ⌊log₁₀ a⌋, numbers of 15, 16 and 17 digits are tried, k = 14 − e and up:

    15   m = the whole number nearest to a·10^k, if m / 10^k is a. At most one decimal of 15 digits reads as a, and a
         decimal that short is what a prints as.
    16   m nearest to a·10^k exactly (product and error of [Dekker71]), if it reads as a: if |m − a·10^k| is less than
         half a unit in the last place of a.
    17   m nearest to a·10^k: 17 digits always suffice, and the nearest is printed.

k is −1, and m says nothing, where the choice is close (half-way between two m, at the end of the range that reads as a,
powers of two of more digits, whose lower neighbour is nearer) or a lies outside 1e-6 … 1e15.
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

_LEAST, _LARGEST = 1e-6, 1e15
_LEAST_EXPONENT = -30  # of the powers of two whose decimal exponents are listed
_POWERS = np.array([10.0**k for k in range(23)])  # exact
_EXPONENTS = np.array([math.floor(math.log10(2.0) * n) for n in range(_LEAST_EXPONENT, 60)], dtype=np.int64)
"""⌊log₁₀ 2^n⌋: no power of two but 1 is near enough to a power of ten for the logarithm's rounding to matter."""
_NEXT = np.array([float(f"1e{e}") for e in range(-9, 19)])  # from 10^e for e = −10 on: of that, the power of ten above
_HALVES = np.array([2.0 ** (n - 53) for n in range(_LEAST_EXPONENT, 60)])  # of a unit in the last place at 2^n
_FRACTION, _MAGNITUDE, _ONE = (1 << 52) - 1, (1 << 63) - 1, 1023 << 52


@kernel
def decimals(x: F64, m: I64, places: I64) -> None:
    """Without branches, so that processors compute several at once, and all three numbers of digits for each."""
    words = x.view(np.int64)
    for i in range(len(x)):
        given = abs(x[i])
        inside = _LEAST <= given < _LARGEST
        a = given if inside else 1.0
        bits = words[i] & _MAGNITUDE if inside else _ONE
        at = (bits >> 52) - 1023 - _LEAST_EXPONENT
        e = _EXPONENTS[at]
        e += a >= _NEXT[e + 10]
        power = _POWERS[14 - e]
        whole = np.rint(a * power)
        short = whole / power == a
        power *= 10.0  # exactly: up to 10^22
        high, error = product(a, power)
        low = np.floor(high)
        rest = (high - low) + error
        nearest = np.floor(rest + 0.5)
        distance, room = abs(nearest - rest), _HALVES[at] * power
        close = (distance > 0.5 - 1e-9) | (abs(distance - room) < 1e-9 * room)
        sixteen = distance < room
        power *= 10.0
        longer, error = product(a, power)
        lower = np.floor(longer)
        rest = (longer - lower) + error
        upper = np.floor(rest + 0.5)
        doubtful = (bits & _FRACTION == 0) | close | (~sixteen & (abs(upper - rest) > 0.5 - 1e-9))
        found = np.int64(low) + np.int64(nearest) if sixteen else np.int64(lower) + np.int64(upper)
        found = np.int64(whole) if short else found
        k = 14 - e if short else (15 - e if sixteen else 16 - e)
        unknown = ~inside | (~short & doubtful)
        found = np.int64(0) if unknown else found
        m[i] = -found if words[i] < 0 else found
        places[i] = (0 if given == 0.0 else -1) if unknown else k
