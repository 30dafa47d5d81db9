"""`optimality_gap`: how far a policy is at most from the best one, from the transitions seen while learning.

**Tied.** If rows depend on one parameter, the same in all rows, it lies in [lo, hi] with confidence 1 − α (tied.py).
Then, with the *same* parameter on both sides,

    P* − P(π) ≤ max over [lo, hi] of P*(p) − P_π(p) ≤ max_i (U_i − L_i),

U and L the Bernstein coefficients of a polynomial that no policy exceeds, and of P_π (checking/parametric.py); [lo, hi]
is halved while that helps. Several parameters, or one whose polynomials take too long, are bounded row by row: nature
picks them again in every row, with the induction of the untied gap below, where Σ p·U and Σ p·L of rows with the same
parameter have the same value of it. `policy=None` is the policy that is optimal at the estimates of the parameters.

**Untied.** Where the possible successors are known, rows lie in intervals with confidence 1 − α (guarantee.py). With
optimistic U ≥ V* and pessimistic L ≤ V^π from the same sweeps,

    D_t(s,q) = max( nature's greatest Σ p·D_{t+1} under π's choice,
                    greatest Σ p·U_{t+1} of another choice − least Σ p·L_{t+1} of π's ),       cut to [0, U_t − L_t]

and V* − V^π ≤ D: if the best choice is π's own, the difference continues in the next step; otherwise it is the second
term. Rounding: each of the three sums errs by at most 8du a sweep (checking/robust.py), D by their sum.

Both hold at any number of transitions at once, so one may stop as soon as the gap is small: of many runs, at most a
share α is ever given a gap that is too small. That is a promise per run, not per run that stopped: where hardly any run
stops, most that do may be wrong.

While learning (`Certifier`) the tied gap is given as long as the data do not contradict the tie, and the untied one
afterwards. If the tie is right, either of them can be wrong, the second after a false alarm: each has α/2.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import one_of, require
from stltool.automata import FALSE, TRUE
from stltool.checking import check
from stltool.checking.induction import Arithmetic, Budget, Edges, Game, Nature, Values, layers_of, solve
from stltool.checking.induction.arithmetic import row_sums
from stltool.checking.parametric import Family
from stltool.checking.robust import rows_defect
from stltool.checking.statistical import require_confidence
from stltool.choices import Form
from stltool.display import Card, Displayed, counted
from stltool.errors import SettingsError, SizeError, TieError, named
from stltool.learning.counts import Counts
from stltool.learning.guarantee import (
    Successors,
    by_rows,
    family_of,
    initial_of,
    interval_model,
    polynomial_too_long,
    possible_successors,
)
from stltool.learning.tied import Evidence, TiedParameter
from stltool.models.rows import Rows
from stltool.numbers import ceiling_text, exact, round_up
from stltool.policy import Policy, require_door
from stltool.product import Product, with_outcome

_HALVINGS = 6
_WITHOUT_DATA = 3  # halvings
_WHAT = "bounding the gap to the optimum"
_U = Fraction(1, 2**53)


@dataclass(frozen=True, eq=False, repr=False)
class Gap(Displayed):
    """How far a policy is at most from the best one.

    upper         with `confidence`, P* − P(policy) is at most this; rounded up
    without_data  what graph and assumptions alone say of the best policy that needs no data, from no transition at all:
                  a small number says that the data contributed little
    parameters    if rows are tied: in which sets the parameters lie
    looser        with parameters: why the gap may be larger than the tie allows; None: they were bounded together
    refused       while learning: the alarm's message if it refused the model's parameters; None: they were used, or
                  there are none
    """

    upper: float
    confidence: float
    without_data: float
    transitions: int
    policy: Policy
    parameters: tuple[TiedParameter, ...] = ()
    seconds: float = 0.0
    looser: str | None = None
    refused: str | None = None

    @property
    def assumes(self) -> str:
        """What the bound assumes in addition to the data."""
        if self.parameters:
            names = " and ".join(one.name for one in self.parameters)
            return f"the probabilities are known up to {names}, the same everywhere, which the data do not contradict"
        refused = ", and not the same everywhere, as the model says" if self.refused is not None else ""
        return f"the possible successors are known, their probabilities are not{refused}"

    @property
    def statement(self) -> str:
        """What was found, in words; bounds are rounded up."""
        return (
            f"with confidence {100 * self.confidence:.12g} % the policy is within {ceiling_text(self.upper)} of the "
            f"optimum, from {self.transitions} transitions (from none: {ceiling_text(self.without_data)}); assumed: "
            f"{self.assumes}" + (f"; {self.looser}" if self.looser is not None else "")
        )

    def _card(self) -> Card:
        shown = ceiling_text(self.upper)
        return Card(
            f"Gap: P* - P(policy) <= {shown} with confidence {100 * self.confidence:.12g} %",
            [
                {
                    "from": counted(self.transitions, "transition"),
                    "parameters": ", ".join(one.text for one in self.parameters) or None,
                    "looser": "see statement" if self.looser is not None else None,
                    "without data": ceiling_text(self.without_data),
                },
                {"policy": self.policy.kind},
            ],
        )


def optimality_gap(
    product: Product,
    policy: Policy | None,
    counts: Counts,
    *,
    confidence: float = 0.99,
    parameters: Literal["model"] | None = None,
    successors: Successors | None = None,
    start: int | None = None,
    memory_limit: int | None = None,
) -> Gap:
    """How far `policy` is at most from the best of all policies, from the transitions in `counts`.

    policy      deterministic; None, with parameters: the policy that is optimal at their estimates, as the result's
                `policy`
    parameters  "model": rows depend on parameters, the same in all of them; None: the model's graph is known
    successors, start   as in `guarantee`

    Raises SettingsError for settings out of range and counts that the model excludes, TieError if the data contradict
    the tie, PolicyError if the policy does not fit, SizeError before allocating more memory than is available.
    """
    require_door("optimality_gap", product, policy)
    require(counts, Counts, "optimality_gap's counts")
    require_confidence(confidence)
    if parameters is not None:
        one_of(parameters, "optimality_gap's parameters", ("model",))
        if successors is not None:
            raise SettingsError("a model with parameters knows its successors; leave out successors or parameters")
        return TiedGaps(product, confidence, start, memory_limit).of(counts, policy)
    if policy is None:
        raise SettingsError("without parameters, optimality_gap needs a policy; give one, such as stl.learn's")
    return UntiedGaps(product, confidence, successors, start, memory_limit).of(counts, policy)


class TiedGaps:
    """Gaps of policies for one product whose rows depend on parameters.

    enough   a gap that is not improved
    sets     the confidence of the parameters' sets; default: that of the gap, which the alarm has
    """

    def __init__(
        self,
        product: Product,
        confidence: float,
        start: int | None = None,
        memory_limit: int | None = None,
        enough: float = 0.0,
        sets: float | Fraction | None = None,
    ) -> None:
        family = family_of(product.model, initial_of(product.model, start))
        self._product, self._confidence, self._enough = product, confidence, enough
        self._of_sets = 1 - exact(sets if sets is not None else confidence)
        self._home, self._memory_limit = replace(product, model=family), memory_limit
        self._family, self._looser = None, None
        if len(family.parameters) == 1:
            self._family = Family(self._home, family.parameters[0], True, Budget(_WHAT, memory_limit))
            self._looser = polynomial_too_long(self._family)
        domains = [TiedParameter(one.name, one.lower, one.upper, (one.lower + one.upper) / 2, 0)
                   for one in family.parameters]  # fmt: skip
        if self._looser is None and self._family is not None:
            try:
                self._without = self._found(domains, self._best(domains), _WITHOUT_DATA)
                return
            except SizeError:
                self._looser = "its polynomials take more memory than is available"
        self._family, self._looser = None, by_rows(domains, self._looser)
        self._without = self._found(domains, self._best(domains), _WITHOUT_DATA)

    def of(self, counts: Counts, policy: Policy | None = None) -> Gap:
        """TieError if the data contradict the tie."""
        began = time.perf_counter()
        evidence = Evidence(self._home.model, counts)
        evidence.require_tied(1 - exact(self._confidence))
        sets = evidence.sets(self._of_sets)
        if policy is None:
            judged = self._best(sets)
            policy = Policy(self._product, judged.form)
        else:
            judge, rebased = policy.on(self._product)
            if judge is not self._product:
                raise SettingsError("the gap is of policies over the product's own automaton; give one of those")
            judged = Policy(self._home, rebased.form)
        found = self._found(sets, judged, _HALVINGS)
        return Gap(
            min(found, 1.0), float(self._confidence), min(self._without, 1.0), int(counts.visits.sum()), policy,
            sets, time.perf_counter() - began, self._looser,
        )  # fmt: skip

    def _best(self, sets: Sequence[TiedParameter]) -> Policy:
        """The policy that is optimal at the estimates."""
        if self._family is not None:
            return self._family.best(sets[0].estimate)
        member = self._home.model.at(**{one.name: one.estimate for one in sets})
        best = check(replace(self._home, model=member), memory_limit=self._memory_limit).policy
        assert best is not None
        return Policy(self._home, best.form)

    def _found(self, sets: Sequence[TiedParameter], policy: Policy, halvings: int) -> float:
        if self._family is not None:
            found = self._gap(policy, sets[0].lower, sets[0].upper, halvings)
            self._family.forget(policy)
            return found
        if not policy.deterministic:
            raise SettingsError(_MIXED)
        narrow = self._home.model.within(**{one.name: (one.lower, one.upper) for one in sets})
        return _solved(replace(self._home, model=narrow), _TiedGaps(policy.form, sets), self._memory_limit)

    def _gap(self, policy: Policy, lower: Fraction, upper: Fraction, halvings: int) -> float:
        """The greatest gap on [lower, upper], from above."""
        family = self._family
        assert family is not None
        (least, most) = family.enclosed(family.optimum(lower, upper))
        below, above = family.enclosed(family.of(policy, lower, upper), policy)
        found = float(np.max(most - below)) * (1 + 2.0**-50)
        at_ends = max(least[0] - above[0], least[-1] - above[-1])  # which halving does not improve
        improves = found > max(self._enough, 1.1 * at_ends, 1e-9) and not 0 < self._enough < at_ends
        if not improves or halvings == 0 or lower == upper:
            return found
        middle = (lower + upper) / 2
        return max(self._gap(policy, *ends, halvings - 1) for ends in ((lower, middle), (middle, upper)))


class UntiedGaps:
    """Gaps of policies for one product of which the possible successors are known."""

    def __init__(
        self,
        product: Product,
        confidence: float | Fraction,
        successors: Successors | None = None,
        start: int | None = None,
        memory_limit: int | None = None,
    ) -> None:
        model = product.model
        if model.blackbox is not None and successors is None:
            raise SettingsError(
                f"{model.name} is a black box, whose possible successors are not known; give successors, or "
                f"{named('until_gap', 'leave until_gap out')}"
            )
        self._product, self._confidence, self._memory_limit = product, confidence, memory_limit
        self._initial = initial_of(model, start)
        self._successors = possible_successors(model, successors) if successors is not None else None
        self._without: float | None = None

    def of(self, counts: Counts, policy: Policy) -> Gap:
        began = time.perf_counter()
        if self._without is None:
            self._without = self._gap(Counts(counts.n_choices, counts.n_states), policy)
        found = self._gap(counts, policy)
        return Gap(
            found, float(self._confidence), self._without, int(counts.visits.sum()), policy,
            seconds=time.perf_counter() - began,
        )  # fmt: skip

    def _gap(self, counts: Counts, policy: Policy) -> float:
        if not policy.deterministic:
            raise SettingsError(_MIXED)
        judge, rebased = policy.on(self._product)
        model = interval_model(self._product.model, self._initial, counts, self._confidence, self._successors)
        return _solved(with_outcome(judge, model, FALSE), _Gaps(rebased.form), self._memory_limit)


_MIXED = "the gap is of deterministic policies; this one mixes actions"


def _solved(product: Product, gaps: _Gaps, memory_limit: int | None) -> float:
    """The gap at the start, rounded up."""
    layers = layers_of(Game.of(product), TRUE, sure=False, budget=Budget(_WHAT, memory_limit))
    found = solve(layers, gaps, True).entry
    model = product.model
    share = model.initial[np.flatnonzero(model.initial)]
    value = Fraction(math.fsum(share * found[:, _D]))
    h, kinds = product.horizon, layers.kinds
    slack = 4 * h * (8 * kinds.longest * _U + 2 * rows_defect(kinds)) + 4 * model.initial_defect + 8 * _U
    return round_up(min(value + slack, Fraction(1)))


_UP, _LOW, _D = range(3)


class _Gaps(Arithmetic):
    """A layer is (n + 2, 3): U, L and D of the module's text, for a policy's choices."""

    repeats = False

    def __init__(self, form: Form) -> None:
        self._form = form
        self._natures = (Nature(False, True), Nature(True, True), Nature(False, True))

    def begin(self, rows: Rows) -> None:
        for nature in self._natures:
            nature.begin(rows)

    def ends(self, t: int) -> tuple[Values, Values]:
        return np.zeros(3), np.array([1.0, 1.0, 0.0])

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        columns = zip(self._natures, np.ascontiguousarray(ahead.T), strict=True)
        return np.stack([nature.sums(t, edges, column) for nature, column in columns], axis=1)

    def away(self, sums: Values, owner: NDArray[np.int64]) -> Values:
        """(choices,) what is lost at most by the policy's choice, `owner` of each choice, if that one is best."""
        lost: Values = sums[:, _UP] - sums[owner, _LOW]
        return lost

    def back(
        self, t: int, edges: Edges, ahead: Values, maximize: bool, keep: bool
    ) -> tuple[Values, NDArray[np.int64] | None]:
        sums, first = self.sums(t, edges, ahead), edges.choices[:-1]
        taken = np.maximum(self._form.at(t, edges.s, edges.q), 0)  # where the policy never gets, any choice will do
        own = first + taken
        away = self.away(sums, np.repeat(own, np.diff(edges.choices)))
        away[own] = sums[own, _D]
        upper, lower = np.maximum.reduceat(sums[:, _UP], first), sums[own, _LOW]
        gap = np.minimum(np.maximum(np.maximum.reduceat(away, first), 0.0), upper - lower)
        return np.stack([upper, lower, gap], axis=1), None


