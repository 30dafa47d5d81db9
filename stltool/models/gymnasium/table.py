"""The transition table of a toy-text environment, env.unwrapped.P[s][a] = [(probability, next state, reward,
terminated), …] → matrices. P may also be an array (S, A, S) of probabilities, or lists with an array (S,) at [s][a].

A state that runs enter with `terminated` is absorbing: runs end and stay there. Probabilities are kept as given.
"""

from __future__ import annotations

import itertools
import math
import operator
from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described
from stltool.errors import ModelError
from stltool.models.gymnasium.replay import Outcome, require_listed, require_replays
from stltool.models.gymnasium.spaces import Observations
from stltool.models.normalize import HINT, MOST_MISSING

_RESETS = 100  # that must agree before a first state is considered the only one
# wrappers that change neither observations nor actions nor dynamics; a table has no time limit
_HARMLESS = {"TimeLimit", "OrderEnforcing", "PassiveEnvChecker", "RecordEpisodeStatistics", "HumanRendering"}


def without_table(env: Any, title: str, observations: Observations, first_action: int, n_actions: int) -> str:
    """Why the transitions of the environment are not listed; "" if they are."""
    wrapper, inner = env, getattr(env, "unwrapped", env)
    while wrapper is not inner:
        kind = type(wrapper)
        reward_only = any(base.__name__ == "RewardWrapper" for base in kind.__mro__)
        if not reward_only and not (kind.__module__.startswith("gymnasium.") and kind.__name__ in _HARMLESS):
            return f"{title}: the wrapper {kind.__name__} may change what its transition table describes"
        wrapper = wrapper.env
    P, n_states = getattr(inner, "P", None), observations.n_states
    none = (
        f"{title} has no transition table, env.unwrapped.P[s][a] = [(probability, next state, reward, terminated), …]"
    )
    if not observations.plain or observations.starts != (0,) or first_action != 0:
        return none + " over states and actions numbered from 0"
    try:
        fits = len(P) == n_states and all(len(P[s]) == n_actions for s in range(len(P)))  # type: ignore[arg-type,index]
        if fits and (isinstance(P[0][0], list | tuple) or np.shape(P[0][0]) == (n_states,)):  # type: ignore[index]
            return ""
    except (TypeError, LookupError):
        pass
    if isinstance(P, np.ndarray) and P.shape == (n_actions, n_states, n_states):
        raise ModelError(
            f"{title}: P has shape {P.shape}, (actions, states, states); give P[s][a], an array "
            f"{(n_states, n_actions, n_states)}: P.transpose(1, 0, 2), or use table=False"
        )
    return none


def read_table(
    env: Any, title: str, observations: Observations, n_actions: int, apart: bool, normalize: bool
) -> tuple[list[Any], NDArray[np.float64]]:
    """A matrix per action, and the initial distribution; with `apart` over 2·S states, S + s for runs ended in s.

    The environment is run for up to 2000 steps as a check (replay.py). `normalize` lets rows miss 1 by up to 1/1000.
    """
    from scipy.sparse import coo_array

    require_listed(env, title)
    P, n_states = env.unwrapped.P, observations.n_states
    rows: list[list[list[Outcome]]] = [[[] for _ in range(n_actions)] for _ in range(n_states)]
    listed = isinstance(P[0][0], list | tuple) and not _numbers(P[0][0])
    for s in range(n_states):
        for a in range(n_actions):
            if listed:
                outcomes = [_outcome(outcome, title, s, a, n_states) for outcome in P[s][a]]
            else:
                outcomes = _of_row(P[s][a], title, s, a, n_states)
            total = math.fsum(p for p, _, _, _ in outcomes)
            if abs(total - 1) > (MOST_MISSING if normalize else 1e-9):
                hint = f"; {HINT}" if abs(total - 1) <= MOST_MISSING else ""
                raise ModelError(
                    f"{title}: the probabilities of P[{s}][{a}] sum to {total:.12g}, not 1; correct the table, or use "
                    f"table=False{hint}"
                )
            rows[s][a] = [outcome for outcome in outcomes if outcome[0] > 0]
    initial = _initial(env, title, n_states)
    require_replays(env, title, rows, initial, listed)
    if apart:
        ends, ended, size = set(range(n_states, 2 * n_states)), n_states, 2 * n_states
        initial = np.concatenate([initial, np.zeros(n_states)])
    else:
        ends, ended, size = _ends(rows, np.flatnonzero(initial).tolist(), title), 0, n_states
    matrices = []
    for a in range(n_actions):
        entries = [
            (s, s2 + (ended if terminated else 0), p)
            for s in range(n_states) if s not in ends for p, s2, _, terminated in rows[s][a]
        ]  # fmt: skip
        entries += [(s, s, 1.0) for s in ends]
        source, target, share = zip(*entries, strict=True)
        matrices.append(coo_array((share, (source, target)), shape=(size, size)).tocsr())  # adds duplicates
    return matrices, initial


