"""Re-check a certificate of stltool in exact integers, from the last step back: `python recheck.py FILE`.

This file imports nothing from stltool and can be read, copied or rewritten on its own; docs/certificates.md describes
the format. It trusts nothing in the certificate. It proves that the claimed bounds hold for the model and the automaton
that the file lists. `stltool certify FILE TASK` compares these with the ones of a task file.

With s a model state, q an automaton state, D·p(c, s') the integers of choice c, and "goal" the verdict that counts,

    V_t(s,q) = 1 or 0                                       if the verdict of q at step t is the goal, or the other one
             = max_c or Σ_c weight(c) · Σ_s' p(c,s') · V_{t+1}(s', δ(letter of s', q))       otherwise

(A minimum is 1 minus the maximum for the other verdict.) If the file lists intervals, nature picks p(c, ·) anew at each
step, knowing s, q and c: of the distributions between the ends, which sum to 1 exactly, one with the least inner sum,
or with the greatest. It starts from the lower ends and hands out the rest in the order of the values, to each up to its
upper end.

There are two parts, both from the last step back:

  * What is certain follows from the model's graph. As sets of automaton states, one integer per model state:
    `possible`, where some considered choice can lead to a goal, and `sure`, where some choice (of a policy: the listed
    ones) leads to goals and sure pairs only. V is 0 outside `possible` and 1 in `sure`; the file lists neither.
  * For the remaining pairs the file lists numbers v_t. They need not be right: the distance of each from the result of
    one step from v_{t+1} is measured in exact integers. With e_t the largest distance upwards at step t, V_t − v_t is
    at most e_t + e_{t+1} + …, by induction, since averages, minima and maxima change by no more than their arguments.
    The same holds downwards. So wrong numbers cannot mislead: they only give wider bounds, and the claimed ones are
    refused.

If a row sums to 1 − d, the missing d may lead anywhere; if it sums to 1 + d, any d of it may be too much: the largest d
is added to the distance at each step, and distances grow by the largest factor 1 + d per step.
"""

from __future__ import annotations

import sys

if __name__ == "__main__" and not (sys.flags.isolated or getattr(sys.flags, "safe_path", False)):
    del sys.path[0]  # this file's folder, where stltool's numbers.py would hide the standard library's

import gzip
import hashlib
import json
import re
import struct
import zlib
from bisect import bisect_right
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from itertools import compress
from typing import Any, NoReturn, TypeAlias

FORMAT = "stltool-certificate-3"
HEADER = {"format", "claim", "nature", "task", "formula", "encoding", "horizon", "model", "policy"}
CLAIMS = ("maximum", "minimum", "policy")
NATURES = (None, "least", "greatest")
LINE = 2**23  # the most bytes of a line
DIGITS = 4300  # the most digits of a decimal number
BITS = 2**20  # the most bits of the integer that represents 1
WORK = 10**8  # the most sets computed for model states, plus 100 for each byte of the file
FINE = 2**64  # parts of a unit in which distances are counted
PLACES = ((2**8, "B"), (2**16, "H"), (2**32, "I"))  # types for places in a list of at most that length: 1, 2, 4 bytes
DAMAGE = (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError, EOFError, MemoryError,
          zlib.error, gzip.BadGzipFile)  # fmt: skip

Item: TypeAlias = dict[str, Any] | list[Any]
Choice: TypeAlias = tuple[list[int], list[int], list[int] | None]
"""Successors, their integers over D (of intervals: the lower ends), and the widths of intervals."""


class Refused(Exception):
    """The certificate proves nothing; the message says why, and where."""


class NotACertificate(Refused):
    """The file is not a certificate, or is too damaged to be read."""


def require(holds: bool, problem: str) -> None:
    if not holds:
        raise Refused(problem)


def certify(path: str, progress: Callable[[int, int], None] | None = None) -> dict[str, Any]:
    """Check every line of the certificate. Returns its header with the proved bounds and the counts.

    `progress` is called with (steps done, all steps). Raises Refused, OSError.
    """
    longest = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(0)  # lengths are checked before numbers are read
    lines = Lines(path)
    try:
        return _certify(lines, progress or (lambda done, total: None))
    except NotACertificate:
        raise
    except (Refused, *DAMAGE) as error:
        fault = str(error) if isinstance(error, Refused) else lines.damage(error)
        if not lines.ours:
            raise NotACertificate(f"not a certificate ({FORMAT}): {fault}") from None
        raise Refused(fault) from None
    finally:
        sys.set_int_max_str_digits(longest)


