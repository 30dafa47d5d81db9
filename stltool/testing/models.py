"""Strategies for MDPs, with points or intervals as probabilities, and for policies."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from stltool.arguments import require
from stltool.models import MDP
from stltool.policy import Policy
from stltool.product import Product
from stltool.testing.names import LABELS, SIGNALS, VALUES, below, many

_MOST_DRAWN = 400  # entries of a policy that are drawn one by one


@st.composite
def mdps(
    draw: st.DrawFn,
    states: int = 3,
    actions: int = 2,
    labels: Sequence[str] = LABELS,
    signals: Sequence[str] = SIGNALS,
    single_start: bool = False,
    exact: bool = False,
) -> MDP:
    """A small MDP: at most so many states and actions, some of which are not available in some states.

    Probabilities are over sixteenths, which doubles hold; with `exact`, fractions over 3, 7, 10 or 16, given exactly.
    """
    n_states = draw(st.integers(1, states))
    n_actions = draw(st.integers(1, actions))
    transitions = np.zeros((n_actions, n_states, n_states), dtype=object if exact else np.float64)
    for s in range(n_states):
        always = draw(st.integers(0, n_actions - 1))
        for a in range(n_actions):
            if a == always or draw(st.booleans()):
                transitions[a, s] = draw(_distributions(n_states, exact))
    return MDP.from_arrays(
        transitions,
        {name: draw(many(VALUES, n_states)) for name in signals},
        initial=draw(st.integers(0, n_states - 1)) if single_start else draw(_distributions(n_states, exact)),
        labels={name: draw(many((False, True), n_states)) for name in labels},
        action_names=[f"act{a}" for a in range(n_actions)],
    )


@st.composite
def interval_mdps(draw: st.DrawFn, /, **options: Any) -> MDP:
    """A small MDP with intervals over sixteenths; `options` as in `mdps`, except `exact`.

    Every row contains a distribution as in `mdps`, with ends up to 1/4 away; entries that were 0 may become possible,
    and lower ends may be 0.
    """
    model = draw(mdps(**options))
    n_actions, n_states = model.n_actions, model.n_states
    lower, upper = (np.zeros((n_actions, n_states, n_states)) for _ in range(2))
    steps = many(tuple(range(5)), n_states).map(lambda ns: np.array(ns) / 16)
    rows = model.matrix().toarray()
    for s in range(n_states):
        for c in range(model.choice_start[s], model.choice_start[s + 1]):
            lower[model.choice_action[c], s] = np.maximum(rows[c] - draw(steps), 0)
            upper[model.choice_action[c], s] = np.minimum(rows[c] + draw(steps), 1)
    return MDP.from_intervals(lower, upper, model.signals, model.initial, model.labels, action_names=model.action_names)


@functools.cache
@st.composite
def _distributions(draw: st.DrawFn, n: int, exact: bool) -> NDArray[Any]:
    whole = draw(st.sampled_from((3, 7, 10, 16))) if exact else 16
    cuts = sorted(draw(many(tuple(range(whole + 1)), n - 1)))
    counts = np.diff([0, *cuts, whole])
    return np.array([Fraction(int(k), whole) for k in counts], dtype=object) if exact else counts / whole


@st.composite
def policies(draw: st.DrawFn, product: Product, mixed: bool = True) -> Policy:
    """A policy for a product: stationary or with a clock, deterministic or, if `mixed`, with weights over sixteenths.

    It is defined everywhere. Tables of over 400 entries are filled from a seed that is drawn, and shrink as a whole.
    """
    require(product, Product, "policies' product")
    model, (n_states, n_memory) = product.model, product.shape
    n_choices = np.diff(model.choice_start)
    clock = product.horizon > 0 and draw(st.booleans())
    shape = (*([product.horizon] if clock else []), n_states, n_memory)
    weighted = mixed and draw(st.booleans())
    available = np.broadcast_to(n_choices[:, None], shape)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1))) if available.size > _MOST_DRAWN else None

    def one(n: int) -> int:
        return int(rng.integers(n)) if rng is not None else draw(below(n)) if n > 1 else 0

    if not weighted:
        table = np.array([one(n) for n in available.ravel().tolist()], dtype=np.int64).reshape(shape)
        return Policy(product, table)
    weights = np.zeros((available.size, model.most_choices))
    for row, n in zip(weights, available.ravel().tolist(), strict=True):
        cuts = sorted(one(17) for _ in range(n - 1))
        row[:n] = np.diff([0, *cuts, 16]) / 16
    return Policy(product, weights.reshape(*shape, model.most_choices))
