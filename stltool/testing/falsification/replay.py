"""The most probable violation of a model, played on the black box that it is a model of.

With a model nothing need be searched: `likely_runs` has the violations of a policy exactly, most probable first.
Whether the real system violates so, too, is what remains to be seen: each attempt resets it and takes the run's actions
for as long as its states are those of the run. With the model's probabilities the run comes about with probability

    p = ι(s₀) Π_t p(s_{t+1} | s_t, a_t)

in each attempt, so that n attempts miss it with probability (1 − p)^n.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stltool.arguments import require, whole
from stltool.checking.likely import LikelyRun, likely_runs
from stltool.display import Card, Displayed, counted, probability_text
from stltool.errors import ArgumentError, SettingsError
from stltool.models.environment import BlackBox, batch_of, require_environment, require_state
from stltool.policy import Policy, require_door
from stltool.product import Product

_ATTEMPTS = 1000


@dataclass(frozen=True, eq=False, repr=False)
class Replay(Displayed):
    """How the black box answered to the actions of a run.

    run          the run that was played, the most probable violation
    reproduced   whether an attempt went through all its states, which violates the task
    attempts     how many were made, until one did
    chance       probability of that in each attempt, by the model; missed: of missing it in all of them
    furthest     (n,) states of the attempt that followed the run for longest, with the state at which it left it
    """

    product: Product
    run: LikelyRun
    reproduced: bool
    attempts: int
    chance: float
    furthest: tuple[int, ...]

    def __bool__(self) -> bool:
        return self.reproduced

    @property
    def missed(self) -> float:
        """The probability, by the model, that as many attempts do not reproduce the run."""
        return (1 - self.chance) ** self.attempts

    def _card(self) -> Card:
        name = self.product.model.state_name
        found = "reproduced" if self.reproduced else "not reproduced"
        return Card(
            f"Replay: the most probable violation, {found} in {counted(self.attempts, 'attempt')}",
            [
                {"probability of the run": probability_text(self.run.probability),
                 "of each attempt, by the model": probability_text(self.chance)},
                {"actions": " ".join(self.run.actions), "states": " ".join(map(name, self.furthest))},
            ],
        )  # fmt: skip


def replay(
    product: Product, environment: BlackBox, policy: Policy | None = None, *, attempts: int = _ATTEMPTS
) -> Replay:
    """Play the most probable run that violates the task under `policy` (default: the optimal one) on a black box.

    environment   anything whose `reset()` and `step(i)` (the i-th available action of the current state) return the
                  index of a state in the model's order
    attempts      how often at most it is reset

    Raises SettingsError if the policy does not violate the task, PolicyError if it does not fit, ModelError if the
    environment does not return a state.
    """
    require_door("replay", product, policy)
    require(product, Product, "replay's product")
    if environment is None:
        raise ArgumentError("replay's environment is None; give an object with reset() and step(i)")
    require_environment(environment, "replay's environment")
    if batch_of(environment, "replay's environment") is not None:
        raise ArgumentError("replay's environment takes many runs at once; give one that takes one run at a time")
    attempts = whole(attempts, "attempts", least=1)
    found = likely_runs(product, policy, count=1).runs
    if not found:
        raise SettingsError("no run of this policy violates the task; there is nothing to replay")
    [run] = found
    model, box = product.model, environment
    chance, numbers = float(model.initial[run.states[0]]), []
    for state, action, after in zip(run.states[:-1], run.actions, run.states[1:], strict=True):
        first, end = model.choice_start[state : state + 2]
        number = model.choice_action[first:end].tolist().index(model.action_names.index(action))
        numbers.append(number)
        row = slice(*model.row_start[first + number : first + number + 2])
        chance *= float(model.probability[row][model.target[row] == after].sum())
    furthest: list[int] = []
    for attempt in range(1, attempts + 1):
        states = _attempt(box, run, numbers, model.n_states, model.name)
        if len(states) > len(furthest):
            furthest = states
        if states == list(run.states):
            return Replay(product, run, True, attempt, chance, tuple(states))
    return Replay(product, run, False, attempts, chance, tuple(furthest))


def _attempt(box: Any, run: LikelyRun, numbers: list[int], n_states: int, name: str) -> list[int]:
    states = [require_state(box.reset(), "reset()", n_states, name)]
    for t, number in enumerate(numbers):
        if states[t] != run.states[t]:
            break
        states.append(require_state(box.step(number), f"step({number})", n_states, name))
    return states
