"""The running program of a formula that looks back without a limit, one sample at a time.

At time n, an instruction of horizon h has its value at step n − h. Operands of shorter horizons wait in queues. Windows
are two stacks over an associative ∘ [Tangwongsan15, §2]: a few applications a sample, amortised, and at most w stored
values; a window of the past without an end is one value:

    once[a,b] φ       max of φ over the last b − a + 1 steps, a steps ago               historically[a,b]: min
    φ since[0,b] ψ    B of (A₁,B₁) ∘ (A₂,B₂) = (min(A₁,A₂), max(B₂, min(A₂,B₁))) over the pairs (φ,ψ), oldest first
    φ since[a,b] ψ    min of historically[0,a−1] φ, and φ since[0,b−a] ψ a steps ago
    φ U[0,b] ψ        B of (A₁,B₁) ∘ (A₂,B₂) = (min(A₁,A₂), max(B₁, min(A₁,B₂)))          U[a,b]: as for since

Before the first value of a window there is its neutral element. A value is a pair (margin, truth), ordered by margin,
then by truth: as margin > 0 implies true and < 0 implies false, one lattice serves both semantics.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias, TypeVar, assert_never

from stltool.logic.formula import Constant, Label
from stltool.monitoring.comparisons import Predicate
from stltool.monitoring.intervals import NEGATED
from stltool.monitoring.program import Atom, Instruction

Value: TypeAlias = tuple[float, bool]
_Pair: TypeAlias = tuple[Value, Value]
_T = TypeVar("_T")

TRUE: Value = (math.inf, True)
FALSE: Value = (-math.inf, False)


class _Queue:
    """A value that waits: `push` returns the one pushed `delay` times ago, the neutral one before there is any."""

    def __init__(self, delay: int, neutral: Any) -> None:
        self.delay, self.neutral = delay, neutral
        self.values: deque[Any] = deque()

    def push(self, value: Any) -> Any:
        self.values.append(value)
        return self.values.popleft() if len(self.values) > self.delay else self.neutral

    def __len__(self) -> int:
        return len(self.values)


class _Window:
    """The aggregate of the last `width` values, as far as there are so many; without a width, of all."""

    def __init__(self, width: int | None, combine: Callable[[Any, Any], Any]) -> None:
        self.width, self.combine = width, combine
        self.older: list[Any] = []  # aggregates of the older values from each of them on, the oldest on top
        self.newer: list[Any] = []
        self.total: Any = None  # aggregate of the newer ones

    @property
    def contents(self) -> tuple[list[Any], list[Any], Any]:
        return self.older, self.newer, self.total

    @contents.setter
    def contents(self, kept: tuple[list[Any], list[Any], Any]) -> None:
        self.older, self.newer, self.total = kept

    def push(self, value: Any) -> Any:
        combine = self.combine
        if self.width is None:
            self.newer = [combine(self.newer[0], value) if self.newer else value]
            return self.newer[0]
        if len(self) == self.width:
            if not self.older:
                suffix = self.newer.pop()
                self.older.append(suffix)
                while self.newer:
                    suffix = combine(self.newer.pop(), suffix)
                    self.older.append(suffix)
            self.older.pop()
        self.total = combine(self.total, value) if self.newer else value
        self.newer.append(value)
        return combine(self.older[-1], self.total) if self.older else self.total

    def __len__(self) -> int:
        return len(self.older) + len(self.newer)


class Network:
    """The program over a stream. A node runs once the first values of its operands exist.

    If the trace has ended, windows of the future take neutral elements in the place of the steps that there are not:
    this cuts them at the end. What nodes compute for these steps themselves is not looked at, as windows of the past
    end at the step that is judged.
    """

    def __init__(self, instructions: Sequence[Instruction]) -> None:
        self._instructions = tuple(instructions)
        self._values: list[Any] = [None] * len(instructions)
        self._nodes: list[tuple[int, Callable[[list[Any]], None]]] = []
        self._states: list[_Queue | _Window] = []
        self._cut: dict[int, tuple[int, Callable[[list[Any]], None]]] = {}  # node: samples it is behind, what ends it
        self._horizon = [now.horizon or 0 for now in instructions]
        self.time = 0
        self._delayed: dict[tuple[int, int], int] = {}
        for out, now in enumerate(instructions):
            if now.op != "atom":
                self._add(out, now)

    def __getstate__(self) -> dict[str, Any]:
        states = [state.values if isinstance(state, _Queue) else state.contents for state in self._states]
        return {"instructions": self._instructions, "values": self._values, "states": states, "time": self.time}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.__init__(kept["instructions"])  # type: ignore[misc]  # nodes are functions, which are made again
        self._values[:], self.time = kept["values"], kept["time"]
        for state, contents in zip(self._states, kept["states"], strict=True):
            if isinstance(state, _Queue):
                state.values = contents
            else:
                state.contents = contents

    @property
    def stored(self) -> int:
        return sum(len(state) for state in self._states)

    def advance(self, atoms: Sequence[tuple[int, Value]], n_steps: int | None = None) -> Value | None:
        """The atoms of the next sample → the value of the formula that is now known, if any.

        `n_steps`: how many steps the trace has, if it has ended; atoms are then of no importance.
        """
        values, time = self._values, self.time
        for i, value in atoms:
            values[i] = value
        for number, (start, run) in enumerate(self._nodes):
            if start <= time:
                if n_steps is not None and number in self._cut and time - self._cut[number][0] >= n_steps:
                    self._cut[number][1](values)
                else:
                    run(values)
        self.time += 1
        found: Value = values[len(self._horizon) - 1]
        return found if time >= self._horizon[-1] else None

    def _add(self, out: int, now: Instruction) -> None:
        horizons = [self._horizon[arg] for arg in now.args]
        a, b, first, last = now.a, now.b, now.args[0], now.args[-1]
        start = max(horizons)
        match now.op:
            case "not":
                self._node(start, out, [first], lambda x: (0.0 - x[0], not x[1]))
            case "and" | "or" | "iff":
                args = [self._after(arg, start) for arg in now.args]
                function = _least if now.op == "and" else _greatest if now.op == "or" else _equivalent
                self._node(start, out, args, function)
            case "eventually" | "always":
                assert b is not None
                some = now.op == "eventually"
                window = _Window(b - a + 1, _greatest if some else _least)
                self._state(start + a, out, first, window, (start, FALSE if some else TRUE))
            case "until":
                assert b is not None
                args = [self._after(arg, start) for arg in now.args]
                both = self._paired(start + a, args, _Window(b - a + 1, _until), (start, (TRUE, FALSE)))
                before = self._window(start, args[0], a, _least) if a else None
                self._joined(start + b, out, both, before, b - a + 1)
            case "once" | "historically":
                some = now.op == "once"
                self._values[out] = FALSE if some else TRUE
                begins = max(start, a)
                window = _Window(None if b is None else b - a + 1, _greatest if some else _least)
                self._state(begins, out, self._after(first, begins), window)
            case "since" if b == 0:
                self._node(horizons[-1], out, [last], lambda x: x)
            case "since":
                args = [self._after(arg, start) for arg in now.args]
                ends = max(horizons[0], horizons[-1] - a, 0)
                both = self._paired(start, args, _Window(None if b is None else b - a + 1, _since))
                both = self._late(both, start, ends + a - start)
                before = self._window(horizons[0], first, a, _least) if a else None
                self._joined(ends, out, both, before, ends - horizons[0])
            case "atom":
                raise ValueError("an atom has no operands")
            case _:
                assert_never(now.op)

    def _joined(self, start: int, out: int, both: int, before: int | None, waits: int) -> None:
        """The lesser of a pair's right part and of a window that ended `waits` samples ago."""
        if before is None:
            self._node(start, out, [both], lambda pair: pair[1])
            return
        waited = self._late(before, start - waits, waits)
        self._node(start, out, [waited, both], lambda before, pair: _least(before, pair[1]))

    def _paired(self, start: int, args: Sequence[int], window: _Window, cut: tuple[int, Any] | None = None) -> int:
        pair, both = self._new(None), self._new((TRUE, FALSE))
        self._node(start, pair, args, lambda left, right: (left, right))
        self._state(start, both, pair, window, cut)
        return both

    def _window(self, start: int, arg: int, width: int, combine: Callable[[Any, Any], Any]) -> int:
        out = self._new(None)
        self._state(start, out, arg, _Window(width, combine))
        return out

    def _new(self, value: Any) -> int:
        self._values.append(value)
        return len(self._values) - 1

    def _after(self, arg: int, time: int) -> int:
        """The register in which an instruction's value is a step's later, known from this time on."""
        return self._late(arg, self._horizon[arg], time - self._horizon[arg])

    def _late(self, arg: int, start: int, delay: int) -> int:
        """The register of a value, known from `start` on, `delay` samples later; what it begins with until then."""
        if delay == 0:
            return arg
        if (arg, delay) not in self._delayed:
            neutral = self._values[arg]
            self._delayed[arg, delay] = out = self._new(neutral)
            self._state(start, out, arg, _Queue(delay, neutral))
        return self._delayed[arg, delay]

    def _node(self, start: int, out: int, args: Sequence[int], function: Callable[..., Any]) -> None:
        first, last = args[0], args[-1]

        def one(values: list[Any]) -> None:
            values[out] = function(values[first])

        def two(values: list[Any]) -> None:
            values[out] = function(values[first], values[last])

        self._nodes.append((start, one if len(args) == 1 else two))

    def _state(
        self, start: int, out: int, arg: int, state: _Queue | _Window, cut: tuple[int, Any] | None = None
    ) -> None:
        """`cut`: how many samples the operand is behind, and what is pushed in the place of steps after the end."""
        push = state.push

        def run(values: list[Any]) -> None:
            values[out] = push(values[arg])

        if cut is not None:
            behind, neutral = cut

            def end(values: list[Any]) -> None:
                values[out] = push(neutral)

            self._cut[len(self._nodes)] = behind, end
        self._states.append(state)
        self._nodes.append((start, run))


