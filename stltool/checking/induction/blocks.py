"""The induction on a dask cluster: model states in blocks that exchange only their borders.

A block owns a range of the graph's states, and also knows their successors, its *border*. A step is one task per block:

    forward   the reached sets that other blocks send are united and pushed through δ: F_t of the block; then they are
              united along its states' choices and sent to the blocks that own the successors
    back      the layer ahead consists of the block's own states and of what the owners send for its border; from it
              come the bits, the numbers and the choices of the block's own states, by the same kernels in the same
              order

so values, bounds and policies are bit for bit the same as on one machine. Tasks are pure functions of their arguments:
if a worker dies, dask computes again whatever is lost.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata import UNDECIDED
from stltool.checking.induction.allowed import Allowed
from stltool.checking.induction.arithmetic import Doubles, Fixed, Values
from stltool.checking.induction.edges import OPEN, REST, SURE
from stltool.checking.induction.graph import I32, I64, Automaton, Game
from stltool.checking.induction.induct import Solution, Step, recorded
from stltool.checking.induction.layers import Budget
from stltool.checking.induction.recording import InMemory, Passed, Recorder
from stltool.checking.induction.tiled import Tiles
from stltool.checking.induction.words import Graph, Layer, Moves, Sets, Words, lanes_of, prepared
from stltool.choices import Listed
from stltool.models.fractions import Shares
from stltool.models.rows import Chances, Rows

if TYPE_CHECKING:
    from distributed import Client, Future

Ahead: TypeAlias = tuple[Layer, Values]


@dataclass(frozen=True, eq=False)
class Block:
    """What a task needs about its block; states are numbered as in the whole graph, except the block's own.

    number   the block's number: its states are cuts[number] … cuts[number + 1] − 1
    known    the block's states and its border, ascending
    graph    of these, by their position in `known`
    """

    number: int
    cuts: I64
    known: I32
    graph: Graph
    automaton: Automaton
    goal: int
    allowed: Allowed
    choices: type[np.unsignedinteger] | None
    arithmetic: Doubles | Fixed

    @cached_property
    def moves(self) -> Moves:
        return Moves(self.automaton)

    def engine(self) -> Words:
        """The engine over the block's graph; a new one for each task, since its buffers belong to one thread."""
        game = Game(self.graph.rows, self.automaton, self.graph.letter, self.graph.first.astype(np.int64))
        game.kept["words"] = (self.graph, self.moves)
        return Words(game, self.goal, self.allowed, choices=self.choices, threads=1)

    def local(self, states: I32) -> I32:
        return np.searchsorted(self.known, states).astype(np.int32)


class Forward(NamedTuple):
    """F_t of a block, whether it equals that of the step before, and what it sends to each block."""

    sets: Sets
    same: bool
    sent: dict[int, Sets]


class Reaching(NamedTuple):
    """Steps first … last, which reach the same sets, by block."""

    first: int
    last: int
    sets: list[Future[Sets]]


class Back(NamedTuple):
    """A block's layer and values of a step, whether they equal those of the step after, and its choices."""

    layer: Layer
    values: Values
    same: bool
    listed: tuple[I64, NDArray[np.uint64], NDArray[np.unsignedinteger]] | None


