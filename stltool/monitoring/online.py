"""Truth and robustness of a running trace: verdicts as soon as they are certain, robustness once it is final.

A verdict is told as soon as every continuation of the trace agrees on it (early.py says how, and where it may take
longer). The robustness of step t is final at sample t + horizon(φ); before, `bounds` encloses it (intervals.py). What
runs per sample is in kernels/streams.py, over arrays that stream.py lays out.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described, mapping, one_of, require, whole
from stltool.display import Card, Displayed, counted
from stltool.errors import NameLookupError, SettingsError, TraceError
from stltool.kernels.told import FULL, NOTHING, REFUSED, SEVERAL
from stltool.logic.formula import Composable, Constant, Formula, bounded_formula_of
from stltool.logic.names import near_names
from stltool.logic.rewrite import negation_normal_form
from stltool.logic.shifts import Delayed
from stltool.logic.task import Task
from stltool.monitoring.blocks import Block
from stltool.monitoring.comparisons import Predicate
from stltool.monitoring.compiled import Compiled, compiled, within
from stltool.monitoring.decisions import Decision, Decisions, new
from stltool.monitoring.early import Early, engine_of
from stltool.monitoring.intervals import MOST_SHARED, Enclosure, positive
from stltool.monitoring.lookback import FALSE, TRUE, Network, Value, judge_of
from stltool.monitoring.offline import judge, judge_quickly
from stltool.monitoring.program import Atom, Program, compile_delayed, compile_formula, formula_of_atom
from stltool.monitoring.samples import WHOLE, WIDE, Earlier, Traces, read_traces
from stltool.monitoring.searched import Searched
from stltool.monitoring.starts import OpenSteps
from stltool.monitoring.states import truth
from stltool.monitoring.tied import Tied, tied

if TYPE_CHECKING:
    from stltool.monitoring.stream import Stream

_BULK = 4  # horizons: longer blocks are judged as a whole, and only their last horizon runs sample by sample
_PART = 1 << 14  # samples of such a block that are judged together


class OnlineMonitor(Displayed):
    """Judges a trace sample by sample; memory and time per sample do not grow with the trace.

    `feed` returns each step once, as soon as every continuation of the trace agrees on its verdict: `G[0,1000] x > 0`,
    violated at sample 3, is decided at sample 3. With `wait` it returns each step when its robustness is final, at
    sample step + horizon: these decisions are, bit for bit, those of `monitor` with end "error".

    early    which engine decides, and whether it is exact: "automaton"; "structure" where that would be too large;
             "search" where the structure is not exact, which may take a millisecond a sample; or "network", if such a
             formula looks back without a limit: steps are then decided at sample step + horizon
    n_steps  the number of samples read

    Raises StlSyntaxError if an interval of the future has no end.
    """

    _tied: Tied | None = None
    _searched: Searched | None = None

    def __new__(cls, phi: Formula | Task | None = None, wait: bool = False) -> OnlineMonitor:
        # a part that looks back without a limit is enough, even if nothing depends on it: the left side of since[0,0]
        if (
            cls is OnlineMonitor
            and isinstance(phi, Composable)
            and any(now.lookback is None for now in _compiled(phi._formula())[1].instructions)
        ):
            return object.__new__(_LookingBack)
        return object.__new__(cls)

    def _compile(self, phi: Formula | Task, wait: bool) -> None:
        """What every kind of monitor begins with."""
        self.formula = bounded_formula_of(phi, "OnlineMonitor's formula")
        require(wait, (bool, np.bool_), "wait", "give True or False")
        self.wait = bool(wait)
        made, self._program = _compiled(self.formula)
        self._judged, self._earlier = made.formula, Earlier(made)
        self.horizon: int = self._program.horizon or 0
        names = dict.fromkeys((*self._program.variables, *self._program.labels, *self._earlier.kept))
        self._asked = tuple(name for name in names if name not in made.signals and name not in made.starts)

    def __init__(self, phi: Formula | Task, wait: bool = False) -> None:
        from stltool.monitoring.stream import Stream  # which loads numba

        self._compile(phi, wait)
        self.wait = self.wait or self.horizon == 0  # nothing to wait for
        engine = engine_of(self._judged, self._program.earlier)
        self.early, made = engine.early, self._earlier.made
        if made.signals and not (self.early.exact or self.wait or made.starts):
            self._tied = tied(engine, self.horizon, made.signals)
        if self._tied is not None:
            why = self.early.why.partition(";")[0] + "; the values of earlier samples are taken into account"
            self.early = Early("automaton", True, why)
        if engine.atoms is not None and not self.wait:
            self._searched = Searched(self._judged, engine.atoms, self.horizon)
            self._letter = engine.letter
        self._leaves = engine.leaves
        self._stream = Stream(self._program, engine, self.horizon, self.wait)
        self._enclosure: Enclosure | None = None
        self._room: NDArray[np.float64] | None = None  # for parts of long blocks: (n, n_names)
        self._columns: NDArray[np.int64] | None = None  # where its signals lie
        self._bind()

    def _bind(self) -> None:
        from stltool.monitoring.stream import Call

        self._call = Call(self._stream)
        atoms = enumerate(self._stream.atoms)
        self._predicates = [
            (i, atom.at_one_sample(), self._begins(atom)) for i, atom in atoms if isinstance(atom, Predicate)
        ]
        self._shorten()

    def _begins(self, atom: Atom) -> int:
        """The step from which on all samples exist that an atom reads."""
        return self._program.reach(atom.names)[1] if isinstance(atom, Predicate) else 0

    def _shorten(self) -> None:
        """Put a compiled `feed` (kernels/objects.py) in front of the method, if there is one and nothing needs Python.

        What is not a dict of floats and truth values goes to the method. It keeps the monitor and its arrays alive.
        """
        from stltool.kernels.objects import bound

        if self._stream.given or self._delays or self._searched is not None or not self._stream.names:
            return
        types = dict, float, bool, True, False, None, Decision, Decisions
        doc = f"feed(sample)\n--\n\n{OnlineMonitor.feed.__doc__}"
        compiled = bound((self._call.root, *types, "_runs", self._feed, *self._stream.names), doc)
        if compiled is not None:
            self.feed = cast(Any, compiled)  # type: ignore[method-assign]

    def __getstate__(self) -> dict[str, Any]:
        made = ("_call", "_predicates", "feed")
        return {name: value for name, value in self.__dict__.items() if name not in made} | {"_room": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()

    def _card(self) -> Card:
        engine = f"{self.early.engine}, {'exact' if self.early.exact else 'possibly late'}"
        return Card(
            f"OnlineMonitor: {counted(self.n_steps, 'sample')} read",
            [{"formula": self.formula}, {"horizon": self.horizon, "early verdicts": engine, "bytes": self.nbytes}],
        )

    @property
    def n_steps(self) -> int:
        return self._stream.n_steps

    @property
    def nbytes(self) -> int:
        """Memory of what is kept: bounded by the horizon, and by the samples so far."""
        searched = 0 if self._searched is None else self._searched.nbytes
        return self._stream.N.nbytes + self._stream.F.nbytes + self._stream.B.nbytes + searched

    def feed(self, sample: Mapping[str, Any]) -> list[Decision] | Decisions:
        """Take the next sample, a value for every name of φ; returns the decisions that it yields, a sequence by step.

        A mapping of names to arrays (n,) is a block of n samples, which is faster. `Decisions`, of blocks and of single
        samples that decide many steps, have arrays of them, too.

        Raises NameLookupError if a name is missing, TraceError if a value is not a finite number (for a label: neither
        true nor false), or gives a predicate no value or no margin. What is refused leaves the monitor unchanged.
        """
        return self._feed(sample)

    def finish(self, end: Literal["cut", "hold"] = "cut") -> list[Decision]:
        """The decisions of the steps still open if the trace ended here. The monitor can still be fed."""
        one_of(end, "end", ("cut", "hold"))
        n = self.n_steps
        first = n - min(self.horizon, n)
        if n == first:
            return []
        kept = self._stream.kept()
        known = len(kept)
        if end == "hold" and self._delays:
            last = dict(zip(self._stream.names, kept[-1].tolist(), strict=True))
            held = [[{**last, **made}[name] for name in self._stream.names] for made in self._earlier.held()]
            kept = np.concatenate([kept, np.array(held, dtype=np.float64).reshape(-1, kept.shape[1])])
        truth, margins = judge(self._judged, self._traces(kept, n - known), end, True, True, slice(known))
        steps = range(first, n) if self.wait else self._undecided(first)
        at = known - n
        return [Decision(t, bool(truth[0, at + t]), float(margins[0, at + t])) for t in steps]

    def bounds(self, step: int) -> tuple[float, float]:
        """The least and the greatest robustness that the step can still have, whatever comes; equal once it is final.

        For a step that has begun, and is not further back than the horizon; otherwise SettingsError.
        """
        step, n = self._bounded_step(step), self.n_steps
        kept = self._stream.kept()
        at = step - (n - len(kept))
        if n - step > self.horizon:
            _, margins = judge(self._judged, self._traces(kept, step - at), "error", True, True)
            return (float(margins[0, at]),) * 2
        if self._enclosure is None:
            self._enclosure = Enclosure(self._judged, self._program.earlier)
        columns = dict(zip(self._stream.names, kept.T, strict=True))
        lower, upper = self._enclosure.at(columns, at, n - len(kept))
        return _within(lower, upper, self._verdict(step))

    def _bounded_step(self, step: int) -> int:
        n = self.n_steps
        first = max(0, n - 1 - self.horizon)
        step = whole(step, "bounds' step", least=0)
        if n == 0:
            raise SettingsError(f"bounds' step is {step}, but no sample was read; feed the first one, of step 0")
        if not first <= step < n:
            range_ = f"steps {first} … {n - 1}" if first < n - 1 else f"step {first} only"
            raise SettingsError(
                f"bounds' step is {step}; after {counted(n, 'sample')} there are bounds of {range_}, as the horizon is "
                f"{self.horizon}"
            )
        return step

    # ------------------------------------------------------------------------------------------------ one sample

    def _feed(self, sample: Mapping[str, Any]) -> list[Decision] | Decisions:
        """`feed`, checking everything."""
        mapping(sample, "feed's sample", "{'x': 0.5}")
        stream, values = self._stream, self._stream.values
        if not stream.names and any(map(_is_block, sample.values())):
            return self._feed_block(sample)
        bases: dict[str, float] = {}
        if self._delays:
            if any(_is_block(sample.get(name)) for name in (*stream.names, *self._earlier.kept)):
                return self._feed_each(sample)
            bases = {name: self._real(name, self._given(name, sample)) for name in self._earlier.kept}
            sample = {**sample, **self._earlier.of(bases)}
        for i, name in enumerate(stream.names):
            value = sample.get(name)
            if value.__class__ is not float and value.__class__ is not bool:
                break
            values[i] = value
        else:
            if not stream.given and (found := self._call.advance(self._call.root)) not in (REFUSED, FULL):
                self._earlier.keep(bases)
                return self._decided(found)
        if any(_is_block(sample.get(name)) for name in stream.names):
            return self._feed_block(sample)
        read = self._read(sample)
        try:
            for i, judge_one, begins in self._predicates:
                margin, truth = judge_one(read) if self.n_steps >= begins else FALSE
                if i in stream.given:
                    stream.set_given(i, margin, truth)
        except TraceError as error:
            raise TraceError(f"step {self.n_steps}: {error}") from None
        for i, name in enumerate(stream.names):
            values[i] = read[name]
        code = self._call.advance(self._call.root)
        if code == FULL:
            self._grow(1)
            return self._feed(sample)
        self._earlier.keep(bases)
        return self._decided(code)

    def _decided(self, code: int) -> list[Decision] | Decisions:
        """The decisions that reading a sample has yielded."""
        if self._searched is not None:
            return [*self._decided_by_search(self._searched, self._of_code(code), 1)]
        return self._of_code(code) if self._tied is None else self._decided_by_values(self._tied, code)

    def _decided_by_search(self, searched: Searched, decided: Iterable[Decision], n: int) -> list[Decision]:
        """The decisions after n new samples, of which the kernel has some, perhaps for the second time."""
        if n == 1:
            rows = [self._stream.truths(self._leaves)]
        else:
            kept = self._stream.kept()[-n:]
            columns = {name: kept[:, i] for i, name in enumerate(self._stream.names)}
            labels = {name: columns[name] != 0 for name in self._program.labels}
            rows = np.stack([truth(leaf, columns, labels, len(kept)) for leaf in self._leaves], axis=1).tolist()
        codes = [sum(holds << i for i, holds in enumerate(row)) for row in rows]
        assert self._letter is not None
        told = [one for one in decided if searched.verdict(one.step) is None]
        found = searched.read(self._letter[codes], n, {one.step for one in told})
        if self.early.exact and not searched.exact:
            self.early = Early("search", False, f"{self.early.why}; a search was cut off at step {self.n_steps - 1}")
        return sorted([*told, *(Decision(step, verdict, None) for step, verdict in found)])

    def _decided_by_values(self, tied: Tied, code: int) -> list[Decision]:
        """The same, if the values of earlier samples decide, too."""
        final = {decision.step: decision.robustness for decision in self._of_code(code)}
        truths, kept = self._stream.truths(self._leaves), self._earlier.kept
        values = {
            name: [last[max(len(last) - 1 - i, 0)] for i in range(last.maxlen or 0)]  # missing ones: nobody looks
            for name, last in kept.items()
        }
        return [Decision(step, verdict, final.get(step)) for step, verdict in tied.read(truths, values)]

    def _verdict(self, step: int) -> bool | None:
        """The verdict of one of the last steps, if it is decided."""
        more = self._tied or self._searched
        found = None if more is None else more.verdict(step)
        return self._stream.verdict(step) if found is None else found

    def _undecided(self, first: int) -> list[int]:
        """The steps without a verdict, from one of the last on."""
        steps: list[int] = self._stream.undecided(first).tolist()
        return steps if self._tied is None else [step for step in steps if self._tied.verdict(step) is None]

    def _of_code(self, code: int) -> list[Decision] | Decisions:
        if code == NOTHING:
            return []
        if code == SEVERAL:
            return Decisions._of_runs(self._stream.told())
        return [new(Decision, (code >> 3, code & 2 == 2, self._call.latest[0] if code & 4 else None))]

    def _grow(self, more: int) -> None:
        """Make room for more samples."""
        stream = self._stream
        while stream.room < stream.n_read + more:
            stream = stream.larger()
        if stream is not self._stream:
            kept = self._stream.kept()
            stream.read(kept, self._outside(stream, kept, 0))
            self._take(stream)

    def _take(self, stream: Stream) -> None:
        if stream is not self._stream:
            self._stream = stream
            self._call.bind(stream)

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

    # ----------------------------------------------------------------------------------------------------- blocks

    @property
    def _delays(self) -> bool:
        """Whether the formula reads earlier samples of a signal."""
        return bool(self._earlier.made.signals)

    def _feed_each(self, block: Mapping[str, Any]) -> Decisions:
        """A block, sample by sample; if one is refused, none was read."""
        given = {name: self._given(name, block) for name in self._asked} if self._asked else block
        columns = {name: np.asarray(values) for name, values in given.items()}
        shapes = {column.shape for column in columns.values()}
        if len(shapes) != 1 or len(shape := shapes.pop()) != 1:
            raise TraceError("the signals of feed's block differ in shape; give each an array (n_steps,)")
        copied = copy.deepcopy(self)
        decisions = [
            decision
            for t in range(shape[0])
            for decision in copied._feed({name: columns[name][t] for name in self._asked})
        ]
        self.__setstate__(copied.__getstate__())
        robustness = [math.nan if decision.robustness is None else decision.robustness for decision in decisions]
        return _decisions([d.step for d in decisions], [d.verdict for d in decisions], robustness)

    def _feed_block(self, block: Mapping[str, Any]) -> Decisions:
        n = self.n_steps
        found = self._read_block(block)
        if self._searched is None or self.n_steps == n:
            return found
        decisions = self._decided_by_search(self._searched, found, self.n_steps - n)
        return _decisions([d.step for d in decisions], [d.verdict for d in decisions], [math.nan] * len(decisions))

    def _read_block(self, block: Mapping[str, Any]) -> Decisions:
        n = self.n_steps
        traces = read_traces(self._program, block, n)
        if traces.batch:
            raise TraceError(f"feed's block has shape {(traces.n_traces, traces.n_steps)}; feed one trace, (n_steps,)")
        if traces.n_steps == 0:
            return _decisions([], [], [])
        if traces.n_steps >= _BULK * self._stream.depth:
            return self._judge(traces)
        samples = np.empty((len(self._stream.names), traces.n_steps)).T  # each signal's samples are together
        self._check(traces, slice(0, traces.n_steps), samples)
        given = self._outside(self._stream, samples, n)
        self._grow(len(samples))
        read = self._stream.read(samples, given)
        assert not isinstance(read, int)
        steps, verdicts, margins = read
        order = np.argsort(steps, kind="stable")
        steps, final = steps[order], steps[order] + self.horizon - n
        known = (final >= 0) & (final < len(samples))
        robustness = np.where(known, margins[np.where(known, final, 0)], np.nan)
        return Decisions(steps, verdicts[order], robustness)

    def _check(self, traces: Traces, part: slice, out: NDArray[np.float64]) -> bool:
        """Write a part of a block to `out` (n, n_names), checked; whether it is `wide`."""
        checked = traces.block(slice(0, 1), part, "open")
        for i, name in enumerate(self._stream.names):
            out[:, i] = checked.columns[name][0]
        if checked.wide:
            self._refuse_margins(out, traces.first_step + part.start)
        return checked.wide

    def _judge(self, traces: Traces) -> Decisions:
        """A block that is much longer than the horizon: its settled steps at once, the open ones from new arrays."""
        stream, n, h, size = self._stream, self.n_steps, self.horizon, traces.n_steps
        first = n - min(h, n)
        settled = n + size - h - first
        truth = np.empty(settled + (0 if self.wait else h), np.bool_)  # then the verdicts that are told early
        margins = np.empty(settled if self.wait else 0)
        outs = [truth.reshape(1, -1), margins.reshape(1, -1)][: 1 + self.wait]
        # in parts that stay in the cache, each after the samples before it that its steps depend on
        back, width = stream.depth - 1, max(_PART, _BULK * stream.depth)
        if self._room is None or len(self._room) < back + min(width, size):
            room = np.empty((len(stream.names), back + min(width, size)))  # each signal's samples are together
            self._columns = np.array([(row.ctypes.data, 0) for row in room], dtype=np.int64).ravel()
            self._room = room.T
        room = self._room
        joined = stream.kept()[-back:] if back else stream.kept()[:0]
        held, at, wide = len(joined), 0, not within(joined, WIDE)
        quick = None if stream.given else compiled(self._program)
        for start in range(0, size, width):
            end = min(start + width, size)
            room[:held], joined = joined[len(joined) - held :].copy(), room[: held + end - start]
            part, decided = slice(start, end), n + end - h - first
            if wide or quick is None or not self._judge_whole(quick, traces, part, joined, held, outs, at, decided):
                wide |= self._check(traces, part, joined[held:])
                if stream.given:
                    self._outside(stream, joined[held:], n + start)  # raises for samples without a margin
                self._judge_part(joined, n + start - held, wide, outs, at, decided)
            held, at = min(back, len(joined)), decided
        new = stream.undecided(first) - first if not self.wait else None
        last = joined[-stream.depth :]
        self._take(stream.afresh(n + size - len(last)))
        read = self._stream.read(last, self._outside(self._stream, last, n + size - len(last)))
        assert not isinstance(read, int)
        steps = np.arange(first, first + len(truth))
        if new is None:
            return Decisions(steps, truth, margins)
        early = read[0] > steps[settled - 1]
        order = np.argsort(read[0][early])
        begin, end = n - first - len(new), settled + len(order)
        steps[settled:end], truth[settled:end] = read[0][early][order], read[1][early][order]
        steps[begin : n - first], truth[begin : n - first] = first + new, truth[new]
        return Decisions(steps[begin:end], truth[begin:end], np.broadcast_to(np.nan, end - begin))

    def _judge_whole(
        self, quick: Compiled, traces: Traces, part: slice, samples: NDArray[np.float64], held: int,
        outs: list[NDArray[Any]], at: int, end: int,
    ) -> bool:  # fmt: skip
        """Write a part of a block to `samples`, from the one of number `held` on, and what they decide to `outs`.

        Samples are checked on the way: False if some are to be converted, or are not finite or wide.
        """
        assert self._columns is not None
        if self._program.labels or any(array.dtype != np.float64 for array in traces.arrays.values()):
            return False
        for i, name in enumerate(self._stream.names):
            samples[held:, i] = traces.arrays[name][0, part]
        decided = [out[:, at:end] for out in outs]
        return quick.at(self._columns, 1, len(samples), "error", decided, True, self.wait, WIDE)

    def _judge_part(
        self, samples: NDArray[np.float64], first_step: int, wide: bool, outs: list[NDArray[Any]], at: int, end: int
    ) -> None:
        """Write truth, and margins if waited for, of the last steps that samples decide to places at … end − 1."""
        if (quick := compiled(self._program)) is not None:
            columns = {name: samples[:, i] for i, name in enumerate(self._stream.names)}
            columns |= {name: columns[name] != 0 for name in self._program.labels}
            block = Block(columns, 1, len(samples), "open", wide)
            if judge_quickly(quick, block, outs, True, self.wait, slice(0, 1), at):
                return
        traces = replace(self._traces(samples, first_step), small=not wide)
        for out, found in zip(outs, judge(self._judged, traces, "error", True, self.wait), strict=True):
            out[0, at:end] = found[0, at - end :]

    def _traces(self, samples: NDArray[np.float64], first_step: int) -> Traces:
        arrays = {name: samples[:, i].reshape(1, -1) for i, name in enumerate(self._stream.names)}
        return Traces(arrays, self._program, 1, len(samples), batch=False, first_step=first_step)

    def _outside(self, stream: Stream, samples: NDArray[np.float64], first_step: int) -> NDArray[np.float64]:
        """Margins and truths of the atoms that the kernel does not judge, (n, n_given, 2)."""
        found = np.empty((len(samples), len(stream.given), 2))
        if not stream.given:
            return found
        columns = {name: samples[:, i].reshape(1, -1) for i, name in enumerate(stream.names)}
        truth, margin = np.empty((1, len(samples)), np.bool_), np.empty((1, len(samples)))
        for j, i in enumerate(stream.given):
            predicate = stream.atoms[i]
            assert isinstance(predicate, Predicate)
            with np.errstate(all="ignore"):
                predicate.judge(columns, truth, margin, True)
            before = max(self._begins(predicate) - first_step, 0)
            margin[0, :before], truth[0, :before] = FALSE
            for step in np.flatnonzero(np.isnan(margin[0]))[:1].tolist():
                self._raise(predicate, samples, step, first_step)
            found[:, j, 0], found[:, j, 1] = margin[0], truth[0]
        return found

    def _refuse_margins(self, samples: NDArray[np.float64], first_step: int) -> None:
        """TraceError if the margin of a comparison is beyond the range of doubles."""
        columns = {name: samples[:, i].reshape(1, -1) for i, name in enumerate(self._stream.names)}
        margin = np.empty((1, len(samples)))
        for predicate in self._stream.atoms:
            if isinstance(predicate, Predicate):
                with np.errstate(all="ignore"):
                    predicate.judge(columns, None, margin, True)
                for step in np.flatnonzero(np.isnan(margin[0]))[:1].tolist():
                    self._raise(predicate, samples, step, first_step)

    def _raise(self, predicate: Predicate, samples: NDArray[np.float64], step: int, first_step: int) -> None:
        sample = dict(zip(self._stream.names, samples[step].tolist(), strict=True))
        try:
            predicate.at_one_sample()(sample)
        except TraceError as error:
            raise TraceError(f"step {first_step + step}: {error}") from None
        raise AssertionError(f"{predicate.node} has a margin at step {first_step + step}")


class _LookingBack(OnlineMonitor):
    """An online monitor of a formula that looks back without a limit (lookback.py)."""

    def __init__(self, phi: Formula | Task, wait: bool = False) -> None:
        self._compile(phi, wait)
        engine = engine_of(self._judged, self._program.earlier)
        self._open = None if engine.delta is None or self.horizon == 0 else OpenSteps(engine)
        self.early, self._leaves = engine.early, engine.leaves
        if self._open is None:
            self.early = Early("network", self.horizon == 0, engine.early.why)
        self.wait = self.wait or self._open is None
        self._verdicts: deque[bool | None] = deque(maxlen=self.horizon + 1)  # of the last steps
        self._network = Network(self._program.instructions)
        self._literals = compile_formula(positive(negation_normal_form(self._judged, MOST_SHARED)))
        self._enclosing = Network(self._literals.instructions)
        self._last: dict[str, float] = {}
        self._n_steps, self._final = 0, math.nan
        self._bind()

    def _bind(self) -> None:
        programs = self._program, self._literals
        self._atoms, self._signs = (
            [(i, judge_of(atom), self._begins(atom)) for i, atom in atoms if atom is not None]
            for atoms in (enumerate(now.atom for now in program.instructions) for program in programs)
        )
        numbers = {
            formula_of_atom(now.atom): i for i, now in enumerate(self._program.instructions) if now.atom is not None
        }
        self._read_by_engine = [numbers[leaf] for leaf in self._leaves]

    def __getstate__(self) -> dict[str, Any]:
        return {
            name: value for name, value in self.__dict__.items() if name not in ("_atoms", "_signs", "_read_by_engine")
        }

    @property
    def n_steps(self) -> int:
        return self._n_steps

    @property
    def nbytes(self) -> int:
        """Memory of the values that are held, about: bounded by the horizon and the windows of the past that end."""
        return 100 * (self._network.stored + self._enclosing.stored)

    def _feed(self, sample: Mapping[str, Any]) -> list[Decision] | Decisions:
        mapping(sample, "feed's sample", "{'x': 0.5}")
        given = map(sample.get, self._asked) if self._asked else sample.values()
        if any(map(_is_block, given)):
            return self._feed_each(sample)
        bases = {name: self._real(name, self._given(name, sample)) for name in self._earlier.kept}
        values = self._read({**sample, **self._earlier.of(bases)})
        atoms, signs = (_values(listed, values, self.n_steps) for listed in (self._atoms, self._signs))
        self._earlier.keep(bases)
        self._enclosing.advance(signs)
        found = self._network.advance(atoms)
        self._last = values
        self._n_steps += 1
        early = self._told_early(dict(atoms))
        if found is not None:
            self._final = found[0]
        if not self.wait:
            return [Decision(step, verdict, None) for step, verdict in early]
        return [] if found is None else [Decision(self._n_steps - 1 - self.horizon, found[1], found[0])]

    def _told_early(self, atoms: dict[int, Value]) -> list[tuple[int, bool]]:
        self._verdicts.append(None)
        if self._open is None:
            return []
        found = self._open.read([atoms[i][1] for i in self._read_by_engine])
        for step, verdict in found:
            self._verdicts[step - self._n_steps] = verdict
        return found

    def finish(self, end: Literal["cut", "hold"] = "cut") -> list[Decision]:
        """The decisions of the steps still open if the trace ended here. The monitor can still be fed."""
        one_of(end, "end", ("cut", "hold"))
        n = self.n_steps
        if min(self.horizon, n) == 0:
            return []
        if end == "hold":
            found = self._ahead_held()
        else:  # what comes later is not looked at
            found = self._ahead(self._network, self.horizon, itertools.repeat([(i, FALSE) for i, *_ in self._atoms]), n)
        last = [Decision(n - len(found) + i, truth, margin) for i, (margin, truth) in enumerate(found)]
        return self._not_told(last)

    def _not_told(self, decisions: list[Decision]) -> list[Decision]:
        return [one for one in decisions if self.wait or self._verdicts[one.step - self._n_steps] is None]

    def _ahead_held(self) -> list[Value]:
        """What the network would say if the last sample were held; TraceError if that is a term without a value."""
        try:
            return self._ahead(self._network, self.horizon, self._held(self._atoms))
        except TraceError:
            ends = [self._ahead(self._enclosing, self.horizon, self._held(self._signs, end)) for end in (FALSE, TRUE)]
            if ends[0] != ends[1]:
                raise
            return ends[0]

    def _held(self, atoms: Sequence[_Judged], unknown: Value | None = None) -> Iterator[list[tuple[int, Value]]]:
        """The atoms of the samples that follow if the last one is held."""
        last = self._last
        for n, made in enumerate(itertools.chain(self._earlier.held(), itertools.repeat(None)), self._n_steps):
            last = {**last, **made} if made is not None else last
            yield _values(atoms, last, n, unknown)

    @staticmethod
    def _ahead(
        network: Network, steps: int, atoms: Iterator[list[tuple[int, Value]]], n_steps: int | None = None
    ) -> list[Value]:
        """What a network would say after so many more samples, or at the end of a trace of `n_steps`."""
        copied = copy.deepcopy(network)
        found = [copied.advance(next(atoms), n_steps) for _ in range(steps)]
        return [value for value in found if value is not None]

    def bounds(self, step: int) -> tuple[float, float]:
        step, n = self._bounded_step(step), self.n_steps
        if step + self.horizon < n:
            return self._final, self._final
        ends = []
        for unknown in (FALSE, TRUE):
            fixed = [
                (i, value({}) if isinstance(self._literals.instructions[i].atom, Constant) else unknown)
                for i, value, _ in self._signs
            ]
            ends.append(self._ahead(self._enclosing, step + self.horizon - n + 1, itertools.repeat(fixed))[-1][0])
        return _within(ends[0], ends[1], self._verdicts[step - n])


def _compiled(phi: Formula) -> tuple[Delayed, Program]:
    """A formula as it is judged sample by sample: what looks back stays, but for comparisons of several steps."""
    return compile_delayed(phi, once=False)


_Judged: TypeAlias = tuple[int, Callable[[Mapping[str, float]], Value], int]
"""The number of an atom, its value at a sample, and the first step at which all samples exist that it reads."""


def _values(
    atoms: Sequence[_Judged], sample: Mapping[str, float], step: int, unknown: Value | None = None
) -> list[tuple[int, Value]]:
    """The values of atoms at a step; `unknown` for those without one, or TraceError."""
    found = []
    for i, judge_one, begins in atoms:
        try:
            value = judge_one(sample) if step >= begins else FALSE  # nobody looks at that
        except TraceError as error:
            if unknown is None:
                raise TraceError(f"step {step}: {error}") from None
            value = unknown
        found.append((i, value))
    return found


def _within(lower: float, upper: float, verdict: bool | None) -> tuple[float, float]:
    """The part of an enclosure of robustness that agrees with a verdict."""
    if verdict is None:
        return lower, upper
    return (max(lower, 0.0), upper) if verdict else (lower, min(upper, 0.0))


def _is_block(value: object) -> bool:
    return isinstance(value, list | tuple) or getattr(value, "ndim", 0) > 0


def _decisions(steps: list[int], verdicts: list[bool], robustness: list[float]) -> Decisions:
    order = np.argsort(np.array(steps, np.int64), kind="stable")
    return Decisions(
        np.array(steps, np.int64)[order], np.array(verdicts, np.bool_)[order], np.array(robustness, np.float64)[order]
    )


_NUMBERS = (int, float, np.bool_, np.integer, np.floating)
