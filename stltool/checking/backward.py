"""Backward induction over the product (docs/semantics.md §3), with numba's kernels or a plain numpy twin.

    V_t(s,q) = 1 / 0                                            if verdict_t(q) is true / false
             = opt_c Σ_s' P(s'|c) · V_{t+1}(s', δ(L(s'), q))     otherwise
    P(Φ)     = Σ_s ι(s) V_0(s, δ(L(s), q₀))                      after h sweeps: no stopping rule, no truncation

The product's matrix is never built: W[s',q] = V[s', δ(L(s'),q)] is gathered once a sweep, then a sweep is P·W with the
optimum over a state's choices. Three layers of |S|·|Q| doubles are all it holds.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import ModuleType
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.checking.fixed import FixedPoint
from stltool.policy import Policy
from stltool.product import Product
from stltool.sizes import Numbers

Floats: TypeAlias = NDArray[np.float64]
Values: TypeAlias = NDArray[Any]
"""Probabilities: float64, or int64 in units of a fixed point (checking/fixed.py)."""
Progress: TypeAlias = Callable[[int, int], None]
"""Called with (steps done, steps in all)."""

Backend = Literal["numba", "numpy"]
BACKENDS: tuple[Backend, ...] = ("numba", "numpy")
Number: TypeAlias = type[np.float64] | type[np.int64]

_WORTH_THREADS = 50_000  # numbers a sweep; below, starting threads costs more than they save


class Sweeper(Protocol):
    """One sweep's arithmetic. W and out are (S, Q) of `dtype`, where `one` means certain.

    Results do not depend on the number of threads.
    """

    dtype: Number
    one: float

    def gather(self, values: Values, out: Values) -> None: ...
    def optimum(self, W: Values, maximize: bool, out: Values, best: Numbers) -> None: ...
    def policy(self, W: Values, chosen: Numbers, out: Values) -> None: ...
    def mixture(self, W: Values, weight: Floats, out: Values) -> None: ...


def induct(
    product: Product, sweeper: Sweeper, sweep: Callable[[int, Values, Values], None], progress: Progress | None
) -> Values:
    """V_0 at the initial states, in their order, where `sweep(t, W, out)` fills V_t before verdicts."""
    h = product.horizon
    values, W = np.zeros(product.shape, sweeper.dtype), np.empty(product.shape, sweeper.dtype)
    out = np.empty(product.shape, sweeper.dtype)
    _decide(product, h, values, sweeper.one)
    for t in range(h - 1, -1, -1):
        sweeper.gather(values, W)
        sweep(t, W, out)
        _decide(product, t, out, sweeper.one)
        values, out = out, values
        if progress is not None:
            progress(h - t, h)
    entry = product.automaton.delta[product.letter, product.automaton.initial]
    start = np.flatnonzero(product.model.initial)
    entries: Values = values[start, entry[start]]
    return entries


def sweep_of(
    sweeper: Sweeper, policy: Policy | None, maximize: bool, tables: Numbers
) -> Callable[[int, Values, Values], None]:
    """What `induct` does a step: a policy's value; or the optimum, whose choices go to `tables` (h or 1, S, Q)."""

    def sweep(t: int, W: Values, out: Values) -> None:
        if policy is None:
            sweeper.optimum(W, maximize, out, tables[t % len(tables)])
        elif policy.deterministic:
            sweeper.policy(W, policy.row(t), out)
        else:
            sweeper.mixture(W, policy.row(t), out)

    return sweep


def _decide(product: Product, t: int, values: Values, one: float) -> None:
    verdicts = product.automaton.verdicts(t)
    for verdict, value in ((TRUE, one), (FALSE, 0)):
        columns = np.flatnonzero(verdicts == verdict)
        if columns.size:
            values[:, columns] = value


def sweeper(product: Product, backend: Backend, scale: FixedPoint | None = None) -> Sweeper:
    """The arithmetic for this product, in doubles or in fixed point: kernels, or their twin in numpy."""
    product.model.require_points()
    return NumbaSweeper(product, scale) if backend == "numba" else NumpySweeper(product, scale)


