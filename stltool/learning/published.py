"""The engine of the methods as published (docs/reproduction.md): a surrogate table, a replay memory, ε-greedy episodes.

They differ in four things: whether each step updates online, what enters the memory (nothing, the factual tuple, or the
counterfactual ones), how tuples are drawn, and, not in [Wang24], which share of a batch is factual. Numbers are drawn
at an episode's beginning: two for each step's action, then `batch` for each replay.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from stltool.automata.flags import SCALES
from stltool.kernels import Group
from stltool.kernels.tuples import Replay
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.kept import Kept
from stltool.learning.learner import Learner
from stltool.learning.problem import Problem
from stltool.learning.replay import Batches
from stltool.learning.schedule import Decaying
from stltool.learning.settings import setting
from stltool.learning.tables import SurrogateTable
from stltool.logic.fragment import check_fragment
from stltool.sizes import require_memory


@dataclass(frozen=True, kw_only=True)
class Published(Decaying, Learner["PublishedRun"]):
    """One of the published methods; see the module docstring."""

    kernels: ClassVar[tuple[Group, ...]] = ("published",)
    published: ClassVar[bool] = True
    online: ClassVar[bool] = True
    replays: ClassVar[bool] = True
    counterfactual: ClassVar[bool] = False
    weighted: ClassVar[bool] = False

    alpha: float = setting(0.01, "learning rate", above=0, most=1)
    gamma: float = setting(0.999, "discount", least=0, most=1)
    scale: str = setting(
        "published",
        "the reward under an outer G: χ − 0.5 (published: as the authors ran it), r − 0.9 with r = −e^(−βχ), that is "
        "−1.9 or −0.9 (printed: Table I as it stands), or χ − 0.9 (shifted)",
        choices=tuple(SCALES),
    )

    def start(self, problem: Problem, counts: Counts, rng: np.random.Generator) -> PublishedRun:
        return PublishedRun(self, problem)

    def episode(self, state: PublishedRun, episode: Episode) -> None:
        explore = episode.rng.random((episode.length, 2))
        epsilon, draws = self.epsilon(episode.number), self._draws(episode)
        if episode.environment.tables is not None:
            state.whole(episode, explore, epsilon, draws)
        else:
            state.step_by_step(episode, explore, epsilon, draws)

    def _draws(self, episode: Episode) -> NDArray[np.float64]:
        """(replays, batch): the random numbers for the replays of an episode."""
        return np.empty((0, 0))

    def memory_of(self, problem: Problem) -> Replay:
        """The method's replay memory, empty."""
        return replay_memory(self, problem, capacity=1, period=0, n_facts=0)

    def policy(self, state: PublishedRun) -> NDArray[Any]:
        return state.table.policy_table()

    def arrays(self, state: PublishedRun) -> dict[str, Kept]:
        return state.arrays()

    def check(self, state: PublishedRun) -> None:
        state.check()


