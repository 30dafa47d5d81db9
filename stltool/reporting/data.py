"""Results as plain data: printed by `--json`, and the source of reports."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from importlib import metadata
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from stltool.automata import TaskAutomaton, compile_automaton
from stltool.automata.compare import disagreement
from stltool.automata.compile import all_valuations, atoms_of
from stltool.automata.history import history_states
from stltool.checking import (
    CheckResult,
    Estimate,
    Run,
    SequentialTest,
    StationaryResult,
    likely_runs,
    sample_run,
    sensitivity,
)
from stltool.errors import FragmentError, SettingsError
from stltool.logic.formula import Comparison, Formula, Label, boolean_value, walk
from stltool.logic.fragment import check_fragment
from stltool.numbers import fraction_text
from stltool.policy import Policy
from stltool.product import Product
from stltool.reporting.guarantees import guarantee_data
from stltool.reporting.runs import likely_data, sensitivity_data

if TYPE_CHECKING:  # a check loads no learners
    from stltool.learning import Gap, Guarantee, Training

FORMAT, SWEEP_FORMAT = "stltool-report-1", "stltool-sweep-1"
_LIKELY, _SENSITIVE = 5, 5  # runs and states that a report shows
_MOST_EDGES = 1e7  # of the unfolded product, at most (some seconds); beyond, `stltool why` can still be used


def product_data(product: Product) -> dict[str, Any]:
    """The task and the sizes."""
    model, automaton = product.model, product.automaton
    return {
        "task": product.task_name,
        "formula": str(product.formula),
        "horizon": product.horizon,
        "encoding": automaton.encoding,
        "exact_encoding": automaton.exact,
        "model": model.name,
        "model_digest": model.digest(),
        "automaton_digest": automaton.digest(),
        "model_notes": list(model.notes.values()),
        "initial": model.initial_text(),
        "initial_states": int(np.count_nonzero(model.initial)),
        "states": model.n_states,
        "actions": list(model.action_names),
        "transitions": model.n_transitions if model.blackbox is None and model.kinds is not None else None,  # unknown
        "automaton_states": automaton.n_states,
        "letters": automaton.n_letters,
        "product_states": product.n_states,
    }


def part_data(automaton: TaskAutomaton) -> list[dict[str, Any]]:
    """The parts of an automaton, with delays and sizes."""
    return [
        {
            "part": str(part.formula),
            "obligation_of_each_start": str(part.obligation),
            "delay": part.delay,
            "method": part.method,
            "explored": part.explored,
            "states": part.states,
        }
        for part in automaton.parts
    ]


def encoding_sizes(automaton: TaskAutomaton) -> dict[str, Any]:
    """How many states the other encodings of the same formula would have; None if there is no such encoding."""
    flags: int | None
    try:
        flags = math.prod(part.tau + 1 for part in check_fragment(automaton.formula).parts)
    except FragmentError:
        flags = None
    histories = history_states(automaton.formula, len(automaton.valuations))
    return {"flag_states": flags, "history_states": histories if histories < math.inf else "over 1e300"}


def disagreement_data(automaton: TaskAutomaton) -> dict[str, Any] | None:
    """A shortest trace on which an automaton and its formula disagree, in labels and comparisons; None if none.

    Only valuations that the automaton accepts occur: with a model, those of its states. Without one, comparisons are
    treated as independent of each other. Raises SizeError if the search would be too large.
    """
    leaves = list(dict.fromkeys(n for n in walk(automaton.formula) if isinstance(n, Label | Comparison)))
    valuations = all_valuations(len(leaves))

    def truths(psis: Sequence[Formula]) -> NDArray[np.bool_]:
        known: list[dict[Formula, bool]] = [dict(zip(leaves, row, strict=True)) for row in valuations.tolist()]
        return np.array([[boolean_value(psi, row.get) for psi in psis] for row in known], dtype=np.bool_)

    truth, exact_truth = truths(automaton.atoms), truths(atoms_of(automaton.formula))
    occurring = {row.tobytes() for row in automaton.valuations}
    possible = np.array([row.tobytes() in occurring for row in truth])
    valuations, truth, exact_truth = valuations[possible], truth[possible], exact_truth[possible]
    exact = compile_automaton(automaton.formula, "exact", np.unique(exact_truth, axis=0))
    letters = exact.letters_at(exact_truth)
    trace = disagreement(automaton, exact, automaton.letters_at(truth), letters)
    if trace is None:
        return None
    judged = exact.judge(letters[trace].tolist())
    assert judged is not None
    return {
        "steps": [
            {"step": t, **{str(leaf): bool(value) for leaf, value in zip(leaves, valuations[symbol], strict=True)}}
            for t, symbol in enumerate(trace)
        ],
        "encoding_says": not judged[0],
        "formula_is": judged[0],
    }


def check_data(result: CheckResult, optimum: CheckResult | None = None) -> dict[str, Any]:
    """One check, flat; `optimum` is the best over all policies, for the gap (default: the result itself)."""
    best = optimum if optimum is not None else result
    return {
        **product_data(result.product),
        "question": result.question,
        "nature": result.nature,
        "policy": result.policy.kind if result.policy is not None else None,
        "probability": result.probability,
        "lower": result.lower,
        "upper": result.upper,
        "exact": fraction_text(result.fraction) if result.fraction is not None else None,
        "arithmetic": result.arithmetic,
        "optimum": best.probability,
        "optimum_lower": best.lower,
        "optimum_upper": best.upper,
        "gap": abs(best.probability - result.probability),
        "status": result.status,
        "certain": result.certainty,
        "engine": result.engine,
        "sweeps": result.sweeps,
        "seconds": result.seconds,
    }


def stationary_data(found: StationaryResult) -> dict[str, Any]:
    """A search among policies that do not know the step: what it found, its bound, and the candidates."""
    return {
        "kind": found.kind,
        "probability": found.probability,
        "lower": found.best.lower,
        "upper": found.best.upper,
        "optimum": found.optimum.probability,
        "gap": found.gap,
        "bound": found.bound,
        "proved": found.proved,
        "status": found.status,
        "evaluated": len(found.candidates),
        "candidates": [dataclasses.asdict(candidate) for candidate in found.candidates],
        "relaxations": found.nodes,
        "seconds": found.seconds,
    }


def estimate_data(
    result: Estimate | SequentialTest,
    product: Product,
    policy: Policy,
    exact: CheckResult | None = None,
) -> dict[str, Any]:
    """One statistical check, flat; `exact` is the exact check of the same policy, shown next to it."""
    inside, decided = None, {}
    if isinstance(result, SequentialTest):
        decided = {"holds": result.verdict == "holds"}
    elif exact is not None:
        inside = result.lower <= exact.upper and exact.lower <= result.upper
    return {
        **product_data(product),
        "policy": policy.kind,
        **_finite(dataclasses.asdict(result)),
        **decided,
        "statement": result.statement,
        "exact": exact.probability if exact is not None else None,
        "exact_lower": exact.lower if exact is not None else None,
        "exact_upper": exact.upper if exact is not None else None,
        "exact_inside": inside,
    }


def _finite(data: dict[str, Any]) -> dict[str, Any]:
    """JSON has no infinity: an infinite ratio is omitted."""
    return {key: value for key, value in data.items() if not (isinstance(value, float) and math.isinf(value))}


def training_data(training: Training) -> dict[str, Any]:
    """A training run: method, settings, and its exact learning curve."""
    from stltool.learning.settings import recorded

    return {
        "method": training.method,
        "faithful": training.faithful,
        "seed": training.seed,
        "settings": training.settings,
        "budget": recorded(training.budget),
        "status": training.status,
        "settled": training.settled,
        "advice": training.advice,
        "environment_steps": training.environment_steps,
        "seconds": training.seconds,
        "history": [
            {"episode": point.episode, "steps": point.steps, "probability": point.probability}
            | ({"gap": point.gap} if point.gap is not None else {})
            for point in training.history
        ],
        **({"gap": gap_data(training.gap)} if training.gap is not None else {}),
    }


def gap_data(gap: Gap) -> dict[str, Any]:
    """What transitions prove about a policy's distance to the optimum."""
    return {
        "upper": gap.upper,
        "confidence": gap.confidence,
        "without_data": gap.without_data,
        "transitions": gap.transitions,
        "assumes": gap.assumes,
        "statement": gap.statement,
        "looser": gap.looser,
        "refused": gap.refused,
        "parameters": [
            {"name": one.name, "lower": float(one.lower), "upper": float(one.upper), "estimate": float(one.estimate)}
            for one in gap.parameters
        ],
    }


