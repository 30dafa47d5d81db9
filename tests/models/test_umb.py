"""UMB files: what we write is what we read, and what Storm and the package umbi read; theirs mean the same to us."""

import gzip
import io
import json
import lzma
import tarfile
import tracemalloc
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.models.costs import Amounts, Cost, Entries
from stltool.models.fractions import Shares, over_one
from stltool.models.rows import Stored
from tests.conftest import FACTORY


def random_model(rng, kind="fractions", chain=False, costs=True):
    """A small model with gaps: states with fewer actions, rows of different lengths."""
    n, names = int(rng.integers(2, 7)), ("go", "stay", "up and down")
    choice_start, action, row_start, target, shares = [0], [], [0], [], []
    for _ in range(n):
        has = [0] if chain else sorted(rng.choice(3, size=rng.integers(1, 4), replace=False).tolist())
        for a in has:
            to = sorted(rng.choice(n, size=rng.integers(1, n + 1), replace=False).tolist())
            weight = rng.integers(1, 9, len(to))
            shares += [Fraction(int(w), int(weight.sum())) for w in weight]
            target += to
            action.append(a)
            row_start.append(len(target))
        choice_start.append(len(action))
    exact = Shares(*over_one(shares))
    doubles = np.array([float(share) for share in shares])
    starts, rows = np.array(choice_start, dtype=np.int64), np.array(row_start, dtype=np.int64)
    ends = None
    if kind == "intervals":
        ends = stl.models.Intervals(doubles * 0.75, np.minimum(1.0, doubles * 1.5))
        doubles = ends.nominal(rows)
    target = np.array(target, dtype=np.int32)
    given = {
        "speed": Cost(Amounts.read(rng.integers(-3, 9, n) / 4, "speed")),
        "toll": Cost(None, Amounts.read([Fraction(int(k), 7) for k in rng.integers(0, 9, len(action))], "toll")),
    }  # fmt: skip
    if costs == "transitions":
        amounts = Amounts.read(rng.random(len(target)), "steps")
        given["steps"] = Cost(transitions=Entries(amounts.values, row_start=rows, target=target))
    first = np.zeros(n)
    first[rng.integers(n)] = 1
    used = tuple(name for a, name in enumerate(names) if a in action)
    return stl.MDP(
        Stored(
            starts, np.array([used.index(names[a]) for a in action], dtype=np.int32), rows, target, doubles,
            exact if kind == "fractions" else None, ends,
        ),
        initial=first,
        signals={"x": rng.integers(-5, 5, n) * 1.0, "height": rng.random(n)},
        labels={"home": rng.random(n) < 0.5, "far away": rng.random(n) < 0.5, "init": first > 0},
        action_names=used,
        state_names=[f"place {s}" for s in range(n)],
        costs=given if costs else {},
    )  # fmt: skip


def same(one, other):
    assert one.digest() == other.digest()
    assert list(one.state_names) == list(other.state_names)
    assert one.uncertain == other.uncertain
    if not one.uncertain:
        assert one.rows.given_exactly == other.rows.given_exactly
        assert [Fraction(int(n), one.rows.denominator) for n in one.rows.numerator] == [
            Fraction(int(n), other.rows.denominator) for n in other.rows.numerator
        ]
    for name, cost in one.costs.items():
        for part, numbers in cost.parts.items():
            found = other.costs[name].parts[part]
            assert [numbers.exact[k] for k in range(len(numbers))] == [found.exact[k] for k in range(len(found))]


def saved(model, path):
    stl.save_model(model, path)
    return stl.load_model(path)


@pytest.mark.parametrize("kind", ["fractions", "doubles", "intervals"])
@pytest.mark.parametrize("chain", [False, True])
def test_what_is_written_is_read(tmp_path, kind, chain):
    rng = np.random.default_rng(7)
    for _ in range(5):
        model = random_model(rng, kind, chain, "transitions")
        same(model, saved(model, tmp_path / "m.umb"))


def steps_of(cost, choice):
    """What a step along each entry costs, without its state."""
    along = np.zeros(len(choice))
    along += cost.choices.values[choice] if cost.choices is not None else 0
    return along + (cost.transitions.values if cost.transitions is not None else 0)


