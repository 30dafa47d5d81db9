"""Long windows and large products: time and memory linear in the result, or a refusal at once."""

import pickle
import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.automata.joint import _distinct
from stltool.automata.machines import Exploration
from stltool.automata.minimise import coarsest_partition
from stltool.automata.reach import reachable_pairs
from stltool.automata.rows import distinct_rows
from stltool.errors import SizeError
from stltool.testing import formulas
from tests.automata.judging import judge, truth_of_all
from tests.conftest import many
from tests.oracles import moore_partition


def cpu_seconds(work):
    start = time.process_time()
    work()
    return time.process_time() - start


# ------------------------------------------------------------------------------------------- long windows


@pytest.mark.soak(only=True)
@pytest.mark.parametrize(
    ("text", "states"),
    [
        ("F[0,20000] a", 2),
        ("G[0,20000] F[0,20000] a", 20_002),
        ("F[0,20000) G[0,20000) a", 20_001),
        ("G[0,20000] (a -> F[0,20000] b)", 20_002),
        ("a U[15000,20000] b", 15_003),
        ("F[0,20000] b & G[0,9000] F[0,9000] a", 18_004),
    ],
)
def test_a_window_of_20000_takes_seconds(text, states):
    """In CPU time, with room for a busy machine: about 0.5 s; refinement by whole rounds took 22 s."""
    phi = stl.parse(text)
    made = []
    assert cpu_seconds(lambda: made.append(stl.compile_automaton(phi))) < 6
    assert made[0].n_states == states


@pytest.mark.soak(only=True)
def test_memory_is_linear_in_the_states():
    stl.compile_automaton(stl.parse("F[0,3] a"))
    for window in (500, 2000):
        phi = stl.parse(f"G[0,{window}] F[0,{window}] a")
        tracemalloc.start()
        automaton = stl.compile_automaton(phi)
        kept, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert kept < 700 * automaton.n_states + 100_000
        assert peak < 1500 * automaton.n_states + 300_000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("G[0,10000] (F[0,10000] A & F[0,10000] B)", "product of parts with 10002 × 10002 states, of which over"),
        ("G[0,9] F[0,300000] a", "F.0,300000. a grows over 100000 states; shorten its inner windows"),
    ],
)
def test_what_explodes_is_refused_soon(text, message):
    def refused():
        with pytest.raises(SizeError, match=message):
            stl.compile_automaton(stl.parse(text))

    assert cpu_seconds(refused) < 6


@pytest.mark.parametrize(
    ("text", "states", "enough", "message"),
    [
        ("G[0,30] (F[0,30] a & F[0,30] b)", 962, 200_000, r"over 6\d\d states and 4 letters, would take"),
        ("F[0,9] (a & F[0,9] (b & F[0,9] c))", 441, 600_000, "over 38 states and 8 letters, would take"),
    ],
)
def test_what_takes_too_much_memory_is_refused_before(text, states, enough, message):
    phi = stl.parse(text)
    assert stl.compile_automaton(phi, memory_limit=enough).n_states == states
    with pytest.raises(SizeError, match=message + ".* compile it for a model in which few letters occur"):
        stl.compile_automaton(phi, memory_limit=40_000)


@pytest.mark.parametrize(
    "text",
    [
        "G[0,150] F[0,120] a",
        "F[0,90] G[0,130] a",
        "G[0,100] (a -> F[0,140] b)",
        "G[0,60] (a -> (a U[0,150] b))",
        "a U[70,150] b",
        "F[0,100] b & G[0,120] F[0,60] a",
        "G[30,150] F[20,90] a | F[0,100] G[0,40] b",
    ],
)
def test_long_windows_are_judged_right(text):
    """Traces of few switches, so that windows are filled, and missed by a step."""
    phi = stl.parse(text)
    automaton = stl.compile_automaton(phi)
    rng = np.random.default_rng(0)
    n = stl.horizon(phi) + 1
    traces = {name: np.empty((60, n), dtype=bool) for name in ("a", "b")}
    for values in traces.values():
        for row in values:
            gaps = rng.choice([1, 2, 40, 60, 61, 62, 90, 120, 121, 122, 130, 131, 150, 151], size=n)
            switches = np.cumsum(gaps)
            row[:] = (np.searchsorted(switches, np.arange(n), side="right") + rng.integers(2)) % 2
    expected = truth_of_all(phi, traces)
    said = [judge(automaton, {name: values[i] for name, values in traces.items()})[0] for i in range(60)]
    assert said == expected.tolist()
    assert expected.any()
    assert not expected.all()


