"""`shield`: masks of actions under which every policy keeps P(Φ) ≥ c, whatever it remembers, tosses or intends.

With V_t, Q_t(·, a) the layers of the maximum, r = Q_t(s,q,a) / V_t(s,q) ≤ 1 is what action a leaves of the maximum.

    static    a is allowed iff r ≥ x; the least x ≥ 0 whose mask keeps c is found by bisection
    ratio     a run has K units to spend; a costs ⌈ln r / ln λ · K⌉ of them, λ = c / P*, and is allowed iff they are
              left. A run that has spent k units in (t, s, q) is promised λ^(1 − k/K) V_t(s,q)

Neither is trusted: with k units spent (static: k = 0 always), the least P of all policies that obey the mask is

    W_t(s,q,k) = min over a with k + cost(a) ≤ K of Σ_s' P(s'|a) W_{t+1}(s', δ(L(s'),q), k + cost(a))

a backward induction whose rounding is enclosed as in check.py; its lower bound must reach c. Where the model's graph
alone makes the task sure, W is 1 without any rounding. The best action costs nothing, so something is always allowed.
"""

from __future__ import annotations

import io
import itertools
import json
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import function, one_of, real, require, whole
from stltool.arguments import path as path_of
from stltool.arrays import open_arrays
from stltool.automata import TRUE, UNDECIDED
from stltool.checking.bounds import roundings
from stltool.checking.check import double_bounds
from stltool.checking.fixed import fixed_point
from stltool.checking.induction import EVERYTHING, OPEN, Budget, Edges, Engine, Game, Progress, layers_of
from stltool.checking.induction.arithmetic import row_sums
from stltool.checking.weighted import Figure
from stltool.display import Card, Displayed, probability_text
from stltool.errors import FileError, InfeasibleError, PolicyError, SettingsError
from stltool.files import require_result, write_atomically
from stltool.numbers import bound_texts, number_text
from stltool.policy import Binding
from stltool.product import Product

Rule: TypeAlias = Literal["static", "ratio"]
Costs: TypeAlias = NDArray[np.unsignedinteger]
Floats: TypeAlias = NDArray[np.float64]

FORMAT = "stltool-shield-1"
_BISECTIONS = 30
_MARGINS = (0.0, 1e-12, 1e-9, 1e-6, 1.0)  # of the exponent of λ, where rounding has cost the promise; 1: only the best
_MOST_LEVELS = 10_000
_LONGEST_HEADER = 1 << 24


class MaskLayer(NamedTuple):
    """Steps first … last of a mask, which are the same: its n pairs and their m choices.

    codes  (n,) int64 s·|Q| + q, ascending: the undecided pairs that runs can be in
    start  (n+1,) int64: pair i has the choices start[i] … start[i+1]−1, in the model's order
    cost   (m,) unsigned: the units that each spends; more than K: never allowed
    best   (n,) int64: the best choice within its state
    """

    first: int
    last: int
    codes: NDArray[np.int64]
    start: NDArray[np.int64]
    cost: Costs
    best: NDArray[np.int64]

    def same(self, other: MaskLayer) -> bool:
        return all(np.array_equal(mine, theirs) for mine, theirs in zip(self[2:], other[2:], strict=True))


