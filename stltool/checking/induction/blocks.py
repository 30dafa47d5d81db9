"""The induction on a dask cluster: model states in blocks, of which only borders are exchanged.

A block owns a range of the graph's states, and knows their successors, its *border*, too. Each step is one task a block:

    forward   the sets that blocks send of what their runs reach are united and pushed through δ: F_t of the block;
              along its states' choices they are united again, for each block that owns what they lead to
    back      the layer ahead is that of the block's own states with what owners send of its border's; then the bits, the
              numbers and the choices of the block's own states, by the same kernels in the same order

so values, bounds and policies are the same to the bit as on one machine. Tasks are functions of what they are given: a
worker that dies takes nothing with it that dask does not compute again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata import UNDECIDED, TaskAutomaton
from stltool.checking.induction.allowed import EVERYTHING, Following
from stltool.checking.induction.arithmetic import Doubles, Fixed, Values
from stltool.checking.induction.edges import OPEN
from stltool.checking.induction.graph import I32, I64, Game
from stltool.checking.induction.layers import Budget
from stltool.checking.induction.recording import Recorder
from stltool.checking.induction.tiled import Tiles
from stltool.checking.induction.words import Graph, Layer, Moves, Sets, Words
from stltool.choices import Form, Listed

if TYPE_CHECKING:
    from distributed import Client, Future

Ahead: TypeAlias = tuple[Layer, Values]


@dataclass(frozen=True, eq=False)
class Block:
    """What a task needs of its block; states are numbered as in the whole graph, unless they are the block's own.

    first, last  the block's states are first … last − 1       cuts   where all blocks begin, and the end
    known        the block's states and its border, ascending  graph  of these, by their position in `known`
    """

    first: int
    last: int
    cuts: I64
    known: I32
    graph: Graph
    automaton: TaskAutomaton
    goal: int
    form: Form | None
    choices: type[np.unsignedinteger] | None
    arithmetic: Doubles | Fixed
    maximize: bool

    def engine(self) -> Words:
        """Over the block's graph; a new one for each task, since its buffers are one thread's."""
        game = Game(self.graph, self.automaton, self.graph.letter, self.graph.first.astype(np.int64))
        game.kept["words"] = (self.graph, Moves(self.automaton))
        allowed = EVERYTHING if self.form is None else Following(self.form)
        return Words(game, self.goal, allowed, choices=self.choices, threads=1)

    def local(self, states: I32) -> I32:
        return np.searchsorted(self.known, states).astype(np.int32)


class Forward(NamedTuple):
    """F_t of a block, whether it is that of the step before, and what it sends to each block."""

    sets: Sets
    same: bool
    sent: dict[int, Sets]


class Back(NamedTuple):
    """A block's layer and values of a step, whether they are those of the step after, and its choices."""

    layer: Layer
    values: Values
    same: bool
    listed: tuple[I64, NDArray[np.uint64], NDArray[np.unsignedinteger]] | None


def make_block(
    graph: Graph, cuts: I64, number: int, automaton: TaskAutomaton, share: NDArray[Any], **rest: Any
) -> Block:
    """One block of a graph; share (n_transitions,) is the arithmetic's, by the model's entries."""
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
    from stltool.kernels import words

    first = graph.first[(graph.first >= a) & (graph.first < b)]
    part = Graph(
        graph.states[known], np.searchsorted(known, first).astype(np.int32), choice_start, row_start, inner,
        graph.choice[choices], np.arange(entries.stop - entries.start), *words.neighbours(choice_start, row_start, inner),
        graph.letter[known],
    )  # fmt: skip
    arithmetic = rest.pop("arithmetic")
    kept = dataclasses.replace(
        automaton, state_names=(), parts=(), atoms=(), valuations=np.empty((0, 0), dtype=np.bool_),
        registers=np.empty((0, 0), dtype=np.int32), register_names=(),
    )  # fmt: skip
    return Block(a, b, cuts, known, part, kept, arithmetic=arithmetic.of(share[graph.entry[entries]]), **rest)


