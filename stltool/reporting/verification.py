"""A verification as plain data, and that data as JUnit XML for CI systems, as Markdown for pull requests, as rows."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from importlib import metadata
from typing import Literal, cast

from stltool.display import counted
from stltool.files import MARK
from stltool.gate import Verification, Verified
from stltool.numbers import bound_texts, fraction_text, number_text, within_text
from stltool.reporting.data import VERIFY_FORMAT
from stltool.reporting.diagnosis import diagnosis_data
from stltool.reporting.monitoring import robustness_text
from stltool.reporting.records import CertificateRecord, DiagnosisRecord, ExpectationRecord, Robustness, VerifyRecord

_LONGEST_FRACTION = 40  # characters in a table
_MARKS = {"holds": "✅", "does not hold": "❌", "undecided": "❓", "error": "⚠️"}
# what XML 1.0 cannot contain, however it is written
_NOT_XML = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def verification_data(found: Verification, command: str | None = None) -> VerifyRecord:
    """Everything that a report of `stltool verify` shows; `command` is the command that repeats it."""
    counts = found.count()
    return {
        "format": VERIFY_FORMAT,
        "version": metadata.version("stltool"),
        "command": command,
        "files": [str(path) for path in found.files],
        "holds": found.holds,
        "counts": {
            "holds": counts["holds"],
            "does_not_hold": counts["does not hold"],
            "undecided": counts["undecided"],
            "error": counts["error"],
        },
        "expectations": [_expectation_data(result) for result in found.results],
        "seconds": found.seconds,
    }


def _expectation_data(found: Verified) -> ExpectationRecord:
    expectation, result, monitored = found.expectation, found.result, found.monitored
    product = result.product if result is not None else None
    robustness: Robustness | None = None
    if monitored is not None and monitored.robustness is not None:
        least = float(monitored.robustness[..., 0].min())
        robustness = least if abs(least) != float("inf") else cast(Literal["inf", "-inf"], str(least))
    certificate: CertificateRecord | None = None
    if found.certificate is not None:
        certificate = {
            "file": str(found.certificate.path),
            "lower": fraction_text(found.certificate.lower),
            "upper": fraction_text(found.certificate.upper),
            "decides": found.certificate.decides,
        }
    return {
        "file": str(found.path),
        "line": found.line,
        "column": expectation.span.column if expectation.span is not None else 1,
        "text": expectation.written,
        "question": expectation.question,
        "robust": expectation.robust,
        "task": expectation.name,
        "formula": str(expectation.formula),
        "relation": expectation.relation,
        "bound": number_text(expectation.bound) if expectation.bound is not None else None,
        "policy": expectation.policy,
        "trace": expectation.trace,
        "part": str(expectation.part) if expectation.part is not None else None,
        "measure": expectation.measure,
        "verdict": found.verdict,
        "decided_by": found.decided_by,
        "reason": found.reason,
        "probability": result.probability if result is not None else None,
        "lower": result.lower if result is not None else None,
        "upper": result.upper if result is not None else None,
        "exact": fraction_text(result.fraction) if result is not None and result.fraction is not None else None,
        "robustness": robustness,
        "traces": _traces(found),
        "count": found.count,
        "model": product.model.name if product is not None else None,
        "model_digest": product.model.digest() if product is not None else None,
        "horizon": product.horizon if product is not None else monitored.horizon if monitored is not None else None,
        "product_states": product.n_states if product is not None else None,
        "certificate": certificate,
        "why": _why(found),
        "seconds": found.seconds,
    }


def _traces(found: Verified) -> int | None:
    """How many traces were judged, if it need not be one."""
    if found.coverage is not None:
        return found.coverage.traces
    verdicts = found.monitored.verdicts if found.monitored is not None else None
    return len(verdicts) if verdicts is not None and verdicts.ndim == 2 else None


def _why(found: Verified) -> DiagnosisRecord | None:
    if found.diagnosis is None or found.monitored is None or found.monitored.verdicts is None:
        return None
    verdicts = found.monitored.verdicts
    return diagnosis_data(found.diagnosis, int(verdicts[:, 0].argmin()) if verdicts.ndim == 2 else None)


# ------------------------------------------------------------------------------------------------------------- texts


def explained(row: ExpectationRecord) -> str | None:
    """Why an expectation is not met, in several lines, if that is known."""
    if row["why"] is None:
        return row["reason"]
    which = f"trace {row['why']['trace']}: " if row["why"]["trace"] is not None else ""
    return "\n".join(
        [which + row["why"]["sentences"][0], *row["why"]["sentences"][1:], f"causes: {row['why']['summary']}"]
    )


def place_text(row: ExpectationRecord) -> str:
    """patrolling.stl:7"""
    return f"{row['file']}:{row['line']}"


def asked_text(row: ExpectationRecord) -> str:
    """What is expected, without the word."""
    return row["text"].removeprefix("expect ")


def found_text(row: ExpectationRecord) -> str:
    """What was found, in short."""
    if row["question"] == "holds":
        robustness = row["robustness"]
        many = f" (the least of {row['traces']} traces)" if row["traces"] is not None else ""
        return f"robustness {robustness_text(robustness)}{many}" if robustness is not None else ""
    if row["count"] is not None:
        traces = counted(row["traces"] or 0, "trace")
        steps = row["part"] != row["formula"] and row["measure"] not in ("mattered", "parts")
        if steps or row["measure"] == "premises":
            return f"{counted(row['count'], 'step')} of {traces}"
        return f"{row['count']} of {traces}"
    if row["probability"] is None:
        return ""
    exact, p = row["exact"], row["probability"]
    if exact is not None and len(exact) <= _LONGEST_FRACTION:
        return f"P = {exact}"
    known = row["lower"] is not None and row["upper"] is not None
    text = within_text(p, row["lower"], row["upper"]) if known else f"{p:.15g}"  # type: ignore[arg-type]
    return f"P = {text}" if exact is None else f"P = {text} (exactly decided)"


def enclosure_text(row: ExpectationRecord) -> str:
    """The enclosure, rounded outwards; empty if there is none."""
    if row["lower"] is None or row["upper"] is None:
        return ""
    lower, upper = bound_texts(row["lower"], row["upper"])
    return f"{lower} <= P <= {upper}"


def counts_text(data: VerifyRecord) -> str:
    """2 of 3 expectations hold, 1 does not"""
    counts, total = data["counts"], len(data["expectations"])
    told = [f"{counts['holds']} of {total} expectation{'s'[: total != 1]} {'hold' if total != 1 else 'holds'}"]
    if n := counts["does_not_hold"]:
        told.append(f"{n} {'does' if n == 1 else 'do'} not")
    if n := counts["undecided"]:
        told.append(f"{n} {'is' if n == 1 else 'are'} undecided")
    if n := counts["error"]:
        told.append(f"{n} {'is' if n == 1 else 'are'} in error")
    return ", ".join(told)


def verification_rows(data: VerifyRecord) -> list[dict[str, str]]:
    """The rows of the terminal's table."""
    return [
        {"verdict": row["verdict"], "expectation": asked_text(row), "found": found_text(row), "at": place_text(row)}
        for row in data["expectations"]
    ]


