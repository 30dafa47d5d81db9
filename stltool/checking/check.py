"""`check`: the best probability over all policies, or a given policy's, with its enclosure.

The optimum over all policies, history-dependent and randomised ones included, is reached by a deterministic policy of
(t, s, q); it comes with the result. A stationary policy can be strictly worse.
"""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import numpy as np

from stltool.automata import UNDECIDED
from stltool.checking.backward import Backend, Floats, Progress, induct, sweeper
from stltool.checking.bounds import can_underflow, defect, enclose, roundings
from stltool.errors import PolicyError, SettingsError
from stltool.models import MDP
from stltool.policy import Policy, silence
from stltool.product import Product
from stltool.sizes import require_memory, require_time

_RATE = 1e9  # multiply-adds a second, roughly, on one core


@dataclass(frozen=True, eq=False)
class CheckResult:
    """How a check ended.

    probability   the value computed; lower ≤ exact value ≤ upper, rounding included, for the model as given
    question      "maximum" | "minimum" (over all policies) | "policy"
    policy        the policy that attains it (None where it was not kept)
    status        "complete": all `sweeps` = horizon steps were swept; nothing was truncated
    seconds       wall time of the sweeps
    """

    product: Product
    question: Literal["maximum", "minimum", "policy"]
    probability: float
    lower: float
    upper: float
    policy: Policy | None
    sweeps: int
    seconds: float
    status: str = "complete"


def check(
    product: Product,
    policy: Policy | None = None,
    *,
    maximize: bool = True,
    keep_policy: bool = True,
    backend: Backend = "numba",
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> CheckResult:
    """The probability that the task holds: under `policy`, or the maximum (minimum) over all policies.

    `keep_policy=False` saves the memory of the optimal policy's table. Raises PolicyError when the policy belongs to
    another task or model, or says nothing about a state it reaches; SizeError before allocating what would not fit.
    """
    start = time.perf_counter()
    if backend not in ("numba", "numpy"):
        raise SettingsError(f"there is no backend {backend!r}; choose numba or numpy")
    require_time(
        product.horizon * product.model.n_transitions * product.automaton.n_states,
        _RATE,
        f"sweeping {product.n_states} product states over {product.horizon} steps",
        "shorten the windows",
    )
    weight_defect, smallest = Fraction(0), 1.0
    longest = int(np.diff(product.model.row_start).max())
    if policy is not None:
        judge, rebased = policy.on(product)
        require_memory(
            judge.check_bytes(keep_policy=False),
            f"checking {judge.n_states} product states",
            "shorten the windows",
            memory_limit,
        )
        value = _policy_value(judge, rebased, backend, progress)
        if not policy.deterministic:
            weights = np.unique(policy.table.reshape(-1, policy.table.shape[-1]), axis=0)
            weight_defect = defect(weights.tolist())
            smallest = _smallest(weights)
        mixed = 0 if policy.deterministic else policy.table.shape[-1]
        question: Literal["maximum", "minimum", "policy"] = "policy"
    else:
        mixed = 0
        sweep = sweeper(product, backend)
        question = "maximum" if maximize else "minimum"
        require_memory(
            product.check_bytes(keep_policy),
            f"checking {product.n_states} product states over {product.horizon} steps"
            + (", the policy's table included" if keep_policy else ""),
            "use keep_policy=False, or shorten the windows" if keep_policy else "shorten the windows",
            memory_limit,
        )
        tables = np.zeros((product.horizon if keep_policy else 1, *product.shape), dtype=np.int16)

        def best_choice(t: int, W: Floats, out: Floats) -> None:
            sweep.optimum(W, maximize, out, tables[t if keep_policy else 0])

        value = induct(product, best_choice, sweep.gather, progress)
        policy = Policy(product, tables) if keep_policy else None
    missing = product.horizon * (_row_defect(product.model) + weight_defect) + defect([product.model.initial])
    factors = (2 if mixed else 1) * product.horizon + 1
    underflow = can_underflow(factors, min(smallest, _smallest(product.model.probability, product.model.initial)))
    lower, upper = enclose(value, roundings(product.horizon, longest, mixed), missing, underflow)
    seconds = time.perf_counter() - start
    value = min(max(value, 0.0), 1.0)
    return CheckResult(product, question, value, lower, upper, policy, product.horizon, seconds)


def _smallest(*arrays: Floats) -> float:
    """The smallest positive entry."""
    return min(float(array[array > 0].min(initial=1.0)) for array in arrays)


def _row_defect(model: MDP) -> Fraction:
    """The largest defect of a row as given; rows that repeat are summed once."""
    if model.rounded:  # as given they sum to 1; the roundings are counted entry by entry
        return Fraction(0)
    rows = {model.probability[a:b].tobytes() for a, b in itertools.pairwise(model.row_start.tolist())}
    return defect(np.frombuffer(row).tolist() for row in rows)


def _policy_value(product: Product, policy: Policy, backend: Backend, progress: Progress | None) -> float:
    sweep = sweeper(product, backend)

    def follow(t: int, W: Floats, out: Floats) -> None:
        if policy.deterministic:
            sweep.policy(W, policy.at(t), out)
        else:
            sweep.mixture(W, policy.at(t), out)

    value = induct(product, follow, sweep.gather, progress)
    if math.isnan(value):
        raise _undefined(product, policy)
    return value


def _undefined(product: Product, policy: Policy) -> PolicyError:
    """The first reachable place where the policy says nothing (its NaN reached the start), in the user's names."""
    model, automaton = product.model, product.automaton
    reached = {(int(s), product.enter(int(s), automaton.initial)) for s in np.flatnonzero(model.initial)}
    for t in range(product.horizon):
        verdicts, table = automaton.verdicts(t), policy.at(t)
        following = set()
        for s, q in sorted(reached):
            if verdicts[q] != UNDECIDED:
                continue
            if table[s, q] < 0:
                return silence(product, s, q, t)
            c = model.choice_start[s] + table[s, q]
            successors = model.target[model.row_start[c] : model.row_start[c + 1]]
            following |= {(int(n), product.enter(int(n), q)) for n in successors}
        reached = following
    raise AssertionError("a NaN reached the start without an undefined state")
