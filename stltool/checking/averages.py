"""The greatest total and the greatest average of rewards in a graph, enclosed, or as fractions.

Choices are rows of a substochastic matrix A (m, n), those of vertex i numbered start[i] … start[i+1]−1.

    total     x = max_a (b_a + A_a x), where every policy ends with probability 1
    average   g + v = r + max_a A_a v, in a graph that is one end component: g is the same everywhere

Both are found by policy iteration [Puterman94, §7.2, §8.6 and §9.2]; averages begin with value iteration. What it ends
with is then *proved*, whatever rounding did:

    total     V ≥ x − max(x − b_π − A_π x)·y for the policy π, with y ≥ 1 + A_π y, its steps to the end;
              V ≤ x + ε y if b_a + A_a (x + ε y) ≤ x + ε y for every choice: ε is what the choices near the best exceed
              x by, and y ≥ 1 + A_a y for these; all others are so much worse that it does not matter to them
    average   min(T v − v) ≤ g ≤ max(T v − v) for every v [Puterman94, §8.5]

with T computed once, whose rounding errors are bounded in advance. Fractions need no proof: policy iteration ends where
no choice is better, and there the equations above hold. It ends: a policy of several recurrent classes has one whose
average is greater than before, or else only what is passed through was improved.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.errors import SizeError

I64: TypeAlias = NDArray[np.int64]
Floats: TypeAlias = NDArray[np.float64]
Row: TypeAlias = list[tuple[int, Fraction]]
"""The successors of a choice, with their probabilities."""

_SWEEPS = 2_000  # of value iteration
_LOOK = 20  # sweeps between two looks at its bounds
_ROUNDS = 300  # of policy iteration in doubles
_NARROWER, _STALLED = 0.9, 10  # rounds that narrow an average's bounds by less are rounding, after so many
_NARROW_AVERAGE = 1e-12  # width of bounds that need no further round
_TIGHT = 1e-13  # width of an average's bounds that needs no improvement
_BETTER = 1e-12  # smaller improvements are rounding
_MOST_SOLVED = 200_000  # unknowns of a sparse system in doubles
MOST_EXACT = 5_000  # unknowns in fractions
_NEAR = (1e-9, 1e-12, 1e-6, 1e-3, 2.0)  # how much worse than the best the choices may be that an upper bound follows
_NARROW = 1e-10  # bounds that need no further attempt
_UP = 1 + 1e-12  # what rounding in the bounds themselves may be
_U = 2.0**-53


@dataclass(frozen=True, eq=False)
class Game:
    """Choices as rows: A (m, n), the first choice of each vertex (n + 1,), the most entries that a row was summed from,
    and what it may lack of its sum."""

    matrix: Any
    start: I64
    longest: int
    defect: float

    @property
    def n(self) -> int:
        return len(self.start) - 1

    @cached_property
    def owner(self) -> I64:
        """(m,) the vertex of each choice."""
        return np.repeat(np.arange(self.n), np.diff(self.start))

    def only(self, choices: I64) -> Game:
        """The same with some of the choices, at least one for each vertex."""
        start = np.searchsorted(self.owner[choices], np.arange(self.n + 1))
        return Game(self.matrix[choices], start, self.longest, self.defect)

    def best(self, value: Floats) -> Floats:
        """The greatest value of a vertex's choices."""
        found: Floats = np.maximum.reduceat(value, self.start[:-1])
        return found

    def first_best(self, value: Floats) -> I64:
        """The first choice of each vertex that has the greatest value."""
        among = np.flatnonzero(value == self.best(value)[self.owner])
        found = np.empty(self.n, dtype=np.int64)
        found[self.owner[among][::-1]] = among[::-1]
        return found

    def slack(self, most: float) -> float:
        """A bound on the error of a row times a vector of numbers up to `most`, plus two more."""
        return (4 * (self.longest + 8) * _U + self.defect) * (most + 1)


# ------------------------------------------------------------------------------------------------------ totals


@dataclass(frozen=True, eq=False)
class Total:
    """x, its choices (n,), and what the exact total may be below and above it, (n,) each."""

    x: Floats
    picks: I64
    below: Floats
    above: Floats


