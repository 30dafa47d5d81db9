"""The best probability of one task under lower bounds on other tasks and budgets for costs, with a certificate.

    P* = max P(Φ_o)   subject to   P(Φ_i) ≥ c_i,   E Σ_{t<h} g_k(s_t) ≤ B_k        over all policies

The linear programme (occupation.py) gives a randomised policy of (t, s, q) and multipliers λ ≥ 0. Neither is trusted:
the policy's probabilities and costs are computed again by backward induction, and for *any* λ ≥ 0, by weak duality,

    P* ≤ max_π [P(Φ_o) + Σ λ_i (P(Φ_i) − c_i) + Σ μ_k (B_k − E cost_k)]

whose right side is one weighted backward induction (weighted.py), with rounding enclosed. The gap between the two
bounds what the solver's arithmetic may have cost.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from stltool.arguments import flag, function, mapping, real, require, whole
from stltool.checking.induction import Progress
from stltool.checking.occupation import MOST_VARIABLES, Programme, Solution, policy_of, programme, solve
from stltool.checking.weighted import Criteria, Figure, best, cost, of_policy, probability
from stltool.choices import ByLayer, Choices
from stltool.display import Card, Displayed, counted, probability_text
from stltool.errors import InfeasibleError, SettingsError, SolverError, named
from stltool.numbers import number_text, round_up
from stltool.policy import Policy
from stltool.product import JointProduct
from stltool.sizes import require_memory

_MARGINS = (1e-9, 1e-7)  # margins on bounds, where there is room; the next is tried if one is not enough
_ROOM = 1e-6  # the least such room
_ITERATIONS = 50  # of the simplex method for each row, before it gives up on bounds


@dataclass(frozen=True, eq=False, repr=False)
class Tradeoff(Displayed):
    """How a trade-off ended.

    objective      the task whose probability was maximised
    at_least, budget  the constraints as given, by task and by cost
    probabilities  each task's probability under `policy`, and `costs` each budgeted cost's expectation: computed by
                   backward induction, lower ≤ exact ≤ upper
    bound          no policy that satisfies the constraints has a higher probability (rounding included)
    multipliers    λ of each constraint, by task or cost: what its bound costs the maximum, per unit
    policy         randomised, over the joint product; None where it was not kept
    randomised     at how many of the reached (t, s, q) the policy mixes choices
    size           the programme's variables, rows and nonzeros
    status         "complete", or which constraints are missed, and by how little
    """

    joint: JointProduct
    objective: str
    at_least: Mapping[str, float | Fraction]
    budget: Mapping[str, float | Fraction]
    probabilities: Mapping[str, Figure]
    costs: Mapping[str, Figure]
    bound: float
    multipliers: Mapping[str, float]
    policy: Policy | None
    randomised: int
    size: Mapping[str, int]
    status: str
    seconds: float

    @property
    def probability(self) -> float:
        """P of the maximised task under the policy."""
        return self.probabilities[self.objective].value

    @property
    def gap(self) -> float:
        """An upper bound on how much higher a policy's probability could be."""
        return max(0.0, self.bound - self.probabilities[self.objective].lower)

    def _card(self) -> Card:
        kept = [f"P({name}) >= {bound}" for name, bound in self.at_least.items()]
        kept += [f"E[{name}] <= {bound}" for name, bound in self.budget.items()]
        shown: dict[str, object] = {f"P({name})": probability_text(f.value) for name, f in self.probabilities.items()}
        shown |= {f"E[{name}]": f"{figure.value:.6g}" for name, figure in self.costs.items()}
        return Card(
            f"Tradeoff: P({self.objective}) = {self.probability!r}, at most {self.bound!r}, {self.status}",
            [shown, {"constraints": ", ".join(kept) or "none", "randomised at": counted(self.randomised, "place")}],
        )


