"""The gate: every expectation of task files is judged, each question once, and nothing is decided that is not known."""

import itertools
import operator
import tempfile
from fractions import Fraction
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool import gate
from stltool.errors import StlToolError
from stltool.testing import interval_mdps
from tests import oracles
from tests.conftest import many

COIN = 'kind = "grid"\nmap = "SA"\ncell = 1\nmoves = "cross"\nsuccess = "1/3"\n'
BLURRED = COIN.replace('"1/3"', '["1/4", "1/2"]')
RELATIONS = {">=": operator.ge, "<=": operator.le, ">": operator.gt, "<": operator.lt}


@pytest.fixture
def written(tmp_path):
    """Write a task file on the coin, or on another model, and return its path."""

    def write(*lines, name="task.stl", model="coin.toml"):
        (tmp_path / "coin.toml").write_text(COIN)
        (tmp_path / "blurred.toml").write_text(BLURRED)
        path = tmp_path / name
        path.write_text("\n".join([f'model "{model}"', "reach := F[0,1] A", *lines, ""]))
        return path

    return write


def verdicts(found):
    return [result.verdict for result in found.results]


@pytest.mark.parametrize("relation", RELATIONS)
@pytest.mark.parametrize("bound", ["0.333", "1/3", "0.334", "0", "1"])
def test_verdicts_are_those_of_the_exact_value(written, relation, bound):
    """P is 1/3, which no double is: next to it the fraction decides, and elsewhere the enclosure."""
    (found,) = stl.verify(written(f"expect Pmax(reach) {relation} {bound}")).results
    holds = RELATIONS[relation](Fraction(1, 3), Fraction(bound))
    assert found.verdict == ("holds" if holds else "does not hold")
    assert found.decided_by == ("fraction" if bound == "1/3" else "enclosure")
    assert found.result.lower <= Fraction(1, 3) <= found.result.upper


def test_a_bound_inside_the_enclosure_is_undecided_if_the_fraction_takes_too_long(written):
    path = written("expect Pmax(reach) >= 1/3", "expect Pmax(reach) >= 0.3")
    found = stl.verify(path, exact_seconds=0)
    assert verdicts(found) == ["undecided", "holds"]
    assert found.results[0].decided_by is None
    assert "lies inside the enclosure" in found.results[0].reason
    assert "over the limit of 0 s" in found.results[0].reason
    assert not found.holds


def test_what_is_decided_is_true_of_every_value_in_the_enclosure():
    grid = [Fraction(n, 4) for n in range(5)]
    for relation, (lower, upper), bound in itertools.product(
        RELATIONS, itertools.combinations_with_replacement(grid, 2), grid
    ):
        told = gate._compared(relation, bound, lower, upper)
        inside = [lower, upper, (lower + upper) / 2, *([bound] if lower <= bound <= upper else [])]
        truths = {RELATIONS[relation](value, bound) for value in inside}
        assert told == (truths.pop() if len(truths) == 1 else None), (relation, lower, upper, bound)


def test_each_model_is_read_once_and_each_question_answered_once(written, monkeypatch):
    loads, checks, products = [], [], []
    for name, calls in (("load_model", loads), ("check", checks), ("build_product", products)):
        door = getattr(gate, name)
        monkeypatch.setattr(gate, name, lambda *a, door=door, calls=calls, **k: calls.append(a) or door(*a, **k))
    first = written("expect Pmax(reach) >= 0.1", "expect Pmax(F[0,1] A) <= 0.9", "expect Pmin(reach) >= 0")
    second = written("expect Pmax(reach) >= 1/3", "expect Pmax(reach) > 1/3", name="other.stl")
    found = stl.verify([first, second, first])
    assert verdicts(found) == ["holds", "holds", "holds", "holds", "does not hold"]
    assert (len(loads), len(products)) == (1, 1)
    assert len(checks) == 3  # maximum, minimum, and the maximum as a fraction


