"""Slow and obvious twins: everything clever in stltool is compared with these."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np

import stltool as stl
from stltool.errors import TraceError
from stltool.logic.formula import (
    Always,
    And,
    Eventually,
    Historically,
    Iff,
    Implies,
    Interval,
    Not,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
)


def trace_of(model: stl.MDP, states) -> dict:
    """The trace that a sequence of model states shows."""
    states = list(states)
    named = {**model.signals, **model.labels}
    return {name: values[states] for name, values in named.items()}


def holds(model: stl.MDP, phi, states) -> bool:
    return stl.satisfies(phi, trace_of(model, states))


def choices(model: stl.MDP, s: int) -> list[list[tuple[int, Fraction]]]:
    """For every available action of s its successors with exact probabilities."""
    rows, exact = [], model.exact()
    for c in range(model.choice_start[s], model.choice_start[s + 1]):
        entries = range(model.row_start[c], model.row_start[c + 1])
        rows.append([(int(model.target[k]), Fraction(int(exact.numerator[k]), exact.denominator)) for k in entries])
    return rows


def vertices(row: list[tuple[Fraction, Fraction]]) -> list[list[Fraction]]:
    """The corners of { lower <= p <= upper, sum p = 1 }: all entries but one at an end, whatever fits the last."""
    found = []
    for free in range(len(row)):
        others = [ends for i, ends in enumerate(row) if i != free]
        for picks in itertools.product(*others):
            last = 1 - sum(picks, Fraction(0))
            if row[free][0] <= last <= row[free][1]:
                found.append([*picks[:free], last, *picks[free:]])
    return found


def interval_choices(model: stl.MDP, s: int) -> list[tuple[list[int], list[list[Fraction]]]]:
    """For every available action of s its successors, and the corners of nature's polytope."""
    rows = []
    for c in range(model.choice_start[s], model.choice_start[s + 1]):
        entries = range(model.row_start[c], model.row_start[c + 1])
        ends = [(Fraction(float(model.intervals.lower[k])), Fraction(float(model.intervals.upper[k]))) for k in entries]
        rows.append(([int(model.target[k]) for k in entries], vertices(ends)))
    return rows


def robust_optimum(model: stl.MDP, phi, maximize: bool, nature_minimizes: bool) -> Fraction:
    """The game's value by walking the tree of all histories; nature picks a corner at every history and action."""
    best, nature = max if maximize else min, min if nature_minimizes else max
    length = stl.horizon(phi) + 1
    rows = [interval_choices(model, s) for s in range(model.n_states)]

    def value(history: tuple[int, ...]) -> Fraction:
        if len(history) == length:
            return Fraction(holds(model, phi, history))
        options = []
        for targets, corners in rows[history[-1]]:
            after = [value((*history, s2)) for s2 in targets]
            options.append(nature(sum(p * v for p, v in zip(corner, after, strict=True)) for corner in corners))
        return best(options)

    return sum((p * value((s,)) for s, p in initial(model)), Fraction(0))


def robust_policy_value(product: stl.Product, policy: stl.Policy, nature_minimizes: bool) -> Fraction:
    """A policy's value under the least (greatest) nature, by walking all histories."""
    model, phi = product.model, product.formula
    nature = min if nature_minimizes else max
    length = stl.horizon(phi) + 1
    rows = [interval_choices(model, s) for s in range(model.n_states)]

    def value(history: tuple[int, ...], q: int) -> Fraction:
        if len(history) == length:
            return Fraction(holds(model, phi, history))
        s, total = history[-1], Fraction(0)
        entry = policy.row(len(history) - 1)[s, q]
        sure = 1 if policy.deterministic else sum(map(Fraction, entry.tolist()))  # in proportion to the doubles given
        for i, (targets, corners) in enumerate(rows[s]):
            weight = Fraction(int(i == entry)) if policy.deterministic else Fraction(float(entry[i])) / sure
            if weight:
                after = [value((*history, s2), product.enter(s2, q)) for s2 in targets]
                total += weight * nature(sum(p * v for p, v in zip(c, after, strict=True)) for c in corners)
        return total

    start = product.automaton.initial
    return sum((p * value((s,), product.enter(s, start)) for s, p in initial(model)), Fraction(0))


def initial(model: stl.MDP) -> list[tuple[int, Fraction]]:
    exact = model.nominal().exact()
    return [(int(s), exact.initial_share(s)) for s in np.flatnonzero(model.initial)]


