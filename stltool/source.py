"""Positions of texts, and how to show them: file, line, column, the line and a caret."""

from __future__ import annotations

import re
from bisect import bisect_right
from dataclasses import dataclass, field
from functools import cached_property


@dataclass(frozen=True)
class Source:
    """A named text: a file, or the string given to `parse`."""

    name: str
    text: str = field(repr=False)

    @cached_property
    def lines(self) -> str:
        """The text with every line end, even that of old Macs, as a line feed; positions are unchanged."""
        return re.sub(r"\r(?!\n)", "\n", self.text)

    @cached_property
    def line_starts(self) -> list[int]:
        """Where each line begins. A text may have as many faults as lines: none of them counts the lines again."""
        return [0, *(found.end() for found in re.finditer("\n", self.lines))]

    def line_start(self, place: int) -> int:
        """Where the line of a character begins."""
        return self.line_starts[bisect_right(self.line_starts, place) - 1]


@dataclass(frozen=True, slots=True)
class Span:
    """The characters `start … end-1` of a source."""

    source: Source
    start: int
    end: int

    @property
    def line(self) -> int:
        """Line number, from 1."""
        return bisect_right(self.source.line_starts, self.start)

    @property
    def column(self) -> int:
        """Column number, from 1."""
        return self.start - self._begin + 1

    @property
    def _begin(self) -> int:
        return self.source.line_start(self.start)

    def where(self) -> str:
        """`file, line 3, column 7`."""
        return f"{self.source.name}, line {self.line}, column {self.column}"

    def text(self) -> str:
        """The characters of the span themselves."""
        return self.source.text[self.start : self.end]

    def show(self, message: str) -> str:
        """The message with its position, the line, and carets under the span."""
        begin = self._begin
        stop = self.source.lines.find("\n", begin)
        line = self.source.text[begin:] if stop < 0 else self.source.text[begin:stop]
        line = line.rstrip("\r")
        indent = "".join("\t" if c == "\t" else " " for c in line[: self.start - begin])
        width = max(1, min(self.end, begin + len(line)) - self.start)
        if len(line) > 160:  # only the surroundings: nobody reads a screenful to find a caret
            cut = max(0, self.start - begin - 60)
            line, indent = line[cut : cut + 140], indent[cut:]
            width = max(1, min(width, 140 - len(indent)))
        return f"{self.where()}: {message}\n    {line}\n    {indent}{'^' * width}"
