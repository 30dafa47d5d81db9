"""The best weighted sum of several criteria over all policies, and the criteria of one policy, by backward induction.

Criteria of a joint product: P(Φ_i) of each task, and for each cost signal g the saving against its largest possible
value,

    S_g = h·ḡ − E Σ_{t<h} g(s_t),   ḡ = max_s g(s),

also a sum of nonnegative terms. A cost is paid in every state s₀ … s_{h−1} in which an action is taken, up to the
longest horizon h of the tasks, whether or not verdicts are decided before. With weights w ≥ 0, over layers (t, s, q):

    V_t(s,q)   = Σ_g w_g (ḡ − g(s)) + opt_c Σ_s' P(s'|c) W_t(s',q)
    W_t(s',q)  = Σ_i w_i·1{Φ_i falls true on reading s'} + V_{t+1}(s', δ_t(L(s'), q))

after h sweeps. No term is negative, so the a-priori enclosure of bounds.py holds; defects are multiplied by the largest
sum to come. Source: the weighted reward of [Etessami08], over a finite horizon.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.automata import TRUE
from stltool.checking.bounds import around, can_underflow, compounded, defect, roundings, row_defect
from stltool.checking.check import Floats
from stltool.checking.induction import (
    EVERYTHING,
    Allowed,
    Arithmetic,
    Budget,
    Edges,
    Engine,
    Following,
    Game,
    Layers,
    Values,
    layers_of,
    solve,
)
from stltool.choices import Choices, Form
from stltool.errors import NameLookupError, SettingsError
from stltool.logic.names import near_names
from stltool.models import MDP
from stltool.models.rows import Rows, least_positive
from stltool.numbers import round_down, round_up
from stltool.product import JointProduct
from stltool.sizes import require_memory, require_time

_LARGEST_COST = 1e100  # over the horizon
_RATE = 5e8  # multiply-adds per second, roughly, on one core


@dataclass(frozen=True)
class Figure:
    """A computed value with lower ≤ exact value ≤ upper, rounding included, for the model as given."""

    value: float
    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class Criteria:
    """The criteria of a trade-off: the tasks of a joint product, then costs by the names of their signals or labels.

    Raises NameLookupError for a cost that the model does not have, SettingsError for one that is negative somewhere,
    SizeError before allocating layers that would not fit into memory.
    """

    joint: JointProduct
    costs: tuple[str, ...] = ()
    engine: Engine = "auto"

    def __post_init__(self) -> None:
        self.joint.model.require_points()
        for name in self.costs:
            most = float(cost_values(self.joint.model, name).max())
            if most * self.joint.horizon > _LARGEST_COST:
                raise SettingsError(f"cost {name} is up to {most:g} per step; scale the signal to numbers below 1e9")

    @cached_property
    def game(self) -> Game:
        """Without costs, runs end where every verdict is decided; automaton states are numbered by layer."""
        return Game.of_joint(self.joint, paying=bool(self.costs))

    @cached_property
    def layers(self) -> Layers[Any, Any]:
        """The undecided pairs of all runs. SizeError before they, or sums over them, need more than is available."""
        return self.layers_along(EVERYTHING, self.joint.model.unsigned_choice_type)

    def layers_along(self, allowed: Allowed, keep: type[np.unsignedinteger] | None) -> Layers[Any, Any]:
        """The same along certain choices."""
        budget = Budget(f"the criteria of {len(self.joint.tasks)} tasks")
        layers = layers_of(
            self.game, TRUE, allowed, engine=self.engine, live=False, sure=False, keep=keep, budget=budget
        )
        widest, pairs = layers.size()
        what, remedy = f"weighted sums over {pairs} pairs, all steps together", "shorten the windows"
        require_memory(32 * (len(self) + 1) * widest, what, remedy)
        require_time((len(self) + 1) * pairs * self.game.widest, _RATE, what, remedy)
        return layers

    def __len__(self) -> int:
        return len(self.joint.tasks) + len(self.costs)

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
    """(S,) the cost of a step in each state: a signal's values, 1 where a label holds, or a cost of the model."""
    columns = {**model.signals, **model.labels}
    if name in model.costs:
        cost = model.costs[name]
        if name in columns:
            raise SettingsError(f"the model has a cost {name} and a {_kind(model, name)} {name}; rename one of them")
        if not cost.of_states_only:
            raise SettingsError(f"cost {name} depends on actions; a budget takes costs that depend on states alone")
        values = cost.states.values if cost.states is not None else np.zeros(model.n_states)
    elif name in columns:
        values = columns[name].astype(np.float64, copy=False)
    else:
        raise NameLookupError(
            f"the model has no signal {name} for this cost; {near_names(name, [*columns, *model.costs])}"
        )
    if (values < 0).any():
        s = int(values.argmin())
        raise SettingsError(
            f"{_kind(model, name)} {name} is {values[s]:g} in state {model.state_name(s)}, but a cost must be at least "
            "0; shift it"
        )
    return values


def _kind(model: MDP, name: str) -> str:
    return "signal" if name in model.signals else "label" if name in model.labels else "cost"


def best(criteria: Criteria, weights: Sequence[float]) -> tuple[Figure, list[Figure], Choices]:
    """max over all policies of Σ w_i·criterion_i, the criteria of a policy that attains it, and its choices.

    Choices are by step and by the automaton states of its layer.
    """
    given = np.vstack([np.asarray(weights, dtype=np.float64), np.eye(len(criteria))])
    values, chosen = _values(criteria, given, criteria.layers, criteria.joint.model.unsigned_choice_type)
    assert chosen is not None
    figures = [_figure(criteria, row, value) for row, value in zip(given, values, strict=True)]
    return figures[0], figures[1:], chosen


