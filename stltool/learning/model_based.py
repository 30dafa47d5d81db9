"""model-based: plans on counted transitions, drawn from what the counts leave open, with hope; the checker's induction.

Acting: each episode draws one model from the posterior of the counts (posterior sampling [Strens00]): the frequencies
of the successors seen so far, by Gamma draws. A share of every choice leads to a paradise instead, all of an untried
choice, less and less of the others, at a level of hope that is drawn, too (learning/optimism.py). The episode acts on
the best plan for this model. Once the task is violated, the rest of the episode takes the choices tried least, as long
as there is something to learn from them (learning/aftermath.py).

Plans are lazy: they are made for what the transitions seen lead to from the present situation. The episode's plan is
kept as long as it applies. Where it relies on a choice that has been tried in the meantime, or says nothing, another
untried choice of that state will do, which promises as much; only if there is none, the rest of the episode is planned
again. On products that are not large, a kernel plays episodes (learning/explorer.py): there a model and its plan are
held for the episodes that follow until some choice has been taken a quarter more often than when it was drawn, or a
transition is new, as episodes of UCRL2 last until a count has doubled [Jaksch10]. And hope for a choice that has been
tried is modest: it leads to the best state that the model has for what is left of the task, which is paradise only
while there are untried choices or certain success. Otherwise, where even the best policy mostly fails, hope would be
all that counts.

Side by side, where a black box takes many runs at once, up to 16 models are drawn for a batch, and episodes with the
same one share its plans. On small products models and plans are made anew after every step of the batch, so that an
episode knows what others have found a step before; on large ones they are those of the batch's beginning. Of untried
choices, which promise the same, each episode takes the one that the others have taken least.

The policy that is judged trusts counts with caution: of n(s,a) visits, successor s' has the share n(s,a,s') / (n + κ),
and the rest fails, or next to it. So a choice seen once is not preferred to one that has proved itself many times, nor
one that is known to fail to one that was never tried. It is the best policy by these data.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.checking.induction import Budget, Doubles, Edges, Following, Game, Single, Values, induct, solve
from stltool.checking.induction.anywhere import Anywhere, From, Known, Later, Learned
from stltool.checking.induction.arithmetic import row_sums
from stltool.checking.induction.tiled import Tiles
from stltool.checking.induction.words import Words
from stltool.choices import Choices, Form
from stltool.kernels import Group
from stltool.learning.aftermath import aftermath
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.explorer import FIRST, Explorer, Held, patient
from stltool.learning.kept import Kept
from stltool.learning.learner import Learner, rarest
from stltool.learning.optimism import NEXT_TO_NOTHING, doubt, level, paradise, unrefuted
from stltool.learning.problem import Problem
from stltool.learning.settings import setting
from stltool.models.rows import Chances, Rows, starts
from stltool.sizes import memory_limit, unsigned_type

_SMALL = 300_000  # situations (t, s, q): with more, only those that can be reached are planned for
_CHARTED = 15  # times as many: there is room to keep those that transitions lead to, for episodes one after the other
_BELIEFS = 16  # different ones, of the episodes of a batch
_LEAST = 1e-300  # drawn frequencies are positive, so that every successor that was seen stays one


@dataclass(frozen=True, kw_only=True)
class ModelBased(Learner["Planner"]):
    """Acts on hopeful plans over models drawn from the counted transitions; a cautious plan gives the judged policy."""

    name: ClassVar[str] = "model-based"
    kernels: ClassVar[tuple[Group, ...]] = ("plans",)

    optimism: float = setting(0.6, "b in the mean share of hope b / (1 + b) of a choice seen once", above=0)
    caution: float = setting(0.1, "κ in the judged policy's weight n / (n + κ) for a choice seen n times", least=0)

    def start(self, problem: Problem, counts: Counts, rng: np.random.Generator) -> Planner:
        return Planner(problem, counts)

    def episode(self, state: Planner, episode: Episode) -> None:
        if state.charted and episode.batch is None:
            state.explorer.episode(episode, self.optimism, state.starts)
            return
        chances = episode.rng.random((episode.length, 2))[:, 1].tolist()
        belief = Belief(state, self.optimism, int(episode.rng.integers(2**62)))
        guide: Guide = Alone(state, belief)
        if episode.batch is not None:
            guide = state.batch(episode.batch).guide(episode.number, belief)
        tried, first_choice = guide.tried, state.first_choice
        if episode.verdict is None:
            state.starts[episode.s] += 1
            guide.begin(episode.t, episode.s, episode.q)
        while not episode.over and episode.verdict is not True:
            t, s = episode.t, episode.s
            first = first_choice[s]
            if episode.verdict is False:
                a = aftermath(episode, tried[first : first_choice[s + 1]], chances[t])
                if a < 0:
                    break
            else:
                a = guide.action(t, s, episode.q, chances[t])
            episode.step(a)
            tried[first + a] += 1

    def policy(self, state: Planner) -> Form:
        return state.judged(self.caution)

    def arrays(self, state: Planner) -> dict[str, Kept]:
        arrays = {"starts": Kept(state.starts, 0)}  # the rest is in the counts
        if state.charted:
            held, (_, S, Q) = state.keep(), state.problem.shape
            arrays |= {
                "plan": Kept(held.choices, 0, FIRST - 1 + np.asarray(state.problem.n_choices)[:, None]),
                "plan limit": Kept(held.limit, 0, patient(state.counts.visits)),
                "plan begins": Kept(held.begins, 0, np.array([1, S - 1, Q - 1])),
            }
        return arrays

    def check(self, state: Planner) -> None:
        require_starts(state.starts, state.counts)
        state.resume()


@dataclass(frozen=True)
class Belief:
    """What one episode believes about the transitions, as far as they are counted; `seed`: of its draws."""

    planner: Planner
    optimism: float
    seed: int

    def learned(self, visits: NDArray[np.int64]) -> Learned:
        """The model drawn, after choices were taken `visits` times; a share of each choice leads outside."""
        rng = np.random.default_rng(self.seed)
        hopes = unrefuted(visits, level(self.optimism, rng.random()))
        seen = self.planner.counts.seen
        return self.planner.learned(gammas(seen, rng.standard_normal(len(seen))), hopes)


def gammas(seen: NDArray[np.int64], normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Gamma(n) for each of `seen`, as n (1 − 1/9n + z/(3√n))³ with z normal [Wilson31], which is drawn much faster."""
    root = 1 - 1 / (9 * seen) + normal / (3 * np.sqrt(seen))
    drawn: NDArray[np.float64] = np.maximum(seen * root * root * root, _LEAST)
    return drawn


