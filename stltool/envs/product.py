"""A product of model and task as a Gymnasium environment, and the counterfactual transitions its learners can use.

The task is known: what remains to be remembered of a run is the automaton state q, and the time. A transition
(s, a, s') of the model says what would have happened in every undecided (t, q) in which a run can be at s:

    (t, s, q) —a→ (t + 1, s', δ(L(s'), q)),     whose reward and end follow from the verdict at t + 1

[Wang24, eq. 14]; for reward machines [Icarte22]. These are as good as real ones, since the model's rows depend neither
on t nor on q.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeAlias

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from stltool.arguments import whole
from stltool.automata import TRUE, UNDECIDED
from stltool.automata.flags import surrogate_reward
from stltool.automata.reach import open_pairs
from stltool.checking.shield import Shield
from stltool.envs.model import Moves
from stltool.errors import ModelError, SettingsError
from stltool.logic.fragment import check_fragment
from stltool.product import Product

Observation: TypeAlias = dict[str, Any]
Observed: TypeAlias = dict[str, NDArray[Any]]


class Counterfactuals(NamedTuple):
    """n transitions as arrays, in the order in which replay buffers take them.

    observations, next_observations   name → (n,), as in the observation space
    actions (n,) int64, rewards (n,) float64, terminated (n,) bool
    """

    observations: Observed
    actions: NDArray[np.int64]
    rewards: NDArray[np.float64]
    next_observations: Observed
    terminated: NDArray[np.bool_]

    def rows(self) -> list[tuple[Observation, int, float, Observation, bool]]:
        """One by one: (observation, action, reward, next observation, done), as reward-machine libraries have them."""

        def each(observed: Observed) -> list[Observation]:
            return [dict(zip(observed, values, strict=True)) for values in zip(*observed.values(), strict=True)]

        columns = (self.actions.tolist(), self.rewards.tolist())
        return list(
            zip(each(self.observations), *columns, each(self.next_observations), self.terminated.tolist(), strict=True)
        )


class ProductEnv(gymnasium.Env[Observation, int]):
    """See `to_gymnasium`.

    `info` contains the name of the model's state, the mask (A,) int8 of available actions, what is remembered in words
    (`memory`), with counterfactuals "crm-experience", with a shield whether it `replaced` the action, and once the
    episode has ended `is_success`, whether the task is satisfied.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - the base class declares it so

    def __init__(
        self,
        product: Product,
        unavailable: Literal["error", "stay"] = "error",
        reward: Literal["exact", "surrogate"] = "exact",
        counterfactuals: int = 0,
        shield: Shield | None = None,
        refused: Literal["replace", "error"] = "replace",
    ) -> None:
        self.product, self.reward, self._shield, self._refused = product, reward, shield, refused
        S, Q = product.shape
        sensing = product.model.sensing
        own: Any = sensing.space if sensing is not None else None
        self._real = getattr(own, "dtype", None) is not None  # one array; others are shown by their cells
        here: dict[str, Any] = {"observation": own} if self._real else {"state": spaces.Discrete(S)}
        left = {"allowance": spaces.Box(0.0, 1.0, (1,), np.float32)} if shield is not None and shield.levels else {}
        self.observation_space: Any = spaces.Dict(
            {**here, "memory": spaces.Discrete(Q), "to_go": spaces.Discrete(product.horizon + 1), **left}
        )
        self._moves = Moves(product.model, unavailable, product.horizon)
        self.action_space: Any = self._moves.actions
        self._automaton, self._letter = product.automaton, product.letter
        self._surrogate = _surrogate_of(product) if reward == "surrogate" else None
        self._k = counterfactuals
        self._q, self._t, self._over, self._spent = product.automaton.initial, 0, True, 0

    # ---------------------------------------------------------------------------------------------- episodes

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        super().reset(seed=seed)
        self._moves.reset(self.np_random, begin=seed is not None)
        self._q, self._t, self._over = self.product.enter(self._moves.state, self._automaton.initial), 0, False
        self._spent = 0
        return self._observed(), self._info()

    def step(self, action: int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take an action. If the first state has decided the task, the first step ends the episode without a move."""
        self._moves.require(action)
        if self._over:
            raise ModelError("step was called after the end of an episode; call reset() first")
        if self._ends(self._t, self._q):
            self._over = True
            return self._observed(), self._rewarded(self._t, self._q), True, False, self._info(False)
        t, s, q, before = self._t, self._moves.state, self._q, self._observed()
        taken = self._shielded(int(action)) if self._shield is not None else int(action)
        replaced, action = taken != action, taken
        self._moves.step(action)
        self._t, self._q = t + 1, self.product.enter(self._moves.state, q)
        self._over = self._ends(self._t, self._q)
        after, reward = self._observed(), self._rewarded(self._t, self._q)
        info = self._info(replaced)
        if self._k:
            real = (before, int(action), reward, after, self._over)
            seen = (before["observation"], after["observation"]) if self._real else None
            others = self.counterfactuals(s, int(action), self._moves.state, self._k, seen)
            info["crm-experience"] = [real, *others.rows()]
        return after, reward, self._over, False, info

    def action_masks(self) -> NDArray[np.bool_]:
        """(A,): the actions that are available in the current state, and allowed by the shield, if there is one; under
        the name that sb3-contrib looks for."""
        mask = self._moves.mask
        if self._shield is not None:
            s, model = self._moves.state, self.product.model
            number = model.choice_action[model.choice_start[s] : model.choice_start[s + 1]]
            mask[number] = self._shield.allows(self._t, s, self._q, self._spent)
        return mask

    def _shielded(self, action: int) -> int:
        """The action, or the best one if the shield refuses it; what it costs is spent."""
        assert self._shield is not None
        t, s, q, model = self._t, self._moves.state, self._q, self.product.model
        actions = model.choice_action[model.choice_start[s] : model.choice_start[s + 1]]
        if not self.action_masks()[action]:
            if self._refused == "error":
                names = [model.action_names[a] for a in np.flatnonzero(self.action_masks())]
                raise ModelError(
                    f"action {model.action_names[action]} is refused by the shield in state {model.state_name(s)} at "
                    f"step {t}, which allows {', '.join(names)}; follow info['action_mask'], or make the environment "
                    "with refused='replace'"
                )
            action = int(actions[self._shield.best(t, s, q)])
        choice = int(np.flatnonzero(actions == action)[0])
        self._spent = self._shield.spend(t, s, q, choice, self._spent)
        return action

    def _observed(self) -> Observation:
        here = self._moves.observed if self._real else self._moves.state
        observed = self.observation(self._t, here, self._q)
        if self._shield is not None and self._shield.levels:
            observed["allowance"] = np.array([self._shield.allowance(self._spent)], dtype=np.float32)
        return observed

    def observation(self, t: int, s: Any, q: int) -> Observation:
        """What is observed in model state s and automaton state q after step t; for a `Situation` of
        `Policy.from_function`: observation(here.step, here.state, here.memory). If states are cells of real
        observations, s is such an observation."""
        here = {"observation": np.asarray(s, dtype=self._dtype)} if self._real else {"state": np.int64(s)}
        return {**here, "memory": np.int64(q), "to_go": np.int64(self.product.horizon - t)}

    @property
    def _dtype(self) -> Any:
        return self.observation_space["observation"].dtype

    def _info(self, replaced: bool | None = None) -> dict[str, Any]:
        info = {**self._moves.info(), "memory": self._automaton.describe(self._q)}
        if self._shield is not None:
            info["action_mask"] = self.action_masks().astype(np.int8)
            if replaced is not None:
                info["replaced"] = replaced
        if self._over:
            info["is_success"] = bool(self._automaton.verdicts(self._t)[self._q] == TRUE)
        return info

    def _ends(self, t: int, q: int) -> bool:
        if self._surrogate is not None:
            return t >= self.product.horizon
        return bool(self._automaton.verdicts(t)[q] != UNDECIDED)

    def _rewarded(self, t: int, q: int) -> float:
        if self._surrogate is not None:
            return float(self._surrogate[q])
        return float(self._automaton.verdicts(t)[q] == TRUE)

    # --------------------------------------------------------------------------------------- counterfactuals

    @cached_property
    def _pairs(self) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """For each letter, the steps t and automaton states q (n,) of a run that has read it at t."""
        automaton = self._automaton
        if self._surrogate is None:
            return open_pairs(automaton)
        reached = [np.unique(row).astype(np.int64) for row in automaton.delta]
        steps = np.arange(automaton.horizon)
        return [(np.repeat(steps, len(q)), np.tile(q, len(steps))) for q in reached]

    def counterfactuals(
        self, s: int, action: int, s2: int, most: int | None = None, observed: tuple[Any, Any] | None = None
    ) -> Counterfactuals:
        """The transitions of the product that a transition of the model is evidence for, the real one among them.

        s, s2   model states;  action  its number
        most    so many of them, drawn at random with replacement (by `np_random`); None: all of them
        observed   if states are cells of real observations: what was observed in s and in s2

        One for every step t and automaton state q that a run in s can have with nothing decided, whatever it read
        before; for the surrogate reward, decided or not. Raises SettingsError for numbers out of range.
        """
        model, automaton, h = self.product.model, self._automaton, self.product.horizon
        s, s2 = (whole(state, name, 0, model.n_states - 1) for state, name in ((s, "s"), (s2, "s2")))
        action = whole(action, "action", 0, model.n_actions - 1)
        t, q = self._pairs[self._letter[s]]
        if most is not None:
            most = whole(most, "most", 0)
            drawn = self.np_random.integers(len(t), size=most if len(t) else 0)
            t, q = t[drawn], q[drawn]
        n = len(t)
        q2 = automaton.delta[self._letter[s2], q].astype(np.int64)
        if self._surrogate is not None:
            rewards, over = self._surrogate[q2], t + 1 >= h
        else:
            verdict = np.empty(n, dtype=np.int8)
            for step in np.unique(t):
                there = t == step
                verdict[there] = automaton.verdicts(int(step) + 1)[q2[there]]
            rewards, over = (verdict == TRUE).astype(np.float64), verdict != UNDECIDED
        return Counterfactuals(
            {**self._repeated(s, n, observed, 0), "memory": q, "to_go": h - t},
            np.full(n, action),
            rewards,
            {**self._repeated(s2, n, observed, 1), "memory": q2, "to_go": h - t - 1},
            over,
        )

    def _repeated(self, s: int, n: int, observed: tuple[Any, Any] | None, which: int) -> dict[str, NDArray[Any]]:
        """What is observed of a model state, n times."""
        if not self._real:
            return {"state": np.full(n, s)}
        if observed is None:
            raise SettingsError("states are cells of real observations; give observed=, what was seen in s and s2")
        return {"observation": np.repeat(np.asarray(observed[which], dtype=self._dtype)[None], n, axis=0)}


def _surrogate_of(product: Product) -> NDArray[np.float64]:
    """(Q,): the published reward of arriving in each automaton state."""
    if not product.automaton.register_names:
        raise SettingsError(
            f"the surrogate reward is of the paper's flags, and this product has the encoding "
            f"{product.automaton.encoding}; build it with encoding='paper'"
        )
    return surrogate_reward(product.automaton, check_fragment(product.formula).outer)
