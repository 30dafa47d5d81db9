"""Rows of an MDP: where they come from, and computing only those that are needed.

Rows are CSR, one row a *choice* (a state with one of its available actions):

    choices of state i          choice_start[i] … choice_start[i+1]−1
    successors of choice c      target[row_start[c] … row_start[c+1]−1], with probability[…]

A *source* gives the rows of any states. `Stored` has all of them in memory; a grid (grid.py) or a function
(function.py) computes them when needed, so a large model costs only what is reached. What a source knows about all its
rows without computing them are its `kinds`: rows such that every row of the model has the length, the probabilities and
the ends of one of them.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arrays import read_only
from stltool.display import Card, Displayed, counted
from stltool.errors import ModelError
from stltool.models.fractions import Integers, Shares, doubles_of, of_doubles, over_one
from stltool.models.intervals import Intervals
from stltool.models.normalize import HINT, MOST_MISSING
from stltool.models.parameters import Parameter, Ties, Values
from stltool.sizes import require_memory

if TYPE_CHECKING:
    from hashlib import _Hash

I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]
Floats: TypeAlias = NDArray[np.float64]
Place: TypeAlias = Callable[[int], str]
"""A choice, or a state, in the user's names."""

ROW_TOLERANCE = 1e-9  # how far the sum of a row of doubles may be from 1
READ_EXACTLY = 1_000_000  # entries whose doubles are read as decimals
_BYTES = 80  # for each entry, in all forms that an engine uses
_BLOCK = 1 << 22  # entries computed at a time when all rows are
_SMALLER = "coarsen the grid, or use a part of the model"


@dataclass(frozen=True, eq=False)
class Chances:
    """The probabilities of entries of rows.

    probability  (e,) doubles; with `intervals`, the nominal ones
    given        the same as given in fractions or decimals; None: given in doubles
    row_start    the rows that doubles are read by (models/fractions.py)
    ties         if entries depend on parameters without values: on which and how; `intervals` are then their ends
    """

    probability: Floats
    row_start: I64
    given: Shares | None = None
    intervals: Intervals | None = None
    ties: Ties | None = None

    @cached_property
    def exact(self) -> Shares:
        return self.given if self.given is not None else Shares(*of_doubles(self.probability, self.row_start))


