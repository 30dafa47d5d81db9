"""Explicit files as PRISM and Storm write them today: comments, kinds, rows, rewards, several starts, packed files."""

import gzip
import random
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.errors import FileError, ModelError, SettingsError, SizeError
from stltool.models.formats import explicit, lines
from stltool.models.load import companions
from tests import oracles
from tests.conftest import OUTSIDE, many

PRISM = OUTSIDE / "prism"


@pytest.fixture(params=["line by line", "kernel"])
def reader(request, monkeypatch):
    large = 0 if request.param == "kernel" else 1 << 60
    monkeypatch.setattr(lines, "LARGE", large)
    monkeypatch.setattr(explicit, "LARGE", large)


def write(folder, **files):
    for ending, text in files.items():
        (folder / f"m.{ending}").write_text(text, encoding="utf-8")
    return folder / "m.tra"


def rows(model):
    """state → action → successor → probability, exactly."""
    found = {}
    for s in range(model.n_states):
        actions = model.choice_action[model.choice_start[s] : model.choice_start[s + 1]]
        found[s] = {model.action_names[a]: dict(row) for a, row in zip(actions, oracles.choices(model, s), strict=True)}
    return found


def numbers(amounts):
    return [amounts.exact[k] for k in range(len(amounts))]


ROBOT = """# Transitions (MDP)
# by hand

3 4 6
0 0 0 2/5 east
# in between
0 0 1 3/5 east
\t0  1 1 1E-1 south\r
0 1 2 0.9 south
1 0 2 1.0 stuck
2 0 2 1 stuck
"""
TRUE_ROWS = {
    0: {"east": {0: Fraction(2, 5), 1: Fraction(3, 5)}, "south": {1: Fraction(1, 10), 2: Fraction(9, 10)}},
    1: {"stuck": {2: 1}},
    2: {"stuck": {2: 1}},
}


