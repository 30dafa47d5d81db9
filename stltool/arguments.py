"""Checks of the arguments of public functions: one sentence states what was given, what is needed, and what to write.

    require(product, Product, "check's product")
    ArgumentError: check's product is an MDP, not a Product; build one: stl.build_product(model, task)

Classes are identified by name, so that this file imports none of them; common mix-ups are listed in a table.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence, Set
from decimal import Decimal
from fractions import Fraction
from numbers import Integral, Real
from os import PathLike
from pathlib import Path, PurePath
from typing import Any, cast

from stltool.errors import ArgumentError, FileError, SettingsError, named

LARGEST = 2**63 - 1
_LONGEST = 40  # characters of a value in a message
_LONGEST_NAME, _LONGEST_PATH = 255, 4095  # bytes, of the usual file systems

_WORDS = {"str": "text", "Iterable": "a list", "Mapping": "a mapping"}

# how to obtain an object of this kind
_MAKE = {
    "Formula": "write one: stl.parse('F[0,5] A')",
    "Task": "read one: stl.load_task(path), or stl.parse_task(text)",
    "MDP": "load one: stl.load_model(path), or make one: stl.MDP.from_arrays(...)",
    "Product": "build one: stl.build_product(model, task)",
    "JointProduct": "build one: stl.build_joint_product(model, tasks)",
    "Policy": "take that of stl.check(product) or stl.learn(product), or load one: stl.load_policy(path, product)",
    "CheckResult": "make one: stl.check(product)",
    "Training": "make one: stl.learn(product)",
    "Counts": "take those of a training: training.counts",
    "Sweep": "read one: stl.load_sweep(path)",
    "str": "write it in quotes",
    "Mapping": "write one: {name: values}",
}

# (needed, given) → the probable intention
_MEANT = {
    ("Formula", "str"): "parse it: stl.parse(text)",
    ("Formula", "Path"): "load it: stl.load_task(path)",
    ("Formula", "Product"): "take the product's: product.formula",
    ("Formula", "TaskAutomaton"): "take the automaton's: automaton.formula",
    ("Formula", "Expression"): "compare it: stl.signal('x') > 0.5",
    ("Formula", "MDP"): "give the task; if both are needed, the model comes first",
    ("Task", "str"): "read it: stl.load_task(path), or stl.parse_task(text)",
    ("Task", "Path"): "read it: stl.load_task(path)",
    ("MDP", "str"): "load it: stl.load_model(path)",
    ("MDP", "Path"): "load it: stl.load_model(path)",
    ("MDP", "Formula"): "the model comes first, then the task",
    ("MDP", "Task"): "the model comes first, then the task",
    ("MDP", "Product"): "take the product's: product.model",
    ("MDP", "JointProduct"): "take the product's: joint.model",
    ("Product", "JointProduct"): "take that of one task: joint.tasks[0]",
    ("Product", "Policy"): "the product comes first, then the policy",
    ("Product", "CheckResult"): "take the result's: result.product",
    ("Product", "TaskAutomaton"): "build one with a model: stl.build_product(model, task)",
    ("JointProduct", "Product"): "build one of all tasks: stl.build_joint_product(model, tasks)",
    ("Policy", "str"): "load it: stl.load_policy(path, product)",
    ("Policy", "Path"): "load it: stl.load_policy(path, product)",
    ("Policy", "Training"): "take the training's: training.policy",
    ("Policy", "CheckResult"): "take the result's: result.policy",
    ("Policy", "array"): "make one of the table: stl.Policy(product, table)",
    ("CheckResult", "Product"): "check it: stl.check(product)",
    ("Training", "Policy"): "give the whole result of stl.learn, not its policy",
    ("Counts", "Training"): "take the training's: training.counts",
    ("Sweep", "str"): "read it: stl.load_sweep(path)",
    ("Sweep", "Path"): "read it: stl.load_sweep(path)",
}


def require(
    value: object, kinds: type | tuple[type, ...], what: str, remedy: str | None = None, *, optional: bool = False
) -> None:
    """ArgumentError unless `value` is of one of these kinds, or None if it is optional.

    `what` names the argument ("check's policy"); without a `remedy`, the tables above provide it.
    """
    if isinstance(value, kinds) or (optional and value is None):
        return
    needed = list(dict.fromkeys(map(kind_name, kinds if isinstance(kinds, tuple) else (kinds,))))
    given = "Path" if isinstance(value, PurePath) else "array" if _is_array(value) else kind_name(type(value))
    if remedy is None:
        meant = (_MEANT.get((kind, given)) for kind in needed)
        remedy = next(filter(None, meant), None) or _MAKE.get(needed[0], "give one")
    raise ArgumentError(f"{what} {_verb(what)} {described(value)}, not {_either(needed, optional)}; {remedy}")


def flag(value: object, what: str) -> bool:
    """True or False; ArgumentError for anything else, so that no string counts as True."""
    if isinstance(value, bool) or type(value).__name__ == "bool":  # numpy's, too
        return bool(value)
    raise ArgumentError(f"{what} is {described(value)}, not a flag; write True or False")


def whole(value: object, what: str, least: int | None = None, most: int | None = None) -> int:
    """`value` as a Python int, which does not wrap like numpy's narrow types; callers use the result.

    SettingsError for anything but an integer, or for one out of range (at most 64 bits).
    """
    good = isinstance(value, Integral) and not isinstance(value, bool)
    number = int(value) if good else 0  # type: ignore[call-overload]
    if not good or not (-LARGEST if least is None else least) <= number <= (LARGEST if most is None else most):
        limits = f" from {least}" if least is not None else ""
        limits += f" up to {most}" if most is not None else " below 2^63" if number > LARGEST else ""
        raise SettingsError(f"{_subject(what)} is {described(value)}; it must be an integer{limits}")
    return number


def real(value: object, what: str, example: str = "0.5") -> float | Fraction:
    """A finite number: fractions and decimals exactly, others as doubles."""
    if not isinstance(value, bool) and isinstance(value, Real | Decimal):
        try:
            number = Fraction(value) if isinstance(value, Fraction | Decimal) else float(value)
            if math.isfinite(number):
                return number
        except (OverflowError, ValueError):  # an infinite decimal, an integer beyond all doubles
            pass
    unquoted = ", without quotes" if isinstance(value, str) else ""
    raise SettingsError(
        f"{_subject(what)} is {described(value)}; a finite number is needed, such as {example}{unquoted}"
    )


def one_of(value: object, what: str, known: Sequence[str]) -> str:
    """One of these words; SettingsError names them."""
    if not isinstance(value, str) or value not in known:
        choices = f"{', '.join(known[:-1])} or {known[-1]}" if len(known) > 1 else known[0]
        raise SettingsError(f"{_subject(what)} is {described(value)}; choose {choices}")
    return value


def function(value: object, what: str) -> None:
    """ArgumentError unless it can be called, or is None."""
    if value is not None and not callable(value):
        raise ArgumentError(f"{what} is {described(value)}, not a function or None; leave it out, or write one")


def path(value: object, what: str) -> Path:
    """The path given as a string or a path object; ArgumentError for anything else."""
    try:
        if isinstance(value, str | PathLike) and b"\0" not in (encoded := os.fsencode(value)):
            longest = max(map(len, encoded.split(b"/")))
            if longest > _LONGEST_NAME or len(encoded) > _LONGEST_PATH:
                raise FileError(f"{os.fsdecode(value)[:_LONGEST]}...: this path is too long for any file")
            return Path(value)
    except UnicodeEncodeError:  # half a character
        pass
    raise ArgumentError(f"{what} is {described(value)}, not a path; write one in quotes, or as pathlib.Path")


def mapping(value: object, what: str, example: str, *, optional: bool = False) -> Mapping[str, Any]:
    """A mapping from names, or a data frame; empty if it is optional and None."""
    if optional and value is None:
        return {}
    if isinstance(value, type) or not (hasattr(value, "keys") and hasattr(value, "__getitem__")):
        none = " or None" if optional else ""
        raise ArgumentError(f"{what} are {described(value)}, not a mapping{none}; write, for example, {example}")
    for key in value.keys():  # noqa: SIM118 - of a data frame, too
        require(key, str, f"a name in {what}", f"write, for example, {example}")
    return cast(Mapping[str, Any], value)


def texts(value: object, what: str) -> list[str]:
    """A list of names; numbers in it are converted to strings."""
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        raise ArgumentError(f"{what} are {described(value)}, not a list; write, for example, ['a', 'b']")
    names = list(value)
    for name in names:
        if not isinstance(name, str | Integral):
            raise ArgumentError(f"one of {what} is {described(name)}, not text; write it in quotes")
    return [str(name) for name in names]


def _subject(what: str) -> str:
    """An argument by its name, marked as such, or in words ("the policy's step t")."""
    return named(what) if what.isidentifier() else what


def described(value: object) -> str:
    """A value as a message shows it: short, whatever it is."""
    if value is None or isinstance(value, bool):
        return str(value)
    if isinstance(value, str):
        return repr(value if len(value) <= _LONGEST else f"{value[:_LONGEST]}...")
    if isinstance(value, PurePath):
        return f"the path {str(value)!r}"
    if isinstance(value, Real | Decimal | complex):
        try:
            text = str(value)
        except ValueError:  # Python does not print integers of more than a few thousand digits
            return "a number of thousands of digits"
        return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if _is_array(value):
        shape = getattr(value, "shape", None)
        return str(value) if shape == () else f"an array of shape {shape}"
    name = kind_name(type(value))
    if isinstance(value, Sequence | Set | Mapping) and type(value).__module__ == "builtins":
        plain = len(value) <= _LONGEST and all(isinstance(item, str | int | float | None) for item in value)
        short = plain and not isinstance(value, Mapping) and len(repr(value)) <= _LONGEST
        return repr(value) if short else f"a {name} of {len(value)}"
    if callable(value) and hasattr(value, "__name__"):
        return f"the function {value.__name__}"
    return _article(name)


def kind_name(kind: type) -> str:
    """The user's name for a class: all formula nodes are a Formula."""
    return str(getattr(kind, "KIND", kind.__name__))


def _is_array(value: object) -> bool:
    return hasattr(value, "shape") and hasattr(value, "dtype")


def _either(names: Sequence[str], optional: bool) -> str:
    words = [_article(name) for name in names] + ["None"] * optional
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"


def _verb(what: str) -> str:
    return "are" if what.endswith("s") and not what.endswith("ss") else "is"


def _article(name: str) -> str:
    if name in _WORDS:
        return _WORDS[name]
    return f"{'an' if name[0] in 'AEIOaeio' or name == 'MDP' else 'a'} {name}"
