"""The undecided situations that runs can come to: a forward search over the product.

A *node* is an undecided (t, s, q): state s was just read at step t, the automaton is then in q. The nodes of a step are
listed by their codes s·|Q| + q, ascending.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata import UNDECIDED
from stltool.choices import Form
from stltool.models.rows import spans
from stltool.product import JointProduct, Product

I64: TypeAlias = NDArray[np.int64]

MOST_NODES, MOST_EDGES = 400_000, 6_000_000  # a second to compute, in a page as well as here


def reachable(
    product: Product | JointProduct, most_nodes: int = MOST_NODES, most_edges: int = MOST_EDGES
) -> list[I64] | None:
    """For t = 0 … h − 1 the codes of the nodes that some policy reaches.

    None if there are more than `most_nodes`, or they have more than `most_edges` outgoing transitions. In a black box,
    any state may follow.
    """
    if product.model.blackbox is not None:
        return _anywhere(product, most_nodes)
    model, automaton = product.model, product.automaton
    here = entered(product, np.flatnonzero(model.initial), automaton.initial)
    found: list[I64] = []
    n_nodes = n_edges = 0
    for t in range(product.horizon):
        here = here[undecided(product, t, here % automaton.n_states)]
        s, q = np.divmod(here, automaton.n_states)
        entry, count = transitions(product, s)
        n_nodes, n_edges = n_nodes + len(here), n_edges + len(entry)
        if n_nodes > most_nodes or n_edges > most_edges:
            return None
        found.append(here)
        possible = possible_entries(product)[entry]
        here = entered(product, model.target[entry][possible], np.repeat(q, count)[possible])
    return found


def reached_by(
    product: Product | JointProduct,
    form: Form,
    most_nodes: int = MOST_NODES,
    most_edges: int = MOST_EDGES,
    *,
    start: tuple[int, I64] | None = None,
) -> list[I64] | None:
    """As `reachable`, under one policy; from all initial states, or from `start`: a step, and the codes there.

    Runs end where the policy defines no action.
    """
    automaton = product.automaton
    first, here = start or (0, entered(product, np.flatnonzero(product.model.initial), automaton.initial))
    found: list[I64] = []
    n_nodes = n_edges = 0
    for t in range(first, product.horizon):
        here = here[undecided(product, t, here % automaton.n_states)]
        s, q = np.divmod(here, automaton.n_states)
        n_nodes, n_edges = n_nodes + len(here), n_edges + int(transitions(product, s)[1].sum())
        if n_nodes > most_nodes or n_edges > most_edges:
            return None
        found.append(here)
        taken = form.at(t, s, q) if len(s) else np.empty(0, dtype=np.int64)
        here = followed(product, s, q, taken)
    return found


def followed(product: Product | JointProduct, s: I64, q: I64, taken: NDArray[Any]) -> I64:
    """The codes that the choices (n,) or weights (n, C) taken in these pairs lead to."""
    model = product.model
    owner, i = (np.flatnonzero(taken >= 0), taken[taken >= 0]) if taken.ndim == 1 else np.nonzero(taken > 0)
    c = model.choice_start[s[owner]] + i.astype(np.int64)
    first, end = model.row_start[c], model.row_start[c + 1]
    entry = spans(first, end)
    possible = possible_entries(product)[entry]
    return entered(product, model.target[entry][possible], np.repeat(q[owner], end - first)[possible])


def undecided(product: Product | JointProduct, t: int, q: I64) -> NDArray[np.bool_]:
    """Whether the verdict, of a joint product that of some task, is open in automaton states q (n,) after step t."""
    open_: NDArray[np.bool_]
    if isinstance(product, JointProduct):
        automaton = product.automaton
        open_ = ~automaton.layers[t].decided[q - automaton.offsets[t]]
    else:
        open_ = product.automaton.verdicts(t)[q] == UNDECIDED
    return open_


def possible_entries(product: Product | JointProduct) -> NDArray[np.bool_]:
    """Which transitions can happen; of intervals, whatever nature picks inside them."""
    intervals = product.model.intervals
    above: NDArray[np.bool_] = (product.model.probability if intervals is None else intervals.upper) > 0
    return above


def transitions(product: Product | JointProduct, s: I64) -> tuple[I64, I64]:
    """The transitions of all choices of states s (n,), one state after another, and how many each has (n,)."""
    edges = product.model.row_start[product.model.choice_start]
    return spans(edges[s], edges[s + 1]), edges[s + 1] - edges[s]


def entered(product: Product | JointProduct, s: NDArray[Any], q: NDArray[Any] | int) -> I64:
    """The codes of the pairs after reading states s (n,) in automaton states q."""
    codes: I64 = np.unique(read(product, s, q))
    return codes


def read(product: Product | JointProduct, s: NDArray[Any], q: NDArray[Any] | int) -> I64:
    """The code of each pair after reading s in q."""
    automaton = product.automaton
    codes: I64 = s.astype(np.int64) * automaton.n_states + automaton.delta[product.letter[s], q]
    return codes


def _anywhere(product: Product | JointProduct, most_nodes: int) -> list[I64] | None:
    """The nodes if any state may follow any other."""
    states, automaton = np.arange(product.model.n_states), product.automaton
    memories: I64 = np.array([automaton.initial], dtype=np.int64)
    found: list[I64] = []
    n_nodes = 0
    for t in range(product.horizon):
        n_nodes += len(states) * len(memories)
        if n_nodes > most_nodes:
            return None
        here = entered(product, np.repeat(states, len(memories)), np.tile(memories, len(states)))
        here = here[undecided(product, t, here % automaton.n_states)]
        found.append(here)
        memories = np.unique(here % automaton.n_states)
    return found
