"""PRISM's explicit files: what they mean, and what is refused."""

import time
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.errors import FileError, ModelError, NameLookupError
from tests import oracles

TRA = "3 4 6\n0 0 1 2/5 go\n0 0 2 3/5 go\n0 1 0 1 wait\n1 0 1 0.25\n1 0 2 0.75\n2 0 2 1\n"
LAB = '0="init" 1="deadlock" 2="done"\n0: 0\n2: 1 2\n'
STA = "(x,up)\n0:(0,true)\n1:(-3,false)\n2:(7,true)\n"


def write(folder, tra=TRA, lab=LAB, sta=STA):
    for ending, text in (("tra", tra), ("lab", lab), ("sta", sta)):
        (folder / f"m.{ending}").unlink(missing_ok=True)
        if text is not None:
            (folder / f"m.{ending}").write_text(text, encoding="utf-8")
    return folder / "m.tra"


def test_everything_that_the_files_say(tmp_path):
    model = stl.load_model(write(tmp_path))
    assert (model.n_states, model.n_choices, model.n_transitions, model.name) == (3, 4, 6, "m")
    assert model.action_names == ("go", "wait", "0")
    assert [model.action_names[a] for a in model.choice_action] == ["go", "wait", "0", "0"]
    assert oracles.choices(model, 0) == [[(1, Fraction(2, 5)), (2, Fraction(3, 5))], [(0, Fraction(1))]]
    assert oracles.choices(model, 1) == [[(1, Fraction(1, 4)), (2, Fraction(3, 4))]]
    assert (model.exact().denominator, oracles.initial(model)) == (20, [(0, Fraction(1))])
    assert {name: values.tolist() for name, values in model.labels.items()} == {
        "init": [True, False, False], "deadlock": [False, False, True], "done": [False, False, True],
    }  # fmt: skip
    assert {name: values.tolist() for name, values in model.signals.items()} == {"x": [0, -3, 7], "up": [1, 0, 1]}
    assert [model.state_name(s) for s in range(3)] == ["x=0, up=true", "x=-3, up=false", "x=7, up=true"]
    product = stl.build_product(model, stl.parse("F[0,2] (done & x > 6 & up > 0)"))
    assert stl.check(product, exact=True).fraction == Fraction(3, 5) + Fraction(2, 5) * Fraction(3, 4)


def test_transitions_alone_are_enough(tmp_path):
    model = stl.load_model(write(tmp_path, lab=None, sta=None))
    assert (dict(model.labels), dict(model.signals), model.state_name(2)) == ({}, {}, "2")
    assert int(model.initial.argmax()) == 0


def test_chains_and_repeated_actions(tmp_path):
    chain = stl.load_model(write(tmp_path, tra="2 3\n0 0 1/3\n0 1 2/3\n1 1 1\n", lab='0="init"\n1: 0\n', sta=None))
    assert (chain.n_choices, chain.action_names, int(chain.initial.argmax())) == (2, ("0",), 1)
    twice = stl.load_model(write(tmp_path, tra="1 2 2\n0 0 0 1 go\n0 1 0 1 go\n", lab=None, sta=None))
    assert twice.action_names == ("go", "go#2")
    tra = "1 3 3\n0 0 0 1 a#2\n0 1 0 1 a\n0 2 0 1 a\n"
    assert stl.load_model(write(tmp_path, tra=tra, lab=None, sta=None)).action_names == ("a#2", "a", "a#3")


def test_choices_are_numbered_as_in_the_file(tmp_path):
    model = stl.load_model(write(tmp_path, tra="2 3 3\n0 1 1 1 late\n0 0 0 1 early\n1 0 1 1\n", lab=None, sta=None))
    assert [model.action_names[a] for a in model.choice_action[:2]] == ["early", "late"]


def test_rounded_decimals_load_with_a_defect(tmp_path):
    tra = "3 3 5\n0 0 0 0.3333333333\n0 0 1 0.3333333333\n0 0 2 0.3333333333\n1 0 1 1\n2 0 2 1\n"
    model = stl.load_model(write(tmp_path, tra=tra, lab=None, sta=None))
    assert model.exact().defects(model.row_start) == (Fraction(1, 10**10), 0)
    product = stl.build_product(stl.load_model(write(tmp_path, tra=tra)), stl.parse("F[0,1] done"))
    result = stl.check(product)
    assert result.lower < Fraction(1, 3) < result.upper
    with pytest.raises(ModelError, match=r"state x=0, up=true, action 0: the probabilities sum to 1 − 1e-10"):
        stl.check(product, exact=True)


