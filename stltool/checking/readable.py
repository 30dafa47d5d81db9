"""`policy_tree`: a policy as a small decision tree that people can read, with the exact probability of the tree itself.

The tree asks for what a user knows of a run: signals, labels, the steps left, what is remembered of each part of the
task, and how two of these memories differ. It is grown in rounds. With V and Q the values of the policy, w(n) how
probable it is that the policy, or a tree of an earlier round, is in the situation n = (t, s, q),

    regret(n, a) = V(n) − Q(n, a),                   cut(n, a) = min(regret(n, a) / ε, 1) for a small ε,

a regression tree on the vectors cut(n, ·) with weights w(n) separates situations in which different actions are good
[Bastani18]; each leaf takes the action of least mean regret. Situations count in which *trees* get, since a tree that
errs meets others than the policy [Ross11]. Then leaves change their actions as long as P of the tree itself grows: by
the derivative of P with respect to a leaf's action, Σ x(n) (Q(n, a) − V(n)) over its situations, with x, V and Q of the
tree. Leaves that P does not need are merged in the end.

The search proves nothing, and need not: what is reported is P of the tree that was found, enclosed by `check`.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import function, real, whole
from stltool.automata import TRUE, UNDECIDED
from stltool.checking.check import CheckResult, check, or_optimal
from stltool.checking.induction import OPEN, Progress
from stltool.checking.situations import Moves
from stltool.display import Card, Displayed, probability_text
from stltool.errors import SettingsError, SizeError, named
from stltool.extras import require as require_extra
from stltool.models.rows import spans, starts
from stltool.policy import Policy
from stltool.product import Product
from stltool.reached import reachable
from stltool.sizes import memory_limit, require_memory

Floats: TypeAlias = NDArray[np.float64]
I64: TypeAlias = NDArray[np.int64]

_ROUNDS = 16  # of growing, for each size and ε
_CUTS = (3.0, 10.0, 30.0)  # ε, in units of the price
_CLIMBS = 60  # changes of a leaf's action at most, a round
_TRIED = 6  # leaves whose change promises most are tried in turn
_SIZES = tuple(dict.fromkeys(round(4 * 1.3**k) for k in range(30)))  # leaves
_BYTES_A_MOVE = 40  # which includes what finding them takes
_LINE = 160  # characters of a legend's line
_GAIN = 1e-12  # changes of P below this are rounding


@dataclass(frozen=True)
class Question:
    """What an inner node asks: the condition as text, for yes and for no; of counts also the name, and the greatest
    value for yes."""

    yes: str
    no: str
    name: str = ""
    most: int = 0


@dataclass(frozen=True, eq=False)
class Node:
    """A node of the tree: a question with its two answers, or an action. `share`: of the steps of the tree's runs."""

    share: float
    action: str | None = None
    question: Question | None = None
    yes: Node | None = field(default=None, repr=False)
    no: Node | None = field(default=None, repr=False)

    def data(self) -> dict[str, Any]:
        if self.question is None or self.yes is None or self.no is None:
            return {"action": self.action, "share": self.share}
        return {"if": self.question.yes, "then": self.yes.data(), "else": self.no.data(), "share": self.share}

    def lines(self, indent: str = "") -> Iterator[str]:
        if self.question is None or self.yes is None or self.no is None:
            yield f"{indent}{self.action}"
            return
        for condition, node in ((self.question.yes, self.yes), (self.question.no, self.no)):
            if node.question is None:
                yield f"{indent}{condition}: {node.action}"
            else:
                yield f"{indent}{condition}:"
                yield from node.lines(indent + "    ")


