"""Every command that takes a policy takes it from each kind of file, and says the same of it."""

import json
import re
from pathlib import Path

import pytest

import stltool as stl
from stltool.cli import app
from tests.conftest import FACTORY, PATROLLING, SMALL

TAKES = {
    "check": [], "estimate": ["--runs", "20"], "why": [], "play": ["--moves", ". *"], "explain": ["--price", "0.3"],
    "export": ["--to", "prism"], "counterfactual": ["--at", "0"],
}  # fmt: skip


def test_these_are_all_commands_that_take_a_policy():
    commands = {command.name or command.callback.__name__: command.callback for command in app.registered_commands}
    taking = {name for name, command in commands.items() if "policy" in command.files}
    assert taking == {*TAKES, "certify"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    task = stl.load_task(PATROLLING, {"T": "5", "tau": "5"})
    product = stl.build_product(stl.load_model(task.model), task)
    made = tmp_path_factory.mktemp("policies")
    for kind in ("npz", "policy", "csv", "json"):
        stl.check(product).policy.save(made / f"p.{kind}")
    (made / "bare.csv").write_text(
        "".join(line for line in (made / "p.csv").read_text().splitlines(keepends=True) if not line.startswith("#"))
    )
    return made


def told(text):
    """Without the name of the file, and seconds."""
    return re.sub(r'"seconds": [\d.e-]+|(p|bare)\.(npz|policy|csv|json)|\b[\d.]+ s\b', "#", text)


@pytest.mark.parametrize("name", TAKES)
def test_a_policy_is_the_same_from_every_file(stltool, folder, name, monkeypatch):
    monkeypatch.chdir(folder)
    found = {}
    for path in sorted(Path().iterdir()):
        code, out, err = stltool(name, PATROLLING, *SMALL, "--policy", path, *TAKES[name])
        assert (code, err) == (0, "")
        found[path.name] = told(out)
    assert len(found) == 5
    assert len(set(found.values())) == 1


def test_expectations_name_policies_as_text(stltool, folder):
    for name in ("p.csv", "p.json", "bare.csv"):
        task = folder.parent / f"{name}.stl"
        text = (FACTORY / "patrolling.stl").read_text().replace("T = 10, tau = 10", "T = 5, tau = 5")
        text = text.replace('"floor-5x5.toml"', f'"{FACTORY}/floor-5x5.toml"')
        task.write_text(f'{text}expect P(patrolling, policy "{folder}/{name}") >= 0.7379\n')
        code, out, err = stltool("verify", task, "--json")
        assert (code, err) == (0, "")
        assert json.loads(out)["expectations"][0]["verdict"] == "holds"
