"""The knobs of a learner, checked once."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, Literal

from stltool.errors import SettingsError, near_misses


@dataclass(frozen=True)
class Settings:
    """Defaults are the paper's for smaller scenarios [Wang24, Table I], where it has the knob; `Settings.of` has the
    corrected methods' own.

    episodes        training episodes
    evaluate_every  episodes between two exact evaluations of the greedy policy
    most_steps      end before an episode that could take more environment steps than this in all
    stop_gap        end as soon as an evaluation is within this of the exact optimum (a known model only)
    decay           n_d of the exploration schedule ε = end + (start − end)·exp(−episode / n_d)
    epsilon_start, epsilon_end  its ends
    memory          transitions that the replay memory holds; the oldest leave first
    period, batch   naive-er, and faithful methods: every `period`-th step draws `batch` transitions
    replays         cfer: real transitions replayed after each episode
    least_step      smallest learning rate of corrected cfer and naive methods, α = max(least_step, 1/n)
    known_after     model-based: visits after which a choice is planned with as counted, not as paradise
    caution         corrected methods: κ of the judged policy's trust n / (n + κ) in a choice seen n times
    alpha, gamma, scale  faithful methods only: learning rate, discount, and the reward's offset under an outer G,
                    χ − 0.5 ("published", what the authors ran) or χ − 0.9 ("paper", what they print)
    factual_share   faithful cfer and cfper: share of each batch drawn from factual tuples alone, which a memory of
                    their own holds (the paper's closing question); None: as published
    """

    episodes: int = 1000
    evaluate_every: int = 20
    most_steps: int | None = None
    stop_gap: float | None = None
    decay: float = 400.0
    epsilon_start: float = 0.99
    epsilon_end: float = 0.01
    memory: int = 1000
    period: int = 4
    batch: int = 64
    replays: int = 200
    least_step: float = 0.02
    known_after: int = 1
    caution: float = 0.1
    alpha: float = 0.01
    gamma: float = 0.999
    scale: Literal["published", "paper"] = "published"
    factual_share: float | None = None

    @classmethod
    def of(cls, method: str, faithful: bool, **given: Any) -> Settings:
        """The method's defaults, and what is given by name; SettingsError for names that are no setting."""
        known = [field.name for field in dataclasses.fields(cls)]
        for name in given:
            if name not in known:
                raise SettingsError(f"there is no setting {name!r}; {near_misses(name, known)}")
        own = {} if faithful else _OWN.get(method, {})
        return cls(**{**own, **given})

    def __post_init__(self) -> None:
        for name in ("episodes", "evaluate_every", "memory", "period", "batch", "known_after"):
            self._require(name, _whole(getattr(self, name)) and getattr(self, name) >= 1, "a whole number from 1")
        self._require("replays", _whole(self.replays) and self.replays >= 0, "a whole number from 0")
        self._require("decay", _real(self.decay) and self.decay > 0, "positive")
        for name in ("epsilon_start", "epsilon_end", "gamma"):
            self._require(name, _real(getattr(self, name)) and 0 <= getattr(self, name) <= 1, "between 0 and 1")
        steps = self.most_steps
        self._require("most_steps", steps is None or (_whole(steps) and steps >= 1), "a whole number from 1")
        for name in ("stop_gap", "factual_share"):
            value = getattr(self, name)
            self._require(name, value is None or (_real(value) and 0 <= value <= 1), "between 0 and 1")
        self._require("caution", _real(self.caution) and self.caution >= 0, "0 or positive")
        for name in ("least_step", "alpha"):
            self._require(name, _real(getattr(self, name)) and 0 < getattr(self, name) <= 1, "above 0 and at most 1")
        self._require("scale", self.scale in ("published", "paper"), "published or paper")

    def _require(self, name: str, fine: bool, what: str) -> None:
        if not fine:
            raise SettingsError(f"{name} is {getattr(self, name)!r}; it must be {what}")


_OWN: dict[str, dict[str, Any]] = {"cfer": {"decay": 50.0, "memory": 100_000, "replays": 600}}


def _whole(value: object) -> bool:
    return not isinstance(value, bool) and isinstance(value, Integral)


def _real(value: object) -> bool:
    return not isinstance(value, bool) and isinstance(value, Real) and math.isfinite(value)