@pytest.mark.parametrize(
    ("files", "says"),
    [
        ({"tra": "mpd\n0 0 0 1\n"}, r"m.tra, line 1: 'mpd': write \"states choices transitions\""),
        ({"tra": ""}, r"m.tra, line 1: '': write"),
        (
            {"tra": "3 4 6\n0 0 1 2:5\n"},
            r"line 2: '0 0 1 2:5': '2:5' is not a number; write .state choice successor probability \[action\]",
        ),
        ({"tra": "2 2\n0 1 2 3 4\n"}, r"line 2: .*write \"state successor probability\""),
        ({"tra": "1 1 1\n0 0 1 1\n"}, r"line 2: '0 0 1 1': states are 0 … 0 by the first line"),
        ({"tra": "1 1 1\n0 0 0 6/5\n"}, r"line 2: .*6/5 is not a probability"),
        ({"tra": "1 1 1\n0 0 0 1/0\n"}, r"line 2: .*a decimal or a fraction such as 2/5"),
        ({"tra": "1 1 2\n0 0 0 1/2\n0 0 0 1/2\n"}, r"line 3: .*this successor of the choice appears twice"),
        ({"tra": "1 1 2\n0 0 0 1\n"}, "1 transitions, but the first line announces 2; is the file cut off"),
        ({"tra": "1 2 1\n0 0 0 1\n"}, "1 choices, but the first line announces 2"),
        (
            {"tra": "2 2 3\n0 0 0 1/2 a\n0 0 1 1/2 b\n1 0 1 1\n"},
            "line 3: .*this choice has the action a in line 2",
        ),
        ({"tra": "1 1 1\n0 0 0 0\n"}, "state 0, choice 0: the probabilities sum to 0, not 1"),
        ({"tra": "1 1 1\n0 0 0 1/2\n", "lab": None}, "m.tra, line 2: state 0, choice 0: .* sum to 0.5, not 1"),
        ({"lab": "init: 0\n"}, r'm.lab, line 1: .*write 0="init" 1="deadlock"'),
        ({"lab": '0="init" 1="init"\n'}, "line 1: .*two labels have the same name"),
        ({"lab": '0="init" 1="A" 1="B"\n'}, "line 1: .*two labels have the same name or number"),
        ({"lab": '0="done"\n'}, 'line 1: .*mark the state that runs start in: 0="init"'),
        ({"lab": '0="init"\n0: 0\n1_0: 0\n'}, "line 3: .*write"),
        ({"tra": "1 1 1\n0 0 +0 1\n"}, "line 2: .*write"),
        ({"tra": "1 1 1\n0 0 \u0660 1\n"}, "line 2: .*write"),
        ({"sta": "(x)\n0:(1_0)\n"}, "m.sta, line 2: .*write"),
        ({"sta": "(x)\n0:(1)\n0:(2)\n"}, "m.sta, line 3: .*state 0 appears twice"),
        ({"lab": '0="init"\n0: 1\n'}, r'line 2: .*write "state: number number …", states 0 … 2'),
        (
            {"lab": '0="init"\n0: 0\n1: 0\n'},
            r"m.lab: 2 initial states are marked \(x=0, up=true; x=-3, up=false\), and the format has no probabilities",
        ),
        ({"lab": '0="init"\n'}, "m.lab: no initial state is marked; mark the one that runs start in"),
        ({"lab": '0="init" 1="x"\n0: 0\n'}, "m.lab: the label x is also a variable in the .sta file; rename it"),
        ({"sta": "x,y\n0:(1,2)\n"}, r"m.sta, line 1: .*write the variables' names, such as \(x,y\)"),
        ({"sta": "(x)\n0:(1,2)\n"}, r'm.sta, line 2: .*write "state:\(x\)" with numbers, true or false'),
        ({"sta": "(x)\n0:(1)\n"}, "m.sta: state 1 is missing"),
    ],
)  # fmt: skip
def test_bad_files_are_refused_with_the_line(tmp_path, files, says):
    with pytest.raises(ModelError, match=says):
        stl.load_model(write(tmp_path, **files))


