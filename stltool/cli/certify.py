"""`stltool certify`: re-checks certificates with code independent of the code that wrote them."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Annotated

import typer

from stltool.cli.app import app
from stltool.cli.options import READ, AsJson, Encoding, Model, ModelReading, Params, TaskName
from stltool.cli.roles import Reads, task_files
from stltool.cli.steps import load_product, read_params
from stltool.errors import RefusedError, SettingsError
from stltool.numbers import bound_texts, long_numbers


@app.command("stltool certify certificate.jsonl patrolling.stl")
def certify(
    file: Annotated[
        Path,
        typer.Argument(help="certificate written by check --certificate", show_default=False),
        Reads("certificate"),
    ],
    task: Annotated[
        Path | None,
        typer.Argument(help="task file (.stl) that the certificate must match", show_default=False),
        Reads("task file", task_files),
    ] = None,
    policy: Annotated[
        Path | None,
        typer.Option("--policy", help="policy file or Q-table that the certificate must match"),
        Reads("policy"),
    ] = None,
    model: Model = None,
    reading: ModelReading = READ,
    param: Params = None,
    name: TaskName = None,
    encoding: Encoding = "exact",
    as_json: AsJson = False,
) -> None:
    """Re-check a certificate in exact arithmetic; with TASK, check that it is about this task and model.

    Exit code 0: the bounds are proved. 1: the certificate is refused, with the position of the fault. 2: the file is
    not a certificate, or is about another task or model.
    """
    import stltool as stl
    from stltool.checking import require_certificate_of
    from stltool.reporting.terminal import error, print_facts, print_json, progress_bar

    if policy is not None and task is None:
        raise SettingsError("--policy: a policy belongs to a task; give TASK, too")
    try:
        with progress_bar("checking layers", quiet=as_json) as bar:
            proved = stl.certify(file, bar)
    except RefusedError as refusal:
        if as_json:
            print_json({"proved": False, "refused": str(refusal).removeprefix(f"{file}: refused: ")})
        else:
            error(str(refusal))
        raise typer.Exit(1) from None
    if task is not None:
        product = load_product(task, model, param, name, encoding, reading=reading)
        _require_task(file, task, param, str(proved["formula"]), str(product.formula))
        require_certificate_of(file, product, stl.load_policy(policy, product) if policy is not None else None)
        nominal = product.model.uncertain and proved["nature"] is None
        proved |= {"task": product.task_name, "encoding": product.automaton.encoding, "nominal": nominal}
    if as_json:
        print_json(proved | {"proved": True, "compared_with": str(task) if task is not None else None})
        return
    with long_numbers():
        lower, upper = bound_texts(*(Fraction(proved[key]) for key in ("lower", "upper")))
    question = {"maximum": "the maximum over all policies", "minimum": "the minimum over all policies"}
    print_facts({
        "proved": f"{lower} <= P <= {upper}",
        "P": question.get(proved["claim"], f"of the policy listed ({proved['policy']})") + _nature(proved["nature"]),
        "task": f"{proved['task']} := {proved['formula']}{'' if task else ' (as stated in the file, not proved)'}",
        "encoding": proved["encoding"],
        "checked": f"{proved['pairs']} pairs of states between 0 and 1, over {proved['steps']} steps, in integers only",
        "rows": _rows(proved["nature"], proved["defect"]),
        "compared": _compared(task, policy, bool(proved.get("nominal"))),
    })  # fmt: skip


def _require_task(file: Path, task: Path, param: list[str] | None, proved: str, asked: str) -> None:
    """CertificateError if the certificate is about another definition of the task file."""
    import stltool as stl
    from stltool.errors import CertificateError
    from stltool.logic.formula import Formula

    if proved == asked:
        return
    for name, definition in stl.load_task(task, read_params(param)).definitions.items():
        if isinstance(definition, Formula) and str(definition) == proved:
            raise CertificateError(
                f"{file}: the task of this certificate is {proved}, not {asked}; that is {name} of the same file: add "
                f"--task {name}"
            )


def _rows(aim: str | None, defect: str) -> str:
    if defect != "0":
        return f"sum to 1 up to {defect}, allowed for"
    return "sum to 1 exactly" if aim is None else "are intervals, each with probabilities that sum to 1 exactly"


def _nature(aim: str | None) -> str:
    """What nature does with intervals."""
    if aim is None:
        return ""
    return f", where nature's choice in the intervals makes P {aim}"


def _compared(task: Path | None, policy: Path | None, nominal: bool) -> str:
    if task is None:
        return "with nothing: model and automaton are those in the file; give TASK to compare them with yours"
    same = f"with {task}: the same task, {'model, automaton and policy' if policy else 'model and automaton'}"
    return same + (" with its nominal probabilities; nothing is proved about its intervals" if nominal else "")
