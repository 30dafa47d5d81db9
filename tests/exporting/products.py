"""Products to export, with policies, and the probabilities that exports must have."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from hypothesis import strategies as st

import stltool as stl
from stltool import testing
from tests.conftest import FACTORY

TASKS: list[tuple[str, dict[str, str]]] = [
    ("patrolling.stl", {"T": "1", "tau": "5"}),
    ("charging.stl", {"T": "5", "tau": "3"}),
    ("shift.stl", {"T": "6", "tau": "10"}),
    ("docks.stl", {}),
]


def factory(name: str, params: dict[str, str]) -> stl.Product:
    task = stl.load_task(FACTORY / name, params)
    return stl.build_product(stl.load_model(task.model), task)


@st.composite
def products(draw: st.DrawFn) -> stl.Product:
    """Small ones, of any kind of task, whose runs may start in several states."""
    model = draw(testing.mdps(single_start=draw(st.booleans()), exact=draw(st.booleans())))
    encoding = draw(st.sampled_from(["exact", "exact", "history"]))
    formula = draw(testing.formulas(longest=3, max_leaves=6, past=encoding == "exact" and draw(st.booleans())))
    return stl.build_product(model, formula, encoding)


def mixture(product: stl.Product, seed: int, by_step: bool) -> stl.Policy:
    """A policy that mixes all actions, at every step, or at each step, in its own way."""
    rng, model = np.random.default_rng(seed), product.model
    shape = (*((product.horizon,) if by_step else ()), *product.shape, model.most_choices)
    weights = rng.integers(1, 5, shape).astype(float)
    weights *= np.arange(model.most_choices) < np.diff(model.choice_start)[:, None, None]
    return stl.Policy(product, weights / weights.sum(axis=-1, keepdims=True))


def policies(product: stl.Product) -> list[stl.Policy | None]:
    """None; the best policy; one that takes the first action always; mixtures."""
    first = stl.Policy(product, np.zeros(product.shape, dtype=np.int64))
    mixed = [mixture(product, 0, by_step) for by_step in (False, True)[: 1 + (product.horizon > 0)]]
    return [None, stl.check(product).policy, first, *mixed]


def answers(product: stl.Product, policy: stl.Policy | None) -> dict[str, Fraction]:
    """What the questions of an export must have as answers."""
    if policy is not None:
        return {"policy": stl.check(product, policy, exact=True).fraction}
    return {
        name: stl.check(product, maximize=name == "maximum", exact=True).fraction for name in ("maximum", "minimum")
    }
