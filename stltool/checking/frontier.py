"""How to relax a task: for which values of its params the best probability reaches a bound.

    { (v₁, v₂) :  opt_π P_π(Φ[v₁, v₂]) ≥ c }            over given values of one param or two

Where enlarging a param can only make the formula true of more runs (or only of fewer), for every pair of neighbouring
values (logic/implied.py proves it from the two formulas themselves), P is monotone in it, so

- of a directed param, the *tightest* value that reaches c is found by bisection: ⌈log₂ n⌉ + 1 checks instead of n;
- with two directed params, the tightest values of the second form a staircase over the first: at most n₁ + n₂ checks;
- anything else is scanned, value by value, and the result says so.

Every probe is an exact check with its enclosure. Where c lies inside one, the exact fraction decides; where that is not
possible, the probe is undecided, which counts as missing c and is reported.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal, TypeAlias

from stltool.arguments import flag, function, mapping, require
from stltool.checking.check import CheckResult, check
from stltool.checking.induction import Progress
from stltool.display import Card, Displayed
from stltool.errors import ModelError, SettingsError, SizeError, StlSyntaxError, near_misses
from stltool.logic.implied import order
from stltool.logic.quantities import Duration, ParamValue, Quantity, quantity, quantity_text
from stltool.logic.task import Task
from stltool.models import MDP
from stltool.numbers import NumberError, exact, number_text
from stltool.product import build_product

Values: TypeAlias = tuple[Quantity, ...]
_MOST_TASKS = 20_000  # combinations of values whose formulas are compared
_AROUND, _FRACTIONS = 40, 20  # values that a bare name stands for
_EXACT_SECONDS = 60.0  # that the exact fraction of a probe may take, by estimate


@dataclass(frozen=True)
class Param:
    """A param and the values asked about, ascending.

    direction  1 if larger values only weaken the task, −1 if they only strengthen it, 0 if neither is proved
    """

    name: str
    values: Values
    direction: Literal[-1, 0, 1]

    @property
    def tightest(self) -> str:
        """What the tightest value is: smallest or largest."""
        return "smallest" if self.direction > 0 else "largest"


@dataclass(frozen=True)
class Probe:
    """One check: the values of the params, P with its enclosure, and whether it is at least the bound (None:
    undecided)."""

    values: Values
    probability: float
    lower: float
    upper: float
    holds: bool | None


@dataclass(frozen=True)
class Step:
    """The tightest value of the last param for values of the others (none, or one); None if none of them reaches the
    bound. `probe` is the check at it, or at the loosest value."""

    others: Values
    tightest: Quantity | None
    probe: Probe


@dataclass(frozen=True, eq=False, repr=False)
class Frontier(Displayed):
    """For which values of a task's params the optimum is at least a bound.

    question  "maximum" | "minimum" (over all policies)
    method    "bisection" | "staircase" | "scan": of every combination, if the last param has no direction
    steps     by the value of the first of two params, or one; empty for a scan
    probes    every check that was made, in the order of the values
    seconds   wall time
    """

    model: MDP
    task: Task
    at_least: Fraction
    question: Literal["maximum", "minimum"]
    params: tuple[Param, ...]
    method: Literal["bisection", "staircase", "scan"]
    steps: tuple[Step, ...]
    probes: tuple[Probe, ...]
    seconds: float

    @property
    def undecided(self) -> tuple[Probe, ...]:
        """Probes whose enclosure contains the bound, where no exact fraction was possible."""
        return tuple(probe for probe in self.probes if probe.holds is None)

    def table(self) -> list[dict[str, Any]]:
        """Rows to print or to make a data frame of: the tightest values with P there, or every probe of a scan."""
        names, rows = [param.name for param in self.params], []
        for step in self.steps:
            row: dict[str, Any] = dict(zip(names, map(quantity_text, step.others), strict=False))
            last = self.params[-1]
            row[f"{last.tightest} {last.name}"] = "none" if step.tightest is None else quantity_text(step.tightest)
            rows.append({**row, **_enclosed(step.probe)})
        if self.method == "scan":
            for probe in self.probes:
                told = {True: "yes", False: "no", None: "undecided"}[probe.holds]
                values = dict(zip(names, map(quantity_text, probe.values), strict=True))
                rows.append({**values, f"P >= {number_text(self.at_least)}": told, **_enclosed(probe)})
        return rows

    @property
    def told(self) -> dict[str, str]:
        """The tightest values, in words, by the values of the first param; then what the task itself lacks."""
        if not self.steps:
            held = sum(probe.holds is True for probe in self.probes)
            return {"reached": f"by {held} of {len(self.probes)} combinations"}
        *first, last = self.params
        told = {}
        for tightest, group in itertools.groupby(self.steps, key=lambda step: step.tightest):
            steps = list(group)
            ends = [quantity_text(step.others[0]) for step in (steps[0], steps[-1]) if first]
            where = f" for {first[0].name} = {' … '.join(dict.fromkeys(ends))}" if first else ""
            found = "none of these values" if tightest is None else quantity_text(tightest)
            told[f"{last.tightest} {last.name}{where}"] = found
        own = tuple(self.task.params[param.name] for param in self.params)
        for step in self.steps:
            if step.others == own[:-1] and step.tightest not in (None, own[-1]):
                size = [_size(self.task, last.name, value) for value in (own[-1], step.tightest) if value is not None]
                verb = "must" if (size[1] > size[0]) == (last.direction > 0) else "could"
                move = "grow" if size[1] > size[0] else "shrink"
                at = f", at {first[0].name} = {quantity_text(own[0])}," if first else ""
                told["as written"] = (
                    f"{last.name} = {quantity_text(own[-1])}{at} {verb} {move} to {quantity_text(step.tightest)}"
                )
        return told

    def _card(self) -> Card:
        rows = self.table()
        columns = tuple(rows[0]) if rows else ()
        shown = [tuple(str(value) for value in row.values()) for row in rows[:_SHOWN]]
        directions = {1: "larger is weaker", -1: "larger is stronger", 0: "no direction is proved"}
        return Card(
            f"Frontier: {self.question} P >= {number_text(self.at_least)}, {len(self.probes)} checks, {self.method}",
            [
                {param.name: directions[param.direction] for param in self.params},
                self.told,
                {"task": str(self.task), "model": self.model.name, "undecided": len(self.undecided) or None},
            ],
            (columns, shown) if shown else None,
        )


_SHOWN = 20


def _enclosed(probe: Probe) -> dict[str, float]:
    return {"P": probe.probability, "lower": probe.lower, "upper": probe.upper}


def frontier(
    model: MDP,
    task: Task,
    at_least: float | str | Fraction,
    parameters: Mapping[str, Iterable[ParamValue] | None] | Sequence[str],
    *,
    maximize: bool = True,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Frontier:
    """The tightest values of one or two params of `task` for which the maximum (minimum) of P is at least a bound.

    `parameters` gives each its values: `{"T": range(1, 16), "tau": range(1, 13)}`; numbers, texts such as "0.5" or
    times such as "2s". A name alone (`["T", "tau"]`, or None for its values) stands for values around the param's own:
    from 1 to twice a whole number, at most 40 of them; twenty steps from 0 to twice a fraction. For each value of the
    first param, the tightest one of the second is found. Other params keep the values that they have in `task`.

    Raises SettingsError for other numbers of params, a param that the task does not have, no value, or too many;
    StlSyntaxError if the formula does not allow a value, such as an empty window; what `build_product` raises.
    """
    began = time.perf_counter()
    require(model, MDP, "frontier's model")
    require(task, Task, "frontier's task", "read one: stl.load_task(path), or stl.parse_task(text)")
    flag(maximize, "frontier's maximize")
    function(progress, "frontier's progress")
    model.require_points()
    bound = _bound(at_least)
    given = {name: _values(task, name, values) for name, values in _named(task, parameters).items()}
    tasks = _tasks(task, given)
    params = tuple(
        Param(name, values, _direction(tasks, i, [len(each) for each in given.values()]))
        for i, (name, values) in enumerate(given.items())
    )
    asked = _Asked(model, tasks, params, bound, maximize, memory_limit, progress)
    method, steps = asked.steps()
    return Frontier(
        model, task, bound, "maximum" if maximize else "minimum", params, method, steps, asked.probes(),
        time.perf_counter() - began,
    )  # fmt: skip


def _bound(at_least: object) -> Fraction:
    try:
        bound = exact(at_least)
    except NumberError as error:
        raise SettingsError(f"frontier's at_least: {error}; write a probability, such as 0.95") from None
    if not 0 <= bound <= 1:
        raise SettingsError(f"frontier's at_least is {number_text(bound)}; a probability lies between 0 and 1")
    return bound


def _named(task: Task, parameters: object) -> dict[str, Any]:
    if isinstance(parameters, list | tuple) and all(isinstance(name, str) for name in parameters):
        parameters = dict.fromkeys(parameters)
    known = mapping(parameters, "frontier's parameters", "{'T': range(1, 16)}")
    if len(known) not in (1, 2):
        raise SettingsError(f"frontier takes one or two params with their values, not {len(known)}")
    for name in known:
        if name not in task.params:
            raise SettingsError(f"the task has no param {name}; {near_misses(name, list(task.params))}")
    return {name: _around(task, name) if values is None else values for name, values in known.items()}


def _around(task: Task, name: str) -> list[Fraction]:
    """Values around a param's own, those that the formula allows."""
    own = task.params[name]
    if isinstance(own, Duration) or own == 0:
        example = "such as 1s and 2s" if isinstance(own, Duration) else "such as -1 and 1"
        raise SettingsError(f"param {name} is {quantity_text(own)}, which suggests no values; give some: {example}")
    if own.denominator == 1:
        most = abs(2 * own.numerator)
        found = [Fraction(k if own > 0 else -k) for k in range(1, most + 1, -(-most // _AROUND))]
    else:
        found = [2 * own * k / _FRACTIONS for k in range(_FRACTIONS + 1)]
    return [value for value in sorted({*found, own}) if _allowed(task, name, value)]


def _allowed(task: Task, name: str, value: Fraction) -> bool:
    try:
        task.with_params(**{name: value})
    except StlSyntaxError:
        return False
    return True


def _values(task: Task, name: str, values: Any) -> Values:
    """The distinct values, ascending."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise SettingsError(f"frontier's values of {name} are not a list; write, for example, range(1, 16)")
    listed = list(itertools.islice(values, _MOST_TASKS + 1))
    if len(listed) > _MOST_TASKS:
        raise SettingsError(f"param {name} has more than {_MOST_TASKS} values; give fewer")
    found = {quantity(name, getattr(value, "item", lambda value=value: value)()) for value in listed}
    if not found:
        raise SettingsError(f"param {name} has no values; write, for example, range(1, 16)")
    if len({type(value) for value in found}) > 1:
        raise SettingsError(f"some values of param {name} are times, others plain numbers; write all of them alike")
    return tuple(sorted(found, key=lambda value: _size(task, name, value)))


def _size(task: Task, name: str, value: Quantity) -> Fraction:
    if not isinstance(value, Duration):
        return value
    steps = value.in_steps(task.step)
    if steps is None:
        raise SettingsError(f"param {name}: {value} is a time, and the task declares no step; write step = 0.1s there")
    return steps


def _tasks(task: Task, given: Mapping[str, Values]) -> dict[Values, Task]:
    """The task for each combination of values."""
    combinations = 1
    for values in given.values():
        combinations *= len(values)
    if combinations > _MOST_TASKS:
        raise SettingsError(f"{combinations} combinations of values are more than {_MOST_TASKS}; give fewer")
    return {
        values: task.with_params(**dict(zip(given, values, strict=True)))
        for values in itertools.product(*given.values())
    }


def _direction(tasks: Mapping[Values, Task], axis: int, shape: Sequence[int]) -> Literal[-1, 0, 1]:
    """Whether formulas imply their neighbours along an axis, everywhere: 1, the converse: −1, or neither: 0."""
    formulas = [task.formula for task in tasks.values()]
    stride = 1 if axis == len(shape) - 1 else shape[-1]
    up = down = True
    for i, formula in enumerate(formulas):
        if (i // stride) % shape[axis] < shape[axis] - 1:
            found = order(formula, formulas[i + stride])
            up, down = up and found.up, down and found.down
    return 1 if up else -1 if down else 0


class _Asked:
    """Checks by combination of values, each made once."""

    def __init__(
        self,
        model: MDP,
        tasks: Mapping[Values, Task],
        params: tuple[Param, ...],
        bound: Fraction,
        maximize: bool,
        memory_limit: int | None,
        progress: Progress | None,
    ) -> None:
        self._model, self._tasks, self._params, self._bound, self._maximize = model, tasks, params, bound, maximize
        self._limit, self._progress = memory_limit, progress
        self._known: dict[Values, Probe] = {}

    def steps(self) -> tuple[Literal["bisection", "staircase", "scan"], tuple[Step, ...]]:
        *others, last = self._params
        if not last.direction:
            for values in self._tasks:
                self.probe(values)
            return "scan", ()
        if not others:
            return "bisection", (self._bisected((), 0),)
        (first,) = others
        if not first.direction:
            return "bisection", tuple(self._bisected((value,), 0) for value in first.values)
        steps, tightest = {}, 0
        for value in _by_tightness(first)[::-1]:  # from the loosest: what the next one needs is not tighter
            tightest, steps[value] = self._climbed((value,), tightest)
        return "staircase", tuple(steps[value] for value in first.values)

    def probe(self, values: Values) -> Probe:
        if values not in self._known:
            product = build_product(self._model, self._tasks[values], memory_limit=self._limit)
            found = check(product, maximize=self._maximize, keep_policy=False, memory_limit=self._limit)
            holds = found.at_least(self._bound)
            if holds is None:
                exactly = self._exactly(product)
                found, holds = (found, None) if exactly is None else (exactly, exactly.at_least(self._bound))
            self._known[values] = Probe(values, found.probability, found.lower, found.upper, holds)
            if self._progress is not None:
                self._progress(len(self._known), len(self._tasks))
        return self._known[values]

    def probes(self) -> tuple[Probe, ...]:
        return tuple(self._known[values] for values in self._tasks if values in self._known)

    def _exactly(self, product: Any) -> CheckResult | None:
        try:
            return check(
                product, maximize=self._maximize, exact=True, keep_policy=False, memory_limit=self._limit,
                time_limit=_EXACT_SECONDS,
            )  # fmt: skip
        except (ModelError, SizeError):  # rows that do not sum to 1, or an answer that would take too long
            return None

    def _bisected(self, others: Values, least: int) -> Step:
        """The tightest value that reaches the bound, if the loosest does."""
        values = _by_tightness(self._params[-1])
        loosest = self.probe((*others, values[-1]))
        if not loosest.holds:
            return Step(others, None, loosest)
        low, high = least, len(values) - 1
        while low < high:
            middle = (low + high) // 2
            low, high = (low, middle) if self.probe((*others, values[middle])).holds else (middle + 1, high)
        return Step(others, values[low], self.probe((*others, values[low])))

    def _climbed(self, others: Values, at: int) -> tuple[int, Step]:
        """The same, one by one, from a value on that is not looser."""
        values = _by_tightness(self._params[-1])
        while at < len(values):
            probe = self.probe((*others, values[at]))
            if probe.holds:
                return at, Step(others, values[at], probe)
            at += 1
        return at, Step(others, None, self.probe((*others, values[-1])))


def _by_tightness(param: Param) -> Values:
    return param.values if param.direction > 0 else param.values[::-1]
