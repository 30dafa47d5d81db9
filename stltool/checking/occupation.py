"""The linear programme over occupation measures of a joint product's layers.

    x(t,s,q,c) ≥ 0        the probability of being in (s,q) after step t and taking choice c
    Σ_c x(0,s,q,c)  = ι(s) where q is entered on reading s
    Σ_c x(t+1,s',q',c) = Σ over (s,q,c) with δ_t(L(s'),q) = q' of P(s'|c)·x(t,s,q,c)
    criterion_i(x)  = r_iᵀx + const   (weighted.py: a task's probability, or what is saved of a cost)

    maximise criterion_o(x)  subject to  criterion_i(x) ≥ b_i

Only what can be reached is a variable, up to the step where every verdict has fallen, or to the horizon where costs
count. Sizes are counted before a matrix is made. x(t,s,q,·) normalised is the policy: every achievable point is that of
such a policy. Source: [Altman99], over a finite horizon.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stltool.checking.backward import Floats
from stltool.checking.weighted import Choices, Criteria, Weights
from stltool.display import counted
from stltool.errors import SizeError, SolverError, named
from stltool.sizes import require_memory

if TYPE_CHECKING:
    from scipy.sparse import csr_array

MOST_VARIABLES = 500_000  # some minutes

_BYTES = 200  # a non-zero, in our matrices, cvxpy's and the solver's
_TOLERANCE = 1e-9  # of the solver, on rows and on reduced costs
_NOISE = 1e-9  # a choice's share of its place, below which it is the solver's rounding


@dataclass(frozen=True, eq=False)
class Programme:
    """The programme's matrices.

    flow      (n_rows, n_variables) sparse, inflow (n_rows,): flow·x = inflow
    reward    (n_criteria, n_variables) sparse, constant (n_criteria,): the criteria are reward·x + constant
    nodes     for each step the places (s, column of the layer) that can be reached
    firsts    for each step the number of its first variable
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
    """Count, then build. SizeError where there are more variables than `most_variables`, or memory is short."""
    from scipy.sparse import coo_array, csr_array

    joint = criteria.joint
    model, automaton, letter, n_tasks = joint.model, joint.automaton, joint.letter, len(joint.tasks)
    nodes = _reachable(criteria)
    n_choices, lengths = np.diff(model.choice_start), np.diff(model.row_start)
    successors = np.add.reduceat(lengths, model.choice_start[:-1])
    counts = [int(n_choices[s].sum()) for s, _ in nodes]
    n_variables, n_rows = sum(counts), sum(len(s) for s, _ in nodes)
    nonzeros = n_variables + sum(int(successors[s].sum()) for s, _ in nodes)
    what = f"a linear programme of {n_variables} variables, {n_rows} rows and up to {nonzeros} non-zeros"
    if n_variables > most_variables:
        raise SizeError(
            f"{what} is over the limit of {most_variables} variables; shorten the windows, or coarsen the grid or the "
            f"time step{named('most_variables', ', or raise most_variables')}"
        )
    require_memory(_BYTES * nonzeros, what, "shorten the windows, or coarsen the grid or the time step")

    firsts = np.cumsum([0, *counts]).tolist()
    above = 0  # rows of the layers before
    entries: list[tuple[NDArray[np.int64], NDArray[np.int64], Floats]] = []
    reward = np.zeros((len(criteria), n_variables))
    savings = criteria.savings()
    for t, (s, j) in enumerate(nodes):
        layer = automaton.layers[t]
        node = np.repeat(np.arange(len(s)), n_choices[s])
        variable = firsts[t] + np.arange(len(node))
        choice = _ranges(model.choice_start[s], n_choices[s])
        entries.append((above + node, variable, np.ones(len(node))))
        above += len(s)
        owner = np.repeat(np.arange(len(node)), lengths[choice])
        row = _ranges(model.row_start[choice], lengths[choice])
        p, target, column = model.probability[row], model.target[row], j[node[owner]]
        reads = letter[target]
        for i in range(n_tasks):
            reward[i, variable] = np.bincount(owner, p * layer.holds[i][reads, column], len(node))
        reward[n_tasks:, variable] = savings[:, s[node]]
        if t + 1 < len(nodes):
            place = np.full((model.n_states, len(automaton.layers[t + 1].states)), -1, dtype=np.int64)
            place[nodes[t + 1]] = np.arange(len(nodes[t + 1][0]))
            following = place[target, layer.delta[reads, column]]
            kept = following >= 0
            entries.append((above + following[kept], variable[owner[kept]], -p[kept]))
    none: tuple[NDArray[np.int64], NDArray[np.int64], Floats] = (np.empty(0, int), np.empty(0, int), np.empty(0))
    rows, columns, data = (np.concatenate(parts) for parts in zip(none, *entries, strict=True))
    inflow = np.zeros(n_rows)
    if nodes:
        inflow[: len(nodes[0][0])] = model.initial[nodes[0][0]]
    constant = np.zeros(len(criteria))
    start = np.flatnonzero(model.initial)
    constant[:n_tasks] = automaton.start.holds[:, letter[start], 0] @ model.initial[start]
    flow = csr_array(coo_array((data, (rows, columns)), shape=(n_rows, n_variables)))
    return Programme(criteria, flow, inflow, csr_array(reward), constant, nodes, firsts)


