"""Traces with a wanted verdict, built step by step instead of drawn and rejected.

The exact automaton of φ, restricted to truth assignments of its comparisons and labels that values in the signals'
ranges give (logic/regions.py), with verdicts as early as they are certain, is walked forward:

    win_d(d, q)  =  verdict_d(q) is the wanted one
    win_d(t, q)  =  verdict_t(q) is open, and some assignment λ has win_d(t + 1, δ(λ, q))         t = d − 1 … 0

is computed backwards, so every move that is taken has a continuation whose verdict becomes certain at step d. What is
*near* the border is a formula, too: robustness is at most ε if φ with every margin required to exceed ε fails.

Signals with a bounded change are in testing/slow.py.

Distribution: d is uniform over the steps at which the verdict can become certain; then each step's assignment is
uniform over those that keep d in reach, and over all of them after d; then values as in `Choices.pick`. Hypothesis
departs from uniform draws where it mutates examples, or tries constants of the program under test.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import TRUE, UNDECIDED
from stltool.automata.compile import atoms_of, compile_automaton
from stltool.automata.reachable import decided_early
from stltool.display import cut
from stltool.errors import InfeasibleError, NameLookupError, SettingsError, SizeError, near_misses
from stltool.logic.feasible import leaves, tabulated
from stltool.logic.formula import (
    Always,
    And,
    Arithmetic,
    Call,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Negate,
    Not,
    Number,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    children,
    horizon,
    with_children,
)
from stltool.logic.regions import Choices, Draw, Range, Span, Values, groups
from stltool.logic.shifts import has_delays
from stltool.testing.slow import Box, Slow

Columns: TypeAlias = dict[str, NDArray[np.float64] | NDArray[np.bool_]]

_MOST_ROWS = 1 << 14  # truth assignments of everything at a step
_MOST_EFFORT = 200_000_000  # steps times states times letters
_MOST_STATES = 20_000
_MOST_STEPS = 100_000
_MOST_CERTAIN = 32  # steps of certainty with slow signals: of more, evenly many are left out
_REMEMBERED = 64  # steps of certainty whose moves are kept


class NoTraceError(InfeasibleError):
    """There is no such trace, or, unless `sure`, none was found."""

    def __init__(self, wanted: str, sure: bool) -> None:
        super().__init__(
            f"no trace {'' if sure else 'was found that '}{wanted} with signals in their ranges; give other ranges, as "
            "in signals={'x': (0, 9)}, or another formula"
        )
        self.sure = sure


class Constructor:
    """Traces on which φ holds. `wanted` says in messages what they do: "satisfies G[0,3] a".

    names    of the signals and labels of a trace;  horizon  h
    certain  the steps at which the verdict can become certain
    sharp    whether no truth assignment is missing that values can give
    Raises NoTraceError if there is no such trace, SettingsError for comparisons that it cannot solve, SizeError.
    """

    def __init__(
        self, phi: Formula, ranges: Mapping[str, Range], labels: Sequence[str] = (), wanted: str = "",
        changes: Mapping[str, Fraction] | None = None,
    ) -> None:  # fmt: skip
        wanted = wanted or f"satisfies {_shown(phi)}"
        if has_delays(phi):
            raise SettingsError(
                f"{_shown(phi)} compares samples of several steps; traces are built for comparisons of one step: "
                "give the change a signal of its own, such as change = x - x[t-1]"
            )
        self.horizon = horizon(phi)
        if self.horizon >= _MOST_STEPS:
            raise SizeError(
                f"{_shown(phi)} has horizon {self.horizon}; traces of over {_MOST_STEPS} steps are not built"
            )
        read = leaves(phi)
        self._groups = groups([leaf for leaf in read if isinstance(leaf, Comparison)], ranges)
        self.sharp = all(group.sharp for group in self._groups)
        self._labels = [leaf for leaf in read if isinstance(leaf, Label)]
        compared = {name for group in self._groups for name in group.names}
        told = {label.name for label in self._labels}
        if both := sorted((compared | ranges.keys()) & (told | set(labels))):
            raise SettingsError(
                f"{', '.join(both)}: a name is either a label, true or false at each step, or a signal with a "
                "range; use another name for one of them"
            )
        known = compared | told
        self._spans = {name: Span(*limits) for name, limits in ranges.items() if name not in known}
        self._free = {name: _anything(limits) for name, limits in ranges.items() if name not in known}
        self._idle = [name for name in labels if name not in known]
        options: list[Sequence[tuple[bool, ...]]] = [group.rows for group in self._groups]
        options += [((False,), (True,))] * len(self._labels)
        if math.prod(map(len, options)) > _MOST_ROWS:
            raise SizeError(
                f"{_shown(phi)} reads {len(read)} labels and comparisons, whose truth can be combined in over "
                f"{_MOST_ROWS} ways; take fewer of them"
            )
        self._rows = list(itertools.product(*options))
        if not self._rows:
            raise NoTraceError(wanted, False)
        self._compile(phi, read)
        self._slow = self._slowed(changes) if changes else None
        self.certain = self._certain()
        if self._slow is not None:
            # the longest first, so that what is too much work is refused at once
            spread = self.certain[:: 1 + len(self.certain) // _MOST_CERTAIN][::-1]
            self.certain = [d for d in spread if self._automaton.initial in self._reach(d)[0]][::-1]
        if not self.certain:
            raise NoTraceError(wanted, self.sharp)

    def __repr__(self) -> str:
        return f"Constructor({self._automaton.formula})"

    def _compile(self, phi: Formula, read: Sequence[Formula]) -> None:
        columns = [*(leaf for group in self._groups for leaf in group.leaves), *self._labels]
        truths = np.array([[t for part in row for t in part] for row in self._rows], dtype=np.bool_)
        order = [columns.index(leaf) for leaf in read]
        atoms = atoms_of(phi)
        valuations = tabulated(atoms, read, truths.reshape(len(self._rows), len(columns))[:, order])
        automaton = compile_automaton(
            phi, valuations=np.unique(valuations, axis=0) if len(atoms) else None, most_states=_MOST_STATES
        )
        letters = automaton.letters_at(valuations) if len(atoms) else np.zeros(len(self._rows), dtype=np.int32)
        used, self._letter_of_row = np.unique(letters, return_inverse=True)
        if self.horizon * automaton.n_states * len(used) > _MOST_EFFORT:
            raise SizeError(
                f"{_shown(phi)} has horizon {self.horizon} and an automaton of {automaton.n_states} states; shorten "
                "its windows"
            )
        self._automaton = decided_early(automaton, letters)
        self._delta = self._automaton.delta[used]
        self._rows_of = [np.flatnonzero(self._letter_of_row == i).tolist() for i in range(len(used))]
        self._known: dict[bytes, list[int]] = {}
        self._wins = lru_cache(maxsize=_REMEMBERED)(self._backwards)
        self._reach = lru_cache(maxsize=_REMEMBERED)(self._reached)

    def _certain(self) -> list[int]:
        """The steps at which the verdict true can be decided."""
        open_states, found = np.array([self._automaton.initial]), []
        for t in range(self.horizon + 1):
            states = np.unique(self._delta[:, open_states])
            verdicts = self._automaton.verdicts(t)[states]
            if (verdicts == TRUE).any():
                found.append(t)
            open_states = states[verdicts == UNDECIDED]
            if not open_states.size:
                break
        return found

    def _backwards(self, d: int) -> NDArray[np.bool_]:
        """win_d, (d + 1, n_states)."""
        win = np.zeros((d + 1, self._automaton.n_states), dtype=np.bool_)
        win[d] = self._automaton.verdicts(d) == TRUE
        for t in range(d - 1, -1, -1):
            win[t] = (self._automaton.verdicts(t) == UNDECIDED) & win[t + 1][self._delta].any(axis=0)
        return win

    def _slowed(self, changes: Mapping[str, Fraction]) -> Slow:
        """Where the signals with a bounded change are under each assignment. SettingsError if that is not exact."""
        whose = {name: i for i, group in enumerate(self._groups) for name in group.names}
        anywhere = {name: [span] for name, span in self._spans.items()}
        for name in changes:
            if name not in whose and name not in anywhere:
                known = near_misses(name, {*whose, *anywhere})
                raise NameLookupError(f"most_change names {name}, which is no signal of these traces; {known}")
        boxes = []
        for row in self._rows:
            spans = []
            for name in changes:
                found = self._groups[whose[name]].spans(row[whose[name]]) if name in whose else anywhere[name]
                if found is None:
                    raise SettingsError(
                        f"most_change of {name}: traces with a wanted verdict have it for signals that are compared "
                        "with numbers alone, linearly; leave it out, or draw traces(…, most_change=…) and judge them"
                    )
                spans.append(found)
            boxes.append(list(itertools.product(*spans)))
        return Slow(changes, boxes, self._letter_of_row.tolist())

    def _reached(self, d: int) -> list[dict[int, list[Box]]]:
        assert self._slow is not None
        return self._slow.reach(self._delta, self._wins(d), self._automaton.initial)

    def build(self, draw: Draw, steps: int | None = None) -> Columns:
        """A trace of so many steps, horizon + 1 by default; 0 from every draw gives the simplest."""
        d = self.certain[draw(len(self.certain))]
        win = self._wins(d)
        before: Values | None = None
        q, values, told = self._automaton.initial, [], []
        for t in range(self.horizon + 1 if steps is None else steps):
            if self._slow is not None:
                places = self._slow.options(self._delta, win, self._reach(d), t, q, before)
                rows = sorted(places)
                row = rows[draw(len(rows))]
                q = int(self._delta[self._letter_of_row[row], q])
                before = self._slow.pick(places[row][draw(len(places[row]))], draw)
            elif t <= d:
                after = self._delta[:, q]
                rows = self._allowed(np.flatnonzero(win[t][after]))
                row = rows[draw(len(rows))]
                q = int(after[self._letter_of_row[row]])
            else:
                row = draw(len(self._rows))
            parts = self._rows[row]
            found: Values = {}
            for group, part in zip(self._groups, parts, strict=False):
                if before is None or before.keys().isdisjoint(group.names):
                    found.update(group.pick(part, draw))
            for name, choices in self._free.items():
                if before is None or name not in before:
                    found[name] = choices.pick(draw)
            found.update(before or {})
            values.append(found)
            told.append([*(part[0] for part in parts[len(self._groups) :]), *(draw(2) == 1 for _ in self._idle)])
        return self._columns(values, told)

    def _allowed(self, letters: NDArray[np.int64]) -> list[int]:
        """The assignments with one of these letters, simplest first."""
        key = letters.tobytes()
        if key not in self._known:
            self._known[key] = sorted(row for letter in letters.tolist() for row in self._rows_of[letter])
        return self._known[key]

    def _columns(self, values: Sequence[Values], told: Sequence[Sequence[bool]]) -> Columns:
        names = [label.name for label in self._labels] + self._idle
        trace: Columns = {
            name: np.array([float(step[name]) for step in values], dtype=np.float64) for name in sorted(values[0])
        }
        for i, name in enumerate(names):
            trace[name] = np.array([row[i] for row in told], dtype=np.bool_)
        return trace


def _anything(limits: Range) -> Choices:
    found = Choices.within(Span(*limits))
    assert found is not None  # ranges have decimals
    return found


def _shown(phi: Formula) -> str:
    return cut(str(phi), 100)


# --------------------------------------------------------------------------------------------------------- near misses


def near(phi: Formula, within: Fraction) -> Formula:
    """φ, with robustness at most `within`."""
    return And((phi, Not(_beyond(phi, within, True))))


def _beyond(phi: Formula, epsilon: Fraction, strictly: bool) -> Formula:
    """Whether robustness is more than ε, or, if not `strictly`, at least −ε."""
    match phi:
        case Constant() | Label():
            return phi
        case Comparison():
            return _margin_beyond(phi, epsilon, strictly)
        case Not(arg):
            return Not(_beyond(arg, epsilon, not strictly))
        case Implies(left, right):
            return Or((Not(_beyond(left, epsilon, not strictly)), _beyond(right, epsilon, strictly)))
        case Iff(left, right):
            both = Implies(left, right), Implies(right, left)
            return And(tuple(_beyond(arg, epsilon, strictly) for arg in both))
        case Rise(arg):
            before = Once(Interval(1, 1), _beyond(arg, epsilon, not strictly))
            return And((_beyond(arg, epsilon, strictly), Not(before)))
        case And() | Or() | Eventually() | Always() | Until() | Release():
            return with_children(phi, tuple(_beyond(arg, epsilon, strictly) for arg in children(phi)))
        case Once() | Historically() | Since() | Trigger():
            return with_children(phi, tuple(_beyond(arg, epsilon, strictly) for arg in children(phi)))
        case _:
            assert_never(phi)


def _margin_beyond(phi: Comparison, epsilon: Fraction, strictly: bool) -> Formula:
    difference, border = Arithmetic("-", phi.left, phi.right), Number(float(epsilon))
    match phi.op:
        case ">" | ">=":
            return Comparison(">", difference, border) if strictly else Comparison(">=", difference, Negate(border))
        case "<" | "<=":
            turned = Arithmetic("-", phi.right, phi.left)
            return Comparison(">", turned, border) if strictly else Comparison(">=", turned, Negate(border))
        case "==":
            return Constant(False) if strictly else Comparison("<=", Call("abs", (difference,)), border)
        case "!=":
            return Comparison(">", Call("abs", (difference,)), border) if strictly else Constant(True)
        case _:
            assert_never(phi.op)