def judge_of(atom: Atom) -> Callable[[Mapping[str, float]], Value]:
    """The value of an atom at one sample. A name that begins as intervals.NEGATED is a label's negation."""
    match atom:
        case Constant(value):
            return lambda sample: TRUE if value else FALSE
        case Label(name) if name.startswith(NEGATED):
            label = name.removeprefix(NEGATED)
            return lambda sample: FALSE if sample[label] else TRUE
        case Label(name):
            return lambda sample: TRUE if sample[name] else FALSE
        case Predicate():
            return atom.at_one_sample()
        case _:
            assert_never(atom)


def _least(x: _T, y: _T) -> _T:
    return x if x <= y else y  # type: ignore[operator]


def _greatest(x: _T, y: _T) -> _T:
    return x if x >= y else y  # type: ignore[operator]


def _equivalent(x: Value, y: Value) -> Value:
    return _least(_greatest((0.0 - x[0], not x[1]), y), _greatest(x, (0.0 - y[0], not y[1])))


def _until(x: _Pair, y: _Pair) -> _Pair:
    return _least(x[0], y[0]), _greatest(x[1], _least(x[0], y[1]))


def _since(x: _Pair, y: _Pair) -> _Pair:
    return _least(x[0], y[0]), _greatest(y[1], _least(y[0], x[1]))
