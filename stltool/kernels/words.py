"""Sets of automaton states as bits of 64-bit words, for the layers of a backward induction
(checking/induction/words.py).

A *layer* lists, for each of its model states in order, the words that are not 0:

    states (n,) int32     start (n+1,) int64     word (k,) int32     bits (k,) uint64
    state states[i] has the sets bits[j] of the automaton states 64·word[j] …, for j = start[i] … start[i+1]−1

A *row* stores a set as `width` words: the automaton's, with at least one word of zeros at each end, so that shifted
reads and writes stay inside. Sets are sparse: a row comes with the word `groups`, whose bit g says whether any of its
words g·2^shift … (g+1)·2^shift − 1 was written to; the others are uninitialised.

δ is stored as *pieces*: for each letter and word, masks whose bits either all move by the same amount (`shift`) or all
go to one state (`not shift`). Counters give one to four pieces per word; any δ at most 64.

The neighbours of a state are its distinct successors: near[near_start[s] … near_start[s+1]−1]; entry k of the model's
rows leads to number position[k] of them.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from stltool.kernels.jit import kernel, part
from stltool.kernels.lanes import at, popcount, put, splat, store, trailing

I8: TypeAlias = NDArray[np.int8]
I32: TypeAlias = NDArray[np.int32]
I64: TypeAlias = NDArray[np.int64]
U64: TypeAlias = NDArray[np.uint64]

ZERO, ONE, FULL = np.uint64(0), np.uint64(1), np.uint64(2**64 - 1)
_BYTES = np.uint64(0x0101010101010101)
PLAIN, RESTRICTED, MIXED = 0, 1, 2


# ------------------------------------------------------------------------------------------------- preparation


@kernel
def reachable_states(choice_start: I64, row_start: I64, target: I32, first: I32, steps: int) -> I32:
    """The model states that runs from `first` can visit within `steps` steps, in the order of their discovery."""
    n_states = len(choice_start) - 1
    seen = np.zeros(n_states, np.bool_)
    found = np.empty(n_states, np.int32)
    n = 0
    for s in first:
        if not seen[s]:
            seen[s] = True
            found[n] = s
            n += 1
    begin = 0
    for _ in range(steps):
        end = n
        if begin == end or n == n_states:
            break
        for i in range(begin, end):
            s = found[i]
            for k in range(row_start[choice_start[s]], row_start[choice_start[s + 1]]):
                x = target[k]
                if not seen[x]:
                    seen[x] = True
                    found[n] = x
                    n += 1
        begin = end
    return found[:n]


@kernel
def submodel(choice_start: I64, row_start: I64, target: I32, kept: I32) -> tuple[I64, I64, I32, I64, I64]:
    """choice_start, row_start and target in new numbers (−1: not kept), and the choices and entries that are kept."""
    number = np.full(len(choice_start) - 1, -1, np.int32)
    for i in range(len(kept)):
        number[kept[i]] = i
    n_choices = n_entries = 0
    for s in kept:
        n_choices += choice_start[s + 1] - choice_start[s]
        n_entries += row_start[choice_start[s + 1]] - row_start[choice_start[s]]
    choices, rows = np.zeros(len(kept) + 1, np.int64), np.zeros(n_choices + 1, np.int64)
    choice, entry, successor = (
        np.empty(n_choices, np.int64),
        np.empty(n_entries, np.int64),
        np.empty(n_entries, np.int32),
    )
    n = m = 0
    for i in range(len(kept)):
        s = kept[i]
        for c in range(choice_start[s], choice_start[s + 1]):
            for k in range(row_start[c], row_start[c + 1]):
                entry[m] = k
                successor[m] = number[target[k]]
                m += 1
            choice[n] = c
            n += 1
            rows[n] = m
        choices[i + 1] = n
    return choices, rows, successor, choice, entry


@kernel
def neighbours(choice_start: I64, row_start: I64, target: I32) -> tuple[I64, I32, I32]:
    """near_start, near, position; entries with target −1 (unreachable states) get position 0 and no neighbour."""
    n_states = len(choice_start) - 1
    stamp, place = np.full(n_states, -1, np.int32), np.empty(n_states, np.int32)
    start = np.zeros(n_states + 1, np.int64)
    near, position = np.empty(len(target), np.int32), np.zeros(len(target), np.int32)
    n = 0
    for s in range(n_states):
        for k in range(row_start[choice_start[s]], row_start[choice_start[s + 1]]):
            x = target[k]
            if x < 0:
                continue
            if stamp[x] != s:
                stamp[x] = s
                place[x] = n - start[s]
                near[n] = x
                n += 1
            position[k] = place[x]
        start[s + 1] = n
    return start, near[:n].copy(), position


@kernel
def pieces(delta: I32, n_words: int) -> tuple[I64, U64, NDArray[np.bool_], I64]:
    """δ (letters, states) as pieces: start (letters·n_words + 1,), mask, whether it shifts, and the amount or the
    target."""
    n_letters, n_states = delta.shape
    start = np.zeros(n_letters * n_words + 1, np.int64)
    most = n_letters * n_states
    mask, shifts, amount = np.zeros(most, np.uint64), np.zeros(most, np.bool_), np.zeros(most, np.int64)
    n = 0
    for letter in range(n_letters):
        row = delta[letter]
        for w in range(n_words):
            lo, hi = 64 * w, min(n_states, 64 * w + 64)
            left, done = hi - lo, np.zeros(64, np.bool_)
            while left > 0:
                most_found, by_shift, value = 0, False, np.int64(0)
                for q in range(lo, hi):  # the largest piece; one with half of the remaining bits is large enough
                    if done[q - lo]:
                        continue
                    moved = together = 0
                    for r in range(q, hi):
                        if not done[r - lo]:
                            moved += row[r] - r == row[q] - q
                            together += row[r] == row[q]
                    if moved > most_found:
                        most_found, by_shift, value = moved, True, np.int64(row[q] - q)
                    if together > most_found:
                        most_found, by_shift, value = together, False, np.int64(row[q])
                    if 2 * most_found >= left:
                        break
                bits = ZERO
                for r in range(lo, hi):
                    if not done[r - lo] and (row[r] - r == value if by_shift else row[r] == value):
                        done[r - lo] = True
                        bits |= ONE << np.uint64(r - lo)
                        left -= 1
                mask[n], shifts[n], amount[n] = bits, by_shift, value
                n += 1
            start[letter * n_words + w + 1] = n
    return start, mask[:n].copy(), shifts[:n].copy(), amount[:n].copy()


@kernel
def table_masks(
    states: I32, start: I64, word: I32, bits: U64, number: I32, choice_start: I64, table: NDArray[np.integer]
) -> tuple[I64, U64, bool]:
    """A layer's masks (`unite_allowed`) for the single choice table[number[s], q], and whether it is negative
    somewhere."""
    first, masks = _room(states, start, choice_start)
    silent = False
    for i in range(len(states)):
        row = table[number[states[i]]]
        for k in range(start[i], start[i + 1]):
            left = bits[k]
            while left != ZERO:
                q = trailing(left)
                chosen = np.int64(row[64 * np.int64(word[k]) + q])
                if chosen < 0:
                    silent = True
                else:
                    masks[first[k] + chosen] |= ONE << np.uint64(q)
                left &= left - ONE
    return first, masks, silent


@kernel
def mixture_masks(
    states: I32, start: I64, word: I32, bits: U64, number: I32, choice_start: I64, table: NDArray[np.float64]
) -> tuple[I64, U64, bool]:
    """The same for all choices of positive weight table[number[s], q, i]; some choice is always defined."""
    first, masks = _room(states, start, choice_start)
    for i in range(len(states)):
        row = table[number[states[i]]]
        n_choices = choice_start[states[i] + 1] - choice_start[states[i]]
        for k in range(start[i], start[i + 1]):
            left = bits[k]
            while left != ZERO:
                q = trailing(left)
                for c in range(n_choices):
                    if row[64 * np.int64(word[k]) + q, c] > 0:
                        masks[first[k] + c] |= ONE << np.uint64(q)
                left &= left - ONE
    return first, masks, False


@kernel
def taken_masks(states: I32, start: I64, word: I32, bits: U64, choice_start: I64, taken: I64) -> tuple[I64, U64, bool]:
    """As `table_masks`, for the choices taken[i] of the layer's pairs in order."""
    first, masks = _room(states, start, choice_start)
    silent, n = False, 0
    for k in range(len(bits)):
        left = bits[k]
        while left != ZERO:
            if taken[n] < 0:
                silent = True
            else:
                masks[first[k] + taken[n]] |= left & -left
            left &= left - ONE
            n += 1
    return first, masks, silent