# ------------------------------------------------------------------------------------------- the tools


def made_of_counters(rng):
    """Counters side by side, some letters reset them, with states that nothing tells apart shuffled in."""
    lengths = rng.integers(1, 12, size=rng.integers(1, 4))
    shape = tuple(int(n) + 1 for n in lengths)
    counters = np.indices(shape).reshape(len(shape), -1)
    delta = []
    for _ in range(rng.integers(1, 4)):
        reset = rng.random(len(shape)) < 0.5
        after = [
            np.zeros_like(c) if r else np.minimum(c + 1, n) for c, r, n in zip(counters, reset, lengths, strict=True)
        ]
        delta.append(np.ravel_multi_index(after, shape))
    outputs = np.where((counters == lengths[:, None]).any(axis=0), 1, -1)
    copies = 1 + int(rng.integers(3))
    n = len(outputs)
    table = np.concatenate([np.stack(delta) + n * int(rng.integers(copies)) for _ in range(copies)], axis=1)
    order = rng.permutation(n * copies)
    place = np.argsort(order)
    return place[table[:, order]].astype(np.int32), np.tile(outputs, copies)[order].astype(np.int8)


def test_refinement_by_changes_is_refinement_by_rounds():
    rng = np.random.default_rng(0)
    merged = 0
    for _ in range(150):
        delta, outputs = made_of_counters(rng)
        classes = coarsest_partition(delta, outputs)
        assert classes.tolist() == moore_partition(delta.tolist(), outputs.tolist())
        merged += classes.max() + 1 < delta.shape[1]
    for _ in range(150):
        n, n_letters = int(rng.integers(1, 80)), int(rng.integers(1, 4))
        delta = rng.integers(0, n, size=(n_letters, n)).astype(np.int32)
        outputs = (rng.random((2, n)) < 0.1).astype(np.int8)
        classes = coarsest_partition(delta, outputs)
        assert classes.tolist() == moore_partition(delta.tolist(), outputs.T.tolist())
        merged += classes.max() + 1 < n
    assert merged > 100


@given(phi=formulas(labels=("a", "b", "c"), signals=(), longest=4, max_leaves=5))
@settings(max_examples=many(100))
def test_compiled_automata_are_minimal_and_reach_all_their_states(phi):
    try:
        automaton = stl.compile_automaton(phi, most_states=2000)
    except SizeError:
        return
    n = automaton.n_states
    classes = moore_partition(automaton.delta.tolist(), automaton.verdict_rows.T.tolist())
    assert classes == list(range(n))
    search = Exploration([automaton.initial], lambda q: automaton.delta[:, q].tolist())
    assert search.grow(n)
    assert sorted(search.states) == list(range(n))


def test_an_exploration_goes_on_where_it_stopped():
    rng = np.random.default_rng(0)
    delta = rng.integers(0, 200, size=(2, 200))
    whole, pieces = (Exploration([0], lambda q: delta[:, q].tolist()) for _ in range(2))
    assert whole.grow(200)
    grown = [pieces.grow(most) for most in (5, 20, 21, 200)]
    assert grown == [False, False, False, True]
    assert pieces.states == whole.states
    assert (pieces.delta == whole.delta).all()
    assert (np.array(whole.states)[whole.delta] == delta[:, whole.states]).all()
    chain = Exploration([0], lambda q: [min(q + 1, 50)])
    assert not chain.grow(40, longest=50)
    assert len(chain.states) == 1  # refused before anything is made
    assert chain.grow(51, longest=50)


