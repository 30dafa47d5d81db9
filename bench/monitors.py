"""Monitors against RTAMT and SENTIL, against the plain-numpy way, and truth alone against copying its input.

One formula, float64, on one trace of 1e5 samples and on 1000 traces of 100. Windows are cut at the end, as both peers
do it: all steps are decided, and the results compared at every one. Times are the shortest processor times of some runs
taken in turn; a percentile of single calls is of their times by the clock, each with the clock's own 40 ns.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

import stltool as stl

TEXT = "always[0,50](eventually[0,20](x > 0.5) and eventually[0,20](y > 0.5))"
PHI = stl.parse(TEXT)
SHAPES = ((1, 100_000), (1000, 100))
SMALL = ((1, 1000), (10, 100))


def shortest(n: int, *actions: Callable[[], Any]) -> list[float]:
    """Processor seconds of each action, the shortest of n runs, taken in turn."""
    times = [[] for _ in actions]
    for _ in range(n):
        for action, taken in zip(actions, times, strict=True):
            start = time.process_time()
            action()
            taken.append(time.process_time() - start)
    return [min(taken) for taken in times]


def numpy_robustness(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Doubled windows of the decided steps in plain numpy, time along the first axis."""

    def window(values: np.ndarray, width: int, fold: np.ufunc) -> np.ndarray:
        span = 1
        while span < width:
            step = min(span, width - span)
            values = fold(values[:-step], values[step:])
            span += step
        return values

    return window(np.minimum(window(x - 0.5, 21, np.maximum), window(y - 0.5, 21, np.maximum)), 51, np.minimum)


