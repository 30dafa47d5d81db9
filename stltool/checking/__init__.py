"""The exact probability that a policy, or the best one, satisfies the task: one question a file."""

from stltool.checking.certificate import require_certificate_of, write_certificate
from stltool.checking.check import CheckResult, check
from stltool.checking.sampling import Run, sample_run

__all__ = ["CheckResult", "Run", "check", "require_certificate_of", "sample_run", "write_certificate"]
