"""The exact automaton of any bounded formula: one small machine a part, then their product.

The root (or its negation) is a conjunction of parts (residuals.py splits outer G over ∧ and outer F over ∨):

    G[a,b] φ         a *watch*: every start k in a…b owes φ; judged at k + D, D = horizon(φ)
    F[a,b] φ         a watch over ¬φ whose violation is a success; success is remembered
    φ U[a,b] ψ       over atoms: open, done or broken; the verdict's clock closes the window
    anything else    a *single* start: the residual itself, its windows counted down

A watch needs no clock for its outer window: which starts count is said by verdict_t. Its state holds the starts that
are still pending, each with its age and residual, oldest first. Three ways to hold them, the smallest is taken:

    oldest   drop a start whose debt an older one's implies: the older is judged first, and one violation decides
    each     keep every pending start: needs no waiting for a window that begins late
    single   no starts but the first, the outer window inside the residual: when pending sets explode

A conjunction is false as soon as one part is, true when all are; so a part needs memory after its own horizon only as
"has succeeded". Every machine is minimised before they are multiplied, and the product again.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import FALSE, UNDECIDED, Part, TaskAutomaton
from stltool.automata.automaton import TRUE as HOLDS
from stltool.automata.minimise import coarsest_partition, quotient
from stltool.automata.reach import reachable
from stltool.automata.residuals import FALSE as NO
from stltool.automata.residuals import TRUE as YES
from stltool.automata.residuals import Letter, Residual, Residuals
from stltool.errors import SizeError
from stltool.logic.formula import Formula
from stltool.logic.formula import horizon as formula_horizon

Method: TypeAlias = Literal["oldest", "each", "single", "until"]
_Pending: TypeAlias = tuple[tuple[int, Residual], ...]  # (age, residual), oldest first
_State: TypeAlias = tuple[str, int, _Pending]

# outcomes of a part machine's state, beside the verdict's clock
_OPEN, _BAD, _GOOD = 0, 1, 2

_FIRST_BUDGET = 3000  # states that each method may explore before the others have had their turn
_LONGEST_EACH = 500  # pending starts a state of method "each" may hold
_WORTH_TRYING = 8  # times the best size so far


class Explosion(Exception):
    """A machine grew over its budget."""


@dataclass(frozen=True, eq=False)
class Machine:
    """A part's machine: delta (n_letters, n_states), outcome and name of each state, state 0 first.

    From step `first` on, a state that is _BAD says that the part fails, until step `last`; _GOOD that it holds.
    """

    part: Part
    delta: NDArray[np.int32]
    outcome: NDArray[np.int8]
    names: tuple[str, ...]
    first: int
    last: int
    good_at_end: bool


def window_automaton(
    phi: Formula, table: Residuals, root: Residual, valuations: NDArray[np.bool_], most_states: int
) -> TaskAutomaton:
    """The automaton of φ, whose residual in `table` is `root`, over the given valuations of `table.atoms`."""
    letters = [tuple(row) for row in valuations.tolist()]
    flipped = table.node(root)[0] in ("or", "F")  # judge ¬φ, a conjunction, and turn the verdicts round
    judged = table.negation(root) if flipped else root
    node = table.node(judged)
    parts = list(node[1]) if node[0] == "and" else [judged]
    machines = [_machine(table, part, letters, most_states, flipped) for part in parts]
    return _multiply(phi, table, machines, valuations, flipped, most_states)


# --------------------------------------------------------------------------------------------------- one part


def _machine(table: Residuals, x: Residual, letters: Sequence[Letter], most_states: int, flipped: bool) -> Machine:
    """The smallest machine found for a part: all methods on a small budget, then on a larger one."""
    success = table.node(x)[0] == "F"
    watched = table.negation(x) if success else x
    methods: list[Method] = ["single"]
    kind, *operands = table.node(watched)
    if kind in ("U", "R") and all(table.horizon(y) == 0 for y in operands[2:]):
        methods = ["until"]
    elif kind in ("G", "atom"):
        methods.insert(0, "oldest")
        if operands[0] > 0 and not success and table.horizon(_owed(table, watched, "each")) <= _LONGEST_EACH:
            methods.insert(1, "each")
    for budget in sorted({min(most_states, size) for size in (_FIRST_BUDGET, 10 * _FIRST_BUDGET, most_states)}):
        found: list[Machine] = []
        for method in methods:
            room = min([budget, *(_WORTH_TRYING * len(machine.outcome) + 16 for machine in found)])
            # a debt can stay open to its last step, each step a state of its own
            longest = table.horizon(_owed(table, watched, method))
            if longest >= room or (method == "single" and found and len(found[0].outcome) <= longest):
                continue
            try:
                negated = success and method != "single"
                found.append(_explore(table, watched if negated else x, letters, room, method, negated, flipped))
            except Explosion:
                continue
        if found:
            return min(found, key=lambda machine: len(machine.outcome))
    raise _too_large(table, x, most_states)


def _owed(table: Residuals, x: Residual, method: Method) -> Residual:
    """What every start owes: φ of a watch over G[a,b] φ; a single start owes everything; an until its right side."""
    node = table.node(x)
    if method == "until":
        return int(node[4])
    return int(node[3]) if method != "single" and node[0] == "G" else x


def _explore(
    table: Residuals, x: Residual, letters: Sequence[Letter], budget: int, method: Method, success: bool, flipped: bool
) -> Machine:
    """Follow every letter from the start until nothing new appears, then minimise."""
    a, b = table.node(x)[1:3] if method == "until" or (method != "single" and table.node(x)[0] == "G") else (0, 0)
    owed = _owed(table, x, method)
    delay = table.horizon(owed)
    start: _State = ("begins", 0, ()) if method == "single" else ("runs", 0, ())
    if a and method in ("oldest", "until"):
        start = ("waits", a, ())
    if method == "single":
        step = _single_step(table, owed)
    elif method == "until":
        step = _until_step(table, x)
    else:
        step = _watch_step(table, owed, delay, method)
    # a part reads its own atoms only: letters that agree on them are explored once
    own = sorted(table.atoms_in(x))
    seen = [tuple(value and i in own for i, value in enumerate(letter)) for letter in letters]
    distinct = sorted(set(seen))
    states, delta = explore(start, distinct, step, budget)
    number = {letter: i for i, letter in enumerate(distinct)}
    delta = delta[[number[letter] for letter in seen]]
    outcome = np.array([{"bad": _BAD, "good": _GOOD}.get(state[0], _OPEN) for state in states], dtype=np.int8)
    if success:  # a violated ¬φ is a success; it is never forgotten
        outcome = np.where(outcome == _BAD, _GOOD, _OPEN).astype(np.int8)
    classes = coarsest_partition(delta, outcome)
    small, representative = quotient(delta, classes)
    described = table.formula(table.negation(x) if success != flipped else x)
    part = Part(
        formula=described,
        owed=table.formula(table.negation(owed) if success != flipped else owed),
        delay=delay,
        method=method,
        explored=len(states),
        states=len(small[0]),
    )
    return Machine(
        part=part,
        delta=small,
        outcome=outcome[representative],
        names=tuple(_name(table, states[i], owed, method, success != flipped) for i in representative),
        first=a + delay if method not in ("single", "until") else 0,
        last=b + delay if method != "single" else table.horizon(x),
        good_at_end=not success and not (method == "until" and table.node(x)[0] == "U"),
    )


def _watch_step(table: Residuals, owed: Residual, delay: int, method: Method) -> Callable[[_State, Letter], _State]:
    """One letter for a watch: pending starts progress, a new one begins, the one of age D is judged."""

    def step(state: _State, letter: Letter) -> _State:
        if state[0] == "waits":
            return _next_wait(state)
        if state[0] == "bad" and method == "oldest":
            return state
        pending = [(age + 1, table.progress(x, letter)) for age, x in state[2]]
        pending.append((0, table.progress(owed, letter)))
        bad = pending[0][0] == delay and pending[0][1] == NO
        if bad and method == "oldest":
            return ("bad", 0, ())
        kept: list[tuple[int, Residual]] = []
        for age, x in pending:
            if age == delay or x == YES:
                continue
            if method == "oldest" and any(table.implies(older, x) for _, older in kept):
                continue
            kept.append((age, x))
        return ("bad" if bad else "runs", 0, tuple(kept))

    return step


def _next_wait(state: _State) -> _State:
    return ("waits", state[1] - 1, ()) if state[1] > 1 else ("runs", 0, ())


def _until_step(table: Residuals, x: Residual) -> Callable[[_State, Letter], _State]:
    """One letter for φ U[a,b] ψ or φ R[a,b] ψ over atoms: after a steps only the verdict's clock counts."""
    kind, _, _, left, right = table.node(x)
    # U ends well when ψ holds and badly when φ fails first; R ends badly when ψ fails and well when φ holds first
    ends, ended, breaks, broken = (YES, "good", NO, "bad") if kind == "U" else (NO, "bad", YES, "good")

    def step(state: _State, letter: Letter) -> _State:
        if state[0] in ("bad", "good"):
            return state
        if state[0] == "runs" and table.progress(right, letter) == ends:
            return (ended, 0, ())
        if table.progress(left, letter) == breaks:
            return (broken, 0, ())
        return _next_wait(state) if state[0] == "waits" else state

    return step