def tradeoff(
    joint: JointProduct,
    objective: str,
    *,
    at_least: Mapping[str, float | Fraction] | None = None,
    budget: Mapping[str, float | Fraction] | None = None,
    keep_policy: bool = True,
    most_variables: int = MOST_VARIABLES,
    progress: Progress | None = None,
) -> Tradeoff:
    """Maximise the probability of the task `objective`.

    at_least   lower bounds on the probabilities of other tasks, by name
    budget     upper bounds on expected costs, by name. A cost is a signal (at least 0 everywhere), a label (1 where it
               holds) or a cost of the model that depends on states alone, summed over the states s₀ … s_{h−1}, h the
               longest horizon of all tasks

    Raises InfeasibleError, with what is possible, if no policy satisfies the constraints, SettingsError for a bound out
    of range, NameLookupError for an unknown task or cost, SizeError before building a programme of more than
    `most_variables`, SolverError if the solver gives up.
    """
    started = time.perf_counter()
    require(joint, JointProduct, "tradeoff's joint product")
    require(objective, str, "tradeoff's objective", f"name a task: {', '.join(joint.names)}")
    at_least = _bounds(at_least, "at_least", "{'patrol': 0.9}")
    budget = _bounds(budget, "budget", "{'fuel': 12}")
    flag(keep_policy, "tradeoff's keep_policy")
    most_variables = whole(most_variables, "most_variables", least=1)
    function(progress, "tradeoff's progress")
    criteria = Criteria(joint, tuple(budget))
    goal = joint.task(objective)
    for name, bound in at_least.items():
        joint.task(name)
        if not 0 <= bound <= 1:
            raise SettingsError(f"P({name}) >= {_text(bound)}: give a probability between 0 and 1")
    for name, bound in budget.items():
        if bound < 0:
            raise SettingsError(f"E[{name}] <= {_text(bound)}: give a finite budget, at least 0")
    if keep_policy:  # it is stored as a table
        require_memory(
            4 * 8 * math.prod(joint.shape) * joint.model.most_choices,
            f"a policy over {joint.shape[0]} model states × {joint.shape[1]} joint automaton states",
            named("keep_policy", "use keep_policy=False, or ") + "shorten the windows",
        )
    both = sorted(set(joint.names) & set(budget))
    if both:
        raise SettingsError(f"{both[0]} is the name of both a task and a cost; rename the task")
    asked = _Asked(criteria, at_least, budget)
    highest = asked.require_possible(progress)
    lp = programme(criteria, most_variables)
    room = asked.require_together(lp, highest)
    for margin in _MARGINS:
        solution = asked.solve(lp, goal, room, margin)
        multipliers = dict(zip(room, solution.multipliers.tolist(), strict=True))
        upper, otherwise = asked.certificate(goal, multipliers)
        form = policy_of(lp, solution.x, otherwise)
        probabilities, costs = asked.told(of_policy(criteria, form))
        status = asked.status(probabilities, costs)
        if status == "complete" or not any(room.values()):
            break
    return Tradeoff(
        joint=joint,
        objective=objective,
        at_least=at_least,
        budget=budget,
        probabilities=probabilities,
        costs=costs,
        bound=min(1.0, round_up(upper)),
        multipliers=dict(zip((*at_least, *budget), multipliers.values(), strict=True)),
        policy=Policy(joint, ByLayer(form, joint.automaton.offsets, joint.shape)) if keep_policy else None,
        randomised=sum(int(((layer.rows > 0).sum(axis=1) > 1)[layer.which].sum()) for layer in form.layers),
        size=lp.size,
        status=status,
        seconds=time.perf_counter() - started,
    )


def _bounds(given: object, name: str, example: str) -> dict[str, float | Fraction]:
    """Bounds by name; no bounds if None is given."""
    known = mapping(given, f"tradeoff's {name}", example, optional=True)
    return {key: real(bound, f"{name} of {key}") for key, bound in known.items()}


