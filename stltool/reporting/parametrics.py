"""P as a function of a parameter, as plain data."""

from __future__ import annotations

from fractions import Fraction

from stltool.checking import ParametricResult
from stltool.checking.parametric import Piece
from stltool.numbers import fraction_text
from stltool.reporting.records import ParametricRecord, PieceRecord, PointRecord


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
        "points": [_point(found, p, lower, upper) for p, lower, upper in found.points()],
        "pieces": [_piece(piece) for piece in found.pieces],
        "seconds": found.seconds,
    }


def _point(found: ParametricResult, p: Fraction, lower: float, upper: float) -> PointRecord:
    data: PointRecord = {"value": float(p), "lower": lower, "upper": upper}
    there = found.exactly_at(p) if found.exact else None
    if there is not None:
        data["fraction"] = fraction_text(there)
    return data


def _piece(piece: Piece) -> PieceRecord:
    data: PieceRecord = {
        "from": float(piece.lower),
        "to": float(piece.upper),
        "lower": piece.below.tolist(),
        "upper": piece.above.tolist(),
        "optimal": piece.optimal,
    }
    if piece.exact is not None:
        data["proved"] = piece.proved
        data["range"] = [fraction_text(piece.lower), fraction_text(piece.upper)]
        data["coefficients"] = [fraction_text(c) for c in piece.exact.coefficients]
        data["powers"] = [fraction_text(a) for a in piece.exact.powers]
    return data
