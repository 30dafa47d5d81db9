"""Several models side by side: the synchronous product, in which every step is one step of each.

States and actions are tuples, one entry a member, numbered with the last member varying fastest; members move
independently of each other:

    P((s1,s2), (a1,a2), (t1,t2)) = P1(s1,a1,t1) · P2(s2,a2,t2)

Probabilities are products of fractions, so they stay exact. Rows are computed when needed (models/rows.py). Signals,
labels and costs of member r1 are called r1.x; further labels are formulas over all of them.

    kind = "composition"
    [members]
    r1 = "floor.toml"                                    relative to the file
    r2 = { model = "floor.toml", start = [4, 0] }        column and row on a grid; elsewhere a state's name or number
    r3 = { model = "ice.toml", parameters = { p = "9/10" } }
    [labels]
    meet = "r1.x == r2.x & r1.y == r2.y"
    close = "meet | abs(r1.x - r2.x) + abs(r1.y - r2.y) < 0.3"       labels above may be used
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described, mapping, require
from stltool.arrays import read_only
from stltool.display import StateNames
from stltool.errors import ModelError, SizeError, StlToolError, near_misses
from stltool.models.cells import SUCCESS
from stltool.models.costs import Cost, Entries
from stltool.models.fractions import LARGEST_SUM, Integers, Shares, doubles_of
from stltool.models.mdp import MDP
from stltool.models.parameters import Ties
from stltool.models.rows import I32, I64, READ_EXACTLY, Chances, Gathered, Rows, Source, Stored, starts, tied
from stltool.models.toml import Faults
from stltool.sizes import require_memory, require_numbered

if TYPE_CHECKING:
    from stltool.monitoring.states import Definition

MOST_MEMBERS = 32
_MOST_ACTIONS = 2**20
_BLOCK = 1 << 18  # entries computed at a time
_PER_ENTRY = 120  # bytes, while they are computed
_SMALLER = "compose fewer or smaller models"
_PREFIX = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_KEYS = ("kind", "members", "labels", "name", "normalize")
_MEMBER_KEYS = ("model", "start", "parameters")


def compose(
    models: Sequence[MDP] | Mapping[str, MDP],
    labels: Mapping[str, Definition] | None = None,
    name: str = "composition",
) -> MDP:
    """The synchronous product of models: in every step each takes one of its actions, independently of the others.

    models   name → model; those of a list are called r1, r2, …
    labels   name → a formula without temporal operators over the members' signals and labels, such as
             {"meet": "r1.x == r2.x & r1.y == r2.y"}, and over the labels defined before it

    States are called "r1=(0,0) r2=(4,0)", actions "r1.N+r2.E". Probabilities are exact products. One member may
    depend on parameters. Raises ModelError for intervals, black boxes and names that clash, SizeError before memory is
    taken, and for a label what its formula is refused for.
    """
    given: dict[str, MDP]
    if isinstance(models, Mapping):
        given = dict(mapping(models, "compose's models", "{'r1': model, 'r2': model}"))
    else:
        require(models, (list, tuple), "compose's models", "give a list of models, or {'r1': model, 'r2': model}")
        given = {f"r{number}": model for number, model in enumerate(models, start=1)}
    for model in given.values():
        require(model, MDP, "one of compose's models")
    require(name, str, "the composition's name")
    formulas = mapping(labels, "compose's labels", "{'meet': 'r1.x == r2.x'}", optional=True)
    return _defined(_product(given, name), formulas)


def _product(members: Mapping[str, MDP], name: str) -> MDP:
    """The composition without labels of its own."""
    _require_composable(members)
    models = list(members.values())
    n_states, n_actions = (prod(getattr(model, what) for model in models) for what in ("n_states", "n_actions"))
    shown = " · ".join(str(model.n_states) for model in models)
    require_numbered(n_states, f"states ({shown})", _SMALLER)
    if n_actions > _MOST_ACTIONS:
        raise SizeError(
            f"these models have {n_actions} joint actions, one after another by name, and at most {_MOST_ACTIONS} can "
            "be listed; compose fewer models, or models with fewer actions"
        )
    columns = sum(8 * len(model.signals) + len(model.labels) for model in models)
    require_memory(
        n_states * (columns + 64 + 8 * len(models)) + 150 * n_actions * len(models),
        f"{n_states} states ({shown}) with {n_actions} actions", _SMALLER,
    )  # fmt: skip
    joint = Joint([model.source for model in models], list(members), [model.n_actions for model in models])
    across = [joint.digits(np.arange(n_states, dtype=np.int64), i) for i in range(len(models))]
    start = [model.initial_shares for model in models]
    one = prod(share.denominator for share in start)
    initial = np.ones(n_states, dtype=np.int64 if one < LARGEST_SUM else object)
    for share, digits in zip(start, across, strict=True):
        initial = initial * share.numerator.astype(initial.dtype)[digits]
    first = Shares(initial, one)
    notes: dict[str, str] = {}
    signals: dict[str, NDArray[np.float64]] = {}
    labels: dict[str, NDArray[np.bool_]] = {}
    for (prefix, model), digits in zip(members.items(), across, strict=True):
        signals |= {f"{prefix}.{key}": values[digits] for key, values in model.signals.items()}
        labels |= {f"{prefix}.{key}": values[digits] for key, values in model.labels.items()}
        for subject, text in model.notes.items():
            notes[subject] = "; ".join(filter(None, [notes.get(subject), f"{prefix}: {text}"]))
    source, costs = _source(joint, members)
    return MDP(
        source,
        initial=doubles_of(first.numerator, one),
        signals=signals,
        labels=labels,
        action_names=_action_names(members),
        state_names=StateNames(n_states, _Names(joint, members)),
        name=name,
        exact_initial=first,
        notes=notes,
        members=dict(members),
        costs=costs,
    )  # fmt: skip


def _action_names(members: Mapping[str, MDP]) -> tuple[str, ...]:
    names = [""]
    for prefix, model in members.items():
        names = [f"{name}{'+' if name else ''}{prefix}.{own}" for name in names for own in model.action_names]
    if len(set(names)) < len(names):
        repeated = next(name for name, times in Counter(names).items() if times > 1)
        raise ModelError(f"two joint actions are called {described(repeated)}; rename the members' actions")
    return tuple(names)


class _Names:
    """The name of each state: those of the members' states."""

    def __init__(self, joint: Joint, members: Mapping[str, MDP]) -> None:
        self._joint, self._members = joint, members

    def __call__(self, s: int) -> str:
        digits = (int(self._joint.digits(np.array([s]), i)[0]) for i in range(len(self._members)))
        named = zip(self._members.items(), digits, strict=True)
        names = ((prefix, model.state_name(digit)) for (prefix, model), digit in named)
        return " ".join(f"{prefix}=[{name}]" if " " in name else f"{prefix}={name}" for prefix, name in names)


