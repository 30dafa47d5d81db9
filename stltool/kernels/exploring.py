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
from stltool.kernels.lanes import (
    N,
    add,
    at,
    gather,
    greater,
    load,
    mask,
    mul,
    narrow_where,
    put,
    select,
    splat,
    splat_at,
    store,
    trailing,
)
from stltool.kernels.rollout import inversion
from stltool.kernels.tuples import (
    Rules,
    Tables,
    Walked,
    chart_of,
    draws_of,
    one_state,
    room_of,
    route_of,
    with_children,
    with_entries,
)
from stltool.kernels.words import ONE, ZERO

F64: TypeAlias = NDArray[np.float64]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]

kernel = functools.partial(jit.kernel, counts=False)
part = functools.partial(jit.part, counts=False)
PATIENCE = 4  # a belief, and its plan, are held until a choice has been taken by so small a part more often
NONE, DRAWN, HELD = range(3)  # route.belief[0]
NO_BELIEF, NO_ROOM = -2, -1  # instead of a choice
_LOST = -2  # the choice of a situation where nothing is hoped for


@kernel
def begins(route: Any, s: Any, q: Any) -> bool:
    """Whether an episode that begins there needs a belief: none is held, or its plan begins elsewhere."""
    belief = route.belief
    belief[1] = 0
    return bool(belief[0] != HELD or belief[2] != s or belief[3] != q)


@kernel
def believe(walked: Any, route: Any, normal: F64, level: float) -> None:
    """Draw weights: of a successor seen n times, Gamma(n) as n (1 − 1/9n + z/(3√n))³ with z normal [Wilson31].

    level: of hope, its logarithm
    """
    for e in range(walked.start[-1]):
        n = float(walked.seen[e])
        root = 1.0 - 1.0 / (9.0 * n) + normal[e] / (3.0 * math.sqrt(n))
        walked.weight[e] = max(n * root * root * root, 1e-300)
    for c in range(len(walked.visits)):
        route.limit[c] = walked.visits[c] + walked.visits[c] // PATIENCE
    route.level[0], route.belief[0], route.belief[1] = level, DRAWN, 1


@kernel
def count(walked: Any, route: Any, c: Any, s2: Any, weight: float) -> bool:
    """Count a transition, of that weight to the belief; whether it is the first one from c to s2."""
    if walked.visits[c] == 0:
        route.turned[c] = route.counter[0]
    walked.visits[c] += 1
    walked.known[s2] = True
    if walked.visits[c] > route.limit[c]:
        route.belief[0] = NONE
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
    route.belief[0] = NONE  # its plan does not know where this leads
    for i in range(c + 1, len(walked.start)):
        walked.start[i] += 1
    return True


@part
def successors(rules: Any, walked: Any, chart: Any, room: Any) -> bool:
    """List the states that each state's choices lead to; whether they are the same as before."""
    same, k, used, found = bool(chart.stamp[0] >= 0), 0, room.used, room.successors
    used[:] = -1
    for s in range(len(rules.letter)):
        first, after, begin = walked.start[rules.first_choice[s]], walked.start[rules.first_choice[s + 1]], k
        for e in range(first, after):
            s2 = np.int64(walked.target[e])
            if used[s2] < 0:  # into its place, which is near the end: each choice's are ascending
                used[s2], i = 0, k
                while i > begin and found[i - 1] > s2:
                    found[i] = found[i - 1]
                    i -= 1
                found[i] = s2
                k += 1
        same = same and chart.begin[s] == begin
        chart.begin[s] = begin
        for i in range(begin, k):
            same = same and chart.successors[i] == found[i]
            chart.successors[i], used[found[i]] = found[i], i - begin
        for e in range(first, after):
            chart.slot[e] = used[walked.target[e]]
        for i in range(begin, k):
            used[found[i]] = -1
    same = same and chart.begin[-1] == k
    chart.begin[-1] = k
    return bool(same)


