"""The application object that commands register with."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import typer
from typer.models import OptionInfo, ParameterInfo

from stltool import numbers
from stltool.cli.roles import Parameter, Reads, Writes, itself, require_apart, require_inside
from stltool.cli.words import Named, Spelled, spelling
from stltool.errors import StlToolError, reworded
from stltool.streams import say

_Command = TypeVar("_Command", bound=Callable[..., Any])
_Number = TypeVar("_Number", int, float)


class _App(typer.Typer):
    """What all commands have in common: numbers in options are read as everywhere (stltool/numbers.py: `--runs 1_0` is
    refused), results never replace inputs (roles.py), messages name options (words.py), --help and -h end with an
    example, and --quiet and --version are understood.
    """

    def command(self, example: str, **named: Any) -> Callable[[_Command], _Command]:  # type: ignore[override]
        register = super().command(epilog=f"Example: {example}", context_settings=_HELP, **named)

        def registered(function: _Command) -> _Command:
            whole: dict[str, Any] = get_type_hints(function, include_extras=True)
            groups = {
                name: kind for name, kind in whole.items() if hasattr(kind, "_fields")
            }  # options as a named tuple
            hints: dict[str, Any] = {}
            for name, hint in whole.items():
                hints |= get_type_hints(hint, include_extras=True) if name in groups else {name: hint}
            files: dict[str, Parameter] = {}
            options: dict[str, Spelled] = {}
            for name, hint in hints.items():
                kind, *option = get_args(hint) or (None,)
                if not option:
                    continue
                shown = _shown(name, option[0])
                if isinstance(option[0], OptionInfo):
                    parsers = [_PARSERS[one] for one in (kind, *get_args(kind)) if one in _PARSERS]
                    option[0].parser = parsers[0] if parsers else None
                    own = next((one for one in option if isinstance(one, Named)), Named(name))
                    options[own.argument] = Spelled(shown, kind is bool, own.advice)
                if roles := tuple(role for role in option if isinstance(role, Reads | Writes)):
                    files[name] = Parameter(shown, roles)
            function.__annotations__ = whole

            @functools.wraps(function)
            def command(quiet: bool, version: bool, sandbox: bool = False, **given: Any) -> Any:
                from stltool.log import LOG

                LOG.quiet = quiet
                try:
                    if sandbox:
                        require_inside(files, given)
                    require_apart(files, given)
                    for name, kind in groups.items():
                        given[name] = kind(**{field: given.pop(field) for field in kind._fields})
                    return function(**given)
                except StlToolError as fault:
                    fault.args = (reworded(fault, spelling(options)),)
                    raise

            signature = inspect.signature(function)
            others = {"sandbox": Sandbox} if any(_names_others(parameter) for parameter in files.values()) else {}
            common = [
                inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
                for name, kind in ({**others, "quiet": Quiet, "version": Version}).items()
            ]
            given = [
                inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hints[key])
                for name, one in signature.parameters.items()
                for key, default in (groups[name]._field_defaults.items() if name in groups else [(name, one.default)])
            ]
            command.__signature__ = signature.replace(parameters=[*given, *common])  # type: ignore[attr-defined]
            command.__annotations__ = {**hints, **others, "quiet": Quiet, "version": Version}
            command.files = files  # type: ignore[attr-defined]  # for tests over all commands
            register(command)
            return function

        return registered


def _names_others(parameter: Parameter) -> bool:
    """Whether the files that it reads may name others."""
    return any(isinstance(role, Reads) and role.files is not itself for role in parameter.roles)


def _shown(name: str, declared: ParameterInfo) -> str:
    """A parameter as written on the command line: --out, TASK."""
    spelled = (
        declared.default,
        *(declared.param_decls or ()),
    )  # in annotations, the first name is stored as the default
    long = (text for text in spelled if isinstance(text, str) and text.startswith("--"))
    return next(long, declared.metavar or name.upper())


def integer(text: int | str) -> int:
    return _read(numbers.whole, text) if isinstance(text, str) else text  # a default


def number(text: float | str) -> float:
    return _read(numbers.double, text) if isinstance(text, str) else text


_PARSERS: dict[Any, Callable[[Any], Any]] = {int: integer, float: number}  # their names appear in --help


def _read(read: Callable[[str], _Number], text: str) -> _Number:
    try:
        return read(text)
    except numbers.NumberError as error:
        raise typer.BadParameter(str(error)) from None


def _version(asked: bool) -> None:
    if asked:
        from importlib import metadata

        say(f"stltool {metadata.version('stltool')}")
        raise typer.Exit


_HELP = {"help_option_names": ["-h", "--help"]}
Version = Annotated[
    bool, typer.Option("--version", help="Show the version and exit.", callback=_version, is_eager=True)
]
Sandbox = Annotated[
    bool,
    typer.Option("--sandbox", help="for files of strangers: read nothing outside their folders, run no programs"),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="no progress on stderr; warnings and errors only")]

app = _App(
    help="Signal temporal logic tasks on Markov decision processes, learned and verified exactly.",
    no_args_is_help=True,
    context_settings=_HELP,
    epilog="Example: stltool new shift, then cd shift, then stltool run task.stl",
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


@app.callback()
def options(version: Version = False) -> None:
    """Signal temporal logic tasks on Markov decision processes, learned and verified exactly."""