def _require_composable(members: Mapping[str, MDP]) -> None:
    if not members:
        raise ModelError("there is no model to compose; give at least one")
    if sum(len(model.members) or 1 for model in members.values()) > MOST_MEMBERS or len(members) > MOST_MEMBERS:
        raise SizeError(f"these are {len(members)} models or more; compose at most {MOST_MEMBERS}")
    for prefix, model in members.items():
        if not _PREFIX.fullmatch(prefix):
            raise ModelError(
                f"member {described(prefix)}: a member's name begins its signals' names; write letters, digits and _, "
                "such as r1"
            )
        if model.blackbox is not None:
            raise ModelError(
                f"member {prefix} is a black box, whose probabilities are unknown; compose models with rows"
            )
        if model.uncertain and not model.parameters:
            raise ModelError(
                f"the probabilities of member {prefix} are intervals; what nature may do to one of several models is "
                "not an interval of their composition, so compose the ordinary model inside them: "
                f"{prefix}.nominal() in Python, or a file with numbers"
            )
    varying = [prefix for prefix, model in members.items() if model.parameters]
    if len(varying) > 1:
        first = members[varying[0]].parameters[0].name
        raise ModelError(
            f"members {' and '.join(varying)} depend on parameters, and products of these are not linear; give all but "
            f"one of them a value: parameters = {{ {first} = … }} of member {varying[0]} in a file, "
            f"model.at({first}=…) in Python"
        )


