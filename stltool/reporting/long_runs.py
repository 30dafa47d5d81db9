"""Answers about runs that go on for ever, as data."""

from __future__ import annotations

from collections.abc import Sequence

from stltool.checking import LongRun
from stltool.logic.repeated import Repetition
from stltool.numbers import fraction_text
from stltool.reporting.records import LongRunOutput


def long_run_data(found: Sequence[LongRun], form: Repetition | None, formula: str) -> LongRunOutput:
    """Answers about one task; `formula` repeats that of their products in this form, or is the same."""
    product = found[0].product
    return {
        "task": product.task_name,
        "formula": formula,
        "form": form,
        "repeated": str(product.formula),
        "model": product.model.name,
        "model_digest": product.model.digest(),
        "horizon": product.horizon,
        "answers": [
            {
                "asked": one.asked,
                "question": one.question,
                "value": one.value,
                "lower": one.lower,
                "upper": one.upper,
                "exact": fraction_text(one.fraction) if one.fraction is not None else None,
                "encoding": one.product.automaton.encoding,
                "pairs": one.pairs,
                "components": one.components,
                "seconds": one.seconds,
            }
            for one in found
        ],
    }
