"""DRN, the direct encoding of Storm: a text with a line for every state, action and transition.

    // a comment
    @type: MDP                      or DTMC
    @value_type: rational           also double, and double-interval or rational-interval: [0.4, 0.9]
    @parameters                     a line of names: numbers may then be linear in them, such as (1-p)/3
    @placeholders                   lines such as "$x : 0.3": numbers that are written $x
    @reward_models                  a line of names
    @nr_states, @nr_choices         a line with their number
    @model
    state 0 [0, 1/2] init done      rewards of the state, and its labels
    //[!b	& x=3]                    the values of its variables, if Storm was asked for them
        action go [1, 0]            the rewards of the action
            1 : 2/5                 successor : probability

Labels become labels, rewards costs, and variables signals (truth is 0 and 1; Storm leaves out the name of a Boolean
that is true, which stands in the comments of other states). Decimals and fractions are exact. What Storm does not check
is checked: the numbers of states and choices, signs, sums, successors that occur twice. A parameter may have all values
for which every number is a probability. `.drn.gz` is what Storm reads under this extension, a compressed archive of one
text; a compressed text is read, too.

Source: https://www.stormchecker.org/documentation/background/drn.html, and what stormpy 2.0 reads and writes.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import NoReturn, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.display import StateNames
from stltool.errors import MOST_FAULTS, ModelError, all_told, marked
from stltool.models.costs import Amounts
from stltool.models.formats.archive import only_file
from stltool.models.formats.drn_family import family_of
from stltool.models.formats.drn_text import NAMES, NO_LABEL
from stltool.models.formats.given import INIT, Given, Valuation, model_of
from stltool.models.formats.lines import Written
from stltool.models.formats.packed import Data, mapped, unpacked
from stltool.models.fractions import LARGEST_SUM, Integers, Shares, over_one
from stltool.models.intervals import Intervals
from stltool.models.loading import Loading
from stltool.models.mdp import MDP
from stltool.models.normalize import HINT, MOST_MISSING
from stltool.numbers import NumberError, index, read
from stltool.sizes import require_memory, require_numbered

I8: TypeAlias = NDArray[np.int8]
I64: TypeAlias = NDArray[np.int64]
Floats: TypeAlias = NDArray[np.float64]

WHAT = "DRN file"
_FACTOR = 12.0  # bytes that a byte of text takes
_MOST_PLACES = 120
_LONGEST_HEADER = 1 << 20  # bytes
_SHOWN = 80  # characters of a line that a message quotes
_TOLERANCE = 1e-9  # how far the sum of a row may be from 1
_LABELS = re.compile(r'"([^"]+)"|([^\s"]+)')
_TYPES = ("double", "rational", "double-interval", "rational-interval", "parametric")
_CHAIN, _DECISIONS = "DTMC", "MDP"
_OTHER_KINDS = ("CTMC", "CTMDP", "MA", "Markov Automaton", "POMDP", "SMG", "S2PG", "IPOMDP", "LTS")
_REMEDIES = {
    1: 'lines begin with "state", "action" or the number of a successor',
    2: "the states are numbered 0, 1, 2, … in this order",
    3: 'the first line behind @model begins with "state 0"',
    4: 'write "successor : probability", such as 1 : 2/5',
    5: 'write "state number [rewards] labels"',
    6: "a bracket is not closed, or something stands behind it",
}


def load_drn(path: Path, loading: Loading) -> MDP:
    """Read a DRN file, .drn or .drn.gz. Raises FileError, SizeError, and ModelError with the lines of faults."""
    data = only_file(unpacked(mapped(path, WHAT), path, WHAT, _FACTOR), path, WHAT)
    return drn_model(path, data, name_of(path), loading)


def drn_model(
    path: Path,
    data: Data,
    name: str,
    loading: Loading,
    variables: Sequence[str] | None = None,
    labels: Collection[str] = (),
    left_out: Collection[str] = (),
) -> MDP:
    """The model of a DRN text; `path` is named in messages.

    variables  the names of all variables, if they are known
    labels     names of labels; a text has no word of those that hold nowhere
    left_out   variables that do not become signals
    """
    reader = Reader(path, data, variables, left_out)
    header = _header(reader)
    header.labels += labels
    try:
        if header.parameters:
            return family_of(reader, header, name, loading)
        return model_of(reader.given(header, loading.normalize), name, loading, reader.place)
    except ModelError as error:
        raise error if str(error).startswith(str(path)) else ModelError(f"{path}: {marked(error)}") from None


def name_of(path: Path) -> str:
    """The name of a file without .drn, .drn.gz, .drn.xz."""
    return path.name[: path.name.lower().rfind(".drn")] or path.stem


# ------------------------------------------------------------------------------------------------------------- header


@dataclass
class Header:
    """What stands before the transitions, which begin at byte `start`."""

    kind: str = ""
    values: str | None = None
    parameters: list[str] = field(default_factory=list)
    placeholders: dict[str, str] = field(default_factory=dict)
    rewards: list[str] = field(default_factory=list)
    n_states: int | None = None
    n_choices: int | None = None
    start: int = 0
    actions: list[str] = field(default_factory=list)
    labels: list[str] = field(default_factory=list)


def _header(reader: Reader) -> Header:
    data, header, at = reader.data, Header(), 0
    seen: set[str] = set()
    while True:
        line, begin, at = reader.line(at)
        if line is None or at > _LONGEST_HEADER:
            raise ModelError(f"{reader.path}: there is no line @model; this is not a {WHAT}, or only a part of one")
        text = line.strip()
        if line.startswith(NAMES):
            header.actions, header.labels = _names_in(line.removeprefix(NAMES))
        if not text or text.startswith("//"):
            continue
        key, _, rest = text.partition(":")
        if key in seen:
            reader.refuse(begin, f"{key} is declared twice")
        seen.add(key)
        match key:
            case "@model":
                header.start = at
                break
            case "@type":
                header.kind = rest.strip()
            case "@value_type":
                header.values = rest.strip()
                if header.values not in _TYPES:
                    reader.refuse(begin, f"there is no such type; known types: {', '.join(_TYPES)}")
            case "@parameters" | "@reward_models" | "@nr_states" | "@nr_choices":
                below, _, at = reader.line(at)
                _declare(reader, header, key, below or "", begin)
            case "@placeholders":
                while bytes(data[at : at + 1]) == b"$":
                    below, where, at = reader.line(at)
                    name, colon, value = (below or "").partition(":")
                    if not colon:
                        reader.refuse(where, 'write "$name : value"')
                    header.placeholders[name.strip()] = value.strip()
            case _:
                reader.refuse(begin, "this is not a line of the header of a DRN file")
    _require_header(reader, header)
    return header


def _names_in(text: str) -> tuple[list[str], list[str]]:
    """Names of actions and labels in a comment that we wrote; none in any other."""
    try:
        table = json.loads(text)
    except (ValueError, RecursionError):
        return [], []
    found = [table.get(key) if isinstance(table, dict) else None for key in ("actions", "labels")]
    ours = all(isinstance(names, list) and all(isinstance(name, str) for name in names) for names in found)
    return (found[0] or [], found[1] or []) if ours else ([], [])


def _declare(reader: Reader, header: Header, key: str, below: str, begin: int) -> None:
    if key == "@parameters":
        header.parameters = below.split()
    elif key == "@reward_models":
        header.rewards = below.split(" ") if below.strip() else [""] * len(below)
        while header.rewards and not header.rewards[-1]:
            header.rewards.pop()
    else:
        try:
            number = index(below.strip())
        except NumberError as error:
            reader.refuse(begin, f"{error}; it stands in the line below {key}")
        if key == "@nr_states":
            header.n_states = number
        else:
            header.n_choices = number


def _require_header(reader: Reader, header: Header) -> None:
    if header.kind not in (_CHAIN, _DECISIONS):
        if header.kind in _OTHER_KINDS:
            fault = f"the model is a {header.kind}; Markov chains (DTMC) and MDPs can be read"
        else:
            fault = f"the type is {header.kind!r}; write @type: MDP or @type: DTMC"
        raise ModelError(f"{reader.path}: {fault}")
    if header.n_states is None:
        raise ModelError(f"{reader.path}: @nr_states is missing; write the number of states in the line below it")
    if header.values == "parametric" and not header.parameters:
        header.values = None


# ---------------------------------------------------------------------------------------------------------- numbers


class Numbers:
    """Numbers as they were read (kernels/drn.py); texts are read here, by `meaning`."""

    def __init__(self, kind: I8, above: I64, below: I64, text: Callable[[int, int], Fraction]) -> None:
        self.kind, self.above, self.below, self._text = kind, above, below, text
        self._known: dict[int, Fraction] = {}

    def __len__(self) -> int:
        return len(self.kind)

    def at(self, k: int) -> Fraction:
        a, b = int(self.above[k]), int(self.below[k])
        match int(self.kind[k]):
            case 0:
                return Fraction(a) * Fraction(10) ** b
            case 1:
                return Fraction(a, b)
            case _:
                if a not in self._known:
                    self._known[a] = self._text(a, b)
                return self._known[a]

    @cached_property
    def doubles(self) -> Floats:
        from stltool.kernels import drn as kernels

        found = np.empty(len(self.kind))
        if kernels.doubles(self.kind, self.above, self.below, found):
            for k in np.flatnonzero(np.isnan(found)).tolist():
                found[k] = _double(self.at(k))
        return found

    @property
    def shares(self) -> Shares:
        """Exactly; over one denominator when that is needed, if all are decimals."""
        decimal = (self.kind == 0).all() and (self.below <= 0).all() and (self.below >= -_MOST_PLACES).all()
        return Written(self.above, (-self.below).astype(np.int8), []) if decimal else self.exact

    @cached_property
    def exact(self) -> Shares:
        """Over one denominator."""
        plain, below = self.kind == 0, self.below
        places = -int(below[plain].min(initial=0)) if plain.any() else 0
        if 0 <= places <= 18 and int(below[plain].max(initial=0)) <= 18 and not (self.kind == 2).any():
            denominators = np.unique(below[~plain])
            one = 10**places
            for denominator in denominators.tolist():
                one = math.lcm(one, denominator)
                if one >= LARGEST_SUM:
                    break
            if one < LARGEST_SUM and (found := self._over(one)) is not None:
                return Shares(found, one)
        key, which = np.unique(
            np.stack([self.kind.astype(np.int64), self.above, self.below]), axis=1, return_inverse=True
        )
        first = np.full(key.shape[1], len(self), dtype=np.int64)
        np.minimum.at(first, which.ravel(), np.arange(len(self)))
        shares, denominator = over_one(self.at(k) for k in first.tolist())
        return Shares(shares[which.ravel()], denominator)

    def _over(self, one: int) -> Integers | None:
        """Integers over that denominator, if they are small."""
        plain = self.kind == 0
        factor = np.empty(len(self), dtype=np.int64)
        powers = np.clip(self.below[plain], -18, 18)
        for power in np.unique(powers).tolist():
            scaled = Fraction(one) * Fraction(10) ** power
            if scaled.denominator != 1 or scaled >= LARGEST_SUM:
                return None
            factor[np.flatnonzero(plain)[powers == power]] = int(scaled)
        factor[~plain] = one // self.below[~plain]
        with np.errstate(over="ignore"):
            large = np.abs(self.above.astype(np.float64)) * factor
        return None if large.max(initial=0) >= LARGEST_SUM else self.above * factor


def _double(value: Fraction) -> float:
    try:
        return float(value)
    except OverflowError:
        return np.inf if value > 0 else -np.inf


# --------------------------------------------------------------------------------------------------------------- model


@dataclass
class Lines:
    """What the lines of a model are: see `read_lines` in kernels/drn.py."""

    n_states: int
    n_choices: int
    n_entries: int
    choice_start: I64
    row_start: I64
    state_at: I64
    state_rest: I64
    comment: I64
    named: I64
    choice_at: I64
    action: I64
    target: I64
    entry_at: I64
    ends: list[Numbers]
    state_rewards: list[Numbers]
    choice_rewards: list[Numbers]


class Reader:
    """Reads one file; every fault has its line."""

    def __init__(
        self, path: Path, data: Data, variables: Sequence[str] | None = None, left_out: Collection[str] = ()
    ) -> None:
        self.path, self.data, self.known, self.left_out = path, data, variables, left_out
        self.bytes = np.frombuffer(data, dtype=np.uint8)
        self.bytes.setflags(write=False)  # as those of a mapped file are: kernels are compiled for one of the two
        self._lines: Lines | None = None

    # ----------------------------------------------------------------------------------------------- lines and faults

    def line(self, at: int) -> tuple[str | None, int, int]:
        """The line that begins at a byte, decoded, that byte, and where the next one begins; None at the end."""
        if at >= len(self.data):
            return None, at, at
        end = self.data.find(b"\n", at)
        end = len(self.data) if end < 0 else end
        return self.text(at, end).rstrip("\r"), at, end + 1

    def text(self, begin: int, end: int) -> str:
        try:
            return bytes(self.data[begin:end]).decode("utf-8-sig" if begin == 0 else "utf-8")
        except UnicodeDecodeError:
            self.refuse(begin, "it is not UTF-8 text; save the file as UTF-8", quoted=False)

    def number_of(self, at: int) -> int:
        """The number of the line that a byte is in."""
        return 1 + int((self.bytes[:at] == ord("\n")).sum())

    def fault(self, at: int, fault: str, quoted: bool = True) -> str:
        shown = ""
        if quoted:
            begin = self.data.rfind(b"\n", 0, at) + 1
            end = self.data.find(b"\n", at)
            line = bytes(self.data[begin : end if end >= 0 else len(self.data)]).decode("utf-8", "replace").strip()
            shown = f"{line if len(line) <= _SHOWN else line[: _SHOWN - 3] + '…'!r}: "
        return f"{self.path}, line {self.number_of(at)}: {shown}{fault}"

    def refuse(self, at: int, fault: str, quoted: bool = True) -> NoReturn:
        raise ModelError(self.fault(at, fault, quoted))

    def place(self, choice: int) -> str:
        """A choice in messages."""
        assert self._lines is not None
        lines = self._lines
        s = int(np.searchsorted(lines.choice_start, choice, side="right")) - 1
        return (
            f"line {self.number_of(int(lines.choice_at[choice]))}: state {s}, choice {choice - lines.choice_start[s]}"
        )

    # -------------------------------------------------------------------------------------------------------- content

    def lines(self, header: Header, text: Callable[[int, int], Fraction]) -> Lines:
        """All lines of the model, in arrays, with the counts that the header declares. `text` reads other numbers."""
        from stltool.kernels import drn as kernels

        start, stop = header.start, len(self.data)
        n_states, n_choices, n_entries, n_rewards, intervals, bad = kernels.count_lines(self.bytes, start, stop)
        if bad >= 0:
            self.refuse(bad, _REMEDIES[1])
        declared = (("states", header.n_states, n_states), ("choices", header.n_choices, n_choices))
        for what, said, n in declared:
            if said is not None and said != n:
                fault = f"{n} {what}, but @nr_{what} announces {said}; is the file cut off?"
                raise ModelError(f"{self.path}: {fault}")
        if not n_states:
            raise ModelError(f"{self.path}: the model has no states")
        require_numbered(max(n_states, n_choices), f"states or choices of {self.path}", "use a part of the model")
        two = 2 if intervals else 1
        bytes_needed = (24 + 34 * two) * n_entries + (48 + 26 * n_rewards) * (n_states + n_choices)
        require_memory(2.0 * bytes_needed, f"{self.path}: {n_entries} transitions", "use a part of the model")

        def columns(n: int, of: int) -> tuple[I8, I64, I64, I64]:
            kind = np.zeros((of, n), dtype=np.int8)
            return kind, *(np.zeros((of, n), dtype=np.int64) for _ in range(3))  # type: ignore[return-value]

        def spans(n: int) -> I64:
            return np.zeros((n, 2), dtype=np.int64)

        kind, above, below, _ = columns(n_entries, two)
        of_states, of_choices = columns(n_states, n_rewards), columns(n_choices, n_rewards)
        choice_start, row_start = np.zeros(n_states + 1, np.int64), np.zeros(n_choices + 1, np.int64)
        state_at, choice_at, entry_at = (np.zeros(n, dtype=np.int64) for n in (n_states, n_choices, n_entries))
        state_rest, comment, named, action = spans(n_states), spans(n_states), spans(n_states), spans(n_choices)
        target = np.zeros(n_entries, dtype=np.int64)
        code, at = kernels.read_lines(
            self.bytes, start, stop, choice_start, row_start, state_at, state_rest, comment, named, choice_at, action,
            target, entry_at, kind, above, below, of_states, of_choices,
        )  # fmt: skip
        if code != kernels.DONE:
            self.refuse(at, _REMEDIES[code])
        found = Lines(
            n_states, n_choices, n_entries, choice_start, row_start, state_at, state_rest, comment, named, choice_at,
            action, target, entry_at, [Numbers(kind[e], above[e], below[e], text) for e in range(two)],
            *([Numbers(k[r], a[r], b[r], text) for r in range(n_rewards)] for k, a, b, _ in (of_states, of_choices)),
        )  # fmt: skip
        self._lines = found
        return found

    def given(self, header: Header, normalize: bool) -> Given:
        lines = self.lines(header, self._number(header))
        self.require_rows(header, lines)
        given = self.described(header, lines, self._probabilities(lines, normalize))
        given.doubles = lines.ends[0].doubles if len(lines.ends) == 1 else None
        return given

    def described(self, header: Header, lines: Lines, probability: Floats | Shares | Intervals) -> Given:
        """The model with these probabilities."""
        labels = self._labels(lines)
        for name in header.labels:
            labels.setdefault(name, np.zeros(lines.n_states, dtype=np.bool_))
        signals, names, notes = self._variables(lines)
        words, action = self._actions(header, lines)
        return Given(
            lines.choice_start,
            lines.row_start,
            lines.target.astype(np.int32),
            probability,
            action,
            words,
            labels.get(INIT, np.zeros(lines.n_states, dtype=np.bool_)),
            labels,
            signals,
            self._names(lines) or names,
            self._rewards(header, lines),
            notes,
        )

    def _number(self, header: Header) -> Callable[[int, int], Fraction]:
        known: dict[str, Fraction] = {}

        def meaning(begin: int, end: int) -> Fraction:
            text = self.text(begin, end).strip()
            if text in header.placeholders:
                if text not in known:
                    try:
                        known[text] = read(header.placeholders[text])
                    except NumberError as error:
                        self.refuse(begin, f"{text} stands for {header.placeholders[text]}: {error}")
                return known[text]
            try:
                return read(text)
            except NumberError as error:
                self.refuse(begin, f"{error}; write a decimal, or a fraction such as 2/5")

        return meaning

    # ---------------------------------------------------------------------------------------------------------- checks

    def require_rows(self, header: Header, lines: Lines) -> None:
        """ModelError unless every state has choices, every choice entries, and these are states, each once."""
        wrong = np.flatnonzero(lines.target >= lines.n_states)
        if wrong.size:
            self.refuse(int(lines.entry_at[wrong[0]]), f"states are 0 … {lines.n_states - 1}")
        if header.kind == _CHAIN:
            many = np.flatnonzero(np.diff(lines.choice_start) > 1)
            if many.size:
                at = int(lines.choice_at[lines.choice_start[many[0]] + 1])
                self.refuse(at, f"state {many[0]} has a second action, but the model is a chain (DTMC)")
        empty = np.flatnonzero(np.diff(lines.row_start) == 0)
        if empty.size:
            self.refuse(int(lines.choice_at[empty[0]]), "this action leads nowhere; its probabilities must sum to 1")
        row = np.repeat(np.arange(lines.n_choices), np.diff(lines.row_start))
        key = (row << 32) | lines.target
        if (key[1:] > key[:-1]).all():
            return
        order = np.argsort(key, kind="stable")
        twice = order[1:][key[order][1:] == key[order][:-1]]
        if twice.size:
            fault = "this successor of the action appears twice; add the two probabilities"
            self.refuse(int(lines.entry_at[twice.min()]), fault)

    def _probabilities(self, lines: Lines, normalize: bool) -> Shares | Intervals:
        lower, upper = lines.ends[0], lines.ends[-1]
        low, high = lower.doubles, upper.doubles
        faults: list[str] = []
        wrong = np.flatnonzero(~((low >= 0) & (low <= high) & (high <= 1)))
        for k in wrong[:MOST_FAULTS].tolist():
            what = "a probability" if lower is upper else "an interval of probabilities"
            faults.append(self.fault(int(lines.entry_at[k]), f"this is not {what}"))
        n_faults, bad = len(wrong), np.zeros(lines.n_choices, dtype=np.bool_)
        if len(wrong):
            bad[np.searchsorted(lines.row_start, wrong, side="right") - 1] = True
        sums = [np.add.reduceat(ends, lines.row_start[:-1]) for ends in ((low,) if lower is upper else (low, high))]
        most = float(MOST_MISSING) if normalize else _TOLERANCE
        if lower is upper:
            off = np.abs(sums[0] - 1) > most
        else:
            off = (sums[0] - 1 > _TOLERANCE) | (1 - sums[1] > _TOLERANCE)
        for c in np.flatnonzero(off & ~bad).tolist():
            n_faults += 1
            if len(faults) < MOST_FAULTS:
                faults.append(f"{self.path}, {self.place(c)}: {_sum_fault([float(one[c]) for one in sums])}")
        if faults:
            raise ModelError(all_told(faults, n_faults))
        return lower.shares if lower is upper else Intervals(low, high, (lower.shares, upper.shares))

    # ----------------------------------------------------------------------------------------------------------- names

    def _interned(self, where: I64) -> tuple[list[str], I64]:
        """The distinct texts at these places, and which one each is."""
        from stltool.kernels import drn as kernels

        table = np.full(1 << max(2 * len(where), 1).bit_length(), -1, dtype=np.int64)
        number = np.empty(len(where), dtype=np.int64)
        kernels.intern(self.bytes, where, table, number)
        first, which = np.unique(number, return_inverse=True)
        return [self.text(int(where[k, 0]), int(where[k, 1])) for k in first.tolist()], which

    def _actions(self, header: Header, lines: Lines) -> tuple[list[str], I64]:
        texts, which = self._interned(lines.action)
        there = dict.fromkeys(text for text in texts if text and text != NO_LABEL)
        words = list(dict.fromkeys([*(name for name in header.actions if name in there), *there]))
        number = {word: k for k, word in enumerate(words)}
        return words, np.array([number.get(text, -1) for text in texts], dtype=np.int64)[which]

    def _labels(self, lines: Lines) -> dict[str, NDArray[np.bool_]]:
        texts, which = self._interned(lines.state_rest)
        order = np.argsort(which, kind="stable")
        begin = np.searchsorted(which[order], np.arange(len(texts) + 1)).tolist()
        marked: dict[str, list[I64]] = {}
        for k, text in enumerate(texts):
            states = order[begin[k] : begin[k + 1]]
            if text.count('"') % 2:
                self.refuse(int(lines.state_at[states[0]]), "a quotation mark of a label is not closed")
            for quoted, plain in _LABELS.findall(text):
                marked.setdefault(quoted or plain, []).append(states)
        n = lines.n_states
        require_memory(float(n) * len(marked), f"{self.path}: {len(marked)} labels of {n} states", "use fewer labels")
        found = {name: np.zeros(n, dtype=np.bool_) for name in marked}
        for name, parts in marked.items():
            for states in parts:
                found[name][states] = True
        return found

    def _rewards(self, header: Header, lines: Lines) -> dict[str, dict[str, Amounts]]:
        found: dict[str, dict[str, Amounts]] = {}
        n = max(len(lines.state_rewards), len(header.rewards))
        for r in range(n):
            name = header.rewards[r] if r < len(header.rewards) else ""
            name = name or ("default" if r < len(header.rewards) or not header.rewards else f"rew{r}")
            if name in found:
                raise ModelError(f"{self.path}: two reward models have the name {name}; rename one")
            found[name] = {}
            for part, columns in (("states", lines.state_rewards), ("choices", lines.choice_rewards)):
                if r < len(columns) and (columns[r].above.any() or (columns[r].kind == 2).any()):
                    found[name][part] = Amounts(columns[r].doubles, columns[r].shares)
            if not found[name]:
                found[name]["states"] = Amounts(np.zeros(lines.n_states), Shares(np.zeros(lines.n_states, np.int64), 1))
        return found

    def _variables(self, lines: Lines) -> tuple[dict[str, Floats], Sequence[str] | None, dict[str, str]]:
        """Signals from Storm's comments, names of states, and what is to be noted."""
        from stltool.kernels import drn as kernels

        if not lines.comment[:, 1].all() or self.known == []:
            return {}, None, {}
        n = bytes(self.data[lines.comment[0, 0] : lines.comment[0, 1]]).count(b"&") + 1
        require_memory(8.0 * n * lines.n_states, f"{self.path}: {n} variables", "use a part of the model")
        where, truths = np.zeros((n, 2), dtype=np.int64), np.zeros(n, dtype=np.int8)
        values = np.zeros((n, lines.n_states))
        unlike = kernels.read_variables(self.bytes, lines.comment, where, truths, values)
        if unlike >= 0:
            line = self.number_of(int(lines.comment[unlike, 0]))
            return {}, None, {"signal": f"the comment in line {line} is not one of variables; the model has no signals"}
        texts = [self.text(int(a), int(b)) for a, b in where.tolist()]
        unnamed = [name for name in self.known or () if name not in texts]
        if texts.count("") == len(unnamed):  # they are true everywhere, so any order will do
            texts = [text or unnamed.pop() for text in texts]
        signals = {text: values[k] for k, text in enumerate(texts) if text}
        if len(signals) < sum(map(bool, texts)):
            return {}, None, {"signal": "two variables have one name; the model has no signals"}
        notes = {}
        if len(signals) < n:
            notes["signal"] = (
                f"{n - len(signals)} Boolean variables are true in every state; Storm does not write the names of such"
            )
        signals = {name: signal for name, signal in signals.items() if name not in self.left_out}
        names = Valuation(signals, list(signals), {text for text, truth in zip(texts, truths, strict=True) if truth})
        return signals, StateNames(lines.n_states, names), notes

    def _names(self, lines: Lines) -> list[str] | None:
        """The names of states, if we wrote them."""
        if not lines.named[:, 1].all():
            return None
        found = []
        for begin, end in lines.named.tolist():
            try:
                name = json.loads(self.text(begin, end))
            except ValueError:
                return None
            if not isinstance(name, str):
                return None
            found.append(name)
        return found


def _sum_fault(sums: list[float]) -> str:
    lower, upper = sums[0], sums[-1]
    if len(sums) == 2:
        if lower > 1:
            return f"the lower ends sum to {lower:.12g}, more than 1; lower one of them"
        return f"the upper ends sum to {upper:.12g}, less than 1; raise one of them"
    hint = f"; {HINT}" if abs(lower - 1) <= MOST_MISSING else ""
    return f"the probabilities sum to {lower:.12g}, not 1{hint}"
