"""index.json of a UMB file: what the file contains, as its author declares it, checked against the format.

Source of the format: https://github.com/pmc-tools/umb, version 1 of 2026.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

from stltool.arguments import described
from stltool.errors import ModelError
from stltool.models.formats.archive import Archive

INDEX = "index.json"
VERSION = 1
"""The package umbi writes the same as version 0."""

TOOL = "stltool"
NAMES = "state-names"
"""Among the parameters of our tool: a name for every state."""

_LARGEST_INDEX = 1 << 26  # bytes
_WIDEST = 1 << 16  # bits of a number
_MOST = 2**64 - 1
_KEY = re.compile(r"[0-9a-z_-]+", re.ASCII)

_SIZES = {
    "bool": 1, "int": 64, "uint": 64, "int-interval": 128, "uint-interval": 128, "double": 64, "double-interval": 128,
    "rational": 128, "rational-interval": 256, "string": 64,
}  # fmt: skip
_FIXED = ("double", "double-interval", "string")
ENTITIES = ("states", "choices", "branches")


@dataclass(frozen=True)
class Type:
    """The type of a file's values, each of `size` bits."""

    name: str
    size: int

    @property
    def is_interval(self) -> bool:
        return self.name.endswith("-interval")

    def __str__(self) -> str:
        return f"{self.name} of {self.size} bits"


@dataclass(frozen=True)
class Annotation:
    """Values of states, choices or branches; `name` is the alias, by which Storm and PRISM refer to it."""

    folder: str
    name: str
    applies_to: tuple[str, ...]
    type: Type


@dataclass(frozen=True)
class Variable:
    """A variable of states, from bit `offset` of a state's valuation; an optional one has a bit before it."""

    name: str
    type: Type
    offset: int
    optional: bool
    plus: int


@dataclass(frozen=True)
class Valuations:
    """`variables` and size in bytes of each class of states."""

    classes: tuple[tuple[tuple[Variable, ...], int], ...]
    n_strings: int


@dataclass(frozen=True)
class Index:
    """What index.json declares of a chain (`players` is 0) or an MDP (1)."""

    players: int
    n_states: int
    n_initial: int
    n_choices: int
    n_actions: int
    n_branches: int
    probabilities: Type
    labels: tuple[Annotation, ...]
    rewards: tuple[Annotation, ...]
    valuations: Valuations | None
    name: str | None
    state_names: tuple[str, ...] | None


def read_index(archive: Archive) -> Index:
    """The index of an archive. Raises ModelError."""
    if INDEX not in archive:
        raise archive.fault(INDEX, "is missing; this is not a UMB file")
    if archive.size(INDEX) > _LARGEST_INDEX:
        raise archive.fault(INDEX, f"has {archive.size(INDEX)} bytes; at most {_LARGEST_INDEX} are read")
    reader = _Reader(archive)
    try:
        content = json.loads(bytes(archive.view(INDEX)).decode("utf-8-sig"), parse_constant=reader.refuse_constant)
    except (ValueError, RecursionError) as error:
        raise archive.fault(INDEX, f"is not JSON: {error}") from None
    return reader.index(content)


