"""The two claims of [Wang24] about representation, as plain data: surrogate against task, flags against histories.

`surrogate_data` and `encoding_data` give the numbers; `surrogate_rows` and `encoding_rows` turn these, scenario by
scenario, into the rows of a table for the terminal or a page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import Any

import numpy as np

from stltool.automata.history import history_length, history_states
from stltool.checking import SurrogateResult, check, surrogate_optimum
from stltool.errors import FragmentError, SizeError
from stltool.logic.fragment import check_fragment
from stltool.models import MDP
from stltool.numbers import probability_text
from stltool.policy import with_flags
from stltool.product import Product, build_product
from stltool.sizes import bytes_text

_BUILT = 5 * 10**8  # bytes: histories that need more are counted, not built
_SHORT = 10**7  # counts below are written in full


def surrogate_data(result: SurrogateResult) -> dict[str, Any]:
    """One reading of the surrogate, and P of its optimal policies for the task, with bounds."""
    judged = {
        "at_random": result.at_random,
        "least": result.least,
        "greatest": result.greatest,
        "optimum": result.optimum,
    }
    figures: dict[str, float] = {}
    for name, check_result in judged.items():
        figures |= {
            name: check_result.probability,
            f"{name}_lower": check_result.lower,
            f"{name}_upper": check_result.upper,
        }
    return {
        "reading": result.reading,
        "gamma": result.gamma,
        **figures,
        "gap": result.gap,
        "tolerance": result.tolerance,
        "sweeps": result.sweeps,
        "seconds": result.seconds,
        "status": result.status,
    }


def encoding_data(product: Product, memory_limit: int = _BUILT) -> dict[str, Any]:
    """The size of each encoding of the past, for a task of the paper's fragment; counts are exact, however large.

    flags, exact, history   the paper's flags, the exact automaton, the histories of τ letters (automata/history.py):
                            states of the automaton and of the product, entries of a stationary Q(s, q, a), its bytes
    state_histories         sequences of τ model states, what a τ-MDP remembers: `all`, |Σ|^τ as the paper counts;
                            `possible` along transitions; entries and bytes of a Q-table on the possible ones
    optimum                 P* on the exact product
    history_optimum         P* again, on histories; None, and why in `history_refused`, if over `memory_limit` bytes
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
    n_entries = sum(n * int(c) for n, c in zip(ends, np.diff(model.choice_start), strict=True))
    return {
        "states": model.n_states,
        "remembered_steps": length,
        "flags": _sizes(model, flags.automaton.n_states),
        "exact": _sizes(model, exact.automaton.n_states),
        "history": _sizes(model, history_states(phi, n_letters)),
        "state_histories": {
            "all": model.n_states**length,
            "possible": sum(ends),
            "q_entries": n_entries,
            "q_bytes": 8 * n_entries,
        },
        "optimum": check(exact, keep_policy=False).probability,
        "history_optimum": history_optimum,
        "history_refused": refused,
    }


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


def _sizes(model: MDP, automaton_states: int | float) -> dict[str, int] | None:
    """None if there are more states than a double can count."""
    if automaton_states == float("inf"):
        return None
    states = int(automaton_states)
    return {
        "automaton_states": states,
        "product_states": model.n_states * states,
        "q_entries": model.n_choices * states,
        "q_bytes": 8 * model.n_choices * states,
    }


def surrogate_rows(scenarios: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[dict[str, str]]:
    """A row for each scenario, from its readings as given by `surrogate_data`, the same ones in every scenario.

    A gap is P* minus P: with ties broken at random, and for the worst policy that is optimal for the surrogate.
    """
    rows = []
    for name, readings in scenarios.items():
        row = {"scenario": name, "optimum P*": probability_text(readings[0]["optimum"])}
        for reading in readings:
            row[f"gap, {reading_text(reading)}"] = gap_text(reading, "at_random")
            row[f"at worst, {reading_text(reading)}"] = gap_text(reading, "least")
        rows.append(row)
    return rows


def reading_text(reading: Mapping[str, Any]) -> str:
    """A reading's name, with its discount."""
    return str(reading["reading"]) + (f" γ = {reading['gamma']:g}" if reading["gamma"] is not None else "")


def story_sections(products: Sequence[tuple[str, Product]]) -> list[dict[str, Any]]:
    """Both tables as sections of a sweep's page, for the tasks, by scenario name, that have flags."""
    inside = [(name, product) for name, product in products if _has_flags(product)]
    if not inside:
        return []
    gaps = {
        name: [surrogate_data(surrogate_optimum(product, reading)) for reading in ("discounted", "episode")]
        for name, product in inside
    }
    sizes = {name: encoding_data(product) for name, product in inside}
    return [
        {
            "title": "The surrogate's gap",
            "text": "P* minus the exact P of policies that are optimal for the paper's surrogate reward: with ties "
            "broken at random, and for the worst of them.",
            "rows": surrogate_rows(gaps),
        },
        {
            "title": "Flags against histories",
            "text": "Sequences of τ states, all and those that can happen; product states with histories of letters, "
            "flags and the exact automaton; the sizes of a Q-table on each.",
            "rows": encoding_rows(sizes),
        },
    ]


def _has_flags(product: Product) -> bool:
    try:
        check_fragment(product.formula)
    except FragmentError:
        return False
    return not product.model.uncertain


def gap_text(reading: Mapping[str, Any], which: str) -> str:
    """P* minus the P of `which` policies; "none" if their enclosures overlap."""
    if reading[f"{which}_upper"] >= reading["optimum_lower"]:
        return "none"
    return f"{reading['optimum'] - reading[which]:.2g}"


def encoding_rows(scenarios: Mapping[str, Mapping[str, Any]]) -> list[dict[str, str]]:
    """A row for each scenario; values as given by `encoding_data`."""
    rows = []
    for name, data in scenarios.items():
        histories, letters = data["state_histories"], data["history"]
        same = data["history_optimum"]
        rows.append({
            "scenario": name,
            "|Σ|^τ": count_text(histories["all"]),
            "possible": count_text(histories["possible"]),
            "× letters": count_text(letters["product_states"]) if letters else "over 1e300",
            "× flags": count_text(data["flags"]["product_states"]),
            "× exact": count_text(data["exact"]["product_states"]),
            "Q: possible": bytes_text(histories["q_bytes"]),
            "letters": bytes_text(letters["q_bytes"]) if letters else "",
            "flags": bytes_text(data["flags"]["q_bytes"]),
            "exact": bytes_text(data["exact"]["q_bytes"]),
            "P* on letters": "too large" if same is None else f"differs by {abs(same - data['optimum']):.1g}",
        })  # fmt: skip
    return rows


def count_text(n: int) -> str:
    """An integer, in three digits if it is long."""
    return str(n) if n < _SHORT else f"{Decimal(n):.3g}"