def markov_data(training: Training) -> dict[str, Any] | None:
    """For a black box, whether the data contradict the Markov assumption; None if the model is known, or nothing was
    learned."""
    from stltool.learning.markov import markov_test

    model = cast(Product, training.policy.home).model  # learners do not support joint products
    if model.blackbox is None or not training.environment_steps:
        return None
    found = markov_test(training.counts, seed=training.seed)
    return {
        **dataclasses.asdict(found),
        "rejected": found.rejected,
        "statement": found.statement,
        "most": [{"choice": model.place(choice), "deviations": deviations} for choice, deviations in found.most],
    }


def report_data(
    results: Sequence[CheckResult],
    training: Training | None = None,
    *,
    source: str | None = None,
    command: str | None = None,
    seed: int = 0,
    estimates: Sequence[Estimate] = (),
    guarantees: Sequence[Guarantee | Estimate | dict[str, Any]] = (),
    stationary: Sequence[StationaryResult] = (),
    product: Product | None = None,
) -> dict[str, Any]:
    """Everything a report shows. `source` is the text of the task file, `command` the command that repeats the run.

    `estimates` of the policy shown (the given one, else the optimal one) appear next to its exact probability, and so
    do `guarantees` for it from data: as found, or in the form of `guarantee_data`. `stationary` are
    searches among policies that do not know the step. A black box has no results: its
    report opens with the first of `guarantees`, for the policy of `training`, on `product` (default: the policy's own).
    """
    if results:
        shown = next((r for r in results if r.question == "policy"), results[0])
        policy, home = shown.policy, results[0].product
    elif training is not None and guarantees:
        policy, home = training.policy, cast(Product, training.policy.home)  # learners do not support joint products
    else:
        raise SettingsError(
            "a report needs at least one check result, or, for a black box, a training and a guarantee for its policy"
        )
    product = product if product is not None else home
    for result in (*results, *(found.optimum for found in stationary)):
        if (result.product.model.digest(), result.product.automaton.digest()) != (
            product.model.digest(),
            product.automaton.digest(),
        ):
            raise SettingsError("the results belong to several models or tasks; write one report for each")
    optima = {r.nature: r for r in reversed(results) if r.question != "policy"}
    points = not product.model.uncertain  # else there is no single distribution to sample from
    return {
        "format": FORMAT,
        "version": metadata.version("stltool"),
        **product_data(product),
        "source": source,
        "command": command,
        "checks": [check_data(result, optima.get(result.nature)) for result in results],
        "estimates": [{**dataclasses.asdict(estimate), "statement": estimate.statement} for estimate in estimates],
        "guarantees": [found if isinstance(found, dict) else guarantee_data(found) for found in guarantees],
        "stationary": [stationary_data(found) for found in stationary],
        "training": training_data(training) if training is not None else None,
        "markov": markov_data(training) if training is not None else None,
        "run": _run_data(product, policy, seed) if policy is not None and points else None,
        "why": _why_data(product, policy) if policy is not None and points and results else None,
        "floor": floor_data(product),
    }


