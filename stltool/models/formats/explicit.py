"""PRISM's explicit files: transitions `.tra`, with labels `.lab` and states `.sta` next to it if they exist.

    NAME.tra    "n_states n_choices n_transitions", then "state choice successor probability [action]"      (MDP)
                "n_states n_transitions",           then "state successor probability"                      (DTMC)
    NAME.lab    0="init" 1="deadlock" 2="done", then "state: number number …"
    NAME.sta    (x,y,b), then "state:(0,1,true)"

Probabilities are decimals or fractions such as 2/5, kept exactly, or intervals of them such as [0.6,0.9]. Labels become
labels, the variables of `.sta` become signals (false 0, true 1), and `init` marks the first state; without a `.lab` it
is state 0.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.errors import MOST_FAULTS, ModelError, all_told
from stltool.files import read_text
from stltool.models.fractions import Shares, doubles_of, over_one
from stltool.models.intervals import Intervals
from stltool.models.mdp import MDP
from stltool.models.normalize import HINT, MOST_MISSING, NOTHING, rescale
from stltool.models.rows import Stored
from stltool.numbers import NumberError, double, index, read
from stltool.sizes import require_memory, require_numbered

_BYTES_A_LINE = 400  # for Python objects while a file is read
_SHOWN = 80  # characters of a line that a message quotes
_TOLERANCE = 1e-9  # how far the sum of a row of doubles may be from 1
_TRUTH = {"true": 1.0, "false": 0.0}
_LABEL = re.compile(r'(\d{1,9})="([^"]*)"', re.ASCII)

_Ends: TypeAlias = tuple[Fraction, Fraction]


def load_explicit(path: str | Path, normalize: bool = False) -> MDP:
    """Read `path` (.tra) and the .lab and .sta files of the same name.

    `normalize` rescales rows that miss 1 by at most 1/1000 (models/normalize.py). Raises FileError, and ModelError with
    all faults in the three files, with their lines.
    """
    path = Path(path)
    faults = _Faults()
    table = _transitions(path, faults)
    if table is None:
        raise faults.error()
    arrays = _Arrays.of(table)
    before = faults.count
    labels = _labels(path.with_suffix(".lab"), table.n_states, faults)
    first = _initial(labels.get("init"), path, table.n_states, faults if faults.count == before else _Faults())
    names, signals = _variables(path.with_suffix(".sta"), table.n_states, faults)
    both = sorted(set(signals) & set(labels))
    if both:
        faults.add(f"{path.with_suffix('.lab')}: the label {both[0]} is also a variable in the .sta file; rename it")
    arrays.require_distributions(path, normalize, faults)
    if faults.count:
        raise faults.error()
    lower, upper = (np.array([float(share[end]) for share in arrays.shares]) for end in (0, 1))
    intervals = Intervals(lower, upper) if table.uncertain else None
    notes = _missing_files(path)
    exact: Shares | None = None
    row_start = np.array(arrays.row_start, dtype=np.int64)
    if intervals is not None and normalize:
        notes["normalize"] = NOTHING.format("intervals")
    if intervals is None:
        shares = over_one(share for share, _ in arrays.shares)
        if normalize:
            shares, done = rescale(shares, row_start, arrays.place)
            lower, notes["normalize"] = doubles_of(*shares), str(done)
        exact = Shares(*shares)
    try:
        return MDP(
            Stored(
                np.array(arrays.choice_start, dtype=np.int64),
                np.array(arrays.choice_action, dtype=np.int32),
                row_start,
                np.array(arrays.target, dtype=np.int32),
                intervals.nominal(row_start) if intervals is not None else lower,
                exact,
                intervals,
            ),
            initial=first.astype(np.float64),
            signals=signals,
            labels=labels,
            action_names=tuple(arrays.action_names),
            state_names=names,
            name=path.stem,
            exact_initial=Shares(first, 1),
            notes=notes,
        )
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None


def _missing_files(path: Path) -> dict[str, str]:
    """The model's notes about missing label or state files."""
    without = {
        "label": (".lab", "the model has no labels, and runs start in state 0"),
        "signal": (".sta", "the model has no signals, and its states have only numbers"),
    }
    return {
        kind: f"there is no {path.with_suffix(ending).name} next to {path.name}: {so}"
        for kind, (ending, so) in without.items()
        if not path.with_suffix(ending).exists()
    }


