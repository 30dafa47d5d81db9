"""A run that is chosen move by move, with P under a policy at every step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stltool.automata import TRUE
from stltool.checking.likely import likely_runs
from stltool.checking.situations import Situations
from stltool.errors import SettingsError, near_misses
from stltool.policy import Policy
from stltool.product import Product
from stltool.randomness import Purpose, generator


@dataclass(frozen=True)
class Step:
    """Model state, automaton state, and the action that led there."""

    s: int
    q: int
    action: str | None


class Game:
    """A run that is chosen move by move. Raises SettingsError for a move that there is not; the moves are those of
    reporting/playing.py."""

    def __init__(self, product: Product, policy: Policy, seed: int) -> None:
        self.here = Situations(product, policy)
        self.product = self.here.product
        self._rng = generator(seed, Purpose.SAMPLE_RUN)
        self._planned: list[tuple[str, int]] = []
        initial = self.product.model.initial
        s = int(self._rng.choice(len(initial), p=initial / initial.sum()))
        self.steps = [Step(s, self.product.enter(s, self.product.automaton.initial), None)]

    @property
    def t(self) -> int:
        return len(self.steps) - 1

    @property
    def verdict(self) -> bool | None:
        """Whether the run satisfies the task; None while that is open."""
        q = self.steps[-1].q
        return None if self.here.undecided(self.t, q) else bool(self.product.automaton.verdicts(self.t)[q] == TRUE)

    @property
    def value(self) -> float:
        """P from here on under the policy, or the verdict."""
        return self.here.value(self.t, self.steps[-1].s, self.steps[-1].q)

    def actions(self) -> list[str]:
        """The available actions."""
        model, s = self.product.model, self.steps[-1].s
        chosen = model.choice_action[model.choice_start[s] : model.choice_start[s + 1]]
        return [model.action_names[a] for a in chosen]

    def move(self, text: str) -> None:
        """One of the moves of HELP that change the run."""
        text = text.strip()
        if text == "<":
            self.steps = self.steps[:-1] or self.steps
            self._planned = []
        elif text == "!":
            self._along_the_worst()
        elif text == "*":
            while self.verdict is None:
                self.move(".")
        elif self.verdict is not None:
            raise SettingsError(f"{text}: the verdict is known, so there is nothing left to do; < goes back")
        elif text in (".", ""):
            self._follow()
        else:
            self._take(text)

    def _follow(self) -> None:
        """As planned, else the policy's action."""
        if self._planned:
            action, s = self._planned.pop(0)
            self._enter(action, s)
            return
        t, last, names = self.t, self.steps[-1], self.actions()
        weights = self.here.weights(t, last.s, last.q)
        if not weights.any():
            raise SettingsError(f"the policy takes no action here; choose one of {', '.join(names)}")
        self._sample(int(self._rng.choice(len(weights), p=weights / weights.sum())))

    def _take(self, text: str) -> None:
        name, arrow, state = text.partition(">")
        names, name = self.actions(), name.strip()
        if name.isdigit() and name not in names and 1 <= int(name) <= len(names):
            name = names[int(name) - 1]
        if name not in names:
            raise SettingsError(f"{name}: there is no such action here; {near_misses(name, names)}")
        i = names.index(name)
        self._planned = []
        if not arrow:
            self._sample(i)
            return
        last, model = self.steps[-1], self.product.model
        places = {model.state_name(one.s): one.s for one in self.here.outcomes(last.s, last.q, i)}
        if state.strip() not in places:
            raise SettingsError(f"{name} does not lead to {state.strip()}; {near_misses(state.strip(), places)}")
        self._enter(name, places[state.strip()])

    def _sample(self, i: int) -> None:
        last = self.steps[-1]
        outcomes = self.here.outcomes(last.s, last.q, i)
        weights = np.array([one.probability for one in outcomes])
        self._enter(self.actions()[i], outcomes[int(self._rng.choice(len(outcomes), p=weights / weights.sum()))].s)

    def _enter(self, action: str, s: int) -> None:
        self.steps.append(Step(s, self.product.enter(s, self.steps[-1].q), action))

    def _along_the_worst(self) -> None:
        found = likely_runs(self.product, self.here.policy, count=1).runs
        if not found:
            raise SettingsError("!: no run of this policy violates the task")
        [run] = found
        s = run.states[0]
        self.steps = [Step(s, self.product.enter(s, self.product.automaton.initial), None)]
        self._planned = list(zip(run.actions, run.states[1:], strict=True))