def make_block(
    graph: Graph, cuts: I64, number: int, automaton: Automaton, arithmetic: Doubles | Fixed, **rest: Any
) -> Block:
    """One block of a graph, with the rows of its own states."""
    from stltool.kernels import words

    a, b = int(cuts[number]), int(cuts[number + 1])
    choices = slice(int(graph.choice_start[a]), int(graph.choice_start[b]))
    entries = slice(int(graph.row_start[choices.start]), int(graph.row_start[choices.stop]))
    target = graph.target[entries]
    known = np.union1d(np.arange(a, b, dtype=np.int32), target[target >= 0]).astype(np.int32)
    own = int(np.searchsorted(known, a))
    before, after = own, len(known) - own - (b - a)
    mine = graph.choice_start[a : b + 1] - choices.start
    choice_start = np.concatenate([np.zeros(before), mine, np.full(after, mine[-1])]).astype(np.int64)
    row_start = graph.row_start[choices.start : choices.stop + 1] - entries.start
    inner = np.where(target >= 0, np.searchsorted(known, target), -1).astype(np.int32)
    first = np.searchsorted(known, graph.first[(graph.first >= a) & (graph.first < b)]).astype(np.int32)
    worth, given = graph.entry[entries], None
    if isinstance(arithmetic, Fixed):
        given = Shares(graph.rows.numerator[worth], graph.rows.denominator)
    chances = Chances(graph.rows.probability[worth], row_start, given)
    rows = Rows(choice_start, row_start, inner, chances, states=graph.states[known].astype(np.int64))
    structure = rows.choice_start, rows.row_start, rows.target
    part = Graph(
        graph.states[known], first, *structure, np.arange(len(row_start) - 1), np.arange(len(inner)), rows,
        *words.neighbours(*structure), graph.letter[known],
    )  # fmt: skip
    return Block(number, cuts, known, part, automaton, arithmetic=arithmetic, **rest)


# ----------------------------------------------------------------------------------------------- tasks of workers


def begin(block: Block) -> Forward:
    """F_0."""
    engine = block.engine()
    sets = engine._initial()
    sets = replace(sets, states=block.known[sets.states])
    return Forward(sets, False, _sent(block, engine, 0, sets))


def forward(block: Block, t: int, before: Forward, *received: Sets) -> Forward:
    """F_t from what all blocks, this one included, sent at step t − 1."""
    from stltool.kernels import words

    engine = block.engine()
    moves, scratch = engine.moves, engine.crew.first
    together = _joined([sets for sets in (before.sent.get(block.number, _NOTHING), *received) if len(sets.states)])
    sets = _NOTHING
    if len(together.states):
        n = _unite_as_they_are(engine, block.local(together.states), together)
        found = words.ascending(scratch.found, n, scratch.slot)
        states, start = np.empty(n, dtype=np.int32), np.empty(n + 1, dtype=np.int64)
        word, bits = np.empty(n * moves.n_words, dtype=np.int32), np.empty(n * moves.n_words, dtype=np.uint64)
        k = words.push(
            found, scratch.slot, scratch.rows, scratch.groups, block.graph.letter, *moves.pieces(t - 1),
            moves.where(t, UNDECIDED), moves.n_words, moves.width, moves.shift, states, start, word, bits,
        )  # fmt: skip
        scratch.forget(n)
        m = int(start[k])
        sets = Sets(block.known[states[:k]], start[: k + 1].copy(), word[:m].copy(), bits[:m].copy())
    same = engine._same_reached(sets, before.sets)
    return Forward(sets, same, before.sent if same and engine.allowed.everything else _sent(block, engine, t, sets))


def sets_of(result: Forward) -> Sets:
    return result.sets


def back(block: Block, t: int, sets: Sets, own: Back | None, *pieces: Ahead) -> Back:
    """A block's layer, values and choices of step t, from its own ones of step t + 1 and pieces of other blocks'."""
    engine = block.engine()
    tiles = block.arithmetic.tiles(engine)
    layer, values = _whole(block, own, pieces, engine, tiles)
    here = engine._settled(replace(sets, states=block.local(sets.states)), layer, t)
    found, best = tiles.back(t, here, layer, values, block.choices is not None)
    listed = None
    if block.choices is not None and best is not None:
        listed = engine.listed(t, t, here, best)[2:]
    here = replace(here, states=block.known[here.states])
    same = own is not None and engine._same_settled(here, own.layer) and np.array_equal(found, own.values)
    return Back(here, found, same, listed)


