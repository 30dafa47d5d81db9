"""What if: P that a run would have satisfied the task, had another action been taken at one of its steps.

Chance is thought of as drawn apart from the actions: step j draws u_j, uniform in [0, 1), and each choice c lays its
outcomes side by side in [0, 1), so that s_{j+1} = f(c_j, u_j). The run s₀ c₀ s₁ … tells where u_j was; these u_j are
independent, uniform in

    U_j = { u : f(c_j, u) = s_{j+1} },        after the end of the run [0, 1)

With another choice at step k and a policy π from step k + 1 on,

    P_j(s' | c) = |{ u ∈ U_j : f(c, u) = s' }| / |U_j|
    W_j(s,q) = Σ_c π_j(c|s,q) Σ_s' P_j(s'|c) W_{j+1}(s', δ(L(s'), q)),      decided: 1 or 0

and the answer is Σ_s' P_k(s'|c) W_{k+1}(s', ·): one induction answers for all steps and actions of a run. The same
choices as in the run lead to the same states.

How the outcomes of *different* choices go together is an assumption that no data can test: in every run only one of
them is tried. A `coupling` states it, and `Counterfactual.assumption` in words.

All shares are exact fractions; W is computed in doubles with an enclosure (checking/bounds.py), or in fractions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described, flag, one_of, require, whole
from stltool.automata import TRUE, UNDECIDED
from stltool.checking.bounds import can_underflow, enclose, roundings
from stltool.checking.check import or_optimal
from stltool.checking.sampling import Run
from stltool.display import Card, Displayed, counted, probability_text
from stltool.errors import ArgumentError, SettingsError, SizeError, named, near_misses
from stltool.models.names import StateLookup
from stltool.models.rows import Outcome, spans, starts
from stltool.policy import Policy, require_door, silence
from stltool.product import Product
from stltool.reached import MOST_EDGES, MOST_NODES, read

I64: TypeAlias = NDArray[np.int64]
Interval: TypeAlias = tuple[Fraction, Fraction]
Coupling = Literal["noise", "order", "independent"]

_FAILS, _HOLDS, _NODES = 0, 1, 2  # a child: the verdict, or 2 + the place of a node of the next step
_SHOWN = 10  # alternatives in a notebook

ASSUMPTIONS = {
    "noise": "what disturbs a step (success, stay, left, right) does not depend on the action, as if drawn before it",
    "order": "one number drawn for each step decides where every action leads; successors lie in the order of the "
    "states' numbers",
    "independent": "what an action would have led to says nothing about where another one would have led",
}


@dataclass(frozen=True)
class Alternative:
    """An action at one step of a run.

    step, state, action   as in the run: `state` is where the action would have been taken
    taken                 whether it is what the run did
    probability           P that the task is then satisfied, enclosed by lower and upper
    fraction              the same exactly, if asked for
    """

    step: int
    state: str
    action: str
    taken: bool
    probability: float
    lower: float
    upper: float
    fraction: Fraction | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Counterfactual(Displayed):
    """What would have become of a run.

    product, policy  the policy that is followed after the other action; the product remembers what it needs
    states, actions  what happened; satisfied is the verdict, None if the run ended before it was decided
    coupling         how the noise of different actions goes together; `assumption` says it in words
    noise            for each step of the run, what may have happened: names, or None for a successor's, and shares
    alternatives     by steps, then in the order of the model's actions
    """

    product: Product
    policy: Policy
    states: tuple[int, ...]
    actions: tuple[str, ...]
    satisfied: bool | None
    coupling: Coupling
    noise: tuple[dict[str | None, Fraction], ...]
    alternatives: tuple[Alternative, ...] = field(default=())

    @property
    def assumption(self) -> str:
        return ASSUMPTIONS[self.coupling]

    @cached_property
    def best(self) -> Alternative:
        """The alternative with the highest P; the first of equal ones."""
        return max(self.alternatives, key=lambda one: (one.probability, -one.step))

    @property
    def probability(self) -> float:
        """P of the alternative asked for; of several, of the best."""
        return self.best.probability

    def _card(self) -> Card:
        best = self.best
        verdict = {None: "undecided", True: "satisfied", False: "violated"}[self.satisfied]
        rows = [
            (one.step, one.state, one.action, "as it was" if one.taken else "", probability_text(one.probability))
            for one in self.alternatives[:_SHOWN]
        ]
        return Card(
            f"Counterfactual: the run was {verdict}; {best.action} at step {best.step} would have made P = "
            f"{probability_text(best.probability)}",
            [
                {"task": f"{self.product.task_name} := {self.product.formula}", "then": f"{self.policy.kind} policy"},
                {"assuming that": self.assumption},
            ],
            (("step", "state", "action", "", "P"), rows),
            more=max(0, len(self.alternatives) - _SHOWN),
        )


def counterfactual(
    product: Product,
    run: Run | tuple[Sequence[int | str], Sequence[str]],
    step: int | None = None,
    action: str | None = None,
    *,
    policy: Policy | None = None,
    coupling: Coupling | None = None,
    exact: bool = False,
) -> Counterfactual:
    """P that the task had been satisfied, had `action` been taken at `step` of a run, and `policy` (default: the
    optimal one) been followed from there.

    run       one that was sampled or found (`sample_run`, `likely_runs`), or the states (n + 1, by numbers or names)
              and the actions (n) of one that was observed; steps after its end are drawn as the model says
    step      from 0; None: every step        action  None: every action of the state there
    coupling  what is assumed of the noise of different actions (see `ASSUMPTIONS`): "noise", where the model names its
              outcomes (grids), and "independent" elsewhere, are the defaults
    exact     compute fractions too

    Raises ArgumentError for a run that the model cannot make, SettingsError for a step or an action that there is not,
    a coupling that the model has not, or probabilities that are not known, PolicyError if the policy defines no action
    where it is needed, SizeError if there is too much to compute.
    """
    require_door("counterfactual", product, policy)
    product.model.require_points()
    exact = flag(exact, "counterfactual's exact")
    if coupling is not None:
        one_of(coupling, "coupling", get_args(Coupling))
    states, actions = _given(product, run)
    chosen = or_optimal("counterfactual", product, policy)
    past = _Past(product, states, actions, coupling)
    steps = _steps(past, step)
    if action is not None:
        _require_action(past, steps, action)
    product, followed = chosen.on(product)
    tree = _Tree(product, followed, past, steps, action)
    return Counterfactual(
        product, followed, states, actions, past.satisfied, past.coupling, past.noise, tree.alternatives(exact)
    )


# ----------------------------------------------------------------------------------------------------- what happened


def _given(product: Product, run: object) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """The states and actions of a run."""
    if isinstance(run, Run):
        return run.states, run.actions
    if not (isinstance(run, tuple | list) and len(run) == 2 and all(isinstance(part, Sequence) for part in run)):
        raise ArgumentError(
            f"counterfactual's run is {described(run)}; give a run (stl.sample_run, stl.likely_runs), or the states "
            "and the actions of one: ([0, 1, 2], ['N', 'N'])"
        )
    states, actions = run
    if len(states) != len(actions) + 1:
        raise ArgumentError(
            f"counterfactual's run has {counted(len(states), 'state')} and {counted(len(actions), 'action')}; it has "
            "one state more than actions"
        )
    names, most = StateLookup(product.model), product.model.n_states - 1
    numbers = []
    for t, state in enumerate(states):
        number = names.find(state) if isinstance(state, str) else whole(state, f"the run's state {t}", 0, most)
        if number is None:
            raise ArgumentError(f"step {t} of the run: there is no state {state!r}; {names.hint(str(state))}")
        numbers.append(number)
    return tuple(numbers), tuple(actions)


class _Past:
    """A run of a model, and what it tells about the noise of its steps."""

    def __init__(
        self, product: Product, states: tuple[int, ...], actions: tuple[str, ...], coupling: Coupling | None
    ) -> None:
        self.product, self.model = product, product.model
        self.states, self.actions = states, actions
        self._laid: dict[int, list[tuple[Outcome, Interval]]] = {}
        self.choices = [self._choice(t) for t in range(len(actions))]
        names = any(one.name is not None for c in self.choices for one, _ in self.laid(c))
        if coupling == "noise" and not names:
            raise SettingsError(
                f'the outcomes of {self.model.name} have no names, as those of a grid have; choose "order" or '
                '"independent" as the coupling'
            )
        self.coupling: Coupling = coupling or ("noise" if names else "independent")
        self._seen: list[list[Interval]] = []
        noise: list[dict[str | None, Fraction]] = []
        for t, c in enumerate(self.choices):
            found = [(one, ends) for one, ends in self.laid(c) if one.target == states[t + 1]]
            if not found:
                raise ArgumentError(
                    f"step {t} of the run: {actions[t]} in state {self.model.state_name(states[t])} never leads to "
                    f"{self.model.state_name(states[t + 1])}; give a run of this model"
                )
            total = sum((one.probability for one, _ in found), Fraction(0))
            self._seen.append([ends for _, ends in found])
            noise.append({one.name: one.probability / total for one, _ in found})
        self.noise = tuple(noise)
        automaton, q = product.automaton, product.automaton.initial
        self.open = 0  # the number of states that an action is due in
        for t, s in enumerate(states):
            q = product.enter(s, q)
            if automaton.verdicts(t)[q] != UNDECIDED:
                break
            self.open += 1
        decided = self.open < len(states)
        self.satisfied = bool(automaton.verdicts(self.open)[q] == TRUE) if decided else None

    def _choice(self, t: int) -> int:
        """The choice that was made at step t."""
        model, s, name = self.model, self.states[t], self.actions[t]
        found = [c for c in self.available(s) if model.action_names[model.choice_action[c]] == name]
        if len(found) != 1:
            raise ArgumentError(
                f"step {t} of the run: there is no action {described(name)} in state {model.state_name(s)}; "
                f"{near_misses(str(name), self.names(s))}"
            )
        return found[0]

    def available(self, s: int) -> range:
        return range(int(self.model.choice_start[s]), int(self.model.choice_start[s + 1]))

    def names(self, s: int) -> list[str]:
        return [self.model.action_names[self.model.choice_action[c]] for c in self.available(s)]

    def laid(self, c: int) -> list[tuple[Outcome, Interval]]:
        """A choice's outcomes side by side in [0, 1)."""
        if c not in self._laid:
            s = int(np.searchsorted(self.model.choice_start, c, side="right")) - 1
            found, below = [], Fraction(0)
            for one in self.model.source.outcomes(s, c - int(self.model.choice_start[s])):
                found.append((one, (below, below + one.probability)))
                below += one.probability
            self._laid[c] = found
        return self._laid[c]

    def after(self, t: int, c: int) -> list[tuple[int, Fraction]]:
        """Where a choice leads at step t, given what the run tells: successors with their shares, all positive."""
        informed = t < len(self.choices) and (self.coupling != "independent" or c == self.choices[t])
        if not informed:
            return [(one.target, one.probability) for one, _ in self.laid(c)]
        seen = self._seen[t]
        size = sum((high - low for low, high in seen), Fraction(0))
        found = []
        for one, (low, high) in self.laid(c):
            both = (min(high, end) - max(low, begin) for begin, end in seen)
            share = sum((part for part in both if part > 0), Fraction(0))
            found += [(one.target, share / size)] if share else []
        return found