def _source(joint: Joint, members: Mapping[str, MDP]) -> tuple[Source, dict[str, Cost]]:
    """The rows and the costs of a composition; all rows in memory where a member's need them."""
    given = [(i, f"{prefix}.{name}", cost) for i, (prefix, model) in enumerate(members.items())
             for name, cost in model.costs.items()]  # fmt: skip
    along = any(cost.transitions is not None for _, _, cost in given)
    tied = any(source.ties is not None for source in joint.sources)
    held = joint.held() if along or tied else None
    states = np.arange(joint.n_states, dtype=np.int64)
    costs = {}
    for i, name, cost in given:
        parts: dict[str, Any] = {}
        if cost.states is not None:
            parts["states"] = cost.states.at(joint.digits(states, i))
        if cost.choices is not None:
            parts["choices"] = cost.choices.at(joint.choices_of(i))
        if cost.transitions is not None:
            assert held is not None
            numbers, rows = cost.transitions.at(held.entries[i]), held.source.whole()
            parts["transitions"] = Entries(numbers.values, numbers.given, row_start=rows.row_start, target=rows.target)
        costs[name] = Cost(**parts)
    return held.source if held is not None else joint, costs


def _defined(model: MDP, formulas: Mapping[str, Definition]) -> MDP:
    for key, formula in formulas.items():
        model = _with_label(model, key, formula)
    return model


def _with_label(model: MDP, key: str, formula: object) -> MDP:
    """The model with one more label. Raises StlToolError."""
    from stltool.monitoring.states import label_of  # which imports numba

    if key in model.labels or key in model.signals:
        raise ModelError(f"label {key}: the composition has a name {key} already; choose another")
    if not key or re.search(r"[\r\n]", key):
        raise ModelError(f"{described(key)} cannot be a label's name; write letters, digits and _")
    require_memory(40 * model.n_states, f"reading label {key} in {model.n_states} states", _SMALLER)
    holds = label_of(key, formula, model.signals, model.labels, model.n_states)
    return replace(model, labels={**model.labels, key: holds})


# ---------------------------------------------------------------------------------------------------------------- rows


class _Parts(NamedTuple):
    """Rows of joint states: where choices and rows start, successors, and of which entries of the members they are."""

    choice_start: I64
    row_start: I64
    target: I64
    entries: list[I64]


