"""A policy as one file of plain Python: the tables inside, the standard library only, at most 200 lines.

It holds what a `Runner` needs: the letter of each state, the automaton with its verdicts, and the rules of
stltool/written.py, so that it acts as the policy does in every situation that runs can come to. Numbers of memories are
those of the automaton. Tables are wrapped as text while the lines allow that; larger ones have longer lines.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

import stltool
from stltool.checking.check import check
from stltool.errors import SizeError
from stltool.files import MARK
from stltool.numbers import bound_texts, probability_text
from stltool.policy import Policy, require_door
from stltool.product import Product, with_early_verdicts
from stltool.written import memory_names, rules_of

MOST_LINES = 200
_WIDTH = 116
_MOST_MOVES = 2_000_000  # of the automaton
_SHARES = {"STATES": 14, "REMEMBERED": 14, "NEXT": 8, "VERDICTS": 4, "RULES": 30}  # lines of each table

_PROGRAM = '''\
"""{title}

{facts}

    from policy import Policy        # if this file is called policy.py

    policy = Policy()
    while policy.verdict is None:
        action = policy.act(state)   # the name of the state that was just entered, from step 0 on

`act` returns the name of an action, and None once the task is decided: `verdict` is then True or False. `reset` begins
another run; `step`, `state` and `remembered` say where this one is. From a shell, with the name of a state on each line
and the answers as they come: python -I policy.py < states.txt

