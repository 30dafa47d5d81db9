"""What a policy does, to be shown next to its probability: a sampled run, the most probable violations, what would have
become of the first of them under other actions, and the states on which P depends most.
"""

from __future__ import annotations

from dataclasses import dataclass

from stltool.checking.counterfactual import Counterfactual, counterfactual
from stltool.checking.likely import LikelyRuns, likely_runs
from stltool.checking.sampling import Run, sample_run
from stltool.checking.sensitivity import Sensitivity, sensitivity
from stltool.errors import PolicyError, SizeError
from stltool.policy import Policy
from stltool.product import Product

_RUNS = 5  # most probable violations
_MOST_EDGES = 1e7  # of the unfolded product, at most (some seconds); beyond, `stltool why` can still be used


@dataclass(frozen=True)
class Evidence:
    """A run sampled with `seed`; the others are None where finding them could take long, or was not asked for."""

    seed: int
    run: Run
    likely: LikelyRuns | None = None
    sensitive: Sensitivity | None = None
    what_if: Counterfactual | None = None


def evidence_of(product: Product, policy: Policy | None, seed: int, why: bool = True) -> Evidence | None:
    """The evidence of a policy; None if there is no policy, or no single distribution to sample from.

    `why` asks for violations and sensitive states, too.
    """
    if policy is None or product.model.uncertain:
        return None
    run = sample_run(product, policy, seed)
    if not why or _edges(product, policy) > _MOST_EDGES:
        return Evidence(seed, run)
    likely = likely_runs(product, policy, count=_RUNS)
    return Evidence(seed, run, likely, sensitivity(product, policy), _what_if(product, policy, likely))


def _what_if(product: Product, policy: Policy, likely: LikelyRuns) -> Counterfactual | None:
    """None if nothing is violated, or could have been different, or too much would have to be computed."""
    if not likely.runs or not likely.runs[0].actions:
        return None
    try:
        return counterfactual(product, likely.runs[0], policy=policy)
    except (PolicyError, SizeError):  # a policy may have no action where it never comes
        return None


def _edges(product: Product, policy: Policy) -> float:
    branches = 1 if policy.deterministic else product.model.most_choices
    successors = product.model.n_transitions / product.model.n_choices
    return product.horizon * product.n_states * branches * successors
