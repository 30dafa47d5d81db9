"""Hypothesis strategies for formulas, traces and MDPs, for your own property tests."""

from stltool.testing.strategies import flag_formulas, formulas, interval_models, models, predicates, traces

__all__ = ["flag_formulas", "formulas", "interval_models", "models", "predicates", "traces"]