def optimum(model: stl.MDP, phi, maximize: bool = True) -> Fraction:
    """The best probability over all history-dependent policies, by walking the tree of all histories."""
    best = max if maximize else min
    length = stl.horizon(phi) + 1

    def value(history: tuple[int, ...]) -> Fraction:
        if len(history) == length:
            return Fraction(holds(model, phi, history))
        return best(sum(p * value((*history, s2)) for s2, p in row) for row in choices(model, history[-1]))

    return sum((p * value((s,)) for s, p in initial(model)), Fraction(0))


def optima(model: stl.MDP, phi) -> tuple[Fraction, Fraction]:
    """The minimum and the maximum, as `optimum` has them, in one walk."""
    length = stl.horizon(phi) + 1
    rows = [choices(model, s) for s in range(model.n_states)]

    def values(history: tuple[int, ...]) -> tuple[Fraction, Fraction]:
        if len(history) == length:
            return (Fraction(holds(model, phi, history)),) * 2
        ahead = {s2: values((*history, s2)) for s2 in {s2 for row in rows[history[-1]] for s2, _ in row}}
        least, greatest = ([sum(p * ahead[s2][end] for s2, p in row) for row in rows[history[-1]]] for end in (0, 1))
        return min(least), max(greatest)

    found = [(p, values((s,))) for s, p in initial(model)]
    least, greatest = (sum((p * value[end] for p, value in found), Fraction(0)) for end in (0, 1))
    return least, greatest


def enumerated_optimum(model: stl.MDP, phi, maximize: bool = True) -> Fraction:
    """The same, literally: every deterministic history-dependent policy, one by one, each evaluated on all traces.

    What it does in histories that begin where no run begins makes no difference.
    """
    length = stl.horizon(phi) + 1
    starts = [s for s, p in initial(model) if p]
    histories = [
        (start, *rest)
        for n in range(length - 1)
        for start in starts
        for rest in itertools.product(range(model.n_states), repeat=n)
    ]
    options = [range(len(choices(model, history[-1]))) for history in histories]
    values = []
    for picks in itertools.product(*options):
        policy = dict(zip(histories, picks, strict=True))
        total = Fraction(0)
        for trace in itertools.product(starts, *[range(model.n_states)] * (length - 1)):
            p = dict(initial(model))[trace[0]]
            for n in range(1, length):
                p *= dict(choices(model, trace[n - 1])[policy[trace[:n]]]).get(trace[n], Fraction(0))
                if p == 0:
                    break
            if p and holds(model, phi, trace):
                total += p
        values.append(total)
    return max(values) if maximize else min(values)


def policy_value(product: stl.Product, policy: stl.Policy) -> Fraction:
    """A policy's probability, by walking all histories; the formula is judged on whole traces."""
    model, phi = product.model, product.formula
    length = stl.horizon(phi) + 1

    def value(history: tuple[int, ...], q: int) -> Fraction:
        if len(history) == length:
            return Fraction(holds(model, phi, history))
        s, t = history[-1], len(history) - 1
        rows = choices(model, s)
        entry = policy.row(t)[s, q]
        if policy.deterministic:
            weights = [Fraction(int(i == entry)) for i in range(len(rows))]
        else:
            weights = [Fraction(float(w)) for w in entry[: len(rows)]]
            weights = [w / sum(weights) for w in weights]  # in proportion to the doubles given
        return sum(
            (
                w * p * value((*history, s2), product.enter(s2, q))
                for w, row in zip(weights, rows, strict=True)
                if w
                for s2, p in row
            ),
            Fraction(0),
        )

    start = product.automaton.initial
    return sum((p * value((s,), product.enter(s, start)) for s, p in initial(model)), Fraction(0))


def chosen(policy, t: int, s: int, q: int, options: list[Fraction]) -> Fraction:
    """What a policy makes of what each choice is worth."""
    entry = policy.row(t)[s, q]
    if policy.deterministic:
        return options[entry]
    weights = [Fraction(float(w)) for w in entry[: len(options)]]
    return sum((w * o for w, o in zip(weights, options, strict=True)), Fraction(0)) / sum(weights)


