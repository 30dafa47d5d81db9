"""Formula → TaskAutomaton, in the requested encoding."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import warnings
from collections.abc import Iterator
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from stltool.arguments import described, one_of, whole
from stltool.automata.automaton import Starts, TaskAutomaton
from stltool.automata.flags import flag_automaton
from stltool.automata.history import history_automaton
from stltool.automata.residuals import Residuals
from stltool.automata.running import running_automaton
from stltool.automata.windows import window_automaton
from stltool.errors import FragmentError, InexactEncodingWarning, SettingsError, SizeError
from stltool.logic.feasible import tabulated
from stltool.logic.formula import Formula, atoms, bounded_formula_of, has_past
from stltool.logic.fragment import Fragment, check_fragment
from stltool.logic.shifts import delayed
from stltool.logic.task import Task
from stltool.sizes import require_limit

Encoding = Literal["exact", "paper", "history", "running", "safety"]
ENCODINGS: tuple[Encoding, ...] = get_args(Encoding)
MOST_STATES = 100_000

_MOST_ATOMS = 14  # up to here, all valuations of the predicates can be tabulated


def atoms_of(phi: Formula | Task, encoding: Encoding = "exact") -> tuple[Formula, ...]:
    """The Boolean formulas whose truth the automaton of φ reads in this encoding, left to right."""
    phi = delayed(bounded_formula_of(phi, "the automaton's formula")).formula
    one_of(encoding, "encoding", ENCODINGS)
    if encoding == "paper":
        return tuple(part.psi for part in check_fragment(phi).parts)
    return atoms(phi)


def compile_automaton(
    phi: Formula | Task,
    encoding: Encoding = "exact",
    valuations: NDArray[np.bool_] | None = None,
    memory_limit: int | None = None,
    most_states: int = MOST_STATES,
) -> TaskAutomaton:
    """The automaton that judges φ.

    "exact" covers every bounded formula with as few states as we can find; "paper" uses the flags of [Wang24], with a
    warning if they may disagree with the formula; "history" stores whole windows; "running" judges every step, not only
    the first, for questions about runs that go on for ever; "safety" decides against a run as soon as it fails at any
    step, with a warning. `valuations` (n, n_atoms) restricts the automaton to those that occur in a model (`atoms_of`
    names the columns); by default it reads all. If it grows
    over `most_states`, compilation stops with a SizeError that names the part at fault. Raises FragmentError for
    "paper" only.
    """
    phi = delayed(bounded_formula_of(phi, "compile_automaton's formula")).formula
    read = atoms_of(phi, encoding)
    most_states = whole(most_states, "most_states", least=1)
    if memory_limit is not None:
        require_limit(memory_limit)
    if valuations is None:
        valuations = all_valuations(len(read))
    valuations = truth_table(valuations, len(read), "atoms_of(formula, encoding)")
    if encoding == "paper":
        fragment = check_fragment(phi)
        if not fragment.uniform:
            warnings.warn(
                f"the paper encoding only approximates {phi}: the inner windows differ, so the flags refer to "
                "different start steps",
                InexactEncodingWarning,
                stacklevel=2,
            )
        return flag_automaton(phi, fragment, valuations, "paper", memory_limit)
    if encoding == "history":
        return history_automaton(phi, read, valuations, memory_limit)
    if encoding in ("running", "safety"):
        if encoding == "safety":
            warnings.warn(
                f"the safety encoding judges {phi} at every step, not only at the first: it is for G {phi}",
                InexactEncodingWarning,
                stacklevel=2,
            )
        base = compile_running(phi, valuations, most_states)
        return running_automaton(base, most_states, memory_limit, safety=encoding == "safety")
    return _exact(phi, valuations, most_states, memory_limit)


def compile_running(
    phi: Formula, valuations: NDArray[np.bool_], most_states: int, most_compared: float = math.inf
) -> TaskAutomaton:
    """The automaton of φ for runs that begin at any step of a trace: with `starts`. SizeError as compile_automaton.

    `most_compared` bounds the time: pairs of residuals of which it is found out whether one implies the other.
    """
    if has_past(phi):
        table = Residuals(atoms(phi), most_compared)
        with _nested(phi):
            return window_automaton(phi, table, table.residual(phi), valuations, most_states, any_step=True)
    automaton = _exact(phi, valuations, most_states, None, most_compared)
    nothing = np.zeros((automaton.n_letters, 1), dtype=np.int32)
    return dataclasses.replace(automaton, starts=Starts(nothing, np.array([automaton.initial], dtype=np.int32)))


def truth_table(valuations: object, columns: int, meaning: str) -> NDArray[np.bool_]:
    """The truth assignments (n, columns); SettingsError for anything else."""
    found = described(valuations)
    if isinstance(valuations, np.ndarray):
        if valuations.dtype == np.bool_ and valuations.ndim == 2 and valuations.shape[1] == columns and len(valuations):
            return valuations
        found = f"{valuations.dtype} of shape {valuations.shape}"
    raise SettingsError(
        f"the valuations are {found}; give an array of Booleans with one row or more and {columns} columns, one for "
        f"each of {meaning}"
    )


@contextlib.contextmanager
def _nested(phi: Formula) -> Iterator[None]:
    """SizeError for residuals that are nested deeper than Python calls functions."""
    try:
        yield
    except RecursionError:
        raise SizeError(
            f"what remains to be judged of {phi} becomes nested too deeply; give it shorter windows"
        ) from None


def _exact(
    phi: Formula, valuations: NDArray[np.bool_], most_states: int, memory_limit: int | None,
    most_compared: float = math.inf,
) -> TaskAutomaton:  # fmt: skip
    """The window automaton, or the flags if they are exact and smaller."""
    table = Residuals(atoms(phi), most_compared)
    flags = _exact_flags(phi)
    found: TaskAutomaton | SizeError
    try:
        with _nested(phi):
            found = window_automaton(phi, table, table.residual(phi), valuations, most_states, memory_limit)
        size = found.n_states
    except SizeError as refusal:
        found, size = refusal, most_states + 1
    if flags is not None and math.prod(part.tau + 1 for part in flags.parts) < size:
        truth = tabulated([part.psi for part in flags.parts], table.atoms, valuations)
        with contextlib.suppress(SizeError):  # the error of the first attempt has the remedies
            flagged = flag_automaton(phi, flags, truth, "exact", memory_limit)
            return dataclasses.replace(flagged, atoms=table.atoms, valuations=valuations)
    if isinstance(found, SizeError):
        raise found
    return found


def _exact_flags(phi: Formula) -> Fragment | None:
    """The decomposition, if the paper's flags are exact."""
    try:
        fragment = check_fragment(phi)
    except FragmentError:
        return None
    return fragment if fragment.uniform else None


def all_valuations(n_atoms: int) -> NDArray[np.bool_]:
    """(2^n, n) bool: every truth assignment, the first atom in the lowest bit."""
    if n_atoms > _MOST_ATOMS:
        raise SizeError(
            f"the formula has {n_atoms} different predicates, hence 2^{n_atoms} letters; compile it for a model, in "
            "which few of them occur"
        )
    index = np.arange(1 << n_atoms)[:, None]
    return (index >> np.arange(n_atoms) & 1).astype(np.bool_)
