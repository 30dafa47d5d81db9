"""cfper: cfer whose tuples are drawn with weight exp(−‖f̃ − f‖₁): flags near the factual ones come up more often.

Only as published: the corrected cfer keeps no counterfactual tuples that could be preferred to others.
"""

from __future__ import annotations

from stltool.learning.published import Published


class FaithfulCfper(Published):
    """As published; f̃ are a tuple's flags, f those of the factual transition it was made from."""

    counterfactual = True
    weighted = True