class ReadOnly:
    """A frozen dataclass whose starts and targets are read-only views, after unpickling too: one kind of array is what
    kernels are compiled for."""

    def __post_init__(self) -> None:
        for name in ("choice_start", "row_start", "target"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.__post_init__()


@dataclass(frozen=True, eq=False, repr=False)
class Rows(ReadOnly, Displayed):
    """The rows of n states (see the module's text), with successors by their numbers in the model.

    entry   (e,) the index in `chances` of each entry; None: in order
    states  (n,) ascending, whose rows these are; None: states 0 … n−1
    parts   (choices, entries) of all rows, if these are only some of them; None: these are all
    """

    choice_start: I64
    row_start: I64
    target: I32
    chances: Chances
    entry: NDArray[np.signedinteger[Any]] | None = None
    parts: tuple[I64, I64] | None = None
    states: I64 | None = None

    def __len__(self) -> int:
        return len(self.choice_start) - 1

    def _card(self) -> Card:
        counts = counted(len(self), "state"), counted(len(self.row_start) - 1, "choice"), f"{len(self.target)} entries"
        return Card(f"Rows: {', '.join(counts)}")

    @property
    def kinds(self) -> Rows:
        """As in a source."""
        return self

    def at(self, states: I64) -> I64:
        """The positions of states among the states of these rows."""
        return states if self.states is None else np.searchsorted(self.states, states)

    @property
    def rows(self) -> Rows:
        """As in `Demand`."""
        return self

    def some(self, numbers: I64) -> Rows:
        """The rows of the states with these numbers, in their order."""
        choice = spans(self.choice_start[numbers], self.choice_start[numbers + 1])
        entry = spans(self.row_start[choice], self.row_start[choice + 1])
        return Rows(
            starts(self.choice_start[numbers + 1] - self.choice_start[numbers]),
            starts(self.row_start[choice + 1] - self.row_start[choice]),
            self.target[entry],
            self.chances,
            entry if self.entry is None else self.entry[entry],
            (choice, entry),
        )

    def _of(self, column: NDArray[Any]) -> NDArray[Any]:
        return read_only(column if self.entry is None else column[self.entry])

    # ------------------------------------------------------------------------------------------ columns (e,)

    @cached_property
    def probability(self) -> Floats:
        return self._of(self.chances.probability)

    @cached_property
    def numerator(self) -> Integers:
        """The exact probabilities, as integers over `denominator`."""
        return self._of(self.chances.exact.numerator)

    @property
    def denominator(self) -> int:
        return self.chances.exact.denominator

    @cached_property
    def intervals(self) -> Intervals | None:
        ends = self.chances.intervals
        if ends is None:
            return None
        ends = ends if self.entry is None else ends.at(self.entry)
        return Intervals(read_only(ends.lower), read_only(ends.upper), ends.given, ends.rounded)

    def tied_at(self, values: Values) -> Floats:
        """(e,) the probabilities at these values of the parameters, each rounded once."""
        ties = self.chances.ties
        assert ties is not None
        return self._of(ties.doubles(values))

    def tied_over(self, *values: Values) -> tuple[list[Integers], int]:
        """For each of these values of the parameters (e,) integers: the probabilities, exactly, over the denominator
        that comes with them."""
        ties = self.chances.ties
        assert ties is not None
        numerators, denominator = ties.over(*values)
        return [self._of(column) for column in numerators], denominator

    @property
    def tied_class(self) -> I64:
        """(e,) the number of each entry's function among `chances.ties.classes`."""
        ties = self.chances.ties
        assert ties is not None
        return self._of(ties.which)

    @cached_property
    def width(self) -> Floats:
        """upper − lower of every entry, with intervals."""
        assert self.intervals is not None
        return self.intervals.upper - self.intervals.lower

    @cached_property
    def budget(self) -> Floats:
        """(choices,) 1 − Σ lower: what nature has to distribute, with intervals."""
        assert self.intervals is not None
        missing: Floats = np.maximum(1 - np.add.reduceat(self.intervals.lower, self.row_start[:-1]), 0.0)
        return missing

    # ------------------------------------------------------------------------------------------ facts

    @cached_property
    def longest(self) -> int:
        """The largest number of entries of a row."""
        return int(np.diff(self.row_start).max(initial=0))

    @cached_property
    def widest(self) -> int:
        """The largest number of entries of a state, all its choices together."""
        return int(np.diff(self.row_start[self.choice_start]).max(initial=0))

    @cached_property
    def most_choices(self) -> int:
        """The largest number of choices of a state."""
        return int(np.diff(self.choice_start).max(initial=0))

    @cached_property
    def least(self) -> float:
        """The smallest positive probability."""
        return least_positive(self.probability)

    @property
    def given_exactly(self) -> bool:
        return self.chances.given is not None

    @cached_property
    def defect(self) -> Fraction:
        """The largest |Σ row − 1|, exactly."""
        sums = np.add.reduceat(self.numerator, self.row_start[:-1])
        worst = max(abs(int(sums.max()) - self.denominator), abs(int(sums.min()) - self.denominator))
        return Fraction(worst, self.denominator)

    @cached_property
    def missing(self) -> float:
        """The largest |Σ row − 1|, with sums in doubles."""
        return float(np.abs(np.add.reduceat(self.probability, self.row_start[:-1]) - 1).max())

    def require_distributions(self, place: Place, state: Place) -> None:
        """ModelError, naming the choice and the successor, if a row is not a distribution."""
        empty = np.flatnonzero(np.diff(self.row_start) == 0)
        if empty.size:
            raise ModelError(f"{place(int(empty[0]))}: the probabilities sum to 0, not 1")
        probability, uncertain = self.probability, self.intervals is not None
        if self.intervals is not None:
            self.intervals.validate(self.row_start, probability, place, lambda k: state(int(self.target[k])))
        least, most = float(probability.min()), float(probability.max())
        if not ((least >= 0 if uncertain else least > 0) and most <= 1 + ROW_TOLERANCE):  # intervals may force a 0
            low = probability < 0 if uncertain else probability <= 0
            bad = np.flatnonzero(~np.isfinite(probability) | low | (probability > 1 + ROW_TOLERANCE))
            choice = int(np.searchsorted(self.row_start, bad[0], side="right")) - 1
            value, successor = probability[bad[0]], state(int(self.target[bad[0]]))
            raise ModelError(f"{place(choice)}: {value:.12g} to state {successor} is not a probability")
        sums = np.add.reduceat(probability, self.row_start[:-1])
        wrong = np.flatnonzero(np.abs(sums - 1) > ROW_TOLERANCE)
        if wrong.size:
            more = f" (and those of {len(wrong) - 1} more rows)" if len(wrong) > 1 else ""
            total = sums[wrong[0]]
            raise ModelError(f"{place(int(wrong[0]))}: the probabilities sum to {total:.12g}, not 1{more}{hint(total)}")


class Outcome(NamedTuple):
    """What chance may do after a choice. `name` says what happens, in a grid for instance "success" or "left"."""

    name: str | None
    target: int
    probability: Fraction


def hint(total: float) -> str:
    """A hint on how to correct rows that sum to `total`."""
    return f"; {HINT}" if abs(total - 1) <= MOST_MISSING else ""


def least_positive(*arrays: Floats) -> float:
    """The smallest positive entry, 1 if there is none."""
    return min(float(array[array > 0].min(initial=1.0)) for array in arrays)


def starts(lengths: NDArray[np.integer[Any] | np.bool_]) -> I64:
    """The start of each piece of these lengths, and the end of the last one."""
    found = np.zeros(len(lengths) + 1, dtype=np.int64)
    np.cumsum(lengths, out=found[1:])
    return found


def spans(first: I64, end: I64) -> I64:
    """first[0] … end[0]−1, first[1] … end[1]−1, and so on."""
    length = end - first
    found: I64 = np.arange(length.sum()) + np.repeat(first - (np.cumsum(length) - length), length)
    return found


# --------------------------------------------------------------------------------------------------------- sources


class Source(ABC):
    """Where a model's rows come from.

    kinds      rows that represent all of them (see the module's text); None if nothing is known before they are
    computed
    on_demand  whether they are computed on demand
    """

    on_demand = True

    @property
    @abstractmethod
    def n_states(self) -> int: ...

    @property
    @abstractmethod
    def n_choices(self) -> int: ...

    @property
    @abstractmethod
    def n_transitions(self) -> int:
        """The number of entries of all rows; an upper bound if `kinds` are not known."""

    @property
    @abstractmethod
    def choice_start(self) -> I64:
        """(n_states + 1,)"""

    @property
    @abstractmethod
    def choice_action(self) -> I32:
        """(n_choices,) the action of each choice."""

    @property
    @abstractmethod
    def kinds(self) -> Rows | None: ...

    @property
    @abstractmethod
    def uncertain(self) -> bool:
        """Whether the probabilities are intervals."""

    @property
    def family(self) -> Source | None:
        """The same choices with rows that depend on parameters, of which these rows are a member; None if nothing is
        known of parameters."""
        return None

    @property
    def ties(self) -> Ties | None:
        """If the rows depend on parameters without values: on which."""
        return self.kinds.chances.ties if self.kinds is not None else None

    def at(self, values: Values) -> Source:
        """For rows that depend on parameters: those with these values. Entries of probability 0 are left out."""
        raise NotImplementedError

    def narrowed(self, parameters: tuple[Parameter, ...]) -> Source:
        """The same with these parameters, whose domains are parts of the former ones."""
        raise NotImplementedError

    @property
    @abstractmethod
    def widest(self) -> int:
        """An upper bound on the entries of a state, all choices together."""

    @abstractmethod
    def rows(self, states: I64) -> Rows:
        """The rows of distinct states, in their order."""

    def outcomes(self, s: int, number: int) -> list[Outcome]:
        """What may happen after a state's choice with this number, for probabilities that are known; they sum to 1.

        Here one outcome for each successor, by state. A source that knows more of its noise tells outcomes of
        different names that lead to one successor apart.
        """
        rows = self.rows(np.array([s]))
        entry = slice(rows.row_start[number], rows.row_start[number + 1])
        target, shares = rows.target[entry].tolist(), rows.numerator[entry].tolist()
        pairs = sorted(zip(target, shares, strict=True))
        return [Outcome(None, there, Fraction(share, sum(shares))) for there, share in pairs if share]

    @abstractmethod
    def nominal(self) -> Source:
        """The same choices with the nominal probabilities."""

    @property
    def most_choices(self) -> int:
        """The largest number of actions of a state."""
        return int(np.diff(self.choice_start).max())

    def require_distributions(self, place: Place, state: Place) -> None:  # noqa: B027 - nothing to do on demand
        """ModelError if a row is not a distribution, unless rows are checked when they are computed."""

    def within(self, first: I64, steps: int, need: Callable[[int], None]) -> Rows:
        """The rows of the states that runs from `first` can visit within `steps` steps.

        States that are reached only in the last step have no choices here. `need` is called with the bytes to allocate.
        """
        demand, seen = Demand(self), np.zeros(self.n_states, dtype=np.bool_)
        seen[first] = True
        frontier = np.unique(first)
        for _ in range(steps):
            if not len(frontier):
                break
            need(_BYTES * self.widest * len(frontier))
            successors = demand.successors(demand.at(frontier))
            frontier = np.unique(successors[~seen[successors]]).astype(np.int64)
            seen[frontier] = True
        states = np.flatnonzero(seen)
        acting = demand.known(states)
        found = demand.rows.some(demand.at(states[acting]))
        counts = np.zeros(len(states), dtype=np.int64)
        counts[acting] = np.diff(found.choice_start)
        return Rows(starts(counts), found.row_start, found.target, found.chances, found.entry, found.parts, states)

    def digest_into(self, sha: _Hash) -> None:
        """Add all rows, column by column: the same bytes for every kind of source."""
        columns: dict[str, _Hash] = {}
        n_choices = n_entries = 0
        for lo, rows in self._blocks():
            first = int(self.choice_start[lo])
            arrays: list[tuple[str, NDArray[Any]]] = [
                ("choices", rows.choice_start[1:] + n_choices),
                ("actions", self.choice_action[first : first + int(rows.choice_start[-1])]),
                ("rows", rows.row_start[1:] + n_entries),
                ("targets", rows.target), ("probabilities", rows.probability),
            ]  # fmt: skip
            if rows.intervals is not None:
                arrays += [("lower", rows.intervals.lower), ("upper", rows.intervals.upper)]
            for title, array in arrays:
                columns.setdefault(title, hashlib.sha256()).update(np.ascontiguousarray(array).data)
            n_choices, n_entries = n_choices + int(rows.choice_start[-1]), n_entries + int(rows.row_start[-1])
        sha.update(f"rows {self.n_states} {n_choices} {n_entries}".encode())
        for title, column in columns.items():
            sha.update(title.encode() + column.digest())
        if self.ties is not None:
            sha.update(self.ties.text().encode())

    def _blocks(self) -> Iterator[tuple[int, Rows]]:
        """All rows in blocks, each with the number of its first state."""
        step = max(_BLOCK // max(self.widest, 1), 1)
        for lo in range(0, self.n_states, step):
            yield lo, self.rows(np.arange(lo, min(lo + step, self.n_states)))

    def whole(self) -> Rows:
        """All rows. Raises SizeError before allocating more memory than is available."""
        n = self.n_transitions
        per_entry = 20 + (16 if self.uncertain else 0)
        require_memory(per_entry * n + 12 * self.n_choices, f"the {n} transitions of {self.n_states} states", _SMALLER)
        gathered = Gathered(n)
        for _, rows in self._blocks():
            gathered.add(rows)
        return gathered.all


class Stored(Source):
    """All rows in memory, each with the action of every choice.

    exact      the exact values of the doubles `probability`, if they were given in fractions or decimals
    intervals  if the probabilities are intervals: their ends; `probability` is then their `nominal`
    ties       if they depend on parameters; `intervals` are then the ends
    family     the rows that depend on parameters, of which these are a member
    """

    on_demand = False

    def __init__(
        self,
        choice_start: I64,
        choice_action: I32,
        row_start: I64,
        target: I32,
        probability: Floats,
        exact: Shares | None = None,
        intervals: Intervals | None = None,
        ties: Ties | None = None,
        family: Stored | None = None,
    ) -> None:
        chances = Chances(probability, row_start, exact if intervals is None else None, intervals, ties)
        self._family = self if ties is not None else family
        self._rows, self._action = Rows(choice_start, row_start, target, chances), choice_action
        ends = (intervals.lower, intervals.upper) if intervals is not None else ()
        for array in (choice_start, choice_action, row_start, target, probability, *ends):
            array.setflags(write=False)  # so that the digest stays valid

    @property
    def n_states(self) -> int:
        return len(self._rows)

    @property
    def n_choices(self) -> int:
        return len(self._action)

    @property
    def n_transitions(self) -> int:
        return len(self._rows.target)

    @property
    def choice_start(self) -> I64:
        return self._rows.choice_start

    @property
    def choice_action(self) -> I32:
        return self._action

    @property
    def kinds(self) -> Rows:
        return self._rows

    @property
    def uncertain(self) -> bool:
        return self._rows.chances.intervals is not None

    @property
    def widest(self) -> int:
        return self._rows.widest

    def rows(self, states: I64) -> Rows:
        return self._rows.some(states)

    def whole(self) -> Rows:
        return self._rows

    def nominal(self) -> Stored:
        """Entries whose probability must be 0 are left out."""
        if not self.uncertain:
            return self
        rows, kept = self._rows, self._rows.probability > 0
        before = starts(kept)
        return Stored(
            rows.choice_start, self._action, before[rows.row_start], rows.target[kept], rows.probability[kept],
            family=self._family,
        )  # fmt: skip

    @property
    def family(self) -> Stored | None:
        return self._family

    def at(self, values: Values) -> Stored:
        rows, ties = self._rows, self._rows.chances.ties
        assert ties is not None
        of_class, denominator = over_one(ties.at(values))
        shares = of_class[ties.which]
        kept = shares != 0
        return Stored(
            rows.choice_start, self._action, starts(kept)[rows.row_start], rows.target[kept],
            doubles_of(shares[kept], denominator), Shares(shares[kept], denominator), family=self,
        )  # fmt: skip

    def narrowed(self, parameters: tuple[Parameter, ...]) -> Stored:
        rows, ties = self._rows, self._rows.chances.ties
        assert ties is not None
        return tied(rows.choice_start, self._action, rows.row_start, rows.target, ties.narrowed(parameters))

    def _blocks(self) -> Iterator[tuple[int, Rows]]:
        yield 0, self._rows

    def require_distributions(self, place: Place, state: Place) -> None:
        self._rows.require_distributions(place, state)


def tied(choice_start: I64, choice_action: I32, row_start: I64, target: I32, ties: Ties) -> Stored:
    """Rows that depend on parameters; their intervals are the ends of each entry."""
    ends = [doubles_of(numerator, ties.denominator) for numerator in (ties.first, ties.last)]
    intervals = Intervals(np.minimum(*ends), np.maximum(*ends))
    nominal = intervals.nominal(row_start)
    return Stored(choice_start, choice_action, row_start, target, nominal, intervals=intervals, ties=ties)


def digest_arrays(sha: _Hash, arrays: Iterable[tuple[str, NDArray[Any]]]) -> None:
    for title, array in arrays:
        sha.update(f"{title}{array.shape}".encode())
        sha.update(np.ascontiguousarray(array).data)


class _Column:
    """An array that grows at the end."""

    def __init__(self, dtype: Any, room: int) -> None:
        self._array, self._n = np.empty(room, dtype=dtype), 0

    def add(self, values: NDArray[Any]) -> None:
        end = self._n + len(values)
        if end > len(self._array):
            self._array = np.concatenate([self._array, np.empty(max(end, 2 * len(self._array)), self._array.dtype)])
        self._array[self._n : end] = values
        self._n = end

    @property
    def all(self) -> NDArray[Any]:
        return self._array[: self._n]


class Gathered:
    """Rows of one source, appended one after another; `room` for this many entries."""

    def __init__(self, room: int = 0) -> None:
        self._room = room
        self._columns: dict[str, _Column] = {}
        self._chances: Chances | None = None
        self._all: Rows | None = None
        for name in ("choice_start", "row_start"):
            self._column(name, np.zeros(1, dtype=np.int64))

    def add(self, rows: Rows) -> None:
        if self._chances is None:
            self._chances = rows.chances
        self._all = None
        for name, first in (("choice_start", rows.choice_start), ("row_start", rows.row_start)):
            self._column(name, first[1:] + self._columns[name].all[-1])
        self._column("target", rows.target)
        if rows.entry is not None:  # entries of one table
            assert rows.chances is self._chances
            self._column("entry", rows.entry)
            return
        self._column("probability", rows.probability)
        if rows.given_exactly:
            assert rows.denominator == self._chances.exact.denominator
            self._column("numerator", rows.numerator)
        if rows.intervals is not None:
            self._column("lower", rows.intervals.lower)
            self._column("upper", rows.intervals.upper)

    def _column(self, name: str, values: NDArray[Any]) -> None:
        if name not in self._columns:
            self._columns[name] = _Column(values.dtype, max(self._room, len(values)))
        self._columns[name].add(values)

    @property
    def all(self) -> Rows:
        """All rows so far."""
        if self._all is None:
            assert self._chances is not None
            of = {name: column.all for name, column in self._columns.items()}
            chances = self._chances
            if "entry" not in of:
                given = Shares(of["numerator"], chances.exact.denominator) if "numerator" in of else None
                known = self._chances.intervals
                lost = known is not None and (known.rounded or known.given is not None)
                ends = Intervals(of["lower"], of["upper"], rounded=lost) if "lower" in of else None
                chances = Chances(of["probability"], of["row_start"], given, ends)
            self._all = Rows(of["choice_start"], of["row_start"], of["target"], chances, of.get("entry"))
        return self._all


class Demand:
    """The rows of a source that were asked for, with states numbered in order of request.

    `rows` grows: what was read from it before a call of `at` may lack the rows added there.
    """

    def __init__(self, source: Source) -> None:
        self.source = source
        self._number = np.full(source.n_states, -1, dtype=np.int32)
        self._gathered = Gathered()
        self._gathered.add(source.rows(np.empty(0, dtype=np.int64)))
        self._n = 0
        self.kinds, self.widest, self.most_choices = source.kinds, source.widest, source.most_choices

    @property
    def choice_start(self) -> I64:
        return self.rows.choice_start

    @property
    def rows(self) -> Rows:
        return self._gathered.all

    def known(self, states: I64) -> NDArray[np.bool_]:
        """Which of these states have been asked for."""
        found: NDArray[np.bool_] = self._number[states] >= 0
        return found

    def at(self, states: I64) -> I64:
        """The numbers of these states; the rows of new ones are computed."""
        found = self._number[states]
        if (found < 0).any():
            new = np.unique(states[found < 0])
            self._gathered.add(self.source.rows(new))
            self._number[new] = np.arange(self._n, self._n + len(new), dtype=np.int32)
            self._n += len(new)
            found = self._number[states]
        return found.astype(np.int64)

    def successors(self, numbers: I64) -> I32:
        """Those of all choices of the states with these numbers."""
        rows = self.rows
        first, end = (rows.row_start[rows.choice_start[which]] for which in (numbers, numbers + 1))
        return rows.target[spans(first, end)]
