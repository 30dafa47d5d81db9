"""The state of an online monitor, laid out for kernels/streams.py, and the calls that read samples into it.

The arrays have room for a number of samples. While that is less than a step's verdict can depend on, the monitor makes
larger ones when they are full, and reads the samples again, which are all kept: so nothing is as large as the horizon
before the trace is, and a sample still costs O(1), amortised.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, assert_never, cast

import numpy as np
from numpy.typing import NDArray

from stltool.kernels import streams as k
from stltool.logic.formula import Comparator, Constant, Formula, Label, Negate, Number, Term, Variable
from stltool.monitoring.comparisons import Predicate
from stltool.monitoring.early import Engine
from stltool.monitoring.program import PAST, Atom, Instruction, Program, formula_of_atom

Ints: TypeAlias = NDArray[np.int64]
Floats: TypeAlias = NDArray[np.float64]

_FIRST_ROOM = 1024
BEYOND = 2**60  # a time that never comes
COMPARATORS: dict[Comparator, int] = {
    ">": k.GREATER, ">=": k.GREATER_EQUAL, "<": k.LESS, "<=": k.LESS_EQUAL, "==": k.EQUAL, "!=": k.UNEQUAL,
}  # fmt: skip
OPERATORS = {
    "atom": k.OP_ATOM, "not": k.OP_NOT, "and": k.OP_AND, "or": k.OP_OR, "iff": k.OP_IFF,
    "eventually": k.OP_EVENTUALLY, "always": k.OP_ALWAYS, "until": k.OP_UNTIL,
    "once": k.OP_ONCE, "historically": k.OP_HISTORICALLY, "since": k.OP_SINCE,
}  # fmt: skip


class Stream:
    """The arrays of one monitor.

    names    variables, then labels: the columns of samples       depth  samples that an open verdict can depend on
    given    the atoms, by number, whose margin and truth come with each sample
    start    the step of the first sample read into these arrays
    """

    def __init__(
        self, program: Program, engine: Engine, horizon: int, waits: bool, start: int = 0, room: int = _FIRST_ROOM
    ) -> None:
        self.names = tuple(dict.fromkeys((*program.variables, *program.labels)))
        back = program.lookback
        assert back is not None
        self.depth = horizon + back + 1
        self.atoms = [now.atom for now in program.instructions if now.atom is not None]
        self.given = [i for i, atom in enumerate(self.atoms) if not _is_inside(atom)]
        self._program, self._engine, self._horizon, self._waits = program, engine, horizon, waits
        self._empty: tuple[Ints, Floats, NDArray[np.uint64]] | None = None  # arrays before the first sample
        self.N, self.F, self.B = _laid_out(program, engine, self.names, horizon, waits, start, room)
        self._bind()

    values: Any
    header: Any
    told_now: Any

    def _bind(self) -> None:
        """Views of the arrays that are quick to read and write from Python."""
        N, F = self.N, self.F
        self.header = memoryview(cast(Any, N))[: k.HEADER]
        self.values = memoryview(cast(Any, F))[N[k.VALUES] : N[k.VALUES] + len(self.names)]
        self.told_now = memoryview(cast(Any, N))[N[k.TOLD_NOW] :]

    def __getstate__(self) -> dict[str, Any]:
        bound = ("values", "header", "told_now")
        return {name: value for name, value in self.__dict__.items() if name not in bound}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    @property
    def n_steps(self) -> int:
        return int(self.header[k.TIME] + self.header[k.BASE])

    @property
    def n_read(self) -> int:
        """The number of samples read into these arrays."""
        return int(self.header[k.TIME])

    @property
    def room(self) -> int:
        return int(self.header[k.ROOM])

    def set_given(self, i: int, margin: float, truth: bool) -> None:
        at = self.header[k.GIVEN] + 2 * i
        self.F[at], self.F[at + 1] = margin, truth

    def told(self) -> bytes:
        """The runs of decisions that the last sample yielded, in any order (`advance` in kernels/streams.py)."""
        found: bytes = self.told_now[: 2 * self.header[k.TOLD]].tobytes()
        return found

    def kept(self) -> Floats:
        """The last samples, at most `depth`, oldest first: (n, n_names)."""
        time, size, begin, width = self.n_read, self.header[k.N_KEPT], self.header[k.KEPT], len(self.names)
        rows = self.F[begin : begin + size * width].reshape(size, width)
        n = min(time, self.depth)
        first = (time - n) % size
        return rows[first : first + n].copy() if first + n <= size else rows[np.arange(time - n, time) % size]

    def verdict(self, step: int) -> bool | None:
        """The verdict of one of the last `depth` steps, if it is decided."""
        found = int(self._verdicts(step)[0])
        return None if found == k.OPEN else found == 2

    def _verdicts(self, first: int) -> Ints:
        """The entries of VERDICT, from one of the last `depth` steps on, without SAME."""
        N = self.N
        begin = max(min(first - N[k.BASE], N[k.TIME] - 1 - N[k.HORIZON]), 0)  # which is not SAME
        times = np.arange(begin, N[k.TIME])
        found: Ints = N[N[k.VERDICT] + times % N[k.SLOTS]]
        own = np.where(found == k.SAME, 0, times - begin)
        return found[np.maximum.accumulate(own)][first - N[k.BASE] - begin :]

    def truths(self, leaves: Sequence[Formula]) -> list[bool]:
        """The truths of labels and comparisons at the last sample."""
        numbers = {formula_of_atom(atom): i for i, atom in enumerate(self.atoms)}
        begin = self.header[k.TRUTH]
        return [bool(self.N[begin + numbers[leaf]]) for leaf in leaves]

    def undecided(self, first: int) -> Ints:
        """The steps without a verdict, from one of the last `depth` ones on."""
        open_: Ints = first + np.flatnonzero(self._verdicts(first) == k.OPEN)
        return open_

    def read(self, samples: Floats, given: Floats) -> tuple[Ints, NDArray[np.bool_], Floats] | int:
        """Read samples (n, n_names), with margins and truths (n, n_given, 2) of the atoms `given`.

        Returns steps and verdicts of the decisions, and the final margins that the samples yield, (n,), NaN before
        there are any; or the number of the sample that is refused, or for which there is no room.
        """
        most = len(samples) + min(self._horizon + 1, int(self.N[k.TIME]))
        steps, verdicts, margins = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(len(samples))
        which, rows = np.array(self.given, dtype=np.int64), np.ascontiguousarray(samples)
        count = k.advance_all(self.N, self.F, self.B, rows, given, which, steps, verdicts, margins)
        return -1 - count if count < 0 else (steps[:count], verdicts[:count] == 1, margins)

    def larger(self) -> Stream:
        """A monitor's arrays with more room, to which the kept samples are still to be read."""
        room = 4 * int(self.N[k.ROOM])
        return Stream(self._program, self._engine, self._horizon, self._waits, int(self.N[k.BASE]), room)

    def afresh(self, start: int) -> Stream:
        """Empty arrays for samples from a step on, with all the room that there can be: these ones if they have it."""
        if self._empty is None:
            made = Stream(self._program, self._engine, self._horizon, self._waits, 0, self.depth)
            self._empty = made.N, made.F, made.B
        N, F, B = self._empty
        if self.room == BEYOND:
            other = self
            self.N[:], self.F[:], self.B[:] = N, F, B
        else:
            other = Stream.__new__(Stream)
            other.__dict__.update(self.__getstate__())
            other.N, other.F, other.B = N.copy(), F.copy(), B.copy()
            other._bind()
        other.N[k.BASE] = start
        return other


