"""Environments with real observations: tasks are read from these, whatever the cells that learners tell apart."""

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env

import stltool as stl
from stltool.errors import ModelError, NameLookupError, SettingsError, SizeError
from stltool.models.environment import simulator
from stltool.models.gymnasium.cells import OfStep
from tests.models.gymnasium_envs import Scripted
from tests.models.test_gymnasium import step_of

pytestmark = pytest.mark.filterwarnings("ignore:.*not having a spec.*:UserWarning")


class Drift(gymnasium.Env):
    """A point on [0, 1] that moves by a real step; `info` tells when it has hit an end."""

    def __init__(self, ends=False):
        self.observation_space = spaces.Box(np.array([0.0, -2.0], np.float32), np.array([1.0, 2.0], np.float32))
        self.action_space = spaces.Discrete(2)
        self.ends, self.trace = ends, []

    def _seen(self):
        self.trace.append((self.x, self.v))
        return np.array([self.x, self.v], dtype=np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.v, self.trace = 0.5 + 0.1 * self.np_random.random(), 0.0, []
        return self._seen(), {"hit": False}

    def step(self, action):
        self.v = (0.3 if action else -0.3) * self.np_random.random()
        there = self.x + self.v
        self.x = min(max(there, 0.0), 1.0)
        hit = bool(there != self.x)
        return self._seen(), -float(hit), self.ends and hit, False, {"hit": hit}


SIGNALS = {"x": 0, "v": 1, "square": lambda o: float(o[0] ** 2)}
LABELS = {"right": lambda o: bool(o[0] > 0.613), "hit": "info.hit", "bump": OfStep(lambda step: step.reward < 0)}
TASK = "F[0,4] (x > 0.777 & !hit) & G[0,4] square < 0.95"


@pytest.mark.parametrize("cells", [{"x": 0.25}, {"x": [0, 0.3, 1], "v": [0]}, {"square": [0.5]}, "function", "one"])
def test_the_task_is_read_from_real_signals(cells):
    """Along many runs, the verdict of the product is that of the recorded trace, even with a single cell."""
    env, options = Drift(), {"cells": cells}
    if cells == "function":
        options = {"cells": lambda o: int(o[0] > 0.5), "n_cells": 2}
    elif cells == "one":
        options = {"cells": lambda o: 0, "n_cells": 1}
    product = stl.build_product(stl.from_gymnasium(env, LABELS, SIGNALS, **options), stl.parse(TASK))
    environment, verdicts = simulator(product.model, np.random.default_rng(1)), set()
    for run in range(40):
        s, hits = environment.reset(), [False]
        q = product.enter(s, product.automaton.initial)
        for step in range(product.horizon):
            s = environment.step(int((run + step) % 3 > 0))
            q = product.enter(s, q)
            hits.append(env.x in (0.0, 1.0))
        x, v = np.array(env.trace).T
        verdict = product.automaton.verdicts(product.horizon)[q]
        assert verdict == stl.satisfies(product.formula, {"x": x, "v": v, "square": x**2, "hit": np.array(hits)})
        verdicts.add(int(verdict))
    assert verdicts == {0, 1}


def test_cells_index_the_states():
    model = stl.from_gymnasium(Drift(), LABELS, SIGNALS, cells={"x": 0.25, "v": [-0.1, 0.1]}, action_names=["l", "r"])
    assert (model.n_states, model.action_names) == (2 * 4 * 3, ("l", "r"))
    assert model.state_name(0) == "x < 0.25, v < -0.1"
    assert model.state_name(7) == "0.5 <= x < 0.75, -0.1 <= v < 0.1"
    assert model.state_name(12) == "x < 0.25, v < -0.1, ended"
    assert "takes cells for states" in model.notes["cells"]
    assert simulator(model, np.random.default_rng(0)).reset() == 7
    product = stl.build_product(model, stl.parse("F[0,2] (right & x > 0.7)"))
    assert product.model.n_states == 24 * 2  # one atom, which holds or not
    assert product.model.state_name(15) == f"0.5 <= x < 0.75, -0.1 <= v < 0.1, {product.automaton.atoms[0]}"
    assert product.model.notes == model.notes
    edges = stl.from_gymnasium(Drift(), {}, SIGNALS, cells={"x": [0.0, 0.5, 1.0]})
    assert edges.n_states == 2 * 2  # the bounds of x separate nothing
    assert stl.from_gymnasium(Drift(), {}, SIGNALS, cells={"square": [0.0, 0.5]}).n_states == 2 * 3


def test_it_is_learned_estimated_and_bounded(tmp_path):
    model = stl.from_gymnasium(Drift(), LABELS, SIGNALS, cells={"x": 0.2})
    product = stl.build_product(model, stl.parse("F[0,6] x > 0.9 & G[0,6] !hit"))
    run = stl.learn(product, "cfer", episodes=150, seed=0)
    found = stl.estimate(product, run.policy, runs=150, seed=0)
    lazy = stl.estimate(product, stl.Policy(product, np.zeros(product.shape, dtype=int)), runs=150, seed=0)
    assert lazy.upper < found.lower
    bound = stl.guarantee(product, run.policy, run.counts, start=int(run.counts.target[0]))
    assert bound.statement.endswith(
        "nothing about the transitions but that runs go on alike wherever in a cell they are"
    )
    run.policy.save(tmp_path / "p.npz")
    again = stl.build_product(stl.from_gymnasium(Drift(), LABELS, SIGNALS, cells={"x": 0.2}), product.formula)
    assert (stl.load_policy(tmp_path / "p.npz", again).table == run.policy.table).all()
    stl.report([], run, tmp_path / "r.html", guarantees=[found])
    assert "takes cells for states" in (tmp_path / "r.html").read_text()


def test_where_a_run_has_ended_it_stays():
    model = stl.from_gymnasium(Drift(ends=True), LABELS, SIGNALS, cells={"x": 0.5})
    environment = simulator(model, np.random.default_rng(0))
    s = environment.reset()
    for _ in range(30):
        s = environment.step(1)
    assert s == 2 + 1  # the right half, ended
    assert "ended" in model.state_name(s)
    assert environment.step(0) == s
    product = stl.build_product(model, stl.parse("F[0,30] G[0,5] (hit & bump)"))
    assert stl.estimate(product, stl.Policy(product, np.ones(product.shape, dtype=int)), runs=10).satisfied == 10


def test_labels_of_info_and_steps_where_observations_are_finite():
    """What an observation does not show still is a label: the state tells it apart."""
    answers = [(1, -1.0, False, False, {"alarm": True}), (1, 0.0, False, False, {})]
    labels = {"alarm": "info.alarm", "lost": OfStep(lambda step: step.before == 1 and step.reward == 0), "one": {1}}
    model = stl.from_gymnasium(Scripted((0, {}), answers, spaces.Discrete(2)), labels, {"x": [0.0, 5.0]})
    assert (model.n_states, model.state_name(1), model.state_name(3)) == (4, "1", "1, ended")
    product = stl.build_product(model, stl.parse("F[1,1] (alarm & !lost & x > 4) & F[2,2] (lost & !alarm & one)"))
    assert stl.estimate(product, stl.Policy(product, np.zeros(product.shape, dtype=int)), runs=2).satisfied == 2


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"cells": {"y": 0.1}}, "cells divide y, which is not a signal"),
        ({"cells": {"x": -1}}, r"cells of width -1 for x, which lies in \[0, 1\]; give a positive width"),
        ({"cells": {"square": 0.1}}, r"cells of width 0.1 for square, which lies in \[-inf, inf\]"),
        ({"cells": {"x": [0.5, 0.2]}}, r"cells of x are \[0.5, 0.2\]; give a width, or ascending edges"),
        ({"cells": {"x": "wide"}}, "cells of x are 'wide'"),
        ({"cells": {}}, "cells is .*; divide at least one signal"),
        ({"cells": 3}, "cells is 3; divide at least one signal"),
        ({"cells": lambda o: 0}, "cells is a function; give the number of its cells, too: n_cells="),
        ({"cells": {"x": 0.1}, "signals": {"x": 2}}, "signal x is 2; give a function of an observation, or the number"),
        ({"cells": {"x": 0.1}, "labels": {"a": {1}}}, "label a is .*; for real observations give a function of one"),
        ({"cells": {"x": 0.1}, "action_names": ["go"]}, "1 action names for 2 actions"),
    ],
)
def test_what_does_not_fit_is_refused(options, says):
    with pytest.raises(ModelError, match=f"Drift: {says}"):
        stl.from_gymnasium(Drift(), **{"signals": SIGNALS, **options})


