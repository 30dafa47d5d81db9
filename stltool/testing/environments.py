"""Gymnasium environments whose episodes are judged by a formula as they run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium

from stltool.arguments import flag, mapping
from stltool.errors import ArgumentError
from stltool.logic.formula import Formula
from stltool.logic.task import Task
from stltool.monitoring.samples import End
from stltool.testing.recorder import Recorder


class RecordedEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """An environment that records every episode: sample 0 is the observation of `reset`, sample t that of step t.

    signals   name → function of an observation; for the names of the formula, and others to be recorded
    stop      end an episode (truncated) as soon as its verdict is certain
    raises    raise TraceViolation at a violation; otherwise the episode is truncated
    end       how an episode is judged that ends before its verdict is certain; "hold": it stays where it is

    `info["stl"]` is the verdict so far: None, True or False. `record` is the episode's `Recorder`, with its trace.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        phi: Formula | Task | str,
        signals: Mapping[str, Callable[[Any], Any]],
        *,
        stop: bool = True,
        raises: bool = True,
        end: End = "hold",
    ) -> None:
        super().__init__(env)
        self._signals = dict(mapping(signals, "RecordedEnv's signals", '{"x": lambda observation: observation[0]}'))
        for name, function in self._signals.items():
            if not callable(function):
                raise ArgumentError(f"RecordedEnv's signal {name} is not a function; give one of an observation")
        self._phi, self._end = phi, end
        self._stop, self._raises = flag(stop, "RecordedEnv's stop"), flag(raises, "RecordedEnv's raises")
        self.record = Recorder(phi, end=end)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        __tracebackhide__ = True
        observation, info = self.env.reset(seed=seed, options=options)
        self.record = Recorder(self._phi, end=self._end)
        return observation, {**info, "stl": self._judged(observation, False)}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        __tracebackhide__ = True
        observation, reward, terminated, truncated, info = self.env.step(action)
        verdict = self._judged(observation, terminated or truncated)
        truncated = truncated or verdict is False or (self._stop and verdict is not None)
        return observation, reward, terminated, truncated, {**info, "stl": verdict}

    def _judged(self, observation: Any, over: bool) -> bool | None:
        __tracebackhide__ = True
        try:
            self.record({name: function(observation) for name, function in self._signals.items()})
            if over and self.record.verdict is None:
                self.record.close()
        except AssertionError:
            if self._raises:
                raise
        return self.record.verdict