def _single_step(table: Residuals, owed: Residual) -> Callable[[_State, Letter], _State]:
    """One letter for the only start: its residual progresses until it is true or false."""

    def step(state: _State, letter: Letter) -> _State:
        if state[0] in ("bad", "good"):
            return state
        x = table.progress(owed if state[0] == "begins" else state[2][0][1], letter)
        if x in (NO, YES):
            return ("good" if x == YES else "bad", 0, ())
        return ("runs", 0, ((0, x),))

    return step


def explore(
    start: Hashable, letters: Sequence[Letter], step: Callable[..., Hashable], budget: int
) -> tuple[list, NDArray[np.int32]]:  # type: ignore[type-arg]
    """All states reachable from `start`, in the order found, and delta (n_letters, n_states)."""
    index = {start: 0}
    states = [start]
    rows: list[list[int]] = []
    for state in states:  # grows while we read it
        row = []
        for letter in letters:
            after = step(state, letter)
            number = index.get(after)
            if number is None:
                number = index[after] = len(states)
                states.append(after)
                if number >= budget:
                    raise Explosion
            row.append(number)
        rows.append(row)
    return states, np.array(rows, dtype=np.int32).T.copy()


def _too_large(table: Residuals, x: Residual, most_states: int) -> SizeError:
    phi = table.formula(x)
    return SizeError(
        f"the automaton of {phi} grows over {most_states} states; shorten its inner windows, coarsen the time step, "
        "split it into tasks, or raise most_states"
    )


