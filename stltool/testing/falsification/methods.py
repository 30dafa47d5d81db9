"""Optimisers of others in place of the portfolio: scipy's dual annealing, CMA-ES [Hansen16] by cma, TPE by optuna.

Each minimises the score (score.py) over the unit cube. All of them give their next point when asked and take a score,
so that the search ends exactly with its budget; dual annealing, which calls a function instead, runs in a thread of its
own that waits for each score.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Mapping
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np

from stltool.extras import require
from stltool.logic.formula import Formula
from stltool.testing.falsification.candidates import Candidates
from stltool.testing.falsification.inputs import F64, Inputs
from stltool.testing.falsification.score import Scores
from stltool.testing.falsification.search import Portfolio

Method: TypeAlias = Literal["portfolio", "random", "annealing", "cma", "optuna"]


class Searcher(Protocol):
    """`ask` for the next point (dimension,), `tell` its trace, in turn; `close` when that is over."""

    def ask(self) -> F64: ...
    def tell(self, x: F64, trace: Mapping[str, F64]) -> None: ...
    def close(self) -> None: ...


def searcher(method: Method, phi: Formula, inputs: Inputs, rng: np.random.Generator) -> Searcher:
    match method:
        case "portfolio":
            return Portfolio(phi, inputs, rng)
        case "random":
            return Uniform(phi, inputs, rng)
        case "annealing":
            return Annealing(phi, inputs, rng)
        case "cma":
            return Cma(phi, inputs, rng)
        case "optuna":
            return Optuna(phi, inputs, rng)


class Uniform:
    """Independent uniform points."""

    def __init__(self, phi: Formula, inputs: Inputs, rng: np.random.Generator) -> None:
        self._candidates = Candidates(inputs, rng)

    def ask(self) -> F64:
        found: F64 = self._candidates.uniform()[0]
        return found

    def tell(self, x: F64, trace: Mapping[str, F64]) -> None:
        pass

    def close(self) -> None:
        pass


class Cma:
    """CMA-ES from a random point, with restarts."""

    def __init__(self, phi: Formula, inputs: Inputs, rng: np.random.Generator) -> None:
        self._cma = require("cma", "falsify's method cma", "use another method")
        self._scores, self._rng, self._dimension = Scores(phi), rng, inputs.dimension
        self._asked: list[F64] = []
        self._told: list[float] = []
        self._strategy: Any = None

    def ask(self) -> F64:
        if self._dimension == 1:  # CMA-ES has no version for a line
            found: F64 = self._rng.random(1)
            return found
        if self._strategy is None or self._strategy.stop():
            options = {"bounds": [0, 1], "seed": int(self._rng.integers(1, 2**31)), "verbose": -9}
            self._strategy = self._cma.CMAEvolutionStrategy(self._rng.random(self._dimension), 0.3, options)
        if not self._asked:
            self._asked = [np.clip(x, 0, 1) for x in self._strategy.ask()]
        return self._asked[len(self._told)]

    def tell(self, x: F64, trace: Mapping[str, F64]) -> None:
        self._scores.add(trace)
        if not self._asked:
            return
        self._told.append(float(self._scores.values[-1]))
        if len(self._told) == len(self._asked):
            self._strategy.tell(self._asked, self._told)
            self._asked, self._told = [], []

    def close(self) -> None:
        pass


class Optuna:
    """Optuna's sampler TPE."""

    def __init__(self, phi: Formula, inputs: Inputs, rng: np.random.Generator) -> None:
        optuna = require("optuna", "falsify's method optuna", "use another method")
        logging.getLogger("optuna").setLevel(logging.WARNING)
        self._scores, self._dimension = Scores(phi), inputs.dimension
        sampler = optuna.samplers.TPESampler(seed=int(rng.integers(2**31)))
        self._study = optuna.create_study(sampler=sampler)
        self._trial: Any = None

    def ask(self) -> F64:
        self._trial = self._study.ask()
        return np.array([self._trial.suggest_float(str(i), 0, 1) for i in range(self._dimension)])

    def tell(self, x: F64, trace: Mapping[str, F64]) -> None:
        self._scores.add(trace)
        self._study.tell(self._trial, float(self._scores.values[-1]))

    def close(self) -> None:
        pass


class _Over(Exception):
    pass


class Annealing:
    """scipy.optimize.dual_annealing without its local searches, as PSY-TaLiRo uses it; begun again when it ends."""

    def __init__(self, phi: Formula, inputs: Inputs, rng: np.random.Generator) -> None:
        self._scores, self._dimension, self._rng = Scores(phi), inputs.dimension, rng
        self._points: queue.SimpleQueue[F64] = queue.SimpleQueue()
        self._answers: queue.SimpleQueue[float | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._started = False

    def _run(self) -> None:
        from scipy.optimize import dual_annealing

        def worth(x: F64) -> float:
            self._points.put(np.clip(x, 0, 1))
            found = self._answers.get()
            if found is None:
                raise _Over
            return found

        try:
            while True:
                seed = int(self._rng.integers(2**31))
                dual_annealing(worth, [(0, 1)] * self._dimension, seed=seed, no_local_search=True)
        except _Over:
            pass

    def ask(self) -> F64:
        if not self._started:
            self._thread.start()
            self._started = True
        return self._points.get()

    def tell(self, x: F64, trace: Mapping[str, F64]) -> None:
        self._scores.add(trace)
        self._answers.put(float(self._scores.values[-1]))

    def close(self) -> None:
        if self._started:
            self._answers.put(None)
            self._thread.join()