def test_params_are_those_of_the_files_and_the_others_those_of_the_models(written):
    """-p goal=…: in every file with a param of that name; success is the parameter of the coin."""
    first = written("param goal = 0.9", "expect Pmax(reach) >= goal", "expect Pmax(F[0,1] A) <= 1/3")
    second = written("expect Pmin(F[0,0] A) <= 0", "expect Pmax(reach) >= 1/2", name="second.stl")
    third = written("param success = 1", "expect Pmax(reach) <= success / 3", name="third.stl")
    files = [first, second, third]
    assert verdicts(stl.verify(files)) == ["does not hold", "holds", "holds", "does not hold", "holds"]
    found = stl.verify(files, params={"goal": "1/4"})
    assert verdicts(found) == ["holds", "holds", "holds", "does not hold", "holds"]
    assert found.results[0].expectation.bound == Fraction(1, 4)
    found = stl.verify(files, params={"success": "1/2"})  # of the third file it is a param, and its coin is as it was
    assert verdicts(found) == ["does not hold", "does not hold", "holds", "holds", "does not hold"]
    assert [result.result.probability for result in found.results] == [0.5, 0.5, 0, 0.5, pytest.approx(1 / 3)]
    with pytest.raises(StlToolError, match="gaol: no task file has a param, and no model a parameter, of"):
        stl.verify(files, params={"gaol": 1, "goal": 1})
    with pytest.raises(StlToolError, match="success"):
        stl.verify(second, params={"success": 2})


def test_policies_and_traces_are_relative_to_the_task_file(written, tmp_path, monkeypatch):
    path = written(
        'expect P(reach, policy "best.npz") >= 1/3', 'expect holds(F[0,1] x > 0.5, trace "log.csv")',
        'expect holds(G x > 0.5, trace "log.csv")', 'expect holds(F[0,1] x > 0.5, trace "batch.npz")',
    )  # fmt: skip
    product = stl.build_product(stl.load_model(tmp_path / "coin.toml"), stl.load_task(path))
    stl.check(product).policy.save(tmp_path / "best.npz")
    (tmp_path / "log.csv").write_text("x\n0\n1\n0\n")
    np.savez(tmp_path / "batch.npz", x=np.array([[1.0, 0.0], [0.0, 0.0]]))
    monkeypatch.chdir(tmp_path.parent)
    found = stl.verify(path)
    assert verdicts(found) == ["holds", "holds", "does not hold", "does not hold"]
    assert [result.decided_by for result in found.results] == ["fraction", "trace", "trace", "trace"]
    assert found.results[3].monitored.verdicts[:, 0].tolist() == [True, False]


def test_robust_is_what_is_guaranteed(written):
    """Nature opposes the claim: of one policy that always tries, P is anything from 1/4 to 1/2."""
    lines = [
        f"expect robust Pmax(reach) {relation} {bound}" for relation, bound in ((">=", 0.24), (">", 0.26), ("<=", 0.51))
    ]
    found = stl.verify(written(*lines, "expect robust Pmax(reach) <= 0.49", model="blurred.toml"))
    assert verdicts(found) == ["holds", "does not hold", "holds", "does not hold"]
    product = found.results[0].result.product
    least, greatest = (stl.robust_check(product, nature=nature).probability for nature in ("against", "with"))
    assert [result.result.probability for result in found.results] == [least, least, greatest, greatest]


@pytest.mark.soak
@given(interval_mdps(states=3), st.sampled_from([Fraction(n, 8) for n in range(1, 8)]))
@settings(max_examples=many(15))
def test_nature_opposes_every_claim(model, bound):
    """Against the tree of all histories, in fractions: >= and > are about the least that nature can do, <= and < about
    the greatest."""
    claims = [(question, relation) for question in ("Pmax", "Pmin") for relation in RELATIONS]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "task.stl")
        lines = [f"expect robust {question}(phi) {relation} {bound}" for question, relation in claims]
        path.write_text("\n".join(['model "blurred.toml"', "phi := F[0,2] a & (b | G[0,1] c)", *lines, ""]))
        with mock.patch.object(gate, "load_model", return_value=model):
            found = stl.verify(path)
    formula = found.results[0].task.formula
    for (question, relation), result in zip(claims, found.results, strict=True):
        exact = oracles.robust_optimum(model, formula, question == "Pmax", relation in (">=", ">"))
        if result.verdict == "undecided":
            assert abs(exact - bound) < 1e-9
        else:
            assert (result.verdict == "holds") == RELATIONS[relation](exact, bound), (question, relation, exact)


