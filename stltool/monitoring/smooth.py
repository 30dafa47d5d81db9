"""Robustness with soft extrema, and how far it can be from the exact one.

[Wang24, eq. 8] with smoothness β:

    smax(x₁ … x_n) = 1/β log Σ exp(βx_i)           max ≤ smax ≤ max + log(n)/β
    smin(x₁ … x_n) = −1/β log Σ exp(−βx_i)         min − log(n)/β ≤ smin ≤ min

in place of every max and min of the robustness: F, or: smax; G, and: smin. smax is associative, so windows are composed
of disjoint windows of 2^k steps, in O(log w) passes (disjoint, since overlaps would count twice). Until is composed in
the same way from the pairs of blocks.py:

    (A₁,B₁) ∘ (A₂,B₂) = (smin(A₁,A₂), smax(B₁, smin(A₁,B₂)))

which is not a soft extremum over all witnesses: smin does not distribute over smax, and that extremum would cost n·w.

Bounds. Each value v of a formula at a step comes with O, N, U, M such that the exact robustness r obeys

    v − O − log(N)/β ≤ r ≤ v + U + log(M)/β

smax of such values: O = max O_i, N = Σ N_i, since nested smax are one flat smax; U = max(U_i + log(M_i)/β), M = 1. smin
is symmetric. The four depend on the step (windows may be cut at the end), not on the trace. Rounding: a soft extremum
of two doubles is off by less than 64u(|v| + log(2)/β), u = 2⁻⁵³, and extrema are 1-Lipschitz, so these add up along the
deepest path; the margins' own errors (comparisons.py) are added, the largest for each trace.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias, assert_never

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import real
from stltool.display import Card, Displayed
from stltool.errors import SettingsError
from stltool.logic.formula import Constant, Formula, Label
from stltool.logic.task import Task
from stltool.monitoring.blocks import Block
from stltool.monitoring.comparisons import Predicate
from stltool.monitoring.offline import decided_steps, prepare, refuse_unknown, without_last
from stltool.monitoring.program import Atom, Instruction, Program
from stltool.monitoring.samples import End

Floats: TypeAlias = NDArray[np.float64]
Bound: TypeAlias = Floats | np.float64

_BLOCK = 1 << 14
_ROUNDING = 64 * 2.0**-53
_WIDER = 1 + 2.0**-20  # covers the rounding of the bounds themselves


@dataclass(frozen=True, eq=False, repr=False)
class SmoothRobustness(Displayed):
    """Soft robustness at the decided steps, and an enclosure of the exact one: lower ≤ robustness ≤ upper.

    Each array is (n_decided,) for one trace, (n_traces, n_decided) for a batch.
    """

    values: Floats
    lower: Floats
    upper: Floats
    beta: float

    def _card(self) -> Card:
        facts: dict[str, object] = {}
        if self.values.size:
            facts["values"] = f"{self.values.min():.6g} to {self.values.max():.6g}"
            width = self.upper - self.lower
            known = width[np.isfinite(width)]
            facts["widest enclosure"] = f"{known.max():.3g}" if known.size else None
        shape = " x ".join(map(str, self.values.shape))
        return Card(f"SmoothRobustness: values {shape}, beta {self.beta:g}", [facts])


def smooth_robustness(
    phi: Formula | Task, signals: Mapping[str, ArrayLike], beta: float, end: End = "error"
) -> SmoothRobustness:
    """Robustness with log-sum-exp in place of max and min [Wang24, eq. 8], β from 1e-100 to 1e100.

    Signals and ends are as for `monitor`, and so are errors; SettingsError for β out of range. Under "hold" a held
    sample counts once for every step of a window, so an interval without end is refused there.
    """
    if not 1e-100 <= (beta := float(real(beta, "beta", "10"))) <= 1e100:
        raise SettingsError(f"beta is {beta!r}; it must be a number from 1e-100 to 1e100")
    formula, traces, beyond = prepare(phi, signals, end, "smooth_robustness", once=False)
    h = traces.program.horizon
    if h is None and end == "hold":
        raise SettingsError(
            'with end="hold", a soft maximum over an interval without end has no value: the held sample would count '
            'without end; write an end, or use end="cut"'
        )
    outs = [np.empty((traces.n_traces, decided_steps(traces, end))) for _ in range(3)]
    longer, block_end = traces, end
    if end == "hold" and h is not None and traces.n_steps > 0:
        longer, block_end = traces.held(h), "error"
    with np.errstate(all="ignore"):
        for block, rows, first in longer.blocks(block_end, _BLOCK):
            found = _run(traces.program, block, float(beta))
            asked = found[0][:, : max(outs[0].shape[1] - beyond - first, 0)]
            refuse_unknown(asked, formula, traces, rows.start, first, end)
            for out, array in zip(outs, found, strict=True):
                out[rows, first : first + array.shape[1]] = array
    outs = [without_last(out, beyond) for out in outs]
    values, lower, upper = outs if traces.batch else [out[0] for out in outs]
    return SmoothRobustness(values, lower, upper, float(beta))


@dataclass(frozen=True, slots=True)
class _Soft:
    """Values (rows, steps), with O, log N, U, log M of the module docstring: (steps,) each, or numbers for all steps.

    `size` (rows, 1) is at least every finite |v|, `error` (rows, 1) bounds the effect of rounding on a value.
    """

    values: Floats
    over: Bound
    log_n: Bound
    under: Bound
    log_m: Bound
    size: Floats
    error: Floats

    def __getitem__(self, steps: slice) -> _Soft:
        over, log_n, under, log_m = (
            bound[steps] if isinstance(bound, np.ndarray) else bound
            for bound in (self.over, self.log_n, self.under, self.log_m)
        )
        return _Soft(self.values[:, steps], over, log_n, under, log_m, self.size, self.error)

    def __len__(self) -> int:
        return int(self.values.shape[1])

    def __neg__(self) -> _Soft:
        return _Soft(-self.values, self.under, self.log_m, self.over, self.log_n, self.size, self.error)

    def reversed(self) -> _Soft:
        """The last step first; the bounds are by step."""
        over, log_n, under, log_m = (
            bound[::-1] if isinstance(bound, np.ndarray) else bound
            for bound in (self.over, self.log_n, self.under, self.log_m)
        )
        return _Soft(self.values[:, ::-1], over, log_n, under, log_m, self.size, self.error)

    def to_length(self, steps: int, value: float) -> _Soft:
        """This many steps; those that are missing are never read."""
        return self[:steps] if steps <= len(self) else self.padded(steps - len(self), value)

    def padded(self, steps: int, value: float) -> _Soft:
        """With this many steps of a neutral element appended, which count as nothing."""
        values = np.hstack([self.values, np.full((len(self.values), steps), value)])
        over, under = (np.append(bound, np.zeros(steps)) for bound in (self.over, self.under))
        log_n, log_m = (np.append(count, np.full(steps, -np.inf)) for count in (self.log_n, self.log_m))
        return _Soft(values, over, log_n, under, log_m, self.size, self.error)


def _run(program: Program, block: Block, beta: float) -> tuple[Floats, Floats, Floats]:
    """Soft robustness at the block's decided steps, and lower and upper bounds on the exact one."""
    instructions = program.instructions
    soft = _Machine(program, block, beta, by_step=block.end == "cut" or program.has_past)
    values: dict[int, _Soft] = {}
    for number, now in enumerate(instructions):
        values[number] = soft.operator(now, [values[arg] for arg in now.args])
        for ended in now.ends:
            del values[ended]
    result = values[len(instructions) - 1]
    error = result.error + _ROUNDING * result.size
    lower = result.values - (soft.closed(result.over, result.log_n) + error)
    upper = result.values + (soft.closed(result.under, result.log_m) + error)
    steps = block.results
    return result.values[:, steps], lower[:, steps], upper[:, steps]


