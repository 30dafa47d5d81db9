"""UMB files: what we write is what we read, and what Storm and the package umbi read; theirs mean the same to us."""

import io
import json
import tarfile
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
