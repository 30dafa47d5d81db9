"""The records that commands print with `--json` and that reports are made from: one class for each kind of object.

`docs/schema.py` writes the JSON schema of all of them, docs/reports.schema.json, from these classes; mypy compares them
with the functions that fill them in. A file that stltool writes names its format and version (`FORMATS`): a field may
be added within a version; what is removed, renamed or changes its meaning makes a new one.
"""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypeAlias, TypedDict

from stltool.reporting.explorer import AutomatonRecord, ExplorerRecord
from stltool.reporting.words import SentenceRecord

Question: TypeAlias = Literal["maximum", "minimum", "policy"]
Nature: TypeAlias = Literal["against", "with", "nominal"]
Robustness: TypeAlias = float | Literal["inf", "-inf"]
"""JSON has no infinity."""
Verdict: TypeAlias = Literal["holds", "does not hold", "undecided", "error"]


# ------------------------------------------------------------------------------------------------------------- tasks


class ProductRecord(TypedDict):
    """A task on a model: names, digests and sizes. `transitions` is null for a black box."""

    task: str
    formula: str
    horizon: int
    encoding: str
    exact_encoding: bool
    model: str
    model_digest: str
    automaton_digest: str
    model_notes: list[str]
    initial: str
    initial_states: int
    states: int
    actions: list[str]
    transitions: int | None
    automaton_states: int
    letters: int
    product_states: int


class PartRecord(TypedDict):
    """A part of an automaton: what it judges, how long after a start that is known, and its size."""

    part: str
    obligation_of_each_start: str
    delay: int
    method: str
    explored: int
    states: int


class EncodingSizes(TypedDict):
    """States that the other encodings of a formula would have; null if there is no such encoding."""

    flag_states: int | None
    history_states: int | Literal["over 1e300"]


class DisagreementRecord(TypedDict):
    """A shortest trace on which an encoding and its formula disagree: a row for each step."""

    steps: list[dict[str, Any]]
    encoding_says: bool
    formula_is: bool


class TreeRecord(TypedDict):
    """An operator of a formula, with its horizon, its position in the text and its operands."""

    operator: str
    horizon: int | None
    line: NotRequired[int]
    column: NotRequired[int]
    operands: list[TreeRecord]


class RefusedRecord(TypedDict):
    """Why there is none."""

    refused: str


class FragmentRecord(TypedDict, total=False):
    """A formula as the paper's fragment has it, or `refused`: why it is outside."""

    outer: str
    parts: list[str]
    equal_windows: bool
    refused: str


class TextRecord(TypedDict):
    """A task's text: its formula, params and operators, and what other tools would read differently."""

    task: str
    formula: str
    params: dict[str, str]
    horizon: int | None
    samples_needed: int | None
    tree: TreeRecord
    ambiguities: list[str]


class ExplainOutput(TextRecord, total=False):
    """What `stltool explain --json` prints. Without a horizon, only the text; the sizes of a product with a model only;
    `automaton` if none could be built."""

    step: str
    unit: str
    meaning: dict[str, Any]
    warnings: list[str]
    holds_for_example_on: str
    fails_for_example_on: str
    fragment: FragmentRecord
    automaton: RefusedRecord
    encoding: str
    exact_encoding: bool
    model: str
    model_digest: str
    automaton_digest: str
    model_notes: list[str]
    initial: str
    initial_states: int
    states: int
    actions: list[str]
    transitions: int | None
    automaton_states: int
    letters: int
    product_states: int
    flag_states: int | None
    history_states: int | Literal["over 1e300"]
    parts: list[PartRecord]
    disagrees_on: DisagreementRecord | None
    disagreement: str


# ------------------------------------------------------------------------------------------------------------ checks


class StateValueRecord(TypedDict):
    """P if runs start in a state, enclosed; as a fraction if that was asked for."""

    state: str
    probability: float
    lower: float
    upper: float
    exact: str | None


class CheckRecord(ProductRecord):
    """The probability of a task, enclosed: lower <= P <= upper; `optimum` is the best over all policies; `values`, if
    asked for, are P from each initial state, or from every state."""

    question: Question
    nature: Nature | None
    policy: str | None
    probability: float
    lower: float
    upper: float
    exact: str | None
    arithmetic: str
    optimum: float
    optimum_lower: float
    optimum_upper: float
    gap: float
    status: str
    certain: str | None
    engine: str
    sweeps: int
    seconds: float
    values: NotRequired[list[StateValueRecord]]


class CandidateRecord(TypedDict):
    """A policy that was evaluated in a search, how it was made, and its P."""

    made: str
    probability: float


