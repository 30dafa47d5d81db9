"""Results as plain data: printed by `--json`, and the source of reports."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from importlib import metadata
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from stltool.automata import TaskAutomaton
from stltool.automata.compare import Disagreement
from stltool.automata.flags import flag_states
from stltool.automata.history import history_states
from stltool.checking import CheckResult, Counterfactual, Estimate, Run, SequentialTest, StationaryResult
from stltool.checking.evidence import Evidence
from stltool.errors import SettingsError
from stltool.logic.printer import with_names
from stltool.models import MDP
from stltool.models.compare import ModelDifferences
from stltool.numbers import fraction_text
from stltool.policy import Policy
from stltool.product import Product
from stltool.reporting.explorer import automaton_data, explorer_data
from stltool.reporting.guarantees import guarantee_data
from stltool.reporting.records import (
    AskedRecord,
    CheckRecord,
    CounterfactualOutput,
    DisagreementRecord,
    EncodingSizes,
    EstimateOutput,
    EstimateRecord,
    FloorRecord,
    GapRecord,
    GuaranteeRecord,
    HistoryRecord,
    MarkovRecord,
    PartRecord,
    ProductRecord,
    ProvedRecord,
    ReportRecord,
    RunRecord,
    SequentialOutput,
    StationaryRecord,
    StatisticalRecord,
    StepRecord,
    TrainingRecord,
    TransferRecord,
    WhyRecord,
)
from stltool.reporting.runs import likely_data, sensitivity_data
from stltool.reporting.what_if import what_if_data
from stltool.reporting.words import sentences

if TYPE_CHECKING:  # a check loads no learners
    from stltool.learning import Gap, Guarantee, MarkovTest, Training
    from stltool.learning.trainer import Point

FORMAT: Literal["stltool-report-1"] = "stltool-report-1"
SWEEP_FORMAT: Literal["stltool-sweep-1"] = "stltool-sweep-1"
VERIFY_FORMAT: Literal["stltool-verify-1"] = "stltool-verify-1"
_SENSITIVE = 5  # states that a report shows


def product_data(product: Product) -> ProductRecord:
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
        "model_notes": [*model.notes.values(), *product.notes],
        "initial": model.initial_text(),
        "initial_states": int(np.count_nonzero(model.initial)),
        "states": model.n_states,
        "actions": list(model.action_names),
        "transitions": model.n_transitions if model.blackbox is None and model.kinds is not None else None,  # unknown
        "automaton_states": automaton.n_states,
        "letters": automaton.n_letters,
        "product_states": product.n_states,
    }


def part_data(automaton: TaskAutomaton) -> list[PartRecord]:
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


def sizes_data(automaton: TaskAutomaton) -> EncodingSizes:
    """How many states the other encodings of the same formula would have; None if there is no such encoding."""
    flags, histories = flag_states(automaton.formula), history_states(automaton.formula, len(automaton.valuations))
    return {"flag_states": flags, "history_states": int(histories) if histories < math.inf else "over 1e300"}


def disagreement_data(found: Disagreement) -> DisagreementRecord:
    """A trace on which an automaton and its formula disagree, in labels and comparisons."""
    return {
        "steps": [
            {"step": t, **{str(leaf): truth for leaf, truth in step.items()}} for t, step in enumerate(found.steps)
        ],
        "encoding_says": found.encoding_says,
        "formula_is": found.formula_is,
    }


def check_data(result: CheckResult, optimum: CheckResult | None = None) -> CheckRecord:
    """One check, flat; `optimum` is the best over all policies, for the gap (default: the result itself)."""
    best = optimum if optimum is not None else result
    data: CheckRecord = {
        **product_data(result.product),  # type: ignore[typeddict-item]  # the values are added below
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
    if result.values is not None:
        data["values"] = [
            {
                "state": each.name,
                "probability": each.value,
                "lower": each.lower,
                "upper": each.upper,
                "exact": fraction_text(each.fraction) if each.fraction is not None else None,
            }
            for each in result.values
        ]
    return data


def transfer_data(found: ModelDifferences) -> TransferRecord:
    """How the model of a check differs from the one that the policy was made for."""
    there, here = found.names
    return {
        "from_model": there,
        "to_model": here,
        "told": list(found.told),
        "states_only_there": list(found.states[0]),
        "states_only_here": list(found.states[1]),
        "actions_only_there": list(found.actions[0]),
        "actions_only_here": list(found.actions[1]),
        "signals": found.signals,
        "labels": found.labels,
        "choices_only_there": found.choices[0],
        "choices_only_here": found.choices[1],
        "common_choices": found.common,
        "other_successors": found.successors,
        "other_probabilities": found.probabilities,
        "distance": found.distance,
        "at": found.place,
        "start": found.start,
    }


def stationary_data(found: StationaryResult) -> StationaryRecord:
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
        "candidates": [{"made": one.made, "probability": one.probability} for one in found.candidates],
        "relaxations": found.nodes,
        "seconds": found.seconds,
    }


def estimate_data(
    result: Estimate | SequentialTest,
    product: Product,
    policy: Policy,
    exact: CheckResult | None = None,
) -> EstimateOutput | SequentialOutput:
    """One statistical check, flat; `exact` is the exact check of the same policy, shown next to it."""
    inside = None
    if isinstance(result, Estimate) and exact is not None:
        inside = result.lower <= exact.upper and exact.lower <= result.upper
    found: StatisticalRecord = {
        **product_data(product),
        "policy": policy.kind,
        "runs": result.runs,
        "satisfied": result.satisfied,
        "seed": result.seed,
        "seconds": result.seconds,
        "statement": result.statement,
        "exact": exact.probability if exact is not None else None,
        "exact_lower": exact.lower if exact is not None else None,
        "exact_upper": exact.upper if exact is not None else None,
        "exact_inside": inside,
    }
    if isinstance(result, Estimate):
        return {
            **found,
            "probability": result.probability,
            "lower": result.lower,
            "upper": result.upper,
            "confidence": result.confidence,
            "side": result.side,
            "method": result.method,
            "steps": result.steps,
        }
    return {
        **found,
        "verdict": result.verdict,
        "holds": result.verdict == "holds",
        "at_least": result.at_least,
        "indifference": result.indifference,
        "alpha": result.alpha,
        "beta": result.beta,
        "log_likelihood_ratio": ratio if math.isfinite(ratio := result.log_likelihood_ratio) else None,
        "accept_below": result.accept_below,
        "reject_above": result.reject_above,
    }


def training_data(training: Training) -> TrainingRecord:
    """A training run: method, settings, and its exact learning curve."""
    from stltool.learning.settings import recorded

    data: TrainingRecord = {
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
        "history": [_point_data(point) for point in training.history],
    }
    if training.gap is not None:
        data["gap"] = gap_data(training.gap)
    return data


def _point_data(point: Point) -> HistoryRecord:
    data: HistoryRecord = {"episode": point.episode, "steps": point.steps, "probability": point.probability}
    if point.gap is not None:
        data["gap"] = point.gap
    return data


def gap_data(gap: Gap) -> GapRecord:
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


def markov_data(found: MarkovTest, model: MDP) -> MarkovRecord:
    """Whether data contradict the Markov assumption."""
    return {
        "p_value": found.p_value,
        "confidence": found.confidence,
        "dependence": found.dependence,
        "transitions": found.transitions,
        "choices": found.choices,
        "most": [{"choice": model.place(choice), "deviations": deviations} for choice, deviations in found.most],
        "statistic": found.statistic,
        "expected": found.expected,
        "draws": found.draws,
        "seed": found.seed,
        "seconds": found.seconds,
        "rejected": found.rejected,
        "statement": found.statement,
    }


def report_data(
    results: Sequence[CheckResult],
    training: Training | None = None,
    *,
    source: str | None = None,
    command: str | None = None,
    estimates: Sequence[Estimate] = (),
    guarantees: Sequence[Guarantee | Estimate | GuaranteeRecord] = (),
    stationary: Sequence[StationaryResult] = (),
    evidence: Evidence | None = None,
    markov: MarkovTest | None = None,
    asked: Sequence[AskedRecord] = (),
    certificate: ProvedRecord | None = None,
    product: Product | None = None,
) -> ReportRecord:
    """Everything a report shows. `source` is the text of the task file, `command` the command that repeats the run.

    `estimates` of the policy shown (`policy_shown`) appear next to its exact probability, and so do `guarantees` for it
    from data, as found or in the form of `guarantee_data`, and the `evidence` of its runs. `stationary` are searches
    among policies that do not know the step. A black box has no results: its report opens with the first of
    `guarantees`, for the policy of `training`, on `product` (default: the policy's own); `markov` tests its data.
    `asked` are bounds with their verdicts, and `certificate` is what was written to prove the value shown.
    """
    if not results and (training is None or not guarantees):
        raise SettingsError(
            "a report needs at least one check result, or, for a black box, a training and a guarantee for its policy"
        )
    product = product if product is not None else policy_shown(results, training)[1]
    for result in (*results, *(found.optimum for found in stationary)):
        if (result.product.model.digest(), result.product.automaton.digest()) != (
            product.model.digest(),
            product.automaton.digest(),
        ):
            raise SettingsError("the results belong to several models or tasks; write one report for each")
    optima = {r.nature: r for r in reversed(results) if r.question != "policy"}
    shown = next((r for r in results if r.question == "policy"), results[0] if results else None)
    text = with_names(product.definitions)
    return {
        "format": FORMAT,
        "version": metadata.version("stltool"),
        **product_data(product),
        "source": source,
        "command": command,
        "checks": [check_data(result, optima.get(result.nature)) for result in results],
        "estimates": [_estimate_record(estimate) for estimate in estimates],
        "guarantees": [found if isinstance(found, dict) else guarantee_data(found) for found in guarantees],
        "stationary": [stationary_data(found) for found in stationary],
        "training": training_data(training) if training is not None else None,
        "markov": markov_data(markov, product.model) if markov is not None else None,
        "run": run_data(evidence.run, evidence.seed, product) if evidence is not None else None,
        "why": _why_data(evidence) if evidence is not None else None,
        "floors": list(floors_data(product.model)),
        "asked": list(asked),
        "certificate": certificate,
        "words": sentences(product.formula, text),
        "names": {name: str(phi) for name, phi in product.definitions.items() if name != str(phi)},
        "automaton": automaton_data(_explored(product, shown).automaton, text),
        "explorer": explorer_data(
            product,
            shown,
            optima.get(shown.nature) if shown is not None else None,
            evidence.run if evidence is not None else None,
            learned=training is not None,
        ),
    }


def _explored(product: Product, shown: CheckResult | None) -> Product:
    """The product that the explorer works on: it also has the memory of a policy with its own automaton."""
    if shown is None or shown.policy is None or product.model.blackbox is not None:
        return product
    return shown.policy.on(product)[0]


def policy_shown(results: Sequence[CheckResult], training: Training | None) -> tuple[Policy | None, Product]:
    """The policy that a report is about, the given one, else the optimal one, else the learned one; and its product."""
    if results:
        shown = next((r for r in results if r.question == "policy"), results[0])
        return shown.policy, results[0].product
    assert training is not None
    return training.policy, cast(Product, training.policy.home)  # learners do not support joint products


def _estimate_record(found: Estimate) -> EstimateRecord:
    return {
        "runs": found.runs,
        "satisfied": found.satisfied,
        "probability": found.probability,
        "lower": found.lower,
        "upper": found.upper,
        "confidence": found.confidence,
        "side": found.side,
        "method": found.method,
        "steps": found.steps,
        "seed": found.seed,
        "seconds": found.seconds,
        "statement": found.statement,
    }


def _why_data(found: Evidence) -> WhyRecord | None:
    if found.likely is None or found.sensitive is None:
        return None
    return {
        **likely_data(found.likely),
        "sensitive": sensitivity_data(found.sensitive, _SENSITIVE),
        "what_if": what_if_data(found.what_if) if found.what_if is not None else None,
    }


def counterfactual_data(found: Counterfactual) -> CounterfactualOutput:
    """What `stltool counterfactual --json` prints."""
    return {**product_data(found.product), "policy": found.policy.kind, **what_if_data(found)}


def run_data(run: Run, seed: int, product: Product) -> RunRecord:
    """A sampled run, in the user's names."""
    model = product.model
    steps: list[StepRecord] = [
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


def floors_data(model: MDP, member: str = "", stride: int = 1) -> Iterator[FloorRecord]:
    """The floor of a grid, or those of a composition's members that are grids; `stride` as in the record."""
    layout = model.layout
    if layout is not None:
        yield {
            "member": member,
            "stride": stride,
            "width": layout.width,
            "height": layout.height,
            "column": layout.column.tolist(),
            "row": layout.row.tolist(),
            "labels": {name: np.flatnonzero(values).tolist() for name, values in model.labels.items()},
            "initial": np.flatnonzero(model.initial).tolist(),
        }
    stride *= math.prod(one.n_states for one in model.members.values())
    for name, one in model.members.items():
        stride //= one.n_states
        yield from floors_data(one, f"{member}.{name}" if member else name, stride)
