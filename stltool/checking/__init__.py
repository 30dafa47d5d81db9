"""The exact probability that a policy, or the best one, satisfies the task: one file for each question."""

from stltool.checking.certificate import certify, require_certificate_of, write_certificate
from stltool.checking.check import CheckResult, check
from stltool.checking.costs import ExpectedCost, expected_cost
from stltool.checking.counterfactual import Alternative, Counterfactual, counterfactual
from stltool.checking.frontier import Frontier, frontier
from stltool.checking.likely import LikelyRun, LikelyRuns, likely_runs
from stltool.checking.long_run import LongRun, long_run
from stltool.checking.margins import RobustnessDistribution, largest_margin, robustness_distribution
from stltool.checking.parametric import ParametricResult, parametric
from stltool.checking.pareto import Front, pareto
from stltool.checking.readable import Node, PolicyTree, policy_tree
from stltool.checking.robust import robust_check
from stltool.checking.runner import Runner
from stltool.checking.runs import load_run
from stltool.checking.sampling import Run, sample_run
from stltool.checking.sensitivity import Sensitivity, sensitivity
from stltool.checking.shield import Shield, shield
from stltool.checking.stationary import StationaryResult, stationary
from stltool.checking.statistical import Estimate, SequentialTest, estimate, estimate_from, sprt, sprt_from
from stltool.checking.surrogate import SurrogateResult, surrogate_optimum
from stltool.checking.timing import TimeDistribution, time_distribution
from stltool.checking.tradeoff import Tradeoff, tradeoff
from stltool.checking.values import StateValue, StateValues
from stltool.checking.within import CostDistribution, cost_distribution

__all__ = [
    "Alternative", "CheckResult", "CostDistribution", "Counterfactual", "Estimate", "ExpectedCost", "Front", "Frontier",
    "LikelyRun", "LikelyRuns", "LongRun", "Node", "ParametricResult", "PolicyTree", "RobustnessDistribution", "Run",
    "Runner", "Sensitivity", "SequentialTest", "Shield", "StateValue", "StateValues", "StationaryResult",
    "SurrogateResult", "TimeDistribution", "Tradeoff", "certify", "check", "cost_distribution", "counterfactual",
    "estimate", "estimate_from", "expected_cost", "frontier", "largest_margin", "likely_runs", "load_run", "long_run",
    "parametric", "pareto", "policy_tree", "require_certificate_of", "robust_check", "robustness_distribution",
    "sample_run", "sensitivity", "shield", "sprt", "sprt_from", "stationary", "surrogate_optimum", "time_distribution",
    "tradeoff", "write_certificate",
]  # fmt: skip
