"""`check`: the best probability over all policies, or a given policy's, with its enclosure.

The optimum over all policies, history-dependent and randomised ones included, is reached by a deterministic policy of
(t, s, q); it comes with the result. A stationary policy can be strictly worse (checking/stationary.py).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import flag, function, one_of, real, require, whole
from stltool.arguments import path as path_of
from stltool.asked import Asked
from stltool.automata import FALSE, TRUE
from stltool.checking.bounds import can_underflow, compounded, defect, enclose, roundings, row_defect
from stltool.checking.enclosed import Enclosed
from stltool.checking.fixed import FixedPoint, fixed_point
from stltool.checking.induction import (
    EVERYTHING,
    Allowed,
    Budget,
    Doubles,
    Engine,
    Fixed,
    Following,
    Game,
    Layers,
    OnDisk,
    Progress,
    Recorder,
    Silent,
    Solution,
    key_of,
    layers_of,
    solve,
    solve_on_cluster,
    stopped_in,
)
from stltool.checking.rational import exact_probability, require_exact
from stltool.checking.values import StateValues, of_doubles, of_fractions, of_units
from stltool.choices import Form, Table
from stltool.cluster import connected
from stltool.display import NATURES, Card, Displayed
from stltool.errors import PolicyError, SettingsError, named
from stltool.kernels.jit import SOURCES
from stltool.models.compare import ModelDifferences
from stltool.models.rows import Demand, Rows, least_positive
from stltool.numbers import round_down, round_up
from stltool.policy import Policy, layered_header, require_door, require_policy_file
from stltool.product import Product
from stltool.sizes import UnsignedType, seconds_of
from stltool.transfer import transferred

Floats: TypeAlias = NDArray[np.float64]

ValuesOf: TypeAlias = Literal["initial", "all"]
NaturesAim: TypeAlias = Literal["least", "greatest"]

_LONG = 10**30  # larger denominators are left out of a short description
_NAMED = 3  # pairs without an action, in a message
_SHARP = 1e-9  # relative width below which a fixed-point enclosure is not recomputed in doubles


@dataclass(frozen=True, eq=False, repr=False)
class CheckResult(Displayed, Enclosed):
    """How a check ended.

    probability   the computed value; lower ≤ exact value ≤ upper, rounding included, for the model as given
    question      "maximum" | "minimum" (over all policies) | "policy"
    policy        the policy that attains it (None where it was not kept)
    nature        for interval probabilities: whether nature is adversarial ("against") or cooperative ("with")
    natures_aim   for interval probabilities: whether nature makes P the "least" or the "greatest"
    fraction      the exact value if it was asked for; lower and upper are then the doubles next to it
    arithmetic    "double" | "fixed" (int64, rounded up) | "rational": what the enclosure rests on
    certain       whether 0 or 1 follows from the model's graph alone
    engine        what computed: "nodes" (pairs in numpy), "words" (sets as bits), "tiles" (these, eight numbers at a
                  time), "cluster" (tiles, by the workers of a cluster)
    sweeps        backward steps that were computed; those left out are bit for bit equal to others
    values        P from each initial state, or from every state, if asked for (checking/values.py)
    transfer      of a policy of another model: how the models differ
    status        "complete": nothing was truncated
    seconds       wall time
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
    natures_aim: NaturesAim | None = None
    certain: bool = False
    engine: str = ""
    values: StateValues | None = None
    transfer: ModelDifferences | None = None

    @property
    def certainty(self) -> str | None:
        """What the model's graph alone proves, in words; None if P is strictly between 0 and 1 or was not decided by
        the graph."""
        if not self.certain:
            return None
        happens = self.probability == 1
        return {
            "maximum": "some policy satisfies it surely" if happens else "no policy can satisfy it",
            "minimum": "every policy satisfies it surely" if happens else "some policy surely does not satisfy it",
            "policy": "the policy satisfies it surely" if happens else "the policy cannot satisfy it",
        }[self.question]

    def _card(self) -> Card:
        asked = {
            "maximum": "maximum over all policies",
            "minimum": "minimum over all policies",
            "policy": "of the policy",
        }
        nature = f", {NATURES[self.nature]}" if self.nature in NATURES else ""
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
    policy_file: str | Path | None = None,
    resume: bool = False,
    save_every: float = 300.0,
    values: ValuesOf | None = None,
    engine: Engine = "auto",
    threads: int | None = None,
    cluster: str | None = None,
    memory_limit: int | None = None,
    time_limit: float | None = None,
    transfer: bool = False,
    progress: Progress | None = None,
) -> CheckResult:
    """The probability that the task holds: under `policy`, or the maximum (minimum) over all policies.

    `exact=True` adds the exact fraction. `arithmetic="auto"` takes whichever of fixed point and doubles has the
    narrower enclosure. `keep_policy=False` does not return the optimal policy. `values="initial"` adds P from each
    initial state, with its enclosure; `values="all"` from every model state. `policy_file` (suffix .policy) receives
    the optimal policy while it is computed, so that it need not fit into memory; every `save_every` seconds, and on
    Ctrl-C, the state of the computation is saved next to it, and `resume=True` continues from there, with bit-for-bit
    the same result. `engine` and `threads` (default: all cores) change no bit of the result; nor does `cluster`, the
    address of a dask scheduler whose workers compute instead (docs/large.md). `time_limit` is for exact answers: the
    seconds that one may take, by estimate. `transfer=True` takes a policy of another model with the same state and
    action names (stltool/transfer.py); the
    result's `transfer` says how the models differ, its `policy` is the policy as it acts here.

    Raises PolicyError if the policy belongs to another task or model, or defines no action in a state it reaches;
    ModelError if an exact answer is asked for and rows do not sum to 1; SizeError before allocating more memory than is
    available, or taking more time.
    """
    start = time.perf_counter()
    require_door("check", product, policy)
    for switch, name in ((maximize, "maximize"), (exact, "exact"), (keep_policy, "keep_policy")):
        flag(switch, f"check's {name}")
    one_of(engine, "engine", get_args(Engine))
    one_of(arithmetic, "arithmetic", ("auto", "double", "fixed"))
    threads = whole(threads, "check's threads", 1) if threads is not None else None
    if values is not None:
        one_of(values, "values", get_args(ValuesOf))
    function(progress, "check's progress")
    product.model.require_points()
    resume = flag(resume, "check's resume")
    every = float(real(save_every, "check's save_every"))
    require(cluster, str, "check's cluster", "write the scheduler's address in quotes", optional=True)
    if cluster is not None:
        require_for_cluster(exact, policy, resume, engine, threads)
    limit = seconds_of(time_limit, "time_limit") if time_limit is not None else None
    moved = None
    if flag(transfer, "check's transfer"):
        if policy is None:
            raise SettingsError(f"{named('transfer', 'transfer=True')} is for a policy of another model; give one")
        moved = transferred(product, policy)
        policy = moved.policy
    path = _policy_file(policy_file, policy, keep_policy, resume)
    if exact and product.model.kinds is not None:
        require_exact(product.model, product.model.kinds)
    question: Literal["maximum", "minimum", "policy"]
    question = "policy" if policy is not None else "maximum" if maximize else "minimum"
    judge, judged = policy.on(product) if policy is not None else (product, None)
    keep = product.model.unsigned_choice_type if policy is None and keep_policy else None
    budget = Budget(f"checking {product.n_states} product states", memory_limit, progress)
    asked = _Question(judge, judged, maximize, keep, values == "all", engine, threads, budget)
    asked.cluster = cluster
    if path is not None:
        asked.goes_to(path, every, resume, "exact" if exact else arithmetic)
    fraction, fractions = None, None
    used: Literal["double", "fixed", "rational"]
    try:
        if exact:
            fraction, found, fractions = exact_probability(
                asked.layers, judge.model, maximize, keep, memory_limit=memory_limit, time_limit=limit,
                recorder=asked.recorder("exact"),
            )  # fmt: skip
            value, lower, upper, used = float(fraction), round_down(fraction), round_up(fraction), "rational"
        else:
            value, lower, upper, used, found = asked.enclosed(arithmetic)
    except Silent:
        assert judged is not None
        raise undefined(judge, judged, everywhere=values == "all") from None
    if found.choices is not None:
        policy = Policy(product, found.choices)
    return CheckResult(
        product, question, value, lower, upper, policy, found.swept, time.perf_counter() - start,
        fraction=fraction, arithmetic=used, certain=asked.certain(found), engine=found.engine,
        values=asked.of_states(found, used, fractions) if values is not None else None,
        transfer=moved.differences if moved is not None else None,
    )  # fmt: skip