class Guide(Protocol):
    """What an episode acts on. tried (choices,): how often they were taken, which the episode itself counts on."""

    tried: NDArray[np.int64]

    def begin(self, t: int, s: int, q: int) -> None:
        """Plan from the episode's first situation on."""

    def action(self, t: int, s: int, q: int, chance: float) -> int:
        """What to do there; ties may be broken by `chance` in [0, 1)."""


class Alone:
    """For one episode after the other: a belief, and the planner's plan by it, made anew where it no longer applies."""

    def __init__(self, planner: Planner, belief: Belief) -> None:
        self.tried, self._planner, self._belief = planner.counts.visits, planner, belief

    def begin(self, t: int, s: int, q: int) -> None:
        self._planner.follow(self._belief.learned(self.tried), t, s, q, self.tried)

    def action(self, t: int, s: int, q: int, chance: float) -> int:
        a = self._planner.action(t, s, q, self.tried)
        if a < 0:
            self.begin(t, s, q)
            a = self._planner.action(t, s, q, self.tried)
        return a


class Batch:
    """The episodes of these numbers, side by side: each has one of a few beliefs.

    tried   (choices,): as in `Guide`, of all of them together
    """

    def __init__(self, planner: Planner, numbers: range) -> None:
        self.numbers, self.tried, self._planner = numbers, planner.counts.visits, planner
        self._shared: dict[int, _Shared] = {}

    def guide(self, number: int, belief: Belief) -> Guide:
        """For the episode of this number; the first one with a belief gives its own."""
        which = (number - self.numbers.start) % _BELIEFS
        if which not in self._shared:
            self._shared[which] = _Shared(self._planner, belief)
        return _Beside(self, self._shared[which])


