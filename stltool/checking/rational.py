"""The probability as the fraction that it is, for models given in fractions or decimals.

With row probabilities n/D, the integers N_t = V_t · D^(h−t) obey the same recursion without any division:

    N_t(s,q) = opt_c Σ_s' n(s'|c) · N_{t+1}(s', δ(L(s'), q)),      decided: D^(h−t) or 0,      P = Σ_s ι(s) N_0 / D^h

Digits of a fixed width in a kernel where D < 2^40; Python's integers in numpy's object arrays otherwise, and for mixed
policies, whose weights (in proportion to the doubles given) enter as integers over a denominator of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE, UNDECIDED
from stltool.checking.backward import Progress, over_ranges
from stltool.checking.reach import first_steps
from stltool.errors import ModelError
from stltool.models import MDP
from stltool.models.fractions import LARGEST_SUM, Integers, over_one
from stltool.models.normalize import HINT, MOST_MISSING
from stltool.policy import Policy
from stltool.product import Product
from stltool.sizes import Numbers, require_memory, require_time

_KERNEL_BELOW = 2**40
_KERNEL_RATE, _PYTHON_RATE = 5e8, 1e7  # digits' and Python integers' multiply-adds a second, roughly


def exact_probability(
    product: Product,
    policy: Policy | None,
    maximize: bool,
    tables: Numbers | None = None,
    *,
    in_kernel: bool = True,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Fraction:
    """P as a fraction: under `policy`, or the optimum, whose choices go to `tables` (h, S, Q) where it is given.

    Raises ModelError where the model's rows do not sum to 1 exactly, SizeError before a sweep that would not fit.
    """
    require_exact(product.model)
    if in_kernel and product.model.exact().denominator < _KERNEL_BELOW and (policy is None or policy.deterministic):
        return _in_digits(product, policy, maximize, tables, memory_limit, progress)
    return _in_python(product, policy, maximize, tables, memory_limit, progress)


def require_exact(model: MDP) -> None:
    """ModelError, with the row, unless every distribution of the model sums to 1 exactly."""
    exact = model.exact()
    sums = np.add.reduceat(exact.numerator, model.row_start[:-1])
    wrong = np.flatnonzero(sums != exact.denominator)
    if wrong.size:
        total, where = Fraction(int(sums[wrong[0]]), exact.denominator), model.place(int(wrong[0]))
    elif sum(exact.initial.tolist()) != exact.initial_denominator:
        total, where = Fraction(sum(exact.initial.tolist()), exact.initial_denominator), "the initial distribution"
    else:
        return
    sign = "+" if total > 1 else "−"
    raise ModelError(
        f"{where}: the probabilities sum to 1 {sign} {float(abs(total - 1)):.3g}, so there is no exact answer; give "
        'them as fractions, such as "1/3", or as decimals that sum to 1'
        + (f"; {HINT}" if abs(total - 1) <= MOST_MISSING else "")
    )


def _in_digits(
    product: Product,
    policy: Policy | None,
    maximize: bool,
    tables: Numbers | None,
    memory_limit: int | None,
    progress: Progress | None,
) -> Fraction:
    from stltool.kernels import rational

    model, automaton, h = product.model, product.automaton, product.horizon
    exact = model.exact()
    D = exact.denominator
    bits = LARGEST_SUM.bit_length() - 1 - D.bit_length()
    most = int(h * math.log2(D) / bits) + 2
    _require(product, 16 * most * product.n_states, most / 2, _KERNEL_RATE, memory_limit)
    first = first_steps(product)
    numerator = exact.numerator.astype(np.int64)
    run = over_ranges(product, work=product.n_states * most)
    anything = np.full(product.shape, -1, dtype=model.choice_type)
    best = np.zeros(product.shape, dtype=model.choice_type)
    values = np.zeros((*product.shape, 1), dtype=np.int64)
    values[:, automaton.verdicts(h) == TRUE] = 1
    one = 1
    for t in range(h - 1, -1, -1):
        one *= D
        verdicts = automaton.verdicts(t)
        digits = _digits(one, bits)
        out = np.zeros((*product.shape, len(digits)), dtype=np.int64)
        out[:, verdicts == TRUE] = digits
        wanted = (first <= t) & (verdicts == UNDECIDED)
        chosen = anything if policy is None else policy.at(t)
        before = (model.choice_start, model.row_start, model.target, numerator, product.letter, automaton.delta)
        table = best if tables is None else tables[t]
        run(rational.optimum, (*before, values, chosen, maximize, wanted, bits), (out, table))
        values = out
        if progress is not None:
            progress(h - t, h)
    total = sum((exact.initial_share(s) * _number(values[s, q], bits) for s, q in _entries(product)), Fraction(0))
    return total / one


def _in_python(
    product: Product,
    policy: Policy | None,
    maximize: bool,
    tables: Numbers | None,
    memory_limit: int | None,
    progress: Progress | None,
) -> Fraction:
    model, automaton, h = product.model, product.automaton, product.horizon
    exact = model.exact()
    words = h * math.log2(max(exact.denominator, 2)) / 64 + 4
    _require(product, 8 * words * (product.n_states + model.n_transitions), 1 + words / 8, _PYTHON_RATE, memory_limit)
    numerator = exact.numerator.astype(object)[:, None]
    n_choices = np.diff(model.choice_start)
    after = automaton.delta[product.letter]  # (S, Q)
    values: Integers = np.zeros(product.shape, dtype=object)
    values[:, automaton.verdicts(h) == TRUE] = 1
    one = 1
    for t in range(h - 1, -1, -1):
        W = values[model.target[:, None], after[model.target]]
        per_choice = np.add.reduceat(numerator * W, model.row_start[:-1], axis=0)
        factor = exact.denominator
        if policy is None:
            values = per_choice[model.choice_start[:-1]]
            best = np.zeros(product.shape, dtype=model.choice_type)
            for i in range(1, int(n_choices.max())):
                there = np.flatnonzero(n_choices > i)
                option = per_choice[model.choice_start[there] + i]
                better = option > values[there] if maximize else option < values[there]
                values[there] = np.where(better, option, values[there])
                best[there] = np.where(better, i, best[there])
            if tables is not None:
                tables[t] = best
        else:
            chosen, shared = follower(model, policy.at(t))
            values, factor = chosen(per_choice), factor * shared
        one *= factor
        verdicts = automaton.verdicts(t)
        values[:, verdicts == TRUE] = one
        values[:, verdicts == FALSE] = 0
        if progress is not None:
            progress(h - t, h)
    total = sum((exact.initial_share(s) * values[s, q] for s, q in _entries(product)), Fraction(0))
    return total / one


def follower(model: MDP, table: NDArray[Any]) -> tuple[Callable[[Integers], Integers], int]:
    """What a policy's table of one step makes of values (n_choices, Q): (S, Q), times the second result."""
    if table.dtype.kind == "i":
        chosen = model.choice_start[:-1, None] + np.maximum(table, 0)
        return lambda per_choice: np.take_along_axis(per_choice, chosen, axis=0), 1
    weight, shared = weights(table)
    n_choices = np.diff(model.choice_start)

    def mix(per_choice: Integers) -> Integers:
        values: Integers = np.zeros(table.shape[:2], dtype=object)
        for i in range(table.shape[2]):
            there = np.flatnonzero(n_choices > i)
            values[there] += weight[there, :, i] * per_choice[model.choice_start[there] + i]
        return values

    return mix, shared


