"""A model as DRN text, as Storm writes it: see formats/drn.py for the format."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from fractions import Fraction

import numpy as np

from stltool.errors import ModelError
from stltool.files import MARK
from stltool.models.costs import Amounts, Cost
from stltool.models.formats.given import INIT, Valuation
from stltool.models.fractions import Shares
from stltool.models.mdp import MDP
from stltool.numbers import fraction_text, number_text, shortest

NO_LABEL = "__NOLABEL__"
NAMES = "// names: "
"""Of a comment of our own: the actions in order, and the labels of no state, which DRN does not represent."""

_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_.]*", re.ASCII)
_AND = "\t& "  # between the variables of a comment
_ELSEWHERE = "write a .umb file, or rename it"


def is_plain(name: str) -> bool:
    """Whether a variable of that name can be written."""
    return _PLAIN.fullmatch(name) is not None


def drn_text(model: MDP) -> str:
    """The DRN text of a model. ModelError if a name cannot be written, or a cost is one of transitions."""
    return "".join(_pieces(model))


def _pieces(model: MDP) -> Iterator[str]:
    rows = model.rows
    costs = {name: _require_writable(name, cost) for name, cost in model.costs.items()}
    for name in model.action_names:
        if not name or any(c.isspace() for c in name) or name == NO_LABEL:
            raise ModelError(f"action {name!r} cannot be written to DRN, where names have no spaces; {_ELSEWHERE}")
    if rows.intervals is not None:
        kind = "double-interval"
        lower, upper = (_texts(Amounts(ends)) for ends in (rows.intervals.lower, rows.intervals.upper))
        shares = [f"[{a}, {b}]" for a, b in zip(lower, upper, strict=True)]
    else:
        given = Shares(rows.numerator, rows.denominator) if rows.given_exactly else None
        kind = "rational" if given is not None else "double"
        shares = _texts(Amounts(rows.probability, given))
    empty = [name for name, values in model.labels.items() if not values.any()]
    names_of_all = {"actions": list(model.action_names), "labels": empty}
    chain = model.n_choices == model.n_states and bool((np.diff(model.choice_start) == 1).all())
    yield (
        f"// {MARK}\n{NAMES}{json.dumps(names_of_all)}\n"
        f"@type: {'DTMC' if chain else 'MDP'}\n@value_type: {kind}\n@parameters\n\n"
        f"@reward_models\n{' '.join(costs)}\n@nr_states\n{model.n_states}\n@nr_choices\n{model.n_choices}\n@model\n"
    )
    of_states, of_choices = _rewards(costs, "states", model.n_states), _rewards(costs, "choices", model.n_choices)
    made = Valuation.of(model)
    labels, variables, names = _labels(model), _variables(model, made), _names(model, made)
    entries = [f"\t\t{t} : {p}\n" for t, p in zip(rows.target.tolist(), shares, strict=True)]
    actions = [f"\taction {model.action_names[a]}" for a in model.choice_action.tolist()]
    choice_start, row_start = model.choice_start.tolist(), rows.row_start.tolist()
    for s in range(model.n_states):
        yield f"state {s}{of_states[s]}{labels[s]}\n{variables[s]}{names[s]}"
        for c in range(choice_start[s], choice_start[s + 1]):
            yield f"{actions[c]}{of_choices[c]}\n"
            yield from entries[row_start[c] : row_start[c + 1]]


def _texts(numbers: Amounts) -> list[str]:
    """Fractions, if they are exact, else the shortest decimals of doubles."""
    if numbers.given is None:
        return [repr(value) for value in numbers.values.tolist()]
    given = numbers.given
    known = {n: fraction_text(Fraction(n, given.denominator)) for n in set(given.numerator.tolist())}
    return [known[n] for n in given.numerator.tolist()]


def _require_writable(name: str, cost: Cost) -> Cost:
    if cost.transitions is not None:
        raise ModelError(f"cost {name} is one of transitions, which DRN does not have; write a .umb or a .tra file")
    if not name or any(c.isspace() for c in name):
        raise ModelError(f"cost {name!r} cannot be written to DRN, where names have no spaces; {_ELSEWHERE}")
    return cost


def _rewards(costs: Mapping[str, Cost], part: str, n: int) -> list[str]:
    """The numbers of each state or choice, in brackets; nothing if there are no costs."""
    if not costs:
        return [""] * n
    columns = [
        _texts(cost.parts[part]) if part in cost.parts else ["0"] * n
        for cost in costs.values()
    ]  # fmt: skip
    return [f" [{', '.join(row)}]" for row in zip(*columns, strict=True)]


def _labels(model: MDP) -> list[str]:
    found = [""] * model.n_states
    for name, values in {**model.labels, INIT: model.initial > 0}.items():
        if '"' in name or "\n" in name or "\r" in name or not name:
            raise ModelError(f"label {name!r} cannot be written to DRN, where names have no quotes; {_ELSEWHERE}")
        shown = name if _PLAIN.fullmatch(name) else f'"{name}"'
        for s in np.flatnonzero(values).tolist():
            found[s] += f" {shown}"
    return found


def _variables(model: MDP, made: Valuation) -> list[str]:
    """The values of variables as Storm writes them, in a comment: //[!b	& x=0.5]."""
    known = {name: values for name, values in model.signals.items() if _PLAIN.fullmatch(name)}
    if not known:
        return [""] * model.n_states
    columns = []
    for name, values in known.items():
        if name in made.truths:
            texts = {0.0: f"!{name}", 1.0: name}
        else:
            texts = {value: f"{name}={number_text(shortest(value))}" for value in set(values.tolist())}
        columns.append([texts[value] for value in values.tolist()])
    return [f"//[{_AND.join(row)}]\n" for row in zip(*columns, strict=True)]


def _names(model: MDP, made: Valuation) -> list[str]:
    """The names of states in comments, //"(0,1)", unless they follow from the variables."""
    names = made.others_of(model)
    return [f"//{json.dumps(name)}\n" for name in names] if names is not None else [""] * model.n_states
