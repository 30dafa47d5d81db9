"""Names and conditions in the PRISM language."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.numbers import long_numbers, number_text

# what PRISM or Storm take for something else than a name
_TAKEN = """
    A bool ceil clock const ctmc ctmdp C deadlock double dtmc E endinit endinvariant endmodule endobservables endplayer
    endrewards endsystem false filter floor formula func F global G idtmc imdp init invariant I int label log max mdp
    min mod module multi nondeterministic observable observables of P player Pmax Pmin pomdp popta pow prob
    probabilistic pta rate rewards R Rmax Rmin round S smg stochastic system true U W X
"""
RESERVED = frozenset(_TAKEN.split())
LABELS = RESERVED - {name for name in RESERVED if len(name) == 1}
"""Of these, what is not the name of a label either, which is quoted."""
_WORDS = {
    "<->": "iff", "->": "implies", "<=": "le", ">=": "ge", "==": "eq", "!=": "ne", "<": "lt", ">": "gt", "&": "and",
    "|": "or", "!": "not", "+": "plus", "-": "minus", "*": "times", "/": "over",
}  # fmt: skip
_LARGEST = 2**31 - 1  # integer that PRISM reads


class Names:
    """Names that are identifiers of the PRISM language, and of which no two are the same."""

    def __init__(self, reserved: frozenset[str] = RESERVED) -> None:
        self._reserved, self._used = reserved, set[str]()

    def keep(self, names: Iterable[str]) -> None:
        """Give these names to nothing else."""
        self._used.update(names)

    def same(self, name: str) -> str:
        """A name that is kept already, itself if it is an identifier."""
        return name if Names(self._reserved).of(name) == name else self.of(name)

    def of(self, text: str, longest: int = 60) -> str:
        """A name that resembles the text."""
        for sign, word in _WORDS.items():
            text = text.replace(sign, f" {word} ")
        name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_")
        name = (name if len(name) <= longest else name[:longest].rstrip("_")) or "x"
        name = f"_{name}" if name[0].isdigit() else name
        name = f"{name}_" if name in self._reserved else name
        unique, number = name, 1
        while unique in self._used:
            number += 1
            unique = f"{name}_{number}"
        self._used.add(unique)
        return unique


def probability_text(value: Fraction) -> str:
    """A number exactly, as PRISM and Storm read it: integers that they cannot read are written with a decimal point."""
    text = number_text(value)
    if "/" in text:
        with long_numbers():
            parts = (str(part) if part <= _LARGEST else f"{part}.0" for part in value.as_integer_ratio())
            return "/".join(parts)
    return text if "." in text or "e" in text or int(text) <= _LARGEST else f"{text}.0"


def condition(names: Sequence[str], table: NDArray[np.signedinteger[Any]], inside: NDArray[np.bool_]) -> str:
    """A condition on integer variables that, of the rows of a table (n, k) without repetitions, holds in those inside.

    A disjunction of boxes, each as large as the other rows allow: about any other values it says nothing.
    """
    if not inside.any():
        return "false"
    if inside.all():
        return "true"
    low, high = table.min(axis=0), table.max(axis=0)
    left, others = table[inside], table[~inside]
    boxes = []
    while len(left):
        box = _box(left[0], others, low, high)
        boxes.append(_box_text(names, box, low, high))
        left = left[~_within(left, box)]
    return " | ".join(f"({box})" if "&" in box and len(boxes) > 1 else box for box in boxes)


def both(*conditions: str) -> str:
    """The conjunction of conditions."""
    parts = [one for one in conditions if one != "true"]
    if "false" in parts:
        return "false"
    return " & ".join(f"({one})" if "|" in one and len(parts) > 1 else one for one in parts) or "true"


_Box = list[tuple[int, int]]


def _box(point: NDArray[Any], others: NDArray[Any], low: NDArray[Any], high: NDArray[Any]) -> _Box:
    """Ranges around a point that no other row is in: each as wide as it can be, the first ones first."""
    box = [(int(value), int(value)) for value in point]
    for i, value in enumerate(point.tolist()):
        box[i] = int(low[i]), int(high[i])
        wrong = others[_within(others, box), i]
        box[i] = (
            int(wrong[wrong < value].max(initial=low[i] - 1)) + 1,
            int(wrong[wrong > value].min(initial=high[i] + 1)) - 1,
        )
    return box


def _within(rows: NDArray[Any], box: _Box) -> NDArray[np.bool_]:
    ends = np.array(box)
    inside: NDArray[np.bool_] = np.logical_and.reduce((rows >= ends[:, 0]) & (rows <= ends[:, 1]), axis=1)
    return inside


def _box_text(names: Sequence[str], box: _Box, low: NDArray[Any], high: NDArray[Any]) -> str:
    parts = []
    for name, (first, last), least, most in zip(names, box, low.tolist(), high.tolist(), strict=True):
        if first == last and least < most:
            parts.append(f"{name}={first}")
            continue
        parts += [f"{name}>={first}"] * (first > least) + [f"{name}<={last}"] * (last < most)
    return " & ".join(parts) or "true"


def piecewise(name: str, values: Sequence[int]) -> str:
    """A function of a variable with the values 0 … n − 1 as an expression; `values` are all at least 0, or −1 where
    they do not matter. What it evaluates to is always between 0 and n − 1."""
    top = len(values) - 1
    known = [(x, y) for x, y in enumerate(values) if y >= 0]
    if all(y == known[0][1] for _, y in known):
        return str(known[0][1])
    if all(x == y for x, y in known):
        return name
    for limit in range(top, 0, -1):
        if all(y == min(x + 1, limit) for x, y in known):
            return f"min({name}+1, {limit})"
    for limit in range(top):
        if all(y == max(x - 1, limit) for x, y in known):
            return f"max({name}-1, {limit})"
    pieces: list[tuple[int, str]] = []
    i = 0
    while i < len(known):
        last, text = _piece(name, known, i, top)
        end = known[last + 1][0] - 1 if last + 1 < len(known) else top
        pieces.append((end, text))
        i = last + 1
    *former, (_, rest) = pieces
    return "".join(f"{name}<={end} ? {text} : " for end, text in former) + rest


def _piece(name: str, known: list[tuple[int, int]], i: int, top: int) -> tuple[int, str]:
    """The longest run from i on that is constant, or a shift of the variable."""
    x, y = known[i]
    same = shifted = i
    while same + 1 < len(known) and known[same + 1][1] == y:
        same += 1
    while shifted + 1 < len(known) and known[shifted + 1][1] - known[shifted + 1][0] == y - x:
        shifted += 1
    if same >= shifted:
        return same, str(y)
    shift = y - x
    if shift == 0:
        return shifted, name
    inside = f"min({name}+{shift}, {top})" if shift > 0 else f"max({name}-{-shift}, 0)"
    return shifted, inside
