"""Re-check a certificate of stltool in exact integers, layer by layer: `python recheck.py FILE`.

This file imports nothing of stltool and can be read, copied or rewritten on its own; docs/certificates.md has the
format. It trusts nothing in the certificate: each transition of each layer is multiplied out once. What it proves: for
the model and the automaton that the file lists, the claimed bounds hold. Whether those are the ones of a task file is
for `stltool certify FILE TASK` to compare.

    claim      U_t(s,q) ≥ Σ p·U_{t+1}         L_t(s,q) ≤ Σ p·L_{t+1}        decided pairs are 1 or 0
    maximum    for every choice               for the choice listed
    minimum    for the choice listed          for every choice
    policy     for the choice (or mixture) listed, both
"""

from __future__ import annotations

import gzip
import hashlib
import json
import sys
import zlib
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any, NoReturn

FORMAT = "stltool-certificate-1"
_DAMAGE = (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError, EOFError,
           zlib.error, gzip.BadGzipFile)  # fmt: skip


class Refused(Exception):
    """The certificate proves nothing: why, and where."""


class NotACertificate(Refused):
    """The file holds something else, or is damaged beyond reading."""


def require(holds: bool, problem: str) -> None:
    if not holds:
        raise Refused(problem)


def certify(path: str, progress: Callable[[int, int], None] | None = None) -> dict[str, Any]:
    """Check every line of the certificate; returns its header with what was counted. Raises Refused, OSError.

    `progress` is called with (layers done, layers in all).
    """
    try:
        return _certify(lines(path), progress or (lambda done, total: None))
    except _DAMAGE as error:
        raise NotACertificate(f"not a certificate ({FORMAT}), or a damaged one: {error!r}") from None


def lines(path: str) -> Iterator[dict[str, Any]]:
    """The objects of the file in order, whole numbers only; the seal (a digest of all lines before it) at the end."""
    with open(path, "rb") as plain:
        packed = plain.read(2) == b"\x1f\x8b"
    digest, seal = hashlib.sha256(), None
    with gzip.open(path, "rb") if packed else open(path, "rb") as file:
        for line in file:
            require(seal is None, "there is text after the seal")
            item = json.loads(line, parse_float=_not_whole, parse_constant=_not_whole)
            seal = item.get("sha256")
            if seal is None:
                digest.update(line)
                yield item
    require(seal is not None, "the file is cut off: its seal is missing")
    require(seal == digest.hexdigest(), "the seal does not fit: the file was changed after it was written")


def _not_whole(text: str) -> NoReturn:
    raise Refused(f"{text} is no whole number")


