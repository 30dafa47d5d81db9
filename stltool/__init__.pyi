# The public names, each once, in reading order; stltool/__init__.py loads them from where this says when first used.

from .logic.parser import load_task as load_task, parse as parse, parse_task as parse_task
from .logic.formula import Formula as Formula, horizon as horizon, lookback as lookback
from .logic.compose import (
    F as F,
    G as G,
    U as U,
    fall as fall,
    historically as historically,
    label as label,
    once as once,
    prev as prev,
    release as release,
    rise as rise,
    signal as signal,
    since as since,
    trigger as trigger,
    weak_until as weak_until,
)
from .logic.semantics import robustness as robustness, satisfies as satisfies, time_robustness as time_robustness
from .logic.timing import time_shifted as time_shifted
from .logic.fragment import Fragment as Fragment, check_fragment as check_fragment
from .logic.rewrite import negation_normal_form as negation_normal_form, simplify as simplify
from .logic.task import Task as Task
from .logic.format import format_task as format_task
from .logic.lint import ambiguities as ambiguities
from .logic.lint import conventions as conventions
from .monitoring import (
    Decision as Decision,
    Decisions as Decisions,
    MonitorResult as MonitorResult,
    OnlineMonitor as OnlineMonitor,
    Recording as Recording,
    SmoothRobustness as SmoothRobustness,
    load_trace as load_trace,
    monitor as monitor,
    smooth_robustness as smooth_robustness,
    trace_readers as trace_readers,
)
from .automata import TaskAutomaton as TaskAutomaton, compile_automaton as compile_automaton
from .automata.vacuity import Meaning as Meaning, meaning as meaning
from .diagnosis import Diagnosis as Diagnosis, diagnose as diagnose
from .models import (
    MDP as MDP,
    compose as compose,
    from_gymnasium as from_gymnasium,
    load_model as load_model,
    save_model as save_model,
)
from .product import (
    JointProduct as JointProduct,
    Product as Product,
    build_joint_product as build_joint_product,
    build_product as build_product,
)
from .envs import to_gymnasium as to_gymnasium
from .policy import Policy as Policy, load_policy as load_policy
from .checking import (
    CheckResult as CheckResult,
    Counterfactual as Counterfactual,
    CostDistribution as CostDistribution,
    Estimate as Estimate,
    ExpectedCost as ExpectedCost,
    Front as Front,
    Frontier as Frontier,
    LikelyRuns as LikelyRuns,
    LongRun as LongRun,
    ParametricResult as ParametricResult,
    PolicyTree as PolicyTree,
    RobustnessDistribution as RobustnessDistribution,
    Run as Run,
    Runner as Runner,
    Sensitivity as Sensitivity,
    SequentialTest as SequentialTest,
    Shield as Shield,
    StateValues as StateValues,
    StationaryResult as StationaryResult,
    SurrogateResult as SurrogateResult,
    TimeDistribution as TimeDistribution,
    Tradeoff as Tradeoff,
    certify as certify,
    check as check,
    counterfactual as counterfactual,
    cost_distribution as cost_distribution,
    estimate as estimate,
    largest_margin as largest_margin,
    expected_cost as expected_cost,
    frontier as frontier,
    likely_runs as likely_runs,
    load_run as load_run,
    long_run as long_run,
    parametric as parametric,
    pareto as pareto,
    policy_tree as policy_tree,
    robust_check as robust_check,
    robustness_distribution as robustness_distribution,
    sample_run as sample_run,
    sensitivity as sensitivity,
    shield as shield,
    sprt as sprt,
    stationary as stationary,
    surrogate_optimum as surrogate_optimum,
    time_distribution as time_distribution,
    tradeoff as tradeoff,
    write_certificate as write_certificate,
)
from .gate import Verification as Verification, Verified as Verified, verify as verify
from .learning import (
    Cfer as Cfer,
    ModelBased as ModelBased,
    Naive as Naive,
    NaiveER as NaiveER,
    PublishedCfer as PublishedCfer,
    PublishedCfper as PublishedCfper,
    PublishedNaive as PublishedNaive,
    PublishedNaiveER as PublishedNaiveER,
    Counts as Counts,
    Gap as Gap,
    Guarantee as Guarantee,
    Learner as Learner,
    MarkovTest as MarkovTest,
    Sweep as Sweep,
    SweepResult as SweepResult,
    Training as Training,
    guarantee as guarantee,
    learn as learn,
    load_sweep as load_sweep,
    optimality_gap as optimality_gap,
    markov_test as markov_test,
    run_sweep as run_sweep,
)
from .exporting import ProductMDP as ProductMDP, export as export, product_mdp as product_mdp
from .reporting import explain as explain, report as report
from .errors import StlToolError as StlToolError

__version__: str
