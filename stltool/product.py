"""MDP × TaskAutomaton, never built as a matrix, with the way back from an index to the user's names.

A product state is a pair (s, q): model state s just read, automaton state q after reading it. Its index is s·|Q| + q.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import mapping, require, whole
from stltool.automata import (
    Encoding,
    JointAutomaton,
    Remembered,
    TaskAutomaton,
    Text,
    compile_automaton,
    join_automata,
)
from stltool.automata.compile import MOST_STATES, atoms_of
from stltool.automata.reach import reachable_pairs
from stltool.automata.reachable import decided_early
from stltool.display import Card, Displayed, counted
from stltool.errors import NameLookupError, SettingsError, near_misses
from stltool.logic.formula import (
    Composable,
    Formula,
    Label,
    bounded_formula_of,
    formula_of,
    label_names,
    variables,
)
from stltool.logic.names import near_names
from stltool.logic.shifts import has_delays
from stltool.logic.task import Task
from stltool.models import MDP
from stltool.models.sensing import Atom
from stltool.monitoring.states import truth
from stltool.monitoring.values import by_values
from stltool.sizes import require_memory
from stltool.source import Span


@dataclass(frozen=True, eq=False, repr=False)
class Product(Displayed):
    """The object that learners and checkers work on.

    letter        (n_model_states,) int32: the automaton's letter L(s) of each model state
    task_name     the name of the definition if the formula came from a task file
    definitions   the task file's formulas without temporal operators, which reports call by their names
    notes         comparisons of several steps, and the cases over values of the model that they were rewritten into
    """

    model: MDP
    automaton: TaskAutomaton
    letter: NDArray[np.int32]
    task_name: str = "formula"
    definitions: Mapping[str, Formula] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        require(self.model, MDP, "Product's model")
        require(
            self.automaton, TaskAutomaton, "Product's automaton", "build products by stl.build_product(model, task)"
        )
        require(self.letter, np.ndarray, "Product's letter", "build products by stl.build_product(model, task)")

    @property
    def formula(self) -> Formula:
        return self.automaton.formula

    @property
    def horizon(self) -> int:
        return self.automaton.horizon

    @property
    def shape(self) -> tuple[int, int]:
        """(model states, automaton states)"""
        return self.model.n_states, self.automaton.n_states

    @property
    def n_states(self) -> int:
        return self.shape[0] * self.shape[1]

    def where(self) -> dict[Formula, NDArray[np.bool_]]:
        """Where each of the automaton's atoms holds, (n_model_states,)."""
        model = self.model
        return {psi: truth(psi, model.signals, model.labels, model.n_states) for psi in self.automaton.atoms}

    def enter(self, s: int, q: int) -> int:
        """The automaton state after reading model state s in q."""
        return int(self.automaton.delta[self.letter[s], q])

    def describe(self, index: int, t: int | None = None) -> str:
        """A product state's index, in the user's names: state, signals, labels, automaton state."""
        s, q = divmod(whole(index, "a product state's index", 0, self.n_states - 1), self.automaton.n_states)
        return _place(self.model, s, self.automaton.describe(q), t)

    def _card(self) -> Card:
        model, automaton = self.model, self.automaton
        return Card(
            f"Product: {counted(model.n_states, 'model state')} x {counted(automaton.n_states, 'automaton state')}",
            [
                {"task": f"{self.task_name} := {self.formula}"},
                {"model": model.name, "horizon": self.horizon, "encoding": automaton.encoding},
            ],
        )


def first_verdicts(product: Product, states: NDArray[np.int64]) -> NDArray[np.int8]:
    """The verdicts once the first of these model states has been read (n,): TRUE, FALSE or UNDECIDED of each."""
    automaton = product.automaton
    verdicts: NDArray[np.int8] = automaton.verdicts(0)[automaton.delta[product.letter[states], automaton.initial]]
    return verdicts


