"""Parameters on which rows depend, from transitions: confidence sets, and an alarm against a wrong tie.

**Likelihood.** An entry is u(1−x) + v·x for the parameter's place x in its domain [0, 1] (models/parameters.py).
Transitions with the same (u, v) are pooled, N of them; entries that do not depend on it say nothing:

    ℓ(x) = Σ N_uv ln(u(1−x) + v·x),      concave

**Confidence sets.** For any fixed probability measure π over θ, however choices were chosen and whenever one stopped,
M_n(x) = ∫ L_n(θ) dπ(θ) / L_n(x) is under x a nonnegative supermartingale from 1: the next outcome multiplies it on
average by Σ P_x(s')·P_θ(s')/P_x(s') ≤ 1. So P(some n has M_n(x) ≥ 1/α) ≤ α [Ville39]. Two measures, α/2 each,
relative to the x in question: x + z and x − z for 96 offsets z from 1e-5 to 1, equally spaced in ln z and equally
likely, where θ outside the domain counts L = 0. As ℓ is concave, ln L(x+z) − ln L(x) falls in x: what the first refuses
is an interval [0, lo), what the second refuses an interval (hi, 1]. Several parameters share α equally.

**The alarm.** If it is wrong that the rows depend on one parameter, neither set means anything. Alternatives: one
state, or one action, has a parameter of its own. With mixtures over 512 fixed values, sin²((i + ½)π/1024),

    E = mean over alternatives of  ∫ L_own dπ · ∫ L_rest dπ / max_x L(x)

is below the same with L(true x), an average of martingales from 1: if the tie is right, E ever reaches 1/α with
probability at most α. Half of the weight is on states, half on actions. That is said of all looks together, so an alarm
that rang stays: the counts remember it (`Counts.alarms`), and more data of the same run do not take it back.

**Rounding.** A value of x is refused only if its evidence exceeds what is needed by 1e-12·(Σ N + 10): sets may be too
wide, never too narrow; the maximum of ℓ is raised by as much.

Sources: [Robbins70], [Howard21].
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stltool.errors import SettingsError, TieError
from stltool.learning.confidence import Floats, Whole, log_inverse
from stltool.learning.counts import Counts
from stltool.models import MDP
from stltool.models.parameters import Parameter
from stltool.numbers import number_text

_OFFSETS = np.exp(np.linspace(np.log(1e-5), 0.0, 96))
_ATOMS = np.sin((np.arange(512) + 0.5) * np.pi / 1024) ** 2
_SLACK = 1e-12
_BISECTIONS = 60
_BLOCK = 4096  # alternatives at a time
_ROUNDED = 10**6  # the denominator of estimates


@dataclass(frozen=True)
class TiedParameter:
    """What data say about a parameter: it lies in [lower, upper] with the stated confidence.

    estimate     the value under which the data are most probable, rounded
    transitions  those whose probabilities depend on it
    """

    name: str
    lower: Fraction
    upper: Fraction
    estimate: Fraction
    transitions: int

    @property
    def text(self) -> str:
        return f"{self.name} in [{float(self.lower):.6g}, {float(self.upper):.6g}]"


class Evidence:
    """Transitions of a family of models, as evidence on its parameters.

    Raises SettingsError for transitions that the family's graph excludes.
    """

    def __init__(self, family: MDP, counts: Counts) -> None:
        self.family = family
        rows, ties = family.rows, family.source.ties
        assert ties is not None
        self.parameters: tuple[Parameter, ...] = ties.parameters
        lengths = np.diff(rows.row_start)
        codes = np.repeat(np.arange(family.n_choices), lengths) * family.n_states + rows.target
        order = np.argsort(codes, kind="stable")
        found = counts.choice * family.n_states + counts.target
        place = np.minimum(np.searchsorted(codes[order], found), len(codes) - 1)
        entry = order[place]
        strange = np.flatnonzero(codes[entry] != found)
        if strange.size:
            choice, target = divmod(int(found[strange[0]]), family.n_states)
            raise SettingsError(
                f"{family.place(choice)}: it was seen to lead to state {family.state_name(target)}, which is "
                f"impossible for every value of {' and '.join(one.name for one in self.parameters)}; mend the model"
            )
        self._parameter = np.array([k for k, _, _ in ties.classes])
        self._ends = np.array([(float(a), float(b)) for _, a, b in ties.classes]).reshape(-1, 2)
        informative = np.array([a != b for _, a, b in ties.classes])
        of_entry = rows.tied_class[entry]
        kept = informative[of_entry]
        self._class, self._choice, self._seen = of_entry[kept], counts.choice[kept], counts.seen[kept]
        self._alarms, said = counts.alarms, hashlib.sha256(repr(ties.classes).encode())
        for column in (rows.row_start, rows.target, rows.tied_class):
            said.update(np.ascontiguousarray(column).tobytes())
        self._tie = said.hexdigest()

    def sets(self, alpha: Fraction) -> tuple[TiedParameter, ...]:
        """Every parameter's set; all of them hold with probability 1 − α, at all numbers of transitions at once."""
        level = log_inverse(2 * len(self.parameters), alpha)
        return tuple(self._set(k, level) for k in range(len(self.parameters)))

    def _set(self, k: int, level: float) -> TiedParameter:
        own = self._parameter[self._class] == k
        likelihood = _Likelihood(self._ends, self._class[own], self._seen[own])
        lower, upper = likelihood.end(0.0, 1, level), likelihood.end(1.0, -1, level)
        one = self.parameters[k]
        width = one.upper - one.lower
        best = one.lower + width * Fraction(likelihood.best)
        rounded = min(max(best.limit_denominator(_ROUNDED), one.lower), one.upper)
        return TiedParameter(
            one.name, one.lower + width * Fraction(lower), one.lower + width * Fraction(upper), rounded, likelihood.n
        )

    @cached_property
    def against_the_tie(self) -> tuple[float, int]:
        """(ln E, the alternative that the data support most: a state s, or −1 − a for an action a)."""
        model = self.family
        state = np.searchsorted(model.choice_start, self._choice, side="right") - 1
        found = [self._alternatives(k, state, model.n_states) for k in range(len(self.parameters))]
        actions = [self._alternatives(k, model.choice_action[self._choice], model.n_actions) for k in range(len(found))]
        total = float(_log_mean(np.array([one for pair in zip(found, actions, strict=True) for one, _, _ in pair])))
        of_state, of_action = (max(several, key=lambda one: one[1]) for several in (found, actions))
        if of_state[1] >= of_action[1]:
            return total, of_state[2]
        return total, -1 - of_action[2]

    def _alternatives(self, k: int, group: NDArray[np.signedinteger], n: int) -> tuple[float, float, int]:
        """ln of the mean over n alternatives; ln of the greatest of them, and which one it is."""
        own = self._parameter[self._class] == k
        which, group, seen = self._class[own], group[own], self._seen[own].astype(np.float64)
        logs = np.log(self._ends[:, :1] * (1 - _ATOMS) + self._ends[:, 1:] * _ATOMS)
        logs[self._parameter != k] = 0.0
        of_all = np.bincount(which, weights=seen, minlength=len(logs)) @ logs
        likelihood = _Likelihood(self._ends, which, self._seen[own])
        top = likelihood.most
        groups, place = np.unique(group, return_inverse=True)
        values = [np.full(n - len(groups), _log_mean(of_all) - top)]  # those without data
        for lo in range(0, len(groups), _BLOCK):
            here = (place >= lo) & (place < lo + _BLOCK)
            table = np.zeros((min(_BLOCK, len(groups) - lo), len(logs)))
            np.add.at(table, (place[here] - lo, which[here]), seen[here])
            apart = table @ logs
            values.append(_log_mean(apart) + _log_mean(of_all - apart) - top)
        found = np.concatenate(values[1:]) if len(groups) else np.full(1, -np.inf)
        best = int(found.argmax())
        return float(_log_mean(np.concatenate(values))), float(found[best]), int(groups[best]) if len(groups) else 0

    def require_tied(self, alpha: Fraction) -> float:
        """E. TieError if the data contradict the tie, at level α, or did so at an earlier look."""
        now = evidence, where = self.against_the_tie
        if (rang := self._alarms.get(self._tie)) is not None and rang[0] > evidence:
            evidence, where = rang
        if evidence >= log_inverse(1, alpha):
            self._alarms[self._tie] = evidence, where
            place = f"state {self.family.state_name(where)}"
            if where < 0:
                place = f"action {self.family.action_names[-1 - where]}"
            names = " and ".join(one.name for one in self.parameters)
            shown = f"{np.exp(evidence):.3g}" if evidence < 100 else f"1e{evidence / np.log(10):.0f}"
            raise TieError(
                f"the data contradict the assumption that the same {names} holds in every row: {shown} times as "
                f"probable with another one somewhere, most clearly in {place} (refused from {number_text(1 / alpha)} "
                "on); use support='known', or give the rows that differ a parameter of their own"
            )
        return float(np.exp(now[0]))