class Call:
    """Reads the single samples that were written to `values`, into whichever arrays it is bound to.

    advance  takes `root`
    latest   its item 0 is, after a call, the robustness of the newest step that has a final one

    Without compilation, the kernel is called in Python.
    """

    def __init__(self, stream: Stream) -> None:
        self._root = np.zeros(k.ROOT, dtype=np.int64)
        self._latest = np.zeros(1)
        self.root = self._root.ctypes.data
        self.latest: Any = memoryview(cast(Any, self._latest))
        self.bind(stream)

    @functools.cached_property
    def advance(self) -> Callable[[int], int]:
        return k.entry_point(k.feed_values) if hasattr(k.feed_values, "py_func") else self._advance

    def bind(self, stream: Stream) -> None:
        self._stream = stream
        N, F, B = stream.N, stream.F, stream.B
        self._root[:] = (N.ctypes.data, len(N), F.ctypes.data, len(F), B.ctypes.data, len(B), self._latest.ctypes.data)

    def _advance(self, root: int) -> int:
        N, F, B = self._stream.N, self._stream.F, self._stream.B
        code = int(k.advance(N, F, B))
        self._latest[0] = F[N[k.MARGIN] + N[k.RESULT]]
        return code


# --------------------------------------------------------------------------------------------------------- layout


