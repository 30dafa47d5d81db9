"""cfper: cfer whose tuples are drawn with weight exp(−‖f̃ − f‖₁): flags near the factual ones are drawn more often.

Only as published: the corrected cfer stores no counterfactual tuples that could be weighted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from stltool.learning.published import Counterfactual


@dataclass(frozen=True, kw_only=True)
class PublishedCfper(Counterfactual):
    """cfer with tuples drawn by weight exp(−d), d the distance of their flags from the factual ones."""

    name: ClassVar[str] = "cfper"
    weighted: ClassVar[bool] = True
