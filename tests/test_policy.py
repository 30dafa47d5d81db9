import json
import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import FileError, InexactEncodingWarning, PolicyError
from stltool.policy import greedy
from tests import oracles
from tests.checking.test_check import products, random_policy


@given(products(), st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
def test_a_policy_survives_its_file(tmp_path_factory, product, seed, timed, mixed):
    policy = random_policy(product, np.random.default_rng(seed), timed, mixed)
    path = tmp_path_factory.mktemp("policies") / "policy.npz"
    policy.save(path)
    again = stl.load_policy(path, product)
    assert np.array_equal(again.table, policy.table)
    assert (again.deterministic, again.stationary) == (not mixed, policy.stationary)
    assert stl.check(product, again).probability == stl.check(product, policy).probability


def test_saving_is_atomic(patrolling, tmp_path, monkeypatch):
    path = tmp_path / "policy.npz"
    stl.check(patrolling).policy.save(path)
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(FileError, match=r"policy.npz: cannot be written: No space left on device"):
        stl.check(patrolling, maximize=False).policy.save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_policy_file_of_another_task_names_both(patrolling, floor5, tmp_path):
    path = tmp_path / "policy.npz"
    stl.check(patrolling).policy.save(path)
    other = stl.build_product(floor5, stl.parse("F[0,5) A"))
    with pytest.raises(PolicyError) as caught:
        stl.load_policy(path, other)
    assert str(patrolling.formula) in str(caught.value)
    assert "F[0,4] A" in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"not a zip", b"PK\x03\x04 broken"])
def test_what_is_no_policy_file(patrolling, tmp_path, content):
    path = tmp_path / "policy.npz"
    path.write_bytes(content)
    with pytest.raises(PolicyError, match="not a policy file"):
        stl.load_policy(path, patrolling)
    with pytest.raises(FileError, match="no such policy file"):
        stl.load_policy(tmp_path / "none.npz", patrolling)
    with pytest.raises(FileError, match="cannot be read"):
        stl.load_policy(tmp_path, patrolling)


def test_pickles_are_never_loaded(patrolling, tmp_path):
    path = tmp_path / "policy.npz"
    header = np.frombuffer(json.dumps({"format": "stltool-policy-1"}).encode(), dtype=np.uint8)
    np.savez(path, header=header, table=np.array([{"a": 1}], dtype=object))
    with pytest.raises(PolicyError, match="not a policy file"):
        stl.load_policy(path, patrolling)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        (np.zeros((3, 3), dtype=int), r"shape \(3, 3\); give \(18, 36\) or \(8, 18, 36\)"),
        (np.full((18, 36), 9), "takes choice 9 in state .*, which has 9, counted from 0"),
        (np.full((18, 36, 9), 0.2), "are not a distribution over the 9 choices"),
        (np.full((18, 36, 9), np.nan), "are not a distribution"),
        (np.full((18, 36, 8), 1 / 8), r"weights have shape \(18, 36, 8\)"),
        (np.full((18, 36), "N"), "give integers"),
    ],
)
def test_tables_that_do_not_fit(flagged, table, says):
    with pytest.raises(PolicyError, match=says):
        stl.Policy(flagged, table)


def write_q_table(product, q_values, path, rows=None):
    """As the published tables are written: `[signals flags]`, a column per action."""
    model, automaton = product.model, product.automaton
    lines = ["," + ",".join(model.action_names)]
    for s, q in rows if rows is not None else np.ndindex(product.shape):
        key = [*(values[s] for values in model.signals.values()), *automaton.registers[q]]
        lines.append(f"{np.array(key, dtype=float)}," + ",".join(repr(float(v)) for v in q_values[s, q]))
    path.write_text("\n".join(lines) + "\n")


def test_a_q_table_is_its_greedy_policy(flagged, tmp_path):
    rng = np.random.default_rng(0)
    q_values = rng.integers(0, 3, size=(*flagged.shape, 9)).astype(float)  # with ties
    path = tmp_path / "q.csv"
    write_q_table(flagged, q_values, path)
    policy = stl.load_policy(path, flagged)
    assert np.array_equal(policy.table, greedy(flagged, q_values).table)
    best = q_values == q_values.max(axis=2, keepdims=True)
    assert np.allclose(policy.table, best / best.sum(axis=2, keepdims=True))
    write_q_table(flagged, q_values, path, rows=[(3, 5)])
    partial = stl.Policy.from_q_table(path, flagged).table
    assert np.allclose(np.delete(partial.reshape(-1, 9), 3 * 36 + 5, axis=0), 1 / 9)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (",stay,N\n", "the Q-table has no rows"),
        (",stay,N\n[0.3 0.1 0 0],1,2\n", "the model's actions are stay, N, S"),
        ("HEAD\n[0.3 0.1 0 0],1,2\n", "line 2: not a row"),
        ("HEAD\n[0.3 0.1 0 zero],1,2,3,4,5,6,7,8,9\n", "line 2: not a row"),
        ("HEAD\n[0.3 0.1 0 0],1,2,3,4,5,6,7,8,nan\n", "with finite numbers"),
        ("HEAD\n[0.3 0.1 0],1,2,3,4,5,6,7,8,9\n", "the index has 3 numbers; it needs 2 signals"),
        ("HEAD\n[0.31 0.1 0 0],1,2,3,4,5,6,7,8,9\n", "row 1: there is no state 0.31 0.1"),
        ("HEAD\n[0.3 0.1 0 6],1,2,3,4,5,6,7,8,9\n", "row 1: there is no automaton state 0 6"),
        ("HEAD\n" + "[0.3 0.1 0 0],1,2,3,4,5,6,7,8,9\n" * 2, "two rows are for the same state"),
    ],
)
def test_bad_q_tables_are_refused(flagged, tmp_path, text, says):
    path = tmp_path / "q.csv"
    path.write_text(text.replace("HEAD", "," + ",".join(flagged.model.action_names)))
    with pytest.raises(PolicyError, match=says):
        stl.load_policy(path, flagged)