@kernel
def weighted_masks(
    states: I32, start: I64, word: I32, bits: U64, choice_start: I64, taken: NDArray[np.float64]
) -> tuple[I64, U64, bool]:
    """As `mixture_masks`, for weights taken[i, c] of the layer's pairs in order."""
    first, masks = _room(states, start, choice_start)
    n = 0
    for i in range(len(states)):
        n_choices = choice_start[states[i] + 1] - choice_start[states[i]]
        for k in range(start[i], start[i + 1]):
            left = bits[k]
            while left != ZERO:
                for c in range(n_choices):
                    if taken[n, c] > 0:
                        masks[first[k] + c] |= left & -left
                left &= left - ONE
                n += 1
    return first, masks, False


@kernel
def choice_masks(
    states: I32, start: I64, word: I32, bits: U64, number: I32, choice_start: I64, n_words: int, keys: I64,
    listed: U64, rank: I64, choice: NDArray[Any],
) -> tuple[I64, U64, bool]:  # fmt: skip
    """The same for choices stored by words (stltool/choices.py): 0 where none is listed; some choice is always defined.

    rank: the choices before each word.
    """
    first, masks = _room(states, start, choice_start)
    for i in range(len(states)):
        lo = _first_from(keys, np.int64(number[states[i]]) * n_words)
        for k in range(start[i], start[i + 1]):
            key = np.int64(number[states[i]]) * n_words + word[k]
            while lo < len(keys) and keys[lo] < key:
                lo += 1
            own = listed[lo] if lo < len(keys) and keys[lo] == key else ZERO
            masks[first[k]] |= bits[k] & ~own
            left = bits[k] & own
            while left != ZERO:
                q = trailing(left)
                left &= left - ONE
                below = popcount(own & ((ONE << np.uint64(q)) - ONE))
                masks[first[k] + np.int64(choice[rank[lo] + below])] |= ONE << np.uint64(q)
    return first, masks, False