@pytest.mark.parametrize("kind", ["fractions", "doubles", "intervals"])
@pytest.mark.parametrize("ending", [".tra", ".tra.gz"])
def test_the_same_as_explicit_files(tmp_path, kind, ending):
    rng = np.random.default_rng(13)
    for number, chain in enumerate((False, True)):
        model = random_model(rng, kind, chain, "transitions")
        names = tuple(name.replace(" ", "_") for name in model.action_names)
        model = stl.models.mdp.replace(model, action_names=names)
        read = saved(model, tmp_path / f"{number}{ending}")
        np.testing.assert_array_equal(read.target, model.target)
        np.testing.assert_array_equal(read.probability, model.probability)
        assert [read.place(c).rpartition(", ")[2] for c in range(read.n_choices)] == [
            model.place(c).rpartition(", ")[2] for c in range(model.n_choices)
        ]
        for mine, its in ((model.signals, read.signals), (model.labels, read.labels)):
            assert {name: values.tolist() for name, values in mine.items()} == {
                name: values.tolist() for name, values in its.items()
            }
        rows = model.rows
        choice = np.repeat(np.arange(model.n_choices), np.diff(rows.row_start))
        for name, cost in model.costs.items():
            one, other = (steps_of(cost, choice) for cost in (cost, read.costs[name]))
            np.testing.assert_array_equal(one, other)
            if cost.states is not None:
                np.testing.assert_array_equal(read.costs[name].states.values, cost.states.values)


def test_a_grid_keeps_its_names_and_fractions(tmp_path):
    grid = stl.load_model(FACTORY / "floor-5x5.toml")
    read = saved(grid, tmp_path / "floor.umb")
    assert list(read.state_names) == list(grid.state_names)
    assert read.action_names == grid.action_names
    assert read.exact().denominator == grid.exact().denominator
    phi = stl.parse("G[0,6) F[0,4) (A | x > 0.6)")
    values = [stl.check(stl.build_product(model, phi), exact=True).fraction for model in (read, grid)]
    assert values[0] == values[1]


# ------------------------------------------------------------------------------------------------- outside judges


@pytest.mark.parametrize("kind", ["fractions", "doubles", "intervals"])
def test_storm_reads_what_we_write(tmp_path, kind):
    stormpy = pytest.importorskip("stormpy", reason="outside judge absent: stormpy (pip install stltool[peers])")
    rng = np.random.default_rng(3)
    for chain in (False, True):
        model = random_model(rng, kind, chain)
        stl.save_model(model, tmp_path / "m.umb")
        theirs = stormpy.build_model_from_umb(str(tmp_path / "m.umb"))
        assert (theirs.nr_states, theirs.nr_choices, theirs.nr_transitions) == (
            model.n_states, model.n_choices, model.n_transitions
        )  # fmt: skip
        matrix = theirs.transition_matrix
        rows = model.rows
        for c in range(model.n_choices):
            for entry, k in zip(matrix.get_row(c), range(rows.row_start[c], rows.row_start[c + 1]), strict=True):
                assert entry.column == rows.target[k]
                if kind == "intervals":
                    assert (entry.value.lower(), entry.value.upper()) == (
                        rows.intervals.lower[k], rows.intervals.upper[k]
                    )  # fmt: skip
                else:
                    assert Fraction(str(entry.value)) == (
                        Fraction(int(rows.numerator[k]), rows.denominator) if kind == "fractions"
                        else Fraction(str(rows.probability[k]))
                    )  # fmt: skip
        for name, values in model.labels.items():
            assert list(theirs.labeling.get_states(name)) == np.flatnonzero(values).tolist()
        for name, cost in model.costs.items():
            reward = theirs.reward_models[name]
            for part, numbers in cost.parts.items():
                found = reward.state_rewards if part == "states" else reward.state_action_rewards
                found = [value.lower() for value in found] if kind == "intervals" else found
                assert [float(Fraction(str(value))) for value in found] == pytest.approx(numbers.values.tolist())


PROGRAM = """mdp
module m
  b : bool init false;
  x : [-3..4] init -3;
  [go] x<4 -> 0.25 : (x'=x+1) + 0.75 : (b'=!b);
  [stay] true -> 0.5 : true + 0.5 : (x'=-3);
  [go] x=4 -> 1 : (b'=false);
endmodule
label "top" = x=4 & b;
rewards "toll" [go] true : 0.5; x>2 : 2; endrewards
"""


