"""The exact probability that a policy, or the best one, satisfies the task: one question a file."""

from stltool.checking.certificate import require_certificate_of, write_certificate
from stltool.checking.check import CheckResult, check
from stltool.checking.sampling import Run, sample_run
from stltool.checking.statistical import Estimate, SequentialTest, estimate, estimate_from, sprt, sprt_from

__all__ = [
    "CheckResult", "Estimate", "Run", "SequentialTest", "check", "estimate", "estimate_from", "require_certificate_of",
    "sample_run", "sprt", "sprt_from", "write_certificate",
]  # fmt: skip
