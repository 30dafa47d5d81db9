"""Which product states can be reached, and when: over all policies, or under one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stltool.automata import UNDECIDED
from stltool.policy import Policy
from stltool.product import Product
from stltool.sizes import Numbers, integer_type


def first_steps(product: Product) -> Numbers:
    """(S, Q): the first step at which (s, q) can be entered, or horizon + 1 where it cannot within the horizon.

    Whatever follows (s, q) in one step has a first step at most one later, so {first ≤ t} is closed under a step.
    """
    model, delta = product.model, product.automaton.delta
    first: Numbers = np.full(product.shape, product.horizon + 1, dtype=integer_type(product.horizon + 1))
    s = np.flatnonzero(model.initial)
    q = delta[product.letter[s], product.automaton.initial]
    state_start = model.row_start[model.choice_start]  # a state's transitions, all choices together
    for t in range(product.horizon + 1):
        first[s, q] = t
        if t == product.horizon or not s.size:
            break
        target, after = _successors(product, state_start[s], state_start[s + 1], q)
        new = first[target, after] > product.horizon
        codes = np.unique(target[new].astype(np.int64) * delta.shape[1] + after[new])
        s, q = np.divmod(codes, delta.shape[1])
    return first


def policy_layers(product: Product, policy: Policy) -> list[NDArray[np.uint8]]:
    """For each step 0 … h−1 the undecided pairs (s, q) that the policy can be in, packed bit by bit.

    Where the policy says nothing its runs end.
    """
    model, automaton = product.model, product.automaton
    now = np.zeros(product.shape, dtype=np.bool_)
    s = np.flatnonzero(model.initial)
    now[s, automaton.delta[product.letter[s], automaton.initial]] = True
    layers = []
    for t in range(product.horizon):
        now[:, automaton.verdicts(t) != UNDECIDED] = False
        layers.append(np.packbits(now))
        s, q = np.nonzero(now)
        table = policy.row(t)[s, q]
        if policy.deterministic:
            choice, q = (model.choice_start[s] + table)[table >= 0], q[table >= 0]
        else:
            which, number = np.nonzero(table)
            choice, q = model.choice_start[s[which]] + number, q[which]
        target, after = _successors(product, model.row_start[choice], model.row_start[choice + 1], q)
        now = np.zeros(product.shape, dtype=np.bool_)
        now[target, after] = True
    return layers


def _successors(
    product: Product, start: NDArray[np.int64], end: NDArray[np.int64], q: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """(s', q') over the transitions start[i] … end[i] − 1, each taken from memory q[i]."""
    length = end - start
    offset = np.arange(length.sum()) - np.repeat(np.cumsum(length) - length, length)
    target = product.model.target[np.repeat(start, length) + offset]
    return target, product.automaton.delta[product.letter[target], np.repeat(q, length)]