# --------------------------------------------------------------------------------------------------- the product


def _multiply(
    phi: Formula,
    table: Residuals,
    machines: Sequence[Machine],
    valuations: NDArray[np.bool_],
    flipped: bool,
    most_states: int,
) -> TaskAutomaton:
    """The reachable synchronous product with the conjunction's verdicts, minimised."""
    horizon = formula_horizon(phi)
    # valuations that no part tells apart are multiplied once
    stacked, letter_of = np.unique(np.concatenate([m.delta for m in machines], axis=1), axis=0, return_inverse=True)
    letter_of = letter_of.ravel()
    cuts = np.cumsum([m.delta.shape[1] for m in machines])[:-1]
    machines = [replace(m, delta=d) for m, d in zip(machines, np.split(stacked, cuts, axis=1), strict=True)]
    index, delta = _reachable(machines, most_states, phi)
    changes = sorted({0, *(t for m in machines for t in (m.first, m.last, m.last + 1) if t < horizon), horizon})
    rows = np.array([_conjunction(machines, index, t, horizon) for t in changes], dtype=np.int8)
    if flipped:
        rows = np.where(rows == UNDECIDED, UNDECIDED, HOLDS + FALSE - rows).astype(np.int8)
    classes = coarsest_partition(delta, rows)
    delta, representative = quotient(delta, classes)
    different = [0] + [i for i in range(1, len(rows)) if (rows[i] != rows[i - 1]).any()]
    names = tuple("; ".join(m.names[index[j, i]] for j, m in enumerate(machines)) for i in representative)
    letters, merged = np.unique(delta, axis=0, return_inverse=True)
    return TaskAutomaton(
        formula=phi,
        encoding="exact",
        exact=True,
        atoms=table.atoms,
        valuations=valuations,
        letter_of=merged.ravel()[letter_of].astype(np.int32),
        delta=np.ascontiguousarray(letters),
        initial=0,
        horizon=horizon,
        verdict_starts=np.array([changes[i] for i in different], dtype=np.int64),
        verdict_rows=np.ascontiguousarray(rows[different][:, representative]),
        state_names=names,
        parts=tuple(machine.part for machine in machines),
    )