class _Shared:
    """A belief of several episodes, and the plans by it: for small products one, renewed after every step; otherwise by
    where they begin: step, state and memory. visits (choices,): as counted when its model was drawn."""

    def __init__(self, planner: Planner, belief: Belief) -> None:
        self.planner, self._belief, self._step = planner, belief, -1
        self._plans: dict[tuple[int, int, int], Plan] = {}
        self._draw()

    def _draw(self) -> None:
        self.visits = self.planner.counts.visits
        self._learned = self._belief.learned(self.visits)

    def plan(self, t: int, s: int, q: int) -> Plan:
        """One that begins there, or earlier in the batch."""
        if not self.planner.small:
            if (t, s, q) not in self._plans:
                self._plans[t, s, q] = self.planner.plan_from(self._learned, t, s, q)
            return self._plans[t, s, q]
        if t > self._step:
            if t:
                self._draw()
            self._step, self._plans[0, 0, 0] = t, self.planner.plan_from(self._learned, t, s, q)
        return self._plans[0, 0, 0]


class _Beside:
    def __init__(self, batch: Batch, shared: _Shared) -> None:
        self.tried, self._shared = batch.tried, shared

    def begin(self, t: int, s: int, q: int) -> None:
        self._plan = self._shared.plan(t, s, q)

    def action(self, t: int, s: int, q: int, chance: float) -> int:
        shared = self._shared
        if shared.planner.small:
            self.begin(t, s, q)
        a = self._plan(t, s, q)
        if a < 0:
            self.begin(t, s, q)
            a = self._plan(t, s, q)
        first, after = shared.planner.first_choice[s], shared.planner.first_choice[s + 1]
        if not shared.visits[first + a]:  # others promise as much: not all take the same
            a = rarest(self.tried[first:after], chance)
        return a


@dataclass(frozen=True, eq=False)
class Plan:
    """What to do from step `since` on: a table (h, S, Q) by step, or choices whose steps are counted from there."""

    form: NDArray[np.unsignedinteger] | Choices
    since: int

    def __call__(self, t: int, s: int, q: int) -> int:
        """The choice; −1 where it does not say."""
        if isinstance(self.form, np.ndarray):
            return int(self.form[t, s, q])
        return self.form.one(t - self.since, s, q)