class StationaryRecord(TypedDict):
    """A search among policies that do not know the step: what it found, and the bound that none exceeds."""

    kind: str
    probability: float
    lower: float
    upper: float
    optimum: float
    gap: float
    bound: float
    proved: bool
    status: str
    evaluated: int
    candidates: list[CandidateRecord]
    relaxations: int
    seconds: float


class TransferRecord(TypedDict):
    """How the model differs from the one that a policy was made for; `told` in sentences.

    Of states and actions, the names that only one has; of signals and labels, in how many common states they differ; of
    common choices, how many have other successors or probabilities, and the largest total variation distance of one.
    """

    from_model: str
    to_model: str
    told: list[str]
    states_only_there: list[str]
    states_only_here: list[str]
    actions_only_there: list[str]
    actions_only_here: list[str]
    signals: dict[str, int]
    labels: dict[str, int]
    choices_only_there: int
    choices_only_here: int
    common_choices: int
    other_successors: int | None
    other_probabilities: int | None
    distance: float | None
    at: str | None
    start: float | None


class CheckOutput(CheckRecord):
    """What `stltool check --json` prints: a check, and the verdict on the bounds that were asked for."""

    transfer: NotRequired[TransferRecord]
    stationary: NotRequired[StationaryRecord]
    at_least: NotRequired[float]
    at_most: NotRequired[float]
    holds: NotRequired[bool]
    decided: NotRequired[bool]


class PointRecord(TypedDict):
    """P, enclosed, at one value of a parameter; as a fraction if that was asked for and is known."""

    value: float
    lower: float
    upper: float
    fraction: NotRequired[str]


PieceRecord = TypedDict(
    "PieceRecord",
    {
        "from": float,
        "to": float,
        "lower": list[float],
        "upper": list[float],
        "optimal": bool | None,
        "proved": NotRequired[bool],
        "range": NotRequired[list[str]],
        "coefficients": NotRequired[list[str]],
        "powers": NotRequired[list[str]],
    },
)
"""Two polynomials that enclose P on a range of a parameter, in Bernstein's basis; whether one policy is optimal there,
as far as rounding lets one tell (null: of a given policy). With --exact: whether that is proved, the range, and the
policy's P, by coefficients in that basis and of the powers of the parameter, from the constant one."""


class SmallestRecord(TypedDict):
    """The smallest value of a parameter whose P reaches `at_least`: none below `below` does, `enough` does (null: none
    was proved to)."""

    below: float
    enough: float | None


ParametricRecord = TypedDict(
    "ParametricRecord",
    {
        "task": str,
        "formula": str,
        "model": str,
        "model_digest": str,
        "horizon": int,
        "encoding": str,
        "question": Question,
        "parameter": str,
        "from": float,
        "to": float,
        "least": list[float],
        "greatest": list[float],
        "gap": float,
        "tolerance": float,
        "status": str,
        "points": list[PointRecord],
        "pieces": list[PieceRecord],
        "seconds": float,
        "at_least": NotRequired[float],
        "at_most": NotRequired[float],
        "holds": NotRequired[bool],
        "decided": NotRequired[bool],
        "smallest": NotRequired[SmallestRecord | None],
    },
)
"""P as a function of a parameter of the model, enclosed on its whole range."""


class CostRecord(TypedDict):
    """An expected cost, enclosed: the least or the greatest over all policies, or a policy's."""

    question: Question
    value: float
    lower: float
    upper: float
    exact: str | None
    seconds: float


class CostsOutput(TypedDict):
    """What `stltool check --cost --json` prints."""

    task: str
    formula: str
    model: str
    model_digest: str
    horizon: int
    encoding: str
    cost: str
    until: Literal["verdict", "horizon"]
    expected: list[CostRecord]


class LongRunRecord(TypedDict):
    """An answer about runs that go on for ever, enclosed: the least or the greatest over all policies, or a policy's.

    `share` is the long-run share of the steps at which the task holds; the others are the probability that it holds at
    every step, at infinitely many steps, and at every step from some step on. Runs reach so many `pairs` of model and
    automaton states, with so many maximal end `components`.
    """

    asked: Literal["share", "always", "recurrence", "persistence"]
    question: Question
    value: float
    lower: float
    upper: float
    exact: str | None
    encoding: str
    pairs: int
    components: int
    seconds: float


class LongRunOutput(TypedDict):
    """What `stltool check --for-ever --json` prints.

    `repeated` is the bounded formula that is judged at every step: the task itself, or what the task repeats in the
    form G (always), G F (recurrence) or F G (persistence).
    """

    task: str
    formula: str
    form: Literal["always", "recurrence", "persistence"] | None
    repeated: str
    model: str
    model_digest: str
    horizon: int
    answers: list[LongRunRecord]
    at_least: NotRequired[float]
    at_most: NotRequired[float]
    holds: NotRequired[bool]
    decided: NotRequired[bool]


