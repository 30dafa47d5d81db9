"""`check`: the best probability over all policies, or a given policy's, with its enclosure.

The optimum over all policies, history-dependent and randomised ones included, is reached by a deterministic policy of
(t, s, q); it comes with the result. A stationary policy can be strictly worse.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import numpy as np

from stltool.arguments import flag, function, one_of, real
from stltool.checking.backward import BACKENDS, Backend, Floats, Progress, Values, induct, sweep_of, sweeper
from stltool.checking.bounds import can_underflow, compounded, defect, enclose, model_defects, roundings
from stltool.checking.fixed import FixedPoint, fixed_point
from stltool.checking.rational import exact_probability, require_exact
from stltool.checking.reach import policy_layers
from stltool.display import Card, Displayed
from stltool.errors import PolicyError, SettingsError, named
from stltool.numbers import round_down, round_up
from stltool.policy import Policy, require_door
from stltool.product import Product
from stltool.sizes import Numbers, require_memory, require_time

_RATE = 1e9  # multiply-adds a second, roughly, on one core
_LONG = 10**30  # denominators that a short description leaves out
_NAMED = 3  # silent places in a message
_SHARP = 1e-9  # the relative width below which a fixed-point enclosure is not swept again in doubles


@dataclass(frozen=True, eq=False, repr=False)
class CheckResult(Displayed):
    """How a check ended.

    probability   the value computed; lower ≤ exact value ≤ upper, rounding included, for the model as given
    question      "maximum" | "minimum" (over all policies) | "policy"
    policy        the policy that attains it (None where it was not kept)
    nature        where the probabilities are intervals: whether they fall "against" or "with" what is asked for
    fraction      the exact value where it was asked for; lower and upper are then the doubles next to it
    arithmetic    "double" | "fixed" (int64, rounded up) | "rational": what the enclosure rests on
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
    fraction: Fraction | None = None
    arithmetic: Literal["double", "fixed", "rational"] = "double"
    status: str = "complete"
    nature: Literal["against", "with"] | None = None

    def at_least(self, bound: float | Fraction) -> bool | None:
        """Whether the exact value is at least `bound`; None where the bound lies inside the enclosure."""
        bound = real(bound, "at_least's bound")
        lower, upper = (self.lower, self.upper) if self.fraction is None else (self.fraction, self.fraction)
        return True if lower >= bound else False if upper < bound else None

    def at_most(self, bound: float | Fraction) -> bool | None:
        """Whether the exact value is at most `bound`; None where the bound lies inside the enclosure."""
        bound = real(bound, "at_most's bound")
        lower, upper = (self.lower, self.upper) if self.fraction is None else (self.fraction, self.fraction)
        return True if upper <= bound else False if lower > bound else None

    def _card(self) -> Card:
        asked = {
            "maximum": "maximum over all policies",
            "minimum": "minimum over all policies",
            "policy": "of the policy",
        }
        nature = f", nature {self.nature}" if self.nature is not None else ""
        exact = self.fraction is not None and self.fraction.denominator < _LONG
        return Card(
            f"CheckResult: P = {self.probability!r}, {asked[self.question]}{nature}, {self.status}",
            [
                {"bounds": f"[{self.lower!r}, {self.upper!r}]", "exactly": self.fraction if exact else None},
                {"task": f"{self.product.task_name} := {self.product.formula}", "model": self.product.model.name},
            ],
        )


