"""What the explorer of a report's page works on: the model, the automaton and the policy, as arrays.

No value is shipped, all are computed in the page, by a twin of the checker (templates/engine.js). Python and the page
find the nodes (stltool/reached.py) by the same forward search and compare their number and a checksum (FNV-1a of
the codes), so no index is shipped either: the policy is one number a node.

Arrays are little-endian bytes in base64 with their numpy type; the smallest type that holds them.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from stltool.automata import TaskAutomaton
from stltool.automata.graph import Drawing
from stltool.checking import CheckResult, Run
from stltool.checking.situations import Explored
from stltool.logic.printer import Text, with_names
from stltool.models import MDP
from stltool.policy import FORMAT, Policy
from stltool.product import Product
from stltool.reached import MOST_EDGES, MOST_NODES

I64 = NDArray[np.int64]

_MOST_MEMORIES = 5000  # automaton states whose phrases are shipped
_MOST_STATES, _MOST_TRANSITIONS = 20_000, 2_000_000
_MOST_DRAWN = 60  # states of a graph; more would be a thicket
_MOST_NODES_DRAWN = 8  # states of an automaton as boxes and arrows
_MOST_TABLE = 200_000_000  # bytes of a dense policy table that the page may write
_SMALLEST = (("u1", 1 << 8), ("u2", 1 << 16), ("u4", 1 << 32))


class LevelRecord(TypedDict):
    """What a part of an automaton can remember (stltool/automata): `number` of steps up to `limit`, if it counts."""

    phrase: str
    status: str
    number: int | None
    limit: int | None
    risk: bool


class TrackRecord(TypedDict):
    """A part of an automaton: its levels in ascending order, and the level `of` each automaton state."""

    name: str
    levels: list[LevelRecord]
    of: list[str]


class ArrowRecord(TypedDict):
    """An edge of a drawn automaton, with the condition on what is read."""

    start: int
    end: int
    text: str


class AutomatonRecord(TypedDict):
    """An automaton as parts; a small one also as boxes, in order from the initial state, and arrows."""

    states: int
    initial: int
    tracks: list[TrackRecord]
    boxes: list[int]
    arrows: list[ArrowRecord]


class BodyRecord(TypedDict):
    """A member of a composition that moves on a floor: of a state s of the model, its cell is (s // stride) mod the
    number of its cells. `labels` are its own, by cell; `actions` are its parts of the model's actions."""

    name: str
    stride: int
    width: int
    height: int
    x: list[int]
    y: list[int]
    labels: dict[str, list[int]]
    actions: list[str]


class PositionRecord(TypedDict):
    """Where states are drawn: cells of a floor, or points of a graph in the unit square; only the `shown` ones.

    `bodies`, of a composition: the floor of each member that is a grid; the page draws one of them at a time.
    """

    kind: str
    width: int
    height: int
    shown: list[int]
    x: list[float]
    y: list[float]
    bodies: NotRequired[list[BodyRecord]]


class ClaimRecord(TypedDict):
    """What the page compares its own computation with."""

    probability: float
    optimum: float | None
    maximize: bool
    nodes: int
    checksum: int


class PathRecord(TypedDict):
    """The sampled run: its states, and the choice taken in each but the last."""

    states: list[int]
    choices: list[int]


class NatureRecord(TypedDict):
    """How nature picks probabilities in their intervals: for the least P, if `minimal`, or for the greatest."""

    minimal: bool


class ExplorerRecord(TypedDict):
    """All that the explorer needs; or `refused`, the reason why there is none, and nothing else. It is `whole`, or has
    only the situations that the policy comes to.

    `header` is that of a policy file; without one, edits cannot be exported, for the reason in `no_export`.
    """

    refused: NotRequired[str]
    policy: NotRequired[str]
    horizon: NotRequired[int]
    states: NotRequired[list[str]]
    actions: NotRequired[list[str]]
    labels: NotRequired[dict[str, list[int]]]
    position: NotRequired[PositionRecord]
    claim: NotRequired[ClaimRecord]
    nature: NotRequired[NatureRecord | None]
    whole: NotRequired[bool]
    run: NotRequired[PathRecord | None]
    header: NotRequired[str | None]
    no_export: NotRequired[str | None]
    arrays: NotRequired[dict[str, list[str]]]


def explorer_data(
    product: Product, shown: CheckResult | None, optimum: CheckResult | None, run: Run | None, learned: bool
) -> ExplorerRecord:
    """The explorer of the policy of `shown`, or the reason why there is none."""
    policy = shown.policy if shown is not None else None
    refusal = _refusal(product, policy)
    if refusal is not None:
        return {"refused": refusal}
    assert shown is not None
    assert policy is not None
    own, (product, policy) = product, policy.on(product)
    if product.automaton.n_states > _MOST_MEMORIES:
        many = product.automaton.n_states
        return {"refused": f"task and policy have {many} states of memory together, too many to choose among"}
    explored = Explored.of(product, policy)
    if explored is None:
        return {
            "refused": f"under the policy, a run can be in more than {MOST_NODES} situations of step, state and "
            f"memory, or its moves are more than {MOST_EDGES}: too many for a page; a report of the same task with "
            "shorter windows has one"
        }
    model, automaton = product.model, product.automaton
    nodes, choice, mixtures = explored.nodes, explored.numbers, explored.mixtures
    no_export = _no_export(product, choice, remembers_more=product is not own)
    values, index = np.unique(model.probability, return_inverse=True)
    best = optimum if optimum is not None and optimum.product.automaton is automaton else None
    maximize = (optimum or shown).question != "minimum"
    return {
        "policy": "learned" if learned else "given" if shown.question == "policy" else shown.question,
        "horizon": product.horizon,
        "states": [model.state_name(s) for s in range(model.n_states)],
        "actions": list(model.action_names),
        "labels": _marks(product),
        "position": position(product, nodes, [] if run is None else list(run.states)),
        "claim": {
            "probability": shown.probability,
            "optimum": best.probability if best is not None and explored.whole else None,
            "maximize": maximize,
            "nodes": sum(map(len, nodes)),
            "checksum": checksum(nodes),
        },
        "whole": explored.whole,
        "nature": {"minimal": maximize == (shown.nature == "against")} if model.uncertain else None,
        "run": _path(model, run) if run is not None else None,
        "header": None if no_export else json.dumps({"format": FORMAT, **asdict(policy.binding)}),
        "no_export": no_export,
        "arrays": {
            "choice_start": _fitting(model.choice_start),
            "choice_action": _fitting(model.choice_action),
            "row_start": _fitting(model.row_start),
            "target": _fitting(model.target),
            "values": _array(values, "f8"),
            "value": _fitting(index.ravel()),
            **_ends(model),
            "initial": _array(model.initial, "f8"),
            "letter": _fitting(product.letter),
            "delta": _fitting(automaton.delta.ravel()),
            "verdict_starts": _fitting(automaton.verdict_starts),
            "verdict_rows": _array(automaton.verdict_rows.ravel(), "i1"),
            "policy": _array(choice, "i1" if abs(choice).max(initial=0) < 127 else "i4"),
            "mixtures": _array(mixtures.ravel(), "f8"),
        },
    }


def _refusal(product: Product, policy: Policy | None) -> str | None:
    """Why there is no explorer; None if there may be one."""
    model = product.model
    if model.blackbox is not None:
        return "the model is a black box, whose probabilities are unknown"
    if model.uncertain and model.parameters:
        return (
            "nature picks the model's parameters, which the page cannot do; give them values (-p), or check the "
            "nominal model (--nature nominal), to explore it"
        )
    if policy is None:
        return "the policy was not kept"
    if model.n_states > _MOST_STATES or model.n_transitions > _MOST_TRANSITIONS:
        return f"the model is too large for a page: {model.n_states} states, {model.n_transitions} transitions"
    return None


def _ends(model: MDP) -> dict[str, list[str]]:
    """The ends of the intervals, if there are any: distinct values, and which of them each transition has."""
    if model.intervals is None:
        return {}
    found: dict[str, list[str]] = {}
    for name, ends in (("lower", model.intervals.lower), ("upper", model.intervals.upper)):
        values, index = np.unique(ends, return_inverse=True)
        found |= {f"{name}s": _array(values, "f8"), name: _fitting(index.ravel())}
    return found


def checksum(nodes: list[I64]) -> int:
    """FNV-1a over the codes of all layers, 32 bits."""
    total = 2166136261
    for code in np.concatenate(nodes).tolist() if nodes else []:
        total = ((total ^ code) * 16777619) & 0xFFFFFFFF
    return total


def _no_export(product: Product, choice: NDArray[np.int32], remembers_more: bool) -> str | None:
    """Why the page cannot write the policy to a file; None if it can."""
    if remembers_more:
        return "the policy remembers more than the task's automaton, so its table would not be all of it"
    if (choice < 0).any():  # without gaps and mixtures it is written as lists, however large a table would be
        width = 8 * product.model.most_choices if choice.min() < -1 else 4
        if product.horizon * product.n_states * width > _MOST_TABLE:
            return "its table would be too large"
    return None


# ---------------------------------------------------------------------------------------------------------------- shown


def _marks(product: Product) -> dict[str, list[int]]:
    """States by what marks them: the model's labels, and what the task compares, unless a label says the same."""
    model = product.model
    marks = {name: np.flatnonzero(values).tolist() for name, values in model.labels.items()}
    text = with_names(product.definitions)
    for atom, holds in product.where().items():
        states = np.flatnonzero(holds).tolist()
        if 0 < len(states) < model.n_states and states not in marks.values():
            marks[text(atom)] = states
    return marks


def _path(model: MDP, run: Run) -> PathRecord:
    choices = []
    for s, name in zip(run.states, run.actions, strict=False):
        actions = model.choice_action[model.choice_start[s] : model.choice_start[s + 1]].tolist()
        choices.append(actions.index(model.action_names.index(name)))
    return {"states": [int(s) for s in run.states], "choices": choices}


def bodies(model: MDP) -> list[BodyRecord]:
    """The members of a composition that are grids, those of its members included."""
    return list(_bodies(model, "", 1, np.arange(model.n_actions)))


def _bodies(model: MDP, name: str, stride: int, own: NDArray[np.int64]) -> Iterator[BodyRecord]:
    """`own` is the model's part (n,) of each action of the whole."""
    if model.layout is not None:
        lay = model.layout
        yield {
            "name": name, "stride": stride, "width": lay.width, "height": lay.height, "x": lay.column.tolist(),
            "y": (lay.height - 1 - lay.row).tolist(), "actions": [model.action_names[a] for a in own.tolist()],
            "labels": {label: np.flatnonzero(values).tolist() for label, values in model.labels.items()},
        }  # fmt: skip
    stride *= math.prod(one.n_states for one in model.members.values())
    actions = model.n_actions
    for prefix, one in model.members.items():
        stride, actions = stride // one.n_states, actions // one.n_actions
        part = own // actions % one.n_actions
        yield from _bodies(one, f"{name}.{prefix}" if name else prefix, stride, part)


def position(product: Product, nodes: list[I64], run: list[int]) -> PositionRecord:
    """A floor, a floor read from two integer signals, or a graph; of many states, those that runs visit most."""
    model = product.model
    everything = list(range(model.n_states))
    if model.layout is not None:
        lay = model.layout
        y = (lay.height - 1 - lay.row).tolist()
        return {"kind": "floor", "width": lay.width, "height": lay.height, "shown": everything,
                "x": lay.column.tolist(), "y": y}  # fmt: skip
    if model.members and (found := bodies(model)):
        return {"kind": "floor", "width": 0, "height": 0, "shown": [], "x": [], "y": [], "bodies": found}
    if len(model.signals) == 2:
        (_, u), (name, v) = sorted(model.signals.items(), key=lambda pair: pair[0] in ("row", "y"))
        cells = np.stack([u, v], axis=1)
        if (cells == np.round(cells)).all() and len(np.unique(cells, axis=0)) == model.n_states:
            x, row = (np.round(w - w.min()).astype(int) for w in (u, v))
            width, height = int(x.max()) + 1, int(row.max()) + 1
            if width * height <= 4 * model.n_states:
                y = row if name == "row" else height - 1 - row
                return {"kind": "floor", "width": width, "height": height, "shown": everything,
                        "x": x.tolist(), "y": y.tolist()}  # fmt: skip
    shown = everything
    if len(shown) > _MOST_DRAWN:
        often = np.bincount(np.concatenate(nodes) // product.automaton.n_states, minlength=model.n_states)
        often[run] += often.max() + 1
        shown = sorted(np.argsort(-often, kind="stable")[:_MOST_DRAWN].tolist())
    x, y = _graph_places(model, shown).T.round(4).tolist()
    return {"kind": "graph", "width": 0, "height": 0, "shown": shown, "x": x, "y": y}


def _graph_places(model: MDP, shown: list[int]) -> NDArray[np.float64]:
    """(n, 2) points in the unit square."""
    import networkx

    graph = networkx.Graph()
    graph.add_nodes_from(shown)
    inside = set(shown)
    for s in shown:
        first, end = model.row_start[model.choice_start[s]], model.row_start[model.choice_start[s + 1]]
        graph.add_edges_from((s, u) for u in model.target[first:end].tolist() if u in inside and u != s)
    place = networkx.kamada_kawai_layout(graph)
    xy = np.array([place[s] for s in shown]).reshape(-1, 2)
    low, size = xy.min(axis=0), np.maximum(np.ptp(xy, axis=0), 1e-9)
    places: NDArray[np.float64] = np.where(np.ptp(xy, axis=0) > 0, (xy - low) / size, 0.5)
    return places


def automaton_data(automaton: TaskAutomaton, text: Text = str) -> AutomatonRecord | None:
    """The automaton as its parts, and a small one as boxes and arrows; None if it is too large to be shown."""
    if automaton.n_states > _MOST_MEMORIES:
        return None
    tracks: list[TrackRecord] = [
        {
            "name": track.name,
            "levels": [
                {"phrase": one.phrase, "status": one.status, "number": one.number, "limit": one.limit, "risk": one.risk}
                for one in track.levels
            ],
            "of": _fitting(track.level_of),
        }
        for track in automaton.tracks(text)
    ]
    drawing = Drawing.of(automaton, _MOST_NODES_DRAWN)
    return {
        "states": automaton.n_states,
        "initial": int(automaton.initial),
        "tracks": tracks,
        "boxes": drawing.boxes,
        "arrows": [{"start": q, "end": r, "text": text(psi)} for q, r, psi in drawing.arrows],
    }


# ---------------------------------------------------------------------------------------------------------------- bytes


def _array(array: NDArray[Any], kind: str) -> list[str]:
    data = np.ascontiguousarray(array, dtype=f"<{kind}").tobytes()
    return [kind, base64.b64encode(data).decode("ascii")]


def _fitting(array: NDArray[Any]) -> list[str]:
    """Non-negative integers in the smallest type."""
    most = int(array.max(initial=0))
    return _array(array, next(kind for kind, room in _SMALLEST if most < room))
