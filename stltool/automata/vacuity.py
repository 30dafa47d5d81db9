"""What a formula means without a model: whether it can hold, whether it can fail, and which parts are vacuous.

An occurrence o of a sub-formula is *vacuous* if a constant in its place does not change the meaning of the whole,

    φ[o := c] ≡ φ        for c = true or c = false,

each occurrence considered by itself. There are three steps, from cheap to expensive: evidence that it is not vacuous (a
synthetic trace with a different verdict), rewriting both to one formula, and a proof (both exact automata, compared on
every run; if those are too large, those of a part of φ around o). If o lies in p, no equivalence is above o, and o is
not vacuous, then neither is p: constants for p change more than those for o. So labels and comparisons come first.

Everything is relative to the truth assignments that can occur at a step. By default these are a superset
(logic/feasible.py), so "can never hold", "always holds" and "vacuous" are never wrong; they are complete for formulas
over labels and comparisons of one variable with constants. `status` reports what was not decided.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import whole
from stltool.automata.automaton import FALSE, TRUE
from stltool.automata.compile import atoms_of, compile_automaton, truth_table
from stltool.automata.reachable import Effort, ReachableVerdicts, differ, shortest_run
from stltool.automata.samples import Samples, truth_along
from stltool.display import Card, Displayed, listed
from stltool.errors import SizeError
from stltool.logic.feasible import feasible_valuations, leaves
from stltool.logic.formula import (
    Comparison,
    Constant,
    Formula,
    Label,
    Not,
    bounded_formula_of,
    children,
    horizon,
    temporal_depth,
    walk,
    with_children,
)
from stltool.logic.occurrences import occurrences, with_replaced
from stltool.logic.rewrite import OPPOSITE, simplify
from stltool.logic.shifts import Delayed, delayed
from stltool.logic.task import Task

MOST_EFFORT = 60_000  # states times letters explored: about a second
_MOST_PLACES = 2000  # occurrences
_MOST_VALUATIONS = 1024
_MOST_STATES = 5000
_DEEPEST = 8  # nested temporal operators; residuals of deeper formulas get too long
_LONGEST_TEXT = 300

_Read: TypeAlias = tuple[ReachableVerdicts, NDArray[np.int32]]
"""The reachable verdicts of an automaton, and its letter for each valuation."""


@dataclass(frozen=True, slots=True)
class Example:
    """The beginning of a trace that fixes the verdict, however it continues; empty if the verdict is always the same.

    `runs` are (truth of each of `leaves`, number of steps), in order of time.
    """

    leaves: tuple[Formula, ...]
    runs: tuple[tuple[tuple[bool, ...], int], ...]

    @property
    def n_steps(self) -> int:
        return sum(count for _, count in self.runs)

    def __str__(self) -> str:
        """`a, x <= 5 for 3 steps; !a, x > 5 for 1 step`."""
        if not self.runs:
            return "any trace"
        return "; ".join(
            ", ".join(str(leaf if holds else simplify(Not(leaf))) for leaf, holds in zip(self.leaves, row, strict=True))
            + f" for {count} step{'' if count == 1 else 's'}"
            for row, count in self.runs
        )

    def data(self) -> list[dict[str, Any]]:
        """One entry a run, for JSON."""
        return [
            {"steps": count, "truth": {str(leaf): holds for leaf, holds in zip(self.leaves, row, strict=True)}}
            for row, count in self.runs
        ]


@dataclass(frozen=True, slots=True)
class VacuousPart:
    """A vacuous occurrence.

    part      the sub-formula, with its position in the text
    path      the operand to descend into at each operator, from the root
    uses      the number of its occurrences that stem from this position: a definition may be used several times
    constant  the constant that can replace it
    formula   the whole formula with that constant, simplified
    """

    part: Formula
    path: tuple[int, ...]
    uses: int
    constant: bool
    formula: Formula

    def __str__(self) -> str:
        which = f", in one of its {self.uses} uses," if self.uses > 1 else ""
        return _at(
            self.part,
            f"{_shown(self.part)}{which} is vacuous; with {Constant(self.constant)} in its place, the task still means "
            f"{_shown(self.formula)}",
        )

    def data(self) -> dict[str, Any]:
        return {**_place(self.part), "uses": self.uses, "constant": self.constant, "means": str(self.formula)}


@dataclass(frozen=True, slots=True, repr=False)
class Meaning(Displayed):
    """What a formula means without a model.

    can_hold, can_fail  whether some trace satisfies it, and whether some violates it; None if not decided. False is
              certain; True is as certain as the truth assignments are complete
    holds, fails  a beginning of a trace that ensures it (with `shortest`, a shortest one); None if there is none, or
              none short enough to be shown
    because   if it never or always holds: the smallest part that explains this by never or always holding itself
    vacuous   the largest vacuous occurrences, each considered by itself; sought only if it can hold and can fail
    status    "decided", or what was not
    """

    formula: Formula
    can_hold: bool | None
    can_fail: bool | None
    holds: Example | None
    fails: Example | None
    shortest: bool
    because: tuple[Formula, bool] | None
    vacuous: tuple[VacuousPart, ...]
    status: str

    def _card(self) -> Card:
        words = {True: "yes", False: "no", None: "not decided"}
        return Card(
            f"Meaning: can hold: {words[self.can_hold]}, can fail: {words[self.can_fail]}, {self.status}",
            [
                {"formula": self.formula},
                {
                    "vacuous parts": listed(str(vacuous.part) for vacuous in self.vacuous),
                    "holds on": self.holds,
                    "fails on": self.fails,
                },
            ],
        )

    def warnings(self) -> list[str]:
        """What the author of the formula should examine, ready to print: position, line and carets if it has a text."""
        found = []
        if self.because is not None:
            part, always = self.because
            text = "this task can never hold" if self.can_hold is False else "this task holds on every trace"
            if part is not self.formula:
                text += f": {_shown(part)} {'always' if always else 'never'} holds"
            found.append(_at(part, text))
        found.extend(str(vacuous) for vacuous in self.vacuous)
        if len(self.vacuous) > 1:
            found.append("each part is considered by itself: once one is removed, the others may matter")
        return found if self.status == "decided" else [*found, self.status]

    def data(self) -> dict[str, Any]:
        """The same as plain data, for JSON."""
        return {
            "can_hold": self.can_hold,
            "can_fail": self.can_fail,
            "holds": self.holds.data() if self.holds is not None else None,
            "fails": self.fails.data() if self.fails is not None else None,
            "shortest": self.shortest,
            "because": {**_place(self.because[0]), "always": self.because[1]} if self.because is not None else None,
            "vacuous": [vacuous.data() for vacuous in self.vacuous],
            "status": self.status,
        }


def _at(phi: Formula, message: str) -> str:
    return phi.span.show(message) if phi.span is not None else message


def _place(phi: Formula) -> dict[str, Any]:
    place = {"line": phi.span.line, "column": phi.span.column} if phi.span is not None else {}
    return {"part": str(phi), **place}


def _shown(phi: Formula) -> str:
    text = str(phi)
    return text if len(text) <= _LONGEST_TEXT else text[: _LONGEST_TEXT - 2] + " …"


# --------------------------------------------------------------------------------------------- the questions


def meaning(
    phi: Formula | Task, valuations: NDArray[np.bool_] | None = None, most_effort: int = MOST_EFFORT
) -> Meaning:
    """Whether φ can hold, whether it can fail, and which of its parts are vacuous.

    `valuations` (n, n_leaves) bool are the truth assignments of `leaves(φ)` that can occur at a step, such as those of
    the states of a model; by default, all that arithmetic allows. The search stops at `most_effort` states times
    letters; `status` reports what it left open. Raises StlSyntaxError for a formula without a horizon, and
    SettingsError for valuations of the wrong shape.
    """
    made = delayed(bounded_formula_of(phi, "meaning's formula"))
    phi = made.formula
    most_effort = whole(most_effort, "most_effort", least=0)
    if valuations is not None:
        valuations = truth_table(valuations, len(leaves(phi)), "leaves(formula)")
    n = sum(1 for _ in walk(phi))
    if n > _MOST_PLACES:
        status = f"not decided: the formula has {n} operators and operands, more than {_MOST_PLACES}"
        return Meaning(phi, None, None, None, None, False, None, (), status)
    return _Question(made, valuations, most_effort).answer()


class _Question:
    """One formula, the letters that it may read, and the remaining effort."""

    def __init__(self, made: Delayed, valuations: NDArray[np.bool_] | None, most_effort: int) -> None:
        self.phi = phi = made.formula
        self.shown = made.shown
        self.simple = simplify(phi)
        self.places = occurrences(phi)
        self.leaves = leaves(phi)
        self.columns: dict[Formula, int] = {leaf: i for i, leaf in enumerate(self.leaves)}
        if valuations is not None:
            self.valuations, self.complete = valuations, True
        else:
            self.valuations, self.complete = feasible_valuations(self.leaves, _MOST_VALUATIONS)
        self.samples = Samples(self.places, self.columns, self.valuations, horizon(phi) + 1)
        self.effort = Effort(most_effort)
        self._automata: dict[Formula, _Read | SizeError] = {}
        self._open: list[str] = []  # what is not decided

    def answer(self) -> Meaning:
        can, examples, shortest = self._extremes()
        because: tuple[Formula, bool] | None = None
        vacuous: tuple[VacuousPart, ...] = ()
        if False in can:
            part, value = self._smallest_constant(can[TRUE] is True)
            because = self.shown(part), value
        elif all(can):
            vacuous = self._vacuous()
        return Meaning(
            formula=self.phi,
            can_hold=can[TRUE],
            can_fail=can[FALSE],
            holds=examples[TRUE],
            fails=examples[FALSE],
            shortest=shortest,
            because=because,
            vacuous=vacuous,
            status="not decided: " + "; ".join(self._open) if self._open else "decided",
        )

    def _extremes(self) -> tuple[list[bool | None], list[Example | None], bool]:
        """For each verdict whether it can occur, and an example; and whether the examples are shortest."""
        both = (FALSE, TRUE)
        try:
            if isinstance(self.simple, Constant):
                can: list[bool | None] = [self.simple.value == verdict for verdict in both]
            else:
                reachable, letters = self._automaton(self.simple)
                can = [reachable.can_become(verdict) for verdict in both]
        except SizeError as refusal:
            can = [bool((self.samples.verdicts == verdict).any()) or None for verdict in both]
            words = [word for word, seen in zip(("fail", "hold"), can, strict=True) if not seen]
            self._open.extend(f"whether the task can {word}: {refusal}" for word in words)
            return can, [self._made_up(verdict) for verdict in both], False
        if not all(can):
            return can, [self._told(()) if sure else None for sure in can], True
        try:
            return can, [self._shortest(reachable, letters, verdict) for verdict in both], True
        except SizeError:
            return can, [self._made_up(verdict) for verdict in both], False

    def _shortest(self, reachable: ReachableVerdicts, letters: NDArray[np.int32], verdict: int) -> Example | None:
        runs = shortest_run(reachable, verdict, self.effort)
        return None if runs is None else self._told((int((letters == letter).argmax()), n) for letter, n in runs)

    def _made_up(self, verdict: int) -> Example | None:
        found = np.flatnonzero(self.samples.verdicts == verdict)
        return self._told((row, 1) for row in self.samples.letters[:, found[0]].tolist()) if found.size else None

    def _told(self, runs: Iterable[tuple[int, int]]) -> Example:
        """(row of the valuations, number of steps) as an example."""
        told: list[tuple[tuple[bool, ...], int]] = []
        for row, count in runs:
            truth = tuple(self.valuations[row].tolist())
            if told and told[-1][0] == truth:
                count += told.pop()[1]
            told.append((truth, count))
        return Example(tuple(map(self.shown, self.leaves)), tuple(told))

    # ------------------------------------------------------------------------------------------ automata

    def _automaton(self, phi: Formula) -> _Read:
        """The automaton of a simplified formula; SizeError with the reason if it is too large."""
        if phi not in self._automata:
            try:
                self._automata[phi] = self._compiled(phi)
            except SizeError as refusal:
                self._automata[phi] = refusal
        known = self._automata[phi]
        if isinstance(known, SizeError):
            raise known
        return known

    def _compiled(self, phi: Formula) -> _Read:
        if not self.complete:
            raise SizeError(f"its labels and comparisons have more than {_MOST_VALUATIONS} truth assignments")
        if temporal_depth(phi) > _DEEPEST:
            raise SizeError(f"it nests temporal operators {temporal_depth(phi)} deep, more than {_DEEPEST}")
        columns = [self._truth(psi) for psi in atoms_of(phi)]
        truth = np.stack(columns, axis=1) if columns else np.zeros((len(self.valuations), 0), dtype=np.bool_)
        occurring = np.unique(truth, axis=0)
        most = min(_MOST_STATES, self.effort.left // (2 * len(occurring)))  # half is reserved for the steps that follow
        if not most:
            self.effort.spend(2 * len(occurring))
        try:
            automaton = compile_automaton(phi, valuations=occurring, most_states=most)
        except SizeError:
            self.effort.spend(most * len(occurring))
            raise SizeError(f"its automaton has more than {most} states") from None
        self.effort.spend(sum(part.explored for part in automaton.parts) * len(occurring))
        letters = automaton.letters_at(truth)
        return ReachableVerdicts(automaton, letters, self.effort), letters

    def _truth(self, psi: Formula) -> NDArray[np.bool_]:
        """The truth of a formula without temporal operators under each valuation."""
        if isinstance(psi, Constant):
            return np.full(len(self.valuations), psi.value)
        if psi in self.columns:
            column: NDArray[np.bool_] = self.valuations[:, self.columns[psi]]
            return column
        if isinstance(psi, Comparison):  # rewriting derived it from its opposite
            return ~self._truth(Comparison(OPPOSITE[psi.op], psi.left, psi.right))
        return truth_along(psi, [self._truth(child) for child in children(psi)])

    def _differ(self, left: Formula, right: Formula) -> bool:
        """Whether two simplified formulas differ in meaning."""
        if isinstance(right, Constant):
            left, right = right, left
        if isinstance(left, Constant):
            if isinstance(right, Constant):
                return left != right
            return self._automaton(right)[0].can_become(FALSE if left.value else TRUE)
        if left == right:
            return False
        (reachable, letters), (others, other_letters) = self._automaton(left), self._automaton(right)
        return differ(reachable, others, letters, other_letters, self.effort)

    # ------------------------------------------------------------------------------------------ parts

    def _smallest_constant(self, value: bool) -> tuple[Formula, bool]:
        """The smallest part that explains why φ always has this value, and the value of that part."""
        phi = self.phi
        while True:
            operands = children(phi)
            for i, child in enumerate(operands):
                found = self._constant_value(child)
                if found is None:
                    continue
                unknown: list[Formula] = [
                    Label(str(j)) for j in range(len(operands))
                ]  # whatever the values of the others
                unknown[i] = Constant(found)
                if simplify(with_children(phi, tuple(unknown))) == Constant(value):
                    phi, value = child, found
                    break
            else:
                return phi, value

    def _constant_value(self, phi: Formula) -> bool | None:
        """The value of a formula that is constant on all traces; None otherwise, for constants, and if too large."""
        simple = simplify(phi)
        if isinstance(phi, Constant) or isinstance(simple, Constant):
            return None if isinstance(phi, Constant) else simple == Constant(True)
        try:
            reachable, _ = self._automaton(simple)
        except SizeError:
            return None
        can_hold = reachable.can_become(TRUE)
        return None if can_hold and reachable.can_become(FALSE) else can_hold

    def _vacuous(self) -> tuple[VacuousPart, ...]:
        """The largest vacuous occurrences."""
        answers: dict[int, VacuousPart | SizeError | None] = {}
        matters: set[int] = set()
        for i, place in enumerate(self.places):
            if isinstance(place.formula, Label | Comparison):
                answers[i] = self._check(i)
                above = place.parent if answers[i] is None and place.polarity else -1
                while above >= 0 and above not in matters:
                    matters.add(above)
                    above = self.places[above].parent
        found: list[VacuousPart] = []
        unknown: list[tuple[Formula, SizeError]] = []
        stack = [(i, False) for i in reversed(self.places[0].operands)]  # and whether it is inside an undecided one
        while stack:
            i, inside = stack.pop()
            place = self.places[i]
            if i not in matters and i not in answers and leaves(place.formula):
                answers[i] = self._check(i)
            answer = answers.get(i)
            if isinstance(answer, VacuousPart):
                found.append(answer)
                continue
            if answer is not None and not inside:
                unknown.append((place.formula, answer))
            stack.extend((j, inside or answer is not None) for j in reversed(place.operands))
        if unknown:
            others = f", and {len(unknown) - 1} other part{'s' if len(unknown) > 2 else ''}" if len(unknown) > 1 else ""
            self._open.append(f"whether {_shown(unknown[0][0])} is vacuous{others}: {unknown[0][1]}")
        return tuple(found)

    def _check(self, i: int) -> VacuousPart | SizeError | None:
        """The vacuous part at an occurrence; None if it is not vacuous, the SizeError if that is not decided."""
        place, refused = self.places[i], None
        for constant in (True, False):
            try:
                if self.samples.notice(i, constant, self.effort):
                    continue
                changed = self._changed(0, place.path, constant)
                try:
                    same = not self._differ(self.simple, changed)
                except SizeError as refusal:
                    same, refused = self._same_nearby(i, constant), refusal
            except SizeError as refusal:
                return refusal
            if same:
                uses = sum(other.formula is place.formula for other in self.places)
                return VacuousPart(self.shown(place.formula), place.path, uses, constant, self.shown(changed))
        return refused

    def _changed(self, i: int, path: tuple[int, ...], constant: bool) -> Formula:
        """Occurrence i with a constant at a path inside it, simplified."""
        self.effort.spend(len(self.places))
        return simplify(with_replaced(self.places[i].formula, path, Constant(constant)))

    def _same_nearby(self, i: int, constant: bool) -> bool:
        """Whether a part around occurrence i, small enough for an automaton, keeps its meaning with this constant."""
        path, around = self.places[i].path, i
        try:
            while around > 0:
                part = self.places[around]
                changed = self._changed(around, path[len(part.path) :], constant)
                if not self._differ(simplify(part.formula), changed):
                    return True
                around = part.parent
        except SizeError:
            pass
        return False