def check(
    product: Product,
    policy: Policy | None = None,
    *,
    maximize: bool = True,
    exact: bool = False,
    keep_policy: bool = True,
    arithmetic: Literal["auto", "double", "fixed"] = "auto",
    backend: Backend = "numba",
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> CheckResult:
    """The probability that the task holds: under `policy`, or the maximum (minimum) over all policies.

    `exact=True` adds the fraction itself. `arithmetic="auto"` takes fixed point where its enclosure is the narrower
    one, doubles elsewhere. `keep_policy=False` saves the memory of the optimal policy's table. Raises PolicyError when
    the policy belongs to another task or model, or says nothing about a state it reaches; ModelError when an exact
    answer is asked of rows that do not sum to 1; SizeError before allocating what would not fit.
    """
    start = time.perf_counter()
    require_door("check", product, policy)
    for switch, name in ((maximize, "maximize"), (exact, "exact"), (keep_policy, "keep_policy")):
        flag(switch, f"check's {name}")
    one_of(backend, "backend", BACKENDS)
    one_of(arithmetic, "arithmetic", ("auto", "double", "fixed"))
    function(progress, "check's progress")
    if exact:
        require_exact(product.model)
    question: Literal["maximum", "minimum", "policy"]
    question = "policy" if policy is not None else "maximum" if maximize else "minimum"
    kept = policy is None and keep_policy
    judge, rebased = policy.on(product) if policy is not None else (product, None)
    require_sweeps(judge, kept, _RATE, memory_limit)
    tables = np.zeros((product.horizon if kept else 1, *product.shape), dtype=product.model.choice_type)
    sweeps = _Sweeps(judge, rebased, maximize, tables, backend, progress)
    used: Literal["double", "fixed", "rational"]
    fraction = None
    if exact:
        if rebased is not None:
            sweeps.enclosed("double")  # finds where the policy says nothing
        choices = tables if kept else None
        fraction = exact_probability(judge, rebased, maximize, choices, memory_limit=memory_limit, progress=progress)
        value, lower, upper, used = float(fraction), round_down(fraction), round_up(fraction), "rational"
    else:
        value, lower, upper, used = sweeps.enclosed(arithmetic)
    if kept:
        policy = Policy(product, tables)
    seconds = time.perf_counter() - start
    return CheckResult(
        product, question, value, lower, upper, policy, product.horizon, seconds, fraction=fraction, arithmetic=used
    )


def require_sweeps(product: Product, keep_policy: bool, rate: float, memory_limit: int | None) -> None:
    """SizeError where sweeps at `rate` multiply-adds a second would not end, or what they hold would not fit."""
    states = f"{product.n_states} product states over {product.horizon} steps"
    nonzeros = product.model.n_transitions * product.automaton.n_states
    require_time(product.horizon * nonzeros, rate, f"sweeping {states}", "shorten the windows")
    require_memory(
        product.check_bytes(keep_policy),
        f"checking {states}" + (", the policy's table included" if keep_policy else ""),
        named("keep_policy", "use keep_policy=False, or ") * keep_policy + "shorten the windows",
        memory_limit,
    )


def or_optimal(caller: str, product: Product, policy: Policy | None, memory_limit: int | None = None) -> Policy:
    """The policy itself, or the optimal one where none is given."""
    require_door(caller, product, policy)
    if policy is not None:
        return policy
    if product.model.blackbox is not None:
        raise SettingsError(
            f"{product.model.name} is a black box, whose optimal policy is not known; give {caller} a policy, such as "
            f"{named('learn', 'stl.learn(product).policy')}"
        )
    best = check(product, memory_limit=memory_limit).policy
    assert best is not None  # checks keep it
    return best


@dataclass(frozen=True, eq=False)
class _Sweeps:
    """One question about one product, answered in fixed point or in doubles."""

    product: Product
    policy: Policy | None
    maximize: bool
    tables: Numbers
    backend: Backend
    progress: Progress | None

    def enclosed(self, arithmetic: str) -> tuple[float, float, float, Literal["double", "fixed"]]:
        """(value, lower, upper, the arithmetic it took)"""
        scale = None
        if arithmetic != "double" and (self.policy is None or self.policy.deterministic):
            scale = fixed_point(self.product.model)
        if scale is not None and (arithmetic == "fixed" or self._narrower(scale)):
            fixed = scale.enclose(self.product.model, self.product.horizon, self._entry_values(scale))
            # a small probability keeps more of its digits in doubles
            if arithmetic == "fixed" or fixed[2] - fixed[1] <= _SHARP * fixed[2]:
                return *fixed, "fixed"
        elif arithmetic == "fixed":
            raise SettingsError(
                "fixed point needs probabilities that share a small denominator, and a policy that does not mix; "
                "use arithmetic='auto'"
            )
        return *self._in_doubles(), "double"

    def _narrower(self, scale: FixedPoint) -> bool:
        h = self.product.horizon
        return scale.roundings(h) / scale.one < roundings(h, self._row_length()) * 2.0**-52

    def _row_length(self) -> int:
        return int(np.diff(self.product.model.row_start).max())

    def _entry_values(self, scale: FixedPoint | None) -> Values:
        swept = sweeper(self.product, self.backend, scale)
        sweep = sweep_of(swept, self.policy, self.maximize, self.tables)
        entry = induct(self.product, swept, sweep, self.progress)
        if self.policy is not None and (np.isnan(entry) | (entry < 0)).any():
            raise undefined(self.product, self.policy)
        return entry

    def _in_doubles(self) -> tuple[float, float, float]:
        model, h = self.product.model, self.product.horizon
        entry = self._entry_values(None)
        value = math.fsum(model.initial[np.flatnonzero(model.initial)] * entry)
        mixed, weight_defect, smallest = 0, Fraction(0), least_positive(model.probability, model.initial)
        if self.policy is not None and not self.policy.deterministic:
            weights = _distinct_mixtures(self.policy.table)
            mixed, weight_defect = weights.shape[1], defect(weights.tolist())
            smallest = min(smallest, least_positive(weights))
        row_defect, start_defect = model_defects(model)
        missing = h * (row_defect + weight_defect) + start_defect
        missing = compounded(missing, missing)
        underflow = can_underflow((2 if mixed else 1) * h + 1, smallest)
        lower, upper = enclose(value, roundings(h, self._row_length(), mixed), missing, underflow)
        return min(max(value, 0.0), 1.0), lower, upper


def _distinct_mixtures(table: Floats) -> Floats:
    """The mixtures of a table (…, C), each once and in ascending order of its weights: few, so their sums are quick."""
    rows = np.sort(table.reshape(-1, table.shape[-1]), axis=1)
    # rows are told apart by a number each, and where two share one, by themselves: that is slower by far
    number = rows.view(np.uint64) @ (2 * np.arange(1, rows.shape[1] + 1, dtype=np.uint64) ** 9 + 1)
    _, first, which = np.unique(number, return_index=True, return_inverse=True)
    distinct: Floats = rows[first]
    return distinct if np.array_equal(distinct[which.ravel()], rows) else np.unique(rows, axis=0)


def least_positive(*arrays: Floats) -> float:
    """The smallest positive entry."""
    return min(float(array[array > 0].min(initial=1.0)) for array in arrays)


def undefined(product: Product, policy: Policy) -> PolicyError:
    """Where the policy says nothing (its NaN reached the start): the places it can reach, then how many it cannot."""
    places: dict[tuple[int, int], int] = {}  # (s, q) → the first step it is reached at
    for t, layer in enumerate(policy_layers(product, policy)):
        reached = np.unpackbits(layer, count=product.n_states).reshape(product.shape).astype(np.bool_)
        for s, q in np.argwhere(reached & (policy.at(t) < 0)).tolist():
            places.setdefault((s, q), t)
    silent = policy.table < 0
    others = int((silent if policy.stationary else silent.any(axis=0)).sum()) - len(places)
    named = list(places.items())[:_NAMED]
    shown = " | ".join(product.describe(s * product.automaton.n_states + q, t) for (s, q), t in named)
    more = f" | and {len(places) - _NAMED} more" if len(places) > _NAMED else ""
    unreached = f" ({others} others it cannot reach)" if others else ""
    return PolicyError(
        f"the policy says nothing about {shown}{more}, which it can reach{unreached}; add an action there"
    )