def _is_inside(atom: Atom) -> bool:
    """Whether the kernel judges the atom by itself: a constant, a label, or a comparison of signals and numbers."""
    return not isinstance(atom, Predicate) or (is_plain(atom) and bool(atom.names)) or _fixed(atom) is not None


def is_plain(atom: Predicate) -> bool:
    """Whether both sides are a signal or a number, perhaps negated."""
    for side in (atom.node.left, atom.node.right):
        while isinstance(side, Negate):
            side = side.arg
        if not isinstance(side, Variable | Number):
            return False
    return True


def _fixed(atom: Atom) -> tuple[float, bool] | None:
    """Margin and truth of an atom that reads no signal, if it has them."""
    if isinstance(atom, Constant):
        return (np.inf, True) if atom.value else (-np.inf, False)
    if isinstance(atom, Label) or atom.names:
        return None
    truth, margin = np.empty((1, 1), np.bool_), np.empty((1, 1))
    with np.errstate(all="ignore"):
        atom.judge({}, truth, margin, False)
    return None if np.isnan(margin[0, 0]) else (float(margin[0, 0]), bool(truth[0, 0]))


def _laid_out(
    program: Program, engine: Engine, names: Sequence[str], horizon: int, waits: bool, start: int, room: int
) -> tuple[Ints, Floats, NDArray[np.uint64]]:
    instructions = program.instructions
    back = program.lookback
    assert back is not None
    depth = horizon + back + 1
    room = min(room, depth)
    N, F, B = _Tables(k.HEADER, np.int64), _Tables(0, np.float64), _Tables(0, np.uint64)
    network = _Network(instructions, room)
    atoms = [now for now in instructions if now.atom is not None]
    read = [now.atom for now in instructions if now.atom is not None]
    head = N.first
    head[k.BASE], head[k.ROOM], head[k.HORIZON] = start, BEYOND if room == depth else room, min(horizon, room)
    head[k.WAITS], head[k.RESULT] = waits, network.registers[-1]
    head[k.N_NAMES], head[k.N_ATOMS], head[k.N_NODES] = len(names), len(atoms), len(network.nodes)
    n_kept, slots = _power_of_two(room), _power_of_two(room + 1)
    head[k.N_KEPT], head[k.SLOTS] = n_kept, slots
    head[k.NAMES] = N.add([name not in program.variables for name in names])
    head[k.ATOMS] = N.add([_atom_row(atom, names) for atom in read])
    head[k.TRUTH] = N.add(len(atoms))
    head[k.NODES], head[k.COUNTERS] = N.add(network.nodes), N.add(3 * len(network.nodes))
    head[k.MARK], head[k.VERDICT], head[k.TOLD_NOW] = N.add(network.length), N.add(slots), N.add(2 * room)
    head[k.VALUES] = F.add(len(names))
    head[k.NUMBERS] = F.add([_numbers(atom) for atom in read])
    head[k.GIVEN] = F.add([_fixed(atom) or (0.0, 0.0) for atom in read])
    ring = np.full(network.length, -np.inf)
    # what has not been computed yet is an empty window's value
    head[k.MARGIN] = F.add(np.full(network.n_registers, -np.inf))
    head[k.RING], head[k.KEPT] = F.add(ring), F.add(n_kept * len(names))
    if engine.delta is not None:
        _add_automaton(head, N, engine, atoms, room)
    else:
        head[k.BACK] = min(max(back, 1), room) if program.has_past else 0
        _add_structure(head, N, B, instructions, len(atoms), room)
    return N.array(), F.array(), B.array()