def outcomes_of(product):
    """The verdicts of all sequences of states that may follow (t, q), whatever the model's transitions: a function."""

    @functools.cache
    def outcomes(t: int, q: int) -> frozenset[int]:
        if (verdict := int(product.automaton.verdicts(t)[q])) >= 0:
            return frozenset({verdict})
        return frozenset().union(*(outcomes(t + 1, product.enter(s, q)) for s in range(product.model.n_states)))

    return outcomes


def expected_cost(product, cost, policy=None, maximize=False, until="verdict") -> Fraction:
    """The expected sum of `cost(s, c, k)`, for state s, choice c and entry k of the rows, by walking all histories.

    A history's verdict is decided as soon as all sequences of states that may follow agree on it.
    """
    model, automaton, best = product.model, product.automaton, max if maximize else min
    exact, outcomes = model.exact(), outcomes_of(product)

    def value(s: int, q: int, t: int) -> Fraction:
        if t == product.horizon or (until == "verdict" and len(outcomes(t, q)) == 1):
            return Fraction(0)
        options = []
        for c in range(model.choice_start[s], model.choice_start[s + 1]):
            total = Fraction(0)
            for k in range(model.row_start[c], model.row_start[c + 1]):
                s2 = int(model.target[k])
                p = Fraction(int(exact.numerator[k]), exact.denominator)
                total += p * (cost(s, c, k) + value(s2, product.enter(s2, q), t + 1))
            options.append(total)
        return best(options) if policy is None else chosen(policy, t, s, q, options)

    start = automaton.initial
    return sum((p * value(s, product.enter(s, start), 0) for s, p in initial(model)), Fraction(0))


def within_budget(product, cost, budget, policy=None, maximize=True) -> Fraction:
    """P(the task holds and the costs until its verdict add up to at most `budget`), by walking all histories.

    `cost(s, c, k)` as in `expected_cost`; the optimum is over policies that know all that happened.
    """
    model, automaton, best = product.model, product.automaton, max if maximize else min
    exact, outcomes = model.exact(), outcomes_of(product)

    def value(s: int, q: int, t: int, spent: Fraction) -> Fraction:
        if len(verdicts := outcomes(t, q)) == 1:
            return Fraction(int(verdicts == {1} and spent <= budget))
        options = []
        for c in range(model.choice_start[s], model.choice_start[s + 1]):
            total = Fraction(0)
            for k in range(model.row_start[c], model.row_start[c + 1]):
                s2 = int(model.target[k])
                p = Fraction(int(exact.numerator[k]), exact.denominator)
                total += p * value(s2, product.enter(s2, q), t + 1, spent + cost(s, c, k))
            options.append(total)
        return best(options) if policy is None else chosen(policy, t, s, q, options)

    start = automaton.initial
    return sum((p * value(s, product.enter(s, start), 0, Fraction(0)) for s, p in initial(model)), Fraction(0))


def layered_value(product: stl.Product, policy: stl.Policy | None = None, maximize: bool = True) -> Fraction:
    """Backward induction on the product, a Fraction a state, as docs/semantics.md §3 writes it."""
    model, automaton = product.model, product.automaton
    rows = [choices(model, s) for s in range(model.n_states)]
    n_q = automaton.n_states

    def decided(t: int, q: int) -> Fraction | None:
        verdict = automaton.verdicts(t)[q]
        return None if verdict < 0 else Fraction(int(verdict))

    values = [[decided(product.horizon, q) for q in range(n_q)] for _ in rows]
    for t in range(product.horizon - 1, -1, -1):
        layer = [[decided(t, q) for q in range(n_q)] for _ in rows]
        for s, q in itertools.product(range(len(rows)), range(n_q)):
            if layer[s][q] is not None:
                continue
            options = [sum(p * values[s2][product.enter(s2, q)] for s2, p in row) for row in rows[s]]
            if policy is None:
                layer[s][q] = max(options) if maximize else min(options)
            elif policy.deterministic:
                layer[s][q] = options[policy.row(t)[s, q]]
            else:
                weights = [Fraction(float(w)) for w in policy.row(t)[s, q]]
                layer[s][q] = sum(w * o for w, o in zip(weights, options, strict=False)) / sum(weights)
        values = layer
    return sum((p * values[s][product.enter(s, automaton.initial)] for s, p in initial(model)), Fraction(0))


