"""Environments that tests drive: one that follows a script, one that follows a transition table."""

import gymnasium
import numpy as np
from gymnasium import spaces


class Scripted(gymnasium.Env):
    """Returns the given answers one after another: `first` to reset, then those of `answers` to steps."""

    def __init__(self, first, answers=(), observation_space=None, action_space=None):
        self.observation_space = observation_space if observation_space is not None else spaces.Discrete(3)
        self.action_space = action_space if action_space is not None else spaces.Discrete(2)
        self._first, self._answers = first, answers
        self.taken = []

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.taken = []
        return self._first

    def step(self, action):
        self.taken.append(action)
        answer = self._answers[len(self.taken) - 1]
        if isinstance(answer, Exception):
            raise answer
        return answer


class Listed(gymnasium.Env):
    """A toy-text environment: P[s][a] = [(probability, next state, reward, terminated), …]."""

    def __init__(self, P, first=(1.0,), distribution=True):
        self.P = P
        self.observation_space = spaces.Discrete(len(P))
        self.action_space = spaces.Discrete(len(P[0]))
        self._first = np.zeros(len(P))
        self._first[: len(first)] = first
        if distribution:
            self.initial_state_distrib = self._first

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.s = int(self.np_random.choice(len(self.P), p=self._first))
        return self.s, {}

    def step(self, action):
        outcomes = self.P[self.s][action]
        i = int(self.np_random.choice(len(outcomes), p=[outcome[0] for outcome in outcomes]))
        _, self.s, reward, terminated = outcomes[i]
        return self.s, reward, terminated, False, {}
