"""The machine of one part: the memory needed to judge a watch, an until or a single start.

A watch G[a,b] φ needs no clock for its outer window: verdict_t determines which starts count. Its state holds the
pending starts, each with its age and residual, oldest first. There are three ways to store them, of which the one with
the fewest states is used:

    oldest   drop a start whose obligation is implied by an older one's: that is judged first, and one violation decides
    each     keep every pending start: no need to wait for a window that begins late
    single   only the first start, with the outer window inside the residual: for pending sets that explode

A machine whose part looks back has the registers of registers.py beside that, which its starts share; a register that
nothing pending depends on is empty. Every machine is minimised.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from stltool.automata.automaton import Part, Remembered, Starts, Text
from stltool.automata.minimise import coarsest_partition, quotient
from stltool.automata.registers import Recorder, Register, Registers
from stltool.automata.residuals import FALSE as NO
from stltool.automata.residuals import TRUE as YES
from stltool.automata.residuals import ByLetter, Letter, Progression, Residual, Residuals, by_letter
from stltool.errors import SizeError
from stltool.sizes import require_memory

Method: TypeAlias = Literal["oldest", "each", "single", "until"]
_State: TypeAlias = tuple[str, int, tuple[int, ...], tuple[Residual, ...]]
"""Kind, steps until the window begins, and ages and residuals of the pending starts, oldest first."""
_T = TypeVar("_T")

# outcomes of a machine's state, which the clock of the verdict completes
OPEN, BAD, GOOD = 0, 1, 2

_FIRST_BUDGET = 3000  # states that each method may explore before the others get their turn
_LONGEST_EACH = 500  # pending starts per state of method "each"
_WORTH_TRYING = 8  # times the best size so far
_DEAR = 10 * _FIRST_BUDGET  # beyond it, only smaller results are sought
_HARDLY_WORSE = 1.001  # times the smallest size to be expected
_STATE_BYTES = 1000  # per state during exploration, without its successors


@dataclass(frozen=True, eq=False)
class Machine:
    """The machine of one part; state 0 is initial.

    delta    (n_own, n_states) int32: over the letters that it distinguishes
    reads    (n_letters,): the own letter for each letter
    outcome  (n_states,) int8: GOOD if the part holds; BAD if it fails, which counts from step `first` to step `last`
    memory   what a state remembers
    starts   where runs begin, over the own letters; only at step 0 unless it was made for any step
    """

    part: Part
    delta: NDArray[np.int32]
    reads: NDArray[np.int64]
    outcome: NDArray[np.int8]
    memory: Callable[[int, Text], Remembered]
    first: int
    last: int
    good_at_end: bool
    starts: Starts

    @property
    def n_states(self) -> int:
        return int(self.delta.shape[1])


def machine_of(
    table: Residuals,
    x: Residual,
    letters: Sequence[Letter],
    most_states: int,
    allowed: int,
    flipped: bool,
    any_step: bool = False,
) -> Machine:
    """The smallest machine found for a part: all methods on a small budget, then on a larger one.

    With `flipped`, ¬φ is judged instead of φ, but names and formulas refer to φ. With `any_step`, runs may begin at
    any step of a trace. Raises SizeError if it grows over `most_states`, or does not fit into `allowed` bytes.
    """
    success = table.node(x)[0] == "F"
    watched = table.negation(x) if success else x
    # a part reads only its own atoms: letters that agree on them are explored once
    own = {index for index in table.atoms_in(x) if index < len(table.atoms)}
    projected = [tuple(value and i in own for i, value in enumerate(letter)) for letter in letters]
    distinct = sorted(set(projected))
    number = {letter: i for i, letter in enumerate(distinct)}
    reads = np.array([number[letter] for letter in projected], dtype=np.int64)
    searches: list[_Search] = []
    recorder = Recorder(table, table.past_in(x), distinct)
    fitting = allowed // (_STATE_BYTES + 4 * len(distinct))
    most = min(most_states, fitting)
    reach = math.inf if any_step else table.horizon(x)
    idle, all_found = Exploration([recorder.empty], lambda registers: recorder.read(registers).registers), True
    large = recorder.too_many(most, reach) if any_step else None
    if any_step:
        all_found = large is None and idle.grow(most)
    for method in _methods(table, watched, success):
        negated = success and method != "single"
        searches.append(_Search(table, watched if negated else x, method, recorder, negated, idle))
    for budget in sorted({min(most, size) for size in (_FIRST_BUDGET, _DEAR, most)}) if all_found else ():
        found: list[Machine] = []
        for search in searches:
            room = min([budget, *(max(m.n_states, min(_WORTH_TRYING * m.n_states, _DEAR)) + 16 for m in found)])
            if search.method == "single" and found and found[0].n_states <= _HARDLY_WORSE * search.delay:
                continue
            # an obligation can stay open to its last step, and each step is a state, unless it looks back
            if search.grow(room, 0 if recorder.own else search.delay):
                found.append(search.machine(reads, flipped))
        if found:
            return min(found, key=lambda machine: machine.n_states)
        if (large := recorder.too_many(most, reach)) is not None:  # exploring on would be in vain
            break
    phi = table.formula(x)
    if large is not None:
        past = table.past[large[0]]
        raise SizeError(
            f"the automaton of {phi} grows over {most} states: {table.atom(len(table.atoms) + large[0])} alone has "
            f"{large[1]:.3g}, since it must remember when {table.formula(past.right)} held in the last {past.b} steps; "
            "widen its window, or begin it closer to now"
        )
    if fitting < most_states:
        require_memory(
            (fitting + 1) * (_STATE_BYTES + 4 * len(distinct)),
            f"the automaton of {phi}, over {fitting} states and {len(distinct)} letters,",
            "shorten its inner windows, or compile it for a model in which few letters occur",
            allowed,
        )
    raise SizeError(
        f"the automaton of {phi} grows over {most_states} states; shorten its inner windows, coarsen the time step, "
        "split it into tasks, or raise most_states"
    )


def _methods(table: Residuals, watched: Residual, success: bool) -> list[Method]:
    kind, *operands = table.node(watched)
    if kind in ("U", "R") and all(table.horizon(y) == 0 for y in operands[2:]):
        return ["until"]
    if kind == "G" and operands[0] > 0 and not success and table.horizon(operands[2]) <= _LONGEST_EACH:
        return ["oldest", "each", "single"]
    return ["oldest", "single"] if kind in ("G", "atom") else ["single"]


def _obligation(table: Residuals, x: Residual, method: Method) -> Residual:
    """The obligation of every start: φ for a watch G[a,b] φ, all of x for a single start, ψ for φ U ψ."""
    node = table.node(x)
    if method == "until":
        return int(node[4])
    return int(node[3]) if method != "single" and node[0] == "G" else x


# --------------------------------------------------------------------------------------------------- exploring


class Exploration(Generic[_T]):
    """The states reachable from `starts`, in order of discovery; `successors` gives one state per letter.

    The order is breadth first, by letter: however states are merged, each class is first reached by the same shortest
    word, so the numbering of a minimised machine does not depend on how it was found.
    """

    def __init__(self, starts: Sequence[_T], successors: Callable[[_T], Sequence[_T]]) -> None:
        self.states = list(starts)
        self._successors = successors
        self._number = {state: i for i, state in enumerate(starts)}
        self._rows = array("i")
        self._done = 0
        self._layer_end = len(starts)  # states before it are reached by words no longer than the current length
        self._depth = 0

    def grow(self, most: int, longest: int = 0) -> bool:
        """Continue until all states are found; False if there are more than `most`.

        `longest`: the length of a word known to reach a new state with each of its letters.
        """
        states, number, successors, rows = self.states, self._number, self._successors, self._rows
        while self._done < len(states):
            if self._done == self._layer_end:
                self._layer_end, self._depth = len(states), self._depth + 1
            if len(states) + max(0, longest - self._depth - 1) > most:
                return False
            for after in successors(states[self._done]):
                q = number.setdefault(after, len(states))
                if q == len(states):
                    states.append(after)
                rows.append(q)
            self._done += 1
        return len(states) <= most

    @property
    def delta(self) -> NDArray[np.int32]:
        """(n_letters, n_states)"""
        rows = np.frombuffer(self._rows, dtype=np.int32).reshape(len(self.states), -1)
        return np.array(rows.T, order="C")


class _Search:
    """The machine of x by one method, found state by state; `negated`: of a watch over ¬φ, inverted."""

    def __init__(
        self,
        table: Residuals,
        x: Residual,
        method: Method,
        recorder: Recorder,
        negated: bool,
        idle: Exploration[Registers],
    ) -> None:
        """`idle`: the registers with which runs begin."""
        self.table, self.x, self.method, self.negated = table, x, method, negated
        self.obligation = _obligation(table, x, method)
        self.delay = table.horizon(self.obligation)
        node = table.node(x)
        self.window = node[1:3] if method == "until" or (method != "single" and node[0] == "G") else (0, 0)
        start = _of_kind("begins" if method == "single" else "runs")
        if self.window[0] and method in ("oldest", "until"):
            start = _of_kind("waits", self.window[0])
        self._recorder, self._idle = recorder, idle
        self._steps: dict[Registers, Callable[[_State], Sequence[_State]]] = {}
        self._plain = None if recorder.own else Exploration([start], self._step(recorder.read(()).after))
        self._looking_back = Exploration([(registers, start) for registers in idle.states], self._successors)
        self.grow = self._looking_back.grow if self._plain is None else self._plain.grow

    def _successors(self, state: tuple[Registers, _State]) -> Sequence[tuple[Registers, _State]]:
        registers, inner = state
        reading = self._recorder.read(registers)
        step = self._steps.get(registers)
        if step is None:
            step = self._steps[registers] = self._step(reading.after)
        return [(self._live(now, to), to) for now, to in zip(reading.registers, step(inner), strict=True)]

    def _step(self, after: Progression) -> Callable[[_State], Sequence[_State]]:
        if self.method == "single":
            return _single(after, self.obligation)
        if self.method == "until":
            return _until(self.table, self.x, after)
        return _watch(self.table, self.obligation, self.delay, self.method, after)

    def _live(self, registers: Registers, state: _State) -> Registers:
        """The registers that can still matter; the others are emptied."""
        kind, _, _, pending = state
        if kind in ("good", "bad") and (self.method in ("single", "until", "oldest")):
            return self._recorder.empty
        if self.method != "single":
            return registers  # new starts begin at every step
        own, todo, live = self._recorder.own, list(pending), set[int]()
        while todo:
            for number in self.table.past_in(todo.pop()):
                if number not in live:
                    live.add(number)
                    todo += [x for _, x in registers[own.index(number)]]
        return tuple(register if number in live else () for number, register in zip(own, registers, strict=True))

    def machine(self, reads: NDArray[np.int64], flipped: bool) -> Machine:
        """The machine that was found, minimised."""
        table, x, method, obligation = self.table, self.x, self.method, self.obligation
        if self._plain is not None:
            states, registers, delta = self._plain.states, list[Registers](), self._plain.delta
        else:
            delta = self._looking_back.delta
            states = [state for _, state in self._looking_back.states]
            registers = [register for register, _ in self._looking_back.states]
        outcome = np.array([{"bad": BAD, "good": GOOD}.get(state[0], OPEN) for state in states], dtype=np.int8)
        if self.negated:  # a violation of ¬φ is a success and is never forgotten
            outcome = np.where(outcome == BAD, GOOD, OPEN).astype(np.int8)
        classes = coarsest_partition(delta, outcome)
        small, representative = quotient(delta, classes)
        turned = self.negated != flipped
        (a, b), delay = self.window, self.delay
        return Machine(
            part=Part(
                formula=table.formula(table.negation(x) if turned else x),
                obligation=table.formula(table.negation(obligation) if turned else obligation),
                delay=delay,
                method=method,
                explored=len(states),
                states=small.shape[1],
            ),
            delta=small,
            reads=reads,
            outcome=outcome[representative],
            memory=_Memory(
                table,
                [states[i] for i in representative.tolist()],
                obligation,
                method,
                turned,
                _Recall(table, self._recorder.own, [registers[i] for i in representative.tolist() if registers]),
            ),
            first=a + delay if method not in ("single", "until") else 0,
            last=b + delay if method != "single" else table.horizon(x),
            good_at_end=not self.negated and not (method == "until" and table.node(x)[0] == "U"),
            starts=self._starts(classes),
        )

    def _starts(self, classes: NDArray[np.int64]) -> Starts:
        """Where runs begin, of the states in these classes: the first ones, one for each of the idle registers."""
        n = len(self._idle.states)
        if n == 1:
            nothing = np.zeros((self._recorder.n_letters, 1), dtype=np.int32)
            return Starts(nothing, classes[:1].astype(np.int32))
        before = coarsest_partition(self._idle.delta, classes[:n])
        delta, representative = quotient(self._idle.delta, before)
        return Starts(delta, classes[representative].astype(np.int32))


def _of_kind(kind: str, waits: int = 0) -> _State:
    return (kind, waits, (), ())


def _next_wait(state: _State) -> _State:
    return _of_kind("waits", state[1] - 1) if state[1] > 1 else _of_kind("runs")


def _watch(
    table: Residuals, obligation: Residual, delay: int, method: Method, after: Progression
) -> Callable[[_State], Sequence[_State]]:
    """The step function of a watch: pending starts progress, a new one begins, the one of age D is judged."""
    oldest = method == "oldest"
    begun, implied = after(obligation), table.implied

    def successors(state: _State) -> Sequence[_State]:
        kind, _, ages, residuals = state
        if kind == "waits":
            return (_next_wait(state),) * len(begun)
        if kind == "bad" and oldest:
            return (state,) * len(begun)
        older = (*[age + 1 for age in ages], 0)
        judged = older[0] == delay

        def settle(left: ByLetter) -> _State:
            bad = judged and left[0] == NO
            if bad and oldest:
                return _of_kind("bad")
            kept_ages: list[int] = []
            kept: list[Residual] = []
            for i in range(judged, len(left)):
                x = left[i]
                if x == YES:
                    continue
                if oldest:
                    for y in kept:
                        if implied[y, x]:
                            break
                    else:
                        kept_ages.append(older[i])
                        kept.append(x)
                else:
                    kept_ages.append(older[i])
                    kept.append(x)
            return ("bad" if bad else "runs", 0, tuple(kept_ages), tuple(kept))

        return by_letter(settle, *map(after, residuals), begun)

    return successors


def _until(table: Residuals, x: Residual, after: Progression) -> Callable[[_State], Sequence[_State]]:
    """The step function of φ U[a,b] ψ or φ R[a,b] ψ over atoms: after a steps only the clock of the verdict counts."""
    kind, _, _, left, right = table.node(x)
    # U ends well if ψ holds, badly if φ fails first; R ends badly if ψ fails, well if φ holds first
    ends, ended, breaks, broken = (YES, "good", NO, "bad") if kind == "U" else (NO, "bad", YES, "good")

    def successors(state: _State) -> Sequence[_State]:
        def step(now: ByLetter) -> _State:
            if state[0] in ("bad", "good"):
                return state
            if state[0] == "runs" and now[1] == ends:
                return _of_kind(ended)
            if now[0] == breaks:
                return _of_kind(broken)
            return _next_wait(state) if state[0] == "waits" else state

        return by_letter(step, after(left), after(right))

    return successors


def _single(after: Progression, obligation: Residual) -> Callable[[_State], Sequence[_State]]:
    """The step function of the only start: its residual progresses until it is true or false."""
    ends = {(YES,): _of_kind("good"), (NO,): _of_kind("bad")}
    known = {"begins": obligation, "good": YES, "bad": NO}

    def successors(state: _State) -> Sequence[_State]:
        x = known[state[0]] if state[0] in known else state[3][0]
        return [ends.get(x) or ("runs", 0, (0,), x) for x in zip(after(x))]

    return successors


# --------------------------------------------------------------------------------------------------- memory


_BEFORE, _AFTER = -(10**9), 10**9  # ranks before and after those of counters


class _Memory:
    """What a state remembers, in terms of φ even if ¬φ is watched: a pending ¬φ means that φ is possible.

    A phrase refers to starts, never to the verdict: the clock of the verdict determines which starts count.
    """

    def __init__(
        self,
        table: Residuals,
        states: Sequence[_State],
        obligation: Residual,
        method: Method,
        negated: bool,
        recall: _Recall,
    ) -> None:
        self._recall = recall
        self._table, self._obligation, self._method, self._negated = table, obligation, method, negated
        # a phrase needs the first pending start and their number
        self._states = [(kind, waits, ages[:1], xs[:1], len(xs)) for kind, waits, ages, xs in states]

    def __call__(self, q: int, text: Text) -> Remembered:
        found = self._of_starts(q, text)
        recalled = self._recall(q, text)
        return replace(found, phrase=f"{found.phrase}; {recalled}") if recalled else found

    def _of_starts(self, q: int, text: Text) -> Remembered:
        table, obligation, method, negated = self._table, self._obligation, self._method, self._negated
        kind, waits, ages, residuals, n_pending = self._states[q]
        if method == "oldest" and table.horizon(obligation) == 0 and kind not in ("waits", "begins"):
            # F[a,b] ψ or G[a,b] ψ with a Boolean ψ: what counts is whether ψ has occurred, or failed, in the window
            psi = text(table.formula(table.negation(obligation) if negated else obligation))
            if negated:
                return Remembered(f"{psi} seen", _AFTER, "done") if kind == "bad" else Remembered(f"{psi} not seen yet")
            return Remembered(f"{psi} has failed", _AFTER, "failed") if kind == "bad" else Remembered(f"{psi} so far")
        if kind == "waits":
            return Remembered(f"{_steps(waits)} before the window", -waits)
        if kind == "begins":
            return Remembered("at the start", _BEFORE)
        if kind in ("good", "bad"):
            good = (kind == "good") != negated
            ended = "succeeded" if good else "failed"
            if method in ("single", "until"):
                phrase = ended
            elif method == "oldest":
                phrase = f"a start has {ended}"
            else:
                phrase = f"the start {_steps(table.horizon(obligation))} ago {ended}"
            return Remembered(phrase, _AFTER, "done" if good else "failed")
        if not n_pending:
            return Remembered("nothing pending", 0, "done" if method != "until" else "open")
        found = self._pending(ages[0], residuals[0], text)
        return found if n_pending == 1 else replace(found, phrase=f"{found.phrase} (and {n_pending - 1} later)")

    def _pending(self, age: int, x: Residual, text: Text) -> Remembered:
        """A pending start."""
        table, obligation, negated = self._table, self._obligation, self._negated
        left = text(table.formula(table.negation(x) if negated else x))
        phrase = f"{'possible' if negated else 'due'} since {_steps(age)}: {left}"
        if self._method == "single":  # which counts no steps: its residual shrinks
            return Remembered(phrase, table.horizon(obligation) - table.horizon(x))
        status: Literal["open", "due"] = "due" if table.horizon(x) == 0 and not negated else "open"
        found = Remembered(phrase, age + 1, status, "", age + 1, table.horizon(obligation), risk=not negated)
        counted = self._counted(age, x)
        if counted is None:
            return found
        index, positive, ends_now = counted
        psi = text(table.atom(index))
        if not ends_now:  # else the phrase names what must hold now
            phrase = f"{psi} {'not seen ' if positive else ''}for {_steps(age + 1)}"
        return replace(found, phrase=phrase, subject=psi)

    def _counted(self, age: int, x: Residual) -> tuple[int, bool, bool] | None:
        """For an F[0,D] ψ, alone or as an alternative, that is still open: the atom ψ has not been seen since the
        start. Its index, its sign, and whether the next step is the last one of its window."""
        table, obligation = self._table, self._obligation
        kind, *rest = table.node(x)
        alternatives = table.node(obligation)[1] if table.node(obligation)[0] == "or" else (obligation,)
        if kind == "F" and rest[0] == 0:
            window, psi = rest[1], rest[2]
        elif kind == "atom":
            window, psi = 0, x
        else:
            return None
        if table.node(psi)[0] != "atom" or ("F", 0, window + age + 1, psi) not in map(table.node, alternatives):
            return None
        _, index, positive = table.node(psi)
        return index, positive, window == 0


class _Recall:
    """What the registers of a state remember, in words."""

    def __init__(self, table: Residuals, own: Sequence[int], registers: Sequence[Registers]) -> None:
        self._table, self._own = table, own
        self._registers = registers if own else ()

    def __call__(self, q: int, text: Text) -> str:
        if not self._registers:
            return ""
        phrases = [
            self._phrase(number, register, text)
            for number, register in zip(self._own, self._registers[q], strict=True)
            if register
        ]
        return ", ".join(phrases)

    def _phrase(self, number: int, register: Register, text: Text) -> str:
        """`b 2 steps ago`, for the youngest entry; with what is still needed, if that is not known yet."""
        table, atom = self._table, self._table.past[number]
        age, x = register[0]
        seen = text(table.formula(atom.right))
        if atom.b is None and age == atom.a:
            when = f"{seen} earlier" if age == 0 else f"{seen} at least {_steps(age + 1)} ago"
        else:
            when = f"{seen} {_steps(age + 1)} ago"
        when = when if x == YES else f"{when} if {text(table.formula(x))}"
        return when if len(register) == 1 else f"{when} (and {len(register) - 1} earlier)"


def _steps(n: int) -> str:
    return f"{n} step{'' if n == 1 else 's'}"
