"""Rule-based machines with a formula as invariant."""

import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import rule, run_state_machine_as_test

import stltool as stl
from stltool.testing import StlStateMachine, TraceViolation

FEW = settings(max_examples=40, stateful_step_count=12, deadline=None, database=None)


class Counter(StlStateMachine):
    """Serves requests after some rules; `slow` is the fault."""

    formula = "G (asked -> F[0,3] idle)"
    slow = False

    def __init__(self):
        super().__init__()
        self.left, self.asked = 0, False

    def observe(self):
        return {"asked": self.asked, "idle": self.left == 0, "left": self.left}

    @rule(work=st.integers(1, 3))
    def ask(self, work):
        self.asked = self.left == 0
        self.left = work if self.asked else max(self.left - (not self.slow), 0)

    @rule()
    def serve(self):
        self.asked = False
        self.left = max(self.left - 1, 0)


class Slow(Counter):
    slow = True


def test_a_machine_that_keeps_its_formula_passes():
    run_state_machine_as_test(Counter, settings=FEW)


def test_a_machine_that_does_not_is_found_and_told():
    with pytest.raises(TraceViolation, match=r"asked -> .* fails at step \d"):
        run_state_machine_as_test(Slow, settings=settings(FEW, max_examples=200, phases=[Phase.generate]))


def test_what_is_open_at_the_end_passes():
    class Waiting(Counter):
        formula = "F[0,100] (left > 5)"

    run_state_machine_as_test(Waiting, settings=settings(FEW, max_examples=5))


def test_robustness_steers(monkeypatch):
    """A violation that needs 25 of one rule among four is found, as every step towards it counts."""

    class Climb(StlStateMachine):
        formula = "G (x < 8)"

        def __init__(self):
            super().__init__()
            self.x = 0

        def observe(self):
            return {"x": self.x}

        @rule()
        def up(self):
            self.x += 1

        @rule(by=st.integers(1, 3))
        def down(self, by):
            self.x = max(self.x - by, 0)

    told = []
    monkeypatch.setattr("stltool.testing.machines.target", lambda value, label: told.append((value, label)))
    run_state_machine_as_test(Climb, settings=settings(FEW, max_examples=5, stateful_step_count=5))
    assert told
    assert all(-8 <= value < 0 and label == "robustness" for value, label in told)


@pytest.mark.parametrize("members", [{}, {"formula": "x > 0"}])
def test_a_machine_needs_a_formula_and_observations(members):
    class Incomplete(StlStateMachine):
        locals().update(members)

        @rule()
        def go(self):
            pass

    with pytest.raises((stl.StlToolError, NotImplementedError), match="has no (formula|observe)"):
        run_state_machine_as_test(Incomplete, settings=FEW)
