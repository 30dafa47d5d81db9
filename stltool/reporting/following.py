"""What `stltool monitor --follow` tells: each decision as it comes, and all of them at the end."""

from __future__ import annotations

from stltool.display import counted
from stltool.logic.task import Task
from stltool.monitoring.decisions import Decision
from stltool.reporting.records import FollowedRecord, FollowedStepRecord


class Followed:
    """The decisions on a log that is still being written; with `at`, those of this step only."""

    def __init__(self, task: Task, end: str, at: int | None) -> None:
        self._task, self._end, self._at = task, end, at
        self._steps: list[FollowedStepRecord] = []

    @property
    def settled(self) -> bool:
        """Whether the one step that is asked for is decided."""
        return self._at is not None and bool(self._steps)

    def add(self, decision: Decision, sample: int | None) -> str | None:
        """Note a decision, made by a sample, or by the end of the log; returns it in words, if it is asked for."""
        if self._at is not None and decision.step != self._at:
            return None
        self._steps.append({
            "step": decision.step, "time": self._time(decision.step), "verdict": decision.verdict,
            "certain_at": sample, "certain_at_time": None if sample is None else self._time(sample),
        })  # fmt: skip
        when = "at the end of the trace" if sample is None else f"certain at step {self._named(sample)}"
        return f"step {self._named(decision.step)}  {'holds' if decision.verdict else 'violated'}, {when}"

    def data(self, where: str, n_steps: int, horizon: int, clock: str | None) -> FollowedRecord:
        ticks, task = self._task.ticks, self._task
        first = min((one["step"] for one in self._steps if not one["verdict"]), default=None)
        violations = sum(not one["verdict"] for one in self._steps)
        return {
            "task": task.name if task.path is not None else None,
            "formula": str(task.formula),
            "trace": where,
            "samples": n_steps,
            "horizon": horizon,
            "end": self._end,
            "at": self._at,
            "unit": ticks.unit if ticks is not None else None,
            "step": ticks.number(1) if ticks is not None else None,
            "clock": clock,
            "decided": len(self._steps),
            "holds": not violations,
            "violations": violations,
            "first_violation": first,
            "first_violation_time": None if first is None else self._time(first),
            "decisions": self._steps,
        }

    def _time(self, step: int) -> float | None:
        return self._task.ticks.number(step) if self._task.ticks is not None else None

    def _named(self, step: int) -> str:
        return f"{step}" + (f" ({self._task.ticks.text(step)})" if self._task.ticks is not None else "")


def followed_facts(data: FollowedRecord) -> dict[str, str]:
    """The terminal's last lines: what was read, and the result."""
    left, violations, first = data["samples"] - data["decided"], data["violations"], data["first_violation"]
    time = "" if data["first_violation_time"] is None else f" ({data['first_violation_time']:.12g} {data['unit']})"
    facts = {"read": f"{counted(data['samples'], 'sample')} of {data['trace']}"}
    if data["clock"] is not None:
        facts["clock"] = data["clock"]
    return {
        **facts,
        "decided": counted(data["decided"], "step")
        + (f"; the verdicts of {left} depend on what comes" if left else ""),
        "violated": f"at {violations} of them, first at step {first}{time}" if violations else "at no step",
    }