@part
def _first_from(keys: I64, key: np.int64) -> np.int64:
    """np.searchsorted, which numba compiles for longer than all of its caller."""
    lo, hi = np.int64(0), np.int64(len(keys))
    while lo < hi:
        middle = (lo + hi) // 2
        if keys[middle] < key:
            lo = middle + 1
        else:
            hi = middle
    return lo


@part
def _room(states: I32, start: I64, choice_start: I64) -> tuple[I64, U64]:
    first = np.empty(start[-1], np.int64)
    n = np.int64(0)
    for i in range(len(states)):
        for k in range(start[i], start[i + 1]):
            first[k] = n
            n += choice_start[states[i] + 1] - choice_start[states[i]]
    return first, np.zeros(n, np.uint64)


# --------------------------------------------------------------------------------------------------- one step


@part
def _open_group(rows: U64, groups: U64, j: Any, d: Any, shift: int, width: int) -> None:
    """Make row j writable at word d."""
    g = d >> shift
    if not (at(groups, j) >> np.uint64(g)) & ONE:
        zero = splat(ZERO)
        for w in range(g << shift, (g + 1) << shift, 8):
            store(rows, j * width + w, zero)
        put(groups, j, at(groups, j) | (ONE << np.uint64(g)))


@kernel
def unite(
    states: I32, start: I64, word: I32, bits: U64, lo: int, hi: int, near_start: I64, near: I32,
    slot: I32, found: I32, rows: U64, groups: U64, width: int, shift: int,
) -> int:  # fmt: skip
    """For the layer's states lo … hi−1: the union of their sets in a row for each neighbour; returns the number of
    rows.

    slot (n_states,), −1 everywhere, becomes the number of a neighbour's row; found[number] is the neighbour.
    """
    n, zero = 0, splat(ZERO)
    for i in range(lo, hi):
        s, first, last = states[i], start[i], start[i + 1]
        if first == last:
            continue
        mine = ZERO
        for k in range(first, last):
            mine |= ONE << np.uint64((at(word, k) + 1) >> shift)
        for e in range(near_start[s], near_start[s + 1]):
            x = np.int64(at(near, e))
            j: Any = np.int64(at(slot, x))
            if j < 0:
                j = n
                slot[x], found[j], groups[j] = j, x, ZERO
                n += 1
            missing = mine & ~at(groups, j)
            if missing != ZERO:
                put(groups, j, at(groups, j) | missing)
                while missing != ZERO:
                    g = j * width + (trailing(missing) << shift)
                    missing &= missing - ONE
                    for w in range(g, g + (1 << shift), 8):
                        store(rows, w, zero)
            base = j * width + 1
            for k in range(first, last):
                d = base + np.int64(at(word, k))
                put(rows, d, at(rows, d) | at(bits, k))
    return n


