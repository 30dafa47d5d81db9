"""The part of the layered product (t, s, q) that a policy reaches: an acyclic graph, told layer by layer.

    layer 0      {(s, δ(L(s), q₀)) : ι(s) > 0}
    layer t + 1  {(s', δ(L(s'), q)) : (s,q) undecided in layer t, π_t(c|s,q) > 0, p(s'|c) > 0}

A node whose verdict has fallen has no edges. Layers are kept, 8 bytes a node; edges are made again whenever a pass asks
for them, since making them costs a few gathers and keeping them about fifty bytes each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stltool.automata import UNDECIDED
from stltool.checking.backward import Floats, Progress
from stltool.checking.check import undefined
from stltool.policy import Policy
from stltool.product import Product
from stltool.sizes import memory_limit, require_memory, require_time

Indices = NDArray[np.int64]

_RATE = 1e7  # edges a second, roughly
_EDGE_BYTES, _LAYER_BYTES = 100, 500  # while a layer's edges are made; of an empty layer


@dataclass(frozen=True, eq=False)
class Edges:
    """Edges from one layer to the next, ordered by their source; n edges, of m sources.

    start    (m,) where each source's edges begin
    source   (n,) position in the layer            child  (n,) position in the next one
    choice   (n,) the model's choice               entry  (n,) index into the model's target and probability
    weight   (n,) the policy's probability of the choice: 1 where it is deterministic
    """

    start: Indices
    source: Indices
    child: Indices
    choice: Indices
    entry: Indices
    weight: Floats


class Unfolding:
    """The layers that `policy` reaches on `product`; the last one has only decided nodes.

    start    probabilities of layer 0's nodes
    layers   one array a step: indices s·|Q| + q of product states, ascending
    bytes    what the layers take, at 24 bytes a node: the index and two numbers that passes keep

    Raises PolicyError, naming the places, where the policy says nothing about a node it reaches; SizeError before
    taking memory over the limit (default: four fifths of what is free).
    """

    def __init__(
        self, product: Product, policy: Policy, limit: int | None = None, progress: Progress | None = None
    ) -> None:
        product.model.require_points()
        require_time(
            product.horizon * product.model.n_transitions * product.automaton.n_states,
            _RATE,
            f"unfolding {product.n_states} product states over {product.horizon} steps",
            "shorten the windows",
        )
        self.product, self.policy = product, policy
        self._limit = memory_limit(limit)
        model, automaton = product.model, product.automaton
        first = np.flatnonzero(model.initial)
        self.start = model.initial[first]
        self.layers = [first * automaton.n_states + automaton.delta[product.letter[first], automaton.initial]]
        self.bytes = 0
        for t in range(product.horizon):
            self.bytes += 24 * len(self.layers[-1]) + _LAYER_BYTES
            nodes = self.undecided(t)
            if policy.deterministic and (policy.row(t)[self._split(t, nodes)] < 0).any():
                raise undefined(product, policy)
            reached = np.zeros(product.n_states, dtype=np.bool_)
            reached[self._expand(t, nodes)[-1]] = True
            self.layers.append(np.flatnonzero(reached))
            if progress is not None:
                progress(t + 1, product.horizon)
            if not len(self.undecided(t + 1)):
                break

    def verdicts(self, t: int) -> NDArray[np.int8]:
        """The verdict of every node of layer t."""
        found: NDArray[np.int8] = self.product.automaton.verdicts(t)[self.layers[t] % self.product.automaton.n_states]
        return found

    def undecided(self, t: int) -> Indices:
        """Positions in layer t of the nodes that have edges."""
        return np.flatnonzero(self.verdicts(t) == UNDECIDED)

    def probabilities(self, verdict: int) -> list[Floats]:
        """The probability of that verdict from every node, layer by layer: backward induction on what is reached."""
        probability = self.product.model.probability
        values: list[Floats] = []
        for t in range(len(self.layers) - 1, -1, -1):
            here = (self.verdicts(t) == verdict).astype(np.float64)
            nodes = self.undecided(t)
            if len(nodes):
                edges = self.edges(t)
                share = edges.weight * probability[edges.entry] * values[-1][edges.child]
                here[nodes] = np.add.reduceat(share, edges.start)
            values.append(here)
        return values[::-1]

    def edges(self, t: int, nodes: Indices | None = None) -> Edges:
        """The edges from layer t to layer t + 1: of the nodes at these positions, undecided all, or of every one."""
        if nodes is None:
            nodes = self.undecided(t)
        pick, choice, entry, weight, index = self._expand(t, nodes)
        child = np.searchsorted(self.layers[t + 1], index)
        start = np.searchsorted(pick, np.arange(len(nodes)))
        return Edges(start, nodes[pick], child, choice, entry, weight)

    def _split(self, t: int, nodes: Indices) -> tuple[Indices, Indices]:
        s, q = np.divmod(self.layers[t][nodes], self.product.automaton.n_states)
        return s, q

    def _expand(self, t: int, nodes: Indices) -> tuple[Indices, Indices, Indices, Floats, Indices]:
        """For every edge: which of `nodes` it leaves, choice, entry, weight, and the product state it leads to."""
        model, automaton = self.product.model, self.product.automaton
        s, q = self._split(t, nodes)
        table = self.policy.row(t)[s, q]
        if self.policy.deterministic:
            pick, i = np.arange(len(nodes)), table.astype(np.int64)
            weight = np.ones(len(nodes))
        else:
            pick, i = np.nonzero(table)
            weight = table[pick, i]
        choice = model.choice_start[s[pick]] + i
        length = model.row_start[choice + 1] - model.row_start[choice]
        n_edges = int(length.sum())
        require_memory(
            self.bytes + _EDGE_BYTES * n_edges + self.product.n_states,
            f"unfolding {sum(map(len, self.layers))} nodes of {t + 1} steps, {n_edges} edges in the last",
            "shorten the windows, or coarsen the grid or the time step",
            self._limit,
        )
        which = np.repeat(np.arange(len(choice)), length)
        entry = np.arange(n_edges) + (model.row_start[choice] - np.cumsum(length) + length)[which]
        target = model.target[entry]
        index = (
            target.astype(np.int64) * automaton.n_states + automaton.delta[self.product.letter[target], q[pick[which]]]
        )
        return pick[which], choice[which], entry, weight[which], index
