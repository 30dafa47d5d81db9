"""Falsification: inputs under which a system violates a formula, found on few executions.

run       the budgeted search and its result       search      which inputs are executed next: a portfolio
inputs    signals and numbers as a unit cube       candidates  points that are worth a try, and variations
score     how near a trace is to a violation       strict      how near in time
tried     the executions so far, what they exclude  surface, dynamics   learned from them
methods   other optimisers: scipy, cma, optuna     replay      the most probable violation of a model, on a black box
steering  robustness as a target of Hypothesis
"""

from stltool.testing.falsification.inputs import Signal
from stltool.testing.falsification.replay import Replay, replay
from stltool.testing.falsification.run import Falsification, falsify
from stltool.testing.falsification.steering import input_signals, steer

__all__ = ["Falsification", "Replay", "Signal", "falsify", "input_signals", "replay", "steer"]
