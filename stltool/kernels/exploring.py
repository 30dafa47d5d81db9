"""Episodes of the model-based learner on small products: plans for what transitions seen lead to, and steps by them.

    V_t(s, q) = max over c of  Σ_s' p(s'|c) · V_{t+1}(s', δ(L(s'), q)) + outside(c) · top_t(q)
    top_t(q)  = min(worth_t, max over s' of V_{t+1}(s', δ(L(s'), q))), but worth_t for a choice that is untried

where q is undecided. The last maximum is over states that a run can be in after step t, by the transitions seen, states
that would satisfy the task, and those never seen, which are worth as much as paradise. Sums are added in the order of
the entries, what leads outside last.
"""

from __future__ import annotations

import functools
import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels import jit
from stltool.kernels.rollout import inversion
from stltool.kernels.tuples import Rules, Tables, Walked, one_state, room_of, route_of, with_entries

F64: TypeAlias = NDArray[np.float64]
I32: TypeAlias = NDArray[np.int32]

kernel = functools.partial(jit.kernel, counts=False)
part = functools.partial(jit.part, counts=False)
_LOST = -2  # the choice of a situation where nothing is hoped for


@kernel
def believe(walked: Any, normal: F64) -> None:
    """Draw weights: of a successor seen n times, Gamma(n) as n (1 − 1/9n + z/(3√n))³ with z normal [Wilson31]."""
    for e in range(walked.start[-1]):
        n = float(walked.seen[e])
        root = 1.0 - 1.0 / (9.0 * n) + normal[e] / (3.0 * math.sqrt(n))
        walked.weight[e] = max(n * root * root * root, 1e-300)


@kernel
def count(walked: Any, route: Any, c: Any, s2: Any, weight: float) -> bool:
    """Count a transition, of that weight to the belief; whether it is the first one from c to s2."""
    if walked.visits[c] == 0:
        route.turned[c] = route.counter[0]
    walked.visits[c] += 1
    walked.known[s2] = True
    e, end = walked.start[c], walked.start[c + 1]
    while e < end and walked.target[e] < s2:
        e += 1
    if e < end and walked.target[e] == s2:
        walked.seen[e] += 1
        walked.weight[e] += weight
        return False
    for i in range(walked.start[-1], e, -1):
        walked.target[i], walked.seen[i], walked.weight[i] = (
            walked.target[i - 1],
            walked.seen[i - 1],
            walked.weight[i - 1],
        )
    walked.target[e], walked.seen[e], walked.weight[e] = s2, 1, weight
    for i in range(c + 1, len(walked.start)):
        walked.start[i] += 1
    return True


@part
def rows(rules: Any, walked: Any, room: Any, level: float) -> None:
    """Each choice's chances, with hope at that level (its logarithm), and each state's different successors."""
    known = room.memo
    known[:] = -1.0
    n_states = len(rules.letter)
    place, k = room.place, 0
    for s in range(n_states):
        room.begin[s] = k
        for c in range(rules.first_choice[s], rules.first_choice[s + 1]):
            n = walked.visits[c]
            if n == 0:
                continue
            if n >= len(known):
                hope = 1.0 - math.exp(level / n)
            else:
                if known[n] < 0.0:
                    known[n] = 1.0 - math.exp(level / n)
                hope = known[n]
            total = 0.0
            for e in range(walked.start[c], walked.start[c + 1]):
                total += walked.weight[e]
                s2 = walked.target[e]
                if place[s2] < 0:
                    place[s2] = k - room.begin[s]
                    room.successors[k] = s2
                    k += 1
                room.slot[e] = place[s2]
            room.outside[c] = hope
            share = (1.0 - hope) / total
            for e in range(walked.start[c], walked.start[c + 1]):
                room.probability[e] = walked.weight[e] * share
        for i in range(room.begin[s], k):
            place[room.successors[i]] = -1
    room.begin[n_states] = k


@part
def spread(rules: Any, route: Any, room: Any, since: int, s: Any, q: Any) -> None:
    """The situations that the transitions lead to from there."""
    h = len(rules.worth)
    route.group[since:] = -1
    route.group[since, s] = 0
    route.first[0], route.first[1] = 0, 1
    room.touched[0], room.layer[since], room.layer[since + 1] = s, 0, 1
    route.memory[0] = q
    groups, n = 1, 1
    for t in range(since, h):
        route.counter[1] += 1
        tick, verdict = route.counter[1], rules.verdicts[t + 1]
        for g in range(room.layer[t], room.layer[t + 1]):
            s = room.touched[g]
            for k in range(room.begin[s], room.begin[s + 1]):
                s2 = room.successors[k]
                after, mark, pending = rules.delta[rules.letter[s2]], room.mark[s2], room.pending[s2]
                for i in range(route.first[g], route.first[g + 1]):
                    q2 = after[route.memory[i]]
                    if verdict[q2] < 0 and mark[q2] != tick:
                        mark[q2] = tick
                        if room.n_pending[s2] == 0:
                            room.touched[groups] = s2
                            groups += 1
                        pending[room.n_pending[s2]] = q2
                        room.n_pending[s2] += 1
        for g in range(room.layer[t + 1], groups):
            s2 = room.touched[g]
            route.group[t + 1, s2] = g
            for i in range(room.n_pending[s2]):
                route.memory[n] = room.pending[s2, i]
                n += 1
            room.n_pending[s2] = 0
            route.first[g + 1] = n
        if t + 1 < h:
            room.layer[t + 2] = groups