def _power_of_two(n: int) -> int:
    """The least power of two that is at least n."""
    return 1 << (n - 1).bit_length()


class _Tables:
    """An array that is put together from tables."""

    def __init__(self, header: int, dtype: Any) -> None:
        self.first = np.zeros(header, dtype=dtype)
        self._dtype = dtype
        self._parts = [self.first]
        self._length = header

    def add(self, table: Any) -> int:
        """Append a table, or so many zeros; returns where it begins."""
        values = np.zeros(table, self._dtype) if isinstance(table, int) else np.array(table, dtype=self._dtype).ravel()
        self._parts.append(values)
        self._length += len(values)
        return self._length - len(values)

    def array(self) -> NDArray[Any]:
        return np.concatenate([*self._parts, np.zeros(1, self._dtype)])


def _add_automaton(head: Ints, N: _Tables, engine: Engine, atoms: Sequence[Instruction], room: int) -> None:
    assert engine.letter is not None
    assert engine.delta is not None
    numbers = {formula_of_atom(now.atom): i for i, now in enumerate(atoms) if now.atom is not None}
    n_states = engine.delta.shape[1]
    assert engine.starts is not None
    assert engine.begins is not None
    head[k.N_LEAVES], head[k.N_STATES], head[k.N_STARTS] = len(engine.leaves), n_states, len(engine.begins)
    head[k.STARTS], head[k.BEGINS] = N.add(engine.starts), N.add(engine.begins)
    head[k.LEAVES], head[k.LETTER] = N.add([numbers[leaf] for leaf in engine.leaves]), N.add(engine.letter)
    slots = int(head[k.SLOTS])
    head[k.DELTA] = N.add(engine.delta)
    if engine.closed is not None:
        head[k.ENGINE] = k.EACH
        head[k.CLOSED], head[k.OPEN_STATES] = N.add(engine.closed), N.add(np.full(slots, -1))
        return
    assert engine.first is not None
    assert engine.outcome is not None
    head[k.ENGINE] = k.COALESCED
    head[k.FIRST], head[k.OUTCOME] = N.add(engine.first), N.add(engine.outcome)
    head[k.LISTS] = N.add(np.full(k.LIST_ROWS * (n_states + 1), -1))
    head[k.FOLLOWING], head[k.LAST] = N.add(slots), N.add(slots)