@pytest.mark.parametrize("entry", [-65536, -65000, -1])
def test_any_negative_entry_says_nothing(patrolling, entry):
    policy = stl.Policy(patrolling, np.full(patrolling.shape, entry))
    assert (policy.table == -1).all()
    with pytest.raises(PolicyError, match="defines no action at step 0"):
        stl.check(patrolling, policy)


def test_damaged_archives_are_refused(patrolling, tmp_path):
    path = tmp_path / "policy.npz"
    stl.check(patrolling).policy.save(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(200):
        damaged = bytearray(whole)
        damaged[int(rng.integers(len(whole)))] ^= 1 << int(rng.integers(8))
        path.write_bytes(bytes(damaged))
        try:
            stl.load_policy(path, patrolling)  # a flip in the padding may do no harm
        except PolicyError as error:
            refused += "policy.npz" in str(error)
    assert refused > 100


def test_links_are_followed_and_devices_left_alone(patrolling, tmp_path):
    policy = stl.check(patrolling).policy
    (tmp_path / "real.npz").touch()
    (tmp_path / "link.npz").symlink_to(tmp_path / "real.npz")
    policy.save(tmp_path / "link.npz")
    assert (tmp_path / "link.npz").is_symlink()
    assert stl.load_policy(tmp_path / "real.npz", patrolling).table.shape == policy.table.shape
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(FileError, match="not a regular file"):
        policy.save(tmp_path / "pipe.npz")


def test_a_policy_replaces_no_other_file(patrolling, tmp_path):
    path = tmp_path / "data.npz"
    policy = stl.check(patrolling).policy
    for write in (
        lambda: np.savez(path, x=np.arange(3)),
        lambda: np.savez(path, header=np.frombuffer(b'{"format": "another-1"}', dtype=np.uint8)),
        lambda: path.write_bytes(b"old"),
    ):
        write()
        before = path.read_bytes()
        with pytest.raises(
            FileError, match=r"data.npz: this file does not contain a policy that stltool wrote, and would"
        ):
            policy.save(path)
        assert path.read_bytes() == before
    path.unlink()
    policy.save(path)
    older = path.read_bytes()
    policy.save(path)  # a policy is replaced
    assert path.read_bytes() == older


def test_signals_that_do_not_tell_states_apart(tmp_path):
    model = stl.MDP.from_arrays([np.eye(2)], {"x": [1.0, 1.0]}, labels={"A": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,2) A"))
    path = tmp_path / "q.csv"
    path.write_text(",0\n[1 0],3\n")
    with pytest.raises(PolicyError, match="do not distinguish its states"):
        stl.load_policy(path, product)


def test_a_policy_that_remembers_flags_is_judged_by_the_exact_automaton(floor5, patrolling, flagged, tmp_path):
    """The same probability on the flag product and, joined, on the minimal one."""
    policy = random_policy(flagged, np.random.default_rng(0), timed=True, mixed=True)
    assert flagged.n_states > patrolling.n_states
    on_flags, joined = stl.check(flagged, policy), stl.check(patrolling, policy)
    assert joined.probability == pytest.approx(on_flags.probability, abs=1e-14)
    path = tmp_path / "policy.npz"
    policy.save(path)
    again = stl.load_policy(path, patrolling)
    assert stl.check(patrolling, again).probability == joined.probability
    run = stl.sample_run(patrolling, again, seed=0)
    assert "the policy: " in run.memory[0]


def test_a_policy_with_the_papers_memory_is_judged_by_the_formula(floor5):
    """Different windows: the flags approximate, the verdict does not; against the tree of all runs."""
    phi = stl.parse("F[0,2) (F[0,2) A & G[0,3) !B)")
    small = stl.MDP.from_arrays(
        [[[0.5, 0.5], [0.25, 0.75]], [[0.0, 1.0], [1.0, 0.0]]], {"x": [0, 1]}, labels={"A": [0, 1], "B": [1, 0]}
    )
    with pytest.warns(InexactEncodingWarning):
        paper = stl.build_product(small, phi, encoding="paper")
    exact = stl.build_product(small, phi)
    for seed in range(5):
        policy = random_policy(paper, np.random.default_rng(seed), timed=True, mixed=False)
        value = oracles.policy_value(paper, policy)  # judged by the formula on whole traces
        assert stl.check(exact, policy).probability == pytest.approx(float(value), abs=1e-14)
