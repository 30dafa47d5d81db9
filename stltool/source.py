"""Positions of texts, and how to show them: file, line, column, the line and a caret."""

from __future__ import annotations

import re
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Source:
    """A named text: a file, or the string given to `parse`."""

    name: str
    text: str = field(repr=False)

    @property
    def lines(self) -> str:
        """The text with every line end, even that of old Macs, as a line feed; positions are unchanged."""
        return re.sub(r"\r(?!\n)", "\n", self.text)


@dataclass(frozen=True, slots=True)
class Span:
    """The characters `start … end-1` of a source."""

    source: Source
    start: int
    end: int

    @property
    def line(self) -> int:
        """Line number, from 1."""
        return self.source.lines.count("\n", 0, self.start) + 1

    @property
    def column(self) -> int:
        """Column number, from 1."""
        return self.start - (self.source.lines.rfind("\n", 0, self.start) + 1) + 1

    def where(self) -> str:
        """`file, line 3, column 7`."""
        return f"{self.source.name}, line {self.line}, column {self.column}"

    def text(self) -> str:
        """The characters of the span themselves."""
        return self.source.text[self.start : self.end]

    def show(self, message: str) -> str:
        """The message with its position, the line, and carets under the span."""
        begin = self.source.lines.rfind("\n", 0, self.start) + 1
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
