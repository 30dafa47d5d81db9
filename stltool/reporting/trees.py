"""A policy's decision tree as JSON-compatible data, and its curve as a picture."""

from __future__ import annotations

from pathlib import Path

from stltool.checking import PolicyTree
from stltool.files import write_result
from stltool.reporting.data import product_data
from stltool.reporting.records import TreeOutput
from stltool.reporting.tradeoffs import require_picture


def tree_data(found: PolicyTree) -> TreeOutput:
    """Everything in a tree, as JSON-compatible data."""
    return {
        **product_data(found.product),
        "given": found.given.probability,
        "price": found.price,
        "probability": found.check.probability,
        "lower": found.check.lower,
        "upper": found.check.upper,
        "met": found.met,
        "leaves": found.leaves,
        "rules": found.rules.splitlines(),
        "legend": list(found.legend),
        "memory": {name: list(phrases) for name, phrases in found.memory.items()},
        "tree": found.root.data(),
        "curve": [{"leaves": leaves, "probability": probability} for leaves, probability in found.curve],
    }


def write_tree_picture(found: PolicyTree, path: str | Path) -> None:
    """Write P over the number of leaves as a picture, whole or not at all."""
    from stltool.reporting.figures import leaves_curve

    require_picture(path)
    write_result(path, leaves_curve(tree_data(found), Path(path).suffix.lower()[1:]), "picture")