@pytest.mark.usefixtures("reader")
class TestForms:
    def test_comments_are_anywhere(self, tmp_path):
        model = stl.load_model(
            write(
                tmp_path,
                tra=ROBOT,
                lab='# Labels\n0="init" 1="at goal, or=near?" 2=""\n# more\n0: 0\n\n2: 1 2\n',
                sta="# States\n(s,up)\n0:(0,true)\n# more\n1:(-1,false)\n2:(2,true)\n",
            )
        )
        assert rows(model) == TRUE_ROWS
        assert model.labels["at goal, or=near?"].tolist() == [False, False, True] == model.labels[""].tolist()
        assert [model.state_name(s) for s in range(3)] == ["s=0, up=true", "s=-1, up=false", "s=2, up=true"]
        assert model.exact().denominator == 10

    def test_rows(self, tmp_path):
        tra = "3 4 6\n0 2/5:0 3/5:1 east\n0 1E-1:1 0.9:2 south\n1 1.0:2 stuck\n2 1:2 stuck\n"
        model = stl.load_model(write(tmp_path, tra=tra, trew="3 4 3\n0 1:0 2:1\n0\n1 3.5:2\n2\n"))
        assert rows(model) == TRUE_ROWS
        assert numbers(model.costs["reward"].transitions) == [1, 2, 0, 0, Fraction(7, 2), 0]
        chain = stl.load_model(write(tmp_path, tra="2 3\n0 1/3:0 2/3:1\n1 1:1\n", trew="2 1\n0 5:1\n1\n"))
        assert rows(chain)[0] == {"0": {0: Fraction(1, 3), 1: Fraction(2, 3)}}
        assert numbers(chain.costs["reward"].transitions) == [0, 5, 0]
        blurred = stl.load_model(write(tmp_path, tra="1 1 1\n0 [0.5,1]:0 go\n", trew="1 1 0\n0\n"))
        assert (blurred.intervals.lower.tolist(), blurred.intervals.upper.tolist()) == ([0.5], [1])

    def test_rows_and_lines_of_rewards_fit_each_other(self, tmp_path):
        tra = "1 2 2\n0 3 0 1 a\n0 7 0 1 b\n"  # choices 3 and 7 are the first and the second row
        model = stl.load_model(write(tmp_path, tra=tra, trew="1 2 2\n0 1:0\n0 2:0\n"))
        assert numbers(model.costs["reward"].choices) == [1, 2]
        model = stl.load_model(write(tmp_path, tra=tra, trew="1 2 2\n0 7 0 2\n0 3 0 1\n"))
        assert numbers(model.costs["reward"].choices) == [1, 2]

    def test_rewards_that_are_the_same_along_a_choice_are_its_own(self, tmp_path):
        """As PRISM writes rewards of actions: once for each transition."""
        tra = "2 3 5\n0 0 0 1/3 a\n0 0 1 2/3 a\n0 1 1 1 b\n1 0 0 1/2\n1 0 1 1/2\n"
        header = "2 3 3\n0 0 0 1/3\n0 0 1 "
        cost = stl.load_model(write(tmp_path, tra=tra, trew=f"{header}1/3\n0 1 1 4\n")).costs["reward"]
        assert (list(cost.parts), numbers(cost.choices)) == (["choices"], [Fraction(1, 3), 4, 0])
        cost = stl.load_model(write(tmp_path, tra=tra, trew=f"{header}0.3333333333333333333\n0 1 1 4\n")).costs[
            "reward"
        ]
        assert list(cost.parts) == ["transitions"]  # the same double, another number
        cost = stl.load_model(write(tmp_path, tra=tra, trew="2 3 1\n1 0 1 2\n")).costs["reward"]
        assert (list(cost.parts), numbers(cost.transitions)) == (["transitions"], [0, 0, 0, 0, 2])

    def test_actions_in_chains(self, tmp_path):
        tra = "# Transitions (DTMC)\n3 6\n0 1 1/2 go\n0 2 1/2 go\n1 1 1/4 go\n1 1 1/2 stay\n1 2 1/4 go\n2 2 1\n"
        model = stl.load_model(write(tmp_path, tra=tra))
        half = Fraction(1, 2)
        assert rows(model) == {
            0: {"go": {1: half, 2: half}},
            1: {"0": {1: 3 * half / 2, 2: half / 2}},
            2: {"0": {2: 1}},
        }
        with pytest.raises(ModelError, match="line 3: .*this successor of the choice appears twice"):
            stl.load_model(write(tmp_path, tra="1 2\n0 0 1/2 go\n0 0 1/2 go\n"))

    def test_states_without_transitions_stay(self, tmp_path):
        path = write(tmp_path, tra="4 1 2\n1 0 0 1/2 go\n1 0 1 1/2 go\n", lab='0="init" 1="deadlock"\n1: 0\n0: 1\n')
        model = stl.load_model(path)
        assert rows(model) == {0: {"0": {0: 1}}, 1: {"go": {0: Fraction(1, 2), 1: Fraction(1, 2)}},
                               2: {"0": {2: 1}}, 3: {"0": {3: 1}}}  # fmt: skip
        assert model.notes["deadlocks"] == "states without transitions stay where they are, as in PRISM: 0, 2, 3"
        assert model.labels["deadlock"].tolist() == [True, False, False, False]
        with pytest.raises(ModelError, match="m.tra: state 0 has no action; give it one that stays(.*\n){3}3 errors"):
            stl.load_model(path, deadlocks="error")
        assert "deadlocks" not in stl.load_model(write(tmp_path, tra="1 1\n0 0 1\n", lab='0="init"\n0: 0\n')).notes
        blurred = stl.load_model(write(tmp_path, tra="2 1 1\n0 0 1 [0.5,1]\n", lab='0="init"\n0: 0\n'))
        assert (blurred.intervals.lower.tolist(), blurred.intervals.upper.tolist()) == ([0.5, 1], [1, 1])

    def test_several_initial_states_are_asked_for(self, tmp_path):
        path = write(
            tmp_path,
            tra="3 3\n0 2 1\n1 1 1\n2 2 1\n",
            lab='0="init" 1="goal"\n0: 0\n1: 0\n2: 1\n',
            sta="(x,y)\n0:(0,1)\n1:(1,1)\n2:(2,1)\n",
        )
        says = (
            r"m.lab: 2 initial states are marked \(x=0, y=1; x=1, y=1\), and the format has no probabilities for them; "
        )
        with pytest.raises(ModelError, match=says + "choose one with initial=NAME, or initial=uniform for each"):
            stl.load_model(path)
        task = stl.parse("F[0,2] goal")
        for initial, share in (("uniform", Fraction(1, 2)), ("x=0, y=1", 1), ("x=1,y=1", 0), (1, 0), ("2", 1)):
            model = stl.load_model(path, initial=initial)
            assert stl.check(stl.build_product(model, task), exact=True).fraction == share
        with pytest.raises(ModelError, match=r"there is no initial state 'x=3, y=1'; states are 0 … 2; .*x=1, y=1"):
            stl.load_model(path, initial="x=3, y=1")
        with pytest.raises(ModelError, match=r"there is no initial state '9{40}…'; states are 0 … 2"):
            stl.load_model(path, initial="9" * 5000)
        (tmp_path / "m.lab").write_text('0="goal"\n2: 0\n')  # nothing is marked, and nothing needs to be
        assert stl.load_model(path, initial=2).initial.tolist() == [0, 0, 1]
        with pytest.raises(ModelError, match='mark the state that runs start in: 0="init"'):
            stl.load_model(path, initial="uniform")

    def test_storms_files(self, tmp_path):
        path = write(
            tmp_path,
            tra="MDP\n0 0 1 2/5\n0 0 2 3/5 \n0 1 1 0.0\n0 1 0 1 wait\n1 0 2 1\n",
            lab="#DECLARATION\ninit goal\nfar\n#END\n0 init\n2 goal far\n",
            srew="0 1.5\n2 1/3\n",
            trew="0 0 2 4\n0 1 1 9\n",
        )
        model = stl.load_model(path)
        assert rows(model) == {
            0: {"0": {1: Fraction(2, 5), 2: Fraction(3, 5)}, "wait": {0: 1}}, 1: {"0": {2: 1}}, 2: {"0": {2: 1}},
        }  # fmt: skip
        assert {name: np.flatnonzero(label).tolist() for name, label in model.labels.items()} == {
            "init": [0], "goal": [2], "far": [2],
        }  # fmt: skip
        assert numbers(model.costs["reward"].states) == [Fraction(3, 2), 0, Fraction(1, 3)]
        assert numbers(model.costs["reward"].transitions) == [0, 4, 0, 0, 0]
        (tmp_path / "m.lab").unlink()
        chain = stl.load_model(write(tmp_path, tra="dtmc\n\n0 1 1\n1 1 1\n", trew="0 1 2\n", srew=""))
        assert (chain.n_states, numbers(chain.costs["reward"].choices)) == (2, [2, 0])

    def test_rewards_are_costs_by_name(self, tmp_path):
        files = {
            "m.tra": ROBOT,
            "m1.srew": '# Reward structure "time"\n# State rewards\n3 2\n0 1\n2 -1/3\n',
            "m1.trew": '# Reward structure "time"\n# Transition rewards\n3 4 1\n0 1 2 1E-3\n',
            "m2.trew": "# Reward structure\n# Transition rewards\n3 4 0\n",
            "m3.srew": '# Reward structure "time"\n3 0\n',
            "mm.srew": "of another model",
            "m4.tra": "",  # so m4.srew is not of m.tra
            "m4.srew": "",
        }
        for name, text in files.items():
            (tmp_path / name).write_text(text)
        model = stl.load_model(tmp_path / "m.tra")
        assert list(model.costs) == ["time", "reward2", "time#3"]
        assert numbers(model.costs["time"].states) == [1, 0, Fraction(-1, 3)]
        assert numbers(model.costs["time"].transitions) == [0, 0, 0, Fraction(1, 1000), 0, 0]
        assert [path.name for path in companions(tmp_path / "m.tra")] == ["m1.srew", "m1.trew", "m2.trew", "m3.srew"]

    def test_packed_files(self, tmp_path):
        files = {"m.tra.gz": ROBOT, "m.lab.gz": '0="init"\n1: 0\n', "m.sta.gz": "(s)\n0:(0)\n1:(4)\n2:(9)\n",
                 "m.srew.gz": '3 1\n1 7\n'}  # fmt: skip
        for name, text in files.items():
            (tmp_path / name).write_bytes(gzip.compress(text.encode()))
        model = stl.load_model(tmp_path / "m.tra.gz")
        assert (rows(model), model.name, model.initial.tolist()) == (TRUE_ROWS, "m", [0, 1, 0])
        assert (model.signals["s"].tolist(), numbers(model.costs["reward"].states)) == ([0, 4, 9], [0, 7, 0])
        assert len(companions(tmp_path / "m.tra.gz")) == 3

    def test_numbers_of_all_lengths_are_exact(self, tmp_path):
        texts = [
            "0.080645161290322580645161290322581", "123456789012345678901/1000000000000000000000000", "1e-30", "1E-18",
            "0.10", ".5e-2", "+0.001", "00.25", "2.5E-1", "1e-300", "0.99999999999999999999999e-1", "1/7",
        ]  # fmt: skip
        rest = 1 - sum(Fraction(text) for text in texts)
        n = len(texts)
        lines = [f"0 {k} {text}" for k, text in enumerate([*texts, f"{rest.numerator}/{rest.denominator}"], start=1)]
        lines += [f"{k} {k} 1" for k in range(1, n + 2)]
        model = stl.load_model(write(tmp_path, tra=f"{n + 2} {len(lines)}\n" + "\n".join(lines)))
        share = model.exact()
        found = [Fraction(int(share.numerator[k]), share.denominator) for k in range(n + 1)]
        assert found == [*map(Fraction, texts), rest]
        assert model.probability[: n + 1].tolist() == [float(value) for value in found]
        assert share.defects(model.row_start) == (0, 0)

    @pytest.mark.parametrize(
        ("files", "says"),
        [
            ({"tra": "# Transitions (CTMC)\n1 1\n0 0 2.5\n"}, "m.tra, line 1: this is a CTMC: its numbers are rates"),
            ({"tra": "# Transitions (POMDP)\n1 1 1 1\n"}, "m.tra, line 1: this is a POMDP: its states are observed in"),
            ({"tra": "# a\n# Transitions (LTS)\n1 1 1\n0 0 0\n"}, "m.tra, line 2: this is a LTS: its transitions"),
            ({"tra": "# Transitions (FOO)\n1 1\n0 0 1\n"}, "this is a FOO: stltool reads DTMC, MDP, IDTMC and IMDP"),
            ({"tra": "2 2 2 2\n0 0 0 1 0\n"}, "m.tra, line 1: this is a POMDP"),
            ({"tra": "2 2 2\n0 0 1\n1 0 1\n"}, "m.tra, line 2: this is a LTS"),
            ({"tra": "2 2 2\n0 0 1 go\n1 0 1 go\n"}, "m.tra, line 2: this is a LTS"),
            ({"tra": "ctmc\n0 0 3\n"}, "m.tra, line 1: this is a CTMC"),
            ({"tra": "1 1\n0 0 3\n"}, "line 2: '0 0 3': 3 is not a probability; rates, those of a CTMC, are not read"),
            ({"tra": "# Transitions (MDP)\n1 1\n0 0 1\n"}, 'line 2: .*this MDP begins with "states choices tr'),
            ({"tra": "0 0\n"}, "m.tra, line 1: '0 0': write \"states choices transitions\""),
            ({"tra": "1 1\n0 0 nan\n"}, "line 2: '0 0 nan': 'nan' is not a finite number"),
            ({"tra": "1 1\n0 0 -0.5\n"}, "line 2: '0 0 -0.5': -0.5 is not a probability"),
            ({"tra": "1 1\n0 0 1e-400\n"}, "line 2: .*'1e-400' is too small for a double; write 0"),
            ({"tra": "1 2\n0 1:0\n0 1:0 a b\n"}, 'line 3: .*write "state probability:successor'),
            ({"tra": "1 1\n0 0.5:1 0.5:0\n"}, "line 2: .*states are 0 … 0 by the first line"),
            ({"tra": "1 1 1\n0 0.5:0 0.5:0 a\n"}, "line 2: .*this successor of the choice appears twice"),
            ({"tra": "1 1 1\n0 9 0 0.5\n"}, "m.tra, line 2: state 0, choice 9: the probabilities sum to 0.5, not 1"),
            ({"lab": "#DECLARATION\ninit\n0 init\n"}, "m.lab: #END is missing"),
            ({"lab": "#DECLARATION\ngoal\n#END\n"}, "m.lab: there is no label init"),
            ({"lab": "#DECLARATION\ninit\n#END\n0 init\n9 init\n1 foo\n"}, 'line 5: .*write "state (.*\n)*.*line 6'),
            ({"srew": "3 1\n0 1\n1 1\n"}, "m.srew: 2 rewards, but the first line announces 1; correct it"),
            ({"srew": "3 2\n0 1\n"}, "m.srew: 1 rewards, but the first line announces 2; is the file cut off"),
            ({"srew": "3 2\n0 1\n0 1\n"}, "m.srew, line 3: '0 1': this state appears twice; add the two rewards"),
            ({"srew": "9 1\n0 1\n"}, 'm.srew, line 1: .*write "states lines", of the 3 states of the .tra'),
            ({"srew": "3 1\n0 inf\n"}, "m.srew, line 2: .*'inf' is not a finite number"),
            ({"srew": "3 1\n0 1 1\n"}, 'm.srew, line 2: .*write "state reward"'),
            ({"srew": "3 1\n7 1\n"}, "m.srew, line 2: .*states are 0 … 2 by the first line"),
            ({"trew": "3 4 1\n0 0 2 1\n"}, "m.trew, line 2: '0 0 2 1': the model has no such transition"),
            ({"trew": "3 4 1\n2 5 2 1\n"}, "m.trew, line 2: '2 5 2 1': the model has no such transition"),
            ({"trew": "3 4 2\n2 0 2 1\n2 0 2 1\n"}, "m.trew, line 3: .*this transition appears twice"),
            ({"trew": "3 1\n0 0 1\n"}, 'm.trew, line 1: .*write "states choices lines"'),
        ],
    )  # fmt: skip
    def test_faults_are_told_with_their_line(self, tmp_path, files, says):
        with pytest.raises(ModelError, match=says):
            stl.load_model(write(tmp_path, **{"tra": ROBOT, **files}))

    def test_bytes_that_are_no_text(self, tmp_path):
        path = write(tmp_path, tra=ROBOT)
        for bad, says in (
            (b"1 0 2 1.0 st\xffck", "byte 12 .0xff. is not UTF-8 text"),
            (b"1 0 2 1 a\0", "it contains binary data"),
        ):
            path.write_bytes(ROBOT.encode().replace(b"1 0 2 1.0 stuck", bad))
            with pytest.raises(FileError, match=f"m.tra, line 10: not a transition file: {says}"):
                stl.load_model(path)