class _Likelihood:
    """ℓ of one parameter: `n` transitions, in classes with these ends."""

    def __init__(self, ends: Floats, which: Whole, seen: Whole) -> None:
        total = np.zeros(len(ends), dtype=np.int64)
        np.add.at(total, which, seen)
        kept = total > 0  # 0 · ln 0 is 0
        self._first, self._last = ends[kept, :1], ends[kept, 1:]
        self._seen = total[kept].astype(np.float64)[:, None]
        self.n = int(total.sum())
        self._slack = _SLACK * (self.n + 10)

    def __call__(self, x: Floats) -> Floats:
        with np.errstate(divide="ignore", invalid="ignore"):
            found: Floats = (self._seen * np.log(self._first * (1 - x) + self._last * x)).sum(axis=0)
        return np.where((x < 0) | (x > 1), -np.inf, found)

    def end(self, out: float, sign: int, level: float) -> float:
        """The end of the set on the side of `out`: a refused value, or `out` itself."""
        if not self.n or not self._refused(out, sign, level):
            return out
        inside = 1.0 - out
        for _ in range(_BISECTIONS):
            middle = (out + inside) / 2
            if self._refused(middle, sign, level):
                out = middle
            else:
                inside = middle
        return out

    def _refused(self, x: float, sign: int, level: float) -> bool:
        here = float(self(np.array([x]))[0])
        if here == -np.inf:  # what was seen is impossible there
            return True
        return float(_log_mean(self(x + sign * _OFFSETS))) - here - self._slack >= level

    @cached_property
    def best(self) -> float:
        """Where ℓ is greatest, up to rounding; the middle without data."""
        lower, upper = 0.0, 1.0
        for _ in range(_BISECTIONS if self.n else 1):
            x = (lower + upper) / 2
            chance = self._first * (1 - x) + self._last * x
            lower, upper = (x, upper) if (self._seen * (self._last - self._first) / chance).sum() > 0 else (lower, x)
        return (lower + upper) / 2

    @property
    def most(self) -> float:
        """An upper bound on the greatest ℓ."""
        around = np.clip(self.best + np.array([-1e-12, 0.0, 1e-12]), 0.0, 1.0)
        found = self(np.append(around, [0.0, 1.0]))
        return float(np.max(found[np.isfinite(found)], initial=-np.inf)) + 1e3 * self._slack if self.n else 0.0


def _log_mean(logs: Floats) -> Floats:
    """ln of the mean of exp, over the last axis."""
    top = logs.max(axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        found = np.log(np.exp(logs - top).mean(axis=-1)) + top[..., 0]
    return np.where(np.isfinite(top[..., 0]), found, -np.inf)