def _policy_file(given: str | Path | None, policy: Policy | None, keep_policy: bool, resume: bool) -> Path | None:
    """The file for the policy; SettingsError if it does not fit the other arguments."""
    if given is None:
        if resume:
            raise SettingsError(f"{named('resume', 'resume=True')} needs {named('policy_file', 'policy_file=…')}")
        return None
    path = path_of(given, "check's policy_file")
    if policy is not None or not keep_policy:
        raise SettingsError(
            f"{named('policy_file', 'policy_file')} is for the optimal policy, which is not kept here; leave it out"
        )
    if path.suffix.lower() != ".policy":
        raise SettingsError(f"{path}: a policy saved while it is computed needs the suffix .policy; rename it")
    require_policy_file(path)
    return path


def require_for_cluster(
    exact: bool, policy: Policy | None, resume: bool = False, engine: Engine = "auto", threads: int | None = None
) -> None:
    """SettingsError for options that a cluster does not support."""
    mixes = policy is not None and not policy.deterministic
    asks = policy is not None and isinstance(policy.form, Asked)
    for given, name in (
        (asks, "a policy that is a function"),
        (exact, named("exact", "exact=True")),
        (mixes, "a policy that mixes actions"),
        (resume, named("resume", "resume=True")),
        (engine != "auto", named("engine", "engine=…")),
        (threads is not None, named("threads", "threads=…")),
    ):
        if given:
            raise SettingsError(f"{name} does not run on a cluster; leave {named('cluster', 'cluster')} out")


