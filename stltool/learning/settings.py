"""The knobs of a learner, checked once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Literal

from stltool.errors import SettingsError


@dataclass(frozen=True)
class Settings:
    """Defaults are the paper's for its smaller scenarios (Table I), where a knob is the paper's.

    episodes        training episodes
    evaluate_every  episodes between two exact evaluations of the greedy policy
    decay           n_d of the exploration schedule ε = end + (start − end)·exp(−episode / n_d)
    epsilon_start, epsilon_end  its ends
    memory          transitions that the replay memory holds; the oldest leave first
    period, batch   naive-er, and faithful methods: every `period`-th step draws `batch` transitions
    replays         cfer: real transitions replayed after each episode
    least_step      smallest learning rate of the corrected methods, α = max(least_step, 1/n)
    alpha, gamma, scale  faithful methods only: learning rate, discount, and the reward's offset under an outer G,
                    χ − 0.5 ("published", what the authors ran) or χ − 0.9 ("paper", what they print)
    """

    episodes: int = 1000
    evaluate_every: int = 20
    decay: float = 400.0
    epsilon_start: float = 0.99
    epsilon_end: float = 0.01
    memory: int = 1000
    period: int = 4
    batch: int = 64
    replays: int = 200
    least_step: float = 0.02
    alpha: float = 0.01
    gamma: float = 0.999
    scale: Literal["published", "paper"] = "published"

    def __post_init__(self) -> None:
        for name in ("episodes", "evaluate_every", "memory", "period", "batch"):
            self._require(name, _whole(getattr(self, name)) and getattr(self, name) >= 1, "a whole number from 1")
        self._require("replays", _whole(self.replays) and self.replays >= 0, "a whole number from 0")
        self._require("decay", _real(self.decay) and self.decay > 0, "positive")
        for name in ("epsilon_start", "epsilon_end", "gamma"):
            self._require(name, _real(getattr(self, name)) and 0 <= getattr(self, name) <= 1, "between 0 and 1")
        for name in ("least_step", "alpha"):
            self._require(name, _real(getattr(self, name)) and 0 < getattr(self, name) <= 1, "above 0 and at most 1")
        self._require("scale", self.scale in ("published", "paper"), "published or paper")

    def _require(self, name: str, fine: bool, what: str) -> None:
        if not fine:
            raise SettingsError(f"{name} is {getattr(self, name)!r}; it must be {what}")


def _whole(value: object) -> bool:
    return not isinstance(value, bool) and isinstance(value, Integral)


def _real(value: object) -> bool:
    return not isinstance(value, bool) and isinstance(value, Real) and math.isfinite(value)