@kernel
def plan(rules: Any, walked: Any, route: Any, room: Any, level: float, since: int, s: Any, q: Any) -> None:
    """The best choices from there, by the belief at that level of hope (its logarithm)."""
    route.counter[0] += 1
    rows(rules, walked, room, level)
    spread(rules, route, room, since, s, q)
    unseen = room.unseen
    unseen[:] = False
    for i in range(len(walked.known)):
        unseen[rules.letter[i]] |= not walked.known[i]
    best, top, tops, which, ahead = room.lines[0], room.lines[1], room.lines[2], room.which, room.ahead
    tick, topped = route.counter[1], room.topped
    route.counter[1] += len(rules.worth)
    for t in range(len(rules.worth) - 1, since - 1, -1):
        later, now, tick = (t + 1) % 2, t % 2, tick + 1
        verdict, worth = rules.verdicts[t + 1], rules.worth[t]
        for g in range(room.layer[t], room.layer[t + 1]):
            s, low = room.touched[g], route.first[g]
            n = route.first[g + 1] - low
            for j in range(n):
                q = route.memory[low + j]
                if topped[q] != tick:
                    topped[q] = tick
                    most = 0.0
                    for letter in rules.occurring:
                        q2 = rules.delta[letter, q]
                        if verdict[q2] == 1:
                            most = 1.0
                        elif verdict[q2] < 0:
                            if unseen[letter]:
                                most = max(most, rules.worth[t + 1])
                            if room.best_mark[letter, q2] == tick - 1:
                                most = max(most, room.best[later, letter, q2])
                    tops[q] = min(most, worth)
                top[j] = tops[q]
            first = room.begin[s]
            for k in range(room.begin[s + 1] - first):
                s2 = room.successors[first + k]
                after, values, line = rules.delta[rules.letter[s2]], room.value[later, s2], ahead[k]
                for j in range(n):
                    q2 = after[route.memory[low + j]]
                    line[j] = values[q2] if verdict[q2] < 0 else float(verdict[q2])
            begin, end = rules.first_choice[s], rules.first_choice[s + 1]
            for j in range(0, n, 4):  # four at once: the lines are long enough
                b0, b1, b2, b3 = -1.0, -1.0, -1.0, -1.0
                w0, w1, w2, w3 = begin, begin, begin, begin
                for c in range(begin, end):
                    t0, t1, t2, t3 = 0.0, 0.0, 0.0, 0.0
                    if walked.visits[c] == 0:
                        t0 = t1 = t2 = t3 = worth
                    else:
                        for i in range(walked.start[c], walked.start[c + 1]):
                            p, line = room.probability[i], ahead[room.slot[i]]
                            t0 += p * line[j]
                            t1 += p * line[j + 1]
                            t2 += p * line[j + 2]
                            t3 += p * line[j + 3]
                        lost = room.outside[c]
                        t0 += lost * top[j]
                        t1 += lost * top[j + 1]
                        t2 += lost * top[j + 2]
                        t3 += lost * top[j + 3]
                    if t0 > b0:
                        b0, w0 = t0, c
                    if t1 > b1:
                        b1, w1 = t1, c
                    if t2 > b2:
                        b2, w2 = t2, c
                    if t3 > b3:
                        b3, w3 = t3, c
                best[j], best[j + 1], best[j + 2], best[j + 3] = b0, b1, b2, b3
                which[j], which[j + 1], which[j + 2], which[j + 3] = w0 - begin, w1 - begin, w2 - begin, w3 - begin
            mine, letter = room.value[now, s], rules.letter[s]
            for j in range(n):
                q = route.memory[low + j]
                mine[q] = best[j]
                route.choice[low + j] = which[j] if best[j] > 0.0 else _LOST
                if room.best_mark[letter, q] != tick:
                    room.best_mark[letter, q], room.best[now, letter, q] = tick, best[j]
                else:
                    room.best[now, letter, q] = max(room.best[now, letter, q], best[j])


