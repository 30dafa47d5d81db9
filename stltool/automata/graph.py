"""An automaton as a networkx graph or Graphviz text: states show what they remember, edges the labels they need."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from stltool.automata.automaton import TRUE, UNDECIDED, TaskAutomaton
from stltool.automata.cover import literals, shortest_cover
from stltool.errors import SizeError
from stltool.files import MARK
from stltool.logic.formula import And, Constant, Formula, Not, Or

if TYPE_CHECKING:
    import networkx

_MOST_SIMPLIFIED = 8  # atoms; with more, an edge lists its valuations
_MOST_DRAWN = 2000  # states; a larger picture would not be readable


def to_graph(automaton: TaskAutomaton) -> networkx.DiGraph:
    """Nodes are states with `name` and `verdicts`; edges carry `condition`, a Boolean formula over the atoms as text.

    Node "start" is the automaton before it reads anything.
    """
    import networkx

    graph = networkx.DiGraph(formula=str(automaton.formula), horizon=automaton.horizon, encoding=automaton.encoding)
    edge_text = lru_cache(maxsize=None)(lambda letters: str(condition(automaton, letters)))
    for q in range(automaton.n_states):
        graph.add_node(
            q, name=automaton.describe(q), verdicts=verdict_text(automaton, q), initial=q == automaton.initial
        )
    for q in range(automaton.n_states):
        targets: dict[int, list[int]] = {}
        for letter, successor in enumerate(automaton.delta[:, q].tolist()):
            targets.setdefault(successor, []).append(letter)
        for successor, letters in targets.items():
            graph.add_edge(q, successor, condition=edge_text(tuple(letters)))
    return graph


def to_dot(automaton: TaskAutomaton) -> str:
    """The same as Graphviz text. Raises SizeError if there are more states than a picture can show."""
    import graphviz

    if automaton.n_states > _MOST_DRAWN:
        raise SizeError(
            f"the automaton has {automaton.n_states} states, and a picture shows at most {_MOST_DRAWN}; "
            "shorten the windows"
        )
    graph = to_graph(automaton)
    dot = graphviz.Digraph("task", comment=str(automaton.formula), graph_attr={"rankdir": "LR"})
    dot.attr(label=graphviz.escape(f"{automaton.formula}\nhorizon {automaton.horizon}, encoding {automaton.encoding}"))
    dot.attr("node", shape="box", style="rounded")
    dot.node("before", label="", shape="point")
    dot.edge("before", str(automaton.initial))
    for q, node in graph.nodes(data=True):
        text = node["name"] + (f"\n{node['verdicts']}" if node["verdicts"] else "")
        dot.node(str(q), label=graphviz.escape(text))
    for q, successor, edge in graph.edges(data=True):
        dot.edge(str(q), str(successor), label=graphviz.escape(edge["condition"]))
    return f"// {MARK}\n{dot.source}"


@dataclass(frozen=True)
class Drawing:
    """A small automaton as boxes, in order of a walk from the initial state, and arrows (from, to, condition)."""

    boxes: list[int]
    arrows: list[tuple[int, int, Formula]]

    @classmethod
    def of(cls, automaton: TaskAutomaton, most: int) -> Drawing:
        """Empty if there are more than `most` states, or if its letters are unknown."""
        if automaton.n_states > most or not len(automaton.valuations):
            return cls([], [])
        leads = [
            {r: tuple(np.flatnonzero(column == r).tolist()) for r in np.unique(column).tolist()}
            for column in automaton.delta.T
        ]
        boxes = [int(automaton.initial)]
        for q in boxes:
            boxes += [r for r in sorted(leads[q], reverse=True) if r not in boxes]
        arrows = [(q, r, condition(automaton, letters)) for q in boxes for r, letters in leads[q].items()]
        return cls(boxes, arrows)


def verdict_text(automaton: TaskAutomaton, q: int) -> str:
    """When a run in state q is decided, such as "false from step 4 to 7; true from step 8"."""
    starts = automaton.verdict_starts.tolist()
    pieces: list[tuple[int, int | None, int]] = []
    for i, verdict in enumerate(automaton.verdict_rows[:, q].tolist()):
        end = starts[i + 1] - 1 if i + 1 < len(starts) else None
        if pieces and pieces[-1][2] == verdict:
            pieces[-1] = (pieces[-1][0], end, verdict)
        else:
            pieces.append((starts[i], end, verdict))
    return "; ".join(
        f"{'true' if verdict == TRUE else 'false'} from step {first}{'' if last is None else f' to {last}'}"
        for first, last, verdict in pieces
        if verdict != UNDECIDED
    )


def condition(automaton: TaskAutomaton, letters: tuple[int, ...]) -> Formula:
    """A short Boolean formula over the atoms that holds for these letters and for no other letter of the automaton."""
    rows = [
        (row, letter in letters)
        for row, letter in zip(automaton.valuations.tolist(), automaton.letter_of.tolist(), strict=True)
    ]
    taken = [row for row, inside in rows if inside]
    if len(taken) == len(rows):
        return Constant(True)
    if not taken:
        return Constant(False)
    if len(automaton.atoms) > _MOST_SIMPLIFIED:
        return _or([_and(automaton, [(i, not holds) for i, holds in enumerate(row)]) for row in taken])
    n, known = len(automaton.atoms), {_code(row) for row, _ in rows}
    unknown = (code for code in range(1 << n) if code not in known)
    return _or([_and(automaton, literals(n, cube)) for cube in shortest_cover(n, map(_code, taken), unknown)])


def _code(row: list[bool]) -> int:
    return sum(1 << i for i, holds in enumerate(row) if holds)


def _and(automaton: TaskAutomaton, parts: list[tuple[int, bool]]) -> Formula:
    formulas = [Not(automaton.atoms[i]) if negated else automaton.atoms[i] for i, negated in parts]
    return formulas[0] if len(formulas) == 1 else And(tuple(formulas))


def _or(parts: list[Formula]) -> Formula:
    return parts[0] if len(parts) == 1 else Or(tuple(parts))
