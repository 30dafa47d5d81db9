"""A running program as a trace: a recorder samples its values and judges them, while it runs or at its end.

    with Recorder("G[0,50] (F[0,9] (level > 2))") as record:
        for _ in range(60):
            tank.step()
            record(level=tank.level)

The formula is judged at the first sample. Verdicts are those of `stl.monitor` on the recorded trace; while the program
runs, those of an online monitor: a violation is raised with the first sample after which every continuation violates.
"""

from __future__ import annotations

import asyncio
import copy
import functools
import inspect
import threading
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import flag, function, mapping, one_of, real
from stltool.display import Card, Displayed, counted
from stltool.errors import ArgumentError, SettingsError, TraceError, named
from stltool.extras import require
from stltool.logic.formula import Always, And, Formula, formula_of, is_bounded, label_names, variables
from stltool.logic.parser import parse
from stltool.logic.task import Task
from stltool.monitoring import OnlineMonitor, monitor
from stltool.monitoring.samples import End
from stltool.testing.assertions import assert_trace
from stltool.testing.judged import tell

if TYPE_CHECKING:
    from stltool.testing.environments import RecordedEnv

P = ParamSpec("P")
R = TypeVar("R")
Read = Callable[[], Mapping[str, Any]]


class _Decided(BaseException):
    """Leaves the block of a recorder whose verdict is certain."""