@kernel
def unite_allowed(
    states: I32, start: I64, word: I32, bits: U64, allowed_start: I64, allowed: U64, choice_start: I64, row_start: I64,
    target: I32, slot: I32, found: I32, rows: U64, groups: U64, width: int, shift: int,
) -> int:  # fmt: skip
    """As `unite`, along the allowed choices: word k of the layer allows choice i of its state in the sets
    allowed[allowed_start[k] + i].
    """
    n = 0
    for i in range(len(states)):
        s = states[i]
        for c in range(choice_start[s], choice_start[s + 1]):
            for e in range(row_start[c], row_start[c + 1]):
                x = np.int64(target[e])
                j: Any = np.int64(slot[x])
                for k in range(start[i], start[i + 1]):
                    going = bits[k] & allowed[allowed_start[k] + c - choice_start[s]]
                    if going == ZERO:
                        continue
                    if j < 0:
                        j = n
                        slot[x], found[j], groups[j] = j, x, ZERO
                        n += 1
                    d = np.int64(word[k]) + 1
                    _open_group(rows, groups, j, d, shift, width)
                    rows[j * width + d] |= going
    return n


@kernel
def forget(slot: I32, states: I32, n: int) -> None:
    """Reset slot to −1 everywhere."""
    for i in range(n):
        slot[states[i]] = -1


def ascending(found: I32, n: int, slot: I32) -> I32:
    """found[:n] in order: sorted if they are few, else read from `slot`."""
    return np.sort(found[:n]) if 20 * n < len(slot) else _listed(n, slot)


@kernel
def _listed(n: int, slot: I32) -> I32:
    """The states with a slot, ascending."""
    ordered, i = np.empty(n, np.int32), 0
    for s in range(len(slot)):
        if slot[s] >= 0:
            ordered[i] = s
            i += 1
    return ordered


