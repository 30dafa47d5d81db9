"""The undecided situations that runs can come to, and P from each: what an explorer of a policy shows.

A *node* is an undecided (t, s, q) that some policy reaches (stltool/reached.py). In a node a policy has a number,

    i ≥ 0   its state's i-th choice        −1   no action        −2 − k   the k-th mixture

and P from there under it follows by backward induction, also where the policy itself never comes (NaN where P depends
on a node without action):

    V_t(s,q) = Σ_c π_t(c|s,q) Q_t(s,q,c),    Q_t(s,q,c) = Σ_s' P(s'|c) V_{t+1}(s', δ(L(s'), q))

in doubles, as in the twin of this file in a report's page (reporting/templates/engine.js).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.asked import Asked
from stltool.automata import TRUE, UNDECIDED
from stltool.choices import distinct
from stltool.errors import SizeError
from stltool.models.rows import spans, starts
from stltool.policy import Policy
from stltool.product import Product
from stltool.reached import MOST_EDGES, MOST_NODES, followed, reachable, reached_by, read, transitions

I64 = NDArray[np.int64]
F64 = NDArray[np.float64]

NO_ACTION = -1


def policy_numbers(product: Product, policy: Policy, nodes: list[I64]) -> tuple[NDArray[np.int32], F64]:
    """The policy's number in every node, one step after another, and its mixtures (k, C).

    A function is asked only where runs under it come; elsewhere it has no action here.
    """
    n_memories, most = product.automaton.n_states, product.model.most_choices
    asked = isinstance(policy.form, Asked)
    numbers: list[NDArray[Any]] = []
    reached = nodes[0] if nodes else np.empty(0, dtype=np.int64)
    for t, codes in enumerate(nodes):
        there = np.isin(codes, reached) if asked else np.ones(len(codes), dtype=np.bool_)
        s, q = np.divmod(codes[there], n_memories)
        found = policy.at(t, s, q) if len(s) else np.empty(0 if policy.deterministic else (0, most))
        full = np.full((len(codes), *found.shape[1:]), -1 if policy.deterministic else 0.0, dtype=found.dtype)
        full[there] = found
        numbers.append(full)
        if asked:
            reached = followed(product, s, q, found)
    if policy.deterministic:
        joined = np.concatenate(numbers).astype(np.int32) if numbers else np.empty(0, dtype=np.int32)
        return np.maximum(joined, NO_ACTION), np.empty((0, most))
    rows, which = distinct(np.concatenate(numbers) if numbers else np.empty((0, most)))
    mixed = rows.any(axis=1) & (rows.max(axis=1, initial=0) != 1)
    number = np.where(mixed, -1 - np.cumsum(mixed), np.where(rows.any(axis=1), rows.argmax(axis=1), NO_ACTION))
    return number[which].astype(np.int32), rows[mixed]


@dataclass(frozen=True, eq=False)
class Moves:
    """The choices of the nodes of a step, and where they lead.

    choices      (n + 1,): node i has the choices choices[i] … choices[i + 1] − 1
    rows         (m + 1,): choice j has the transitions rows[j] … rows[j + 1] − 1
    probability  (e,);  child (e,): 0 where the task fails, 1 where it holds, 2 + k the k-th node of the next step
    """

    choices: I64
    rows: I64
    probability: F64
    child: I64

    @classmethod
    def of(cls, product: Product, nodes: list[I64], t: int) -> Moves:
        model, automaton = product.model, product.automaton
        s, q = np.divmod(nodes[t], automaton.n_states)
        entry, count = transitions(product, s)
        code = read(product, model.target[entry], np.repeat(q, count))
        verdict = automaton.verdicts(t + 1)[code % automaton.n_states]
        child = (verdict == TRUE).astype(np.int64)
        open_ = np.flatnonzero((verdict == UNDECIDED) & (model.probability[entry] > 0))
        if len(open_):
            child[open_] = 2 + np.searchsorted(nodes[t + 1], code[open_])
        first, end = model.choice_start[s], model.choice_start[s + 1]
        lengths = np.diff(model.row_start)[spans(first, end)]
        return cls(starts(end - first), starts(lengths), model.probability[entry], child)

    def sums(self, ahead: F64) -> F64:
        """(m,): what each choice is worth, from the values of the nodes of the next step."""
        weighted = self.probability * np.concatenate([[0.0, 1.0], ahead])[self.child]
        sums: F64 = np.add.reduceat(weighted, self.rows[:-1]) if len(weighted) else np.empty(0)
        return sums


@dataclass(frozen=True, eq=False)
class Explored:
    """The nodes of a product, and a policy's numbers there and its mixtures (k, C); see the module's text.

    Where these are too many, only those that this policy comes to (`whole` is then False).
    """

    nodes: list[I64]
    numbers: NDArray[np.int32]
    mixtures: F64
    whole: bool = True

    @classmethod
    def of(cls, product: Product, policy: Policy) -> Explored | None:
        """None if even the policy comes to more than MOST_NODES nodes, or their states have more than MOST_EDGES
        transitions."""
        nodes, whole = reachable(product), True
        if nodes is None:
            nodes, whole = reached_by(product, policy.form), False
        return None if nodes is None else cls(nodes, *policy_numbers(product, policy, nodes), whole)


@dataclass(frozen=True)
class Outcome:
    """A successor: the model state, the automaton state after reading it, and its probability."""

    s: int
    q: int
    probability: float


class Situations:
    """P under a policy from every node, and after every choice there.

    Raises SizeError if there are too many nodes.
    """

    def __init__(self, product: Product, policy: Policy) -> None:
        product.model.require_points()
        self.product, self.policy = product, policy = policy.on(product)
        explored = Explored.of(product, policy)
        if explored is None or not explored.whole:
            raise SizeError(
                f"runs can come to more than {MOST_NODES} situations of step, state and memory, or have more than "
                f"{MOST_EDGES} moves there; shorten the windows"
            )
        self.nodes, self.numbers, self.mixtures = explored.nodes, explored.numbers, explored.mixtures
        self._offset = np.cumsum([0, *map(len, self.nodes)])
        self._by_choice: list[tuple[F64, I64]] = [(np.empty(0), np.zeros(1, dtype=np.int64))] * len(self.nodes)
        ahead: F64 = np.empty(0)
        for t in range(len(self.nodes) - 1, -1, -1):
            ahead = self._layer(t, ahead)

    def _layer(self, t: int, ahead: F64) -> F64:
        """The values of the nodes of step t, from those of step t + 1; those of choices are kept."""
        moves = Moves.of(self.product, self.nodes, t)
        sums, start = moves.sums(ahead), moves.choices
        self._by_choice[t] = sums, start
        numbers = self.numbers[self._offset[t] : self._offset[t + 1]]
        values = np.full(len(numbers), np.nan)
        sure = numbers >= 0
        values[sure] = sums[start[:-1][sure] + numbers[sure]]
        for n in np.flatnonzero(numbers < NO_ACTION).tolist():
            row = self.mixtures[-2 - numbers[n]][: start[n + 1] - start[n]]
            used = row > 0
            values[n] = row[used] @ sums[start[n] : start[n + 1]][used]
        return values

    def _place(self, t: int, s: int, q: int) -> int:
        """The position of a node among those of its step."""
        return int(np.searchsorted(self.nodes[t], s * self.product.automaton.n_states + q))

    def known(self, t: int, s: int, q: int) -> bool:
        """Whether (t, s, q) is a node."""
        n, code = self._place(t, s, q), s * self.product.automaton.n_states + q
        return n < len(self.nodes[t]) and int(self.nodes[t][n]) == code

    def undecided(self, t: int, q: int) -> bool:
        """Whether the verdict is open in automaton state q after step t."""
        return bool(self.product.automaton.verdicts(t)[q] == UNDECIDED)

    def choices(self, t: int, s: int, q: int) -> F64:
        """P after each choice of a node, if the policy is followed from the next step on."""
        sums, start = self._by_choice[t]
        n = self._place(t, s, q)
        values: F64 = sums[start[n] : start[n + 1]]
        return values

    def weights(self, t: int, s: int, q: int) -> F64:
        """The policy's weight on each choice of a node; zeros where it takes none."""
        number = int(self.numbers[self._offset[t] + self._place(t, s, q)])
        n = len(self.choices(t, s, q))
        weights: F64 = np.zeros(n)
        if number < NO_ACTION:
            weights = self.mixtures[-2 - number][:n]
        if number >= 0:
            weights[number] = 1.0
        return weights

    def value(self, t: int, s: int, q: int) -> float:
        """P from a node, or the verdict."""
        if not self.undecided(t, q):
            return float(self.product.automaton.verdicts(t)[q] == TRUE)
        weights, values = self.weights(t, s, q), self.choices(t, s, q)
        used = weights > 0
        return float(weights[used] @ values[used]) if used.any() else float("nan")

    def outcomes(self, s: int, q: int, i: int) -> list[Outcome]:
        """The successors of a state's i-th choice, most probable first."""
        model = self.product.model
        c = model.choice_start[s] + i
        entry = slice(model.row_start[c], model.row_start[c + 1])
        pairs = zip(model.target[entry].tolist(), model.probability[entry].tolist(), strict=True)
        found = [Outcome(u, self.product.enter(u, q), p) for u, p in pairs if p > 0]
        return sorted(found, key=lambda one: (-one.probability, one.s))
