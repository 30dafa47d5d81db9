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
import os
import re
import sys
import zlib
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any, NoReturn

FORMAT = "stltool-certificate-1"
HEADER = ("format", "claim", "task", "formula", "encoding", "horizon", "model", "policy")
FRACTION = re.compile(r"-?[0-9]+(/[0-9]+)?")
DAMAGE = (LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError, EOFError, MemoryError,
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
    longest = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(0)  # exact numbers are as long as they are
    try:
        return _certify(lines(path), progress or (lambda done, total: None))
    except DAMAGE as error:
        raise NotACertificate(f"not a certificate ({FORMAT}), or a damaged one: {error!r}") from None
    finally:
        sys.set_int_max_str_digits(longest)


def lines(path: str) -> Iterator[dict[str, Any]]:
    """The objects of the file in order, whole numbers only; the seal (a digest of all lines before it) at the end."""
    with open(path, "rb") as plain:
        packed = plain.read(2) == b"\x1f\x8b"
    if os.path.getsize(path) == 0:
        raise NotACertificate("the file is empty")
    digest, seal = hashlib.sha256(), None
    with gzip.open(path, "rb") if packed else open(path, "rb") as file:
        for line in file:
            require(seal is None, "there is text after the seal")
            item = json.loads(line.decode(), parse_float=_not_whole, parse_constant=_not_whole, object_pairs_hook=_once)
            seal = item.get("sha256")
            if seal is None:
                digest.update(line)
                yield item
            else:
                require(len(item) == 1, "the seal says more than its digest")
    require(seal is not None, "the file is cut off: its seal is missing")
    require(seal == digest.hexdigest(), "the seal does not fit: the file was changed after it was written")


def _not_whole(text: str) -> NoReturn:
    raise Refused(f"{text} is no whole number")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    require(len(dict(pairs)) == len(pairs), "an object has one key twice")
    return dict(pairs)


def _whole(lists: list[Any]) -> bool:
    """Whether lists, of lists, hold whole numbers alone."""
    return all(type(item) is int or (type(item) is list and _whole(item)) for item in lists)


def _certify(items: Iterator[dict[str, Any]], progress: Callable[[int, int], None]) -> dict[str, Any]:
    header = next(items, {})
    if header.get("format") != FORMAT:
        raise NotACertificate(f"not a certificate ({FORMAT})")
    model, automaton = next(items, {}), next(items, {})
    told = {key: header[key] for key in HEADER}
    require(set(header) == set(told), "the header has other keys than those of the format")
    require(_whole([*model.values(), *automaton.values()]), "the model or the automaton holds more than whole numbers")
    claim, horizon, D, Q = header["claim"], header["horizon"], model["denominator"], automaton["memory"]
    letter, delta, start = automaton["letter"], automaton["delta"], automaton["start"]
    verdict_rows, starts = dict(automaton["verdicts"]), [t for t, _ in automaton["verdicts"]]

    # a choice is its successors [(s', n)] and what its row lacks of 1 (below 0: exceeds), which may go anywhere
    def choice(row: list[int]) -> tuple[list[tuple[int, int]], int]:
        return list(zip(row[::2], row[1::2], strict=True)), D - sum(row[1::2])

    choices = [[choice(row) for row in options] for options in model["choices"]]
    entries = [entry for options in choices for successors, _ in options for entry in successors]
    texts = [told[key] for key in ("task", "formula", "encoding", "model", "policy") if told[key] is not None]
    require(all(isinstance(text, str) and text.isprintable() for text in texts), "the header's texts are not printable")
    require(type(horizon) is int and horizon >= 0, f"the horizon {horizon!r} is no number of steps")
    require(claim in ("maximum", "minimum", "policy"), f"unknown claim {claim!r}")
    require(D > 0 and all(n >= 0 and 0 <= s < len(choices) for s, n in entries), "a transition is no probability")
    require(all(choices) and len(letter) == len(choices), "a state has no choice, or no letter")
    require(all(0 <= i < len(delta) for i in letter), "a letter is none of the automaton's")
    require(all(len(row) == Q and all(0 <= q < Q for q in row) for row in delta), "the automaton's table is not whole")
    require(starts == sorted(set(starts)) and starts[0] == 0, "the verdicts' steps do not ascend from 0")
    require(all(len(row) == Q and {*row} <= {-1, 0, 1} for row in verdict_rows.values()), "the verdicts are not whole")

    def verdicts(t: int) -> list[int]:
        row: list[int] = verdict_rows[max(first for first in starts if first <= t)]
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

    t, one, after, pairs = horizon, 1, verdicts(horizon), 0
    bounds: dict[int, tuple[int, int]] = {}  # s·Q + q → (U, L) in units of 1/one, at step t
    while t > 0:
        layer = next(items, {})
        require(layer.get("t") == t - 1 and layer["one"] > 0, f"layer {t - 1} is missing")
        require(
            _whole([layer[key] for key in ("one", "at", "lower", "upper", "choice")]),
            f"layer {t - 1}: no whole numbers",
        )
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
        progress(horizon - t, horizon)
    claimed, initial, total = next(items, {}), model["initial"], model["initial_denominator"]
    require(next(items, None) is None, "there are lines after the conclusion")
    lack = total - sum(n for _, n in initial)
    require(total > 0 and 0 <= start < Q, "the start is not whole")
    require(all(n >= 0 and 0 <= s < len(choices) for s, n in initial), "the start is no distribution")
    high, low = expected(initial, start)
    proved = {"lower": Fraction(low + min(0, lack) * one, one * total),
              "upper": Fraction(high + max(0, lack) * one, one * total)}  # fmt: skip
    require({*claimed} == {*proved}, "the conclusion is no lower and upper bound")
    for key, bound in claimed.items():
        require(isinstance(bound, str) and bool(FRACTION.fullmatch(bound)), f"{bound!r} is no fraction")
        proves = proved[key] >= Fraction(bound) if key == "lower" else proved[key] <= Fraction(bound)
        require(proves, f"the claimed {key} bound is not what is proved")
    defect = max(Fraction(abs(lack), total), *(Fraction(abs(n), D) for options in choices for _, n in options))
    return told | claimed | {"layers": horizon, "pairs": pairs, "defect": str(defect)}


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        print("usage: python recheck.py FILE    (exit code 0: proved, 1: refused, 2: no certificate)", file=sys.stderr)
        sys.exit(2)
    try:
        told = certify(sys.argv[1])
        print(f"proved for the model and automaton in the file: {told['lower']} <= P <= {told['upper']}")
        print(json.dumps(told))
    except (Refused, OSError) as refusal:
        print(f"refused: {refusal}", file=sys.stderr)
        sys.exit(2 if isinstance(refusal, NotACertificate | OSError) else 1)
