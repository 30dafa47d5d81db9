"""Trade-offs, fronts and shields as plain data, and a front as a picture: .svg or .png, by the file extension."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stltool.checking import Front, Shield, Tradeoff
from stltool.checking.weighted import Figure
from stltool.errors import SettingsError
from stltool.files import require_result, write_result
from stltool.product import JointProduct
from stltool.reporting.data import product_data
from stltool.reporting.records import FigureRecord, FrontRecord, JointRecord, ShieldRecord, TradeoffRecord

_PICTURES = (".svg", ".png")


def joint_data(joint: JointProduct) -> JointRecord:
    """The tasks and the sizes."""
    return {
        "tasks": {task.task_name: str(task.formula) for task in joint.tasks},
        "model": joint.model.name,
        "model_digest": joint.model.digest(),
        "horizon": joint.horizon,
        "encoding": joint.automaton.encoding,
        "states": joint.model.n_states,
        "automaton_states": {task.task_name: task.automaton.n_states for task in joint.tasks},
        "joint_states": joint.automaton.n_states,
    }


def tradeoff_data(result: Tradeoff) -> TradeoffRecord:
    """A trade-off, flat; figures are {value, lower, upper}."""
    return {
        **joint_data(result.joint),
        "objective": result.objective,
        "at_least": {name: float(bound) for name, bound in result.at_least.items()},
        "budget": {name: float(bound) for name, bound in result.budget.items()},
        "probabilities": {name: _figure(figure) for name, figure in result.probabilities.items()},
        "costs": {name: _figure(figure) for name, figure in result.costs.items()},
        "bound": result.bound,
        "gap": result.gap,
        "multipliers": dict(result.multipliers),
        "policy": result.policy.kind if result.policy is not None else None,
        "randomised": result.randomised,
        "size": dict(result.size),
        "status": result.status,
        "seconds": result.seconds,
    }


def front_data(front: Front) -> FrontRecord:
    """A front: its corners in order, and the lines that no policy crosses."""
    names = front.joint.names
    return {
        **joint_data(front.joint),
        "corners": [
            {
                "probabilities": {
                    name: _figure(figure) for name, figure in zip(names, corner.probabilities, strict=True)
                },
                "weights": dict(zip(names, corner.weights, strict=True)),
                "bound": corner.bound,
            }
            for corner in front.corners
        ],
        "lines": [{"weights": [w1, w2], "bound": bound} for w1, w2, bound in front.lines],
        "gap": front.gap,
        "inductions": front.inductions,
        "status": front.status,
        "seconds": front.seconds,
    }


def shield_data(shield: Shield) -> ShieldRecord:
    """A shield, without its mask."""
    return {
        **product_data(shield.product),
        "at_least": float(shield.at_least),
        "rule": shield.rule,
        "levels": shield.levels,
        "least": _figure(shield.least),
        "uniform": shield.uniform,
        "share": shield.share,
    }


def _figure(figure: Figure) -> FigureRecord:
    return {"value": figure.value, "lower": figure.lower, "upper": figure.upper}


def require_picture(path: str | Path, endings: Sequence[str] = _PICTURES) -> None:
    """Raise an error, before the work, if the picture could not be written after it."""
    path = Path(path)
    if path.suffix.lower() not in endings:
        named = f"{', '.join(endings[:-1])} or {endings[-1]}"
        raise SettingsError(f"{path}: pictures are written as {named}; use one of these extensions")
    require_result(path, "picture")


def write_front_picture(front: Front, path: str | Path) -> None:
    """Write the front as a picture, whole or not at all."""
    from stltool.reporting.figures import pareto_front

    require_picture(path)
    write_result(path, pareto_front(front_data(front), Path(path).suffix.lower()[1:]), "picture")
