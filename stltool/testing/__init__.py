"""Property-based tests of what is specified in STL: strategies for Hypothesis, and assertions (docs/testing.md).

formulas      formulas, of any shape or of a fragment          models     MDPs, with intervals too, and policies
traces        traces, satisfying ones, violating ones          tasks      texts of task files
assertions    what a trace, a policy and two formulas keep     printing   failures as code that reproduces them
constructive, regions    how traces with a verdict are built: the automaton, and exact values of the signals
"""

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
from stltool.testing.formulas import flag_formulas, formulas, predicates
from stltool.testing.models import interval_mdps, mdps, policies
from stltool.testing.tasks import expectations, task_files
from stltool.testing.trace import Trace
from stltool.testing.traces import satisfying_traces, traces, violating_traces

__all__ = [
    "FormulasDiffer",
    "ProbabilityViolation",
    "StlAssertionError",
    "Trace",
    "TraceViolation",
    "assert_equivalent",
    "assert_probability",
    "assert_refines",
    "assert_trace",
    "expectations",
    "flag_formulas",
    "formulas",
    "interval_mdps",
    "mdps",
    "policies",
    "predicates",
    "satisfying_traces",
    "task_files",
    "traces",
    "violating_traces",
]

printing.register()
