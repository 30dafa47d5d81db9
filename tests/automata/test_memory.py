"""What automaton states remember, as data: phrases, numbers, and the tracks that sliders move on."""

import numpy as np
import pytest

import stltool as stl
from stltool.automata import FALSE
from stltool.logic.formula import Label
from tests.conftest import FACTORY

FORMULAS = [
    "G[0,4] (F[0,5] a & F[0,5] b)", "F[0,5] G[0,3] a", "G[0,5] (a -> F[1,3] b)", "(!a) U[2,5] b",
    "F[0,3] a & G[0,4] !b", "F[2,4] a | G[0,2] F[0,2] b", "a & F[1,2] b",
]  # fmt: skip


@pytest.mark.parametrize("formula", FORMULAS)
def test_tracks_and_names_say_the_same(formula):
    automaton = stl.compile_automaton(stl.parse(formula))
    tracks = automaton.tracks()
    assert len(tracks) == len(automaton.parts)
    for q, name in enumerate(automaton.state_names):
        levels = [track.levels[track.level_of[q]] for track in tracks]
        assert automaton.memory(q) == tuple(levels)
        assert name == automaton.describe(q) == "; ".join(level.phrase for level in levels)
    for track in tracks:
        assert [level.rank for level in track.levels] == sorted(level.rank for level in track.levels)
        assert set(track.level_of.tolist()) == set(range(len(track.levels)))


def test_a_counter_counts_to_its_limit_and_fails_after_it():
    """G[0,4] (F[0,5] a & F[0,5] b) without an a: its counter goes up to the limit, and then the part has failed."""
    automaton = stl.compile_automaton(stl.parse(FORMULAS[0]))
    track = automaton.tracks()[0]
    [only_b] = np.flatnonzero([row == [False, True] for row in automaton.valuations.tolist()])
    q, seen = automaton.initial, []
    for _ in range(6):
        q = automaton.delta[automaton.letter_of[only_b], q]
        seen.append(track.levels[track.level_of[q]])
    assert track.name == "a"
    assert [level.number for level in seen] == [1, 2, 3, 4, 5, None]
    assert [level.status for level in seen] == ["open"] * 4 + ["due", "failed"]
    assert all(level.limit == 5 and level.risk and level.subject == "a" for level in seen[:-1])
    assert automaton.verdicts(5)[q] == FALSE
    assert seen[1].phrase == "a not seen for 2 steps"


def test_success_is_no_risk():
    [track] = stl.compile_automaton(stl.parse("F[0,5] G[0,3] a")).tracks()
    assert {level.risk for level in track.levels if level.number is not None} == {False}
    assert track.levels[-1].status == "done"


@pytest.mark.parametrize("encoding", ["paper", "history"])
def test_other_encodings_have_tracks_too(encoding):
    automaton = stl.compile_automaton(stl.parse("G[0,3] (F[0,3] a & G[0,2] b)" if encoding == "history" else
                                                "G[0,3] (F[0,3] a & G[0,3] b)"), encoding)  # fmt: skip
    tracks = automaton.tracks()
    assert [automaton.describe(q) for q in range(automaton.n_states)] == list(automaton.state_names)
    if encoding == "paper":
        assert [[level.number for level in track.levels] for track in tracks] == [[0, 1, 2, 3, 4]] * 2
        assert [track.levels[0].phrase for track in tracks] == ["a seen now", "b does not hold"]


def test_formulas_are_written_as_asked():
    phi = stl.parse("G[0,2] F[0,3] (x > 1 & a)")
    automaton = stl.compile_automaton(phi)
    named = automaton.tracks(lambda psi: "here" if str(psi) == "x > 1 & a" else str(psi))
    assert [level.phrase for level in named[0].levels][1:3] == ["here not seen for 1 step", "here not seen for 2 steps"]
    assert named[0].name == "here"


def test_a_policys_own_memory_is_told_apart(patrolling, flagged):
    policy = stl.Policy(flagged, stl.check(flagged).policy.table)
    product, _ = policy.on(patrolling)
    tracks = product.automaton.tracks()
    assert len(tracks) == 4
    assert [track.levels[0].phrase.startswith("the policy: ") for track in tracks] == [False, False, True, True]
    assert product.automaton.describe(3) == "; ".join(one.phrase for one in product.automaton.memory(3))


def test_a_product_keeps_the_names_of_predicates(floor5):
    task = stl.load_task(FACTORY / "patrolling.stl")
    product = stl.build_product(floor5, task)
    assert {name: str(phi) for name, phi in product.definitions.items()} == {"at_A": "A", "at_B": "x < 0.4 & y > 0.6"}
    assert product.definitions["at_A"] == Label("A")
    assert stl.build_product(floor5, task.formula).definitions == {}