def weights(table: NDArray[np.float64]) -> tuple[Integers, int]:
    """A mixture's weights (S, Q, C), each row scaled to sum to 1, as integers over one denominator."""
    rows, which = np.unique(table.reshape(-1, table.shape[-1]), axis=0, return_inverse=True)
    shares = []
    for row in rows.tolist():
        total = sum(map(Fraction, row))
        shares += [Fraction(weight) / total for weight in row]
    numerator, denominator = over_one(shares)
    return numerator.astype(object).reshape(rows.shape)[which.ravel()].reshape(table.shape), denominator


def _entries(product: Product) -> list[tuple[int, int]]:
    """The initial product states."""
    return [(int(s), product.enter(int(s), product.automaton.initial)) for s in np.flatnonzero(product.model.initial)]


def _require(product: Product, needed: float, words: float, rate: float, memory_limit: int | None) -> None:
    h, nonzeros = product.horizon, product.model.n_transitions * product.automaton.n_states
    what = f"exact arithmetic on {product.n_states} product states over {h} steps"
    remedy = "shorten the windows, round the probabilities to fewer digits, or take the enclosure without --exact"
    require_memory(needed, what, remedy, memory_limit)
    require_time(h * nonzeros * words, rate, what, remedy)


def _digits(value: int, bits: int) -> list[int]:
    digits: list[int] = []
    while value or not digits:
        digits.append(value & ((1 << bits) - 1))
        value >>= bits
    return digits


def _number(digits: NDArray[np.int64], bits: int) -> int:
    return sum(digit << (bits * i) for i, digit in enumerate(digits.tolist()))
