"""What a policy reaches, unfolded over the steps, with the values of an arithmetic at every step.

    layer 0      {(s, δ(L(s), q₀)) : ι(s) > 0}
    layer t + 1  {(s', δ(L(s'), q)) : (s,q) undecided in layer t, π_t(c|s,q) > 0, p(s'|c) > 0}

A pair whose verdict is decided has no edges. The layers are those of one induction (checking/induction), so repeated
steps share them and their values; edges are made again whenever a pass needs them.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.checking.check import undefined
from stltool.checking.induction import (
    OPEN,
    Arithmetic,
    Budget,
    Edges,
    Engine,
    Following,
    Game,
    Layers,
    Progress,
    Silent,
    Stretch,
    Values,
    Way,
    layers_of,
)
from stltool.choices import Form
from stltool.policy import Policy
from stltool.product import Product

Floats = NDArray[np.float64]


class Unfolding:
    """The undecided pairs that `policy` reaches on `product`; with `live`, only those from which `goal` is possible.

    product, start   (k,) the probability of each of the model's first states
    steps   the number of steps that have such pairs
    game    the product's, by default
    kept    maps an arithmetic's values by slots (n + 2, …) to what is kept; all of them by default

    Raises PolicyError, naming the pairs, if the policy defines no action in a pair that it reaches; SizeError before
    allocating memory over the limit (default: four fifths of free memory).
    """

    def __init__(
        self,
        product: Product,
        policy: Policy,
        arithmetic: Arithmetic,
        goal: int,
        *,
        live: bool,
        game: Game | None = None,
        kept: Callable[[Values], Any] | None = None,
        engine: Engine = "auto",
        limit: int | None = None,
        progress: Progress | None = None,
    ) -> None:
        product.model.require_points()
        self.product = product
        game = game or Game.of(product)
        keep = kept or (lambda values: values)
        budget = Budget(f"unfolding {product.n_states} product states", limit, progress)
        self.start: Floats = product.model.initial[game.first]
        try:
            self.layers = layers_of(
                game, goal, Following(policy.form), engine=engine, live=live, sure=False, budget=budget
            )
            way = Way(self.layers, arithmetic, True)
            at = way.end()
            self._found: list[tuple[int, Any, Any]] = []  # (first step, layer, what is kept of its values)
            self._nothing = (0, at.ahead, keep(way.by_slot(at)))
            for step in way.back(at):
                at = step.at
                self._keep(step.first, at.ahead, keep(way.by_slot(at)))
            self.entry = way.by_slot(at)[self.layers.first_slots(at.ahead)]
        except Silent:
            raise undefined(product, policy) from None
        self.steps = self.layers.reached.last + 1
        self._found.reverse()
        self._first = [first for first, _, _ in self._found]

    def layer(self, t: int) -> Any:
        """The layer of step t."""
        return self._at(t)[1]

    def values(self, t: int) -> Any:
        """What is kept of the values of step t."""
        return self._at(t)[2]

    @property
    def stretches(self) -> list[Stretch]:
        """All layers, from step 0 on."""
        ends = [*self._first[1:], self.steps]
        return [Stretch(first, end - 1, layer) for (first, layer, _), end in zip(self._found, ends, strict=False)]

    def _keep(self, first: int, layer: Any, values: Any) -> None:
        """Claims memory for them, within the budget."""
        new = not self._found or self._found[-1][1] is not layer
        n_bytes = sum(x.nbytes for x in (values if isinstance(values, tuple) else (values,)))
        n_bytes += (self.layers.n_bytes(layer) if new else 0) + _STEP_BYTES
        self.layers.budget.take(n_bytes, first, self.layers.game.horizon)
        self._found.append((first, layer, values))

    def _at(self, t: int) -> tuple[int, Any, Any]:
        return self._found[bisect_right(self._first, t) - 1] if t < self.steps else self._nothing


_STEP_BYTES = 500  # for a step whose layer is empty


def flows(
    layers: Layers[Any, Any], stretches: Sequence[Stretch], start: Floats, form: Form | None = None
) -> Iterator[tuple[int, Edges, Floats, Floats]]:
    """(t, edges, the probability of each pair (n,), of each choice (m,)) step by step, edges in parts.

    stretches  of the layers, from step 0 on; start (k,) the probability of each of the game's first states
    form       a deterministic policy to follow if the layers hold several choices
    """
    reach: Floats = np.empty(0)
    made: tuple[Any, Any] = (None, None)  # the layers whose edges are kept
    kept: list[Edges] = []
    for i, (first, last, here) in enumerate(stretches):
        following = stretches[i + 1].layer if i + 1 < len(stretches) else layers.nothing()
        if not i:
            reach = np.zeros(OPEN + layers.n_open(here))
            np.add.at(reach, layers.first_slots(here), start)
        for t in range(first, last + 1):
            ahead = here if t < last else following
            if made[0] is not here or made[1] is not ahead:
                made, kept = (here, ahead), [layers.edges(here, ahead, t, lo, hi) for lo, hi in layers.parts(here)]
            after, at = np.zeros(OPEN + layers.n_open(ahead)), OPEN
            for edges in kept:
                share = reach[at : at + len(edges)]
                flow = np.repeat(share, np.diff(edges.choices))
                if form is not None:
                    taken = np.zeros(len(edges.choice), dtype=np.bool_)
                    taken[edges.choices[:-1] + form.at(t, edges.s, edges.q)] = True
                    flow = np.where(taken, flow, 0.0)
                elif edges.weight is not None:
                    flow = flow * edges.weight
                yield t, edges, share, flow
                moved = np.repeat(flow, np.diff(edges.start)) * layers.rows.probability[edges.entry]
                np.add.at(after, edges.child, moved)
                at += len(edges)
            reach = after