def _reachable(
    machines: Sequence[Machine], most_states: int, phi: Formula
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """index (n_machines, n_states): each reachable combination; delta over them."""
    if len(machines) == 1:
        return np.arange(machines[0].delta.shape[1])[None, :], machines[0].delta
    sizes = [machine.delta.shape[1] for machine in machines]
    strides = np.cumprod([1, *sizes[:-1]], dtype=object)
    if int(strides[-1]) * sizes[-1] >= 2**62:
        raise _product_too_large(phi, sizes, most_states)
    weights = strides.astype(np.int64)

    def after(codes: NDArray[np.int64]) -> NDArray[np.int64]:
        total = np.zeros((machines[0].delta.shape[0], len(codes)), dtype=np.int64)
        for weight, machine, part in zip(weights, machines, _split(codes, sizes), strict=True):
            total += weight * machine.delta[:, part]
        return total

    def guard(n_states: int) -> None:
        if n_states > most_states:
            raise _product_too_large(phi, sizes, most_states)

    known, delta = reachable(0, after, guard)
    return np.stack(_split(known, sizes)), delta


def _split(codes: NDArray[np.int64], sizes: Sequence[int]) -> list[NDArray[np.int64]]:
    parts = []
    for size in sizes:
        codes, part = np.divmod(codes, size)
        parts.append(part)
    return parts


def _product_too_large(phi: Formula, sizes: Sequence[int], most_states: int) -> SizeError:
    product = " × ".join(str(size) for size in sizes)
    return SizeError(
        f"the automaton of {phi} is a product of parts with {product} states, over {most_states} of them reachable; "
        "check the parts one by one, shorten their windows, or raise most_states"
    )


def _conjunction(machines: Sequence[Machine], index: NDArray[np.int64], t: int, horizon: int) -> NDArray[np.int8]:
    """The verdict at step t: false if a part has failed, true if all hold."""
    failed = np.zeros(index.shape[1], dtype=np.bool_)
    holding = np.ones(index.shape[1], dtype=np.bool_)
    for machine, states in zip(machines, index, strict=True):
        outcome = machine.outcome[states]
        over = t >= machine.last
        good = outcome == _GOOD
        bad = (outcome == _BAD) & (machine.first <= t <= machine.last)
        if machine.good_at_end:
            good |= over & ~bad
        else:
            bad |= over & ~good
        failed |= bad
        holding &= good
    verdict = np.where(failed, FALSE, np.where(holding, HOLDS, UNDECIDED)).astype(np.int8)
    assert t < horizon or (verdict != UNDECIDED).all()
    return verdict


# --------------------------------------------------------------------------------------------------- names


def _name(table: Residuals, state: _State, owed: Residual, method: Method, negated: bool) -> str:
    """What a state remembers, told of φ where ¬φ is watched: a debt of ¬φ is a start at which φ is still possible.

    A name speaks of starts, never of the verdict: which starts count is the verdict's clock to say.
    """
    kind, waits, pending = state
    if method == "oldest" and table.horizon(owed) == 0 and kind not in ("waits", "begins"):
        # F[a,b] ψ or G[a,b] ψ with ψ of one state: what counts is whether ψ has occurred, or failed, in the window
        psi = table.formula(table.negation(owed) if negated else owed)
        if negated:
            return f"{psi} seen" if kind == "bad" else f"{psi} not seen yet"
        return f"{psi} has failed" if kind == "bad" else f"{psi} so far"
    if kind == "waits":
        return f"{_steps(waits)} before the window"
    if kind == "begins":
        return "at the start"
    if kind in ("good", "bad"):
        ended = "succeeded" if (kind == "good") != negated else "failed"
        if method in ("single", "until"):
            return ended
        return f"a start has {ended}" if method == "oldest" else f"the start {_steps(table.horizon(owed))} ago {ended}"
    if not pending:
        return "nothing pending"
    age, x = pending[0]
    kind, *rest = table.node(x)
    # an F[0,D] ψ that was owed, alone or as an alternative, and is open still: ψ has not been seen since the start
    alternatives = table.node(owed)[1] if table.node(owed)[0] == "or" else (owed,)
    if kind == "F" and method != "single" and ("F", 0, rest[1] + age + 1, rest[2]) in map(table.node, alternatives):
        node = table.node(rest[2])
        if rest[0] == 0 and node[0] == "atom":
            text = f"{table.atoms[node[1]]} {'not seen ' if node[2] else ''}for {_steps(age + 1)}"
            return text if len(pending) == 1 else f"{text} (and {len(pending) - 1} later)"
    left = table.formula(table.negation(x) if negated else x)
    text = f"{'possible' if negated else 'due'} since {_steps(age)}: {left}"
    return text if len(pending) == 1 else f"{text} (and {len(pending) - 1} later)"


def _steps(n: int) -> str:
    return f"{n} step{'' if n == 1 else 's'}"