@dataclass(frozen=True, eq=False, repr=False)
class PolicyTree(Displayed):
    """A decision tree in place of a policy.

    root      the tree; `rules` is its text
    memory    what the names in brackets count: what each value from 0 on means. `legend` tells those that the tree uses
    check     P of the tree, enclosed;  given  P of the policy that it stands for
    curve     (leaves, P) of the best trees found of each size, ascending in both
    policy    the tree as a policy
    met       whether P of the tree is within the price of the policy's
    """

    product: Product
    root: Node
    memory: Mapping[str, tuple[str, ...]]
    check: CheckResult
    given: CheckResult
    curve: tuple[tuple[int, float], ...]
    policy: Policy = field(repr=False)
    price: float
    seconds: float

    @property
    def leaves(self) -> int:
        """The number of leaves."""

        def count(node: Node | None) -> int:
            return 0 if node is None else 1 if node.question is None else count(node.yes) + count(node.no)

        return count(self.root)

    @property
    def legend(self) -> tuple[str, ...]:
        """What the names in brackets that the tree uses count: first and last values, and those next to conditions."""
        asked: dict[str, set[int]] = {}
        todo: list[Node | None] = [self.root]
        while todo:
            node = todo.pop()
            if node is None or node.question is None:
                continue
            todo += [node.no, node.yes]
            for name in self.memory:
                if name == node.question.name:
                    asked.setdefault(name, set()).update((node.question.most, node.question.most + 1))
                elif name in node.question.name.split(" - "):
                    asked.setdefault(name, set()).add(1)
        lines: list[str] = []
        for name in (name for name in self.memory if name in asked):
            values = _told(self.memory[name], asked[name])
            line = f"{name}: {', '.join(values)}"
            lines += [line] if len(line) <= _LINE else [f"{name}:", *(f"    {value}" for value in values)]
        return tuple(lines)

    @property
    def met(self) -> bool:
        """Whether P of the tree is proved to be within the price of the policy's."""
        return self.check.lower >= self.given.upper - self.price

    @property
    def rules(self) -> str:
        """The tree as indented text."""
        return "\n".join(self.root.lines())

    def _card(self) -> Card:
        lost = self.given.probability - self.check.probability
        return Card(
            f"PolicyTree: {self.leaves} leaves, P = {probability_text(self.check.probability)}",
            [
                {"policy": probability_text(self.given.probability), "difference": f"{lost:.3g}",
                 "price": f"{self.price:g}", "met": self.met},
                {"task": f"{self.product.task_name} := {self.product.formula}"},
            ],
        )  # fmt: skip


def policy_tree(
    product: Product,
    policy: Policy | None = None,
    *,
    price: float = 0.001,
    most_leaves: int = 200,
    memory_limit: int | None = None,
    progress: Progress | None = None,
) -> PolicyTree:
    """A small decision tree whose P is within `price` of that of `policy` (default: the optimal one).

    most_leaves  the search gives up there, with the best tree found (`met` is then False)
    progress     called with (leaves of the trees that are grown, most_leaves)

    Needs scikit-learn (`pip install 'stltool[trees]'`). Raises PolicyError if the policy defines no action in a
    situation that it reaches, SettingsError for a mixed policy or a model without known probabilities, SizeError before
    allocating more memory than is available.
    """
    start = time.perf_counter()
    allowed = float(real(price, named("price"), "0.001"))
    if not 0 < allowed < 1:
        raise SettingsError(f"{named('price')} is {price}; give a number between 0 and 1, such as 0.001")
    most = whole(most_leaves, named("most_leaves"), 1)
    function(progress, "policy_tree's progress")
    require_extra("sklearn", "a decision tree of a policy")
    from sklearn import tree as trees

    home, given = or_optimal("policy_tree", product, policy, memory_limit).on(product)
    if not given.deterministic:
        raise SettingsError("policy_tree needs a deterministic policy; a mixed one has no tree of actions")
    found = check(home, given)
    situations = _Situations(home, given, memory_limit)
    grown = _grow(situations, trees, found.probability - allowed, allowed, most, progress)
    table = situations.table(grown.best.chosen)
    tree = Policy(home, table)
    return PolicyTree(
        product=home,
        root=situations.node(grown.best),
        memory=situations.features.memory,
        check=check(home, tree),
        given=found,
        curve=grown.curve,
        policy=tree,
        price=allowed,
        seconds=time.perf_counter() - start,
    )