def test_we_read_what_storm_writes(tmp_path):
    """Packed variables with offsets, in a compressed archive."""
    stormpy = pytest.importorskip("stormpy", reason="outside judge absent: stormpy (pip install stltool[peers])")
    (tmp_path / "m.prism").write_text(PROGRAM)
    program = stormpy.parse_prism_program(str(tmp_path / "m.prism"))
    theirs = stormpy.build_model(program, options=stormpy.BuilderOptions(build_full=True))
    stormpy.io.export_to_umb(theirs, str(tmp_path / "m.umb"))
    model = stl.load_model(tmp_path / "m.umb")
    assert sorted(set(model.signals["x"])) == list(range(-3, 5))
    np.testing.assert_array_equal(model.labels["top"], (model.signals["x"] == 4) & (model.signals["b"] == 1))
    np.testing.assert_array_equal(model.costs["toll"].states.values, 2 * (model.signals["x"] > 2))
    assert set(model.action_names) == {"go", "stay"}
    for optimum in ("Pmax", "Pmin"):
        formula = stormpy.parse_properties(f'{optimum}=? [F<=12 "top"]')[0]
        value = stormpy.model_checking(theirs, formula).get_value(theirs.initial_states[0])
        mine = stl.check(stl.build_product(model, stl.parse("F[0,12] top")), maximize=optimum == "Pmax")
        assert mine.probability == pytest.approx(value, abs=1e-9)


@pytest.mark.parametrize("kind", ["fractions", "doubles", "intervals"])
def test_the_package_umbi_reads_what_we_write_and_we_what_it_writes(tmp_path, kind):
    umbi = pytest.importorskip("umbi", reason="outside judge absent: umbi (pip install stltool[peers])")
    model = random_model(np.random.default_rng(5), kind, costs="transitions")
    stl.save_model(model, tmp_path / "m.umb")
    theirs = umbi.ats.read(tmp_path / "m.umb")
    assert (theirs.num_states, theirs.num_choices) == (model.n_states, model.n_choices)
    umbi.ats.write(theirs, tmp_path / "theirs.umb")
    read = stl.load_model(tmp_path / "theirs.umb")
    actions = [[one.place(c).rpartition(", ")[2] for c in range(one.n_choices)] for one in (read, model)]
    assert actions[0] == actions[1]
    np.testing.assert_array_equal(read.probability, model.probability)
    np.testing.assert_array_equal(read.target, model.target)
    for mine, its in ((model.signals, read.signals), (model.labels, read.labels)):
        assert {name: values.tolist() for name, values in mine.items() if values.any()} == {
            name: values.tolist() for name, values in its.items()
        }  # umbi drops labels of no state
    check = stl.robust_check if kind == "intervals" else stl.check
    phi = stl.parse("F[0,5] (home & height > 0.3)")
    values = [check(stl.build_product(one, phi)) for one in (model, read)]
    assert (values[0].lower, values[0].upper) == (values[1].lower, values[1].upper)


def changed(path, **edit):
    """The UMB file with its index, or some of its files, changed."""
    with tarfile.open(path) as tar:
        files = {member.name: tar.extractfile(member).read() for member in tar}
    index = json.loads(files["index.json"])
    edit.get("index", lambda index: None)(index)
    files["index.json"] = json.dumps(index).encode()
    edit.get("files", lambda files: None)(files)
    with tarfile.open(path, "w") as tar:
        for name, content in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            tar.addfile(entry, io.BytesIO(content))
    return path


# --------------------------------------------------------------------------------------------------------------- faults


