"""The size of each encoding of the past, for a task of the paper's fragment, and the claims of [Wang24] on a scenario.

Counts are exact, however large. Flags, exact automaton and histories of τ letters (automata/history.py) have states of
the automaton and of the product, and a stationary Q(s, q, a) with so many entries and bytes. State histories are the
sequences of τ model states, what a τ-MDP remembers: |Σ|^τ as the paper counts, or only those along transitions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stltool.automata.history import history_length, history_states
from stltool.checking.check import check
from stltool.checking.surrogate import SurrogateResult, surrogate_optimum
from stltool.errors import FragmentError, SizeError
from stltool.logic.fragment import check_fragment
from stltool.models import MDP
from stltool.policy import with_flags
from stltool.product import Product, build_product

_BUILT = 5 * 10**8  # bytes: histories that need more are counted, not built


@dataclass(frozen=True)
class Size:
    """States of an automaton and of its product, and entries of a stationary table Q(s, q, a), eight bytes each."""

    automaton_states: int
    product_states: int
    q_entries: int

    @property
    def q_bytes(self) -> int:
        return 8 * self.q_entries


@dataclass(frozen=True)
class Encodings:
    """The encodings of a task on a model, side by side.

    history            None if there are more states than a double can count
    all_histories, possible_histories, history_entries   sequences of `remembered_steps` model states: all of them,
                       those along transitions, and the entries of a Q-table on these
    optimum            P* on the exact product
    history_optimum    P* again, on histories; None, and why in `history_refused`, if that takes too much memory
    """

    states: int
    remembered_steps: int
    flags: Size
    exact: Size
    history: Size | None
    all_histories: int
    possible_histories: int
    history_entries: int
    optimum: float
    history_optimum: float | None
    history_refused: str | None


@dataclass(frozen=True)
class Story:
    """The paper's two claims about representation on a scenario: surrogate against task, flags against histories."""

    scenario: str
    surrogates: tuple[SurrogateResult, ...]
    encodings: Encodings


def compare_encodings(product: Product, memory_limit: int = _BUILT) -> Encodings:
    """The encodings of a product's task; histories are built and checked within `memory_limit` bytes.

    Raises FragmentError for a task that has no flags.
    """
    model, phi = product.model, product.formula
    flags = with_flags(product)
    exact = product if product.automaton.encoding == "exact" else build_product(model, phi)
    length, n_letters = history_length(phi), len(exact.automaton.valuations)
    history_optimum, refused = None, None
    try:
        built = build_product(model, phi, "history", memory_limit)
        history_optimum = check(built, keep_policy=False, memory_limit=memory_limit).probability
    except SizeError as refusal:
        refused = str(refusal)
    ends = state_histories(model, length)
    histories = history_states(phi, n_letters)
    return Encodings(
        states=model.n_states,
        remembered_steps=length,
        flags=_size(model, flags.automaton.n_states),
        exact=_size(model, exact.automaton.n_states),
        history=_size(model, int(histories)) if histories != float("inf") else None,
        all_histories=model.n_states**length,
        possible_histories=sum(ends),
        history_entries=sum(n * int(c) for n, c in zip(ends, np.diff(model.choice_start), strict=True)),
        optimum=check(exact, keep_policy=False).probability,
        history_optimum=history_optimum,
        history_refused=refused,
    )


def story_of(scenario: str, product: Product) -> Story | None:
    """The paper's claims on a product; None for a task that has no flags, or a model with intervals."""
    try:
        check_fragment(product.formula)
    except FragmentError:
        return None
    if product.model.uncertain:
        return None
    surrogates = tuple(surrogate_optimum(product, reading) for reading in ("discounted", "episode"))
    return Story(scenario, surrogates, compare_encodings(product))


def state_histories(model: MDP, length: int) -> list[int]:
    """For each state the number of sequences of `length` states that end there, along transitions that can happen."""
    per_state = np.diff(model.row_start[model.choice_start])
    source = np.repeat(np.arange(model.n_states), per_state)[model.probability > 0]
    edges = np.unique(np.stack([source, model.target[model.probability > 0]]), axis=1)
    ends = np.ones(model.n_states, dtype=object)
    for _ in range(length - 1):
        after = np.zeros(model.n_states, dtype=object)
        np.add.at(after, edges[1], ends[edges[0]])
        ends = after
    return [int(n) for n in ends]


def _size(model: MDP, states: int) -> Size:
    return Size(states, model.n_states * states, model.n_choices * states)
