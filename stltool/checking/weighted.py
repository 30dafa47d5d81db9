"""The best weighted sum of several criteria over all policies, and the criteria of one policy, by backward induction.

Criteria of a joint product: P(Φ_i) of each task, and for each cost signal g what is saved of the most it could be,

    S_g = h·ḡ − E Σ_{t<h} g(s_t),   ḡ = max_s g(s),

a sum of nonnegative terms too. A cost is paid in every state s₀ … s_{h−1} in which an action is taken, up to the
longest horizon h of the tasks, whether or not verdicts have fallen before. With weights w ≥ 0, over layers (t, s, q):

    V_t(s,q)   = Σ_g w_g (ḡ − g(s)) + opt_c Σ_s' P(s'|c) W_t(s',q)
    W_t(s',q)  = Σ_i w_i·1{Φ_i falls true on reading s'} + V_{t+1}(s', δ_t(L(s'), q))

after h sweeps. No term is negative, so the a-priori enclosure of bounds.py holds; defects count as often as the largest
sum to come. Source: the weighted reward of [Etessami08], over a finite horizon.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.checking.backward import Floats, Progress
from stltool.checking.bounds import around, can_underflow, compounded, defect, model_defects, roundings
from stltool.errors import NameLookupError, SettingsError, near_misses
from stltool.models import MDP
from stltool.models.rows import least_positive
from stltool.numbers import round_down, round_up
from stltool.product import JointProduct
from stltool.sizes import Numbers, require_memory, require_time

Choices: TypeAlias = list[Numbers]
"""(S, n_t) for each step t < h: the choice's number within its state."""

Weights: TypeAlias = list[Floats]
"""(S, n_t, C) for each step t < h: the probability of each choice."""

_LARGEST_COST = 1e100  # over the horizon
_RATE = 5e8  # multiply-adds a second, roughly, on one core


@dataclass(frozen=True)
class Figure:
    """A computed value with lower ≤ exact value ≤ upper, rounding included, for the model as given."""

    value: float
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class Criteria:
    """What is traded off: the tasks of a joint product, then costs by their signals' (or labels') names.

    Raises NameLookupError for a cost that the model does not have, SettingsError for one that is negative somewhere,
    SizeError before allocating layers that would not fit.
    """

    joint: JointProduct
    costs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self.joint.model.require_points()
        for name in self.costs:
            most = float(cost_values(self.joint.model, name).max())
            if most * self.joint.horizon > _LARGEST_COST:
                raise SettingsError(f"cost {name} is up to {most:g} a step; scale the signal to numbers below 1e9")
        S, horizon = self.joint.model.n_states, self.joint.horizon
        itemsize = np.dtype(self.joint.model.choice_type).itemsize
        widest = max(len(layer.states) for layer in self.joint.automaton.layers)
        require_memory(
            8 * 3 * len(self) * S * widest + itemsize * S * self.joint.automaton.n_states,
            f"sweeping {S} model states × up to {widest} joint automaton states",
            "shorten the windows",
        )
        require_time(
            len(self) * self.joint.model.n_transitions * self.joint.automaton.n_states,
            _RATE,
            f"sweeping {horizon} layers of up to {widest} joint automaton states",
            "shorten the windows",
        )

    def __len__(self) -> int:
        return len(self.joint.tasks) + len(self.costs)

    @cached_property
    def defects(self) -> tuple[Fraction, Fraction]:
        """Of a row, and of the initial distribution."""
        return model_defects(self.joint.model)

    @property
    def most_saved(self) -> list[Fraction]:
        """h·ḡ of each cost, exactly."""
        model = self.joint.model
        return [Fraction(float(cost_values(model, name).max())) * self.joint.horizon for name in self.costs]

    def savings(self) -> Floats:
        """(K, S): ḡ − g(s)."""
        rows = [cost_values(self.joint.model, name) for name in self.costs]
        return np.array([row.max() - row for row in rows]).reshape(len(rows), self.joint.model.n_states)


def cost_values(model: MDP, name: str) -> Floats:
    """(S,) the cost of a step in each state: a signal's values, or 1 where a label holds."""
    if name in model.labels:
        return model.labels[name].astype(np.float64)
    if name not in model.signals:
        raise NameLookupError(
            f"the model has no signal {name} to be a cost; {near_misses(name, [*model.signals, *model.labels])}"
        )
    values = model.signals[name]
    if (values < 0).any():
        s = int(values.argmin())
        raise SettingsError(
            f"signal {name} is {values[s]:g} in state {model.state_name(s)}; a cost is at least 0: "
            "give the model a signal that is shifted"
        )
    return values