class CostDistributionOutput(TypedDict):
    """What `stltool check --cost --within --json` prints: P(task and cost <= c), enclosed, for every budget c.

    The model is the one with what is left of the budget; verdicts are on the largest budget.
    """

    task: str
    formula: str
    model: str
    model_digest: str
    horizon: int
    encoding: str
    cost: str
    question: Question
    nature: Nature | None
    within: str
    budgets: list[str]
    lower: list[float]
    upper: list[float]
    exact: list[str] | None
    seconds: float
    at_least: NotRequired[float]
    at_most: NotRequired[float]
    holds: NotRequired[bool]
    decided: NotRequired[bool]


class ParamRecord(TypedDict):
    """A task's param and the values asked about; direction 1: larger is weaker, -1: larger is stronger, 0: neither."""

    name: str
    values: list[str]
    direction: Literal[-1, 0, 1]


class ProbeRecord(TypedDict):
    """P, enclosed, at values of the params; whether it reaches the bound (null: undecided)."""

    values: list[str]
    P: float
    lower: float
    upper: float
    holds: bool | None


class FrontierStep(TypedDict):
    """The tightest value of the last param for values of the others; null if none reaches the bound."""

    others: list[str]
    tightest: str | None
    probe: ProbeRecord


class FrontierOutput(TypedDict):
    """What `stltool frontier --json` prints."""

    task: str
    formula: str
    model: str
    model_digest: str
    question: Question
    bound: float
    params: list[ParamRecord]
    method: Literal["bisection", "staircase", "scan"]
    steps: list[FrontierStep]
    probes: list[ProbeRecord]
    seconds: float


class RobustnessRecord(TypedDict):
    """By how much a task holds: bounds on P(robustness >= value), for each value by itself, and on the mean."""

    task: str
    formula: str
    model: str
    model_digest: str
    horizon: int
    question: Question
    values: list[Robustness]
    lower: list[float]
    upper: list[float]
    mean: list[float] | None
    seconds: float
    at_least: NotRequired[float]
    at_most: NotRequired[float]
    holds: NotRequired[bool]
    decided: NotRequired[bool]


class EnclosuresRecord(TypedDict):
    """Bounds on several probabilities, in order."""

    lower: list[float]
    upper: list[float]


class TimingRecord(TypedDict):
    """How many steps of delay a task tolerates: bounds on P(time robustness >= k), entry k of each list.

    `predicates`: every predicate keeps its truth for k more steps; `whole_task`: the task holds from each of the steps
    0 to k on. With a margin, the robustness is at least that, too.
    """

    task: str
    formula: str
    model: str
    model_digest: str
    question: Question
    margin: float | None
    predicates: EnclosuresRecord
    whole_task: EnclosuresRecord
    seconds: float
    at_least: NotRequired[float]
    at_most: NotRequired[float]
    holds: NotRequired[bool]
    decided: NotRequired[bool]


class EstimateRecord(TypedDict):
    """How many sampled runs satisfied the task, and bounds on P that hold with this confidence."""

    runs: int
    satisfied: int
    probability: float
    lower: float
    upper: float
    confidence: float
    side: str
    method: str
    steps: int | None
    seed: int | None
    seconds: float
    statement: str


class StatisticalRecord(ProductRecord):
    """How many sampled runs satisfied a task, next to the exact probability of the same policy, if it is known."""

    policy: str
    runs: int
    satisfied: int
    seed: int | None
    seconds: float
    statement: str
    exact: float | None
    exact_lower: float | None
    exact_upper: float | None
    exact_inside: bool | None


class EstimateOutput(StatisticalRecord):
    """What `stltool estimate --json` prints: an interval that has this confidence."""

    probability: float
    lower: float
    upper: float
    confidence: float
    side: str
    method: str
    steps: int | None


class SequentialOutput(StatisticalRecord):
    """What `stltool estimate --at-least P --json` prints: how the test ended. An infinite ratio is null."""

    verdict: Literal["holds", "does not hold", "undecided"]
    holds: bool
    at_least: float
    indifference: float
    alpha: float
    beta: float
    log_likelihood_ratio: float | None
    accept_below: float
    reject_above: float


# -------------------------------------------------------------------------------------------------------------- runs


class StepRecord(TypedDict):
    """One step of a sampled run, in the user's names; the last has no action."""

    step: int
    state: str
    signals: dict[str, float]
    labels: list[str]
    memory: str
    action: str | None