@kernel
def push(
    found: I32, slot: I32, rows: U64, groups: U64, letter: I32, piece_start: I64, piece_mask: U64,
    piece_shifts: NDArray[np.bool_], piece_amount: I64, undecided: U64, n_words: int, width: int, shift: int,
    states: I32, start: I64, word: I32, bits: U64,
) -> int:  # fmt: skip
    """The next layer: the undecided images of the rows under δ of their states' letters.

    `found` are the states that have a row (slot); undecided is a row. Fills states, start, word, bits, in the order of
    `found`; returns the number of states.
    """
    image, written = np.empty(width, np.uint64), np.zeros(1, np.uint64)
    n_states = n_bits = 0
    start[0] = 0
    for s in found:
        j = np.int64(slot[s])
        written[0] = ZERO
        base, left = letter[s] * n_words, groups[j]
        while left != ZERO:
            g = trailing(left) << shift
            left &= left - ONE
            for w in range(max(g - 1, 0), min(g + (1 << shift) - 1, n_words)):
                x = at(rows, j * width + w + 1)
                if x == ZERO:
                    continue
                for i in range(at(piece_start, base + w), at(piece_start, base + w + 1)):
                    going = x & at(piece_mask, i)
                    if going == ZERO:
                        continue
                    if at(piece_shifts, i):
                        d = 64 * (w + 1) + at(piece_amount, i)
                        offset = np.uint64(d & 63)
                        d >>= 6
                        if going << offset != ZERO:
                            _open_group(image, written, np.int64(0), d, shift, width)
                            put(image, d, at(image, d) | (going << offset))
                        if offset != ZERO and going >> (np.uint64(64) - offset) != ZERO:
                            _open_group(image, written, np.int64(0), d + 1, shift, width)
                            put(image, d + 1, at(image, d + 1) | (going >> (np.uint64(64) - offset)))
                    else:
                        d = 64 + at(piece_amount, i)
                        offset = np.uint64(d & 63)
                        d >>= 6
                        _open_group(image, written, np.int64(0), d, shift, width)
                        put(image, d, at(image, d) | (ONE << offset))
        before, left = n_bits, written[0]
        while left != ZERO:
            g = trailing(left) << shift
            left &= left - ONE
            for w in range(max(g, 1), min(g + (1 << shift), n_words + 1)):
                x = at(image, w) & at(undecided, w)
                if x != ZERO:
                    put(word, n_bits, np.int32(w - 1))
                    put(bits, n_bits, x)
                    n_bits += 1
        if n_bits > before:
            states[n_states] = s
            n_states += 1
            start[n_states] = n_bits
    return n_states


@kernel
def collect(
    found: I32, slot: I32, rows: U64, groups: U64, n_words: int, width: int, shift: int,
    start: I64, word: I32, bits: U64,
) -> int:  # fmt: skip
    """The rows of the states `found` as a layer: fills start (n+1,), word, bits; returns the number of words."""
    n = 0
    start[0] = 0
    for i in range(len(found)):
        j = np.int64(slot[found[i]])
        left = groups[j]
        while left != ZERO:
            g = trailing(left) << shift
            left &= left - ONE
            for w in range(max(g, 1), min(g + (1 << shift), n_words + 1)):
                x = at(rows, j * width + w)
                if x != ZERO:
                    put(word, n, np.int32(w - 1))
                    put(bits, n, x)
                    n += 1
        start[i + 1] = n
    return n


