"""Minimisation, the history encoding's sizes, graphs."""

import itertools
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.automata.graph import condition, to_dot, to_graph, verdict_text
from stltool.automata.history import history_states
from stltool.automata.minimise import coarsest_partition, quotient
from stltool.errors import SizeError
from stltool.logic.formula import boolean_value
from stltool.testing import formulas
from tests.conftest import ROOT, many


@st.composite
def machines(draw):
    n, n_letters = draw(st.integers(1, 7)), draw(st.integers(1, 2))
    delta = draw(
        st.lists(st.lists(st.integers(0, n - 1), min_size=n, max_size=n), min_size=n_letters, max_size=n_letters)
    )
    outputs = draw(st.lists(st.integers(-1, 1), min_size=n, max_size=n))
    return np.array(delta, dtype=np.int32), np.array(outputs, dtype=np.int8)


@given(machines())
def test_classes_are_the_states_that_no_word_tells_apart(machine):
    delta, outputs = machine
    n = delta.shape[1]
    classes = coarsest_partition(delta, outputs)

    def behaviour(q):
        seen = []
        for length in range(n):  # words up to n - 1 letters tell any two states apart
            for word in itertools.product(range(len(delta)), repeat=length):
                p = q
                for letter in word:
                    p = delta[letter, p]
                seen.append(outputs[p])
        return tuple(seen)

    behaviours = [behaviour(q) for q in range(n)]
    for p in range(n):
        for q in range(n):
            assert (classes[p] == classes[q]) == (behaviours[p] == behaviours[q])
    assert classes[0] == 0
    small, representative = quotient(delta, classes)
    assert small.shape == (len(delta), classes.max() + 1)
    assert (small[:, classes] == classes[delta]).all()
    assert (classes[representative] == np.arange(classes.max() + 1)).all()


def test_exact_automata_are_minimal():
    for text in ("G[0,5] (F[0,3] a & G[1,2] b)", "G[0,9] (a -> F[0,4] b)", "F[0,3] (F[0,1] a & G[0,3] b)"):
        automaton = stl.compile_automaton(stl.parse(text))
        classes = coarsest_partition(automaton.delta, automaton.verdict_rows)
        assert classes.max() + 1 == automaton.n_states


@given(formulas(labels=("a", "b"), signals=(), longest=2, max_leaves=4))
def test_the_history_encodings_size_is_predicted(phi):
    try:
        automaton = stl.compile_automaton(phi, "history", memory_limit=3_000_000)
    except SizeError:
        return
    n, steps = automaton.n_letters, automaton.parts[0].delay + 1
    assert automaton.n_states == history_states(phi, n) == sum(n**length for length in range(steps + 1))
    assert len(automaton.state_names) == automaton.n_states


def test_there_are_as_many_histories_as_sequences_of_letters():
    phi = stl.parse("G[0,1] ((F[0,2] a) | F[0,1] b)")
    for n in (1, 2, 3, 4):
        valuations = np.array(list(itertools.product([True, False], repeat=2)))[:n]
        automaton = stl.compile_automaton(phi, "history", valuations=valuations)
        assert automaton.n_states == history_states(phi, n) == sum(n**length for length in range(4))
        assert np.unique(automaton.delta).tolist() == list(range(1, automaton.n_states))


def test_the_history_encoding_is_refused_before_it_is_built():
    with pytest.raises(SizeError, match=r"2 letters over 2001 steps, inf states"):
        stl.compile_automaton(stl.parse("G[0,5] F[0,2000] a"), "history")
    with pytest.raises(SizeError, match=r"4 letters over 15 steps, 1.432e\+09 states .*use the exact encoding"):
        stl.compile_automaton(stl.parse("G[0,15) (F[0,15) a & F[0,15) b)"), "history", memory_limit=10**9)


def test_histories_are_told_newest_first():
    automaton = stl.compile_automaton(stl.parse("G[0,3] F[0,1] a"), "history")
    q = automaton.initial
    for letter in (1, 0):
        q = automaton.delta[letter, q]
    assert automaton.describe(q) == "{} after {a}"


@given(formulas(labels=("a", "b", "c"), signals=(), longest=2, max_leaves=4))
@settings(max_examples=many(25))
def test_edges_carry_the_condition_that_takes_them(phi):
    automaton = stl.compile_automaton(phi)
    if automaton.n_states > 40:
        return
    graph = to_graph(automaton)
    assert graph.number_of_nodes() == automaton.n_states
    assert [q for q, initial in graph.nodes(data="initial") if initial] == [automaton.initial]
    for q in range(automaton.n_states):
        for row, letter in zip(automaton.valuations.tolist(), automaton.letter_of.tolist(), strict=True):
            known = {str(atom): value for atom, value in zip(automaton.atoms, row, strict=True)}
            taken = [
                successor
                for _, successor, edge in graph.out_edges(q, data=True)
                if boolean_value(stl.parse(edge["condition"]), lambda psi, known=known: known.get(str(psi)))
            ]
            assert taken == [automaton.delta[letter, q]]


