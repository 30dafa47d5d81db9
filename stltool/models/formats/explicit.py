"""PRISM's explicit files, and Storm's: transitions `.tra`, with files of the same name next to it if they exist.

    NAME.tra    "n_states n_choices n_transitions", then "state choice successor probability [action]"      (MDP)
                "n_states n_transitions",           then "state successor probability [action]"             (DTMC)
                Storm: "mdp" or "dtmc", then the same lines; rows: "state probability:successor … [action]"
    NAME.lab    0="init" 1="deadlock" 2="done", then "state: number number …"
                Storm: "#DECLARATION", the labels' names, "#END", then "state name name …"
    NAME.sta    (x,y,b), then "state:(0,1,true)"
    NAME.srew   "n_states n_lines", then "state number"                          (NAME1.srew, NAME2.srew for several)
    NAME.trew   as .tra, with numbers instead of probabilities; Storm's files have no first line

Each may be gzipped (.gz). Lines that begin with # are comments; PRISM's name the kind of model, and reward structures.
Probabilities are decimals or fractions such as 2/5, kept exactly, or intervals of them such as [0.6,0.9]. Labels become
labels, the variables of `.sta` signals (false 0, true 1), reward structures costs; `init` marks the initial states,
state 0 without a `.lab`. States without transitions stay where they are, as in PRISM, unless they are refused.
"""

from __future__ import annotations

import glob
import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.display import StateNames, distinct
from stltool.errors import MOST_FAULTS, ModelError, marked
from stltool.models.costs import Amounts, Cost
from stltool.models.costs import Entries as CostEntries
from stltool.models.formats.lines import (
    LARGE,
    Cursor,
    Entries,
    File,
    FileFaults,
    Form,
    Written,
    cut,
    read_entries,
    words_of,
)
from stltool.models.fractions import Shares, doubles_of
from stltool.models.intervals import Intervals
from stltool.models.loading import Loading
from stltool.models.mdp import MDP
from stltool.models.normalize import HINT, MOST_MISSING, NOTHING, rescale
from stltool.models.rows import Stored, starts
from stltool.numbers import NumberError, double, index
from stltool.sizes import require_memory, require_numbered

I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]
Floats: TypeAlias = NDArray[np.float64]

_BYTES = 64  # for each transition and state, at the peak
_TOLERANCE = 1e-9  # how far the sum of a row of doubles may be from 1
_UNLIMITED = 2**31 - 2
_MOST_LABELS = 1 << 16  # numbers of labels that the kernel looks up
_STORM_LINE = 10  # bytes of a transition in Storm's files, roughly the shortest
_NAMED = 4  # states that a note names
_TRUTH = {"true": 1.0, "false": 0.0}
_LABEL = re.compile(r'(\d{1,9})="([^"]*)"', re.ASCII)
_KIND = re.compile(r"#\s*Transitions\s*\((\w+)\)")
_REWARD = re.compile(r'#\s*Reward structure\s*(?:"([^"]*)")?\s*$')
_IDENTIFIER = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_CHAINS, _DECISIONS = ("DTMC", "IDTMC"), ("MDP", "IMDP")
_NUMBER = "a decimal or a fraction such as 2/5"
_RATES = "its numbers are rates, not probabilities; write its embedded or uniformised chain"
_REFUSED = {
    "CTMC": _RATES,
    "CTMDP": _RATES,
    "MA": _RATES,
    "POMDP": "its states are observed in part, and policies here see them; write the MDP of its states",
    "IPOMDP": "its states are observed in part, and policies here see them; write the MDP of its states",
    "LTS": "its transitions have no probabilities; write an MDP, with probability 1 for each",
    "PTA": "it has clocks; write the MDP of its digital clocks",
    "SMG": "it has several players; write the MDP of one player against fixed others",
}


def load_explicit(path: str | Path, loading: Loading = Loading()) -> MDP:  # noqa: B008 - it is frozen
    """Read `path` (.tra or .tra.gz) and the files of the same name.

    Raises FileError, SizeError before taking more memory than there is, and ModelError with all faults in the files,
    with their lines.
    """
    path = Path(path)
    faults = FileFaults()
    read = _transitions(path, faults)
    if read is None:
        raise faults.error()
    if read.entries.garbled:
        table = None
    else:
        table = _Table.of(read)
    _tell(read, faults)
    if table is not None and not read.entries.garbled:
        table.require_choices(faults)
    before = faults.count
    labels, lab = _labels(path, read.n_states, loading.marked, faults)
    lab_told = faults.count > before
    names, signals = _variables(path, read.n_states, faults)
    both = sorted(set(signals) & set(labels))
    if both:
        faults.add(f"{lab}: the label {both[0]} is also a variable in the .sta file; rename it")
    first = None
    if not lab_told:
        beginning = labels.get("init", np.arange(read.n_states) == 0)
        try:
            first = loading.starts(beginning, names)
        except ModelError as error:
            faults.add(f"{lab if lab is not None else path}: {marked(error)}")
    costs = _costs(path, read, table, faults)
    if table is not None and not read.entries.garbled:
        table.require_distributions(loading, faults)
    if faults.count or table is None or first is None:
        raise faults.error()
    notes = _missing_files(path)
    if table.looped:
        shown = ", ".join(names[s] if names is not None else str(s) for s in table.looped[:_NAMED])
        more = f", and {len(table.looped) - _NAMED} more" if len(table.looped) > _NAMED else ""
        notes["deadlocks"] = f"states without transitions stay where they are, as in PRISM: {shown}{more}"
    try:
        return MDP(
            table.rows(loading, notes),
            initial=first / first.sum(),
            signals=signals,
            labels=labels,
            action_names=table.action_names,
            state_names=names,
            name=_stem(path).name,
            exact_initial=Shares(first, int(first.sum())),
            notes=notes,
            costs=costs,
        )
    except ModelError as error:
        raise ModelError(f"{path}: {marked(error)}") from None


