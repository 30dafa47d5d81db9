"""How a device without a server takes an address: `python -m examples.zeroconf.zeroconf` writes zeroconf.tra.

Written anew from the protocol (RFC 3927, IPv4 link-local addresses). There are 65024 addresses, 1000 of them taken. The
device picks one, asks up to four times whether it is taken, and then either asks again or takes it. If it is taken, its
owner answers, unless question or answer is lost, with probability 1/4; the device then picks another one. Taking an
address in use is a conflict, and final.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

from examples.explicit import Choice, State, write

TAKEN, LOST, PROBES = Fraction(1000, 65024), Fraction(1, 4), 4


def choices(state: State) -> Iterator[Choice]:
    if state == "pick":
        yield "pick", [(TAKEN, ("probing", True, 0)), (1 - TAKEN, ("probing", False, 0))]
        return
    if state in ("configured", "conflict"):
        yield "stay", [(Fraction(1), state)]
        return
    _, taken, asked = state
    if asked:
        yield "take", [(Fraction(1), "conflict" if taken else "configured")]
    if asked < PROBES:
        unanswered = LOST if taken else Fraction(1)
        row = [(unanswered, ("probing", taken, asked + 1))]
        yield "ask", [*row, (1 - unanswered, "pick")] if taken else row


def main(folder: Path = Path(__file__).parent) -> Path:
    labels = {"configured": lambda s: s == "configured", "conflict": lambda s: s == "conflict"}
    return write(folder / "zeroconf", "pick", choices, labels, {"asked": lambda s: s[2] if isinstance(s, tuple) else 0})


if __name__ == "__main__":
    main()