def piece(result: Back, states: I32) -> Ahead:
    """The part of a block's layer for some states, to be sent to another block."""
    layer = result.layer
    kept = np.isin(layer.states, states)
    words = np.repeat(kept, np.diff(layer.start))
    n_words, n_tiles = np.diff(layer.start)[kept], np.diff(layer.tiles)[kept]
    lanes = np.repeat(np.repeat(kept, np.diff(layer.tiles)), 8)
    part = Layer(
        layer.states[kept], np.concatenate([[0], np.cumsum(n_words)]), layer.word[words], layer.open[words],
        layer.sure[words], np.concatenate([[0], np.cumsum(n_tiles)]), None,
    )  # fmt: skip
    return part, result.values[lanes]


def again(block: Block, t: int, before: Forward) -> Forward:
    """F_t, equal to that of an earlier step, with what it sends by the choices of step t."""
    return Forward(before.sets, True, _sent(block, block.engine(), t, before.sets))


def at_start(block: Block, own: Back | None) -> tuple[Values, NDArray[np.bool_]]:
    """The values of the block's first pairs, and whether they are certain."""
    engine = block.engine()
    tiles = block.arithmetic.tiles(engine)
    layer, values = _whole(block, own, (), engine, tiles)
    game = engine.game
    slots = engine.slots(layer, 0, block.graph.states[game.first].astype(np.int64), game.entry)
    return tiles.values(layer, values)[slots], slots < OPEN


def is_empty(result: Forward) -> bool:
    return not len(result.sets.states)


def is_same(result: Forward | Back) -> bool:
    return result.same


def sent(result: Forward, to: int) -> Sets:
    return result.sent.get(to, _NOTHING)


def choices_of(result: Back) -> tuple[NDArray[Any], ...] | None:
    return result.listed


def layer_of(result: Back) -> Ahead:
    return result.layer, result.values


_IN_FLIGHT = 8  # steps submitted before the answers about earlier ones are known
_NOTHING = Sets(
    np.empty(0, dtype=np.int32), np.zeros(1, dtype=np.int64), np.empty(0, dtype=np.int32), np.empty(0, dtype=np.uint64)
)


def _sent(block: Block, engine: Words, t: int, sets: Sets) -> dict[int, Sets]:
    """What the sets of the block's states lead to, by owning block."""
    from stltool.kernels import words

    if not len(sets.states):
        return {}
    moves, scratch = engine.moves, engine.crew.first
    inner = replace(sets, states=block.local(sets.states))
    if engine.allowed.everything:
        n = scratch.unite(inner, 0, len(inner.states))
    else:
        n = scratch.unite_allowed(inner, engine.allowed.masks(t, block.graph, inner))
    found = words.ascending(scratch.found, n, scratch.slot)
    start = np.empty(n + 1, dtype=np.int64)
    word, bits = np.empty(n * moves.n_words, dtype=np.int32), np.empty(n * moves.n_words, dtype=np.uint64)
    words.collect(
        found, scratch.slot, scratch.rows, scratch.groups, moves.n_words, moves.width, moves.shift, start, word, bits
    )
    states = block.known[found]
    cuts = np.searchsorted(states, block.cuts)
    parts = {}
    for number, (a, b) in enumerate(zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True)):
        if b > a:
            lo, hi = int(start[a]), int(start[b])
            parts[number] = Sets(states[a:b], start[a : b + 1] - lo, word[lo:hi].copy(), bits[lo:hi].copy())
    return parts


def _unite_as_they_are(engine: Words, states: I32, sets: Sets) -> int:
    """One row for each state, from sets that list some states several times."""
    from stltool.kernels import words

    scratch, moves = engine.crew.first, engine.moves
    n = len(engine.graph.states)
    if len(scratch.rows) < n * moves.width:
        scratch.rows = np.empty(n * moves.width, dtype=np.uint64)
    itself, start = np.arange(n, dtype=np.int32), np.arange(n + 1, dtype=np.int64)
    united: int = words.unite(
        states, sets.start, sets.word, sets.bits, 0, len(states), start, itself,
        scratch.slot, scratch.found, scratch.rows, scratch.groups, moves.width, moves.shift,
    )  # fmt: skip
    return united


