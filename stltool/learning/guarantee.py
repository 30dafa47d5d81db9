"""`guarantee`: a lower bound on a policy's probability from the transitions seen while learning, and from nothing else.

**What is known with confidence 1 − α.** M choices, S states. Choice c was tried n_c times and led k_cs times to s; when
to try what was decided while looking at the data, and so was when to stop, so intervals hold at all n at once
(confidence.py). One event: every interval below holds. It fails with probability at most α by the union bound over

    support unknown   M·e(S) entries, α/2 shared equally;  M times the mass outside the successors seen, α/2 shared
                      equally, each over all sets of successors that could have been seen
    support known     Σ_c e(d_c) entries, α shared equally, d_c the successors that c has in the model's graph

e(d) counts the entries of a row of d possible successors that need an interval: d; for d = 2 one, since each is the
other's rest; for d = 1 none, the probability is 1. An entry's interval has both its ends for its share of α. A choice
that was never tried has no interval; the shares do not depend on the data.

**The bound.** Nature takes the worst distribution inside the intervals at every step (checking/robust.py); mass outside
the successors seen goes to a state where the task has failed, which is the least it can be worth. The true
distribution is one that nature may take, so on the event

    P(policy) ≥ min over nature of P(policy, nature) = `lower`      for every policy at once.

Hence the policy may be chosen from the same data: the event does not speak of it. Of all policies the one that is best
here (`policy=None`) has the greatest bound, with the same confidence.

**Tied parameters.** If rows depend on parameters (models/parameters.py), the same in all rows, all transitions are
evidence on them (tied.py), and the bound is the policy's least probability over the set where they lie: for one
parameter that of a polynomial (checking/parametric.py), never below the value if nature picks the parameters again in
every row. That value alone is the bound for several parameters, and where a polynomial takes too long: `looser` says
so. Of all policies no induction finds the one with the greatest bound, for nature cannot adapt: `policy=None` is
the best of four, optimal at the ends of the set, at the estimate, and where nature picks again.

Where runs start is a part of what is asked: the
model's initial distribution, or `start`. Its transition probabilities are never read; with the support known, its
graph is.

Sources: [Iyengar05] and [Nilim05] for the robust value, [Strehl08] for learning with such intervals.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stltool.arguments import flag, function, one_of, require, whole
from stltool.automata import FALSE, TRUE
from stltool.checking import CheckResult, Estimate, robust_check
from stltool.checking.induction import Budget, Progress
from stltool.checking.parametric import Family
from stltool.checking.polynomial import least
from stltool.checking.statistical import clopper_pearson, require_confidence
from stltool.choices import Choices
from stltool.display import Card, Displayed, counted
from stltool.errors import SettingsError, SizeError
from stltool.learning.confidence import Floats, Whole, entry_interval, log_inverse, unseen_mass
from stltool.learning.counts import Counts
from stltool.learning.tied import Evidence, TiedParameter
from stltool.models import MDP, Intervals
from stltool.models.rows import Stored
from stltool.models.sensing import ALIKE
from stltool.numbers import exact, floor_text
from stltool.policy import Policy, require_door
from stltool.product import Product, first_verdicts, with_outcome

Support: TypeAlias = Literal["unknown", "known"]
Successors: TypeAlias = "Callable[[int, int], Iterable[int]] | ArrayLike"
_TOLERANCE = 1e-7  # how far below the least value of a polynomial its bound may be


@dataclass(frozen=True, eq=False, repr=False)
class Guarantee(Displayed):
    """A lower bound on a policy's probability, from transitions seen.

    lower        with `confidence` the probability is at least this; rounded down
    support      "unknown": nothing was taken as known of where choices lead; "known": which successors they can have;
                 "given": the successors were given
    parameters   if the rows are taken as known up to parameters: in which sets these lie
    fresh        if the bound is the greater one from transitions and from these runs: the runs
    evidence     how much more probable the data are if a parameter differs somewhere (`learning/tied.py`)
    looser       with parameters: why the bound may be lower than the tie allows; None: it is the least value over their
                 sets, but for 1e-7
    transitions  how many were seen
    never_tried  how many of the `choices` (a state with one of its actions) were never tried
    policy       whose probability it is: the one given, or the one with the greatest bound
    """

    lower: float
    confidence: float
    support: Literal["unknown", "known", "given"]
    transitions: int
    choices: int
    never_tried: int
    policy: Policy
    seconds: float = 0.0
    parameters: tuple[TiedParameter, ...] = ()
    evidence: float | None = None
    fresh: Estimate | None = None
    looser: str | None = None

    def _card(self) -> Card:
        home = self.policy.home
        task = f"{home.task_name} := {home.formula}" if isinstance(home, Product) else None
        return Card(
            f"Guarantee: P >= {floor_text(self.lower)} with confidence {100 * self.confidence:.12g} %",
            [
                {
                    "from": counted(self.transitions, "transition"),
                    "successors": self.support if not self.parameters else None,
                    "parameters": ", ".join(one.text for one in self.parameters) or None,
                    "looser": "see statement" if self.looser is not None else None,
                    "never tried": f"{self.never_tried} of {counted(self.choices, 'choice')}",
                },
                {"task": task, "policy": self.policy.kind},
            ],
        )

    @property
    def statement(self) -> str:
        """What was found, in words; the bound is rounded down."""
        found = f"with confidence {100 * self.confidence:.12g} % the probability is at least {floor_text(self.lower)}"
        runs = f" and {self.fresh.runs} fresh runs" if self.fresh is not None else ""
        seen = f"from {self.transitions} transitions seen while learning{runs}"
        return f"{found}, {seen}; assumed: {self.assumes}" + (f"; {self.looser}" if self.looser is not None else "")

    @property
    def assumes(self) -> str:
        """What the bound assumes in addition to the data."""
        independent = "; the runs are independent of each other and of the learning" if self.fresh is not None else ""
        cells = "" if self.policy.home.model.sensing is None else f" but {ALIKE}"
        return self._of_rows + cells + independent

    @property
    def _of_rows(self) -> str:
        if self.parameters:
            names = " and ".join(one.name for one in self.parameters)
            tested = "which the data do not contradict" if self.evidence is not None else "which was not tested"
            return f"the probabilities are known up to {names}, the same everywhere, {tested}"
        if self.support == "unknown":
            return "nothing about the transitions"
        if self.support == "given":
            return "the possible successors are among those given"
        return "the possible successors are known, their probabilities are not"


def guarantee(
    product: Product,
    policy: Policy | None,
    counts: Counts,
    *,
    confidence: float = 0.99,
    support: Support = "unknown",
    successors: Successors | None = None,
    parameters: Literal["model"] | None = None,
    test_tie: bool = True,
    fresh: Estimate | None = None,
    start: int | None = None,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Guarantee:
    """A lower bound on the probability that the task holds under `policy`, from the transitions in `counts`.

    policy      None: the policy with the greatest bound, as the result's `policy`
    counts      transitions seen, however they were gathered: adaptively, for as long as one pleased, and also to choose
                `policy` from them. What must not be is that some that were seen are left out because of what they show.
    confidence  of the method: over many sets of data at least such a share of bounds hold
    support     "known" takes the model's graph as true: which successors each choice may have
    successors  for any model, a black box too: the successors that choices may have, or more. (M, S) Booleans for M
                choices and S states, or a function of a state and one of its actions, by their numbers, that returns
                the indices of states. It is then taken as known instead of `support`
    parameters  "model" takes the model as known up to its parameters, the same in all rows: those declared, or of a
                grid its success probability. Of the model only the graph and the form of the rows are read. With one
                parameter the bound is the least value over its set, but for 1e-7; with several, or if that takes too
                long, nature picks them again in every row, and the result says so (`looser`)
    test_tie    with parameters: refuse (TieError) where the data contradict that they are the same everywhere, or did
                so at an earlier look at these `counts`; if they are, this ever happens with a probability of at most
                1 − confidence
    fresh       fresh runs of the policy (`estimate`), whose number was fixed beforehand: the bound is the greater one
                of the two, each at half of 1 − confidence
    start       the state where every run starts, for a model that does not say it (a black box)

    Raises SettingsError for settings out of range, counts of another model's size, or counts that the known graph
    excludes; PolicyError if the policy belongs to another task or model, or defines no action in a state it may reach;
    SizeError before allocating more memory than is available.
    """
    began = time.perf_counter()
    require_door("guarantee", product, policy)
    require(counts, Counts, "guarantee's counts")
    require_confidence(confidence)
    one_of(support, "support", get_args(Support))
    if parameters is not None:
        one_of(parameters, "guarantee's parameters", ("model",))
    require(
        fresh, Estimate, "guarantee's fresh", "make one by stl.estimate(product, policy, side='lower')", optional=True
    )
    if fresh is not None and (policy is None or fresh.side == "upper"):
        raise SettingsError("fresh runs are those of one policy, with side='lower'; give guarantee the same policy")
    flag(test_tie, "guarantee's test_tie")
    function(progress, "guarantee's progress")
    model = product.model
    if (counts.n_choices, counts.n_states) != (model.n_choices, model.n_states):
        raise SettingsError(
            f"the counts are of {counts.n_choices} choices and {counts.n_states} states, the model has "
            f"{model.n_choices} and {model.n_states}; give the counts of a learner of this model"
        )
    initial = initial_of(model, start)
    share: float | Fraction = confidence if fresh is None else 1 - (1 - exact(confidence)) / 2
    if parameters is not None:
        if successors is not None:
            raise SettingsError("a model with parameters knows its successors; leave out successors or parameters")
        tested = 1 - exact(confidence) if test_tie else None
        found = _tied(product, policy, counts, initial, share, tested, began, memory_limit, progress)
        return _with_runs(found, fresh, confidence, share)
    possible = possible_successors(model, successors) if successors is not None else None
    judge, rebased = policy.on(product) if policy is not None else (product, None)
    visits = counts.visits
    extended = with_outcome(judge, _of_intervals(model, initial, counts, visits, share, support, possible), FALSE)
    result = robust_check(
        extended,
        Policy(extended, rebased.form) if rebased is not None else None,  # in what is added all is decided
        nature="against",
        memory_limit=memory_limit,
        progress=progress,
    )
    if policy is None:
        assert result.policy is not None
        assert isinstance(result.policy.form, Choices)
        policy = Policy(product, result.policy.form.resized(product.shape))
    found = Guarantee(
        lower=max(result.lower, _decided(product, initial)),
        confidence=float(share),
        support="given" if possible is not None else support,
        transitions=int(visits.sum()),
        choices=model.n_choices,
        never_tried=int((visits == 0).sum()),
        policy=policy,
        seconds=time.perf_counter() - began,
    )
    return _with_runs(found, fresh, confidence, share)


def _with_runs(found: Guarantee, fresh: Estimate | None, confidence: float, share: float | Fraction) -> Guarantee:
    """The greater one of this bound and that of fresh runs, both at the confidence `share`."""
    if fresh is None:
        return found
    lower, _ = clopper_pearson(fresh.satisfied, fresh.runs, share, "lower")
    return replace(found, lower=max(found.lower, lower), confidence=float(confidence), fresh=fresh)


# ------------------------------------------------------------------------------------------------- the interval model


def initial_of(model: MDP, start: int | None) -> Floats:
    """The initial distribution (n_states,)."""
    if start is None:
        if not model.initial.any():
            raise SettingsError(
                f"{model.name} does not say where runs start, so nothing is guaranteed; give start=, the state where "
                "every run starts"
            )
        return model.initial
    start = whole(start, "start", 0, model.n_states - 1)
    point: Floats = (np.arange(model.n_states) == start).astype(np.float64)
    return point


def _decided(product: Product, initial: Floats) -> float:
    """What the first state alone guarantees: the probability that it satisfies the task, rounded down."""
    states = np.flatnonzero(initial)
    satisfied = first_verdicts(product, states) == TRUE
    if satisfied.all():
        return 1.0
    share = math.fsum(initial[states[satisfied]]) / math.fsum(initial[states])
    return math.nextafter(share * (1 - 4 * np.finfo(np.float64).eps), 0)


def interval_model(
    model: MDP, initial: Floats, counts: Counts, confidence: float | Fraction, given: Whole | None = None
) -> MDP:
    """The model's states and choices with intervals from the counts, for known (or given) successors."""
    return _of_intervals(model, initial, counts, counts.visits, confidence, "known", given)


