"""The methods by name, with their classes and settings."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

from stltool.errors import SettingsError, named, near_misses
from stltool.learning.cfer import Cfer, PublishedCfer
from stltool.learning.cfper import PublishedCfper
from stltool.learning.learner import Learner, summary
from stltool.learning.model_based import ModelBased
from stltool.learning.naive import Naive, PublishedNaive
from stltool.learning.naive_er import NaiveER, PublishedNaiveER
from stltool.learning.settings import Budget, settings_of, shown_value

LEARNERS: tuple[type[Learner[Any]], ...] = (
    Cfer, ModelBased, Naive, NaiveER, PublishedNaive, PublishedNaiveER, PublishedCfer, PublishedCfper,
)  # fmt: skip
for _cls in LEARNERS:  # help(stl.Cfer) lists its settings
    _cls.__doc__ = f"{summary(_cls)}\n\n" + "\n".join(
        f"{name} = {shown_value(one.default)}: {one.text} ({one.range})" for name, one in settings_of(_cls).items()
    )
METHODS = tuple(dict.fromkeys(cls.name for cls in LEARNERS))
_BY_NAME = {(cls.name, cls.published): cls for cls in LEARNERS}


def class_of(method: str | None, faithful: bool) -> type[Learner[Any]]:
    """The class of a method by its name; SettingsError if there is none. None: the default."""
    if method is None:
        method = Cfer.name if faithful else ModelBased.name
    if method not in METHODS:
        raise SettingsError(f"there is no method {method!r}; {near_misses(method, METHODS)}")
    if (method, faithful) not in _BY_NAME:
        if faithful:
            raise SettingsError(f"{method} is not a published method; leave {named('faithful')} out")
        raise SettingsError(f"{method} exists only as published; give {named('faithful', 'faithful=True')}, too")
    return _BY_NAME[method, faithful]


def make(cls: type[Learner[Any]], settings: Mapping[str, Any]) -> Learner[Any]:
    """A learner with these settings; SettingsError for names that its method does not have."""
    for name in settings:
        require_setting(cls, name)
    return cls(**settings)


def require_setting(cls: type[Learner[Any]], name: str, also: tuple[str, ...] = ()) -> None:
    """SettingsError unless the method has a setting of that name, or it is one of `also`."""
    known = (*settings_of(cls), *also)
    if name in known:
        return
    others = [other for other in LEARNERS if other is not cls and name in settings_of(other)]
    if others:
        where = ", ".join(_described(other) for other in others)
        raise SettingsError(
            f"{_described(cls)} has no setting {name}; {where} {'has' if len(others) == 1 else 'have'} it. Leave it "
            f"out, or use one of these"
        )
    meant = near_misses(name, (*known, *settings_of(Budget)))
    raise SettingsError(f"{_described(cls)} has no setting {name!r}; {meant}")


def methods_text() -> str:
    """All methods, their settings and defaults, and the meaning of each setting, for the command line."""
    lines = ["Methods, their settings and defaults (--set NAME=VALUE):"]
    for cls in LEARNERS:
        option = " --faithful" if cls.published else ""
        lines.append(f"  -m {cls.name}{option}: {summary(cls)}")
        defaults = [f"{name}={shown_value(one.default)}" for name, one in settings_of(cls).items()]
        lines += textwrap.wrap(" ".join(defaults), 100, initial_indent=" " * 6, subsequent_indent=" " * 6)
    lines += ["", "Settings:"]
    found = {name: one for cls in LEARNERS for name, one in settings_of(cls).items()}
    width = max(map(len, found))
    for name, one in found.items():
        lines += textwrap.wrap(
            f"  {name:<{width}}  {one.text} ({one.range})", 110, subsequent_indent=" " * (width + 4),
        )  # fmt: skip
    return "\n".join(lines)


def methods_table() -> list[tuple[str, ...]]:
    """Rows for the documentation: name, class, what it is."""
    return [
        (f"`{cls.name}`" + (", as published" if cls.published else ""), f"`stl.{cls.__name__}`", summary(cls))
        for cls in LEARNERS
    ]


def settings_table() -> list[tuple[str, ...]]:
    """Rows for the documentation: setting, range, what it means, and the methods that have it with their defaults."""
    rows: list[tuple[str, ...]] = []
    for name, one in {name: one for cls in LEARNERS for name, one in settings_of(cls).items()}.items():
        owners: dict[str, list[str]] = {}
        for cls in LEARNERS:
            if name in settings_of(cls):
                owners.setdefault(shown_value(settings_of(cls)[name].default), []).append(cls.__name__)
        defaults = "; ".join(f"{default} ({', '.join(classes)})" for default, classes in owners.items())
        rows.append((f"`{name}`", one.range, one.text, defaults))
    return rows


def budget_table() -> list[tuple[str, ...]]:
    """Rows for the documentation: what belongs to a run, its range, its default, what it means."""
    return [(f"`{name}`", one.range, one.text, shown_value(one.default)) for name, one in settings_of(Budget).items()]


def _described(cls: type[Learner[Any]]) -> str:
    return f"{cls.name} as published" if cls.published else cls.name