def _joined(parts: Sequence[Sets]) -> Sets:
    if not parts:
        return _NOTHING
    words = np.cumsum([0, *(len(part.word) for part in parts)])
    start = np.concatenate([*(part.start[:-1] + w for part, w in zip(parts, words, strict=False)), words[-1:]])
    return Sets(
        np.concatenate([part.states for part in parts]),
        start,
        np.concatenate([part.word for part in parts]),
        np.concatenate([part.bits for part in parts]),
    )


def _whole(block: Block, own: Back | None, pieces: Sequence[Ahead], engine: Words, tiles: Tiles) -> Ahead:
    """The layer ahead of all states that a block knows, in its own numbering: the pieces in order."""
    ahead = [piece for piece in pieces if len(piece[0].states)]
    if own is not None and len(own.layer.states):
        ahead.append((own.layer, own.values))
    if not ahead:
        return engine.nothing(), tiles.start()
    layer, values = _put_together(ahead)
    return replace(layer, states=block.local(layer.states)), values


def _put_together(parts: Sequence[Ahead]) -> Ahead:
    """One layer from several, in their order."""
    layers = [layer for layer, _ in parts]
    words = np.cumsum([0, *(len(layer.word) for layer in layers)])
    counts = np.cumsum([0, *(layer.n_tiles for layer in layers)])
    start = [layer.start[:-1] + w for layer, w in zip(layers, words, strict=False)]
    numbers = [layer.tiles[:-1] + n for layer, n in zip(layers, counts, strict=False)]
    joined = Layer(
        np.concatenate([layer.states for layer in layers]),
        np.concatenate([*start, words[-1:]]),
        np.concatenate([layer.word for layer in layers]),
        np.concatenate([layer.open for layer in layers]),
        np.concatenate([layer.sure for layer in layers]),
        np.concatenate([*numbers, counts[-1:]]),
        None,
    )
    return joined, np.concatenate([values for _, values in parts])


# -------------------------------------------------------------------------------------------------------- the client


def solve_on_cluster(
    client: Client,
    game: Game,
    arithmetic: Doubles | Fixed,
    goal: int,
    allowed: Allowed,
    keep: type[np.unsignedinteger] | None,
    recorder: Recorder | None,
    budget: Budget,
    n_blocks: int | None = None,
) -> Solution:
    """The result of `solve`, by the client's workers, in n_blocks blocks (default: one for each of their threads)."""
    recorder, whole = recorder or InMemory(), False
    try:
        recorder.resume(None)
        work = _Work(client, game, prepared(game, budget)[0], arithmetic, goal, allowed, keep, n_blocks)
        ahead, swept = None, 0
        for step in _back(work, _reached(work, budget), budget):
            ahead, swept = step.results, swept + 1
            if keep is not None:
                chosen = zip(*work.told(step.choices), strict=True)
                recorder.add(Listed(step.first, step.last, *(np.concatenate(arrays) for arrays in chosen)))
        parts = work.at_start(ahead)
        entry, certain = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        choices = recorded(game, recorder) if keep is not None else None
        whole = True
        return Solution(entry, certain, choices, "cluster", swept)
    finally:
        recorder.close(whole)


class ClusterWay:
    """Like `Way`, by the workers of a cluster: the layer and the values of every step are sent back."""

    engine = "cluster"

    def __init__(self, client: Client, layers: Words, arithmetic: Doubles | Fixed, n_blocks: int | None = None) -> None:
        self._layers, self._ends = layers, arithmetic.ends(0)
        question = (arithmetic, layers.goal, layers.allowed)
        self._work = _Work(client, layers.game, layers.graph, *question, None, n_blocks)
        self._dtype = np.int64 if isinstance(arithmetic, Fixed) else np.float64

    def end(self) -> Passed:
        """The layer after the last step."""
        return Passed(self._layers.game.horizon, self._layers.nothing(), np.empty(0, dtype=self._dtype), 0)

    def back(self, at: Passed) -> Iterator[Step]:
        """From the last step to step 0."""
        for step in _back(self._work, _reached(self._work, self._layers.budget), self._layers.budget):
            if not step.again:
                parts = [part for part in self._work.told(self._work.ask(layer_of, step.results)) if len(part[1])]
                layer, values = _put_together(parts) if parts else (self._layers.nothing(), at.values[:0])
                at = Passed(step.first, layer, values, at.swept + 1)
            else:
                at = replace(at, before=step.first, swept=at.swept + 1)
            yield Step(step.first, step.last, step.again, None, at)

    def by_slot(self, at: Passed) -> Values:
        """The values of a layer, as arithmetics hold them."""
        ends = np.array([self._ends[REST], self._ends[SURE]], dtype=self._dtype)
        return np.concatenate([ends, at.values[lanes_of(at.ahead, at.ahead.open)]])