@kernel
def pull(
    found: I32, n: int, rows: U64, groups: U64, slot: I32, start: I64, word: I32, open_bits: U64, sure_bits: U64,
    goal: U64, letter: I32, piece_start: I64, piece_mask: U64, piece_shifts: NDArray[np.bool_], piece_amount: I64,
    n_words: int, width: int, shift: int, possible: U64, certain: U64, somewhere: NDArray[np.bool_],
) -> None:  # fmt: skip
    """From the next layer back: which automaton states of each row lead into a set, before the letter is read.

    The next layer's state x has number slot[x] (−1: none), where open_bits and sure_bits are set; `goal` is the row of
    verdicts that count as sure. Row j of `possible`, in the same groups: those of rows[j] whose image is open, sure or
    a goal; of `certain`: sure or a goal; somewhere[j] whether `certain` has any.
    """
    ahead, sure = goal.copy(), goal.copy()
    for j in range(n):
        s = found[j]
        i: Any = np.int64(slot[s])
        if i >= 0:
            for k in range(start[i], start[i + 1]):
                d = np.int64(at(word, k)) + 1
                put(sure, d, at(sure, d) | at(sure_bits, k))
                put(ahead, d, at(ahead, d) | at(sure_bits, k) | at(open_bits, k))
        base, any_sure, left = letter[s] * n_words, False, groups[j]
        while left != ZERO:
            g = trailing(left) << shift
            left &= left - ONE
            for w in range(max(g - 1, 0), min(g + (1 << shift) - 1, n_words)):
                x = at(rows, j * width + w + 1)
                here, here_sure = ZERO, ZERO
                if x != ZERO:
                    for p in range(at(piece_start, base + w), at(piece_start, base + w + 1)):
                        coming = x & at(piece_mask, p)
                        if coming == ZERO:
                            continue
                        if at(piece_shifts, p):
                            d = 64 * (w + 1) + at(piece_amount, p)
                            offset = np.uint64(d & 63)
                            d >>= 6
                            y, z = at(ahead, d) >> offset, at(sure, d) >> offset
                            if offset != ZERO:
                                back = np.uint64(64) - offset
                                y |= at(ahead, d + 1) << back
                                z |= at(sure, d + 1) << back
                            here |= y & coming
                            here_sure |= z & coming
                        else:
                            d = 64 + at(piece_amount, p)
                            offset = np.uint64(d & 63)
                            d >>= 6
                            if (at(ahead, d) >> offset) & ONE:
                                here |= coming
                            if (at(sure, d) >> offset) & ONE:
                                here_sure |= coming
                put(possible, j * width + w + 1, here)
                put(certain, j * width + w + 1, here_sure)
                any_sure |= here_sure != ZERO
        somewhere[j] = any_sure
        if i >= 0:  # unchanged
            for k in range(start[i], start[i + 1]):
                d = np.int64(at(word, k)) + 1
                put(sure, d, at(goal, d))
                put(ahead, d, at(goal, d))


@part
def spread(x: Any) -> Any:
    """Bit 8·b is set where byte b of x is not 0."""
    x |= x >> np.uint64(4)
    x |= x >> np.uint64(2)
    x |= x >> np.uint64(1)
    return x & _BYTES