@part
def rarest(visits: Any, chance: float) -> int:
    """The choice taken least, ties broken by `chance` in [0, 1)."""
    least, ties = visits[0], 0
    for n in visits:
        if n < least:
            least, ties = n, 1
        elif n == least:
            ties += 1
    wanted = int(chance * ties)
    for a in range(len(visits)):
        if visits[a] == least:
            if wanted == 0:
                return a
            wanted -= 1
    return 0


@part
def told(rules: Any, walked: Any, route: Any, t: int, s: Any, q: Any, chance: float) -> int:
    """What the plan says; −1 if nothing, or if it hoped for a choice that has been tried in the meantime.

    It hoped for no more than any untried choice of this state promises, so such a choice is taken instead.
    """
    first, after, g = rules.first_choice[s], rules.first_choice[s + 1], route.group[t, s]
    if g >= 0:
        for i in range(route.first[g], route.first[g + 1]):
            if route.memory[i] == q:
                a = route.choice[i]
                if a == _LOST:
                    return int(rarest(walked.visits[first:after], chance))
                if route.turned[first + a] != route.counter[0]:
                    return int(a)
    for c in range(first, after):
        if walked.visits[c] == 0:
            return int(c - first)
    return -1


@kernel
def choose(
    rules: Any, walked: Any, route: Any, room: Any, level: float, t: int, s: Any, q: Any, chance: float
) -> int:  # fmt: skip
    """What to do while the task is open."""
    a = told(rules, walked, route, t, s, q, chance)
    if a < 0:
        plan(rules, walked, route, room, level, t, s, q)
        a = told(rules, walked, route, t, s, q, chance)
    return int(a)


@kernel
def aftermath(rules: Any, walked: Any, s: Any, stuck: bool, enough: int, chance: float) -> int:
    """What to do once it is violated: learning/aftermath.py. stuck: whether the last step led nowhere."""
    first, after = rules.first_choice[s], rules.first_choice[s + 1]
    a = rarest(walked.visits[first:after], chance)
    if walked.visits[first + a] < enough or not stuck:
        return int(a)
    for e in range(walked.start[first], walked.start[after]):
        if walked.target[e] != s:
            return int(a)
    return -1


@kernel
def episode(
    env: Any, rules: Any, walked: Any, route: Any, room: Any, level: float, enough: int, q: Any,
    moves: F64, chances: F64, weights: F64, states: I32, actions: I32,
) -> int:  # fmt: skip
    """A whole episode of at most len(actions) steps from states[0] with memory q: how many there are.

    states (n+1,) and actions (n,) are filled.
    """
    s, verdict, stuck = np.int64(states[0]), rules.verdicts[0, q], False
    if verdict < 0:
        plan(rules, walked, route, room, level, 0, s, q)
    for t in range(len(actions)):
        if verdict == 1:
            return t
        if verdict == 0:
            a = aftermath(rules, walked, s, stuck, enough, chances[t])
            if a < 0:
                return t
        else:
            a = choose(rules, walked, route, room, level, t, s, q, chances[t])
        c = rules.first_choice[s] + a
        lo, hi = env.row_start[c], env.row_start[c + 1]
        s2 = np.int64(env.target[inversion(env.sums, lo, hi, moves[t] * env.sums[hi - 1])])
        count(walked, route, c, s2, weights[t])
        stuck = s2 == s
        s, q = s2, np.int64(rules.delta[rules.letter[s2], q])
        states[t + 1], actions[t] = s, a
        if verdict < 0:
            verdict = rules.verdicts[t + 1, q]
    return len(actions)


def warm_up() -> None:
    """Compile or load what Python calls, on a model of one state and one step."""
    one, whole, narrow = np.zeros(1), np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int32)
    places, verdicts = np.arange(2), np.array([[-1], [0]], dtype=np.int8)
    rules = Rules(places, narrow, narrow[None], verdicts, one, whole)
    walked = Walked(
        np.zeros(2, np.int64), whole, np.zeros(4, np.int32), np.zeros(4, np.int64), np.zeros(4), np.zeros(1, np.bool_)
    )
    route, room = route_of(1, 1, 1, 1), with_entries(room_of(1, 1, 1, 1, 1), 4)
    env = Tables(*one_state(), np.ones(1), np.ones(1))
    states, actions = np.zeros(2, dtype=np.int32), np.zeros(1, dtype=np.int32)
    believe(walked, one)
    plan(rules, walked, route, room, -1.0, 0, 0, 0)
    episode(env, rules, walked, route, room, -1.0, 1, 0, one, one, one, states, actions)
    choose(rules, walked, route, room, -1.0, 0, 0, 0, 0.5)
    count(walked, route, 0, 0, 1.0)
    aftermath(rules, walked, 0, True, 1, 0.5)