def spelled(value, rng):
    """A number in one of its texts."""
    ways = [f"{value.numerator}/{value.denominator}"]
    if (10**6 * value).denominator == 1:
        ways += [f"{float(value)!r}", f"{float(value):.20f}", f"{float(value):e}", f"{float(value):.6f}"] * 2
    return rng.choice(ways)


def random_files(rng):
    """The texts of a random model's files, some lines of which are odd or faulty."""
    n, chain, by_row, storm = rng.randint(1, 6), rng.random() < 0.3, rng.random() < 0.3, rng.random() < 0.3
    blurred, n_choices, lines = rng.random() < 0.2, 0, []
    by_row = by_row and not storm
    entries = []
    for s in range(n):
        for c in range(1 if chain else rng.randint(0, 3)):
            targets = rng.sample(range(n), rng.randint(1, n))
            weights = [rng.randint(0, 5) for _ in targets]
            total = sum(weights) or 1
            shares = [Fraction(w, total) for w in weights] if rng.random() < 0.5 else [Fraction(0)] * len(targets)
            if not any(shares):
                shares[0] = Fraction(1)
            texts = [spelled(share, rng) for share in shares]
            if blurred:
                texts = [f"[{float(x) / 2!r},{min(1.0, 2 * float(x))!r}]" if x else "0" for x in shares]
            word = rng.choice(["", " a", " go", "\tβ"])
            n_choices += 1
            if by_row:
                lines.append(f"{s} " + " ".join(f"{p}:{t}" for p, t in zip(texts, targets, strict=True)) + word)
            else:
                first = f"{s}" if chain else f"{s} {c}"
                lines += [f"{first} {t} {p}{word}" for p, t in zip(texts, targets, strict=True)]
            entries += [(s, c, t) for t in targets]
    if not by_row and rng.random() < 0.3:
        rng.shuffle(lines)
    header = (
        ("dtmc" if chain else "mdp") if storm else f"{n} {len(entries)}" if chain else f"{n} {n_choices} {len(entries)}"
    )
    body = [header, *lines]
    for _ in range(rng.randint(0, 2)):
        odd = rng.choice(["# note", "", "  ", "0 0 x", "0 0 0 7/5", "1 1 1 1 1 1", "0 0 0 [0.1,0.2]", "99 0 0 1", "\r"])
        body.insert(rng.randint(1, len(body)), odd)
    rewarded = rng.sample(entries, rng.randint(0, len(entries)))
    numbered = [f"{s} {t} {rng.randint(-3, 9)}" if chain else f"{s} {c} {t} 1.{c}" for s, c, t in rewarded]
    counts = f"{n} {len(numbered)}" if chain else f"{n} {n_choices} {len(numbered)}"
    labelled = [f"{s}: 7{' 0' * (s == 0)}\n" for s in range(n)]
    valued = [f"{s}:({rng.choice([s, -s, s / 2])},{rng.choice(['true', 'false', '1'])})\n" for s in range(n)]
    return {
        "tra": "\n".join(body) + rng.choice(["", "\n"]),
        "lab": "".join(['0="init" 7="b c"\n', *labelled, rng.choice(["", "0:\n", "x"])]),
        "sta": "".join(["(x,up)\n", *valued]),
        "trew": "\n".join([*([] if storm else [counts]), *numbered]),
    }  # fmt: skip


