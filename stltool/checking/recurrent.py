"""A product that runs for ever, as a graph: its end components, and ways to reach a set.

An *end component* is a set of vertices with some of their choices that a policy can stay in for ever: closed, strongly
connected. Under any policy, what a run visits infinitely often is one of them with probability 1 [Alfaro97, ch. 3],
so every question about the long run is one about maximal end components, and about reaching them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata.running import satisfied_in
from stltool.models.rows import spans, starts
from stltool.policy import Policy, silence
from stltool.product import Product
from stltool.sizes import require_memory, require_numbered

I64: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]
Floats: TypeAlias = NDArray[np.float64]

_BYTES = 80  # for each entry


@dataclass(frozen=True, eq=False)
class Recurrent:
    """The pairs (s, q) that runs can reach, as vertices of a graph in CSR form, like a model's rows.

    code          (n,) s·|Q| + q of each vertex, ascending
    choice_start  (n + 1,) the choices of each vertex
    choice        (m,) the index of each within its state; 0 under a policy, which leaves one for each vertex
    row_start     (m + 1,) the successors of each choice
    child         (e,) vertices
    probability   (e,) doubles
    entry         (e,) where the exact probability is among the model's rows; negative: it is 1
    weight        (e,) of a mixture, by which it is multiplied; None: 1
    satisfied     (n,) whether the window that ends here satisfies the formula
    first, share  where runs begin, and with what probability
    """

    product: Product
    code: I64
    choice_start: I64
    choice: I64
    row_start: I64
    child: I64
    probability: Floats
    entry: I64
    weight: Floats | None
    satisfied: Bools
    first: I64
    share: Floats

    @property
    def n(self) -> int:
        return len(self.code)

    @cached_property
    def owner(self) -> I64:
        """(m,) the vertex of each choice."""
        return np.repeat(np.arange(self.n), np.diff(self.choice_start))

    @cached_property
    def row(self) -> I64:
        """(e,) the choice of each entry."""
        return np.repeat(np.arange(len(self.choice)), np.diff(self.row_start))

    def all_in(self, vertices: Bools) -> Bools:
        """(m,) whether all successors of a choice are in a set."""
        found: Bools = np.logical_and.reduceat(vertices[self.child], self.row_start[:-1])
        return found

    def exactly(self, choices: I64) -> list[list[tuple[int, Fraction]]]:
        """The successors of these choices with exact probabilities."""
        rows = self.product.model.rows
        numerator, denominator = rows.numerator, rows.denominator
        found = []
        for c in choices.tolist():
            entries = np.arange(self.row_start[c], self.row_start[c + 1])
            given = self.entry[entries].tolist()
            parts = [Fraction(int(numerator[i]), denominator) if i >= 0 else Fraction(1) for i in given]
            if self.weight is not None:
                weights = [Fraction(w) for w in self.weight[entries].tolist()]
                parts = [p * w for p, w in zip(parts, weights, strict=True)]
                total = sum(parts, Fraction(0))  # mixtures are meant in proportion to their weights
                parts = [p / total for p in parts]
            found.append(list(zip(self.child[entries].tolist(), parts, strict=True)))
        return found

    def absorbing(self, vertices: Bools) -> Recurrent:
        """The same, but runs stay in these vertices for ever."""
        kept = np.flatnonzero(~vertices[self.owner] | _firsts(self.choice_start, len(self.choice)))
        stays = vertices[self.owner[kept]]
        length = np.where(stays, 1, np.diff(self.row_start)[kept])
        entries = spans(self.row_start[kept], self.row_start[kept] + length)
        child, probability, entry = self.child[entries], self.probability[entries], self.entry[entries]
        weight = self.weight[entries] if self.weight is not None else None
        here = starts(length)
        there = here[:-1][stays]
        child[there], probability[there], entry[there] = self.owner[kept[stays]], 1.0, -1
        return replace(
            self,
            choice_start=starts(np.bincount(self.owner[kept], minlength=self.n)),
            choice=self.choice[kept],
            row_start=here,
            child=child,
            probability=probability,
            entry=entry,
            weight=weight,
        )


def _firsts(start: I64, n: int) -> Bools:
    found = np.zeros(n, dtype=np.bool_)
    found[start[:-1]] = True
    return found


def recurrent(product: Product, policy: Policy | None, memory_limit: int | None = None) -> Recurrent:
    """What runs of a running product can reach, under a stationary policy on it or any.

    Raises PolicyError where the policy defines no action, SizeError before allocating more memory than is available.
    """
    model, automaton = product.model, product.automaton
    Q = automaton.n_states
    begins = np.flatnonzero(model.initial)
    first = begins * Q + automaton.delta[product.letter[begins], automaton.initial]
    seen, parts, waiting = np.zeros(product.n_states, dtype=np.bool_), [], np.unique(first)
    seen[waiting] = True
    size = 0
    while len(waiting):
        part = _expand(product, policy, waiting)
        size += len(part.child)
        require_memory(
            _BYTES * size, f"a graph of {size} successors that runs can reach", "shorten the windows", memory_limit
        )
        parts.append(part)
        waiting = np.unique(part.child[~seen[part.child]])
        seen[waiting] = True
    code = np.flatnonzero(seen)
    require_numbered(len(code), "pairs that runs can reach", "shorten the windows")
    found = _expand(product, policy, code)
    return replace(
        found,
        child=np.searchsorted(code, found.child),
        satisfied=satisfied_in(automaton)[code % Q],
        first=np.searchsorted(code, first),
        share=model.initial[begins],
    )


def _expand(product: Product, policy: Policy | None, code: I64) -> Recurrent:
    """The choices and successors of these pairs, successors by their codes."""
    model, automaton = product.model, product.automaton
    rows, Q = model.rows, automaton.n_states
    s, q = np.divmod(code, Q)
    count = np.diff(rows.choice_start)[s]
    taken = spans(rows.choice_start[s], rows.choice_start[s + 1])  # choices, by their numbers in the model
    owner = np.repeat(np.arange(len(code)), count)
    number = taken - rows.choice_start[s][owner]
    weights = None
    if policy is not None:
        chosen = policy.form.at(0, s, q)
        silent = (chosen < 0) if chosen.ndim == 1 else (chosen < 0).any(axis=1) | (chosen.sum(axis=1) == 0)
        if silent.any():
            i = int(np.flatnonzero(silent)[0])
            raise silence(product, int(s[i]), int(q[i]), None)
        weights = (chosen[owner] == number).astype(np.float64) if chosen.ndim == 1 else chosen[owner, number]
        kept = np.flatnonzero(weights)
        taken, owner, number, weights = taken[kept], owner[kept], number[kept], weights[kept]
    length = rows.row_start[taken + 1] - rows.row_start[taken]
    entry = spans(rows.row_start[taken], rows.row_start[taken + 1])
    probability = rows.probability[entry]
    weight = None
    if weights is not None:
        of_entry = np.repeat(np.arange(len(taken)), length)
        if (weights != 1).any():
            weight = weights[of_entry]
            probability = probability * weight
        length = np.bincount(owner[of_entry], minlength=len(code))
        number, count = np.zeros(len(code), dtype=np.int64), np.ones(len(code), dtype=np.int64)
        from_q = q[owner[of_entry]]
    else:
        from_q = np.repeat(q[owner], length)
    target = rows.target[entry].astype(np.int64)
    child = target * Q + automaton.delta[product.letter[target], from_q]
    nothing = np.empty(0, dtype=np.int64)
    return Recurrent(
        product, code, starts(count), number, starts(length), child, probability, entry, weight,
        np.empty(0, dtype=np.bool_), nothing, np.empty(0),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Components:
    """Maximal end components: of each vertex (n,), −1 outside; and the choices (m,) that stay in their component."""

    count: int
    of: I64
    inside: Bools


def end_components(graph: Recurrent, within: Bools | None = None) -> Components:
    """The maximal end components among the vertices `within` [Alfaro97, ch. 3]."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    inside = np.ones(len(graph.choice), dtype=np.bool_) if within is None else graph.all_in(within)
    if within is not None:
        inside &= within[graph.owner]
    while True:
        inside = closed(graph, inside)
        alive = np.zeros(graph.n, dtype=np.bool_)
        alive[graph.owner[inside]] = True
        entries = np.flatnonzero(inside[graph.row])
        edges = csr_array(
            (np.ones(len(entries), dtype=np.int8), (graph.owner[graph.row[entries]], graph.child[entries])),
            shape=(graph.n, graph.n),
        )
        _, strong = connected_components(edges, directed=True, connection="strong")
        leaves = np.zeros(len(graph.choice), dtype=np.bool_)
        away = entries[strong[graph.owner[graph.row[entries]]] != strong[graph.child[entries]]]
        leaves[graph.row[away]] = True
        if not leaves.any():
            break
        inside &= ~leaves
    names, numbers = np.unique(strong[alive], return_inverse=True)
    of = np.full(graph.n, -1, dtype=np.int64)
    of[alive] = numbers
    return Components(len(names), of, inside)