@dataclass(frozen=True, eq=False, repr=False)
class JointProduct(Displayed):
    """Several tasks over one model, tracked together: the object that trade-offs work on.

    tasks     their products, with distinct names
    automaton the joint automaton, which also counts steps
    letter    (n_model_states,) int32: the joint letter of each model state
    """

    model: MDP
    tasks: tuple[Product, ...]
    automaton: JointAutomaton
    letter: NDArray[np.int32]

    def __post_init__(self) -> None:
        require(self.model, MDP, "JointProduct's model")
        require(
            self.automaton,
            JointAutomaton,
            "JointProduct's automaton",
            "build one: stl.build_joint_product(model, tasks)",
        )

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(task.task_name for task in self.tasks)

    @property
    def horizon(self) -> int:
        """The longest of the tasks' horizons."""
        return self.automaton.horizon

    @property
    def shape(self) -> tuple[int, int]:
        """(model states, states of the joint automaton)"""
        return self.model.n_states, self.automaton.n_states

    @property
    def n_states(self) -> int:
        return self.shape[0] * self.shape[1]

    def _card(self) -> Card:
        tasks = "; ".join(f"{task.task_name} := {task.formula}" for task in self.tasks)
        return Card(
            f"JointProduct: {counted(self.shape[0], 'model state')} x {counted(self.shape[1], 'joint state')}",
            [
                {"tasks": tasks},
                {"model": self.model.name, "horizon": self.horizon, "encoding": self.automaton.encoding},
            ],
        )

    def task(self, name: str) -> int:
        """The number of the task of that name; NameLookupError if there is none."""
        require(name, str, "a task's name")
        if name not in self.names:
            raise NameLookupError(f"there is no task {name}; {near_misses(name, self.names)}")
        return self.names.index(name)

    def describe(self, index: int, t: int | None = None) -> str:
        """As `Product.describe`."""
        s, q = divmod(whole(index, "a product state's index", 0, self.n_states - 1), self.automaton.n_states)
        return _place(self.model, s, self.automaton.describe(q), t)


def _place(model: MDP, s: int, memory: str, t: int | None) -> str:
    if t is not None:
        t = whole(t, "the step t", 0)
    signals = ", ".join(f"{name} = {values[s]:g}" for name, values in model.signals.items())
    labels = ", ".join(name for name, values in model.labels.items() if values[s])
    step = f"step {t}, " if t is not None else ""
    parts = [f"{step}state {model.state_name(s)}", signals, labels, memory]
    return "; ".join(part for part in parts if part)


def joined(task: Product, memory: Product | JointProduct) -> tuple[Product, NDArray[np.int64]]:
    """The product whose verdicts are `task`'s and whose states determine those of `memory` too; both of one model.

    Returns it with the memory's automaton state (n_states,) of each of its automaton states. With it, a policy that
    uses one automaton (the flags of [Wang24]) is evaluated by another automaton (the exact one).
    """
    pairs, letter = _distinct(
        [(letter, int(letter.max()) + 1) for letter in (task.letter, memory.letter)], task.model.n_states
    )
    left, right = task.automaton, memory.automaton

    def guard(n_states: int) -> None:
        require_memory(
            8 * n_states * (len(pairs) + 10),
            f"joining {left.n_states} task states with {right.n_states} states that the policy remembers",
            "check the policy with its own encoding",
        )

    q, m, delta = reachable_pairs(
        left.delta[pairs[:, 0]], right.delta[pairs[:, 1]], [(left.initial, right.initial)], guard
    )
    automaton = replace(
        left,
        valuations=np.empty((0, len(left.atoms)), dtype=np.bool_),
        letter_of=np.empty(0, dtype=np.int32),
        delta=delta,
        initial=int(np.flatnonzero((q == left.initial) & (m == right.initial))[0]),
        verdict_rows=np.ascontiguousarray(left.verdict_rows[:, q]),
        memory=Both(left, right, q, m),
        registers=np.empty((0, 0), dtype=np.int32),
        register_names=(),
    )
    return Product(task.model, automaton, letter, task.task_name, task.definitions), m


class Both:
    """What the states of two automata remember together; `right` is the one that a policy uses."""

    def __init__(
        self, left: TaskAutomaton, right: TaskAutomaton | JointAutomaton, q: NDArray[np.int64], m: NDArray[np.int64]
    ) -> None:
        self.left, self.right, self._q, self._m = left, right, q, m

    def __call__(self, q: int, text: Text = str) -> tuple[Remembered, ...]:
        own, other = int(self._q[q]), int(self._m[q])
        if isinstance(self.right, TaskAutomaton):
            kept = self.right.memory(other, text)
        else:
            kept = (Remembered(self.right.describe(other), rank=other),)
        policys = (replace(one, phrase=f"the policy: {one.phrase}", subject="") for one in kept)
        return (*self.left.memory(own, text), *policys)