class Planner:
    """Plans over the transitions counted so far; `plan` is the one that is acted on.

    starts   (n_states,) int64: how many episodes started there, undecided
    small    with at most `most` situations (t, s, q), plans of batches are made for all in which a run could be
    charted  with some times as many, episodes that are played alone are planned and played by a kernel
    """

    def __init__(self, problem: Problem, counts: Counts, most: float = _SMALL) -> None:
        self.problem, self.counts = problem, counts
        self.starts, self.first_choice = np.zeros(problem.n_states, dtype=np.int64), problem.first_choice.tolist()
        self.plan = Plan(Choices(problem.shape[1:], problem.automaton.horizon, [], problem.choice_type), 0)
        self._tried = np.zeros(counts.n_choices, dtype=np.bool_)
        # one more state, outside, where hopes and doubts lead: what that is worth is the plan's to say
        self._automata = [Single(problem.automaton.with_outcome(verdict)) for verdict in (FALSE, TRUE)]
        self._letter = np.append(problem.letter, np.int32(problem.automaton.n_letters))
        self._moves: list[dict[str, Any]] = [{}, {}]
        self._choices = unsigned_type(problem.most_choices - 1)
        self._anywhere: Anywhere | None = None
        self._worth = np.zeros(0)
        situations = float(np.prod([float(n) for n in problem.shape]))
        self.charted = situations <= _CHARTED * most
        if situations <= most:
            self._anywhere = Anywhere(problem.automaton, problem.letter, problem.first_choice, self._choices)
            h = problem.automaton.horizon
            self._worth = np.array([paradise(t, h) for t in range(h)])
        self._batch: Batch | None = None
        self._judged: tuple[tuple[int, int, float], Choices] | None = None  # by what was counted, and caution
        self._explorer: Explorer | None = None
        self._held: Held | None = None  # while a checkpoint is written or read
        self._limit = memory_limit(None)  # which takes longer to find out than some plans

    @property
    def small(self) -> bool:
        return self._anywhere is not None

    def keep(self) -> Held:
        """The plan that is held for later episodes; `resume` goes on with it, once the counts are the same again."""
        if self._explorer is not None and self._explorer.total == self.counts.total:
            self._held = self._explorer.held()
        else:
            self._held = Held.none(self.problem.shape, self.counts.n_choices)
        return self._held

    def resume(self) -> None:
        held, self._held = self._held, None
        if held is None:
            return
        if not held.begins[0] and any(array.any() for array in held):
            raise ValueError("a plan is stored, and none is held")
        if held.begins[0]:
            if (held.limit < self.counts.visits).any():
                raise ValueError("the plan that is held was given up")
            self.explorer.hold(held)

    @property
    def explorer(self) -> Explorer:
        """What plays episodes one after the other on small products."""
        if self._explorer is None or self._explorer.total != self.counts.total:
            self._explorer = Explorer(self.problem, self.counts)
        return self._explorer

    def batch(self, numbers: range) -> Batch:
        """The batch of these episodes."""
        if self._batch is None or self._batch.numbers != numbers:
            self._batch = Batch(self, numbers)
        return self._batch

    def action(self, t: int, s: int, q: int, visits: NDArray[np.int64]) -> int:
        """What to do by the plan; −1 if it does not say, or hoped for what has been tried in the meantime.

        It hoped for no more than any untried choice of this state promises, so such a choice is taken instead.
        """
        first, a = self.first_choice[s], self.plan(t, s, q)
        if a >= 0 and (self._tried[first + a] or not visits[first + a]):
            return a
        untried = np.flatnonzero(visits[first : self.first_choice[s + 1]] == 0)
        return int(untried[0]) if len(untried) else -1

    def follow(self, learned: Learned, t: int, s: int, q: int, visits: NDArray[np.int64]) -> None:
        """Make the optimistic plan over these rows from there, and act on it."""
        self.plan, self._tried = self.plan_from(learned, t, s, q), visits > 0

    def plan_from(self, learned: Learned, t: int, s: int, q: int) -> Plan:
        """The optimistic plan over these rows from there: being outside is worth 1, less a hair, the more the later."""
        if self._anywhere is not None:
            return Plan(self._anywhere.plan(learned, self._worth, t), 0)
        return Plan(self._induct(learned, True, From(self._automata[TRUE], t, q), np.array([s])), t)

    def judged(self, caution: float) -> Choices:
        """The best policy by the counts, from the states where episodes started; being outside is next to failing.

        That of the last evaluation is the one that a run ends with: it is made once.
        """
        of = self.counts.total, int(self.starts.sum()), caution
        if self._judged is None or self._judged[0] != of:
            self._judged = of, self._best(caution)
        return self._judged[1]

    def _best(self, caution: float) -> Choices:
        learned = self.learned(self.counts.seen.astype(np.float64), doubt(self.counts.visits, caution))
        if self._anywhere is not None:
            table = self._anywhere.plan(learned, np.full_like(self._worth, NEXT_TO_NOTHING))
            return self._anywhere.listed(table, self.problem.choice_type)
        return self._induct(learned, False, Later(self._automata[TRUE], 0), np.flatnonzero(self.starts))

    def value(self, form: Form, caution: float) -> float:
        """P of a policy by the counts, from the states where episodes started, in proportion; 0 if none has."""
        first = np.flatnonzero(self.starts)
        if not len(first):
            return 0.0
        learned = self.learned(self.counts.seen.astype(np.float64), doubt(self.counts.visits, caution))
        game = Game(self._rows(learned), self._automata[FALSE], self._letter, first)
        budget = Budget(f"judging a policy on {self.problem.n_states} states", self._limit)
        found = induct(game, Doubles(True), True, Following(form), threads=1, budget=budget)
        return float(found.entry @ self.starts[first] / self.starts.sum())

    def learned(self, weights: NDArray[np.float64], outside: NDArray[np.float64]) -> Learned:
        """Where each choice leads, outside with a given probability.

        weights (transitions,) in proportion to the chances of the counted transitions of each choice
        """
        counts = self.counts
        choice = counts.choice
        total = np.bincount(choice, weights, counts.n_choices)
        share = (1 - outside) / np.where(total > 0, total, 1.0)
        start = starts(np.bincount(choice, minlength=counts.n_choices))
        return Learned(start, counts.target, weights * share[choice], outside)

    def _rows(self, learned: Learned) -> Rows:
        """The same, of the model's states and one more, outside."""
        n = self.counts.n_choices
        doubtful = np.flatnonzero(learned.outside)
        choice = np.repeat(np.arange(n), np.diff(learned.start))
        rows = np.concatenate([choice, doubtful, [n]])  # the last: outside there is nothing to do
        order = np.argsort(rows, kind="stable")
        probability = np.concatenate([learned.probability, learned.outside[doubtful], [1.0]])[order]
        successor = np.concatenate([learned.target, np.full(len(doubtful) + 1, self.problem.n_states)])
        start = starts(np.bincount(rows, minlength=n + 1))
        first = np.append(self.problem.first_choice, n + 1)
        return Rows(first, start, successor[order].astype(np.int32), Chances(probability, start))

    def _induct(self, learned: Learned, optimistic: bool, later: Later, first: NDArray[np.int64]) -> Choices:
        """The best plan from these states on, at a step from which it counts its own."""
        problem, since = self.problem, later.since
        if not later.horizon:
            return Choices(problem.shape[1:], 0, [], problem.choice_type)
        game = Game(self._rows(learned), later, self._letter, first, dict(self._moves[optimistic]))
        budget = Budget(
            f"planning {problem.shape[0]} steps of {problem.n_states * problem.automaton.n_states} product states",
            self._limit,
        )
        layers = Known(game, budget, self._choices)
        self._moves[optimistic] = {"moves": game.kept["moves"]} if "moves" in game.kept else {}
        worth = partial(paradise, horizon=problem.automaton.horizon) if optimistic else _nothing
        found = solve(layers, _Outside(problem, since, worth), True, self._choices).choices
        assert found is not None
        return found.resized((problem.n_states, problem.automaton.n_states))


