"""No command writes over what it reads, or two results into one file: over all commands and pairs of parameters."""

import itertools
import os
import re
import shutil
import typing
from pathlib import Path

import pytest

import stltool as stl
from stltool.cli import app
from stltool.cli.roles import Reads, Writes
from tests.cli.every import CASES, make_inputs

# what a parameter of that role may name, in the folder that make_inputs fills, and what is read with it
SAMPLES = {
    "task file": ["patrolling.stl", "floor-5x5.toml"], "model file": ["model.tra", "model.lab", "model.sta"],
    "policy's model": ["floor-5x5.toml"], "policy": ["policy.npz"], "trace": ["trace.csv"],
    "certificate": ["certificate.jsonl"], "run": ["run.csv"],
    "sweep file": ["sweep.toml", "patrolling.stl", "floor-5x5.toml"], "report": ["report.json"],
}  # fmt: skip
COMMANDS = {command.name or command.callback.__name__: command.callback for command in app.registered_commands}


def roles(name, kind):
    """(parameter, its spelling, role) of a command."""
    return [
        (parameter, files.shown, role)
        for parameter, files in COMMANDS[name].files.items()
        for role in files.roles
        if isinstance(role, kind)
    ]


def is_read(name):
    return {parameter for parameter, _, _ in roles(name, Reads)}


PAIRS = [
    pytest.param(name, shown, role, sample, id=f"{name} {shown} {read.what} {sample}")
    for name in COMMANDS
    for parameter, shown, role in roles(name, Writes)
    for _, _, read in roles(name, Reads)
    for sample in SAMPLES[read.what]
    if parameter not in is_read(name)  # of report: below
]
TWO = [
    pytest.param(name, one, file, other, twin, id=f"{name} {one} {other}")
    for name in COMMANDS
    for (_, one, role), (_, other, another) in itertools.combinations(roles(name, Writes), 2)
    for file in role.files(Path("result"))
    for twin in another.files(Path("result"))
]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    made = tmp_path_factory.mktemp("inputs")
    make_inputs(made)
    (made / "run.csv").write_text('state,action\n"(1,0)",N\n"(1,1)",\n')
    (made / "model.tra").write_text("1 1 1\n0 0 0 1\n")
    (made / "model.lab").write_text('0="init"\n0: 0\n')
    (made / "model.sta").write_text("(x)\n0:(1)\n")
    return made


