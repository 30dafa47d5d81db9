"""The probability as an exact fraction, for models given in fractions or decimals.

With row probabilities n/D, the integers N_t = V_t · D^(h−t) obey the same recursion without any division:

    N_t(s,q) = opt_c Σ_s' n(s'|c) · N_{t+1}(s', δ(L(s'), q)),      decided: D^(h−t) or 0,      P = Σ_s ι(s) N_0 / D^h

Digits of a fixed width in a kernel where D < 2^40; Python's integers in numpy's object arrays otherwise, and for mixed
policies, whose weights (in proportion to the doubles given) enter as integers over a denominator of their own.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from stltool.checking.induction import Digits, Integers, Layers, Recorder, Solution, solve
from stltool.errors import ModelError
from stltool.models import MDP
from stltool.models.normalize import HINT, MOST_MISSING
from stltool.models.rows import Rows
from stltool.sizes import require_memory, require_time

_DIGITS_BELOW = 2**40
_SMALL = 300_000  # edges for which Python's integers take less time than loading numba
_DIGITS_RATE, _PYTHON_RATE = 5e8, 1e7  # digits' and Python integers' multiply-adds per second, roughly


def exact_probability(
    layers: Layers[Any, Any],
    model: MDP,
    maximize: bool,
    keep: type[np.unsignedinteger] | None = None,
    *,
    in_digits: bool = True,
    memory_limit: int | None = None,
    time_limit: float | None = None,
    recorder: Recorder | None = None,
) -> tuple[Fraction, Solution, list[Fraction]]:
    """P as a fraction, over the layers of a question (checking/check.py), the solution it comes from, and the value of
    each of the game's first states.

    Raises ModelError if the model's rows do not sum to 1 exactly, SizeError before it needs more than is available.
    """
    require_exact(model, layers.kinds)
    arithmetic = exact_arithmetic(
        layers, maximize, in_digits=in_digits, memory_limit=memory_limit, time_limit=time_limit
    )
    found = solve(layers, arithmetic, maximize, keep, recorder)
    entries = [Fraction(arithmetic.number(value), arithmetic.one) for value in found.entry]
    shares = (model.initial_share(s) for s in layers.game.first.tolist())
    total = sum((share * value for share, value in zip(shares, entries, strict=True)), Fraction(0))
    return total, replace(found, entry=np.array([float(value) for value in entries])), entries


def exact_arithmetic(
    layers: Layers[Any, Any],
    maximize: bool,
    *,
    in_digits: bool = True,
    memory_limit: int | None = None,
    time_limit: float | None = None,
) -> Digits | Integers:
    """The arithmetic without any rounding over these layers. Raises SizeError before it needs more than is
    available."""
    D = layers.rows.denominator
    _, pairs = layers.size()
    small = "numba" not in sys.modules and pairs * layers.game.widest <= _SMALL
    if in_digits and D < _DIGITS_BELOW and not layers.allowed.mixed and not small:
        digits = Digits(D, maximize)
        require_room(layers, digits.bits, memory_limit=memory_limit, time_limit=time_limit, rate=_DIGITS_RATE)
        return digits
    require_room(layers, 64, memory_limit=memory_limit, time_limit=time_limit)
    return Integers(D, maximize)


def require_room(
    layers: Layers[Any, Any],
    bits: int,
    *,
    memory_limit: int | None = None,
    time_limit: float | None = None,
    rate: float = _PYTHON_RATE,
) -> None:
    """SizeError if integers over the rows' denominator to the power of the horizon, of words of so many bits, need more
    than is available."""
    h, D = layers.game.horizon, layers.rows.denominator
    widest, pairs = layers.size()
    words = h * math.log2(max(D, 2)) / bits + (2 if rate == _DIGITS_RATE else 4)
    what = f"exact arithmetic on {pairs} pairs over {h} steps"
    remedy = "shorten the windows, round the probabilities to fewer digits, or use the enclosure, without --exact"
    require_memory(24 * words * widest, what, remedy, memory_limit)
    require_time(pairs * layers.game.widest * (1 + words / 2), rate, what, remedy, time_limit)


def require_exact(model: MDP, kinds: Rows) -> None:
    """ModelError, with the row, unless the model's rows (represented by `kinds`) and its start sum to 1 exactly."""
    if not kinds.defect and not model.initial_defect:
        return
    if kinds.defect:
        rows = model.rows
        sums = np.add.reduceat(rows.numerator, rows.row_start[:-1])
        wrong = int(np.flatnonzero(sums != rows.denominator)[0])
        total, where = Fraction(int(sums[wrong]), rows.denominator), model.place(wrong)
    else:
        total, where = model.initial_total, "the initial distribution"
    sign = "+" if total > 1 else "−"
    raise ModelError(
        f"{where}: the probabilities sum to 1 {sign} {float(abs(total - 1)):.3g}, so there is no exact answer; give "
        'them as fractions, such as "1/3", or as decimals that sum to 1'
        + (f"; {HINT}" if abs(total - 1) <= MOST_MISSING else "")
    )
