import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

import stltool as stl
from stltool.errors import FileError, ModelError
from stltool.models.environment import simulator
from stltool.testing import mdps

STAY, SWAP = np.eye(2), np.array([[0.1, 0.9], [0.8, 0.2]])


def build(**changes):
    arguments = {"transitions": [STAY, SWAP], "signals": {"x": [0.0, 1.0]}, "labels": {"A": [1, 0]}}
    return stl.MDP.from_arrays(**(arguments | changes))


def test_dense_and_sparse_transitions_give_one_model():
    dense = build(transitions=np.stack([STAY, SWAP]))
    mixed = build(transitions=[sparse.csr_matrix(STAY), SWAP.tolist()])
    assert dense.digest() == mixed.digest()
    assert (dense.n_states, dense.n_choices, dense.n_transitions) == (2, 4, 6)
    assert dense.matrix().toarray().tolist() == [[1, 0], [0.1, 0.9], [0, 1], [0.8, 0.2]]
    assert build(action_names=["stay", "go"]).digest() != dense.digest()


def test_a_row_of_zeros_is_an_unavailable_action():
    model = build(transitions=[STAY, [[0, 0], [0.8, 0.2]]])
    assert model.choice_start.tolist() == [0, 1, 3]
    assert model.choice_action.tolist() == [0, 0, 1]


@given(mdps(states=4, actions=3))
def test_models_of_the_strategy_are_distributions(model):
    assert np.allclose(model.matrix().sum(axis=1), 1)
    assert (np.diff(model.choice_start) > 0).all()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"transitions": [STAY, [[0.3, 0.9], [0.8, 0.2]]]}, "state 0, action 1: the probabilities sum to 1.2, not 1"),
        ({"transitions": [STAY, [[0.1, 0.9], [1.2, -0.2]]]}, "state 1, action 1: 1.2 to state 0 is not a probability"),
        (
            {"transitions": [STAY, [[np.nan, 0.9], [0.8, 0.2]]]},
            "state 0, action 1: nan to state 0 is not a probability",
        ),
        ({"transitions": [[[1, 0], [0, 0]]]}, "state 1 has no action; give it one that stays"),
        ({"transitions": [STAY, np.eye(3)]}, r"transitions of action 1 have shape \(3, 3\), not \(2, 2\)"),
        ({"transitions": STAY}, r"shape \(2, 2\); give an array \(A, S, S\) or a list of matrices"),
        ({"transitions": 3}, "must be an array"),
        ({"transitions": []}, "no action"),
        ({"transitions": np.zeros((1, 0, 0))}, "the model has no states"),
        ({"signals": {"": [0.0, 1.0]}}, "the name of a signal is empty; give it one"),
        ({"costs": {"": [0, 1]}}, "the name of a cost is empty; give it one"),
        ({"transitions": [[["a", 0], [0, 1]]]}, "transitions of action 0 are not numbers"),
        ({"transitions": [[1.0, 0.0]]}, r"give a matrix \(S, S\)"),
        ({"transitions": [STAY * 1j]}, "transitions of action 0 are not numbers"),
        ({"signals": {"x": [0.0]}}, r"x has shape \(1,\); give one value for each of the 2 states"),
        ({"signals": {"x": [0.0, np.inf]}}, "signal x is inf in state 1; it must be finite"),
        ({"signals": {"x": ["far", 1]}}, "signal x does not contain numbers"),
        ({"labels": {"A": [0.5, 1]}}, "label A has values other than true and false"),
        ({"labels": {"x": [0, 1]}}, "x is the name of both a signal and a label"),
        ({"initial": 2}, "the initial state 2 is not one of 0 … 1"),
        ({"initial": "s3", "state_names": ["s1", "s2"]}, "no initial state 's3'; known names: s1, s2"),
        ({"initial": [0.5, 0.6]}, "the initial distribution sums to 1.1"),
        ({"initial": [1.5, -0.5]}, "not probabilities"),
        ({"initial": [1.0]}, r"the initial distribution has shape \(1,\)"),
        ({"action_names": ["go"]}, "1 action names for 2 actions"),
        ({"action_names": ["go", "go"]}, "action names repeat"),
        ({"state_names": ["only"]}, "1 state names for 2 states"),
    ],
)
def test_bad_arrays_are_refused_with_state_and_action(changes, says):
    with pytest.raises(ModelError, match=says):
        build(**changes)


def test_intervals_without_states_are_refused():
    none = np.zeros((1, 0, 0))
    with pytest.raises(ModelError, match="the model has no states"):
        stl.MDP.from_intervals(none, none, {})


def test_a_model_does_not_change_behind_its_digest():
    with pytest.raises(ValueError, match="read-only"):
        build().probability[:] = 0.3


def test_state_names_appear_in_messages():
    with pytest.raises(ModelError, match="state dock, action go: the probabilities sum to 0.9"):
        build(transitions=[STAY, [[0.1, 0.8], [0.8, 0.2]]], state_names=["dock", "hall"], action_names=["stay", "go"])


def test_model_files_are_told_by_their_ending(tmp_path):
    with pytest.raises(FileError, match="no such model file"):
        stl.load_model(tmp_path / "none.xyz")
    (tmp_path / "model.xyz").write_text("")
    with pytest.raises(FileError, match="no model format has the extension '.xyz'"):
        stl.load_model(tmp_path / "model.xyz")
    with pytest.raises(FileError, match="this is a folder; name a model file"):
        stl.load_model(tmp_path)


@given(model=mdps(), seed=st.integers(0, 2**32 - 1))
def test_the_simulator_takes_possible_steps_only(model, seed):
    rng = np.random.default_rng(seed)
    environment = simulator(model, rng)
    s = environment.reset()
    assert model.initial[s] > 0
    for _ in range(20):
        i = int(rng.integers(model.choice_start[s + 1] - model.choice_start[s]))
        c = model.choice_start[s] + i
        s2 = environment.step(i)
        assert s2 in model.target[model.row_start[c] : model.row_start[c + 1]]
        s = s2
    with pytest.raises(IndexError, match="no available action number 99"):
        environment.step(99)


def test_the_simulator_follows_the_distribution():
    model = build(initial=[0.25, 0.75])
    environment = simulator(model, np.random.default_rng(0))
    starts = [environment.reset() for _ in range(4000)]
    assert abs(np.mean(starts) - 0.75) < 0.03
    moves = []
    for _ in range(8000):
        if environment.reset() == 0:
            moves.append(environment.step(1))
    assert abs(np.mean(moves) - 0.9) < 0.03


def test_a_choice_without_successors_is_named(floor5):
    row_start = floor5.row_start.copy()
    row_start[1] = 0  # the first choice's entries go to the second
    with pytest.raises(ModelError, match=r"state \(0,4\), action stay: the probabilities sum to 0, not 1"):
        floor5.with_rows(row_start=row_start)


def test_state_names_that_repeat_get_numbers():
    model = stl.MDP.from_arrays([np.eye(4)], {}, "a (1)", state_names=["a", "a", "b", "a (0)"])
    assert tuple(model.state_names) == ("a (0) (0)", "a (1)", "b", "a (0) (3)")
    assert model.initial.tolist() == [0, 1, 0, 0]
    with pytest.raises(ModelError, match=r"several states have this name: a \(0\) \(0\), a \(1\)"):
        stl.MDP.from_arrays([np.eye(4)], {}, "a", state_names=["a", "a", "b", "a (0)"])