def _why_data(product: Product, policy: Policy) -> dict[str, Any] | None:
    """The most probable violating runs and the most sensitive states; None if finding them could take long."""
    branches = 1 if policy.deterministic else product.model.most_choices
    successors = product.model.n_transitions / product.model.n_choices
    if product.horizon * product.n_states * branches * successors > _MOST_EDGES:
        return None
    return {
        **likely_data(likely_runs(product, policy, count=_LIKELY)),
        "sensitive": sensitivity_data(sensitivity(product, policy), _SENSITIVE),
    }


def _run_data(product: Product, policy: Policy, seed: int) -> dict[str, Any]:
    run: Run = sample_run(product, policy, seed)
    model = product.model
    steps = [
        {
            "step": t,
            "state": model.state_name(s),
            "signals": {name: float(values[s]) for name, values in model.signals.items()},
            "labels": [name for name, values in model.labels.items() if values[s]],
            "memory": memory,
            "action": run.actions[t] if t < len(run.actions) else None,
        }
        for t, (s, memory) in enumerate(zip(run.states, run.memory, strict=True))
    ]
    return {"satisfied": run.satisfied, "seed": seed, "states": list(run.states), "steps": steps}


def floor_data(product: Product) -> dict[str, Any] | None:
    layout = product.model.layout
    if layout is None:
        return None
    return {
        "width": layout.width,
        "height": layout.height,
        "column": layout.column.tolist(),
        "row": layout.row.tolist(),
        "labels": {name: np.flatnonzero(values).tolist() for name, values in product.model.labels.items()},
        "initial": np.flatnonzero(product.model.initial).tolist(),
    }
