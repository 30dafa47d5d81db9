"""P as a function of a parameter, as plain data."""

from __future__ import annotations

from stltool.checking import ParametricResult
from stltool.reporting.records import ParametricRecord


def parametric_data(found: ParametricResult) -> ParametricRecord:
    """The result, flat; `pieces` are polynomials in Bernstein's basis on [from, to], `points` are values."""
    product = found.product
    return {
        "task": product.task_name,
        "formula": str(product.formula),
        "model": product.model.name,
        "model_digest": product.model.digest(),
        "horizon": product.horizon,
        "encoding": product.automaton.encoding,
        "question": found.question,
        "parameter": found.parameter.name,
        "from": float(found.parameter.lower),
        "to": float(found.parameter.upper),
        "least": list(found.least),
        "greatest": list(found.greatest),
        "gap": found.gap,
        "tolerance": found.tolerance,
        "status": found.status,
        "points": [{"value": float(p), "lower": lower, "upper": upper} for p, lower, upper in found.points()],
        "pieces": [
            {
                "from": float(piece.lower),
                "to": float(piece.upper),
                "lower": piece.below.tolist(),
                "upper": piece.above.tolist(),
                "optimal": piece.optimal,
            }
            for piece in found.pieces
        ],
        "seconds": found.seconds,
    }