@dataclass(frozen=True, eq=False, repr=False)
class Shield(Displayed):
    """Which actions are allowed, and the least P of all policies that take no others.

    at_least   the promise: P(Φ) ≥ at_least from the start
    rule       "static" | "ratio"
    levels     K, the units that a run may spend; 0 for a static mask
    least      the least P over all obedient policies, history-dependent and randomised ones included: enclosed
    uniform    P of the policy that draws evenly from what is allowed
    share      of the available actions, how many are allowed in its undecided steps on average
    layers     the mask, from step 0 on
    """

    product: Product
    at_least: float | Fraction
    rule: Rule
    levels: int
    least: Figure
    uniform: float
    share: float
    layers: tuple[MaskLayer, ...]

    def _card(self) -> Card:
        product = self.product
        lower, upper = bound_texts(self.least.lower, self.least.upper)
        return Card(
            f"Shield: P({product.task_name}) >= {_text(self.at_least)} under every policy, "
            f"{self.share:.1%} of actions allowed",
            [
                {"task": f"{product.task_name} := {product.formula}"},
                {"least P": f"[{lower}, {upper}]", "P of the even choice": probability_text(self.uniform)},
                {"rule": self.rule, "levels": self.levels or None, "model": product.model.name},
            ],
        )

    def allows(self, t: int, s: int, q: int, spent: int = 0) -> NDArray[np.bool_]:
        """(C,): which of the available actions, in the model's order, are allowed in (s, q) after step t.

        spent   the units that the run has spent so far (`spend`); 0 for a static mask

        Never all False: every action once the task is decided, and at least the best one before. Raises PolicyError
        where no run of the model can be, as nothing is promised there.
        """
        t, s, q = self._place(t, s, q)
        spent = whole(spent, "the shield's spent", 0, self.levels)
        if self._decided(t, q):
            start = self.product.model.choice_start
            return np.ones(int(start[s + 1] - start[s]), dtype=np.bool_)
        layer, i = self._find(t, s, q)
        allowed: NDArray[np.bool_] = layer.cost[layer.start[i] : layer.start[i + 1]] <= self.levels - spent
        return allowed

    def spend(self, t: int, s: int, q: int, choice: int, spent: int = 0) -> int:
        """The units spent after this choice, an index within its state; PolicyError if it is not allowed."""
        allowed = self.allows(t, s, q, spent)
        choice = whole(choice, "the shield's choice", 0, len(allowed) - 1)
        if not allowed[choice]:
            raise PolicyError(
                f"{self._action(s, choice)} is refused at {self.product.describe(s * self.product.shape[1] + q, t)}; "
                f"allowed: {', '.join(self._action(s, c) for c in np.flatnonzero(allowed).tolist())}"
            )
        if self._decided(t, q):
            return spent
        layer, i = self._find(t, s, q)
        return spent + int(layer.cost[layer.start[i] + choice])

    def best(self, t: int, s: int, q: int) -> int:
        """The best choice, an index within its state: always allowed, and free. Once the task is decided, the first."""
        t, s, q = self._place(t, s, q)
        if self._decided(t, q):
            return 0
        layer, i = self._find(t, s, q)
        return int(layer.best[i])

    def allowance(self, spent: int) -> float:
        """What is left to spend, from 1 to 0; always 0 for a static mask."""
        spent = whole(spent, "the shield's spent", 0, self.levels)
        return 1 - spent / self.levels if self.levels else 0.0

    def _place(self, t: int, s: int, q: int) -> tuple[int, int, int]:
        S, Q = self.product.shape
        return (
            whole(t, "the shield's step t", 0, self.product.horizon),
            whole(s, "the shield's model state s", 0, S - 1),
            whole(q, "the shield's automaton state q", 0, Q - 1),
        )

    def _decided(self, t: int, q: int) -> bool:
        return bool(self.product.automaton.verdicts(t)[q] != UNDECIDED)

    def _find(self, t: int, s: int, q: int) -> tuple[MaskLayer, int]:
        code = s * self.product.shape[1] + q
        k = bisect_right(self.layers, t, key=lambda layer: layer.first) - 1
        if k >= 0 and t <= self.layers[k].last:
            layer = self.layers[k]
            i = int(np.searchsorted(layer.codes, code))
            if i < len(layer.codes) and layer.codes[i] == code:
                return layer, i
        raise PolicyError(
            f"no run of the model can be at {self.product.describe(code, t)}, so that the shield promises nothing "
            "there; make the shield with a model that has what happened"
        )

    def _action(self, s: int, choice: int) -> str:
        model = self.product.model
        name: str = model.action_names[model.choice_action[model.choice_start[s] + choice]]
        return name

    def require_for(self, product: Product) -> None:
        """PolicyError unless the shield is for this product's task, model and encoding."""
        require(product, Product, "the shield's product")
        if product is not self.product:
            _require_for(Binding.of(self.product), product, "the shield")

    def save(self, path: str | Path) -> None:
        """Write the shield atomically as .npz: a header, and the arrays of `layers` one after another."""
        path = require_shield_file(path_of(path, "save's path"))
        header = {
            "format": FORMAT, **asdict(Binding.of(self.product)), "at_least": str(self.at_least), "rule": self.rule,
            "levels": self.levels, "least": [self.least.lower, self.least.upper],
        }  # fmt: skip
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            header=np.frombuffer(json.dumps(header).encode("utf-8"), dtype=np.uint8),
            steps=np.array([layer[:2] for layer in self.layers], dtype=np.int64).reshape(-1, 2),
            pairs=np.array([len(layer.codes) for layer in self.layers], dtype=np.int64),
            codes=_joined([layer.codes for layer in self.layers], np.int64),
            choices=_joined([np.diff(layer.start) for layer in self.layers], np.int64),
            cost=_joined([layer.cost for layer in self.layers], _cost_type(self.levels)),
            best=_joined([layer.best for layer in self.layers], np.int64),
        )
        write_atomically(path, buffer.getvalue())

    @classmethod
    def load(cls, path: str | Path, product: Product) -> Shield:
        """Read a shield for this product, and check what it promises again by induction.

        PolicyError names both sides if it belongs to another task, model or encoding, or if its mask does not keep its
        promise.
        """
        path = path_of(path, "Shield.load's path")
        require(product, Product, "Shield.load's product")
        try:
            with open_arrays(path, "shield file") as archive:
                header = json.loads(archive.read("header", np.uint8, (None,), _LONGEST_HEADER).tobytes())
                if header.pop("format") != FORMAT:
                    raise ValueError
                at_least, rule = _bound(header.pop("at_least")), one_of(header.pop("rule"), "rule", get_args(Rule))
                levels = whole(header.pop("levels"), "levels", 0, _MOST_LEVELS)
                header.pop("least")
                header["action_names"], header["tasks"] = tuple(header["action_names"]), tuple(header["tasks"])
                binding = Binding(**header)
        except FileError:
            raise
        except Exception:  # a damaged archive fails in many ways, all caused by the file
            raise _not_a_shield(path) from None
        _require_for(binding, product, f"{path}: the shield")
        unfolded = _Unfolded(product)
        try:
            costs = _read_costs(path, unfolded, levels)
        except FileError:
            raise
        except Exception:
            raise _not_a_shield(path) from None
        least, lower = unfolded.least(costs, levels)
        if lower < at_least:
            raise PolicyError(f"{path}: this mask does not keep P >= {_text(at_least)}; make the shield again")
        found = unfolded.shield(at_least, "ratio" if rule == "ratio" else "static", levels, costs)
        return replace(found, least=least)