def test_robust_minimum_and_policy(written, tmp_path):
    path = written(model="blurred.toml")
    product = stl.build_product(stl.load_model(tmp_path / "blurred.toml"), stl.load_task(path))
    stl.robust_check(product).policy.save(tmp_path / "best.npz")
    found = stl.verify(
        written(
            'expect robust P(reach, policy "best.npz") >= 0.24',
            'expect robust P(reach, policy "best.npz") <= 0.4',
            "expect robust Pmin(reach) <= 0",
            "expect robust Pmin(reach) > 0",
            model="blurred.toml",
        )
    )
    assert verdicts(found) == ["holds", "does not hold", "holds", "does not hold"]
    assert found.results[1].result.probability == pytest.approx(0.5, abs=1e-12)


def test_intervals_are_decided_exactly(written, tmp_path):
    """1/4 lies inside the enclosure; the certificate proves it, with nature's aim."""
    texts = "expect robust Pmax(reach) >= 1/4", "expect robust Pmax(reach) > 1/4"
    found = stl.verify(written(*texts, model="blurred.toml"), certificates=tmp_path / "proofs").results
    assert [(one.verdict, one.decided_by) for one in found] == [("holds", "fraction"), ("does not hold", "fraction")]
    for one in found:
        assert one.certificate.lower == one.certificate.upper == Fraction(1, 4)
        assert stl.certify(one.certificate.path)["nature"] == "least"


def test_parameters_without_values_have_no_exact_answer(written, tmp_path):
    text = COIN.replace('"1/3"', '"p"\nslip = "(1-p)/3"\n[parameters]\np = [0.25, 0.5]')
    (tmp_path / "open.toml").write_text(text)
    path = written("expect robust Pmax(reach) >= 1/4", model="open.toml")
    (found,) = stl.verify(path, certificates=tmp_path / "proofs").results
    assert (found.verdict, found.decided_by, found.certificate) == ("undecided", None, None)
    assert "no exact arithmetic for parameters without values" in found.reason


def test_robust_fractions_that_take_too_long_leave_it_undecided(written):
    (found,) = stl.verify(written("expect robust Pmax(reach) >= 1/4", model="blurred.toml"), exact_seconds=0).results
    assert found.verdict == "undecided"
    assert "over the limit of 0 s" in found.reason


def test_one_fault_later_on_does_not_stop_the_others(written, tmp_path):
    (tmp_path / "no.npz").write_bytes(b"no policy")
    (tmp_path / "short.csv").write_text("x\n0\n")
    found = stl.verify(
        written(
            'expect P(reach, policy "no.npz") >= 0.5',
            'expect holds(F[0,1] x > 0, trace "short.csv")',
            'expect holds(F[0,1] true, trace "short.csv")',
            "expect Pmax(reach) >= 0.3",
        )
    )
    assert verdicts(found) == ["error"] * 3 + ["holds"]
    for result, told in zip(found.results, ["no.npz", "samples", "constant"], strict=False):
        assert told in result.reason
    assert found.count() == {"holds": 1, "does not hold": 0, "undecided": 0, "error": 3}
    for result, file in zip(found.results, ["no.npz", "short.csv"], strict=False):  # as the task file names them
        assert file in result.reason
        assert str(tmp_path) not in result.reason


@pytest.mark.parametrize(
    ("line", "model", "told"),
    [
        ('expect P(reach, policy "none.npz") >= 0.5', "coin.toml", r"line 3, column 1: the policy file .*none\.npz"),
        ('expect holds(reach, trace "none.csv")', "coin.toml", r"line 3, column 1: the trace file .*none\.csv"),
        ('expect holds(reach, trace "..")', "coin.toml", "is not a regular file"),
        ("expect Pmax(reach) >= 0.5", "none.toml", "there is no such model file"),
        ("expect Pmax(reach) >= 0.5", "blurred.toml", "are intervals; write robust Pmax"),
        ("expect robust Pmin(reach) >= 0.5", "coin.toml", "are not intervals; leave robust out"),
        ("expect Pmax(reach) >= 1.5", "coin.toml", "1.5 is not a probability"),
        ("", "coin.toml", "no expectations to verify; add a line such as expect Pmax"),
    ],
)
def test_faults_are_told_before_anything_is_computed(written, line, model, told):
    with (
        mock.patch.object(gate, "check", side_effect=AssertionError),
        pytest.raises(StlToolError, match=told),
    ):
        stl.verify(
            [written("expect Pmax(reach) >= 0", name="good.stl") if line else written(), written(line, model=model)]
        )