class RunRecord(TypedDict):
    """A sampled run, its states also by index."""

    satisfied: bool
    seed: int
    states: list[int]
    steps: list[StepRecord]


class LikelyRunRecord(TypedDict):
    """One of the most probable runs: state i was left by action i; `remembered` is null at step 0."""

    probability: float
    log_probability: float
    share: float | None
    satisfied: bool
    step: int
    certain_from: int
    remembered: str | None
    state_indices: list[int]
    states: list[str]
    labels: list[list[str]]
    actions: list[str]
    memory: list[str]


class LikelyRecord(TypedDict):
    """The most probable runs of a verdict, and how much of its probability they cover."""

    satisfied: bool
    verdict_probability: float
    mass: float
    covered: float
    exhausted: bool
    status: str
    runs: list[LikelyRunRecord]


class ActionSensitivityRecord(TypedDict):
    """An action of a state: its intended successor, the derivative of P, and how often it is expected to be taken."""

    action: str
    intended: str
    success: float
    derivative: float
    times: float


class SensitivityRecord(TypedDict):
    """A state whose success probability moves P."""

    state: int
    name: str
    derivative: float
    steepest: float
    visits: float
    actions: list[ActionSensitivityRecord]


class WhyRecord(LikelyRecord):
    """Why a task fails: the most probable violations, the states on which P depends most, and what would have become of
    the first violation under other actions (null where none was found)."""

    sensitive: list[SensitivityRecord]
    what_if: WhatIfRecord | None


class WhyOutput(ProductRecord):
    """What `stltool why --json` prints."""

    question: Question
    policy: str
    probability: float
    lower: float
    upper: float
    asked_mass: float | None
    satisfied: bool
    verdict_probability: float
    mass: float
    covered: float
    exhausted: bool
    status: str
    runs: list[LikelyRunRecord]
    sensitive: list[SensitivityRecord]


class LeavesRecord(TypedDict):
    """The best tree found of a size."""

    leaves: int
    probability: float


class TreeOutput(ProductRecord):
    """What `stltool explain --policy --json` prints: a decision tree in place of a policy. `tree` nests `if`, `then`
    and `else` down to an `action`, each with its `share` of the steps."""

    given: float
    price: float
    probability: float
    lower: float
    upper: float
    met: bool
    leaves: int
    rules: list[str]
    legend: list[str]
    memory: dict[str, list[str]]
    tree: dict[str, Any]
    curve: list[LeavesRecord]


# ---------------------------------------------------------------------------------------------------------- learning


class HistoryRecord(TypedDict):
    """A point of a learning curve: the exact probability of the greedy policy; null for a black box."""

    episode: int
    steps: int
    probability: float | None
    gap: NotRequired[float]


class ParameterRecord(TypedDict):
    """What transitions say about a parameter of the model."""

    name: str
    lower: float
    upper: float
    estimate: float
    transitions: NotRequired[int]


class GapRecord(TypedDict):
    """What transitions prove about a policy's distance to the optimum."""

    upper: float
    confidence: float
    without_data: float
    transitions: int
    assumes: str
    statement: str
    looser: str | None
    refused: str | None
    parameters: list[ParameterRecord]


class TrainingRecord(TypedDict):
    """A training run: method, settings, and its exact learning curve."""

    method: str
    faithful: bool
    seed: int
    settings: dict[str, Any]
    budget: dict[str, Any]
    status: str
    settled: bool | None
    advice: str | None
    environment_steps: int
    seconds: float
    history: list[HistoryRecord]
    gap: NotRequired[GapRecord]


class DeviationRecord(TypedDict):
    """A choice whose outcomes depend on the context, by so many standard deviations."""

    choice: str
    deviations: float


class MarkovRecord(TypedDict):
    """Whether data contradict the assumption that the next state depends on state and action alone."""

    p_value: float
    confidence: float
    dependence: float
    transitions: int
    choices: int
    most: list[DeviationRecord]
    statistic: float
    expected: float
    draws: int
    seed: int
    seconds: float
    rejected: bool
    statement: str


class TrainingOutput(TrainingRecord):
    """What `stltool learn --json` prints."""

    task: str
    formula: str
    markov: MarkovRecord | None


class GuaranteeRecord(TypedDict):
    """A lower bound on a policy's P from data, at a confidence, and what it assumes; `refused` if none is given."""

    source: str
    lower: float
    confidence: float
    seconds: float
    assumes: str
    statement: str
    support: NotRequired[str]
    transitions: NotRequired[int]
    choices: NotRequired[int]
    never_tried: NotRequired[int]
    parameters: NotRequired[list[ParameterRecord]]
    evidence_against_tie: NotRequired[float | None]
    looser: NotRequired[str | None]
    runs: NotRequired[int]
    satisfied: NotRequired[int]
    seed: NotRequired[int | None]
    refused: NotRequired[str]


