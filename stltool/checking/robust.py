"""`robust_check`: the probability of a task if the model's probabilities are known only as intervals.

    V_t(s,q) = 1 / 0                                                  if verdict_t(q) is true / false
             = opt_c nature_{p ∈ P(c)} Σ_s' p(s') · V_{t+1}(s', δ(L(s'), q))     otherwise
    P(c)     = { lower ≤ p ≤ upper, Σ p = 1 }

opt is max or min over the state's choices, or a policy's mixture; nature is adversarial (max–min, min–max) or
cooperative (max–max, min–min). Nature chooses again at every step and knows (t, s, q) and the choice taken: the
dynamic, (s,a)-rectangular semantics. These are the values over all history-dependent policies and natures [Iyengar05]
[Nilim05]. A fixed distribution is one of nature's strategies; so if one governs the whole run, a policy's value there
is at least its value under adversarial nature, and at most its value under cooperative nature.

Where a row depends on a parameter (models/parameters.py), nature picks that parameter in its domain, again at every
row; the row's sum is linear in it, so it is worst at an end (induction/tied.py).

The inner optimum needs no solver: start from the lower ends and distribute the budget 1 − Σ lower in the order of W, to
each entry at most its width [Givan00]: a fractional knapsack. h sweeps, no stopping rule.

**The enclosure.** Let a row have d entries, u = 2⁻⁵³, ends lower*, upper* as given and lower, upper their doubles. By
duality, for W in [0, 1], nature's maximum is min over λ in [0, 1] of

    S·λ + Σ_k (W_k − λ)⁺·upper_k − Σ_k (λ − W_k)⁺·lower_k,       S = 1 the mass distributed.

So ends moved by η_k each and mass moved by σ move it by at most Σ η_k + |σ|. The loop adds Σ lower·W and Σ take·W. Its
weights p̂ = lower + take are optimal for the ends lower, lower + fl(upper − lower) and for their own mass Σ p̂: every
error of the loop is one of ends or mass, or of the last sums. Ends: two roundings (decimals to doubles, the width),
η_k ≤ 2u, 2du in all. Mass: d additions and d subtractions of at most one, 2du; or, if the budget is negative or exceeds
the widths, the error of the ends, also 2du. Sums: 2d products of at most one in all, u, and 2d − 1 additions of at most
one. Together 6du and terms of second order, less than 8du if d ≤ 2²⁰. Minimum: 1 − W. The exact operator moves values
by no more than W moves, so h sweeps add up to 8hdu = h·d·2⁻⁵⁰; a mixture of m choices adds 2mu a sweep. Rows of doubles
may miss Σ lower ≤ 1 ≤ Σ upper by a defect D: it counts as moved ends and moved mass, 2D a sweep; the weights of a
mixture likewise.
"""

from __future__ import annotations

import itertools
import math
import time
from fractions import Fraction
from typing import Literal, get_args

import numpy as np

from stltool.arguments import flag, function, one_of, whole
from stltool.automata import FALSE, TRUE
from stltool.checking.bounds import compounded, defect, enclose
from stltool.checking.check import CheckResult, NaturesAim, ValuesOf, undefined
from stltool.checking.induction import (
    EVERYTHING,
    Arithmetic,
    Budget,
    Engine,
    ExactNature,
    Following,
    Game,
    Progress,
    Silent,
    Tied,
    layers_of,
    solve,
)
from stltool.checking.induction import Nature as NaturesChoice
from stltool.checking.rational import require_room
from stltool.checking.values import StateValues, of_doubles, of_fractions
from stltool.errors import ModelError, SettingsError, named
from stltool.models.rows import Rows
from stltool.numbers import round_down, round_up
from stltool.policy import Policy, require_door
from stltool.product import Product
from stltool.sizes import seconds_of

Nature = Literal["against", "with"]

_LONGEST_ROW = 2**20
_U = Fraction(1, 2**53)


