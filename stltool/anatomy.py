"""A task taken apart: what it means, its fragment, its automaton, and with a model the product."""

from __future__ import annotations

from dataclasses import dataclass

from stltool.automata import TaskAutomaton, compile_automaton
from stltool.automata.compare import Disagreement, with_formula
from stltool.automata.compile import Encoding
from stltool.automata.vacuity import Meaning, meaning
from stltool.errors import FragmentError, SizeError
from stltool.logic.formula import is_bounded
from stltool.logic.fragment import Fragment, check_fragment
from stltool.logic.task import Task
from stltool.models import MDP
from stltool.product import Product, build_product


@dataclass(frozen=True)
class Anatomy:
    """The parts of a task; what cannot be had is the refusal, in words.

    meaning        None if an interval has no end; nothing else is there then
    disagreement   where an automaton that is not exact disagrees with the formula; None if nowhere
    """

    task: Task
    meaning: Meaning | None = None
    fragment: Fragment | str | None = None
    automaton: TaskAutomaton | str | None = None
    product: Product | None = None
    disagreement: Disagreement | str | None = None


def take_apart(task: Task, model: MDP | None = None, encoding: Encoding = "exact") -> Anatomy:
    """The parts of a task, with a model those of their product."""
    if not is_bounded(task.formula):
        return Anatomy(task)
    means, fragment = meaning(task.formula), _fragment(task)
    product = None
    try:
        if model is not None:
            product = build_product(model, task, encoding)
        automaton = product.automaton if product is not None else compile_automaton(task.formula, encoding)
    except (FragmentError, SizeError) as refusal:
        return Anatomy(task, means, fragment, str(refusal))
    return Anatomy(task, means, fragment, automaton, product, _disagreement(automaton))


def _fragment(task: Task) -> Fragment | str:
    try:
        return check_fragment(task.formula)
    except FragmentError as refusal:
        return str(refusal)


def _disagreement(automaton: TaskAutomaton) -> Disagreement | str | None:
    if automaton.exact:
        return None
    try:
        return with_formula(automaton)
    except SizeError as refusal:
        return str(refusal)
