"""Expected costs as data."""

from __future__ import annotations

from collections.abc import Sequence

from stltool.checking import ExpectedCost
from stltool.reporting.records import CostsOutput


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
                "seconds": one.seconds,
            }
            for one in found
        ],
    }
