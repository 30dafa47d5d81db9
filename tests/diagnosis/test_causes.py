"""Causes of verdicts against the enumeration of all traces: they force the verdict, and none can be left out."""

import numpy as np
import pytest

import stltool as stl
from stltool.diagnosis.knowledge import one_sided
from stltool.logic.feasible import leaves
from stltool.logic.formula import Always, And, Eventually, Iff, Implies, Interval, Not, Or, Until
from tests.conftest import many
from tests.oracles import least_cause

BITS = (0.0, 1.0)
CELLS = (1.0, 2.0, 2.5, 3.0, 4.0)  # what comparisons with 2 and 3 can tell apart
WINDOWED, JOINED = (Eventually, Always), (And, Or)


def random_formula(rng, atoms, depth, room):
    """A formula of this depth whose horizon is at most `room`."""
    if depth == 0:
        return atoms[rng.integers(len(atoms))]
    kind = rng.integers(8)
    a = int(rng.integers(0, room + 1))
    b = int(rng.integers(a, room + 1))

    def below(left):
        return random_formula(rng, atoms, depth - 1, left)

    if kind < 4:
        return WINDOWED[kind % 2](Interval(a, b), below(room - b))
    if kind == 4:
        return Until(Interval(a, b), below(room - b), below(room - b))
    if kind == 5:
        return Not(below(room))
    if kind == 6:
        return JOINED[rng.integers(2)](tuple(below(room) for _ in range(2)))
    return (Implies, Iff)[rng.integers(2)](below(room), below(room))


CASES = [
    (["a", "b"], {"a": BITS, "b": BITS}, 5),
    (["x > 3", "x > 2", "x <= 3", "x == 2"], {"x": CELLS}, 5),
    (["a", "x > 3", "x > 2 & a", "2 < x & x <= 3"], {"a": BITS, "x": CELLS}, 3),
    (["x + y > 0", "a", "x + y <= 0"], {"x": (-1.0, 1.0, -3.0, 3.0), "y": (-2.0, 0.0, 2.0), "a": BITS}, 3),
]


@pytest.mark.soak
@pytest.mark.parametrize(("texts", "values", "n"), CASES, ids=["labels", "dependent", "mixed", "sums"])
def test_the_least_cause_is_found(texts, values, n):
    rng, checked, mixed = np.random.default_rng(7), 0, 0
    atoms = [stl.parse(text) for text in texts]
    while checked < many(60):
        phi = random_formula(rng, atoms, int(rng.integers(1, 4)), n - 1)
        if not leaves(phi) or (h := stl.horizon(phi)) == 0:
            continue
        names = sorted({*stl.logic.formula.variables(phi), *stl.logic.formula.label_names(phi)})
        trace = {name: rng.choice(values[name][: 2 if "+" in texts[0] and name == "x" else None], n) for name in names}
        t = int(rng.integers(0, n - h))
        told = stl.diagnose(phi, trace, t)
        least, forces = least_cause(phi, trace, t, "error", values)
        found = {name: steps.tolist() for name, steps in told.causes.items()}
        assert told.verdict == stl.satisfies(phi, trace, t)
        assert told.minimal
        assert found == least, (str(phi), trace, t, one_sided(phi))
        assert forces(found)
        checked += 1
        mixed += not one_sided(phi)
    assert 0 < mixed < checked
