"""A slow reader of programs of the PRISM language, as far as stltool writes them: what they mean, in fractions.

It also checks what PRISM's symbolic engines check, which look at all values of the variables, whether reached or not:
updates stay in the variables' ranges, and the probabilities of a command sum to 1.
"""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

Env = dict[str, Any]
Expression = Callable[[Env], Any]

TOKEN = re.compile(r'\s*(\d+\.?\d*(?:[eE][+-]?\d+)?|\w+|"[^"]*"|<=|>=|!=|->|\.\.|[^\s\w])')
LEVELS = [["|"], ["&"], ["=", "!=", "<=", ">=", "<", ">"], ["+", "-"], ["*", "/"]]
BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "|": lambda a, b: a or b, "&": lambda a, b: a and b, "=": lambda a, b: a == b, "!=": lambda a, b: a != b,
    "<=": lambda a, b: a <= b, ">=": lambda a, b: a >= b, "<": lambda a, b: a < b, ">": lambda a, b: a > b,
    "+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b, "/": lambda a, b: Fraction(a) / b,
}  # fmt: skip
STOP = 2**31  # the first integer that PRISM does not read


class Program:
    """kind "mdp" | "dtmc"; ranges (values) and first value of each variable; commands (action, guard, branches)."""

    def __init__(self, text: str) -> None:
        self.comments = [line[3:] for line in text.splitlines() if line.startswith("// ")]
        code = "\n".join(line.partition("//")[0] for line in text.splitlines())
        self.kind, _, code = code.strip().partition("\n")
        assert self.kind in ("mdp", "dtmc")
        before, body, after = re.fullmatch(r"(.*)module product\n(.*)endmodule\n(.*)", code, flags=re.DOTALL).groups()
        self.formulas: dict[str, Expression] = {}
        for statement in statements(before):
            name, expression = re.fullmatch(r"formula (\w+) = (.*)", statement, flags=re.DOTALL).groups()
            self.formulas[name] = read(expression, self.formulas)
        self.values: dict[str, list[Any]] = {}
        self.first: Env = {}
        self.commands: list[tuple[str, Expression, list[tuple[Fraction, Env]]]] = []
        for statement in statements(body):
            if found := re.fullmatch(r"(\w+) : \[(-?\d+)\.\.(-?\d+)\] init (-?\d+)", statement):
                name, low, high, first = found[1], *map(int, found.groups()[1:])
                assert low < high, "PRISM refuses a variable with one value"
                self.values[name], self.first[name] = list(range(low, high + 1)), first
            elif found := re.fullmatch(r"(\w+) : bool init (true|false)", statement):
                self.values[found[1]], self.first[found[1]] = [False, True], found[2] == "true"
            else:
                self.commands.append(self._command(statement))
        assert all(self.first[name] in values for name, values in self.values.items())
        self.labels = {}
        for statement in statements(after):
            name, expression = re.fullmatch(r'label "(\w+)" = (.*)', statement, flags=re.DOTALL).groups()
            self.labels[name] = read(expression, self.formulas)
        self._explored: tuple[list[Env], list[list[tuple[str, list[tuple[Fraction, int]]]]]] | None = None

    def _command(self, statement: str) -> tuple[str, Expression, list[tuple[Fraction, Env]]]:
        action, guard, updates = re.fullmatch(r"\[(\w*)\] (.*?) ->(.*)", statement, flags=re.DOTALL).groups()
        branches = []
        for branch in re.split(r"\+ (?=[\d.])|(?<=\))\s+\+ ", updates.strip()):
            share, colon, assignments = branch.rpartition(" : ")
            probability = read(share, {})({}) if colon else Fraction(1)
            new = {}
            for part in assignments.strip().split(" & ") if assignments.strip() != "true" else []:
                name, expression = re.fullmatch(r"\((\w+)'=(.*)\)", part.strip()).groups()
                new[name] = read(expression, self.formulas)
            branches.append((Fraction(probability), new))
        return action, read(guard, self.formulas), branches

    def require_total(self, most: int = 1000) -> int:
        """Check what PRISM's symbolic engines check, at `most` values of the variables; returns at how many."""
        every = range(math.prod(map(len, self.values.values())))
        for number in (drawn := random.Random(0).sample(every, min(most, len(every)))):
            state = {}
            for name, values in self.values.items():
                number, i = divmod(number, len(values))
                state[name] = values[i]
            for _, guard, branches in self.commands:
                if guard(state):
                    assert sum(share for share, _ in branches) == 1
                    for _, new in branches:
                        for name, expression in new.items():
                            assert expression(state) in self.values[name], (state, name)
        return len(drawn)

    def explored(self) -> tuple[list[Env], list[list[tuple[str, list[tuple[Fraction, int]]]]]]:
        """The reachable states and the choices of each."""
        if self._explored is not None:
            return self._explored
        states, number = [self.first], {tuple(self.first.values()): 0}
        choices = []
        for state in states:
            found = []
            for action, guard, branches in self.commands:
                if not guard(state):
                    continue
                row: dict[int, Fraction] = {}
                for share, new in branches:
                    after = {**state, **{name: expression(state) for name, expression in new.items()}}
                    key = tuple(after.values())
                    if key not in number:
                        number[key] = len(states)
                        states.append(after)
                    row[number[key]] = row.get(number[key], Fraction(0)) + share
                found.append((action, list(row.items())))
            assert found, "a deadlock"
            assert self.kind == "mdp" or len(found) == 1
            choices.append([(action, [(share, i) for i, share in row]) for action, row in found])
        self._explored = states, choices
        return self._explored

    def sizes(self) -> tuple[int, int, int]:
        """(states, choices, transitions)"""
        states, choices = self.explored()
        rows = [row for of_state in choices for _, row in of_state]
        return len(states), len(rows), sum(map(len, rows))

    def value(self, question: Any) -> Fraction:
        """The probability that a question of ours asks for."""
        side, bound, label = re.fullmatch(
            r'P(max|min|)=\? \[ F(?:<=(\d+))? (".*"|false) \]', question.property
        ).groups()
        states, choices = self.explored()
        best = {"max": max, "min": min, "": max}[side]
        goal = [Fraction(bool(label != "false" and self.labels[label.strip('"')](state))) for state in states]
        values, step = goal, 0
        while bound is None or step < int(bound):
            after = [
                goal[i] or best(sum((share * values[j] for share, j in row), Fraction(0)) for _, row in choices[i])
                for i in range(len(states))
            ]
            if after == values:
                break
            values, step = after, step + 1
        return 1 - values[0] if question.complement else values[0]