def or_optimal(caller: str, product: Product, policy: Policy | None, memory_limit: int | None = None) -> Policy:
    """The policy itself, or the optimal one if none is given."""
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


class _Question:
    """One question about one product: a policy's value, or the optimum, in fixed point or in doubles."""

    def __init__(
        self,
        product: Product,
        policy: Policy | None,
        maximize: bool,
        keep: UnsignedType | None,
        everywhere: bool,
        engine: Engine,
        threads: int | None,
        budget: Budget,
    ) -> None:
        self.product, self.policy, self.maximize, self.keep = product, policy, maximize, keep
        self._made = (Game.of(product, everywhere), engine, threads, budget)
        self._recorder: Callable[[str], Recorder] | None = None
        self._begun: str | None = None
        self.cluster: str | None = None

    @cached_property
    def layers(self) -> Layers[Any, Any]:
        game, engine, threads, budget = self._made
        goal, allowed = self._allowed()
        return layers_of(game, goal, allowed, engine=engine, keep=self.keep, threads=threads, budget=budget)

    @property
    def _kinds(self) -> Rows:
        known = self._made[0].rows.kinds
        return known if known is not None else self.layers.kinds

    def _allowed(self) -> tuple[int, Allowed]:
        return TRUE if self.maximize else FALSE, EVERYTHING if self.policy is None else Following(self.policy.form)

    def enclosed(self, arithmetic: str) -> tuple[float, float, float, Literal["double", "fixed"], Solution]:
        """(value, lower, upper, the arithmetic it took, the solution)"""
        scale = None
        if arithmetic != "double" and self._begun != "double" and (self.policy is None or self.policy.deterministic):
            scale = fixed_point(self.product.model, self._kinds)
        if scale is not None and (arithmetic == "fixed" or self._narrower(scale)):
            found = self._solved(Fixed(scale.denominator, scale.one, self.maximize), "fixed")
            fixed = scale.enclose(self.product.model, self.product.horizon, found.entry[self._starts()])
            # doubles keep more digits of a small probability
            if arithmetic == "fixed" or self.certain(found) or fixed[2] - fixed[1] <= _SHARP * fixed[2]:
                return *self._surely(found, fixed), "fixed", found
        elif arithmetic == "fixed":
            raise SettingsError(
                "fixed point needs probabilities with a small common denominator, and a deterministic policy; "
                "use arithmetic='auto'"
            )
        found = self._solved(Doubles(self.maximize), "double")
        return *self._surely(found, self._in_doubles(found)), "double", found

    def certain(self, found: Solution) -> bool:
        """Whether the model's graph alone makes P 0 or 1."""
        starts = self._starts()
        values = found.entry[starts] != 0
        return bool(found.certain[starts].all() and (values.all() or not values.any()))

    def of_states(self, found: Solution, used: str, fractions: Sequence[Fraction] | None) -> StateValues:
        """P from each of the states that runs may start in, from a solution in this arithmetic."""
        states, model = self._made[0].first, self.product.model
        if fractions is not None:
            return StateValues(model, states, *of_fractions(fractions), tuple(fractions))
        if used == "fixed":
            scale = fixed_point(model, self._kinds)
            assert scale is not None
            return StateValues(model, states, *of_units(found.entry, found.certain, scale, self.product.horizon))
        errors = double_errors(self.product, self._kinds, self._mixtures(), started=False)
        return StateValues(model, states, *of_doubles(found.entry, found.certain, *errors))

    def goes_to(self, path: Path, every: float, resume: bool, arithmetic: str) -> None:
        """Write the policy to this file; a resumed run continues in the arithmetic that it was using."""
        header = layered_header(self.product)
        question = [header, self.maximize, arithmetic, len(self._made[0].first), SOURCES]
        self._begun = stopped_in(path, question, resume)
        self._recorder = lambda used: OnDisk(path, header, key_of(question, used), every, resume)

    def recorder(self, arithmetic: str) -> Recorder | None:
        """Where the policy is written; None: kept in memory."""
        return self._recorder(arithmetic) if self._recorder is not None else None

    def _solved(self, arithmetic: Doubles | Fixed, name: str) -> Solution:
        if self.cluster is None:
            return solve(self.layers, arithmetic, self.maximize, self.keep, self.recorder(name))
        (game, _, _, budget), recorder = self._made, self.recorder(name)
        with connected(self.cluster, "checking on a cluster", f"leave {named('cluster')} out") as client:
            return solve_on_cluster(client, game, arithmetic, *self._allowed(), self.keep, recorder, budget)

    def _starts(self) -> NDArray[np.int64]:
        """The positions of the model's initial states among the states that runs may start in."""
        return np.searchsorted(self._made[0].first, np.flatnonzero(self.product.model.initial))

    def _surely(self, found: Solution, bounds: tuple[float, float, float]) -> tuple[float, float, float]:
        if not self.certain(found):
            return bounds
        value = float(found.entry[self._starts()[0]] != 0)
        return value, value, value

    def _narrower(self, scale: FixedPoint) -> bool:
        h = self.product.horizon
        return scale.roundings(h) / scale.one < roundings(h, self._kinds.longest) * 2.0**-52

    def _in_doubles(self, found: Solution) -> tuple[float, float, float]:
        model = self.product.model
        value = math.fsum(model.initial[np.flatnonzero(model.initial)] * found.entry[self._starts()])
        return min(max(value, 0.0), 1.0), *double_bounds(self.product, self._kinds, value, self._mixtures())

    def _mixtures(self) -> Floats | None:
        mixed = self.policy is not None and not self.policy.deterministic
        return self.policy.form.mixtures() if self.policy is not None and mixed else None