# ----------------------------------------------------------------------------------------------------------- reports


class FloorRecord(TypedDict):
    """The floor of a grid world: column and row of each state, and the states of each label.

    member, stride   in a composition: whose floor it is, "" otherwise; a state s of the model is the floor's state
                     (s // stride) mod the number of its states
    """

    member: str
    stride: int
    width: int
    height: int
    column: list[int]
    row: list[int]
    labels: dict[str, list[int]]
    initial: list[int]


class AskedRecord(TypedDict):
    """A bound that was asked for, such as "P >= 19/20", and whether it holds; null: it lies inside the enclosure."""

    claim: str
    holds: bool | None


class ProvedRecord(TypedDict):
    """A certificate that was written, the bounds that it proves, as fractions, and the command that re-checks it."""

    file: str
    lower: str
    upper: str
    command: str


class ReportRecord(ProductRecord):
    """A report of `stltool run` or `stl.report`: checks, training, guarantees from data, and runs of the policy."""

    format: Literal["stltool-report-1"]
    version: str
    source: str | None
    command: str | None
    checks: list[CheckRecord]
    estimates: list[EstimateRecord]
    guarantees: list[GuaranteeRecord]
    stationary: list[StationaryRecord]
    training: TrainingRecord | None
    markov: MarkovRecord | None
    run: RunRecord | None
    why: WhyRecord | None
    floors: list[FloorRecord]
    asked: list[AskedRecord]
    certificate: ProvedRecord | None
    words: SentenceRecord
    names: dict[str, str]
    automaton: AutomatonRecord | None
    explorer: ExplorerRecord


class MethodRecord(TypedDict):
    """A method of a sweep, with the settings that the sweep gives it."""

    id: str
    name: str
    faithful: bool
    settings: dict[str, Any]


class ScenarioRecord(TypedDict):
    """A scenario of a sweep: a task on a model, and its optimum."""

    id: str
    task: str
    formula: str
    model: str
    model_digest: str
    params: dict[str, str]
    horizon: int
    states: int
    automaton_states: int
    settings: dict[str, Any]
    optimum: float
    optimum_lower: float
    optimum_upper: float


class CurveRecord(TypedDict):
    """Quartiles over the seeds, at environment steps."""

    steps: list[int]
    q1: list[float]
    median: list[float]
    q3: list[float]


class SweepRunRecord(TypedDict):
    """The learning curve of one seed."""

    seed: int
    episode: list[int]
    steps: list[int]
    probability: list[float]


class SweepResultRecord(TypedDict):
    """One scenario with one method, over its seeds."""

    scenario: str
    method: str
    settings: dict[str, Any]
    budget: dict[str, Any]
    seeds: list[int]
    median: float
    q1: float
    q3: float
    least: float
    greatest: float
    published: float | None
    optimum: float
    environment_steps: int
    near_optimum_at: int | None
    regret: float
    seconds: float
    curve: CurveRecord
    runs: list[SweepRunRecord]


class FailureRecord(TypedDict):
    """Runs of a sweep that failed for one reason."""

    scenario: str
    method: str
    seeds: list[int]
    message: str


class SweepCounts(TypedDict):
    """Runs of a sweep."""

    finished: int
    failed: int
    all: int


class SectionRecord(TypedDict):
    """A section of a sweep's page: a table and a figure."""

    title: str
    text: str
    rows: list[dict[str, Any]]
    figure: dict[str, Any] | None


class SweepRecord(TypedDict):
    """A report of `stltool sweep`."""

    format: Literal["stltool-sweep-1"]
    version: str
    name: str
    command: str | None
    columns: int
    settings: dict[str, Any]
    methods: list[MethodRecord]
    scenarios: list[ScenarioRecord]
    results: list[SweepResultRecord]
    runs: SweepCounts
    failures: list[FailureRecord]
    sections: list[SectionRecord]


# ------------------------------------------------------------------------------------------------------ expectations


class CertificateRecord(TypedDict):
    """A certificate that was written: its file, the bounds it proves, as fractions, and whether they decide the
    expectation."""

    file: str
    lower: str
    upper: str
    decides: bool