def _reached(work: _Work, budget: Budget) -> list[Reaching]:
    """The reached sets, by stretches."""
    game, allowed, h = work.game, work.allowed, work.game.horizon
    now, first, t = work.begin(), 0, 0
    stretches: list[Reaching] = []
    flight: deque[tuple[list[Future[Forward]], list[Future[bool]], list[Future[bool]]]] = deque()
    empty = all(work.told(work.ask(is_empty, now)))
    while not empty:
        budget.tell(t, h)
        while len(flight) < _IN_FLIGHT and t + 1 + len(flight) < h:
            after = work.forward(t + 1 + len(flight), flight[-1][0] if flight else now)
            flight.append((after, work.ask(is_empty, after), work.ask(is_same, after)))
        if flight:
            after, *answers = flight.popleft()
            empty, same = (all(work.told(answer)) for answer in answers)
            if same and game.automaton.keeps_numbers(t):
                last = min(game.automaton.alike(t + 1)[1], allowed.last_alike(t) + 1, h - 1)
                if last > t + 1:
                    flight.clear()
                now, t = after if last == t + 1 or allowed.everything else work.again(last, after), last
                continue
        stretches.append(Reaching(first, t, work.sets(now)))
        if t == h - 1:
            break
        now, first, t = after, t + 1, t + 1
    return stretches


class BackStep(NamedTuple):
    """Steps first … last, which have the same values: the results of every block; like `Step` on one machine."""

    first: int
    last: int
    again: bool
    results: list[Future[Back]]
    choices: list[Future[Any]]


def _back(work: _Work, stretches: list[Reaching], budget: Budget) -> Iterator[BackStep]:
    """Every backward step that is computed, from the last."""
    game, allowed = work.game, work.allowed
    latest: list[Future[Back]] | None = None
    flight: deque[tuple[int, BackStep, list[Future[bool]]]] = deque()
    steps = _back_from(stretches, game.horizon)
    while True:
        for first, t, sets in itertools.islice(steps, _IN_FLIGHT - len(flight)):
            latest = work.back(t, sets, latest)
            choices = [] if work.keep is None else work.ask(choices_of, latest)
            flight.append((first, BackStep(t, t, False, latest, choices), work.ask(is_same, latest)))
        if not flight:
            return
        first, step, same = flight.popleft()
        t = step.last
        if all(work.told(same)) and game.automaton.keeps_numbers(t):
            until = max(first, game.automaton.alike(t + 1)[0] - 1, allowed.first_alike(t))
            step = step._replace(first=until, again=True)
            if until < t:
                flight.clear()
                latest, steps = step.results, _back_from(stretches, until)
        yield step
        while stretches and stretches[-1].first >= step.first:
            stretches.pop()
        budget.tell(step.first, game.horizon, back=True)


def _back_from(stretches: list[Reaching], before: int) -> Iterator[tuple[int, int, list[Future[Sets]]]]:
    """The steps before this one, from the last: each with the first of its stretch, and the sets of the blocks."""
    for first, last, sets in reversed(stretches.copy()):
        for t in range(min(last, before - 1), first - 1, -1):
            yield first, t, sets


