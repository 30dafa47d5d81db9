"""Results → JSON, HTML, terminal. The HTML page is made from the JSON only, so it can be rebuilt."""

from stltool.reporting.curves import write_history
from stltool.reporting.data import check_data, estimate_data, product_data, report_data, stationary_data, training_data
from stltool.reporting.explanation import explain
from stltool.reporting.guarantees import guarantee_data, guarantee_rows
from stltool.reporting.monitoring import monitor_data, write_monitor_picture
from stltool.reporting.page import load_report, render, report, write_report
from stltool.reporting.runs import likely_data, sensitivity_data
from stltool.reporting.story import encoding_data, encoding_rows, surrogate_data, surrogate_rows
from stltool.reporting.sweeps import sweep_data, write_sweep
from stltool.reporting.tradeoffs import front_data, tradeoff_data, write_front_picture

__all__ = [
    "check_data", "encoding_data", "encoding_rows", "estimate_data", "explain", "front_data", "guarantee_data",
    "guarantee_rows", "likely_data", "load_report", "monitor_data", "product_data", "render", "report", "report_data",
    "sensitivity_data", "stationary_data", "surrogate_data", "surrogate_rows", "sweep_data", "tradeoff_data",
    "training_data", "write_front_picture", "write_history", "write_monitor_picture", "write_report", "write_sweep",
]  # fmt: skip