class ExpectationRecord(TypedDict):
    """One expectation of a task file, and whether it holds; `text` is its line, `formula` what it is about.

    `decided_by` is "enclosure" (lower <= P <= upper on one side of the bound), "fraction" (the exact value) or "trace";
    it is null if the expectation is undecided or in error, and `reason` then states why. `bound` and `exact` are exact.
    `why` explains the verdict on a trace, in a batch on the first that fails; null if it holds. `part` and `measure`
    are what a cover expectation counts, `count` the number found, over so many `traces`.
    """

    file: str
    line: int
    column: int
    text: str
    question: Literal["Pmax", "Pmin", "P", "holds", "cover"]
    robust: bool
    task: str | None
    formula: str
    relation: Literal[">=", "<=", ">", "<"] | None
    bound: str | None
    policy: str | None
    trace: str | None
    part: str | None
    measure: Literal["held", "failed", "closed", "mattered", "vacuous", "premises", "parts"] | None
    verdict: Verdict
    decided_by: Literal["enclosure", "fraction", "trace"] | None
    reason: str | None
    probability: float | None
    lower: float | None
    upper: float | None
    exact: str | None
    robustness: Robustness | None
    traces: int | None
    count: int | None
    model: str | None
    model_digest: str | None
    horizon: int | None
    product_states: int | None
    certificate: CertificateRecord | None
    why: DiagnosisRecord | None
    seconds: float


class VerdictCounts(TypedDict):
    """Expectations by verdict."""

    holds: int
    does_not_hold: int
    undecided: int
    error: int


class VerifyRecord(TypedDict):
    """A report of `stltool verify`: every expectation of every file."""

    format: Literal["stltool-verify-1"]
    version: str
    command: str | None
    files: list[str]
    holds: bool
    counts: VerdictCounts
    expectations: list[ExpectationRecord]
    seconds: float


# ----------------------------------------------------------------------------------------------- trade-offs, monitors


class FigureRecord(TypedDict):
    """A value with its enclosure."""

    value: float
    lower: float
    upper: float


class JointRecord(TypedDict):
    """Several tasks on one model: names, formulas and sizes."""

    tasks: dict[str, str]
    model: str
    model_digest: str
    horizon: int
    encoding: str
    states: int
    automaton_states: dict[str, int]
    joint_states: int


class TradeoffRecord(JointRecord):
    """The best probability of one task under constraints, and the bound that no policy exceeds."""

    objective: str
    at_least: dict[str, float]
    budget: dict[str, float]
    probabilities: dict[str, FigureRecord]
    costs: dict[str, FigureRecord]
    bound: float
    gap: float
    multipliers: dict[str, float]
    policy: str | None
    randomised: int
    size: dict[str, int]
    status: str
    seconds: float


class AlternativeRecord(TypedDict):
    """An action at a step of a run: P that the task would have been satisfied; `taken`: it is what the run did."""

    step: int
    state: str
    action: str
    taken: bool
    probability: float
    lower: float
    upper: float
    fraction: NotRequired[str]


class WhatIfRecord(TypedDict):
    """What would have become of a run under other actions, and what that assumes; `satisfied` is null for a run that
    ended undecided. `noise`: for each step, the shares of what may have happened, null for a successor without name."""

    satisfied: bool | None
    visited: list[str]
    actions: list[str]
    coupling: str
    assumption: str
    noise: list[list[NoiseRecord]]
    alternatives: list[AlternativeRecord]


class NoiseRecord(TypedDict):
    """Something that may have disturbed a step, and how probable that is in view of where the step led."""

    name: str | None
    share: float


class CounterfactualOutput(ProductRecord, WhatIfRecord):
    """What `stltool counterfactual --json` prints."""

    policy: str


class ShieldRecord(ProductRecord):
    """A shield: the promise, the least P of all policies that obey, P of the even choice, how much is allowed."""

    at_least: float
    rule: str
    levels: int
    least: FigureRecord
    uniform: float
    share: float


class CornerRecord(TypedDict):
    """A corner of a front: the probabilities of a policy, and the weights for which it is optimal."""

    probabilities: dict[str, FigureRecord]
    weights: dict[str, float]
    bound: float


class LineRecord(TypedDict):
    """A line that no policy crosses: the weighted sum is at most the bound."""

    weights: list[float]
    bound: float


class FrontRecord(JointRecord):
    """Which pairs of probabilities two tasks can have."""

    corners: list[CornerRecord]
    lines: list[LineRecord]
    gap: float
    inductions: int
    status: str
    seconds: float


class TraceRecord(TypedDict):
    """The verdicts on one trace, in short; of one of several files, with its name, its lengths and its clock."""

    verdict: bool
    holds: bool
    violations: int
    first_violation: int | None
    first_violation_time: float | None
    least_robustness: Robustness
    least_robustness_at: int
    least_robustness_time: float | None
    file: NotRequired[str]
    samples_there: NotRequired[int]
    judged_there: NotRequired[int]
    clock_there: NotRequired[str | None]


