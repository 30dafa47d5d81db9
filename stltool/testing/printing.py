"""How Hypothesis prints what the strategies draw: as Python code that makes it again, given `import stltool as stl`."""

from __future__ import annotations

from fractions import Fraction
from typing import Any, get_args

import numpy as np
from hypothesis.vendor import pretty

from stltool.choices import Table
from stltool.logic.formula import Formula
from stltool.logic.task import Task
from stltool.models import MDP
from stltool.policy import Policy
from stltool.product import Product

_MOST_ENTRIES = 4000  # of a model or a policy that is printed in full


def code(thing: object) -> str:
    """Python code that makes a formula, task, model, product or policy again; its short description if that is long."""
    match thing:
        case MDP():
            return model_code(thing)
        case Product():
            asked = f", encoding={thing.automaton.encoding!r}" if thing.automaton.encoding != "exact" else ""
            return f"stl.build_product({code(thing.model)}, stl.parse({str(thing.formula)!r}){asked})"
        case Policy():
            return _policy_code(thing)
        case Task():
            text = thing.document.source.text if thing.document is not None else f"{thing.name} := {thing.formula}"
            return f"stl.parse_task({text!r})"
        case _ if isinstance(thing, get_args(Formula)):
            return f"stl.parse({str(thing)!r})"
        case _:
            return repr(thing)


def model_code(model: MDP) -> str:
    """`stl.MDP.from_arrays(…)`, or `from_intervals`, of a small model."""
    entries = model.n_actions * model.n_states**2
    if model.blackbox is not None or model.sensing is not None or model.parameters or entries > _MOST_ENTRIES:
        return repr(model)
    if model.uncertain:
        assert model.intervals is not None
        made = "from_intervals"
        rows = [_dense(model, model.intervals.lower.tolist()), _dense(model, model.intervals.upper.tolist())]
    else:
        made, rows = "from_arrays", [_dense(model, _probabilities(model))]
    given = [repr(row) for row in rows] + [_columns(model.signals), f"initial={_initial(model)!r}"]
    if model.labels:
        given.append(f"labels={_columns(model.labels)}")
    given.append(f"action_names={list(model.action_names)!r}")
    if model.state_names is not None:
        given.append(f"state_names={list(model.state_names)!r}")
    return f"stl.MDP.{made}({', '.join(given)})"


def _probabilities(model: MDP) -> list[float] | list[str]:
    rows = model.rows
    if not rows.given_exactly:
        doubles: list[float] = rows.probability.tolist()
        return doubles
    return [str(Fraction(int(k), rows.denominator)) for k in rows.numerator]


def _initial(model: MDP) -> Any:
    starts = np.flatnonzero(model.initial)
    if len(starts) == 1 and model.initial[starts[0]] == 1:
        return int(starts[0])
    if model.exact_initial is None:
        return model.initial.tolist()
    return [str(model.exact_initial[s]) for s in range(model.n_states)]


def _dense(model: MDP, values: list[float] | list[str]) -> list[list[list[Any]]]:
    nothing: Any = 0 if any(isinstance(value, str) for value in values) else 0.0
    dense = [[[nothing] * model.n_states for _ in range(model.n_states)] for _ in range(model.n_actions)]
    row_start, target = model.row_start.tolist(), model.target.tolist()
    for s in range(model.n_states):
        for c in range(int(model.choice_start[s]), int(model.choice_start[s + 1])):
            for k in range(row_start[c], row_start[c + 1]):
                dense[int(model.choice_action[c])][s][target[k]] = values[k]
    return dense


def _columns(columns: Any) -> str:
    return "{" + ", ".join(f"{name!r}: {values.tolist()!r}" for name, values in columns.items()) + "}"


def _policy_code(policy: Policy) -> str:
    """`stl.Policy(product, …)` of a small table, the product being named."""
    form = policy.form
    if not isinstance(form, Table) or form.table.size > _MOST_ENTRIES:
        return repr(policy)
    return f"stl.Policy(product, {form.table.tolist()!r})"


def _printer(thing: object, printer: pretty.RepresentationPrinter, cycle: bool) -> None:
    printer.text(code(thing))


def register() -> None:
    """Tell Hypothesis; an instance of these types that st.builds made keeps the printer of that call."""
    kinds: tuple[type, ...] = (MDP, Policy, Product, Task, *get_args(Formula))
    for kind in kinds:
        pretty.for_type_by_name(kind.__module__, kind.__name__, _printer)