def _steps(past: _Past, step: int | None) -> list[int]:
    last = min(past.open, len(past.actions)) - 1
    if last < 0:
        raise SettingsError(
            "the run is decided at its first state, or has no action; nothing could have been different"
        )
    if step is None:
        return list(range(last + 1))
    return [whole(step, named("step"), 0, last)]


def _require_action(past: _Past, steps: list[int], action: str) -> None:
    require(action, str, "counterfactual's action", "name one of the model's")
    if not any(action in past.names(past.states[t]) for t in steps):
        known = list(dict.fromkeys(name for t in steps for name in past.names(past.states[t])))
        where = f"in state {past.model.state_name(past.states[steps[0]])}" if len(steps) == 1 else "in the run's states"
        raise SettingsError(f"there is no action {described(action)} {where}; {near_misses(action, known)}")


# ---------------------------------------------------------------------------------------------------- what would have


@dataclass(frozen=True, eq=False)
class _Layer:
    """What may happen in a step: its n nodes (stltool/reached.py), then the alternatives there.

    choices  (n + 1,): node i has the choices choices[i] … choices[i + 1] − 1
    weight   (m,) the policy's on each choice, in proportion
    rows     (m + 1,): choice j has the edges rows[j] … rows[j + 1] − 1
    number   (e,) the number of each edge's share;  child (e,): _FAILS, _HOLDS, or _NODES + a node of the next step
    asked    how many of the nodes are alternatives
    """

    choices: I64
    weight: NDArray[np.float64]
    rows: I64
    number: I64
    child: I64
    asked: int