@dataclass(frozen=True, eq=False)
class _Asked:
    """The constraints as lower bounds on criteria: P(Φ_i) ≥ c_i, and for a cost its saving ≥ h·ḡ − B."""

    criteria: Criteria
    at_least: Mapping[str, float | Fraction]
    budget: Mapping[str, float | Fraction]

    @property
    def floors(self) -> dict[int, Fraction]:
        """Criterion → what it must reach, exactly; tasks first, then costs."""
        tasks = {self.criteria.joint.task(name): Fraction(bound) for name, bound in self.at_least.items()}
        costs = zip(self.criteria.most_saved, self.budget.values(), strict=True)
        first = len(self.criteria.joint.tasks)
        return tasks | {first + k: most - Fraction(bound) for k, (most, bound) in enumerate(costs)}

    def unit(self, i: int) -> float:
        """The unit in which differences of a criterion are measured."""
        k = i - len(self.criteria.joint.tasks)
        return 1.0 if k < 0 else float(self.criteria.most_saved[k]) or 1.0

    def require_possible(self, progress: Progress | None) -> dict[int, Fraction]:
        """The maximum of each constrained criterion; InfeasibleError if it is below the bound."""
        highest = {}
        for i, floor in self.floors.items():
            top = best(self.criteria, np.eye(len(self.criteria))[i])[0]
            if Fraction(top.upper) < floor:
                raise InfeasibleError(f"{self.text(i)} cannot be met: {self.possible(i, Fraction(top.upper), 'its')}")
            highest[i] = Fraction(top.upper)
            if progress is not None:
                progress(len(highest), len(self.floors))
        return highest

    def require_together(self, lp: Programme, highest: Mapping[int, Fraction]) -> dict[int, bool]:
        """For each constraint, whether there is room above it given those before; InfeasibleError, with what is
        possible, for the first that they make infeasible.
        """
        room: dict[int, bool] = {}
        for i, floor in self.floors.items():
            upper = highest[i]
            if room:
                solution = self.solve(lp, i, room, _MARGINS[0])
                upper, _ = self.certificate(i, dict(zip(room, solution.multipliers.tolist(), strict=True)))
            if upper < floor:
                given = " and ".join(map(self.text, room))
                raise InfeasibleError(
                    f"{given} and {self.text(i)} cannot be met together: with {given}, "
                    f"{self.possible(i, upper, self.named(i))}"
                )
            room[i] = float(upper - floor) > _ROOM * self.unit(i)
        return room

    def solve(self, lp: Programme, objective: int, room: Mapping[int, bool], margin: float) -> Solution:
        """The programme under those constraints: with a margin where there is room, without one at the edge of what is
        possible, or with a margin below if the solver does not converge there.
        """
        floors = self.floors
        near = {i: float(floors[i]) + (margin * self.unit(i) if roomy else 0.0) for i, roomy in room.items()}
        try:
            return solve(lp, objective, near, _ITERATIONS * (lp.size["rows"] + 1000) if room else None)
        except SolverError:
            return solve(lp, objective, {i: float(floors[i]) - margin * self.unit(i) for i in room})

    def certificate(self, objective: int, multipliers: Mapping[int, float]) -> tuple[Fraction, Choices]:
        """An upper bound on the objective under constraints with these multipliers, and the weighted sum's choices."""
        weights = np.eye(len(self.criteria))[objective]
        others = {i: multiplier for i, multiplier in multipliers.items() if i != objective}  # not its own bound
        for i, multiplier in others.items():
            weights[i] = multiplier
        top, _, chosen = best(self.criteria, weights)
        floors = self.floors
        spent = sum((Fraction(multiplier) * floors[i] for i, multiplier in others.items()), Fraction(0))
        return Fraction(top.upper) - spent, chosen

    def told(self, figures: list[Figure]) -> tuple[dict[str, Figure], dict[str, Figure]]:
        """The figures of all criteria, as probabilities and costs."""
        names, n = self.criteria.joint.names, len(self.criteria.joint.tasks)
        costs = zip(self.budget, figures[n:], self.criteria.most_saved, strict=True)
        return (
            {name: probability(figure) for name, figure in zip(names, figures, strict=False)},
            {name: cost(figure, most) for name, figure, most in costs},
        )

    def status(self, probabilities: Mapping[str, Figure], costs: Mapping[str, Figure]) -> str:
        """ "complete" if every constraint holds, rounding included."""
        missed = {
            f"P({name})": Fraction(bound) - Fraction(probabilities[name].lower) for name, bound in self.at_least.items()
        }
        missed |= {f"E[{name}]": Fraction(costs[name].upper) - Fraction(bound) for name, bound in self.budget.items()}
        parts = [f"{name} misses its bound by {float(by):.2g}" for name, by in missed.items() if by > 0]
        return "; ".join(parts) or "complete"

    def named(self, i: int) -> str:
        k = i - len(self.criteria.joint.tasks)
        return f"P({self.criteria.joint.names[i]})" if k < 0 else f"E[{self.criteria.costs[k]}]"

    def text(self, i: int) -> str:
        """The constraint as the user would write it."""
        k = i - len(self.criteria.joint.tasks)
        if k < 0:
            return f"{self.named(i)} >= {_text(self.at_least[self.criteria.joint.names[i]])}"
        return f"{self.named(i)} <= {_text(self.budget[self.criteria.costs[k]])}"

    def possible(self, i: int, upper: Fraction, whose: str) -> str:
        """The best possible value of a criterion, with enough digits to differ from the bound that it misses."""
        k = i - len(self.criteria.joint.tasks)
        most = upper if k < 0 else self.criteria.most_saved[k] - upper
        bound = self.at_least[self.criteria.joint.names[i]] if k < 0 else self.budget[self.criteria.costs[k]]
        texts = (f"{float(most):.{digits}g}" for digits in range(6, 18))
        shown = next((text for text in texts if (float(text) - bound) * (1 if k < 0 else -1) < 0), str(float(most)))
        if whose == "its":
            return f"its {'maximum' if k < 0 else 'minimum'} is {shown}"
        return f"{whose} is at {'most' if k < 0 else 'least'} {shown}"


def _text(bound: float | Fraction) -> str:
    return number_text(bound) if isinstance(bound, Fraction) else repr(bound)