def greatest_total(game: Game, base: Floats, picks: I64) -> Total:
    """The greatest total, from a policy to begin with; `base` (m,) is what each choice pays, 0 … 1 along any run."""
    x, picks = _improved_total(game, base, picks)
    unknown = np.ones(game.n)
    if not np.isfinite(x).all():
        return Total(np.clip(np.nan_to_num(x), 0, 1), picks, unknown, unknown)
    x = np.clip(x, 0, 1)
    value, slack = base + game.matrix @ x, game.slack(1.0)
    alone = game.only(picks)
    below = above = unknown
    if (steps := _steps(alone, np.arange(game.n))) is not None:
        below = max(float((x - value[picks]).max()) + slack, 0.0) * steps
    owner, chosen = game.owner, np.zeros(len(value), dtype=np.bool_)
    chosen[picks] = True
    for near in _NEAR:
        kept = np.flatnonzero(chosen | (value >= x[owner] - near))
        some = game.only(kept)
        steps = _steps(some, some.first_best(chosen[kept].astype(np.float64)))
        if steps is None:
            continue
        missing = max(float((value[kept] - x[owner[kept]]).max()) + slack, 0.0)
        worse = value - x[owner] + slack + missing * (game.matrix @ steps * _UP - steps[owner] / _UP)
        worse[kept] = 0.0
        if (worse <= 0).all() and missing * float(steps.max()) < float(above.max()):
            above = missing * steps
            if float(above.max()) < _NARROW:
                break
    return Total(x, picks, below * _UP, above * _UP)


def _steps(game: Game, picks: I64) -> Floats | None:
    """y ≥ 1 + max_a A_a y, the steps to the end whatever is chosen, close to the least; None if they are too many."""
    steps, _ = _improved_total(game, np.ones(len(game.owner)), picks)
    if not np.isfinite(steps).all() or steps.min() < 0.5:
        return None
    short = float((1 + game.best(game.matrix @ steps) - steps).max()) + game.slack(float(steps.max()))
    return steps / (1 - short) * _UP if 0 <= short < 0.5 else None


def _improved_total(game: Game, base: Floats, picks: I64) -> tuple[Floats, I64]:
    """Policy iteration in doubles."""
    from scipy.sparse import identity
    from scipy.sparse.linalg import splu

    if game.n > _MOST_SOLVED:
        raise SizeError(f"equations in {game.n} unknowns are too many; shorten the windows, or coarsen the grid")
    for _ in range(_ROUNDS):
        x = splu((identity(game.n, format="csc") - game.matrix[picks].tocsc()).tocsc()).solve(base[picks])
        value = base + game.matrix @ x
        better = game.best(value) > value[picks] + _BETTER * (1 + abs(x).max())
        if not better.any():
            break
        picks = np.where(better, game.first_best(value), picks)
    return x, picks


def exact_total(
    rows: Sequence[Sequence[Row]], base: Sequence[Sequence[Fraction]], picks: Sequence[int]
) -> tuple[list[Fraction], list[int]]:
    """The same in fractions: rows[i][k] and base[i][k] are those of choice k of vertex i."""
    picks = list(picks)
    while True:
        chain = [rows[i][k] for i, k in enumerate(picks)]
        [x] = solved(chain, [[base[i][k] for i, k in enumerate(picks)]])
        if not _improve(rows, base, x, picks, x):
            return x, picks


def _improve(
    rows: Sequence[Sequence[Row]],
    base: Sequence[Sequence[Fraction]],
    x: Sequence[Fraction],
    picks: list[int],
    now: Sequence[Fraction],
) -> bool:
    """Take the best choice where it is better than `now`; whether it is anywhere."""
    changed = False
    for i, choices in enumerate(rows):
        values = [base[i][k] + sum((p * x[j] for j, p in row), Fraction(0)) for k, row in enumerate(choices)]
        best = max(range(len(values)), key=values.__getitem__)
        if values[best] > now[i]:
            picks[i], changed = best, True
    return changed


# ---------------------------------------------------------------------------------------------------- averages