TS = "transition-system/"
INDEX_FAULTS = [
    ("format-version", 2, "index.json: the format version is 2; versions up to 1 can be read"),
    ("format-version", "1", "index.json: format-version is '1'; it must be an integer"),
    (TS + "time", "stochastic", "the model is a CTMDP: its time is continuous"),
    (TS + "time", "urgent-stochastic", "the model is a Markov automaton: its time is continuous"),
    (TS + "#players", 2, "the model is a game: it has 2 players"),
    (TS + "#observations", 3, "the model is a POMDP: its states are observed in part"),
    (TS + "branch-probability-type", None, "the model is a transition system (LTS): it has no probabilities"),
    (TS + "#states", 0, "#states is 0; a model has states"),
    (TS + "#states", -1, "#states is -1; it must be an integer from 0"),
    (TS + "#states", True, "#states is True; it must be an integer"),
    (TS + "#states", 3, "there are 4 names for 3 states"),
    (TS + "#choices", 2**62, "are more than can be numbered"),
    (TS + "#branches", 2**62, "of memory"),
    (TS + "#choices", 1, "state-to-choices.bin is not a list of ascending numbers from 0 to 1"),
    (TS + "#initial-states", 2, "marks 1 states, but index.json declares 2 initial states"),
    (TS + "#initial-states", 0, "no initial state is marked"),
    (TS + "branch-probability-type", {"type": "int"}, "branch-probability-type is int; probabilities are"),
    (TS + "branch-probability-type/type", "real", "there is no type 'real'; known types: bool"),
    (TS + "branch-probability-type/size", 96, "rational of 96 bits; it must have 128, or a multiple"),
    (TS + "branch-probability-type/size", 256, "branch-to-probability.bin has"),
    ("annotations/aps/home/type", {"type": "uint"}, "it is of type uint; atomic propositions are of type bool"),
    ("annotations/aps/home/applies-to", ["choices"], "atomic propositions are of states"),
    ("annotations/rewards/speed/type/type", "string", "it is of type string; rewards are numbers"),
    ("annotations/rewards/speed/applies-to", ["players"], "rewards of players cannot be read"),
    ("annotations/rewards/speed/alias", "toll", "the alias 'toll' is used twice; rename one"),
    ("annotations/aps", [], "annotations: aps is []; it must be an object"),
    ("annotations/aps/home/alias", "x", "x is the name of both a variable and a label"),
    ("annotations/aps/0-far-away/alias", "init", "the label init marks other states than those that runs start in"),
    ("valuations/states/classes", [], "there are no classes"),
    ("valuations/states/classes/0/variables/0/type/size", 63, "their number must be a multiple of 8"),
    ("valuations/states/classes/0/variables/0/name", "height", "variables have a name each; rename one"),
    ("file-data/parameters", {"state-names": ["here"]}, "there are 1 names for"),
    ("transition-system", [1], "transition-system is [1]; it must be an object"),
]  # fmt: skip


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("written") / "m.umb"
    stl.save_model(random_model(np.random.default_rng(1)), path)
    return path


@pytest.fixture
def file(written, tmp_path):
    (tmp_path / "m.umb").write_bytes(written.read_bytes())
    return tmp_path / "m.umb"


@pytest.mark.parametrize(("key", "value", "message"), INDEX_FAULTS)
def test_faults_of_the_index(file, key, value, message):
    def edit(index):
        *outer, last = key.split("/")
        for name in outer:
            index = index[int(name) if isinstance(index, list) else name]
        if value is None:
            del index[last]
        else:
            index[last] = value

    with pytest.raises(stl.StlToolError) as caught:
        stl.load_model(changed(file, index=edit))
    assert message in str(caught.value)
    assert str(file) in str(caught.value)


def put(name, at, content):
    def edit(files):
        data = bytearray(files[name])
        data[at : at + len(content)] = content
        files[name] = bytes(data)

    return edit


def cut(name, n):
    return lambda files: files.update({name: files[name][:-n]})


U64 = (2**63).to_bytes(8, "little")
FILE_FAULTS = [
    (put("branch-to-target.bin", 0, U64), "branch-to-target.bin leads to state 9223372036854775808 in branch 0"),
    (put("state-to-choices.bin", 0, b"\1"), "state-to-choices.bin is not a list of ascending numbers from 0 to"),
    (put("choice-to-branches.bin", 8, U64), "choice-to-branches.bin is not a list of ascending numbers"),
    (put("choice-to-branches.bin", 8, bytes(8)), "choice-to-branches.bin gives choice 0 no branch"),
    (put("branch-to-probability.bin", 8, bytes(8)), "branch-to-probability.bin divides by zero in entry 0"),
    (put("branch-to-probability.bin", 0, b"\xff" * 8), "branch-to-probability.bin has -"),
    (put("branch-to-probability.bin", 0, (99).to_bytes(8, "little")), "which is not a probability"),
    (put("actions/choices/values.bin", 0, b"\xff"), "actions/choices/values.bin gives choice 0 action 255; there are"),
    (put("actions/choices/strings.bin", 0, b"\xff"), "actions/choices/strings.bin is not UTF-8 in text 0"),
    (put("state-is-initial.bin", 7, b"\x80"), "state-is-initial.bin has bits behind the last of"),
    (cut("branch-to-target.bin", 1), "branch-to-target.bin has"),
    (cut("valuations/states/valuations.bin", 8), "valuations/states/valuations.bin has"),
    (lambda files: files.pop("branch-to-probability.bin"), "branch-to-probability.bin is missing"),
    (lambda files: files.pop("actions/choices/strings.bin"), "actions/choices/string-mapping.bin"),
    (lambda files: files.update({"index.json": b"{"}), "index.json is not JSON"),
    (lambda files: files.update({"index.json": b"[" * 10**5}), "index.json is not JSON"),
    (lambda files: files.update({"index.json": b'{"format-version": NaN}'}), "NaN is not a number of JSON"),
    (lambda files: files.pop("index.json"), "index.json is missing; this is not a UMB file"),
]  # fmt: skip


