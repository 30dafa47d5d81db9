"""Random MDPs are valid and exact where asked, policies fit their products, texts of task files parse."""

from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.logic.format import format_task
from stltool.logic.formula import temporal_depth
from stltool.testing import formulas, mdps, policies, predicates, task_files
from tests.conftest import many


@given(mdps(states=4, actions=3, exact=True))
@settings(max_examples=many(50))
def test_exact_models_have_exact_rows(model):
    assert model.rows.given_exactly
    assert (model.rows.defect, model.initial_total) == (0, 1)
    product = stl.build_product(model, stl.parse("F[0,2] (a | x > 0)"))
    result = stl.check(product, exact=True)
    assert result.lower <= result.fraction <= result.upper


@given(data=st.data())
@settings(max_examples=many(50))
def test_policies_are_defined_everywhere(data):
    model = data.draw(mdps())
    product = stl.build_product(model, data.draw(formulas(longest=2, max_leaves=2)))
    policy = data.draw(policies(product))
    best = stl.check(product)
    result = stl.check(product, policy)
    assert result.lower <= best.upper
    assert stl.check(product, maximize=False).lower <= result.upper


def test_all_forms_of_policies_are_drawn():
    model = stl.MDP.from_arrays([[[1, 0], [0, 1]], [[0, 1], [1, 0]]], {}, labels={"a": [0, 1]})
    small, large = (stl.build_product(model, stl.parse(f"F[0,{n}] a")) for n in (2, 300))
    kinds = set()

    @given(policies(small), policies(large))
    @settings(max_examples=20, derandomize=True, database=None)
    def collect(one, other):
        kinds.update([one.kind, other.kind])

    collect()
    assert kinds == {
        f"{time}, {how}" for time in ("stationary", "time-dependent") for how in ("deterministic", "mixed")
    }
    assert all(policy.deterministic for policy in [sampled(policies(small, mixed=False)) for _ in range(3)])


def sampled(strategy):
    found = []
    settings(max_examples=1, database=None)(given(strategy)(lambda one: found.append(one)))()
    return found[0]


@given(text=task_files(past=True))
@settings(max_examples=many(60))
def test_texts_of_task_files_parse_and_keep_their_layout(text):
    task = stl.parse_task(text)
    assert task.name == "task"
    assert stl.parse_task(format_task(text)) == task


@given(
    st.tuples(st.integers(0, 2), st.integers(0, 4)).flatmap(
        lambda pair: st.tuples(st.just(pair), formulas(depth=pair[0], horizon=pair[1]))
    )
)
@settings(max_examples=many(100))
def test_formulas_keep_to_their_depth_and_horizon(drawn):
    (depth, horizon), phi = drawn
    assert temporal_depth(phi) <= depth
    assert stl.horizon(phi) <= horizon


@given(
    phi=formulas(fragment="paper", labels=("a",), signals={"x": (0, 9)}, horizon=3), psi=predicates((), {"x": (2, 3)})
)
@settings(max_examples=many(60))
def test_fragments_and_ranges(phi, psi):
    assert stl.check_fragment(phi).parts
    assert stl.horizon(phi) <= 3
    numbers = [float(word.strip("()!")) for word in str(psi).split() if word.strip("()!").replace(".", "").isdigit()]
    assert all(2 <= number <= 3 for number in numbers)
