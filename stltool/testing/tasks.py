"""Strategies for texts of task files, and for their `expect` lines."""

from __future__ import annotations

from collections.abc import Sequence

from hypothesis import strategies as st

from stltool.logic.expectation import ASKED, OF_THE_WHOLE, RELATIONS, Expectation
from stltool.testing.formulas import formulas, predicates
from stltool.testing.names import LABELS, SIGNALS, Signals, below

_PARAMS = ("T", "tau")


@st.composite
def expectations(draw: st.DrawFn, labels: Sequence[str] = LABELS, signals: Signals = SIGNALS) -> Expectation:
    """What a task file may expect of a formula: any question with its bound and files, but for counts of its parts."""
    question = draw(st.sampled_from([asked for asked in ASKED if asked != "cover"]))
    formula, file = draw(formulas(labels, signals)), draw(st.text("abz é#/.\\'-", min_size=1))
    if question == "holds":
        return Expectation(question, formula, trace=file)
    relation, bound = draw(st.sampled_from(RELATIONS)), draw(st.fractions(0, 1))
    policy = file if question == "P" else None
    return Expectation(question, formula, None, relation, bound, draw(st.booleans()), policy)


@st.composite
def task_files(
    draw: st.DrawFn,
    labels: Sequence[str] = LABELS,
    signals: Signals = SIGNALS,
    model: str | None = "model.toml",
    past: bool = False,
    expect: bool = True,
) -> str:
    """The text of a task file that `stl.parse_task` reads: params, definitions that use each other, the task last.

    model    the file that its `model` line names, in some of the texts; None: there is no such line
    past     whether formulas may look back
    expect   whether there may be `expect` lines
    """
    lines = [f'model "{model}"'] if model is not None and draw(st.booleans()) else []
    params = _PARAMS[: draw(below(len(_PARAMS) + 1))]
    lines += [f"param {name} = {1 + draw(below(4))}" for name in params]
    defined: list[str] = []
    for i in range(draw(below(3))):
        parts = [str(draw(predicates(labels, signals)))]
        together: bool = draw(st.booleans())
        if defined and together:
            parts.append(defined[draw(below(len(defined)))])
        defined.append(f"part{i + 1}")
        lines.append(f"{defined[-1]} := {' & '.join(f'({part})' for part in parts)}")
    body = str(draw(formulas(labels, signals, max_leaves=4, past=past)))
    for name in defined:
        if draw(st.booleans()):
            sign: str = draw(st.sampled_from(("&", "|", "->")))
            body = f"({body}) {sign} {name}"
    if params:
        operator: str = draw(st.sampled_from("GF"))
        body = f"{operator}[0,{params[draw(below(len(params)))]}) ({body})"
    lines.append(f"task := {body}")
    if expect:
        asked = draw(st.lists(expectations(labels, signals), max_size=2))
        lines += [str(one) for one in asked]
        lines += [
            f"expect cover(task, {draw(st.sampled_from(OF_THE_WHOLE))}) {draw(st.sampled_from(RELATIONS))} {count}"
            for count in draw(st.lists(st.integers(0, 200), max_size=1))
        ]
    return "\n".join([*lines, ""])