def _add_structure(
    head: Ints, N: _Tables, B: _Tables, instructions: Sequence[Instruction], n_atoms: int, room: int
) -> None:
    words, n = _power_of_two(room // 64 + 3), len(instructions)
    numbers = {i: number for number, i in enumerate(i for i, now in enumerate(instructions) if now.atom is not None)}
    rows: list[list[int]] = []
    for i, now in enumerate(instructions):
        first = numbers.get(i, now.args[0] if now.args else 0)
        second = now.args[-1] if now.args else 0
        assert now.b is not None
        row = [OPERATORS[now.op], first, second, min(now.a, BEYOND), min(now.b, BEYOND)]
        rows.append([*row, *_beyond(now, [rows[arg][5:] for arg in now.args])])
    wide = words + int(head[k.HORIZON]) // 64 + 2
    head[k.ENGINE], head[k.N_OPS], head[k.N_WORDS], head[k.N_LANES] = k.STRUCTURE, n, words, wide
    head[k.PROGRAM] = N.add(rows)
    head[k.KNOWN], head[k.LANES] = B.add((n_atoms + 1) * words), B.add((2 * n + 3) * wide)


def _beyond(now: Instruction, below: list[list[int]]) -> list[int]:
    """Whether the instruction is surely true, and possibly true, where no sample is known."""
    match now.op:
        case "atom":
            assert now.atom is not None
            fixed = _fixed(now.atom)
            return [0, 1] if fixed is None else [int(fixed[1]), int(fixed[1])]
        case "not":
            return [1 - below[0][1], 1 - below[0][0]]
        case "and":
            return [min(x, y) for x, y in zip(*below, strict=True)]
        case "or":
            return [max(x, y) for x, y in zip(*below, strict=True)]
        case "iff":
            (p, q), (r, s) = below
            return [min(max(1 - q, r), max(p, 1 - s)), min(max(1 - p, s), max(q, 1 - r))]
        case "eventually" | "always":
            return below[0]
        case "until":
            if now.a == 0:
                return below[1]
            return [min(x, y) for x, y in zip(*below, strict=True)]
        case "once" | "historically" | "since":
            return [0, 1]
        case _:
            assert_never(now.op)


def _atom_row(atom: Atom, names: Sequence[str]) -> list[int]:
    nothing = [0, -1, 1, -1, 1]
    if _fixed(atom) is not None:
        return [k.FIXED, *nothing]
    if isinstance(atom, Label):
        return [k.LABEL, names.index(atom.name), *nothing[1:]]
    if not _is_inside(atom):
        return [k.GIVEN_ATOM, *nothing]
    assert isinstance(atom, Predicate)
    return [k.PLAIN, COMPARATORS[atom.node.op], *side_of(atom.node.left, names), *side_of(atom.node.right, names)]


def side_of(term: Term, names: Sequence[str], sign: int = 1) -> tuple[int, int]:
    """The column of a plain term, −1 for a number, and its sign."""
    if isinstance(term, Negate):
        return side_of(term.arg, names, -sign)
    return (names.index(term.name) if isinstance(term, Variable) else -1), sign


def _numbers(atom: Atom) -> tuple[float, float]:
    if not isinstance(atom, Predicate) or not is_plain(atom):
        return 0.0, 0.0
    return number_of(atom.node.left), number_of(atom.node.right)


def number_of(term: Term) -> float:
    if isinstance(term, Negate):
        return -number_of(term.arg)
    return float(term.value) if isinstance(term, Number) else 0.0


class _Network:
    """The nodes that compute margins: at time n, an instruction of horizon h has its value of step n − h.

    Operands of shorter horizon wait in a queue. `registers` has the register of each instruction; those of atoms come
    first.
    """

    def __init__(self, instructions: Sequence[Instruction], room: int) -> None:
        self.nodes: list[list[int]] = []
        self.length = 0
        self._room = room
        self._instructions = instructions
        self._waiting: dict[tuple[int, int], int] = {}
        atoms = [i for i, now in enumerate(instructions) if now.atom is not None]
        others = [i for i, now in enumerate(instructions) if now.atom is None]
        number = {i: n for n, i in enumerate([*atoms, *others])}
        self.registers = [number[i] for i in range(len(instructions))]
        self.n_registers = len(instructions)
        for i in others:
            self._add(i, instructions[i])

    def _add(self, i: int, now: Instruction) -> None:
        assert now.b is not None
        horizons = [self._instructions[arg].horizon or 0 for arg in now.args]
        start, out, a, b = max(horizons), self.registers[i], now.a, now.b
        args: list[int] = []
        if now.op not in PAST:
            args = [self._wait(self.registers[arg], h, start - h) for arg, h in zip(now.args, horizons, strict=True)]
        match now.op:
            case "not":
                self._node(k.NOT, out, args, start, start)
            case "and":
                self._node(k.AND, out, args, start, start)
            case "or":
                self._node(k.OR, out, args, start, start)
            case "iff":
                self._node(k.IFF, out, args, start, start)
            case "eventually" | "always":
                self._window(k.GREATEST if now.op == "eventually" else k.LEAST, out, args, start + a, b - a + 1)
            case "until":
                both = out if a == 0 else self._new()
                held = min(b - a + 1, self._room)
                self._node(k.UNTIL, both, args, start + a, start + b, held, 4 * held + 2)
                if a > 0:
                    before = self._new()
                    self._window(k.LEAST, before, args[:1], start, a)
                    before = self._wait(before, start + a - 1, b - a + 1)
                    self._node(k.AND, out, [before, both], start + b, start + b)
            case "once" | "historically":
                kind = k.GREATEST if now.op == "once" else k.LEAST
                self._earlier(kind, out, self.registers[now.args[0]], horizons[0], now)
            case "since":
                self._since(out, now, horizons)
            case "atom":
                raise AssertionError("an atom has no operands")
            case _:
                assert_never(now.op)

    def _new(self) -> int:
        self.n_registers += 1
        return self.n_registers - 1

    def _node(self, op: int, out: int, args: list[int], pushes: int, shows: int, width: int = 0, size: int = 0) -> None:
        times = [min(pushes, BEYOND), min(shows, BEYOND)]
        self.nodes.append([op, out, args[0], args[-1], *times, width, self.length, size])
        self.length += size

    def _wait(self, register: int, start: int, delay: int) -> int:
        """The register of a value, known from time `start` on, `delay` samples later."""
        if delay == 0:
            return register
        if (register, delay) not in self._waiting:
            self._waiting[register, delay] = out = self._new()
            held = min(delay, self._room)
            self._node(k.DELAY, out, [register], start, start + delay, held, _power_of_two(held + 1))
        return self._waiting[register, delay]

    def _window(self, op: int, out: int, args: list[int], pushes: int, width: int) -> None:
        held = min(width, self._room)
        self._node(op, out, args, pushes, pushes + width - 1, held, _power_of_two(held + 1))

    def _earlier(self, op: int, out: int, register: int, horizon: int, now: Instruction) -> None:
        """A window of the past: its operand, of this horizon, comes as late as its newest step is needed."""
        assert now.horizon is not None
        assert now.b is not None
        first = now.horizon + now.a  # the time at which the operand's step 0 enters
        held = min(now.b - now.a + 1, self._room)
        args = [self._wait(register, horizon, first - horizon)]
        self._node(op, out, args, first, now.horizon, held, _power_of_two(held + 1))

    def _since(self, out: int, now: Instruction, horizons: list[int]) -> None:
        """φ since[a,b] ψ: at t, φ throughout t−a+1 … t, and φ since[0,b−a] ψ at t−a."""
        assert now.horizon is not None
        assert now.b is not None
        left, right = (self.registers[arg] for arg in now.args)
        a, known = now.a, now.horizon
        if now.b == 0:
            self._node(k.OR, out, [self._wait(right, horizons[1], known - horizons[1])] * 2, known, known)
            return
        start = max(horizons)
        pairs = [self._wait(register, h, start - h) for register, h in zip((left, right), horizons, strict=True)]
        both = out if a == 0 else self._new()
        held = min(now.b - a + 1, self._room)
        self._node(k.SINCE, both, pairs, start, start, held, 4 * held + 2)
        if a > 0:
            within = self._new()
            held = min(a, self._room)
            self._node(
                k.LEAST, within, [self._wait(left, horizons[0], known - horizons[0])], known, known, held,
                _power_of_two(held + 1),
            )  # fmt: skip
            self._node(k.AND, out, [within, self._wait(both, start, known + a - start)], known, known)