class _Faults:
    """The faults of the files, in order: the first messages, and the number of all."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.count = 0

    def add(self, message: str) -> None:
        self.count += 1
        if len(self.told) < MOST_FAULTS:
            self.told.append(message)

    def line(self, path: Path, number: int, line: str, remedy: str) -> None:
        shown = line if len(line) <= _SHOWN else line[: _SHOWN - 3] + "…"
        self.add(f"{path}, line {number}: {shown!r}: {remedy}")

    def error(self) -> ModelError:
        return ModelError(all_told(self.told, self.count))


# ------------------------------------------------------------------------------------------------------ transitions


@dataclass
class _Choice:
    """A choice in the file: its action, its first line, and each successor with the ends of its probability."""

    action: str
    line: int
    row: dict[int, _Ends] = field(default_factory=dict)
    faulty: bool = False


@dataclass
class _Table:
    """n_states, and state → choice number in the file → choice; `uncertain` if an interval was written, `garbled` if
    lines are missing or cannot be assigned to a choice."""

    n_states: int
    rows: dict[int, dict[int, _Choice]] = field(default_factory=dict)
    uncertain: bool = False
    garbled: bool = False


def _transitions(path: Path, faults: _Faults) -> _Table | None:
    """None if the first line does not contain the number of states."""
    lines = _lines(path, "transition file")
    number, header = next(lines, (1, ""))
    try:
        counts = [index(word) for word in header.split()]
    except NumberError:
        counts = []
    if len(counts) not in (2, 3):
        faults.line(path, number, header, 'write "states choices transitions", as PRISM exports it')
        return None
    n_states, n_transitions = counts[0], counts[-1]
    require_memory(
        _BYTES_A_LINE * max(n_transitions, n_states),
        f"{path}: reading {n_transitions} transitions of {n_states} states",
        "check the file's first line",
    )
    require_numbered(n_states, "states", "use a part of the model")
    table, chain = _Table(n_states), len(counts) == 2
    known: dict[str, _Ends] = {}
    found = 0
    for number, line in lines:
        found += 1
        wrong = _transition(table, number, line.split(), chain, known)
        if wrong:
            faults.line(path, number, line, wrong)
    if found != n_transitions:
        faults.add(f"{path}: {found} transitions, but the first line announces {n_transitions}; is the file cut off?")
        table.garbled = True
    n_choices = sum(map(len, table.rows.values()))
    if not chain and not table.garbled and n_choices != counts[1]:
        faults.add(f"{path}: {n_choices} choices, but the first line announces {counts[1]}; correct it")
    return table


def _transition(table: _Table, number: int, words: list[str], chain: bool, known: dict[str, _Ends]) -> str:
    """Add a line to the table; returns its fault, or "". `known` are the probabilities read so far."""
    if chain:
        words.insert(1, "0")
    form = "state successor probability" if chain else "state choice successor probability [action]"
    try:
        s, choice = index(words[0]), index(words[1])
    except (NumberError, IndexError):
        table.garbled = True
        return f'write "{form}" with a decimal or a fraction such as 2/5, or [0.6,0.9]'
    if not 0 <= s < table.n_states:
        table.garbled = True
        return f"states are 0 … {table.n_states - 1} by the first line"
    action = words[4] if len(words) > 4 else ""
    entry = table.rows.setdefault(s, {}).setdefault(choice, _Choice(action, number))
    wrong = _outcome(table, entry, words, action, form, known)
    entry.faulty |= bool(wrong)
    return wrong or ""


def _outcome(
    table: _Table, choice: _Choice, words: list[str], action: str, form: str, known: dict[str, _Ends]
) -> str | None:
    """Add a successor to its choice; returns its fault, or ""."""
    try:
        successor, text = index(words[2]), words[3]
        if len(words) > (5 if "choice" in form else 4):
            return f'write "{form}"'
        share = known[text] if text in known else known.setdefault(text, _parse_ends(text))
    except IndexError:
        return f'write "{form}"'
    except NumberError as error:
        return f'{error}; write "{form}" with a decimal or a fraction such as 2/5, or [0.6,0.9]'
    table.uncertain |= text.startswith("[")
    if successor >= table.n_states:
        return f"states are 0 … {table.n_states - 1} by the first line"
    if not 0 <= share[0] <= share[1] <= 1:
        return f"{text} is not a probability"
    if action and action != choice.action:
        return f"this choice has the action {choice.action or '(none)'} in line {choice.line}"
    if successor in choice.row:
        return "this successor of the choice appears twice; add the two probabilities"
    if share[1]:
        choice.row[successor] = share
    return None


def _parse_ends(text: str) -> _Ends:
    """A probability, or [lower,upper]. Raises NumberError for anything else."""
    if not (text.startswith("[") and text.endswith("]")):
        share = read(text)
        return share, share
    ends = text[1:-1].split(",")
    if len(ends) != 2:
        raise NumberError(f"{text!r} is not an interval")
    return read(ends[0]), read(ends[1])


@dataclass
class _Arrays:
    """The model's arrays as lists; `lines` (n_choices,): where each choice begins in the file."""

    table: _Table
    choice_start: list[int] = field(default_factory=lambda: [0])
    row_start: list[int] = field(default_factory=lambda: [0])
    choice_action: list[int] = field(default_factory=list)
    target: list[int] = field(default_factory=list)
    shares: list[_Ends] = field(default_factory=list)
    action_names: dict[str, int] = field(default_factory=dict)
    choices: list[tuple[int, int, _Choice]] = field(default_factory=list)

    @classmethod
    def of(cls, table: _Table) -> _Arrays:
        made = cls(table)
        for s in range(table.n_states):
            taken: set[str] = set()
            for number, choice in sorted(table.rows.get(s, {}).items()):
                name = choice.action or str(number)
                if name in taken:  # in PRISM, several choices may share an action; here each has its own name
                    name = next(new for i in itertools.count(2) if (new := f"{name}#{i}") not in taken)
                taken.add(name)
                made.choice_action.append(made.action_names.setdefault(name, len(made.action_names)))
                for successor in sorted(choice.row):
                    made.target.append(successor)
                    made.shares.append(choice.row[successor])
                made.row_start.append(len(made.target))
                made.choices.append((s, number, choice))
            made.choice_start.append(len(made.choice_action))
        return made

    def place(self, c: int) -> str:
        s, number, choice = self.choices[c]
        return f"line {choice.line}: state {s}, choice {number}"

    def require_distributions(self, path: Path, normalize: bool, faults: _Faults) -> None:
        """Check that every state has a choice and every choice a distribution, except rows with faulty lines."""
        if self.table.garbled:
            return
        for s in np.flatnonzero(np.diff(self.choice_start) == 0).tolist():
            faults.add(f"{path}: state {s} has no action; give it one that stays (probability 1 to itself)")
        for c, (_, _, choice) in enumerate(self.choices):
            if not choice.faulty and (wrong := _sum_fault(choice.row, normalize)):
                faults.add(f"{path}, {self.place(c)}: {wrong}")