# --------------------------------------------------------------------------------------------------------------- files


def _stem(path: Path) -> Path:
    """The path without .tra or .tra.gz."""
    return path.with_suffix("").with_suffix("") if path.suffix.lower() == ".gz" else path.with_suffix("")


def _with(stem: Path, ending: str) -> Path | None:
    """The file of that name with the ending, plain or packed, if there is one."""
    for name in (stem.name + ending, stem.name + ending + ".gz"):
        if (found := stem.with_name(name)).exists():
            return found
    return None


def companions(path: Path) -> list[Path]:
    """The files next to `path` that are read with it."""
    stem = _stem(path)
    beside = [found for ending in (".lab", ".sta") if (found := _with(stem, ending)) is not None]
    return [*beside, *(file for _, files in _reward_files(path) for file in files.values())]


def _reward_files(path: Path) -> list[tuple[str, dict[str, Path]]]:
    """The reward structures next to a model: the number of each in the names ("" for one), and its files by ending."""
    stem = _stem(path)
    form = re.compile(re.escape(stem.name) + r"(\d*)(\.[st]rew)(?:\.gz)?", re.ASCII)
    found: dict[str, dict[str, Path]] = {}
    try:
        near = sorted(path.parent.glob(glob.escape(stem.name) + "*rew*"))
    except (OSError, ValueError):
        near = []
    for file in near:
        fits = form.fullmatch(file.name)
        if fits is None or (fits[1] and _with(stem.with_name(stem.name + fits[1]), ".tra") is not None):
            continue  # NAME1.srew belongs to NAME1.tra, if there is one
        found.setdefault(fits[1], {}).setdefault(fits[2], file)
    return sorted(found.items(), key=lambda one: int(one[0] or 0))


def _missing_files(path: Path) -> dict[str, str]:
    """The model's notes about missing label or state files."""
    stem = _stem(path)
    without = {
        "label": (".lab", "the model has no labels, and runs start in state 0"),
        "signal": (".sta", "the model has no signals, and its states have only numbers"),
    }
    return {
        kind: f"there is no {stem.name}{ending} next to {path.name}: {so}"
        for kind, (ending, so) in without.items()
        if _with(stem, ending) is None
    }


# --------------------------------------------------------------------------------------------------------- transitions


@dataclass(frozen=True)
class _Read:
    """The transition file: its entries, and what its first line announces (Storm's announces nothing)."""

    path: Path
    entries: Entries
    n_states: int
    chain: bool
    storm: bool
    n_choices: int | None
    n_transitions: int | None


def _transitions(path: Path, faults: FileFaults) -> _Read | None:
    """None if the first line does not tell the number of states."""
    cursor = Cursor(File(path, "transition file"))
    number, header = cursor.take() or (1, "")
    kind = _kind(path, cursor, number, header)
    if header.lower() in ("mdp", "dtmc"):
        return _storm(path, cursor, header.lower() == "dtmc", faults)
    try:
        counts = [index(word) for word in words_of(header)]
    except NumberError:
        counts = []
    if len(counts) == 4:
        _refuse(path, number, "POMDP")
    if len(counts) not in (2, 3) or not counts[0]:
        told = 'write "states choices transitions", as PRISM exports it; in Storm\'s files it is "mdp" or "dtmc"'
        faults.line(path, number, header, told)
        return None
    n_states, n_transitions, chain = counts[0], counts[-1], len(counts) == 2
    if kind is not None and chain != (kind in _CHAINS):
        wanted = "states transitions" if kind in _CHAINS else "states choices transitions"
        faults.line(path, number, header, f'this {kind} begins with "{wanted}"')
        return None
    require_memory(
        _BYTES * max(n_transitions, n_states),
        f"{path}: reading {n_transitions} transitions of {n_states} states",
        "check the file's first line",
    )
    require_numbered(n_states, "states", "use a part of the model")
    form = _form(cursor, n_states, chain, named="probability", worded=True, ranged=True)
    entries = read_entries(cursor, form, n_transitions)
    return _Read(path, entries, n_states, chain, False, None if chain else counts[1], n_transitions)


