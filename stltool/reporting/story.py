"""The two claims of [Wang24] about representation, as plain data: surrogate against task, flags against histories.

`surrogate_data` and `encoding_data` give the numbers; `surrogate_rows` and `encoding_rows` turn these, scenario by
scenario, into the rows of a table for the terminal or a page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import Literal

from stltool.checking import SurrogateResult
from stltool.checking.encodings import Encodings, Size, Story
from stltool.numbers import probability_text
from stltool.reporting.records import EncodingsRecord, SectionRecord, SizeRecord, SurrogateRecord
from stltool.sizes import bytes_text

_SHORT = 10**7  # counts below are written in full


def surrogate_data(result: SurrogateResult) -> SurrogateRecord:
    """One reading of the surrogate, and P of its optimal policies for the task, with bounds."""
    return {
        "reading": result.reading,
        "gamma": result.gamma,
        "at_random": result.at_random.probability,
        "at_random_lower": result.at_random.lower,
        "at_random_upper": result.at_random.upper,
        "least": result.least.probability,
        "least_lower": result.least.lower,
        "least_upper": result.least.upper,
        "greatest": result.greatest.probability,
        "greatest_lower": result.greatest.lower,
        "greatest_upper": result.greatest.upper,
        "optimum": result.optimum.probability,
        "optimum_lower": result.optimum.lower,
        "optimum_upper": result.optimum.upper,
        "gap": result.gap,
        "tolerance": result.tolerance,
        "sweeps": result.sweeps,
        "seconds": result.seconds,
        "status": result.status,
    }


def encoding_data(found: Encodings) -> EncodingsRecord:
    """The size of each encoding of the past, for a task of the paper's fragment; counts are exact, however large."""
    return {
        "states": found.states,
        "remembered_steps": found.remembered_steps,
        "flags": _size_data(found.flags),
        "exact": _size_data(found.exact),
        "history": _size_data(found.history) if found.history is not None else None,
        "state_histories": {
            "all": found.all_histories,
            "possible": found.possible_histories,
            "q_entries": found.history_entries,
            "q_bytes": 8 * found.history_entries,
        },
        "optimum": found.optimum,
        "history_optimum": found.history_optimum,
        "history_refused": found.history_refused,
    }


def _size_data(size: Size) -> SizeRecord:
    return {
        "automaton_states": size.automaton_states,
        "product_states": size.product_states,
        "q_entries": size.q_entries,
        "q_bytes": size.q_bytes,
    }


def surrogate_rows(scenarios: Mapping[str, Sequence[SurrogateRecord]]) -> list[dict[str, str]]:
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


def reading_text(reading: SurrogateRecord) -> str:
    """A reading's name, with its discount."""
    return str(reading["reading"]) + (f" γ = {reading['gamma']:g}" if reading["gamma"] is not None else "")


def story_sections(stories: Sequence[Story]) -> list[SectionRecord]:
    """Both tables as sections of a sweep's page, for the scenarios that have them."""
    if not stories:
        return []
    gaps = {story.scenario: [surrogate_data(result) for result in story.surrogates] for story in stories}
    sizes = {story.scenario: encoding_data(story.encodings) for story in stories}
    return [
        {
            "title": "The surrogate's gap",
            "text": "P* minus the exact P of policies that are optimal for the paper's surrogate reward: with ties "
            "broken at random, and for the worst of them.",
            "rows": surrogate_rows(gaps),
            "figure": None,
        },
        {
            "title": "Flags against histories",
            "text": "Sequences of τ states, all and those that can happen; product states with histories of letters, "
            "flags and the exact automaton; the sizes of a Q-table on each.",
            "rows": encoding_rows(sizes),
            "figure": None,
        },
    ]


def gap_text(reading: SurrogateRecord, which: Literal["at_random", "least"]) -> str:
    """P* minus the P of `which` policies; "none" if their enclosures overlap."""
    upper = reading["at_random_upper"] if which == "at_random" else reading["least_upper"]
    if upper >= reading["optimum_lower"]:
        return "none"
    return f"{reading['optimum'] - reading[which]:.2g}"


def encoding_rows(scenarios: Mapping[str, EncodingsRecord]) -> list[dict[str, str]]:
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
