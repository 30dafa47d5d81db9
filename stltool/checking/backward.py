"""Backward induction over the product (semantics.md §3), with numba's kernels or a plain numpy twin.

    V_t(s,q) = 1 / 0                                            if verdict_t(q) is true / false
             = opt_c Σ_s' P(s'|c) · V_{t+1}(s', δ(L(s'), q))     otherwise
    P(Φ)     = Σ_s ι(s) V_0(s, δ(L(s), q₀))                      after h sweeps: no stopping rule, no truncation

The product's matrix is never built: W[s',q] = V[s', δ(L(s'),q)] is gathered once a sweep, then a sweep is P·W with the
optimum over a state's choices. Three layers of |S|·|Q| doubles are all it holds.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.product import Product

Floats: TypeAlias = NDArray[np.float64]
Progress: TypeAlias = Callable[[int, int], None]
"""Called with (steps done, steps in all)."""

Backend = Literal["numba", "numpy"]

_WORTH_THREADS = 50_000  # product states; below, starting threads costs more than they save


class Sweeper(Protocol):
    """One sweep's arithmetic. W and out are (S, Q); results do not depend on the number of threads."""

    def gather(self, values: Floats, out: Floats) -> None: ...
    def optimum(self, W: Floats, maximize: bool, out: Floats, best: NDArray[np.int16]) -> None: ...
    def policy(self, W: Floats, chosen: NDArray[np.int16], out: Floats) -> None: ...
    def mixture(self, W: Floats, weight: Floats, out: Floats) -> None: ...


def induct(product: Product, sweep: Callable[[int, Floats, Floats], None], gather: Callable[[Floats, Floats], None],
           progress: Progress | None) -> float:  # fmt: skip
    """P(Φ) where `sweep(t, W, out)` fills V_t before verdicts and `gather(V, W)` looks successors up."""
    h = product.horizon
    values, W = np.zeros(product.shape), np.empty(product.shape)
    out = np.empty(product.shape)
    _decide(product, h, values)
    for t in range(h - 1, -1, -1):
        gather(values, W)
        sweep(t, W, out)
        _decide(product, t, out)
        values, out = out, values
        if progress is not None:
            progress(h - t, h)
    entry = product.automaton.delta[product.letter, product.automaton.initial]
    start = np.flatnonzero(product.model.initial)
    return math.fsum(product.model.initial[start] * values[start, entry[start]])


def _decide(product: Product, t: int, values: Floats) -> None:
    verdicts = product.automaton.verdicts(t)
    for verdict, value in ((TRUE, 1.0), (FALSE, 0.0)):
        columns = np.flatnonzero(verdicts == verdict)
        if columns.size:
            values[:, columns] = value


def sweeper(product: Product, backend: Backend) -> Sweeper:
    """The arithmetic for this product: numba's kernels, or the numpy twin that they are tested against."""
    return NumbaSweeper(product) if backend == "numba" else NumpySweeper(product)


class NumbaSweeper:
    """Kernels over ranges of states, shared out to threads where it pays."""

    def __init__(self, product: Product) -> None:
        from stltool.kernels import sweep

        model = product.model
        self._kernels = sweep
        self._lookup = (product.letter, product.automaton.delta)
        self._rows = (model.choice_start, model.row_start, model.target, model.probability)
        workers = (os.cpu_count() or 1) if product.n_states >= _WORTH_THREADS else 1
        cuts = np.linspace(0, model.n_states, 4 * workers + 1 if workers > 1 else 2).astype(int).tolist()
        self._ranges = list(itertools.pairwise(cuts))
        self._pool = ThreadPoolExecutor(workers) if workers > 1 else None

    def _run(self, kernel: Callable[..., None], before: tuple[Any, ...], after: tuple[Any, ...]) -> None:
        if self._pool is None:
            for lo, hi in self._ranges:
                kernel(*before, lo, hi, *after)
        else:
            for future in [self._pool.submit(kernel, *before, lo, hi, *after) for lo, hi in self._ranges]:
                future.result()

    def gather(self, values: Floats, out: Floats) -> None:
        self._run(self._kernels.gather, (values, *self._lookup), (out,))

    def optimum(self, W: Floats, maximize: bool, out: Floats, best: NDArray[np.int16]) -> None:
        self._run(self._kernels.optimum, (*self._rows, W, maximize), (out, best))

    def policy(self, W: Floats, chosen: NDArray[np.int16], out: Floats) -> None:
        self._run(self._kernels.policy, (*self._rows, W, chosen), (out,))

    def mixture(self, W: Floats, weight: Floats, out: Floats) -> None:
        self._run(self._kernels.mixture, (*self._rows, W, weight), (out,))


class NumpySweeper:
    """The same in a few lines of numpy and scipy: no compilation, more memory (a layer per choice)."""

    def __init__(self, product: Product) -> None:
        self._matrix = product.model.matrix()
        self._start = product.model.choice_start
        self._after = product.automaton.delta[product.letter]
        self._state = np.arange(product.model.n_states)[:, None]

    def gather(self, values: Floats, out: Floats) -> None:
        out[:] = values[self._state, self._after]

    def optimum(self, W: Floats, maximize: bool, out: Floats, best: NDArray[np.int16]) -> None:
        per_choice = self._matrix @ W
        for s in range(len(out)):
            options = per_choice[self._start[s] : self._start[s + 1]]
            best[s] = options.argmax(axis=0) if maximize else options.argmin(axis=0)
            out[s] = options.max(axis=0) if maximize else options.min(axis=0)

    def policy(self, W: Floats, chosen: NDArray[np.int16], out: Floats) -> None:
        per_choice = self._matrix @ W
        choice = self._start[:-1, None] + np.maximum(chosen, 0)
        out[:] = np.where(chosen < 0, np.nan, np.take_along_axis(per_choice, choice, axis=0))

    def mixture(self, W: Floats, weight: Floats, out: Floats) -> None:
        per_choice = self._matrix @ W
        for s in range(len(out)):
            options = per_choice[self._start[s] : self._start[s + 1]]
            out[s] = np.einsum("cq,qc->q", options, weight[s, :, : len(options)])
