"""`markov_test`: does the next state depend on more than the state and the action?

**Hypothesis.** A context g is something else that was known before a transition: the choice before, a heading, the
hour. Let n_cgs count how often choice c, taken in context g, led to s, and write · for a sum. The process is Markov in
the states that were counted only if

    H₀: the successors of c have the same distribution in every context g.

**Statistic.** For each choice, the log-likelihood ratio of one distribution for each context against one for all,

    G_c = 2 Σ_gs n_cgs ln( n_cgs n_c·· / (n_cg· n_c·s) ).

T₁ = Σ_c G_c notices a dependence that is everywhere; T₂ = max_c (G_c − mean) / deviation, both under H₀, one that few
choices have.

**Level.** Given how often a choice was taken in each context and how often it led to each state, under H₀ every pairing
of contexts with outcomes is equally likely, so n_c is a random table with these margins, and such tables can be drawn
[Patefield81]. B are drawn for each choice; if b of the B values of a statistic are at least the observed one,
(b + 1)/(B + 1) is a p-value without any approximation, however small the counts [Barnard63]. Mean and deviation are
those of all B + 1 values, so the observed one is treated like the others. Of the two p-values twice the smaller one
counts: p = min(1, 2 min(p₁, p₂)), so P(p ≤ α) ≤ α.

**What this assumes.** Under H₀, the contexts in which a choice is taken do not depend on its earlier outcomes. If the
context is the choice before, they do, since outcomes decide where a run goes; the limit for many transitions is the
same [Billingsley61], and the tests measure the error rate on the data of learners. It is lost if whoever gathered the
data looked at context and outcome together: by trying a choice again in one context until it succeeds, say.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import function, require, whole
from stltool.checking.induction import Progress
from stltool.checking.statistical import require_confidence
from stltool.display import Card, Displayed, counted
from stltool.errors import SettingsError
from stltool.learning.counts import Counts, Whole
from stltool.numbers import exact
from stltool.product import Product
from stltool.randomness import Purpose, generator, require_seed

if TYPE_CHECKING:
    from stltool.learning.learn import Training

_CELLS = 1 << 22  # of the tables drawn at once
_MOST_SHOWN = 5
_TIES = 1e-9  # relative: sums of the same terms in another order are equal


@dataclass(frozen=True, repr=False)
class MarkovTest(Displayed):
    """Whether the data contradict the assumption that the next state depends on state and action alone.

    p_value      of data that satisfy the assumption, at most a share p has a p-value of p or less
    confidence   the assumption is rejected if p_value ≤ 1 − confidence
    dependence   by how much contexts change where choices lead: the total variation between the successors in a
                 context and those in all contexts, averaged over the transitions tested, less what chance alone yields.
                 0.05: knowing the context moves 5 % of the probability elsewhere
    transitions  how many were tested: those of `choices` choices that were taken in several contexts and had several
                 outcomes; the others say nothing
    most         the choices that depend most on the context, and by how many standard deviations, greatest first
    statistic, expected   Σ G of the data, and its mean under the assumption
    """

    p_value: float
    confidence: float
    dependence: float
    transitions: int
    choices: int
    most: tuple[tuple[int, float], ...]
    statistic: float
    expected: float
    draws: int
    seed: int
    seconds: float = 0.0

    def _card(self) -> Card:
        found = "rejected" if self.rejected else "not rejected" if self.choices else "nothing to test"
        return Card(
            f"MarkovTest: {found}, {self.p_text}",
            [
                {
                    "dependence": f"{self.dependence:.3g}",
                    "tested": f"{counted(self.transitions, 'transition')} of {counted(self.choices, 'choice')}",
                    "confidence": f"{100 * self.confidence:.12g} %",
                },
                {"statistic": f"{self.statistic:.6g}", "expected": f"{self.expected:.6g}", "seed": self.seed},
            ],
        )

    @property
    def rejected(self) -> bool:
        """Whether the data contradict the assumption."""
        return exact(self.p_value) <= 1 - exact(self.confidence)  # decimals, as doubles 0.001 > 1 - 0.999

    @property
    def p_text(self) -> str:
        """The p-value in words: `p = 0.37`, or `p <= 0.002` where it is the least that the number of draws allows."""
        sign = "<=" if self.p_value <= 2 / (self.draws + 1) else "="
        return f"p {sign} {self.p_value:.2g}"

    @property
    def statement(self) -> str:
        """What was found, in words."""
        if not self.choices:
            return "nothing to test: no choice was taken in two contexts and had two different outcomes"
        of = f"{self.p_text}, {counted(self.transitions, 'transition')}"
        if self.rejected:
            return (
                f"the next state depends on more than state and action ({of}): knowing the context moves "
                f"{100 * self.dependence:.2g} % of the probability elsewhere; add the context to the state, or rely on "
                "fresh runs alone"
            )
        return f"no evidence that the next state depends on more than state and action ({of})"


def markov_test(
    counts: Counts,
    *,
    confidence: float = 0.99,
    draws: int = 999,
    seed: int = 0,
    progress: Progress | None = None,
) -> MarkovTest:
    """Test whether where choices lead depends on the context, in addition to the state and the action.

    counts      transitions with their contexts: those of `learn` (the context is the choice before), or your own, as in
                `Counts(n_choices, n_states, n_contexts)`
    confidence  the assumption is rejected if the p-value is at most 1 − confidence: of data that satisfy it, at most
                this share is rejected
    draws       random tables for each choice; the least possible p-value is 2/(draws + 1)
    seed        an integer from 0, the source of those tables: same seed, same result
    progress    called with (choices done, choices)

    That an assumption is not rejected does not prove it: contexts that were not counted are not tested, and small
    dependences need many transitions. Raises SettingsError if the counts have no contexts, or for settings out of
    range.
    """
    began = time.perf_counter()
    require(counts, Counts, "markov_test's counts")
    require_confidence(confidence)
    function(progress, "markov_test's progress")
    draws = whole(draws, "draws", 1)
    alpha = 1 - exact(confidence)
    if alpha * (draws + 1) < 2:
        raise SettingsError(
            f"with {draws} draws no p-value is less than {2 / (draws + 1):.3g}, so nothing is ever rejected with "
            f"confidence {confidence}; use draws={-int(-2 // alpha) - 1}"
        )
    seed = require_seed(seed)
    if counts.n_contexts == 1:
        raise SettingsError(
            "the counts have no contexts, so there is nothing to compare; take the counts of stl.learn, or count with "
            "Counts(n_choices, n_states, n_contexts)"
        )
    rng = generator(seed, Purpose.MARKOV_TEST)
    tables = list(_tables(counts))
    total, largest = np.zeros(draws + 1), np.full(draws + 1, -np.inf)
    moved = 0.0
    excess = np.zeros(len(tables))
    for i, (_, table) in enumerate(tables):
        ratios, variation = _under_null(table, draws, rng)
        deviation = ratios.std()
        scaled = (ratios - ratios.mean()) / deviation if deviation > _TIES * (1 + ratios.max()) else np.zeros(draws + 1)
        total += ratios
        np.maximum(largest, scaled, out=largest)
        moved += variation * table.sum()
        excess[i] = scaled[0]
        if progress is not None:
            progress(i + 1, len(tables))
    p_value = min(1.0, 2 * min(_rank(total), _rank(largest))) if tables else 1.0
    transitions = int(sum(table.sum() for _, table in tables))
    order = np.argsort(-excess, kind="stable")[:_MOST_SHOWN]
    return MarkovTest(
        p_value=p_value,
        confidence=float(confidence),
        dependence=max(0.0, moved / max(transitions, 1)),
        transitions=transitions,
        choices=len(tables),
        most=tuple((tables[i][0], float(excess[i])) for i in order.tolist()),
        statistic=float(total[0]),
        expected=float(total.mean()),
        draws=draws,
        seed=seed,
        seconds=time.perf_counter() - began,
    )


def tested(training: Training) -> MarkovTest | None:
    """For a black box, whether the data of a training contradict the assumption; None if the model is known, or nothing
    was learned."""
    model = cast(Product, training.policy.home).model  # learners do not support joint products
    if model.blackbox is None or not training.environment_steps:
        return None
    return markov_test(training.counts, seed=training.seed)


def _tables(counts: Counts) -> Iterator[tuple[int, Whole]]:
    """(choice, (contexts, outcomes) counts) of every choice that has several of both."""
    choice, target, context, seen = counts.in_context
    starts = np.flatnonzero(np.diff(choice, prepend=-1)).tolist()
    for start, end in itertools.pairwise([*starts, len(choice)]):
        rows, row = np.unique(context[start:end], return_inverse=True)
        columns, column = np.unique(target[start:end], return_inverse=True)
        if len(rows) > 1 and len(columns) > 1:
            table = np.zeros((len(rows), len(columns)), dtype=np.int64)
            table[row, column] = seen[start:end]
            yield int(choice[start]), table


def _under_null(table: Whole, draws: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], float]:
    """G of the table, then of `draws` random ones with its margins, less a constant; and its total variation less the
    mean of theirs."""
    from scipy.stats import random_table

    rows, columns = table.sum(axis=1), table.sum(axis=0)
    n = int(rows.sum())
    product = np.outer(rows, columns) / n
    weights = np.arange(int(min(rows.max(), columns.max())) + 1, dtype=np.float64)
    weights[1:] *= np.log(weights[1:])  # n ln n
    fixed = _entropy(rows) + _entropy(columns) - _entropy(np.array([n]))
    ratios, variation = np.empty(draws + 1), np.empty(draws + 1)
    family = random_table(rows, columns, seed=rng)
    batch = max(1, _CELLS // table.size)
    ratios[0], variation[0] = weights[table].sum(), np.abs(table - product).sum()
    for start in range(1, draws + 1, batch):
        size = min(batch, draws + 1 - start)
        drawn: NDArray[Any] = family.rvs(size=size).reshape(size, *table.shape).astype(np.int64)
        ratios[start : start + size] = weights[drawn].sum(axis=(1, 2))
        variation[start : start + size] = np.abs(drawn - product).sum(axis=(1, 2))
    return 2 * (ratios - fixed), float(variation[0] - variation.mean()) / (2 * n)


def _entropy(counts: Whole) -> float:
    """Σ n ln n."""
    return float((counts * np.log(np.maximum(counts, 1))).sum())


def _rank(values: NDArray[np.float64]) -> float:
    """The share of values that are at least the first one; equal ones count."""
    return float((values >= values[0] - _TIES * (1 + abs(values[0]))).mean())
