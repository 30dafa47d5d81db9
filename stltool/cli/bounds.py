"""What --at-least and --at-most say of enclosures, for the commands' data and what they print."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stltool.reporting.records import CostDistributionOutput, LongRunOutput, RobustnessRecord, TimingRecord

VERDICTS = {True: "holds", False: "does not hold", None: "undecided: the bound lies inside the enclosure"}
WITH_EXACT = {**VERDICTS, None: f"{VERDICTS[None]}; add --exact"}  # where there is one


class Asked:
    """One bound, which `data` has from now on: how it reads, such as ">= 0.9", and what it says of an enclosure."""

    def __init__(
        self,
        option: str,
        text: str,
        bound: Fraction,
        data: RobustnessRecord | TimingRecord | CostDistributionOutput | LongRunOutput,
    ) -> None:
        self.below, self._bound = option == "--at-least", bound
        self.text = f"{'>=' if self.below else '<='} {text}"
        data["at_least" if self.below else "at_most"] = float(bound)

    def judge(self, lower: float | Fraction, upper: float | Fraction) -> bool | None:
        from stltool.checking.enclosed import is_at_least, is_at_most

        return (is_at_least if self.below else is_at_most)(lower, upper, self._bound)


def conclude(
    verdicts: Sequence[bool | None],
    data: RobustnessRecord | TimingRecord | CostDistributionOutput | LongRunOutput,
) -> bool:
    """Whether all bounds hold, which is added to the data."""
    data["holds"] = all(verdict is True for verdict in verdicts)
    data["decided"] = all(verdict is not None for verdict in verdicts)
    return data["holds"]
