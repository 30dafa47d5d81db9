"""What is asked of the readers of model files, whatever the format."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described, flag, whole
from stltool.errors import ModelError, SettingsError, named, near_misses
from stltool.models.fractions import Shares
from stltool.numbers import NumberError, index, shown

if TYPE_CHECKING:
    from stltool.models.mdp import MDP

Deadlocks: TypeAlias = Literal["loop", "error"]

UNIFORM = "uniform"
_NAMED = 4  # states that a message names
_SEARCHED = 10_000  # names that are searched for one that is similar


@dataclass(frozen=True)
class Loading:
    """How a model file is read.

    normalize  rescale rows that miss 1 by rounding (models/normalize.py)
    initial    where runs start, in each with the same probability: the names or numbers of states, or ("uniform",): the
               initial states of the file; empty: as the file says
    deadlocks  states without transitions: "loop" lets them stay, as PRISM and Storm do; "error" refuses them
    """

    normalize: bool = False
    initial: tuple[str, ...] = ()
    deadlocks: Deadlocks = "loop"

    @classmethod
    def of(cls, normalize: object, initial: object, deadlocks: object) -> Loading:
        """From the arguments of a public function."""
        several = list(initial) if isinstance(initial, list | tuple | np.ndarray) else [initial]
        if not several:
            raise SettingsError(f"{named('initial')} names no state; give one, or leave it out")
        several = [] if initial is None else several
        for i, one in enumerate(several):
            if isinstance(one, int | np.integer) and not isinstance(one, bool):
                several[i] = str(whole(one, "initial", 0))
            elif not isinstance(one, str):
                raise SettingsError(
                    f"{named('initial')} is {described(one)}; give a state's name or number, a list of them, or "
                    f"{UNIFORM!r}"
                )
        if UNIFORM in several and len(several) > 1:
            raise SettingsError(f"{named('initial')} names states and {UNIFORM!r}, which are all of them; give one")
        if not isinstance(deadlocks, str) or deadlocks not in get_args(Deadlocks):
            raise SettingsError(
                f"{named('deadlocks')} is {described(deadlocks)}; give {' or '.join(get_args(Deadlocks))}"
            )
        return cls(flag(normalize, "normalize"), tuple(several), deadlocks)  # type: ignore[arg-type]

    @property
    def marked(self) -> bool:
        """Whether the file has to mark initial states."""
        return self.initial in ((), (UNIFORM,))

    def starts(self, marked: NDArray[np.bool_], names: Sequence[str] | None) -> NDArray[np.int64]:
        """(n_states,) the weights of the initial states, of those that a file marks. ModelError if that is open."""
        weight = np.zeros(len(marked), dtype=np.int64)
        states = np.flatnonzero(marked)
        if self.initial == (UNIFORM,) and len(states):
            weight[states] = 1
        elif not self.marked:
            weight[[_state(one, len(marked), names) for one in self.initial]] = 1
        elif len(states) == 1:
            weight[states] = 1
        elif not len(states):
            raise ModelError("no initial state is marked; mark the one that runs start in" + _asking(None))
        else:
            first = [names[s] if names is not None else str(s) for s in states[:_NAMED].tolist()]
            more = f"; and {len(states) - _NAMED} more" if len(states) > _NAMED else ""
            raise ModelError(
                f"{len(states)} initial states are marked ({'; '.join(first)}{more}), and the format has no "
                f"probabilities for them{_asking(UNIFORM)}"
            )
        return weight


def _asking(otherwise: str | None) -> str:
    choose = named("initial", "initial=NAME")
    return f"; choose one with {choose}" + (
        f", or {named('initial', f'initial={otherwise}')} for each with the same probability" if otherwise else ""
    )


def _state(asked: str, n_states: int, names: Sequence[str] | None) -> int:
    if names is not None:
        wanted = asked.replace(" ", "")
        for s in range(n_states):
            if names[s].replace(" ", "") == wanted:
                return s
    with suppress(NumberError):
        if (number := index(asked)) < n_states:
            return number
    known = [names[s] for s in range(n_states)] if names is not None and n_states <= _SEARCHED else []
    hint = f"; {near_misses(asked, known)}" if known else ""
    raise ModelError(f"there is no initial state {shown(asked)}; states are 0 … {n_states - 1}{hint}")


def started(model: MDP, loading: Loading) -> MDP:
    """The model with the initial states that are asked for."""
    if not loading.initial:
        return model
    if model.blackbox is not None:
        raise SettingsError(f"{named('initial')}: {model.name} is a black box, which starts where its environment does")
    weight = loading.starts(model.initial > 0, model.state_names)
    total = int(weight.sum())
    return replace(model, initial=weight / total, exact_initial=Shares(weight, total))