# ------------------------------------------------------------------------------------------------------------- JUnit


def junit_text(data: VerifyRecord) -> str:
    """JUnit XML as CI systems read it: a suite for each file, a case for each expectation.

    It keeps to the schema that Jenkins and pytest use, which all readers know; places are in the texts of failures.
    """
    root = ET.Element("testsuites", {"name": "stltool verify", **_totals(data["expectations"])})
    for file in data["files"]:
        rows = [row for row in data["expectations"] if row["file"] == file]
        suite = ET.SubElement(root, "testsuite", {"name": _xml(file), "skipped": "0", **_totals(rows)})
        for row in rows:
            case = ET.SubElement(
                suite, "testcase", classname=_xml(file), name=_xml(asked_text(row)), time=f"{row['seconds']:.3f}"
            )
            if row["verdict"] == "holds":
                continue
            kind = "error" if row["verdict"] == "error" else "failure"
            told = row["reason"] or found_text(row)
            message = f"{row['verdict']}: {told.partition(chr(10))[0]}"
            fault = ET.SubElement(case, kind, type=row["verdict"], message=_xml(message))
            fault.text = _xml("\n".join(filter(None, [place_text(row), row["text"], found_text(row),
                                                      enclosure_text(row), explained(row)])))  # fmt: skip
    ET.indent(root)
    xml = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<!-- {MARK} -->\n{xml}\n'


def _totals(rows: Sequence[ExpectationRecord]) -> dict[str, str]:
    failures = sum(row["verdict"] in ("does not hold", "undecided") for row in rows)
    errors = sum(row["verdict"] == "error" for row in rows)
    seconds = sum(row["seconds"] for row in rows)
    return {"tests": str(len(rows)), "failures": str(failures), "errors": str(errors), "time": f"{seconds:.3f}"}


def _xml(text: str) -> str:
    return _NOT_XML.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


# ---------------------------------------------------------------------------------------------------------- Markdown


def markdown_text(data: VerifyRecord) -> str:
    """A table for a pull request, and what did not hold in words."""
    lines = [f"### {_MARKS['holds' if data['holds'] else 'does not hold']} stltool verify: {counts_text(data)}", ""]
    lines += ["| | expectation | found | at |", "|---|---|---|---|"]
    for row in data["expectations"]:
        cells = (
            f"{_MARKS[row['verdict']]} {row['verdict']}", _code(asked_text(row)), _plain(found_text(row)),
            _code(place_text(row)),
        )  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    for row in data["expectations"]:
        if (told := explained(row)) is not None:
            lines += ["", f"{_code(place_text(row))} {_said(row)}:", "", _block(told)]
    if data["command"] is not None:
        lines += ["", f"{_code(data['command'])}, stltool {data['version']}"]
    return "\n".join([f"<!-- {MARK} -->", *lines]) + "\n"


def _said(row: ExpectationRecord) -> str:
    return {"error": "is in error", "undecided": "is undecided"}.get(row["verdict"], row["verdict"])


def _code(text: str) -> str:
    """Inline code in a cell of a table: a fence longer than any in the text, and | escaped as GitHub reads it."""
    text = " ".join(text.split()).replace("|", "\\|")
    fence = "`" * (max((len(ticks) for ticks in re.findall("`+", text)), default=0) + 1)
    pad = " " if fence != "`" else ""
    return f"{fence}{pad}{text}{pad}{fence}"


def _plain(text: str) -> str:
    return re.sub(r"([\\`*_{}\[\]<>|#])", r"\\\1", text)


def _block(text: str) -> str:
    fence = "`" * max(3, max((len(ticks) for ticks in re.findall("`+", text)), default=0) + 1)
    return f"{fence}\n{text}\n{fence}"