_Column: TypeAlias = Callable[[I64, I64, I64], NDArray[Any]]
"""Of situations (t, s, q)."""


def _of_state(values: NDArray[Any]) -> _Column:
    return lambda t, s, q: values[s]


def _of_memory(values: NDArray[Any]) -> _Column:
    return lambda t, s, q: values[q]


class _Features:
    """What the tree may ask of a situation.

    names   of each feature, as they stand in conditions;  memory  what each value of those in brackets means
    """

    def __init__(self, product: Product) -> None:
        model, automaton, h = product.model, product.automaton, product.horizon
        self.names: list[str] = []
        self.kinds: list[str] = []
        self._columns: list[_Column] = []
        self.memory: dict[str, tuple[str, ...]] = {}
        for name, values in model.signals.items():
            self._add(name, "signal", _of_state(values))
        for name, holds in model.labels.items():
            self._add(name, "label", _of_state(holds))
        counters = []
        called = {formula: name for name, formula in product.definitions.items()}
        for track in automaton.tracks(lambda phi: called.get(phi, str(phi))):
            if len(track.levels) > 1:
                name = f"[{track.name}]"
                self._add(name, "count", _of_memory(track.level_of))
                self.memory[name] = tuple(level.phrase for level in track.levels)
                if any(level.number is not None for level in track.levels):
                    counters.append((name, track.level_of))
        for (one, a), (other, b) in itertools.combinations(counters, 2):
            self._add(f"{one} - {other}", "count", _of_memory(a.astype(np.int64) - b))
        self._add("steps_left", "count", lambda t, s, q: h - t)

    def _add(self, name: str, kind: str, column: _Column) -> None:
        self.names.append(name)
        self.kinds.append(kind)
        self._columns.append(column)

    def __call__(self, t: I64, s: I64, q: I64) -> Floats:
        """(n, features) of situations."""
        return np.stack([column(t, s, q).astype(np.float64) for column in self._columns], axis=1)

    def question(self, feature: int, below: float, above: float) -> Question:
        """`below` and `above` are the values next to its threshold."""
        name, kind = self.names[feature], self.kinds[feature]
        if kind == "label":
            return Question(f"!{name}", name)
        if kind == "count":
            return Question(f"{name} <= {below:.0f}", f"{name} > {below:.0f}", name, round(below))
        number = _shortest(below, above)
        return Question(f"{name} < {number}", f"{name} >= {number}")


def _told(phrases: Sequence[str], asked: set[int]) -> list[str]:
    """What some values mean, and the first and the last one."""
    wanted = sorted({0, len(phrases) - 1, *(value for value in asked if 0 <= value < len(phrases))})
    parts: list[str] = []
    for before, value in zip([-1, *wanted], wanted, strict=False):
        parts += ["..."] if value > before + 1 else []
        parts.append(f"{value} {phrases[value]}")
    return parts


def _most(product: Product, limit: int | None) -> tuple[int, int]:
    """How many situations, and moves of theirs, fit into memory."""
    free = memory_limit(limit)
    return free // (8 * (20 + product.model.n_actions)), free // _BYTES_A_MOVE


def _shortest(below: float, above: float) -> str:
    """The shortest decimal in (below, above]."""
    for digits in range(1, 18):
        text = f"{(below + above) / 2:.{digits}g}"
        if below < float(text) <= above:
            return text
    return f"{above:.17g}"


