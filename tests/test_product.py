import numpy as np
import pytest

import stltool as stl
from stltool.errors import ArgumentError, InexactEncodingWarning, NameLookupError


def test_names_are_bound_or_refused_with_their_place(floor5):
    cases = [
        ("F[0,3] D", "line 1, column 8: the model has no label D; known names: A, B, C, x, y"),
        ("F[0,3] xx > 0.5", "the model has no signal xx; did you mean x?"),
        ("F[0,3] A > 0.5", "A is not a signal of the model but a label; use it without comparing"),
        ("F[0,3] x", "x is not a label of the model but a signal; compare it with a number"),
    ]
    for text, says in cases:
        with pytest.raises(NameLookupError) as caught:
            stl.build_product(floor5, stl.parse(text))
        assert says in str(caught.value)


def test_unknown_labels_of_a_task_file_carry_file_line_and_caret(floor5, tmp_path):
    path = tmp_path / "task.stl"
    path.write_text("at_A := A\n  at_D := Dock\ntask := F[0,3] (at_A & at_D)\n")
    with pytest.raises(NameLookupError) as caught:
        stl.build_product(floor5, stl.load_task(path))
    assert f"{path}, line 2, column 11" in str(caught.value)
    assert str(caught.value).endswith("      at_D := Dock\n              ^^^^")


def test_a_name_with_two_meanings_is_refused(floor5):
    for text in ("param x = 3\nr := F[0,3] (x > 2)", "A := x > 0.9\nr := F[0,3] A"):
        with pytest.raises(NameLookupError, match=r"is defined in the task, and the model has a (signal|label)"):
            stl.build_product(floor5, stl.parse_task(text))


def test_predicates_are_decided_exactly(floor5):
    """No cell has x - y > 1/5 with y > 3/5; in doubles, 0.9 - 0.7 is more than 0.2."""
    assert stl.check(stl.build_product(floor5, stl.parse("F[0,10] (x - y > 0.2 & y > 0.6)"))).probability == 0


def test_text_is_not_a_formula(floor5):
    calls = [
        lambda text: stl.build_product(floor5, text),
        lambda text: stl.satisfies(text, {"A": [1]}),
        stl.check_fragment,
        stl.compile_automaton,
    ]
    for call in calls:
        with pytest.raises(ArgumentError, match="parse it: stl.parse"):
            call("F[0,3] A")


def test_the_way_back_to_the_users_names(patrolling, flagged):
    s = int(patrolling.model.initial.argmax())
    index = s * flagged.automaton.n_states + 3 * 6 + 2
    assert flagged.describe(index, t=4) == (
        "step 4, state (1,0); x = 0.3, y = 0.1; A seen 2 steps ago; x < 0.4 & y > 0.6 seen 3 steps ago"
    )
    assert flagged.n_states == 18 * 36
    assert patrolling.n_states == 18 * 26
    assert patrolling.task_name == "patrolling"


def test_letters_are_those_that_occur(patrolling):
    assert patrolling.automaton.n_letters == 3  # nowhere both A and B
    model = patrolling.model
    for s in range(model.n_states):
        valuation = [bool(model.labels["A"][s]), bool(model.labels["B"][s])]
        assert patrolling.automaton.letters_at(np.array([valuation])) == patrolling.letter[s]


def test_the_papers_encoding_warns_where_it_approximates(floor5):
    phi = stl.parse("F[0,3) (F[0,2) A & G[0,4) B)")
    with pytest.warns(InexactEncodingWarning):
        product = stl.build_product(floor5, phi, encoding="paper")
    assert not product.automaton.exact
