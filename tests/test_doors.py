"""What is wrong with an argument is told in a sentence, by every public function and method, whatever it is given.

Every parameter of every door is given one thing of every kind. Either the kind is one that the door takes (`TAKES`,
`OWN`), or a StlToolError comes out whose message is a short sentence. Doors are found by introspection: one without a
valid call in `CALLS` fails.
"""

import functools
import inspect
import math
import re
from pathlib import Path

import numpy as np
import pytest

import stltool as stl
from stltool.errors import ArgumentError, StlToolError
from stltool.learning.settings import settings_of

# classes whose objects functions make, so that their constructors are no doors
RESULTS = {
    "CheckResult", "CostDistribution", "Counterfactual", "Decision", "Decisions", "Diagnosis", "Estimate",
    "ExpectedCost", "Fragment", "Front", "Frontier", "Gap", "Guarantee", "JointProduct", "Learner", "LikelyRuns",
    "LongRun", "MDP", "MarkovTest", "Meaning", "MonitorResult", "ParametricResult", "PolicyTree", "Product",
    "ProductMDP", "Recording", "RobustnessDistribution", "Run", "Sensitivity", "SequentialTest", "Shield",
    "SmoothRobustness", "StateValues", "StationaryResult", "StlToolError", "SurrogateResult", "Sweep", "SweepResult",
    "Task", "TaskAutomaton", "TimeDistribution", "Tradeoff", "Training", "Verification", "Verified",
}  # fmt: skip

# called from within, or in inner loops with indices of their own
INNER = {
    "Counts.add_known", "Counts.add_one", "Counts.restore", "MDP.initial_share",
    "Product.enter", "Product.first_verdicts", "Sweep.settled", "TaskAutomaton.letters_at",
    "TaskAutomaton.tracks", "TaskAutomaton.verdicts", "TaskAutomaton.with_outcome",
}  # fmt: skip


@functools.cache
def doors():
    """name → callable: functions, constructors, class methods and methods with a parameter."""
    found = {}
    for name in stl.__all__:
        thing = getattr(stl, name)
        if inspect.isfunction(thing):
            found[name] = thing
        elif inspect.isclass(thing):
            if name not in RESULTS:
                found[name] = thing
            if issubclass(thing, stl.Learner):
                continue  # hooks, which training calls
            for key, member in inspect.getmembers(thing, inspect.isroutine):
                own = key in {k for base in thing.__mro__ if base.__module__.startswith("stltool") for k in vars(base)}
                if key.startswith("_") or not own or not callable(member):  # cached properties count as routines
                    continue
                if f"{name}.{key}" not in INNER and parameters(member):
                    found[f"{name}.{key}"] = member
    return found


def parameters(door):
    listed = inspect.signature(door).parameters.values()
    return [p.name for p in listed if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL) and p.name != "self"]


class Anything:
    def __init__(self, *given):
        pass


SWEEP = """
[sweep]
seeds = 1
settings = { episodes = 2 }
[[method]]
name = "naive"
[[scenario]]
id = "R"
task = "task.stl"
model = "model.toml"
"""


def write_inputs(folder, text):
    (folder / "task.stl").write_text(text)
    (folder / "gate.stl").write_text(f'model "model.toml"\n{text}\nexpect Pmax(reach) >= 0.5\n')
    (folder / "trace.csv").write_text("x,A\n0.5,true\n")
    (folder / "model.toml").write_text('kind = "grid"\nmap = "SA"\ncell = 1\nmoves = "cross"\nsuccess = 1\n')
    (folder / "run.csv").write_text("state,action\n0,0\n1,\n")
    (folder / "q.csv").write_text("state,0,1\n[0 0],1,2\n")
    (folder / "sweep.toml").write_text(SWEEP)