class _TiedGaps(_Gaps):
    """The same where nature picks every row's parameters in their sets; at one step of a run, in all rows the same."""

    def __init__(self, form: Form, sets: Sequence[TiedParameter]) -> None:
        self._form = form
        self._box = {one.name: one.lower for one in sets}, {one.name: one.upper for one in sets}

    def begin(self, rows: Rows) -> None:
        self._ends = [rows.tied_at(end) for end in self._box]
        ties = rows.chances.ties
        assert ties is not None
        of_class = np.array([k if a != b else -1 for k, a, b in ties.classes])
        self._of_row = np.maximum.reduceat(of_class[rows.tied_class], rows.row_start[:-1])  # which parameter
        self._at: list[Values] = []

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        values = ahead[edges.child]
        self._at = [
            np.stack([row_sums(end[edges.entry] * column, edges.start) for column in values.T], axis=1)
            for end in self._ends
        ]
        self._parameter = self._of_row[edges.choice]
        first, last = self._at
        found = np.maximum(first, last)
        found[:, _LOW] = np.minimum(first[:, _LOW], last[:, _LOW])
        return found

    def away(self, sums: Values, owner: NDArray[np.int64]) -> Values:
        first, last = (super(_TiedGaps, self).away(at, owner) for at in self._at)
        same = self._parameter == self._parameter[owner]
        return np.where(same, np.maximum(first, last), super().away(sums, owner))


