"""Policies that are functions: asked once in every situation that is reached, and remembered.

    stl.Policy.from_function(product, lambda here: "E" if "A" in here.labels else "stay")

A network, a planner, a rule: anything that can say what it would do. `check` asks it wherever runs under it can get, so
its probability is exact; a sampled run asks where it is. What was answered once is not asked again, so a function whose
answers change is judged by its first ones.
"""

from __future__ import annotations

import operator
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described, flag, require
from stltool.automata import UNDECIDED
from stltool.choices import Indices
from stltool.display import Card, Displayed
from stltool.errors import ArgumentError, PolicyError, near_misses
from stltool.models.rows import spans
from stltool.product import Product
from stltool.reached import reached_by

I64: TypeAlias = NDArray[np.int64]
_SUM = 1e-6  # by which weights may miss 1, in single precision, say; they are then scaled


@dataclass(frozen=True, slots=True)
class Situation:
    """What a policy function sees of an undecided run.

    step        steps taken so far;  to_go  steps until the horizon
    state       the model's state, by index;  name  by name
    signals     name → value;  labels  the names of those that hold
    memory      what is remembered of the run: the automaton's state, by index;  remembered  in words
    actions     the names of the available actions
    """

    step: int
    to_go: int
    state: int
    name: str
    signals: Mapping[str, float]
    labels: frozenset[str]
    memory: int
    remembered: str
    actions: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Situations:
    """Many undecided runs after the same number of steps, for functions that answer all at once.

    step, to_go     numbers, as in `Situation`
    state, memory   (n,) int64;  signals  name → (n,) float64;  labels  name → (n,) bool
    available       (n, A) bool: which of the model's actions each has
    """

    step: int
    to_go: int
    state: I64
    memory: I64
    signals: Mapping[str, NDArray[np.float64]]
    labels: Mapping[str, NDArray[np.bool_]]
    available: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.state)