class Recorder(Displayed):
    """A context manager that records samples: `record(x=0.5)`, `record({"x": 0.5})`, or `record()` with `read`.

    phi      the formula, a task, or a formula's text
    read     returns a sample, {"x": 0.5, …}, whenever one is needed
    every    seconds between samples that are taken by themselves: in `async with` by a task of the event loop, which
             cancels the block at a violation; in `with` by a thread, which cannot, so that the violation is raised at
             the end of the block
    online   judge while the block runs; otherwise only at its end
    stop     leave the block as soon as the verdict is certain, whatever it is
    end      how a trace is judged that is too short to decide the formula, as in `stl.monitor`; default: "error", or
             "cut" for a formula with an interval without end

    verdict      None as long as it is open
    decided_at   the number of samples after which it was certain
    trace        name → array (n_steps,) of all samples; late: the most seconds by which a sample was taken late

    Raises TraceViolation, an AssertionError, with the diagnosis in sentences.
    """

    def __init__(
        self,
        phi: Formula | Task | str,
        read: Read | None = None,
        *,
        every: float | None = None,
        online: bool = True,
        stop: bool = False,
        end: End | None = None,
    ) -> None:
        self.phi: Formula | Task = parse(phi, unbounded=True) if isinstance(phi, str) else phi
        formula = formula_of(self.phi, "Recorder's formula")
        function(read, "Recorder's read")
        self.online, self.stop = flag(online, "Recorder's online"), flag(stop, "Recorder's stop")
        self.every = None if every is None else float(real(every, "every", "0.1"))
        if end is not None:
            one_of(end, "end", get_args(End))
        if self.every is not None and self.every <= 0:
            raise SettingsError(f"{named('every')} is {self.every:g}; give seconds above 0, such as 0.1")
        if self.every is not None and read is None:
            raise SettingsError(f"{named('every')} takes samples by `read`, which is not given; give both")
        self.end: End = end if end is not None else "error" if is_bounded(formula) else "cut"
        self.verdict: bool | None = None
        self.decided_at: int | None = None
        self.late = 0.0
        self._read = read
        self._labels = frozenset(label_names(formula))
        self._needed = dict.fromkeys((*variables(formula), *label_names(formula)))
        self._watch = copy.deepcopy(_watch(formula)) if self.online else None
        self._columns: dict[str, list[Any]] = {}
        self._failure: BaseException | None = None
        self._closed = False
        self._task: asyncio.Task[Any] | None = None
        self._sampler: asyncio.Task[None] | threading.Thread | None = None
        self._over = threading.Event()

    def _card(self) -> Card:
        verdict = {None: "open", True: "holds", False: "violated"}[self.verdict]
        return Card(
            f"Recorder: {counted(self.n_steps, 'sample')}, {verdict}",
            [{"formula": self.phi}, {"decided after": self.decided_at}],
        )

    @property
    def closed(self) -> bool:
        """Whether the recording has ended."""
        return self._closed

    @property
    def n_steps(self) -> int:
        return len(next(iter(self._columns.values()), ()))

    @property
    def trace(self) -> dict[str, NDArray[Any]]:
        return {
            name: np.array(column, dtype=np.bool_ if name in self._labels else np.float64)
            for name, column in self._columns.items()
        }

    # -------------------------------------------------------------------------------------------------- samples

    def __call__(self, sample: Mapping[str, Any] | None = None, /, **values: Any) -> bool | None:
        """Record a sample; returns the verdict so far."""
        __tracebackhide__ = True
        self._keep(self._sample(sample, values))
        if self.verdict is False and self._watch is not None:
            self._raise_violation("hold")  # every continuation violates, and so does this one
        if self.stop and self.verdict is not None:
            raise _Decided
        return self.verdict

    def _sample(self, sample: Mapping[str, Any] | None, values: Mapping[str, Any]) -> Mapping[str, Any]:
        if self._closed:
            raise SettingsError("a sample came after the recorder's block; take samples within it")
        if sample is None and not values:
            if self._read is None:
                raise ArgumentError("record() has no sample; give one, record(x=0.5), or a function as Recorder's read")
            sample = self._read()
        return {**mapping(sample if sample is not None else {}, "record's sample", "{'x': 0.5}"), **values}

    def _keep(self, sample: Mapping[str, Any]) -> None:
        if self._columns and self._columns.keys() != sample.keys():
            odd = sorted(self._columns.keys() ^ sample.keys())
            raise TraceError(f"sample {self.n_steps}: {odd[0]} is not in every sample; give the same names each time")
        missing = [name for name in self._needed if name not in sample]
        if missing:
            raise TraceError(f"sample {self.n_steps}: {missing[0]} is missing, which the formula reads; record it")
        if self._watch is not None and self.verdict is None:
            self.verdict = self._watch.feed({name: sample[name] for name in self._needed})
        for name, value in sample.items():
            self._columns.setdefault(name, []).append(value)
        if self.verdict is not None and self.decided_at is None:
            self.decided_at = self.n_steps

    def _raise_violation(self, end: End) -> None:
        __tracebackhide__ = True
        self._closed = True
        assert_trace(self.phi, self.trace, end=end)

    def close(self) -> bool:
        """End the recording, and judge what is open; returns the verdict, or raises TraceViolation."""
        __tracebackhide__ = True
        self._closed = True
        end: End = self.end if self.verdict is None else "hold"  # what is certain is so on every continuation
        if self.verdict is None:
            if not self._columns:
                raise TraceError("nothing was recorded; record at least one sample")
            found = monitor(self.phi, self.trace, self.end, "boolean", at=0).verdicts
            assert found is not None  # asked for
            self.verdict, self.decided_at = bool(found[0]), self.n_steps
        if not self.verdict:
            self._raise_violation("hold" if self._watch is not None and self._watch.violated else self.end)
        tell(self.phi, self.trace, 0, end)
        return self.verdict

    # --------------------------------------------------------------------------------------------------- blocks

    def __enter__(self) -> Recorder:
        if self.every is not None:
            self._sampler = threading.Thread(target=self._sample_in_thread, daemon=True)
            self._sampler.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, raised: BaseException | None, trace: TracebackType | None
    ) -> bool:
        __tracebackhide__ = True
        if isinstance(self._sampler, threading.Thread):
            self._over.set()
            self._sampler.join()
        return self._ended(raised)

    async def __aenter__(self) -> Recorder:
        self._task = asyncio.current_task()
        if self.every is not None:
            self._sampler = asyncio.create_task(self._sample_in_loop())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, raised: BaseException | None, trace: TracebackType | None
    ) -> bool:
        __tracebackhide__ = True
        if isinstance(self._sampler, asyncio.Task):
            self._sampler.cancel()
            await asyncio.gather(self._sampler, return_exceptions=True)
        if self._failure is not None and isinstance(raised, asyncio.CancelledError):
            assert self._task is not None
            if self._task.uncancel() == 0:  # nobody else has cancelled it
                raised = None
        return self._ended(raised)

    def _ended(self, raised: BaseException | None) -> bool:
        __tracebackhide__ = True
        self._closed = True
        if raised is not None and not isinstance(raised, _Decided):
            return False
        if self._failure is not None and not isinstance(self._failure, _Decided):
            raise self._failure
        self.close()
        return True

    def _take(self) -> bool:
        """A sample that is taken by itself; whether to go on."""
        try:
            self()
        except (Exception, _Decided) as failure:
            self._failure = failure
            return False
        return True

    def _sample_in_thread(self) -> None:
        assert self.every is not None
        start, taken = time.monotonic(), 0
        while self._take():
            taken += 1
            self._note_late(time.monotonic() - start - (taken - 1) * self.every)
            if self._over.wait(max(start + taken * self.every - time.monotonic(), 0)):
                return

    async def _sample_in_loop(self) -> None:
        assert self.every is not None
        assert self._task is not None
        loop = asyncio.get_running_loop()
        start, taken = loop.time(), 0
        while self._take():
            taken += 1
            self._note_late(loop.time() - start - (taken - 1) * self.every)
            await asyncio.sleep(max(start + taken * self.every - loop.time(), 0))
        self._task.cancel()

    def _note_late(self, seconds: float) -> None:
        self.late = max(self.late, seconds)