class Certifier:
    """Certifies the gap of a run while it learns: tied where the model depends on parameters, as long as the data do
    not contradict it; otherwise untied. With a tie, each of the two has half of 1 − confidence.
    """

    def __init__(self, home: Product, product: Product, counts: Counts, until: float, confidence: float) -> None:
        self._learners, self._product, self._counts, self.until = home, product, counts, until
        self.last: Gap | None = None
        self._confidence = confidence
        self._tied: TiedGaps | None = None
        share: float | Fraction = confidence
        if product.model.family is not None:
            share = 1 - (1 - exact(confidence)) / 2
            self._tied = TiedGaps(product, confidence, enough=until, sets=share)
        self._untied = UntiedGaps(product, share)

    def __call__(self, policy: Callable[[], NDArray[Any] | Form]) -> Gap:
        """The gap of the policy that is best at the estimates; untied, of the learner's."""
        self.last = self._found(policy)
        return self.last

    def _found(self, policy: Callable[[], NDArray[Any] | Form]) -> Gap:
        refused = None
        if self._tied is not None:
            try:
                return self._tied.of(self._counts)
            except TieError as error:
                refused = str(error)
        found = self._untied.of(self._counts, Policy(self._learners, policy()))
        return replace(found, confidence=float(self._confidence), refused=refused)


def due(episode: int) -> bool:
    """Whether a gap is certified after this episode: at first after each, then whenever there are a twentieth more."""
    return episode < 20 or math.floor(math.log(episode, 1.05)) > math.floor(math.log(episode - 1, 1.05))
