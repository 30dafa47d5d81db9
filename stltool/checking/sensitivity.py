"""Which state's success probability moves P most: derivatives of a fixed policy's P with respect to the model's rows.

With x_t(s,q) the probability of being in (s,q), undecided, after step t, and V the policy's values, the product rule
over the horizon gives, for every entry of every row,

    ∂P/∂p(s'|c) = Σ_{t,q} x_t(s,q) π_t(c|s,q) V_{t+1}(s', δ(L(s'),q))           for c a choice of s

A row stays a distribution, so a single entry cannot move. A choice's *tilt* moves its row towards its intended
successor ŝ, the most probable one (the first of equals), and away from the others in proportion:

    p_ε(ŝ) = p(ŝ) + ε,   p_ε(s') = p(s') (1 − ε / Σ_{s''≠ŝ} p(s''))
    tilt(c) = dP/dε at 0 = ∂P/∂p(ŝ|c) − Σ_{s'≠ŝ} p(s') ∂P/∂p(s'|c) / Σ_{s'≠ŝ} p(s')

A row with one successor has no tilt (0). A state's derivative is the sum over its choices: all its rows tilted at once.
For an optimal policy it is the derivative of the optimum too, wherever that has one (envelope theorem). One backward
and one forward pass over the unfolded product: nothing is truncated. Source: the adjoint method; for Markov chains,
[Cao07, ch. 2] (performance derivatives).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from stltool.arguments import function, one_of, whole
from stltool.automata import TRUE
from stltool.checking.check import or_optimal
from stltool.checking.induction import Doubles, Engine, Game, Progress
from stltool.checking.unfold import Floats, Unfolding, flows
from stltool.display import Card, Displayed, probability_text
from stltool.policy import Policy
from stltool.product import Product
from stltool.sizes import require_memory, require_time

_SHOWN = 10  # states in a notebook
_RATE, _STEP = 1e7, 500  # edges per second, and the fixed cost of a step in edges, roughly


@dataclass(frozen=True)
class ActionSensitivity:
    """One action of a state: its intended successor and its probability, the tilt, and how often it is expected to be
    taken."""

    action: str
    intended: str
    success: float
    derivative: float
    times: float


@dataclass(frozen=True)
class StateSensitivity:
    """One state, in the user's names; `actions` are those that the policy takes, the largest |tilt| first."""

    state: int
    name: str
    derivative: float
    steepest: float
    visits: float
    actions: tuple[ActionSensitivity, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity(Displayed):
    """Derivatives of a policy's P, per unit of probability; see the module's text.

    probability   P under the policy
    gradient      (n_transitions,) ∂P/∂p of each entry of the model's rows
    tilt          (n_choices,) per choice
    derivative    (n_states,) per state: the sum of its choices' tilts
    steepest      (n_states,) the most that moving probability from one successor to another can change, summed over
    choices
    visits        (n_states,) expected number of steps at which the run is there, undecided
    times         (n_choices,) expected number of times that a choice is taken
    """

    product: Product
    policy: Policy
    probability: float
    gradient: Floats
    tilt: Floats
    derivative: Floats
    steepest: Floats
    visits: Floats
    times: Floats

    def _card(self) -> Card:
        ranked = self.ranked(_SHOWN)
        rows = [(row.name, f"{row.derivative:.6g}", f"{row.visits:.6g}") for row in ranked]
        told = "; ".join(f"{name}: {derivative}" for name, derivative, _ in rows[:3])
        return Card(
            f"Sensitivity: dP of {self.product.task_name} under a policy with P = {probability_text(self.probability)}",
            [{"states that move P most": told or "none"}, {"model": self.product.model.name}],
            (("state", "derivative", "expected visits"), rows),
        )

    def ranked(self, count: int | None = None) -> tuple[StateSensitivity, ...]:
        """States that the policy acts in, the largest |derivative| first, then by `steepest`, then in model order."""
        if count is not None:
            count = whole(count, "ranked's count", least=0)
        model = self.product.model
        visited = np.flatnonzero(self.visits > 0)
        order = np.lexsort((visited, -self.steepest[visited], -np.abs(self.derivative[visited])))
        return tuple(
            StateSensitivity(
                state=s,
                name=model.state_name(s),
                derivative=float(self.derivative[s]),
                steepest=float(self.steepest[s]),
                visits=float(self.visits[s]),
                actions=self._actions(s),
            )
            for s in visited[order][:count].tolist()
        )

    def _actions(self, s: int) -> tuple[ActionSensitivity, ...]:
        model = self.product.model
        found = []
        for c in range(model.choice_start[s], model.choice_start[s + 1]):
            if self.times[c] > 0:
                first = int(model.row_start[c])
                k = first + int(model.probability[first : model.row_start[c + 1]].argmax())
                found.append(
                    ActionSensitivity(
                        action=model.action_names[model.choice_action[c]],
                        intended=model.state_name(int(model.target[k])),
                        success=float(model.probability[k]),
                        derivative=float(self.tilt[c]),
                        times=float(self.times[c]),
                    )
                )
        return tuple(sorted(found, key=lambda action: (-abs(action.derivative), -action.times)))


def sensitivity(
    product: Product,
    policy: Policy | None = None,
    *,
    engine: Engine = "auto",
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Sensitivity:
    """How P under `policy` (default: the optimal one) changes with the model's probabilities, the policy held fixed.

    Raises PolicyError if the policy defines no action in a pair that it reaches or belongs to another task, SizeError
    before allocating more memory than is available.
    """
    one_of(engine, "engine", get_args(Engine))
    function(progress, "sensitivity's progress")
    product, policy = or_optimal("sensitivity", product, policy, memory_limit).on(product)
    model = product.model
    require_memory(
        8 * (4 * model.n_transitions + 4 * model.n_choices + 4 * model.n_states),
        f"derivatives for {model.n_transitions} transitions",
        "coarsen the grid",
        memory_limit,
    )
    game = replace(Game.of(product), rows=model.rows, kept={})  # its edges are numbered as in the model
    unfolding = Unfolding(
        product, policy, Doubles(True), TRUE, game=game,
        live=False, engine=engine, limit=memory_limit, progress=progress,
    )  # fmt: skip
    pairs = unfolding.layers.size()[1]
    require_time(
        pairs * unfolding.layers.game.widest + _STEP * unfolding.steps, _RATE,
        f"derivatives along {pairs} pairs, all steps together", "shorten the windows",
    )  # fmt: skip
    gradient, visits, times = np.zeros(model.n_transitions), np.zeros(model.n_states), np.zeros(model.n_choices)
    for t, edges, here, flow in flows(unfolding.layers, unfolding.stretches, unfolding.start):
        np.add.at(visits, edges.s, here)
        np.add.at(times, edges.choice, flow)
        per_edge = np.repeat(flow, np.diff(edges.start))
        np.add.at(gradient, edges.entry, per_edge * unfolding.values(t + 1)[edges.child])
    tilt, steepest = _per_choice(product, gradient)
    per_state = model.choice_start[:-1]
    return Sensitivity(
        product=product,
        policy=policy,
        probability=math.fsum(unfolding.start * unfolding.entry),
        gradient=gradient,
        tilt=tilt,
        derivative=np.add.reduceat(tilt, per_state),
        steepest=np.add.reduceat(steepest, per_state),
        visits=visits,
        times=times,
    )


def _per_choice(product: Product, gradient: Floats) -> tuple[Floats, Floats]:
    """(tilt, steepest) of each choice from the entries' gradient."""
    model = product.model
    tilt, steepest = np.zeros(model.n_choices), np.zeros(model.n_choices)
    for c, (a, b) in enumerate(itertools.pairwise(model.row_start.tolist())):
        slope = gradient[a:b]
        if b - a > 1 and slope.any():
            p, k = model.probability[a:b], int(model.probability[a:b].argmax())
            others = np.arange(b - a) != k
            tilt[c] = slope[k] - (p[others] @ slope[others]) / p[others].sum()
            steepest[c] = slope.max() - slope.min()
    return tilt, steepest