@part
def rows(walked: Any, room: Any, level: float) -> None:
    """Each choice's chances, with hope at that level (its logarithm)."""
    known = room.memo
    known[:] = -1.0
    for c in range(len(walked.visits)):
        n = walked.visits[c]
        if n == 0:
            room.hope[c], room.fresh[c] = 0.0, 1.0
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
        room.hope[c], room.fresh[c] = hope, 0.0
        share = (1.0 - hope) / total
        for e in range(walked.start[c], walked.start[c + 1]):
            room.chance[e] = walked.weight[e] * share


@part
def ahead(rules: Any, route: Any, chart: Any, room: Any, t: int, children: int) -> int:
    """The states that step t leads to, undecided, and their memories, pending; how many groups there are with them.

    Of the children with the same letter, the first is its memory for now, and Q if the task is decided there, one more
    if it is true.
    """
    verdict, memories, pending, bits = rules.verdicts[t + 1], len(room.peak_mark), room.pending, room.bits
    child, memory, words, groups = chart.child, route.memory, room.pending.shape[1], chart.layer[t + 1]
    for g in range(chart.layer[t], chart.layer[t + 1]):
        s, low, begin = chart.touched[g], route.first[g], chart.begin[chart.touched[g]]
        situations, successors = route.first[g + 1] - low, chart.begin[s + 1] - begin
        route.counter[1] += 1
        for k in range(successors):
            s2 = np.int64(chart.successors[begin + k])
            letter, some = np.int64(rules.letter[s2]), ZERO
            if room.letter_mark[letter] != route.counter[1]:
                room.letter_mark[letter] = route.counter[1]
                for w in range(words):
                    bits[letter, w] = 0
                for i in range(situations):
                    q2 = np.int64(rules.delta[letter, memory[low + i]])
                    known = np.int64(verdict[q2])
                    if known < 0:
                        bits[letter, q2 >> 6] |= ONE << np.uint64(q2 & 63)
                    child[children + k * situations + i] = q2 if known < 0 else memories + known
            for w in range(words):
                some |= bits[letter, w]
                pending[s2, w] |= bits[letter, w]
            if some != ZERO and not room.reached[s2]:
                room.reached[s2], chart.touched[groups] = True, s2
                groups += 1
        children += situations * successors
    return int(groups)


