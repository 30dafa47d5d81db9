"""What would have become of a run, against all that chance could have drawn."""

import itertools
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.errors import ArgumentError, FileError, NameLookupError, PolicyError, SettingsError
from tests import oracles
from tests.conftest import FACTORY, many

TINY = """
kind = "grid"
map = '''
A.
S.
'''
moves = ["N", "E", "stay"]
success = "7/10"
slip = "1/10"
"""


def laid(model, s):
    """For every choice of a state its successors side by side: (target, begin, end)."""
    rows = []
    for row in oracles.choices(model, s):
        ends = [Fraction(0), *itertools.accumulate(p for _, p in sorted(row))]
        rows.append([(target, *pair) for (target, _), pair in zip(sorted(row), itertools.pairwise(ends), strict=True)])
    return rows


def drawn(model, coupling):
    """What chance may draw for one step: (probability, where each choice leads: {(s, i): target})."""
    rows = {(s, i): row for s in range(model.n_states) for i, row in enumerate(laid(model, s))}
    if coupling == "independent":
        for picks in itertools.product(*rows.values()):
            probability = Fraction(1)
            for _, low, high in picks:
                probability *= high - low
            yield probability, {key: pick[0] for key, pick in zip(rows, picks, strict=True)}
        return
    cuts = sorted({end for row in rows.values() for _, *ends in row for end in ends})
    for low, high in itertools.pairwise(cuts):
        yield (
            high - low,
            {key: next(target for target, a, b in row if a <= low < b) for key, row in rows.items()},
        )


def enumerated(model, phi, states, taken, k, i, then, coupling):
    """P by all that chance could have drawn in all steps; `then(t, states)` weighs the choices of what follows."""
    length = stl.horizon(phi)
    worlds = list(drawn(model, coupling))
    good = total = Fraction(0)
    for steps in itertools.product(worlds, repeat=length):
        weight = Fraction(1)
        for probability, _ in steps:
            weight *= probability
        if any(leads[states[t], taken[t]] != states[t + 1] for t, (_, leads) in enumerate(steps[: len(taken)])):
            continue
        total += weight
        good += weight * followed(model, phi, list(states[: k + 1]), [leads for _, leads in steps], i, then)
    return good / total


def followed(model, phi, path, leads, i, then):
    """The share of the policy's own draws that satisfy the task, in one world."""
    t = len(path) - 1
    if t == len(leads):
        return Fraction(int(oracles.holds(model, phi, path)))
    weights = {i: Fraction(1)} if i is not None else then(t, path)
    return sum(
        (w * followed(model, phi, [*path, leads[t][path[-1], j]], leads, None, then) for j, w in weights.items()),
        Fraction(0),
    )


def evenly(product):
    return stl.Policy.from_function(
        product, lambda now: {name: 1 / len(now.actions) for name in now.actions}, mixed=True
    )


def random_model(rng):
    """Two states and two actions; labels a and b, each of one state."""
    cut = rng.integers(0, 7, size=(2, 2))
    table = np.array([[[f"{n}/6", f"{6 - n}/6"] for n in row] for row in cut.tolist()])
    return stl.MDP.from_arrays(table, {}, labels={"a": [False, True], "b": [bool(rng.random() < 0.5), False]})


SHORT = ["G[1,2] a", "F[1,2] a", "G[1,2] !a", "F[1,1] G[0,1] b"]
LONG = ["F[2,3] a", "G[1,3] a", "F[1,2] (a & F[1,1] b)", "!b U[1,3] a", "G[0,2] F[0,1] a", "F[0,1] G[1,2] !a"]