tables = st.integers(1, 5).flatmap(
    lambda width: st.lists(st.lists(st.integers(0, 3), min_size=width, max_size=width), min_size=1, max_size=9)
)


@given(rows=tables, kind=st.sampled_from([np.int8, np.int32, np.int64]))
def test_distinct_rows_are_numpys(rows, kind):
    table = np.array(rows, dtype=kind)
    expected, first, inverse = np.unique(table, axis=0, return_index=True, return_inverse=True)
    places, number = distinct_rows(table)
    assert (table[places] == expected).all()
    assert places.tolist() == first.tolist()
    assert number.tolist() == inverse.ravel().tolist()
    below = distinct_rows(table - 1)[1]
    assert [[i == j for i in below] for j in below] == [[i == j for i in number] for j in number]


@given(seed=st.integers(0, 10**6), batch=st.sampled_from([1, 7, 1 << 20]))
@settings(max_examples=many(60))
def test_reachable_pairs_are_those_that_words_lead_to(seed, batch):
    rng = np.random.default_rng(seed)
    left, right = (rng.integers(0, n, size=(2, n)).astype(np.int32) for n in (6, 9))
    found = {(1, 2)}
    while True:
        after = {(int(left[a, p]), int(right[a, q])) for p, q in found for a in range(2)}
        if after <= found:
            break
        found |= after
    known = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stltool.automata.reach._CELLS", batch)
        p, q, delta = reachable_pairs(left, right, [(1, 2)], known.append)
    assert list(zip(p.tolist(), q.tolist(), strict=True)) == sorted(found)
    assert (p[delta] == left[:, p]).all()
    assert (q[delta] == right[:, q]).all()
    assert known[-1] == len(found)


# ------------------------------------------------------------------------------------------- names