@part
def spread(rules: Any, walked: Any, route: Any, chart: Any, room: Any, since: int, s: Any, q: Any) -> bool:
    """The situations that the transitions lead to from there; whether there was room for all their children."""
    h, unseen, letters, memories = len(rules.worth), room.unseen, len(rules.occurring), len(room.peak_mark)
    number, pending = room.number, room.pending
    unseen[:] = False
    for i in range(len(walked.known)):
        unseen[rules.letter[i]] |= not walked.known[i]
        number[(i + 1) * (memories + 2) - 2], number[(i + 1) * (memories + 2) - 1] = 0, 1
    route.group[:] = -1
    route.group[since, s] = 0
    route.first[0], route.first[1], route.memory[0] = 0, 1, q
    chart.touched[0], chart.layer[since], chart.layer[since + 1] = s, 0, 1
    chart.kind[0], chart.kinds[since], chart.kinds[since + 1], chart.peaks[since] = 1, 1, 2, 0
    n, kinds, peaks, children = 1, 2, 0, 0
    for t in range(since, h):
        low, after, more = chart.layer[t], chart.layer[t + 1], children
        for g in range(low, after):
            s = chart.touched[g]
            more += (route.first[g + 1] - route.first[g]) * (chart.begin[s + 1] - chart.begin[s])
        if more + N > len(chart.child):  # whole vectors are read
            return False
        groups = ahead(rules, route, chart, room, t, children)
        route.counter[1] += 1
        tick, verdict = route.counter[1], rules.verdicts[t + 1]
        for g in range(after, groups):
            s2 = np.int64(chart.touched[g])
            letter = np.int64(rules.letter[s2])
            route.group[t + 1, s2], room.reached[s2] = g, False
            for w in range(pending.shape[1]):
                left = pending[s2, w]
                pending[s2, w] = 0
                while left != ZERO:
                    q2 = 64 * w + np.int64(trailing(left))
                    left &= left - ONE
                    if room.kind_mark[letter, q2] != tick:
                        room.kind_mark[letter, q2], room.kind_number[letter, q2] = tick, kinds
                        kinds += 1
                    route.memory[n], number[s2 * (memories + 2) + q2] = q2, 2 + n
                    chart.kind[n] = room.kind_number[letter, q2]
                    n += 1
            route.first[g + 1] = n
        if t + 1 < h:
            chart.layer[t + 2], chart.kinds[t + 2] = groups, kinds
        for g in range(low, after):
            s, begin = chart.touched[g], chart.begin[chart.touched[g]]
            situations = route.first[g + 1] - route.first[g]
            for k in range(chart.begin[s + 1] - begin - 1, -1, -1):  # the first with its letter last, as others read it
                s2, first = np.int64(chart.successors[begin + k]), 0
                while rules.letter[chart.successors[begin + first]] != rules.letter[s2]:
                    first += 1
                new, old = children + k * situations, children + first * situations
                for i in range(situations):
                    put(chart.child, new + i, at(number, s2 * (memories + 2) + at(chart.child, old + i)))
            children += situations * (chart.begin[s + 1] - begin)
        for i in range(route.first[low], route.first[after]):
            q = np.int64(route.memory[i])
            if room.peak_mark[q] != tick:
                room.peak_mark[q], room.peak_number[q] = tick, peaks
                basis = 0.0
                for j in range(letters):
                    letter = rules.occurring[j]
                    q2, feed = np.int64(rules.delta[letter, q]), np.int64(0)
                    if verdict[q2] == 1:
                        basis = 1.0
                    elif verdict[q2] < 0:
                        if unseen[letter]:
                            basis = max(basis, rules.worth[t + 1])
                        if room.kind_mark[letter, q2] == tick:
                            feed = np.int64(room.kind_number[letter, q2])
                    chart.feeds[peaks * letters + j] = feed
                chart.basis[peaks] = basis
                peaks += 1
            chart.peak[i] = room.peak_number[q]
        chart.peaks[t + 1] = peaks
    return True


@part
def sweep(rules: Any, walked: Any, route: Any, chart: Any, room: Any, since: int) -> None:
    """Backward induction over the chart's situations, eight of a group at once, which have the same chances."""
    letters, value, best, child, ahead = len(rules.occurring), room.value, room.best, chart.child, room.ahead
    h, m, zeros, lost = len(rules.worth), 0, splat(0.0), splat(np.int64(_LOST))
    value[0], value[1], best[0] = 0.0, 1.0, 0.0
    for g in range(chart.layer[h]):
        s = chart.touched[g]
        m += (route.first[g + 1] - route.first[g]) * (chart.begin[s + 1] - chart.begin[s])
    for t in range(h - 1, since - 1, -1):
        worth, worths = rules.worth[t], splat(rules.worth[t])
        for peak in range(chart.peaks[t], chart.peaks[t + 1]):
            most = chart.basis[peak]
            for j in range(peak * letters, (peak + 1) * letters):
                most = max(most, best[chart.feeds[j]])
            room.top[peak] = min(most, worth)
        best[chart.kinds[t] : chart.kinds[t + 1]] = 0.0
        for g in range(chart.layer[t + 1] - 1, chart.layer[t] - 1, -1):
            s, low, high = chart.touched[g], route.first[g], route.first[g + 1]
            first, after, situations = rules.first_choice[s], rules.first_choice[s + 1], high - low
            children = chart.begin[s + 1] - chart.begin[s]
            m -= situations * children
            for i in range(low, high, N):
                for k in range(children):
                    store(ahead, N * k, gather(value, child, m + k * situations + i - low))
                tops, dearest, which = gather(room.top, chart.peak, i), splat(-1.0), lost
                for c in range(first, after):
                    total = zeros
                    for e in range(walked.start[c], walked.start[c + 1]):
                        chance = splat_at(room.chance, e)
                        total = add(total, mul(chance, load(ahead, N * np.int64(at(chart.slot, e)))))
                    total = add(total, mul(splat_at(room.hope, c), tops))
                    total = add(total, mul(splat_at(room.fresh, c), worths))
                    better = greater(total, dearest)
                    dearest = select(better, total, dearest)
                    which = select(better, splat(np.int64(c - first)), which)
                which = select(greater(dearest, zeros), which, lost)
                end = min(i + N, high)
                here = mask(np.uint8((1 << (end - i)) - 1))
                store(value, 2 + i, select(here, dearest, load(value, 2 + i)))
                narrow_where(route.choice, i, here, which)
                for j in range(i, end):
                    best[chart.kind[j]] = max(best[chart.kind[j]], value[2 + j])