# ------------------------------------------------------------------------------------------------ reading


class Lines:
    """The file's lines in order, each an object or a list; its seal, a digest of all lines before it, is checked last.

    `read` counts bytes, `begun` the lines begun; `ours` tells whether the first line states the format. Of a line, no
    more than the longest allowed length is read.
    """

    def __init__(self, path: str) -> None:
        self.path, self.read, self.begun, self.ours = path, 0, 0, False

    def damage(self, error: Exception) -> str:
        """What an error of reading means, in words."""
        match error:
            case EOFError():
                return f"the file is cut off: its compressed data end after line {self.begun}"
            case zlib.error() | gzip.BadGzipFile():
                return f"its compressed data are damaged after line {self.begun}"
            case UnicodeDecodeError():
                return f"line {self.begun} is not UTF-8 text"
            case json.JSONDecodeError():
                return f"line {self.begun} is not JSON, or it is cut off"
            case RecursionError():
                return f"line {self.begun} is nested too deeply"
            case MemoryError():
                return f"line {self.begun} needs more memory than there is"
        return f"what is listed up to line {self.begun} does not have the form of a certificate"

    def __iter__(self) -> Iterator[Item]:
        with open(self.path, "rb") as plain:
            packed = plain.read(2) == b"\x1f\x8b"
        digest, seal = hashlib.sha256(), None
        with gzip.open(self.path, "rb") if packed else open(self.path, "rb") as file:
            while line := file.readline(LINE + 1):
                self.read += len(line)
                self.begun += 1
                require(len(line) <= LINE, f"line {self.begun} has more than {LINE} bytes")
                require(seal is None, "there is text after the seal")
                item = _DECODER.decode(line.decode())
                if self.begun == 1:
                    self.ours = type(item) is dict and item.get("format") == FORMAT
                seal = item.get("sha256") if type(item) is dict else None
                if seal is None:
                    digest.update(line)
                    yield item
                else:
                    require(len(item) == 1, "the seal has keys other than its digest")
        if not self.read:
            raise NotACertificate("the file is empty")
        require(seal is not None, "the file is cut off: its seal is missing")
        require(seal == digest.hexdigest(), "the seal does not match: the file was changed after it was written")


class Blocks:
    """An object of the file opens a block; the lists that follow are its rows."""

    def __init__(self, items: Iterator[Item]) -> None:
        self._items = items
        self._next = next(items, None)

    def opens(self, key: str) -> bool:
        """Whether an object with this key comes next."""
        return type(self._next) is dict and key in self._next

    def head(self, keys: set[str]) -> dict[str, Any]:
        """The object that comes next, which must have these keys and no others."""
        head = self._next
        if type(head) is not dict or {*head} != keys:
            raise Refused(f"expected an object with the keys {', '.join(sorted(keys))}, found {head!r:.80}")
        self._next = next(self._items, None)
        return head

    def rows(self) -> Iterator[list[Any]]:
        while type(self._next) is list:
            row, self._next = self._next, next(self._items, None)
            yield row

    def end(self) -> None:
        require(self._next is None, "there are lines after the conclusion")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    require(len(found) == len(pairs), "an object has a duplicate key")
    return found


def _whole(text: str) -> int:
    require(len(text) <= DIGITS, f"a number has {len(text)} digits, more than {DIGITS}")
    return int(text)


def _not_whole(text: str) -> NoReturn:
    raise Refused(f"{text[:80]} is not an integer")


_DECODER = json.JSONDecoder(
    parse_int=_whole, parse_float=_not_whole, parse_constant=_not_whole, object_pairs_hook=_once
)
_TRUE = bytes.maketrans(b"01", b"\0\1")
_HEX, _FRACTION = re.compile("[0-9a-f]+"), re.compile("(-?[0-9]+)(?:/([0-9]+))?")


def integers(row: Any) -> bool:
    """Whether `items` is a list of integers and nothing else."""
    return type(row) is list and {*map(type, row)} <= {int}


def hexadecimal(text: Any, most: int, what: str) -> int:
    """The number in a text of at most `most` hexadecimal digits."""
    holds = type(text) is str and len(text) <= most and _HEX.fullmatch(text)
    require(bool(holds), f"{what} is not a hexadecimal number of at most {most} digits")
    return int(text, 16)


