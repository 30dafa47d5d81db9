"""The product of a model and a task as an MDP of its own, or as a Markov chain under a policy: only what runs reach.

A state is (t, s, m): the step as far as it matters (clock.py), the model state just read, and the state of the memory
(memory.py). Label `satisfied` holds where the task is decided as true, `violated` where as false; such states stay as
they are. A model that starts in several states gets one before all others, from which its first states are drawn.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import flag
from stltool.automata import FALSE, TRUE, UNDECIDED
from stltool.checking.check import undefined
from stltool.display import Card, Displayed, StateNames, counted, listed
from stltool.exporting.clock import Clock, clock_of
from stltool.exporting.memory import Memory, memory_of
from stltool.exporting.words import LABELS, Names
from stltool.logic.printer import with_names
from stltool.models import MDP, Intervals
from stltool.models.fractions import LARGEST_SUM, Integers, Shares, doubles_of, over_one
from stltool.models.rows import Rows, Stored, spans, starts
from stltool.policy import Policy, require_door
from stltool.product import Product
from stltool.sizes import require_memory, require_numbered

I64 = NDArray[np.int64]

_BYTES_A_STATE, _BYTES_AN_ENTRY = 160, 100
_SMALLER = "shorten the windows, or coarsen the model"
_LARGEST = 2**31 - 1  # values of variables


@dataclass(frozen=True)
class Question:
    """A property of the exported model, as PRISM and Storm read it; the probability of the task is its value, with
    `complement` 1 minus its value."""

    property: str
    complement: bool = False

    def __str__(self) -> str:
        return f"1 - x, where x is {self.property}" if self.complement else self.property


@dataclass(frozen=True, eq=False, repr=False)
class StateVariables(Displayed):
    """Integer variables that identify a model state; `values` (n_model_states, n_variables); `note`: what they mean."""

    names: tuple[str, ...]
    values: I64
    note: str

    def _card(self) -> Card:
        return Card(f"StateVariables: {listed(self.names)}", [{"note": self.note or None}])


@dataclass(frozen=True, eq=False)
class Vocabulary:
    """The names in an exported model.

    step, begun          variables: the step, and whether the first state has been drawn; None: there is none
    satisfied, violated  labels
    labels               label of the product's model → its name as an identifier
    variables            names of variables and formulas that are in use
    """

    step: str | None
    begun: str | None
    satisfied: str
    violated: str
    labels: Mapping[str, str]
    variables: Names = field(repr=False)


@dataclass(frozen=True, eq=False, repr=False)
class ProductMDP(Displayed):
    """A product, built state by state (see the module's text), and what it means.

    product        the product;  policy  if it is a chain: the policy, whose choices are the only ones
    followed       the product whose automaton is followed: that of a policy that remembers more too
    model          the MDP; its signals are the variables below and the signals of the product's model
    step, state, memory  (n,) of each state: the step (at most `clock.last`), the model state, the state of
                   `remembered`; all −1 in the state before the first, which is state 0 if there is one
    clock          how far steps are counted;  remembered  what is remembered;  of_state  what identifies a model state
    """

    product: Product
    policy: Policy | None
    followed: Product
    model: MDP
    step: I64 = field(repr=False)
    state: I64 = field(repr=False)
    memory: I64 = field(repr=False)
    clock: Clock
    remembered: Memory
    of_state: StateVariables
    names: Vocabulary

    def _card(self) -> Card:
        what = "MDP" if self.policy is None else "Markov chain"
        sizes = f"{counted(self.model.n_states, 'state')}, {counted(self.model.n_transitions, 'transition')}"
        return Card(
            f"ProductMDP: {what} of {sizes}",
            [
                {"task": f"{self.product.task_name} := {self.product.formula}"},
                {name: str(question) for name, question in self.questions.items()},
            ],
        )

    @cached_property
    def questions(self) -> dict[str, Question]:
        """The properties whose values are the probabilities of the task: "maximum" and "minimum" over all policies, or
        "policy"."""
        bound = self.clock.bound
        if bound is not None and self.names.begun is not None:
            bound += 1  # the step in which the first state is drawn
        within = "" if bound is None else f"<={bound}"
        complement = bound is not None and self.clock.rest == TRUE
        label = self.names.violated if complement else self.names.satisfied
        goal = f'"{label}"' if self.model.labels[label].any() else "false"  # not every format has labels of no state
        opposite = {"max": "min", "min": "max", "": ""}
        sides = {"policy": ""} if self.policy is not None else {"maximum": "max", "minimum": "min"}
        return {
            asked: Question(f"P{opposite[side] if complement else side}=? [ F{within} {goal} ]", complement)
            for asked, side in sides.items()
        }


def product_mdp(
    product: Product, policy: Policy | None = None, *, clock: bool = False, memory_limit: int | None = None
) -> ProductMDP:
    """The product of a model and a task as an MDP of its own, under `policy` as a Markov chain: only what runs reach.

    clock         count steps in the states up to the horizon, so that the properties that ask for P have no bound; by
                  default steps are counted as far as verdicts, and the policy, depend on them
    memory_limit  in bytes; default: four fifths of the free memory

    `model` of the result is an `MDP`, `questions` are the properties for Storm and PRISM. Interval probabilities stay
    intervals. Raises SettingsError if probabilities are unknown, or depend on a parameter without a value; PolicyError
    if the policy defines no action somewhere; SizeError before allocating what would not fit.
    """
    require_door("product_mdp", product, policy)
    clock = flag(clock, "product_mdp's clock")
    model = product.model
    model.require_probabilities()
    if model.parameters or (policy is not None and not policy.deterministic):
        model.require_points()
    return _Build(product, policy, clock, memory_limit).built()


@dataclass(frozen=True, eq=False)
class _Fan:
    """The choices of the undecided among some states, and where they lead.

    position  (n,) of each undecided state among them
    owner     (c,) the undecided state of each choice; choice (c,) its number in the model
    row       (c + 1,) its entries: entry (e,) in `rows`, to the state with the code child (e,)
    weight    (c,) the policy's, if it mixes
    """

    position: I64
    owner: I64
    choice: I64
    row: I64
    rows: Rows
    entry: I64
    child: I64
    weight: NDArray[np.float64] | None


class _Build:
    """A product's states have the codes (t · n_model_states + s) · n_memories + m."""

    def __init__(self, product: Product, policy: Policy | None, whole: bool, memory_limit: int | None) -> None:
        self.asked, self.policy, self.limit = product, policy, memory_limit
        self.product, self.judged = product, policy
        if policy is not None:
            self.product, self.judged = policy.on(product)
        self.model, automaton, h = product.model, self.product.automaton, product.horizon
        least = self.judged.form.alike(h - 1)[0] if self.judged is not None and h else 0
        self.clock = clock_of(automaton, least, whole)
        names, labels = Names(), Names(LABELS)
        names.keep([*self.model.signals, *self.model.labels, "satisfied", "violated"])
        self.of_state = state_variables(self.model, names)
        self.first = np.flatnonzero(self.model.initial)
        self.memory = memory_of(automaton, self.clock, with_names(product.definitions), names)
        self.names = Vocabulary(
            step=names.of("step") if self.clock.last else None,
            begun=names.of("begun") if len(self.first) > 1 else None,
            labels={name: labels.of(name) for name in self.model.labels},
            satisfied=labels.of("satisfied"),
            violated=labels.of("violated"),
            variables=names,
        )
        self.n_memories = len(self.memory)
        self.per_step = self.model.n_states * self.n_memories
        self.verdicts = [(last, self.memory.verdicts(row)) for _, last, row in self.clock.stretches]
        self.rows = self.model.some_rows()
        if (self.clock.last + 1) * self.per_step >= 2**62:
            self._require(0, 0, float((self.clock.last + 1) * self.per_step))

    def _require(self, n_states: int, n_entries: int, at_least: float = 0) -> None:
        """SizeError if so many states, and entries of rows, would not fit."""
        sizes = f"{self.model.n_states} model states, {self.n_memories} of memory and {self.clock.last + 1} steps"
        bytes_ = _BYTES_A_STATE * max(n_states, at_least) + _BYTES_AN_ENTRY * n_entries
        reached = f", of which at least {n_states} states are reached," if n_states else ""
        require_memory(bytes_, f"the product of {sizes}{reached} as an MDP", _SMALLER, self.limit)
        require_numbered(n_states, "product states", _SMALLER)

    # ------------------------------------------------------------------------------------------------- exploring

    def _split(self, codes: I64) -> tuple[I64, I64, I64]:
        step, rest = np.divmod(codes, self.per_step)
        s, m = np.divmod(rest, self.n_memories)
        return step, s, m

    def verdict(self, step: I64, m: I64) -> NDArray[np.int8]:
        found = np.empty(len(step), dtype=np.int8)
        first = 0
        for last, verdicts in self.verdicts:
            there = (step >= first) & (step <= last)
            found[there], first = verdicts[m[there]], last + 1
        return found

    def _entered(self) -> I64:
        """The codes of the states that runs start in."""
        letter = self.product.letter[self.first]
        codes: I64 = self.first * self.n_memories + self.memory.entry[letter].astype(np.int64)
        return codes

    def reached(self) -> I64:
        """The codes of all states, ascending."""
        frontier = seen = np.unique(self._entered())
        n_entries = 0
        while len(frontier):
            self._require(len(seen) + len(frontier), n_entries + self.rows.widest * len(frontier))
            fan = self.fan(frontier)
            n_entries += len(fan.child)
            after = np.unique(fan.child)
            place = np.minimum(np.searchsorted(seen, after), len(seen) - 1)
            frontier = after[seen[place] != after]
            seen = np.union1d(seen, frontier) if len(frontier) and frontier[0] < seen[-1] else np.append(seen, frontier)
        return seen

    def fan(self, codes: I64) -> _Fan:
        step, s, m = self._split(codes)
        position = np.flatnonzero(self.verdict(step, m) == UNDECIDED)
        step, s, m = step[position], s[position], m[position]
        numbers = self.rows.at(s)  # which may compute more rows
        rows = self.rows.rows.some(numbers)
        owner, number, weight = self._taken(rows, step, s, m)
        first, end = rows.row_start[number], rows.row_start[number + 1]
        entry = spans(first, end)
        of = np.repeat(np.arange(len(owner)), end - first)
        ends = rows.intervals
        possible = (rows.probability if ends is None else ends.upper)[entry] > 0
        entry, of = entry[possible], of[possible]
        target, state = rows.target[entry].astype(np.int64), owner[of]
        m_ahead = self.memory.delta[self.product.letter[target], m[state]]
        t_ahead = np.minimum(step[state] + 1, self.clock.last)
        child = t_ahead * self.per_step + target * self.n_memories + m_ahead
        choice = self.model.choice_start[s[owner]] + number - rows.choice_start[owner]
        row = np.searchsorted(of, np.arange(len(owner) + 1))
        return _Fan(position, owner, choice, row, rows, entry, child, weight)

    def _taken(self, rows: Rows, step: I64, s: I64, m: I64) -> tuple[I64, I64, NDArray[np.float64] | None]:
        """The choices that count: the state of each, its number in the rows, and its weight if they are mixed."""
        if self.judged is None:
            number = np.arange(len(rows.row_start) - 1)
            return np.repeat(np.arange(len(s)), np.diff(rows.choice_start)), number, None
        form, q, last = self.judged.form, self.memory.state[m], self.asked.horizon - 1
        width = self.model.most_choices
        taken: NDArray[Any] = np.zeros((len(s), width)) if not form.deterministic else np.zeros(len(s), dtype=np.int64)
        for t in np.unique(step).tolist():
            there = step == t
            taken[there] = form.at(min(t, last), s[there], q[there])
        if form.deterministic:
            if (taken < 0).any():
                raise undefined(self.product, self.judged)
            return np.arange(len(s)), rows.choice_start[:-1] + taken, None
        owner, i = np.nonzero(taken > 0)
        return owner, rows.choice_start[owner] + i, taken[owner, i]

    # ------------------------------------------------------------------------------------------------- the model

    def built(self) -> ProductMDP:
        codes = self.reached()
        step, s, m = self._split(codes)
        verdict = self.verdict(step, m)
        before = self.names.begun is not None
        if before:
            step, s, m = (np.concatenate([[-1], column]) for column in (step, s, m))
        with_before = np.concatenate([np.full(int(before), UNDECIDED), verdict])
        model = MDP(
            self._source(codes, verdict == UNDECIDED, before),
            initial=self._initial(codes, before),
            signals=self._signals(step, s, m),
            labels={
                **{self._label(name): holds[s] & (s >= 0) for name, holds in self.model.labels.items()},
                self.names.satisfied: with_before == TRUE,
                self.names.violated: with_before == FALSE,
            },
            action_names=self._actions(),
            state_names=StateNames(len(step), lambda i: self._name(int(step[i]), int(s[i]), int(m[i]))),
            name=f"{self.model.name} x {self.asked.task_name}",
        )
        return ProductMDP(
            self.asked, self.policy, self.product, model, step, s, m, self.clock, self.memory, self.of_state, self.names
        )

    def _label(self, name: str) -> str:
        """A label of the model; the product's own initial state, and deadlocks, are marked otherwise."""
        return self.names.labels[name] if name in ("init", "deadlock") else name

    def _initial(self, codes: I64, before: bool) -> NDArray[np.float64]:
        initial = np.zeros(len(codes) + before)
        initial[0 if before else np.searchsorted(codes, self._entered()[0])] = 1.0
        return initial

    def _actions(self) -> tuple[str, ...]:
        """The model's, one for decided states, one for the state before the first, and one for mixtures."""
        actions = Names(frozenset(self.model.action_names))
        return (*self.model.action_names, *(actions.of(name) for name in ("end", "start", "policy")))

    def _name(self, step: int, s: int, m: int) -> str:
        if s < 0:
            return "before the first state"
        index = s * self.product.automaton.n_states + int(self.memory.state[m])
        known = step < self.clock.last or step == self.asked.horizon
        return self.product.describe(index, step if known else None)

    def _signals(self, step: I64, s: I64, m: I64) -> dict[str, NDArray[np.float64]]:
        """The variables, and the model's signals; in the state before the first, those of the first state."""
        first, (entered, *_) = s < 0, self._entered()
        at = self._split(np.array([entered]))
        step, s, m = (np.where(first, value, column) for value, column in zip(at, (step, s, m), strict=True))
        found: dict[str, NDArray[Any]] = {name: values[s] for name, values in self.model.signals.items()}
        found |= {name: self.of_state.values[s, i] for i, name in enumerate(self.of_state.names)}
        found |= {one.name: self.memory.values[m, i] for i, one in enumerate(self.memory.variables)}
        found |= {self.names.step: step} if self.names.step is not None else {}
        found |= {self.names.begun: ~first} if self.names.begun is not None else {}
        return {name: values.astype(np.float64) for name, values in found.items()}

    def _source(self, codes: I64, open_: NDArray[np.bool_], before: bool) -> Stored:
        fan, n = self.fan(codes), len(codes)
        end = len(self.model.action_names)
        if fan.weight is None:
            owner, action = fan.position[fan.owner], self.model.choice_action[fan.choice].astype(np.int64)
            row, child, values = fan.row, fan.child, _Values.of(fan.rows, fan.entry)
        else:
            owner, action = fan.position, np.full(len(fan.position), end + 2)
            row, child, values = _mixed(fan)
        decided = np.flatnonzero(~open_)
        first = self.first if before else np.empty(0, dtype=np.int64)
        pieces: list[tuple[I64, Any, I64]] = [  # the state of each choice, its action, its length
            (np.full(int(before), -1), end + 1, np.full(int(before), len(first))),
            (owner, action, np.diff(row)),
            (decided, end, np.ones(len(decided), dtype=np.int64)),
        ]
        state = np.concatenate([one[0] for one in pieces])
        actions = np.concatenate([np.broadcast_to(one[1], one[0].shape) for one in pieces])
        begin = starts(np.concatenate([one[2] for one in pieces]))
        child = np.concatenate([self._entered()[: len(first)], child, codes[decided]])
        values = values.between(self._shares() if before else None, len(decided))
        order = np.argsort(state, kind="stable")
        entry = spans(begin[order], begin[order + 1])
        target = np.searchsorted(codes, child[entry]) + before
        choice_start = starts(np.bincount(state + before, minlength=n + before))
        require_numbered(len(order), "choices of product states", _SMALLER)
        row_start = starts(np.diff(begin)[order])
        return values.stored(choice_start, actions[order].astype(np.int32), row_start, target, entry)

    def _shares(self) -> tuple[NDArray[np.float64], list[Fraction]]:
        """The probabilities of the first states, in doubles and exactly."""
        return self.model.initial[self.first], [self.model.initial_share(s) for s in self.first.tolist()]


@dataclass(frozen=True, eq=False)
class _Values:
    """The probabilities of entries: doubles, and if known exactly numerators over a denominator, or intervals."""

    probability: NDArray[np.float64]
    numerator: Integers | None
    denominator: int
    lower: NDArray[np.float64] | None
    upper: NDArray[np.float64] | None

    @classmethod
    def of(cls, rows: Rows, entry: I64) -> _Values:
        exact, ends = rows.given_exactly and rows.intervals is None, rows.intervals
        return cls(
            rows.probability[entry],
            rows.numerator[entry] if exact else None,
            rows.denominator if exact else 1,
            ends.lower[entry] if ends is not None else None,
            ends.upper[entry] if ends is not None else None,
        )

    def between(self, first: tuple[NDArray[np.float64], list[Fraction]] | None, n_last: int) -> _Values:
        """With those of the first states before, and n_last times 1 after."""
        doubles, shares = first if first is not None else (np.empty(0), [])
        one = np.ones(n_last)
        numerator, denominator = self.numerator, self.denominator
        if numerator is not None:
            denominator = math.lcm(denominator, *(share.denominator for share in shares))
            begin = np.array([int(share * denominator) for share in shares], dtype=object)
            middle, last = numerator.astype(object) * (denominator // self.denominator), np.full(n_last, denominator)
            numerator = np.concatenate([begin, middle, last])
            if denominator < LARGEST_SUM:
                numerator = numerator.astype(np.int64)
        probability = np.concatenate([doubles, self.probability, one])
        if self.lower is None or self.upper is None:
            return _Values(probability, numerator, denominator, None, None)
        ends = (np.concatenate([doubles, column, one]) for column in (self.lower, self.upper))
        return _Values(probability, None, 1, *ends)

    def stored(
        self, choice_start: I64, choice_action: NDArray[np.int32], row_start: I64, target: I64, entry: I64
    ) -> Stored:
        exact = Shares(self.numerator[entry], self.denominator) if self.numerator is not None else None
        intervals = None
        if self.lower is not None and self.upper is not None:
            intervals = Intervals(self.lower[entry], self.upper[entry], rounded=True)
        return Stored(
            choice_start, choice_action, row_start, target.astype(np.int32), self.probability[entry], exact, intervals
        )


def _mixed(fan: _Fan) -> tuple[I64, I64, _Values]:
    """The rows of a policy that mixes choices, one for each undecided state: weights are in proportion to the doubles
    given. (row, child, values) as in a fan."""
    rows, denominator = fan.rows, fan.rows.denominator
    assert fan.weight is not None
    numerator, child, weight = rows.numerator[fan.entry].tolist(), fan.child.tolist(), fan.weight.tolist()
    begin, bounds = np.searchsorted(fan.owner, np.arange(len(fan.position) + 1)).tolist(), fan.row.tolist()
    lengths: list[int] = []
    children: list[int] = []
    shares: list[Fraction] = []
    for first, end in itertools.pairwise(begin):
        total = sum(map(Fraction, weight[first:end]), Fraction(0))
        found: dict[int, Fraction] = {}
        for c in range(first, end):
            for k in range(bounds[c], bounds[c + 1]):
                share = Fraction(weight[c]) / total * Fraction(numerator[k], denominator)
                found[child[k]] = found.get(child[k], Fraction(0)) + share
        lengths.append(len(found))
        children += sorted(found)
        shares += (found[code] for code in sorted(found))
    exact, one = over_one(shares)
    values = _Values(doubles_of(exact, one) if len(shares) else np.empty(0), exact, one, None, None)
    return starts(np.array(lengths, dtype=np.int64)), np.array(children, dtype=np.int64), values


def state_variables(model: MDP, names: Names) -> StateVariables:
    """Integer variables that identify a model state: signals that are integers, the cell of a grid, or its number."""
    integers = {
        name: values.astype(np.int64)
        for name, values in model.signals.items()
        if (np.abs(values) <= _LARGEST).all() and (values == np.round(values)).all() and values.min() < values.max()
    }
    if integers:
        table = np.stack(list(integers.values()), axis=1)
        if len(np.unique(table, axis=0)) == model.n_states:
            return StateVariables(tuple(map(names.same, integers)), table, "")
    layout = model.layout
    if layout is not None and min(layout.width, layout.height) > 0:
        columns = {"column": layout.column, "row": layout.row}
        kept = {name: values for name, values in columns.items() if values.min() < values.max()} or columns
        table = np.stack(list(kept.values()), axis=1).astype(np.int64)
        return StateVariables(tuple(map(names.of, kept)), table, _grid_note(model, columns))
    number = np.arange(model.n_states, dtype=np.int64)[:, None]
    return StateVariables((names.of("state"),), number, "")


def _grid_note(model: MDP, columns: Mapping[str, I64]) -> str:
    """Signals that are coordinates of cells, in terms of column and row."""
    notes = []
    for (name, values), (column, cells) in zip(model.signals.items(), columns.items(), strict=False):
        if cells.min() == cells.max():
            continue
        slope, start = np.polyfit(cells.astype(np.float64), values, 1)
        if np.allclose(values, start + slope * cells, atol=1e-9):
            notes.append(f"{name} = {start:.6g} + {slope:.6g} * {column}")
    return ", ".join(notes)