def test_all_faults_of_the_three_files_are_told_at_once(tmp_path):
    path = write(
        tmp_path,
        tra="3 4 7\n0 0 1 2:5 go\n0 0 2 3/5 go\n0 0 2 2/5 go\n0 1 0 0.9 wait\n1 0 9 0.25\n1 0 1 7/5\n2 0 2 0.5\n",
        lab='0="init" 1="done"\n0: 0\n2: 7\n1_0: 1\n',
        sta="(x,up)\n0:(0,true)\n0:(1,true)\n1:(one,true)\n",
    )
    with pytest.raises(ModelError) as caught:
        stl.load_model(path)
    told = str(caught.value).replace(str(path.with_suffix("")), "M").splitlines()
    form = 'write "state choice successor probability [action]" with a decimal or a fraction such as 2/5, or [0.6,0.9]'
    assert told == [
        f"M.tra, line 2: '0 0 1 2:5 go': '2:5' is not a number; {form}",
        "M.tra, line 4: '0 0 2 2/5 go': this successor of the choice appears twice; add the two probabilities",
        "M.tra, line 6: '1 0 9 0.25': states are 0 … 2 by the first line",
        "M.tra, line 7: '1 0 1 7/5': 7/5 is not a probability",
        "M.lab, line 3: '2: 7': write \"state: number number …\", states 0 … 2, numbers of the first line",
        "M.lab, line 4: '1_0: 1': write \"state: number number …\", states 0 … 2, numbers of the first line",
        "M.sta, line 3: '0:(1,true)': state 0 appears twice",
        "M.sta, line 4: '1:(one,true)': 'one' is not a number; write \"state:(x,up)\" with numbers, true or false",
        "M.tra, line 5: state 0, choice 1: the probabilities sum to 0.9, not 1",
        "M.tra, line 8: state 2, choice 0: the probabilities sum to 0.5, not 1",
        "10 errors",
    ]


@pytest.mark.soak(only=True)
def test_many_faults_are_counted_in_linear_time(tmp_path):
    n = 100_000
    path = write(tmp_path, tra=f"1 1 {n}\n" + "0 0 x 1\n" * n, lab=None, sta=None)
    started = time.perf_counter()
    with pytest.raises(ModelError, match=r"(.*\n){20}100000 errors; the first 20 are shown$"):
        stl.load_model(path)
    assert time.perf_counter() - started < 20  # seconds


def test_a_missing_label_file_is_told_where_a_label_is_missed(tmp_path):
    path = write(tmp_path, lab=None, sta=None)
    model = stl.load_model(path)
    assert model.notes == {
        "label": "there is no m.lab next to m.tra: the model has no labels, and runs start in state 0",
        "signal": "there is no m.sta next to m.tra: the model has no signals, and its states have only numbers",
    }
    with pytest.raises(
        NameLookupError, match="the model has no label done; .*; there is no m.lab next to m.tra: the mod"
    ):
        stl.build_product(model, stl.parse("F[0,2] done"))
    with pytest.raises(NameLookupError, match="the model has no signal x; .*; there is no m.sta next to m.tra"):
        stl.build_product(model, stl.parse("F[0,2] x > 0"))
    assert stl.load_model(write(tmp_path)).notes == {}


def test_missing_and_enormous_files(tmp_path):
    with pytest.raises(FileError, match="there is no such transition file"):
        stl.load_model(tmp_path / "none.tra")
    with pytest.raises(stl.StlToolError, match="reading 1000000000000 transitions"):
        stl.load_model(write(tmp_path, tra="5 5 1000000000000\n"))


def test_arrays_of_fractions_and_texts():
    half = Fraction(1, 2)
    model = stl.MDP.from_arrays([[[half, half], [0, 1]], [["0.25", "3/4"], ["0", "0"]]], {"x": [0, 1]}, ["1/3", "2/3"])
    assert oracles.choices(model, 0) == [[(0, half), (1, half)], [(0, Fraction(1, 4)), (1, Fraction(3, 4))]]
    assert oracles.initial(model) == [(0, Fraction(1, 3)), (1, Fraction(2, 3))]
    assert model.probability.tolist() == [0.5, 0.5, 0.25, 0.75, 1.0]
    for bad in ("one", "1/0", "1_0", "9" * 1001, "1e400", None, 1j):
        with pytest.raises(ModelError, match="transitions of action 0 are not numbers"):
            stl.MDP.from_arrays([[[bad, half], [0, 1]]], {"x": [0, 1]})
        with pytest.raises(ModelError, match="initial distribution does not contain numbers"):
            stl.MDP.from_arrays([np.eye(2)], {"x": [0, 1]}, initial=[bad, half])