def members(mask: int) -> list[int]:
    """The elements of a set, which is stored as the bits of an integer."""
    bits = f"{mask:b}"[::-1].encode().translate(_TRUE)
    return [*compress(range(len(bits)), bits)]


def set_of(elements: Iterable[int], n: int) -> int:
    """The set of elements below n."""
    bits = bytearray(b"0" * (n + 1))
    for i in elements:
        bits[~i] = 49  # "1"
    return int(bits, 2)


# -------------------------------------------------------------------------------------- model and automaton


class Letter:
    """An automaton's moves on one letter: `after` (δ), and the inverse image of a set.

    Sets move by shifts: states that all move by the same amount, or all to the same state, form a piece.
    """

    def __init__(self, after: list[int]) -> None:
        self.after = after
        shifts, targets = Counter(r - q for q, r in enumerate(after)), Counter(after)
        pieces = defaultdict(list)
        for q, r in enumerate(after):
            pieces[("by", r - q) if shifts[r - q] >= targets[r] else ("to", r)].append(q)
        few = len(pieces) <= 256
        self.pieces = [(*key, set_of(piece, len(after))) for key, piece in pieces.items()] if few else None

    def before(self, ends: int) -> int:
        """The set {q : δ(q) in `ends`}."""
        if not ends:
            return 0
        if self.pieces is None:
            bits = f"{ends:0{len(self.after)}b}"
            return int("".join([bits[~r] for r in reversed(self.after)]), 2)
        found = 0
        for kind, amount, piece in self.pieces:
            if kind == "by":
                found |= (ends >> amount if amount >= 0 else ends << -amount) & piece
            elif ends >> amount & 1:
                found |= piece
        return found


class Model:
    """The states of the file: share of the initial distribution, letter, and choices.

    What follows a state without choices, or a choice without successors, is unknown. `near`: the successors of each
    state; `known`: the states of which every choice is known.
    """

    def __init__(self, head: dict[str, Any], rows: Iterator[list[Any]], intervals: bool) -> None:
        self.D, self.total = head["denominator"], head["initial_denominator"]
        require(
            integers([self.D, self.total]) and self.D > 0 < self.total, "the denominators are not positive integers"
        )
        self.share: dict[int, int] = {}
        self.letter: dict[int, int] = {}
        self.choices: dict[int, list[Choice]] = {}
        last, size = -1, 3 if intervals else 2
        for row in rows:
            where = f"model state {row[0]!r:.20}" if row else "the model"
            require(
                len(row) > 2 and integers(row[:3]) and min(row[:3]) >= 0,
                f"{where}: number, share or letter missing or invalid",
            )
            s, self.share[s], self.letter[s], *choices = row
            require(s > last, f"{where}: not in ascending order")
            known = all(integers(choice) and len(choice) % size == 0 for choice in choices)
            require(known, f"{where}: a choice is not a list of {'triples' if intervals else 'pairs'} of integers")
            require(all(min(choice, default=0) >= 0 for choice in choices), f"{where}: a negative number")
            if intervals:
                self.choices[s] = [self._between(choice[::3], choice[1::3], choice[2::3], where) for choice in choices]
            else:
                self.choices[s] = [(choice[::2], choice[1::2], None) for choice in choices]
            last = s
        self.near = {s: sorted({x for xs, _, _ in options for x in xs}) for s, options in self.choices.items()}
        require(all(x in self.share for near in self.near.values() for x in near), "a successor is not listed")
        require(bool(self.share), "the model has no states")
        self.known = {s for s, options in self.choices.items() if options and all(xs for xs, _, _ in options)}
        given = [] if intervals else [option for options in self.choices.values() for option in options]
        sums = [self.D, *(sum(numbers) for xs, numbers, _ in given if xs)]
        self.missing, self.excess = self.D - min(sums), max(sums) - self.D  # the largest of a row, over D

    def _between(self, successors: list[int], low: list[int], high: list[int], where: str) -> Choice:
        """A choice with intervals, which must contain a distribution."""
        require(all(map(int.__le__, low, high)), f"{where}: a lower end is above the upper end")
        holds = not successors or sum(low) <= self.D <= sum(high)
        require(holds, f"{where}: no probabilities between the ends sum to 1")
        return successors, low, [*map(int.__sub__, high, low)]

    def reached(self, horizon: int) -> dict[int, int]:
        """The first step at which runs can be in a model state, for the states reached within this many steps."""
        first = {s: 0 for s, share in self.share.items() if share}
        newest, t = [*first], 0
        while newest and t < horizon:
            t += 1
            newest = [*dict.fromkeys(x for s in newest for x in self.near[s] if x not in first)]
            first |= dict.fromkeys(newest, t)
        return first


