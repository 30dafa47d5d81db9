"""model-based: learned transition counts, optimism about the unknown, planning with the induction of the checker.

Acting (R-max [Brafman02]): a choice taken fewer than `known_after` times leads to a paradise that
satisfies the task; others follow their counted frequencies. Paradise is worth a thousandth less than 1, and less the
later it is entered: near-certain success comes first, and exploring is not postponed. The plan is recomputed whenever a
choice becomes known, and at the beginning of every episode. Once the task is violated, the rest of the episode takes
the choices tried least.

Any state may follow any other, whatever was counted: plans say what to do wherever a run can be.

The policy that is judged trusts counts with caution: of n(s,a) visits, successor s' has the share n(s,a,s') / (n + κ),
and the rest fails. So a choice seen once is not preferred to one that has proved itself many times.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from stltool.automata import FALSE, TRUE
from stltool.checking.induction import Budget, Doubles, Edges, Game, Layers, Single, Values, solve
from stltool.checking.induction.anywhere import Anywhere, Later
from stltool.checking.induction.arithmetic import row_sums
from stltool.checking.induction.tiled import Tiles
from stltool.checking.induction.words import Words
from stltool.choices import Choices, Form
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.kept import Kept
from stltool.learning.learner import Learner, rarest
from stltool.learning.problem import Problem
from stltool.learning.settings import setting
from stltool.models.rows import Chances, Rows, starts
from stltool.sizes import memory_limit, unsigned_type

_HAIR = 1e-3  # how much less than 1 paradise is worth: far above rounding, below any gain worth exploring for


@dataclass(frozen=True, kw_only=True)
class ModelBased(Learner["Planner"]):
    """Acts on an optimistic plan over the counted transitions; a cautious plan gives the judged policy."""

    name: ClassVar[str] = "model-based"
    side_by_side: ClassVar[bool] = False  # an episode counts its own visits

    known_after: int = setting(1, "visits after which planning uses the counts of a choice, not optimism", least=1)
    caution: float = setting(0.1, "κ in the judged policy's weight n / (n + κ) for a choice seen n times", least=0)

    def start(self, problem: Problem, counts: Counts, rng: np.random.Generator) -> Planner:
        return Planner(problem, counts)

    def episode(self, state: Planner, episode: Episode) -> None:
        chances = episode.rng.random((episode.length, 2))[:, 1].tolist()
        visits = state.counts.visits
        self.replan(state, visits, 0)
        while not episode.over and episode.verdict is not True:
            t, s = episode.t, episode.s
            first, after = state.problem.first_choice[s : s + 2].tolist()
            if episode.verdict is False:
                a = rarest(visits[first:after], chances[t])
            else:
                a = state.action(t, s, episode.q)
            episode.step(a)
            visits[first + a] += 1
            if visits[first + a] == self.known_after:
                self.replan(state, visits, t + 1)

    def replan(self, state: Planner, visits: NDArray[np.int64], t: int) -> None:
        """The optimistic plan of the steps from t on, after choices were taken `visits` times."""
        rows = state.rows(visits, self.known_after, 0.0)
        state.plan, state.since = state.induct(rows, True, t), t

    def policy(self, state: Planner) -> Form:
        return state.induct(state.rows(state.counts.visits, 1, self.caution), False, 0)

    def arrays(self, state: Planner) -> dict[str, Kept]:
        return {}  # all that is learned is in the counts; every episode begins with a new plan


class Planner:
    """Plans over the transitions counted so far; `plan` is the one that is acted on, its steps counted from `since`.

    `kind` of engine: Nodes compile nothing and give the same plans, slowly.
    """

    def __init__(self, problem: Problem, counts: Counts, kind: type[Layers[Any, Any]] = Words) -> None:
        self.problem, self.counts = problem, counts
        self.plan, self.since = Choices(problem.shape[1:], problem.automaton.horizon, [], problem.choice_type), 0
        # one more state, outside, where unknown choices and doubts lead: what that is worth is the plan's to say
        outside = [Single(problem.automaton.with_outcome(verdict)) for verdict in (FALSE, TRUE)]
        letter = np.append(problem.letter, np.int32(problem.automaton.n_letters))
        self._automata, self._letter = outside, letter
        self._moves: list[dict[str, Any]] = [{}, {}]
        self._choices = unsigned_type(problem.most_choices - 1)
        self._anywhere = Anywhere(outside[0], problem.letter, self._choices)
        self._kind, self._limit = kind, memory_limit(None)  # which takes longer to find out than some plans

    def action(self, t: int, s: int, q: int) -> int:
        """What the plan does."""
        return int(self.plan.at(t - self.since, np.array([s]), np.array([q]))[0])

    def rows(self, visits: NDArray[np.int64], known_after: int, caution: float) -> Rows:
        """Of the model's states and one more, outside: where unknown choices and doubts lead."""
        counts, outside = self.counts, self.problem.n_states
        choice, target, seen = counts.choice, counts.target, counts.seen
        trusted = visits >= max(known_after, 1)
        kept = trusted[choice]
        doubtful = np.arange(counts.n_choices) if caution else np.flatnonzero(~trusted)
        doubt = np.where(trusted, caution / (visits + caution) if caution else 0.0, 1.0)[doubtful]
        rows = np.concatenate([choice[kept], doubtful, [counts.n_choices]])  # the last: outside there is nothing to do
        order = np.argsort(rows, kind="stable")
        probability = np.concatenate([seen[kept] / (visits[choice[kept]] + caution), doubt, [1.0]])[order]
        successor = np.concatenate([target[kept], np.full(len(doubtful) + 1, outside)])[order].astype(np.int32)
        start = starts(np.bincount(rows, minlength=counts.n_choices + 1))
        first = np.append(self.problem.first_choice, counts.n_choices + 1)
        return Rows(first, start, successor, Chances(probability, start))

    def induct(self, rows: Rows, optimistic: bool, since: int) -> Choices:
        """The best plan from step `since` on, whose steps it counts from there.

        Being outside fails; to an optimist it is worth 1, less a hair that grows with time.
        """
        problem, h = self.problem, self.problem.automaton.horizon
        if since == h:
            return Choices(problem.shape[1:], 0, [], problem.choice_type)
        later = Later(self._automata[optimistic], since)
        game = Game(rows, later, self._letter, np.arange(problem.n_states), dict(self._moves[optimistic]))
        budget = Budget(
            f"planning {h} steps of {problem.n_states * problem.automaton.n_states} product states", self._limit
        )
        layers = self._anywhere.layers(self._kind, game, since, budget)
        self._moves[optimistic] = {"moves": game.kept["moves"]} if "moves" in game.kept else {}
        arithmetic = _Optimistic(problem, since) if optimistic else Doubles(True)
        found = solve(layers, arithmetic, True, self._choices).choices
        assert found is not None
        return found.resized((problem.n_states, problem.automaton.n_states))


class _Optimistic(Doubles):
    """Where being outside is worth a little less than 1, the less the later."""

    repeats = False

    def __init__(self, problem: Problem, since: int) -> None:
        super().__init__(True)
        self._h, self._outside, self._since = problem.automaton.horizon, problem.n_states, since
        self.state = problem.automaton.n_states  # of the automaton, outside

    def worth(self, t: int) -> float:
        """Of going outside after step t of the plan."""
        return 1.0 - _HAIR * (1 + (self._since + t) / self._h)

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
