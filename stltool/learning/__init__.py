"""Policies learned without the model: one learner a file; what they share is one schedule, replay and trainer."""

from stltool.learning.guarantee import Guarantee, guarantee
from stltool.learning.learn import METHODS, Training, learn
from stltool.learning.settings import Settings

__all__ = ["METHODS", "Guarantee", "Settings", "Training", "guarantee", "learn"]