def require_starts(starts: NDArray[np.int64], counts: Counts) -> None:
    """ValueError if more episodes started, undecided, than steps were counted."""
    if sum(starts.tolist()) > int(counts.seen.sum()):
        raise ValueError("more episodes started than steps were counted")


def _nothing(t: int) -> float:
    return NEXT_TO_NOTHING


class _Outside(Doubles):
    """Where being outside is worth `by_step` after each step of the task."""

    repeats = False

    def __init__(self, problem: Problem, since: int, by_step: Callable[[int], float]) -> None:
        super().__init__(True)
        self._by_step, self._outside, self._since = by_step, problem.n_states, since
        self.state = problem.automaton.n_states  # of the automaton, outside

    def worth(self, t: int) -> float:
        """Of going outside after step t of the plan."""
        return float(self._by_step(self._since + t))

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        values = ahead[edges.child]
        values[self.rows.target[edges.entry] == self._outside] = self.worth(t)
        return row_sums(self.rows.probability[edges.entry] * values, edges.start)

    def tiles(self, engine: Words) -> Tiles:
        return _OutsideTiles(self, engine)


class _OutsideTiles(Tiles):
    def __init__(self, arithmetic: _Outside, engine: Words) -> None:
        super().__init__(engine, engine.rows.probability, 1, arithmetic.ends(0), True)
        self._arithmetic = arithmetic

    def decided(self, t: int) -> Values:
        row = super().decided(t)
        self.at(row)[self._arithmetic.state] = self._arithmetic.worth(t - 1)
        return row
