"""What a file of transitions gives → an MDP: rows in order, choices with names, a state that runs start in.

Shared by the readers of formats that write a model down transition by transition.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.errors import ModelError
from stltool.models.costs import Amounts, Cost, Entries
from stltool.models.formats.lines import Written
from stltool.models.fractions import Shares, doubles_of, of_doubles, over_one
from stltool.models.intervals import Intervals
from stltool.models.loading import Loading
from stltool.models.mdp import MDP
from stltool.models.normalize import NOTHING, rescale
from stltool.models.rows import Place, Stored, starts
from stltool.numbers import number_text, shortest

I64: TypeAlias = NDArray[np.int64]
Floats: TypeAlias = NDArray[np.float64]

_NAMED = 4  # states that a note names
_NONE: Mapping[str, Any] = {}
INIT = "init"
"""The label of the states that runs start in, in PRISM's and Storm's formats."""


@dataclass
class Given:
    """The content of a file; rows in any order, in which a successor may occur several times.

    choice_start  (n_states + 1,) the choices of each state, one after another
    row_start     (n_choices + 1,) the entries of each choice
    target        (n,) successors, each one of the states
    probability   (n,) doubles, exact numbers, or intervals
    action        (n_choices,) the number of each choice's action among `words`; −1: it has none
    initial       (n_states,) where runs may start
    doubles       of exact numbers: the doubles nearest to them, if they are known
    costs         name → parts: amounts of states (n_states,), choices (n_choices,), transitions (n,)
    """

    choice_start: I64
    row_start: I64
    target: NDArray[np.int32]
    probability: Floats | Shares | Intervals
    action: I64
    words: Sequence[str]
    initial: NDArray[np.bool_]
    labels: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    signals: dict[str, Floats] = field(default_factory=dict)
    state_names: Sequence[str] | None = None
    costs: dict[str, dict[str, Amounts]] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    doubles: Floats | None = None


def model_of(given: Given, name: str, loading: Loading, place: Place | None = None) -> MDP:
    """The model. Raises ModelError if it is not one.

    place  names a choice in messages
    """
    begin = loading.starts(given.initial, given.state_names)
    if INIT in given.labels and not np.array_equal(given.labels[INIT], given.initial):
        raise ModelError(f"the label {INIT} marks other states than those that runs start in; rename it")
    both = sorted(set(given.signals) & {INIT, *given.labels})
    if both:
        raise ModelError(f"{both[0]} is the name of both a variable and a label; rename one of them")
    if _loop(given, loading):
        place = None  # choices have other numbers now
    ordered(given)
    empty = np.flatnonzero(np.diff(given.row_start) == 0)
    if empty.size:
        c = int(empty[0])
        s = int(np.searchsorted(given.choice_start, c, side="right")) - 1
        where = place(c) if place is not None else f"state {s}, choice {c - given.choice_start[s]}"
        raise ModelError(f"{where}: the probabilities sum to 0, not 1")
    action, names = _actions(given)
    notes, exact, intervals = dict(given.notes), None, None
    if isinstance(given.probability, Intervals):
        intervals = given.probability
        if loading.normalize:
            notes["normalize"] = NOTHING.format("intervals")
        probability = intervals.nominal(given.row_start)
    else:
        doubles = given.probability if not isinstance(given.probability, Shares) else np.empty(0)
        exact = given.probability if isinstance(given.probability, Shares) else None
        if loading.normalize:
            shares = exact if exact is not None else Shares(*of_doubles(doubles, given.row_start, True))

            def numbered(c: int) -> str:
                return f"choice {c}"

            found, done = rescale((shares.numerator, shares.denominator), given.row_start, place or numbered)
            exact, notes["normalize"] = Shares(*found), str(done)
        if given.doubles is not None and not loading.normalize:
            probability = given.doubles
        else:
            probability = doubles_of(exact.numerator, exact.denominator) if exact is not None else doubles
    labels = {**given.labels, INIT: given.initial}
    return MDP(
        Stored(given.choice_start, action, given.row_start, given.target, probability, exact, intervals),
        initial=begin / begin.sum(),
        signals=given.signals,
        labels=labels,
        action_names=names,
        state_names=given.state_names,
        name=name,
        exact_initial=Shares(begin, int(begin.sum())),
        notes=notes,
        costs={key: _cost(parts, given) for key, parts in given.costs.items()},
    )


def _cost(parts: Mapping[str, Amounts], given: Given) -> Cost:
    along = parts.get("transitions")
    entries = None
    if along is not None:
        entries = Entries(along.values, along.given, row_start=given.row_start, target=given.target)
    return Cost(parts.get("states"), parts.get("choices"), entries)


# --------------------------------------------------------------------------------------------------------- rows


def _loop(given: Given, loading: Loading) -> bool:
    """Let states without choices stay where they are, for ever; whether there are any. ModelError if that is not asked
    for."""
    states = np.flatnonzero(np.diff(given.choice_start) == 0)
    if not states.size:
        return False
    names = given.state_names
    shown = ", ".join(names[s] if names is not None else str(s) for s in states[:_NAMED].tolist())
    more = f", and {len(states) - _NAMED} more" if len(states) > _NAMED else ""
    if loading.deadlocks == "error":
        raise ModelError(f"states without actions: {shown}{more}; give them one that stays (probability 1 to itself)")
    given.notes["deadlocks"] = f"states without transitions stay where they are, as in PRISM: {shown}{more}"
    choice = given.choice_start[states]
    entry = given.row_start[choice]

    def added(amounts: Amounts, at: I64) -> Amounts:
        shares = None
        if amounts.given is not None:
            shares = Shares(np.insert(amounts.given.numerator, at, 0), amounts.given.denominator)
        return Amounts(np.insert(amounts.values, at, 0.0), shares)

    for parts in given.costs.values():
        for part, at in (("choices", choice), ("transitions", entry)):
            if part in parts:
                parts[part] = added(parts[part], at)
    given.choice_start = starts(np.maximum(np.diff(given.choice_start), 1))
    given.row_start = starts(np.insert(np.diff(given.row_start), choice, 1))
    given.action = np.insert(given.action, choice, -1)
    given.target = np.insert(given.target, entry, states.astype(np.int32))
    one, given.doubles = given.probability, None
    if isinstance(one, Intervals):
        ends = None
        if one.given is not None:
            ends = _with_ones(one.given[0], entry), _with_ones(one.given[1], entry)
        lower, upper = (np.insert(each, entry, 1.0) for each in (one.lower, one.upper))
        given.probability = Intervals(lower, upper, ends)
    elif isinstance(one, Shares):
        given.probability = _with_ones(one, entry)
    else:
        given.probability = np.insert(one, entry, 1.0)
    return True


def _with_ones(shares: Shares, entry: I64) -> Shares:
    return Shares(np.insert(shares.numerator, entry, shares.denominator), shares.denominator)


def ordered(given: Given) -> None:
    """Put the entries of each row in the order of their successors, each once; what cannot happen is left out."""
    possible = given.doubles != 0 if given.doubles is not None else _possible(given.probability)
    if not possible.all():
        before = starts(possible)
        _keep(given, np.flatnonzero(possible), before[given.row_start])
    rising = np.ones(len(given.target), dtype=np.bool_)
    rising[1:] = given.target[1:] > given.target[:-1]
    rising[given.row_start[:-1][given.row_start[:-1] < len(rising)]] = True
    if rising.all():
        return
    row = np.repeat(np.arange(len(given.row_start) - 1), np.diff(given.row_start))
    order = np.argsort((row << 32) | given.target, kind="stable")
    _keep(given, order, given.row_start)
    same = np.zeros(len(order), dtype=np.bool_)
    same[1:] = (given.target[1:] == given.target[:-1]) & (row[1:] == row[:-1])
    if same.any():
        _merge(given, np.flatnonzero(~same), row)


def _possible(probability: Floats | Shares | Intervals) -> NDArray[np.bool_]:
    ends = probability.upper if isinstance(probability, Intervals) else (
        probability.numerator if isinstance(probability, Shares) else probability)  # fmt: skip
    return np.asarray(ends != 0, dtype=np.bool_)


def _keep(given: Given, entries: I64, row_start: I64) -> None:
    given.target, given.row_start = given.target[entries], row_start
    given.probability = _picked(given.probability, entries)
    given.doubles = given.doubles[entries] if given.doubles is not None else None
    for parts in given.costs.values():
        if "transitions" in parts:
            parts["transitions"] = parts["transitions"].at(entries)


def _picked(probability: Floats | Shares | Intervals, entries: I64) -> Floats | Shares | Intervals:
    if isinstance(probability, Intervals):
        return probability.at(entries)
    if isinstance(probability, Written):
        return probability.at(entries)
    if isinstance(probability, Shares):
        return Shares(probability.numerator[entries], probability.denominator)
    return probability[entries]


def _merge(given: Given, first: I64, row: I64) -> None:
    """Add up entries of equal successors; the costs of such a transition become their expectation, exactly."""
    probability = given.probability
    for name, parts in given.costs.items():
        if "transitions" not in parts:
            continue
        if isinstance(probability, Intervals):
            raise ModelError(
                f"reward {name}: a transition with an interval of probabilities occurs twice in a row, with a reward "
                "of its own each time; write it once"
            )
        shares = probability if isinstance(probability, Shares) else Shares(*of_doubles(probability, given.row_start))
        amounts, of_entry = parts["transitions"].exact, np.searchsorted(first, np.arange(len(row)), side="right") - 1
        total = [Fraction(0)] * len(first)
        weight = [Fraction(0)] * len(first)
        for k, to in enumerate(of_entry.tolist()):
            total[to] += shares[k] * amounts[k]
            weight[to] += shares[k]
        parts["transitions"] = Amounts.of_shares(*over_one(a / b for a, b in zip(total, weight, strict=True)))
    given.doubles = None
    if isinstance(probability, Intervals):
        *both, denominator = probability.exact
        sums = (np.minimum(np.add.reduceat(ends, first), denominator) for ends in both)
        given.probability = Intervals.of_shares(*(Shares(ends, denominator) for ends in sums))
    elif isinstance(probability, Shares):
        given.probability = Shares(np.add.reduceat(probability.numerator, first), probability.denominator)
    else:
        given.probability = np.add.reduceat(probability, first)
    given.target = given.target[first]
    given.row_start = starts(np.bincount(row[first], minlength=len(given.row_start) - 1))


# ------------------------------------------------------------------------------------------------------ actions


def _actions(given: Given) -> tuple[NDArray[np.int32], tuple[str, ...]]:
    """The action of every choice, and the names of all.

    A choice without an action has its number among the choices of its state as name. In PRISM, several choices of a
    state may have one action; here each has a name of its own: go, go#2, go#3.
    """
    n = len(given.action)
    names = list(given.words)
    action = given.action.copy()
    without = action < 0
    state = np.repeat(np.arange(len(given.choice_start) - 1), np.diff(given.choice_start))
    if without.any():
        number = (np.arange(n) - given.choice_start[state])[without]
        known = {name: k for k, name in enumerate(names)}
        place = np.empty(int(number.max()) + 1, dtype=np.int64)
        for one in np.unique(number).tolist():
            if str(one) not in known:
                known[str(one)] = len(names)
                names.append(str(one))
            place[one] = known[str(one)]
        action[without] = place[number]
    key = state * max(len(names), 1) + action
    order = np.argsort(key, kind="stable")
    same = np.zeros(n, dtype=np.bool_)
    same[1:] = key[order][1:] == key[order][:-1]
    if same.any():
        begin = np.maximum.accumulate(np.where(same, 0, np.arange(n)))
        rank = np.empty(n, dtype=np.int64)
        rank[order] = np.arange(n) - begin
        taken, made = set(names), {}
        for a, r in sorted(set(zip(action[rank > 0].tolist(), rank[rank > 0].tolist(), strict=True))):
            suffix = r + 1
            while f"{names[a]}#{suffix}" in taken:
                suffix += 1
            taken.add(f"{names[a]}#{suffix}")
            made[a, r] = len(names)
            names.append(f"{names[a]}#{suffix}")
        for c in np.flatnonzero(rank > 0).tolist():
            action[c] = made[int(action[c]), int(rank[c])]
    used = np.zeros(len(names), dtype=np.bool_)
    used[action] = True
    renumbered = np.cumsum(used) - 1
    return renumbered[action].astype(np.int32), tuple(
        name for name, is_used in zip(names, used, strict=True) if is_used
    )


# -------------------------------------------------------------------------------------------------------------- names


Others: TypeAlias = "Mapping[str, Sequence[tuple[I64, Callable[[int], str]]]]"
"""Variables that are not signals: for some states, in ascending order, the value of the k-th."""


class Valuation:
    """The name of a state from its variables: "x=1, b=true".

    order   the names of the variables
    truths  those that are true (1) or false (0)
    """

    def __init__(
        self, signals: Mapping[str, Floats], order: Sequence[str], truths: Collection[str] = (), others: Others = _NONE
    ) -> None:
        self.signals, self.order, self.truths, self.others = signals, order, truths, others

    @classmethod
    def of(cls, model: MDP) -> Valuation:
        """As the names of a model are made, if they are made like this."""
        first = set(model.state_names[0].split(", ")) if model.state_names is not None else set()
        truths = [
            name
            for name, values in model.signals.items()
            if first & {f"{name}=true", f"{name}=false"} and np.isin(values, (0, 1)).all()
        ]
        return cls(model.signals, list(model.signals), truths)

    def __call__(self, s: int) -> str:
        return ", ".join(f"{name}={text}" for name in self.order if (text := self._text(name, s)) is not None)

    def _text(self, name: str, s: int) -> str | None:
        if name in self.signals:
            value = self.signals[name][s]
            return str(value != 0).lower() if name in self.truths else number_text(shortest(value))
        for states, text in self.others[name]:
            k = int(np.searchsorted(states, s))
            if k < len(states) and states[k] == s:
                return text(k)
        return None

    def others_of(self, model: MDP, most: int | None = None) -> list[str] | None:
        """The names of a model's states, unless they are all made like this, or have more than `most` characters."""
        names = model.state_names
        if names is None or all(names[s] == self(s) for s in range(model.n_states)):
            return None
        return None if most is not None and sum(map(len, names)) > most else list(names)
