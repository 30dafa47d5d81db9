"""Assertions for tests: what a trace satisfies, how probable it is, and what two formulas have to do with each other.

Each raises a child of `StlAssertionError`, an AssertionError, whose message says why in sentences and as code that
reproduces it. Faults of the input raise what other functions of stltool raise.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import NoReturn

from numpy.typing import ArrayLike

from stltool.arguments import real, require, whole
from stltool.automata.vacuity import meaning
from stltool.checking import CheckResult, LikelyRuns, check, likely_runs, robust_check
from stltool.diagnosis import Diagnosis, diagnose
from stltool.display import NATURES, cut, probability_text
from stltool.errors import SettingsError, SizeError, StlToolError
from stltool.logic.formula import And, Formula, Not, bounded_formula_of, formula_of
from stltool.logic.task import Task
from stltool.monitoring import monitor
from stltool.monitoring.samples import End
from stltool.numbers import number_text
from stltool.policy import Policy
from stltool.product import Product
from stltool.reporting.runs import likely_data, trace_text, verdict_text
from stltool.testing.constructive import Constructor, NoTraceError
from stltool.testing.judged import tell
from stltool.testing.ranges import Limits, ranges_of
from stltool.testing.timeline import timeline
from stltool.testing.trace import Trace

_LONGEST = 100  # characters of a formula
_PATIENCE = 10.0  # seconds for the exact fraction, if the bound lies inside the enclosure


class StlAssertionError(AssertionError):
    """An assertion of stltool.testing does not hold. `str(error)` is the whole explanation."""


class TraceViolation(StlAssertionError):
    """A trace violates a formula: `diagnosis` says why; `signals` is the trace."""

    def __init__(self, message: str, diagnosis: Diagnosis, signals: Mapping[str, ArrayLike]) -> None:
        super().__init__(message)
        self.diagnosis, self.signals = diagnosis, signals


class ProbabilityViolation(StlAssertionError):
    """A probability is not within the bound: `result` is the check, `likely` the most probable run that explains it.

    `likely` is None for interval probabilities, under which a run has no single one.
    """

    def __init__(self, message: str, result: CheckResult, likely: LikelyRuns | None) -> None:
        super().__init__(message)
        self.result, self.likely = result, likely


class FormulasDiffer(StlAssertionError):
    """Two formulas do not mean the same, or one does not imply the other: on `trace`, if None, it is not decided."""

    def __init__(self, message: str, trace: Trace | None) -> None:
        super().__init__(message)
        self.trace = trace


def assert_trace(phi: Formula | Task, signals: Mapping[str, ArrayLike], t: int = 0, *, end: End = "error") -> None:
    """The trace satisfies φ at step t. `signals` and `end` are as in `stl.monitor`, of one trace.

    Raises TraceViolation with the diagnosis in sentences (which part, when, by which value) and a timeline.
    """
    __tracebackhide__ = True
    t = whole(t, "assert_trace's step t", least=0)
    result = monitor(phi, signals, end, "boolean", at=t)
    assert result.verdicts is not None  # asked for
    tell(phi, signals, t, end)
    if result.verdicts.size and bool(result.verdicts.all()):
        return
    found = diagnose(phi, signals, t, end=end)
    lines = [f"{_short(phi)} fails at step {t}{_by_how_much(phi, signals, end, t)}", ""]
    lines += [f"  {line}" for line in str(found).splitlines()]
    if picture := timeline(found, signals):
        lines += ["", *(f"  {line}".rstrip() for line in picture)]
    raise TraceViolation("\n".join(lines), found, signals)


def _by_how_much(phi: Formula | Task, signals: Mapping[str, ArrayLike], end: End, t: int) -> str:
    try:
        margins = monitor(phi, signals, end, "robustness", at=t).robustness
    except StlToolError:  # a term without a value that does not matter
        return ""
    return "" if margins is None or not margins.size else f", robustness {float(margins[0]):.6g}"


def assert_probability(
    product: Product,
    policy: Policy | None = None,
    *,
    at_least: float | Fraction | None = None,
    at_most: float | Fraction | None = None,
) -> CheckResult:
    """P(task) under the policy, exactly, is at least, or at most, a bound; without a policy the maximum over all.

    If the model's probabilities are intervals, so it is whatever they are in these (`stl.robust_check`). Returns the
    check. If the bound lies inside its enclosure, the exact fraction decides where it can be had. Raises
    ProbabilityViolation with the most probable violation, or satisfaction if P is too large.
    """
    __tracebackhide__ = True
    require(product, Product, "assert_probability's product")
    if at_least is None and at_most is None:
        raise SettingsError("assert_probability has no bound; give at_least=0.95, or at_most")
    uncertain = product.model.uncertain
    result = check(product, policy) if not uncertain else robust_check(product, policy)
    for bound, lowest in ((at_least, True), (at_most, False)):
        if bound is None:
            continue
        bound = real(bound, f"assert_probability's {'at_least' if lowest else 'at_most'}")
        if uncertain and not lowest:
            result = robust_check(product, policy, nature="with")
        kept = result.at_least(bound) if lowest else result.at_most(bound)
        if kept is None and not uncertain:
            result = _exactly(result, product, policy)
            kept = result.at_least(bound) if lowest else result.at_most(bound)
        if not kept:
            _too_far(result, bound, lowest, kept is None)
    return result


def _exactly(result: CheckResult, product: Product, policy: Policy | None) -> CheckResult:
    try:
        return check(product, policy, exact=True, time_limit=_PATIENCE)
    except StlToolError:  # too large, or rows that do not sum to 1: it stays undecided
        return result


def _too_far(result: CheckResult, bound: float | Fraction, lowest: bool, undecided: bool) -> NoReturn:
    __tracebackhide__ = True
    likely = None
    if not result.product.model.uncertain:
        likely = likely_runs(result.product, result.policy, satisfied=not lowest, count=1)
    told = number_text(bound) if isinstance(bound, Fraction) else f"{bound:.15g}"
    wanted = f"at {'least' if lowest else 'most'} {told}"
    whose = {"maximum": "the maximum over all policies", "policy": "of the policy"}[result.question]
    exactly = f" = {result.fraction}" if result.fraction is not None and len(str(result.fraction)) < _LONGEST else ""
    lines = [
        f"P({_short(result.product.formula)}) = {result.probability:.15g}{exactly}, {whose}, is "
        + (f"not known to be {wanted}: the bound lies inside the enclosure" if undecided else f"not {wanted}"),
        f"  enclosure  {result.lower!r} … {result.upper!r}",
    ]
    kind = "violation" if lowest else "satisfaction"
    if likely is None:
        raise ProbabilityViolation("\n".join([*lines, f"  with {NATURES[result.nature or 'against']}"]), result, None)
    data = likely_data(likely)
    for run in data["runs"]:
        share = f", {100 * run['share']:.3g} % of P({kind})" if run["share"] is not None else ""
        lines += [
            f"  the most probable {kind}, probability {probability_text(run['probability'])}{share}, "
            f"{verdict_text(run)}:",
            f"    {trace_text(run['states'], run['labels'], run['actions'])}",
        ]
        if run["remembered"] is not None:
            lines.append(f"    before the verdict: {run['remembered']}")
    if not data["runs"]:
        lines.append(f"  there is no {kind} of positive probability")
    raise ProbabilityViolation("\n".join(lines), result, likely)


def assert_equivalent(phi: Formula | Task, psi: Formula | Task, signals: Mapping[str, Limits] | None = None) -> None:
    """φ and ψ have the same truth at step 0 of every trace, with signals in the given ranges (default: any values).

    signals   name → range, as in `satisfying_traces`

    Decided by automata over the truth assignments that values can give: exactly if comparisons are linear, with abs,
    min and max. Raises FormulasDiffer with a trace on which they differ; also if it could not be decided, which its
    message says.
    """
    __tracebackhide__ = True
    left, right = _both(phi, psi, "assert_equivalent")
    for holds, fails in ((left, right), (right, left)):
        _no_trace(holds, fails, signals, f"{_short(left)} and {_short(right)} differ")


def assert_refines(phi: Formula | Task, psi: Formula | Task, signals: Mapping[str, Limits] | None = None) -> None:
    """φ refines ψ: every trace that satisfies φ satisfies ψ, with signals in the given ranges (default: any values).

    Everything else as in `assert_equivalent`.
    """
    __tracebackhide__ = True
    left, right = _both(phi, psi, "assert_refines")
    _no_trace(left, right, signals, f"{_short(left)} does not refine {_short(right)}")


def _both(phi: Formula | Task, psi: Formula | Task, door: str) -> tuple[Formula, Formula]:
    return bounded_formula_of(phi, f"{door}' formula phi"), bounded_formula_of(psi, f"{door}' formula psi")


def _no_trace(holds: Formula, fails: Formula, signals: Mapping[str, Limits] | None, head: str) -> None:
    """No trace satisfies the one and violates the other."""
    __tracebackhide__ = True
    if holds == fails:
        return
    goal, ranges = And((holds, Not(fails))), ranges_of(signals, "the ranges of signals")
    doubt = "values for comparisons that are not linear are sought among finitely many points"
    try:
        made = Constructor(goal, ranges)
    except NoTraceError as nothing:
        if nothing.sure:
            return
    except (SettingsError, SizeError) as refusal:
        doubt = str(refusal)
    else:
        trace = Trace(made.build(lambda n: 0))
        found = diagnose(fails, trace)
        lines = [f"{head}; {_short(holds)} holds and {_short(fails)} fails on", "", f"  {trace!r}", ""]
        lines += [f"  {line}" for line in str(found).splitlines()]
        lines += ["", *(f"  {line}".rstrip() for line in timeline(found, trace))]
        raise FormulasDiffer("\n".join(lines), trace)
    try:
        proved = meaning(goal).can_hold is False
    except StlToolError:
        proved = False
    if not proved:
        raise FormulasDiffer(f"not decided whether {head}: no trace was found, and none is excluded; {doubt}", None)


def _short(phi: Formula | Task) -> str:
    return cut(str(formula_of(phi, "the formula")), _LONGEST)