class CauseRecord(TypedDict):
    """Samples of one signal that a verdict depends on; `times` if the duration of a step is declared."""

    signal: str
    steps: list[int]
    values: list[float | bool]
    times: NotRequired[list[float]]


class ReasonRecord(TypedDict):
    """A sub-formula that has one truth value at some steps, and the operands that decide it there.

    `steps` are ranges [first, last]. If the part is the operand of a failed eventually or until, it is `awaited`, and
    `last` and `next` are the last step before and the first after at which it holds, as far as the trace decides.
    """

    formula: str
    holds: bool
    steps: list[list[int]]
    parts: list[ReasonRecord]
    awaited: bool
    last: int | None
    next: int | None


class DiagnosisRecord(TypedDict):
    """What decided the verdict at a step.

    `time`, in the declared `unit`, is that of the step. `causes` force the verdict, whatever the other samples are.
    None of them can be left out if they are `minimal`; otherwise `doubt` states why some might. `by_cases`: the tree
    under `reason` is one of several.
    """

    trace: int | None
    step: int
    verdict: bool
    time: float | None
    unit: str | None
    sentences: list[str]
    summary: str
    causes: list[CauseRecord]
    minimal: bool
    doubt: str | None
    by_cases: bool
    reason: ReasonRecord


class CoveredPartRecord(TypedDict):
    """A part of a formula: steps at which it held, failed, or is open at the end, and traces in which it mattered."""

    part: str
    premise: bool
    held: int
    failed: int
    open: int
    mattered: int


class CountedRecord(TypedDict):
    """An `expect cover(…)` line of the task file, and the number that was counted."""

    text: str
    count: int
    verdict: Verdict


class CoverageRecord(TypedDict):
    """What traces say about a formula; `more` parts are not counted, `gaps` says in words what is not tested."""

    traces: int
    passed: int
    vacuous: int
    parts: list[CoveredPartRecord]
    more: int
    gaps: list[str]
    expectations: list[CountedRecord]


class MonitorRecord(TraceRecord):
    """Verdicts and robustness of a trace at every judged step; of a batch, lists of lists, and `each` trace.

    Of several files, `samples` and `judged` are those of the longest trace. `step` is the duration of a step and, like
    all times, in `unit`; null if none is declared. `clock` says what was done with the times of the trace.
    """

    task: str | None
    formula: str
    trace: str
    traces: int | None
    samples: int
    horizon: int | None
    end: str
    at: int | None
    unit: str | None
    step: float | None
    clock: str | None
    judged: int
    verdicts: list[bool | list[bool]]
    robustness: list[Robustness | list[Robustness]]
    violating_traces: NotRequired[int]
    each: NotRequired[list[TraceRecord]]
    why: NotRequired[DiagnosisRecord]
    coverage: NotRequired[CoverageRecord]


class FollowedStepRecord(TypedDict):
    """A decision: the step whose sample made it certain, or null at the end of the trace. Times are in the `unit`."""

    step: int
    time: float | None
    verdict: bool
    certain_at: int | None
    certain_at_time: float | None


class FollowedRecord(TypedDict):
    """What `stltool monitor --follow --json` prints at the end of the trace: the decisions, in the order of deciding.

    `holds` says that none of the `decided` steps is violated; the verdicts of the other samples depend on what comes.
    """

    task: str | None
    formula: str
    trace: str
    samples: int
    horizon: int
    end: str
    at: int | None
    unit: str | None
    step: float | None
    clock: str | None
    decided: int
    holds: bool
    violations: int
    first_violation: int | None
    first_violation_time: float | None
    decisions: list[FollowedStepRecord]


class RobustnessReport(RobustnessRecord):
    """A report of `stltool check --robustness`.

    `beside`: of the optimum, the distribution of the policy that is best for P; of a policy, that of the optimum.
    `margin`: the one that was asked for, or the largest with the probability that was asked for.
    """

    format: Literal["stltool-robustness-1"]
    version: str
    command: str | None
    words: SentenceRecord
    beside: RobustnessRecord
    margin: Robustness | None


class ParametricReport(ParametricRecord):
    """A report of `stltool check --vary`."""

    format: Literal["stltool-parametric-1"]
    version: str
    command: str | None
    words: SentenceRecord


class FrontierReport(FrontierOutput):
    """A report of `stltool frontier`."""

    format: Literal["stltool-frontier-1"]
    version: str
    command: str | None
    words: SentenceRecord


