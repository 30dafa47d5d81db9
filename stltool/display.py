"""How a REPL and a notebook show an object: one description, as three lines of text or as a small table.

A class defines what to show in `_card`; `Displayed` derives `__repr__` and `_repr_html_` from it.
"""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import overload

from stltool.numbers import probability_text as text_of

_WIDTH = 120  # characters of a line of text
_LONGEST = 300  # characters of a cell

NATURES = {"against": "adversarial nature", "with": "cooperative nature"}


@dataclass(frozen=True, slots=True)
class Card:
    """A title, and facts by name: each group is a line of text after the title, two at most. `table` is a header and
    rows that only a notebook has room for; `more` says how many rows were left out."""

    title: str
    facts: Sequence[Mapping[str, object]] = ()
    table: tuple[Sequence[str], Sequence[Sequence[object]]] | None = None
    more: int = 0

    def text(self) -> str:
        lines = [self.title]
        for group in self.facts:
            told = "; ".join(f"{name}: {value}" for name, value in group.items() if value is not None)
            lines += [f"  {told}"] if told else []
        return "\n".join(cut(line, _WIDTH) for line in lines[:3])

    def html(self) -> str:
        facts = [(name, value) for group in self.facts for name, value in group.items() if value is not None]
        parts = [f"<strong>{_escaped(self.title)}</strong>"]
        if facts:
            parts.append(_table((), [(name, value) for name, value in facts]))
        if self.table is not None:
            header, rows = self.table
            parts.append(_table(header, rows))
        if self.more:
            parts.append(f"<p>{self.more} more</p>")
        return f'<div class="stltool">{"".join(parts)}</div>'


class StateNames(Sequence[str]):
    """A name for each of n states, made on demand."""

    def __init__(self, n: int, name: Callable[[int], str]) -> None:
        self._n, self._name = n, name

    def __len__(self) -> int:
        return self._n

    @overload
    def __getitem__(self, s: int) -> str: ...
    @overload
    def __getitem__(self, s: slice) -> tuple[str, ...]: ...
    def __getitem__(self, s: int | slice) -> str | tuple[str, ...]:
        found = range(self._n)[s]
        return tuple(map(self._name, found)) if isinstance(found, range) else self._name(found)


def distinct(names: Sequence[str]) -> Sequence[str]:
    """The names of states; those that repeat with the number of their state added: "x=0 (3)", "x=0 (4)"."""
    while len(counts := Counter(names)) < len(names):
        names = tuple(f"{name} ({s})" if counts[name] > 1 else name for s, name in enumerate(names))
    return names


class Displayed:
    """An object that shows itself as its card."""

    __slots__ = ()

    def _card(self) -> Card:
        raise NotImplementedError

    def __repr__(self) -> str:
        return self._card().text()

    def _repr_html_(self) -> str:
        return self._card().html()


def cut(text: str, most: int) -> str:
    """One line of at most so many characters."""
    text = " ".join(text.split()) if "\n" in text else text
    return text if len(text) <= most else f"{text[: most - 3]}..."


def probability_text(value: float) -> str:
    """Six digits, or as many as tell it from 0 and 1: `0.737948`, `1 - 3.1e-10`."""
    return text_of(value).replace("−", "-")


def counted(n: int, what: str) -> str:
    """`1 state`, `18 states`."""
    return f"{n} {what}{'s'[: n != 1]}"


def listed(names: Iterable[str], most: int = 6) -> str:
    """`A, B, C, ...`, `none`."""
    known = list(names)
    return ", ".join(known[:most]) + (", ..." if len(known) > most else "") if known else "none"


def _table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    head = f"<tr>{''.join(f'<th>{_escaped(name)}</th>' for name in header)}</tr>" if header else ""
    body = "".join(f"<tr>{''.join(f'<td>{_escaped(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table>{head}{body}</table>"


def _escaped(value: object) -> str:
    return html.escape(cut(str(value), _LONGEST))
