"""Tasks that repeat a bounded formula Φ for ever: G Φ, G F Φ and F G Φ, whose outermost operators have no end.

G[a,∞) Φ           always, of Φ from step a on: always F[a,a] Φ
G[a,∞) F[b,∞) Φ    recurrence, whatever a and b are
F[a,∞) G[b,∞) Φ    persistence, likewise
"""

from __future__ import annotations

from typing import Literal, TypeAlias

from stltool.errors import StlSyntaxError
from stltool.logic.formula import FUTURE, Always, Eventually, Formula, Interval, is_bounded, walk

Repetition: TypeAlias = Literal["always", "recurrence", "persistence"]


def repeated(phi: Formula) -> tuple[Repetition | None, Formula]:
    """How a formula repeats a bounded one, and that one; None if it is bounded itself.

    Raises StlSyntaxError if it is neither.
    """
    match phi:
        case Always(Interval(_, None), Eventually(Interval(_, None), inner)):
            found: tuple[Repetition | None, Formula] = "recurrence", inner
        case Eventually(Interval(_, None), Always(Interval(_, None), inner)):
            found = "persistence", inner
        case Always(Interval(0, None), inner):
            found = "always", inner
        case Always(Interval(a, None), inner):
            found = "always", Eventually(Interval(a, a), inner)
        case _:
            found = None, phi
    if is_bounded(found[1]):
        return found
    endless = next(node for node in walk(found[1]) if isinstance(node, FUTURE) and node.interval.b is None)
    message = (
        "this interval has no end; of a task that repeats for ever, only the outermost operators have none: G phi, "
        "G F phi or F G phi, where phi is bounded"
    )
    raise StlSyntaxError(endless.span.show(message) if endless.span is not None else f"{endless}: {message}")