class _Situations:
    """All undecided situations that any policy reaches, unfolded over the steps, for policies as lists of choices.

    t, s, q  (n,);  values_of (n, features), and `x` the same in single precision
    action_choice  (n, A): the choice of an action within its state, −1 where it has none
    """

    def __init__(self, product: Product, policy: Policy, limit: int | None) -> None:
        self.product, self.features = product, _Features(product)
        nodes = reachable(product, *_most(product, limit))
        if nodes is None:
            raise SizeError(
                f"the situations of {product.n_states} product states and their moves take more memory than is "
                "available; shorten the windows"
            )
        self._moves = [Moves.of(product, nodes, t) for t in range(len(nodes))]
        self._at = starts(np.array([len(codes) for codes in nodes], dtype=np.int64))  # where each step's begin
        none = np.empty(0, dtype=np.int64)
        self.t = np.repeat(np.arange(len(nodes)), np.diff(self._at))
        self.s, self.q = np.divmod(np.concatenate([none, *nodes]), product.automaton.n_states)
        first = np.flatnonzero(product.model.initial)
        codes = first * product.automaton.n_states + [
            product.enter(s, product.automaton.initial) for s in first.tolist()
        ]
        verdict = product.automaton.verdicts(0)[codes % product.automaton.n_states]
        self._start = product.model.initial[first]
        self._first = (verdict == TRUE).astype(np.int64)
        if len(nodes):
            still = verdict == UNDECIDED
            self._first[still] = OPEN + np.searchsorted(nodes[0], codes[still])
        self.values_of = self.features(self.t, self.s, self.q)
        self.x = self.values_of.astype(np.float32)  # in which the trees compare
        model = product.model
        number = np.full((model.n_states, model.n_actions), -1, dtype=np.int64)
        state = np.repeat(np.arange(model.n_states), np.diff(model.choice_start))
        number[state, model.choice_action] = np.arange(model.n_choices) - model.choice_start[state]
        self.action_choice = number[self.s]
        parts = (policy.at(t, self.s[a:b], self.q[a:b]) for t, a, b in self._steps())
        self.given = np.concatenate([none, *parts])

    def __len__(self) -> int:
        return len(self.s)

    def _steps(self) -> Iterator[tuple[int, int, int]]:
        """t, and the first and the end of its situations."""
        return zip(range(len(self._moves)), self._at[:-1].tolist(), self._at[1:].tolist(), strict=True)

    def values(self, chosen: I64) -> tuple[float, Floats, list[Floats]]:
        """P, V (n,) and Q of each step's choices under choices (n,); where one is negative, the best is taken."""
        v = np.empty(len(self))
        q: list[Floats] = []
        here: Floats = np.empty(0)
        for t, a, b in reversed(list(self._steps())):
            moves, taken = self._moves[t], chosen[a:b]
            each = moves.sums(here)
            here = each[moves.choices[:-1] + np.maximum(taken, 0)]
            if (taken < 0).any():
                here = np.where(taken < 0, np.maximum.reduceat(each, moves.choices[:-1]), here)
            v[a:b] = here
            q.append(each)
        q.reverse()
        return float(self._start @ np.concatenate([[0.0, 1.0], here])[self._first]), v, q

    def visits(self, chosen: I64) -> Floats:
        """How probable each situation is under choices (n,)."""
        found = np.empty(len(self))
        reach = np.bincount(self._first, self._start, minlength=OPEN)
        for t, a, b in self._steps():
            moves = self._moves[t]
            reach = np.pad(reach, (0, OPEN + b - a - len(reach)))
            found[a:b] = here = reach[OPEN:]
            row = moves.choices[:-1] + np.maximum(chosen[a:b], 0)
            edge = spans(moves.rows[row], moves.rows[row + 1])
            flow = np.repeat(here, np.diff(moves.rows)[row]) * moves.probability[edge]
            reach = np.bincount(moves.child[edge], flow, minlength=OPEN)
        return found

    def by_action(self, q: list[Floats], fill: float) -> Floats:
        """(n, A): Q of each action, `fill` where there is none."""
        found = np.full(self.action_choice.shape, fill)
        for t, a, b in self._steps():
            numbers = self.action_choice[a:b]
            i, action = np.nonzero(numbers >= 0)
            found[a + i, action] = q[t][self._moves[t].choices[i] + numbers[i, action]]
        return found

    def table(self, chosen: I64) -> NDArray[Any]:
        """Choices (n,) as a policy's table."""
        shape = (self.product.horizon, *self.product.shape)
        require_memory(8 * int(np.prod(shape)), f"a table of {' x '.join(map(str, shape))}", "shorten the windows")
        table = np.full(shape, -1, dtype=self.product.model.choice_type)
        table[self.t, self.s, self.q] = chosen
        return table

    def node(self, tree: _Tree) -> Node:
        """A tree with its conditions in words; sub-trees of one action are leaves."""
        weight = self.visits(tree.chosen)
        weight = weight / max(weight.sum(), 1e-300)
        names = self.product.model.action_names

        def build(i: int, here: I64) -> Node:
            share = float(weight[here].sum())
            if tree.left[i] < 0:
                return Node(share, action=names[tree.action[i]])
            below = self.x[here, tree.feature[i]] <= tree.threshold[i]
            values = self.values_of[here, tree.feature[i]]
            low = values[below].max() if below.any() else tree.threshold[i]
            high = values[~below].min() if (~below).any() else tree.threshold[i]
            yes, no = build(tree.left[i], here[below]), build(tree.right[i], here[~below])
            if list(yes.lines()) == list(no.lines()):  # the question makes no difference
                return _together(yes, no)
            question = self.features.question(int(tree.feature[i]), low, high)
            return Node(share, question=question, yes=yes, no=no)

        return build(0, np.arange(len(self)))


