"""PRISM's explicit files: transitions `.tra`, with labels `.lab` and states `.sta` beside it where they exist.

    NAME.tra    "n_states n_choices n_transitions", then "state choice successor probability [action]"      (MDP)
                "n_states n_transitions",           then "state successor probability"                      (DTMC)
    NAME.lab    0="init" 1="deadlock" 2="done", then "state: number number …"
    NAME.sta    (x,y,b), then "state:(0,1,true)"

Probabilities are decimals or fractions such as 2/5, kept exactly, or intervals of them such as [0.6,0.9]. Labels become
labels, the variables of `.sta` signals (false 0, true 1), and `init` marks the first state; without a `.lab` it is
state 0.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import NoReturn, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.errors import ModelError
from stltool.files import read_text
from stltool.models.fractions import Fractions, over_one
from stltool.models.intervals import Intervals
from stltool.models.mdp import MDP
from stltool.numbers import double, index, read
from stltool.sizes import require_memory, require_numbered

_BYTES_A_LINE = 400  # of Python objects while a file is read
_TRUTH = {"true": 1.0, "false": 0.0}
_LABEL = re.compile(r'(\d{1,9})="([^"]*)"', re.ASCII)


def load_explicit(path: str | Path) -> MDP:
    """Read `path` (.tra) and the .lab and .sta files of the same name. Raises FileError, ModelError."""
    path = Path(path)
    n_states, rows, uncertain = _transitions(path)
    choice_start, row_start = [0], [0]
    action_names: dict[str, int] = {}
    choice_action: list[int] = []
    target: list[int] = []
    shares: list[_Ends] = []
    for s in range(n_states):
        taken: set[str] = set()
        for number, (action, row) in sorted(rows.get(s, {}).items()):
            name = action or str(number)
            if name in taken:  # PRISM lets one action offer several choices; here each has its own name
                name = next(new for i in itertools.count(2) if (new := f"{name}#{i}") not in taken)
            taken.add(name)
            choice_action.append(action_names.setdefault(name, len(action_names)))
            for successor in sorted(row):
                target.append(successor)
                shares.append(row[successor])
            row_start.append(len(target))
        choice_start.append(len(choice_action))
    lower, upper = (np.array([float(share[end]) for share in shares]) for end in (0, 1))
    intervals = Intervals(lower, upper) if uncertain else None
    labels = _labels(path.with_suffix(".lab"), n_states)
    initial = _initial(labels.get("init"), path)
    first = (np.arange(n_states) == initial).astype(np.int64)
    names, signals = _variables(path.with_suffix(".sta"), n_states)
    both = sorted(set(signals) & set(labels))
    if both:
        raise ModelError(
            f"{path.with_suffix('.lab')}: the label {both[0]} is a variable of the .sta file too; rename it"
        )
    try:
        return MDP(
            choice_start=np.array(choice_start, dtype=np.int64),
            choice_action=np.array(choice_action, dtype=np.int32),
            row_start=np.array(row_start, dtype=np.int64),
            target=np.array(target, dtype=np.int32),
            probability=intervals.nominal(np.array(row_start)) if intervals is not None else lower,
            initial=first.astype(np.float64),
            signals=signals,
            labels=labels,
            action_names=tuple(action_names),
            state_names=names,
            name=path.stem,
            fractions=Fractions(*over_one(share for share, _ in shares), first, 1) if not uncertain else None,
            intervals=intervals,
        )
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from None


_Ends: TypeAlias = tuple[Fraction, Fraction]
_Rows: TypeAlias = dict[int, dict[int, tuple[str, dict[int, _Ends]]]]
"""state → choice number in the file → (action, successor → lower and upper end of its probability)"""


def _transitions(path: Path) -> tuple[int, _Rows, bool]:
    """The number of states, their rows, and whether an interval was written."""
    lines = _lines(path, "transition file")
    number, header = next(lines, (1, ""))
    try:
        counts = [index(word) for word in header.split()]
        if len(counts) not in (2, 3) or min(counts) < 0:
            raise ValueError
    except ValueError:
        _fail(path, number, header, 'write "states choices transitions", as PRISM exports it')
    n_states, n_transitions = counts[0], counts[-1]
    require_memory(
        _BYTES_A_LINE * max(n_transitions, n_states),
        f"{path}: reading {n_transitions} transitions of {n_states} states",
        "check the file's first line",
    )
    require_numbered(n_states, "states", "give a part of the model")
    chain = len(counts) == 2
    rows: _Rows = {}
    known: dict[str, _Ends] = {}
    found = 0
    for number, line in lines:
        words = line.split()
        if chain:
            words.insert(1, "0")
        try:
            s, choice, successor = (index(word) for word in words[:3])
            text = words[3]
            if len(words) > (4 if chain else 5):
                raise ValueError
            share = known[text] if text in known else known.setdefault(text, _parse_ends(text))
        except (ValueError, IndexError):
            form = "state successor probability" if chain else "state choice successor probability [action]"
            _fail(path, number, line, f'write "{form}" with a decimal or a fraction such as 2/5, or [0.6,0.9]')
        if not (0 <= s < n_states and 0 <= successor < n_states):
            _fail(path, number, line, f"states are 0 … {n_states - 1} by the first line")
        if not 0 <= share[0] <= share[1] <= 1:
            _fail(path, number, line, f"{text} is no probability")
        action, row = rows.setdefault(s, {}).setdefault(choice, (words[4] if len(words) > 4 else "", {}))
        if len(words) > 4 and words[4] != action:
            _fail(
                path,
                number,
                line,
                f"choice {choice} of state {s} has the action {action or '(none)'} in an earlier line",
            )
        if successor in row:
            _fail(path, number, line, f"this successor of state {s}, choice {choice} stands twice; add the two up")
        found += 1
        if share[1]:
            row[successor] = share
    if found != n_transitions:
        raise ModelError(f"{path}: {found} transitions, and the first line says {n_transitions}; is the file cut off?")
    if not chain and sum(map(len, rows.values())) != counts[1]:
        raise ModelError(f"{path}: {sum(map(len, rows.values()))} choices, and the first line says {counts[1]}")
    _require_rows(path, rows)
    return n_states, rows, any(text.startswith("[") for text in known)


def _parse_ends(text: str) -> _Ends:
    """A probability, or [lower,upper]. Raises ValueError for anything else."""
    if text.startswith("[") and text.endswith("]"):
        lower, upper = (read(end) for end in text[1:-1].split(","))
        return lower, upper
    share = read(text)
    return share, share


def _require_rows(path: Path, rows: _Rows) -> None:
    """A choice whose probabilities are all zero would vanish unseen."""
    for s, choices in rows.items():
        for choice, (_, row) in choices.items():
            if not row:
                raise ModelError(f"{path}: state {s}, choice {choice}: the probabilities sum to 0, not 1")


def _labels(path: Path, n_states: int) -> dict[str, NDArray[np.bool_]]:
    if not path.exists():
        return {}
    lines = _lines(path, "label file")
    number, header = next(lines, (1, ""))
    names = {int(key): name for key, name in _LABEL.findall(header)}
    if not names or _LABEL.sub("", header).strip():
        _fail(path, number, header, 'write 0="init" 1="deadlock" 2="done" …')
    labels = {name: np.zeros(n_states, dtype=np.bool_) for name in names.values()}
    if len(labels) < len(_LABEL.findall(header)):
        _fail(path, number, header, "two labels have one name, or one number")
    if "init" not in labels:
        _fail(path, number, header, 'mark the state that runs start in: 0="init", and a line "state: 0"')
    for number, line in lines:
        state, colon, numbers = line.partition(":")
        try:
            s, which = index(state.strip()), [index(word) for word in numbers.split()]
            if not colon or not 0 <= s < n_states or any(i not in names for i in which):
                raise ValueError
        except ValueError:
            _fail(
                path,
                number,
                line,
                f'write "state: number number …", states 0 … {n_states - 1}, numbers of the first line',
            )
        for i in which:
            labels[names[i]][s] = True
    return labels


def _initial(marked: NDArray[np.bool_] | None, path: Path) -> int:
    if marked is None:
        return 0
    states = np.flatnonzero(marked)
    if len(states) != 1:
        raise ModelError(
            f'{path.with_suffix(".lab")}: "init" marks {len(states)} states; mark the one that runs start in'
        )
    return int(states[0])


def _variables(path: Path, n_states: int) -> tuple[list[str] | None, dict[str, NDArray[np.float64]]]:
    """State names and signals of a .sta file; none without one."""
    if not path.exists():
        return None, {}
    lines = _lines(path, "states file")
    number, header = next(lines, (1, ""))
    variables = [name.strip() for name in header.strip("() ").split(",")]
    if (
        not header.startswith("(")
        or not header.endswith(")")
        or not all(variables)
        or len(set(variables)) < len(variables)
    ):
        _fail(path, number, header, "write the variables' names, such as (x,y)")
    names = [""] * n_states
    values = np.full((len(variables), n_states), np.nan)
    for number, line in lines:
        state, _, tuple_text = line.partition(":")
        words = [word.strip() for word in tuple_text.strip("() ").split(",")]
        try:
            s = index(state.strip())
            column = [_TRUTH[word] if word in _TRUTH else double(word) for word in words]
            if not 0 <= s < n_states or len(column) != len(variables):
                raise ValueError
        except ValueError:
            _fail(path, number, line, f'write "state:({",".join(variables)})" with numbers, true or false')
        if names[s]:
            _fail(path, number, line, f"state {s} stands twice")
        names[s] = ", ".join(f"{name}={word}" for name, word in zip(variables, words, strict=True))
        values[:, s] = column
    missing = np.flatnonzero(np.isnan(values[0]))
    if missing.size:
        raise ModelError(f"{path}: state {missing[0]} is missing")
    return names, dict(zip(variables, values, strict=True))


def _lines(path: Path, what: str) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(read_text(path, what).splitlines(), start=1):
        if line.strip():
            yield number, line.strip()


def _fail(path: Path, number: int, line: str, remedy: str) -> NoReturn:
    shown = line if len(line) <= 80 else line[:77] + "…"
    raise ModelError(f"{path}, line {number}: {shown!r}: {remedy}")
