"""Models in PRISM's language (.prism, .pm, .nm, .sm) and in JANI (.jani): Storm builds them, through stormpy.

The state space is built in rational arithmetic and read as Storm writes it down, in DRN (formats/drn.py): probabilities
are exact, the variables of states become signals, labels labels, reward structures costs. Constants that the file
leaves open are given values; those that only probabilities depend on may stay open, and become the model's parameters.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stltool.errors import ModelError, SettingsError, near_misses
from stltool.extras import require
from stltool.files import read_text
from stltool.models.formats.drn import drn_model
from stltool.models.loading import Loading
from stltool.models.mdp import MDP
from stltool.numbers import NumberError, exact, fraction_text

PRISM, JANI = (".prism", ".pm", ".nm", ".sm"), ".jani"
_LONGEST = 1 << 26  # bytes of a file
_SHOWN = 300  # characters of what Storm says
_INSTEAD = (
    "export the model with PRISM (prism {name} -exportmodel model.umb) or with Storm "
    "(storm {option} {name} --exportbuild model.drn), and give that file"
)
_BEYOND = "out_of_bounds"  # Storm's name of the state behind values that variables cannot have


def load_language(path: Path, loading: Loading, constants: Mapping[str, Any] | None = None) -> MDP:
    """Build the model of a PRISM or JANI file, with these values of constants.

    Raises MissingExtraError without stormpy; FileError; ModelError with what Storm says of the file, or naming the
    constants without a value.
    """
    stormpy, program = _parsed(path)
    open_constants = _open(program)
    values = dict(constants or {})
    for name in values:
        if name not in open_constants:
            hint = near_misses(name, open_constants) if open_constants else "the file defines all of its constants"
            raise SettingsError(f"{path}: there is no constant {name} without a value; {hint}")
    with _quiet(stormpy, path):
        if values:
            given = {name: _value(stormpy, name, value, open_constants[name]) for name, value in values.items()}
            program, _ = stormpy.io.instantiate_constants(program, given)
        missing = [name for name in open_constants if name not in values]
        if missing and not program.undefined_constants_are_graph_preserving:
            raise ModelError(
                f"{path}: no value is given for {' and '.join(missing)}; give one: -p {missing[0]}=…, in Python "
                f"constants={{{missing[0]!r}: …}}"
            )
        number = stormpy.RationalFunction if missing else stormpy.Rational
        with tempfile.TemporaryDirectory() as folder:
            text = Path(folder) / "model.drn"
            built = _built(stormpy, path, program, number)
            stormpy.io.export_to_drn(built, str(text))
            names = [variable.name for variable in built.state_valuations.get_all_variables()]
            labels = sorted(built.labeling.get_labels())
            told = _told(program, built)
            content = text.read_bytes()
    try:
        return drn_model(path, content, path.stem, loading, names, labels, told)
    except ModelError as error:  # its lines are those of a text that nobody has
        raise ModelError(
            re.sub(rf"(?m)^({re.escape(str(path))}), line \d+", r"\1, as Storm builds it", str(error))
        ) from None


def _built(stormpy: Any, path: Path, program: Any, number: Any) -> Any:
    """Storm's model of a program, if variables only get values that they may have.

    Of others Storm keeps the last bits, unless it is asked to check them. Then it refuses sums that miss 1, too, which
    the reader of its model judges: so these are built again, without checks. In JANI it can tell only by them.
    """
    checked, extended = stormpy.BuilderOptions(build_full=True), stormpy.BuilderOptions(build_full=True)
    checked.set_exploration_checks(True)
    extended.set_add_out_of_bounds_state(True)
    try:
        return stormpy.build_model[number](program, options=checked)
    except (RuntimeError, stormpy.exceptions.StormError):
        if path.suffix.lower() == JANI:
            raise
        labeling = stormpy.build_model[number](program, options=extended).labeling
        if _BEYOND in labeling.get_labels() and any(labeling.get_states(_BEYOND)):
            raise
        return stormpy.build_model[number](program, options=stormpy.BuilderOptions(build_full=True))


def _told(program: Any, built: Any) -> set[str]:
    """The transient variables of a JANI model that are labels and rewards already."""
    if not hasattr(program, "global_variables") or not hasattr(program, "automata"):
        return set()
    found = {variable.name for variable in program.global_variables if variable.is_transient}
    return found & {*built.labeling.get_labels(), *built.reward_models}


def constants_of(path: Path) -> list[str]:
    """The constants to which a file gives no value; none of files in other formats."""
    if path.suffix.lower() not in (*PRISM, JANI):
        return []
    return list(_open(_parsed(path)[1]))


def _parsed(path: Path) -> tuple[Any, Any]:
    """The package stormpy, and the program."""
    read_text(path, "model file", _LONGEST)  # that it is there, and text
    option = "--jani" if path.suffix.lower() == JANI else "--prism"
    stormpy = require("stormpy", f"{path}: a file in {_language(path)}", _INSTEAD.format(name=path.name, option=option))
    with _quiet(stormpy, path):
        if path.suffix.lower() == JANI:
            return stormpy, stormpy.io.parse_jani_model(str(path))[0]
        return stormpy, stormpy.parse_prism_program(str(path), prism_compatibility=True, simplify=False)


def _language(path: Path) -> str:
    return "JANI" if path.suffix.lower() == JANI else "PRISM's language"


def _open(program: Any) -> dict[str, bool]:
    """The constants without a value, and whether each is a real number."""
    return {
        constant.name: constant.expression_variable.has_rational_type()
        for constant in program.constants
        if not constant.defined
    }


def _value(stormpy: Any, name: str, value: Any, real: bool) -> Any:
    """A constant's value for Storm: a truth value, or an exact number."""
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and value.strip() in ("true", "false"):
        return value.strip() == "true"
    try:
        number = exact(value)
    except NumberError as error:
        raise SettingsError(f"constant {name}: {error}") from None
    return int(number) if number.denominator == 1 and not real else stormpy.Rational(fraction_text(number))


@contextmanager
def _quiet(stormpy: Any, path: Path) -> Iterator[None]:
    """What Storm says, as an error of ours; nothing of it goes to the terminal."""
    log = stormpy.developer
    before = log.get_log_level()
    log.set_log_level(log.LogLevel.OFF)
    try:
        yield
    except (RuntimeError, ValueError, TypeError, stormpy.exceptions.StormError) as error:
        said = " ".join(str(error).split())
        shown = said if len(said) <= _SHOWN else said[:_SHOWN] + "…"
        raise ModelError(f"{path}: Storm does not build this model: {shown}") from None
    finally:
        log.set_log_level(before)