def robust_check(
    product: Product,
    policy: Policy | None = None,
    *,
    maximize: bool = True,
    nature: Nature = "against",
    exact: bool = False,
    keep_policy: bool = True,
    values: ValuesOf | None = None,
    engine: Engine = "auto",
    threads: int | None = None,
    memory_limit: int | None = None,
    time_limit: float | None = None,
    progress: Progress | None = None,
) -> CheckResult:
    """The guaranteed (or best possible) probability that the task holds, on a model with intervals.

    maximize, nature   True, "against": max–min, what the best policy guarantees     True, "with": max–max
                       False, "against": min–max                                     False, "with": min–min
    policy             None: the optimum over all policies. Given: its least probability if nature opposes a maximum or
                       supports a minimum, else its greatest; nature knows which choice a mixture has taken
    exact              True: also the exact fraction; ends in fractions and decimals mean exactly that
    keep_policy        False: do not return the optimal policy
    values             "initial": also P from each initial state; "all": from every state
    engine, threads    as in `check`
    time_limit         of exact answers: the seconds that they may take by estimate; more are a SizeError

    Raises SettingsError for a model without intervals, PolicyError if the policy belongs to another task or model or
    defines no action in a state that it may reach, SizeError before allocating more memory than is available.
    """
    start = time.perf_counter()
    require_door("robust_check", product, policy)
    flag(maximize, "robust_check's maximize")
    flag(exact, "robust_check's exact")
    flag(keep_policy, "robust_check's keep_policy")
    one_of(nature, "nature", get_args(Nature))
    one_of(engine, "engine", get_args(Engine))
    if values is not None:
        one_of(values, "values", get_args(ValuesOf))
    threads = whole(threads, "robust_check's threads", 1) if threads is not None else None
    limit = seconds_of(time_limit, "time_limit") if time_limit is not None else None
    function(progress, "robust_check's progress")
    if not product.model.uncertain:
        product.model.require_points()
        raise SettingsError(
            f"the model has no intervals; use {named('check', 'stl.check')}, or give them with MDP.from_intervals or "
            "success = [lo, hi]"
        )
    judge, judged = policy.on(product) if policy is not None else (product, None)
    keep = product.model.unsigned_choice_type if policy is None and keep_policy else None
    question: Literal["maximum", "minimum", "policy"]
    question = "policy" if judged is not None else "maximum" if maximize else "minimum"
    minimal = maximize == (nature == "against")
    aim: NaturesAim = "least" if minimal else "greatest"
    arithmetic: Arithmetic = NaturesChoice(minimal=minimal, maximize=maximize)
    if parameters := product.model.parameters:
        first, last = {one.name: one.lower for one in parameters}, {one.name: one.upper for one in parameters}
        if exact:
            raise SettingsError("a model whose parameters have no values has no exact robust answer; leave out exact")
        arithmetic = Tied(first, last, minimal=minimal, maximize=maximize)
    allowed = EVERYTHING if judged is None else Following(judged.form)
    budget = Budget(f"checking {product.n_states} product states", memory_limit, progress)
    game, goal = Game.of(judge, values == "all"), TRUE if maximize else FALSE
    try:
        layers = layers_of(game, goal, allowed, engine=engine, keep=keep, threads=threads, budget=budget)
        longest = require_short_rows(layers.kinds)
        if exact:
            arithmetic = ExactNature(minimal, require_exact_ends(product, layers.kinds), maximize)
            require_room(layers, 64, memory_limit=memory_limit, time_limit=limit)
        found = solve(layers, arithmetic, maximize, keep)
    except Silent:
        assert judged is not None
        raise undefined(judge, judged, everywhere=values == "all") from None
    starts = np.searchsorted(game.first, np.flatnonzero(product.model.initial))
    if isinstance(arithmetic, ExactNature):
        fractions = [Fraction(arithmetic.number(value), arithmetic.one) for value in found.entry.tolist()]
        shares = (product.model.initial_share(s) for s in game.first[starts].tolist())
        exactly = sum((share * fractions[i] for share, i in zip(shares, starts.tolist(), strict=True)), Fraction(0))
        if found.choices is not None:
            policy = Policy(product, found.choices)
        return CheckResult(
            product, question, float(exactly), round_down(exactly), round_up(exactly), policy, found.swept,
            time.perf_counter() - start, fraction=exactly, arithmetic="rational", nature=nature,
            natures_aim=aim, certain=bool(found.certain[starts].all()) and exactly in (0, 1), engine=found.engine,
            values=StateValues(product.model, game.first, *of_fractions(fractions), tuple(fractions))
            if values is not None else None,
        )  # fmt: skip
    value = math.fsum(product.model.initial[game.first[starts]] * found.entry[starts])
    weight_defect, mixed = Fraction(0), 0
    if judged is not None and not judged.deterministic:
        weights = judged.form.mixtures()
        mixed, weight_defect = weights.shape[1], defect(weights.tolist())
    initial_defect = product.model.initial_defect
    a_sweep = (8 * longest + 2 * mixed) * _U + 2 * rows_defect(layers.kinds) + 2 * weight_defect
    growth = product.horizon * weight_defect + initial_defect  # by what weight defects enlarge earlier errors
    slack = compounded(product.horizon * a_sweep + initial_defect, growth)
    lower, upper = enclose(value, 3, slack, underflow=False)  # the initial sum; the slack of a sweep is larger
    value = min(max(value, 0.0), 1.0)
    certain = bool(found.certain[starts].all()) and value in (0.0, 1.0)
    if certain:  # whatever nature does, without any rounding
        lower = upper = value
    if found.choices is not None:
        policy = Policy(product, found.choices)
    each = None
    if values is not None:
        slack = compounded(product.horizon * a_sweep, product.horizon * weight_defect)
        each = StateValues(product.model, game.first, *of_doubles(found.entry, found.certain, 0, slack, False))
    seconds = time.perf_counter() - start
    return CheckResult(
        product, question, value, lower, upper, policy, found.swept, seconds, nature=nature, natures_aim=aim,
        certain=certain, engine=found.engine, values=each,
    )  # fmt: skip