def test_other_refusals():
    with pytest.raises(SizeError, match="Drift: 100000000 cells; at most 33554432"):
        stl.from_gymnasium(Drift(), {}, SIGNALS, cells={"x": 1e-4, "v": 4e-4})
    with pytest.raises(SettingsError, match="a model of cells has no table"):
        stl.from_gymnasium(Drift(), {}, SIGNALS, cells={"x": 0.1}, table=True)
    with pytest.raises(SettingsError, match="n_cells is the number of cells of a function; give cells, too"):
        stl.from_gymnasium(Scripted((0, {})), n_cells=3)
    model = stl.from_gymnasium(Drift(), LABELS, SIGNALS, cells={"x": 0.1})
    with pytest.raises(NameLookupError, match="the model has no label left; known names: .*hit, right"):
        stl.build_product(model, stl.parse("F[0,2] left"))
    with pytest.raises(NameLookupError, match="right is not a signal of the model but a label"):
        stl.build_product(model, stl.parse("F[0,2] right > 1"))
    product = stl.build_product(model, stl.parse("F[0,2] right"))
    with pytest.raises(SettingsError, match="are those of one task, as its predicates are read from real signals"):
        stl.build_product(product.model, stl.parse("F[0,2] hit"))
    with pytest.raises(SettingsError, match="a black box with real signals, whose states are those of one task"):
        stl.build_joint_product(model, {"one": stl.parse("F[0,2] hit")})
    with pytest.raises(SettingsError, match="it is a black box"):
        stl.check(product)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"cells": lambda o: 7, "n_cells": 2}, "cells returned 7 for an observation; return a number of a cell, 0 … 1"),
        ({"cells": lambda o: 0.5, "n_cells": 2}, "cells returned 0.5"),
        ({"signals": {"x": lambda o: 1 / 0}}, "signal x raised ZeroDivisionError at step 0: division by zero"),
        ({"signals": {"x": lambda o: np.inf}}, "signal x is inf at step 0; it must be finite"),
        ({"labels": {"a": lambda o: 1}}, "label a is 1 at step 0; return True or False"),
        ({"labels": {"a": OfStep(lambda step: step.action > 0)}}, "label a raised TypeError at step 0"),
    ],
)
def test_faults_of_what_is_given_are_named(given, says):
    model = stl.from_gymnasium(Drift(), **{"signals": {"x": 0}, "cells": {"x": [0.5]}, **given})
    with pytest.raises(ModelError, match=f"Drift: {says}"):
        simulator(model, np.random.default_rng(0)).reset()


