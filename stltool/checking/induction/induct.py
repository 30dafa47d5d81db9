"""One backward induction for every question: an engine defines where to compute, an arithmetic how.

    V_t(s,q) = 1 / 0                                            if verdict_t(q) is true / false
             = opt_c Σ_s' P(s'|c) · V_{t+1}(s', δ(L(s'), q))     otherwise
    P(Φ)     = Σ_s ι(s) V_0(s, δ(L(s), q₀))                      after h steps: no stopping rule, no truncation

(docs/semantics.md §3.) The engine: lists of pairs in numpy if few pairs are reached (nodes.py), otherwise words of bits
(words.py); with words, doubles and fixed point process eight automaton states at a time (tiled.py).

**Stopping early.** Let steps u … t have the same open and sure pairs, verdicts (of the steps after them) and choices
that count. V_t is a function f of V_{t+1}, the same for all of them, down to every rounding. So if
V_t = V_{t+1} bit for bit, then V_{t−1} = f(V_t) = f(V_{t+1}) = V_t, and so on down to u, the choices too. Nothing is
truncated: these are the numbers that h steps give, and an enclosure that counts the roundings of h steps holds for
them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.checking.induction.allowed import EVERYTHING, Allowed
from stltool.checking.induction.arithmetic import Arithmetic, Values
from stltool.checking.induction.edges import OPEN
from stltool.checking.induction.graph import Game
from stltool.checking.induction.layers import Budget, Layers
from stltool.checking.induction.nodes import Nodes, TooMany
from stltool.checking.induction.recording import InMemory, Passed, Recorder
from stltool.checking.induction.words import Words
from stltool.choices import Choices
from stltool.sizes import integer_type

Engine: TypeAlias = Literal["auto", "nodes", "words"]
# the most pairs, all steps together, for numpy: until numba is loaded, until words.py is used, and after that
FEW, FEW_LOADED, FEW_USED = 100_000, 3_000, 200
_FEW_EACH = 2  # and for each automaton state: words.py makes tables of all of them, also of those not reached


@dataclass(frozen=True, eq=False)
class Solution:
    """entry    the value at each of the game's first states, in order
    certain  (k,) whether each is certain: 0 or 1, without any rounding
    choices  the first best choice by step (None if not kept)
    engine   "nodes" | "words" | "tiles" | "cluster"
    swept    backward steps that were computed; the others repeat
    """

    entry: Values
    certain: NDArray[np.bool_]
    choices: Choices | None
    engine: str
    swept: int


def layers_of(
    game: Game,
    goal: int,
    allowed: Allowed = EVERYTHING,
    *,
    engine: Engine = "auto",
    live: bool = True,
    sure: bool = True,
    keep: type[np.unsignedinteger] | None = None,
    threads: int | None = None,
    budget: Budget | None = None,
) -> Layers[Any, Any]:
    """The reached and open pairs, by the engine asked for; `auto` chooses one.

    Their results are the same to the bit, so the choice may depend on whether numba is loaded already, which takes a
    while.
    """
    if engine != "words":
        few = None if engine == "nodes" else max(_few(), _FEW_EACH * game.automaton.n_states)
        nodes = Nodes(game, goal, allowed, live, sure, budget, few)
        try:
            nodes.reached  # noqa: B018 - computed here, so that TooMany is raised here
        except TooMany:
            pass
        else:
            return nodes
    return Words(game, goal, allowed, live, sure, budget, keep, threads)


def _few() -> int:
    """The most pairs for numpy: the more, the longer the alternative would take to load."""
    if "stltool.kernels.words" in sys.modules:
        return FEW_USED
    return FEW_LOADED if "numba" in sys.modules else FEW


def induct(
    game: Game,
    arithmetic: Arithmetic,
    maximize: bool = True,
    allowed: Allowed = EVERYTHING,
    *,
    engine: Engine = "auto",
    keep: type[np.unsignedinteger] | None = None,
    threads: int | None = None,
    budget: Budget | None = None,
) -> Solution:
    """Solve a game. `keep` is the dtype of the choices that are kept, or None."""
    goal = TRUE if maximize else FALSE
    layers = layers_of(game, goal, allowed, engine=engine, keep=keep, threads=threads, budget=budget)
    return solve(layers, arithmetic, maximize, keep)


def solve(
    layers: Layers[Any, Any],
    arithmetic: Arithmetic,
    maximize: bool,
    keep: type[np.unsignedinteger] | None = None,
    recorder: Recorder | None = None,
) -> Solution:
    """Backwards over the layers, which were made for the same choices to keep; `recorder` receives these."""
    recorder, found = recorder or InMemory(), None
    try:
        found = _solve(layers, arithmetic, maximize, keep, recorder)
        return found
    finally:
        recorder.close(found is not None)


def _solve(
    layers: Layers[Any, Any],
    arithmetic: Arithmetic,
    maximize: bool,
    keep: type[np.unsignedinteger] | None,
    recorder: Recorder,
) -> Solution:
    game = layers.game
    way = Way(layers, arithmetic, maximize, keep)
    at = recorder.resume(layers) or way.end()
    for step in way.back(at):
        if keep is not None and step.choice is not None:
            recorder.add(layers.listed(step.first, step.last, step.at.ahead, step.choice))
        at = step.at
        recorder.passed(at)
    slots = layers.first_slots(at.ahead)
    choices = recorded(game, recorder) if keep is not None else None
    return Solution(way.by_slot(at)[slots], slots < OPEN, choices, way.engine, at.swept)


class Step(NamedTuple):
    """Steps first … last, which have the same values: `at` is the first of them. `choice`: the best, if kept.

    again   whether the layer and its values equal those of the steps after these
    """

    first: int
    last: int
    again: bool
    choice: NDArray[Any] | None
    at: Passed


class Way:
    """The way back over layers by an arithmetic; by tiles, if it supports them.

    engine  "nodes" | "words" | "tiles"
    """

    def __init__(
        self,
        layers: Layers[Any, Any],
        arithmetic: Arithmetic,
        maximize: bool,
        keep: type[np.unsignedinteger] | None = None,
    ) -> None:
        self._layers, self._arithmetic, self._maximize, self._keep = layers, arithmetic, maximize, keep
        assert layers.reached is not None  # computing it makes all rows
        arithmetic.begin(layers.rows)
        self._tiles = arithmetic.tiles(layers) if isinstance(layers, Words) and not layers.allowed.mixed else None
        self.engine = "nodes" if isinstance(layers, Nodes) else "words" if self._tiles is None else "tiles"

    def end(self) -> Passed:
        """The layer after the last step."""
        h, tiles = self._layers.game.horizon, self._tiles
        return Passed(h, self._layers.nothing(), self._arithmetic.start(h) if tiles is None else tiles.start(), 0)

    def back(self, at: Passed) -> Iterator[Step]:
        """From the current step to step 0."""
        layers, tiles = self._layers, self._tiles
        for first, last, layer in layers.backwards(at.before, at.ahead):
            t = last
            while t >= first:
                if tiles is None:
                    new, choice = _back(
                        layers, self._arithmetic, t, layer, at.ahead, at.values, self._maximize, self._keep
                    )
                else:
                    new, choice = tiles.back(t, layer, at.ahead, at.values, self._keep is not None)
                again = layer is at.ahead and self._arithmetic.repeats and np.array_equal(new, at.values)
                until = first if again else t
                at = Passed(until, layer, new, at.swept + 1)
                yield Step(until, t, again, choice, at)
                t = until - 1
                layers.budget.tell(until, layers.game.horizon, back=True)

    def by_slot(self, at: Passed) -> Values:
        """The values of a layer, as arithmetics hold them."""
        return at.values if self._tiles is None else self._tiles.values(at.ahead, at.values)


def recorded(game: Game, recorder: Recorder) -> Choices:
    """What an induction passed to its recorder."""
    shape, most = (game.n_states, game.automaton.n_states), game.rows.most_choices
    return Choices(shape, game.horizon, recorder.layers(), integer_type(most - 1))


def _back(
    layers: Layers[Any, Any],
    arithmetic: Arithmetic,
    t: int,
    here: Any,
    ahead: Any,
    values: Values,
    maximize: bool,
    keep: type[np.unsignedinteger] | None,
) -> tuple[Values, Values | None]:
    """The values of step t by slots, and the choices of its open pairs."""
    values_found, choices = [], []
    for lo, hi in layers.parts(here):
        edges = layers.edges(here, ahead, t, lo, hi)
        if len(edges):
            found, choice = arithmetic.back(t, edges, values, maximize, keep is not None)
            values_found.append(found)
            if choice is not None:
                if not layers.allowed.everything:  # so far numbered among the allowed choices
                    choice = layers.within(edges.s, edges.choice[edges.choices[:-1] + choice])
                choices.append(choice)
    by_slot = arithmetic.layer(t, values_found)
    return by_slot, np.concatenate(choices).astype(keep) if choices else np.empty(0, dtype=keep)