def _kind(path: Path, cursor: Cursor, number: int, header: str) -> str | None:
    """The kind of model, if comments name it. ModelError for kinds that are not read."""
    line = cursor.peek()
    for at, comment in cursor.comments:
        if found := _KIND.match(comment):
            kind = found[1].upper()
            if kind not in (*_CHAINS, *_DECISIONS):
                _refuse(path, at, kind)
            return kind
    if header.upper() in _REFUSED:
        _refuse(path, number, header.upper())
    words = words_of(line) if line is not None else []
    if (
        len(words_of(header)) == 3
        and ":" not in "".join(words)
        and (
            (len(words) == 3 and all(map(str.isdigit, words))) or (len(words) == 4 and _IDENTIFIER.fullmatch(words[3]))
        )
    ):
        _refuse(path, cursor.line, "LTS")
    return None


def _refuse(path: Path, line: int, kind: str) -> None:
    why = _REFUSED.get(kind, "stltool reads DTMC, MDP, IDTMC and IMDP")
    raise ModelError(f"{path}, line {line}: this is a {kind}: {why}")


def _form(
    cursor: Cursor, n_states: int, chain: bool, *, named: str, worded: bool = False, ranged: bool = False
) -> Form:
    """The form of lines with transitions, of which the next one is an example."""
    words = words_of(cursor.peek() or "0 0")
    number = f"{_NUMBER}, or [0.6,0.9]" if ranged else _NUMBER
    if len(words) == 1 or (":" in words[1] and not words[1].startswith("(")):
        action = " [action]" if worded else ""
        shown = f"state {named}:successor {named}:successor …{action}"
        return Form((n_states,), shown, number, worded, ranged, by_row=True)
    if chain:
        return Form((n_states, n_states), f"state successor {named}", number, worded, ranged)
    shown = f"state choice successor {named}" + (" [action]" if worded else "")
    return Form((n_states, _UNLIMITED, n_states), shown, number, worded, ranged)


