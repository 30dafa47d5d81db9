"""Exploration: ε = ε_end + (ε_start − ε_end)·exp(−episode / n_d) [Wang24, §V-B], with its sign corrected."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stltool.learning.settings import setting


@dataclass(frozen=True, kw_only=True)
class Decaying:
    """The settings of a method whose exploration probability decays from episode to episode."""

    decay: float = setting(400.0, "n_d of the exploration probability end + (start − end)·exp(−episode / n_d)", above=0)
    epsilon_start: float = setting(0.99, "exploration probability in the first episode", least=0, most=1)
    epsilon_end: float = setting(0.01, "exploration probability in the long run", least=0, most=1)

    def epsilon(self, episode: int) -> float:
        """The exploration probability in this episode (counted from 0)."""
        span = self.epsilon_start - self.epsilon_end
        return self.epsilon_end + span * math.exp(-episode / self.decay)
