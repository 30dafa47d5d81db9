"""Laws of STL that hold whatever the formula: across the parser, monitors, automata, checker, formats and learners.

Each is checked by two rooms at once, on what the strategies of stltool.testing draw.
"""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.automata.compile import atoms_of, compile_automaton
from stltool.errors import InfeasibleError
from stltool.logic.feasible import leaves, tabulated
from stltool.logic.formula import (
    Always,
    Comparison,
    Eventually,
    Interval,
    Label,
    Not,
    Or,
    Until,
    Variable,
    children,
    with_children,
)
from stltool.logic.semantics import satisfies
from stltool.logic.shifts import with_variables
from stltool.models.environment import simulator
from stltool.testing import (
    assert_equivalent,
    assert_refines,
    assert_trace,
    formulas,
    mdps,
    policies,
    satisfying_traces,
    violating_traces,
)
from tests import oracles
from tests.conftest import many

RANGES = {"x": (-2, 2)}
small = formulas(labels=("a", "b"), signals=RANGES, longest=2, max_leaves=2)
windows = st.tuples(st.integers(0, 2), st.integers(0, 2)).map(lambda ab: Interval(min(ab), max(ab)))


def online(phi, trace):
    """The verdict of step 0, as soon as it is certain."""
    monitor = stl.OnlineMonitor(phi)
    for t in range(len(trace["a"])):
        for decision in monitor.feed({name: values[t] for name, values in trace.items()}):
            if decision.step == 0:
                return decision.verdict
    raise AssertionError("the trace decides step 0")


@given(phi=formulas(labels=("a", "b"), signals=RANGES, longest=3, max_leaves=4, past=True), data=st.data())
@settings(max_examples=many(60))
def test_every_judge_agrees_on_traces_that_satisfy_and_on_traces_that_violate(phi, data):
    read = leaves(phi)
    automaton = compile_automaton(phi)
    for verdict, build in ((True, satisfying_traces), (False, violating_traces)):
        try:
            trace = data.draw(build(phi, RANGES, ("a", "b")))
        except InfeasibleError:
            continue
        assert satisfies(phi, trace) == verdict
        monitored = stl.monitor(phi, trace, at=0)
        assert monitored.verdicts.tolist() == [verdict]
        assert monitored.robustness[0] * (1 if verdict else -1) >= 0
        again = stl.parse(str(phi))
        assert stl.monitor(again, trace, semantics="boolean", at=0).verdicts.tolist() == [verdict]
        truths = np.array(
            [[satisfies(leaf, trace, t) for leaf in read] for t in range(len(trace["a"]))], dtype=np.bool_
        )
        rows = tabulated(atoms_of(phi), read, truths.reshape(len(trace["a"]), len(read)))
        assert automaton.judge(automaton.letters_at(rows)) is not None
        assert automaton.judge(automaton.letters_at(rows))[0] == verdict
        assert stl.diagnose(phi, trace).verdict == verdict
        assert online(phi, trace) == verdict
        if verdict:
            assert_trace(phi, trace)


@given(phi=small, psi=small, window=windows)
@settings(max_examples=many(25))
def test_duality(phi, psi, window):
    assert_equivalent(Not(Eventually(window, phi)), Always(window, Not(phi)), RANGES)
    assert_equivalent(Not(Until(window, phi, psi)), stl.release(Not(phi), Not(psi), window.a, window.b), RANGES)


@given(phi=small, psi=small, n=st.integers(1, 2))
@settings(max_examples=many(25))
def test_unfolding(phi, psi, n):
    later = Interval(1, n)
    assert_equivalent(Eventually(Interval(0, n), phi), Or((phi, Eventually(later, phi))), RANGES)
    unfolded = psi | (phi & Eventually(Interval(1, 1), Until(Interval(0, n - 1), phi, psi)))
    assert_equivalent(Until(Interval(0, n), phi, psi), unfolded, RANGES)


@given(phi=small, window=windows, more=st.integers(0, 2))
@settings(max_examples=many(25))
def test_wider_windows_are_weaker_for_eventually_and_stronger_for_always(phi, window, more):
    wider = Interval(window.a, window.last + more)
    assert_refines(Eventually(window, phi), Eventually(wider, phi), RANGES)
    assert_refines(Always(wider, phi), Always(window, phi), RANGES)
    assert_refines(Always(window, phi), Eventually(window, phi), RANGES)


@given(model=mdps(states=3), phi=small, n=st.integers(0, 2))
@settings(max_examples=many(25))
def test_probabilities_are_dual_and_monotone_in_windows(model, phi, n):
    best = [
        stl.check(stl.build_product(model, Eventually(Interval(0, m), phi)), exact=True).fraction for m in (n, n + 1)
    ]
    assert best[0] <= best[1]
    never = stl.build_product(model, Always(Interval(0, n), Not(phi)))
    assert best[0] + stl.check(never, maximize=False, exact=True).fraction == 1


def renamed(phi, name):
    if isinstance(phi, Label):
        return Label(name(phi.name))
    if isinstance(phi, Comparison):
        return with_variables(phi, lambda variable: Variable(name(variable.name), variable.delay))
    return with_children(phi, tuple(renamed(child, name) for child in children(phi)))