def require_short_rows(rows: Rows) -> int:
    """The length of the longest row. SettingsError if the enclosure's proof does not cover it."""
    if rows.longest > _LONGEST_ROW:
        raise SettingsError(f"a row has {rows.longest} entries; robust checks support up to {_LONGEST_ROW}")
    return rows.longest


def require_exact_ends(product: Product, kinds: Rows) -> int:
    """The common denominator of the ends. ModelError unless every row contains a distribution exactly."""
    rows = product.model.rows if product.model.kinds is not None else kinds
    assert rows.intervals is not None
    lower, upper, denominator = rows.intervals.exact
    least, most = (np.add.reduceat(ends, rows.row_start[:-1]) for ends in (lower, upper))
    wrong = np.flatnonzero((least > denominator) | (most < denominator))
    if len(wrong) or product.model.initial_defect:
        where = product.model.place(int(wrong[0])) if len(wrong) else "the initial distribution"
        raise ModelError(
            f"{where}: no probabilities within the ends sum to 1 exactly, so there is no exact answer or certificate; "
            'give them as fractions, such as "1/3", or as decimals'
        )
    return denominator


def rows_defect(rows: Rows) -> Fraction:
    """The largest amount, exactly, by which a row's ends violate Σ lower ≤ 1 ≤ Σ upper; repeated rows are summed
    once."""
    intervals = rows.intervals
    assert intervals is not None
    worst = Fraction(0)
    for ends, sign in ((intervals.lower, 1), (intervals.upper, -1)):
        sums = np.add.reduceat(ends, rows.row_start[:-1])
        close = (sums - 1) * sign > -_LONGEST_ROW * 2.0**-52  # allows for rounding of the sums
        bounds = itertools.compress(itertools.pairwise(rows.row_start.tolist()), close.tolist())
        for row in {ends[a:b].tobytes() for a, b in bounds}:
            worst = max(worst, sign * (sum(map(Fraction, np.frombuffer(row).tolist()), Fraction(0)) - 1))
    return worst