@pytest.mark.parametrize("coupling", ["order", "independent"])
def test_all_that_chance_could_have_drawn(coupling):
    seen = set()
    tasks = LONG if coupling == "order" else SHORT  # there are many independent draws
    for seed in range(many(20)):
        rng = np.random.default_rng([seed, coupling == "order"])
        model = random_model(rng)
        phi = stl.parse(tasks[seed % len(tasks)])
        product = stl.build_product(model, phi)
        mixed = bool(seed % 2)
        policy = evenly(product) if mixed else None
        run = stl.sample_run(product, evenly(product), seed)
        if not run.actions:
            continue
        best = policy if mixed else stl.check(product).policy
        automaton = product.automaton

        def then(t, path, best=best, automaton=automaton, product=product, mixed=mixed, model=model):
            q = automaton.initial
            for s in path:
                q = product.enter(s, q)
            n = int(model.choice_start[path[-1] + 1] - model.choice_start[path[-1]])
            if mixed:
                return {j: Fraction(1, n) for j in range(n)}
            if automaton.verdicts(t)[q] != UNDECIDED:  # decided: what follows is no matter
                return {0: Fraction(1)}
            return {int(best.at(t, np.array([path[-1]]), np.array([q]))[0]): Fraction(1)}

        found = stl.counterfactual(product, run, policy=policy, coupling=coupling, exact=True)
        assert found.satisfied == run.satisfied
        taken = [model.action_names.index(name) for name in run.actions]
        for one in found.alternatives:
            i = model.action_names.index(one.action)
            truth = enumerated(model, phi, run.states, taken, one.step, i, then, coupling)
            assert one.fraction == truth
            assert one.lower <= truth <= one.upper <= one.lower + 1e-12
            assert one.lower <= one.probability <= one.upper
            assert one.taken == (i == taken[one.step])
            seen.add(0 < truth < 1)
    assert seen == {True, False}


def test_the_same_actions_lead_to_the_same_states():
    product = stl.build_product(stl.load_model(FACTORY / "floor-5x5.toml"), stl.parse("G[0,4] F[0,4] A"))
    for seed in range(20):
        run = stl.sample_run(product, evenly(product), seed)

        def as_before(situation, run=run):
            return run.actions[situation.step] if situation.step < len(run.actions) else "stay"

        again = stl.Policy.from_function(product, as_before)
        found = stl.counterfactual(product, run, policy=again)
        for one in found.alternatives:
            if one.taken:
                assert one.probability == float(run.satisfied)


def test_the_noise_of_a_grid_has_names(tmp_path):
    """From S, N succeeds to A; E succeeds to the right. A slip to the left of E leads to A too."""
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    model = stl.load_model(path)
    product = stl.build_product(model, stl.parse("F[0,1] A"))
    east, north = stl.load_model(path).state_names.index("(1,0)"), model.state_names.index("(0,1)")
    start = model.state_names.index("(0,0)")
    succeeded = stl.counterfactual(product, ([start, east], ["E"]), 0, "N", exact=True)
    assert succeeded.noise == ({"success": Fraction(1)},)
    assert succeeded.best.fraction == 1  # another action would have succeeded too
    slipped = stl.counterfactual(product, (["(0,0)", "(0,1)"], ["E"]), 0, "N", exact=True)
    assert slipped.noise == ({"left": Fraction(1)},)
    assert slipped.best.fraction == 0  # a move to the north slips to the wall in the west: it stays
    stayed = stl.counterfactual(product, ([start, start], ["E"]), 0, "N", exact=True)
    assert stayed.noise == ({"stay": Fraction(1, 2), "right": Fraction(1, 2)},)
    assert stayed.best.fraction == 0
    # N came to (0,1) only by success, and E would have succeeded to the east then
    seen = stl.counterfactual(product, ([start, north], ["N"]), exact=True)
    assert [(one.action, one.fraction) for one in seen.alternatives] == [("N", 1), ("E", 0), ("stay", 0)]
    with_prior = stl.counterfactual(product, ([start, east], ["E"]), 0, "N", coupling="independent", exact=True)
    assert with_prior.best.fraction == Fraction(7, 10)


def test_cells_of_different_noise_share_one_draw(tmp_path):
    """Success lies at [0, 9/10) on the dry cell and at [0, 1/2) on the wet one, the slips above."""
    path = tmp_path / "wet.toml"
    path.write_text('kind = "grid"\nmap = "S.A"\nmoves = ["E", "stay"]\nsuccess = "9/10"\nslip = "1/30"\n'
                    '[regions]\nwet = [1, 0]\n[noise]\nwet = { success = "1/2", slip = "1/6" }\n')  # fmt: skip
    product = stl.build_product(stl.load_model(path), stl.parse("F[0,2] A"))
    # step 1 stayed on the dry cell: u is in [9/10, 1), where the wet cell slips, too
    run = (["(0,0)", "(0,0)", "(0,0)"], ["stay", "E"])
    found = stl.counterfactual(product, run, 0, "E", exact=True)
    assert found.best.fraction == 0
    # it succeeded on the dry cell: u is in [0, 9/10), of which 5/9 succeed on the wet one
    run = (["(0,0)", "(0,0)", "(1,0)"], ["stay", "E"])
    assert stl.counterfactual(product, run, 0, "E", exact=True).best.fraction == Fraction(9, 10) * Fraction(5, 9)


