"""Truth and robustness of a running trace: every step as soon as its samples have arrived.

Step t is decided by sample t + horizon(φ). The program of φ runs once per sample; at time t an instruction of horizon h
computes its value at step t − h, from operands that wait in a queue if their horizons are shorter. Windows of fixed
width w are aggregated by two stacks over an associative ∘, with three applications per sample, amortised, and at most w
stored values [Tangwongsan15, §2]:

    F[a,b] φ       max of φ over w = b−a+1 steps                                       G[a,b]: min
    φ U[0,w−1] ψ   B of (A₁,B₁) ∘ (A₂,B₂) = (min(A₁,A₂), max(B₁, min(A₁,B₂))) over the pairs (φ,ψ) of w steps
    φ U[a,b] ψ     min of φ over [t, t+a), and φ U[0,b−a] ψ at t+a

A value is a pair (margin, truth), ordered by margin, then by truth. As margin > 0 implies true and < 0 implies false,
the truth of the greatest pair is "some are true": one lattice serves both semantics.
"""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar, assert_never

import numpy as np

from stltool.arguments import described, mapping, one_of
from stltool.display import Card, Displayed, counted
from stltool.errors import FragmentError, NameLookupError, TraceError
from stltool.logic.formula import Constant, Formula, Label, bounded_formula_of
from stltool.logic.names import near_names
from stltool.logic.task import Task
from stltool.monitoring.comparisons import Predicate
from stltool.monitoring.offline import judge
from stltool.monitoring.program import Atom, Instruction, compile_delayed
from stltool.monitoring.samples import WHOLE, Earlier, Traces

Sample: TypeAlias = Mapping[str, float]
_Value: TypeAlias = tuple[float, bool]
_Pair: TypeAlias = tuple[_Value, _Value]
_T = TypeVar("_T")

_TRUE: _Value = (math.inf, True)
_FALSE: _Value = (-math.inf, False)


class Decision(NamedTuple):
    """Truth and robustness at one step."""

    step: int
    verdict: bool
    robustness: float

    def _repr_html_(self) -> str:
        verdict = "true" if self.verdict else "false"
        return Card(f"Decision: {verdict} at step {self.step}", [{"robustness": self.robustness}]).html()