def _storm(path: Path, cursor: Cursor, chain: bool, faults: FileFaults) -> _Read | None:
    form = _form(cursor, _UNLIMITED, chain, named="probability", worded=True)
    if form.by_row:
        number, text = cursor.take() or (cursor.line, "")
        faults.line(path, number, text, f'write "state {"" if chain else "choice "}successor probability [action]"')
        return None
    entries = read_entries(cursor, form, cursor.file.size // _STORM_LINE)
    n_states = 1 + max(int(entries.lead[0].max(initial=-1)), int(entries.last.max(initial=-1)))
    if not len(entries) and not entries.n_faults:
        faults.add(f"{path}: there are no transitions")
        return None
    require_memory(_BYTES * n_states, f"{path}: a model of {n_states} states", "number states from 0 without gaps")
    return _Read(path, entries, n_states, chain, True, None, None)


def _tell(read: _Read, faults: FileFaults) -> None:
    """Add the faults of lines, in their order, and of what the first line announces."""
    entries, path = read.entries, read.path
    for number, line, remedy in sorted(entries.faults):
        faults.line(path, number, line, remedy)
    faults.count += entries.n_faults - len(entries.faults)
    found = len(entries) + len(entries.skipped)
    if read.n_transitions is not None and found != read.n_transitions and not (entries.form.by_row and entries.skipped):
        cut_off = "; is the file cut off?" if found < read.n_transitions else "; correct it"
        faults.add(f"{path}: {found} transitions, but the first line announces {read.n_transitions}{cut_off}")
        entries.garbled = True


@dataclass
class _Table:
    """The model's rows: states in order, their choices by number, the successors of each in order.

    state, number (n_choices,)         row_start (n_choices + 1,)      target, value, exact (n,), upper (n,) or None
    word, words                        the action of each choice, −1 for none
    origin        (n,) the entry of the file, −1 for a loop that was added
    looped        states without transitions
    """

    read: _Read
    state: I32
    number: I32
    row_start: I64
    target: I32
    value: Floats
    upper: Floats | None
    exact: Written
    word: I32
    words: list[str]
    origin: I64 | None
    looped: list[int]

    @classmethod
    def of(cls, read: _Read) -> _Table:
        """The rows; faults that concern several entries are added to those of lines."""
        entries = read.entries
        state, target = entries.lead[0], entries.last
        number = entries.lead[1] if len(entries.lead) == 2 else np.zeros(len(state), dtype=np.int32)
        value, upper, exact, word = entries.value, entries.upper, entries.exact, entries.word
        origin: I64 | None = None
        new, rising = _steps(state, number, target)
        if not rising.all():
            origin = np.lexsort((target, number, state))
            state, number, target = state[origin], number[origin], target[origin]
            value, exact, word = value[origin], exact.at(origin), word[origin]
            upper = upper[origin] if upper is not None else None
            new, rising = _steps(state, number, target)
        table = cls(
            read,
            state,
            number,
            np.empty(0, dtype=np.int64),
            target,
            value,
            upper,
            exact,
            word,
            entries.words,
            origin,
            [],
        )
        if not rising.all() and read.chain and entries.words and upper is None:
            new, rising = table._merge(rising)
        table._compare(new, rising)
        table._add_loops(new)
        entries.lead, entries.word = np.empty((0, 0), dtype=np.int32), np.empty(0, dtype=np.int32)  # to save memory
        return table

    def _entry(self, k: int) -> int:
        """Where in the file's entries entry k comes from."""
        return k if self.origin is None else int(self.origin[k])

    def _merge(self, rising: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Add up a chain's transitions to one successor by several actions, which PRISM writes in a line each."""
        again = ~rising
        again[1:] &= self.word[1:] != self.word[:-1]
        first = np.flatnonzero(~again)
        sums = np.add.reduceat(self.exact.numerator, first)
        unique, which = np.unique(sums, return_inverse=True)
        texts = [Fraction(int(n), self.exact.denominator) for n in unique]
        self.exact = Written(which.astype(np.int64), np.full(len(sums), -1, dtype=np.int8), texts)
        self.value = np.array([float(text) for text in texts])[which]
        several = np.add.reduceat(again, first) > 0
        origin = self.origin if self.origin is not None else np.arange(len(self.state))
        self.state, self.number, self.target = self.state[first], self.number[first], self.target[first]
        self.word, self.origin = np.where(several, -1, self.word[first]), origin[first]
        return _steps(self.state, self.number, self.target)

    def _compare(self, new: NDArray[np.bool_], rising: NDArray[np.bool_]) -> None:
        """Tell values that are not probabilities, successors that repeat, and choices with two actions."""
        wrong: list[tuple[int, str | int]] = []  # entry; the remedy, or the entry whose action it lacks
        top = self.upper if self.upper is not None else self.value
        bad = ~((self.value >= 0) & (self.value <= top) & (top <= 1))
        if bad.any():
            wrong += [(k, "") for k in np.flatnonzero(bad).tolist()]
        if not rising.all():
            wrong += [
                (k, "this successor of the choice appears twice; add the two probabilities")
                for k in np.flatnonzero(~rising).tolist()
            ]
        if not self.read.chain and (~new[1:] & (self.word[1:] != self.word[:-1])).any():
            begin = np.flatnonzero(new)
            first = begin[np.cumsum(new) - 1]
            other = np.flatnonzero((self.word >= 0) & (self.word != self.word[first]))
            wrong += [(k, int(first[k])) for k in other.tolist()]
        if not wrong:
            return
        entries = self.read.entries
        wrong.sort(key=lambda one: self._entry(one[0]))
        told = [*(k for k, _ in wrong[:MOST_FAULTS]), *(to for _, to in wrong[:MOST_FAULTS] if isinstance(to, int))]
        lines = entries.lines_of(map(self._entry, told))
        for position, (k, remedy) in enumerate(wrong):
            place = (int(self.state[k]), int(self.number[k]))
            entries.faulty.add(place if not self.read.chain else place[:1])
            entries.n_faults += 1
            if position >= MOST_FAULTS:
                continue
            at, text = lines[self._entry(k)]
            if remedy == "":
                words = words_of(text)
                shown = words[len(entries.form.limits)] if not entries.form.by_row else f"{self.value[k]:.12g}"
                remedy = f"{cut(shown)} is not a probability"
                if self.value[k] > 1 and self.read.chain:
                    remedy += "; rates, those of a CTMC, are not read"
            elif isinstance(remedy, int):
                before = lines[self._entry(remedy)][0]
                known = self.word[remedy]
                remedy = f"this choice has the action {self.words[known] if known >= 0 else '(none)'} in line {before}"
            entries.faults.append((at, cut(text), remedy))

    def _add_loops(self, new: NDArray[np.bool_]) -> None:
        """Give states without transitions one that stays, and find where rows begin."""
        there = np.zeros(self.read.n_states, dtype=np.bool_)
        begin = np.flatnonzero(new)
        there[self.state[begin]] = True
        for place in self.read.entries.faulty:
            if place[0] < len(there):
                there[place[0]] = True
        if not there.all():
            missing = np.flatnonzero(~there)
            at = np.searchsorted(self.state, missing)
            self.looped = missing.tolist()
            origin = self.origin if self.origin is not None else np.arange(len(self.state))
            self.state, self.target = np.insert(self.state, at, missing), np.insert(self.target, at, missing)
            self.number, self.value = np.insert(self.number, at, 0), np.insert(self.value, at, 1.0)
            self.upper = np.insert(self.upper, at, 1.0) if self.upper is not None else None
            self.exact = Written(np.insert(self.exact.w, at, 1), np.insert(self.exact.places, at, 0), self.exact.texts)
            self.word, self.origin = np.insert(self.word, at, -1), np.insert(origin, at, -1)
            begin = np.flatnonzero(np.insert(new, at, True))
        self.row_start = np.append(begin, len(self.state))
        self.state, self.number, self.word = self.state[begin], self.number[begin], self._row_words(begin)

    def _row_words(self, begin: I64) -> I32:
        """The word of each row; those of a chain that differ within a row say nothing of its one choice."""
        found = self.word[begin]
        if self.words and self.read.chain:
            found = np.minimum.reduceat(self.word, begin) if len(begin) else found
            found[found != (np.maximum.reduceat(self.word, begin) if len(begin) else found)] = -1
        return found

    def _named(self, c: int) -> str:
        """A choice as messages name it."""
        return f"state {self.state[c]}, choice {self.number[c]}"

    def _first(self, c: int) -> int:
        """The first entry of a choice in the file; −1 if it was added."""
        return min(map(self._entry, range(int(self.row_start[c]), int(self.row_start[c + 1]))))

    def require_choices(self, faults: FileFaults) -> None:
        """Check that there are as many choices as the first line announces."""
        announced, path, entries = self.read.n_choices, self.read.path, self.read.entries
        if announced is not None:
            n_choices = len(self.state) - len(self.looped)
            if entries.faulty:
                n_choices += len(entries.faulty - set(zip(self.state.tolist(), self.number.tolist(), strict=True)))
            if n_choices != announced:
                faults.add(f"{path}: {n_choices} choices, but the first line announces {announced}; correct it")

    def require_distributions(self, loading: Loading, faults: FileFaults) -> None:
        """Check that every state has a choice and every choice a distribution, except rows with faulty lines."""
        path, entries = self.read.path, self.read.entries
        if loading.deadlocks == "error":
            for s in self.looped:
                faults.add(f"{path}: state {s} has no action; give it one that stays (probability 1 to itself)")
        if not len(self.state):
            return
        lower = np.add.reduceat(self.value, self.row_start[:-1])
        upper = np.add.reduceat(self.upper, self.row_start[:-1]) if self.upper is not None else lower
        most = float(MOST_MISSING) if loading.normalize else _TOLERANCE
        wrong: list[tuple[int, str]] = []
        for c in np.flatnonzero((lower - 1 > _TOLERANCE) | (1 - upper > _TOLERANCE)).tolist():
            place = (int(self.state[c]), int(self.number[c]))
            said = _sum_fault(float(lower[c]), float(upper[c]), most)
            if said and (place[:1] if self.read.chain else place) not in entries.faulty:
                wrong.append((c, said))
        lines = entries.lines_of(self._first(c) for c, _ in wrong[:MOST_FAULTS])
        for c, said in wrong[:MOST_FAULTS]:
            faults.add(f"{path}, line {lines[self._first(c)][0]}: {self._named(c)}: {said}")
        faults.count += max(len(wrong) - MOST_FAULTS, 0)

    def rows(self, loading: Loading, notes: dict[str, str]) -> Stored:
        """The rows as a model's source, without entries that cannot happen."""
        top = self.upper if self.upper is not None else self.value
        row_start, target, value, upper, exact = self.row_start, self.target, self.value, self.upper, self.exact
        if not top.all():
            kept = top != 0
            row_start, target, value = starts(kept)[row_start], target[kept], value[kept]
            upper, exact = upper[kept] if upper is not None else None, exact.at(kept)
        choice_start = np.searchsorted(self.state, np.arange(self.read.n_states + 1)).astype(np.int64)
        shares: Shares | None = exact
        intervals = None
        if upper is not None:
            intervals, shares = Intervals(value, upper, rounded=self.read.entries.rounded), None
            value = intervals.nominal(row_start)
            if loading.normalize:
                notes["normalize"] = NOTHING.format("intervals")
        elif loading.normalize:
            found, done = rescale((exact.numerator, exact.denominator), row_start, self._named)
            shares, value, notes["normalize"] = Shares(*found), doubles_of(*found), str(done)
        return Stored(choice_start, self._actions(choice_start), row_start, target, value, shares, intervals)

    @property
    def action_names(self) -> tuple[str, ...]:
        return tuple(self._names)

    def _actions(self, choice_start: I64) -> I32:
        """The action of each choice. One without a word has its number as name; choices of a state with one word have
        names of their own: go, go#2, go#3."""
        names = list(self.words)
        action = self.word.astype(np.int64)
        without = np.flatnonzero(action < 0)
        known = {name: k for k, name in enumerate(names)}

        def named(name: str) -> int:
            if name not in known:
                known[name] = len(names)
                names.append(name)
            return known[name]

        if len(without):
            numbers, which = np.unique(self.number[without], return_inverse=True)
            action[without] = np.array([named(str(n)) for n in numbers.tolist()])[which]
        key = self.state.astype(np.int64) * len(names) + action
        if (np.diff(choice_start) > 1).any():
            order = np.argsort(key, kind="stable")
            again = order[1:][key[order[1:]] == key[order[:-1]]]
            for s in np.unique(self.state[again]).tolist():
                taken: set[str] = set()
                for c in range(int(choice_start[s]), int(choice_start[s + 1])):
                    name = names[action[c]]
                    if name in taken:
                        name = next(new for i in itertools.count(2) if (new := f"{name}#{i}") not in taken)
                    taken.add(name)
                    action[c] = named(name)
        first = np.full(len(names), len(action))
        first[action[::-1]] = np.arange(len(action))[::-1]
        used = np.argsort(first, kind="stable")[: int((first < len(action)).sum())]
        place = np.zeros(len(names), dtype=np.int32)
        place[used] = np.arange(len(used), dtype=np.int32)
        self._names = [names[k] for k in used.tolist()]
        return place[action]


def _steps(state: I32, number: I32, target: I32) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Where a row begins, and where an entry is after the one before it, in the order of a model's rows."""
    n = len(state)
    new, rising = np.ones(n, dtype=np.bool_), np.ones(n, dtype=np.bool_)
    if n > 1:
        same = state[1:] == state[:-1]
        equal = same & (number[1:] == number[:-1])
        new[1:] = ~equal
        rising[1:] = (
            (state[1:] > state[:-1]) | (same & (number[1:] > number[:-1])) | (equal & (target[1:] > target[:-1]))
        )
    return new, rising


def _sum_fault(lower: float, upper: float, most: float) -> str:
    """The fault in the sums of a row, or ""."""
    if lower != upper:
        if lower > 1:
            return f"the lower ends sum to {lower:.12g}, more than 1; lower one of them"
        return f"the upper ends sum to {upper:.12g}, less than 1; raise one of them"
    missing = abs(lower - 1)
    if missing <= most:
        return ""
    return f"the probabilities sum to {lower:.12g}, not 1" + (f"; {HINT}" if missing <= MOST_MISSING else "")


# -------------------------------------------------------------------------------------------------------------- labels


def _labels(
    path: Path, n_states: int, marks: bool, faults: FileFaults
) -> tuple[dict[str, NDArray[np.bool_]], Path | None]:
    """The labels, and their file; none without one. `marks`: whether initial states must be marked."""
    lab = _with(_stem(path), ".lab")
    if lab is None:
        return {}, None
    cursor = Cursor(File(lab, "label file"))
    number, header = cursor.take() or (1, "")
    if any(comment.startswith("#DECLARATION") for _, comment in cursor.comments):
        return _storm_labels(lab, n_states, marks, (number, header), cursor, faults), lab
    found = _LABEL.findall(header)
    names = {int(key): name for key, name in found}
    require_memory(len(names) * n_states, f"{lab}: {len(names)} labels of {n_states} states", "leave some out")
    if not names or _LABEL.sub("", header).strip():
        faults.line(lab, number, header, 'write 0="init" 1="deadlock" 2="done" …')
        return {}, lab
    if len(set(names.values())) < len(found):
        faults.line(lab, number, header, "two labels have the same name or number; make them different")
        return {}, lab
    if marks and "init" not in names.values():
        faults.line(lab, number, header, 'mark the state that runs start in: 0="init", and a line "state: 0"')
    form = f'write "state: number number …", states 0 … {n_states - 1}, numbers of the first line'
    rank = np.full(max(names) + 1 if max(names) < _MOST_LABELS else 0, -1, dtype=np.int64)
    rank[[key for key in names if key < len(rank)]] = [k for k, key in enumerate(names) if key < len(rank)]
    holds = np.zeros((len(names), n_states), dtype=np.bool_)
    place = {key: k for k, key in enumerate(names)}
    for number, text in _rest(cursor, lambda at: _kernel_labels(cursor, at, rank, holds)):
        state, colon, numbers = text.partition(":")
        try:
            s, which = index(state.strip()), [place[index(word)] for word in words_of(numbers.strip()) if word]
        except (NumberError, KeyError):
            s, which = n_states, []
        if not colon or s >= n_states:
            faults.line(lab, number, text, form)
            continue
        holds[which, s] = True
    return dict(zip(names.values(), holds, strict=True)), lab


def _kernel_labels(cursor: Cursor, at: int, rank: I64, holds: NDArray[np.bool_]) -> tuple[int, int, int]:
    from stltool.kernels.lines import labels

    return labels(cursor.bytes, at, len(cursor.block), cursor.line, rank, holds)


def _rest(cursor: Cursor, kernel: Callable[[int], tuple[int, int, int]]) -> Iterator[tuple[int, str]]:
    """The lines that a kernel leaves to Python; all of them in a small file."""
    large = cursor.file.size >= LARGE
    while True:
        if large:
            if not cursor.more():
                return
            status, cursor.at, cursor.line = kernel(cursor.at)
            if not status:
                continue
        taken = cursor.take()
        if taken is None:
            return
        yield taken


def _storm_labels(
    lab: Path, n_states: int, marks: bool, first: tuple[int, str], cursor: Cursor, faults: FileFaults
) -> dict[str, NDArray[np.bool_]]:
    """Labels as Storm writes them: the names between #DECLARATION and #END, in one line or in several."""
    names: dict[str, NDArray[np.bool_]] = {}
    line: tuple[int, str] | None = first
    cursor.peek()
    end = next((at for at, comment in cursor.comments if comment.startswith("#END")), None)
    while line is not None and line[1] and (end is None or line[0] < end):
        for name in words_of(line[1]):
            names[name] = np.zeros(n_states, dtype=np.bool_)
        line = cursor.take()
        end = end or next((at for at, comment in cursor.comments if comment.startswith("#END")), None)
        require_memory(len(names) * n_states, f"{lab}: {len(names)} labels of {n_states} states", "leave some out")
    if end is None:
        faults.add(f"{lab}: #END is missing; write it in a line of its own after the labels' names")
        return {}
    if marks and "init" not in names:
        faults.add(f'{lab}: there is no label init; declare it, and mark the state that runs start in: "0 init"')
    while line is not None and line[1]:
        number, text = line
        state, *of = words_of(text)
        try:
            s = index(state)
        except NumberError:
            s = n_states
        if s >= n_states or any(name not in names for name in of):
            faults.line(lab, number, text, f'write "state name name …", states 0 … {n_states - 1}, declared names')
        else:
            for name in of:
                names[name][s] = True
        line = cursor.take()
    return names


# ----------------------------------------------------------------------------------------------------------- variables


def _variables(path: Path, n_states: int, faults: FileFaults) -> tuple[Sequence[str] | None, dict[str, Floats]]:
    """State names and signals from a .sta file; none without one."""
    sta = _with(_stem(path), ".sta")
    if sta is None:
        return None, {}
    cursor = Cursor(File(sta, "states file"))
    number, header = cursor.take() or (1, "")
    variables = [name.strip() for name in header.strip("() ").split(",")]
    bracketed = header.startswith("(") and header.endswith(")")
    if not bracketed or not all(variables) or len(set(variables)) < len(variables):
        faults.line(sta, number, header, "write the variables' names, such as (x,y)")
        return None, {}
    needed = 8 * len(variables) * n_states
    require_memory(needed, f"{sta}: {len(variables)} variables of {n_states} states", "leave some out")
    values, seen = np.full((len(variables), n_states), np.nan), np.zeros(n_states, dtype=np.bool_)
    types = np.zeros(len(variables), dtype=np.int8)
    odd: dict[tuple[int, int], str] = {}
    form = f'write "state:({",".join(variables)})" with numbers, true or false'
    before = faults.count
    for number, line in _rest(cursor, lambda at: _kernel_values(cursor, at, seen, types, values)):
        state, _, tuple_text = line.partition(":")
        words = [word.strip() for word in tuple_text.strip("() ").split(",")]
        try:
            s = index(state.strip())
            column = [_TRUTH[word] if word in _TRUTH else double(word) for word in words]
        except NumberError as error:
            faults.line(sta, number, line, f"{error}; {form}")
            continue
        if s >= n_states or len(column) != len(variables):
            faults.line(sta, number, line, f"{form}; states are 0 … {n_states - 1}")
        elif seen[s]:
            faults.line(sta, number, line, f"state {s} appears twice")
        else:
            values[:, s], seen[s] = column, True
            for k, word in enumerate(words):
                kind = 1 if word in _TRUTH else 2
                types[k] = types[k] or kind
                if types[k] != kind or (kind == 2 and word != f"{column[k]:.0f}"):
                    odd[s, k] = word
    missing = np.flatnonzero(~seen)
    if missing.size and faults.count == before:
        more = f", and {missing.size - 1} more" if missing.size > 1 else ""
        faults.add(f"{sta}: state {missing[0]} is missing{more}")
    truths = types == 1

    def name(s: int) -> str:
        texts = (odd.get((s, k)) or _text(values[k, s], bool(truths[k])) for k in range(len(variables)))
        return ", ".join(f"{variable}={text}" for variable, text in zip(variables, texts, strict=True))

    names: Sequence[str] = StateNames(n_states, name)
    if faults.count == before and _repeat(values):
        names = distinct(tuple(names))
    return names, dict(zip(variables, values, strict=True))


def _kernel_values(
    cursor: Cursor, at: int, seen: NDArray[np.bool_], types: NDArray[np.int8], values: Floats
) -> tuple[int, int, int]:
    from stltool.kernels.lines import valuations

    return valuations(cursor.bytes, at, len(cursor.block), cursor.line, seen, types, values)


def _text(value: float, truth: bool) -> str:
    return str(bool(value)).lower() if truth else f"{value:.0f}"


def _repeat(values: Floats) -> bool:
    """Whether two states may have the same values of all variables; if so, their names are compared."""
    mixed = np.zeros(values.shape[1])
    for weight, row in zip(np.random.default_rng(0).random(len(values)), values, strict=True):
        mixed += (
            weight * row
        )  # state by state, so that equal values give equal sums, as in products of BLAS they need not
    mixed.sort()
    return bool((mixed[1:] == mixed[:-1]).any())


# --------------------------------------------------------------------------------------------------------------- costs


def _costs(path: Path, read: _Read, table: _Table | None, faults: FileFaults) -> dict[str, Cost]:
    """Reward structures by name: as the files call them; those without a name are called reward, reward2, …"""
    costs: dict[str, Cost] = {}
    for number, files in _reward_files(path):
        name, parts = "", dict[str, Amounts]()
        for ending, part in ((".srew", "states"), (".trew", "transitions")):
            if ending in files:
                called, amounts = _rewards(files[ending], read, table, part, faults)
                name = name or called
                if amounts is not None:
                    parts["choices" if part == "transitions" and not isinstance(amounts, CostEntries) else part] = (
                        amounts
                    )
        name = name or f"reward{number}"
        while name in costs:
            name += f"#{number}" if number else "#"
        along = parts.get("transitions")
        assert along is None or isinstance(along, CostEntries)
        costs[name] = Cost(parts.get("states"), parts.get("choices"), along)
    return costs


def _rewards(
    file: Path, read: _Read, table: _Table | None, part: str, faults: FileFaults
) -> tuple[str, Amounts | None]:
    cursor = Cursor(File(file, "reward file"))
    announced = None
    if not read.storm:
        number, header = cursor.take() or (1, "")
        try:
            counts = [index(word) for word in words_of(header)]
        except NumberError:
            counts = []
        wanted = 2 if part == "states" or read.chain else 3
        if len(counts) != wanted or counts[0] != read.n_states:
            choices = " choices" if wanted == 3 else ""
            faults.line(
                file, number, header, f'write "states{choices} lines", of the {read.n_states} states of the .tra'
            )
            return "", None
        announced = counts[-1]
    if part == "states":
        form = Form((read.n_states,), "state reward", _NUMBER)
    else:
        form = _form(cursor, read.n_states, read.chain, named="reward")
    entries = read_entries(cursor, form, announced if announced is not None else cursor.file.size // _STORM_LINE)
    name = next((fits[1] for _, comment in cursor.comments if (fits := _REWARD.match(comment)) and fits[1]), "")
    for number, line, remedy in entries.faults:
        faults.line(file, number, line, remedy)
    faults.count += entries.n_faults - len(entries.faults)
    found = len(entries) + len(entries.skipped)
    if announced is not None and found != announced and not (form.by_row and entries.skipped):
        cut_off = "; is the file cut off?" if found < announced else "; correct it"
        faults.add(f"{file}: {found} rewards, but the first line announces {announced}{cut_off}")
    if part == "states":
        return name, _amounts(entries, entries.last.astype(np.int64), read.n_states, "state", faults)
    if table is None:
        return name, None
    place = _places(entries, table)
    lost = np.flatnonzero(place < 0)
    if lost.size:
        for at, text in entries.lines_of(lost[:MOST_FAULTS].tolist()).values():
            faults.line(file, at, text, "the model has no such transition")
        faults.count += max(lost.size - MOST_FAULTS, 0)
        return name, None
    amounts = _amounts(entries, place, len(table.target), "transition", faults)
    if amounts is None:
        return name, None
    top = table.upper if table.upper is not None else table.value
    kept, row_start, target = top != 0, table.row_start, table.target
    if not kept.all():
        amounts, row_start, target = amounts.at(kept), starts(kept)[row_start], target[kept]
    of_choices = _of_choices(amounts, row_start)
    if of_choices is not None:
        return name, of_choices
    return name, CostEntries(amounts.values, amounts.given, row_start=row_start, target=target)


def _of_choices(amounts: Amounts, row_start: I64) -> Amounts | None:
    """One number for each choice, as PRISM repeats rewards of actions along all transitions; None if they differ."""
    width = np.diff(row_start)
    if not width.all():
        return None
    first = np.repeat(row_start[:-1], width)
    if (amounts.values != amounts.values[first]).any():  # exact numbers take longer
        return None
    numerator = amounts.exact.numerator
    return amounts.at(row_start[:-1]) if (numerator == numerator[first]).all() else None


def _amounts(entries: Entries, place: I64, n: int, what: str, faults: FileFaults) -> Amounts | None:
    """(n,) the numbers at their places, 0 elsewhere."""
    order = np.argsort(place, kind="stable")
    twice = order[1:][place[order[1:]] == place[order[:-1]]]
    if twice.size:
        for at, text in entries.lines_of(twice[:MOST_FAULTS].tolist()).values():
            faults.line(entries.file.path, at, text, f"this {what} appears twice; add the two rewards")
        faults.count += max(twice.size - MOST_FAULTS, 0)
        return None
    values, w, places = np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int8)
    values[place], w[place], places[place] = entries.value, entries.exact.w, entries.exact.places
    return Amounts(values, Written(w, places, entries.exact.texts))


def _places(entries: Entries, table: _Table) -> I64:
    """The table's entry of each transition in a reward file, −1 if there is none."""
    state = entries.lead[0].astype(np.int64)
    choices = len(entries.lead) == 2
    number = entries.lead[1].astype(np.int64) if choices else np.zeros(len(state), dtype=np.int64)
    rows = (table.state.astype(np.int64) << 31) + table.number
    if table.read.entries.form.by_row != entries.form.by_row and choices:
        first = np.searchsorted(
            table.state, np.arange(table.read.n_states)
        )  # the k-th line of a state: its k-th choice
        rows = (table.state.astype(np.int64) << 31) + np.arange(len(rows)) - first[table.state]
    wanted = (state << 31) + number
    row = np.searchsorted(rows, wanted)
    found: I64 = np.full(len(wanted), -1)
    there = np.flatnonzero(np.append(rows, -1)[row] == wanted)
    keys = (np.repeat(np.arange(len(rows)), np.diff(table.row_start)) << 31) + table.target
    key = (row[there] << 31) + entries.last[there]
    at = np.searchsorted(keys, key)
    same = np.append(keys, -1)[at] == key
    found[there[same]] = at[same]
    return found