class _Reader:
    """Reads one index; every fault names the place in it."""

    def __init__(self, archive: Archive) -> None:
        self.archive = archive

    def refuse(self, fault: str) -> NoReturn:
        raise ModelError(f"{self.archive.path}: {INDEX}: {fault}")

    def refuse_constant(self, text: str) -> NoReturn:
        self.refuse(f"{text} is not a number of JSON")

    def table(self, value: Any, where: str) -> Mapping[str, Any]:
        if not isinstance(value, dict):
            self.refuse(f"{where} is {described(value)}; it must be an object")
        return value

    def list(self, value: Any, where: str) -> list[Any]:
        if not isinstance(value, list):
            self.refuse(f"{where} is {described(value)}; it must be a list")
        return value

    def text(self, value: Any, where: str) -> str:
        if not isinstance(value, str):
            self.refuse(f"{where} is {described(value)}; it must be a text")
        return value

    def whole(self, value: Any, where: str, least: int = 0, most: int = _MOST) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            self.refuse(f"{where} is {described(value)}; it must be an integer from {least} to {most}")
        return value

    def type(self, value: Any, where: str, packed: bool = False) -> Type:
        """A type; `packed` for variables, whose integers may have any size."""
        table = self.table(value, where)
        name = self.text(table.get("type"), f"{where}: type")
        if name not in _SIZES:
            self.refuse(f"{where}: there is no type {name!r}; known types: {', '.join(_SIZES)}")
        size = self.whole(table.get("size", _SIZES[name]), f"{where}: size", not packed, _WIDEST)
        usual = _SIZES[name]
        if name in _FIXED or not (packed or name.startswith("rational")):
            fits = size == usual
        else:
            fits = size % (usual if not packed else 2) == 0 if name.startswith("rational") else True
        if not fits:
            self.refuse(f"{where}: {name} of {size} bits; it must have {usual}, or a multiple if it is rational")
        return Type(name, size)

    def index(self, content: Any) -> Index:
        top = self.table(content, "the index")
        version = self.whole(top.get("format-version"), "format-version")
        if version > VERSION:
            self.refuse(f"the format version is {version}; versions up to {VERSION} can be read; write it as that one")
        system = self.table(top.get("transition-system"), "transition-system")
        players = self.whole(system.get("#players"), "#players")
        self.refuse_kind(system, players)
        counts = {
            key: self.whole(system.get(key), key)
            for key in ("#states", "#initial-states", "#choices", "#choice-actions", "#branches", "#branch-actions")
        }
        if counts["#states"] < 1:
            self.refuse("#states is 0; a model has states")
        kind = self.type(system.get("branch-probability-type"), "branch-probability-type")
        if not kind.name.startswith(("double", "rational")):
            self.refuse(f"branch-probability-type is {kind.name}; probabilities are double or rational, or intervals")
        annotations = self.table(top.get("annotations", {}), "annotations")
        data = top.get("model-data")
        name = data.get("name") if isinstance(data, dict) else None
        return Index(
            players, counts["#states"], counts["#initial-states"], counts["#choices"], counts["#choice-actions"],
            counts["#branches"], kind, self.annotations(annotations, "aps"), self.annotations(annotations, "rewards"),
            self.valuations(top), name if isinstance(name, str) and name else None,
            self.state_names(top, counts["#states"]),
        )  # fmt: skip

    def state_names(self, top: Mapping[str, Any], n_states: int) -> tuple[str, ...] | None:
        """The names of states, in files that stltool wrote."""
        data = top.get("file-data")
        if not isinstance(data, dict) or data.get("tool") != TOOL:
            return None
        parameters = data.get("parameters")
        names = parameters.get(NAMES) if isinstance(parameters, dict) else None
        if names is None:
            return None
        found = tuple(self.text(one, f"parameters: {NAMES}") for one in self.list(names, f"parameters: {NAMES}"))
        if len(found) != n_states:
            self.refuse(f"parameters: {NAMES}: there are {len(found)} names for {n_states} states")
        return found

    def refuse_kind(self, system: Mapping[str, Any], players: int) -> None:
        """Models that are neither chains nor MDPs."""
        time, chain = system.get("time"), players == 0
        if time not in ("discrete", "stochastic", "urgent-stochastic"):
            self.refuse(f"time is {described(time)}; it must be discrete")
        kind = None
        if time != "discrete":
            kind = ("CTMC" if chain else "CTMDP") if time == "stochastic" else "Markov automaton"
            why = "its time is continuous"
        elif players > 1:
            kind, why = "game", f"it has {players} players"
        elif self.whole(system.get("#observations", 0), "#observations"):
            kind, why = "POMDP", "its states are observed in part"
        elif "branch-probability-type" not in system:
            kind, why = "transition system (LTS)", "it has no probabilities"
        if kind is not None:
            self.refuse(f"the model is a {kind}: {why}; Markov chains and MDPs of discrete time can be read")

    def annotations(self, groups: Mapping[str, Any], group: str) -> tuple[Annotation, ...]:
        found: dict[str, Annotation] = {}
        for key, value in self.table(groups.get(group, {}), f"annotations: {group}").items():
            where = f"annotations: {group}: {key}"
            if _KEY.fullmatch(key) is None:
                self.refuse(f"{where}: identifiers consist of a to z, 0 to 9, _ and -")
            table = self.table(value, where)
            kind = self.type(table.get("type"), f"{where}: type")
            applies = tuple(self.text(one, where) for one in self.list(table.get("applies-to"), f"{where}: applies-to"))
            name = self.text(table.get("alias", key), f"{where}: alias")
            if group == "aps" and applies != ("states",):
                self.refuse(f"{where}: applies-to is {list(applies)}; atomic propositions are of states")
            if not applies or len(set(applies)) < len(applies):
                self.refuse(f"{where}: applies-to is {list(applies)}; name each kind once")
            if group == "aps" and kind.name != "bool":
                self.refuse(f"{where}: it is of type {kind.name}; atomic propositions are of type bool")
            if group == "rewards":
                if kind.name not in ("double", "rational", "int", "uint"):
                    self.refuse(f"{where}: it is of type {kind.name}; rewards are numbers")
                if other := [one for one in applies if one not in ENTITIES]:
                    self.refuse(f"{where}: rewards of {other[0]} cannot be read")
                if "probability-type" in table:
                    self.refuse(f"{where}: random rewards cannot be read; give their expectations")
            if name in found:
                self.refuse(f"{where}: the alias {name!r} is used twice; rename one")
            found[name] = Annotation(f"annotations/{group}/{key}", name, applies, kind)
        return tuple(found.values())

    def valuations(self, top: Mapping[str, Any]) -> Valuations | None:
        states = self.table(top.get("valuations", {}), "valuations").get("states")
        if states is None:
            return None
        table = self.table(states, "valuations: states")
        classes = self.list(table.get("classes"), "valuations: states: classes")
        if not classes:
            self.refuse("valuations: states: there are no classes")
        described_classes = tuple(self.valuation_class(one, f"valuations: class {k}") for k, one in enumerate(classes))
        n_strings = self.whole(table.get("#strings", 0), "valuations: #strings")
        return Valuations(described_classes, n_strings)

    def valuation_class(self, value: Any, where: str) -> tuple[tuple[Variable, ...], int]:
        found: dict[str, Variable] = {}
        bits = 0
        for entry in self.list(self.table(value, where).get("variables"), f"{where}: variables"):
            table = self.table(entry, f"{where}: variables")
            if "padding" in table:
                bits += self.whole(table["padding"], f"{where}: padding", 1, _WIDEST)
                continue
            name = self.text(table.get("name"), f"{where}: name")
            there = f"{where}: variable {name!r}"
            given = table.get("type")
            if isinstance(given, str):  # as in the examples of the specification
                given = {"type": given, **({"size": table["size"]} if "size" in table else {})}
            kind = self.type(given, there, packed=True)
            if kind.is_interval:
                self.refuse(f"{there} is of type {kind.name}; the values of variables are not intervals")
            if not name or name in found:
                self.refuse(f"{there}: variables have a name each; {'rename one' if name else 'it is empty'}")
            optional = table.get("is-optional", False)
            if not isinstance(optional, bool):
                self.refuse(f"{there}: is-optional is {described(optional)}; write true or false")
            bits += optional
            plus = self.whole(table.get("offset", 0), f"{there}: offset", -(2**63), 2**63 - 1)
            found[name] = Variable(name, kind, bits, optional, plus)
            bits += kind.size
        if bits % 8 or bits > _WIDEST * 64:
            self.refuse(f"{where}: a valuation has {bits} bits; their number must be a multiple of 8")
        return tuple(found.values()), bits // 8