def content(path):
    try:
        model = stl.load_model(path)
    except stl.StlToolError as error:
        return str(error)
    exact = None if model.uncertain else (model.exact().numerator.tolist(), model.exact().denominator)
    return (
        model.digest(), exact, [model.state_name(s) for s in range(model.n_states)], model.action_names, model.notes,
        {(name, of): numbers(part) for name, cost in model.costs.items() for of, part in cost.parts.items()},
    )  # fmt: skip


@pytest.mark.soak
def test_both_readers_read_the_same(tmp_path, monkeypatch):
    rng, told = random.Random(1), 0
    for _ in range(many(300)):
        path = write(tmp_path, **random_files(rng))
        both = []
        for large in (0, 1 << 60):
            monkeypatch.setattr(lines, "LARGE", large)
            monkeypatch.setattr(explicit, "LARGE", large)
            monkeypatch.setattr(lines, "_BLOCK", rng.choice([7, 50, 1 << 20]))
            both.append(content(path))
        assert both[0] == both[1], path.read_text()
        told += isinstance(both[0], str)
    assert 0.1 < told / many(300) < 0.95


def test_damaged_and_enormous_packed_files(tmp_path, monkeypatch):
    path = tmp_path / "m.tra.gz"
    packed = gzip.compress(ROBOT.encode() * 20)
    for bad in (packed[:-9], ROBOT.encode(), packed[:20] + b"\0\0\0" + packed[23:], b""):
        path.write_bytes(bad)
        with pytest.raises(stl.StlToolError, match="m.tra.gz"):
            stl.load_model(path)
    path.write_bytes(gzip.compress(b"1 1\n0 0 1\n" + b"#" * (1 << 20)))
    assert stl.load_model(path).n_states == 1
    monkeypatch.setattr(lines, "memory_limit", lambda: 10**6)
    with pytest.raises(SizeError, match=r"m.tra.gz: unpacked, it has more than .*B of text, .*; 1 MB may be used"):
        stl.load_model(path)


