"""model-based: plans on counted transitions, drawn from what the counts leave open, with hope; the checker's induction.

Acting: each episode draws one model from the posterior of the counts (posterior sampling [Strens00]): the frequencies
of the successors seen so far, by Gamma draws. A share of every choice leads to a paradise instead, all of an untried
choice, less and less of the others (learning/optimism.py). The episode acts on the best plan for this model. Once the
task is violated, the rest of the episode takes the choices tried least.

Plans are lazy: the episode's plan is kept as long as it applies. Where it relies on a choice that has been tried in the
meantime, or says nothing, another untried choice of that state will do, which promises as much; only if there is none,
the rest of the episode is planned again. Small products are planned wherever a run could be; large ones where runs can
be by the transitions seen.

Side by side, where a black box takes many runs at once, episodes act on what was counted when their batch began: up to
16 models are drawn, and episodes with the same one share its plans, whatever has been tried in the meantime. So a batch
costs about as many plans as 16 episodes, and hopes are the same as alone, at most a batch later.

The policy that is judged trusts counts with caution: of n(s,a) visits, successor s' has the share n(s,a,s') / (n + κ),
and the rest fails. So a choice seen once is not preferred to one that has proved itself many times. It is the best
policy by these data.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.checking.induction import Budget, Doubles, Edges, Following, Game, Layers, Single, Values, induct, solve
from stltool.checking.induction.anywhere import Anywhere, From, Known, Later
from stltool.checking.induction.arithmetic import row_sums
from stltool.checking.induction.tiled import Tiles
from stltool.checking.induction.words import Words
from stltool.choices import Choices, Form
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.kept import Kept
from stltool.learning.learner import Learner, rarest
from stltool.learning.optimism import doubt, hope, paradise
from stltool.learning.problem import Problem
from stltool.learning.settings import setting
from stltool.models.rows import Chances, Rows, starts
from stltool.sizes import memory_limit, unsigned_type

_SMALL = 300_000  # situations (t, s, q): with more, only those that can be reached are planned for
_BELIEFS = 16  # different ones, of the episodes of a batch
_LEAST = 1e-300  # drawn frequencies are positive, so that every successor that was seen stays one


@dataclass(frozen=True, kw_only=True)
class ModelBased(Learner["Planner"]):
    """Acts on hopeful plans over models drawn from the counted transitions; a cautious plan gives the judged policy."""

    name: ClassVar[str] = "model-based"
    optimism: float = setting(0.3, "b in the share of hope b / (n + b) of a choice seen n times", above=0)
    caution: float = setting(0.1, "κ in the judged policy's weight n / (n + κ) for a choice seen n times", least=0)

    def start(self, problem: Problem, counts: Counts, rng: np.random.Generator) -> Planner:
        return Planner(problem, counts)

    def episode(self, state: Planner, episode: Episode) -> None:
        chances = episode.rng.random((episode.length, 2))[:, 1].tolist()
        drawn, visits = Belief(state, self.optimism, int(episode.rng.integers(2**62))), state.counts.visits
        planner, belief, tried = state, drawn.rows, visits
        if episode.batch is not None:
            planner, shared = state.beside(episode.batch, episode.number, drawn, visits)
            belief, visits, tried = shared.rows, shared.visits, visits.copy()
        if episode.verdict is None:
            state.starts[episode.s] += 1
            planner.follow(belief(visits), episode.t, episode.s, episode.q, visits)
        while not episode.over and episode.verdict is not True:
            t, s, q = episode.t, episode.s, episode.q
            first, after = state.problem.first_choice[s : s + 2].tolist()
            if episode.verdict is False:
                a = rarest(tried[first:after], chances[t])
            else:
                a = planner.action(t, s, q, visits)
                if a < 0:
                    planner.follow(belief(visits), t, s, q, visits)
                    a = planner.action(t, s, q, visits)
                if episode.batch is not None and not visits[first + a]:  # others promise as much: not all take the same
                    a = rarest(tried[first:after], chances[t])
            episode.step(a)
            tried[first + a] += 1

    def policy(self, state: Planner) -> Form:
        return state.judged(self.caution)

    def arrays(self, state: Planner) -> dict[str, Kept]:
        return {"starts": Kept(state.starts, 0)}  # the rest is in the counts; every episode begins with a new plan

    def check(self, state: Planner) -> None:
        require_starts(state.starts, state.counts)


@dataclass(frozen=True)
class Belief:
    """What one episode believes about the transitions, as far as they are counted; `seed`: of its draws."""

    planner: Planner
    optimism: float
    seed: int

    def rows(self, visits: NDArray[np.int64]) -> Rows:
        """The model drawn, after choices were taken `visits` times; a share of each choice leads outside."""
        problem, seen = self.planner.problem, self.planner.counts.seen
        drawn = np.random.default_rng(self.seed).standard_gamma(seen.astype(np.float64))
        of_state = np.add.reduceat(visits, problem.first_choice[:-1]) / problem.n_choices
        hopes = hope(visits, np.repeat(of_state, problem.n_choices), self.optimism)
        return self.planner.rows(np.maximum(drawn, _LEAST), hopes)


class Shared:
    """A belief of several episodes, by what had been counted when their batch began, and the plans made for it.

    visits   (choices,) as they were then;  plans   by where they begin: step, state and memory
    """

    def __init__(self, belief: Belief, visits: NDArray[np.int64]) -> None:
        self.visits, self.plans = visits, dict[tuple[int, int, int], Choices]()
        self._rows = belief.rows(visits)

    def rows(self, visits: NDArray[np.int64]) -> Rows:
        """As in `Belief`, whatever was tried in the meantime."""
        return self._rows


class Planner:
    """Plans over the transitions counted so far; `plan` is the one that is acted on, its steps counted from `since`.

    starts   (n_states,) int64: how many episodes started there, undecided
    `kind` of engine: Nodes compile nothing and give the same plans, slowly. `small`: with up to so many situations
    (t, s, q), plans are made for all in which a run could be, wherever choices lead.
    """

    def __init__(
        self, problem: Problem, counts: Counts, kind: type[Layers[Any, Any]] = Words, small: float = _SMALL
    ) -> None:
        self.problem, self.counts = problem, counts
        self.starts = np.zeros(problem.n_states, dtype=np.int64)
        self.plan, self.since = Choices(problem.shape[1:], problem.automaton.horizon, [], problem.choice_type), 0
        self._tried = np.zeros(counts.n_choices, dtype=np.bool_)
        self._known: dict[tuple[int, int, int], Choices] | None = None  # plans already made, of a batch's episode
        self._batch, self._beliefs = range(0), dict[int, Shared]()
        # one more state, outside, where hopes and doubts lead: what that is worth is the plan's to say
        outside = [Single(problem.automaton.with_outcome(verdict)) for verdict in (FALSE, TRUE)]
        letter = np.append(problem.letter, np.int32(problem.automaton.n_letters))
        self._automata, self._letter = outside, letter
        self._moves: list[dict[str, Any]] = [{}, {}]
        self._choices = unsigned_type(problem.most_choices - 1)
        fits = float(np.prod([float(n) for n in problem.shape])) <= small
        self._anywhere = Anywhere(outside[0], problem.letter, self._choices) if fits else None
        self._kind, self._limit = kind, memory_limit(None)  # which takes longer to find out than some plans

    def beside(self, batch: range, number: int, belief: Belief, visits: NDArray[np.int64]) -> tuple[Planner, Shared]:
        """For an episode of a batch: a planner with a plan of its own, and its belief, which others may share."""
        if self._batch != batch:
            self._batch, self._beliefs = batch, {}
        group = (number - batch.start) % _BELIEFS
        if group not in self._beliefs:
            self._beliefs[group] = Shared(belief, visits)
        lane = copy.copy(self)
        lane._known = self._beliefs[group].plans
        return lane, self._beliefs[group]

    def action(self, t: int, s: int, q: int, visits: NDArray[np.int64]) -> int:
        """What to do by the plan; −1 if it does not say, or hoped for what has been tried in the meantime.

        It hoped for no more than any untried choice of this state promises, so such a choice is taken instead.
        """
        here, memory = np.array([s]), np.array([q])
        first, after = self.problem.first_choice[s : s + 2].tolist()
        if self.plan.lists(t - self.since, here, memory)[0]:
            a = int(self.plan.at(t - self.since, here, memory)[0])
            if self._tried[first + a] or not visits[first + a]:
                return a
        untried = np.flatnonzero(visits[first:after] == 0)
        return int(untried[0]) if len(untried) else -1

    def follow(self, rows: Rows, t: int, s: int, q: int, visits: NDArray[np.int64]) -> None:
        """Make the optimistic plan over these rows from there, and act on it."""
        plan = self._known.get((t, s, q)) if self._known is not None else None
        if plan is None:
            plan = self.induct(rows, True, From(self._automata[True], t, q), np.array([s]))
            if self._known is not None:
                self._known[t, s, q] = plan
        self.plan, self.since, self._tried = plan, t, visits > 0

    def judged(self, caution: float) -> Choices:
        """The best policy by the counts, from the states where episodes started."""
        rows = self.rows(self.counts.seen.astype(np.float64), doubt(self.counts.visits, caution))
        return self.induct(rows, False, self.later(False, 0), np.flatnonzero(self.starts))

    def later(self, optimistic: bool, since: int) -> Later:
        """The task from step `since` on, being outside satisfying or violating it."""
        return Later(self._automata[optimistic], since)

    def value(self, form: Form, caution: float) -> float:
        """P of a policy by the counts, from the states where episodes started, in proportion; 0 if none has."""
        first = np.flatnonzero(self.starts)
        if not len(first):
            return 0.0
        rows = self.rows(self.counts.seen.astype(np.float64), doubt(self.counts.visits, caution))
        game = Game(rows, self._automata[False], self._letter, first)
        budget = Budget(f"judging a policy on {self.problem.n_states} states", self._limit)
        found = induct(game, Doubles(True), True, Following(form), threads=1, budget=budget)
        return float(found.entry @ self.starts[first] / self.starts.sum())

    def rows(self, weights: NDArray[np.float64], outside: NDArray[np.float64]) -> Rows:
        """Of the model's states and one more, outside: where each choice leads with a given probability.

        weights (transitions,) in proportion to the chances of the counted transitions of each choice
        """
        counts = self.counts
        choice, target = counts.choice, counts.target
        total = np.bincount(choice, weights, counts.n_choices)
        share = (1 - outside) / np.where(total > 0, total, 1.0)
        doubtful = np.flatnonzero(outside)
        rows = np.concatenate([choice, doubtful, [counts.n_choices]])  # the last: outside there is nothing to do
        order = np.argsort(rows, kind="stable")
        probability = np.concatenate([weights * share[choice], outside[doubtful], [1.0]])[order]
        successor = np.concatenate([target, np.full(len(doubtful) + 1, self.problem.n_states)])
        start = starts(np.bincount(rows, minlength=counts.n_choices + 1))
        first = np.append(self.problem.first_choice, counts.n_choices + 1)
        return Rows(first, start, successor[order].astype(np.int32), Chances(probability, start))

    def induct(self, rows: Rows, optimistic: bool, later: Later, first: NDArray[np.int64]) -> Choices:
        """The best plan from these states on, at a step from which it counts its own.

        Being outside fails; to an optimist it is worth 1, less a hair that grows with time.
        """
        problem, since = self.problem, later.since
        if not later.horizon:
            return Choices(problem.shape[1:], 0, [], problem.choice_type)
        if self._anywhere is not None:
            first = np.arange(problem.n_states)
        game = Game(rows, later, self._letter, first, dict(self._moves[optimistic]))
        budget = Budget(
            f"planning {problem.shape[0]} steps of {problem.n_states * problem.automaton.n_states} product states",
            self._limit,
        )
        if self._anywhere is not None:
            layers = self._anywhere.layers(self._kind, game, since, budget)
        else:
            layers = Known(game, budget, self._choices)
        self._moves[optimistic] = {"moves": game.kept["moves"]} if "moves" in game.kept else {}
        arithmetic = _Optimistic(problem, since) if optimistic else Doubles(True)
        found = solve(layers, arithmetic, True, self._choices).choices
        assert found is not None
        return found.resized((problem.n_states, problem.automaton.n_states))


def require_starts(starts: NDArray[np.int64], counts: Counts) -> None:
    """ValueError if more episodes started, undecided, than steps were counted."""
    if sum(starts.tolist()) > int(counts.seen.sum()):
        raise ValueError("more episodes started than steps were counted")


class _Optimistic(Doubles):
    """Where being outside is worth a little less than 1, the less the later."""

    repeats = False

    def __init__(self, problem: Problem, since: int) -> None:
        super().__init__(True)
        self._h, self._outside, self._since = problem.automaton.horizon, problem.n_states, since
        self.state = problem.automaton.n_states  # of the automaton, outside

    def worth(self, t: int) -> float:
        """Of going outside after step t of the plan."""
        return float(paradise(self._since + t, self._h))

    def sums(self, t: int, edges: Edges, ahead: Values) -> Values:
        values = ahead[edges.child]
        values[self.rows.target[edges.entry] == self._outside] = self.worth(t)
        return row_sums(self.rows.probability[edges.entry] * values, edges.start)

    def tiles(self, engine: Words) -> Tiles:
        return _OptimisticTiles(self, engine)


class _OptimisticTiles(Tiles):
    def __init__(self, arithmetic: _Optimistic, engine: Words) -> None:
        super().__init__(engine, engine.rows.probability, 1, arithmetic.ends(0), True)
        self._arithmetic = arithmetic

    def decided(self, t: int) -> Values:
        row = super().decided(t)
        self.at(row)[self._arithmetic.state] = self._arithmetic.worth(t - 1)
        return row
