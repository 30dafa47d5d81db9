"""A task explained as plain data: its tree and horizon, the fragment of [Wang24], possible misreadings, sizes."""

from __future__ import annotations

from typing import cast

from stltool.anatomy import Anatomy, take_apart
from stltool.arguments import one_of, require
from stltool.automata import TaskAutomaton
from stltool.automata.compile import ENCODINGS, Encoding
from stltool.logic.formula import (
    Always,
    And,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Not,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    children,
    formula_of,
    horizon,
    is_bounded,
)
from stltool.logic.fragment import Fragment
from stltool.logic.quantities import quantity_text
from stltool.logic.task import Task
from stltool.models import MDP
from stltool.reporting.data import disagreement_data, part_data, product_data, sizes_data
from stltool.reporting.records import ExplainOutput, FragmentRecord, TreeRecord

_MOST_NODES = 500  # nodes of a tree that are listed

_SIGNS: dict[type, str] = {
    Not: "!", And: "&", Or: "|", Implies: "->", Iff: "<->", Eventually: "F", Always: "G", Until: "U",
    Release: "release", Once: "once", Historically: "historically", Since: "since", Trigger: "trigger", Rise: "rise",
}  # fmt: skip


def explain(task: Formula | Task, *, model: MDP | None = None, encoding: Encoding = "exact") -> ExplainOutput:
    """The structure of a task as JSON-compatible data; with a model also the sizes of automaton and product.

    `tree` nests the operators: each has its `operator`, `horizon`, position (`line`, `column`) and `operands`.
    `ambiguities` are texts that other tools would read differently; `meaning` states whether the task can hold and fail
    at all and which of its parts are vacuous, before any model, and `warnings` states the same in words. `fragment` is
    the decomposition along the paper's fragment, or its refusal, which names the smallest sub-formula at fault;
    `automaton` is present if no automaton could be built.
    """
    require(model, MDP, "explain's model", optional=True)
    one_of(encoding, "encoding", ENCODINGS)
    if not isinstance(task, Task):
        task = Task("formula", formula_of(task, "explain's task"))
    parts = take_apart(task, model, encoding)
    facts = _text_data(task)
    if (told := parts.meaning) is None:
        return facts
    facts["meaning"], facts["warnings"] = told.data(), told.warnings()
    if told.holds is not None:
        facts["holds_for_example_on"] = str(told.holds)
    if told.fails is not None:
        facts["fails_for_example_on"] = str(told.fails)
    if isinstance(parts.fragment, Fragment):
        facts["fragment"] = _fragment_data(parts.fragment)
    elif parts.fragment is not None:
        facts["fragment"] = {"refused": parts.fragment}
    if isinstance(parts.automaton, TaskAutomaton):
        _add_automaton(facts, parts.automaton, parts)
    elif parts.automaton is not None:
        facts["automaton"] = {"refused": parts.automaton}
    return facts


def _text_data(task: Task) -> ExplainOutput:
    from stltool.logic.lint import ambiguities  # imports lark, which is slow to load

    steps = horizon(task.formula) if is_bounded(task.formula) else None
    facts: ExplainOutput = {
        "task": task.name,
        "formula": str(task.formula),
        "params": {key: quantity_text(value) for key, value in task.params.items()},
        "horizon": steps,
        "samples_needed": None if steps is None else steps + 1,
        "tree": tree_data(task.formula),
        "ambiguities": [str(advice) for advice in ambiguities(task)],
    }
    if task.step is not None:
        facts["step"] = str(task.step)
    if task.unit is not None:
        facts["unit"] = str(task.unit)
    return facts


def tree_data(phi: Formula) -> TreeRecord:
    """The operators of a formula, nested, each with its horizon and position; cut after the first few hundred."""
    budget = [_MOST_NODES]
    return _tree(phi, budget)


def _tree(phi: Formula, budget: list[int]) -> TreeRecord:
    budget[0] -= 1
    operands: list[TreeRecord] = []
    for child in children(phi):
        if budget[0] <= 0:
            operands.append({"operator": "…", "horizon": None, "operands": []})
            break
        operands.append(_tree(child, budget))
    steps = horizon(phi) if is_bounded(phi) else None
    if phi.span is None:
        return {"operator": _operator(phi), "horizon": steps, "operands": operands}
    line, column = phi.span.line, phi.span.column
    return {"operator": _operator(phi), "horizon": steps, "line": line, "column": column, "operands": operands}


def _operator(phi: Formula) -> str:
    match phi:
        case Constant() | Label() | Comparison():
            return str(phi)
        case Once(Interval(1, 1)):
            return "prev"
        case Eventually(interval) | Always(interval) | Until(interval) | Release(interval):
            return f"{_SIGNS[type(phi)]}{interval}"
        case Once(interval) | Historically(interval) | Since(interval) | Trigger(interval):
            return f"{_SIGNS[type(phi)]}{'' if interval == Interval(0, None) else interval}"
        case _:
            return _SIGNS[type(phi)]


def _fragment_data(fragment: Fragment) -> FragmentRecord:
    return {
        "outer": f"{fragment.outer}[0,{fragment.T})",
        "parts": [str(part) for part in fragment.parts],
        "equal_windows": fragment.uniform,
    }


def _add_automaton(facts: ExplainOutput, automaton: TaskAutomaton, parts: Anatomy) -> None:
    if parts.product is not None:
        facts |= cast(ExplainOutput, product_data(parts.product))
    else:
        facts["automaton_states"] = automaton.n_states
    facts |= cast(ExplainOutput, sizes_data(automaton))
    facts["parts"] = part_data(automaton)
    if isinstance(parts.disagreement, str):
        facts["disagreement"] = parts.disagreement
    elif not automaton.exact:
        facts["disagrees_on"] = disagreement_data(parts.disagreement) if parts.disagreement is not None else None
