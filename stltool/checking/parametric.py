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

**Exactly** (`exact=True`): the same coefficients as fractions. If L and U have the same ones on a piece, then
L ≤ P* ≤ U = L: the policy in the middle is optimal everywhere on the piece, which is thereby proved. (Where at every
reached pair the policy's choice has the greatest coefficients of all choices, U = L; so this proves no less than
comparing choices.)
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
    ExactAt,
    ExactBernstein,
    Following,
    Game,
    Layers,
    Progress,
    Silent,
    layers_of,
    solve,
)
from stltool.checking.polynomial import Floats, Polynomial, greatest, halves, least, value
from stltool.checking.rational import require_exact
from stltool.display import Card, Displayed, counted, probability_text
from stltool.errors import SettingsError
from stltool.models.parameters import Parameter, Values
from stltool.models.rows import least_positive
from stltool.numbers import Exactable, NumberError, number_text, round_down, round_up
from stltool.numbers import exact as exactly
from stltool.policy import Policy, require_door
from stltool.product import Product
from stltool.sizes import require_memory, require_time

_SHOWN = 10  # rows in a notebook
_U = 2.0**-53
_DEPTH, _MOST_HALVINGS = 48, 4000  # of the search for the first point
_TINY, _SMALL = 2.0**-1060, 2.0**-900