def _sum_fault(row: dict[int, _Ends], normalize: bool) -> str:
    """The fault in the sums of a row, or ""."""
    lower, upper = (sum(float(ends[k]) for ends in row.values()) for k in (0, 1))
    if not row:
        return "the probabilities sum to 0, not 1"
    if lower - 1 > _TOLERANCE and lower != upper:
        return f"the lower ends sum to {lower:.12g}, more than 1; lower one of them"
    if 1 - upper > _TOLERANCE and lower != upper:
        return f"the upper ends sum to {upper:.12g}, less than 1; raise one of them"
    missing = abs(lower - 1)
    if lower == upper and missing > (MOST_MISSING if normalize else _TOLERANCE):
        return f"the probabilities sum to {lower:.12g}, not 1" + (f"; {HINT}" if missing <= MOST_MISSING else "")
    return ""


# ------------------------------------------------------------------------------------------------ labels, variables


def _labels(path: Path, n_states: int, faults: _Faults) -> dict[str, NDArray[np.bool_]]:
    if not path.exists():
        return {}
    lines = _lines(path, "label file")
    number, header = next(lines, (1, ""))
    found = _LABEL.findall(header)
    names = {int(key): name for key, name in found}
    labels = {name: np.zeros(n_states, dtype=np.bool_) for name in names.values()}
    if not names or _LABEL.sub("", header).strip():
        faults.line(path, number, header, 'write 0="init" 1="deadlock" 2="done" …')
        return {}
    if len(labels) < len(found):
        faults.line(path, number, header, "two labels have the same name or number; make them different")
        return {}
    if "init" not in labels:
        faults.line(path, number, header, 'mark the state that runs start in: 0="init", and a line "state: 0"')
    form = f'write "state: number number …", states 0 … {n_states - 1}, numbers of the first line'
    for number, line in lines:
        state, colon, numbers = line.partition(":")
        try:
            s, which = index(state.strip()), [index(word) for word in numbers.split()]
        except NumberError:
            s, which = n_states, []
        if not colon or s >= n_states or any(i not in names for i in which):
            faults.line(path, number, line, form)
            continue
        for i in which:
            labels[names[i]][s] = True
    return labels