def bernstein(product, policy, lower: Fraction, upper: Fraction, maximize: bool = True) -> list[Fraction]:
    """The Bernstein coefficients on [lower, upper] of a policy's P as a function of the model's only parameter; without
    a policy, coefficientwise optima over choices: a Fraction each, by recursion."""
    family, best = product.model.family, max if maximize else min
    (parameter,) = family.parameters
    ends = [choices(family.within(**{parameter.name: (p, p)}).at(**{parameter.name: p}), s)
            for p in (lower, upper) for s in range(family.n_states)]  # fmt: skip
    ends = [ends[: family.n_states], ends[family.n_states :]]

    @functools.cache
    def value(t: int, s: int, q: int) -> tuple[Fraction, ...]:
        verdict = product.automaton.verdicts(t)[q]
        degree = product.horizon - t
        if verdict >= 0:
            return (Fraction(int(verdict)),) * (degree + 1)
        sums = []
        for first, last in zip(ends[0][s], ends[1][s], strict=True):
            found = [Fraction(0)] * (degree + 1)
            for i in range(degree):
                for row, lift, share in ((first, 0, degree - i), (last, 1, i + 1)):
                    for s2, p in row:
                        ahead = value(t + 1, s2, product.enter(s2, q))
                        found[i + lift] += p * ahead[i] * Fraction(share, degree)
            sums.append(found)
        if policy is None:
            return tuple(map(best, zip(*sums, strict=True)))
        entry = policy.row(t)[s, q]
        if policy.deterministic:
            return tuple(sums[entry])
        weights = [Fraction(float(w)) for w in entry[: len(sums)]]
        return tuple(sum(w * c for w, c in zip(weights, column, strict=True)) / sum(weights)
                     for column in zip(*sums, strict=True))  # fmt: skip

    start = product.automaton.initial
    total = [Fraction(0)] * (product.horizon + 1)
    for s, share in initial(family):
        total = [a + share * b for a, b in zip(total, value(0, s, product.enter(s, start)), strict=True)]
    return total


def tied_optimum(model: stl.MDP, phi, maximize: bool, nature_minimizes: bool) -> Fraction:
    """The value of the game in which nature picks the parameter of every row of the tree of all histories."""
    best, nature = max if maximize else min, min if nature_minimizes else max
    length = stl.horizon(phi) + 1
    corners = itertools.product(*((one.lower, one.upper) for one in model.parameters))
    members = [model.at(**dict(zip([one.name for one in model.parameters], corner, strict=True))) for corner in corners]

    def value(history: tuple[int, ...]) -> Fraction:
        if len(history) == length:
            return Fraction(holds(model, phi, history))
        rows = zip(*(choices(member, history[-1]) for member in members), strict=True)
        return best(nature(sum(p * value((*history, s2)) for s2, p in row) for row in ends) for ends in rows)

    return sum((p * value((s,)) for s, p in initial(model)), Fraction(0))


def random_model(rng: np.random.Generator, denominator: int, n_states: int = 3, n_actions: int = 2) -> stl.MDP:
    """A small MDP whose probabilities are fractions over (divisors of) one denominator, with labels A and B."""

    def row() -> list[Fraction]:
        cuts = sorted(int(rng.integers(0, denominator, endpoint=True)) for _ in range(n_states - 1))
        return [Fraction(b - a, denominator) for a, b in itertools.pairwise([0, *cuts, denominator])]

    transitions = np.array([[row() for _ in range(n_states)] for _ in range(n_actions)], dtype=object)
    labels = {name: rng.integers(0, 2, n_states) for name in "AB"}
    return stl.MDP.from_arrays(transitions, {"x": np.arange(n_states)}, np.array(row(), dtype=object), labels)


def corridor(n: int) -> stl.MDP:
    """n cells: only the way right leads to the end, left leads back at once; the third action stays."""
    rows = np.zeros((3, n, n))
    rows[0, :, 0] = rows[1, np.arange(n), np.minimum(np.arange(n) + 1, n - 1)] = 1
    rows[2] = np.eye(n)
    return stl.MDP.from_arrays(rows, {}, labels={"end": np.arange(n) == n - 1})


