"""Where a backward induction has to compute at all: for each step, what runs reach, and what is certain there.

Three sets of pairs (s, q) after step t, each exact:

    reached   F_t    forward from the first pairs, undecided only, along the choices that count
    sure      O_t    backwards over F_t: some choice leads to goals and sure pairs only
    open      A_t    some choice can lead to a goal, but no choice makes it sure

With true verdicts as goals the values of open pairs are strictly between 0 and 1, of sure ones 1, of all others 0; with
false verdicts sure ones are 0 and others 1: what a minimum wants. This classification involves no rounding. Without
`sure`, sure pairs count as open; without `live`, everything reached does.

Steps at which nothing changes share a layer, a *stretch*:

    F_{t+1} = Φ(F_t) under the verdicts of t+1: if it equals F_t, it stays so until verdicts or choices change
    (A, O)_t = Ψ(F_t, (A, O)_{t+1}) under the verdicts of t+1: if it equals that of t+1, so do all earlier ones, as long
    as F, verdicts and choices are the same

so `F[0,1000000] goal` takes as many layers as it takes to reach the goal.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from stltool.checking.induction.allowed import Allowed
from stltool.checking.induction.edges import Edges, Fan
from stltool.checking.induction.graph import I64, Game
from stltool.checking.induction.reached import Reached, Stretch
from stltool.choices import Listed
from stltool.models.rows import Demand, Rows
from stltool.sizes import memory_limit, require_memory, require_time

Progress: TypeAlias = Callable[[int, int], None]
"""Called with (steps done, all steps)."""

FLayer = TypeVar("FLayer")
Settled = TypeVar("Settled")


class Budget:
    """The memory and time that an induction may take, and where it reports its progress.

    limit     bytes (default: four fifths of free memory)
    progress  called with (steps done, all steps): once forward, once backward
    Raises SizeError before allocating more memory than is available, or for work of more than a week.
    """

    def __init__(self, what: str, limit: int | None = None, progress: Progress | None = None) -> None:
        self._what, self.limit, self._progress, self._taken = what, memory_limit(limit), progress, 0

    def share(self) -> float:
        """Bytes for layers that are kept from the forward pass to the backward pass."""
        return _SHARE * self.limit

    def take(self, n: int, t: int, h: int) -> None:
        """Claim n bytes permanently, at step t of h."""
        self.need(n, t, h)
        self._taken += n

    def need(self, n: int, t: int, h: int) -> None:
        """Claim n bytes temporarily."""
        if self._taken + n > self.limit:
            what = f"{self._what}: {t + 1} of {h} steps" if t else self._what
            require_memory(self._taken + n, what, _SMALLER, self.limit)

    def require_time(self, work: float, h: int) -> None:
        """Check the time for `work` multiply-adds, as far as they can be predicted."""
        require_time(work, _RATE, f"{self._what} over {h} steps", _SMALLER)

    def tell(self, t: int, h: int, back: bool = False) -> None:
        if self._progress is not None:
            self._progress(h + (h - t) if back else t, 2 * h)


_RATE = 1e9  # multiply-adds per second, roughly, on one core
_SETTLED = 1024  # steps
_SHARE = 0.25
_SMALLER = "shorten the windows, or coarsen the grid or the time step"


class Layers(ABC, Generic[FLayer, Settled]):
    """The layers of one question; engines define how sets are stored (nodes.py, words.py).

    goal      the verdict that counts           live, sure    which pairs are distinguished (see the module's text)
    """

    def __init__(self, game: Game, goal: int, allowed: Allowed, live: bool, sure: bool, budget: Budget) -> None:
        self.game, self.goal, self.allowed, self.live, self.sure = game, goal, allowed, live, sure
        self.budget = budget
        self._widest = self._in_all = 0

    @cached_property
    def reached(self) -> Reached:
        """F by stretches, from step 0 to the last at which a run can be undecided."""
        return self._reach()

    def size(self) -> tuple[int, int]:
        """The number of pairs in the largest layer, and in all steps together."""
        assert self.reached is not None  # computing it counts them
        return self._widest, self._in_all

    def backwards(self, before: int | None = None, ahead: Settled | None = None) -> Iterator[Stretch]:
        """The open and sure pairs, by stretches from the last step to step 0; a layer ahead is not needed again.

        With `before`, only the steps before it; its layer is `ahead`.
        """
        ahead = self.nothing() if ahead is None else ahead
        for first, last, layer in self.reached.back(before):
            t = last
            while t >= first:
                here = self._settled(layer, ahead, t)
                until = t
                if self.game.automaton.keeps_numbers(t) and self._same_settled(here, ahead):
                    until = max(first, self.game.automaton.alike(t + 1)[0] - 1, self.allowed.first_alike(t))
                yield Stretch(until, t, here)
                ahead, t = here, until - 1

    def _reach(self) -> Reached:
        game, h = self.game, self.game.horizon
        layer, first, t = self._initial(), 0, 0
        found = Reached(self._after, self.budget.share())
        while not self._empty(layer):
            self.budget.tell(t, h)
            if t >= _SETTLED and t & (t - 1) == 0:  # occasionally: most repeat before
                self.budget.require_time((h - t) * self._work(layer), h)
            if t == h - 1:  # every verdict is decided after the next step
                self._add(found, first, t, layer)
                break
            after = self._after(layer, t)
            if game.automaton.keeps_numbers(t) and self._same_reached(layer, after):
                t = min(game.automaton.alike(t + 1)[1], self.allowed.last_alike(t) + 1, h - 1)
                continue
            self._add(found, first, t, layer)
            layer, first, t = after, t + 1, t + 1
        return found

    def _add(self, found: Reached, first: int, last: int, layer: FLayer) -> None:
        n = self._count(layer)
        self._widest, self._in_all = max(self._widest, n), self._in_all + n * (last + 1 - first)
        self.budget.need(found.bytes + self._bytes(layer), last, self.game.horizon)
        found.add(first, last, layer, self._bytes(layer))

    @property
    @abstractmethod
    def asked(self) -> Rows | Demand:
        """The rows to which the numbers of choices and entries in edges refer: the model's, or those made for its
        runs."""

    @property
    def rows(self) -> Rows:
        """The rows made so far."""
        return self.asked.rows

    def within(self, s: I64, choice: I64) -> I64:
        """The index within its state of each choice, which edges number among `rows`."""
        here = self.asked.at(s)
        return choice - self.asked.choice_start[here]

    @abstractmethod
    def acting(self) -> I64:
        """The model states that a run can be in while it is undecided, ascending."""

    @cached_property
    def kinds(self) -> Rows:
        """Rows that represent all those that runs meet, by lengths and probabilities; the same for every engine."""
        kinds = self.game.rows.kinds
        return kinds if kinds is not None else self.rows.some(self.asked.at(self.acting()))

    @abstractmethod
    def nothing(self) -> Settled:
        """The layer of the last step, after which every verdict is decided."""

    @abstractmethod
    def edges(self, here: Settled, ahead: Settled, t: int, lo: int, hi: int) -> Edges:
        """The edges of the open pairs in a range of step t, along the choices that count."""

    @abstractmethod
    def parts(self, layer: Settled) -> list[tuple[int, int]]:
        """The open pairs in ranges for `edges`, none of which takes much memory."""

    @abstractmethod
    def listed(self, first: int, last: int, layer: Settled, choice: NDArray[Any]) -> Listed:
        """Steps first … last of a policy: the first choice that makes each sure pair sure, and the choices of open
        pairs."""

    @abstractmethod
    def n_open(self, layer: Settled) -> int: ...

    @abstractmethod
    def n_bytes(self, layer: Settled) -> int:
        """What it takes in memory."""

    @abstractmethod
    def pairs(self, layer: Settled) -> tuple[I64, I64]:
        """(s, q) of the open pairs, in order."""

    @abstractmethod
    def pairs_reached(self, layer: FLayer) -> tuple[I64, I64]:
        """(s, q) of a layer of `reached`, in order."""

    @abstractmethod
    def slots(self, layer: Settled, t: int, s: I64, q: I64) -> I64:
        """The slots of pairs (s, q) after step t, whose layer this is."""

    def first_slots(self, layer: Settled) -> I64:
        """The slot of each of the game's first pairs at step 0."""
        return self.slots(layer, 0, self.game.first, self.game.entry)

    def fan(self, t: int, s: I64, q: I64) -> Fan:
        """The edges of any pairs (s, q) of step t, along the choices that count."""
        game = self.game
        owner, choice, weight = self.allowed.choices(self.asked, t, s, q)
        rows = self.rows  # the rows of these states are made now
        length = rows.row_start[choice + 1] - rows.row_start[choice]
        start = np.concatenate([[0], np.cumsum(length)])
        which = np.repeat(np.arange(len(choice)), length)
        entry = np.arange(len(which)) + (rows.row_start[choice] - start[:-1])[which]
        target = rows.target[entry].astype(np.int64)
        after = game.automaton.moves(t)[game.letter[target], q[owner[which]]].astype(np.int64)
        return Fan(s, q, np.searchsorted(owner, np.arange(len(s) + 1)), choice, weight, start, entry, target, after)

    @abstractmethod
    def _initial(self) -> FLayer: ...

    @abstractmethod
    def _after(self, layer: FLayer, t: int) -> FLayer: ...

    @abstractmethod
    def _settled(self, layer: FLayer, ahead: Settled, t: int) -> Settled: ...

    @abstractmethod
    def _count(self, layer: FLayer) -> int:
        """The number of its pairs."""

    @abstractmethod
    def _bytes(self, layer: FLayer) -> int:
        """Its size in memory, and the temporary memory needed once."""

    @abstractmethod
    def _work(self, layer: FLayer) -> int:
        """A rough upper bound on the multiply-adds of a backward step."""

    @abstractmethod
    def _empty(self, layer: FLayer) -> bool: ...

    @abstractmethod
    def _same_reached(self, one: FLayer, other: FLayer) -> bool: ...

    @abstractmethod
    def _same_settled(self, one: Settled, other: Settled) -> bool: ...
