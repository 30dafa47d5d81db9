"""The budgeted search for inputs under which a system violates a formula."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import described, function, mapping, one_of, whole
from stltool.diagnosis import Diagnosis, diagnose
from stltool.display import Card, Displayed, counted
from stltool.errors import ArgumentError, NameLookupError, TraceError, near_misses
from stltool.logic.formula import Formula, bounded_formula_of, horizon, label_names, variables
from stltool.logic.parser import parse
from stltool.logic.task import Task
from stltool.monitoring import monitor
from stltool.randomness import Purpose, generator
from stltool.testing.falsification.inputs import F64, Inputs, InputsGiven, Signal
from stltool.testing.falsification.methods import Method, searcher

System = Callable[[dict[str, Any]], Mapping[str, ArrayLike]]
Progress = Callable[[int, int], None]

_LARGEST = 1e100  # of signals that the formula does not name: their squares are finite


@dataclass(frozen=True, eq=False, repr=False)
class Falsification(Displayed):
    """What a search has found. True as a condition (`if result`) if it has found a violation.

    falsified    whether some execution violated the formula; otherwise this says nothing of those not tried
    executions   how often the system was executed, at most the budget
    points       the inputs of the violation, or of the execution that came nearest: control points (points,), numbers
    inputs       the same as the system was given them: arrays (steps,), numbers
    trace        name → array (h + 1,): what it answered, with the inputs that it did not return itself
    robustness   of that trace;  history  (executions,) float64: of all of them, in order
    """

    formula: Formula
    falsified: bool
    executions: int
    points: Mapping[str, Any]
    inputs: Mapping[str, Any]
    trace: Mapping[str, NDArray[Any]]
    robustness: float
    history: F64
    method: str
    seed: int
    seconds: float
    given: Mapping[str, Signal | tuple[float, float]]

    def __bool__(self) -> bool:
        return self.falsified

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """Why the trace violates the formula, or satisfies it."""
        return diagnose(self.formula, self.trace)

    @property
    def code(self) -> str:
        """The inputs as Python code: `system(…)` is the same execution again."""
        parts = []
        for name, one in self.inputs.items():
            if isinstance(self.given[name], Signal):
                values, counts = _runs(one)
                parts.append(f"{name!r}: np.repeat({values!r}, {counts!r})")
            else:
                parts.append(f"{name!r}: {one!r}")
        return f"{{{', '.join(parts)}}}"

    def _card(self) -> Card:
        found = "a violation" if self.falsified else "no violation"
        return Card(
            f"Falsification: {found} in {counted(self.executions, 'execution')}, robustness {self.robustness:.6g}",
            [
                {name: _shown(point) for name, point in self.points.items()},
                {"formula": self.formula, "method": self.method, "seed": self.seed},
            ],
        )


def falsify(
    system: System,
    phi: Formula | Task | str,
    inputs: InputsGiven,
    *,
    budget: int = 300,
    seed: int = 0,
    steps: int | None = None,
    method: Method = "portfolio",
    progress: Progress | None = None,
) -> Falsification:
    """Search for inputs under which `system` violates φ, on at most `budget` executions; ends with the first violation.

    system    called with {name: value}: an array (steps,) float64 for each signal, a float for each number; returns
              a trace, name → array of horizon(φ) + 1 samples or more. Names that it does not return are inputs
    phi       bounded; judged at step 0, exactly: robustness steers, the verdict decides
    inputs    name → `Signal(low, high, points=…)`, or (low, high) for a number
    steps     samples of a signal; default: horizon(φ) + 1
    seed      same seed, same search, for a system that answers the same
    method    "portfolio": stltool's own (search.py); "random": uniform points; "annealing": scipy's dual annealing;
              "cma", "optuna": those packages (pip install 'stltool[falsify]')
    progress  called with (executions done, budget)

    An exception of the system goes to the caller, with the inputs as a note. Raises what `monitor` raises,
    SettingsError for settings out of range, and MissingExtraError.
    """
    if not callable(system):
        raise ArgumentError(f"falsify's system is {described(system)}, not a function; write one of the inputs that "
                            "returns a trace")  # fmt: skip
    formula = bounded_formula_of(parse(phi) if isinstance(phi, str) else phi, "falsify's formula")
    budget = whole(budget, "budget", least=1)
    one_of(method, "method", get_args(Method))
    function(progress, "falsify's progress")
    rng = generator(seed, Purpose.FALSIFY)
    needed = horizon(formula) + 1
    cube = Inputs(inputs, needed if steps is None else whole(steps, "steps", least=1))
    search = searcher(method, formula, cube, rng)
    start = time.perf_counter()
    history: list[float] = []
    best: tuple[float, F64, dict[str, F64]] | None = None
    falsified = False
    try:
        for done in range(1, budget + 1):
            x = np.clip(search.ask(), 0, 1)
            trace = executed(system, formula, cube, x, needed)
            result = monitor(formula, trace, at=0)
            assert result.verdicts is not None  # both are asked for
            assert result.robustness is not None
            falsified, robustness = not result.verdicts[0], float(result.robustness[0])
            history.append(robustness)
            if best is None or falsified or robustness < best[0]:
                best = robustness, x, trace
            if progress is not None:
                progress(done, budget)
            if falsified:
                break
            search.tell(x, trace)
    finally:
        search.close()
    assert best is not None  # there was an execution
    robustness, x, trace = best
    labels = label_names(formula)
    return Falsification(
        formula, falsified, len(history), cube.points(x), cube.values(x),
        {name: one.astype(np.bool_) if name in labels else one for name, one in trace.items()},
        robustness, np.array(history), method, int(seed), time.perf_counter() - start, cube.given,
    )  # fmt: skip


def executed(system: System, formula: Formula, inputs: Inputs, x: F64, needed: int) -> dict[str, F64]:
    """The trace of an execution, (needed,) float64 each, with the inputs that the system does not return."""
    values = inputs.values(x)
    try:
        answer = system(
            {name: value.copy() if isinstance(value, np.ndarray) else value for name, value in values.items()}
        )
    except Exception as error:
        error.add_note(f"raised by the system under the inputs {_plain(values)}")
        raise
    trace: dict[str, F64] = {}
    needed_names = {**variables(formula), **label_names(formula)}
    for name, given in mapping(answer, "the system's signals", '{"x": array}').items():
        try:
            array = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.empty(())
        usable = array.ndim == 1 and len(array) >= needed
        if name not in needed_names and not (usable and (np.abs(array[:needed]) < _LARGEST).all()):
            continue  # the search can do without it
        if not usable:
            shape = f"of shape {array.shape}" if array.ndim else f"{described(given)}"
            raise TraceError(
                f"the system's signal {name} is {shape}; return at least {needed} samples, since the horizon of the "
                f"formula is {needed - 1}"
            )
        trace[name] = array[:needed]
    for name in needed_names:
        if name not in trace and name in values:
            value = values[name]
            array = np.full(needed, value) if isinstance(value, float) else value
            if len(array) >= needed:
                trace[name] = array[:needed]
        if name not in trace:
            raise NameLookupError(
                f"the system returns no signal {name}, which the formula names; {near_misses(name, trace)}"
            )
    return trace


def _runs(samples: F64) -> tuple[list[float], list[int]]:
    """Run lengths."""
    firsts = np.flatnonzero(np.diff(samples, prepend=np.nan) != 0)
    return samples[firsts].tolist(), np.diff(firsts, append=len(samples)).tolist()


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}


def _shown(point: Any) -> str:
    if isinstance(point, float):
        return f"{point:.6g}"
    return "[" + ", ".join(f"{value:.4g}" for value in point.tolist()) + "]"
