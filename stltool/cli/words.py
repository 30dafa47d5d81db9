"""Messages of the library in the command line's words: arguments as options, functions as commands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Named:
    """In an option's annotation: which argument of the library it gives, where that has another name than the option's.

    `advice` stands for what the library advises on that argument ("use keep_policy=False, or ").
    """

    argument: str
    advice: str = ""


@dataclass(frozen=True)
class Spelled:
    """An option as it is written, whether it takes a value, and what is advised instead of the library's advice."""

    option: str
    flag: bool
    advice: str = ""


def spelling(options: Mapping[str, Spelled]) -> Callable[[str, str], str]:
    """How a command spells what a message names; `options` by argument."""

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
        unquoted = value.strip('"')
        return f"{known.option} {unquoted}"

    return spell
