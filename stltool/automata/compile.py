"""Formula → TaskAutomaton, by the encoding asked for."""

from __future__ import annotations

import warnings
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import TaskAutomaton
from stltool.automata.flags import flag_automaton
from stltool.errors import FragmentError, InexactEncodingWarning, SettingsError, SizeError
from stltool.logic.formula import Formula
from stltool.logic.fragment import Fragment, check_fragment

Encoding = Literal["exact", "paper"]
ENCODINGS: tuple[Encoding, ...] = get_args(Encoding)

_MOST_ATOMS = 16  # all valuations of so many predicates are still a table


def atoms_of(phi: Formula) -> tuple[Formula, ...]:
    """The Boolean formulas whose valuation is a letter of φ's automaton, left to right."""
    return tuple(part.psi for part in check_fragment(phi).parts)


def compile_automaton(
    phi: Formula,
    encoding: Encoding = "exact",
    letters: NDArray[np.bool_] | None = None,
    memory_limit: int | None = None,
) -> TaskAutomaton:
    """The automaton that judges φ.

    `letters` (n_letters, n_atoms) restricts it to the valuations that occur in a model (`atoms_of` names the columns);
    by default it reads all of them. Encoding "exact" is proven equal to the formula and refuses what it does not
    cover; "paper" is the paper's flags, which warn where they may disagree with the formula.
    Raises FragmentError, SizeError.
    """
    if encoding not in ENCODINGS:
        raise SettingsError(f"there is no encoding {encoding!r}; choose one of {', '.join(ENCODINGS)}")
    fragment = check_fragment(phi)
    if not fragment.uniform:
        if encoding == "exact":
            raise FragmentError(_different_windows(phi, fragment))
        warnings.warn(
            f"encoding paper is an approximation of {phi}: its inner windows differ, so its flags speak of different "
            "start steps",
            InexactEncodingWarning,
            stacklevel=2,
        )
    if letters is None:
        letters = all_valuations(len(fragment.parts))
    return flag_automaton(phi, fragment, letters, encoding, memory_limit)


def all_valuations(n_atoms: int) -> NDArray[np.bool_]:
    """(2^n, n) bool: every truth assignment, the first atom in the lowest bit."""
    if n_atoms > _MOST_ATOMS:
        raise SizeError(
            f"the formula reads {n_atoms} different predicates, 2^{n_atoms} letters; compile it for a model, which "
            "realises few of them, or name common parts"
        )
    index = np.arange(1 << n_atoms)[:, None]
    return (index >> np.arange(n_atoms) & 1).astype(np.bool_)


def _different_windows(phi: Formula, fragment: Fragment) -> str:
    shortest = min(fragment.parts, key=lambda part: part.tau)
    windows = ", ".join(str(part) for part in fragment.parts)
    message = (
        f"encoding exact covers equal inner windows; here they differ: {windows}; "
        "make them equal, or use encoding paper and accept its approximation"
    )
    span = shortest.formula.span or phi.span
    return span.show(message) if span is not None else message