def statements(text: str) -> Iterator[str]:
    return (one.strip() for one in text.split(";") if one.strip())


def read(text: str, formulas: dict[str, Expression]) -> Expression:
    """An expression of the PRISM language."""
    tokens = TOKEN.findall(text)
    assert "".join(tokens) == re.sub(r"\s", "", text)

    def either() -> Expression:
        test = binary(0)
        if not tokens or tokens[0] != "?":
            return test
        tokens.pop(0)
        left = either()
        assert tokens.pop(0) == ":"
        right = either()
        return lambda env: left(env) if test(env) else right(env)

    def binary(level: int) -> Expression:
        if level == len(LEVELS):
            return unary()
        left = binary(level + 1)
        while tokens and tokens[0] in LEVELS[level]:
            left = joined(BINARY[tokens.pop(0)], left, binary(level + 1))
        return left

    def unary() -> Expression:
        token = tokens.pop(0)
        if token == "!":
            arg = unary()
            return lambda env: not arg(env)
        if token == "-":
            arg = unary()
            return lambda env: -arg(env)
        if token == "(":
            inner = either()
            assert tokens.pop(0) == ")"
            return inner
        if token in ("min", "max"):
            assert tokens.pop(0) == "("
            one = either()
            assert tokens.pop(0) == ","
            other = either()
            assert tokens.pop(0) == ")"
            pick = {"min": min, "max": max}[token]
            return lambda env: pick(one(env), other(env))
        if token[0].isdigit():
            value = Fraction(token)
            assert "." in token or "e" in token or value < STOP, f"PRISM does not read the integer {token}"
            return lambda env: value
        if token in ("true", "false"):
            return lambda env: token == "true"
        assert token.isidentifier()
        return formulas[token] if token in formulas else lambda env: env[token]

    found = either()
    assert not tokens, tokens
    return found


def joined(operator: Callable[[Any, Any], Any], left: Expression, right: Expression) -> Expression:
    return lambda env: operator(left(env), right(env))