def test_arguments_are_checked(tmp_path):
    path = write(tmp_path, tra=ROBOT)
    for changes in ({"initial": 1.5}, {"initial": True}, {"deadlocks": "stop"}, {"deadlocks": None}):
        with pytest.raises(SettingsError, match=next(iter(changes))):
            stl.load_model(path, **changes)
    toml = tmp_path / "f.toml"
    toml.write_text('kind = "grid"\nmap = "SS."\nmoves = "cross"\nsuccess = 1\n')
    assert stl.load_model(toml, initial="(2,0)").initial.tolist() == [0, 0, 1]
    assert stl.load_model(toml, initial="uniform").initial.tolist() == [0.5, 0.5, 0]


@pytest.mark.skipif(not PRISM.exists(), reason="PRISM's files are not here")
def test_prisms_own_files(tmp_path):
    robots = [stl.load_model(PRISM / "mdp" / f"robot.prism{form}.tra") for form in ("", ".exact", ".rows")]
    for text in ("F[0,6] goal1", "G[0,4] !hazard"):
        values = {stl.check(stl.build_product(model, stl.parse(text)), exact=True).fraction for model in robots}
        assert len(values) == 1
    for model in robots:
        assert list(model.costs) == ["time", "energy", "move"]
        assert numbers(model.costs["energy"].states)[:3] == [Fraction(23, 10), Fraction(23, 10), Fraction(1, 10)]
        assert sorted(numbers(model.costs["energy"].choices))[-3:] == [0, Fraction(7, 2), Fraction(7, 2)]
        assert numbers(model.costs["move"].choices) == [1, 1, 1, 1, 0, 0, 1, 1, 1, 1]  # all but "stuck"
    for path in sorted(PRISM.glob("*/*.tra")):
        assert stl.load_model(path).n_states >= 6