class World:
    """One small thing of every kind."""

    def __init__(self, folder):
        stay, swap = [[1, 0], [0, 1]], [[0.1, 0.9], [0.8, 0.2]]
        self.model = stl.MDP.from_arrays([stay, swap], {"x": [0.0, 1.0]}, labels={"A": [1, 0], "B": [0, 1]})
        self.text = "reach := F[0,2] A"
        self.task = stl.parse_task(self.text)
        self.formula = self.task.formula
        self.product = stl.build_product(self.model, self.task)
        self.joint = stl.build_joint_product(self.model, {"one": self.formula, "two": stl.parse("F[0,2] B")})
        self.result = stl.check(self.product)
        self.policy = self.result.policy
        self.shield = stl.shield(self.product, 0)
        q = self.product.enter(0, self.product.automaton.initial)
        self.first = {"t": 0, "s": 0, "q": q}
        self.training = stl.learn(self.product, "naive", episodes=2)
        self.blurred = stl.MDP.from_intervals(
            [[[0.5, 0.2], [0.3, 0.3]]], [[[0.8, 0.5], [0.7, 0.7]]], {}, labels={"A": [1, 0]}
        )
        rows, domains = [[["p", "1-p"], [0, 1]]], {"p": (0, 1)}
        chain = stl.MDP.from_arrays(rows, {}, labels={"A": [0, 1]}, parameters=domains)
        self.family = stl.build_product(chain, self.formula)
        write_inputs(folder, self.text)
        self.sweep = stl.load_sweep(folder / "sweep.toml")
        self.kinds = {
            "None": None, "True": True, "int": 3, "negative int": -1, "huge int": 10**5000, "nan float": math.nan,
            "float": 0.5, "text": "text", "path": Path("path.npz"),
            "list": [1, 2], "tuple": (), "dict": {"a": 1}, "array": np.zeros((2, 2)), "scalar": np.float64(0.5),
            "object": object(), "function": lambda *args: None, "class": Anything,
            "generator": np.random.default_rng(0), "Formula": self.formula, "Task": self.task,
            "Expression": stl.signal("x") + 1, "MDP": self.model,
            "Product": self.product, "JointProduct": self.joint, "Policy": self.policy, "Training": self.training,
            "Counts": self.training.counts, "Learner": stl.Naive(), "Sweep": self.sweep,
            "TaskAutomaton": self.product.automaton, "CheckResult": self.result,
            "Estimate": stl.estimate(self.product, runs=5), "Shield": self.shield,
            "MonitorResult": stl.monitor(self.formula, {"A": [1, 0, 1]}),
        }  # fmt: skip


LEARNERS = [name for name in stl.__all__ if inspect.isclass(c := getattr(stl, name)) and issubclass(c, stl.Learner)]
LEARNERS.remove("Learner")

# door → a valid call, as arguments by name; "self" is the object whose method it is


def begun(phi):
    """An online monitor that has read a sample."""
    monitor = stl.OnlineMonitor(phi)
    monitor.feed({"A": 1})
    return monitor


