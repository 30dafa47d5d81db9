"""A policy played in the terminal, move by move: what `stltool play` prints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from rich.text import Text as Line

from stltool.checking.playing import Game
from stltool.logic.printer import with_names
from stltool.numbers import probability_text
from stltool.screen import Screen
from stltool.streams import printable

HELP = """\
Enter, or .   the policy's action; chance decides where it leads
NAME          another action, by its name or its number in the table
NAME>STATE    an action and where it leads, such as N>(2,1): the state's name, with or without its spaces, or its number
<             one step back
*             to the end, by the policy
!             from the start, along the most probable violation
?             this text
q             the end

On the floor, @ is the run; a letter is a label; an arrow is the policy's action there, with the same past."""
_GLYPHS = {"N": "↑", "NE": "↗", "E": "→", "SE": "↘", "S": "↓", "SW": "↙", "W": "←", "NW": "↖", "up": "↑", "down": "↓",
           "left": "←", "right": "→", "stay": "•"}  # fmt: skip
_WIDEST = 40  # cells of a floor that is drawn
_SHOWN = 3  # successors of an action


class Told:
    """A game in words: for the terminal, and as data."""

    def __init__(self, game: Game) -> None:
        self._game = game
        self._text = with_names(game.product.definitions)

    def memory(self, q: int) -> str:
        """What is remembered, formulas by the names of the task file."""
        return "; ".join(dict.fromkeys(one.phrase for one in self._game.product.automaton.memory(q, self._text)))

    def data(self) -> dict[str, Any]:
        """The run so far."""
        model = self._game.product.model
        moves: Sequence[str | None] = [*(step.action for step in self._game.steps[1:]), None]
        return {
            "task": self._game.product.task_name,
            "formula": str(self._game.product.formula),
            "policy": self._game.here.policy.kind,
            "satisfied": self._game.verdict,
            "steps": [
                {
                    "step": t,
                    "state": model.state_name(step.s),
                    "labels": self._labels(step.s),
                    "memory": self.memory(step.q),
                    "probability": self._game.here.value(t, step.s, step.q),
                    "action": action,
                }
                for t, (step, action) in enumerate(zip(self._game.steps, moves, strict=True))
            ],
        }

    def _labels(self, s: int) -> list[str]:
        return [name for name, holds in self._game.product.model.labels.items() if holds[s]]

    def show(self, console: Screen) -> None:
        """Where the run is, what the policy does around it, and P after each action."""
        step, model = self._game.steps[-1], self._game.product.model
        labels = self._labels(step.s)
        verdict = {None: f"P = {probability_text(self._game.value)}", True: "satisfied", False: "violated"}[
            self._game.verdict
        ]
        style = {None: "bold", True: "bold green", False: "bold red"}[self._game.verdict]
        where = f"step {self._game.t} of {self._game.product.horizon}, {model.state_name(step.s)}"
        where += f" {{{', '.join(labels)}}}" if labels else ""
        console.print(Line.assemble((printable(where), "bold"), "   ", (printable(verdict), style)))
        console.print(Line(printable(self.memory(step.q)), "dim"))
        for line in self._floor():
            console.print(Line(printable(line)))
        for row in self._table() if self._game.verdict is None else ():
            console.print(row)

    def ending(self) -> str:
        """Where the run was left."""
        outcome = {None: "undecided", True: "satisfied", False: "violated"}[self._game.verdict]
        return f"left at step {self._game.t} of {self._game.product.horizon}: {outcome}"

    def _floor(self) -> Iterable[str]:
        """The floor from above: @ is the run; arrows, what the policy does there with this memory on arrival."""
        layout = self._game.product.model.layout
        if layout is None or layout.width > _WIDEST:
            return []
        before = self._game.steps[-2].q if self._game.t else self._game.product.automaton.initial
        cells = [["##"] * layout.width for _ in range(layout.height)]
        for s, (column, row) in enumerate(zip(layout.column.tolist(), layout.row.tolist(), strict=True)):
            label = (self._labels(s) or ["."])[0][:1]
            cells[layout.height - 1 - row][column] = label + self._glyph(s, self._game.product.enter(s, before))
        here = self._game.steps[-1].s
        cells[layout.height - 1 - int(layout.row[here])][int(layout.column[here])] = "@ "
        return ["  " + " ".join(row) for row in cells]

    def _glyph(self, s: int, q: int) -> str:
        if self._game.t >= self._game.product.horizon or not self._game.here.known(self._game.t, s, q):
            return " "
        weights = self._game.here.weights(self._game.t, s, q)
        if np.count_nonzero(weights) != 1:
            return "?" if weights.any() else " "
        model = self._game.product.model
        name = model.action_names[model.choice_action[model.choice_start[s] + int(weights.argmax())]]
        glyph = printable(_GLYPHS.get(name, "*"))
        return glyph if len(glyph) == 1 else glyph.strip("-")  # <- and ->, where arrows cannot be printed

    def _table(self) -> Iterable[Line]:
        """P after each action, the policy's in bold, and where it leads."""
        step = self._game.steps[-1]
        values, weights = (f(self._game.t, step.s, step.q) for f in (self._game.here.choices, self._game.here.weights))
        rows: list[tuple[str, ...]] = [("", "action", "P, then the policy", "", "leads to")]
        for i, name in enumerate(self._game.actions()):
            outcomes = self._game.here.outcomes(step.s, step.q, i)
            to = [
                f"{self._game.product.model.state_name(one.s)} {100 * one.probability:.3g} %"
                for one in outcomes[:_SHOWN]
            ]
            share = "" if not weights[i] else "policy" if weights[i] == 1 else f"policy {100 * weights[i]:.3g} %"
            more = ", ..." if len(outcomes) > _SHOWN else ""
            rows.append((str(i + 1), name, probability_text(float(values[i])), share, ", ".join(to) + more))
        rows = [tuple(map(printable, row)) for row in rows]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for number, row in enumerate(rows):
            line = "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            yield Line(line, "dim" if not number else "bold" if weights[number - 1] else "")