class Joint(Source):
    """The rows of a composition of models whose probabilities are numbers (or, for `held`, depend on parameters).

    sources   those of the members      names   the members' names, for messages
    actions   how many actions each member has
    """

    def __init__(self, sources: Sequence[Source], names: Sequence[str], actions: Sequence[int]) -> None:
        self.sources, self._names, self._actions = list(sources), list(names), list(actions)
        self._sizes = [source.n_states for source in sources]
        self._strides, self._action_strides = _strides(self._sizes), _strides(self._actions)
        require_memory(
            _PER_ENTRY * self.widest, f"the {self.widest} transitions of one state of {' and '.join(names)}", _SMALLER
        )
        self._rows = [self._readable(i) for i in range(len(sources))]

    def _readable(self, i: int) -> Callable[[I64], Rows]:
        """What gives the rows of a member, all over one denominator."""
        source = self.sources[i]
        given = source.ties is not None or source.rows(np.zeros(1, dtype=np.int64)).given_exactly
        if not given and source.n_transitions > READ_EXACTLY:
            raise SizeError(
                f"the {source.n_transitions} probabilities of {self._names[i]} are doubles, too many to be multiplied "
                "exactly; give them as fractions or decimals in a file, or as integers over a denominator"
            )
        return source.rows if given or not source.on_demand else source.whole().some

    def digits(self, states: I64, i: int) -> I64:
        """The states of member i in these joint states."""
        found: I64 = states // self._strides[i] % self._sizes[i]
        return found

    @property
    def n_states(self) -> int:
        return prod(self._sizes)

    @property
    def n_choices(self) -> int:
        return prod(source.n_choices for source in self.sources)

    @property
    def n_transitions(self) -> int:
        return prod(source.n_transitions for source in self.sources)

    @cached_property
    def choice_start(self) -> I64:
        counts = np.ones(1, dtype=np.int64)
        for source in self.sources:
            counts = np.multiply.outer(counts, np.diff(source.choice_start)).ravel()
        return read_only(starts(counts))

    @cached_property
    def choice_action(self) -> I32:
        found = np.zeros(self.n_choices, dtype=np.int32)
        for i, (source, stride) in enumerate(zip(self.sources, self._action_strides, strict=True)):
            found += source.choice_action[self.choices_of(i)] * np.int32(stride)
        return read_only(found)

    def choices_of(self, i: int) -> I64:
        """The choice of member i in each joint choice."""
        require_memory(30 * self.n_choices, f"the {self.n_choices} choices of {self.n_states} states", _SMALLER)
        found = np.empty(self.n_choices, dtype=np.int64)
        for states in _pieces(np.arange(self.n_states, dtype=np.int64), self.most_choices):
            digits = [self.digits(states, j) for j in range(len(self.sources))]
            first = [source.choice_start[own] for source, own in zip(self.sources, digits, strict=True)]
            end = [source.choice_start[own + 1] for source, own in zip(self.sources, digits, strict=True)]
            _, picks = _combined(first, [b - a for a, b in zip(first, end, strict=True)])
            found[slice(int(self.choice_start[states[0]]), int(self.choice_start[states[-1] + 1]))] = picks[i]
        return found

    @property
    def most_choices(self) -> int:
        return prod(source.most_choices for source in self.sources)

    @property
    def widest(self) -> int:
        return prod(source.widest for source in self.sources)

    @cached_property
    def kinds(self) -> Rows | None:
        """The combinations of the members' kinds, unless these are many."""
        kinds = [source.kinds for source in self.sources]
        known = [rows for rows in kinds if rows is not None]
        if len(known) < len(kinds) or prod(len(rows.target) for rows in known) > READ_EXACTLY:
            return None
        sizes = [len(rows) for rows in known]
        which = np.arange(prod(sizes), dtype=np.int64)
        strides = _strides(sizes)
        return self._made([rows.some(which // strides[i] % sizes[i]) for i, rows in enumerate(known)])

    @property
    def uncertain(self) -> bool:
        return False

    def nominal(self) -> Joint:
        return self

    @cached_property
    def family(self) -> Source | None:
        """That of the one member whose file declares parameters."""
        families = [source.family for source in self.sources]
        declared = [
            i for i, one in enumerate(families)
            if one is not None and one.ties is not None and all(known is not SUCCESS for known in one.ties.parameters)
        ]  # fmt: skip
        if len(declared) != 1:
            return None
        i = declared[0]
        sources = [families[i] if i == j else source for j, source in enumerate(self.sources)]
        return Joint([one for one in sources if one is not None], self._names, self._actions).held().source

    def rows(self, states: I64) -> Rows:
        if len(states) * self.widest <= _BLOCK:
            return self._some(states)
        gathered = Gathered()
        for piece in _pieces(states, self.widest):
            gathered.add(self._some(piece))
        return gathered.all

    def _some(self, states: I64) -> Rows:
        return self._made([self._member(states, i) for i in range(len(self.sources))])

    def _member(self, states: I64, i: int) -> Rows:
        """A member's rows in these joint states."""
        own, where = np.unique(self.digits(states, i), return_inverse=True)
        return self._rows[i](own).some(where)

    def _made(self, parts: list[Rows]) -> Rows:
        """The rows that consist of these rows of the members."""
        made = self._parts(parts)
        shares = _product_of(parts, made.entries)
        probability = doubles_of(*shares)
        chances = Chances(probability, made.row_start, Shares(*shares))
        return Rows(made.choice_start, made.row_start, made.target.astype(np.int32), chances)

    def _parts(self, parts: list[Rows]) -> _Parts:
        choice_start, choices = _combined(
            [rows.choice_start[:-1] for rows in parts], [np.diff(rows.choice_start) for rows in parts]
        )
        picked = list(zip(parts, choices, strict=True))
        row_start, entries = _combined(
            [rows.row_start[choice] for rows, choice in picked],
            [rows.row_start[choice + 1] - rows.row_start[choice] for rows, choice in picked],
        )
        columns = zip(parts, entries, self._strides, strict=True)
        target = sum(rows.target[entry].astype(np.int64) * stride for rows, entry, stride in columns)
        return _Parts(choice_start, row_start, np.asarray(target), entries)

    def held(self) -> _Held:
        """All rows in memory; those of one member may depend on parameters."""
        n = self.n_transitions
        require_memory(_PER_ENTRY * n, f"the {n} transitions of {self.n_states} states", _SMALLER)
        states = np.arange(self.n_states, dtype=np.int64)
        parts = [source.whole().some(self.digits(states, i)) for i, source in enumerate(self.sources)]
        made = self._parts(parts)
        entries = [
            own if rows.parts is None else rows.parts[1][own] for rows, own in zip(parts, made.entries, strict=True)
        ]
        at = self.choice_start, self.choice_action, made.row_start, made.target.astype(np.int32)
        varying = [i for i, rows in enumerate(parts) if rows.chances.ties is not None]
        if not varying:
            shares = _product_of(parts, made.entries)
            return _Held(Stored(*at, doubles_of(*shares), Shares(*shares)), entries)
        which = varying[0]
        ties, place = parts[which].chances.ties, parts[which].entry
        assert ties is not None
        entry = made.entries[which] if place is None else place[made.entries[which]].astype(np.int64)
        others = [i for i in range(len(parts)) if i != which]
        factor, one = _product_of([parts[i] for i in others], [made.entries[i] for i in others])
        kind = np.int64 if one * ties.denominator < LARGEST_SUM else object
        first, last = (end[entry].astype(kind) * np.asarray(factor, dtype=kind) for end in (ties.first, ties.last))
        together = Ties(ties.parameters, first, last, one * ties.denominator, ties.parameter[entry])
        return _Held(tied(*at, together), entries)


class _Held(NamedTuple):
    """All rows of a composition in memory, and which entry of each member's rows theirs are made of."""

    source: Stored
    entries: list[I64]


def _strides(sizes: Sequence[int]) -> list[int]:
    """What a digit counts, the last one varying fastest."""
    return [prod(sizes[i + 1 :]) for i in range(len(sizes))]


def _pieces(states: I64, width: int) -> Iterator[I64]:
    """States in pieces, such that a piece has few entries if a state has at most `width`."""
    step = max(_BLOCK // max(width, 1), 1)
    yield from (states[lo : lo + step] for lo in range(0, len(states), step))


def _combined(first: Sequence[I64], length: Sequence[I64]) -> tuple[I64, list[I64]]:
    """All combinations of ranges, line by line, the last one varying fastest.

    Line i combines first[m][i] … first[m][i] + length[m][i] − 1 of every m. Returns the start of each line, and for
    every m what is combined.
    """
    counts = np.prod(length, axis=0, dtype=np.int64)
    found = starts(counts)
    rest = np.arange(found[-1], dtype=np.int64) - np.repeat(found[:-1], counts)
    picks: list[I64] = []
    for begin, long in zip(reversed(first), reversed(length), strict=True):
        rest, digit = np.divmod(rest, np.repeat(long, counts))
        picks.append(np.repeat(begin, counts) + digit)
    return found, picks[::-1]


def _product_of(parts: Sequence[Rows], entries: Sequence[I64]) -> tuple[Integers, int]:
    """The products of these entries of rows, over the product of their denominators."""
    one = prod(rows.denominator for rows in parts)
    kind = np.int64 if one < LARGEST_SUM else object
    found = np.ones(len(entries[0]) if entries else 1, dtype=kind)
    for rows, entry in zip(parts, entries, strict=True):
        found = found * rows.numerator.astype(kind)[entry]
    return found, one


# ---------------------------------------------------------------------------------------------------------------- files


def composition_from_table(
    table: Mapping[str, Any], path: Path, load: Callable[[Path, bool], MDP], normalize: bool = False
) -> MDP:
    """The composition that a file describes. Raises ModelFaults listing all faults.

    `load` reads a member's file, whose path is relative to that of `path`.
    """
    faults = Faults()
    for key in table:
        if key not in _KEYS:
            faults.add(key, f"unknown key {key}; {near_misses(key, _KEYS)}")
    if not isinstance(table.get("name", ""), str):
        faults.add("name", f"name is {described(table['name'])}; write a text in quotes")
    normalize = normalize or table.get("normalize") is True
    given = member_files(table, faults)
    members = {}
    for prefix, (file, start, values) in given.items():
        try:
            members[prefix] = _placed(load(path.parent / file, normalize), start, values)
        except SizeError:
            raise
        except StlToolError as error:
            faults.add(("members", prefix), f"member {prefix}: {error}")
    labels = table.get("labels", {})
    if not isinstance(labels, Mapping):
        faults.add("labels", f'labels is {described(labels)}; write [labels] and below it meet = "r1.x == r2.x"')
    faults.refuse()
    model = faults.reading("members", _product, members, str(table.get("name", path.stem)))
    faults.refuse()
    assert model is not None
    for key, formula in labels.items():
        try:
            if not isinstance(formula, str):
                raise ModelError(f'label {key} is {described(formula)}; write a formula in quotes, "r1.x == r2.x"')
            model = _with_label(model, key, formula)
        except SizeError:
            raise
        except StlToolError as error:
            faults.add(("labels", key), str(error))
    faults.refuse()
    return model


def member_files(table: Mapping[str, Any], faults: Faults) -> dict[str, tuple[str, Any, Mapping[str, Any]]]:
    """For each member: its file, where it starts (None: as its file says), and values of parameters."""
    members = table.get("members")
    example = 'write [members] and below it r1 = "floor.toml"'
    if not isinstance(members, Mapping) or not members:
        faults.add("members", f"members is {described(members)}; {example}" if members else f"no members; {example}")
        return {}
    found = {}
    for prefix, given in members.items():
        place = ("members", prefix)
        whole = given if isinstance(given, Mapping) else {"model": given}
        for key in whole:
            if key not in _MEMBER_KEYS:
                faults.add((*place, key), f"member {prefix}: unknown key {key}; {near_misses(key, _MEMBER_KEYS)}")
        file, values = whole.get("model"), whole.get("parameters", {})
        if not isinstance(file, str) or not file or "\0" in file:
            remedy = f'write the path of its model, {prefix} = "floor.toml"'
            faults.add(place, f"member {prefix} is {described(given)}; {remedy}")
        elif not isinstance(values, Mapping):
            faults.add(place, f"parameters is {described(values)}; write parameters = {{ p = 0.9 }}")
        else:
            found[prefix] = (file, whole.get("start"), values)
    return found


def _placed(model: MDP, start: Any, values: Mapping[str, Any]) -> MDP:
    """A member with values for its parameters, and another start."""
    if values:
        model = model.at(**values)
    if start is None:
        return model
    if isinstance(start, list):
        return model.starting_in(_cell(model, start))
    if isinstance(start, bool) or not isinstance(start, str | int):
        raise ModelError(f"start is {described(start)}; write the name of a state, or its number")
    return model.starting_in(start)


def _cell(model: MDP, start: list[Any]) -> int:
    layout = model.layout
    if layout is None:
        raise ModelError(f"start is {start!r}, a cell, and {model.name} is no grid; write the name of a state")
    if len(start) != 2 or not all(type(n) is int for n in start):
        raise ModelError(f"start is {start!r}; write start = [column, row], counted from 0 at the bottom left")
    column, row = (n if 0 <= n < 2**31 else -1 for n in start)
    found = np.flatnonzero((layout.column == column) & (layout.row == row))
    if not found.size:
        raise ModelError(f"start = {start!r} is blocked or off the map of {layout.width} × {layout.height} cells")
    return int(found[0])
