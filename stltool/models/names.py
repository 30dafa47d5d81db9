"""States by their names: the inverse of `MDP.state_name`."""

from __future__ import annotations

from functools import cached_property
from itertools import islice

from stltool.errors import near_misses
from stltool.models.mdp import MDP

_COMPARED = 5000  # names that a misspelled one is compared with


class StateLookup:
    """Finds states of a model by name; spaces need not be written as in the model. Without names, by number."""

    def __init__(self, model: MDP) -> None:
        self._model = model

    def find(self, name: str) -> int | None:
        """The state of that name; None if there is none."""
        model = self._model
        if model.state_names is None:
            text = name.strip()
            number = int(text) if text.isascii() and text.isdecimal() and len(text) < 19 else -1
            return number if 0 <= number < model.n_states and str(number) == text else None
        found = self._exact.get(name)
        return found if found is not None else self._bare.get(_bare(name))

    def hint(self, name: str) -> str:
        """What may have been meant by a name that there is not."""
        model = self._model
        if model.state_names is None:
            return f"its states are numbered from 0 to {model.n_states - 1}"
        return near_misses(name, islice(self._exact, _COMPARED))

    @cached_property
    def _exact(self) -> dict[str, int]:
        assert self._model.state_names is not None
        return {name: s for s, name in enumerate(self._model.state_names)}

    @cached_property
    def _bare(self) -> dict[str, int]:
        found: dict[str, int] = {}
        several = set()
        for name, s in self._exact.items():
            if found.setdefault(_bare(name), s) != s:
                several.add(_bare(name))
        return {name: s for name, s in found.items() if name not in several}


def _bare(text: str) -> str:
    return "".join(text.split())
