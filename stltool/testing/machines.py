"""Hypothesis' rule-based machines whose invariant is a formula over what is observed after every rule."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from hypothesis import target
from hypothesis.stateful import RuleBasedStateMachine, invariant

from stltool.errors import SettingsError
from stltool.logic.formula import Formula
from stltool.logic.task import Task
from stltool.monitoring import monitor
from stltool.testing.judged import tell
from stltool.testing.recorder import Recorder

_FARTHEST = 1e9  # Hypothesis' targets are finite


class StlStateMachine(RuleBasedStateMachine):
    """A machine with rules as in Hypothesis; `observe` returns a sample of the state.

        class Thermostat(StlStateMachine):
            formula = "G (heating -> F[0,3] (temperature > 18))"

            def observe(self):
                return {"temperature": self.room.temperature, "heating": self.room.heating}

    A sample is taken before the first rule and after each. A violation fails as soon as it is certain: what is still
    open when a run ends passes, since Hypothesis may end a run anywhere. `formula` may be a text, and may have `G`
    without an end.

    steer   runs of small robustness are looked for (`hypothesis.target`)
    """

    formula: ClassVar[Formula | Task | str]
    steer: ClassVar[bool] = True

    def __init__(self) -> None:
        super().__init__()
        if not hasattr(type(self), "formula"):
            raise SettingsError(f"{type(self).__name__} has no formula; write, for example, formula = 'G (x < 5)'")
        self.record = Recorder(type(self).formula)

    def observe(self) -> Mapping[str, Any]:
        """A sample: a value for every name of the formula, and any others that its report should have."""
        raise NotImplementedError(f"{type(self).__name__} has no observe(self); return a sample, such as {{'x': 0.5}}")

    @invariant()
    def _specification(self) -> None:
        __tracebackhide__ = True
        self.record(self.observe())

    def teardown(self) -> None:
        if self.record.n_steps and self.record.verdict is not False:  # a violation has been told
            tell(self.record.phi, self.record.trace, 0, "cut" if self.record.verdict is None else "hold")
        if type(self).steer and self.record.n_steps and self.record.verdict is None:
            found = monitor(self.record.phi, self.record.trace, "cut", "robustness", at=0).robustness
            assert found is not None  # asked for
            target(-max(min(float(found[0]), _FARTHEST), -_FARTHEST), label="robustness")
        super().teardown()