def solve(lp: Programme, objective: int, bounds: Mapping[int, float], most_iterations: int | None = None) -> Solution:
    """Maximise one criterion where others are at least `bounds`.

    Raises SolverError, with the solver's status, where it ends without an optimum. Simplex is slow to tell that there
    is none: ask for bounds that can be met, or limit its iterations.
    """
    import cvxpy as cp

    constrained = list(bounds)
    if lp.flow.shape[1] == 0:  # decided by the first state
        return Solution(np.empty(0), np.zeros(len(constrained)))
    rows = lp.reward[constrained]
    scale = np.maximum(abs(rows).max(axis=1).toarray().ravel(), 1e-300)  # costs come in any unit
    needed = np.array([bounds[i] - lp.constant[i] for i in constrained])
    x = cp.Variable(lp.flow.shape[1], nonneg=True)
    requirements = [lp.flow @ x == lp.inflow]
    if constrained:
        requirements.append(rows.multiply(1 / scale[:, None]).tocsr() @ x >= needed / scale)
    problem = cp.Problem(cp.Maximize(lp.reward[[objective]].toarray()[0] @ x), requirements)
    options: dict[str, Any] = {"method": "highs-ds"}  # of SciPy's own HiGHS, which prints nothing
    options |= {"primal_feasibility_tolerance": _TOLERANCE, "dual_feasibility_tolerance": _TOLERANCE}
    if most_iterations is not None:
        options["maxiter"] = most_iterations
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that a result is inaccurate: it is refused below
            problem.solve(solver=cp.SCIPY, scipy_options=options)  # type: ignore[no-untyped-call]
        status = problem.status
    except cp.SolverError:
        status = cp.SOLVER_ERROR
    if status != cp.OPTIMAL:
        limit = f" within {counted(most_iterations, 'iteration')}" if most_iterations is not None else ""
        raise SolverError(
            f"the linear programme of {lp.flow.shape[1]} variables and {lp.flow.shape[0]} rows: HiGHS found no optimum"
            f"{limit} ({status}); shorten the windows, scale costs nearer to 1, or move the bounds a little away from "
            "what is possible"
        )
    duals = np.array(requirements[1].dual_value) if constrained else np.empty(0)
    return Solution(np.maximum(np.array(x.value), 0), np.maximum(duals, 0) / scale)


def policy_of(lp: Programme, x: Floats, otherwise: Choices) -> Weights:
    """x normalised at every place it reaches; `otherwise` where it does not."""
    n_choices = np.diff(lp.criteria.joint.model.choice_start)
    policy = []
    for t, chosen in enumerate(otherwise):
        weights = np.zeros((*chosen.shape, int(n_choices.max())))
        np.put_along_axis(weights, chosen[:, :, None].astype(np.int64), 1.0, axis=2)
        s, j = lp.nodes[t]
        node = np.repeat(np.arange(len(s)), n_choices[s])
        measure = np.zeros((len(s), weights.shape[2]))
        measure[node, _ranges(np.zeros_like(s), n_choices[s])] = x[lp.firsts[t] : lp.firsts[t + 1]]
        total = measure.sum(axis=1, keepdims=True)
        reached = total[:, 0] > 0
        measure = measure[reached] / total[reached]
        measure[measure < _NOISE] = 0
        weights[s[reached], j[reached]] = measure / measure.sum(axis=1, keepdims=True)
        policy.append(weights)
    return policy


def _reachable(criteria: Criteria) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """For each step t < h the places (s, column) that a run can be in; without costs, those with a verdict to come."""
    from scipy.sparse import csr_array

    joint = criteria.joint
    model, letter, automaton = joint.model, joint.letter, joint.automaton
    own = csr_array((np.ones(model.n_choices), np.arange(model.n_choices), model.choice_start))  # state → its choices
    back = csr_array((own @ model.matrix()).T)
    s = np.flatnonzero(model.initial)
    j = automaton.start.delta[letter[s], 0].astype(np.int64)
    nodes = []
    for t in range(joint.horizon):
        layer = automaton.layers[t]
        if not criteria.costs:
            open_ = ~layer.decided[j]
            s, j = s[open_], j[open_]
        nodes.append((s, j))
        if t + 1 == joint.horizon:
            break
        here = np.zeros((model.n_states, len(layer.states)))
        here[s, j] = 1.0
        after, column = np.nonzero(back @ here)
        there = np.zeros((model.n_states, len(automaton.layers[t + 1].states)), dtype=np.bool_)
        there[after, layer.delta[letter[after], column]] = True
        s, j = np.nonzero(there)
    return nodes


def _ranges(starts: NDArray[np.int64], lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """start, start + 1, …, start + length − 1 for each, one after the other."""
    before = np.cumsum(lengths) - lengths
    return np.repeat(starts - before, lengths) + np.arange(int(lengths.sum()))