def shield(
    product: Product,
    at_least: float | Fraction,
    rule: Rule = "static",
    *,
    levels: int = 64,
    engine: Engine = "auto",
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> Shield:
    """The mask of actions under which every policy keeps P(Φ) ≥ `at_least`.

    rule     "static": a function of step, state and what the task remembers. "ratio": also of what the run has spent so
             far of its allowance
    levels   K ≤ 10000, how finely the allowance is counted; for "ratio"

    No larger mask is claimed to be impossible: there is no largest one in general. Raises InfeasibleError, with P*, if
    no policy has as much; SizeError before allocating more memory than is available.
    """
    require(product, Product, "shield's product")
    one_of(rule, "rule", get_args(Rule))
    one_of(engine, "engine", get_args(Engine))
    function(progress, "shield's progress")
    levels = whole(levels, "levels", 1, _MOST_LEVELS)
    at_least = real(at_least, "shield's at_least", "0.95")
    if not 0 <= at_least <= 1:
        raise SettingsError(f"at_least is {_text(at_least)}; give a probability between 0 and 1")
    levels = levels if rule == "ratio" else 0
    unfolded = _Unfolded(product, engine, memory_limit, progress)
    only_best = unfolded.above(1.0)
    greatest, lower = unfolded.least(only_best, 0)
    if lower < at_least:
        raise InfeasibleError(
            f"P({product.task_name}) >= {_text(at_least)} cannot be promised: its maximum P* is "
            f"{_between(greatest)}; ask for less"
        )
    costs = unfolded.static(at_least) if rule == "static" else unfolded.ratio(at_least, greatest.value, levels)
    return unfolded.shield(at_least, rule, levels, costs)


def require_shield_file(path: str | Path) -> Path:
    """The path where a shield may be written; an error, before the work, if it could not be."""
    path = Path(path)
    require_result(path, "shield", _is_shield)
    if path.suffix.lower() != ".npz":
        raise PolicyError(f"{path}: shields are saved as .npz; use this extension")
    return path


def _is_shield(path: Path) -> bool:
    try:
        with open_arrays(path, "shield file") as archive:
            found = json.loads(archive.read("header", np.uint8, (None,), _LONGEST_HEADER).tobytes())["format"]
        return bool(found.rpartition("-")[0] == FORMAT.rpartition("-")[0])
    except Exception:  # other files, and damaged ones, fail in many ways
        return False


def _require_for(binding: Binding, product: Product, what: str) -> None:
    binding.require(product, what)
    if binding.automaton_digest != product.automaton.digest():
        raise PolicyError(
            f"{what} remembers runs by the encoding {binding.encoding}, and the product by "
            f"{product.automaton.encoding}; build the product with the shield's encoding, or make the shield again"
        )


def _not_a_shield(path: Path) -> PolicyError:
    return PolicyError(f"{path}: not a shield of this version ({FORMAT}), or a damaged one; write one with Shield.save")


def _text(bound: float | Fraction) -> str:
    return number_text(bound) if isinstance(bound, Fraction) else repr(bound)


def _bound(text: str) -> float | Fraction:
    """A promise as a file has it: the same number, whether a fraction or a double."""
    bound = Fraction(text) if "/" in text else float(text)
    if not 0 <= bound <= 1:
        raise ValueError
    return bound


def _between(figure: Figure) -> str:
    lower, upper = bound_texts(figure.lower, figure.upper)
    return lower if lower == upper else f"between {lower} and {upper}"


def _joined(arrays: Sequence[NDArray[Any]], dtype: Any) -> NDArray[Any]:
    return np.concatenate([np.empty(0, dtype=dtype), *arrays]).astype(dtype)


def _cost_type(levels: int) -> np.dtype[np.unsignedinteger]:
    """The smallest type that holds a cost, or K + 1 for an action that is never allowed."""
    return np.dtype(np.min_scalar_type(levels + 1))


def _read_costs(path: Path, unfolded: _Unfolded, levels: int) -> list[Costs]:
    """The costs of every step in a file, for the pairs and choices that the product has; ValueError for others."""
    h, own = len(unfolded.steps), unfolded.sizes()
    with open_arrays(path, "shield file") as archive:
        steps = archive.read("steps", np.int64, (None, 2), 2 * h)
        pairs = archive.read("pairs", np.int64, (len(steps),))
        codes = archive.read("codes", np.int64, (None,), own[0])
        choices = archive.read("choices", np.int64, (len(codes),))
        cost = archive.read("cost", _cost_type(levels), (None,), own[1])
        archive.read("best", np.int64, (len(codes),))  # the product's is the same
    found: list[Costs] = [np.empty(0, dtype=cost.dtype)] * h
    expected, at, begin = 0, 0, 0
    for (first, last), n in zip(steps.tolist(), pairs.tolist(), strict=True):
        if first != expected or not first <= last < h or n < 0:
            raise ValueError
        counts = choices[at : at + n]
        size = int(counts.sum())
        for t in range(first, last + 1):
            step = unfolded.steps[t]
            if not np.array_equal(codes[at : at + n], step.codes) or not np.array_equal(counts, np.diff(step.start)):
                raise ValueError
            found[t] = cost[begin : begin + size]
        expected, at, begin = last + 1, at + n, begin + size
    if expected != h or begin != len(cost) or at != len(codes):
        raise ValueError
    if any(not _free(costs, step).all() for costs, step in zip(found, unfolded.steps, strict=True)):
        raise ValueError
    return found


def _free(cost: Costs, step: _Step) -> NDArray[np.bool_]:
    """(n,): whether the best choice of every pair costs nothing."""
    free: NDArray[np.bool_] = cost[step.start[:-1] + step.best] == 0
    return free


@dataclass(frozen=True, eq=False)
class _Step:
    """One step: its edges in parts, its pairs and choices, what each choice leaves of the maximum, the best one."""

    edges: list[Edges]
    codes: NDArray[np.int64]
    start: NDArray[np.int64]
    left: Floats
    best: NDArray[np.int64]


class _Unfolded:
    """All undecided pairs that any policy reaches, with V and Q; `steps` from step 0 on."""

    def __init__(
        self,
        product: Product,
        engine: Engine = "auto",
        limit: int | None = None,
        progress: Progress | None = None,
    ) -> None:
        model = product.model
        model.require_points()
        game = Game.of(product)
        budget = Budget(f"a shield over {product.n_states} product states", limit, progress)
        layers = layers_of(game, TRUE, EVERYTHING, engine=engine, live=False, sure=False, budget=budget)
        found: list[list[Edges]] = []
        here: Any = layers.nothing()
        made: tuple[Any, Any] = (None, None)
        kept: list[Edges] = []
        for first, last, layer in layers.backwards():
            for t in range(last, first - 1, -1):
                ahead, here = here, layer
                if made[0] is not here or made[1] is not ahead:
                    made = (here, ahead)
                    kept = [layers.edges(here, ahead, t, lo, hi) for lo, hi in layers.parts(here)]
                    kept = [edges for edges in kept if len(edges)]
                    budget.take(sum(edges.nbytes for edges in kept), t, game.horizon)
                budget.take(24 * sum(len(edges.choice) for edges in kept), t, game.horizon)
                found.append(kept)
                budget.tell(t, game.horizon, back=True)
        self.product, self._kinds = product, layers.kinds
        self._first = layers.first_slots(here)
        self._start = game.first
        scale = fixed_point(model, self._kinds)
        h = product.horizon
        if scale is not None and scale.roundings(h) / scale.one >= roundings(h, self._kinds.longest) * 2.0**-52:
            scale = None  # doubles are narrower
        self._scale = scale
        self._weight: NDArray[Any] = layers.rows.probability if scale is None else layers.rows.numerator
        self._probability = layers.rows.probability
        self._Q = product.shape[1]
        self.steps, self._sure = self._best(found)

    def sizes(self) -> tuple[int, int]:
        """The number of pairs, and of choices, all steps together."""
        return sum(len(step.codes) for step in self.steps), sum(len(step.left) for step in self.steps)

    # ------------------------------------------------------------------------------------------------- rules

    def above(self, x: float) -> list[Costs]:
        """The static mask of actions that leave at least the share x of the maximum."""
        return [(step.left < x).astype(_cost_type(0)) for step in self.steps]

    def static(self, at_least: float | Fraction) -> list[Costs]:
        """The largest of these masks, up to the bisection, that keeps the promise; x = 1 is known to."""
        low, high = 0.0, 1.0
        if self.least(self.above(low), 0)[1] >= at_least:
            return self.above(low)
        for _ in range(_BISECTIONS):
            x = (low + high) / 2
            low, high = (low, x) if self.least(self.above(x), 0)[1] >= at_least else (x, high)
        return self.above(high)

    def ratio(self, at_least: float | Fraction, greatest: float, levels: int) -> list[Costs]:
        """Costs of the rule; promises start a little higher where rounding has cost the promise."""
        dtype = _cost_type(levels)
        if at_least == 0:
            return [np.zeros(len(step.left), dtype=dtype) for step in self.steps]
        depth = -math.log(min(1.0, float(at_least) / greatest))
        costs: list[Costs] = []
        for margin in _MARGINS:
            unit = depth * (1 - margin) / levels
            costs = [_units(step.left, unit, levels).astype(dtype) for step in self.steps]
            if self.least(costs, levels)[1] >= at_least:
                break
        return costs

    def shield(self, at_least: float | Fraction, rule: Rule, levels: int, costs: list[Costs]) -> Shield:
        least, lower = self.least(costs, levels)
        assert lower >= at_least
        chances, length = self._even(costs, levels, "share"), self._even(costs, levels, "length")
        layers: list[MaskLayer] = []
        for t, (step, cost) in enumerate(zip(self.steps, costs, strict=True)):
            layer = MaskLayer(t, t, step.codes, step.start, cost, step.best)
            if layers and layers[-1].same(layer):
                layers[-1] = layers[-1]._replace(last=t)
            else:
                layers.append(layer)
        return Shield(
            product=self.product,
            at_least=at_least,
            rule=rule,
            levels=levels,
            least=least,
            uniform=min(1.0, self._even(costs, levels, "P")),
            share=chances / length if length > 0 else 1.0,
            layers=tuple(layers),
        )

    # -------------------------------------------------------------------------------------------- inductions

    def _best(self, found: list[list[Edges]]) -> tuple[list[_Step], bool]:
        """V and Q backwards, kept as what each choice leaves, from step 0 on; and whether some policy is sure to
        satisfy the task."""
        steps, values, sure = [], self._ends(0), _SURE
        none = np.empty(0, dtype=np.int64)
        for parts in found:
            left, best, new, surely = [], [none], [], []
            for edges in parts:
                first, count = edges.choices[:-1], np.diff(edges.choices)
                sums = self._sums(edges, values, self._weight)
                each = np.repeat(np.maximum.reduceat(sums, first), count)
                with np.errstate(invalid="ignore", divide="ignore"):
                    share = np.where(each > 0, sums / each, 1.0)
                safe = np.logical_and.reduceat(sure[edges.child], edges.start[:-1])
                somewhere = np.logical_or.reduceat(safe, first)
                worse = np.where(np.repeat(somewhere, count), ~safe, sums < each)
                share = np.where(worse, np.minimum(share, _BELOW_ONE), 1.0)  # rounding may hide what is lost
                attained = np.flatnonzero(share == 1)
                best.append(attained[np.searchsorted(attained, first)] - first)
                left.append(share)
                new.append(self._settled(np.maximum.reduceat(sums, first)))
                surely.append(somewhere)
            codes = np.concatenate([none, *(edges.s * self._Q + edges.q for edges in parts)])
            counts = np.concatenate([none, *(np.diff(edges.choices) for edges in parts)])
            start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
            steps.append(_Step(parts, codes, start, np.concatenate([np.empty(0), *left]), np.concatenate(best)))
            values, sure = np.concatenate([self._ends(0), *new]), np.concatenate([_SURE, *surely])
        return steps[::-1], bool(sure[self._first].all())

    def least(self, costs: Sequence[Costs], levels: int) -> tuple[Figure, Fraction]:
        """The least P over all policies that obey these costs: enclosed, and its lower bound as it is."""
        values = self._ends(levels)
        most = np.iinfo(np.int64).max if self._scale is not None else np.inf
        for step, cost in zip(reversed(self.steps), reversed(costs), strict=True):
            new = []
            for edges, units in _by_part(step, cost):
                sums, allowed = _spent(self._sums(edges, values, self._weight), units, levels)
                worst = np.minimum.reduceat(np.where(allowed, sums, most), edges.choices[:-1], axis=0)
                new.append(self._settled(worst))
            values = np.concatenate([self._ends(levels), *new])
        if self._sure and self._surely(costs, levels):
            return Figure(1.0, 1.0, 1.0), Fraction(1)
        return self._enclosed(values[self._first] if not levels else values[self._first, 0])

    def _surely(self, costs: Sequence[Costs], levels: int) -> bool:
        """Whether the graph alone makes every policy that obeys satisfy the task."""
        ends = _SURE if not levels else np.repeat(_SURE[:, None], levels + 1, axis=1)
        sure = ends
        for step, cost in zip(reversed(self.steps), reversed(costs), strict=True):
            new = []
            for edges, units in _by_part(step, cost):
                safe = np.logical_and.reduceat(sure[edges.child], edges.start[:-1], axis=0)
                after, allowed = _spent(safe, units, levels)
                new.append(np.logical_and.reduceat(after | ~allowed, edges.choices[:-1], axis=0))
            sure = np.concatenate([ends, *new])
        return bool((sure[self._first] if not levels else sure[self._first, 0]).all())

    def _even(self, costs: Sequence[Costs], levels: int, what: Literal["P", "share", "length"]) -> float:
        """Under the even choice of what is allowed: P, the expected sum of the shares allowed, or of steps."""
        shape = (OPEN,) if not levels else (OPEN, levels + 1)
        ends = np.zeros(shape)
        ends[1] = what == "P"
        values = ends
        for step, cost in zip(reversed(self.steps), reversed(costs), strict=True):
            new = []
            for edges, units in _by_part(step, cost):
                sums, allowed = _spent(self._sums(edges, values, self._probability), units, levels)
                first = edges.choices[:-1]
                n = np.add.reduceat(allowed.astype(np.float64), first, axis=0)
                mean = np.add.reduceat(np.where(allowed, sums, 0.0), first, axis=0) / n
                count = np.diff(edges.choices) if not levels else np.diff(edges.choices)[:, None]
                new.append(mean + (n / count if what == "share" else float(what == "length")))
            values = np.concatenate([ends, *new])
        entry = values[self._first] if not levels else values[self._first, 0]
        return float(math.fsum(self.product.model.initial[self._start] * entry))

    def _ends(self, levels: int) -> NDArray[Any]:
        """The values of decided pairs: 0 and 1 in the arithmetic's unit."""
        ends: NDArray[Any] = np.array([0, self._scale.one]) if self._scale is not None else np.array([0.0, 1.0])
        return ends if not levels else np.repeat(ends[:, None], levels + 1, axis=1)

    @staticmethod
    def _sums(edges: Edges, values: NDArray[Any], weight: NDArray[Any]) -> NDArray[Any]:
        if values.ndim == 1:
            return row_sums(weight[edges.entry] * values[edges.child], edges.start)
        terms = weight[edges.entry][:, None] * values[edges.child]
        sums: NDArray[Any] = np.add.reduceat(terms, edges.start[:-1], axis=0)
        return sums

    def _settled(self, sums: NDArray[Any]) -> NDArray[Any]:
        """Sums in the layer's own unit, rounded up as in fixed.py."""
        return sums if self._scale is None else -((-sums) // self._scale.denominator)

    def _enclosed(self, entry: NDArray[Any]) -> tuple[Figure, Fraction]:
        model, h = self.product.model, self.product.horizon
        if self._scale is None:
            value = math.fsum(model.initial[self._start] * entry)
            lower, upper = double_bounds(self.product, self._kinds, value)
            return Figure(min(max(value, 0.0), 1.0), lower, upper), Fraction(lower)
        one = Fraction(self._scale.one)
        shares = zip(self._start.tolist(), entry.tolist(), strict=True)
        above = sum((model.initial_share(s) * int(u) for s, u in shares), Fraction(0)) / one
        below = max(above - self._scale.roundings(h) / one, Fraction(0))
        return Figure(*self._scale.enclose(model, h, entry)), below


_SURE = np.array([False, True])  # of decided pairs, whether the task is satisfied
_BELOW_ONE = np.nextafter(1.0, 0.0)


def _spent(sums: NDArray[Any], units: Costs, levels: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """The value of every choice by units spent before it, (m,) or (m, K+1), and whether it is allowed."""
    if not levels:
        return sums, units == 0
    spent = np.arange(levels + 1) + units.astype(np.int64)[:, None]
    return np.take_along_axis(sums, np.minimum(spent, levels), axis=1), spent <= levels


def _by_part(step: _Step, cost: Costs) -> list[tuple[Edges, Costs]]:
    """The edges of a step with their choices' costs."""
    ends = list(itertools.accumulate((len(edges.choice) for edges in step.edges), initial=0))
    return [(edges, cost[a:b]) for edges, (a, b) in zip(step.edges, itertools.pairwise(ends), strict=True)]


def _units(left: Floats, unit: float, levels: int) -> NDArray[np.int64]:
    """What a choice costs that leaves this share of the maximum; K + 1 if it is more than K."""
    with np.errstate(divide="ignore", invalid="ignore"):
        units = np.where(left >= 1, 0.0, np.ceil(-np.log(left) / unit) if unit > 0 else np.inf)
    return np.minimum(units, levels + 1).astype(np.int64)