def rebuilt(model, of, actions=None, name=str):
    """The model whose state i is a copy of state of[i], its actions in another order and its names others.

    What leads to a state leads to each of its copies with the same share of the probability.
    """
    of, actions = np.asarray(of), np.arange(model.n_actions) if actions is None else np.asarray(actions)
    copies = np.bincount(of, minlength=model.n_states)
    rows = np.zeros((model.n_actions, model.n_states, model.n_states), dtype=object)
    for s in range(model.n_states):
        for c, row in enumerate(oracles.choices(model, s)):
            for s2, p in row:
                rows[model.choice_action[model.choice_start[s] + c], s, s2] = p / int(copies[s2])
    start = np.array([Fraction(0)] * model.n_states, dtype=object)
    for s, p in oracles.initial(model):
        start[s] = p / int(copies[s])
    return stl.MDP.from_arrays(
        rows[np.ix_(actions, of, of)],
        {name(key): values[of] for key, values in model.signals.items()},
        start[of],
        {name(key): values[of] for key, values in model.labels.items()},
        [name(model.action_names[a]) for a in actions],
    )


def split(model, s):
    """The model with a second copy of state s, to which half of each probability of reaching s goes."""
    return rebuilt(model, [*range(model.n_states), s])


def other(name):
    return f"not {name}; new"


def optima(model, phi):
    product = stl.build_product(model, phi)
    return [stl.check(product, maximize=maximize, exact=True).fraction for maximize in (False, True)]


@given(model=mdps(states=3, exact=True), phi=formulas(longest=2, max_leaves=3), data=st.data())
@settings(max_examples=many(25))
def test_names_orders_and_copies_of_states_do_not_matter(model, phi, data):
    best = optima(model, phi)
    order = data.draw(st.permutations(range(model.n_states)))
    actions = data.draw(st.permutations(range(model.n_actions)))
    assert optima(rebuilt(model, order, actions, other), stl.parse(str(renamed(phi, other)))) == best
    assert optima(split(model, data.draw(st.integers(0, model.n_states - 1))), phi) == best


@pytest.mark.soak
@given(
    model=mdps(states=3, single_start=True, exact=True), phi=formulas(longest=2, max_leaves=3),
    ending=st.sampled_from((".drn", ".drn.gz", ".umb", ".tra", ".tra.gz")), data=st.data(),
)  # fmt: skip
@settings(max_examples=many(30), suppress_health_check=[*HealthCheck])
def test_a_format_keeps_the_optima_whatever_states_and_actions_are_called_and_copied(
    tmp_path, monkeypatch, model, phi, ending, data
):
    monkeypatch.setattr("os.fsync", lambda descriptor: None)
    best = optima(model, phi)
    first = int(np.flatnonzero(model.initial)[0])
    order = data.draw(st.permutations(range(model.n_states)))
    twin = rebuilt(model, order, data.draw(st.permutations(range(model.n_actions))), lambda name: f"{name}_2")
    copied = [s for s in range(model.n_states) if s != first]  # files have one initial state
    changed = [(model, phi), (twin, renamed(phi, lambda name: f"{name}_2"))]
    changed += [(split(model, data.draw(st.sampled_from(copied))), phi)] if copied else []
    for one, psi in changed:
        path = tmp_path / ending[1:] / f"model{ending}"
        path.parent.mkdir(exist_ok=True)
        stl.save_model(one, path)
        again = stl.load_model(path)
        assert optima(again, psi) == best
        stl.save_model(again, path)  # and what was read is written as it was
        assert optima(stl.load_model(path), psi) == best


@given(model=mdps(states=3, exact=True), phi=formulas(longest=2, max_leaves=3), data=st.data())
@settings(max_examples=many(20), suppress_health_check=[*HealthCheck])
def test_a_policy_has_one_probability_in_every_format(tmp_path, monkeypatch, model, phi, data):
    monkeypatch.setattr("os.fsync", lambda descriptor: None)
    product = stl.build_product(model, phi)
    policy = data.draw(policies(product, mixed=False))
    value = stl.check(product, policy, exact=True).fraction
    least, greatest = optima(model, phi)
    assert least <= value <= greatest
    for ending in (".npz", ".csv", ".json"):
        policy.save(tmp_path / f"policy{ending}")
        again = stl.load_policy(tmp_path / f"policy{ending}", product)
        assert stl.check(product, again, exact=True).fraction == value


class World:
    """A black box: the model's transitions, with states of another number, and the i-th action another one."""

    def __init__(self, model, number, seed):
        self.simulated = simulator(model, np.random.default_rng(seed))
        self.number = number

    def reset(self):
        return self.number[self.simulated.reset()]

    def step(self, i):
        return self.number[self.simulated.step(i)]


@pytest.mark.soak
@given(
    model=mdps(states=4), phi=formulas(longest=2, max_leaves=3), data=st.data(), seed=st.integers(0, 99),
    method=st.sampled_from(("model-based", "cfer", "naive", "naive-er")),
)  # fmt: skip
@settings(max_examples=many(25))
def test_learners_do_not_care_about_names_and_never_beat_the_optimum(model, phi, data, seed, method):
    """With the same random choices, the policy learned is the same one, whatever states, actions and labels are called.

    On a model with a copy of a state, it is another one, which is no better than the optimum of the first.
    """
    product = stl.build_product(model, phi)
    order = data.draw(st.permutations(range(model.n_states)))
    number = np.argsort(order)
    twin = stl.build_product(rebuilt(model, order, name=other), stl.parse(str(renamed(phi, other))))
    copied = stl.build_product(split(model, data.draw(st.integers(0, model.n_states - 1))), phi)
    best = stl.check(product, exact=True).fraction
    found, worlds = [], (World(model, range(model.n_states), seed), World(model, number.tolist(), seed), None)
    for one, world in zip((product, twin, copied), worlds, strict=True):
        run = stl.learn(one, method, episodes=20, evaluate_every=5, seed=seed, environment=world)
        found.append(stl.check(one, run.policy, exact=True).fraction)
        assert found[-1] <= best
    assert found[0] == found[1]