def double_bounds(product: Product, kinds: Rows, value: float, mixtures: Floats | None = None) -> tuple[float, float]:
    """The enclosure of an induction's value in doubles, over rows of these kinds; `mixtures` (k, C): the policy's
    weights."""
    return enclose(value, *double_errors(product, kinds, mixtures))


def double_errors(
    product: Product, kinds: Rows, mixtures: Floats | None, started: bool = True
) -> tuple[int, Fraction, bool]:
    """The arguments of `bounds.enclose`; unless `started`, without what the initial distribution adds."""
    h, initial = product.horizon, product.model.initial
    mixed, weight_defect, smallest = 0, Fraction(0), min(kinds.least, least_positive(initial))
    if mixtures is not None:
        mixed, weight_defect = mixtures.shape[1], defect(mixtures.tolist())
        smallest = min(smallest, least_positive(mixtures))
    missing = h * (row_defect(kinds) + weight_defect) + (product.model.initial_defect if started else 0)
    missing = compounded(missing, missing)
    underflow = can_underflow((2 if mixed else 1) * h + 1, smallest)
    return roundings(h, kinds.longest, mixed), missing, underflow


def undefined(product: Product, policy: Policy, everywhere: bool = False) -> PolicyError:
    """The pairs without an action: those that are reachable, then how many are not; with `everywhere`, from any
    state."""
    places = silent_places(product, policy, everywhere)
    form = policy.form
    others = 0
    if isinstance(form, Table):
        silent = form.table < 0
        others = int((silent if form.stationary else silent.any(axis=0)).sum()) - len(places)
    first = list(places.items())[:_NAMED]
    shown = " | ".join(product.describe(s * product.automaton.n_states + q, t) for (s, q), t in first)
    more = f" | and {len(places) - _NAMED} more" if len(places) > _NAMED else ""
    unreached = f" ({others} others are not)" if others else ""
    return PolicyError(
        f"the policy defines no action at {shown}{more}, which is reachable under it{unreached}; add an action there"
    )


