"""Messages of the library in terms of the command line: arguments as options, functions as commands."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Named:
    """In an option's annotation: the argument of the library that it sets, if its name differs from the option's.

    `advice` replaces the library's advice on that argument ("use keep_policy=False, or ").
    """

    argument: str
    advice: str = ""


@dataclass(frozen=True)
class Spelled:
    """An option as written, whether it takes a value, and the advice that replaces the library's."""

    option: str
    flag: bool
    advice: str = ""


def spelling(options: Mapping[str, Spelled]) -> Callable[[str, str], str]:
    """A function that spells arguments in messages as a command's options; `options` by argument."""

    def spell(argument: str, text: str) -> str:
        if text.startswith("stl."):
            return f"stltool {argument}"
        name, equals, value = text.partition("=")
        known, plain = options.get(argument), name == argument
        if known is None:
            return text if plain else ""
        if not plain:
            return known.advice
        if known.flag or not equals:
            return known.option
        unquoted = value.strip("\"'")
        # quotes that a shell needs stay: a column's name may have spaces and brackets
        return f"{known.option} {unquoted}" if shlex.quote(unquoted) == unquoted else f'{known.option} "{unquoted}"'

    return spell
