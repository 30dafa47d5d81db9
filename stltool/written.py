"""Policies as text, in the names of model and task: CSV for people and spreadsheets, JSON for programs.

    # format,stltool-policy-text-1
    # task,"F[0,4] (A & F[0,4] B)"
    # encoding,exact
    # model,floor
    # model digest,9f8e…
    from,to,state,remembered,action
    0,0,"(0,1)","A not seen for 1 step",N
    1,3,"(0,2)","A not seen for 1 step",E
    # elsewhere,situations that only other choices lead to
    2,2,"(1,1)",…

A rule says what to do in a state at some steps, given what is remembered of the run. Rules are listed for the undecided
situations that runs can come to: first those that runs under the policy come to, in the order of a run, then those that
only other choices lead to, so that any action may be changed by hand. If these are too many, the first kind alone.
Steps of one situation with the same action are one range, over steps in between at which no run can be there.

Whoever edits may leave cells empty: `from` and `to` mean the first and the last step, `remembered` whatever is
remembered. Lines that begin with # are facts about the whole, each of which may be left out: what is there must fit the
product. A policy that mixes actions has a column `weight`, and a line for each action of a situation. JSON has the same
names; weights are then {"N": 0.25, "E": 0.75}. What memory is called follows from the formula, and from `# define`.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from stltool.asked import Asked
from stltool.choices import Form, Rules, distinct
from stltool.display import distinct as apart
from stltool.errors import MOST_FAULTS, PolicyError, SizeError, StlToolError, all_told, near_misses
from stltool.logic.formula import Formula
from stltool.logic.printer import with_names
from stltool.models.names import StateLookup
from stltool.numbers import NumberError, exact
from stltool.product import JointProduct, Product
from stltool.reached import MOST_NODES, reachable, reached_by
from stltool.sizes import require_memory

I64: TypeAlias = NDArray[np.int64]

FORMAT = "stltool-policy-text-1"
_COLUMNS = ("from", "to", "state", "remembered", "action", "weight")
_NEEDED = ("state", "action")
_FACTS = ("format", "task", "encoding", "model", "model digest", "automaton digest")  # and `define NAME`
_ELSEWHERE = "situations that only other choices lead to"
_MOST_RULED = 4_000_000  # situations that a file may list
_MOST_NUMBER = 18  # digits of a step
_SUM = 1e-9  # by which weights may miss 1


@dataclass
class Written:
    """What a file says, before names are looked up. `facts` by name, with all their values; `define` name → formula."""

    facts: dict[str, list[str]] = field(default_factory=dict)
    define: dict[str, str] = field(default_factory=dict)
    rules: list[Line] = field(default_factory=list)
    weighted: bool = False

    def fact(self, name: str) -> str | None:
        values = self.facts.get(name)
        return values[0] if values else None


@dataclass
class Line:
    """A rule as it is written, and where: "p.csv, line 7"."""

    place: str
    first: str
    last: str
    state: str
    remembered: str
    weights: dict[str, str]


def _line(place: str, key: Sequence[str], weights: dict[str, str]) -> Line:
    first, last, state, remembered = key
    return Line(place, first, last, state, remembered, weights)


# ------------------------------------------------------------------------------------------------------------ writing


def rules_of(product: Product | JointProduct, form: Form) -> tuple[Rules, NDArray[np.bool_]]:
    """The rules that make up a policy, and whether runs under it come to each; SizeError if there are too many."""
    blackbox, asked = product.model.blackbox is not None, isinstance(form, Asked)
    if blackbox and asked:
        raise PolicyError(
            "a policy function that acts in a black box, whose reach is not known, cannot be written as text; use the "
            "function"
        )
    own = None if blackbox else reached_by(product, form, _MOST_RULED, 2**60)
    nodes = None if asked else reachable(product, _MOST_RULED if blackbox else MOST_NODES)
    if own is None and (nodes is None or not blackbox):
        raise SizeError(
            f"the policy acts in more than {_MOST_RULED} situations, too many for text; save it as .npz or .policy"
        )
    nodes = nodes if nodes is not None else own
    assert nodes is not None
    timeless = form.stationary and isinstance(product, Product)
    code = np.concatenate([np.empty(0, dtype=np.int64), *nodes])
    step = np.repeat(np.arange(len(nodes)), [len(codes) for codes in nodes])
    mine = np.ones(len(code), dtype=np.bool_)
    if own is not None:
        mine = np.concatenate([np.empty(0, np.bool_), *map(np.isin, nodes, own)])
    parts = [form.at(t, *np.divmod(codes, product.automaton.n_states)) for t, codes in enumerate(nodes) if len(codes)]
    if form.deterministic:
        number: I64 = np.concatenate([np.empty(0, dtype=np.int64), *parts])
        rows = np.empty((0, 0))
    else:
        rows, number = distinct(np.concatenate([np.empty((0, product.model.most_choices)), *parts]))
        if len(rows):
            acts = np.atleast_1d(rows.any(axis=1))
            number = np.where(acts[number], number, -1)
    step = np.zeros_like(step) if timeless else step
    order = np.lexsort((step, code))
    code, step, number, mine = code[order], step[order], number[order], mine[order]
    new = np.ones(len(code), dtype=np.bool_)
    new[1:] = (code[1:] != code[:-1]) | (number[1:] != number[:-1])
    begin = np.flatnonzero(new)
    if not len(begin):
        values: NDArray[Any] = number if form.deterministic else rows
        return _ordered(product, code, step, step, values, timeless), mine
    end = np.append(begin[1:], len(code)) - 1
    ours = np.logical_or.reduceat(mine, begin)
    acts = number[begin] >= 0
    begin, end, ours = begin[acts], end[acts], ours[acts]
    values = number[begin] if form.deterministic else rows[number[begin]]
    found = _ordered(product, code[begin], step[begin], step[end], values, timeless)
    return found, ours


def _ordered(
    product: Product | JointProduct, code: I64, first: I64, last: I64, values: NDArray[Any], timeless: bool
) -> Rules:
    kind = product.model.choice_type
    return Rules(product.shape, product.horizon, code, first, last, values, timeless, kind)


def memory_names(product: Product | JointProduct, define: Mapping[str, Formula]) -> tuple[Sequence[str], bool]:
    """What each automaton state is called in words (Q,), and whether words alone tell them apart."""
    automaton, text = product.automaton, with_names(define)
    if isinstance(product, JointProduct):
        words = [automaton.describe(q) for q in range(automaton.n_states)]
    else:
        memory = product.automaton.memory
        words = ["; ".join(one.phrase for one in memory(q, text)) for q in range(automaton.n_states)]
    words = [" ".join(each.split()) or "nothing" for each in words]
    names = apart(words)
    return names, list(names) == words


def as_text(product: Product | JointProduct, form: Form, facts: Mapping[str, Sequence[str]], kind: str) -> str:
    """A policy as the text of a file of this kind, "csv" or "json"; `facts` as in `Written`."""
    rules, ours = rules_of(product, form)
    define = _definitions(product)
    memory, told = memory_names(product, define)
    facts = dict(facts)
    if told:
        facts.pop("automaton digest", None)  # words are enough to tell what is remembered
    lines = list(_lines(product, rules, ours, memory))
    texts = {name: str(phi) for name, phi in define.items()}
    return (_csv if kind == "csv" else _json)(facts, texts, lines, rules.deterministic, rules.stationary)


def _definitions(product: Product | JointProduct) -> Mapping[str, Formula]:
    return {} if isinstance(product, JointProduct) else product.definitions


_Listed: TypeAlias = tuple[bool, int, int, str, str, list[tuple[str, float]]]


def _lines(
    product: Product | JointProduct, rules: Rules, ours: NDArray[np.bool_], memory: Sequence[str]
) -> Iterator[_Listed]:
    """Of each rule: whether runs under the policy come there, first and last step, state, memory, weights of actions.

    In the order of a run, those of the policy first.
    """
    model, n_memories = product.model, product.automaton.n_states
    for i in np.lexsort((rules.code, rules.first, ~ours)).tolist():
        s, q = divmod(int(rules.code[i]), n_memories)
        start = int(model.choice_start[s])
        if rules.deterministic:
            chosen = [(int(rules.values[i]), 1.0)]
        else:
            chosen = [(c, weight) for c, weight in enumerate(rules.values[i].tolist()) if weight > 0]
        actions = [(model.action_names[model.choice_action[start + c]], weight) for c, weight in chosen]
        yield bool(ours[i]), int(rules.first[i]), int(rules.last[i]), model.state_name(s), memory[q], actions


def _csv(
    facts: Mapping[str, Sequence[str]], define: Mapping[str, str], lines: list[_Listed], sure: bool, timeless: bool
) -> str:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["# format", FORMAT])
    for name, values in facts.items():
        writer.writerows([f"# {name}", value] for value in values)
    writer.writerows([f"# define {name}", phi] for name, phi in define.items())
    writer.writerow(_COLUMNS[: 5 if sure else 6])
    own = True
    for ours, first, last, state, memory, actions in lines:
        if own and not ours:
            own = False
            writer.writerow(["# elsewhere", _ELSEWHERE])
        steps = ("", "") if timeless else (first, last)
        writer.writerows(
            [*steps, state, memory, action, *(() if sure else (repr(weight),))] for action, weight in actions
        )
    return text.getvalue()


def _json(
    facts: Mapping[str, Sequence[str]], define: Mapping[str, str], lines: list[_Listed], sure: bool, timeless: bool
) -> str:
    def dumped(value: object) -> str:
        return json.dumps(value, ensure_ascii=False)

    def rule(line: _Listed) -> str:
        _, first, last, state, memory, actions = line
        steps = {} if timeless else {"from": first, "to": last}
        action = actions[0][0] if sure else dict(actions)
        return "  " + dumped({**steps, "state": state, "remembered": memory, "action": action})

    head: dict[str, Any] = {"format": FORMAT}
    head |= {name: list(values) if name == "task" and len(values) > 1 else values[0] for name, values in facts.items()}
    head["define"] = dict(define)
    parts = [f"{dumped(name)}: {dumped(value)}" for name, value in head.items()]
    for name, ours in (("rules", True), ("elsewhere", False)):
        listed = ",\n".join(rule(line) for line in lines if line[0] is ours)
        parts.append(f'"{name}": [\n{listed}\n]' if listed else f'"{name}": []')
    return "{" + ",\n".join(parts) + "}\n"


# ------------------------------------------------------------------------------------------------------------ reading


def is_rules(text: str) -> bool:
    """Whether CSV lists rules of this format; else it is a Q-table."""
    first = text.lstrip().removeprefix('"')
    if first.startswith("#"):
        return True
    header = {cell.strip().strip('"').lower() for cell in re.split(r"[,;\t]", text.lstrip().partition("\n")[0])}
    return header.issuperset(_NEEDED) and header.issubset(_COLUMNS)


def read(path: object, text: str, kind: str) -> Written:
    """What a file of this kind says. PolicyError, with lines, for what is not such a file."""
    return _read_csv(path, text) if kind == "csv" else _read_json(path, text)


def _read_csv(path: object, text: str) -> Written:
    header_line = next((line for line in text.splitlines() if line.strip() and not re.match(r'\s*"?#', line)), "")
    separator = max(",;\t", key=header_line.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    found, columns = Written(), list[str]()
    faults = _Faults()
    mixtures: dict[tuple[str, ...], Line] = {}
    try:
        for row in reader:
            place = f"{path}, line {reader.line_num}"
            if not any(cell.strip() for cell in row):
                continue
            if row[0].lstrip().startswith("#"):
                faults.add(_fact(place, row, found))
            elif not columns:
                columns = [cell.strip().lower() for cell in row]
                while columns and not columns[-1]:
                    columns.pop()
                if fault := _columns_fault(columns):
                    raise PolicyError(f"{place}: {fault}")
                found.weighted = "weight" in columns
            else:
                faults.add(_row(place, row, columns, found, mixtures))
    except csv.Error as error:
        raise PolicyError(f"{path}, line {reader.line_num}: not a policy in CSV: {error}") from None
    faults.refuse()
    if not columns:
        raise PolicyError(
            f"{path}: a policy without rules; write the columns {','.join(_COLUMNS[:5])}, then a rule a line"
        )
    return found


def _columns_fault(columns: Sequence[str]) -> str | None:
    for name in columns:
        if name not in _COLUMNS:
            return f"there is no column {name!r}; {near_misses(name, _COLUMNS)}"
        if columns.count(name) > 1:
            return f"two columns are called {name}; keep one"
    missing = [name for name in _NEEDED if name not in columns]
    return f"there is no column {missing[0]}; the columns are {', '.join(_COLUMNS)}" if missing else None


def _fact(place: str, row: Sequence[str], found: Written) -> str | None:
    name, value = row[0].lstrip()[1:].strip(), row[1].strip() if len(row) > 1 else ""
    return _take_fact(place, name, value, found) if value else None  # a remark


def _take_fact(place: str, name: str, value: str, found: Written) -> str | None:
    if name == "elsewhere":
        return None
    if name.startswith("define "):
        found.define[name.removeprefix("define ").strip()] = value
    elif name == "format":
        if value != FORMAT:
            return f"{place}: a policy of the format {value}, which this version cannot read; it reads {FORMAT}"
    elif name in _FACTS:
        if name in found.facts and name != "task":
            return f"{place}: the {name} is given twice; keep one"
        found.facts.setdefault(name, []).append(value)
    else:
        return f"{place}: there is no fact {name!r}; {near_misses(name, _FACTS)}"
    return None


def _row(
    place: str, row: Sequence[str], columns: Sequence[str], found: Written, mixtures: dict[tuple[str, ...], Line]
) -> str | None:
    if any(cell.strip() for cell in row[len(columns) :]) or len(row) < len(columns):
        return f"{place}: {len(row)} cells for {len(columns)} columns; put quotation marks around names with commas"
    cell = dict(zip(columns, row, strict=False))
    key = tuple(cell.get(name, "") for name in _COLUMNS[:4])
    weight = cell.get("weight", "1")
    line = mixtures.get(key) if found.weighted else None
    if line is None:
        line = _line(place, key, {})
        mixtures[key] = line
        found.rules.append(line)
    if cell["action"] in line.weights:
        return f"{place}: the action {cell['action']} has a weight there already ({line.place}); keep one"
    line.weights[cell["action"]] = weight
    return None


def _read_json(path: object, text: str) -> Written:
    try:
        data = json.loads(text, object_pairs_hook=_once)
    except json.JSONDecodeError as error:
        raise PolicyError(f"{path}, line {error.lineno}: not a policy in JSON: {error.msg}") from None
    except (ValueError, RecursionError) as error:
        raise PolicyError(f"{path}: not a policy in JSON: {error}") from None
    if not isinstance(data, dict) or not isinstance(data.get("rules"), list):
        raise PolicyError(f'{path}: not a policy: it has no list "rules"')
    found = Written()
    faults = _Faults()
    for name, value in data.items():
        if name == "define" and isinstance(value, dict) and all(isinstance(phi, str) for phi in value.values()):
            found.define = dict(value)
        elif name in ("rules", "elsewhere"):
            if not isinstance(value, list):
                faults.add(f"{path}: {name} is not a list; write a list of rules")
        elif isinstance(value, str) and name in _FACTS:
            faults.add(_take_fact(str(path), name, value, found))
        elif name == "task" and isinstance(value, list) and all(isinstance(phi, str) for phi in value):
            found.facts["task"] = value
        else:
            known = [*_FACTS, "define", "rules", "elsewhere"]
            hint = "write text" if name in known else near_misses(name, known)
            faults.add(f"{path}: there is no fact {name!r} with such a value; {hint}")
    where = _Lines(path, text)
    for part in ("rules", "elsewhere"):
        given = data.get(part, [])
        for number, rule in enumerate(given if isinstance(given, list) else []):
            line = _rule(rule)
            if isinstance(line, str):
                faults.add(f"{where(part, number)}: {line}")
                continue
            line.place = f"{part}\0{number}"
            found.rules.append(line)
            found.weighted |= isinstance(rule["action"], dict)
    faults.refuse()
    return _Located(found.facts, found.define, found.rules, found.weighted, where)


@dataclass
class _Located(Written):
    """Of JSON: the line of a rule is searched for when it is needed."""

    where: _Lines | None = None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{twice!r} is given twice in one place")
    return found


def _rule(rule: object) -> Line | str:
    """A rule of JSON, or what is wrong with it."""
    if not isinstance(rule, dict):
        return 'not a rule; write {"state": …, "action": …}'
    for name in rule:
        if name not in _COLUMNS[:5]:
            return f"a rule has no {name!r}; {near_misses(name, _COLUMNS[:5])}"
    for name in _NEEDED:
        if name not in rule:
            return f"a rule without {name}; write one"
    texts = []
    for name in _COLUMNS[:4]:
        value = rule.get(name, "")
        if value is None:
            value = ""
        wanted = str if name == "remembered" else (str, int)
        if not isinstance(value, wanted) or isinstance(value, bool):
            return f"{name} is {json.dumps(value)[:60]}; write {'a step' if name in ('from', 'to') else 'its name'}"
        try:
            texts.append(str(value))
        except ValueError:  # an integer of thousands of digits
            return f"{name} is out of range"
    action = rule["action"]
    if isinstance(action, str):
        return _line("", texts, {action: "1"})
    if not isinstance(action, dict) or not action:
        return 'the action is not text; write a name, or weights {"N": 0.5, "E": 0.5}'
    weights = {}
    for name, weight in action.items():
        if isinstance(weight, bool) or not isinstance(weight, int | float | str):
            return f"the weight of {name} is not a number"
        try:
            weights[name] = repr(weight) if isinstance(weight, float) else str(weight)
        except ValueError:
            return f"the weight of {name} is out of range"
    return _line("", texts, weights)


class _Lines:
    """Where the rules of JSON begin: "p.json, line 7"."""

    def __init__(self, path: object, text: str) -> None:
        self._path, self._text = path, text

    def __call__(self, part: str, number: int) -> str:
        decoder, text = json.JSONDecoder(), self._text
        start = re.search(rf'(?<!\\)"{part}"\s*:\s*\[', text)
        if start is not None:
            position = start.end()
            try:
                for i in range(number + 1):
                    position = cast("re.Match[str]", re.compile(r"[\s,]*").match(text, position)).end()
                    if i == number:
                        return f"{self._path}, line {text.count(chr(10), 0, position) + 1}"
                    _, position = decoder.raw_decode(text, position)
            except (ValueError, RecursionError):
                pass
        return f"{self._path}, {part} {number + 1}"


class _Faults:
    """The faults of a file, told together."""

    def __init__(self) -> None:
        self._told: list[str] = []
        self._count = 0

    @property
    def many(self) -> bool:
        return len(self._told) >= MOST_FAULTS

    def add(self, fault: str | None) -> None:
        if fault is not None:
            self._count += 1
            if not self.many:
                self._told.append(fault)

    def refuse(self) -> None:
        if self._told:
            raise PolicyError(all_told(self._told, self._count))


def form_of(
    path: object, product: Product | JointProduct, written: Written, definitions: Mapping[str, Formula]
) -> Rules:
    """The rules of a file, over the product that its memory belongs to. PolicyError, with lines, for its faults.

    A file without definitions of its own may use these, those of the task, or none.
    """
    memory: dict[str, int] = {}
    for define in (_defined(path, written.define, definitions),) if written.define else (definitions, {}):
        for q, name in enumerate(memory_names(product, define)[0]):
            memory.setdefault(name, q)
    found = _Found(product, memory, written)
    faults = _Faults()
    for line in written.rules:
        fault = found.add(line)
        if fault is not None:
            faults.add(f"{found.place(line)}: {fault}")
    faults.refuse()
    rules, clash = found.rules()
    if clash is not None:
        raise PolicyError(clash)
    return rules


def _defined(path: object, define: Mapping[str, str], own: Mapping[str, Formula]) -> Mapping[str, Formula]:
    """The definitions by which a file calls what is remembered."""
    if define == {name: str(phi) for name, phi in own.items()}:
        return own
    from stltool.logic.parser import parse  # lark is slow to load

    found = {}
    for name, text in define.items():
        try:
            found[name] = parse(text, unbounded=True)
        except StlToolError as error:
            raise PolicyError(f"{path}: the definition {name}: {error}") from None
    return found


class _Found:
    """The rules found so far, as indices."""

    def __init__(self, product: Product | JointProduct, memory: Mapping[str, int], written: Written) -> None:
        self.product, self.written = product, written
        self.states, self.memory = StateLookup(product.model), memory
        self.known: dict[str, int] = {}
        self.code: list[I64] = []
        self.steps: list[tuple[int, int]] = []
        self.values: list[Any] = []
        self.line: list[Line] = []
        self.timeless = isinstance(product, Product)

    def place(self, line: Line) -> str:
        if isinstance(self.written, _Located) and self.written.where is not None:
            part, _, number = line.place.partition("\0")
            return self.written.where(part, int(number))
        return line.place

    def add(self, line: Line) -> str | None:
        """What is wrong with a rule."""
        product = self.product
        s = self.known.get(line.state)
        if s is None:
            found = self.states.find(line.state)
            if found is None:
                return f"there is no state {line.state!r}; {self.states.hint(line.state)}"
            s = self.known[line.state] = found
        words = " ".join(line.remembered.split())
        if words and words not in self.memory:
            return f"nothing is remembered as {words!r}; {near_misses(words, self.memory)}"
        steps = self._steps(line)
        if isinstance(steps, str):
            return steps
        value = self._value(s, line.weights)
        if isinstance(value, str):
            return value
        n_memories = product.automaton.n_states
        q = [self.memory[words]] if words else range(n_memories)
        if not words:
            n = len(self.code) * n_memories
            require_memory(32 * n, "rules that hold whatever is remembered", "name what is remembered")
        self.code.append(s * n_memories + np.array(q, dtype=np.int64))
        self.timeless &= not line.first.strip() and not line.last.strip()
        self.steps.append(steps)
        self.values.append(value)
        self.line.append(line)
        return None

    def _steps(self, line: Line) -> tuple[int, int] | str:
        h = self.product.horizon
        found = []
        for name, text, default in (("from", line.first.strip(), 0), ("to", line.last.strip(), max(h - 1, 0))):
            if text and not (text.isascii() and text.isdecimal() and len(text) <= _MOST_NUMBER):
                return f"{name} is {text[:60]!r}; give a step, from 0 to {h - 1}"
            found.append(int(text) if text else default)
        first, last = found
        if not first <= last < max(h, 1):
            return f"steps {first} to {last}; give steps from 0 to {h - 1}, in ascending order"
        return first, last

    def _value(self, s: int, weights: Mapping[str, str]) -> Any:
        """The choice or the weights of a rule; text for a fault."""
        model = self.product.model
        start, end = int(model.choice_start[s]), int(model.choice_start[s + 1])
        names = [model.action_names[a] for a in model.choice_action[start:end]]
        row = np.zeros(model.most_choices)
        for action, text in weights.items():
            known = action if action in names else action.strip()
            if known not in names:
                fault = "is not available in" if known in model.action_names else "is not an action of"
                there = f"state {model.state_name(s)}" if known in model.action_names else "the model"
                return f"{known!r} {fault} {there}; {near_misses(known, names)}"
            if not self.written.weighted:
                return names.index(known)
            try:
                weight = float(exact(text.strip()))
            except (NumberError, OverflowError) as error:
                return f"the weight of {known}: {error}"
            if not 0 <= weight <= 1:
                return f"the weight of {known} is {text.strip()[:60]}; give a number from 0 to 1"
            row[names.index(known)] = weight
        if abs(row.sum() - 1) > _SUM:
            return f"the weights sum to {row.sum():g}; they must sum to 1"
        return row

    def rules(self) -> tuple[Rules, str | None]:
        """All of them, or two of one situation."""
        product = self.product
        count = np.array([len(codes) for codes in self.code], dtype=np.int64)
        number = np.repeat(np.arange(len(count)), count)
        code = np.concatenate([np.empty(0, dtype=np.int64), *self.code])
        steps = np.array(self.steps, dtype=np.int64).reshape(-1, 2)[number]
        timeless = self.timeless and bool(len(code))
        steps = np.zeros_like(steps) if timeless else steps
        width = (product.model.most_choices,) if self.written.weighted else ()
        kind = np.float64 if self.written.weighted else np.int64
        values = np.array(self.values, dtype=kind).reshape(len(count), *width)[number]
        order = np.lexsort((steps[:, 0], code))
        again = np.flatnonzero((code[order][1:] == code[order][:-1]) & (steps[order][1:, 0] <= steps[order][:-1, 1]))
        clash = None
        if len(again):
            one, other = sorted(number[order[again[0] : again[0] + 2]].tolist())
            s, q = divmod(int(code[order[again[0]]]), product.automaton.n_states)
            t = None if timeless else int(steps[order[again[0] + 1], 0])
            clash = (
                f"{self.place(self.line[other])}: this rule and that of {self.place(self.line[one])} are both for "
                f"{product.describe(s * product.automaton.n_states + q, t)}; keep one of them there"
            )
        return _ordered(product, code, steps[:, 0], steps[:, 1], values, timeless), clash