{mark}
"""

import bisect
import difflib
import random
import sys

HORIZON = {horizon}  # steps until every run is decided
START = {start}  # what is remembered before the first state

# what the task reads in each state
{STATES}

# what is remembered, in words
{REMEMBERED}

# NEXT[what the task reads][what is remembered]: what is remembered next
{NEXT}

# from each step on, the verdict for what is remembered: t true, f false, - not decided yet
{VERDICTS}

# state: {{remembered: [(first step, last step, action or weights of actions), ...]}}
{RULES}


class Policy:
    """What to do, one state after another. `seed` is for policies that mix actions."""

    def __init__(self, seed=None):
        self._random = random.Random(seed)
        self.reset()

    def reset(self):
        """Begin another run."""
        self.step, self.state, self.memory, self.verdict = None, None, START, None

    def act(self, state):
        """What to do in this state, the next of the run; None once the task is decided.

        Raises ValueError for a state that there is not, LookupError where the policy defines no action; the run is then
        as it was before.
        """
        if self.verdict is not None:
            return None
        state = str(state)
        if state not in STATES:
            near = difflib.get_close_matches(state, list(STATES)[:5000])
            hint = "; did you mean %s?" % " or ".join(near) if near else ""
            raise ValueError("there is no state %r%s" % (state, hint))
        step = 0 if self.step is None else self.step + 1
        memory = NEXT[STATES[state]][self.memory]
        verdict = self.verdict_of(step, memory)
        action = None if verdict is not None else self.choose(step, state, memory)
        self.step, self.state, self.memory, self.verdict = step, state, memory, verdict
        if isinstance(action, dict):
            return self._random.choices(list(action), list(action.values()))[0]
        return action

    @property
    def remembered(self):
        """What is remembered of the run, in words."""
        return "" if self.step is None else REMEMBERED[self.memory]

    @staticmethod
    def verdict_of(step, memory):
        """Whether the task holds, by what is remembered after that step; None if that is open."""
        row = VERDICTS[bisect.bisect_right([since for since, _ in VERDICTS], step) - 1][1]
        return {{"t": True, "f": False, "-": None}}[row[memory]]

    @staticmethod
    def choose(step, state, memory):
        """The action in a situation, or the weights of several."""
        for first, last, action in RULES.get(state, {{}}).get(memory, ()):
            if first <= step <= last:
                return action
        raise LookupError("no action at step %d in state %s, with %s" % (step, state, REMEMBERED[memory]))


def main():
    policy = Policy()
    for line in sys.stdin:
        try:
            action = policy.act(line.rstrip("\\r\\n"))
        except (ValueError, LookupError) as error:
            print("error: %s" % error, file=sys.stderr)
            return 2
        if action is None:
            break
        print(action, flush=True)
    print({{True: "satisfied", False: "violated", None: "undecided"}}[policy.verdict])
    return 0


if __name__ == "__main__":
    sys.exit(main())
'''


def to_python(product: Product, policy: Policy) -> str:
    """The text of a Python file that acts as the policy does.

    Raises PolicyError if the policy belongs to another task or model, SizeError if its tables are too large for a
    program.
    """
    require_door("to_python", product, policy)
    facts = _facts(product, policy)
    product, policy = policy.on(product)
    product = with_early_verdicts(product)
    automaton, model = product.automaton, product.model
    if automaton.n_letters * automaton.n_states > _MOST_MOVES:
        raise SizeError(
            f"the automaton has {automaton.n_states} states over {automaton.n_letters} letters, too many for a "
            "program; save the policy as .json, and use stl.Runner"
        )
    letters = product.letter.tolist()
    names = [model.state_name(s) for s in range(model.n_states)]
    memories = memory_names(product, product.definitions)[0]
    rows = zip(automaton.verdict_starts.tolist(), automaton.verdict_rows, strict=True)
    tables = {
        "STATES": ("{", [f"{name!r}: {letter}," for name, letter in zip(names, letters, strict=True)], "}"),
        "REMEMBERED": ("[", [f"{words!r}," for words in memories], "]"),
        "NEXT": ("[", [f"{row}," for row in automaton.delta.tolist()], "]"),
        "VERDICTS": ("[", [f"({t}, {''.join('-ft'[v + 1] for v in row.tolist())!r})," for t, row in rows], "]"),
        "RULES": ("{", _rules(product, policy), "}"),
    }
    shown = {name: _table(name, *table) for name, table in tables.items()}
    title = _plain(f"{product.task_name} on {model.name}, as a policy for robots.")
    return _PROGRAM.format(
        title=title, facts=facts, mark=f"{MARK} {stltool.__version__}", horizon=automaton.horizon,
        start=automaton.initial, **shown,
    )  # fmt: skip


def _facts(product: Product, policy: Policy) -> str:
    model = product.model
    facts = {
        "task": f"{product.task_name} := {product.formula}",
        "model": f"{model.name} ({model.nominal().digest()[:12]}), {model.n_states} states",
        "policy": policy.kind,
        "P": "not known: the model's probabilities are not",
    }
    if model.blackbox is None and not model.uncertain and not model.parameters:
        found = check(product, policy)
        lower, upper = bound_texts(found.lower, found.upper)
        facts["P"] = f"{probability_text(found.probability)} that a run satisfies the task, within [{lower}, {upper}]"
    lines = []
    for name, value in facts.items():
        lines += textwrap.wrap(
            f"{name:8}{_plain(value)}",
            _WIDTH,
            subsequent_indent=" " * 8,
            break_long_words=False,
            break_on_hyphens=False,
        )[:4]
    return "\n".join(lines)


def _plain(text: str) -> str:
    """As part of a docstring, on one line."""
    return " ".join(text.split()).replace("\\", "\\\\").replace('"', '\\"')


def _rules(product: Product, policy: Policy) -> list[str]:
    """An entry for each state that has rules."""
    rules, _ = rules_of(product, policy.form)
    model, last = product.model, max(product.horizon - 1, 0)
    by_state: dict[int, dict[int, list[tuple[int, int, Any]]]] = {}
    for i, code in enumerate(rules.code.tolist()):
        s, q = divmod(code, product.automaton.n_states)
        start = int(model.choice_start[s])
        action: Any
        if rules.deterministic:
            action = model.action_names[model.choice_action[start + int(rules.values[i])]]
        else:
            weights = rules.values[i]
            action = {
                model.action_names[model.choice_action[start + c]]: float(weights[c])
                for c in np.flatnonzero(weights).tolist()
            }
        steps = (0, last) if rules.stationary else (int(rules.first[i]), int(rules.last[i]))
        by_state.setdefault(s, {}).setdefault(q, []).append((*steps, action))
    return [f"{model.state_name(s)!r}: {found}," for s, found in by_state.items()]


def _table(name: str, begin: str, entries: Sequence[str], end: str) -> str:
    """A literal: its entries on as many lines as the table has, wider where they need to be."""
    width, rows = _WIDTH, [" ".join(entries)]
    if name == "RULES" and len(entries) <= _SHARES[name]:
        rows = list(entries)  # a line a state
    else:
        while len(rows := _wrapped(entries, width)) > _SHARES[name]:
            width *= 2
    return f"{name} = {begin}\n" + "".join(f"    {row}\n" for row in rows if row) + end


def _wrapped(entries: Sequence[str], width: int) -> list[str]:
    rows: list[str] = []
    for entry in entries:
        if rows and len(rows[-1]) + 1 + len(entry) <= width:
            rows[-1] += f" {entry}"
        else:
            rows.append(entry)
    return rows
