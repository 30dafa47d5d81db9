"""Runs of a policy, step by step, for reports."""

from __future__ import annotations

from dataclasses import dataclass, field

from stltool.automata import TRUE, UNDECIDED
from stltool.checking.check import or_optimal
from stltool.checking.rollouts import choice
from stltool.display import Card, Displayed
from stltool.models.environment import simulator
from stltool.policy import Policy
from stltool.product import Product
from stltool.randomness import Purpose, generator, require_seed


@dataclass(frozen=True, repr=False)
class Run(Displayed):
    """One sampled run s₀ … s_n up to the step where the verdict is decided.

    `states` has one entry more than `actions`; `memory` describes the automaton state after each; `satisfied` is the
    verdict, decided at the last step; `seed` is the seed of its random numbers, if it was sampled.
    """

    states: tuple[int, ...]
    actions: tuple[str, ...]
    memory: tuple[str, ...]
    satisfied: bool
    seed: int | None = field(default=None, kw_only=True)

    def _card(self) -> Card:
        verdict = "satisfied" if self.satisfied else "violated"
        return Card(
            f"{type(self).__name__}: {verdict} at step {len(self.actions)}",
            [
                {"states": " ".join(map(str, self.states)), "seed": self.seed},
                {"actions": " ".join(self.actions) or None},
            ],
        )


def sample_run(product: Product, policy: Policy | None = None, seed: int = 0) -> Run:
    """Follow `policy` (default: the optimal one) from a random first state until the task is decided, in the model or
    its black box.

    seed   an integer from 0; every random choice comes from it: same seed, same run

    Raises PolicyError if the policy defines no action in a state that the run reaches or belongs to another task.
    """
    rng = generator(require_seed(seed), Purpose.SAMPLE_RUN)
    product, policy = or_optimal("sample_run", product, policy).on(product)
    model, automaton = product.model, product.automaton
    environment = simulator(model, rng, product.horizon)
    s = environment.reset()
    q = product.enter(s, automaton.initial)
    states, actions, memory = [s], [], [automaton.describe(q)]
    t = 0
    while automaton.verdicts(t)[q] == UNDECIDED:
        i = choice(product, policy, s, q, t, rng)
        actions.append(model.action_names[model.choice_action[model.choice_start[s] + i]])
        s = environment.step(i)
        q = product.enter(s, q)
        t += 1
        states.append(s)
        memory.append(automaton.describe(q))
    satisfied = bool(automaton.verdicts(t)[q] == TRUE)
    return Run(tuple(states), tuple(actions), tuple(memory), satisfied, seed=int(seed))