def _together(one: Node, other: Node) -> Node:
    """Two sub-trees with the same text as one."""
    share = one.share + other.share
    if one.yes is None or one.no is None or other.yes is None or other.no is None:
        return Node(share, one.action)
    return Node(share, None, one.question, _together(one.yes, other.yes), _together(one.no, other.no))


@dataclass(eq=False)
class _Tree:
    """Arrays of a fitted tree: `left` and `right` children (−1: a leaf), the action of each leaf, the leaf of each
    situation, and what follows from them: the choice in each situation, and P."""

    left: I64
    right: I64
    feature: I64
    threshold: Floats
    action: I64
    leaf: I64
    chosen: I64
    probability: float

    @cached_property
    def leaves(self) -> int:
        """Leaves, where equal sub-trees count once."""

        def walk(i: int) -> tuple[int, Any]:  # leaves, and the sub-tree
            if self.left[i] < 0:
                return 1, int(self.action[i])
            (a, one), (b, other) = walk(int(self.left[i])), walk(int(self.right[i]))
            if one == other:
                return a, one
            return a + b, (int(self.feature[i]), float(self.threshold[i]), one, other)

        return walk(0)[0]


@dataclass(frozen=True, eq=False)
class _Grown:
    best: _Tree
    curve: tuple[tuple[int, float], ...]


def _grow(
    situations: _Situations, trees: Any, target: float, price: float, most: int, progress: Progress | None
) -> _Grown:
    """Trees of growing size, until one attains `target`."""
    if not len(situations):  # the first state decides
        none = np.empty(0, dtype=np.int64)
        leaf = np.full(1, -1)
        only = _made(situations, leaf, leaf, leaf, np.zeros(1), np.zeros(1, dtype=np.int64), none)
        return _Grown(only, ((1, only.probability),))
    _, v, q = situations.values(situations.given)
    regret = np.maximum(v[:, None] - situations.by_action(q, -1.0), 0.0)
    first = situations.visits(situations.given)
    found: list[_Tree] = []
    for size in [n for n in _SIZES if n < most] + [most]:
        if progress is not None:
            progress(size, most)
        for cut in _CUTS:
            weight = first.copy()
            for _ in range(_ROUNDS):
                tree = _climbed(situations, _fitted(situations, trees, regret, weight, cut * price, size))
                found.append(tree)
                weight += situations.visits(tree.chosen)
            if good := [tree for tree in found if tree.probability >= target]:
                best = _pruned(situations, min(good, key=lambda tree: tree.leaves), target)
                return _Grown(best, _frontier([*found, best]))
    return _Grown(max(found, key=lambda tree: tree.probability), _frontier(found))