class OnlineMonitor(Displayed):
    """Judges a trace sample by sample; memory and time per sample do not grow with the trace.

    The decisions after n samples are, bit for bit, those of `monitor` for these n samples with end "error"; with
    `finish(end)` they are those with that end. Raises StlSyntaxError if an interval has no end.
    """

    def __init__(self, phi: Formula | Task) -> None:
        self.formula = bounded_formula_of(phi, "OnlineMonitor's formula")
        made, self._program = compile_delayed(self.formula)
        self._judged, self._earlier = made.formula, Earlier(made)
        if self._program.has_past:
            raise FragmentError(f"{self.formula} looks back, which online monitors do not support yet; use monitor")
        instructions = self._program.instructions
        self.horizon: int = instructions[-1].horizon or 0
        self.n_steps = 0
        self._last: deque[Sample] = deque(maxlen=min(self.horizon, sys.maxsize))
        self._atoms = [(i, _atom(now.atom)) for i, now in enumerate(instructions) if now.atom is not None]
        self._network = _Network(instructions)

    def _card(self) -> Card:
        decided = max(0, self.n_steps - self.horizon)
        return Card(
            f"OnlineMonitor: {counted(self.n_steps, 'sample')} read, {counted(decided, 'step')} decided",
            [{"formula": self.formula}, {"horizon": self.horizon, "values held": self.stored}],
        )

    @property
    def stored(self) -> int:
        """The number of stored samples and values: per operator, at most a few times the horizon."""
        return len(self._last) + self._network.stored

    def feed(self, sample: Mapping[str, Any]) -> list[Decision]:
        """Take the next sample, a value for every name of φ; returns the decisions that it yields, at most one.

        Raises NameLookupError if a name is missing, TraceError if a value is not a finite number (for a label: neither
        true nor false), or gives a predicate no value or no margin. A refused sample leaves the monitor unchanged.
        """
        mapping(sample, "feed's sample", "{'x': 0.5}")
        bases = {name: self._real(name, self._given(name, sample)) for name in self._earlier.kept}
        values = self._read({**sample, **self._earlier.of(bases)} if self._earlier.made.starts or bases else sample)
        try:
            atoms = [(i, atom(values)) for i, atom in self._atoms]
        except TraceError as error:
            raise TraceError(f"step {self.n_steps}: {error}") from None
        value = self._network.advance(atoms)
        self._earlier.keep(bases)
        self._last.append(values)
        self.n_steps += 1
        if self.n_steps <= self.horizon:
            return []
        return [Decision(self.n_steps - 1 - self.horizon, value[1], value[0])]

    def finish(self, end: Literal["cut", "hold"] = "cut") -> list[Decision]:
        """The decisions of the remaining steps if the trace ended here. The monitor can still be fed."""
        one_of(end, "end", ("cut", "hold"))
        n = len(self._last)
        if n == 0:
            return []
        samples = list(self._last)
        if end == "hold":
            samples += [{**samples[-1], **made} for made in self._earlier.held()]
        arrays = {
            name: np.array([[sample[name] for sample in samples]])
            for name in (*self._program.variables, *self._program.labels)
        }
        traces = Traces(arrays, self._program, 1, len(samples), batch=False, first_step=self.n_steps - n)
        truth, margins = (found[:, :n] for found in judge(self._judged, traces, end, True, True))
        found = zip(range(self.n_steps - n, self.n_steps), truth[0].tolist(), margins[0].tolist(), strict=True)
        return [Decision(*decision) for decision in found]

    def _read(self, sample: Mapping[str, Any]) -> dict[str, float]:
        values: dict[str, float] = {}
        for name in self._program.labels:
            values[name] = self._label(name, self._given(name, sample))
        for name in self._program.variables:
            values[name] = self._real(name, self._given(name, sample))
        return values

    def _given(self, name: str, sample: Mapping[str, Any]) -> Any:
        try:
            return sample[name]
        except KeyError:
            message = f"the sample at step {self.n_steps} has no value of {name}; {near_names(name, sample)}"
            raise NameLookupError(message) from None

    def _label(self, name: str, value: Any) -> bool:
        if not isinstance(value, _NUMBERS) or value not in (0, 1):
            raise TraceError(
                f"{name} is {described(value)} at step {self.n_steps}; it is used as a label, which is true or false "
                "(1 or 0)"
            )
        return bool(value)

    def _real(self, name: str, value: Any) -> float:
        if type(value) is not float:
            if not isinstance(value, _NUMBERS) or isinstance(value, np.longdouble):
                raise TraceError(f"{name} is {described(value)} at step {self.n_steps}; give a float")
            if isinstance(value, int | np.integer) and abs(int(value)) > WHOLE:
                why = "integers beyond 2^53 may not be representable as a double; give a float"
                raise TraceError(f"{name} is {value} at step {self.n_steps}: {why}")
        real = float(value)
        if not math.isfinite(real):
            raise TraceError(f"{name} is {real} at step {self.n_steps}; monitors judge finite samples")
        return real


_NUMBERS = (int, float, np.bool_, np.integer, np.floating)


def _atom(atom: Atom) -> Callable[[Sample], _Value]:
    match atom:
        case Constant(value):
            return lambda sample: _TRUE if value else _FALSE
        case Label(name):
            return lambda sample: _TRUE if sample[name] else _FALSE
        case Predicate():
            return atom.at_one_sample()
        case _:
            assert_never(atom)


# ------------------------------------------------------------------------------------------- the running program


class _Queue:
    """A value that waits for others of the same step: `push` returns the one pushed `delay` times ago."""

    def __init__(self, delay: int) -> None:
        self.delay = delay
        self.values: deque[Any] = deque()

    def push(self, value: Any) -> Any:
        self.values.append(value)
        return self.values.popleft() if len(self.values) > self.delay else None

    def __len__(self) -> int:
        return len(self.values)


class _Window:
    """The aggregate of the last `width` values, once there are that many: two stacks, the older one of suffixes."""

    def __init__(self, width: int, combine: Callable[[Any, Any], Any]) -> None:
        self.width, self.combine = width, combine
        self.older: list[Any] = []  # aggregates of the older values from each of them on, the oldest on top
        self.newer: list[Any] = []
        self.total: Any = None  # aggregate of the newer ones

    def push(self, value: Any) -> Any:
        combine = self.combine
        self.total = combine(self.total, value) if self.newer else value
        self.newer.append(value)
        if len(self.older) + len(self.newer) < self.width:
            return None
        if not self.older:
            suffix = self.newer.pop()
            self.older.append(suffix)
            while self.newer:
                suffix = combine(self.newer.pop(), suffix)
                self.older.append(suffix)
            return self.older.pop()
        oldest = self.older.pop()
        return combine(oldest, self.total) if self.newer else oldest

    def __len__(self) -> int:
        return len(self.older) + len(self.newer)


