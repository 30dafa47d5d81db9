"""A product, or its chain under a policy, as a program in the PRISM language that people can read.

One module. Its variables are those of `ProductMDP`: what identifies a model state, what the task remembers, the step.
There is a command for each choice of each model state, however many product states it is part of; the memory's next
value is an expression of its own, by what holds in the state that is entered. Under a policy a command names the
situations in which the policy takes it. Numbers are exact: Storm's exact engine and PRISM's read fractions and decimals
as such. Ranges and updates suit PRISM's symbolic engines, which look at states that no run reaches too.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.automata.graph import condition as formula_condition
from stltool.errors import SizeError
from stltool.exporting.explicit import ProductMDP
from stltool.exporting.memory import Variable
from stltool.exporting.words import Names, both, condition, piecewise, probability_text
from stltool.files import MARK
from stltool.logic.printer import with_names

MOST_BRANCHES = 200_000
"""More branches of commands than this are not written: a program is for reading, and tools take minutes over longer
ones."""


def to_prism(exported: ProductMDP) -> str:
    """The program. Raises SizeError if it would be too long to be of use."""
    return _Program(exported).text()


class _Program:
    def __init__(self, exported: ProductMDP) -> None:
        self.of, self.names = exported, exported.names
        variables = self.names.variables
        self.holds, self.fails, self.open = (variables.of(name) for name in ("holds", "fails", "open"))
        self.later = variables.of(f"{self.names.step}_next") if self.names.step is not None else ""
        actions = Names()
        self.actions = [actions.of(name) for name in exported.model.action_names]
        self.updates: list[dict[str, _Update]] = [{} for _ in exported.remembered.variables]
        self.acting = self._acting()

    # ------------------------------------------------------------------------------------------------- the whole

    def text(self) -> str:
        commands = list(self._commands())
        kind = "mdp" if self.of.policy is None else "dtmc"
        parts = [
            self._heading(),
            kind,
            "\n".join(self._next_values()),
            "\n".join(self._verdicts()),
            "\n".join(["module product", *self._variables(), "", *commands, "endmodule"]),
            "\n".join(self._labels()),
        ]
        return "\n\n".join(part for part in parts if part) + "\n"

    def _heading(self) -> str:
        product, model = self.of.product, self.of.model
        text = with_names(product.definitions)
        lines = [MARK, f"{product.task_name} := {text(product.formula)}"]
        lines += [f"  {name} := {phi}" for name, phi in product.definitions.items() if name != str(phi)]
        what = f"the product with {product.model.name}"
        if self.of.policy is not None:
            what += f", under a policy ({self.of.policy.kind})"
        lines.append(f"{what}: {model.n_states} states, {model.n_choices} choices, {model.n_transitions} transitions")
        asked = {"maximum": "maximum over all policies", "minimum": "minimum over all policies", "policy": "P"}
        lines += [f"{asked[name]}: {question}" for name, question in self.of.questions.items()]
        if model.uncertain:
            lines.append("probabilities are intervals: say how nature picks, in PRISM by Pmaxmin=? and the like")
        renamed = [
            f"{shown} is {json.dumps(name, ensure_ascii=False)}"
            for name, shown in zip(product.model.action_names, self.actions, strict=False)
            if name != shown
        ]
        lines += [f"actions: {', '.join(renamed)}"] if renamed else []
        return "\n".join(f"// {_one_line(line)}" for line in lines)

    # ------------------------------------------------------------------------------------------------- variables

    def _variables(self) -> Iterator[str]:
        of, first = self.of, int(np.flatnonzero(self.of.model.initial)[0])
        begun = self.names.begun
        if begun is not None:
            yield "  // whether the first state has been drawn"
            yield f"  {begun} : bool init false;"
        state = f"  // the state of {of.product.model.name}"
        yield _one_line(state + (f": {of.of_state.note}" if of.of_state.note else ""))
        known = of.model.signals
        for name in of.of_state.names:
            yield self._declared(name, known[name], first)
        for variable in of.remembered.variables:
            yield _one_line(f"  // {variable.what}:")
            for value, meaning in enumerate(variable.meanings):
                yield _one_line(f"  //   {value}  {meaning}")
            yield f"  {variable.name} : [0..{len(variable.meanings) - 1}] init {int(known[variable.name][first])};"
        if self.names.step is not None:
            last, horizon = of.clock.last, of.product.horizon
            yield f"  // steps since the start{'' if last == horizon else f', up to {last}'}"
            yield f"  {self.names.step} : [0..{last}] init 0;"

    @staticmethod
    def _declared(name: str, values: NDArray[Any], first: int) -> str:
        low, high = int(values.min()), int(values.max())
        return f"  {name} : [{low}..{max(high, low + 1)}] init {int(values[first])};"

    def _place(self, s: int) -> list[str]:
        of_state = self.of.of_state
        return [f"{name}={value}" for name, value in zip(of_state.names, of_state.values[s].tolist(), strict=True)]

    # -------------------------------------------------------------------------------------------------- commands

    def _acting(self) -> dict[int, list[int]]:
        """The undecided states of the exported model by their model state, without the one before the first."""
        of = self.of
        labels = of.model.labels
        decided = labels[self.names.satisfied] | labels[self.names.violated]
        found: dict[int, list[int]] = {}
        for i in np.flatnonzero(~decided & (of.state >= 0)).tolist():
            found.setdefault(int(of.state[i]), []).append(i)
        return found

    def _commands(self) -> Iterator[str]:
        model = self.of.model
        per_state = np.diff(model.row_start[model.choice_start])
        shown = [i for states in self.acting.values() for i in (states if self.of.policy is not None else states[:1])]
        n_branches = int(per_state[shown].sum())
        if n_branches > MOST_BRANCHES:
            raise SizeError(
                f"the program would have {n_branches} branches, and has at most {MOST_BRANCHES}; use DRN or UMB, or "
                "coarsen the model"
            )
        if self.names.begun is not None:
            (before,) = np.flatnonzero(model.initial).tolist()
            branches = self._branches(int(model.choice_start[before]), True)
            yield f"  [{self.actions[-2]}] !{self.names.begun} ->{branches};"
        for s, states in self.acting.items():
            guard = [self.open, *self._place(s)]
            if self.of.policy is None:
                for c in range(model.choice_start[states[0]], model.choice_start[states[0] + 1]):
                    yield self._command(c, guard)
            else:
                yield from self._chosen(states, guard)
        yield f"  [] {self.holds} | {self.fails} -> true;"

    def _chosen(self, states: list[int], guard: list[str]) -> Iterator[str]:
        """The commands of a model state under a policy, each with the situations in which it is taken."""
        of, model = self.of, self.of.model
        taken: dict[tuple[int, str], list[int]] = {}
        for i, state in enumerate(states):
            c = int(model.choice_start[state])
            model_states = of.state[model.target[model.row_start[c] : model.row_start[c + 1]]]
            key = int(model.choice_action[c]), str(list(zip(model_states.tolist(), self._shares(c), strict=True)))
            taken.setdefault(key, []).append(i)
        names = [variable.name for variable in of.remembered.variables]
        table = of.remembered.values[of.memory[states]].astype(np.int64)
        if self.names.step is not None:
            names, table = [self.names.step, *names], np.column_stack([of.step[states], table])
        for which in taken.values():
            inside = np.isin(np.arange(len(states)), which)
            yield self._command(int(model.choice_start[states[which[0]]]), guard, condition(names, table, inside))

    def _command(self, c: int, guard: list[str], where: str = "true") -> str:
        action = self.actions[self.of.model.choice_action[c]]
        return f"  [{action}] {both(*guard, where)} ->{self._branches(c)};"

    def _branches(self, c: int, starting: bool = False) -> str:
        model = self.of.model
        entries = range(model.row_start[c], model.row_start[c + 1])
        branches = [self._assigned(int(model.target[k]), starting) for k in entries]
        shares = self._shares(c)
        if shares == ["1"]:
            return f" {branches[0]}"
        width = max(map(len, shares))
        lines = [f"{share:{width}} : {branch}" for share, branch in zip(shares, branches, strict=True)]
        return "\n      " + "\n    + ".join(lines)

    def _shares(self, c: int) -> list[str]:
        rows = self.of.model.rows
        entries = range(rows.row_start[c], rows.row_start[c + 1])
        if rows.intervals is not None:
            ends = [(float(rows.intervals.lower[k]), float(rows.intervals.upper[k])) for k in entries]
            return ["1"] if ends == [(1.0, 1.0)] else [f"[{low!r}, {high!r}]" for low, high in ends]
        return [probability_text(Fraction(int(rows.numerator[k]), rows.denominator)) for k in entries]

    def _assigned(self, after: int, starting: bool) -> str:
        """The assignments that lead to a state of the exported model."""
        of, s = self.of, int(self.of.state[after])
        values = zip(of.of_state.names, of.of_state.values[s].tolist(), strict=True)
        parts = [f"({name}'={value})" for name, value in values]
        if starting:
            parts.insert(0, f"({self.names.begun}'=true)")
            known = zip(of.remembered.variables, of.remembered.values[of.memory[after]].tolist(), strict=True)
            return " & ".join([*parts, *(f"({variable.name}'={value})" for variable, value in known)])
        letter = int(of.followed.letter[s])
        for variable, updates in zip(of.remembered.variables, self.updates, strict=True):
            value = self._next(variable, updates, letter)
            parts += [f"({variable.name}'={value})"] if value != variable.name else []
        if self.names.step is not None:
            parts.append(f"({self.names.step}'={self.later})")
        return " & ".join(parts)

    # -------------------------------------------------------------------------------------------------- formulas

    def _next(self, variable: Variable, updates: dict[str, _Update], letter: int) -> str:
        """A variable's next value where this letter is read: itself, a number, or the name of a formula."""
        value = piecewise(variable.name, variable.update[letter].tolist())
        if value == variable.name or value.isdigit():
            return value
        if value not in updates:
            updates[value] = _Update(self.names.variables.of(f"{variable.name}_next"), set())
        updates[value].letters.add(letter)
        return updates[value].name

    def _next_values(self) -> Iterator[str]:
        automaton, text = self.of.followed.automaton, with_names(self.of.product.definitions)
        if any(self.updates) or self.later:
            yield "// what is remembered next, by what holds in the state that is entered"
        for updates in self.updates:
            for value, update in updates.items():
                where = ""
                if len(automaton.valuations):
                    where = _one_line(f"  // where {text(formula_condition(automaton, tuple(sorted(update.letters))))}")
                yield f"formula {update.name} = {value};{where}"

        if self.later:
            yield f"formula {self.later} = min({self.names.step}+1, {self.of.clock.last});"

    def _verdicts(self) -> Iterator[str]:
        yield "// whether the task is decided"
        for name, verdict in ((self.holds, TRUE), (self.fails, FALSE)):
            yield f"formula {name} = {self._decided(verdict)};"
        begun = [self.names.begun] if self.names.begun is not None else []
        yield f"formula {self.open} = {' & '.join([*begun, f'!{self.holds}', f'!{self.fails}'])};"

    def _decided(self, verdict: int) -> str:
        of, step = self.of, self.names.step
        names = [variable.name for variable in of.remembered.variables]
        pieces: list[tuple[int, int, str]] = []
        for first, last, verdicts in of.clock.stretches:
            what = condition(names, of.remembered.values, of.remembered.verdicts(verdicts) == verdict)
            if pieces and pieces[-1][2] == what:
                first = pieces.pop()[0]
            pieces.append((first, last, what))
        found = []
        for first, last, what in pieces:
            when = [f"{step}={first}"] if first == last else [f"{step}>={first}"] * (first > 0)
            when += [f"{step}<={last}"] * (first < last < of.clock.last)
            found.append(both(*when, what) if of.clock.last else what)
        known = [one for one in found if one != "false"]
        any_ = "true" if "true" in known else " | ".join(_bracketed(known)) or "false"
        return both(self.names.begun, any_) if self.names.begun is not None else any_

    def _labels(self) -> Iterator[str]:
        of = self.of
        yield f'label "{self.names.satisfied}" = {self.holds};'
        yield f'label "{self.names.violated}" = {self.fails};'
        visited = np.unique(of.state[of.state >= 0])
        begun = [self.names.begun] if self.names.begun is not None else []
        for label, name in self.names.labels.items():
            where = condition(of.of_state.names, of.of_state.values[visited], of.product.model.labels[label][visited])
            shown = f"  // {json.dumps(label, ensure_ascii=False)}" if name != label else ""
            yield f'label "{name}" = {both(*begun, where)};{_one_line(shown)}'


class _Update(NamedTuple):
    """A formula for a variable's next value, and the letters where it is that."""

    name: str
    letters: set[int]


def _bracketed(alternatives: list[str]) -> list[str]:
    """For a disjunction."""
    return [f"({one})" if "&" in one and len(alternatives) > 1 else one for one in alternatives]


def _one_line(text: str) -> str:
    return text.replace("\n", " ").replace("\r", " ")
