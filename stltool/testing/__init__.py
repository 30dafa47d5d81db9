"""Hypothesis strategies for formulas, expectations, traces and MDPs, for your own property tests."""

from stltool.testing.strategies import (
    expectations,
    flag_formulas,
    formulas,
    interval_models,
    models,
    predicates,
    traces,
)

__all__ = ["expectations", "flag_formulas", "formulas", "interval_models", "models", "predicates", "traces"]