_State: TypeAlias = _Queue | _Window


class _Network:
    """The program over a stream. A node runs once the first values of its operands exist."""

    def __init__(self, instructions: tuple[Instruction, ...]) -> None:
        self.values: list[Any] = [None] * len(instructions)
        self.nodes: list[tuple[int, Callable[[list[Any]], None]]] = []
        self.states: list[_State] = []
        self.result = len(instructions) - 1
        self.time = 0
        self._delayed: dict[tuple[int, int], int] = {}
        for out, now in enumerate(instructions):
            if now.op != "atom":
                self._add(out, now, [instructions[arg].horizon or 0 for arg in now.args])

    @property
    def stored(self) -> int:
        return sum(len(state) for state in self.states)

    def advance(self, atoms: list[tuple[int, _Value]]) -> Any:
        """The atoms of the next sample → the value of the formula that is now known, if any."""
        values, time = self.values, self.time
        for i, value in atoms:
            values[i] = value
        for start, run in self.nodes:
            if start <= time:
                run(values)
        self.time += 1
        return values[self.result]

    def _add(self, out: int, now: Instruction, horizons: list[int]) -> None:
        start = max(horizons)
        args = [self._delay(arg, h, start - h) for arg, h in zip(now.args, horizons, strict=True)]
        assert now.b is not None
        match now.op:
            case "not":
                self._node(start, out, args, lambda x: (0.0 - x[0], not x[1]))
            case "and":
                self._node(start, out, args, _least)
            case "or":
                self._node(start, out, args, _greatest)
            case "iff":
                self._node(start, out, args, _equivalent)
            case "eventually":
                self._state(start + now.a, out, args[0], _Window(now.b - now.a + 1, _greatest))
            case "always":
                self._state(start + now.a, out, args[0], _Window(now.b - now.a + 1, _least))
            case "until":
                self._until(start, out, args, now.a, now.b)
            case "once" | "historically" | "since":
                raise AssertionError("the past is refused")
            case "atom":
                raise ValueError("an atom has no operands")
            case _:
                assert_never(now.op)

    def _until(self, start: int, out: int, args: list[int], a: int, b: int) -> None:
        pair, both = self._new(), self._new()
        self._node(start, pair, args, lambda left, right: (left, right))
        self._state(start + a, both, pair, _Window(b - a + 1, _compose))
        if a == 0:
            self._node(start + b, out, [both], lambda pair: pair[1])
            return
        before = self._new()
        self._state(start, before, args[0], _Window(a, _least))
        waited = self._delay(before, start + a - 1, b - a + 1)
        self._node(start + b, out, [waited, both], lambda before, pair: _least(before, pair[1]))

    def _new(self) -> int:
        self.values.append(None)
        return len(self.values) - 1

    def _delay(self, arg: int, start: int, delay: int) -> int:
        """The register of the value of `arg`, known from time `start` on, `delay` samples later."""
        if delay == 0:
            return arg
        if (arg, delay) not in self._delayed:
            self._delayed[arg, delay] = out = self._new()
            self._state(start, out, arg, _Queue(delay))
        return self._delayed[arg, delay]

    def _node(self, start: int, out: int, args: list[int], function: Callable[..., Any]) -> None:
        first, last = args[0], args[-1]

        def one(values: list[Any]) -> None:
            values[out] = function(values[first])

        def two(values: list[Any]) -> None:
            values[out] = function(values[first], values[last])

        self.nodes.append((start, one if len(args) == 1 else two))

    def _state(self, start: int, out: int, arg: int, state: _State) -> None:
        push = state.push

        def run(values: list[Any]) -> None:
            values[out] = push(values[arg])

        self.states.append(state)
        self.nodes.append((start, run))


def _least(x: _T, y: _T) -> _T:
    return x if x <= y else y  # type: ignore[operator]


def _greatest(x: _T, y: _T) -> _T:
    return x if x >= y else y  # type: ignore[operator]


def _equivalent(x: _Value, y: _Value) -> _Value:
    return _least(_greatest((0.0 - x[0], not x[1]), y), _greatest(x, (0.0 - y[0], not y[1])))


def _compose(x: _Pair, y: _Pair) -> _Pair:
    return _least(x[0], y[0]), _greatest(x[1], _least(x[0], y[1]))