class NumbaSweeper:
    """Kernels over ranges of states, shared out to threads where it pays."""

    def __init__(self, product: Product, scale: FixedPoint | None = None) -> None:
        from stltool.kernels import fixed, sweep

        model = product.model
        self._lookup = (product.letter, product.automaton.delta)
        self._structure = (model.choice_start, model.row_start, model.target)
        self._gather: Callable[..., None] = sweep.gather
        self._mixture: Callable[..., None] = sweep.mixture
        self.dtype: Number = np.float64 if scale is None else np.int64
        self.one: float = 1.0 if scale is None else scale.one
        self._kernels: ModuleType = sweep if scale is None else fixed
        self._shares: tuple[Any, ...] = (
            (model.probability,) if scale is None else (model.rows.numerator, scale.denominator)
        )
        self._run = over_ranges(product, product.n_states)

    def gather(self, values: Values, out: Values) -> None:
        self._run(self._gather, (values, *self._lookup), (out,))

    def optimum(self, W: Values, maximize: bool, out: Values, best: Numbers) -> None:
        self._run(self._kernels.optimum, (*self._structure, *self._shares, W, maximize), (out, best))

    def policy(self, W: Values, chosen: Numbers, out: Values) -> None:
        self._run(self._kernels.policy, (*self._structure, *self._shares, W, chosen), (out,))

    def mixture(self, W: Values, weight: Floats, out: Values) -> None:
        self._run(self._mixture, (*self._structure, *self._shares, W, weight), (out,))


Runner: TypeAlias = Callable[[Callable[..., None], tuple[Any, ...], tuple[Any, ...]], None]


def over_ranges(product: Product, work: int) -> Runner:
    """run(kernel, before, after): kernel(*before, lo, hi, *after) over all states, by threads where `work` pays."""
    workers = (os.cpu_count() or 1) if work >= _WORTH_THREADS else 1
    cuts = np.linspace(0, product.model.n_states, 4 * workers + 1 if workers > 1 else 2).astype(int).tolist()
    ranges = list(itertools.pairwise(cuts))
    pool = ThreadPoolExecutor(workers) if workers > 1 else None

    def run(kernel: Callable[..., None], before: tuple[Any, ...], after: tuple[Any, ...]) -> None:
        if pool is None:
            for lo, hi in ranges:
                kernel(*before, lo, hi, *after)
        else:
            for future in [pool.submit(kernel, *before, lo, hi, *after) for lo, hi in ranges]:
                future.result()

    return run


class NumpySweeper:
    """The same in a few lines of numpy and scipy: no compilation, more memory (a layer per choice)."""

    def __init__(self, product: Product, scale: FixedPoint | None = None) -> None:
        from scipy.sparse import csr_array

        self.dtype: Number = np.float64 if scale is None else np.int64
        self.one: float = 1.0 if scale is None else scale.one
        model = product.model
        shares = model.probability if scale is None else model.rows.numerator
        self._matrix = csr_array((shares, model.target, model.row_start), shape=(model.n_choices, model.n_states))
        self._denominator = None if scale is None else scale.denominator
        self._start = model.choice_start
        self._after = product.automaton.delta[product.letter]
        self._state = np.arange(model.n_states)[:, None]

    def gather(self, values: Values, out: Values) -> None:
        out[:] = values[self._state, self._after]

    def optimum(self, W: Values, maximize: bool, out: Values, best: Numbers) -> None:
        per_choice = self._matrix @ W
        for s in range(len(out)):
            options = per_choice[self._start[s] : self._start[s + 1]]
            best[s] = options.argmax(axis=0) if maximize else options.argmin(axis=0)
            out[s] = self._rounded_up(options.max(axis=0) if maximize else options.min(axis=0))

    def policy(self, W: Values, chosen: Numbers, out: Values) -> None:
        per_choice = self._rounded_up(self._matrix @ W)
        undefined: float = np.nan
        if self._denominator is not None:  # integers have no NaN to spread by itself
            undefined = -1
            per_choice[(self._matrix @ (W < 0)) > 0] = undefined
        choice = self._start[:-1, None] + np.maximum(chosen, 0)
        out[:] = np.where(chosen < 0, undefined, np.take_along_axis(per_choice, choice, axis=0))

    def mixture(self, W: Values, weight: Floats, out: Values) -> None:
        per_choice = self._matrix @ W
        for s in range(len(out)):
            options = per_choice[self._start[s] : self._start[s + 1]]
            out[s] = np.einsum("cq,qc->q", options, weight[s, :, : len(options)])

    def _rounded_up(self, sums: Values) -> Values:
        return sums if self._denominator is None else -((-sums) // self._denominator)
