"""The interface of a method: a frozen dataclass whose fields are its settings, with five hooks.

    start     begins a run: returns the state that its learning changes, whatever that is
    episode   plays one episode, and learns from it
    policy    the current policy of the run
    arrays    the arrays of the state that a checkpoint stores             (optional)
    check     whether stored arrays are consistent                         (optional)

A learner has no state: the same object can be used for any number of runs. docs/learning.md shows one.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from stltool.choices import Form
from stltool.display import Card
from stltool.errors import SettingsError
from stltool.kernels import Group
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.kept import Kept
from stltool.learning.problem import Problem
from stltool.learning.settings import check_settings

State = TypeVar("State")


class Learner(ABC, Generic[State]):
    """A method with its settings; see the module docstring. Subclasses are frozen dataclasses.

    name        the name of the method in reports and on the command line; default: the class's name
    side_by_side   whether episodes may be played side by side, where a black box takes many runs at once
                (`stltool.models.environment.Batched`): between two steps of one, others are played too, so that
                `counts` and the state may have changed
    kernels     groups of compiled kernels that its episodes use: they are loaded before the first one
    published   whether it is run as in [Wang24]: the policy remembers the paper's flags, and episodes take T + τ
                transitions, two more than the horizon
    """

    name: ClassVar[str] = ""
    kernels: ClassVar[tuple[Group, ...]] = ()
    published: ClassVar[bool] = False
    side_by_side: ClassVar[bool] = True

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "name" not in vars(cls):
            cls.name = cls.__name__

    def __post_init__(self) -> None:
        check_settings(self)

    def _repr_html_(self) -> str:
        settings = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}  # type: ignore[arg-type]
        return Card(f"{type(self).__name__}: {summary(type(self))}", [settings]).html()

    @abstractmethod
    def start(self, problem: Problem, counts: Counts, rng: np.random.Generator) -> State:
        """The state of a new run. `counts` always contains all transitions so far, including the current episode."""

    @abstractmethod
    def episode(self, state: State, episode: Episode) -> None:
        """Play one episode: `episode.step(choice)` until it is over, or earlier. All randomness from `episode.rng`."""

    @abstractmethod
    def policy(self, state: State) -> NDArray[Any] | Form:
        """The policy to be judged, which does not explore: a table, or a form, as accepted by `Policy`."""

    def arrays(self, state: State) -> Mapping[str, NDArray[Any] | Kept]:
        """Everything that learning has changed, to be written to a checkpoint and read back in place.

        Arrays of fixed shapes, or `Kept` for values with a range. Default: the state, if it is a dict.
        """
        if not isinstance(state, Mapping) or not all(isinstance(array, np.ndarray) for array in state.values()):
            raise SettingsError(
                f"{self.name} cannot be checkpointed: its state is a {type(state).__name__}; make it a dict of numpy "
                "arrays, or define arrays(state)"
            )
        return state

    def check(self, state: State) -> None:
        """Raise ValueError, with a sentence, if arrays read from a checkpoint contradict each other."""


def require_learner(learner: Learner[Any]) -> None:
    """SettingsError unless the learner's settings can be recorded."""
    if not dataclasses.is_dataclass(learner):
        raise SettingsError(
            f"{type(learner).__name__} is not a dataclass, so its settings are not known; "
            "decorate the class with @dataclass(frozen=True)"
        )


def rarest(visits: NDArray[Any], chance: float) -> int:
    """The choice taken least, ties broken by `chance` in [0, 1): count-based exploration."""
    least = np.flatnonzero(visits == visits.min())
    return int(least[int(chance * len(least))])


def summary(cls: type[Learner[Any]]) -> str:
    """The method in one line: the first line of its class docstring."""
    return next(iter((cls.__doc__ or "").strip().splitlines()), "")