def _certify(items: Iterator[dict[str, Any]], progress: Callable[[int, int], None]) -> dict[str, Any]:
    header = next(items, {})
    if header.get("format") != FORMAT:
        raise NotACertificate(f"not a certificate ({FORMAT})")
    model, automaton = next(items, {}), next(items, {})
    claim, D, Q = header["claim"], model["denominator"], automaton["memory"]
    letter, delta, verdict_rows = automaton["letter"], automaton["delta"], dict(automaton["verdicts"])

    # a choice is its successors [(s', n)] and what its row lacks of 1 (below 0: exceeds), which may go anywhere
    def choice(row: list[int]) -> tuple[list[tuple[int, int]], int]:
        return list(zip(row[::2], row[1::2], strict=True)), D - sum(row[1::2])

    choices = [[choice(row) for row in options] for options in model["choices"]]
    entries = [entry for options in choices for successors, _ in options for entry in successors]
    require(claim in ("maximum", "minimum", "policy"), f"unknown claim {claim!r}")
    require(D > 0 and all(n >= 0 and 0 <= s < len(choices) for s, n in entries), "a transition is no probability")
    require(all(choices) and len(letter) == len(choices), "a state has no choice, or no letter")
    require(all(0 <= i < len(delta) for i in letter), "a letter is none of the automaton's")
    require(all(len(row) == Q and all(0 <= q < Q for q in row) for row in delta), "the automaton's table is not whole")
    require(all(len(row) == Q and {*row} <= {-1, 0, 1} for row in verdict_rows.values()), "the verdicts are not whole")

    def verdicts(t: int) -> list[int]:
        row: list[int] = verdict_rows[max(start for start in verdict_rows if start <= t)]
        return row

    def expected(successors: list[tuple[int, int]], q: int) -> tuple[int, int]:
        """Σ n·U and Σ n·L over the layer reached (`one`, `after`, `bounds`), from memory q."""
        high = low = 0
        for s, n in successors:
            q2 = delta[letter[s]][q]
            require(after[q2] >= 0 or s * Q + q2 in bounds, f"step {t}, state {s}, memory {q2}: not listed")
            u, v = (one * after[q2],) * 2 if after[q2] >= 0 else bounds[s * Q + q2]
            high, low = high + n * u, low + n * v
        return high, low

    t, one, after, pairs = header["horizon"], 1, verdicts(header["horizon"]), 0
    bounds: dict[int, tuple[int, int]] = {}  # s·Q + q → (U, L) in units of 1/one, at step t
    while t > 0:
        layer = next(items, {})
        require(layer.get("t") == t - 1 and layer["one"] > 0, f"layer {t - 1} is missing")
        now, unit = verdicts(t - 1), layer["one"]
        found: dict[int, tuple[int, int]] = {}
        for at, low, high, listed in zip(layer["at"], layer["lower"], layer["upper"], layer["choice"], strict=True):
            (s, q), where = divmod(at, Q), f"step {t - 1}, state {at // Q}, memory {at % Q}"
            options = choices[s]
            weights = listed if isinstance(listed, list) else [int(c == listed) for c in range(len(options))]
            require(at >= 0 and now[q] < 0 and at not in found, f"{where}: decided, or listed twice")
            require(len(weights) == len(options) and min(weights) >= 0 < sum(weights), f"{where}: no such choice")
            # what a row lacks may go where it is worth most, what it exceeds be taken there
            considered = [(w, *o) for w, o in zip(weights, options, strict=True) if w or claim != "policy"]
            taken = [(w, *expected(successors, q), lack) for w, successors, lack in considered]
            highs = [(w, u + max(0, lack) * one) for w, u, _, lack in taken]
            lows = [(w, v + min(0, lack) * one) for w, _, v, lack in taken]
            total = sum(weights)
            most = max(u for _, u in highs) * total if claim == "maximum" else sum(w * u for w, u in highs)
            least = min(v for _, v in lows) * total if claim == "minimum" else sum(w * v for w, v in lows)
            require(high * D * one * total >= most * unit, f"{where}: the upper bound is below what a step gives")
            require(low * D * one * total <= least * unit, f"{where}: the lower bound is above what a step gives")
            found[at] = high, low
        t, one, after, bounds, pairs = t - 1, unit, now, found, pairs + len(found)
        progress(header["horizon"] - t, header["horizon"])
    conclusion = next(items, {})
    require(next(items, None) is None, "there are lines after the conclusion")
    start, total = model["initial"], model["initial_denominator"]
    lack = total - sum(n for _, n in start)
    require(total > 0 and 0 <= automaton["start"] < Q, "the start is not whole")
    require(all(n >= 0 and 0 <= s < len(choices) for s, n in start), "the start is no distribution")
    high, low = expected(start, automaton["start"])
    proved = Fraction(low + min(0, lack) * one, one * total), Fraction(high + max(0, lack) * one, one * total)
    require(
        Fraction(conclusion["lower"]) <= proved[0], f"the claimed lower bound is above {proved[0]}, which is proved"
    )
    require(
        Fraction(conclusion["upper"]) >= proved[1], f"the claimed upper bound is below {proved[1]}, which is proved"
    )
    defects = [Fraction(abs(lack), D) for row in choices for _, lack in row]
    defect = max(Fraction(abs(lack), total), *defects)
    return header | conclusion | {"layers": header["horizon"], "pairs": pairs, "defect": str(defect)}


if __name__ == "__main__":
    try:
        print(json.dumps(certify(sys.argv[1])))
    except (Refused, OSError) as refusal:
        sys.exit(f"refused: {refusal}")