def with_early_verdicts(product: Product) -> Product:
    """`product` with verdicts as soon as no sequence of its model's states can change them (`decided_early`).

    They are those of the task, whatever automaton decides it: an automaton may decide later than it could.
    """
    return replace(product, automaton=decided_early(product.automaton, product.letter))


def with_outcome(product: Product, model: MDP, verdict: int) -> Product:
    """`product` over `model`: its states and one more, the last, that decides the task as `verdict` when entered.

    A model that knows only part of what may happen sends the rest there: FALSE where the rest is feared, TRUE where it
    is hoped for. The automaton gets one more letter and one more state, the last ones (`TaskAutomaton.with_outcome`).
    It decides runs as early as the letters allow (`decided_early`): nothing need be known about the steps after that.
    """
    letter = np.append(product.letter, np.int32(product.automaton.n_letters))
    automaton = with_early_verdicts(product).automaton.with_outcome(verdict)
    return replace(product, model=model, automaton=automaton, letter=letter)


def build_product(
    model: MDP,
    task: Formula | Task,
    encoding: Encoding = "exact",
    memory_limit: int | None = None,
    most_states: int = MOST_STATES,
) -> Product:
    """Bind a formula's names to a model and compile it to an automaton over the letters that occur there.

    `encoding` is "exact" (every bounded formula), "paper" (the paper's flags), "history" (the τ-MDP) "running" (it
    judges every step, for questions about runs that go on for ever) or "safety" (at every step until one fails).
    `memory_limit` in bytes (default: four fifths of
    the free memory), `most_states` an automaton may have. Raises NameLookupError for a label or signal that the model
    does not have, FragmentError when the encoding does not cover the formula, SizeError before allocating what would
    not fit.
    """
    require(model, MDP, "build_product's model")
    formula = bounded_formula_of(task, "build_product's task")
    name, named = (task.name, task.predicates) if isinstance(task, Task) else ("formula", {})
    sensing = model.sensing
    earlier = itertools.takewhile(lambda known: known != name, task.definitions) if isinstance(task, Task) else ()
    require_names(model, formula, task if isinstance(task, Task) else None, tuple(earlier))
    if sensing is not None and has_delays(formula):
        raise SettingsError(
            f"{model.name} is a black box with real signals, which have no finite set of values; a comparison of "
            "several steps, such as x[t+1] - x[t] > 0, needs one: record the difference as a signal of its own"
        )
    formula, cases = by_values(formula, model.signals)
    atoms = atoms_of(formula, encoding)
    if sensing is not None:
        model, told, code = sensing.bound(model, list(map(_sensed, atoms)))
        automaton = compile_automaton(formula, encoding, told, memory_limit, most_states)
        return Product(model, automaton, automaton.letter_of[code], name, named)
    require_memory(
        model.n_states * 24,
        f"reading {len(atoms)} predicates in {model.n_states} states",
        "coarsen the grid",
        memory_limit,
    )
    values = ((truth(psi, model.signals, model.labels, model.n_states), 2) for psi in atoms)
    valuations, which = _distinct(values, model.n_states)
    automaton = compile_automaton(formula, encoding, valuations != 0, memory_limit, most_states)
    return Product(model, automaton, automaton.letter_of[which], name, named, tuple(map(str, cases)))


def require_names(model: MDP, formula: Formula, task: Task | None, definitions: Sequence[str]) -> None:
    """NameLookupError if the model lacks a name of the formula, or if the task defines one that the model has.

    `definitions` are those of the file that the formula could have used: one of them may have been meant.
    """
    sensing = model.sensing
    labels = model.labels if sensing is None else sensing.labels
    signals = model.signals if sensing is None else sensing.signals
    for wanted, known, other, kind, remedy in (
        (label_names(formula), labels, signals, "label", "compare it with a number"),
        (variables(formula), signals, labels, "signal", "use it without comparing"),
    ):
        _require_names(wanted, known, other, definitions, kind, remedy, model.notes)
    if task is None:
        return
    for own in (*task.params, *task.definitions):
        if own in labels or own in signals:
            raise NameLookupError(
                f"{task.path or task.name}: {own} is defined in the task, and the model has a "
                f"{'label' if own in labels else 'signal'} of that name; rename the one in the task"
            )


