"""`stltool convert`: the same model in every format, and files of others stay."""

import json
import os
from unittest import mock

import pytest

import stltool as stl
from stltool.files import write_results
from tests.conftest import FACTORY

ENDINGS = [".umb", ".drn", ".tra", ".drn.gz", ".tra.gz"]
COIN = """@type: DTMC
@value_type: rational
@parameters
p
@reward_models
toll
@nr_states
2
@nr_choices
2
@model
state 0 [1/3] init
	action go [0]
		0 : 1-p
		1 : p
state 1 [0] done
	action go [2]
		1 : 1
"""


@pytest.fixture
def coin(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "coin.drn").write_text(COIN)
    return tmp_path


def test_a_grid_in_every_format_and_back(stltool, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = FACTORY / "floor-5x5.toml"
    for ending in ENDINGS:
        name = f"{ending.count('g')}{ending}"
        code, out, _ = stltool("convert", before, name, "--json")
        assert code == 0
        data = json.loads(out)
        assert name in data["files"]
        assert (data["states"], data["choices"], data["transitions"], data["exact"]) == (18, 162, 372, True)
        before = name
    grid, last, named = (stl.load_model(file) for file in (FACTORY / "floor-5x5.toml", before, "0.drn"))
    assert list(named.state_names) == list(grid.state_names)  # which .tra files do not have
    assert last.action_names == grid.action_names
    for key in ("numerator", "initial"):
        assert getattr(last.exact(), key).tolist() == getattr(grid.exact(), key).tolist()
    assert {name: values.tolist() for name, values in last.signals.items()} == {
        name: values.tolist() for name, values in grid.signals.items()
    }


def test_parameters_need_values(stltool, coin):
    code, _, refused = stltool("convert", "coin.drn", "coin.umb")
    assert code == 2
    assert "coin depends on p, which .umb files do not represent; give a value" in refused
    assert not (coin / "coin.umb").exists()
    stltool("convert", "coin.drn", "coin.umb", "-p", "p=1/3")
    model = stl.load_model(coin / "coin.umb")
    assert model.exact().denominator == 3
    assert (
        model.costs["toll"].parts["states"].exact[0]
        == stl.check(stl.build_product(model, stl.parse("F[0,1] done")), exact=True).fraction
    )


@pytest.mark.parametrize("target", ["coin.tra", "coin.umb", "other.drn", "coin.lab"])
def test_files_of_others_stay(stltool, coin, target):
    (coin / target).write_text("mine")
    wanted = "coin.tra" if target.endswith((".tra", ".lab")) else target
    code, _, refused = stltool("convert", "coin.drn", wanted, "-p", "p=0.5")
    assert code == 2
    assert f"{target}: this file does not contain a model that stltool wrote, and would be lost" in refused
    assert (coin / target).read_text() == "mine"
    assert sorted(os.listdir(coin)) == sorted(["coin.drn", target])


def test_the_input_stays(stltool, coin):
    code, _, refused = stltool("convert", "coin.drn", "coin.drn")
    assert code == 2
    assert "OUT: coin.drn would replace the model file" in refused
    assert (coin / "coin.drn").read_text() == COIN


def test_what_is_written(stltool, coin):
    stltool("convert", "coin.drn", "coin.tra", "-p", "p=0.5")
    assert {name: (coin / name).read_text() for name in os.listdir(coin) if name != "coin.drn"} == {
        "coin.tra": "# Generator: stltool\n# Transitions (DTMC)\n2 3\n0 0 0.5 go\n0 1 0.5 go\n1 1 1 go\n",
        "coin.lab": '# Generator: stltool\n# Labels\n0="init" 1="done"\n0: 0\n1: 1\n',
        "coin.srew": '# Generator: stltool\n# Reward structure "toll"\n# State rewards\n2 1\n0 1/3\n',
        "coin.trew": '# Generator: stltool\n# Reward structure "toll"\n# Transition rewards\n2 1\n1 1 2\n',
    }
    code, _, refused = stltool("convert", "coin.drn", "coin.tra.gz", "-p", "p=0.5")
    assert code == 2
    assert "coin.tra next to it would be read with the same labels" in refused


def test_files_of_an_older_model_do_not_stay_next_to_a_new_one(stltool, coin):
    stltool("convert", "coin.drn", "coin.tra", "-p", "p=0.5")
    (coin / "plain.drn").write_text(
        COIN.replace("\ntoll", "\n").replace("[1/3] ", "").replace(" [0]", "").replace(" [2]", "")
    )
    stltool("convert", "plain.drn", "coin.tra", "-p", "p=0.5")
    assert sorted(os.listdir(coin)) == ["coin.drn", "coin.lab", "coin.tra", "plain.drn"]


def test_all_files_are_written_or_none(coin):
    """Also if the second of them cannot be moved into place."""
    old = {coin / name: f"Generator: stltool {name}".encode() for name in ("a", "b", "gone")}
    for path, content in old.items():
        path.write_bytes(content)
    moved, replace = [], os.replace

    def failing(source, target):
        moved.append(target)
        if len(moved) == 4:  # a is kept and replaced, b kept, and then
            raise OSError(28, "No space left on device")
        replace(source, target)

    new = {coin / "a": b"1", coin / "b": b"2", coin / "gone": None, coin / "c": b"3"}
    with mock.patch("os.replace", failing), pytest.raises(stl.errors.FileError, match="No space left on device"):
        write_results(new, "model")
    assert {path.name for path in coin.iterdir()} == {"a", "b", "gone", "coin.drn"}
    assert {path: path.read_bytes() for path in old} == old
    write_results(new, "model")
    assert {path.name: path.read_bytes() for path in coin.iterdir() if path.suffix == ""} == {
        "a": b"1",
        "b": b"2",
        "c": b"3",
    }


def test_a_start_is_chosen_for_formats_with_one(stltool, coin):
    (coin / "two.drn").write_text(COIN.replace("done", "done init"))
    code, _, refused = stltool("convert", "two.drn", "two.umb", "-p", "p=0.5", "--initial", "uniform")
    assert code == 2
    assert "runs of two start in 2 states, and .umb files have one initial state" in refused
    assert stltool("convert", "two.drn", "two.umb", "-p", "p=0.5", "--initial", "1")[0] == 0
    model = stl.load_model(coin / "two.umb")
    assert model.initial.tolist() == model.labels["init"].tolist() == [0, 1]


def test_an_unknown_extension(stltool, coin):
    code, _, refused = stltool("convert", "coin.drn", "coin.xyz")
    assert code == 2
    assert "models cannot be written with the extension '.xyz'; write one of .tra, .tra.gz, .umb, .drn" in refused


def test_what_a_format_does_not_keep_is_reported(stltool, coin):
    _, _, noted = stltool("convert", FACTORY / "floor-5x5.toml", "floor.tra")
    assert noted == "note: floor.tra does not keep the names of its states, which PRISM's files do not have\n"