def test_all_faults_of_all_files_are_told_together(written, tmp_path):
    paths = [
        written('expect P(reach, policy "a.npz") > 0', 'expect holds(reach, trace "b.csv")'),
        written("expect Pmax(reach) > 0", "expect Pmin(reach) > 0", name="two.stl", model="none.toml"),
        written("expect Pmax(reach) > 2", name="three.stl"),
        tmp_path / "four.stl",
    ]
    with pytest.raises(StlToolError) as refused:
        stl.verify(paths)
    said = str(refused.value)
    assert said.endswith("5 errors")
    assert said.count("none.toml") == 1  # two expectations need it
    for told in ("a.npz", "b.csv", "2 is not a probability", "four.stl"):
        assert told in said


def test_every_kind_of_fault_is_told_at_once(written):
    """Faults of syntax, files, names, natures and horizons, all of them before anything is computed."""
    path = written(
        "expect Pmax(reach) == 0.9",
        'expect P(reach, policy "none.npz") >= 0.5',
        'expect holds(reach, trace "none.csv")',
        "expect robust Pmax(reach) >= 0.5",
        "expect Pmax(raech) >= 0.5",
        "expect Pmax(F[0,1] Q) >= 0.5",
        "expect Pmax(G A) >= 0.5",
    )
    with mock.patch.object(gate, "build_product", side_effect=AssertionError), pytest.raises(StlToolError) as refused:
        stl.verify([path, written("expect Pmax(F[0,1] Q) >= 0", name="two.stl")])
    said = str(refused.value)
    assert said.endswith("8 errors")
    for told in (
        "for ==, write both expect Pmax(reach) >= 0.9 and expect Pmax(reach) <= 0.9",
        "the policy file",
        "the trace file",
        "leave robust out",
        "the model has no label raech; did you mean reach?",
        "the model has no label Q; known names: A, x, y; definitions of the file: reach",
        "hence no horizon",
        "two.stl, line 3",
    ):
        assert told in said


def test_a_faulty_line_brings_no_further_faults(written, tmp_path):
    """What is about a definition or a model that cannot be read is passed over."""
    path = tmp_path / "broken.stl"
    path.write_text("model coin.toml\nreach = F[0,2] A\nother := F[0,1] A\nexpect Pmax(reach) >= 0.5\n")
    with pytest.raises(StlToolError) as refused:
        stl.verify(path)
    assert "names no model" not in str(refused.value)
    assert "no label reach" not in str(refused.value)


def test_a_black_box_has_no_probability(tmp_path):
    (tmp_path / "lake.toml").write_text(
        'kind = "gymnasium"\nid = "FrozenLake-v1"\nblackbox = true\n[labels]\ngoal = "G"\n'
    )
    path = tmp_path / "task.stl"
    path.write_text('model "lake.toml"\nreach := F[0,9] goal\nexpect Pmax(reach) >= 0.5\n')
    with mock.patch.object(gate, "load_model", return_value=mock.Mock(blackbox=object(), uncertain=False)) as load:
        load.return_value.name = "lake"
        with pytest.raises(StlToolError, match="lake is a black box.*stltool estimate --at-least"):
            stl.verify(path)


def test_files_without_expectations_are_named(written):
    quiet = written(name="quiet.stl")
    found = stl.verify([written("expect Pmax(reach) >= 0.3"), quiet])
    assert (found.quiet, found.holds) == ((quiet,), True)


def test_certificates_prove_what_they_are_for(written, tmp_path):
    lines = [
        "expect Pmax(reach) >= 0.3", "expect Pmax(reach) < 0.9", "expect Pmax(reach) <= 1/3", "expect Pmin(reach) <= 0",
    ]  # fmt: skip
    path = written(*lines, "expect Pmax(F[0,2] A) > 0.5")
    found = stl.verify(path, certificates=tmp_path / "proofs")
    assert found.holds
    files = [result.certificate.path for result in found.results]
    assert files[0] == files[1] != files[2]  # the third needs the fraction
    assert sorted((tmp_path / "proofs").iterdir()) == sorted(set(files))
    names = [file.name.removesuffix(".jsonl.gz") for file in files]
    assert [names[i] for i in (0, 2, 3)] == ["task-reach-Pmax", "task-reach-Pmax-2", "task-reach-Pmin"]  # without gaps
    for result in found.results:
        proved = stl.certify(result.certificate.path)
        assert (Fraction(proved["lower"]), Fraction(proved["upper"])) == (
            result.certificate.lower,
            result.certificate.upper,
        )
        assert result.certificate.decides
        expected = result.expectation
        assert RELATIONS[expected.relation](Fraction(proved["lower"]), expected.bound)
        assert RELATIONS[expected.relation](Fraction(proved["upper"]), expected.bound)


