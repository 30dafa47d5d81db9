"""stltool: signal temporal logic tasks on Markov decision processes, learned and verified exactly. START HERE.

    >>> import stltool as stl
    >>> phi = stl.parse("G[0,5) (F[0,5) A & F[0,5) B)")         # text → Formula; str(phi) parses back
    >>> print(phi, stl.horizon(phi))
    G[0,4] ((F[0,4] A) & (F[0,4] B)) 8
    >>> stay = [[1, 0], [0, 1]]; swap = [[0.1, 0.9], [0.8, 0.2]]
    >>> model = stl.MDP.from_arrays([stay, swap], {"x": [0.0, 1.0]}, labels={"A": [1, 0], "B": [0, 1]})
    >>> product = stl.build_product(model, phi)                  # MDP × automaton of the task
    >>> best = stl.check(product)                                # exact optimum, with its policy and enclosure
    >>> print(f"{best.lower:.6f} <= {best.probability:.6f} <= {best.upper:.6f}")
    0.996815 <= 0.996815 <= 0.996815
    >>> run = stl.learn(product, "cfer", episodes=100, seed=0)   # never sees the probabilities
    >>> stl.check(product, run.policy).probability <= best.upper
    True

One straight way through the house, and the map in reading order:

    logic/        text → Formula: grammar, parser, printer, rewriting, semantics (the oracle), the paper's fragment
    monitoring/   recorded traces → truth and robustness at every step
    automata/     Formula → TaskAutomaton: what must be remembered to judge a run; what a formula means at all
    models/       a file, arrays or a Gymnasium environment → MDP; MDP → something that only resets and steps
    product.py    MDP × TaskAutomaton, never built as a matrix
    policy.py     a table over (t?, s, q), saved and loaded without pickle
    checking/     the exact probability of the best policy, or of a given one, with bounds; estimates from runs
    recheck.py    certificates of those bounds re-checked; imports nothing of stltool
    learning/     policies from experience alone, and what their data guarantee
    reporting/    results → JSON, HTML, terminal
    cli/          the same from the command line
    kernels/      numba loops; testing/  Hypothesis strategies for users' own tests
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stltool.automata import TaskAutomaton, compile_automaton
    from stltool.automata.vacuity import Meaning, meaning
    from stltool.checking import (
        CheckResult,
        Estimate,
        Front,
        LikelyRuns,
        Run,
        Sensitivity,
        SequentialTest,
        SurrogateResult,
        Tradeoff,
        check,
        estimate,
        likely_runs,
        pareto,
        robust_check,
        sample_run,
        sensitivity,
        sprt,
        surrogate_optimum,
        tradeoff,
        write_certificate,
    )
    from stltool.errors import StlToolError
    from stltool.learning import (
        Guarantee,
        Settings,
        Sweep,
        SweepResult,
        Training,
        guarantee,
        learn,
        load_sweep,
        run_sweep,
    )
    from stltool.logic.format import format_task
    from stltool.logic.formula import Formula, horizon
    from stltool.logic.fragment import Fragment, check_fragment
    from stltool.logic.lint import ambiguities
    from stltool.logic.parser import load_task, parse, parse_task
    from stltool.logic.rewrite import negation_normal_form, simplify
    from stltool.logic.semantics import robustness, satisfies
    from stltool.logic.task import Task
    from stltool.models import MDP, from_gymnasium, load_model, to_gymnasium
    from stltool.monitoring import (
        Decision,
        MonitorResult,
        OnlineMonitor,
        SmoothRobustness,
        load_trace,
        monitor,
        smooth_robustness,
    )
    from stltool.policy import Policy, load_policy
    from stltool.product import JointProduct, Product, build_joint_product, build_product
    from stltool.recheck import certify
    from stltool.reporting import explain, report

__version__ = "0.1.0"

# name → the module it is loaded from when first used, so that `import stltool` stays light
_HOME = {
    "CheckResult": "checking", "Formula": "logic.formula", "Fragment": "logic.fragment", "MDP": "models",
    "Front": "checking", "JointProduct": "product", "Tradeoff": "checking", "build_joint_product": "product",
    "pareto": "checking", "tradeoff": "checking",
    "Policy": "policy", "Product": "product", "Run": "checking", "Settings": "learning", "StlToolError": "errors",
    "Task": "logic.task", "TaskAutomaton": "automata", "Training": "learning", "build_product": "product",
    "certify": "recheck", "write_certificate": "checking",
    "likely_runs": "checking", "LikelyRuns": "checking", "sensitivity": "checking", "Sensitivity": "checking",
    "surrogate_optimum": "checking", "SurrogateResult": "checking",
    "Estimate": "checking", "SequentialTest": "checking", "estimate": "checking", "sprt": "checking",
    "check": "checking", "check_fragment": "logic.fragment", "compile_automaton": "automata",
    "Guarantee": "learning", "guarantee": "learning",
    "horizon": "logic.formula", "learn": "learning", "load_model": "models", "load_policy": "policy",
    "load_task": "logic.parser", "load_trace": "monitoring", "parse": "logic.parser", "parse_task": "logic.parser",
    "report": "reporting",
    "from_gymnasium": "models", "to_gymnasium": "models",
    "ambiguities": "logic.lint", "explain": "reporting", "format_task": "logic.format",
    "robust_check": "checking", "robustness": "logic.semantics", "sample_run": "checking",
    "satisfies": "logic.semantics", "monitor": "monitoring", "MonitorResult": "monitoring",
    "Decision": "monitoring", "OnlineMonitor": "monitoring",
    "SmoothRobustness": "monitoring", "smooth_robustness": "monitoring",
    "simplify": "logic.rewrite", "negation_normal_form": "logic.rewrite",
    "meaning": "automata.vacuity", "Meaning": "automata.vacuity",
    "Sweep": "learning", "SweepResult": "learning", "load_sweep": "learning", "run_sweep": "learning",
}  # fmt: skip

__all__ = [  # noqa: RUF022 - in reading order
    "parse", "Formula", "horizon", "satisfies", "robustness", "check_fragment", "Fragment",
    "simplify", "negation_normal_form", "load_task", "parse_task", "Task", "format_task", "ambiguities",
    "load_trace", "monitor", "MonitorResult", "OnlineMonitor", "Decision", "smooth_robustness", "SmoothRobustness",
    "meaning", "Meaning", "compile_automaton", "TaskAutomaton", "load_model", "MDP", "from_gymnasium", "to_gymnasium",
    "build_product", "Product", "Policy", "load_policy", "check", "CheckResult", "robust_check", "sample_run", "Run",
    "estimate", "Estimate", "sprt", "SequentialTest", "write_certificate", "certify",
    "likely_runs", "LikelyRuns", "sensitivity", "Sensitivity", "surrogate_optimum", "SurrogateResult",
    "build_joint_product", "JointProduct", "tradeoff", "Tradeoff", "pareto", "Front",
    "learn", "Training", "Settings", "guarantee", "Guarantee", "load_sweep", "run_sweep", "Sweep", "SweepResult",
    "report", "explain", "StlToolError",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'stltool' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"stltool.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