def _initial(marked: NDArray[np.bool_] | None, path: Path, n_states: int, faults: _Faults) -> NDArray[np.int64]:
    """The initial distribution; without labels it is state 0."""
    first = np.zeros(n_states, dtype=np.int64)
    states = np.flatnonzero(marked) if marked is not None else np.zeros(1, dtype=np.int64)
    if len(states) != 1:
        faults.add(f'{path.with_suffix(".lab")}: "init" marks {len(states)} states; mark the one that runs start in')
    first[states[:1]] = 1
    return first


def _variables(path: Path, n_states: int, faults: _Faults) -> tuple[list[str] | None, dict[str, NDArray[np.float64]]]:
    """State names and signals from a .sta file; none without one."""
    if not path.exists():
        return None, {}
    lines = _lines(path, "states file")
    number, header = next(lines, (1, ""))
    variables = [name.strip() for name in header.strip("() ").split(",")]
    bracketed = header.startswith("(") and header.endswith(")")
    if not bracketed or not all(variables) or len(set(variables)) < len(variables):
        faults.line(path, number, header, "write the variables' names, such as (x,y)")
        return None, {}
    names = [""] * n_states
    values = np.full((len(variables), n_states), np.nan)
    form = f'write "state:({",".join(variables)})" with numbers, true or false'
    before = faults.count
    for number, line in lines:
        state, _, tuple_text = line.partition(":")
        words = [word.strip() for word in tuple_text.strip("() ").split(",")]
        try:
            s = index(state.strip())
            column = [_TRUTH[word] if word in _TRUTH else double(word) for word in words]
        except NumberError as error:
            faults.line(path, number, line, f"{error}; {form}")
            continue
        if s >= n_states or len(column) != len(variables):
            faults.line(path, number, line, f"{form}; states are 0 … {n_states - 1}")
        elif names[s]:
            faults.line(path, number, line, f"state {s} appears twice")
        else:
            names[s] = ", ".join(f"{name}={word}" for name, word in zip(variables, words, strict=True))
            values[:, s] = column
    missing = np.flatnonzero(np.isnan(values[0]))
    if missing.size and faults.count == before:
        more = f", and {missing.size - 1} more" if missing.size > 1 else ""
        faults.add(f"{path}: state {missing[0]} is missing{more}")
    return names, dict(zip(variables, values, strict=True))


def _lines(path: Path, what: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(read_text(path, what).splitlines(), start=1):
        if line.strip():
            yield number, line.strip()
