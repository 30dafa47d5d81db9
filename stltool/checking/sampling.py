"""Runs of a policy: what a report shows, step by step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stltool.automata import TRUE, UNDECIDED
from stltool.models.environment import simulator
from stltool.policy import Policy, silence
from stltool.product import Product


@dataclass(frozen=True)
class Run:
    """One sampled run s₀ … s_n up to the step where the verdict fell.

    `states` has one entry more than `actions`; `memory` tells what is remembered after each; `satisfied` is the
    verdict, which fell at the last step.
    """

    states: tuple[int, ...]
    actions: tuple[str, ...]
    memory: tuple[str, ...]
    satisfied: bool


def sample_run(product: Product, policy: Policy, rng: np.random.Generator) -> Run:
    """Follow `policy` from a random first state until the task is decided, in the model or its black box."""
    product, policy = policy.on(product)
    model, automaton = product.model, product.automaton
    environment = simulator(model, rng, product.horizon)
    s = environment.reset()
    q = product.enter(s, automaton.initial)
    states, actions, memory = [s], [], [automaton.describe(q)]
    t = 0
    while automaton.verdicts(t)[q] == UNDECIDED:
        table = policy.at(t)[s, q]
        if policy.deterministic and table < 0:
            raise silence(product, s, q, t)
        i = int(table) if policy.deterministic else int(rng.choice(len(table), p=table / table.sum()))
        actions.append(model.action_names[model.choice_action[model.choice_start[s] + i]])
        s = environment.step(i)
        q = product.enter(s, q)
        t += 1
        states.append(s)
        memory.append(automaton.describe(q))
    return Run(tuple(states), tuple(actions), tuple(memory), bool(automaton.verdicts(t)[q] == TRUE))