def test_a_folder_that_holds_other_files_is_refused_first(written, tmp_path):
    (tmp_path / "task-reach-Pmax.jsonl.gz").write_text("mine")
    with (
        mock.patch.object(gate, "check", side_effect=AssertionError),
        pytest.raises(StlToolError, match="would be lost"),
    ):
        stl.verify(written("expect Pmax(reach) >= 0.3"), certificates=tmp_path)


def test_it_shows_itself(written):
    found = stl.verify(written("expect Pmax(reach) >= 0.3", "expect Pmax(reach) >= 0.4"))
    assert repr(found).startswith("Verification: 2 expectations: 1 holds; 1 does not hold")
    assert "expect Pmax(reach) &gt;= 0.4" in found._repr_html_()
    first = repr(found.results[1]).splitlines()[0]  # cut where the path is long
    full = f"Verified: does not hold, {found.results[1].path}:4: expect Pmax(reach) >= 0.4"
    assert first == full or (full.startswith(first.rstrip(".")) and len(first) >= 100)


ANSWERS = """premise := request & !busy
answers := G[0,3] (premise -> F[0,2] level > 3)
limit := G[0,3] level < 9
expect holds(answers, trace "idle.csv")
expect holds(answers, trace "asked.csv")
expect cover(premise, of answers) >= 2
expect cover(premise, of answers) >= 3
expect cover(premise, of answers, trace "idle.csv") < 1
expect cover(answers, vacuous) <= 0
expect cover(level > 3, closed, of answers) > 11
expect cover(limit) >= 1
"""


@pytest.fixture
def answers(tmp_path):
    (tmp_path / "idle.csv").write_text("request,busy,level\n" + "1,1,0\n" * 6)
    (tmp_path / "asked.csv").write_text("request,busy,level\n1,0,0\n0,0,4\n1,1,0\n1,0,0\n0,0,0\n0,0,7\n")
    path = tmp_path / "answers.stl"
    path.write_text(ANSWERS)
    return path


def test_counts_are_over_the_traces_of_the_file_or_their_own(answers):
    """By hand: a request that is not busy comes at two steps, in one of the two traces on which answers is judged."""
    found = stl.verify(answers).results
    assert [(one.verdict, one.count, one.coverage and one.coverage.traces) for one in found] == [
        ("holds", None, None), ("holds", None, None), ("holds", 2, 2), ("does not hold", 2, 2), ("holds", 0, 1),
        ("does not hold", 1, 2), ("holds", 12, 2), ("error", None, None),
    ]  # fmt: skip
    assert found[0].reason == "vacuously: its premise request & !busy holds at no step"
    assert found[1].reason is None
    assert "request & !busy (premise)" in found[3].reason
    assert "there are none; name one, cover(…, trace" in found[7].reason
    assert found[2].coverage is found[3].coverage


def test_batches_count_trace_by_trace(answers):
    np.savez(answers.with_name("batch.npz"), request=np.eye(2, 6), busy=np.zeros((2, 6)), level=np.full((2, 6), 5))
    answers.write_text(ANSWERS.partition("expect")[0] + 'expect cover(premise, of answers, trace "batch.npz") >= 2\n'
                       'expect holds(answers, trace "batch.npz")')  # fmt: skip
    count, holds = stl.verify(answers).results
    assert (count.verdict, count.count, count.coverage.traces) == ("holds", 2, 2)
    assert holds.reason is None  # each premise held in some trace


def test_a_trace_that_is_too_short_to_count_is_in_error(answers):
    answers.with_name("idle.csv").write_text("request,busy,level\n1,1,0\n")
    found = stl.verify(answers).results
    assert found[4].verdict == "error"
    assert found[4].reason.startswith("idle.csv: ")
    assert "end=" not in found[4].reason
