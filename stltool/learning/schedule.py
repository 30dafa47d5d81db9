"""Exploration: ε = ε_end + (ε_start − ε_end)·exp(−episode / n_d) [Wang24, §V-B], its sign mended."""

from __future__ import annotations

import math

from stltool.learning.settings import Settings


def epsilon(settings: Settings, episode: int) -> float:
    """The chance of a random action in this episode (counted from 0)."""
    span = settings.epsilon_start - settings.epsilon_end
    return settings.epsilon_end + span * math.exp(-episode / settings.decay)