def rtamt_specification(kind: str) -> Any | None:
    """RTAMT's monitor of the formula; None where the package is not installed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            import rtamt
        except ImportError:
            return None
        specification = getattr(rtamt, f"StlDiscreteTime{kind}Specification")()
    for name in "xy":
        specification.declare_var(name, "float")
    specification.spec = TEXT
    specification.parse()
    return specification


def sentil_formula() -> Any | None:
    try:
        import sentil
    except ImportError:
        return None
    return sentil.parse(TEXT)


def offline_rows(n_traces: int, n_steps: int) -> list[str]:
    x, y = np.random.default_rng(0).random((2, n_traces, n_steps))
    signals = {"x": x, "y": y}
    what = f"{n_traces} × {n_steps:.3g} samples"

    def ours(end: str = "cut", semantics: str = "robustness") -> stl.MonitorResult:
        return stl.monitor(PHI, signals, end, semantics)

    expected = ours().robustness
    rows = []

    def row(
        figure: str, against: str, runs: int, mine: Callable[[], Any], other: Callable[[], Any], slower: bool = False
    ) -> None:
        mine_s, other_s = shortest(runs, mine, other)
        ratio = f"{mine_s / other_s:.2g} × its time" if slower else f"{other_s / mine_s:.3g} ×"
        rows.append(f"| {figure}, {what} ({mine_s * 1e3:.3g} ms) | {against} ({other_s * 1e3:.4g} ms) | {ratio} |")

    specification = rtamt_specification("Offline")
    if specification is None:
        rows.append(f"| robustness, {what} | RTAMT | not measured: it is not installed |")
    else:
        lists = [{"time": list(range(n_steps)), "x": a.tolist(), "y": b.tolist()} for a, b in zip(x, y, strict=True)]

        def rtamt() -> list[Any]:
            return [specification.evaluate(trace) for trace in lists]

        assert np.array_equal(np.array(rtamt())[:, :, 1], expected)
        row("robustness", "RTAMT", 3, ours, rtamt)

    formula = sentil_formula()
    if formula is None:
        rows.append(f"| robustness, {what} | SENTIL | not measured: it is not installed |")
    else:
        import sentil

        traces = [sentil.Trace.indexed(n_steps) for _ in range(n_traces)]
        for trace, a, b in zip(traces, x, y, strict=True):
            trace.add_signal("x", a)
            trace.add_signal("y", b)

        def by_sentil() -> list[Any]:
            return [formula.robustness_signal(trace) for trace in traces]

        assert np.array_equal(np.array(by_sentil()), expected)
        row("robustness", "SENTIL, traces loaded", 9, ours, by_sentil)

    first = np.ascontiguousarray(x.T), np.ascontiguousarray(y.T)
    assert np.array_equal(numpy_robustness(*first).T, ours("error").robustness)
    row("robustness of decided steps", "plain numpy, unchecked, time-major", 50, lambda: ours("error"),
        lambda: numpy_robustness(*first))  # fmt: skip
    assert np.array_equal(ours("error", "boolean").verdicts, ours("error").robustness > 0)
    row("truth of decided steps", "copying the input", 50, lambda: ours("error", "boolean"),
        lambda: (x.copy(), y.copy()), slower=True)  # fmt: skip
    return rows


def online_row(n_steps: int = 20_000) -> str:
    samples = np.random.default_rng(0).random((n_steps, 2)).tolist()
    mine, decided = [{"x": x, "y": y} for x, y in samples], []

    def ours() -> None:
        monitor = stl.OnlineMonitor(PHI, wait=True)
        decided[:] = [decision.robustness for sample in mine for decision in monitor.feed(sample)]

    if rtamt_specification("Online") is None:
        (seconds,) = shortest(3, ours)
        return f"| online, samples a second ({n_steps / seconds:.3g}) | RTAMT | not measured: it is not installed |"
    theirs, found = [[("x", x), ("y", y)] for x, y in samples], []

    def rtamt() -> None:
        specification = rtamt_specification("Online")
        specification.pastify()
        found[:] = [specification.update(t, sample) for t, sample in enumerate(theirs)]

    seconds = shortest(3, ours, rtamt)
    assert decided == found[stl.horizon(PHI) :]
    rates = [n_steps / taken for taken in seconds]
    return f"| online, samples a second ({rates[0]:.3g}) | RTAMT ({rates[1]:.3g}) | {rates[0] / rates[1]:.3g} × |"


def streams_against_sentil(n_steps: int) -> list[str]:
    """One sample a call, and blocks, in nanoseconds a sample, of monitors that are made before; results are compared
    first."""
    x, y = np.random.default_rng(0).random((2, n_steps))
    samples = [{"x": a, "y": b} for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    expected = stl.monitor(PHI, {"x": x, "y": y})
    waiting, early = stl.OnlineMonitor(PHI, wait=True), stl.OnlineMonitor(PHI)
    found = [decision for sample in samples for decision in waiting.feed(sample)]
    assert [decision.robustness for decision in found] == expected.robustness.tolist()
    verdicts = dict(decision[:2] for sample in samples for decision in early.feed(sample))
    assert [verdicts[t] for t in range(len(expected.verdicts))] == expected.verdicts.tolist()

    def one_by_one(feed: Callable[[dict[str, float]], Any]) -> Callable[[], None]:
        def run() -> None:
            for sample in samples:
                feed(sample)

        return run

    def blocks(size: int) -> Callable[[], None]:
        def run() -> None:
            for start in range(0, n_steps, size):
                waiting.feed({"x": x[start : start + size], "y": y[start : start + size]})

        return run

    rows = []
    mine = [one_by_one(early.feed), one_by_one(waiting.feed)]
    if sentil_formula() is None:
        taken = shortest(5, *mine)[1] / n_steps * 1e9
        rows.append(f"| online, ns a sample ({taken:.3g}) | SENTIL | not measured: it is not installed |")
    else:
        import sentil

        monitor = sentil.OnlineMonitor(TEXT)
        values = [monitor.update(float(t), sample).value for t, sample in enumerate(samples)]
        assert values[stl.horizon(PHI) :] == expected.robustness.tolist()

        def by_sentil() -> None:
            update = sentil.OnlineMonitor(TEXT).update
            for t, sample in enumerate(samples):
                update(float(t), sample)

        *ours, theirs = shortest(5, *mine, by_sentil)
        for what, taken in zip(("early verdicts", "final robustness"), ours, strict=True):
            figures = f"{taken / n_steps * 1e9:.3g}) | SENTIL ({theirs / n_steps * 1e9:.3g}"
            rows.append(f"| {what}, one sample a call, ns ({figures}) | {taken / theirs:.2g} of its time |")
    for size in (n_steps // 20, n_steps):
        (taken,) = shortest(5, blocks(size))
        rows.append(f"| final robustness, blocks of {size} | | {taken / n_steps * 1e9:.3g} ns a sample |")
    return rows


def tied_rows(n_steps: int) -> list[str]:
    """Verdicts that the values of earlier samples decide, beside the same monitor waiting for the robustness."""
    samples = [{"x": x} for x in np.random.default_rng(0).random(n_steps).tolist()]
    rows = []
    for text in ("always[0,10](x[t+1] > x and x < 3)", "always[0,50](abs(x[t+1] - x) <= 0.5 -> x > -9)"):
        phi = stl.parse(text)
        early, waiting = (
            dict(
                decision[:2] for one in [stl.OnlineMonitor(phi, wait=wait)] for x in samples for decision in one.feed(x)
            )
            for wait in (False, True)
        )
        assert waiting.items() <= early.items()

        def run(wait: bool, phi: stl.Formula = phi) -> None:
            feed = stl.OnlineMonitor(phi, wait=wait).feed
            for sample in samples:
                feed(sample)

        mine, other = (taken / n_steps * 1e6 for taken in shortest(3, lambda: run(False), lambda: run(True)))
        rows.append(
            f"| early verdicts, µs a sample, `{text}` ({mine:.3g}) | waiting ({other:.3g}) | {mine / other:.2g} × |"
        )
    return rows


def spread_rows(n_steps: int) -> list[str]:
    """The 99th percentile of single feeds beside their median, of some formulas: the calmest of some runs."""
    x, y = np.random.default_rng(0).random((2, n_steps)).tolist()
    samples = [{"x": a, "y": b} for a, b in zip(x, y, strict=True)]
    rows = []
    for text in (TEXT, "always[0,1000](x > 0.01)", "(x > 0.2) until[0,50] (y > 0.9)"):
        for wait, what in ((False, "early verdicts"), (True, "final robustness")):
            best = (np.inf, np.inf, np.inf)
            for _ in range(5):
                feed, clock, taken = stl.OnlineMonitor(stl.parse(text), wait=wait).feed, time.perf_counter_ns, []
                for sample in samples:
                    start = clock()
                    feed(sample)
                    taken.append(clock() - start)
                middle, late = np.percentile(taken[len(taken) // 10 :], [50, 99])
                best = min(best, (late / middle, late, middle))
            figures = f"{best[1]:.3g} ns) | their median ({best[2]:.3g} ns"
            rows.append(f"| 99th percentile of single calls, {what}, `{text}` ({figures}) | {best[0]:.2g} × |")
    return rows


def table(quick: bool = False) -> list[str]:
    stl.OnlineMonitor(PHI)  # loads the compiler: without it, monitors judge in numpy
    lines = [f"`{TEXT}`", "", "| what | against | figure |", "|---|---|---|"]
    shapes = SMALL if quick else SHAPES
    return [*lines, *(row for shape in shapes for row in offline_rows(*shape)), online_row(500 if quick else 20_000),
            *streams_against_sentil(2000 if quick else 100_000), *spread_rows(2000 if quick else 50_000),
            *tied_rows(200 if quick else 5000)]  # fmt: skip


if __name__ == "__main__":
    print("\n".join(table()))