def achievable(model: stl.MDP, phis, cost=None) -> set[tuple[Fraction, ...]]:
    """(P(φ) for each φ, then the expected cost) of every deterministic history-dependent policy, as a set.

    `cost` (S,) is paid in every state but the last one of the longest horizon.
    """
    length = max(map(stl.horizon, phis)) + 1
    paid = [Fraction(float(c)) for c in cost] if cost is not None else [Fraction(0)] * model.n_states

    def points(history: tuple[int, ...]) -> set[tuple[Fraction, ...]]:
        if len(history) == length:
            held = (Fraction(holds(model, phi, history)) for phi in phis)
            return {(*held, sum((paid[s] for s in history[:-1]), Fraction(0)))}
        return {p for row in choices(model, history[-1]) for p in mixed([(points((*history, s)), w) for s, w in row])}

    def mixed(parts: list[tuple[set[tuple[Fraction, ...]], Fraction]]) -> set[tuple[Fraction, ...]]:
        sums = {(Fraction(0),) * (len(phis) + 1)}
        for part, w in parts:
            sums = {tuple(a + w * b for a, b in zip(x, y, strict=True)) for x in sums for y in part}
        return sums

    found = mixed([(points((s,)), w) for s, w in initial(model)])
    return found if cost is not None else {point[:-1] for point in found}


def best_mixture(points, floor: Fraction) -> Fraction | None:
    """max x over mixtures of points (x, y) with y >= floor: two of them are enough; None where none reaches it."""
    above = [p for p in points if p[1] >= floor]
    values = [x for x, _ in above]
    for x, y in above:
        for u, v in points:
            if v < floor:
                part = (floor - v) / (y - v)
                values.append(part * x + (1 - part) * u)
    return max(values, default=None)


def undominated(points) -> list[tuple[Fraction, Fraction]]:
    """Those which no other one is as good as in both: the only ones that matter in mixtures."""
    found, most = [], None
    for x, y in sorted(points, reverse=True):
        if most is None or y > most:
            found.append((x, y))
            most = y
    return found


def extremum(phi, atom, n: int, end: str, steps) -> list[float]:
    """A formula over a lattice of numbers at some steps of n: `atom` gives the value of a predicate at a step.

    With end "cut" windows hold the steps before n, with "hold" those after n - 1 look like it.
    """

    @functools.cache
    def value(phi, t):
        match phi:
            case Not(arg):
                return -value(arg, t)
            case And(args):
                return min(value(arg, t) for arg in args)
            case Or(args):
                return max(value(arg, t) for arg in args)
            case Implies(left, right):
                return max(-value(left, t), value(right, t))
            case Iff(left, right):
                return min(max(-value(left, t), value(right, t)), max(-value(right, t), value(left, t)))
            case Eventually(interval, arg):
                return max((value(arg, u) for u in window(interval, t)), default=-math.inf)
            case Always(interval, arg):
                return min((value(arg, u) for u in window(interval, t)), default=math.inf)
            case Until(interval, left, right):
                if end == "cut":  # the left operand is met also where no witness is left
                    for v in range(t, n if interval.b is None else min(t + interval.b, n)):
                        value(left, v)
                witnesses = ([value(right, u)] + [value(left, v) for v in range(t, u)] for u in window(interval, t))
                return max(map(min, witnesses), default=-math.inf)
            case Release(interval, left, right):
                return -value(Until(interval, Not(left), Not(right)), t)
            case Once(interval, arg):
                return max((value(arg, u) for u in earlier(interval, t)), default=-math.inf)
            case Historically(interval, arg):
                return min((value(arg, u) for u in earlier(interval, t)), default=math.inf)
            case Since(interval, left, right):
                steps = earlier(interval, t)
                witnesses = ([value(right, u)] + [value(left, v) for v in range(u + 1, t + 1)] for u in steps)
                return max(map(min, witnesses), default=-math.inf)
            case Trigger(interval, left, right):
                return -value(Since(interval, Not(left), Not(right)), t)
            case Rise(arg):
                return min(value(arg, t), -value(Once(Interval(1, 1), arg), t))
            case _:
                return atom(phi, t) if t < n else value(phi, n - 1)

    def window(interval, t):
        last = interval.b if interval.b is not None else interval.a + n + 20  # held samples have settled by then
        return range(t + interval.a, min(t + last, n - 1 if end == "cut" else t + last) + 1)

    def earlier(interval, t):
        return range(0 if interval.b is None else max(t - interval.b, 0), t - interval.a + 1)

    return [value(phi, t) for t in steps]


