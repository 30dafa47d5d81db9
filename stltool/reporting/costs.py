"""Expected costs as data."""

from __future__ import annotations

from collections.abc import Sequence

from stltool.checking import CostDistribution, ExpectedCost
from stltool.numbers import fraction_text, number_text
from stltool.reporting.records import CostDistributionOutput, CostsOutput


def costs_data(found: Sequence[ExpectedCost]) -> CostsOutput:
    """Values of one cost on one product."""
    product = found[0].product
    return {
        "task": product.task_name,
        "formula": str(product.formula),
        "model": product.model.name,
        "model_digest": product.model.digest(),
        "horizon": product.horizon,
        "encoding": product.automaton.encoding,
        "cost": found[0].cost,
        "until": found[0].until,
        "expected": [
            {
                "question": one.question,
                "value": one.value,
                "lower": one.lower,
                "upper": one.upper,
                "exact": fraction_text(one.fraction) if one.fraction is not None else None,
                "seconds": one.seconds,
            }
            for one in found
        ],
    }


def cost_distribution_data(found: CostDistribution) -> CostDistributionOutput:
    """P(task and cost <= c) for every budget c."""
    product = found.product
    return {
        "task": product.task_name,
        "formula": str(product.formula),
        "model": product.model.name,
        "model_digest": product.model.digest(),
        "horizon": product.horizon,
        "encoding": product.automaton.encoding,
        "cost": found.cost,
        "question": found.question,
        "nature": found.nature,
        "within": number_text(found.at_most),
        "budgets": [number_text(budget) for budget in found.budgets],
        "lower": found.lower.tolist(),
        "upper": found.upper.tolist(),
        "exact": [fraction_text(value) for value in found.fractions] if found.fractions is not None else None,
        "seconds": found.seconds,
    }