def _outcome(outcome: Any, title: str, s: int, a: int, n_states: int) -> Outcome:
    try:
        p, s2, reward, terminated = outcome
        p, s2 = float(p), operator.index(s2)
        if not (0 <= p <= 1 + 1e-9 and 0 <= s2 < n_states and isinstance(terminated, bool | np.bool_)):
            raise ValueError
    except (TypeError, ValueError):
        raise ModelError(
            f"{title}: P[{s}][{a}] contains {outcome!r}, which is not a (probability, next state 0 … {n_states - 1}, "
            "reward, terminated); correct the table, or use table=False"
        ) from None
    return p, s2, reward, bool(terminated)


def _numbers(row: Sequence[Any]) -> bool:
    return bool(row) and all(isinstance(p, Real) for p in row)


def _of_row(row: Any, title: str, s: int, a: int, n_states: int) -> list[Outcome]:
    """The outcomes of a row (S,) of probabilities, which says nothing of rewards and ends."""
    try:
        array = np.asarray(row, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    bad = np.flatnonzero(~((array >= 0) & (array <= 1 + 1e-9))) if array.shape == (n_states,) else None
    if bad is None or bad.size:
        what = f"{described(row)}" if bad is None else f"{array[bad[0]]} for state {bad[0]}"
        raise ModelError(
            f"{title}: P[{s}][{a}] is {what}; give the probabilities of the {n_states} states, or use table=False"
        )
    return [(float(array[s2]), int(s2), 0.0, False) for s2 in np.flatnonzero(array)]


def _initial(env: Any, title: str, n_states: int) -> NDArray[np.float64]:
    given = getattr(env.unwrapped, "initial_state_distrib", None)
    if given is not None:
        return np.array(given, dtype=np.float64)
    first = {operator.index(env.reset(seed=seed)[0]) for seed in range(_RESETS)}
    if len(first) > 1:
        raise ModelError(
            f"{title} has a transition table and starts in several states, but has no initial_state_distrib "
            "(S,); add it, or use table=False"
        )
    point = np.zeros(n_states)
    point[first.pop()] = 1.0
    return point


def _ends(rows: list[list[list[Outcome]]], first: list[int], title: str) -> set[int]:
    """The states in which runs end and stay. ModelError if a run can be in one of them both before and at its end:
    no MDP over these states behaves like that."""
    going_on, todo = set(first), list(first)
    while todo:
        for _, s2, _, terminated in itertools.chain.from_iterable(rows[todo.pop()]):
            if not terminated and s2 not in going_on:
                going_on.add(s2)
                todo.append(s2)
    ends = set()
    for s, outcomes in enumerate(map(itertools.chain.from_iterable, rows)):
        entered = {s2 for _, s2, _, terminated in outcomes if terminated}
        both = entered & going_on
        if both and s in going_on:
            raise ModelError(
                f"{title}: state {min(both)} is reached both with terminated=True and before the end, so the table "
                "is not an MDP over these states; use ends='apart'"
            )
        ends |= entered
    return ends - going_on  # only unreachable states lead into those that runs continue from