@dataclass(frozen=True, slots=True)
class _Machine:
    program: Program
    block: Block
    beta: float
    by_step: bool  # bounds differ from step to step, since windows may be cut

    def operator(self, now: Instruction, operands: list[_Soft]) -> _Soft:
        if len(operands) == 2 and now.op != "since":
            n = min(map(len, operands))
            operands = [operand[:n] for operand in operands]
        match now.op:
            case "atom":
                assert now.atom is not None
                return self.atom(now.atom)
            case "not":
                return -operands[0]
            case "or":
                return self.smax(*operands)
            case "and":
                return self.smin(*operands)
            case "iff":
                left, right = operands
                return self.smin(self.smax(-left, right), self.smax(left, -right))
            case "eventually":
                a, b = self.bounds(now)
                return self.window(self.ended(operands[0], b, -np.inf)[a:], b - a + 1)
            case "always":
                a, b = self.bounds(now)
                return -self.window(self.ended(-operands[0], b, -np.inf)[a:], b - a + 1)
            case "until":
                a, b = self.bounds(now)
                left, right = self.ended(operands[0], b, np.inf), self.ended(operands[1], b, -np.inf)
                result = self.until(left[a:], right[a:], b - a + 1)
                if a > 0:
                    before = -self.window(-left, a)
                    result = self.smin(before[: len(result)], result)
                return result
            case "once":
                return self.earlier(operands[0], now)
            case "historically":
                return -self.earlier(-operands[0], now)
            case "since":
                return self.since(operands[0], operands[1], now)
            case _:
                assert_never(now.op)

    def earlier(self, x: _Soft, now: Instruction) -> _Soft:
        """smax over t−b … t−a: the mirror image of smax over t+a … t+b on a trace whose windows are cut at its end."""
        n = self.block.steps
        a, b = min(now.a, n), n if now.b is None else min(now.b, n)
        mirrored = x.to_length(min(len(x) + a, n), -np.inf).reversed().padded(b, -np.inf)
        return self.window(mirrored[a:], b - a + 1).reversed()

    def since(self, left: _Soft, right: _Soft, now: Instruction) -> _Soft:
        n = self.block.steps
        a, b = min(now.a, n), n if now.b is None else min(now.b, n)
        steps = min(len(right) + a, n) if b == 0 else min(len(left), len(right) + a)
        A = left.to_length(steps, np.inf).reversed().padded(b, np.inf)
        B = right.to_length(steps, -np.inf).reversed().padded(b, -np.inf)
        result = self.until(A[a:], B[a:], b - a + 1)
        if a > 0:
            before = -self.window(-A, a)
            result = self.smin(before[: len(result)], result)
        return result.reversed()

    def bounds(self, now: Instruction) -> tuple[int, int]:
        n = self.block.steps
        if self.block.end == "open":
            assert now.b is not None
            return now.a, now.b
        return min(now.a, n), n if now.b is None else min(now.b, n)

    def ended(self, operand: _Soft, b: int, neutral: float) -> _Soft:
        return operand if self.block.end == "open" else operand.padded(b, neutral)

    def atom(self, atom: Atom) -> _Soft:
        rows, n = self.block.rows, self.block.steps
        values, error = np.empty((rows, n)), np.zeros((rows, 1))
        match atom:
            case Constant(value):
                values[...] = np.inf if value else -np.inf
            case Label(name):
                values[...] = np.where(self.block.columns[name], np.inf, -np.inf)
            case Predicate():
                atom.judge(self.block.columns, None, values, self.block.wide)
                before = max(self.program.reach(atom.names)[1] - self.block.first, 0)  # nobody looks there
                values[:, :before] = -np.inf
                error = np.broadcast_to(atom.error(self.block.columns), values.shape).max(axis=1, keepdims=True)
            case _:
                assert_never(atom)
        finite = np.where(np.isfinite(values), np.abs(values), 0.0)
        zeros = np.zeros(n) if self.by_step else np.float64(0.0)  # all windows are full, hence equal
        return _Soft(values, zeros, zeros, zeros, zeros, np.max(finite, axis=1, keepdims=True), error)

    def closed(self, bound: Bound, log_count: Bound) -> Bound:
        """`bound` + log(count)/β, rounded up; an empty count has no error."""
        closed: Bound = (bound + np.maximum(log_count, 0.0) / self.beta) * _WIDER
        return closed

    def smax(self, x: _Soft, y: _Soft) -> _Soft:
        size = np.maximum(x.size, y.size) + np.log(2) / self.beta
        return _Soft(
            _soft_maximum(x.values, y.values, self.beta),
            np.maximum(x.over, y.over),
            np.logaddexp(x.log_n, y.log_n),
            np.maximum(self.closed(x.under, x.log_m), self.closed(y.under, y.log_m)),
            np.zeros_like(x.log_m)[()],  # a number for a number
            size,
            np.maximum(x.error, y.error) + _ROUNDING * size,
        )

    def smin(self, x: _Soft, y: _Soft) -> _Soft:
        return -self.smax(-x, -y)

    def window(self, x: _Soft, width: int) -> _Soft:
        """smax over t … t+width−1, composed of disjoint windows of 2^k steps, the shortest first."""
        result, covered, span = x, 0, 1
        while True:
            if width & span:
                n = max(len(x) - covered, 0)
                result = self.smax(result[:n], x[covered:]) if covered else x
                covered += span
            if covered == width:
                return result
            x = self.smax(x[: max(len(x) - span, 0)], x[span:])
            span *= 2

    def until(self, A: _Soft, B: _Soft, width: int) -> _Soft:
        """left U[0,width−1] right, from disjoint pairs in the same way."""
        firsts, result, covered, span = A, B, 0, 1
        while True:
            if width & span:
                n = max(len(B) - covered, 0)
                result = self.smax(result[:n], self.smin(firsts[:n], B[covered:])) if covered else B
                firsts = self.smin(firsts[:n], A[covered:]) if covered else A
                covered += span
            if covered == width:
                return result
            n = max(len(B) - span, 0)
            A, B = self.smin(A[:n], A[span:]), self.smax(B[:n], self.smin(A[:n], B[span:]))
            span *= 2


def _soft_maximum(x: Floats, y: Floats, beta: float) -> Floats:
    """1/β log(exp(βx) + exp(βy)); infinities behave as under max, and NaN propagates."""
    high = np.maximum(x, y)
    apart = high - np.minimum(x, y)
    np.fmax(apart, 0.0, out=apart)  # equal infinities
    apart *= -beta
    np.exp(apart, out=apart)
    np.log1p(apart, out=apart)
    apart /= beta
    apart += high
    return apart
