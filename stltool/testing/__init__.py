"""Property-based tests of what is specified in STL: strategies for Hypothesis, and assertions (docs/testing.md).

formulas      formulas, of any shape or of a fragment          models     MDPs, with intervals too, and policies
traces        traces, satisfying ones, violating ones          tasks      texts of task files
assertions    what a trace, a policy and two formulas keep     printing   failures as code that reproduces them
constructive, regions    how traces with a verdict are built: the automaton, and exact values of the signals
recorder      running programs as traces that are judged, also Gymnasium's environments (environments)
machines      rule-based machines of Hypothesis with a formula as invariant
sampled       tests of probabilities of randomised programs, on as few runs as possible
coverage      how much the traces that were judged say about a formula
falsification inputs under which a system violates a formula
"""

from stltool.monitoring.coverage import Coverage, PartCoverage
from stltool.testing import printing
from stltool.testing.assertions import (
    FormulasDiffer,
    ProbabilityViolation,
    StlAssertionError,
    TraceViolation,
    assert_equivalent,
    assert_probability,
    assert_refines,
    assert_trace,
)
from stltool.testing.coverage import CoverageGap, assert_covered, collect_coverage
from stltool.testing.falsification import Falsification, Replay, Signal, falsify, input_signals, replay, steer
from stltool.testing.formulas import flag_formulas, formulas, predicates
from stltool.testing.machines import StlStateMachine
from stltool.testing.models import interval_mdps, mdps, policies
from stltool.testing.recorder import Recorder, recorded, recorded_env
from stltool.testing.sampled import SampledViolation, SamplingPlan, assert_probability_sampled, sampling_plan
from stltool.testing.tasks import expectations, task_files
from stltool.testing.trace import Trace
from stltool.testing.traces import satisfying_traces, traces, violating_traces

__all__ = [
    "Coverage",
    "CoverageGap",
    "Falsification",
    "FormulasDiffer",
    "PartCoverage",
    "ProbabilityViolation",
    "Recorder",
    "Replay",
    "SampledViolation",
    "SamplingPlan",
    "Signal",
    "StlAssertionError",
    "StlStateMachine",
    "Trace",
    "TraceViolation",
    "assert_covered",
    "assert_equivalent",
    "assert_probability",
    "assert_probability_sampled",
    "assert_refines",
    "assert_trace",
    "collect_coverage",
    "expectations",
    "falsify",
    "flag_formulas",
    "formulas",
    "input_signals",
    "interval_mdps",
    "mdps",
    "policies",
    "predicates",
    "recorded",
    "recorded_env",
    "replay",
    "sampling_plan",
    "satisfying_traces",
    "steer",
    "task_files",
    "traces",
    "violating_traces",
]

printing.register()
