"""The linear programme over occupation measures of a joint product's layers.

    x(t,s,q,c) ≥ 0        the probability of being in (s,q) after step t and taking choice c
    Σ_c x(0,s,q,c)  = ι(s) where q is entered on reading s
    Σ_c x(t+1,s',q',c) = Σ over (s,q,c) with δ_t(L(s'),q) = q' of P(s'|c)·x(t,s,q,c)
    criterion_i(x)  = r_iᵀx + const   (weighted.py: a task's probability, or the saving on a cost)

    maximise criterion_o(x)  subject to  criterion_i(x) ≥ b_i

Variables exist for reachable pairs only, up to the step where every verdict is decided, or up to the horizon if costs
count. Sizes are counted before a matrix is built. x(t,s,q,·) normalised is the policy: every achievable point is
achieved by such a policy. Source: [Altman99], over a finite horizon.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stltool.checking.check import Floats
from stltool.checking.induction import OPEN, Stretch
from stltool.checking.weighted import Criteria
from stltool.choices import Choices, Mixed, Mixtures, mixed
from stltool.display import counted
from stltool.errors import SizeError, SolverError, named
from stltool.sizes import require_memory

if TYPE_CHECKING:
    from scipy.sparse import csr_array

MOST_VARIABLES = 500_000  # some minutes

_BYTES = 200  # for each non-zero, in our matrices and the solver's
_TOLERANCE = 1e-9  # of the solver, on rows and on reduced costs
_NOISE = 1e-9  # a choice with a smaller share of its pair is the solver's rounding


@dataclass(frozen=True, eq=False)
class Programme:
    """The programme's matrices.

    flow      (n_rows, n_variables) sparse, inflow (n_rows,): flow·x = inflow
    reward    (n_criteria, n_variables) sparse, constant (n_criteria,): the criteria are reward·x + constant
    nodes     for each step the reachable pairs (s, automaton state of the layer)
    firsts    for each step the index of its first variable
    """

    criteria: Criteria
    flow: csr_array
    inflow: Floats
    reward: csr_array
    constant: Floats
    nodes: list[tuple[NDArray[np.int64], NDArray[np.int64]]]
    firsts: list[int]

    @property
    def size(self) -> dict[str, int]:
        """Variables, rows and non-zeros of the flow."""
        rows, variables = self.flow.shape
        return {"variables": int(variables), "rows": int(rows), "nonzeros": int(self.flow.nnz)}


@dataclass(frozen=True, eq=False)
class Solution:
    """x (n_variables,), and the multiplier of each bound in the order given."""

    x: Floats
    multipliers: Floats


def programme(criteria: Criteria, most_variables: int = MOST_VARIABLES) -> Programme:
    """Count, then build. SizeError if there are more variables than `most_variables`, or too little memory."""
    from scipy.sparse import coo_array, csr_array

    joint, layers = criteria.joint, criteria.layers
    model, automaton, letter, n_tasks = joint.model, joint.automaton, joint.letter, len(joint.tasks)
    n_choices = np.diff(model.choice_start)
    rows = layers.rows
    per_state = np.diff(rows.row_start[rows.choice_start])
    n_variables = n_rows = nonzeros = 0
    for stretch in layers.backwards():
        s, _ = layers.pairs(stretch.layer)
        times = stretch.last + 1 - stretch.first
        choices, successors = int(n_choices[s].sum()), int(per_state[layers.asked.at(s)].sum())
        n_rows, n_variables = n_rows + times * len(s), n_variables + times * choices
        nonzeros += times * (choices + successors)
    what = f"a linear programme of {n_variables} variables, {n_rows} rows and up to {nonzeros} non-zeros"
    if n_variables > most_variables:
        raise SizeError(
            f"{what} is over the limit of {most_variables} variables; shorten the windows, or coarsen the grid or the "
            f"time step{named('most_variables', ', or raise most_variables')}"
        )
    require_memory(_BYTES * nonzeros, what, "shorten the windows, or coarsen the grid or the time step")

    steps = [stretch.layer for stretch in [*layers.backwards()][::-1] for _ in _steps(stretch)]
    nodes = [layers.pairs(layer) for layer in steps]
    firsts = np.cumsum([0, *(int(n_choices[s].sum()) for s, _ in nodes)]).tolist()
    rows_before = np.cumsum([0, *(len(s) for s, _ in nodes)]).tolist()
    entries: list[tuple[NDArray[np.int64], NDArray[np.int64], Floats]] = []
    reward = np.zeros((len(criteria), n_variables))
    savings = criteria.savings()
    for t, (here, ahead) in enumerate(zip(steps, [*steps[1:], layers.nothing()], strict=False)):
        variables, row = firsts[t], rows_before[t]
        for lo, hi in layers.parts(here):
            edges = layers.edges(here, ahead, t, lo, hi)
            node = np.repeat(np.arange(len(edges)), np.diff(edges.choices))
            variable = variables + np.arange(len(node))
            entries.append((row + node, variable, np.ones(len(node))))
            owner = np.repeat(np.arange(len(node)), np.diff(edges.start))
            p, column = rows.probability[edges.entry], edges.q[node[owner]]
            reads = letter[rows.target[edges.entry]]
            for i in range(n_tasks):
                holds = automaton.layers[t].holds[i]
                reward[i, variable] = np.bincount(owner, p * holds[reads, column], len(node))
            reward[n_tasks:, variable] = savings[:, edges.s[node]]
            kept = edges.child >= OPEN
            entries.append((rows_before[t + 1] + edges.child[kept] - OPEN, variable[owner[kept]], -p[kept]))
            variables, row = variables + len(node), row + len(edges)
    none: tuple[NDArray[np.int64], NDArray[np.int64], Floats] = (np.empty(0, int), np.empty(0, int), np.empty(0))
    row_of, columns, data = (np.concatenate(parts) for parts in zip(none, *entries, strict=True))
    inflow = np.zeros(n_rows)
    start = np.flatnonzero(model.initial)
    if nodes:
        place = np.searchsorted(start, nodes[0][0])
        inflow[: len(place)] = model.initial[start[place]]
    constant = np.zeros(len(criteria))
    constant[:n_tasks] = automaton.start.holds[:, letter[start], 0] @ model.initial[start]
    flow = csr_array(coo_array((data, (row_of, columns)), shape=(n_rows, n_variables)))
    return Programme(criteria, flow, inflow, csr_array(reward), constant, nodes, firsts)


def _steps(stretch: Stretch) -> range:
    return range(stretch.first, stretch.last + 1)


def solve(lp: Programme, objective: int, bounds: Mapping[int, float], most_iterations: int | None = None) -> Solution:
    """Maximise one criterion subject to the others being at least `bounds`.

    Raises SolverError, with the solver's status, if it ends without an optimum. The simplex method is slow to detect
    infeasibility: ask for bounds that can be met, or limit its iterations.
    """
    from scipy.optimize import linprog

    constrained = list(bounds)
    if lp.flow.shape[1] == 0:  # decided by the first state
        return Solution(np.empty(0), np.zeros(len(constrained)))
    rows = lp.reward[constrained]
    scale = np.maximum(abs(rows).max(axis=1).toarray().ravel(), 1e-300)  # costs come in any unit
    needed = np.array([bounds[i] - lp.constant[i] for i in constrained])
    options: dict[str, Any] = {"primal_feasibility_tolerance": _TOLERANCE, "dual_feasibility_tolerance": _TOLERANCE}
    if most_iterations is not None:
        options["maxiter"] = most_iterations
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # inaccurate results are refused below
        found = linprog(  # which minimises
            -lp.reward[[objective]].toarray()[0],
            A_ub=-rows.multiply(1 / scale[:, None]).tocsr() if constrained else None,
            b_ub=-needed / scale if constrained else None,
            A_eq=lp.flow, b_eq=lp.inflow, bounds=(0, None), method="highs-ds", options=options,
        )  # fmt: skip
    if found.status != 0:
        limit = f" within {counted(most_iterations, 'iteration')}" if most_iterations is not None else ""
        raise SolverError(
            f"the linear programme of {lp.flow.shape[1]} variables and {lp.flow.shape[0]} rows: HiGHS found no optimum"
            f"{limit} ({_ENDED.get(found.status, 'numerical difficulties')}); shorten the windows, scale costs closer "
            "to 1, or move the bounds slightly away from the limits of what is possible"
        )
    duals = -np.asarray(found.ineqlin.marginals) if constrained else np.empty(0)
    return Solution(np.maximum(found.x, 0), np.maximum(duals, 0) / scale)


_ENDED = {1: "its limit is reached", 2: "infeasible", 3: "unbounded"}


def policy_of(lp: Programme, x: Floats, otherwise: Choices) -> Mixtures:
    """x normalised in every pair that it reaches, by step and automaton state of the layer; elsewhere `otherwise`."""
    model = lp.criteria.joint.model
    n_choices, n_states = np.diff(model.choice_start), lp.criteria.game.automaton.n_states
    layers: list[Mixed] = []
    for t in range(len(lp.nodes) - 1, -1, -1):
        s, q = lp.nodes[t]
        node = np.repeat(np.arange(len(s)), n_choices[s])
        measure = np.zeros((len(s), model.most_choices))
        measure[node, _ranges(np.zeros_like(s), n_choices[s])] = x[lp.firsts[t] : lp.firsts[t + 1]]
        total = measure.sum(axis=1, keepdims=True)
        reached = total[:, 0] > 0
        measure = measure[reached] / total[reached]
        measure[measure < _NOISE] = 0
        measure /= measure.sum(axis=1, keepdims=True)
        layers.append(mixed(None, t, (s * n_states + q)[reached], measure))
    return Mixtures((model.n_states, n_states), layers[::-1], otherwise, model.most_choices)


def _ranges(starts: NDArray[np.int64], lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """start, start + 1, …, start + length − 1 for each, one after the other."""
    before = np.cumsum(lengths) - lengths
    return np.repeat(starts - before, lengths) + np.arange(int(lengths.sum()))