def _of_intervals(
    model: MDP,
    initial: Floats,
    counts: Counts,
    visits: Whole,
    confidence: float | Fraction,
    support: Support,
    given: Whole | None = None,
) -> MDP:
    """The model's states and choices with intervals from the counts, and one more state for what was never seen."""
    S, M = model.n_states, model.n_choices
    alpha = 1 - exact(confidence)
    if support == "known" or given is not None:
        codes, seen = _of_graph(model, counts, given)
        choice = codes // S
        possible = np.bincount(choice, minlength=M)
        level = log_inverse(int(_intervals_needed(possible).sum()), alpha)
        outside = np.zeros(M)
    else:
        codes, seen = counts.choice * S + counts.target, counts.seen
        choice = codes // S
        possible = np.full(M, S)
        level = log_inverse(int(_intervals_needed(possible).sum()), alpha / 2)
        outside = unseen_mass(np.bincount(choice, minlength=M), visits, S, log_inverse(M, alpha / 2))
    lower, upper = entry_interval(seen, visits[choice], level)
    lower[possible[choice] == 1] = 1.0
    lost = np.flatnonzero(outside)
    rows = np.concatenate([choice, lost, [M]])
    order = np.argsort(rows, kind="stable")
    row_start = np.searchsorted(rows[order], np.arange(M + 2)).astype(np.int64)
    ends = Intervals(
        np.concatenate([lower, np.zeros(len(lost)), [1.0]])[order],
        np.concatenate([upper, outside[lost], [1.0]])[order],
    )
    names = model.state_names if model.state_names is not None else map(str, range(S))
    return MDP(
        Stored(
            np.append(model.choice_start, M + 1),
            np.append(model.choice_action, np.int32(0)),
            row_start,
            np.concatenate([codes % S, np.full(len(lost) + 1, S)])[order].astype(np.int32),
            ends.nominal(row_start),
            intervals=ends,
        ),
        initial=np.append(initial, 0.0),
        signals={},
        labels={},
        action_names=model.action_names,
        state_names=(*names, "never seen"),
        name=model.name,
    )