def greatest_average(game: Game, reward: Floats) -> tuple[float, float, I64]:
    """Bounds on the greatest average in an end component, and the choices (n,) of a policy that attains it, up to
    rounding; `reward` (n,) is between 0 and 1."""
    lower, upper, width, best_v = 0.0, 1.0, np.inf, np.zeros(game.n)
    owner = game.owner

    def look(v: Floats, ahead: Floats) -> float:
        nonlocal lower, upper, width, best_v
        rise = reward + ahead - v
        slack = game.slack(float(v.max()))
        least, most = float(rise.min()) - slack, float(rise.max()) + slack
        if most - least < width:
            width, best_v = most - least, v
        lower, upper = max(lower, least), min(upper, most)
        return most - least

    v = np.zeros(game.n)
    for sweep in range(_SWEEPS):
        ahead = game.best(game.matrix @ v)
        if sweep % _LOOK == 0 and look(v, ahead) < _TIGHT:
            break
        v = (v + reward + ahead) / 2  # half of the steps stay: no period
        v -= v.min()
    picks = game.first_best(game.matrix @ best_v)
    if game.n > _MOST_SOLVED:
        return lower, upper, picks
    best_picks, stalled, narrowest = picks, 0, np.inf
    for _ in range(_ROUNDS):
        picks, reference = _one_class(game, reward, picks)
        gain, v = _bias(game.matrix[picks], reward, reference)
        value = reward[owner] + game.matrix @ v
        better = game.best(value) > value[picks] + _BETTER * (1 + abs(v).max())
        shifted = v - v.min()
        now = max(look(shifted, game.best(game.matrix @ shifted)), upper - gain)  # what the policy may lack, too
        stalled = 0 if now < _NARROWER * narrowest else stalled + 1
        if now < narrowest:
            narrowest, best_picks = now, picks
        if not better.any() or now < _NARROW_AVERAGE or stalled > _STALLED:
            break
        picks = np.where(better, game.first_best(value), picks)
    return lower, upper, best_picks


def recurrent_classes(matrix: Any) -> list[I64]:
    """The closed classes of a Markov chain, each as its vertices, ascending."""
    from scipy.sparse.csgraph import connected_components

    count, of = connected_components(matrix, directed=True, connection="strong")
    edges = matrix.tocoo()
    is_closed = np.ones(count, dtype=np.bool_)
    is_closed[of[edges.row[of[edges.row] != of[edges.col]]]] = False
    order = np.argsort(of, kind="stable")
    bounds = np.searchsorted(of[order], np.arange(count + 1))
    return [order[bounds[c] : bounds[c + 1]] for c in np.flatnonzero(is_closed).tolist()]


def _one_class(game: Game, reward: Floats, picks: I64) -> tuple[I64, int]:
    """The policy with one recurrent class only, its best, to which all else leads; and a vertex of that class."""
    chain = game.matrix[picks]
    classes = recurrent_classes(chain)
    if len(classes) == 1:
        return picks, int(classes[0][0])
    gains = [_bias(chain[c][:, c], reward[c], 0)[0] for c in classes]
    best = classes[int(np.argmax(gains))]
    return lead_to(game.matrix, game.start, best, picks), int(best[0])