# ----------------------------------------------------------------------------------------------- tasks of workers


def begin(block: Block) -> Forward:
    """F_0."""
    graph, automaton = block.graph, block.automaton
    q = automaton.delta[graph.letter[graph.first], automaton.initial].astype(np.int64)
    undecided = automaton.verdicts(0)[q] == UNDECIDED
    states, q = block.known[graph.first[undecided]], q[undecided]
    bits = np.uint64(1) << (q % 64).astype(np.uint64)
    sets = Sets(states, np.arange(len(states) + 1, dtype=np.int64), (q // 64).astype(np.int32), bits)
    return Forward(sets, False, _sent(block, block.engine(), 0, sets))


def forward(block: Block, t: int, before: Forward, *received: Sets) -> Forward:
    """F_t from what all blocks sent at step t − 1."""
    from stltool.kernels import words

    engine = block.engine()
    moves, scratch = engine.moves, engine.crew.first
    together = _joined([sets for sets in received if len(sets.states)])
    sets = _NOTHING
    if len(together.states):
        n = _unite_as_they_are(engine, block.local(together.states), together)
        found = words.ascending(scratch.found, n, scratch.slot)
        states, start = np.empty(n, dtype=np.int32), np.empty(n + 1, dtype=np.int64)
        word, bits = np.empty(n * moves.n_words, dtype=np.int32), np.empty(n * moves.n_words, dtype=np.uint64)
        k = words.push(
            found, scratch.slot, scratch.rows, scratch.groups, block.graph.letter, *moves.pieces,
            moves.where(t, UNDECIDED), moves.n_words, moves.width, moves.shift, states, start, word, bits,
        )  # fmt: skip
        m = int(start[k])
        sets = Sets(block.known[states[:k]], start[: k + 1].copy(), word[:m].copy(), bits[:m].copy())
    same = engine._same_reached(sets, before.sets)
    return Forward(sets, same, before.sent if same and engine.allowed.everything else _sent(block, engine, t, sets))


def back(block: Block, t: int, reached: Forward, *ahead: Ahead) -> Back:
    """A block's layer, values and choices of step t; `ahead` are the pieces of step t + 1, in order of their states."""
    engine = block.engine()
    arithmetic = block.arithmetic
    tiles = arithmetic.tiles(engine)
    layer, values = _whole(block, ahead, engine, tiles)
    sets = reached.sets
    here = engine._settled(dataclasses.replace(sets, states=block.local(sets.states)), layer, t)
    found, best = tiles.back(t, here, layer, values, block.choices is not None)
    listed = None
    if block.choices is not None and best is not None:
        listed = engine.listed(t, t, here, best)[2:]
    here = dataclasses.replace(here, states=block.known[here.states])
    own, old = _own(block, ahead)
    same = not len(here.states) if own is None else engine._same_settled(here, own) and np.array_equal(found, old)
    return Back(here, found, same, listed)


def piece(result: Back, states: I32) -> Ahead:
    """What a block's layer has of some states, to be sent to another block."""
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
    """F_t, which is that of a step before: what it sends by the choices of step t."""
    return Forward(before.sets, True, _sent(block, block.engine(), t, before.sets))


def at_start(block: Block, *ahead: Ahead) -> tuple[Values, NDArray[np.bool_]]:
    """The values of the block's first pairs, and whether they are certain."""
    engine = block.engine()
    tiles = block.arithmetic.tiles(engine)
    layer, values = _whole(block, ahead, engine, tiles)
    slots = engine.first_slots(layer)
    return tiles.values(layer, values)[slots], slots < OPEN


def flags(results: Sequence[Forward]) -> tuple[bool, bool]:
    """Whether no block reaches anything, and whether every block reaches what it did before."""
    return not any(len(result.sets.states) for result in results), all(result.same for result in results)


def all_same(results: Sequence[Back]) -> bool:
    return all(result.same for result in results)


def sent(result: Forward, to: int) -> Sets:
    return result.sent.get(to, _NOTHING)


def listed(results: Sequence[Back], first: int, last: int) -> Listed:
    """The choices of all blocks."""
    parts = [result.listed for result in results if result.listed is not None]
    keys, bits, choice = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Listed(first, last, keys, bits, choice)


def size(*results: Any) -> int:
    """The bytes of what is exchanged."""
    total = 0
    for result in results:
        layer, values = result if isinstance(result, tuple) and isinstance(result[0], Layer) else (result, np.empty(0))
        fields = (getattr(layer, field.name) for field in dataclasses.fields(layer))
        total += values.nbytes + sum(array.nbytes for array in fields if array is not None)
    return total


_NOTHING = Sets(
    np.empty(0, dtype=np.int32), np.zeros(1, dtype=np.int64), np.empty(0, dtype=np.int32), np.empty(0, dtype=np.uint64)
)


def _sent(block: Block, engine: Words, t: int, sets: Sets) -> dict[int, Sets]:
    """What the sets of the block's states lead to, by the block that owns it."""
    from stltool.kernels import words

    if not len(sets.states):
        return {}
    moves, scratch = engine.moves, engine.crew.first
    inner = dataclasses.replace(sets, states=block.local(sets.states))
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
    """The rows of sets that name some states several times."""
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


def _whole(block: Block, ahead: Sequence[Ahead], engine: Words, tiles: Tiles) -> Ahead:
    """Pieces put together, by the block's own numbers."""
    layers = [layer for layer, _ in ahead if len(layer.states)]
    if not layers:
        return engine.nothing(), tiles.start()
    words = np.cumsum([0, *(len(layer.word) for layer in layers)])
    counts = np.cumsum([0, *(layer.n_tiles for layer in layers)])
    start = [layer.start[:-1] + w for layer, w in zip(layers, words, strict=False)]
    numbers = [layer.tiles[:-1] + n for layer, n in zip(layers, counts, strict=False)]
    joined = Layer(
        block.local(np.concatenate([layer.states for layer in layers])),
        np.concatenate([*start, words[-1:]]),
        np.concatenate([layer.word for layer in layers]),
        np.concatenate([layer.open for layer in layers]),
        np.concatenate([layer.sure for layer in layers]),
        np.concatenate([*numbers, counts[-1:]]),
        None,
    )
    return joined, np.concatenate([values for layer, values in ahead if len(layer.states)])


def _own(block: Block, ahead: Sequence[Ahead]) -> tuple[Layer | None, Values]:
    """The piece of the block's own states, the only one whose states it owns."""
    for layer, values in ahead:
        if len(layer.states) and block.first <= layer.states[0] < block.last:
            return layer, values
    return None, np.empty(0)


# -------------------------------------------------------------------------------------------------------- the client


def solve_on_cluster(
    client: Client,
    game: Game,
    arithmetic: Doubles | Fixed,
    goal: int,
    maximize: bool,
    form: Form | None,
    keep: type[np.unsignedinteger] | None,
    recorder: Recorder,
    budget: Budget,
    n_blocks: int | None = None,
) -> tuple[Values, NDArray[np.bool_], int]:
    """The values of the game's first pairs, whether they are certain, and the steps back that were computed."""
    h, allowed = game.horizon, EVERYTHING if form is None else Following(form)
    graph = Graph.of(game)
    blocks = _blocks(client, graph, game, arithmetic, goal, maximize, form, keep, n_blocks)
    work = _Work(client, blocks, graph)
    now, first, t = work.begin(), 0, 0
    stretches: list[tuple[int, int, list[Future]]] = []
    while not work.asked(flags, now)[0]:
        budget.tell(t, h)
        if t == h - 1:
            stretches.append((first, t, now))
            break
        after = work.forward(t + 1, now)
        if work.asked(flags, after)[1]:
            t = min(game.last_alike(t + 1), allowed.last_alike(t) + 1, h - 1)
            if not allowed.everything:
                now = work.again(t, now)
            continue
        stretches.append((first, t, now))
        now, first, t = after, t + 1, t + 1
    ahead: list[Future] | None = None
    swept = 0
    for first, last, sets in reversed(stretches):
        t = last
        while t >= first:
            ahead = work.back(t, sets, ahead)
            swept += 1
            until = t
            if work.asked(all_same, ahead):
                until = max(first, game.first_alike(t + 1) - 1, allowed.first_alike(t))
            if keep is not None:
                recorder.add(work.asked(listed, ahead, until, t))
            budget.tell(until, h, back=True)
            t = until - 1
    parts = work.at_start(ahead)
    entry, certain = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return entry, certain, swept


def _blocks(
    client: Client,
    graph: Graph,
    game: Game,
    arithmetic: Doubles | Fixed,
    goal: int,
    maximize: bool,
    form: Form | None,
    keep: type[np.unsignedinteger] | None,
    n_blocks: int | None,
) -> list[Block]:
    """Blocks of equally many row entries, two for each of the cluster's threads unless asked otherwise."""
    wanted = n_blocks or 2 * sum(client.nthreads().values())
    weight = graph.row_start[graph.choice_start]
    cuts = np.unique(np.searchsorted(weight, np.linspace(0, weight[-1], max(1, wanted) + 1)))
    cuts[0], cuts[-1] = 0, len(graph.states)
    return [
        make_block(
            graph, cuts, number, game.automaton, arithmetic.share, goal=goal, form=form, choices=keep,
            arithmetic=arithmetic, maximize=maximize,
        )
        for number in range(len(cuts) - 1)
    ]  # fmt: skip


class _Work:
    """Tasks of all blocks, step by step."""

    def __init__(self, client: Client, blocks: Sequence[Block], graph: Graph) -> None:
        self._client = client
        self._states = [np.arange(block.first, block.last, dtype=np.int32) for block in blocks]
        owners = [np.unique(np.searchsorted(block.cuts, block.known, side="right") - 1).tolist() for block in blocks]
        self._owners = owners
        self._senders = [[i for i in range(len(blocks)) if number in owners[i]] for number in range(len(blocks))]
        self._needed = [
            {i: block.known[(block.known >= block.cuts[i]) & (block.known < block.cuts[i + 1])] for i in owners[number]}
            for number, block in enumerate(blocks)
        ]
        self._blocks = [self._submit(_itself, block) for block in blocks]

    def _submit(self, task: Any, *given: Any) -> Future:
        return self._client.submit(task, *given, pure=False)

    def begin(self) -> list[Future]:
        return [self._submit(begin, block) for block in self._blocks]

    def again(self, t: int, now: Sequence[Future]) -> list[Future]:
        return [self._submit(again, block, t, mine) for block, mine in zip(self._blocks, now, strict=True)]

    def forward(self, t: int, now: Sequence[Future]) -> list[Future]:
        return [
            self._submit(forward, block, t, now[i], *(self._submit(sent, now[j], i) for j in self._senders[i]))
            for i, block in enumerate(self._blocks)
        ]

    def back(self, t: int, sets: Sequence[Future], ahead: Sequence[Future] | None) -> list[Future]:
        return [self._submit(back, block, t, sets[i], *self._pieces(i, ahead)) for i, block in enumerate(self._blocks)]

    def at_start(self, ahead: Sequence[Future] | None) -> list[tuple[Values, NDArray[np.bool_]]]:
        parts = [self._submit(at_start, block, *self._pieces(i, ahead)) for i, block in enumerate(self._blocks)]
        found: list[tuple[Values, NDArray[np.bool_]]] = self._client.gather(parts)
        return found

    def asked(self, question: Any, results: Sequence[Future], *given: Any) -> Any:
        """The answer to a question about the results of all blocks."""
        return self._submit(question, list(results), *given).result()

    def _pieces(self, i: int, ahead: Sequence[Future] | None) -> list[Future]:
        if ahead is None:
            return []
        return [self._submit(piece, ahead[j], states) for j, states in self._needed[i].items()]


def _itself(block: Block) -> Block:
    return block
