"""A model as PRISM's explicit files, as PRISM writes them: see formats/explicit.py for the format.

NAME.tra    transitions          NAME.lab    labels          NAME.sta    variables
NAME.srew, NAME.trew             the costs of states and of transitions; NAME1.srew, NAME2.srew … if there are several
"""

from __future__ import annotations

import re
from fractions import Fraction

import numpy as np

from stltool.errors import ModelError
from stltool.files import MARK
from stltool.models.costs import Amounts, Cost
from stltool.models.formats.given import INIT, Valuation
from stltool.models.fractions import Shares
from stltool.models.mdp import MDP
from stltool.numbers import long_numbers, number_text, shortest

_PLAIN = re.compile(r"[^\s,()\"#]+")
_ELSEWHERE = "write a .umb file, or rename it"


def tra_texts(model: MDP) -> dict[str, str]:
    """The files, by ending: .tra, .lab and what there is of .sta, .srew, .1.srew … ModelError if a name cannot be
    written."""
    for name in model.action_names:
        if not name or any(c.isspace() for c in name):
            raise ModelError(
                f"action {name!r} cannot be written to .tra files, where names have no spaces; {_ELSEWHERE}"
            )
    files = {".tra": _transitions(model), ".lab": _labels(model)}
    if model.signals:
        files[".sta"] = _states(model)
    several = len(model.costs) > 1
    for number, (name, cost) in enumerate(model.costs.items(), start=1):
        files |= _rewards(model, name, cost, str(number) if several else "")
    return files


def _is_chain(model: MDP) -> bool:
    return model.n_choices == model.n_states and bool((np.diff(model.choice_start) == 1).all())


def _texts(numbers: Amounts) -> list[str]:
    if numbers.given is None:
        return [repr(value) for value in numbers.values.tolist()]
    given = numbers.given
    known = {n: number_text(Fraction(n, given.denominator)) for n in set(given.numerator.tolist())}
    return [known[n] for n in given.numerator.tolist()]


def _places(model: MDP) -> list[str]:
    """The beginning of each line: state and choice, only the state in a chain, and the successor."""
    rows, chain = model.rows, _is_chain(model)
    state = np.repeat(np.arange(model.n_states), np.diff(model.choice_start))
    number = np.arange(model.n_choices) - model.choice_start[state]
    begin = [f"{s} " if chain else f"{s} {i} " for s, i in zip(state.tolist(), number.tolist(), strict=True)]
    choice = np.repeat(np.arange(model.n_choices), np.diff(rows.row_start)).tolist()
    return [f"{begin[c]}{to}" for c, to in zip(choice, rows.target.tolist(), strict=True)]


def _counts(model: MDP, n: int) -> str:
    return f"{model.n_states} {n}\n" if _is_chain(model) else f"{model.n_states} {model.n_choices} {n}\n"


def _transitions(model: MDP) -> str:
    rows = model.rows
    if rows.intervals is not None:
        lower, upper = (_texts(Amounts(ends)) for ends in (rows.intervals.lower, rows.intervals.upper))
        shares = [f"[{a},{b}]" for a, b in zip(lower, upper, strict=True)]
    else:
        with long_numbers():
            given = Shares(rows.numerator, rows.denominator) if rows.given_exactly else None
            shares = _texts(Amounts(rows.probability, given))
    choice = np.repeat(np.arange(model.n_choices), np.diff(rows.row_start))
    actions = [model.action_names[a] for a in model.choice_action[choice].tolist()]
    lines = [f"{at} {p} {a}\n" for at, p, a in zip(_places(model), shares, actions, strict=True)]
    kind = ("I" if rows.intervals is not None else "") + ("DTMC" if _is_chain(model) else "MDP")
    return f"# {MARK}\n# Transitions ({kind})\n{_counts(model, len(lines))}{''.join(lines)}"


def _labels(model: MDP) -> str:
    labels = {INIT: model.initial > 0, **model.labels}
    found: list[list[int]] = [[] for _ in range(model.n_states)]
    for k, (name, values) in enumerate(labels.items()):
        if '"' in name or "\n" in name or "\r" in name or not name:
            raise ModelError(
                f"label {name!r} cannot be written to .lab files, where names have no quotes; {_ELSEWHERE}"
            )
        for s in np.flatnonzero(values).tolist():
            found[s].append(k)
    heading = " ".join(f'{k}="{name}"' for k, name in enumerate(labels))
    lines = [f"{s}: {' '.join(map(str, numbers))}\n" for s, numbers in enumerate(found) if numbers]
    return f"# {MARK}\n# Labels\n{heading}\n{''.join(lines)}"


def _states(model: MDP) -> str:
    made = Valuation.of(model)
    columns = []
    for name, values in model.signals.items():
        if not _PLAIN.fullmatch(name):
            raise ModelError(
                f"signal {name!r} cannot be written to .sta files, where names have no spaces, commas, quotes and "
                f"parentheses; {_ELSEWHERE}"
            )
        texts = {value: number_text(shortest(value)) for value in set(values.tolist())}
        if name in made.truths:
            texts = {0.0: "false", 1.0: "true"}
        columns.append([texts[value] for value in values.tolist()])
    lines = [f"{s}:({','.join(row)})\n" for s, row in enumerate(zip(*columns, strict=True))]
    return f"# {MARK}\n# States\n({','.join(model.signals)})\n{''.join(lines)}"


def _rewards(model: MDP, name: str, cost: Cost, number: str) -> dict[str, str]:
    if '"' in name or "\n" in name or "\r" in name:
        raise ModelError(f"cost {name!r} cannot be written to .srew files, where names have no quotes; {_ELSEWHERE}")
    heading = f'# {MARK}\n# Reward structure "{name}"\n'
    files = {}
    if cost.states is not None or not cost.parts:
        states = cost.states if cost.states is not None else Amounts(np.zeros(model.n_states))
        lines = [f"{s} {text}\n" for s, text in enumerate(_texts(states)) if states.values[s]]
        files[f"{number}.srew"] = f"{heading}# State rewards\n{model.n_states} {len(lines)}\n{''.join(lines)}"
    if cost.choices is not None or cost.transitions is not None:
        numbers = _along(model, cost)
        lines = [
            f"{at} {text}\n"
            for at, text, value in zip(_places(model), _texts(numbers), numbers.values.tolist(), strict=True)
            if value
        ]
        files[f"{number}.trew"] = f"{heading}# Transition rewards\n{_counts(model, len(lines))}{''.join(lines)}"
    return files


def _along(model: MDP, cost: Cost) -> Amounts:
    """The costs of choices and transitions, for every entry of the rows."""
    choice = np.repeat(np.arange(model.n_choices), np.diff(model.rows.row_start))
    if cost.choices is None:
        assert cost.transitions is not None
        return cost.transitions
    of_choices = cost.choices.at(choice)
    if cost.transitions is None:
        return of_choices
    both = [of_choices.exact[k] + cost.transitions.exact[k] for k in range(len(choice))]
    return Amounts.read(np.array(both, dtype=object), "the cost")
