"""`parametric`: the probability of a task as a function of the model's parameter, enclosed on its whole domain.

For a policy the function is a polynomial whose degree is at most the horizon; one induction gives its coefficients in
Bernstein's basis (induction/tied.py). For the optimum, on a piece [a, b] of the domain,

    L = P of the policy that is optimal in the middle   ≤   P*   ≤   U = coefficientwise maximum over choices

and U = P* at both ends. A piece is halved until U − L ≤ tol in every coefficient. Minimum: likewise, with L and U
swapped.

**Rounding.** A row's entries are rounded once from fractions, and all terms are nonnegative. A sweep of rows with d
entries rounds at most d + 4 times along a path (entry, products, sums, the weights i/n and the two halves), a mixture
of m choices m times more: relative errors as in bounds.py, for every coefficient. A halving adds at most one a degree,
an evaluation three. Defects of a mixture's weights add as in robust.py.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from stltool.arguments import flag, function, mapping, real, whole
from stltool.automata import FALSE, TRUE
from stltool.checking.bounds import can_underflow, compounded, defect, roundings
from stltool.checking.check import undefined
from stltool.checking.induction import (
    EVERYTHING,
    Allowed,
    At,
    Bernstein,
    Budget,
    Following,
    Game,
    Layers,
    Progress,
    Silent,
    layers_of,
    solve,
)
from stltool.checking.polynomial import Floats, greatest, halves, least, value
from stltool.display import Card, Displayed, counted, probability_text
from stltool.errors import SettingsError
from stltool.models.parameters import Parameter, Values
from stltool.models.rows import least_positive
from stltool.numbers import Exactable, NumberError, exact, number_text, round_up
from stltool.policy import Policy, require_door
from stltool.product import Product

_SHOWN = 10  # rows in a notebook
_U = 2.0**-53
_DEPTH, _MOST_HALVINGS = 48, 4000  # of the search for the first point
_TINY, _SMALL = 2.0**-1060, 2.0**-900


@dataclass(frozen=True, eq=False)
class Piece:
    """[lower, upper]: a part of the parameter's domain.

    below, above  coefficients (degree + 1,) in Bernstein's basis of polynomials that enclose P there, rounding included
    policy        the one that `below` (for a minimum: `above`) belongs to
    optimal       whether it is optimal everywhere on the piece, up to rounding; None of a given policy
    """

    lower: Fraction
    upper: Fraction
    below: Floats = field(repr=False)
    above: Floats = field(repr=False)
    policy: Policy | None = field(repr=False)
    optimal: bool | None = None

    @property
    def gap(self) -> float:
        """How far apart the enclosing polynomials are at most."""
        return float((self.above - self.below).max())


class Smallest(NamedTuple):
    """The smallest value of a parameter for which P reaches a bound: none below `below` does, `enough` does.

    enough  None if that was not proved of any value
    policy  one that reaches the bound there; None of a minimum, where all policies do
    """

    below: Fraction
    enough: Fraction | None
    policy: Policy | None


@dataclass(frozen=True, eq=False, repr=False)
class ParametricResult(Displayed):
    """The probability as a function of a parameter.

    pieces    in order; of a policy there is one
    question  "maximum" | "minimum" (over all policies) | "policy"
    status    "complete": every piece is within the tolerance, or that it is not
    """

    product: Product
    question: Literal["maximum", "minimum", "policy"]
    parameter: Parameter
    pieces: tuple[Piece, ...]
    tolerance: float
    status: str
    seconds: float

    @property
    def gap(self) -> float:
        """The largest distance between the bounds."""
        return max(piece.gap for piece in self.pieces)

    def at(self, p: Exactable) -> tuple[float, float]:
        """(lower, upper) bounds on P where the parameter is p."""
        try:
            given = self.parameter.require(exact(p))
        except NumberError as error:
            raise SettingsError(f"{self.parameter.name}: {error}") from None
        piece = next(one for one in self.pieces if given <= one.upper)
        width = piece.upper - piece.lower
        x = (given - piece.lower) / width if width else Fraction(0)
        ends = [value(c, float(x), float(1 - x)) for c in (piece.below, piece.above)]
        slack = 8 * len(piece.below) * _U
        lost = len(piece.below) * _TINY if 0 <= ends[1] < _SMALL and piece.above.any() else 0.0  # by underflow
        return max(_down(ends[0], slack) - lost, 0.0), min(_up(ends[1], slack) + lost, 1.0)

    @cached_property
    def least(self) -> tuple[float, float]:
        """(lower, upper) bounds on the smallest P of the domain."""
        found = [(least(piece.below, self.tolerance), least(piece.above, self.tolerance)) for piece in self.pieces]
        depth = max(max(below[2], above[2]) for below, above in found)
        slack = self._slack(depth)
        return max(_down(min(a[0] for a, _ in found), slack), 0.0), min(_up(min(b[1] for _, b in found), slack), 1.0)

    @cached_property
    def greatest(self) -> tuple[float, float]:
        """(lower, upper) bounds on the largest P of the domain."""
        found = [
            (greatest(piece.below, self.tolerance), greatest(piece.above, self.tolerance)) for piece in self.pieces
        ]
        depth = max(max(below[2], above[2]) for below, above in found)
        slack = self._slack(depth)
        return max(_down(max(a[1] for a, _ in found), slack), 0.0), min(_up(max(b[0] for _, b in found), slack), 1.0)

    def _slack(self, depth: int) -> float:
        return 8 * (depth + 1) * max(len(piece.below) for piece in self.pieces) * _U

    def at_least(self, bound: float | Fraction) -> bool | None:
        """Whether P is at least `bound` on the whole domain; None if it cannot be told."""
        bound = real(bound, "at_least's bound")
        return True if self.least[0] >= bound else False if self.least[1] < bound else None

    def at_most(self, bound: float | Fraction) -> bool | None:
        """Whether P is at most `bound` on the whole domain; None if it cannot be told."""
        bound = real(bound, "at_most's bound")
        return True if self.greatest[1] <= bound else False if self.greatest[0] > bound else None

    def smallest(self, at_least: float | Fraction) -> Smallest | None:
        """The smallest value of the parameter for which P is at least `at_least`, enclosed; None if there is none.

        P need not be monotone. `below` and `enough` are as far apart as the bounds on P let them be: a smaller `tol`
        brings them closer.
        """
        bound = real(at_least, "smallest's at_least")
        below = next((x for one in self.pieces if (x := _first(one, one.above, bound, True)) is not None), None)
        if below is None:
            return None
        for one in self.pieces:
            enough = _first(one, one.below, bound, False) if one.upper >= below else None
            if enough is not None:
                return Smallest(below, enough, one.policy if self.question != "minimum" else None)
        return Smallest(below, None, None)

    def points(self, n: int = 11) -> list[tuple[Fraction, float, float]]:
        """(p, lower, upper) at n points of the domain, evenly spaced."""
        n = whole(n, "points' n", 2)
        width = self.parameter.upper - self.parameter.lower
        places = [self.parameter.lower + width * i / (n - 1) for i in range(n)]
        return [(p, *self.at(p)) for p in places]

    def _card(self) -> Card:
        asked = {"maximum": "the maximum", "minimum": "the minimum", "policy": "of the policy"}[self.question]
        rows = [(number_text(p), probability_text(a), probability_text(b)) for p, a, b in self.points(_SHOWN + 1)]
        name = self.parameter.name
        return Card(
            f"ParametricResult: P, {asked}, for {name} in {self.parameter.domain}, {self.status}",
            [
                {"from": f"{self.least[0]:.9g}", "to": f"{self.greatest[1]:.9g}", "within": f"{self.gap:.3g}",
                 "pieces": len(self.pieces)},
                {"task": f"{self.product.task_name} := {self.product.formula}", "model": self.product.model.name},
            ],
            ((name, "P at least", "P at most"), rows),
        )  # fmt: skip


def parametric(
    product: Product,
    policy: Policy | None = None,
    *,
    over: Mapping[str, Sequence[Exactable]] | None = None,
    maximize: bool = True,
    tol: float = 1e-6,
    most_pieces: int = 1000,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> ParametricResult:
    """P as a function of the model's parameter: under `policy`, or the optimum over all policies.

    over         a part of the domain, such as {"p": (0.9, 0.95)}; default: the domain. A grid whose file declares no
                 parameter has `success`, in [0, 1]
    tol          how far apart the bounds on the optimum may be, for every value of the parameter
    most_pieces  pieces into which the domain is divided at most; if that is not enough, `status` says so

    The optimal policy may depend on the parameter: every piece has its own. Raises SettingsError for a model without
    exactly one parameter, PolicyError if the policy does not fit or defines no action in a state that it may reach,
    SizeError before allocating more memory than is available.
    """
    start = time.perf_counter()
    require_door("parametric", product, policy)
    flag(maximize, "parametric's maximize")
    tolerance = float(real(tol, "parametric's tol", "1e-6"))
    if not tolerance > 0:
        raise SettingsError(f"parametric's tol is {tolerance}; give a positive number, such as 1e-6")
    most = whole(most_pieces, "parametric's most_pieces", 1)
    function(progress, "parametric's progress")
    mapping(over, "parametric's over", "{'p': (0.9, 0.95)}", optional=True)
    model = product.model.require_family().within(**(over or {}))
    if len(model.parameters) != 1:
        names = " and ".join(one.name for one in model.parameters)
        raise SettingsError(
            f"parametric supports one parameter, the model has {names}; fix the others with from_family"
        )
    budget = Budget(f"checking {product.n_states} product states", memory_limit, progress)
    family = Family(product, model.parameters[0], maximize, budget)
    (domain,) = model.parameters
    pieces: list[Piece] = []
    question: Literal["maximum", "minimum", "policy"] = "policy"
    if policy is not None:
        c = family.of(policy, domain.lower, domain.upper)
        pieces = [Piece(domain.lower, domain.upper, *family.enclosed(c, policy), policy)]
    else:
        question = "maximum" if maximize else "minimum"
        pieces = family.pieces(domain.lower, domain.upper, tolerance, most)
    wide = max(piece.gap for piece in pieces)
    met = policy is not None or wide <= tolerance
    status = "complete" if met else f"bounds up to {wide:.3g} apart after {counted(len(pieces), 'piece')}"
    return ParametricResult(product, question, domain, tuple(pieces), tolerance, status, time.perf_counter() - start)


class Family:
    """Inductions over a product whose model depends on one parameter: every question about it takes the same layers."""

    def __init__(self, product: Product, parameter: Parameter, maximize: bool, budget: Budget) -> None:
        family = product.model.require_family()
        self.home, self.product = product, replace(product, model=family)
        self.parameter, self.maximize, self._budget = parameter, maximize, budget
        self._keep = family.unsigned_choice_type
        self._layers: dict[int, tuple[Layers[Any, Any], Policy]] = {}

    @cached_property
    def _open(self) -> Layers[Any, Any]:
        return self._made(self.product, EVERYTHING, self.maximize)

    def _made(self, product: Product, allowed: Allowed, maximize: bool) -> Layers[Any, Any]:
        goal = TRUE if maximize else FALSE
        return layers_of(Game.of(product), goal, allowed, keep=self._keep, budget=self._budget)

    def _point(self, p: Fraction) -> Values:
        return {self.parameter.name: p}

    def optimum(self, lower: Fraction, upper: Fraction) -> Floats:
        """Coefficients on [lower, upper] of a polynomial that no policy exceeds (for a minimum: falls below)."""
        box = self._point(lower), self._point(upper)
        return self._solved(self._open, Bernstein(self.product.horizon, *box, self.maximize), self.maximize)

    def best(self, p: Fraction) -> Policy:
        """The policy that is optimal where the parameter is p."""
        found = solve(self._open, At(self._point(p), self.maximize), self.maximize, self._keep)
        assert found.choices is not None
        return Policy(self.home, found.choices)

    def of(self, policy: Policy, lower: Fraction, upper: Fraction) -> Floats:
        """Coefficients of the policy's P on [lower, upper]."""
        box = self._point(lower), self._point(upper)
        return self._solved(self._following(policy), Bernstein(self.product.horizon, *box, True), True)

    def _following(self, policy: Policy) -> Layers[Any, Any]:
        known = self._layers.get(id(policy))
        if known is None:
            judge, judged = policy.on(self.home)
            judge = replace(judge, model=self.product.model)
            try:
                layers = self._made(judge, Following(judged.form), True)
                layers.size()  # raises Silent
            except Silent:
                raise undefined(judge, judged) from None
            known = self._layers[id(policy)] = layers, policy  # which keeps its id
        return known[0]

    def forget(self, policy: Policy) -> None:
        """Drop the layers that are kept for a policy."""
        self._layers.pop(id(policy), None)

    def work(self, policy: Policy | None = None) -> float:
        """The multiply-adds for a polynomial, roughly."""
        layers = self._open if policy is None else self._following(policy)
        return layers.size()[1] * layers.game.widest * float(self.product.horizon)

    def _solved(self, layers: Layers[Any, Any], arithmetic: Bernstein, maximize: bool) -> Floats:
        h = self.product.horizon
        widest, pairs = layers.size()
        self._budget.need(32 * widest * (h + 1), 0, h)
        self._budget.require_time(pairs * layers.game.widest * float(h), h)
        found = solve(layers, arithmetic, maximize).entry
        model = self.product.model
        shares = model.initial[np.flatnonzero(model.initial)]
        c = np.array([math.fsum(column) for column in (shares[:, None] * found).T.tolist()])
        return c if len(c) == h + 1 else np.full(h + 1, c[0])  # decided at the start: constant

    def roundings(self, policy: Policy | None = None) -> int:
        """The relative error of coefficients, in units of 2⁻⁵³."""
        layers = self._open if policy is None else self._layers[id(policy)][0]
        mixed = 0 if policy is None or policy.deterministic else policy.form.mixtures().shape[1]
        return roundings(self.product.horizon, layers.kinds.longest + 3, mixed)

    def enclosed(self, c: Floats, policy: Policy | None = None) -> tuple[Floats, Floats]:
        """Coefficients rounded down and up, so that rounding is included."""
        n = self.roundings(policy)
        if n > 2**45:
            return np.zeros_like(c), np.ones_like(c)
        missing = self.product.model.initial_defect
        if policy is not None and not policy.deterministic:
            weights = defect(policy.form.mixtures().tolist())
            missing = compounded(self.product.horizon * weights + missing, self.product.horizon * weights)
        extra = (round_up(missing) if missing else 0.0) + (n * _TINY if self._underflows else 0.0)
        return np.maximum(_down(c, 4 * n * _U) - extra, 0.0), np.minimum(_up(c, 4 * n * _U) + extra, 1.0)

    @cached_property
    def _underflows(self) -> bool:
        """Whether a product of a path's factors can leave the normal doubles."""
        model, h = self.product.model, self.product.horizon
        ties = model.source.ties
        assert ties is not None
        smallest = min(float(end) for _, a, b in ties.classes for end in (a, b) if end)
        return can_underflow(h + 1, min(smallest / (h + 1), least_positive(model.initial)))

    def pieces(self, lower: Fraction, upper: Fraction, tolerance: float, most: int) -> list[Piece]:
        """Pieces on which the optimum is enclosed within the tolerance, as far as that many suffice."""
        todo, done = [(lower, upper)], list[Piece]()
        while todo:
            a, b = todo.pop()
            policy = self.best((a + b) / 2)
            theirs, own = self.enclosed(self.optimum(a, b)), self.enclosed(self.of(policy, a, b), policy)
            self.forget(policy)
            below, above = (own[0], theirs[1]) if self.maximize else (theirs[0], own[1])
            piece = Piece(a, b, below, above, policy, bool((theirs[0] <= own[1]).all() and (own[0] <= theirs[1]).all()))
            if piece.gap <= tolerance or a == b or len(done) + len(todo) + 2 > most:
                done.append(piece)
            else:
                todo += [((a + b) / 2, b), (a, (a + b) / 2)]
        return done


