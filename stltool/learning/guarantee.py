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
here (`policy=None`) has the greatest bound, with the same confidence. Where runs start is a part of what is asked: the
model's initial distribution, or `start`. Its transition probabilities are never read; with the support known, its
graph is.

Sources: [Iyengar05] and [Nilim05] for the robust value, [Strehl08] for learning with such intervals.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import function, one_of, require, whole
from stltool.automata import FALSE, TRUE
from stltool.checking import robust_check
from stltool.checking.induction import Progress
from stltool.checking.statistical import require_confidence
from stltool.choices import Choices
from stltool.display import Card, Displayed, counted
from stltool.errors import SettingsError
from stltool.learning.confidence import Floats, Whole, entry_interval, unseen_mass
from stltool.learning.counts import Counts
from stltool.models import MDP, Intervals
from stltool.models.rows import Stored
from stltool.numbers import exact, floor_text
from stltool.policy import Policy, require_door
from stltool.product import Product, first_verdicts, with_outcome

Support: TypeAlias = Literal["unknown", "known"]


@dataclass(frozen=True, eq=False, repr=False)
class Guarantee(Displayed):
    """A lower bound on a policy's probability, from transitions seen.

    lower        with `confidence` the probability is at least this; rounded down
    support      "unknown": nothing was taken as known of where choices lead; "known": which successors they can have
    transitions  how many were seen
    never_tried  how many of the `choices` (a state with one of its actions) were never tried
    policy       whose probability it is: the one given, or the one with the greatest bound
    """

    lower: float
    confidence: float
    support: Support
    transitions: int
    choices: int
    never_tried: int
    policy: Policy
    seconds: float = 0.0

    def _card(self) -> Card:
        home = self.policy.home
        task = f"{home.task_name} := {home.formula}" if isinstance(home, Product) else None
        return Card(
            f"Guarantee: P >= {floor_text(self.lower)} with confidence {100 * self.confidence:.12g} %",
            [
                {
                    "from": counted(self.transitions, "transition"),
                    "successors": self.support,
                    "never tried": f"{self.never_tried} of {counted(self.choices, 'choice')}",
                },
                {"task": task, "policy": self.policy.kind},
            ],
        )

    @property
    def statement(self) -> str:
        """What was found, in words; the bound is rounded down."""
        found = f"with confidence {100 * self.confidence:.12g} % the probability is at least {floor_text(self.lower)}"
        return f"{found}, from {self.transitions} transitions seen while learning; assumed: {self.assumes}"

    @property
    def assumes(self) -> str:
        """What the bound assumes in addition to the data."""
        if self.support == "unknown":
            return "nothing about the transitions"
        return "the possible successors are known, their probabilities are not"


def guarantee(
    product: Product,
    policy: Policy | None,
    counts: Counts,
    *,
    confidence: float = 0.99,
    support: Support = "unknown",
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
    function(progress, "guarantee's progress")
    model = product.model
    if (counts.n_choices, counts.n_states) != (model.n_choices, model.n_states):
        raise SettingsError(
            f"the counts are of {counts.n_choices} choices and {counts.n_states} states, the model has "
            f"{model.n_choices} and {model.n_states}; give the counts of a learner of this model"
        )
    initial = _initial(model, start)
    judge, rebased = policy.on(product) if policy is not None else (product, None)
    visits = counts.visits
    extended = with_outcome(judge, _of_intervals(model, initial, counts, visits, confidence, support), FALSE)
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
    return Guarantee(
        lower=max(result.lower, _decided(product, initial)),
        confidence=float(confidence),
        support=support,
        transitions=int(visits.sum()),
        choices=model.n_choices,
        never_tried=int((visits == 0).sum()),
        policy=policy,
        seconds=time.perf_counter() - began,
    )


# ------------------------------------------------------------------------------------------------- the interval model


def _initial(model: MDP, start: int | None) -> Floats:
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


def _of_intervals(
    model: MDP, initial: Floats, counts: Counts, visits: Whole, confidence: float, support: Support
) -> MDP:
    """The model's states and choices with intervals from the counts, and one more state for what was never seen."""
    S, M = model.n_states, model.n_choices
    alpha = 1 - exact(confidence)
    if support == "known":
        codes, seen = _of_graph(model, counts)
        choice = codes // S
        possible = np.bincount(choice, minlength=M)
        level = _log_inverse(int(_intervals_needed(possible).sum()), alpha)
        outside = np.zeros(M)
    else:
        codes, seen = counts.choice * S + counts.target, counts.seen
        choice = codes // S
        possible = np.full(M, S)
        level = _log_inverse(int(_intervals_needed(possible).sum()), alpha / 2)
        outside = unseen_mass(np.bincount(choice, minlength=M), visits, S, _log_inverse(M, alpha / 2))
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


def _of_graph(model: MDP, counts: Counts) -> tuple[Whole, Whole]:
    """Every (choice, successor) of the model's graph, as choice · n_states + successor, and how often it was seen."""
    lengths = np.diff(model.row_start)
    if not lengths.all():
        raise SettingsError(
            f"{model.place(int(lengths.argmin()))}: the model does not say where this leads; use support='unknown'"
        )
    codes = np.unique(np.repeat(np.arange(model.n_choices), lengths) * model.n_states + model.target)
    found = counts.choice * model.n_states + counts.target
    place = np.searchsorted(codes, found)
    strange = np.flatnonzero(np.append(codes, -1)[place] != found)
    if strange.size:
        choice, target = divmod(int(found[strange[0]]), model.n_states)
        raise SettingsError(
            f"{model.place(choice)}: it was seen to lead to state {model.state_name(target)}, which the model's graph "
            "excludes; use support='unknown', or mend the model"
        )
    seen = np.zeros(len(codes), dtype=np.int64)
    seen[place] = counts.seen
    return codes, seen


def _intervals_needed(possible: NDArray[Any]) -> NDArray[Any]:
    """e(d) of the module's text."""
    return np.where(possible > 2, possible, possible - 1)


def _log_inverse(events: int, alpha: Fraction) -> float:
    """ln(events / α): every one of the events gets an equal share of α."""
    share = alpha / max(events, 1)
    return math.log(share.denominator) - math.log(share.numerator)
