"""Messages speak of options, not of arguments: every option of every command with a value that it refuses."""

import pathlib
import re
import typing

import pytest
from typer.models import OptionInfo

import stltool as stl
from stltool.cli import app
from stltool.cli.words import Spelled, spelling
from stltool.errors import SettingsError, StlToolError, named, reworded
from tests.cli.every import CASES, SMALL, make_inputs
from tests.conftest import PATROLLING

COMMANDS = {command.name or command.callback.__name__: command.callback for command in app.registered_commands}
# besides the option itself, what makes the command look at it
BESIDE = {
    ("estimate", "--alpha"): ["--at-least", "0.5"], ("estimate", "--beta"): ["--at-least", "0.5"],
    ("estimate", "--indifference"): ["--at-least", "0.5"], ("estimate", "--most-runs"): ["--at-least", "0.5"],
    ("why", "--most"): ["--mass", "0.5"], ("monitor", "--trace"): ["--steps"],
    ("run", "--checkpoint-every"): ["--checkpoint", "c.npz"],
    ("learn", "--checkpoint-every"): ["--checkpoint", "c.npz"],
}  # fmt: skip
INSTEAD = {
    ("estimate", "--at-least"): ["patrolling.stl", *SMALL], ("sweep", "--cluster"): ["sweep.toml", "--out", "swept"],
    ("explain", "--step"): ["F[0,2] a"], ("new", "--kind"): ["made"], ("new", "--example"): ["made"],
}  # fmt: skip
for option in ("--alpha", "--beta", "--indifference", "--most-runs"):
    INSTEAD["estimate", option] = ["patrolling.stl", *SMALL]


def options(name):
    """(option, the values that it refuses, the names of the library's arguments that it gives) of a command."""
    for parameter, hint in typing.get_type_hints(COMMANDS[name], include_extras=True).items():
        kind, *more = typing.get_args(hint) or (None,)
        declared = next((one for one in more if isinstance(one, OptionInfo)), None)
        kinds = {kind, *typing.get_args(kind)}
        if declared is not None and not kinds & {bool, pathlib.Path}:
            spelled = [declared.default, *(declared.param_decls or ())]
            long = next(text for text in spelled if isinstance(text, str) and text.startswith("--"))
            values = ["-1", "x"] if kinds & {int, float} else ["nonsense", ""]
            yield long, values, parameter


TABLE = [(name, option, value) for name in COMMANDS for option, values, _ in options(name) for value in values]
ARGUMENTS = {parameter for name in COMMANDS for _, _, parameter in options(name)} | {"runs", "keep_policy", "resume"}
ARGUMENTS -= {"step", "unit"}  # words of task files, too: "write step = 0.1s there"
ARGUMENTS -= {"cost"}  # a word of English, too: "a cost is paid"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("inputs")
    make_inputs(made)
    return made


def python_words(text):
    """What no user of the command line has written: names of arguments, their values in Python, functions."""
    found = re.findall(r"\w+=(?:True|False|None|'|\")|\bstl\.\w+|\b(?:None|True|False)\b|[\x00-\x08\x0b-\x1f]", text)
    found += [name for name in re.findall(r"(?<![\w-])(\w+)(?= (?:is|=) )", text) if name in ARGUMENTS]
    return found + [name for name in re.findall(r"(?<![\w-])\w+(?![\w-])", text) if "_" in name and name in ARGUMENTS]


@pytest.mark.parametrize(("name", "option", "value"), TABLE)
def test_bad_values_are_told_in_words_of_the_command_line(stltool, folder, monkeypatch, name, option, value):
    monkeypatch.chdir(folder)
    given = INSTEAD.get((name, option), CASES[name])
    code, out, err = stltool(name, *given, *BESIDE.get((name, option), []), option, value)
    assert (code, out) == (2, ""), err
    err = " ".join(err.replace("│", " ").split())
    assert python_words(err) == []
    assert option in err or repr(value)[1:-1] in err  # the option, or what was given to it