class _Watch:
    """The verdict of a formula at the first sample as soon as it is certain; of `G φ` without an end, a violation.

    violated   whether a violation was found
    """

    def __init__(self, phi: Formula) -> None:
        self.violated = False
        self._parts: list[_Watch] = []
        self._first: int | None = 0
        self._monitor: OnlineMonitor | None = None
        match phi:
            case And(args) if not is_bounded(phi):
                self._parts = [_Watch(arg) for arg in args]
            case Always(interval, arg) if interval.b is None and is_bounded(arg):
                self._monitor, self._first = OnlineMonitor(arg), interval.a
            case _ if is_bounded(phi):
                self._monitor, self._first = OnlineMonitor(phi), None
        self._held = [False] * len(self._parts)

    def feed(self, sample: Mapping[str, Any]) -> bool | None:
        verdict: bool | None = None
        if self._parts:
            for i, part in enumerate(self._parts):
                if self._held[i]:
                    continue
                found = part.feed(sample)
                self._held[i] = found is True
                if found is False:
                    verdict = False
            if verdict is None and all(self._held):
                verdict = True
        elif self._monitor is not None:
            for step, holds, _ in self._monitor.feed(sample):
                if self._first is None and step == 0:
                    verdict = holds
                elif self._first is not None and step >= self._first and not holds:
                    verdict = False
        self.violated = self.violated or verdict is False
        return verdict


@functools.lru_cache(64)
def _watch(phi: Formula) -> _Watch:
    """One that has read nothing, to be copied: a tenth of the time of making one."""
    return _Watch(phi)


def recorded(
    phi: Formula | Task | str,
    read: Read | None = None,
    *,
    every: float | None = None,
    online: bool = True,
    stop: bool = False,
    end: End | None = None,
) -> Callable[[Callable[Concatenate[Recorder, P], R]], Callable[P, R]]:
    """A decorator: the function, also a coroutine, is given a new `Recorder` as its first argument in each call.

    Arguments are those of `Recorder`. A function that is left early because its verdict is certain returns None.
    """
    options: dict[str, Any] = {"every": every, "online": online, "stop": stop, "end": end}
    Recorder(phi, read, **options)  # whatever is wrong with them is told here

    def decorate(decorated: Callable[Concatenate[Recorder, P], R]) -> Callable[P, R]:
        if inspect.iscoroutinefunction(decorated):

            @functools.wraps(decorated)
            async def run(*args: Any, **named: Any) -> Any:
                __tracebackhide__ = True
                async with Recorder(phi, read, **options) as record:
                    return await decorated(record, *args, **named)

        else:

            @functools.wraps(decorated)
            def run(*args: Any, **named: Any) -> Any:
                __tracebackhide__ = True
                with Recorder(phi, read, **options) as record:
                    return decorated(record, *args, **named)

        signature = inspect.signature(decorated)
        rest = list(signature.parameters.values())[1:]
        run.__signature__ = signature.replace(parameters=rest)  # type: ignore[attr-defined]  # pytest looks for fixtures
        return run  # type: ignore[return-value]

    return decorate


def recorded_env(
    env: Any,
    phi: Formula | Task | str,
    signals: Mapping[str, Callable[[Any], Any]],
    *,
    stop: bool = True,
    raises: bool = True,
    end: End = "hold",
) -> RecordedEnv:
    """A Gymnasium environment whose episodes are judged as they run: see `RecordedEnv`."""
    require("gymnasium", "recording a Gymnasium environment")
    from stltool.testing.environments import RecordedEnv

    return RecordedEnv(env, phi, signals, stop=stop, raises=raises, end=end)