class FrontReport(FrontRecord):
    """A report of `stltool pareto`: a front, and its tasks in words."""

    format: Literal["stltool-front-1"]
    version: str
    command: str | None
    words: dict[str, SentenceRecord]


class SubformulaRecord(TypedDict):
    """Where a part of the formula holds: ranges [first, last] of its `judged` steps; null if a term has no value."""

    formula: str
    judged: int
    holds: list[list[int]] | None


class MonitorReport(MonitorRecord):
    """A report of `stltool monitor`: a judged trace, and the task in words; null if an interval has no end.

    `subformulas` are judged on the trace that the page shows; `more_subformulas` is the number of others.
    """

    format: Literal["stltool-monitor-1"]
    version: str
    command: str | None
    words: SentenceRecord | None
    subformulas: list[SubformulaRecord]
    more_subformulas: int


class EstimateReport(EstimateOutput):
    """A report of `stltool estimate`: an interval, and the task in words."""

    format: Literal["stltool-estimate-1"]
    version: str
    command: str | None
    words: SentenceRecord


class SequentialReport(SequentialOutput):
    """A report of `stltool estimate --at-least P`: how the test ended, and the task in words."""

    format: Literal["stltool-test-1"]
    version: str
    command: str | None
    words: SentenceRecord


class PlayedStepRecord(TypedDict):
    """A step of a played run: what is remembered, P from there under the policy, and the action taken."""

    step: int
    state: str
    labels: list[str]
    memory: str
    probability: float
    action: str | None


class PlayOutput(TypedDict):
    """What `stltool play --json` prints: the run; `satisfied` is null while the verdict is open."""

    task: str
    formula: str
    policy: str
    satisfied: bool | None
    steps: list[PlayedStepRecord]


class SurrogateRecord(TypedDict):
    """P of the policies that are optimal for one reading of the surrogate reward [Wang24]."""

    reading: str
    gamma: float | None
    at_random: float
    at_random_lower: float
    at_random_upper: float
    least: float
    least_lower: float
    least_upper: float
    greatest: float
    greatest_lower: float
    greatest_upper: float
    optimum: float
    optimum_lower: float
    optimum_upper: float
    gap: float
    tolerance: float
    sweeps: int
    seconds: float
    status: str


class SizeRecord(TypedDict):
    """States of an automaton and of its product, and the size of a table Q(s, q, a)."""

    automaton_states: int
    product_states: int
    q_entries: int
    q_bytes: int


class HistoriesRecord(TypedDict):
    """Sequences of model states, all and those along transitions, and the size of a Q-table on these."""

    all: int
    possible: int
    q_entries: int
    q_bytes: int


class EncodingsRecord(TypedDict):
    """The encodings of a task on a model, side by side."""

    states: int
    remembered_steps: int
    flags: SizeRecord
    exact: SizeRecord
    history: SizeRecord | None
    state_histories: HistoriesRecord
    optimum: float
    history_optimum: float | None
    history_refused: str | None


class SurrogateOutput(ProductRecord):
    """What `stltool surrogate --json` prints."""

    surrogates: list[SurrogateRecord]


FORMATS = {
    "stltool-report-1": ReportRecord,
    "stltool-sweep-1": SweepRecord,
    "stltool-verify-1": VerifyRecord,
    "stltool-front-1": FrontReport,
    "stltool-robustness-1": RobustnessReport,
    "stltool-parametric-1": ParametricReport,
    "stltool-frontier-1": FrontierReport,
    "stltool-monitor-1": MonitorReport,
    "stltool-estimate-1": EstimateReport,
    "stltool-test-1": SequentialReport,
}
"""The files that stltool writes, by their `format`."""

OUTPUTS = {
    "check": CheckOutput,
    "check --cost": CostsOutput,
    "check --cost --within": CostDistributionOutput,
    "check --for-ever": LongRunOutput,
    "check --robustness": RobustnessRecord,
    "check --robustness --time-shift": TimingRecord,
    "check --vary": ParametricRecord,
    "counterfactual": CounterfactualOutput,
    "estimate": EstimateOutput,
    "estimate --at-least": SequentialOutput,
    "explain --policy": TreeOutput,
    "explain": ExplainOutput,
    "frontier": FrontierOutput,
    "learn": TrainingOutput,
    "monitor": MonitorRecord,
    "monitor --follow": FollowedRecord,
    "pareto": FrontRecord,
    "play": PlayOutput,
    "run": ReportRecord,
    "shield": ShieldRecord,
    "surrogate": SurrogateOutput,
    "sweep": SweepRecord,
    "tradeoff": TradeoffRecord,
    "verify": VerifyRecord,
    "why": WhyOutput,
}
"""What the commands that compute something print with --json."""
