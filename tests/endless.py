"""Slow and obvious twins of `long_run`: policies of the last h + 1 states, one by one, each chain in fractions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from fractions import Fraction

import numpy as np

import stltool as stl
from tests import oracles

Buffer = tuple[int, ...]
Chain = dict[object, dict[object, Fraction]]

QUESTIONS = ("share", "always", "recurrence", "persistence")


def values(model: stl.MDP, phi, most: int = 256) -> Iterator[dict[str, Fraction]] | None:
    """What each deterministic policy of the last h + 1 states is worth, question by question; None if they are too
    many. φ does not look back."""
    keep = stl.horizon(phi) + 1
    moves = [oracles.choices(model, s) for s in range(model.n_states)]
    buffers, waiting = set(), [(s,) for s, _ in oracles.initial(model)]
    while waiting:
        buffer = waiting.pop()
        if buffer not in buffers:
            buffers.add(buffer)
            waiting += [(*buffer, s)[-keep:] for row in moves[buffer[-1]] for s, _ in row]
    ordered = sorted(buffers)
    options = [range(len(moves[buffer[-1]])) for buffer in ordered]
    if math.prod(map(len, options)) > most:
        return None
    held = {b: len(b) < keep or oracles.holds(model, phi, b) for b in ordered}
    return (of_chain(_chain(moves, ordered, picks, keep), held, _first(model)) for picks in itertools.product(*options))


def _chain(moves, ordered, picks, keep) -> Chain:
    chain: Chain = {}
    for buffer, k in zip(ordered, picks, strict=True):
        row = chain.setdefault(buffer, {})
        for s, p in moves[buffer[-1]][k]:
            after = (*buffer, s)[-keep:]
            row[after] = row.get(after, Fraction(0)) + p
    return chain


def _first(model) -> dict[object, Fraction]:
    return {(s,): p for s, p in oracles.initial(model)}


def of_policy(product: stl.Product, policy: stl.Policy) -> dict[str, Fraction]:
    """What a stationary policy on a running product, or on one for safety ("always"), is worth."""
    automaton, exact = product.automaton, [oracles.choices(product.model, s) for s in range(product.model.n_states)]
    table = policy.row(0)
    first = {(s, product.enter(s, automaton.initial)): p for s, p in oracles.initial(product.model)}
    chain: Chain = {}
    waiting = list(first)
    while waiting:
        s, q = waiting.pop()
        if (s, q) in chain:
            continue
        entry = table[s, q]
        weights = (
            {int(entry): Fraction(1)}
            if policy.deterministic
            else {k: Fraction(w) for k, w in enumerate(entry.tolist())}
        )
        row = chain[s, q] = {}
        for k, w in weights.items():
            for s2, p in exact[s][k] if w else ():
                after = s2, product.enter(s2, q)
                row[after] = row.get(after, Fraction(0)) + p * w / sum(weights.values())
        waiting += row
    held = {(s, q): automaton.verdicts(product.horizon)[q] == 1 for s, q in chain}
    return of_chain(chain, held, first)


def of_chain(chain: Chain, held: dict[object, bool], first: dict[object, Fraction]) -> dict[str, Fraction]:
    """The four values of a Markov chain."""
    reach = {i: reachable(chain, i) for i in chain}
    found = dict.fromkeys(QUESTIONS, Fraction(0))
    for members in {frozenset(reach[i]) for i in chain if all(i in reach[j] for j in reach[i])}:
        arrived = arriving(chain, members, first)
        found["share"] += arrived * sum(p for i, p in stationary(chain, sorted(members)).items() if held[i])
        found["recurrence"] += arrived * any(held[i] for i in members)
        found["persistence"] += arrived * all(held[i] for i in members)
    stuck = {i: row if held[i] else {i: Fraction(1)} for i, row in chain.items()}
    failing = frozenset(i for i in stuck if not held[i])
    found["always"] = 1 - arriving(stuck, failing, first)
    return found


def reachable(chain: Chain, start: object) -> set[object]:
    seen, waiting = {start}, [start]
    while waiting:
        for j in chain[waiting.pop()]:
            if j not in seen:
                seen.add(j)
                waiting.append(j)
    return seen


def arriving(chain: Chain, goal: frozenset[object], first: dict[object, Fraction]) -> Fraction:
    """The probability of ever being in `goal`."""
    able = [i for i in chain if i not in goal and goal & reachable(chain, i)]
    rows = [[Fraction(int(i == j)) - chain[i].get(j, Fraction(0)) for j in able] for i in able]
    x = solve(rows, [sum((p for j, p in chain[i].items() if j in goal), Fraction(0)) for i in able])
    worth = {**dict.fromkeys(goal, Fraction(1)), **dict(zip(able, x, strict=True))}
    return sum((p * worth.get(i, Fraction(0)) for i, p in first.items()), Fraction(0))


def stationary(chain: Chain, members: list[object]) -> dict[object, Fraction]:
    """The stationary distribution of a closed class."""
    rows = [[chain[i].get(j, Fraction(0)) - Fraction(int(i == j)) for i in members] for j in members[:-1]]
    x = solve([*rows, [Fraction(1)] * len(members)], [Fraction(0)] * (len(members) - 1) + [Fraction(1)])
    return dict(zip(members, x, strict=True))


def solve(rows: list[list[Fraction]], side: list[Fraction]) -> list[Fraction]:
    """Gauss–Jordan elimination."""
    n, table = len(rows), [[*row, b] for row, b in zip(rows, side, strict=True)]
    for i in range(n):
        pivot = next(k for k in range(i, n) if table[k][i])
        table[i], table[pivot] = table[pivot], table[i]
        table[i] = [x / table[i][i] for x in table[i]]
        for k in range(n):
            if k != i and table[k][i]:
                table[k] = [x - table[k][i] * y for x, y in zip(table[k], table[i], strict=True)]
    return [row[n] for row in table]


def simulated(model: stl.MDP, product: stl.Product, policy: stl.Policy, steps: int, rng: np.random.Generator) -> float:
    """The share of the steps at which the task holds, along one run."""
    s = int(rng.choice(model.n_states, p=model.initial))
    q, table, count = product.enter(s, product.automaton.initial), policy.row(0), 0
    held = product.automaton.verdicts(product.horizon) == 1
    for _ in range(steps):
        c = model.choice_start[s] + table[s, q]
        a, b = model.row_start[c], model.row_start[c + 1]
        s = int(rng.choice(model.target[a:b], p=model.probability[a:b] / model.probability[a:b].sum()))
        q = product.enter(s, q)
        count += bool(held[q])
    return count / steps