def test_no_option_without_a_row():
    assert len(TABLE) > 130
    for name, option in {**BESIDE, **INSTEAD}:
        assert option in {option for option, _, _ in options(name)}
    assert python_words("most_runs is -1") == ["most_runs", "most_runs"]
    assert python_words("use resume=True; stl.learn") == ["resume=True", "stl.learn"]
    assert python_words("--most-runs is -1") == []


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (["learn", "--resume"], "--resume needs the checkpoint to continue from; give --checkpoint FILE"),
        (["learn", "--method", "cfper"], "cfper exists only as published; give --faithful, too"),
        (["learn", "--method", "model-based", "--faithful"], "leave --faithful out"),
        (["estimate", "--runs", "5", "--epsilon", "0.1"], "--runs and --epsilon are both given"),
        (["estimate", "--alpha", "0.5", "--beta", "0.5", "--at-least", "0.5"], "--alpha + --beta is 1; choose them"),
        (["surrogate", "--model", "floor-5x5-uncertain.toml"], "the ordinary model inside them (--nominal)"),
        (["surrogate", "--model", "floor-5x5-uncertain.toml"], "use stltool check"),
        (["pareto", "--model", "floor-5x5-uncertain.toml"], "or the ordinary model inside them\n"),
        (["monitor", "G[0,9] x > 0", "trace.csv"], "or --end cut to cut windows at the end of the trace, or --end h"),
        (["explain", "F[0,2s] a", "--step", "5"], "is not a positive time with a unit; write, for example, --step"),
    ],
)  # fmt: skip
def test_advice_is_given_in_options(stltool, folder, monkeypatch, command, says):
    monkeypatch.chdir(folder)
    name = command[0]
    given = command if name in ("monitor", "explain") else [name, *CASES[name], *command[1:]]
    if name == "estimate":
        given = [name, "patrolling.stl", *SMALL, *command[1:]]
    code, _, err = stltool(*given)
    assert (code, says in err, python_words(err)) == (2, True, []), err


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (["check", "--save-policy", "p.npz"], "40 kB may be used; shorten the windows, or coarsen the grid"),
        (["tradeoff", "--save-policy", "p.npz"], "leave --save-policy out, or shorten the windows"),
        (["why"], "of memory; 40 kB may be used; shorten the windows"),
    ],
)
def test_what_would_not_fit_is_told_with_options_that_there_are(stltool, folder, monkeypatch, command, says):
    monkeypatch.chdir(folder)
    monkeypatch.setattr("psutil.virtual_memory", lambda: type("Memory", (), {"available": 50_000}))
    monkeypatch.setattr("stltool.sizes._LITTLE", 0)
    given = ["patrolling.stl", *SMALL] if command[0] == "check" else CASES[command[0]]
    code, _, err = stltool(command[0], *given, *command[1:])
    assert (code, says in err, python_words(err)) == (2, True, []), err


def test_errors_are_pythons_in_python_and_can_be_reworded():
    error = SettingsError(f"{named('resume', 'resume=True')} needs {named('checkpoint', 'checkpoint=FILE')}; "
                          f"{named('keep', 'use keep=False, or ')}stop; {named('other')}")  # fmt: skip
    plain = "resume=True needs checkpoint=FILE; use keep=False, or stop; other"
    assert (str(error), error.args, repr(error)) == (plain, (plain,), f"SettingsError({plain!r})")
    options = {"resume": Spelled("--resume", True), "checkpoint": Spelled("--checkpoint", False)}
    assert reworded(error, spelling(options)) == "--resume needs --checkpoint FILE; stop; other"
    options["keep"] = Spelled("--save", False, "leave --save out, or ")
    assert reworded(error, spelling(options)) == "--resume needs --checkpoint FILE; leave --save out, or stop; other"
    with pytest.raises(StlToolError, match="^runs is -1; it must be an integer from 1"):
        stl.estimate(*patrolled(), runs=-1)


def patrolled():
    model = stl.MDP.from_arrays([[[1.0]]], {"x": [0.0]}, labels={"A": [1]})
    product = stl.build_product(model, stl.parse("F[0,2] A"))
    return product, stl.check(product).policy


@pytest.mark.parametrize("option", ["--runs", "--seed", "--confidence"])
@pytest.mark.parametrize("text", ["1_0", "٣", "0x10"])
def test_options_of_every_command_are_read_so(stltool, option, text):
    code, _, err = stltool("estimate", PATROLLING, option, text)
    assert code == 2
    assert "is not a" in err
