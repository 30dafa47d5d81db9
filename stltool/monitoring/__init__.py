"""Monitoring of recorded traces: the verdicts of the slow semantics, at every step of whole batches, fast.

files      a trace file → signals                       samples    arrays → traces, checked as they are read
program    a formula → instructions                     comparisons  predicates over arrays, decided exactly
blocks     the instructions over blocks of traces       offline    verdicts and robustness at every decided step
online     the same, sample by sample                   smooth     log-sum-exp robustness with its enclosure
states     truth at the states of a model
"""

from stltool.monitoring.files import load_trace
from stltool.monitoring.offline import MonitorResult, monitor
from stltool.monitoring.online import Decision, OnlineMonitor
from stltool.monitoring.smooth import SmoothRobustness, smooth_robustness

__all__ = [
    "Decision", "MonitorResult", "OnlineMonitor", "SmoothRobustness", "load_trace", "monitor", "smooth_robustness",
]  # fmt: skip