@kernel
def plan(rules: Any, walked: Any, route: Any, chart: Any, room: Any, since: int, s: Any, q: Any) -> bool:
    """The best choices from there, by the belief; False if the chart has too little room for children."""
    stamp, entries, known = chart.stamp, walked.start[-1], 0
    for one in walked.known:
        known += one
    if stamp[0] != entries:
        if not successors(rules, walked, chart, room):
            stamp[1] = -1
        stamp[0] = entries
    if stamp[1] != known or stamp[2] != since or stamp[3] != s or stamp[4] != q:
        stamp[1] = -1
        if not spread(rules, walked, route, chart, room, since, s, q):
            return False
        stamp[1], stamp[2], stamp[3], stamp[4] = known, since, s, q
    route.counter[0] += 1
    rows(walked, room, route.level[0])
    sweep(rules, walked, route, chart, room, since)
    if since == 0 and route.belief[0] == DRAWN:
        route.belief[0], route.belief[2], route.belief[3] = HELD, s, q
    return True


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
    rules: Any, walked: Any, route: Any, chart: Any, room: Any, t: int, s: Any, q: Any, chance: float
) -> int:  # fmt: skip
    """What to do while the task is open. NO_BELIEF: that of an earlier episode does not say, and a new one is to be
    drawn; NO_ROOM: the chart has too little for children."""
    a = told(rules, walked, route, t, s, q, chance)
    if a >= 0:
        return int(a)
    if route.belief[1] == 0:
        return NO_BELIEF
    if not plan(rules, walked, route, chart, room, t, s, q):
        return NO_ROOM
    return int(told(rules, walked, route, t, s, q, chance))


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


@part
def draw(walked: Any, route: Any, rng: Any, draws: Any, optimism: float) -> None:
    """Draw a belief."""
    for e in range(walked.start[-1]):
        draws.normal[e] = rng.standard_normal()
    chance = draws.chances[-1]
    believe(walked, route, draws.normal, math.log(max(1.0 - chance ** (1.0 / optimism), 1e-300)))


