"""`robust_check` beside Storm's engines for interval MDPs, an outside judge: `pip install stltool[peers]`.

The product goes to Storm unrolled over the clock, as P=? [F<=h "sat"]. Its rational engine gives the exact value, which
must lie in our enclosure; its double engine comes close. (Without the bound, Storm refuses lower ends of 0.)
"""

import itertools
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.automata import TRUE, UNDECIDED
from tests.conftest import FACTORY

stormpy = pytest.importorskip("stormpy", reason="outside judge absent: stormpy (pip install stltool[peers])")


def unrolled(product):
    """The product, layer by layer, as an interval MDP in DRN text: places (t, s, q), label sat where the task holds."""
    model, automaton = product.model, product.automaton
    (start,) = np.flatnonzero(model.initial)
    initial = (0, int(start), product.enter(int(start), automaton.initial))
    number, waiting, lines, n_choices = {initial: 0}, [initial], [], 0
    while waiting:
        t, s, q = place = waiting.pop(0)
        verdict = automaton.verdicts(t)[q]
        labels = (" init" if place == initial else "") + (" sat" if verdict == TRUE else "")
        lines.append(f"state {number[place]}{labels}")
        if verdict != UNDECIDED:
            n_choices += 1
            lines += ["\taction 0", f"\t\t{number[place]} : [1, 1]"]
            continue
        for i, c in enumerate(range(model.choice_start[s], model.choice_start[s + 1])):
            n_choices += 1
            lines.append(f"\taction {i}")
            entries = []
            for k in range(model.row_start[c], model.row_start[c + 1]):
                s2 = int(model.target[k])
                after = (t + 1, s2, product.enter(s2, q))
                if after not in number:
                    number[after] = len(number)
                    waiting.append(after)
                lower, upper, denominator = model.intervals.exact
                ends = (Fraction(int(e[k]), denominator) for e in (lower, upper))
                entries.append((number[after], "[{}, {}]".format(*ends)))
            lines += [f"\t\t{index} : {ends}" for index, ends in sorted(entries)]
    head = ["@type: MDP", "@parameters", "", "@reward_models", "", "@nr_states", str(len(number))]
    return "\n".join([*head, "@nr_choices", str(n_choices), "@model", *lines, ""])


def storm_value(path, maximize, nature, steps, value_type):
    model = stormpy.build_model_from_drn[value_type](str(path))
    formula = stormpy.parse_properties(f'P{"max" if maximize else "min"}=? [F<={steps} "sat"]')[0]
    mode = {"against": "ROBUST", "with": "COOPERATIVE"}[nature]
    result = stormpy.model_checking(
        model, formula, uncertainty_resolution_mode=getattr(stormpy.UncertaintyResolutionMode, mode)
    )
    return result.get_value(model.initial_states[0])


def compare(product, path, maximize, nature):
    path.write_text(unrolled(product))
    result = stl.robust_check(product, maximize=maximize, nature=nature)
    exact = Fraction(str(storm_value(path, maximize, nature, product.horizon, stormpy.RationalInterval)))
    assert Fraction(result.lower) <= exact <= Fraction(result.upper)
    assert stl.robust_check(product, maximize=maximize, nature=nature, exact=True).fraction == exact
    assert storm_value(path, maximize, nature, product.horizon, stormpy.Interval) == pytest.approx(
        result.probability, abs=1e-9
    )
    return exact


@pytest.mark.parametrize("nature", ["against", "with"])
def test_the_uncertain_floor(tmp_path, nature):
    task = stl.load_task(FACTORY / "uncertain.stl", params={"T": 6, "tau": 6})
    product = stl.build_product(stl.load_model(task.model), task)
    assert 0.9 < compare(product, tmp_path / "floor.drn", True, nature) < 1


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("smallest", [0.02, 0.0])
def test_random_models(tmp_path, seed, smallest):
    rng = np.random.default_rng(seed)
    n = 4
    inside = rng.dirichlet(np.ones(n), size=(2, n))
    reach = rng.random(inside.shape) * 0.3
    lower = np.minimum(np.maximum(inside - reach, smallest), inside)  # 0.0: nature may do without a successor
    model = stl.MDP.from_intervals(
        lower, np.minimum(inside + reach, 1), {}, labels={"a": [1, 0, 0, 1], "b": [0, 1, 0, 0]}
    )
    product = stl.build_product(model, stl.parse("G[0,2] (F[0,2] a | b) & (a U[0,3] b | F[2,3] G[0,1] !a)"))
    questions = itertools.product((True, False), ("against", "with"))
    exact = {question: compare(product, tmp_path / "random.drn", *question) for question in questions}
    assert len(set(exact.values()) - {0, 1}) >= 2