class Automaton:
    """δ by letters, the state `start` before the first letter, and verdicts as sets, each from its step on."""

    def __init__(self, head: dict[str, Any], rows: Iterator[list[Any]]) -> None:
        self.size, n_letters, self.start, self.steps = (head[key] for key in ("states", "letters", "start", "verdicts"))
        require(
            integers([self.size, n_letters, self.start]) and integers(self.steps),
            "the automaton's header is not in integers",
        )
        require(
            self.steps[:1] == [0] and self.steps == sorted({*self.steps}), "the verdicts' steps do not ascend from 0"
        )
        require(0 <= self.start < self.size, "the automaton's first state is not one of its states")
        self.all = (1 << self.size) - 1
        self.letters: list[Letter] = []
        self.verdicts: list[tuple[int, int, int]] = []
        for row in rows:
            require(integers(row) and len(row) == self.size, "a row of the automaton needs one integer for each state")
            if len(self.letters) < n_letters:
                require(min(row) >= 0 and max(row) < self.size, "the automaton leads to something that is not a state")
                self.letters.append(Letter(row))
            else:
                require({*row} <= {-1, 0, 1}, "a verdict is not −1, 0 or 1")
                true, false, undecided = (
                    set_of((q for q, v in enumerate(row) if v == verdict), self.size) for verdict in (1, 0, -1)
                )
                self.verdicts.append((true, false, undecided))
        require(len(self.letters) == n_letters, "the automaton has fewer letters than announced")
        require(len(self.verdicts) == len(self.steps), "the automaton has fewer or more verdicts than announced")

    def period(self, t: int) -> int:
        """The index of the verdicts that apply at step t: they apply from step steps[index] on."""
        return bisect_right(self.steps, t) - 1


# ------------------------------------------------------------------------------------------------- induction

Listed: TypeAlias = dict[int, tuple[int, list[int], list[int]]]
"""By model state: the set of automaton states that have a number, these states in order, and their numbers."""
Weights: TypeAlias = tuple[tuple[int, int], ...]
"""Choices of a model state, each with its integer weight."""
Outcomes: TypeAlias = dict[tuple[int, Weights | None], dict[tuple[int, ...], int]]
"""By model state and choices taken there: the outcome of the values of its successors, in order."""


class Row(dict[int, int]):
    """The values of a model state by automaton state: the listed numbers, and on demand the certain values."""

    def __init__(self, at: Induction, s: int) -> None:
        _, states, numbers = at.values.get(s, (0, [], []))
        super().__init__(zip(states, numbers, strict=True))
        self._one, self._possible, self._sure = at.one, at.possible[s], at.sure[s]
        self._place = f"step {at.t}, model state {s}"

    def __missing__(self, q: int) -> int:
        value = self._one if self._sure >> q & 1 else 0
        certain = value or not self._possible >> q & 1
        require(bool(certain), f"{self._place}, automaton state {q}: neither certain nor listed")
        self[q] = value
        return value


class Rows(dict[int, Row]):
    """The values of all model states at the current step of an induction, made on demand."""

    def __init__(self, at: Induction) -> None:
        super().__init__()
        self._at = at

    def __missing__(self, s: int) -> Row:
        row = self[s] = Row(self._at, s)
        return row