def _first(piece: Piece, c: Floats, bound: float | Fraction, may: bool) -> Fraction | None:
    """The first point of a piece where the polynomial may be (or, at a point of the grid, is) at least the bound.

    By halving: a part whose coefficients are all below the bound is out, rounding included.
    """
    width = piece.upper - piece.lower
    slack = 8 * (_DEPTH + 1) * len(c) * _U
    parts, number = [(Fraction(0), 0, c)], 0
    while parts:
        x, depth, part = parts.pop()
        if _up(float(part.max()), slack) < bound:
            continue
        size = Fraction(1, 2**depth)
        if may and (depth == _DEPTH or number > _MOST_HALVINGS or _down(float(part[0]), slack) >= bound):
            return piece.lower + x * width
        if not may:
            for at, found in ((x, part[0]), (x + size, part[-1])):
                if _down(float(found), slack) >= bound and (at == x or depth == _DEPTH):
                    return piece.lower + at * width
        if depth == _DEPTH or number > _MOST_HALVINGS:
            continue
        left, right = halves(part)
        number += 1
        parts += [(x + size / 2, depth + 1, right), (x, depth + 1, left)]
    return None


def _down(c: Any, slack: float) -> Any:
    return c * (1 - slack)


def _up(c: Any, slack: float) -> Any:
    return c * (1 + slack)
