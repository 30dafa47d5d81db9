"""Settings as the fields of frozen dataclasses: each declared once, with its range and meaning.

The declaration yields the checks, what `--set NAME=VALUE` accepts, and the tables of `--help` and docs/learning.md.
A learner's fields are its method's settings; what belongs to a run, whatever its method, is a `Budget`.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from stltool.arguments import LARGEST, described
from stltool.errors import SettingsError, named
from stltool.numbers import double, whole

_KINDS: dict[Any, str] = {int: "an integer", float: "a number", str: "text", bool: "true or false"}


def setting(
    default: Any,
    text: str,
    *,
    least: float = -math.inf,
    above: float = -math.inf,
    most: float = math.inf,
    choices: tuple[str, ...] | None = None,
) -> Any:
    """A field of a settings dataclass: `least` ≤ value ≤ `most`, value > `above`; or one of `choices`."""
    return dataclasses.field(default=default, metadata={"setting": _Declared(text, least, above, most, choices)})


@dataclass(frozen=True)
class _Declared:
    """The arguments of `setting`."""

    text: str = ""
    least: float = -math.inf
    above: float = -math.inf
    most: float = math.inf
    choices: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Setting:
    """A setting with its declaration. `kind` is int, float, str or bool; None: anything, unchecked."""

    name: str
    default: Any
    kind: type | None
    optional: bool
    declared: _Declared

    @property
    def text(self) -> str:
        """What it means."""
        return self.declared.text

    @property
    def range(self) -> str:
        """Its range in words: "an integer from 1"."""
        declared, ends = self.declared, []
        if declared.choices is not None:
            *others, last = declared.choices
            return f"{', '.join(others)} or {last}" if others else last
        if declared.above == 0 and math.isinf(declared.most):
            ends = ["above 0"]
        elif math.isfinite(declared.least) and math.isfinite(declared.most):
            ends = [f"from {declared.least:g} to {declared.most:g}"]
        elif math.isfinite(declared.least):
            ends = [f"from {declared.least:g}"]
        else:
            ends += [f"above {declared.above:g}"] * math.isfinite(declared.above)
            ends += [f"at most {declared.most:g}"] * math.isfinite(declared.most)
        words = " ".join([_KINDS.get(self.kind, "any value"), " and ".join(ends)]).strip()
        return f"{words}, or none" if self.optional else words

    def checked(self, value: Any) -> Any:
        """The value as a plain int, float, str or bool; SettingsError if it is out of range."""
        if value is None and self.optional:
            return None
        fine, plain = _plain(value, self.kind)
        declared = self.declared
        if fine and declared.choices is not None:
            fine = plain in declared.choices
        elif fine and self.kind in (int, float):
            fine = declared.least <= plain <= declared.most and plain > declared.above
        if not fine:
            raise SettingsError(f"{named(self.name)} is {described(value)}; it must be {self.range}")
        return plain

    def read(self, text: str) -> Any:
        """The value parsed from text; SettingsError, with the range, if there is none."""
        if self.optional and text == "none":
            return None
        value: Any = text
        try:
            if self.kind in (int, float):
                value = (whole if self.kind is int else double)(text)
            elif self.kind is bool:
                value = {"true": True, "false": False}[text]
        except (ValueError, KeyError):
            raise SettingsError(f"{named(self.name)} is {text!r}; it must be {self.range}") from None
        return self.checked(value)


def _plain(value: Any, kind: type | None) -> tuple[bool, Any]:
    """Whether it is of that kind, and the value as Python's type: numpy's numbers are fine, true is not a number."""
    if kind is int:
        fine = isinstance(value, int | np.integer) and not isinstance(value, bool) and abs(int(value)) <= LARGEST
        return fine, int(value) if fine else value
    if kind is float:
        try:
            plain = float(value) if isinstance(value, int | float | np.integer | np.floating) else math.nan
        except OverflowError:  # an integer beyond all doubles
            plain = math.nan
        fine = math.isfinite(plain) and not isinstance(value, bool)
        return fine, plain if fine else value
    return kind is None or isinstance(value, kind), value


def settings_of(owner: Any) -> dict[str, Setting]:
    """The settings of a dataclass or of one of its instances, by name, in their order."""
    return dict(_settings_of(owner if isinstance(owner, type) else type(owner)))


@functools.cache
def _settings_of(cls: Any) -> dict[str, Setting]:
    hints = typing.get_type_hints(cls)  # which takes a millisecond, and a sweep asks for every run
    found = {}
    for field in dataclasses.fields(cls):
        kind, optional = _kind(hints[field.name])
        default = field.default if field.default is not dataclasses.MISSING else None
        if field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        declared = field.metadata.get("setting", _Declared())
        found[field.name] = Setting(field.name, default, kind, optional, declared)
    return found


def _kind(hint: Any) -> tuple[type | None, bool]:
    """int, float, str or bool, and whether None is allowed too; None where the annotation is anything else."""
    arguments = typing.get_args(hint)
    optional = type(None) in arguments
    if optional and len(arguments) == 2:
        hint = next(one for one in arguments if one is not type(None))
    if typing.get_origin(hint) is typing.Literal:
        return str, optional
    return (hint if hint in _KINDS else None), optional


def check_settings(owner: Any) -> None:
    """Check the fields of a frozen dataclass as it is made; numpy's numbers become Python's."""
    for name, declared in settings_of(owner).items():
        object.__setattr__(owner, name, declared.checked(getattr(owner, name)))


def shown_value(value: Any) -> str:
    """A setting's value as `--set` reads it."""
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def recorded(owner: Any) -> dict[str, Any]:
    """All settings with their values, in JSON-compatible form. SettingsError for a value that JSON cannot represent."""
    values = {field.name: getattr(owner, field.name) for field in dataclasses.fields(owner)}
    for name, value in values.items():
        try:
            json.dumps(value, allow_nan=False)
        except (TypeError, ValueError):
            raise SettingsError(
                f"{name} of {type(owner).__name__} is {described(value)}; settings are recorded, so it must be a "
                "finite number, text, true, false, None, or a list or dict of these"
            ) from None
    return values


@dataclass(frozen=True, kw_only=True)
class Budget:
    """How long a run of any method continues, and how often its policy is evaluated."""

    episodes: int = setting(1000, "training episodes", least=1)
    evaluate_every: int = setting(20, "episodes between exact evaluations of the learned policy", least=1)
    most_steps: int | None = setting(None, "stop before the total of environment steps could exceed this", least=1)
    stop_gap: float | None = setting(
        None, "stop once an evaluation is within this of the exact optimum (known models only)", least=0, most=1
    )

    def __post_init__(self) -> None:
        check_settings(self)


def split(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Settings by name, as those of a Budget and the rest."""
    own = settings_of(Budget)
    return {k: v for k, v in given.items() if k in own}, {k: v for k, v in given.items() if k not in own}
