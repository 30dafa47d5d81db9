"""Laws of STL that hold whatever the formula: across the parser, monitors, automata and the checker.

Each is checked by two rooms at once, on what the strategies of stltool.testing draw.
"""

import numpy as np
from hypothesis import given, settings
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
from stltool.testing import (
    assert_equivalent,
    assert_refines,
    assert_trace,
    formulas,
    mdps,
    satisfying_traces,
    violating_traces,
)
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


def split(model, s):
    """The model with a second copy of state s, to which half of each probability of reaching s goes."""
    old = np.arange(model.n_states)
    of = np.append(old, s)
    rows = model.matrix().toarray()
    transitions = np.zeros((model.n_actions, len(of), len(of)))
    for new, state in enumerate(of):
        for c in range(model.choice_start[state], model.choice_start[state + 1]):
            row = rows[c][of]
            row[of == s] /= 2
            transitions[model.choice_action[c], new] = row
    initial = model.initial[of]
    initial[of == s] /= 2
    signals = {name: values[of] for name, values in model.signals.items()}
    labels = {name: values[of] for name, values in model.labels.items()}
    return stl.MDP.from_arrays(transitions, signals, initial, labels, model.action_names)


@given(model=mdps(states=3), phi=formulas(longest=2, max_leaves=3), data=st.data())
@settings(max_examples=many(25))
def test_names_and_copies_of_states_do_not_matter(model, phi, data):
    best = stl.check(stl.build_product(model, phi), exact=True).fraction

    def other(name):
        return f"not {name}; new"

    twin = stl.MDP.from_arrays(
        [*transitions_of(model)],
        {other(name): values for name, values in model.signals.items()},
        model.initial,
        {other(name): values for name, values in model.labels.items()},
    )
    assert stl.check(stl.build_product(twin, stl.parse(str(renamed(phi, other)))), exact=True).fraction == best
    copied = split(model, data.draw(st.integers(0, model.n_states - 1)))
    assert stl.check(stl.build_product(copied, phi), exact=True).fraction == best


def transitions_of(model):
    dense = np.zeros((model.n_actions, model.n_states, model.n_states))
    rows = model.matrix().toarray()
    for s in range(model.n_states):
        for c in range(model.choice_start[s], model.choice_start[s + 1]):
            dense[model.choice_action[c], s] = rows[c]
    return dense