def test_conditions_are_short_and_use_what_the_model_rules_out(floor5):
    product = stl.build_product(floor5, stl.parse("G[0,5] (F[0,3] A & F[0,3] B)"))
    conditions = {edge["condition"] for *_, edge in to_graph(product.automaton).edges(data=True)}
    assert conditions <= {"A", "B", "!A & !B", "true", "!A", "!B", "A | B"}
    wide = stl.compile_automaton(stl.parse("F[0,1] (" + " & ".join(f"F[0,1] l{i}" for i in range(9)) + ")"))
    assert "l8" in str(condition(wide, (0,)))


@pytest.mark.parametrize(
    "text",
    [
        "G[0,9] F[0,4] a",
        "F[0,9] G[0,4] a",
        "G[0,9] (a -> F[2,5] b)",
        "G[0,9] (a -> F[0,5] b)",
        "F[0,6] G[0,3] a & G[0,9] (F[0,3] a & F[0,4] b)",
        "G[2,6] F[0,3] !a",
        "F[0,9] (a & G[0,3] b)",
        "G[3,9] F[1,3] a",
    ],
)
def test_names_of_states_are_true_of_the_run(text):
    automaton = stl.compile_automaton(stl.parse(text))
    rng = np.random.default_rng(0)
    claims = 0
    for _ in range(60):
        q, seen = automaton.initial, []
        for t in range(automaton.horizon):
            i = int(rng.integers(len(automaton.valuations)))
            seen.append(dict(zip(map(str, automaton.atoms), automaton.valuations[i].tolist(), strict=True)))
            q = automaton.delta[automaton.letter_of[i], q]
            if automaton.verdicts(t)[q] != UNDECIDED:
                break
            for name in automaton.describe(q).split("; "):
                if claim := re.match(r"(\w+) (not seen )?for (\d+) steps?", name):
                    claims += 1
                    last = seen[-int(claim[3]) :]
                    assert len(last) == int(claim[3])
                    assert all(step[claim[1]] is (claim[2] is None) for step in last), (name, seen)
    assert claims > 20 or "->" in text or "&" in text


def test_names_of_plain_windows_are_true_of_the_run():
    """F and G of one predicate say whether it has occurred, or failed; conjuncts are told apart."""
    automaton = stl.compile_automaton(stl.parse("F[0,6] a & F[0,6] b & G[0,7] c"))
    rng = np.random.default_rng(0)
    names = set()
    for _ in range(60):
        q, seen = automaton.initial, []
        for t in range(6):
            likely = [i for i, row in enumerate(automaton.valuations.tolist()) if row[2] or rng.random() < 0.05]
            i = int(rng.choice(likely))
            seen.append(dict(zip(map(str, automaton.atoms), automaton.valuations[i].tolist(), strict=True)))
            q = automaton.delta[automaton.letter_of[i], q]
            if automaton.verdicts(t)[q] != UNDECIDED:
                break
            for name in automaton.describe(q).split("; "):
                names.add(name)
                subject = name.split()[0]
                occurred = any(step[subject] for step in seen)
                expected = f"{subject} {'seen' if occurred else 'not seen yet'}" if subject != "c" else "c so far"
                assert name == expected
    assert names == {"a seen", "a not seen yet", "b seen", "b not seen yet", "c so far"}


def test_verdicts_in_words():
    automaton = stl.compile_automaton(stl.parse("G[0,4] F[0,3] a"))
    texts = {verdict_text(automaton, q) for q in range(automaton.n_states)}
    assert "false from step 3" in texts
    assert "true from step 7" in texts


def test_dot_is_graphviz_text():
    automaton = stl.compile_automaton(stl.parse("G[0,4] F[0,3] a"))
    text = to_dot(automaton)
    assert text.startswith("// Generator: stltool\n// G[0,4] F[0,3] a\ndigraph task {")
    assert 'label="a not seen for 2 steps\ntrue from step 7"' in text
    assert r"G[0,4] F[0,3] a\nhorizon 7, encoding exact" in text.replace("\n", r"\n")
    assert text.count("->") == sum(1 for _ in to_graph(automaton).edges) + 1
    with pytest.raises(SizeError, match="a picture shows at most"):
        to_dot(stl.compile_automaton(stl.parse("G[0,99] (F[0,60] a & F[0,60] b)")))


@pytest.mark.parametrize("text", ["{} | {}", "{} & {}"])
def test_parts_are_those_of_the_formula_not_of_its_negation(text):
    parts = {"F[0,9] a": "a", "F[0,5] G[0,3] b": "G[0,3] b", "G[0,5] F[0,2] c": "F[0,2] c", "d U[1,3] e": "e"}
    for one, other in itertools.combinations(parts, 2):
        found = stl.compile_automaton(stl.parse(text.format(f"({one})", f"({other})"))).parts
        assert {part.formula: part.obligation for part in found} == {
            stl.parse(part): stl.parse(parts[part]) for part in (one, other)
        }


def test_states_of_an_example_tell_what_they_remember():
    task = stl.load_task(ROOT / "examples/factory/charging.stl")
    automaton = stl.compile_automaton(task.formula)
    assert "x > 0.6 & y > 0.6 for 3 steps" in automaton.state_names
    assert "a start has succeeded" in automaton.state_names