class _Tree:
    """The situations after the alternatives, from the first of these steps to the last verdict."""

    def __init__(self, product: Product, policy: Policy, past: _Past, steps: list[int], action: str | None) -> None:
        self._product, self._policy, self._past = product, policy, past
        self._shares: list[Fraction] = []
        self._rows: dict[tuple[int, int], tuple[I64, I64]] = {}
        self._asked: list[tuple[int, int]] = []  # the step and choice of each alternative
        self._layers: list[_Layer] = []
        model, q, memory = product.model, product.automaton.initial, []
        for s in past.states:
            q = product.enter(s, q)
            memory.append(q)
        here: I64 = np.empty(0, dtype=np.int64)
        nodes = edges = 0
        t = steps[0]
        while t <= steps[-1] or len(here):
            choices: list[int] = []
            if t <= steps[-1]:
                listed = past.available(past.states[t])
                choices = [c for c in listed if action in (None, model.action_names[model.choice_action[c]])]
            self._asked += [(t, c) for c in choices]
            layer, here = self._layer(t, here, choices, memory[min(t, len(memory) - 1)])
            self._layers.append(layer)
            nodes, edges, t = nodes + len(here), edges + len(layer.child), t + 1
            if nodes > MOST_NODES or edges > MOST_EDGES:
                raise SizeError(
                    f"what would have followed has more than {MOST_NODES} situations of step, state and memory, or "
                    f"{MOST_EDGES} moves there; ask for one step, or shorten the windows"
                )

    def _layer(self, t: int, here: I64, asked: list[int], memory: int) -> tuple[_Layer, I64]:
        """Of step t: from these nodes and these alternatives; and the nodes of the next step."""
        s, q = np.divmod(here, self._product.automaton.n_states)
        owner, c, weight = self._taken(t, s, q)
        owner = np.concatenate([owner, len(here) + np.arange(len(asked))])
        c = np.concatenate([c, np.array(asked, dtype=np.int64)])
        weight = np.concatenate([weight, np.ones(len(asked))])
        q = np.concatenate([q, np.full(len(asked), memory)])
        used, which = np.unique(c, return_inverse=True)
        found = [self._row(t, one) for one in used.tolist()]
        nothing: list[I64] = [np.empty(0, dtype=np.int64)]
        begin = starts(np.array([len(target) for target, _ in found], dtype=np.int64))
        entry = spans(begin[which], begin[which + 1])
        target = np.concatenate([target for target, _ in found] or nothing)[entry]
        number = np.concatenate([number for _, number in found] or nothing)[entry]
        lengths = begin[which + 1] - begin[which]
        code = read(self._product, target, np.repeat(q[owner], lengths))
        verdict = self._product.automaton.verdicts(t + 1)[code % self._product.automaton.n_states]
        child = np.where(verdict == TRUE, _HOLDS, _FAILS)
        open_ = verdict == UNDECIDED
        ahead, place = np.unique(code[open_], return_inverse=True)
        child[open_] = _NODES + place
        choices = starts(np.bincount(owner, minlength=len(q)))
        return _Layer(choices, weight, starts(lengths), number, child, len(asked)), ahead

    def _taken(self, t: int, s: I64, q: I64) -> tuple[I64, I64, NDArray[np.float64]]:
        """What the policy does in nodes (n,): for each choice that it may make the node, the choice and its weight."""
        model = self._product.model
        if not len(s):
            return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0)
        taken = self._policy.form.at(t, s, q)
        silent = taken < 0 if taken.ndim == 1 else ~taken.any(axis=1)
        for i in np.flatnonzero(silent)[:1].tolist():
            raise silence(self._product, int(s[i]), int(q[i]), t)
        if taken.ndim == 1:
            return np.arange(len(s)), model.choice_start[s] + taken.astype(np.int64), np.ones(len(s))
        owner, i = np.nonzero(taken > 0)
        return owner, model.choice_start[s[owner]] + i, taken[owner, i].astype(np.float64)

    def _row(self, t: int, c: int) -> tuple[I64, I64]:
        """(n,) successors of a choice at step t, and the numbers of their shares."""
        key = min(t, len(self._past.choices)), c
        if key not in self._rows:
            found = self._past.after(t, c)
            first = len(self._shares)
            self._shares += [share for _, share in found]
            target = np.array([there for there, _ in found], dtype=np.int64)
            self._rows[key] = target, np.arange(first, first + len(found))
        return self._rows[key]

    def alternatives(self, exact: bool) -> tuple[Alternative, ...]:
        """What each of them is worth."""
        past, model = self._past, self._product.model
        values = self._values(np.array(list(map(float, self._shares))), np.array)
        fractions: list[Fraction | None] = [None] * len(values)
        if exact:
            fractions = self._values(np.array(self._shares, dtype=object), _fractions)
        longest = max(int(np.diff(layer.rows).max(initial=0)) for layer in self._layers)
        mixed = 0 if self._policy.deterministic else 2 * model.most_choices + 1  # both sums, and their quotient
        n_roundings, least = roundings(len(self._layers), longest, mixed), self._least()
        underflow = can_underflow(len(self._layers), least)
        return tuple(
            Alternative(
                t,
                model.state_name(past.states[t]),
                model.action_names[model.choice_action[c]],
                c == past.choices[t],
                min(value, 1.0),
                *enclose(value, n_roundings, underflow=underflow),
                fraction,
            )
            for (t, c), value, fraction in zip(self._asked, values, fractions, strict=True)
        )

    def _least(self) -> float:
        """The smallest factor that a step multiplies by."""
        least = min(map(float, self._shares))
        if self._policy.deterministic:
            return least
        return least * min(float(layer.weight.min(initial=1.0)) for layer in self._layers)

    def _values(self, shares: NDArray[Any], numbers: Callable[[Any], NDArray[Any]]) -> list[Any]:
        """W of the alternatives, in the numbers of the shares."""
        found: list[Any] = []
        ends, ahead = numbers([0.0, 1.0]), numbers([])
        for layer in reversed(self._layers):
            if not len(layer.weight):
                continue
            terms = shares[layer.number] * np.concatenate([ends, ahead])[layer.child]
            sums = np.add.reduceat(terms, layer.rows[:-1])
            if not self._policy.deterministic:
                weight, first = numbers(layer.weight), layer.choices[:-1]
                sums = np.add.reduceat(weight * sums, first) / np.add.reduceat(weight, first)
            n = len(sums) - layer.asked
            ahead, found = sums[:n], sums[n:].tolist() + found
        return found


def _fractions(values: Iterable[float]) -> NDArray[Any]:
    return np.array(list(map(Fraction, values)), dtype=object)