def _sensed(psi: Formula) -> Atom:
    """An atom of a task that is read from real signals, one sample after another."""

    def holds(signals: Mapping[str, float], labels: Mapping[str, bool]) -> bool:
        one_signal = {name: np.array([value]) for name, value in signals.items()}
        return bool(truth(psi, one_signal, {name: np.array([value]) for name, value in labels.items()}, 1)[0])

    return Atom(str(psi), holds, psi.name if isinstance(psi, Label) else None)


def build_joint_product(
    model: MDP,
    tasks: Sequence[Task] | Mapping[str, Formula | Task],
    encoding: Encoding = "exact",
    memory_limit: int | None = None,
) -> JointProduct:
    """Bind several tasks to one model and track them together.

    `tasks` are named by their definitions, or by the mapping. Raises SettingsError if two have the same name, SizeError
    before allocating what would not fit, and what `build_product` raises for each.
    """
    require(model, MDP, "build_joint_product's model")
    if model.sensing is not None:
        raise SettingsError(
            f"{model.name} is a black box with real signals, whose states are those of one task; build a product "
            "of each"
        )
    named: list[tuple[str, Formula | Task]]
    if isinstance(tasks, Mapping):
        named = list(mapping(tasks, "build_joint_product's tasks", "{'patrol': formula}").items())
        for name, task in named:
            formula_of(task, f"build_joint_product's task {name}")
    else:
        require(tasks, (list, tuple), "build_joint_product's tasks", "give a list of tasks, or {name: formula}")
        for task in tasks:
            if isinstance(task, Composable) and not isinstance(task, Task):
                raise SettingsError(f"{task} has no name; give tasks as a mapping from names to formulas")
            require(task, Task, "one of build_joint_product's tasks")
        named = [(task.name, task) for task in tasks]
    if not named:
        raise SettingsError("there is no task to trade off; give at least one")
    names = [name for name, _ in named]
    for name in names:
        if names.count(name) > 1:
            raise SettingsError(f"two tasks are called {name}; give them distinct names, for example in a mapping")
    products = tuple(
        replace(build_product(model, task, encoding, memory_limit), task_name=name) for name, task in named
    )
    letters, letter = _distinct([(each.letter, each.automaton.n_letters) for each in products], model.n_states)
    automaton = join_automata([product.automaton for product in products], letters, memory_limit)
    return JointProduct(model, products, automaton, letter)


_FEW_CODES = 4096


def _distinct(
    columns: Iterable[tuple[NDArray[Any], int]], n_states: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The distinct rows of a table, in lexicographic order, and for each state (n_states,) the index of its row.

    columns   (n_states,) each, of integers from 0, with the number of values that it may have. They are processed one
              after another: sorting the table takes much longer.
    """
    rows: NDArray[np.int32] = np.zeros((1, 0), dtype=np.int32)
    which: NDArray[Any] = np.zeros(n_states, dtype=np.int32)
    for values, n in columns:
        code = which.astype(np.int64) * n + values
        if len(rows) * n <= 2 * n_states + _FEW_CODES:
            seen = np.zeros(len(rows) * n, dtype=np.bool_)
            seen[code] = True
            places, which = np.flatnonzero(seen), (np.cumsum(seen, dtype=np.int32) - 1)[code]
        else:
            places, which = np.unique(code, return_inverse=True)
        rows = np.column_stack([rows[places // n], places % n]).astype(np.int32)
    return rows, which.astype(np.int32, copy=False)


def _require_names(
    wanted: Mapping[str, Span | None],
    known: Collection[str],
    other: Collection[str],
    definitions: Sequence[str],
    kind: str,
    remedy: str,
    notes: Mapping[str, str],
) -> None:
    for name, span in wanted.items():
        if name not in known:
            if name in other:
                message = (
                    f"{name} is not a {kind} of the model but a {'signal' if kind == 'label' else 'label'}; {remedy}"
                )
            else:
                note = f"; {notes[kind]}" if kind in notes else ""
                hint = near_names(name, [*known, *other, *definitions])
                if not hint.startswith("did you mean"):
                    hint = near_names(name, [*known, *other])
                    hint += f"; definitions of the file: {', '.join(definitions)}" if definitions else ""
                message = f"the model has no {kind} {name}; {hint}{note}"
            raise NameLookupError(span.show(message) if span is not None else message)
