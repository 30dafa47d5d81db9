"""`stltool check --vary`: the probability as a function of a parameter of the model."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

from stltool.cli.bounds import VERDICTS
from stltool.cli.steps import this_command
from stltool.errors import SettingsError
from stltool.numbers import NumberError, bound_texts, most_text, number_text, read

if TYPE_CHECKING:
    from stltool.checking import ParametricResult
    from stltool.policy import Policy
    from stltool.product import Product

_LONGEST = 400  # characters of a polynomial that are printed


def check_range(
    product: Product,
    policy: Policy | None,
    vary: str,
    maximize: bool,
    exact: bool,
    bounds: list[tuple[str, str, Fraction]],
    as_json: bool,
    plot: Path | None = None,
    report: Path | None = None,
) -> bool:
    """Print P over the range, and write its picture and page; whether every bound holds on all of it."""
    import stltool as stl
    from stltool.reporting import parametric_data, parametric_report, write_answer_picture, write_report
    from stltool.reporting.answers import smallest_text
    from stltool.reporting.terminal import print_facts, print_json, print_table, progress_bar

    over = _range(vary)
    with progress_bar("checking", quiet=as_json) as bar:
        found = stl.parametric(product, policy, over=over, maximize=maximize, exact=exact, progress=bar)
    data, verdicts = parametric_data(found), dict[str, bool | None]()
    for option, text, bound in bounds:
        below = option == "--at-least"
        holds = found.at_least(bound) if below else found.at_most(bound)
        verdicts[f"P {'>=' if below else '<='} {text} everywhere"] = holds
        data["at_least" if below else "at_most"] = float(bound)
    all_hold = all(holds is True for holds in verdicts.values())
    if verdicts:
        data["holds"] = all_hold
        data["decided"] = all(holds is not None for holds in verdicts.values())
    wanted = next((bound for option, _, bound in bounds if option == "--at-least"), None)
    if wanted is not None:
        first = found.smallest(wanted)
        data["smallest"] = first and {
            "below": float(first.below), "enough": None if first.enough is None else float(first.enough)
        }  # fmt: skip
    page = parametric_report(found, data, this_command())
    if plot is not None:
        write_answer_picture(page, plot)
    if report is not None:
        write_report(page, report / "report.html")
    if as_json:
        print_json(data)
        return all_hold
    name, asked = found.parameter.name, "the policy" if policy is not None else f"{found.question} over all policies"
    print_facts({
        "task": f"{product.task_name} := {product.formula}",
        "P": f"{asked}, for every {name} in {found.parameter.domain}",
    })  # fmt: skip
    print_table([
        {name: number_text(p), **dict(zip(("lower_bound", "upper_bound"), bound_texts(lower, upper), strict=True))}
        for p, lower, upper in found.points()
    ])  # fmt: skip
    optimal = sum(piece.optimal is True for piece in found.pieces)
    alone = f"proved on {optimal} of these, in fractions" if exact else f"on {optimal} of these, up to rounding"
    least, greatest = bound_texts(found.least[0], found.greatest[1])
    print_facts({
        "everywhere": f"{least} <= P <= {greatest}",
        "bounds": f"at most {most_text(found.gap)} apart, in {len(found.pieces)} "
        f"{'piece' if len(found.pieces) == 1 else 'pieces'}; {found.status}",
        **({"one policy optimal": alone} if policy is None else {}),
        **_exactly(found),
        **{claim: VERDICTS[holds] for claim, holds in verdicts.items()},
        **({"smallest": smallest_text(data)} if "smallest" in data else {}),
        **({"plot": plot} if plot is not None else {}),
        **({"report": report / "report.html"} if report is not None else {}),
    })  # fmt: skip
    return all_hold


def _exactly(found: ParametricResult) -> dict[str, str]:
    """P as a polynomial, where it is one and not too long to be read."""
    known = found.pieces[0].known
    if known is None or len(found.pieces) > 1:
        return {}
    text = known.text(found.parameter.name)
    if len(text) > _LONGEST:
        text = f"of degree {len(known.powers) - 1}, {len(text)} characters long; --json prints its coefficients"
    return {"exact P": text}


def _range(text: str) -> dict[str, tuple[Fraction, Fraction]]:
    name, equals, ends = text.partition("=")
    lower, colon, upper = ends.partition(":")
    if not (name.strip() and equals and colon):
        raise SettingsError(f"--vary {text}: write a parameter and its range, for example --vary p=0.5:1")
    try:
        return {name.strip(): (read(lower), read(upper))}
    except NumberError as error:
        raise SettingsError(f"--vary {text}: {error}; write, for example, --vary p=0.5:1") from None