def test_observations_that_are_none():
    for outside in (np.array([0.5]), np.array([0.5, np.nan]), "x", None, [[0.5], [1, 2]]):
        env = Scripted((outside, {}), [], Drift().observation_space)
        model = stl.from_gymnasium(env, {}, {"x": 0}, cells={"x": 0.5})
        with pytest.raises(ModelError, match=r"Scripted: reset\(seed=…\) returned the observation .* not in its space"):
            simulator(model, np.random.default_rng(0)).reset()
    near = Scripted((np.array([1.0000001, 0.0]), {}), [step_of(np.array([0.2, 9.0]))], Drift().observation_space)
    environment = simulator(stl.from_gymnasium(near, {}, {"x": 0}, cells={"x": 0.5}), np.random.default_rng(0))
    assert (environment.reset(), environment.step(0)) == (1, 0)  # bounds are not held against real numbers


def test_deep_learners_see_the_real_observation():
    model = stl.from_gymnasium(drift := Drift(), LABELS, SIGNALS, cells={"x": 0.5})
    env = stl.to_gymnasium(stl.build_product(model, stl.parse("F[0,5] x > 0.9")), counterfactuals=4)
    check_env(env)
    observation, info = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    assert "<= x" in info["state"]
    assert observation["observation"].tolist() == np.array(drift.trace[-1], np.float32).tolist()
    after, _, _, _, info = env.step(1)
    assert after["observation"].tolist() == np.array(drift.trace[-1], np.float32).tolist()
    told = info["crm-experience"]
    assert len(told) == 5
    for before, action, _, later, _ in told:
        assert action == 1
        assert (before["observation"] == observation["observation"]).all()
        assert (later["observation"] == after["observation"]).all()
        assert later["to_go"] == before["to_go"] - 1
    with pytest.raises(SettingsError, match="give observed=, what was seen in s and s2"):
        env.counterfactuals(0, 0, 0)