def _frontier(found: list[_Tree]) -> tuple[tuple[int, float], ...]:
    """The best P for each number of leaves, where it exceeds that of all smaller trees."""
    curve: list[tuple[int, float]] = []
    for tree in sorted(found, key=lambda tree: (tree.leaves, -tree.probability)):
        if not curve or (tree.probability > curve[-1][1] and tree.leaves > curve[-1][0]):
            curve.append((tree.leaves, tree.probability))
    return tuple(curve)


def _fitted(situations: _Situations, trees: Any, regret: Floats, weight: Floats, cut: float, size: int) -> _Tree:
    """A tree that separates situations with different good actions."""
    seen = np.flatnonzero(weight)
    fitted = trees.DecisionTreeRegressor(  # which has no such limit below 2, but may leave the root whole
        max_leaf_nodes=max(size, 2), min_samples_split=2 if size > 1 else len(seen) + 1, random_state=0
    )
    fitted.fit(situations.x[seen], np.minimum(regret[seen] / cut, 1.0), sample_weight=weight[seen])
    inner = fitted.tree_
    leaf = fitted.apply(situations.x)
    cost = np.zeros((inner.node_count, regret.shape[1]))
    np.add.at(cost, leaf[seen], weight[seen, None] * regret[seen])
    action = cost.argmin(axis=1)
    return _made(situations, inner.children_left, inner.children_right, inner.feature, inner.threshold, action, leaf)


def _made(
    situations: _Situations, left: I64, right: I64, feature: I64, threshold: Floats, action: I64, leaf: I64
) -> _Tree:
    chosen = _choices(situations, action, leaf)
    probability = situations.values(chosen)[0]
    return _Tree(left, right, feature, threshold, action, leaf, chosen, probability)


def _choices(situations: _Situations, action: I64, leaf: I64) -> I64:
    """What a tree takes; where its action is not available, the state's first choice."""
    found: I64 = np.maximum(situations.action_choice[np.arange(len(situations)), action[leaf]], 0)
    return found


def _with(situations: _Situations, tree: _Tree, action: I64) -> _Tree:
    return _made(situations, tree.left, tree.right, tree.feature, tree.threshold, action, tree.leaf)


def _climbed(situations: _Situations, tree: _Tree) -> _Tree:
    """The tree with other actions in its leaves, as long as P grows."""
    for _ in range(_CLIMBS):
        _, v, q = situations.values(tree.chosen)
        gain = situations.by_action(q, -1.0) - v[:, None]
        gain *= situations.visits(tree.chosen)[:, None]
        total = np.zeros((len(tree.left), gain.shape[1]))
        np.add.at(total, tree.leaf, gain)
        for place in np.argsort(-total, axis=None, kind="stable")[:_TRIED].tolist():
            leaf, action = divmod(place, gain.shape[1])
            if total[leaf, action] <= _GAIN:
                return tree
            changed = tree.action.copy()
            changed[leaf] = action
            new = _with(situations, tree, changed)
            if new.probability > tree.probability + _GAIN:
                tree = new
                break
        else:
            return tree
    return tree


def _pruned(situations: _Situations, tree: _Tree, target: float) -> _Tree:
    """The tree with leaves merged, the least loss first, as long as P attains the target."""
    while True:
        best: _Tree | None = None
        for i in np.flatnonzero(tree.left >= 0).tolist():
            one, other = int(tree.left[i]), int(tree.right[i])
            if tree.left[one] >= 0 or tree.left[other] >= 0:
                continue
            left, action = tree.left.copy(), tree.action.copy()
            left[i] = -1
            leaf = np.where((tree.leaf == one) | (tree.leaf == other), i, tree.leaf)
            for kept in {int(tree.action[one]), int(tree.action[other])}:
                action[i] = kept
                new = _made(situations, left, tree.right, tree.feature, tree.threshold, action.copy(), leaf)
                if new.probability >= target and (best is None or new.probability > best.probability):
                    best = new
        if best is None:
            return tree
        tree = best