CALLS = {
    "parse": lambda w: {"text": "F[0,2] A"},
    "parse_task": lambda w: {"text": w.text},
    "load_task": lambda w: {"path": "task.stl"},
    "F": lambda w: {"phi": w.formula, "a": 0, "b": 5},
    "G": lambda w: {"phi": w.formula, "a": 0, "b": 5},
    "U": lambda w: {"phi": w.formula, "psi": w.task, "a": 0, "b": 5},
    "label": lambda w: {"name": "A"},
    "signal": lambda w: {"name": "x"},
    "horizon": lambda w: {"phi": w.formula},
    "lookback": lambda w: {"phi": w.formula},
    "once": lambda w: {"phi": w.formula, "a": 0, "b": 5},
    "historically": lambda w: {"phi": w.formula, "a": 0, "b": 5},
    "since": lambda w: {"phi": w.formula, "psi": w.task, "a": 0, "b": 5},
    "trigger": lambda w: {"phi": w.formula, "psi": w.task, "a": 0, "b": 5},
    "release": lambda w: {"phi": w.formula, "psi": w.task, "a": 0, "b": 5},
    "weak_until": lambda w: {"phi": w.formula, "psi": w.task, "a": 0, "b": 5},
    "prev": lambda w: {"phi": w.formula},
    "rise": lambda w: {"phi": w.formula},
    "fall": lambda w: {"phi": w.formula},
    "satisfies": lambda w: {"phi": w.formula, "signals": {"A": [0, 0, 0, 1, 0, 1]}, "t": 0},
    "robustness": lambda w: {"phi": w.formula, "signals": {"A": [0, 0, 0, 1, 0, 1]}, "t": 0},
    "check_fragment": lambda w: {"phi": w.formula},
    "Fragment.combine": lambda w: {"self": stl.check_fragment(w.formula), "chi": [True]},
    "simplify": lambda w: {"phi": w.formula},
    "negation_normal_form": lambda w: {"phi": w.formula},
    "format_task": lambda w: {"text": w.text},
    "ambiguities": lambda w: {"task": w.task},
    "conventions": lambda w: {"task": w.task},
    "load_trace": lambda w: {"path": "trace.csv"},
    "monitor": lambda w: {"phi": w.formula, "signals": {"A": [1, 0, 1]}},
    "diagnose": lambda w: {"phi": w.formula, "signals": {"A": [0, 0, 0, 1, 0, 1]}, "t": 1},
    "time_robustness": lambda w: {"phi": w.formula, "signals": {"A": [0, 0, 0, 1, 0, 1, 1]}, "most": 1},
    "time_shifted": lambda w: {"phi": w.formula, "steps": 1},
    "smooth_robustness": lambda w: {"phi": w.formula, "signals": {"A": [1, 0, 1]}, "beta": 1.0},
    "OnlineMonitor": lambda w: {"phi": w.formula, "wait": False},
    "OnlineMonitor.feed": lambda w: {"self": stl.OnlineMonitor(w.formula), "sample": {"A": 1}},
    "OnlineMonitor.bounds": lambda w: {"self": begun(w.formula), "step": 0},
    "OnlineMonitor.finish": lambda w: {"self": stl.OnlineMonitor(w.formula)},
    "meaning": lambda w: {"phi": w.formula},
    "compile_automaton": lambda w: {"phi": w.formula},
    "TaskAutomaton.describe": lambda w: {"self": w.product.automaton, "q": 0},
    "TaskAutomaton.judge": lambda w: {"self": w.product.automaton, "letters": [0, 1]},
    "load_model": lambda w: {"path": "model.toml"},
    "compose": lambda w: {"models": [w.model, w.model]},
    "MDP.starting_in": lambda w: {"self": w.model, "initial": 0},
    "save_model": lambda w: {"model": w.model, "path": "saved.umb"},
    "MDP.from_arrays": lambda w: {"transitions": [[[1]]], "signals": {}},
    "MDP.from_intervals": lambda w: {"lower": [[[1]]], "upper": [[[1]]], "signals": {}},
    "MDP.from_function": lambda w: {"states": 2, "actions": 1, "step": lambda s, a: (s[:, None], s[:, None] * 0 + 1)},
    "MDP.black_box": lambda w: {"n_states": 1, "actions": 1, "environment": lambda rng: None},
    "MDP.place": lambda w: {"self": w.model, "choice": 0},
    "MDP.state_name": lambda w: {"self": w.model, "s": 0},
    "from_gymnasium": lambda w: {"env": stl.to_gymnasium(w.model)},
    "to_gymnasium": lambda w: {"model": w.model},
    "build_product": lambda w: {"model": w.model, "task": w.formula},
    "build_joint_product": lambda w: {"model": w.model, "tasks": [w.task]},
    "Product.describe": lambda w: {"self": w.product, "index": 0},
    "JointProduct.describe": lambda w: {"self": w.joint, "index": 0},
    "JointProduct.task": lambda w: {"self": w.joint, "name": "one"},
    "Policy": lambda w: {"product": w.product, "table": np.zeros(w.product.shape, dtype=int)},
    "Policy.at": lambda w: {"self": w.policy, "t": 0, "s": [0, 1], "q": 0},
    "Policy.row": lambda w: {"self": w.policy, "t": 0},
    "Policy.on": lambda w: {"self": w.policy, "product": w.product},
    "Policy.save": lambda w: {"self": w.policy, "path": "saved.npz"},
    "Policy.load": lambda w: {"path": "policy.npz", "product": w.product},
    "Policy.from_function": lambda w: {"product": w.product, "function": lambda here: 0},
    "Policy.from_q_table": lambda w: {"path": "q.csv", "product": w.product},
    "load_policy": lambda w: {"path": "policy.npz", "product": w.product},
    "check": lambda w: {"product": w.product},
    "CheckResult.at_least": lambda w: {"self": w.result, "bound": 0.5},
    "CheckResult.at_most": lambda w: {"self": w.result, "bound": 0.5},
    "StateValues.at_least": lambda w: {"self": stl.check(w.product, values="all").values, "bound": 0.5},
    "StateValues.at_most": lambda w: {"self": stl.check(w.product, values="all").values, "bound": 0.5},
    "frontier": lambda w: {
        "model": w.model,
        "task": stl.parse_task("param n = 1\nr := F[0,n] A"),
        "at_least": 0.5,
        "parameters": {"n": [1, 2]},
    },
    "counterfactual": lambda w: {
        "product": stl.build_product(w.model, stl.parse("F[1,2] B")),
        "run": ([0, 0], w.model.action_names[:1]),
    },
    "load_run": lambda w: {"path": "run.csv"},
    "expected_cost": lambda w: {"product": w.product, "cost": "x"},
    "long_run": lambda w: {"product": w.product},
    "LongRun.at_least": lambda w: {"self": stl.long_run(w.product), "bound": 0.5},
    "LongRun.at_most": lambda w: {"self": stl.long_run(w.product), "bound": 0.5},
    "cost_distribution": lambda w: {"product": w.product, "cost": "A", "at_most": 2},
    "CostDistribution.at": lambda w: {"self": stl.cost_distribution(w.product, "A", 2), "budget": 1},
    "CostDistribution.exactly": lambda w: {"self": stl.cost_distribution(w.product, "A", 2), "budget": 1},
    "CostDistribution.smallest": lambda w: {"self": stl.cost_distribution(w.product, "A", 2), "at_least": 0.5},
    "robust_check": lambda w: {"product": stl.build_product(w.blurred, w.formula)},
    "parametric": lambda w: {"product": w.family},
    "ParametricResult.at": lambda w: {"self": stl.parametric(w.family), "p": 0.5},
    "ParametricResult.exactly_at": lambda w: {"self": stl.parametric(w.family, exact=True), "p": 0.5},
    "ParametricResult.at_least": lambda w: {"self": stl.parametric(w.family), "bound": 0.5},
    "ParametricResult.at_most": lambda w: {"self": stl.parametric(w.family), "bound": 0.5},
    "ParametricResult.smallest": lambda w: {"self": stl.parametric(w.family), "at_least": 0.5},
    "ParametricResult.points": lambda w: {"self": stl.parametric(w.family)},
    "robustness_distribution": lambda w: {"model": w.model, "task": w.formula},
    "RobustnessDistribution.at": lambda w: {"self": stl.robustness_distribution(w.model, w.formula), "margin": 0.5},
    "RobustnessDistribution.largest": lambda w: {
        "self": stl.robustness_distribution(w.model, w.formula),
        "at_least": 0.5,
    },
    "largest_margin": lambda w: {"model": w.model, "task": w.formula, "at_least": 0.5},
    "time_distribution": lambda w: {"model": w.model, "task": w.formula, "most": 1},
    "TimeDistribution.at": lambda w: {"self": stl.time_distribution(w.model, w.formula, 1), "steps": 1},
    "TimeDistribution.largest": lambda w: {"self": stl.time_distribution(w.model, w.formula, 1), "at_least": 0.5},
    "policy_tree": lambda w: {"product": w.product},
    "Runner": lambda w: {"product": w.product, "policy": w.policy},
    "Runner.act": lambda w: {"self": stl.Runner(w.product), "state": 0},
    "MDP.from_family": lambda w: {"build": lambda p: w.family.model.at(p=p), "parameters": {"p": (0, 1)}},
    "sample_run": lambda w: {"product": w.product},
    "estimate": lambda w: {"product": w.product, "policy": w.policy, "runs": 5},
    "sprt": lambda w: {"product": w.product, "policy": w.policy, "at_least": 0.5, "most_runs": 100},
    "write_certificate": lambda w: {"result": w.result, "path": "proof.jsonl"},
    "certify": lambda w: {"path": "certificate.jsonl"},
    "likely_runs": lambda w: {"product": w.product},
    "sensitivity": lambda w: {"product": w.product},
    "Sensitivity.ranked": lambda w: {"self": stl.sensitivity(w.product)},
    "shield": lambda w: {"product": w.product, "at_least": 0.5},
    "Shield.allows": lambda w: {"self": w.shield, **w.first},
    "Shield.spend": lambda w: {"self": w.shield, **w.first, "choice": 0},
    "Shield.best": lambda w: {"self": w.shield, **w.first},
    "Shield.allowance": lambda w: {"self": w.shield, "spent": 0},
    "Shield.require_for": lambda w: {"self": w.shield, "product": w.product},
    "Shield.save": lambda w: {"self": w.shield, "path": "shield.npz"},
    "Shield.load": lambda w: {"path": "mask.npz", "product": w.product},
    "stationary": lambda w: {"product": w.product},
    "surrogate_optimum": lambda w: {"product": w.product, "gamma": 0.5},
    "tradeoff": lambda w: {"joint": w.joint, "objective": "one"},
    "pareto": lambda w: {"joint": w.joint},
    "Front.at_least": lambda w: {"self": stl.pareto(w.joint), "second": 0.5},
    "learn": lambda w: {"product": w.product, "method": "naive", "episodes": 2},
    **dict.fromkeys(LEARNERS, lambda w: {}),
    "guarantee": lambda w: {"product": w.product, "policy": w.policy, "counts": w.training.counts},
    "Counts": lambda w: {"n_choices": 2, "n_states": 2},
    "Counts.add": lambda w: {"self": stl.Counts(2, 2), "choice": [0, 1], "target": [1, 1]},
    "Counts.contains": lambda w: {"self": stl.Counts(2, 2), "other": stl.Counts(2, 2)},
    "markov_test": lambda w: {"counts": w.training.counts},
    "optimality_gap": lambda w: {"product": w.product, "policy": w.policy, "counts": w.training.counts},
    "verify": lambda w: {"files": "gate.stl"},
    "load_sweep": lambda w: {"path": "sweep.toml"},
    "run_sweep": lambda w: {"sweep": w.sweep, "folder": "swept", "workers": 1},
    "Sweep.select": lambda w: {"self": w.sweep},
    "product_mdp": lambda w: {"product": w.product, "policy": w.policy},
    "export": lambda w: {"product": w.product, "path": "product.prism"},
    "report": lambda w: {"results": [w.result], "training": w.training, "path": "report.html"},
    "explain": lambda w: {"task": w.task},
}