@kernel
def decide(
    states: I32, start: I64, word: I32, bits: U64, lo: int, hi: int, slot: I32, choice_start: I64, row_start: I64,
    position: I32, near_start: I64, near: I32, width: int, possible: U64, certain: U64,
    somewhere: NDArray[np.bool_], mode: int, allowed_start: I64, allowed: U64, ask_live: bool, ask_sure: bool,
    keep: bool, states_out: I32, start_out: I64, word_out: I32, open_out: U64, sure_out: U64, tiles_out: I64,
    sure_choice: NDArray[np.unsignedinteger],
) -> tuple[int, int]:  # fmt: skip
    """Which pairs of a layer are sure (some choice leads only to sure ones), which are open, and which are neither.

    `possible`, `certain`, `somewhere` from `pull`, by rows of `slot`. mode PLAIN: over all choices; RESTRICTED: over
    the allowed ones; MIXED: a pair is sure if all its allowed choices are, since each may be taken. Without `sure`,
    sure pairs count as open; without `live`, all others do. The new layer lists what is open or sure; tiles_out (n+1,)
    counts its nonempty tiles of eight automaton states. With `keep`, sure_choice gets the first choice that makes each
    sure pair sure, in order. Returns the numbers of states and of sure pairs.
    """
    rows = np.empty(_longest(near_start), np.int64)
    chosen = np.empty(64, sure_choice.dtype)
    n_states = n_bits = n_tiles = n_sure = 0
    start_out[0] = tiles_out[0] = 0
    for i in range(lo, hi):
        s = states[i]
        first, n_near = near_start[s], near_start[s + 1] - near_start[s]
        c0, c1 = choice_start[s], choice_start[s + 1]
        any_sure = False
        for e in range(n_near):
            j = np.int64(slot[near[first + e]])
            put(rows, e, j * width + 1)
            any_sure |= somewhere[j]
        before = n_bits
        for k in range(start[i], start[i + 1]):
            here, w = at(bits, k), np.int64(at(word, k))
            mine = allowed_start[k] if mode != PLAIN else np.int64(0)
            live = ZERO
            if not ask_live:
                live = here
            elif mode == PLAIN:
                for e in range(n_near):
                    live |= at(possible, at(rows, e) + w)
                live &= here
            else:
                for c in range(c0, c1):
                    taking = here & at(allowed, mine + c - c0)
                    if taking & ~live != ZERO:
                        for e in range(at(row_start, c), at(row_start, c + 1)):
                            live |= taking & at(possible, at(rows, np.int64(at(position, e))) + w)
            if live == ZERO:
                continue
            sure, left = ZERO, ZERO
            if not ask_sure:
                pass
            elif any_sure and mode == PLAIN:
                for e in range(n_near):
                    left |= at(certain, at(rows, e) + w)
                left &= live
            elif any_sure:
                left = live
            if mode == MIXED:
                for c in range(c0, c1):
                    taking = left & at(allowed, mine + c - c0)
                    if taking != ZERO:
                        for e in range(at(row_start, c), at(row_start, c + 1)):
                            taking &= at(certain, at(rows, np.int64(at(position, e))) + w)
                        left &= taking | ~at(allowed, mine + c - c0)
                sure = left
            else:
                c = c0
                while left != ZERO and c < c1:
                    x = left
                    if mode == RESTRICTED:
                        x &= at(allowed, mine + c - c0)
                    e = at(row_start, c)
                    while x != ZERO and e < at(row_start, c + 1):
                        x &= at(certain, at(rows, np.int64(at(position, e))) + w)
                        e += 1
                    sure |= x
                    left &= ~x
                    while keep and x != ZERO:
                        chosen[trailing(x)] = c - c0
                        x &= x - ONE
                    c += 1
                x = sure
                while keep and x != ZERO:
                    sure_choice[n_sure] = chosen[trailing(x)]
                    n_sure += 1
                    x &= x - ONE
            put(word_out, n_bits, np.int32(w))
            put(sure_out, n_bits, sure)
            put(open_out, n_bits, live & ~sure)
            n_bits += 1
            n_tiles += popcount(spread(live))
        if n_bits > before:
            states_out[n_states] = s
            n_states += 1
            start_out[n_states], tiles_out[n_states] = n_bits, n_tiles
    return n_states, n_sure


@kernel
def merge_choices(
    open_bits: U64, sure_bits: U64, by_tile: bool, open_choice: NDArray[np.unsignedinteger],
    sure_choice: NDArray[np.unsignedinteger], out: NDArray[np.unsignedinteger],
) -> None:  # fmt: skip
    """The choices of open and of sure pairs, merged in order; those of open ones are given one by one, or by tiles of
    the layer."""
    n = opened = sure = tile = 0
    for k in range(len(open_bits)):
        both, between = open_bits[k] | sure_bits[k], open_bits[k]
        tiles = spread(both)
        while both != ZERO:
            bit = trailing(both)
            both &= both - ONE
            if (between >> np.uint64(bit)) & ONE:
                if by_tile:
                    before = popcount(tiles & ((ONE << np.uint64(bit & 56)) - ONE))
                    out[n] = open_choice[8 * (tile + before) + (bit & 7)]
                else:
                    out[n] = open_choice[opened]
                opened += 1
            else:
                out[n] = sure_choice[sure]
                sure += 1
            n += 1
        tile += popcount(tiles)


