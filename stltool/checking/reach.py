"""When a product state can first be reached, over all policies: breadth-first search, a frontier a step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stltool.product import Product


def first_steps(product: Product) -> NDArray[np.int32]:
    """(S, Q): the first step at which (s, q) can be entered, or horizon + 1 where it cannot within the horizon.

    Whatever follows (s, q) in one step has a first step at most one later, so {first ≤ t} is closed under a step.
    """
    model, delta = product.model, product.automaton.delta
    first = np.full(product.shape, product.horizon + 1, dtype=np.int32)
    s = np.flatnonzero(model.initial)
    q = delta[product.letter[s], product.automaton.initial]
    state_start = model.row_start[model.choice_start]  # a state's transitions, all choices together
    for t in range(product.horizon + 1):
        first[s, q] = t
        if t == product.horizon or not s.size:
            break
        length = state_start[s + 1] - state_start[s]
        offset = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
        target = model.target[np.repeat(state_start[s], length) + offset]
        after = delta[product.letter[target], np.repeat(q, length)]
        new = first[target, after] > product.horizon
        codes = np.unique(target[new].astype(np.int64) * delta.shape[1] + after[new])
        s, q = np.divmod(codes, delta.shape[1])
    return first
