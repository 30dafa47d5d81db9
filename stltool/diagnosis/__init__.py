"""Why a trace satisfies a formula at a step, or violates it.

knowledge  the atoms that some samples decide             sheet     the value of every sub-formula, and what decides it
causes     a minimal set of samples that force a verdict  sentences  the tree of reasons, and its text
diagnose   the answer
"""

from stltool.diagnosis.diagnose import Diagnosis, Sample, diagnose
from stltool.diagnosis.sentences import Reason

__all__ = ["Diagnosis", "Reason", "Sample", "diagnose"]
