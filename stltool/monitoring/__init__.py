"""Monitoring of recorded traces: the verdicts of the slow semantics, at every step of whole batches, fast.

logs/      a trace file → signals, with a sample per step   samples    arrays → traces, checked as they are read
program    a formula → instructions                     comparisons  predicates over arrays, decided exactly
blocks     the instructions over blocks of traces       offline    verdicts and robustness at every decided step
online     running traces: early verdicts               early      how soon a verdict is certain: automaton, structure
searched   ... where neither of them is exact           tied       ... where values of earlier samples matter
stream     their state, as arrays for the kernels       intervals  the robustness that a step can still have
smooth     log-sum-exp robustness with its enclosure    states     truth at the states of a model
"""

from stltool.monitoring.decisions import Decision, Decisions
from stltool.monitoring.logs import Recording, load_trace, trace_readers
from stltool.monitoring.offline import MonitorResult, monitor
from stltool.monitoring.online import OnlineMonitor
from stltool.monitoring.smooth import SmoothRobustness, smooth_robustness

__all__ = [
    "Decision", "Decisions", "MonitorResult", "OnlineMonitor", "Recording", "SmoothRobustness", "load_trace", "monitor",
    "smooth_robustness", "trace_readers",
]  # fmt: skip
