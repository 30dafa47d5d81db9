"""A run that is chosen move by move, with P under a policy at every step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stltool.automata import TRUE
from stltool.checking.likely import likely_runs
from stltool.checking.situations import Situations
from stltool.errors import SettingsError, near_misses
from stltool.numbers import probability_text
from stltool.policy import Policy
from stltool.product import Product
from stltool.randomness import Purpose, generator

_LISTED = 12  # states in a message


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

    def move(self, text: str) -> str | None:
        """One of the moves of HELP that change the run; returns a remark on it, if there is one."""
        text = text.strip()
        if text == "<":
            if not self.t:
                raise SettingsError("<: the run is at its first step; there is none to go back to")
            self.steps, self._planned = self.steps[:-1], []
        elif text == "!":
            return self._along_the_worst()
        elif text == "*":
            while self.verdict is None:
                self.move(".")
        elif self.verdict is not None:
            raise SettingsError(f"{text}: the verdict is known, so there is nothing left to do; < goes back")
        elif text in (".", ""):
            self._follow()
        else:
            self._take(text)
        return None

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
        """ACTION or ACTION>STATE; each by its name, with or without its spaces, or by its number."""
        names = self.actions()
        name, arrow, state = (text, "", "") if _bare(text) in map(_bare, names) else text.partition(">")
        same = [i for i, known in enumerate(names) if known == name.strip()]
        same = same or [i for i, known in enumerate(names) if _bare(known) == _bare(name)]
        if not same and name.strip().isdecimal() and 1 <= int(name) <= len(names):
            same = [int(name) - 1]
        if len(same) != 1:
            raise SettingsError(f"{name.strip()}: there is no such action here; {near_misses(name.strip(), names)}")
        self._planned = []
        if not arrow:
            self._sample(same[0])
            return
        self._enter(names[same[0]], self._place(same[0], state.strip()))

    def _place(self, i: int, text: str) -> int:
        """The successor that is meant. SettingsError with the choices if there is none, or if several are."""
        last, model, action = self.steps[-1], self.product.model, self.actions()[i]
        states = [one.s for one in self.here.outcomes(last.s, last.q, i)]
        same = [s for s in states if model.state_name(s) == text]
        same = same or [s for s in states if _bare(model.state_name(s)) == _bare(text)]
        if not same and text.isdecimal():
            same = [s for s in states if str(s) == text]
        if len(same) == 1:
            return same[0]
        fault = f"{text} is the name of several states" if same else f"{action} does not lead to {text}"
        choices = "; ".join(_bare(f"{action}>{model.state_name(s)}") for s in (same or states)[:_LISTED])
        more = "; …" if len(same or states) > _LISTED else ""
        numbers = ", ".join(map(str, (same or states)[:_LISTED]))
        raise SettingsError(f"{fault}; choose from: {choices}{more} (or, by the states' numbers, {numbers})")

    def _sample(self, i: int) -> None:
        last = self.steps[-1]
        outcomes = self.here.outcomes(last.s, last.q, i)
        weights = np.array([one.probability for one in outcomes])
        self._enter(self.actions()[i], outcomes[int(self._rng.choice(len(outcomes), p=weights / weights.sum()))].s)

    def _enter(self, action: str, s: int) -> None:
        self.steps.append(Step(s, self.product.enter(s, self.steps[-1].q), action))

    def _along_the_worst(self) -> str:
        found = likely_runs(self.product, self.here.policy, count=1).runs
        if not found:
            raise SettingsError("!: no run of this policy violates the task")
        [run] = found
        s = run.states[0]
        self.steps = [Step(s, self.product.enter(s, self.product.automaton.initial), None)]
        self._planned = list(zip(run.actions, run.states[1:], strict=True))
        return (
            f"the most probable violation, with probability {probability_text(run.probability)}, is decided at step "
            f"{run.step}: Enter follows it step by step, * to the end"
        )


def _bare(text: str) -> str:
    """Without spaces: how a name may be written in a list of moves."""
    return "".join(text.split())
