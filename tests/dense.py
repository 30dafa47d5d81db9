"""Backward induction over every state, memory and step, in fractions and without any cleverness: what the engines of
checking/induction are compared with."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from fractions import Fraction

import numpy as np

import stltool as stl
from stltool.automata import TRUE, UNDECIDED
from tests import oracles

Layer = list[list[Fraction]]


def taken(policy: stl.Policy | None, t: int, s: int, q: int, n: int) -> list[tuple[int, Fraction]] | None:
    """The choices of (t, s, q) with their weights, in proportion to the doubles given; None: all, to pick from."""
    if policy is None:
        return None
    entry = policy.row(t)[s, q]
    if policy.deterministic:
        return [(int(entry), Fraction(1))]
    weights = [Fraction(float(w)) for w in entry[:n]]
    return [(i, w / sum(weights)) for i, w in enumerate(weights) if w]


def layers(
    product: stl.Product,
    maximize: bool = True,
    policy: stl.Policy | None = None,
) -> list[Layer]:
    """V_0 … V_h, by V[s][q]: the optimum, or a policy's value."""
    model, automaton, h = product.model, product.automaton, product.horizon
    best = max if maximize else min
    rows = [oracles.choices(model, s) for s in range(model.n_states)]
    found: list[Layer] = [[]] * (h + 1)
    for t in range(h, -1, -1):
        verdicts = automaton.verdicts(t)
        found[t] = [[Fraction(0)] * automaton.n_states for _ in range(model.n_states)]
        for s, q in itertools.product(range(model.n_states), range(automaton.n_states)):
            if verdicts[q] != UNDECIDED:
                found[t][s][q] = Fraction(int(verdicts[q] == TRUE))
                continue
            options = [sum((p * found[t + 1][x][product.enter(x, q)] for x, p in row), Fraction(0)) for row in rows[s]]
            mixture = taken(policy, t, s, q, len(options))
            found[t][s][q] = (
                best(options) if mixture is None else sum((w * options[i] for i, w in mixture), Fraction(0))
            )
    return found


def reached(product: stl.Product, policy: stl.Policy | None = None) -> Iterator[set[tuple[int, int]]]:
    """The undecided pairs (s, q) of steps 0 … h−1 that some run can be in."""
    model, automaton = product.model, product.automaton
    pairs = {(int(s), product.enter(int(s), automaton.initial)) for s in np.flatnonzero(model.initial)}
    for t in range(product.horizon):
        verdicts = automaton.verdicts(t)
        pairs = {(s, q) for s, q in pairs if verdicts[q] == UNDECIDED}
        yield pairs
        after = set()
        for s, q in pairs:
            rows = oracles.choices(model, s)
            mixture = taken(policy, t, s, q, len(rows))
            for i in range(len(rows)) if mixture is None else [i for i, _ in mixture]:
                after |= {(x, product.enter(x, q)) for x, _ in rows[i]}
        pairs = after


def robust_layers(product: stl.Product, maximize: bool, minimal: bool, policy: stl.Policy | None = None) -> list[Layer]:
    """V_0 … V_h where probabilities are intervals and nature minimises or maximises, row by row."""
    model, automaton, h = product.model, product.automaton, product.horizon
    lower, upper = ([Fraction(x) for x in ends.tolist()] for ends in (model.intervals.lower, model.intervals.upper))

    def row_value(c: int, q: int, ahead: Layer) -> Fraction:
        """The mass that must go nowhere in particular goes where nature likes it best."""
        rows = range(*model.row_start[c : c + 2].tolist())
        values = {k: ahead[int(model.target[k])][product.enter(int(model.target[k]), q)] for k in rows}
        total, left = (
            sum((lower[k] * values[k] for k in rows), Fraction(0)),
            1 - sum((lower[k] for k in rows), Fraction(0)),
        )
        for k in sorted(rows, key=lambda k: values[k] if minimal else -values[k]):
            take = min(upper[k] - lower[k], left)
            total, left = total + take * values[k], left - take
        return total

    best = max if maximize else min
    found: list[Layer] = [[]] * (h + 1)
    for t in range(h, -1, -1):
        verdicts = automaton.verdicts(t)
        found[t] = [[Fraction(0)] * automaton.n_states for _ in range(model.n_states)]
        for s, q in itertools.product(range(model.n_states), range(automaton.n_states)):
            if verdicts[q] != UNDECIDED:
                found[t][s][q] = Fraction(int(verdicts[q] == TRUE))
                continue
            options = [row_value(c, q, found[t + 1]) for c in range(*model.choice_start[s : s + 2].tolist())]
            mixture = taken(policy, t, s, q, len(options))
            weighed = () if mixture is None else (w * options[i] for i, w in mixture)
            found[t][s][q] = best(options) if mixture is None else sum(weighed, Fraction(0))
    return found


def at_start(product: stl.Product, found: list[Layer]) -> Fraction:
    """Σ ι(s) V_0(s, δ(L(s), q₀)), with ι as the doubles that it is."""
    model = product.model
    starts = np.flatnonzero(model.initial).tolist()
    return sum(
        (Fraction(float(model.initial[s])) * found[0][s][product.enter(s, product.automaton.initial)] for s in starts),
        Fraction(0),
    )
