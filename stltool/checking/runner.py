"""`Runner`: a policy in a robot's software, which keeps the clock and what is remembered.

    runner = stl.Runner(product, policy)
    while runner.verdict is None:
        action = runner.act(where_am_i())      # a state's name or number, or signals and labels that tell it apart

After step t in (t, s, q), with V as in checking/situations.py,

    q_t = δ(L(s_t), q_{t−1}),    verdict = verdict_t(q_t),    probability = V_t(s_t, q_t)

exporting/standalone.py writes the same policy as a file of plain Python, which does not need stltool.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described, require, whole
from stltool.automata import TRUE, UNDECIDED
from stltool.checking.check import or_optimal
from stltool.checking.rollouts import choice
from stltool.checking.shield import Shield
from stltool.display import Card, Displayed, counted
from stltool.errors import ArgumentError, NameLookupError, SettingsError, SizeError, near_misses
from stltool.logic.printer import with_names
from stltool.models.names import StateLookup
from stltool.models.rows import spans
from stltool.numbers import NumberError, exact
from stltool.policy import Policy
from stltool.product import Product, with_early_verdicts
from stltool.randomness import Purpose, generator, require_seed
from stltool.reached import entered, reached_by, read

I64: TypeAlias = NDArray[np.int64]
F64: TypeAlias = NDArray[np.float64]

_MOST_NODES = 4_000_000  # situations that P is computed from
_TOLERANCE = 1e-6  # relative, by which a signal may miss a state's
_SHOWN = 5  # states in a message


class Runner(Displayed):
    """A policy (default: the optimal one) that is told states one after another, and says what to do.

    shield  one for this product: where it refuses the policy's action, the best one is taken, and `replaced` is True.
            P from the start is then at least what the shield promises, whatever the policy
    seed    of the random choices of a policy that mixes actions; runs after `reset` draw new ones

    Raises what `check` and `Policy.on` raise for a policy that does not belong to the product.
    """

    def __init__(
        self, product: Product, policy: Policy | None = None, *, shield: Shield | None = None, seed: int = 0
    ) -> None:
        require(shield, Shield, "Runner's shield", "make one: stl.shield(product, at_least=0.95)", optional=True)
        given = or_optimal("Runner", product, policy)
        self._rng = generator(require_seed(seed), Purpose.SAMPLE_RUN)
        if shield is not None:
            shield.require_for(product)
        self._shield = shield
        product, self.policy = given.on(product)
        self.product = with_early_verdicts(product)
        self._states = StateLookup(product.model)
        self._values = _Values(self.product, self.policy)
        self._text = with_names(product.definitions)
        self.reset()

    def _card(self) -> Card:
        shown = {None: "undecided", True: "satisfied", False: "violated"}[self.verdict]
        where = "before the first state" if self.state is None else f"step {self.step}, state {self.state}"
        return Card(
            f"Runner: {where}, {shown}",
            [
                {"task": f"{self.product.task_name} := {self.product.formula}"},
                {"policy": self.policy.kind, "remembers": self.remembered or None},
            ],
        )

    def reset(self) -> None:
        """Begin another run: the next state is that of step 0."""
        self._step, self._s, self._q = -1, -1, self.product.automaton.initial
        self._spent, self._replaced = 0, False
        if self._shield is not None:
            self._guard = self._shield.product.automaton.initial  # the policy may remember runs by another automaton

    def act(self, state: str | int | Mapping[str, float | bool]) -> str | None:
        """What to do in this state, the next of the run: an action's name, or None once the task is decided.

        state   its name, its number, or the values of signals and labels, if they tell it apart from the others

        Raises NameLookupError for a state that there is not, PolicyError where the policy defines no action; the run is
        then as it was before. Once the verdict is known, states are no longer read.
        """
        if self.verdict is not None:
            return None
        s = self._find(state)
        t, q = self._step + 1, self.product.enter(s, self._q)
        action = None
        if self._open(t, q):
            model = self.product.model
            action = model.action_names[model.choice_action[model.choice_start[s] + self._pick(t, s, q)]]
        else:
            self._replaced = False
        self._step, self._s, self._q = t, s, q
        return action

    def _pick(self, t: int, s: int, q: int) -> int:
        """The choice taken in (t, s, q), by its number within the state: the one place that decides."""
        taken = choice(self.product, self.policy, s, q, t, self._rng)
        if self._shield is None:
            return taken
        guard = self._shield.product.enter(s, self._guard)
        replaced = not self._shield.allows(t, s, guard, self._spent)[taken]
        if replaced:
            taken = self._shield.best(t, s, guard)
        self._spent = self._shield.spend(t, s, guard, taken, self._spent)
        self._guard, self._replaced = guard, replaced
        return taken

    @property
    def replaced(self) -> bool:
        """Whether the shield has replaced the last action by the best one."""
        return self._replaced

    @property
    def allowance(self) -> float:
        """What the run has left to spend, from 1 to 0; 0 without a shield that counts it."""
        return self._shield.allowance(self._spent) if self._shield is not None else 0.0

    @property
    def step(self) -> int | None:
        """The step of the last state, from 0; None before the first."""
        return self._step if self._step >= 0 else None

    @property
    def state(self) -> str | None:
        """The name of the last state; None before the first."""
        return self.product.model.state_name(self._s) if self._step >= 0 else None

    @property
    def actions(self) -> tuple[str, ...]:
        """The actions that are available in the last state; none before the first, or once the task is decided."""
        if self._step < 0 or self.verdict is not None:
            return ()
        model = self.product.model
        chosen = model.choice_action[model.choice_start[self._s] : model.choice_start[self._s + 1]]
        return tuple(model.action_names[a] for a in chosen)

    @property
    def remembered(self) -> str:
        """What is remembered of the run, in words."""
        if self._step < 0:
            return ""
        return "; ".join(one.phrase for one in self.product.automaton.memory(self._q, self._text))

    @property
    def verdict(self) -> bool | None:
        """Whether the run satisfies the task, as soon as no sequence of states can change that; None until then."""
        if self._step < 0 or self._open(self._step, self._q):
            return None
        return bool(self.product.automaton.verdicts(self._step)[self._q] == TRUE)

    @property
    def probability(self) -> float:
        """P that the run satisfies the task if the policy is followed from here on; before the first state, P of all.

        In doubles; `check` encloses P of all runs. Computed when first asked for. Raises SettingsError for models
        without known probabilities, SizeError if runs can come to too many situations; NaN if they come to one where
        the policy defines no action; with a shield, SettingsError too.
        """
        if self._shield is not None and self.verdict is None:
            raise SettingsError(
                "with a shield, P is not that of the policy; shield.least encloses what it is at least, from the start"
            )
        self.product.model.require_points()
        if self._step < 0:
            return self._values.first()
        verdict = self.verdict
        return float(verdict) if verdict is not None else self._values.at(self._step, self._s, self._q)

    def _open(self, t: int, q: int) -> bool:
        return bool(self.product.automaton.verdicts(t)[q] == UNDECIDED)

    # ---------------------------------------------------------------------------------------------- which state

    def _find(self, state: object) -> int:
        model = self.product.model
        if isinstance(state, str):
            found = self._states.find(state)
            if found is None:
                raise NameLookupError(f"there is no state {state!r}; {self._states.hint(state)}")
            return found
        if isinstance(state, Mapping):
            return self._told_apart(state)
        if isinstance(state, int | np.integer) and not isinstance(state, bool):
            return whole(state, "act's state", 0, model.n_states - 1)
        raise ArgumentError(
            f"act's state is {described(state)}; give its name, its number, or the values of signals and labels"
        )

    def _told_apart(self, told: Mapping[object, Any]) -> int:
        """The only state with these values of signals and labels."""
        model = self.product.model
        there = np.ones(model.n_states, dtype=np.bool_)
        away = np.zeros(model.n_states)
        for name, given in told.items():
            if not isinstance(name, str) or not (name in model.signals or name in model.labels):
                known = [*model.signals, *model.labels]
                raise NameLookupError(f"the model has no signal or label {name!r}; {near_misses(str(name), known)}")
            column: NDArray[Any] = model.signals[name] if name in model.signals else model.labels[name]
            values = column.astype(np.float64)
            try:
                value = float(bool(given)) if isinstance(given, bool | np.bool_) else float(exact(given))
            except (NumberError, OverflowError) as error:
                raise ArgumentError(f"act's state: the value of {name}: {error}") from None
            apart = abs(values - value)
            there &= apart <= _TOLERANCE * np.maximum(1.0, abs(values))
            away += (apart / max(float(np.ptp(values)), 1e-300)) ** 2
        found = np.flatnonzero(there)
        if len(found) == 1:
            return int(found[0])
        shown = ", ".join(f"{name} = {given}" for name, given in told.items()) or "nothing"
        if len(found):
            names = ", ".join(model.state_name(s) for s in found[:_SHOWN].tolist())
            more = ", …" if len(found) > _SHOWN else ""
            missing = [name for name in (*model.signals, *model.labels) if name not in told]
            remedy = f"give {' or '.join(missing[:_SHOWN])}, too, or the state" if missing else "name the state"
            raise NameLookupError(f"{shown}: {counted(len(found), 'state')} with this, {names}{more}; {remedy}")
        near = int(np.argmin(away))
        columns: dict[str, NDArray[Any]] = {**model.labels, **model.signals}
        here = ", ".join(f"{name} = {columns[str(name)][near]:g}" for name in told)
        raise NameLookupError(f"{shown}: there is no such state; the nearest is {model.state_name(near)}, with {here}")


class _Values:
    """P from situations under a policy, computed when asked for; what was computed is kept."""

    def __init__(self, product: Product, policy: Policy) -> None:
        self._product, self._form = product, policy.form
        self._known: dict[int, dict[int, float]] = {}
        self._first: float | None = None

    def first(self) -> float:
        """P of all runs."""
        if self._first is None:
            product, automaton = self._product, self._product.automaton
            s = np.flatnonzero(product.model.initial)
            codes = read(product, s, automaton.initial)
            self._unfold(0, entered(product, s, automaton.initial))
            values = [self._value(0, code) for code in codes.tolist()]
            self._first = float(product.model.initial[s] @ values)
        return self._first

    def at(self, t: int, s: int, q: int) -> float:
        code = s * self._product.automaton.n_states + q
        if code not in self._known.get(t, {}):
            self._unfold(t, np.array([code], dtype=np.int64))
        return self._known[t][code]

    def _value(self, t: int, code: int) -> float:
        verdict = int(self._product.automaton.verdicts(t)[code % self._product.automaton.n_states])
        return self._known[t][code] if verdict == UNDECIDED else float(verdict == TRUE)

    def _unfold(self, first: int, codes: I64) -> None:
        """The values of all situations that runs from these come to."""
        nodes = reached_by(self._product, self._form, _MOST_NODES, 2**60, start=(first, codes))
        if nodes is None:
            raise SizeError(
                f"runs of the policy can come to more than {_MOST_NODES} situations, too many to compute P while it "
                "runs; act and verdict work without it"
            )
        ahead, after = np.empty(0), np.empty(0, dtype=np.int64)
        for t, here in reversed(list(enumerate(nodes, start=first))):
            ahead, after = self._layer(t, here, ahead, after), here
            self._known.setdefault(t, {}).update(zip(here.tolist(), ahead.tolist(), strict=True))

    def _layer(self, t: int, here: I64, ahead: F64, after: I64) -> F64:
        """The values of the nodes of step t, from those of step t + 1."""
        product, model = self._product, self._product.model
        n_memories = product.automaton.n_states
        s, q = np.divmod(here, n_memories)
        if not len(here):
            return np.empty(0)
        taken = self._form.at(t, s, q)
        if taken.ndim == 1:
            owner = np.flatnonzero(taken >= 0)
            number, weight = taken[owner], np.ones(len(owner))
        else:
            owner, number = np.nonzero(taken > 0)
            weight = taken[owner, number]
        row = model.choice_start[s[owner]] + number
        begin, end = model.row_start[row], model.row_start[row + 1]
        entry, count = spans(begin, end), end - begin
        p = model.probability[entry]
        code = read(product, model.target[entry], np.repeat(q[owner], count))
        verdict = product.automaton.verdicts(t + 1)[code % n_memories]
        value = (verdict == TRUE).astype(np.float64)
        open_ = np.flatnonzero((verdict == UNDECIDED) & (p > 0))
        if len(open_):
            value[open_] = ahead[np.searchsorted(after, code[open_])]
        values = np.zeros(len(here))
        np.add.at(values, np.repeat(owner, count), np.repeat(weight, count) * p * value)
        silent = np.ones(len(here), dtype=np.bool_)
        silent[owner] = False
        values[silent] = np.nan
        found: F64 = np.minimum(values, 1.0)
        return found
