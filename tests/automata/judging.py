"""Running an automaton on traces, and on every trace of a few labels at once."""

import itertools

import numpy as np

import stltool as stl
from stltool.automata import UNDECIDED
from stltool.monitoring.states import truth


def judge(automaton, trace):
    """The automaton's verdict on a trace, its letters read off the atoms' truth."""
    n = len(next(iter(trace.values())))
    labels = {name: trace[name] for name in ("a", "b", "c") if name in trace}
    signals = {name: trace[name] for name in ("x", "y") if name in trace}
    values = np.empty((n, len(automaton.atoms)), dtype=bool)
    for i, psi in enumerate(automaton.atoms):
        values[:, i] = truth(psi, signals, labels, n)
    return automaton.judge(automaton.letters_at(values).tolist())


def every_trace(n_steps, labels=("a", "b")):
    """All traces of the labels: name → array (n_traces, n_steps)."""
    rows = np.array(list(itertools.product([False, True], repeat=n_steps * len(labels))), dtype=bool)
    return {name: rows[:, i * n_steps : (i + 1) * n_steps] for i, name in enumerate(labels)}


def judge_all(automaton, traces):
    """The verdicts on many traces at once, (n_traces,): first decided, all decided at the horizon."""
    n, n_steps = next(iter(traces.values())).shape
    letters = np.empty((n, n_steps), dtype=np.int64)
    for t in range(n_steps):
        labels = {name: values[:, t] for name, values in traces.items()}
        values = np.empty((n, len(automaton.atoms)), dtype=bool)
        for i, psi in enumerate(automaton.atoms):
            values[:, i] = truth(psi, {}, labels, n)
        letters[:, t] = automaton.letters_at(values)
    q = np.full(n, automaton.initial)
    verdict = np.full(n, UNDECIDED)
    for t in range(n_steps):
        q = automaton.delta[letters[:, t], q]
        verdict = np.where(verdict == UNDECIDED, automaton.verdicts(t)[q], verdict)
    assert (verdict != UNDECIDED).all()
    return verdict == 1


def truth_of_all(phi, traces):
    """The slow semantics on each of many traces."""
    n = len(next(iter(traces.values())))
    return np.array([stl.satisfies(phi, {name: values[i] for name, values in traces.items()}) for i in range(n)])