def lead_to(matrix: Any, start: I64, goal: I64, picks: I64) -> I64:
    """The choices with those elsewhere replaced by some that lead to `goal` with probability 1."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order

    n = len(start) - 1
    owner = np.repeat(np.arange(n), np.diff(start))
    edges = matrix.tocoo()
    before = np.concatenate([edges.col, np.full(len(goal), n)])
    after = np.concatenate([owner[edges.row], goal])
    inside = np.zeros(n, dtype=np.bool_)
    inside[goal] = True
    kept = (before == n) | ~inside[after]
    reverse = coo_array((np.ones(kept.sum(), dtype=np.int8), (before[kept], after[kept])), shape=(n + 1, n + 1))
    _, nearer = breadth_first_order(reverse.tocsr(), n, directed=True, return_predecessors=True)
    found = picks.copy()
    steps = ~inside[owner[edges.row]] & (edges.col == nearer[owner[edges.row]])
    found[owner[edges.row[steps]][::-1]] = edges.row[steps][::-1]
    return found


def _bias(chain: Any, reward: Floats, reference: int) -> tuple[float, Floats]:
    """Average and bias of a chain with one recurrent class, which contains `reference`; its bias is 0."""
    from scipy.sparse import identity
    from scipy.sparse.linalg import splu

    n = chain.shape[0]
    others = np.flatnonzero(np.arange(n) != reference)
    back = chain.tocsr()[[reference]][:, others]
    v = np.zeros(n)
    if not len(others):
        return float(reward[reference]), v
    system = splu((identity(n - 1, format="csc") - chain.tocsc()[others][:, others].tocsc()).tocsc())
    earned, passed = system.solve(reward[others]), system.solve(np.ones(n - 1))
    gain = float((reward[reference] + (back @ earned)[0]) / (1 + (back @ passed)[0]))
    v[others] = earned - gain * passed
    return gain, v


def exact_average(
    rows: Sequence[Sequence[Row]], reward: Sequence[Fraction], picks: Sequence[int]
) -> tuple[Fraction, list[int]]:
    """The greatest average in an end component, as a fraction, and choices that attain it."""
    from scipy.sparse import csr_array

    now, n = list(picks), len(rows)
    base = [[reward[i]] * len(choices) for i, choices in enumerate(rows)]
    start = np.cumsum([0] + [len(choices) for choices in rows])
    flat = [(c, j) for c, row in enumerate(row for choices in rows for row in choices) for j, _ in row]
    where = np.array(flat).T
    matrix = csr_array((np.ones(len(flat), dtype=np.int8), (where[0], where[1])), shape=(int(start[-1]), n))
    while True:
        chosen = start[:-1] + np.array(now)
        classes = recurrent_classes(matrix[chosen])
        if len(classes) > 1:
            gains = [_exact_bias([rows[i][now[i]] for i in c], reward, c.tolist())[0] for c in classes]
            best = classes[max(range(len(gains)), key=gains.__getitem__)]
            now = (lead_to(matrix, start, best, chosen) - start[:-1]).tolist()
        else:
            best = classes[0]
        order = [int(best[0]), *(i for i in range(n) if i != best[0])]
        gain, bias = _exact_bias([rows[i][now[i]] for i in order], reward, order)
        v = [bias[i] for i in range(n)]
        if not _improve(rows, base, v, now, [gain + one for one in v]):
            return gain, now


def _exact_bias(
    chain: Sequence[Row], reward: Sequence[Fraction], order: Sequence[int]
) -> tuple[Fraction, dict[int, Fraction]]:
    """As `_bias`, of the chain over the vertices `order`, the first of which is the reference."""
    number = {vertex: i for i, vertex in enumerate(order)}
    local = [[(number[j] - 1, p) for j, p in row if number[j]] for row in chain]
    one = [Fraction(1)] * (len(order) - 1)
    earned, passed = solved(local[1:], [[reward[i] for i in order[1:]], one])
    top = reward[order[0]] + sum((p * earned[j] for j, p in local[0]), Fraction(0))
    gain = top / (1 + sum((p * passed[j] for j, p in local[0]), Fraction(0)))
    v = {vertex: earned[i] - gain * passed[i] for i, vertex in enumerate(order[1:])}
    return gain, {order[0]: Fraction(0), **v}


def solved(chain: Sequence[Row], sides: Sequence[Sequence[Fraction]]) -> list[list[Fraction]]:
    """The solutions of (I − P) x = b for each side b, in fractions; from every vertex, P must lead out at last.

    Vertices are eliminated one by one, the one with the fewest neighbours first: x_i (1 − P_ii) = b_i + Σ P_ij x_j.
    """
    n = len(chain)
    if n > MOST_EXACT:
        raise SizeError(
            f"equations in {n} unknowns are too many for fractions (at most {MOST_EXACT}); shorten the windows, or use "
            "the enclosure, without exact"
        )
    after: list[dict[int, Fraction]] = [{} for _ in range(n)]
    before: list[set[int]] = [set() for _ in range(n)]
    for i, row in enumerate(chain):
        for j, p in row:
            after[i][j] = after[i].get(j, Fraction(0)) + p
            before[j].add(i)
    known = [list(side) for side in sides]
    order: list[int] = []
    done = [False] * n
    waiting = [(len(before[i]) * len(after[i]), i) for i in range(n)]
    heapq.heapify(waiting)
    while waiting:
        cost, i = heapq.heappop(waiting)
        now = len(before[i]) * len(after[i])
        if done[i] or now > cost:  # it is listed again where it has become dearer
            if not done[i]:
                heapq.heappush(waiting, (now, i))
            continue
        done[i] = True
        order.append(i)
        stay = 1 - after[i].pop(i, Fraction(0))
        before[i].discard(i)
        if stay != 1:
            after[i] = {j: p / stay for j, p in after[i].items()}
            for side in known:
                side[i] /= stay
        for j in after[i]:
            before[j].discard(i)
        for k in before[i]:
            p = after[k].pop(i)
            for j, share in after[i].items():
                after[k][j] = after[k].get(j, Fraction(0)) + p * share
                before[j].add(k)
            for side in known:
                side[k] += p * side[i]
    for i in reversed(order):
        for side in known:
            side[i] += sum((p * side[j] for j, p in after[i].items()), Fraction(0))
    return known