class Asked(Displayed):
    """A form of choices (choices.py) that is a function: see `Policy.from_function`."""

    stationary = False

    def __init__(self, product: Product, function: Callable[[Any], Any], batched: bool, mixed: bool | None) -> None:
        require(product, Product, "from_function's product")
        if not callable(function):
            raise ArgumentError(
                f"from_function's function is {described(function)}, not a function; give one of a situation that "
                "returns an action"
            )
        self._product, self._function = product, function
        self._batched = flag(batched, "from_function's batched")
        self._known: dict[int, tuple[I64, NDArray[Any]]] = {}  # by step: codes s·Q + q ascending, and their answers
        self._lock = threading.Lock()
        self._walked = False
        self.deterministic = not (flag(mixed, "from_function's mixed") if mixed is not None else self._mixes())

    def _card(self) -> Card:
        kind = "choices" if self.deterministic else "mixtures"
        return Card(f"Asked: a function, {kind} in {sum(len(codes) for codes, _ in self._known.values())} situations")

    # --------------------------------------------------------------------------------------------- as a form

    def at(self, t: int, s: Indices, q: Indices) -> NDArray[Any]:
        wanted = np.asarray(s, dtype=np.int64) * self._product.automaton.n_states + q
        with self._lock:
            codes, answers = self._known.get(t, self._nothing)
            new = np.setdiff1d(wanted, codes)
            if len(new):
                found = self._ask(t, *np.divmod(new, self._product.automaton.n_states))
                order = np.argsort(np.concatenate([codes, new]), kind="stable")
                codes, answers = (np.concatenate(both)[order] for both in ((codes, new), (answers, found)))
                self._known[t] = codes, answers
        asked: NDArray[Any] = answers[np.searchsorted(codes, wanted)]
        return asked

    def row(self, t: int) -> NDArray[Any]:
        """Step t as a dense table, without a choice in situations that no run reaches."""
        self._walk()
        shape = self._product.shape
        table = np.full(shape[0] * shape[1], -1, dtype=self._product.model.choice_type)
        codes, answers = self._known.get(t, self._nothing)
        table[codes] = answers
        return table.reshape(shape)

    def alike(self, t: int) -> tuple[int, int]:
        return t, t

    def mixtures(self) -> NDArray[np.float64]:
        """Of the situations asked about so far: all that an answer can depend on."""
        asked = [answers for _, answers in self._known.values()] or [self._nothing[1]]
        rows: NDArray[np.float64] = np.unique(np.sort(np.concatenate(asked), axis=1), axis=0)
        return rows

    @property
    def _nothing(self) -> tuple[I64, NDArray[Any]]:
        empty = np.empty(0, dtype=np.int64)
        return empty, empty if self.deterministic else np.empty((0, self._product.model.most_choices))

    def _walk(self) -> None:
        """Ask about every situation that runs reach."""
        product, model = self._product, self._product.model
        if not self.deterministic or model.blackbox is not None:
            why = "mixes actions" if not self.deterministic else "acts in a black box, whose reach is not known"
            raise PolicyError(
                f"a policy function that {why} has no table; use it as it is, by `at`, or make the table yourself"
            )
        if self._walked:
            return
        reached_by(product, self, 2**60, 2**60)
        self._walked = True

    # ------------------------------------------------------------------------------------------------ asking

    def _mixes(self) -> bool:
        """Whether its answer in the first undecided situation of the model is weights."""
        product = self._product
        first = np.flatnonzero(product.model.initial)
        q = product.automaton.delta[product.letter[first], product.automaton.initial].astype(np.int64)
        open_ = np.flatnonzero(product.automaton.verdicts(0)[q] == UNDECIDED)[:1]
        if not len(open_):
            return False
        s, q = first[open_], q[open_]
        answer = self._call(0, s, q)
        weights = isinstance(answer, Mapping) or _shape(answer)[int(self._batched) :] == (product.model.n_actions,)
        self.deterministic = not weights
        self._known[0] = s * product.automaton.n_states + q, self._read(0, s, q, answer)
        return weights

    def _ask(self, t: int, s: I64, q: I64) -> NDArray[Any]:
        """The choices (n,) or weights (n, C) in situations that are new."""
        if self._batched:
            return self._read(t, s, q, self._call(t, s, q))
        each = [
            self._read(t, s[i : i + 1], q[i : i + 1], self._call(t, s[i : i + 1], q[i : i + 1])) for i in range(len(s))
        ]
        return np.concatenate(each)

    def _call(self, t: int, s: I64, q: I64) -> Any:
        here = self._situations(t, s, q) if self._batched else self.situation(t, int(s[0]), int(q[0]))
        try:
            return self._function(here)
        except Exception as error:  # any fault in there is the function's
            raise PolicyError(
                f"the policy function raised {type(error).__name__} at {self._place(t, s, q)}: {error}"
            ) from error

    def situation(self, t: int, s: int, q: int) -> Situation:
        """What the function sees in (t, s, q)."""
        model, automaton = self._product.model, self._product.automaton
        names = [model.action_names[a] for a in model.choice_action[model.choice_start[s] : model.choice_start[s + 1]]]
        return Situation(
            step=t,
            to_go=automaton.horizon - t,
            state=s,
            name=model.state_name(s),
            signals={name: float(values[s]) for name, values in model.signals.items()},
            labels=frozenset(name for name, holds in model.labels.items() if holds[s]),
            memory=q,
            remembered=automaton.describe(q),
            actions=tuple(names),
        )

    def _situations(self, t: int, s: I64, q: I64) -> Situations:
        model = self._product.model
        first, end = model.choice_start[s], model.choice_start[s + 1]
        available = np.zeros((len(s), model.n_actions), dtype=np.bool_)
        available[np.repeat(np.arange(len(s)), end - first), model.choice_action[spans(first, end)]] = True
        return Situations(
            step=t,
            to_go=self._product.horizon - t,
            state=s.copy(),
            memory=q.copy(),
            signals={name: values[s] for name, values in model.signals.items()},
            labels={name: holds[s] for name, holds in model.labels.items()},
            available=available,
        )

    # ---------------------------------------------------------------------------------------------- answers

    def _read(self, t: int, s: I64, q: I64, answer: Any) -> NDArray[Any]:
        """Answers as choices (n,), or as weights (n, C)."""
        if not self.deterministic:
            return self._weights(t, s, q, answer)
        answers: Sequence[Any] = [answer]
        if self._batched:
            if isinstance(answer, str) or len(_shape(answer)) != 1 or len(answer) != len(s):
                raise PolicyError(
                    f"the policy function returned {described(answer)} for {len(s)} situations; return an action for "
                    f"each: a list, or an array of shape ({len(s)},)"
                )
            answers = answer
        actions = [self._action(t, s[i : i + 1], q[i : i + 1], one) for i, one in enumerate(answers)]
        return self._choices(t, s, q, np.array(actions, dtype=np.int64))

    def _action(self, t: int, s: I64, q: I64, answer: Any) -> int:
        """The number of an action in the model; −1 for None, no action."""
        names = self._product.model.action_names
        if answer is None:
            return -1
        if isinstance(answer, str):
            if answer not in names:
                raise PolicyError(
                    f"the policy function returned {answer!r} at {self._place(t, s, q)}, which is not an action; "
                    f"{near_misses(answer, names)}"
                )
            return names.index(answer)
        try:
            if isinstance(answer, bool | np.bool_):
                raise TypeError
            number = operator.index(answer[0] if _shape(answer) == (1,) else answer)
        except TypeError:
            number = -1
        if not 0 <= number < len(names):
            weights = isinstance(answer, Mapping) or _shape(answer) == (len(names),)
            raise PolicyError(
                f"the policy function returned {described(answer)} at {self._place(t, s, q)}; return an action's name, "
                f"or its number, 0 … {len(names) - 1}{', or give mixed=True for weights' if weights else ''}"
            )
        return number

    def _certain(self, t: int, s: I64, q: I64, answer: Any) -> int:
        """The same where the function mixes actions: None is none of them."""
        if answer is None:
            raise PolicyError(
                f"the policy function returned None at {self._place(t, s, q)}; a function that mixes actions returns "
                "weights everywhere, or the name of one action"
            )
        return self._action(t, s, q, answer)

    @cached_property
    def _codes(self) -> tuple[I64, I64]:
        """s · A + action of every choice, ascending, and the choice of each: a file may list actions in any order."""
        model = self._product.model
        state = np.repeat(np.arange(model.n_states), np.diff(model.choice_start))
        codes = state * model.n_actions + model.choice_action
        order = np.argsort(codes)
        return codes[order], order

    def _choices(self, t: int, s: I64, q: I64, actions: I64) -> I64:
        """The indices of actions (n,) within their states s (n,)."""
        model = self._product.model
        wanted = s * model.n_actions + actions
        codes, order = self._codes
        place = np.minimum(np.searchsorted(codes, wanted), len(codes) - 1)
        wrong = np.flatnonzero((codes[place] != wanted) & (actions >= 0))
        if wrong.size:
            i = int(wrong[0])
            here = self.situation(t, int(s[i]), int(q[i]))
            raise PolicyError(
                f"the policy function returned {model.action_names[actions[i]]} at "
                f"{self._place(t, s[i:], q[i:])}, where it is not available; choose among {', '.join(here.actions)}"
            )
        found: I64 = np.where(actions >= 0, order[place] - model.choice_start[s], -1)
        return found

    def _weights(self, t: int, s: I64, q: I64, answer: Any) -> NDArray[np.float64]:
        model = self._product.model
        if isinstance(answer, Mapping) and not self._batched:
            row = np.zeros(model.n_actions)
            for action, weight in answer.items():
                row[self._certain(t, s, q, action)] += weight
            answer = row
        elif not self._batched and not _shape(answer):  # one action, for certain
            answer = np.eye(model.n_actions)[self._certain(t, s, q, answer)]
        shape = (len(s), model.n_actions)
        try:
            given = np.asarray(answer, dtype=np.float64).reshape(shape if not self._batched else np.shape(answer))
        except (TypeError, ValueError):
            given = np.empty(0)
        if given.shape != shape:
            needed = f"weights of shape {shape}" if self._batched else f"{model.n_actions} weights, one an action"
            raise PolicyError(
                f"the policy function returned {described(answer)} at {self._place(t, s, q)}; return {needed}"
            )
        sums = given.sum(axis=1)
        bad = np.flatnonzero(~((given >= 0).all(axis=1) & (abs(sums - 1) <= _SUM)))
        if bad.size:
            i = int(bad[0])
            raise PolicyError(
                f"the policy function's weights {given[i].tolist()} at {self._place(t, s[i:], q[i:])} are not a "
                "distribution; return numbers from 0 that sum to 1"
            )
        owner, action = np.nonzero(given)
        found = np.zeros((len(s), model.most_choices))
        found[owner, self._choices(t, s[owner], q[owner], action)] = given[owner, action] / sums[owner]
        return found

    def _place(self, t: int, s: I64, q: I64) -> str:
        return self._product.describe(int(s[0]) * self._product.automaton.n_states + int(q[0]), t)


def _shape(answer: Any) -> tuple[int, ...]:
    """The shape of an answer; () of what is not an array."""
    try:
        return np.shape(answer)
    except Exception:  # whatever it is
        return ()