def closed(graph: Recurrent, inside: Bools) -> Bools:
    """The most of these choices whose successors all have one of them: with them, runs go on for ever."""
    while True:
        alive = np.zeros(graph.n, dtype=np.bool_)
        alive[graph.owner[inside]] = True
        kept = inside & graph.all_in(alive)
        if kept.sum() == inside.sum():
            return kept
        inside = kept


def towards(graph: Recurrent, targets: Bools, allowed: Bools) -> I64:
    """For each vertex a choice, among those allowed, that may lead one step nearer to the targets; −1 where none leads
    there, and in the targets."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import breadth_first_order

    entries = np.flatnonzero(allowed[graph.row])
    owner = graph.owner[graph.row[entries]]
    kept = ~targets[owner]
    entries, owner = entries[kept], owner[kept]
    goals = np.flatnonzero(targets)
    before = np.concatenate([graph.child[entries], np.full(len(goals), graph.n)])
    after = np.concatenate([owner, goals])
    edges = csr_array((np.ones(len(before), dtype=np.int8), (before, after)), shape=(graph.n + 1, graph.n + 1))
    _, nearer = breadth_first_order(edges, graph.n, directed=True, return_predecessors=True)
    best = entries[graph.child[entries] == nearer[owner]]
    found = np.full(graph.n, -1, dtype=np.int64)
    found[graph.owner[graph.row[best]][::-1]] = graph.row[best][::-1]
    return found


def surely(graph: Recurrent, targets: Bools) -> Bools:
    """From where some policy reaches the targets with probability 1 [Alfaro97, ch. 3]."""
    allowed = np.ones(len(graph.choice), dtype=np.bool_)
    while True:
        able = targets | (towards(graph, targets, allowed) >= 0)
        kept = allowed & graph.all_in(able)
        if kept.sum() == allowed.sum():
            return able
        allowed = kept


def columns(graph: Recurrent, choices: I64, numbers: I64, n: int) -> Any:
    """The rows of these choices as a scipy CSR array (len(choices), n), over other numbers of vertices."""
    from scipy.sparse import csr_array

    entries = spans(graph.row_start[choices], graph.row_start[choices + 1])
    row = starts(np.diff(graph.row_start)[choices])
    found = csr_array((graph.probability[entries], numbers[graph.child[entries]], row), shape=(len(choices), n))
    found.sum_duplicates()
    return found