@dataclass(frozen=True, eq=False)
class Piece:
    """[lower, upper]: a part of the parameter's domain.

    below, above  coefficients (degree + 1,) in Bernstein's basis of polynomials that enclose P there, rounding included
    policy        the one that `below` (for a minimum: `above`) belongs to
    optimal       whether it is optimal everywhere on the piece: up to rounding, or with `exact` proved (False: it was
                  not, though it may be); None of a given policy
    exact         the policy's P, exactly, if that was asked for
    """

    lower: Fraction
    upper: Fraction
    below: Floats = field(repr=False)
    above: Floats = field(repr=False)
    policy: Policy | None = field(repr=False)
    optimal: bool | None = None
    exact: Polynomial | None = field(default=None, repr=False)

    @property
    def gap(self) -> float:
        """How far apart the enclosing polynomials are at most."""
        return float((self.above - self.below).max())

    @property
    def proved(self) -> bool:
        """Whether `policy` is proved, in fractions, to be optimal everywhere on the piece."""
        return self.exact is not None and self.optimal is True

    @property
    def known(self) -> Polynomial | None:
        """P on the piece, exactly, if that is known: the given policy's, or that of one proved optimal."""
        return None if self.optimal is False else self.exact


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
    def exact(self) -> bool:
        """Whether it was computed in fractions."""
        return self.pieces[0].exact is not None

    @property
    def gap(self) -> float:
        """The largest distance between the bounds."""
        return max(piece.gap for piece in self.pieces)

    def at(self, p: Exactable) -> tuple[float, float]:
        """(lower, upper) bounds on P where the parameter is p."""
        given = self._given(p)
        piece = next(one for one in self.pieces if given <= one.upper)
        if piece.known is not None:
            value_there = piece.known.at(given)
            return round_down(value_there), round_up(value_there)
        width = piece.upper - piece.lower
        x = (given - piece.lower) / width if width else Fraction(0)
        ends = [value(c, float(x), float(1 - x)) for c in (piece.below, piece.above)]
        slack = 8 * len(piece.below) * _U
        lost = len(piece.below) * _TINY if 0 <= ends[1] < _SMALL and piece.above.any() else 0.0  # by underflow
        return max(_down(ends[0], slack) - lost, 0.0), min(_up(ends[1], slack) + lost, 1.0)

    def exactly_at(self, p: Exactable) -> Fraction | None:
        """P where the parameter is p, exactly; None if on no piece with p a policy was proved optimal. Needs
        `parametric(..., exact=True)`."""
        if not self.exact:
            raise SettingsError("this result was computed in doubles; for fractions call parametric with exact=True")
        given = self._given(p)
        known = (one.known for one in self.pieces if one.lower <= given <= one.upper)
        found = next((one for one in known if one is not None), None)
        return None if found is None else found.at(given)

    def _given(self, p: Exactable) -> Fraction:
        try:
            return self.parameter.require(exactly(p))
        except NumberError as error:
            raise SettingsError(f"{self.parameter.name}: {error}") from None

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
        bound = Fraction(real(bound, "at_least's bound"))
        told = self._told(bound, 1)
        if told is None:
            told = True if self.least[0] >= bound else False if self.least[1] < bound else None
        return told

    def at_most(self, bound: float | Fraction) -> bool | None:
        """Whether P is at most `bound` on the whole domain; None if it cannot be told."""
        bound = Fraction(real(bound, "at_most's bound"))
        told = self._told(bound, -1)
        if told is None:
            told = True if self.greatest[1] <= bound else False if self.greatest[0] > bound else None
        return told

    def _told(self, bound: Fraction, sign: int) -> bool | None:
        """Whether sign · P ≥ sign · bound everywhere, if fractions tell: by coefficients, or by a piece's end."""
        known = [one.known for one in self.pieces]
        ends = [sign * (c - bound) for one in known if one is not None for c in one.ends]
        if any(end < 0 for end in ends):
            return False
        if all(one is not None and all(sign * (c - bound) >= 0 for c in one.coefficients) for one in known):
            return True
        return None

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
    exact: bool = False,
    tol: float = 1e-6,
    most_pieces: int = 1000,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> ParametricResult:
    """P as a function of the model's parameter: under `policy`, or the optimum over all policies.

    over         a part of the domain, such as {"p": (0.9, 0.95)}; default: the domain. A grid whose file declares no
                 parameter has `success`, in [0, 1]
    exact        compute in fractions, for models given in fractions or decimals: `Piece.exact` is the policy's P as a
                 polynomial, and `Piece.optimal` is proved
    tol          how far apart the bounds on the optimum may be, for every value of the parameter
    most_pieces  pieces into which the domain is divided at most; if that is not enough, `status` says so

    The optimal policy may depend on the parameter: every piece has its own. Raises SettingsError for a model without
    exactly one parameter, PolicyError if the policy does not fit or defines no action in a state that it may reach,
    SizeError before allocating more memory than is available; with `exact`, ModelError if rows do not sum to 1.
    """
    start = time.perf_counter()
    require_door("parametric", product, policy)
    flag(maximize, "parametric's maximize")
    flag(exact, "parametric's exact")
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
    if exact:
        family.require_exact()
    if policy is not None and exact:
        own = family.exactly(domain.lower, domain.upper, policy)
        pieces = [Piece(domain.lower, domain.upper, *_rounded(own, own), policy, exact=own)]
    elif policy is not None:
        c = family.of(policy, domain.lower, domain.upper)
        pieces = [Piece(domain.lower, domain.upper, *family.enclosed(c, policy), policy)]
    else:
        question = "maximum" if maximize else "minimum"
        pieces = family.pieces(domain.lower, domain.upper, tolerance, most, exact)
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

    def require_exact(self) -> None:
        """ModelError if rows, or the start, do not sum to 1 exactly everywhere in the domain."""
        for end in (self.parameter.lower, self.parameter.upper):
            member = self.home.model.require_family().at(**self._point(end))
            assert member.kinds is not None
            require_exact(member, member.kinds)

    def exactly(self, lower: Fraction, upper: Fraction, policy: Policy | None = None) -> Polynomial:
        """The policy's P on [lower, upper], or what `optimum` bounds it by, without any rounding."""
        layers = self._open if policy is None else self._following(policy)
        arithmetic = ExactBernstein(self._point(lower), self._point(upper), policy is not None or self.maximize)
        layers.size()  # makes the rows
        arithmetic.begin(layers.rows)
        self._require_room(layers, arithmetic.denominator)
        found = solve(layers, arithmetic, policy is not None or self.maximize).entry
        model, n = self.product.model, arithmetic.degree
        shares = [model.initial_share(s) for s in layers.game.first.tolist()]
        totals = (sum((a * int(b) for a, b in zip(shares, column, strict=True)), Fraction(0)) for column in found.T)
        c = tuple(total / (math.comb(n, i) * arithmetic.one) for i, total in enumerate(totals))
        return Polynomial(lower, upper, c)

    def _require_room(self, layers: Layers[Any, Any], denominator: int) -> None:
        h = self.product.horizon
        widest, pairs = layers.size()
        words = h * math.log2(max(denominator, 2)) / 64 + 4
        what = f"exact polynomials of degree {h} on {pairs} pairs"
        remedy = "shorten the windows, round the probabilities to fewer digits, or compute in doubles, without exact"
        numbers = (h + 1.0) * widest * (2 + layers.game.widest)
        require_memory(8 * (words + 4) * numbers, what, remedy, self._budget.limit)
        require_time(pairs * layers.game.widest * h * (1 + words / 2), 1e7, what, remedy)

    def exactly_best(self, p: Fraction) -> Policy:
        """The policy that is optimal where the parameter is p, choices compared without any rounding."""
        found = solve(self._open, ExactAt(self._point(p), self.maximize), self.maximize, self._keep)
        assert found.choices is not None
        return Policy(self.home, found.choices)

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

    def pieces(self, lower: Fraction, upper: Fraction, tolerance: float, most: int, exact: bool = False) -> list[Piece]:
        """Pieces on which the optimum is enclosed within the tolerance, as far as that many suffice."""
        todo, done = [(lower, upper)], list[Piece]()
        while todo:
            a, b = todo.pop()
            piece = self._proved(a, b) if exact else self._enclosed(a, b)
            if piece.gap <= tolerance or piece.proved or a == b or len(done) + len(todo) + 2 > most:
                done.append(piece)
            else:
                todo += [((a + b) / 2, b), (a, (a + b) / 2)]
        return done

    def _enclosed(self, a: Fraction, b: Fraction) -> Piece:
        policy = self.best((a + b) / 2)
        theirs, own = self.enclosed(self.optimum(a, b)), self.enclosed(self.of(policy, a, b), policy)
        self.forget(policy)
        below, above = (own[0], theirs[1]) if self.maximize else (theirs[0], own[1])
        optimal = bool((theirs[0] <= own[1]).all() and (own[0] <= theirs[1]).all())
        return Piece(a, b, below, above, policy, optimal)

    def _proved(self, a: Fraction, b: Fraction) -> Piece:
        policy = self.exactly_best((a + b) / 2)
        theirs, own = self.exactly(a, b), self.exactly(a, b, policy)
        self.forget(policy)
        ends = _rounded(own, theirs) if self.maximize else _rounded(theirs, own)
        return Piece(a, b, *ends, policy, _same(own, theirs), own)


def _rounded(below: Polynomial, above: Polynomial) -> tuple[Floats, Floats]:
    """The coefficients of both, rounded outwards, of the same degree."""
    degree = max(len(below.coefficients), len(above.coefficients)) - 1
    low = [round_down(c) for c in below.raised(degree).coefficients]
    return np.array(low), np.array([round_up(c) for c in above.raised(degree).coefficients])


def _same(one: Polynomial, other: Polynomial) -> bool:
    degree = max(len(one.coefficients), len(other.coefficients)) - 1
    return one.raised(degree) == other.raised(degree)


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