@dataclass(frozen=True, kw_only=True)
class Replaying(Batches, Published):
    """A published method with a replay memory."""

    def _draws(self, episode: Episode) -> NDArray[np.float64]:
        return episode.rng.random((-(-episode.length // self.period), self.batch))

    def memory_of(self, problem: Problem) -> Replay:
        return replay_memory(self, problem, capacity=self.memory, period=self.period, n_facts=0)


@dataclass(frozen=True, kw_only=True)
class Counterfactual(Replaying):
    """A published method whose memory contains counterfactual tuples."""

    counterfactual: ClassVar[bool] = True

    factual_share: float | None = setting(
        None,
        "share of each batch drawn only from factual tuples, kept in a separate memory (the closing question of "
        "[Wang24]); none: as published",
        least=0,
        most=1,
    )

    def memory_of(self, problem: Problem) -> Replay:
        n_facts = round(self.factual_share * self.batch) if self.factual_share is not None else 0
        return replay_memory(self, problem, capacity=self.memory, period=self.period, n_facts=n_facts)


def replay_memory(method: Published, problem: Problem, capacity: int, period: int, n_facts: int) -> Replay:
    """An empty memory of `capacity` transitions, of which `n_facts` of a batch come from a factual one."""
    automaton = problem.automaton
    imagined = np.empty(0, dtype=np.int32)
    if method.counterfactual:  # flags 0 … τ−1 only: the published off-by-one
        registers = automaton.registers
        imagined = np.flatnonzero((registers < registers.max(axis=0)).all(axis=1)).astype(np.int32)
    n_weights = automaton.n_states * len(imagined) if method.weighted else 0
    require_memory(
        2 * 28 * capacity + 8 * n_weights, f"a replay memory of {capacity} transitions", "set a smaller memory"
    )
    kept = capacity if n_facts else 1
    return Replay(
        online=method.online,
        period=period,
        rows=np.zeros((capacity, 5), dtype=np.int32),
        weight=np.zeros(capacity),
        place=np.zeros(2, dtype=np.int64),
        imagined=imagined,
        after=np.ascontiguousarray(automaton.delta[:, imagined]),
        weighted=method.weighted,
        closeness=_closeness(automaton.registers, imagined) if method.weighted else np.empty((0, 0)),
        n_facts=n_facts,
        facts=np.zeros((kept, 5), dtype=np.int32),
        facts_place=np.zeros(2, dtype=np.int64),
    )


def _closeness(registers: NDArray[np.int32], imagined: NDArray[np.int32]) -> NDArray[np.float64]:
    distance = np.zeros((len(registers), len(imagined)))
    for flag in registers.T:
        distance += np.abs(flag[:, None] - flag[imagined])
    return np.exp(-distance)


class PublishedRun:
    """What a run of a published method changes: its table, and its memory."""

    def __init__(self, method: Published, problem: Problem) -> None:
        outer = check_fragment(problem.automaton.formula).outer
        self.table = SurrogateTable(problem, method.alpha, method.gamma, method.scale, outer)
        self.problem, self.replay = problem, method.memory_of(problem)

    def whole(self, episode: Episode, explore: NDArray[np.float64], epsilon: float, draws: NDArray[np.float64]) -> None:
        """An episode in a simulated model at once: bit for bit the same as step by step."""
        from stltool.kernels import learning

        environment, automaton, n = episode.environment, self.problem.automaton, len(explore)
        assert environment.generator is not None
        states, actions = np.empty(n + 1, dtype=np.int32), np.empty(n, dtype=np.int32)
        states[0] = episode.s
        learning.surrogate_episode(
            environment.tables, self.problem.letter, automaton.delta, automaton.initial, self.table.kernel,
            self.replay, environment.generator.random(n), explore, epsilon, draws, states, actions,
        )  # fmt: skip
        episode.record(states, actions)

    def step_by_step(
        self, episode: Episode, explore: NDArray[np.float64], epsilon: float, draws: NDArray[np.float64]
    ) -> None:
        """The same with only reset and step. s₀ is not read, as published."""
        delta, q = self.problem.automaton.delta, self.problem.automaton.initial
        for t, (u, chance) in enumerate(explore.tolist()):
            s, a = episode.s, self.choice(episode.s, q, u < epsilon, chance)
            episode.step(a)
            after = int(delta[self.problem.letter[episode.s], q])
            self.observe(t, s, q, a, episode.s, after, draws)
            q = after

    def choice(self, s: int, q: int, explores: bool, chance: float) -> int:
        from stltool.kernels import learning

        n = int(self.problem.n_choices[s])
        return int(chance * n) if explores else int(learning.greedy(self.table.Q[s, q], n, chance))

    def observe(self, t: int, s: int, q: int, a: int, s2: int, q2: int, draws: NDArray[np.float64]) -> None:
        from stltool.kernels import learning

        letter = int(self.problem.letter[s2])
        learning.surrogate_observe(self.table.kernel, self.replay, draws, letter, t, s, q, a, s2, q2)

    def arrays(self) -> dict[str, Kept]:
        replay, problem = self.replay, self.problem
        row = np.array([problem.n_states, problem.automaton.n_states, problem.most_choices,
                        problem.n_states, problem.automaton.n_states]) - 1  # fmt: skip
        return {
            "Q": Kept(self.table.Q, -self.table.greatest, self.table.greatest),
            "rows": Kept(replay.rows, 0, row),
            "weight": Kept(replay.weight, 0, 1),
            "place": Kept(replay.place, 0, [len(replay.rows) - 1, len(replay.rows)]),
            "facts": Kept(replay.facts, 0, row),
            "facts_place": Kept(replay.facts_place, 0, [len(replay.facts) - 1, len(replay.facts)]),
        }

    def check(self) -> None:
        replay = self.replay
        for name, rows, place in (("rows", replay.rows, replay.place), ("facts", replay.facts, replay.facts_place)):
            following, held = place.tolist()
            if (held < len(rows) and following != held) or rows[held:].any():
                raise ValueError(f"{name} hold {held} transitions, and the next one is {following}: that cannot be")
            s, q, a, s2, q2 = rows[:held].T
            if (a >= self.problem.n_choices[s]).any():
                raise ValueError(f"{name} hold a choice that its state does not have")
            if (self.problem.automaton.delta[self.problem.letter[s2], q] != q2).any():
                raise ValueError(f"{name} hold a step that the automaton does not take")
        held = replay.place[1]
        if (replay.weight[:held] <= 0).any() != (held > 0 and len(replay.imagined) == 0) or replay.weight[held:].any():
            raise ValueError("weight does not fit the tuples that are held")