NUMBERS = {"int", "float", "scalar"}
FORMULAS = {"Formula", "Task"}
PATHS = {"text", "path"}
CALLABLE = {"None", "function", "class"}
MAPPING = {"None", "dict"}
TEXT = {"None", "text"}
LISTS = {"list", "tuple"}
NAMES = {"None", *LISTS}


def kinds_of(setting):
    kinds = {int: {"int"}, float: NUMBERS, str: {"text"}}[setting.kind]
    return {"None", *kinds} if setting.optional else kinds


# parameter → the kinds that are taken (the value may be at fault all the same); of single doors in OWN
TAKES = {
    **dict.fromkeys(("phi", "psi", "task"), FORMULAS),
    **{key: {"int"} for key in ("t", "a", "q", "s", "index", "choice", "seed", "count", "most", "points", "n_states")},
    **{key: {"int"} for key in ("most_runs", "most_states", "most_effort", "most_operators", "most_variables")},
    **dict.fromkeys(
        ("gamma", "alpha", "beta", "confidence", "tolerance", "indifference", "at_least", "bound", "second"), NUMBERS
    ),
    **{key: {"None", *NUMBERS} for key in ("epsilon", "mass", "memory_limit", "time_limit")},
    **{key: {"True"} for key in ("maximize", "exact", "keep_policy", "satisfied", "cut", "unbounded", "normalize")},
    **{key: {"True"} for key in ("wait", "clock", "transfer")},
    **{key: {"text"} for key in ("text", "name", "objective")},
    **dict.fromkeys(("source", "command", "step", "unit"), TEXT),
    **dict.fromkeys(("labels", "costs", "params", "budget", "over", "parameters", "constants"), MAPPING),
    "tol": NUMBERS,
    "margin": NUMBERS,
    "margins": {"None", "array", *LISTS},
    "most_pieces": {"int"},
    "most_values": {"int"},
    "mean_states": {"int"},
    "most_leaves": {"int"},
    "price": NUMBERS,
    **dict.fromkeys(("names", "action_names", "state_names"), NAMES),
    **dict.fromkeys(("letters", "chi", "estimates", "guarantees", "stationary"), LISTS),
    **{key: {"array", "list"} for key in ("table", "transitions", "lower", "upper")},
    "b": {"int", "None"},
    "environment": {"None"},
    "initial": {"int", "text", "array", "list"},
    "joint": {"JointProduct"},
    "model": {"MDP"},
    "path": PATHS,
    "policy": {"Policy", "None"},
    "product": {"Product"},
    "progress": CALLABLE,
    "result": {"CheckResult"},
    "results": {"CheckResult", *LISTS},
    "runs": {"None", "int"},
    "sample": {"dict"},
    "signals": {"dict"},
    "training": {"None", "Training"},
    "cluster": {"None"},
    "policy_file": {"None", *PATHS},
    "resume": {"True"},
    "save_every": NUMBERS,
    "threads": {"None", "int"},
    "valuations": {"None"},
    "values": {"None"},
}  # fmt: skip
OWN = {
    "parse_task": {"task": TEXT, "path": {"None", *PATHS}},
    "load_task": {"task": TEXT},
    "ambiguities": {"task": {"Task"}},
    "conventions": {"task": {"Task"}},
    "explain": {"model": {"MDP", "None"}},
    "counterfactual": {"action": {"None"}, "coupling": {"None"}, "step": {"None", "negative int", "int"}},
    "frontier": {"task": {"Task"}, "at_least": {*NUMBERS, "text"}, "parameters": {"dict"}},
    "expected_cost": {"cost": {"text"}, "until": {"text"}},
    "long_run": {"asked": {"text"}},
    "time_distribution": {"margin": {"None", *NUMBERS}},
    "time_shifted": {"steps": {"int"}},
    "TimeDistribution.at": {"steps": {"int"}},
    "cost_distribution": {"cost": {"text"}, "at_most": NUMBERS},
    "CostDistribution.at": {"budget": NUMBERS}, "CostDistribution.exactly": {"budget": NUMBERS},
    "CostDistribution.smallest": {"at_least": NUMBERS},
    "export": {"product": {"Product", "TaskAutomaton"}, "to": TEXT},
    "monitor": {"at": {"None", "int"}},
    "load_model": {"initial": {"None", "int", "text"}},
    "MDP.from_family": {"build": CALLABLE - {"None"}, "parameters": {"dict"}},
    "ParametricResult.at": {"p": {*NUMBERS, "text"}},
    "ParametricResult.exactly_at": {"p": {*NUMBERS, "text"}},
    "ParametricResult.points": {"n": {"int"}},
    "from_gymnasium": {
        "table": {"True"}, "signals": MAPPING, "name": TEXT, "cells": {"None"}, "n_cells": {"None"},
    },
    "to_gymnasium": {"model": {"MDP", "Product"}, "counterfactuals": {"int"}, "shield": {"None"}},
    "Runner": {"shield": {"None", "Shield"}},
    "MDP.black_box": {
        "actions": {"int", *LISTS},
        "available": {"None", "array", "list"},
        "environment": {"function", "class"},
        "signals": MAPPING,
    },
    "MDP.from_function": {
        "states": {"int"}, "actions": {"int", *LISTS}, "signals": MAPPING, "available": {"None"},
        "denominator": {"None", "int"},
    },
    "compose": {"models": {"dict", *LISTS}},
    "MDP.from_arrays": {"transitions": {"array", *LISTS}},
    "build_joint_product": {"tasks": {"dict", *LISTS}},
    "Product.describe": {"t": {"None", "int"}},
    "JointProduct.describe": {"t": {"None", "int"}},
    "Policy.at": {"s": {"int", *LISTS}, "q": {"int", *LISTS}},
    "Policy": {"product": {"Product", "JointProduct"}},
    "Policy.from_function": {"function": {"function", "class"}, "batched": {"True"}, "mixed": {"None", "True"}},
    "Sensitivity.ranked": {"count": {"None", "int"}},
    "shield": {"levels": {"int"}},
    "tradeoff": {"at_least": MAPPING},
    "report": {"product": {"None", "Product"}},
    "learn": {
        "method": {"None", "text", "Learner"}, "faithful": {"True"}, "resume": {"True"}, "episodes": {"int"},
        "evaluate_every": {"int"}, "most_steps": {"None", "int"}, "stop_gap": {"None", *NUMBERS},
        "until_gap": {"None", *NUMBERS},
        "checkpoint": {"None", *PATHS}, "checkpoint_every": NUMBERS,
    },
    "optimality_gap": {
        "counts": {"Counts"}, "start": {"None", "int"}, "parameters": {"None"}, "successors": {"None", "function"},
    },
    "guarantee": {
        "counts": {"Counts"}, "start": {"None", "int"}, "parameters": {"None"}, "test_tie": {"True"},
        "fresh": {"None", "Estimate"}, "successors": {"None", "function"},
    },
    "Counts": {"n_choices": {"int"}, "n_contexts": {"int"}},
    "Counts.add": {"choice": {"int", *LISTS}, "target": {"int", *LISTS}, "context": {"None", "int", *LISTS}},
    "Counts.contains": {"other": {"Counts"}},
    "markov_test": {"counts": {"Counts"}, "draws": {"int"}},
    "verify": {
        "initial": {"None", "int", "text"},
        "files": {*PATHS, *LISTS}, "certificates": {"None", *PATHS}, "exact_seconds": NUMBERS, "stage": CALLABLE,
        "time": {"None", "text"}, "resample": {"None"},
    },
    "load_trace": {
        "names": {"None", *LISTS, "Formula", "Task"}, "time": {"None"}, "step": {"None"}, "resample": {"None"},
    },
    "run_sweep": {"sweep": {"Sweep"}, "folder": PATHS, "workers": {"None", "int"}, "cluster": TEXT},
    "Sweep.select": {"scenarios": NAMES, "methods": NAMES, "seeds": {"None", "int", *LISTS}},
    **{name: {key: kinds_of(one) for key, one in settings_of(getattr(stl, name)).items()} for name in LEARNERS},
}  # fmt: skip


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return World(tmp_path_factory.mktemp("world"))