@kernel
def episodes(
    env: Any, rules: Any, walked: Any, route: Any, chart: Any, room: Any, rng: Any, world: Any, optimism: float,
    enough: int, draws: Any, here: I64, starts: I64, choice: I64, target: I32, context: I64,
) -> int:  # fmt: skip
    """Episodes one after the other, which is what it returns 0 after; 1: there is too little room for entries, 2: for
    children. It then goes on from there.

    here (8,): what is left: episodes; the present one's step (−1: it begins; −2: it has not been reset), state, memory,
    verdict, and whether the last step led nowhere; how many transitions there are, and the automaton's first state
    starts (S,): how many episodes started there, undecided
    choice, target, context (n,): the transitions; the context is 1 + the choice before, 0 at the start of an episode
    rng draws the beliefs; world, the model's transitions, one number for each and for each reset
    """
    t, s, q, verdict, stuck, n = here[1], here[2], here[3], here[4], here[5] == 1, here[6]
    length, missing = len(draws.weights), 0
    while here[0] > 0:
        if t < 0:
            if walked.start[-1] + length > len(walked.target):
                missing = 1
                break
            if t == -2:
                s = np.int64(inversion(env.first, 0, len(env.first), world.random() * env.first[-1]))
                q = np.int64(rules.delta[rules.letter[s], here[7]])
                verdict = np.int64(rules.verdicts[0, q])
            walked.known[s] = True
            for i in range(length + 1):
                draws.chances[i] = rng.random()
            for i in range(length):
                draws.weights[i] = rng.standard_exponential()
            if verdict < 0:
                starts[s] += 1
                if begins(route, s, q):
                    draw(walked, route, rng, draws, optimism)
            t, stuck = 0, False
        if t == 0 and verdict < 0 and route.belief[0] == DRAWN and not plan(rules, walked, route, chart, room, 0, s, q):
            missing = 2
            break
        while t < length and verdict != 1:
            if verdict == 0:
                a = aftermath(rules, walked, s, stuck, enough, draws.chances[t])
                if a < 0:
                    break
            else:
                a = choose(rules, walked, route, chart, room, t, s, q, draws.chances[t])
                if a == NO_BELIEF:
                    draw(walked, route, rng, draws, optimism)
                    a = choose(rules, walked, route, chart, room, t, s, q, draws.chances[t])
                if a < 0:
                    missing = 2
                    break
            c = rules.first_choice[s] + a
            lo, hi = env.row_start[c], env.row_start[c + 1]
            s2 = np.int64(env.target[inversion(env.sums, lo, hi, world.random() * env.sums[hi - 1])])
            count(walked, route, c, s2, draws.weights[t])
            choice[n], target[n], context[n] = c, s2, 0 if t == 0 else choice[n - 1] + 1
            stuck = s2 == s
            s, q = s2, np.int64(rules.delta[rules.letter[s2], q])
            n += 1
            t += 1
            if verdict < 0:
                verdict = np.int64(rules.verdicts[t, q])
        if missing > 0:
            break
        t = -2
        here[0] -= 1
    here[1], here[2], here[3], here[4], here[5], here[6] = t, s, q, verdict, 1 if stuck else 0, n
    return missing


def warm_up() -> None:
    """Compile or load what Python calls, on a model of one state and one step."""
    one, whole, narrow = np.zeros(1), np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int32)
    places, verdicts = np.arange(2), np.array([[-1], [0]], dtype=np.int8)
    rules = Rules(places, narrow, narrow[None], verdicts, one, whole)
    walked = Walked(
        np.zeros(2, np.int64), whole, np.zeros(4, np.int32), np.zeros(4, np.int64), np.zeros(4), np.zeros(1, np.bool_)
    )
    route = route_of(1, 1, 1, 1)
    chart, room = with_entries(with_children(chart_of(1, 1, 1, 1)), room_of(1, 1, 1, 1, 1), 4)
    env = Tables(*one_state(), np.ones(1), np.ones(1))
    begins(route, 0, 0)
    believe(walked, route, one, -1.0)
    plan(rules, walked, route, chart, room, 0, 0, 0)
    rng, draws, here = np.random.default_rng(0), draws_of(4, 1), np.array([1, -2, 0, 0, -1, 0, 0, 0])
    episodes(env, rules, walked, route, chart, room, rng, rng, 1.0, 1, draws, here, whole.copy(), whole, narrow, whole)
    choose(rules, walked, route, chart, room, 0, 0, 0, 0.5)
    count(walked, route, 0, 0, 1.0)
    aftermath(rules, walked, 0, True, 1, 0.5)