def test_states_are_named_when_asked():
    """Texts of 20 000 states that nobody reads are not made; they are there like those of a list."""
    automaton = stl.compile_automaton(stl.parse("G[0,20] F[0,5] a & F[0,3] b"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stltool.automata.machines._Memory.__call__", lambda *given: pytest.fail("a phrase was made"))
        stl.compile_automaton(stl.parse("G[0,20] F[0,5] a & F[0,3] b"))
    names = automaton.state_names
    assert len(names) == automaton.n_states
    assert list(names) == [automaton.describe(q) for q in range(len(names))] == list(names[:])
    assert names[-1] == names[len(names) - 1]
    assert len(set(names)) > 10
    with pytest.raises(IndexError):
        names[len(names)]
    assert pickle.loads(pickle.dumps(automaton)).state_names[5] == names[5]  # as processes of a user's own do


def test_neighbours_move_together():
    """Whichever part is written first, the long counter runs through neighbours: δ is made of shifts and constants."""
    steps = {}
    for text in ("G[0,40] (F[0,10] a & F[0,90] b)", "G[0,40] (F[0,90] b & F[0,10] a)"):
        automaton = stl.compile_automaton(stl.parse(text))
        moves = np.diff(automaton.delta, axis=1)
        steps[text] = ((moves == 0) | (moves == 1)).mean()
    assert min(steps.values()) > 0.97, steps


# ------------------------------------------------------------------------------------------- joint automata


def joint_of(texts):
    """The joint automaton of formulas over one label each, every joint letter in it."""
    automata = [stl.compile_automaton(stl.parse(text)) for text in texts]
    letters = np.array(list(np.ndindex(*(a.n_letters for a in automata))), dtype=np.int32)
    return stl.automata.join_automata(automata, letters), automata, letters


def test_ten_automata_of_100_states_are_joined_where_few_states_are_reached():
    """Their product has 101^10 states; they all watch one label, so about 100 rows a step are reached."""
    automata = [stl.compile_automaton(stl.parse(f"G[0,{30 + i}] F[0,{98 + i}] a")) for i in range(10)]
    assert all(automaton.n_states >= 100 for automaton in automata)
    letters = np.array([[a.letters_at(np.array([[holds]]))[0] for a in automata] for holds in (False, True)])
    joint = stl.automata.join_automata(automata, letters)
    assert joint.n_states < 20_000
    rng = np.random.default_rng(0)
    for _ in range(20):
        states, column = [a.initial for a in automata], 0
        word = rng.random(joint.horizon + 1) < rng.choice([0.01, 0.03, 0.1])
        for t, layer in enumerate((joint.start, *joint.layers[:-1])):
            letter = int(word[t])
            states = [
                int(a.delta[letters[letter, i], q]) for i, (a, q) in enumerate(zip(automata, states, strict=True))
            ]
            was = layer.states[column]
            column = int(layer.delta[letter, column])
            following = joint.layers[t].states[column]
            for i, (a, q) in enumerate(zip(automata, states, strict=True)):
                open_still = was[i] != -1 and a.verdicts(t)[q] == UNDECIDED
                assert following[i] == (q if open_still else -1)


def test_layers_that_repeat_are_made_once():
    joint, automata, letters = joint_of(["F[0,3000] a", "G[0,2000] !a", "F[500,1000] a"])
    assert joint.horizon == 3000
    assert len({id(layer) for layer in joint.layers}) < 30
    column, states, decided = 0, [a.initial for a in automata], [False] * 3
    rng = np.random.default_rng(0)
    for t, layer in enumerate((joint.start, *joint.layers[:-1])):
        letter = int(rng.integers(len(letters))) if t % 700 == 600 else 0
        states = [int(a.delta[letters[letter, i], q]) for i, (a, q) in enumerate(zip(automata, states, strict=True))]
        decided = [done or a.verdicts(t)[q] != UNDECIDED for done, a, q in zip(decided, automata, states, strict=True)]
        column = int(layer.delta[letter, column])
        expected = [-1 if done else q for done, q in zip(decided, states, strict=True)]
        assert joint.layers[t].states[column].tolist() == expected


def test_joint_states_are_told_apart_where_codes_would_wrap():
    """Five automata of 2^16 states: in 64 bits the last one's state would be multiplied by 0."""
    columns = np.array([[7, 7, 7]] * 4 + [[5, 3, 5]], dtype=np.int32)
    first, number = _distinct(columns, [2**16] * 5)
    assert first.tolist() == [1, 0]
    assert number.tolist() == [1, 0, 1]


@given(seed=st.integers(0, 10**6), largest=st.sampled_from([30, 200, 2**62]))
def test_joint_states_are_numbered_as_rows(seed, largest):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(2, 6, size=4).tolist()
    columns = np.stack([rng.integers(-1, size - 1, size=12) for size in sizes]).astype(np.int32)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stltool.automata.joint._LARGEST_CODE", largest)
        first, number = _distinct(columns, sizes)
    expected, places, inverse = np.unique(columns[::-1].T, axis=0, return_index=True, return_inverse=True)
    assert first.tolist() == places.tolist()
    assert number.tolist() == inverse.ravel().tolist()
    assert (expected == columns[:, first][::-1].T).all()


def test_a_joint_automaton_too_large_is_refused_before_it_is_made():
    automata = [stl.compile_automaton(stl.parse(f"G[0,99] F[0,60] l{i}")) for i in range(4)]
    letters = np.array(list(np.ndindex(2, 2, 2, 2)), dtype=np.int32)
    tracemalloc.start()
    with pytest.raises(SizeError, match=r"a joint automaton of 62 × 62 × 62 × 62 automaton states over 159 steps"):
        stl.automata.join_automata(automata, letters, memory_limit=5_000_000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5_000_000