def greatest(criteria: Criteria, weights: Sequence[float]) -> Figure:
    """max over all policies of Σ w_i·criterion_i alone."""
    given = np.asarray(weights, dtype=np.float64)[None]
    [value], _ = _values(criteria, given, criteria.layers, None)
    return _figure(criteria, given[0], value)


def of_policy(criteria: Criteria, form: Form) -> list[Figure]:
    """All criteria of a policy by step and the automaton states of its layer."""
    given = np.eye(len(criteria))
    values, _ = _values(criteria, given, criteria.layers_along(Following(form), None), None)
    if form.deterministic:
        return [_figure(criteria, row, value) for row, value in zip(given, values, strict=True)]
    mixtures = form.mixtures()
    mixtures = mixtures[(mixtures > 0).sum(axis=1) > 1]
    weight_defect = defect(mixtures.tolist())
    n_choices, least = criteria.joint.model.most_choices, least_positive(mixtures)
    return [
        _figure(criteria, row, value, n_choices, weight_defect, least) for row, value in zip(given, values, strict=True)
    ]


def _values(
    criteria: Criteria, given: Floats, layers: Layers[Any, Any], keep: type[np.unsignedinteger] | None
) -> tuple[list[float], Choices | None]:
    """The values of weighted sums, `given` (M, n), and the choices that are best for the first."""
    joint, n_tasks = criteria.joint, len(criteria.joint.tasks)
    found = solve(layers, _Sums(criteria, given), True, keep)
    start = criteria.game.first
    at_once = given[:, :n_tasks] @ joint.automaton.start.holds[:, joint.letter[start], 0]
    shares = joint.model.initial[start]
    return [math.fsum(shares * row) for row in found.entry.T + at_once], found.choices


class _Sums(Arithmetic):
    """M columns: weighted sums, `given` (M, n); the first is maximised, the others follow its choices."""

    repeats = False  # equal pairs may still have different rewards

    def __init__(self, criteria: Criteria, given: Floats) -> None:
        joint, self._n_tasks = criteria.joint, len(criteria.joint.tasks)
        self._given, self._automaton = given, joint.automaton
        self._letter = joint.letter
        self._paid = (given[:, self._n_tasks :] @ criteria.savings()).T.copy()  # (S, M)
        self._reward: tuple[Any, Floats] = (None, np.empty((0, 0, 0)))

    def begin(self, rows: Rows) -> None:
        super().begin(rows)
        self._reads = self._letter[rows.target]

    def ends(self, t: int) -> tuple[Values, Values]:
        nothing = np.zeros(len(self._given))
        return nothing, nothing

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        raise NotImplementedError  # choices are compared while sums are computed

    def back(
        self, t: int, edges: Edges, ahead: Values, maximize: bool, keep: bool
    ) -> tuple[Values, NDArray[np.int64] | None]:
        from stltool.kernels import edges as kernels

        out, best = np.zeros((len(edges), len(self._given))), np.zeros(len(edges), dtype=np.int64)
        weight = np.empty(0) if edges.weight is None else edges.weight
        kernels.sums(
            edges.choices, edges.start, edges.entry, edges.child, edges.q, self.rows.probability, self._reads,
            self._falls(t), ahead, weight, 0, len(edges), out, best,
        )  # fmt: skip
        return out + self._paid[edges.s], best if edges.weight is None else None

    def _falls(self, t: int) -> Floats:
        """(letters, n_t, M): what verdicts that are decided true on reading a letter after step t add."""
        layer = self._automaton.layers[t]
        if self._reward[0] is not layer:
            falls = np.einsum("mi,ilq->lqm", self._given[:, : self._n_tasks], layer.holds.astype(np.float64))
            self._reward = (layer, np.ascontiguousarray(falls))
        return self._reward[1]


def _figure(
    criteria: Criteria,
    weights: Floats,
    value: float,
    choices_mixed: int = 0,
    weight_defect: Fraction = Fraction(0),
    least: float = 1.0,
) -> Figure:
    joint, n_tasks = criteria.joint, len(criteria.joint.tasks)
    model, h, kinds = joint.model, joint.horizon, criteria.layers.kinds
    # a sweep adds the reward of the transition and that of the state; a reward is itself a sum of products
    n_roundings = roundings(h, kinds.longest + 2, choices_mixed) + len(criteria) + 6
    savings = criteria.savings()
    most = sum((Fraction(w) for w in weights[:n_tasks].tolist()), Fraction(0))
    for w, saved in zip(weights[n_tasks:].tolist(), savings, strict=True):
        most += Fraction(w) * h * Fraction(float(saved.max(initial=0.0)))
    missing = h * (row_defect(kinds) + weight_defect) + model.initial_defect
    missing = most * compounded(missing, missing)
    factors = (2 if choices_mixed else 1) * h + 3
    underflow = can_underflow(factors, min(least, kinds.least, least_positive(model.initial, weights, savings)))
    lower, upper = around(value, n_roundings, missing, underflow)
    return Figure(value, round_down(max(lower, Fraction(0))), round_up(max(upper, Fraction(0))))


def probability(figure: Figure) -> Figure:
    """The enclosed value of a probability, cut to [0, 1]."""
    return Figure(*(min(max(x, 0.0), 1.0) for x in (figure.value, figure.lower, figure.upper)))


def cost(figure: Figure, most_saved: Fraction) -> Figure:
    """The expected cost h·ḡ − S, given the enclosed value of the saving."""
    lower, upper = (max(most_saved - Fraction(x), Fraction(0)) for x in (figure.upper, figure.lower))
    return Figure(float(max(most_saved - Fraction(figure.value), Fraction(0))), round_down(lower), round_up(upper))
