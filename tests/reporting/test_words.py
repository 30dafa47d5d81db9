"""Tasks and findings in sentences."""

import pytest

import stltool as stl
from stltool.logic.printer import with_names
from stltool.reporting.words import run_sentences, sensitivity_sentences, sentence_text, sentences


@pytest.mark.parametrize(
    ("formula", "text"),
    [
        ("A", "A holds"),
        ("!A", "A does not hold"),
        ("x > 0.5 & A", "x > 0.5 & A holds"),
        ("G[0,9] A", "at every step from 0 to 9, A holds"),
        ("F[2,2] A", "at step 2 A holds"),
        ("G[0,9] (F[0,9] A & F[0,1] B)",
         "at every step from 0 to 9: (within the next 9 steps A holds; and within the next 1 step B holds)"),
        ("G[0,3] (A | F[1,1] B)",
         "at every step from 0 to 3: at least one of these: (A holds; or 1 step later B holds)"),
        ("F[0,3] G[1,2] A", "at some step from 0 to 3, at every step from 1 to 2 later, A holds"),
        ("F[0,3] G[0,2] A", "at some step from 0 to 3, now and at the next 2 steps, A holds"),
        ("!a U[0,7] b", "at some step from 0 to 7, b holds, and at every step until then a does not hold"),
        ("(F[0,1] a) U[0,7] b",
         "at some step from 0 to 7, b holds, and at every step until then within the next 1 step a holds"),
        ("(F[0,1] a & F[0,2] b) U[0,7] b",
         "both, at some step from 0 to 7: (b holds; and at every step until then: (within the next 1 step a holds; "
         "and within the next 2 steps b holds))"),
        ("!F[0,3] (A & F[0,1] A)",
         "it is not the case that at some step from 0 to 3: (A holds; and within the next 1 step A holds)"),
        ("A -> F[0,3] B", "if A holds, then at some step from 0 to 3, B holds"),
        ("G[0,2] (A -> F[0,3] B)", "at every step from 0 to 2, if A holds, then within the next 3 steps B holds"),
        ("G[0,9] (rise a -> F[0,3] b)",
         "at every step from 0 to 9, if a holds, and did not at the step before, then within the next 3 steps b holds"),
        ("F[1,9] fall a", "at some step from 1 to 9, a does not hold, and did at the step before if there was one"),
        ("G[0,5] once[0,3] a", "at every step from 0 to 5, now or within the last 3 steps a holds"),
        ("G[0,5] once a", "at every step from 0 to 5, now or earlier a holds"),
        ("F[2,5] (prev a & historically[2,4] b)",
         "at some step from 2 to 5: (1 step before, a holds; and at every step from 4 to 2 before, b holds)"),
        ("F[0,5] (a since[1,4] b)",
         "at some step from 0 to 5, at some step from 4 to 1 before, b holds, and at every step since then a holds"),
        ("G[0,9] (a trigger[0,2] b)",
         "at every step from 0 to 9, now and at the last 2 steps b holds, unless at a later step up to now a holds"),
        ("a release[0,4] b", "at every step from 0 to 4, b holds, unless at an earlier step a holds"),
        ("A <-> F[0,3] B", "both or neither of these: (A holds; and at some step from 0 to 3, B holds)"),
        ("(F[0,1] A & F[0,2] B) -> F[0,3] C",
         "if the first, then the second: (all of these: (at some step from 0 to 1, A holds; and at some step from 0 to "
         "2, B holds); and at some step from 0 to 3, C holds)"),
    ],
)  # fmt: skip
def test_a_formula_in_one_line(formula, text):
    assert sentence_text(sentences(stl.parse(formula))) == text


def test_definitions_keep_their_names():
    text = with_names({"home": stl.parse("x < 0.4 & y > 0.6"), "at_A": stl.parse("A")})
    assert text(stl.parse("F[0,2] (x < 0.4 & y > 0.6) | !A | BAD")) == "(F[0,2] home) | !at_A | BAD"
    assert sentence_text(sentences(stl.parse("F[0,2] A"), text)) == "at some step from 0 to 2, at_A holds"


def test_findings_in_sentences(patrolling):
    from stltool.reporting import likely_data, sensitivity_data

    policy = stl.check(patrolling).policy
    likely = stl.likely_runs(patrolling, policy, count=3)
    texts = run_sentences(likely_data(likely))
    assert len(texts) == 3
    first = likely.runs[0]
    assert texts[0].startswith("The most probable run that violates the task has probability ")
    assert f"decided at step {first.step}" in texts[0]
    assert texts[1].startswith("Number 2: a run that violates the task")
    rows = sensitivity_data(stl.sensitivity(patrolling, policy), 3)
    told = sensitivity_sentences(rows)
    assert told[0].startswith(f"P depends most on state {rows[0]['name']}: ")
    assert told[1].startswith(f"P depends next on state {rows[1]['name']}: ")


def test_a_long_run_is_told_by_its_ends():
    run = {"probability": 0.5, "share": None, "satisfied": False, "step": 20, "certain_from": 18, "remembered": None,
           "states": [f"s{i}" for i in range(21)]}  # fmt: skip
    [text] = run_sentences({"runs": [run]})
    assert "from s0 over s1, s2, s3, s4, …, s16, s17, s18, s19 to s20" in text
    assert "cannot be averted under this policy from step 18 on" in text
    run["states"] = ["s0"] * 21
    assert "nowhere: it stays in s0" in run_sentences({"runs": [run]})[0]


def test_bounds_are_written_as_times_where_a_step_is_declared():
    task = stl.parse_task("step = 0.5s\nunit = ms\nnear := x < 1\nduty := G[0,2s] (near -> (F[500ms,1s] b))")
    assert with_names(task.formulas, task.ticks)(task.formula) == "duty"
    assert with_names(task.predicates, task.ticks)(task.formula) == "G[0,2000ms] (near -> (F[500ms,1000ms] b))"
    once = stl.parse("once[0,inf] a & a U[2,3] b")
    assert with_names({}, task.ticks)(once) == "(once[0,inf) a) & (a U[1000ms,1500ms] b)"