def _of_graph(model: MDP, counts: Counts, given: Whole | None = None) -> tuple[Whole, Whole]:
    """Every (choice, successor) of the model's graph, or of the one given, as choice · n_states + successor, and how
    often it was seen."""
    if given is not None:
        codes = given
    else:
        lengths = np.diff(model.row_start)
        if not lengths.all():
            raise SettingsError(
                f"{model.place(int(lengths.argmin()))}: the model does not say where this leads; use "
                "support='unknown', or give successors"
            )
        codes = np.unique(np.repeat(np.arange(model.n_choices), lengths) * model.n_states + model.target)
    found = counts.choice * model.n_states + counts.target
    place = np.searchsorted(codes, found)
    strange = np.flatnonzero(np.append(codes, -1)[place] != found)
    if strange.size:
        choice, target = divmod(int(found[strange[0]]), model.n_states)
        whose = "the model's graph excludes" if given is None else "is not among the successors given"
        raise SettingsError(
            f"{model.place(choice)}: it was seen to lead to state {model.state_name(target)}, which {whose}; use "
            f"support='unknown', or mend {'the model' if given is None else 'them'}"
        )
    seen = np.zeros(len(codes), dtype=np.int64)
    seen[place] = counts.seen
    return codes, seen


def possible_successors(model: MDP, given: Successors) -> Whole:
    """The successors given, as choice · n_states + successor, ascending."""
    S, M = model.n_states, model.n_choices
    if callable(given):
        state = np.repeat(np.arange(S), np.diff(model.choice_start))
        rows = []
        for c, (s, a) in enumerate(zip(state.tolist(), model.choice_action.tolist(), strict=True)):
            try:
                found = np.unique(np.atleast_1d(np.asarray(list(given(s, a)))))
            except (TypeError, ValueError):
                raise SettingsError(
                    f"{model.place(c)}: successors did not return a list of states; return their indices"
                ) from None
            if found.size and (found.dtype.kind not in "iu" or found[0] < 0 or found[-1] >= S):
                raise SettingsError(f"{model.place(c)}: successors are not indices of states from 0 to {S - 1}")
            rows.append(c * S + found.astype(np.int64))
        codes = np.concatenate(rows)
    else:
        dense = given.toarray() if hasattr(given, "toarray") else np.asarray(given)
        if dense.shape != (M, S) or dense.dtype.kind not in "bui" or not np.isin(dense, (0, 1)).all():
            raise SettingsError(
                f"successors are of shape {dense.shape}; give ({M}, {S}) Booleans (choices, states), or a "
                "function of a state and an action"
            )
        codes = np.flatnonzero(dense.ravel())
    empty = np.flatnonzero(np.bincount(codes // S, minlength=M) == 0)
    if empty.size:
        raise SettingsError(f"{model.place(int(empty[0]))}: no successor is given; every choice leads somewhere")
    return codes


# ------------------------------------------------------------------------------------------------ tied parameters


def _tied(
    product: Product,
    policy: Policy | None,
    counts: Counts,
    initial: Floats,
    confidence: float | Fraction,
    tested: Fraction | None,
    began: float,
    memory_limit: int | None,
    progress: Progress | None,
) -> Guarantee:
    """`tested`: at which level the tie is; None: it is not."""
    family = family_of(product.model, initial)
    evidence = Evidence(family, counts)
    tie = evidence.require_tied(tested) if tested is not None else None
    sets = evidence.sets(1 - exact(confidence))
    narrow = family.within(**{one.name: (one.lower, one.upper) for one in sets})
    judge, rebased = policy.on(product) if policy is not None else (product, None)
    home = replace(judge, model=family)
    one = Family(home, family.parameters[0], True, Budget(_WHAT, memory_limit, progress)) if len(sets) == 1 else None

    def again(judged: Policy | None) -> CheckResult:
        """If nature picks the parameters again in every row."""
        tied = replace(judge, model=narrow)
        return robust_check(tied, Policy(tied, judged.form) if judged is not None else None, memory_limit=memory_limit)

    def bound(judged: Policy) -> tuple[float, str | None]:
        """The bound, and why it may be loose."""
        lower = again(judged).lower
        if one is None:
            return lower, by_rows(sets)
        if too_long := polynomial_too_long(one, judged):
            return lower, by_rows(sets, too_long)
        try:
            below, _ = one.enclosed(one.of(judged, sets[0].lower, sets[0].upper), judged)
        except SizeError:
            return lower, by_rows(sets, "its polynomial takes more memory than is available")
        found, attained, depth = least(below, _TOLERANCE)
        known = f"the least value of its polynomial is known to {attained - found:.1g} only"
        loose = known if attained - found > 2 * _TOLERANCE else None
        return max(lower, found * (1 - 8 * (depth + 1) * len(below) * 2.0**-53)), loose

    if rebased is not None:
        lower, looser = bound(Policy(home, rebased.form))
    else:
        best = again(None).policy
        assert best is not None
        tried = [best.form]
        if one is not None:
            tried += [one.best(p).form for p in (sets[0].estimate, sets[0].lower, sets[0].upper)]
        found = [(*bound(Policy(home, form)), form) for form in tried]
        lower, looser, form = max(found, key=lambda each: each[0])
        policy = Policy(product, form)
    assert policy is not None
    visits = counts.visits
    return Guarantee(
        lower=max(lower, _decided(product, initial)), confidence=float(confidence), support="known",
        transitions=int(visits.sum()), choices=product.model.n_choices, never_tried=int((visits == 0).sum()),
        policy=policy, seconds=time.perf_counter() - began, parameters=sets, evidence=tie, looser=looser,
    )  # fmt: skip


BY_ROWS = "row by row"
"""How the probability is bounded if nature picks the parameters again in every row."""


def by_rows(sets: Sequence[TiedParameter], reason: str | None = None) -> str:
    """Why a bound is that of nature picking the parameters again in every row; `reason`, of one parameter."""
    names = " and ".join(one.name for one in sets)
    several = f"of {len(sets)} parameters" if reason is None else f"of {names}"
    why = "only for one parameter can all rows be bounded together" if reason is None else reason
    return f"bounded {BY_ROWS}, as if each row had a value {several} of its own, since {why}"


def polynomial_too_long(family: Family, policy: Policy | None = None) -> str | None:
    """Why P of the policy, or of the optimum, is not computed as a polynomial; None if it can be."""
    work = family.work(policy)
    return f"its polynomial takes {work:.1g} multiply-adds, more than {_MOST_WORK:.0g}" if work > _MOST_WORK else None


_WHAT = "bounding the probability"
_MOST_WORK = 5e9  # multiply-adds for a polynomial; beyond that, nature picks again in every row


def family_of(model: MDP, initial: Floats) -> MDP:
    """The model as a function of its parameters, with these initial probabilities."""
    family = model.require_family()
    if initial is model.initial:
        return family
    return replace(family, initial=initial, exact_initial=None)


def _intervals_needed(possible: NDArray[Any]) -> NDArray[Any]:
    """e(d) of the module's text."""
    return np.where(possible > 2, possible, possible - 1)