@pytest.fixture
def folder(inputs, tmp_path, monkeypatch):
    shutil.copytree(inputs, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here"


def arguments(name, **values):
    """The command's case with these options, and with every file that it can read."""
    given = [name, *CASES[name]]
    if "task" in COMMANDS[name].files and name != "certify":
        given[1:3] = ["patrolling.stl", "trace.csv"] if name == "monitor" else ["patrolling.stl", given[2]]
    if name == "convert":
        given[1:3] = ["model.tra", values.pop("OUT", given[2])]
    options = {shown: SAMPLES[role.what][0] for _, shown, role in roles(name, Reads) if shown.startswith("--")}
    for shown, value in {**options, **values}.items():
        if shown in given:
            given[given.index(shown) + 1] = value
        else:
            given += [shown, value]
    return given


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_every_parameter_that_names_a_file_says_what_is_done_with_it():
    for command in COMMANDS.values():
        hints = typing.get_type_hints(command, include_extras=True)
        assert {parameter for parameter, hint in hints.items() if "pathlib.Path" in str(hint)} <= set(command.files)
    assert {role.what for name in COMMANDS for _, _, role in roles(name, Reads)} == set(SAMPLES)
    assert len(PAIRS) > 50


@pytest.mark.parametrize(("name", "shown", "role", "sample"), PAIRS)
def test_no_result_replaces_what_is_read(stltool, folder, name, shown, role, sample):
    """Named as it is, or through a link of either kind; where a folder is named, as any file that is written there."""
    before = contents(folder)

    def refused(value):
        code, out, err = stltool(*arguments(name, **{shown: value}))
        assert (code, out) == (2, ""), err
        assert f"{shown}: " in err
        assert "would replace" in err

    if role.files(Path("named")) == [Path("named")]:
        refused(sample)
    for output in role.files(folder / "result"):
        output.parent.mkdir(exist_ok=True)
        for link in (os.symlink, os.link):
            link(folder / sample, output)
            refused("result")
            output.unlink()
    assert contents(folder) == before


@pytest.mark.parametrize(("name", "one", "file", "other", "twin"), TWO)
def test_no_two_results_go_into_one_file(stltool, folder, name, one, file, other, twin):
    """Of a folder any file that is written there."""
    before = contents(folder)
    values = {one: "result" if len(file.parts) == 2 else str(twin), other: str(file)}
    code, out, err = stltool(*arguments(name, **values))
    assert (code, out) == (2, "")
    assert re.search(rf"({one} and {other}|{other} and {one}) would both write {file}", err)
    assert contents(folder) == before


def test_a_page_does_not_replace_the_data_that_it_is_made_from(stltool, folder):
    shutil.copy("report.json", "data.html")
    os.symlink("report.json", "same.html")
    before = contents(folder)
    for given, says in (
        (["data.html"], "data.html would replace the report; name another"),
        (["report.json", "same.html"], "same.html would replace the report, report.json"),
        (["report.json", "./report.json"], "DATA would twice write report.html"),
    ):
        code, out, err = stltool("report", *given)
        assert (code, out) == (2, "")
        assert says in err
    assert contents(folder) == before


def test_results_go_into_a_folder_of_their_own_by_default(stltool, folder):
    """Where no option names a folder, its files are known before the work, too."""
    (folder / "out" / "patrolling").mkdir(parents=True)
    shutil.copy("floor-5x5.toml", "out/patrolling/policy.npz")
    code, _, err = stltool("run", "patrolling.stl", "--model", "out/patrolling/policy.npz")
    assert (code, "policy.npz would replace the model file; name another" in err) == (2, True)
    (folder / "out" / "sweep").mkdir()
    shutil.copy("sweep.toml", "out/sweep/report.json")
    code, _, err = stltool("sweep", "out/sweep/report.json")
    assert (code, "no such" in err) == (2, True)  # paths in it are relative to it
    text = Path("sweep.toml").read_text().replace("[sweep]", "[sweep]\nname = 'sweep'")
    Path("out/sweep/report.json").write_text(text.replace("patrolling.stl", "../../patrolling.stl"))
    code, _, err = stltool("sweep", "out/sweep/report.json")
    assert (code, "report.json would replace the sweep file; name another" in err) == (2, True)


# a name for each parameter that names one file
NAMES = {
    "--junit": ["v.xml"], "--markdown": ["v.md"], "--plot": ["f.svg", "f.png"], "--certificate": ["c.jsonl"],
    "--save-policy": ["p.npz", "p.policy"], "--save-policies": ["f.npz"], "--history": ["h.csv"],
    "--checkpoint": ["c.npz"],
    "--tensorboard": ["events"], "export --out": ["a.dot"], "learn --out": ["p.npz"], "explain --out": ["p.npz"],
    "OUT": ["m.umb", "m.tra"],
}  # fmt: skip
FOREIGN = [
    pytest.param(name, shown, value, file, id=f"{name} {shown} {file}")
    for name in COMMANDS
    for parameter, shown, role in roles(name, Writes)
    if parameter not in is_read(name)  # of report: below
    for value in (NAMES.get(f"{name} {shown}") or NAMES.get(shown) or ["result"])
    for file in map(os.path.relpath, role.files(Path(value)))
]


@pytest.mark.parametrize(("name", "shown", "value", "file"), FOREIGN)
def test_a_file_of_another_origin_is_not_replaced(stltool, folder, name, shown, value, file):
    """And nothing is computed or written before that is said: text, data, and pictures that are not ours."""
    Path(file).parent.mkdir(exist_ok=True)
    Path(file).write_text("x,y\n1,2\n")
    before = contents(folder)
    given = [name, *CASES[name]]
    given = given[: given.index(shown)] + given[given.index(shown) + 2 :] if shown in given else given
    given = given[:2] if name == "convert" else given
    code, out, err = stltool(*given, *([shown] if shown.startswith("-") else []), value)
    assert (code, out) == (2, "")
    says = "would be lost; name another file|exists[;,] |not a writable directory|it exists, and|delete it to start"
    assert re.search(rf"{file}.*({says})", err), err
    assert contents(folder) == before


@pytest.mark.parametrize("name", ["f.svg", "f.png", "f.pdf"])
def test_a_picture_of_ours_is_replaced_and_another_is_not(stltool, folder, name):
    from matplotlib.figure import Figure

    call = ("monitor", "F[0,2] x > 0.5", "trace.csv", "--plot", name)
    Path(name).touch()  # empty: nothing can be lost
    assert [stltool(*call)[0] for _ in range(2)] == [0, 0]
    Figure().savefig(name)
    code, _, err = stltool(*call)
    assert (code, f"{name}: this file does not contain a picture that stltool wrote" in err) == (2, True)


def test_a_page_is_renewed_only_where_a_page_of_ours_was(stltool, folder):
    assert [stltool("report", "report.json")[0] for _ in range(2)] == [0, 0]
    Path("report.html").write_text("<!doctype html>\n<p>Mine.</p>\n")
    code, out, err = stltool("report", "report.json")
    assert (code, out, "report.html: this file does not contain a page" in err) == (2, "", True)
    assert Path("report.html").read_text().endswith("Mine.</p>\n")
    product = stl.build_product(stl.load_model("floor-5x5.toml"), stl.load_task("patrolling.stl", {"T": 2, "tau": 2}))
    with pytest.raises(stl.StlToolError, match="would be lost"):
        stl.report(stl.check(product), None, "report.html")


@pytest.mark.parametrize("name", [name for name in COMMANDS if roles(name, Writes)])
def test_every_file_that_a_command_writes_is_known_before_and_may_be_written_again(stltool, folder, name):
    extra = {"check": ["--save-policy", "p.npz", "--certificate", "c.jsonl", "--report", "r"],
             "pareto": ["--plot", "f.svg"], "monitor": ["--plot", "f.svg"], "export": ["--out", "a.dot"],
             "learn": ["--history", "h.csv"], "tradeoff": ["--save-policy", "p.npz"],
             "verify": ["--junit", "v.xml", "--markdown", "v.md", "--report", "r", "--certificates", "cs"]}  # fmt: skip
    given = [*CASES[name], *extra.get(name, [])]
    before = contents(folder)
    assert stltool(name, *given)[0] == 0
    declared = set()
    for parameter, shown, role in roles(name, Writes):
        if parameter in is_read(name):
            declared |= set(role.files(folder / given[0]))
        elif shown == "OUT":
            declared |= set(role.files(folder / given[1]))
        elif shown in given:
            declared |= set(role.files(folder / given[given.index(shown) + 1]))
    written = {path for path, content in contents(folder).items() if before.get(path) != content}
    kept = {path for path in written if {"runs", "cs"} & {*path.parts} or path.name == "sweep.lock"}  # of sweep, verify
    assert written - kept <= declared
    assert {path for path in declared if path not in written and path.name != "report.html"} == set()
    if name != "new":
        assert stltool(name, *given)[0] == 0


@pytest.mark.parametrize("name", sorted(
    name for name in COMMANDS if "task" in COMMANDS[name].files and name not in ("monitor", "fmt", "new")
))  # fmt: skip
def test_in_a_sandbox_nothing_outside_the_folder_is_read(stltool, folder, name):
    inner = folder / "inner"
    inner.mkdir()
    text = (folder / "patrolling.stl").read_text()
    (inner / "patrolling.stl").write_text(text.replace('model "', 'model "../'))
    given = [str(inner / one) if one == "patrolling.stl" else str(one) for one in arguments(name)]
    if "--model" in given:
        at = given.index("--model")
        del given[at : at + 2]
    before = contents(folder)
    code, out, err = stltool(*given, "--sandbox")
    assert (code, out) == (2, "")
    assert "--sandbox: " in err
    assert "floor-5x5.toml, which is outside the folder of TASK" in err
    assert contents(folder) == before


def test_a_sandbox_follows_links_and_runs_no_program(stltool, folder):
    (folder / "far").mkdir()
    shutil.move("floor-5x5.toml", "far")
    os.symlink("far/floor-5x5.toml", "floor-5x5.toml")
    small = ("-p", "T=5", "-p", "tau=5", "--sandbox")
    assert stltool("check", "patrolling.stl", *small)[0] == 0  # a link within
    os.unlink("floor-5x5.toml")
    os.symlink(shutil.move("far/floor-5x5.toml", folder.parent), "floor-5x5.toml")
    assert "floor-5x5.toml, which is outside the folder of TASK" in stltool("check", "patrolling.stl", *small)[2]
    assert stltool("check", "patrolling.stl", "--model", folder.parent / "floor-5x5.toml", *small)[0] == 0
    os.symlink(shutil.move("patrolling.stl", folder.parent), "patrolling.stl")
    assert (
        "patrolling.stl is a link that leads outside the folder of TASK"
        in stltool("check", "patrolling.stl", *small)[2]
    )
    (folder / "lake.toml").write_text('kind = "gymnasium"\nid = "FrozenLake-v1"\n')
    (folder / "lake.stl").write_text('model "lake.toml"\nt := F[0,3] goal\n')
    code, out, err = stltool("check", "lake.stl", "--sandbox")
    assert (code, out) == (2, "")
    assert "lake.toml names a Gymnasium environment, which is a program; it is not run" in err
