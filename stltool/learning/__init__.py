"""Policies learned without the model: one learner a file; what they share is one schedule, replay and trainer."""

from stltool.learning.guarantee import Guarantee, guarantee
from stltool.learning.learn import METHODS, Training, learn
from stltool.learning.settings import Settings
from stltool.learning.sweep import Sweep, SweepResult, run_sweep
from stltool.learning.sweep_file import load_sweep

__all__ = [
    "METHODS", "Guarantee", "Settings", "Sweep", "SweepResult", "Training", "guarantee", "learn", "load_sweep",
    "run_sweep",
]  # fmt: skip
