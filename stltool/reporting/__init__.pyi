"""Results → JSON, HTML, terminal. The HTML page is made from the JSON alone, so it can be made again."""

from .answers import frontier_report, parametric_report, robustness_report, write_answer_picture
from .costs import cost_distribution_data, costs_data
from .curves import write_history
from .data import (
    check_data,
    counterfactual_data,
    estimate_data,
    markov_data,
    product_data,
    report_data,
    stationary_data,
    training_data,
    transfer_data,
)
from .explanation import explain
from .frontiers import frontier_data
from .guarantees import guarantee_data, guarantee_rows, looser_note, refused_data
from .long_runs import long_run_data
from .margins import robustness_data, timing_data
from .monitoring import monitor_data, write_monitor_picture
from .page import load_report, render, report, require_report, write_report
from .pages import estimate_report, front_report, monitor_report
from .parametrics import parametric_data
from .runs import likely_data, sensitivity_data
from .story import encoding_data, encoding_rows, surrogate_data, surrogate_rows
from .sweeps import sweep_data, write_sweep
from .tradeoffs import front_data, shield_data, tradeoff_data, write_front_picture
from .verification import junit_text, markdown_text, verification_data

__all__ = [
    "check_data", "cost_distribution_data", "costs_data", "counterfactual_data", "encoding_data", "encoding_rows",
    "estimate_data", "estimate_report", "explain", "front_data", "front_report", "frontier_data", "frontier_report",
    "guarantee_data", "guarantee_rows", "junit_text", "likely_data", "load_report", "long_run_data", "looser_note",
    "markdown_text", "markov_data", "monitor_data", "monitor_report", "parametric_data", "parametric_report",
    "product_data", "refused_data", "render", "report", "report_data", "require_report", "robustness_data",
    "robustness_report", "sensitivity_data", "shield_data", "stationary_data", "surrogate_data", "surrogate_rows",
    "sweep_data", "timing_data", "tradeoff_data", "training_data", "transfer_data", "verification_data",
    "write_answer_picture", "write_front_picture", "write_history", "write_monitor_picture", "write_report",
    "write_sweep",
]  # fmt: skip