@kernel
def count_edges(
    states: I32, start: I64, word: I32, open_bits: U64, lo: int, hi: int, choice_start: I64, row_start: I64, mode: int,
    allowed_start: I64, allowed: U64,
) -> tuple[int, int, int]:  # fmt: skip
    """The numbers of open pairs of the layer's states lo … hi−1, of their choices that count, and of the edges of
    those."""
    n_pairs = n_choices = n_edges = 0
    for i in range(lo, hi):
        s = states[i]
        for k in range(start[i], start[i + 1]):
            n_pairs += popcount(open_bits[k])
            for c in range(choice_start[s], choice_start[s + 1]):
                taking = open_bits[k]
                if mode != PLAIN:
                    taking &= allowed[allowed_start[k] + c - choice_start[s]]
                n = popcount(taking)
                n_choices += n
                n_edges += n * (row_start[c + 1] - row_start[c])
    return n_pairs, n_choices, n_edges


@kernel
def list_edges(
    states: I32, start: I64, word: I32, open_bits: U64, lo: int, hi: int, choice_start: I64, row_start: I64,
    target: I32, mode: int, allowed_start: I64, allowed: U64, slot: I32, start_ahead: I64, word_ahead: I32,
    open_ahead: U64, sure_ahead: U64, rank_ahead: I64, undecided: U64, goal: U64, letter: I32, delta: I32,
    entry: I64, model_choice: I64,
    s_out: I64, q_out: I64, choices: I64, choice: I64, edge_start: I64, edge: I64, child: I64,
) -> None:  # fmt: skip
    """Fill an `Edges`, pair by pair; rank_ahead: open pairs before each word of the layer ahead.

    model_choice: the model's number of each choice here.
    """
    n = m = e = 0
    choices[0] = edge_start[0] = 0
    for i in range(lo, hi):
        s = states[i]
        for k in range(start[i], start[i + 1]):
            left = open_bits[k]
            while left != ZERO:
                bit = trailing(left)
                left &= left - ONE
                q = 64 * np.int64(word[k]) + bit
                s_out[n], q_out[n] = s, q
                for c in range(choice_start[s], choice_start[s + 1]):
                    if mode != PLAIN and not (allowed[allowed_start[k] + c - choice_start[s]] >> np.uint64(bit)) & ONE:
                        continue
                    for j in range(row_start[c], row_start[c + 1]):
                        x = target[j]
                        after = np.int64(delta[letter[x], q])
                        w, one = after >> 6, ONE << np.uint64(after & 63)
                        found: Any = np.int64(0)
                        if not undecided[w + 1] & one:
                            found = np.int64(1 if goal[w + 1] & one else 0)
                        elif slot[x] >= 0:
                            a, b = start_ahead[slot[x]], start_ahead[slot[x] + 1]
                            while a < b:  # finds the word, if it is listed
                                middle = (a + b) >> 1
                                if word_ahead[middle] < w:
                                    a = middle + 1
                                else:
                                    b = middle
                            if a < start_ahead[slot[x] + 1] and word_ahead[a] == w:
                                if open_ahead[a] & one:
                                    found = 2 + rank_ahead[a] + popcount(open_ahead[a] & (one - ONE))
                                elif sure_ahead[a] & one:
                                    found = 1
                        edge[e] = entry[j]
                        child[e] = found
                        e += 1
                    choice[m] = model_choice[c]
                    m += 1
                    edge_start[m] = e
                n += 1
                choices[n] = m


@part
def _longest(start: I64) -> int:
    longest = 1
    for s in range(len(start) - 1):
        longest = max(longest, start[s + 1] - start[s])
    return longest