@pytest.fixture
def folder(world, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_inputs(Path(), world.text)
    world.policy.save("policy.npz")
    world.shield.save("mask.npz")
    stl.write_certificate(world.result, "certificate.jsonl")


def test_every_door_has_a_valid_call():
    assert set(doors()) == set(CALLS)


@pytest.mark.parametrize("name", CALLS)
def test_a_valid_call_is_valid(name, world, folder):
    doors()[name](**CALLS[name](world))


@pytest.mark.parametrize("name", CALLS)
def test_whatever_is_given_a_sentence_comes_out(name, world, folder, monkeypatch):
    monkeypatch.setattr("stltool.reporting.page.render", lambda data: "")  # pictures take long
    door, wrong = doors()[name], []
    for parameter in parameters(door):
        takes = {**TAKES, **OWN.get(name, {})}.get(parameter, set())
        for kind, value in world.kinds.items():
            try:
                door(**{**CALLS[name](world), parameter: value})
            except StlToolError as error:
                if len(str(error)) > 500 or "object at 0x" in str(error) or "array(" in str(error):
                    wrong.append(f"{parameter} = {kind}: {str(error)[:200]}")
                elif (named := re.match(r"(\w+)'s ", str(error))) and named[1] in {*doors()} - {name}:
                    wrong.append(f"{parameter} = {kind} is refused in another's name: {error}")
                elif kind in takes - {"list", "dict"} and isinstance(error, ArgumentError):
                    wrong.append(f"{parameter} = {kind} is refused: {error}")
            except Exception as error:
                wrong.append(f"{parameter} = {kind}: {type(error).__name__}: {str(error)[:200]}")
            else:
                if kind.split()[-1] not in takes:
                    wrong.append(f"{parameter} = {kind} is taken")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(("kind", "n"), [("MDP", 5), ("Product", 3), ("JointProduct", 4)])
@pytest.mark.parametrize("given", [None, 3, "model", np.zeros(3)], ids=repr)
def test_what_is_built_otherwise_says_how(kind, n, given):
    """Constructors that users take for the functions that build: one sentence names the right one."""
    with pytest.raises(TypeError, match=r"not an? \w+; .*stl\.(MDP\.from_arrays|load_model|build_\w+)"):
        getattr(stl, kind)(*[given] * n)


def test_half_a_character_is_no_path():
    with pytest.raises(TypeError, match="not a path"):
        stl.load_task("\ud800")