def silent_places(product: Product, policy: Policy, everywhere: bool = False) -> dict[tuple[int, int], int]:
    """The pairs (s, q) that a policy reaches without defining an action, with the first step at which it does."""
    lenient = _Lenient(policy.form)
    layers = layers_of(Game.of(product, everywhere), TRUE, lenient, engine="nodes")
    for first, _, codes in layers.reached:
        s, q = np.divmod(codes, product.automaton.n_states)
        lenient.choices(layers.asked, first, s, q)  # also for the last layer
    return dict(sorted(lenient.places.items(), key=lambda place: (place[1], place[0])))


class _Lenient(Following):
    """Where the policy defines no action, its runs end, and the pair is noted."""

    def __init__(self, form: Form) -> None:
        super().__init__(form)
        self._lenient_form = form
        self.places: dict[tuple[int, int], int] = {}

    def choices(
        self, rows: Rows | Demand, t: int, s: NDArray[np.int64], q: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats | None]:
        taken = self._lenient_form.at(t, s, q)
        silent = taken < 0 if taken.ndim == 1 else ~taken.any(axis=1)
        for place in zip(s[silent].tolist(), q[silent].tolist(), strict=True):
            self.places[place] = min(t, self.places.get(place, t))
        owner = np.flatnonzero(~silent)
        if self.mixed:
            inner, number, weight = super().choices(rows, t, s[owner], q[owner])
            return owner[inner], number, weight
        here = rows.at(s[owner])  # may generate them
        return owner, rows.choice_start[here] + taken[owner], None