def judged_to_the_end(phi, trace: dict, end: str, steps) -> list[tuple[bool | None, float | None]]:
    """Truth and robustness at steps of a trace whose windows are cut at its end, or whose last sample is held.

    Truth is None where it hangs on what has no value, robustness where it meets such a value.
    """

    def sample(t):
        return {name: values[t : t + 1] for name, values in trace.items()}

    def truth(psi, t):
        try:
            return 1 if stl.satisfies(psi, sample(t)) else -1
        except TraceError:
            return 0

    def margin(psi, t):
        return stl.robustness(psi, sample(t))

    n = len(next(iter(trace.values())))
    margins = []
    for t in steps:
        try:
            margins += extremum(phi, margin, n, end, [t])
        except TraceError:
            margins.append(None)
    truths = [None if v == 0 else v > 0 for v in extremum(phi, truth, n, end, steps)]
    return list(zip(truths, margins, strict=True))


def moore_partition(delta, outputs) -> list[int]:
    """Classes of states by output, then by their successors' classes, until nothing changes; numbered as they come."""

    def numbered(keys):
        known = {}
        return [known.setdefault(key, len(known)) for key in keys]

    classes = numbered(tuple(o) if isinstance(o, list) else o for o in outputs)
    while True:
        finer = numbered((c, *(classes[row[q]] for row in delta)) for q, c in enumerate(classes))
        if finer == classes:
            return classes
        classes = finer


def least_cause(phi, trace: dict, t: int, end: str, values: dict) -> tuple[dict, Callable[[dict], bool]]:
    """The colex-least cause of a verdict among all traces over `values`, and whether given samples are a cause.

    Samples are `{name: [steps]}`. One after another, the latest first, they are left out if the verdict stays.
    """
    names, n = sorted(trace), len(next(iter(trace.values())))
    grids = [values[name] for name in names for _ in range(n)]
    every = np.array(list(itertools.product(*grids)), dtype=float).reshape(-1, len(names), n)
    verdicts = stl.monitor(phi, {name: every[:, i] for i, name in enumerate(names)}, end, "boolean").verdicts[:, t]
    agrees = [every[:, i] == np.asarray(trace[name], dtype=float) for i, name in enumerate(names)]
    wanted = stl.monitor(phi, trace, end, "boolean").verdicts[t]

    def forces(samples: dict) -> bool:
        same = np.ones(len(every), dtype=bool)
        for i, name in enumerate(names):
            same &= agrees[i][:, samples.get(name, [])].all(axis=1)
        return bool((verdicts[same] == wanted).all())

    kept = {name: list(range(n)) for name in names}
    for step, name in itertools.product(reversed(range(n)), reversed(names)):
        less = kept | {name: [other for other in kept[name] if other != step]}
        kept = less if forces(less) else kept
    return kept, forces


def robustness_shares(product: stl.Product, policy: stl.Policy, phi) -> dict[float, Fraction]:
    """P(ρ = value) under a deterministic policy over `product`, by walking all histories of φ."""
    return history_shares(product, policy, stl.horizon(phi) + 1, lambda trace: stl.robustness(phi, trace))


def history_shares(product: stl.Product, policy: stl.Policy, length: int, worth) -> dict[float, Fraction]:
    """The same of worth(trace), over traces of so many samples."""
    model = product.model
    shares: dict[float, Fraction] = {}

    def walk(history: tuple[int, ...], q: int, p: Fraction) -> None:
        if len(history) == length:
            value = worth(trace_of(model, history))
            shares[value] = shares.get(value, Fraction(0)) + p
            return
        choice = policy.row(len(history) - 1)[history[-1], q]
        for s2, p2 in choices(model, history[-1])[choice]:
            walk((*history, s2), product.enter(s2, q), p * p2)

    for s, p in initial(model):
        walk((s,), product.enter(s, product.automaton.initial), p)
    return shares


def robustness_optimum(model: stl.MDP, phi, worth, maximize: bool = True) -> Fraction:
    """The greatest (least) mean of worth(ρ) over all history-dependent policies, by walking all histories."""
    length = stl.horizon(phi) + 1
    return history_optimum(model, length, lambda trace: worth(stl.robustness(phi, trace)), maximize)


def history_optimum(model: stl.MDP, length: int, worth, maximize: bool = True) -> Fraction:
    """The same of worth(trace), over traces of so many samples."""
    best = max if maximize else min

    def value(history: tuple[int, ...]) -> Fraction:
        if len(history) == length:
            return Fraction(worth(trace_of(model, history)))
        return best(sum(p * value((*history, s2)) for s2, p in row) for row in choices(model, history[-1]))

    return sum((p * value((s,)) for s, p in initial(model)), Fraction(0))