def damaged(text, rng):
    """A text with bytes changed, cut out, doubled and put in."""
    data = bytearray(text.encode())
    for _ in range(rng.randint(1, 3)):
        a = rng.randrange(len(data) + 1)
        b = min(len(data), a + rng.randint(0, 12))
        match rng.randrange(4):
            case 0:
                data[a : a + 1] = bytes([rng.randrange(256)])
            case 1:
                del data[a:b]
            case 2:
                data[a:a] = data[a:b]
            case 3:
                data[a:b] = rng.choice(PIECES)
    return bytes(data)


PIECES = [
    b"#", b"\n", b"\r\n", b" ", b"\t", b"\0", b"\xff", b"-", b"/", b"/0", b":", b"[", b"]", b",", b"[0.5,1]", b"1e999",
    b"1e-999", b"99999999999", b"-1", b"nan", b"0x1", b"1_0", b"\xc2\xa0", b"\x0b", b"\x1c", b"mdp", b"dtmc",
    b'0="init"', b"#DECLARATION\ninit\n#END\n", b"# Transitions (CTMC)\n", b"()", b"(x)", b"0:(1)", b"true", b".", b"e",
    b"0.33333333333333333333333",
]  # fmt: skip


@pytest.mark.soak
def test_whatever_is_damaged_is_refused_or_read(tmp_path, monkeypatch):
    """The readers' fuzzer in small (bench/fuzz_explicit.py), with both readers."""
    rng, refused = random.Random(2), 0
    for _ in range(many(400)):
        files = random_files(rng)
        path = write(tmp_path, **files)
        ending = rng.choice(list(files))
        (tmp_path / f"m.{ending}").write_bytes(damaged(files[ending], rng))
        both = []
        for large in (0, 1 << 60):
            monkeypatch.setattr(lines, "LARGE", large)
            monkeypatch.setattr(explicit, "LARGE", large)
            both.append(content(path))
        assert both[0] == both[1]
        refused += isinstance(both[0], str)
        assert not isinstance(both[0], str) or str(tmp_path) in both[0]
    assert refused > many(400) / 3