def test_what_follows_the_run_is_drawn_anew():
    rows = [[["1/2", "1/2"], [0, 1]], [["1/2", "1/2"], [0, 1]]]
    model = stl.MDP.from_arrays(rows, {}, labels={"b": [False, True]}, action_names=["try", "also"])
    product = stl.build_product(model, stl.parse("F[0,3] b"))
    found = stl.counterfactual(product, ([0, 0], ["try"]), 0, "also", exact=True)
    assert found.satisfied is None
    assert found.best.fraction == 1 - Fraction(1, 8)  # this try, and two that are left
    assert "undecided" in repr(found)


def test_faults_are_told():
    model = stl.load_model(FACTORY / "floor-5x5.toml")
    product = stl.build_product(model, stl.parse("F[0,3] A"))
    run = (["(1,0)", "(1,1)"], ["N"])
    for bad, kind, message in [
        (3, ArgumentError, "stl.sample_run"),
        ((["(1,0)"], ["N"]), ArgumentError, "one state more"),
        ((["(9,9)", "(1,1)"], ["N"]), ArgumentError, r"step 0 of the run: there is no state '\(9,9\)'"),
        (([99, 0], ["N"]), SettingsError, "the run's state 0"),
        ((["(1,0)", "(1,1)"], ["up"]), ArgumentError, "there is no action 'up' in state"),
        ((["(1,0)", "(4,4)"], ["N"]), ArgumentError, r"N in state \(1,0\) never leads to \(4,4\)"),
        ((["(1,0)"], []), SettingsError, "nothing could have been different"),
    ]:
        with pytest.raises(kind, match=message):
            stl.counterfactual(product, bad)
    with pytest.raises(SettingsError, match="step"):
        stl.counterfactual(product, run, 1)
    with pytest.raises(SettingsError, match="there is no action"):
        stl.counterfactual(product, run, 0, "up")
    with pytest.raises(SettingsError, match="coupling"):
        stl.counterfactual(product, run, coupling="some")
    plain = stl.MDP.from_arrays([[[1, 0], [0, 1]]], {}, labels={"b": [False, True]}, action_names=["0"])
    with pytest.raises(SettingsError, match="have no names"):
        stl.counterfactual(stl.build_product(plain, stl.parse("F[0,2] b")), ([0, 0], ["0"]), coupling="noise")
    uncertain = stl.load_model(FACTORY / "floor-5x5-uncertain.toml")
    with pytest.raises(SettingsError, match="intervals"):
        stl.counterfactual(stl.build_product(uncertain, stl.parse("F[0,3] A")), run)
    silent = stl.Policy.from_function(product, lambda situation: None)
    with pytest.raises((PolicyError, NameLookupError)):
        stl.counterfactual(product, run, policy=silent)


def test_runs_are_read_from_files(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text('step,state,action\n0,"(1,0)",N\n\n1,"(1,1)",\n')
    assert stl.load_run(path) == (("(1,0)", "(1,1)"), ("N",))
    other = tmp_path / "run.json"
    other.write_text('{"steps": [{"state": "(1,0)", "action": "N", "step": 0}, {"state": "(1,1)", "action": null}]}')
    assert stl.load_run(other) == stl.load_run(path)
    for name, text, message in [
        ("a.txt", "state,action\n", "read from .csv and .json"),
        ("a.csv", "", "a run without states"),
        ("a.csv", "state,action\n", "a run without states"),
        ("a.csv", "state,what\na,b\n", "no column action"),
        ("a.csv", "state,action\na,b\nc\n", "line 3: this line has 1 cells, the header 2"),
        ("a.csv", "state,action\na,\nb,\n", "line 2: state a has no action"),
        ("a.csv", "state,action\na,go\n", "the last action, go, leads to no state"),
        ("a.json", "{", "not a run in JSON"),
        ("a.json", "[" * 100_000, "not a run in JSON"),
        ("a.json", "[]", "write {"),
        ("a.json", '{"steps": [{"state": 3}]}', r"steps\[0\]"),
    ]:
        (tmp_path / name).write_text(text)
        with pytest.raises(FileError, match=message):
            stl.load_run(tmp_path / name)