class Induction:
    """All that is known about step t; numbers are in units of 1/one.

    values    the numbers of the listed pairs     table    the numbers that rows may refer to
    possible, sure, and the sets that lead into them (before): a set for each model state
    changed   the model states whose sets differ from those of step t + 1
    least     with intervals: whether nature makes the probability of the goal least (False: greatest)
    moves     for a policy, by model state: sets of automaton states, and the choices taken there, with weights
    far       the sums of the distances upwards and downwards so far, in units of 1/(one·FINE)
    worst     the largest distance each way, and where it was
    outcomes  results of the last compared step from the values ahead, by model state and policy; `kept`: of this step
    work      how often sets of a model state were computed, or its numbers compared; most_work() is its limit
    """

    def __init__(
        self,
        model: Model,
        automaton: Automaton,
        claim: str,
        nature: str | None,
        horizon: int,
        most_work: Callable[[], int],
    ) -> None:
        self.model, self.automaton, self.horizon, self.t = model, automaton, horizon, horizon
        self.goal = claim != "minimum"
        self.least = (nature == "least") == self.goal  # the goal of a minimum is the other verdict
        self.moves: dict[int, list[tuple[int, Weights]]] | None = {} if claim == "policy" else None
        self.policy_from, self.named = horizon if claim == "policy" else 0, set[int]()
        self.values: Listed = {}
        self.table: list[int] = []
        self.outcomes: Outcomes = {}
        self.kept: Outcomes = {}
        self.one, self.pairs, self.work, self.far, self.most_work = 1, 0, 0, [0, 0], most_work
        self.worst = [(Fraction(0), "")] * 2
        self.reached = model.reached(horizon)
        self.leading_to: dict[int, list[int]] = defaultdict(list)
        for s in self.reached:
            for x in model.near[s]:
                self.leading_to[x].append(s)
        goal, other, _ = self.verdicts(horizon)
        self.possible, self.sure = dict.fromkeys(model.share, automaton.all & ~other), dict.fromkeys(model.share, goal)
        self.possible_before, self.sure_before = dict.fromkeys(model.share, 0), dict.fromkeys(model.share, 0)
        self.changed = [*self.reached]

    def verdicts(self, t: int) -> tuple[int, int, int]:
        """The automaton states whose verdict at step t is the goal, the other one, undecided."""
        true, false, undecided = self.automaton.verdicts[self.automaton.period(t)]
        return (true, false, undecided) if self.goal else (false, true, undecided)

    def follow(self, steps: Any, rows: Iterator[list[Any]]) -> None:
        """Read the policy of the steps before this one."""
        first = self._first_of(steps)
        require(self.moves is not None and self.t == self.policy_from, f"step {self.t - 1}: a policy out of place")
        assert self.moves is not None
        self.named, self.moves, self.policy_from = {*self.moves}, defaultdict(list), first
        last = 0
        for s, mask, taken in rows:
            where = f"the policy of step {first}, model state {s!r:.20}"
            require(type(s) is int and s in self.model.share, f"{where}: no such state")
            require(last <= s, f"{where}: not in ascending order")
            last, n = s, len(self.model.choices[s])
            if type(taken) is int:
                require(0 <= taken < n, f"{where}: no such choice")
                weights: Weights = ((taken, 1),)
            else:
                require(integers(taken) and len(taken) == n and min(taken) >= 0, f"{where}: not a mixture of choices")
                weights = tuple((c, weight) for c, weight in enumerate(taken) if weight)
            those = self._set(mask, where)
            require(bool(weights), f"{where}: no choice")
            require(
                all(self.model.choices[s][c][0] for c, _ in weights),
                f"{where}: nothing is known about the choice taken",
            )
            require(not any(those & others for others, _ in self.moves[s]), f"{where}: two choices for one pair")
            self.moves[s].append((those, weights))
        self.named |= {*self.moves}

    def go_back(self, layer: Any, scale: Any, known: Any, rows: Iterator[list[Any]]) -> None:
        """Compare the numbers of a range of steps with the results of one step from the numbers ahead, from the last
        step back."""
        first = self._first_of(layer)
        where = f"steps {first} to {self.t - 1}"
        require(first >= self.policy_from, f"{where}: there is no policy for the first of them")
        growth = hexadecimal(scale, BITS // 4, f"{where}: the scale")
        unit = self.one * growth
        require(0 < unit.bit_length() <= BITS, f"{where}: the scale is 0 or too large")
        require(type(known) is int and 0 <= known <= len(self.table), f"{where}: it keeps more numbers than there are")
        self.table = [number * growth for number in self.table[:known]]
        here = self._listed(rows, len(f"{unit:x}"), where)
        self.pairs += sum(len(states) for _, states, _ in here.values())
        passed, distances = 0, [0, 0]
        while self.t > first:
            t, period = self.t - 1, self.automaton.period(self.t - 1)
            new_verdicts = period != self.automaton.period(self.t)
            again = {s for x in self.changed for s in self.leading_to[x]}
            if passed == 0 or new_verdicts:
                undecided = self.verdicts(t)[2]
                for s, (those, _, _) in here.items():
                    require(not those & ~undecided, f"step {t}, model state {s}: a number where the verdict is known")
            # from the second step of a layer on, numbers are compared with themselves: only changed sets matter
            wanted = here.keys() if passed < 2 else here.keys() & again
            found = self._distances(here, wanted, growth, t)
            distances = found if passed < 2 else [*map(max, distances, found)]
            alike = passed > 1 and not again and not new_verdicts
            n = self.t - max(first, self.automaton.steps[period]) if alike else 1
            self.far = [far * growth + n * distance for far, distance in zip(self.far, distances, strict=True)]
            self._sets(t, new_verdicts, again)
            self.values, self.one, self.t, passed, growth = here, unit, self.t - n, passed + 1, 1
            require(self.work <= self.most_work(), f"step {t}: it takes more work than the size of the file allows")

    def bounds(self) -> tuple[Fraction, Fraction]:
        """The proved bounds of the claimed quantity, at step 0."""
        model, automaton, rows = self.model, self.automaton, Rows(self)
        entries = [
            (n, s, automaton.letters[model.letter[s]].after[automaton.start]) for s, n in model.share.items() if n
        ]
        value = Fraction(sum(n * rows[s][q] for n, s, q in entries), self.one * model.total)
        share = Fraction(sum(model.share.values()), model.total)
        defect = Fraction(self.horizon * (model.missing + model.excess), model.D)
        room = 1 - Fraction(self.horizon * model.excess, model.D)  # (1 + d)^h is at most 1 / (1 - h·d)
        if room <= 0:
            return Fraction(0), Fraction(1)
        none, all_ = Fraction(0), Fraction(1)
        high, low = ((Fraction(far, self.one * FINE) + defect) / room * max(share, all_) for far in self.far)
        lower, upper = max(value - low - max(share - 1, none), none), min(value + high + max(1 - share, none), all_)
        return (lower, upper) if self.goal else (1 - upper, 1 - lower)

    def _first_of(self, steps: Any) -> int:
        """The first step of a range [first, last], which must end just before this step."""
        require(integers(steps) and len(steps) == 2, f"{steps!r:.80} is not a range of steps")
        require(0 <= steps[0] <= steps[1] == self.t - 1, f"expected steps that end with {self.t - 1}, found {steps}")
        return int(steps[0])

    def _set(self, mask: Any, where: str) -> int:
        found = hexadecimal(mask, self.automaton.size // 4 + 1, f"{where}: its set of automaton states")
        require(0 < found <= self.automaton.all, f"{where}: not a set of automaton states")
        return found

    def _listed(self, rows: Iterator[list[Any]], width: int, where: str) -> Listed:
        """The rows of a layer: first numbers of `width` digits each, to be added to the table, then pairs."""
        found: Listed = {}
        last = -1
        for row in rows:
            if len(row) == 1 and not found:
                known = type(row[0]) is str and len(row[0]) % width == 0 and _HEX.fullmatch(row[0])
                require(bool(known), f"{where}: expected numbers of {width} digits")
                self.table += [int(row[0][i : i + width], 16) for i in range(0, len(row[0]), width)]
                continue
            require(len(row) == 3, f"{where}: a row does not consist of a model state, a set and places in the table")
            s, mask, text = row
            place = f"{where}, model state {s!r:.20}"
            require(type(s) is int and s in self.model.share, f"{place}: no such state")
            require(s in self.model.known or self.moves is not None, f"{place}: not all of its choices are known")
            require(last < s, f"{place}: not in ascending order")
            last, those = s, self._set(mask, place)
            code = next(code for most, code in PLACES if len(self.table) <= most)
            states, size = members(those), 2 * struct.calcsize(f">{code}")
            known = type(text) is str and len(text) == size * len(states) and _HEX.fullmatch(text)
            require(bool(known), f"{place}: expected {len(states)} places of {size} digits in the table")
            which = struct.unpack(f">{len(states)}{code}", bytes.fromhex(text))
            require(max(which) < len(self.table), f"{place}: there is no such number in the table")
            found[s] = those, states, [*map(self.table.__getitem__, which)]
        return found

    def _distances(self, here: Listed, wanted: Iterable[int], growth: int, t: int) -> list[int]:
        """How far numbers of some model states are, upwards and downwards, from the result of a step from those
        ahead."""
        ahead, largest, where = Rows(self), [0, 0], [0, 0]
        self.outcomes, self.kept = self.kept, {}
        for s in wanted:
            self.work += 1
            for numbers, values, denominator in self._compared(s, here[s], ahead, t):
                off = [value * growth - number * denominator for value, number in zip(values, numbers, strict=True)]
                for side, distance in enumerate((max(off), -min(off))):
                    if distance * FINE > largest[side] * denominator:
                        largest[side], where[side] = -(-distance * FINE // denominator), s
        for side, distance in enumerate(largest):
            if distance and Fraction(distance, self.one * growth) > self.worst[side][0]:
                self.worst[side] = Fraction(distance, self.one * growth), f"step {t}, model state {where[side]}"
        return largest

    def _compared(
        self, s: int, listed: tuple[int, list[int], list[int]], ahead: Rows, t: int
    ) -> Iterator[tuple[list[int], list[int], int]]:
        """Numbers of a model state, the results of a step from the values ahead, and their denominator."""
        those, states, numbers = listed
        if self.moves is None:
            yield numbers, self._step(s, None, states, ahead), self.model.D
            return
        for where, weights in self.moves.get(s, ()):
            if where & those:
                taken = [where >> q & 1 for q in states]
                values = self._step(s, weights, [*compress(states, taken)], ahead)
                yield [*compress(numbers, taken)], values, self.model.D * sum(w for _, w in weights)
                those &= ~where
        require(not those, f"step {t}, model state {s}: a number where no choice is listed")

    def _step(self, s: int, weights: Weights | None, states: list[int], ahead: Rows) -> list[int]:
        """By automaton state: the largest Σ D·p·(value ahead) over all choices, or Σ weight · Σ D·p·(value ahead).

        Pairs that lead to the same values have the same outcome, which is computed once, and kept for the step before.
        """
        choices, near = self.model.choices[s], self.model.near[s]
        if weights is not None:
            choices = [choices[c] for c, _ in weights]
            near = sorted({x for successors, _, _ in choices for x in successors})
        after: dict[int, list[int]] = {}
        values = []
        for x in near:
            if (letter := self.model.letter[x]) not in after:
                after[letter] = [*map(self.automaton.letters[letter].after.__getitem__, states)]
            values.append(map(ahead[x].__getitem__, after[letter]))
        keys = [*zip(*values, strict=True)]
        outcomes = self.outcomes.get((s, weights), {})
        if new := {*keys}.difference(outcomes):
            by_successor = dict(zip(near, zip(*new, strict=True), strict=True))
            sums = []
            for successors, integers_, widths in choices:
                if widths is not None:
                    columns = zip(*map(by_successor.__getitem__, successors), strict=True)
                    sums.append([self._natures(integers_, widths, column) for column in columns])
                    continue
                terms = [[n * value for value in by_successor[x]] for x, n in zip(successors, integers_, strict=True)]
                sums.append(terms[0] if len(terms) == 1 else [*map(sum, zip(*terms, strict=True))])
            if weights is not None:
                weighed = ([weight * x for x in xs] for (_, weight), xs in zip(weights, sums, strict=True))
                sums = [[*map(sum, zip(*weighed, strict=True))]]
            outcomes |= zip(new, sums[0] if len(sums) == 1 else map(max, *sums), strict=True)
        self.kept.setdefault((s, weights), {}).update({key: outcomes[key] for key in keys})
        return [*map(outcomes.__getitem__, keys)]

    def _natures(self, low: list[int], widths: list[int], values: tuple[int, ...]) -> int:
        """The least (or greatest) Σ D·p·value over all p between the ends that sum to 1."""
        left, total = self.model.D - sum(low), sum(map(int.__mul__, low, values))
        for value, width in sorted(zip(values, widths, strict=True), reverse=not self.least):
            share = min(width, left)
            left, total = left - share, total + share * value
        return total

    def _sets(self, t: int, everywhere: bool, again: set[int]) -> None:
        """Go on to the sets of step t. They can differ only where verdicts, the policy or a successor's sets do."""
        model, letters, ends = self.model, self.automaton.letters, (self.possible, self.sure)
        for x in self.changed:
            letter = letters[model.letter[x]]
            self.possible_before[x], self.sure_before[x] = (letter.before(sets[x]) for sets in ends)
        goal, _, undecided = self.verdicts(t)
        changed, some = [], self.reached if everywhere else again | self.named
        for s in some:
            if self.reached.get(s, self.t) <= t:
                possible, sure = self._sets_before(s)
                possible, sure = goal | undecided & possible, goal | undecided & sure
                if possible != self.possible[s] or sure != self.sure[s]:
                    self.possible[s], self.sure[s] = possible, sure
                    changed.append(s)
        self.work += len(some)
        self.changed, self.named = changed, set()

    def _sets_before(self, s: int) -> tuple[int, int]:
        """The automaton states from which a considered choice can lead to a goal, and from which it surely does."""
        choices, some, every = self.model.choices[s], 0, 0
        if self.moves is None and s not in self.model.known:
            return self.automaton.all, 0  # it may lead to anything
        if self.moves is None:
            for x in self.model.near[s]:
                some |= self.possible_before[x]
            for successors, _, _ in choices:
                all_of_them = self.automaton.all
                for x in successors:
                    all_of_them &= self.sure_before[x]
                every |= all_of_them
            return some, every
        unknown = self.automaton.all
        for those, weights in self.moves.get(s, ()):
            all_of_them = those
            for x in {x for c, _ in weights for x in choices[c][0]}:
                some |= those & self.possible_before[x]
                all_of_them &= self.sure_before[x]
            every, unknown = every | all_of_them, unknown & ~those
        return some | unknown, every


def _certify(lines: Lines, progress: Callable[[int, int], None]) -> dict[str, Any]:
    blocks = Blocks(iter(lines))
    if not blocks.opens("format") or (header := blocks.head(HEADER))["format"] != FORMAT:
        raise NotACertificate(f"not a certificate ({FORMAT})")
    claim, nature, horizon = header["claim"], header["nature"], header["horizon"]
    texts = [header[key] for key in ("task", "formula", "encoding", "model", "policy") if header[key] is not None]
    require(all(type(text) is str and text.isprintable() for text in texts), "the header's texts are not printable")
    require(claim in CLAIMS, f"unknown claim {claim!r:.80}")
    require(nature in NATURES, f"unknown nature {nature!r:.80}")
    require(type(horizon) is int and horizon >= 0, f"the horizon {horizon!r:.80} is not a number of steps")
    model = Model(blocks.head({"denominator", "initial_denominator"}), blocks.rows(), nature is not None)
    automaton = Automaton(blocks.head({"states", "letters", "start", "verdicts"}), blocks.rows())
    require(max(model.letter.values()) < len(automaton.letters), "a letter is not one of the automaton's")
    induction = Induction(model, automaton, claim, nature, horizon, lambda: WORK + 100 * lines.read)
    while induction.t > 0:
        if blocks.opens("policy"):
            induction.follow(blocks.head({"policy"})["policy"], blocks.rows())
        else:
            induction.go_back(**blocks.head({"layer", "scale", "known"}), rows=blocks.rows())
            progress(horizon - induction.t, horizon)
    claimed, proved = blocks.head({"lower", "upper"}), induction.bounds()
    blocks.end()
    for i, key in enumerate(("lower", "upper")):
        bound = _fraction(claimed[key], proved[i])
        _, where = induction.worst[i if claim == "minimum" else 1 - i]
        holds = proved[i] >= bound if key == "lower" else proved[i] <= bound
        farthest = f"; the largest distance is at {where}" if where else ""
        require(holds, f"the claimed {key} bound is not proved{farthest}")
    initial = abs(model.total - sum(model.share.values()))
    defect = max(Fraction(initial, model.total), Fraction(max(model.missing, model.excess), model.D))
    return header | claimed | {"steps": horizon, "pairs": induction.pairs, "defect": str(defect)}


def _fraction(text: Any, proved: Fraction) -> Fraction:
    """A claimed bound, with not many more digits than the one proved."""
    most = proved.numerator.bit_length() + proved.denominator.bit_length() + 1000
    known = _FRACTION.fullmatch(text) if type(text) is str and len(text) <= most else None
    require(known is not None, f"{text!r:.80} is not a fraction")
    return Fraction(text)


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        print(
            "usage: python recheck.py FILE    (exit code 0: proved, 1: refused, 2: not a certificate)", file=sys.stderr
        )
        sys.exit(2)
    try:
        told = certify(sys.argv[1])
        print(f"proved for the model and automaton in the file: {told['lower']} <= P <= {told['upper']}")
        print(json.dumps(told))
    except (Refused, OSError) as refusal:
        print(f"refused: {refusal}", file=sys.stderr)
        sys.exit(2 if isinstance(refusal, NotACertificate | OSError) else 1)