@pytest.mark.parametrize(("edit", "message"), FILE_FAULTS)
def test_faults_of_files(file, edit, message):
    with pytest.raises(stl.StlToolError) as caught:
        stl.load_model(changed(file, files=edit))
    assert message in str(caught.value)
    assert str(file) in str(caught.value)


def test_what_is_no_archive_or_a_damaged_one(tmp_path, file):
    whole = file.read_bytes()
    cases = {
        b"": "it is empty", b"text": "it is not a tar archive", whole[:700]: "is cut off",
        gzip.compress(whole)[:-100]: "is compressed and cannot be unpacked: it ends too early",
        lzma.compress(whole)[:-40]: "is compressed and cannot be unpacked: it ends too early",
        whole[: len(whole) // 2]: "",
    }  # fmt: skip
    for content, message in cases.items():
        (tmp_path / "bad.umb").write_bytes(content)
        with pytest.raises(stl.StlToolError, match=r"bad\.umb") as caught:
            stl.load_model(tmp_path / "bad.umb")
        assert message in str(caught.value)


@pytest.mark.parametrize(
    "pack", [gzip.compress, lzma.compress, lambda content: gzip.compress(content[:999]) + gzip.compress(content[999:])]
)
def test_compressed_files(file, pack):
    model = stl.load_model(file)
    file.write_bytes(pack(file.read_bytes()))
    same(model, stl.load_model(file))


@pytest.mark.parametrize("pack", [gzip.compress, lzma.compress])
def test_what_unpacks_is_measured_first(tmp_path, pack, monkeypatch):
    """A file of kilobytes that unpacks to more than there is memory for is refused, without taking it."""
    monkeypatch.setattr("stltool.models.formats.packed.memory_limit", lambda: 3 * 2**23)
    (tmp_path / "bomb.umb").write_bytes(pack(bytes(2**25)))
    tracemalloc.start()
    with pytest.raises(stl.errors.SizeError, match=r"bomb\.umb: this UMB file of .* unpacks to more than 8\.39 MB"):
        stl.load_model(tmp_path / "bomb.umb")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**24  # xz has a dictionary of 2**23


def test_links_and_devices_in_an_archive_are_refused(tmp_path):
    with tarfile.open(tmp_path / "link.umb", "w") as tar:
        entry = tarfile.TarInfo("index.json")
        entry.type, entry.linkname = tarfile.SYMTYPE, "/etc/hostname"
        tar.addfile(entry)
    with pytest.raises(stl.errors.FileError, match="'index.json' in it is not a regular file"):
        stl.load_model(tmp_path / "link.umb")


# ----------------------------------------------------------------------------------------------------------- the format


def chain_with(file, variables, rows, n_strings=0, files=None):
    """Two states with these variables, whose valuations are numbers, packed."""
    size = sum(
        one.get("padding", 0) + one.get("type", {}).get("size", 0) + one.get("is-optional", 0) for one in variables
    )
    stl.save_model(stl.MDP.from_arrays([[[0, 1], [1, 0]]], {}), file)

    def edit_index(index):
        states = {"unique": False, "classes": [{"variables": variables}]}
        index["valuations"] = {"states": {**states, **({"#strings": n_strings} if n_strings else {})}}

    def edit(content):
        content["valuations/states/valuations.bin"] = b"".join(row.to_bytes(size // 8, "little") for row in rows)
        content.update(files or {})

    return stl.load_model(changed(file, index=edit_index, files=edit))


def test_packed_variables(tmp_path):
    """The second example of the specification, and bits that cross bytes."""
    variables = [
        {"name": "sv0", "type": {"type": "uint", "size": 8}, "offset": -128},
        {"name": "sv1", "type": {"type": "int", "size": 16}},
        {"padding": 3},
        {"name": "b", "type": {"type": "bool", "size": 2}},
        {"name": "r", "type": {"type": "rational", "size": 10}},
        {"padding": 1},
    ]
    first = 0b10111101_11111111_10111000 | 2 << 27 | (0b00011_11110 << 29)  # r = -2/3
    model = chain_with(tmp_path / "m.umb", variables, [first, 0b00001_00001 << 29])
    assert {name: values.tolist() for name, values in model.signals.items()} == {
        "sv0": [56, -128], "sv1": [-16897, 0], "b": [1, 0], "r": [-2 / 3, 1]
    }  # fmt: skip
    assert model.state_name(0).startswith("sv0=56, sv1=-16897, b=true, r=-0.66666")


def test_optional_variables_and_texts_are_in_the_names_of_states(tmp_path):
    variables = [
        {"name": "v", "is-optional": True, "type": {"type": "uint", "size": 6}}, {"padding": 1},
        {"name": "where", "type": {"type": "string", "size": 64}},
        {"name": "x", "type": {"type": "double", "size": 64}},
    ]  # fmt: skip
    half = int.from_bytes(np.float64(0.5).tobytes(), "little")
    rows = [1 | 27 << 1 | 1 << 8 | half << 72, half << 72]
    starts, strings = np.array([0, 3, 5], dtype="<u8").tobytes(), b"xyzab"
    texts = {"valuations/states/string-mapping.bin": starts, "valuations/states/strings.bin": strings}
    model = chain_with(tmp_path / "m.umb", variables, rows, 2, texts)
    assert list(model.signals) == ["x"]
    assert list(model.state_names) == ["v=27, where=ab, x=0.5", "where=xyz, x=0.5"]
    assert model.notes["signal"].endswith("where (a text), v (without a value in state 1)")


def test_branches_to_the_same_state_add_up(tmp_path):
    """Also the rewards of such branches: they become their expectation."""
    path = tmp_path / "m.umb"
    costs = {"toll": [[[1, 4], [0, 0]]]}
    stl.save_model(stl.MDP.from_arrays([[["1/3", "2/3"], [0, 1]]], {}, costs=costs), path)
    targets = np.array([1, 1, 1], dtype="<u8").tobytes()
    read = stl.load_model(changed(path, files=lambda files: files.update({"branch-to-target.bin": targets})))
    assert (read.n_transitions, read.exact().numerator.tolist(), read.target.tolist()) == (2, [3, 3], [1, 1])
    assert [read.costs["toll"].transitions.exact[k] for k in range(2)] == [3, 0]


def test_rows_of_zeros(tmp_path):
    """Also where the probabilities are intervals, and in the last row."""
    for kind in ("fractions", "intervals"):
        model = random_model(np.random.default_rng(6), kind)
        stl.save_model(model, tmp_path / "m.umb")
        size = 16
        zero = bytes(size) if kind == "intervals" else bytes(8) + b"\1" + bytes(7)
        first = int(model.row_start[-2])
        edit = put("branch-to-probability.bin", size * first, zero * (int(model.row_start[-1]) - first))
        with pytest.raises(stl.errors.ModelError, match="the probabilities sum to 0, not 1"):
            stl.load_model(changed(tmp_path / "m.umb", files=edit))
        (tmp_path / "m.umb").unlink()


def test_many_variables_are_measured_first(tmp_path, monkeypatch):
    variables = [{"name": f"b{k}", "type": {"type": "bool", "size": 1}} for k in range(64)]
    monkeypatch.setattr("stltool.models.formats.umb._BYTES_A_VALUE", 10**12)
    with pytest.raises(stl.errors.SizeError, match=r"m\.umb: 2 branches of 2 states would take .* of memory"):
        chain_with(tmp_path / "m.umb", variables, [0, 0])


def test_long_fractions(tmp_path):
    share = Fraction(10**60 + 1, 3 * 10**60)
    model = stl.MDP.from_arrays([[[share, 1 - share], [0, 1]]], {})
    read = saved(model, tmp_path / "m.umb")
    assert [Fraction(int(n), read.rows.denominator) for n in read.rows.numerator] == [share, 1 - share, 1]