def best(
    criteria: Criteria, weights: Sequence[float], progress: Progress | None = None
) -> tuple[Figure, list[Figure], Choices]:
    """max over all policies of Σ w_i·criterion_i, the criteria of a policy that attains it, and its choices."""
    joint, n = criteria.joint, len(criteria)
    rows, S = _rows(joint.model), joint.model.n_states
    from stltool.kernels import sweep as kernels

    chosen: Choices = []

    def sweep(t: int, W: Floats, out: Floats) -> None:
        choice = np.zeros(W.shape[1:], dtype=joint.model.choice_type)
        kernels.optimum(*rows, W[0], True, 0, S, out[0], choice)
        for i in range(1, n + 1):
            kernels.policy(*rows, W[i], choice, 0, S, out[i])
        chosen.append(choice)

    given = np.vstack([np.asarray(weights, dtype=np.float64), np.eye(n)])
    values = _induct(criteria, given, sweep, progress)
    figures = [_figure(criteria, row, value) for row, value in zip(given, values, strict=True)]
    return figures[0], figures[1:], chosen[::-1]


def of_policy(criteria: Criteria, policy: Weights) -> list[Figure]:
    """All criteria of a policy."""
    joint = criteria.joint
    rows, S = _rows(joint.model), joint.model.n_states
    from stltool.kernels import sweep as kernels

    def sweep(t: int, W: Floats, out: Floats) -> None:
        for W_i, out_i in zip(W, out, strict=True):
            kernels.mixture(*rows, W_i, policy[t], 0, S, out_i)

    given = np.eye(len(criteria))
    values = _induct(criteria, given, sweep, None)
    n_choices = int(np.diff(joint.model.choice_start).max())
    mixed = [layer[(layer > 0).sum(axis=2) > 1] for layer in policy]
    weight_defect = max((defect(rows.tolist()) for rows in mixed), default=Fraction(0))
    least = min((least_positive(rows) for rows in mixed), default=1.0)
    return [
        _figure(criteria, row, value, n_choices, weight_defect, least) for row, value in zip(given, values, strict=True)
    ]


def _rows(model: MDP) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32], Floats]:
    return model.choice_start, model.row_start, model.target, model.probability


def _induct(
    criteria: Criteria, given: Floats, sweep: Callable[[int, Floats, Floats], None], progress: Progress | None
) -> list[float]:
    """The values of weighted sums, `given` (M, n), swept together: `sweep(t, W, out)` with W and out (M, S, n_t)."""
    joint, n_tasks = criteria.joint, len(criteria.joint.tasks)
    model, automaton, letter = joint.model, joint.automaton, joint.letter
    paid = given[:, n_tasks:] @ criteria.savings()  # (M, S)
    values = np.zeros((len(given), model.n_states, 1))
    state = np.arange(model.n_states)[:, None]
    for t in range(joint.horizon - 1, -1, -1):
        layer = automaton.layers[t]
        W = np.ascontiguousarray(values[:, state, layer.delta[letter]])
        W += np.tensordot(given[:, :n_tasks], layer.holds.astype(np.float64), 1)[:, letter]
        values = np.empty_like(W)
        sweep(t, W, values)
        values += paid[:, :, None]
        if progress is not None:
            progress(joint.horizon - t, joint.horizon)
    start = np.flatnonzero(model.initial)
    first = automaton.start
    total = values[:, start, first.delta[letter[start], 0]]
    total += given[:, :n_tasks] @ first.holds[:, letter[start], 0]
    return [math.fsum(model.initial[start] * row) for row in total]


def _figure(
    criteria: Criteria,
    weights: Floats,
    value: float,
    choices_mixed: int = 0,
    weight_defect: Fraction = Fraction(0),
    least: float = 1.0,
) -> Figure:
    joint, n_tasks = criteria.joint, len(criteria.joint.tasks)
    model, h = joint.model, joint.horizon
    longest = int(np.diff(model.row_start).max())
    # a sweep adds the reward on the way and the one of the state; a reward is a sum of products itself
    n_roundings = roundings(h, longest + 2, choices_mixed) + len(criteria) + 6
    savings = criteria.savings()
    most = sum((Fraction(w) for w in weights[:n_tasks].tolist()), Fraction(0))
    for w, saved in zip(weights[n_tasks:].tolist(), savings, strict=True):
        most += Fraction(w) * h * Fraction(float(saved.max(initial=0.0)))
    row_defect, start_defect = criteria.defects
    missing = h * (row_defect + weight_defect) + start_defect
    missing = most * compounded(missing, missing)
    factors = (2 if choices_mixed else 1) * h + 3
    underflow = can_underflow(factors, min(least, least_positive(model.probability, model.initial, weights, savings)))
    lower, upper = around(value, n_roundings, missing, underflow)
    return Figure(value, round_down(max(lower, Fraction(0))), round_up(max(upper, Fraction(0))))


def probability(figure: Figure) -> Figure:
    """The figure of a probability, cut to [0, 1]."""
    return Figure(*(min(max(x, 0.0), 1.0) for x in (figure.value, figure.lower, figure.upper)))


def cost(figure: Figure, most_saved: Fraction) -> Figure:
    """The expected cost h·ḡ − S, given the figure of what is saved."""
    lower, upper = (max(most_saved - Fraction(x), Fraction(0)) for x in (figure.upper, figure.lower))
    return Figure(float(max(most_saved - Fraction(figure.value), Fraction(0))), round_down(lower), round_up(upper))