class _Work:
    """Tasks of all blocks, step by step."""

    def __init__(
        self,
        client: Client,
        game: Game,
        graph: Graph,
        arithmetic: Doubles | Fixed,
        goal: int,
        allowed: Allowed,
        keep: type[np.unsignedinteger] | None,
        n_blocks: int | None,
    ) -> None:
        self.game, self.allowed, self.keep, self._client = game, allowed, keep, client
        self._worker = [worker for worker, threads in client.nthreads().items() for _ in range(threads)]
        cuts = _cuts(graph, n_blocks or len(self._worker))
        rest = {"goal": goal, "allowed": allowed, "choices": keep}
        blocks = [make_block(graph, cuts, i, game.automaton, arithmetic, **rest) for i in range(len(cuts) - 1)]
        borders = [_border(block) for block in blocks]
        self._senders = [[i for i, border in enumerate(borders) if number in border] for number in range(len(blocks))]
        self._blocks = [self._submit(i, _itself, block) for i, block in enumerate(blocks)]
        self._needed = [[(j, self._submit(j, _itself, states)) for j, states in border.items()] for border in borders]

    def _submit(self, i: int, task: Any, *given: Any) -> Future[Any]:
        """A task of block i, which stays with its worker as long as the worker lives."""
        return self._client.submit(
            task, *given, pure=False, workers=[self._worker[i % len(self._worker)]], allow_other_workers=True
        )

    def begin(self) -> list[Future[Forward]]:
        return [self._submit(i, begin, block) for i, block in enumerate(self._blocks)]

    def again(self, t: int, now: Sequence[Future[Forward]]) -> list[Future[Forward]]:
        return [self._submit(i, again, block, t, now[i]) for i, block in enumerate(self._blocks)]

    def forward(self, t: int, now: Sequence[Future[Forward]]) -> list[Future[Forward]]:
        received = [[self._submit(j, sent, now[j], i) for j in senders] for i, senders in enumerate(self._senders)]
        return [self._submit(i, forward, block, t, now[i], *received[i]) for i, block in enumerate(self._blocks)]

    def sets(self, now: Sequence[Future[Forward]]) -> list[Future[Sets]]:
        return [self._submit(i, sets_of, mine) for i, mine in enumerate(now)]

    def back(self, t: int, sets: Sequence[Future[Sets]], ahead: Sequence[Future[Back]] | None) -> list[Future[Back]]:
        if ahead is None:
            return [self._submit(i, back, block, t, sets[i], None) for i, block in enumerate(self._blocks)]
        pieces = [[self._submit(j, piece, ahead[j], states) for j, states in needed] for needed in self._needed]
        return [self._submit(i, back, block, t, sets[i], ahead[i], *pieces[i]) for i, block in enumerate(self._blocks)]

    def at_start(self, ahead: Sequence[Future[Back]] | None) -> list[tuple[Values, NDArray[np.bool_]]]:
        own = [None] * len(self._blocks) if ahead is None else ahead
        parts = [self._submit(i, at_start, block, own[i]) for i, block in enumerate(self._blocks)]
        found: list[tuple[Values, NDArray[np.bool_]]] = self._client.gather(parts)
        return found

    def ask(self, question: Any, results: Sequence[Future[Any]]) -> list[Future[Any]]:
        """A function of the result of every block, computed where the result is."""
        return [self._submit(i, question, result) for i, result in enumerate(results)]

    def told(self, answers: list[Future[Any]]) -> list[Any]:
        found: list[Any] = self._client.gather(answers)
        return found


def _cuts(graph: Graph, wanted: int) -> I64:
    """The boundaries of blocks with about equally many row entries, the end included; no block is empty."""
    weight = graph.row_start[graph.choice_start]
    inner = np.searchsorted(weight, np.linspace(0, weight[-1], wanted + 1)[1:-1])
    return np.unique(np.concatenate([[0], inner, [len(graph.states)]])).astype(np.int64)


def _border(block: Block) -> dict[int, I32]:
    """The border of a block, by the blocks that own it."""
    owner = np.searchsorted(block.cuts, block.known, side="right") - 1
    return {int(number): block.known[owner == number] for number in np.unique(owner) if number != block.number}


def _itself(given: Any) -> Any:
    return given
