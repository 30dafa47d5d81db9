"""Certificates: what is proved is true, and no single entry can be changed into a lie."""

import functools
import gzip
import hashlib
import itertools
import json
import random
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool import recheck
from stltool.checking import proof, require_certificate_of
from stltool.checking.induction import layers_of
from stltool.errors import ArgumentError, CertificateError, FileError, ModelError, RefusedError, SizeError
from stltool.reporting import check_data
from tests import oracles
from tests.conftest import ROOT, many

FORMULAS = ["F[0,3] (A & B)", "G[0,2] F[0,1] A", "A U[1,3] B", "F[0,3] A & G[0,2] (A -> F[1,2] B)"]


def results(seed, denominators=(1, 10, 300, 10**6, 3 * 10**17), count=20):
    """Results of every kind: optimum and minimum, policies that mix or not, rounded and exact."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        model = oracles.random_model(rng, denominators[i % len(denominators)])
        product = stl.build_product(model, stl.parse(FORMULAS[i % len(FORMULAS)]))
        weights = rng.random((product.horizon, *product.shape, 2))
        weights[..., 0] *= rng.integers(0, 2, product.shape)  # some choices are never taken
        mixed = stl.Policy(product, weights / weights.sum(axis=-1, keepdims=True))
        table = rng.integers(0, 2, (product.horizon, *product.shape)[i % 2 :]).astype(np.int16)
        for policy, maximize in ((None, True), (None, False), (mixed, True), (stl.Policy(product, table), True)):
            for exact in (False, True):
                yield stl.check(product, policy, maximize=maximize, exact=exact)


def interval_results(seed, denominators=(16, 10, 300), count=6):
    """The same for models with intervals: every question, of either nature."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        D = denominators[i % len(denominators)]
        point = oracles.random_model(rng, D)
        rows = np.full((2, 3, 3), Fraction(0), dtype=object)
        for s in range(3):
            for c in range(point.choice_start[s], point.choice_start[s + 1]):
                for k in range(point.row_start[c], point.row_start[c + 1]):
                    share = Fraction(int(point.rows.numerator[k]), point.rows.denominator)
                    rows[point.choice_action[c], s, point.target[k]] = share
        down, up = (np.vectorize(lambda n, D=D: Fraction(int(n), D))(rng.integers(0, D // 3, rows.shape)) for _ in "du")
        lower, upper = np.maximum(rows - down, Fraction(0)), np.minimum(rows + up, Fraction(1))
        labels = {name: rng.integers(0, 2, 3) for name in "AB"}
        model = stl.MDP.from_intervals(lower, upper, {"x": np.arange(3)}, point.initial, labels)
        product = stl.build_product(model, stl.parse(FORMULAS[i % len(FORMULAS)]))
        weights = rng.integers([0, 1], [4, 5], (product.horizon, *product.shape, 2))
        mixed = stl.Policy(product, weights / weights.sum(axis=-1, keepdims=True))
        policy = stl.Policy(product, rng.integers(0, 2, product.shape).astype(np.int16))
        for given, maximize, nature in itertools.product((None, mixed, policy), (True, False), ("against", "with")):
            for exact in (False, True):
                yield stl.robust_check(product, given, maximize=maximize, nature=nature, exact=exact)


def blocks_of(parts):
    """The parts between objects, each with its object, in order: header, model, automaton, policies and layers."""
    blocks = []
    for part in parts:
        if isinstance(part, dict):
            blocks.append((part, []))
        else:
            blocks[-1][1].append(part)
    return blocks


def truth_of(parts):
    """Where the claimed quantity of a certificate's own model and automaton lies, pair by pair in fractions.

    What rows lack of 1, what follows states without choices, and what a policy does where it lists nothing may be
    anything: so these are two fractions.
    """
    (header, _), (denominators, model), (sizes, rows), *blocks = blocks_of(parts)
    delta, verdicts = rows[: sizes["letters"]], rows[sizes["letters"] :]
    horizon, D, claim = header["horizon"], denominators["denominator"], header["claim"]
    share_of = {s: Fraction(share, denominators["initial_denominator"]) for s, share, *_ in model}
    letter, choices = {s: letter for s, _, letter, *_ in model}, {s: choices for s, _, _, *choices in model}

    def chosen(t, s, q):
        for head, rows in blocks:
            if "policy" in head and head["policy"][0] <= t <= head["policy"][1]:
                for state, mask, taken in rows:
                    if state == s and int(mask, 16) >> q & 1:
                        if isinstance(taken, int):
                            return [Fraction(c == taken) for c in range(len(choices[s]))]
                        return [Fraction(weight, sum(taken)) for weight in taken]
        return None

    def outcome(t, q, row):
        if header["nature"] is not None:
            after = [value(t + 1, s, delta[letter[s]][q]) for s in row[::3]]
            ends = [(Fraction(low, D), Fraction(high, D)) for low, high in zip(row[1::3], row[2::3], strict=True)]
            nature, corners = min if header["nature"] == "least" else max, oracles.vertices(ends)
            sums = ([sum(p * v[end] for p, v in zip(c, after, strict=True)) for c in corners] for end in (0, 1))
            return tuple(map(nature, sums))
        lack = 1 - Fraction(sum(row[1::2]), D)
        low, high = (
            sum(Fraction(n, D) * value(t + 1, s, delta[letter[s]][q])[end] for s, n in pairs(row)) for end in (0, 1)
        )
        return low + min(lack, 0), high + max(lack, 0)

    def pairs(row):
        return zip(row[::2], row[1::2], strict=True)

    @functools.cache
    def value(t, s, q):
        verdict = [row for start, row in zip(sizes["verdicts"], verdicts, strict=True) if start <= t][-1][q]
        weights = chosen(t, s, q) if claim == "policy" else None
        if verdict >= 0:
            return Fraction(verdict), Fraction(verdict)
        if t == horizon or not choices[s] or (claim == "policy" and weights is None):
            return Fraction(0), Fraction(1)
        if claim == "policy":
            taken = [(w, outcome(t, q, row)) for w, row in zip(weights, choices[s], strict=True) if w]
            return sum(w * low for w, (low, _) in taken), sum(w * high for w, (_, high) in taken)
        lows, highs = zip(*(outcome(t, q, row) for row in choices[s]), strict=True)
        return (max(lows), max(highs)) if claim == "maximum" else (min(lows), min(highs))

    lack = 1 - sum(share_of.values())
    starts = [(share, value(0, s, delta[letter[s]][sizes["start"]])) for s, share in share_of.items() if share]
    low, high = (sum(share * ends[end] for share, ends in starts) for end in (0, 1))
    return max(low + min(lack, 0), Fraction(0)), min(high + max(lack, 0), Fraction(1))


def read(path):
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def write(path, parts, seal=True):
    """The parts as a file, sealed as a liar would."""
    lines = [json.dumps(part) + "\n" for part in parts]
    digest = hashlib.sha256("".join(lines).encode()).hexdigest()
    path.write_text("".join(lines) + (json.dumps({"sha256": digest}) + "\n" if seal else ""), encoding="utf-8")
    return str(path)


def test_certificates_prove_their_results(tmp_path):
    path = tmp_path / "c.jsonl"
    for result in results(seed=1, count=many(15)):
        stl.write_certificate(result, path)
        proved = stl.certify(str(path))
        require_certificate_of(path, result.product, result.policy if result.question == "policy" else None)
        lower, upper = Fraction(proved["lower"]), Fraction(proved["upper"])
        truth, also = truth_of(read(path)[:-2])
        assert truth == also  # what is left out does not matter
        assert lower <= truth <= upper
        assert (proved["claim"], proved["defect"]) == (result.question, "0")
        if result.fraction is not None:
            assert lower == truth == upper == result.fraction
        else:
            assert upper - lower < 1e-13
            assert lower <= result.upper
            assert result.lower <= upper


def test_certificates_of_intervals_prove_what_nature_leaves(tmp_path):
    """Against trees of all histories, and against the corners of the intervals that the file lists."""
    path = tmp_path / "c.jsonl"
    for result in interval_results(seed=11, count=many(3)):
        product, policy = result.product, result.policy if result.question == "policy" else None
        stl.write_certificate(result, path)
        proved = stl.certify(path)
        require_certificate_of(path, product, policy)
        lower, upper = Fraction(proved["lower"]), Fraction(proved["upper"])
        assert (proved["claim"], proved["nature"], proved["defect"]) == (result.question, result.natures_aim, "0")
        truth, also = truth_of(read(path)[:-2])
        assert lower <= truth == also <= upper
        if result.fraction is None:
            assert upper - lower < 1e-12
            assert lower <= result.upper
            assert result.lower <= upper
            continue
        assert lower == truth == upper == result.fraction
        least = result.natures_aim == "least"
        if policy is None and (product.model.intervals.lower * 16 % 1 == 0).all():
            tree = oracles.robust_optimum(product.model, product.formula, result.question == "maximum", least)
            assert tree == truth


def test_a_certificate_of_intervals_is_refused_where_something_else_was_meant(tmp_path):
    """Another interval, nature, or model: refused by the checker, or named by the comparison."""
    path = tmp_path / "c.jsonl"
    model = stl.MDP.from_intervals(
        [[["0.1", "0.6"], ["0", "1"]]], [[["0.4", "0.9"], ["0", "1"]]], {}, labels={"goal": [0, 1]}
    )
    product = stl.build_product(model, stl.parse("F[0,2] goal"))
    for maximize, nature, aim, proved in (
        (True, "against", "least", "21/25"), (True, "with", "greatest", "99/100"),
        (False, "against", "greatest", "99/100"), (False, "with", "least", "21/25"),
    ):  # fmt: skip
        stl.write_certificate(stl.robust_check(product, maximize=maximize, nature=nature, exact=True), path)
        *parts, _ = read(path)
        assert (parts[0]["nature"], parts[-1]) == (aim, {"lower": proved, "upper": proved})
        assert parts[2] == [0, 1, 0, [0, 1, 4, 1, 6, 9]]
        other = {"least": "greatest", "greatest": "least"}[aim]
        for change, says in (
            (lambda m, other=other: m.header.__setitem__("nature", other), "bound is not proved"),
            (lambda m: m.header.__setitem__("nature", None), "not a list of pairs|is not proved|not listed"),
            (lambda m: m.header.__setitem__("nature", "against"), "unknown nature 'against'"),
            (lambda m: m.header.pop("nature"), "expected an object with the keys"),
            (lambda m: m.model[0][3].__setitem__(slice(0, 6), [0, 2, 3, 1, 7, 8]), "bound is not proved"),
            (lambda m: m.model[0][3].__setitem__(slice(0, 6), [0, 0, 5, 1, 5, 10]), "bound is not proved"),
            (lambda m: m.model[0][3].__setitem__(1, 5), "model state 0: a lower end is above the upper end"),
            (lambda m: m.model[0][3].__setitem__(1, -1), "a negative number"),
            (lambda m: m.model[0][3].__setitem__(5, 5), "a lower end is above the upper end"),
            (lambda m: m.model[0][3].__setitem__(slice(4, 6), [5, 5]), "no probabilities between the ends sum to 1"),
            (lambda m: m.model[0][3].__setitem__(slice(4, 6), [10, 10]), "no probabilities between the ends sum to 1"),
            (lambda m: m.model[0][3].pop(), "not a list of triples of integers"),
            (lambda m: m.layers[1][1][0].__setitem__(0, "11"), "bound is not proved"),
            (lambda m: m.conclusion.__setitem__("lower", "199/200"), "the claimed lower bound is not proved"),
            (lambda m: m.conclusion.__setitem__("upper", "1/2"), "the claimed upper bound is not proved"),
        ):
            with pytest.raises(CertificateError, match=says):
                stl.certify(write(path, with_change(parts, change)))
        write(path, parts)
        require_certificate_of(path, product)
        with pytest.raises(CertificateError, match="for a model with intervals, unlike model"):
            require_certificate_of(path, replace(product, model=model.nominal()))
        wide = stl.MDP.from_intervals(
            [[["0.1", "0.6"], ["0", "1"]]], [[["0.45", "0.9"], ["0", "1"]]], {}, labels={"goal": [0, 1]}
        )
        with pytest.raises(CertificateError, match="for another model"):
            require_certificate_of(path, stl.build_product(wide, product.formula))
    stl.write_certificate(stl.check(replace(product, model=model.nominal())), path)
    require_certificate_of(path, product)  # of the nominal probabilities
    uneven = stl.MDP.from_intervals([[[1 / 3, 2 / 3], [0, 1]]], [[[1 / 3, 2 / 3], [0, 1]]], {}, labels={"goal": [0, 1]})
    result = stl.robust_check(stl.build_product(uneven, product.formula))
    with pytest.raises(ModelError, match="sum to 1 exactly, so there is no exact answer or certificate"):
        stl.write_certificate(result, tmp_path / "none.jsonl")
    assert not (tmp_path / "none.jsonl").exists()


def test_tables_of_any_length(tmp_path, monkeypatch):
    """Tables that start anew when they are full, and places of any number of digits."""
    path = tmp_path / "c.jsonl"
    for result in results(seed=6, count=4):
        stl.write_certificate(result, path)
        bounds = stl.certify(path)
        with monkeypatch.context() as patched:
            patched.setattr(proof, "_TABLE", 5)
            few = ((2, "B"), (4, "H"), (2**32, "I"))
            patched.setattr(recheck, "PLACES", few)
            sizes = [(most, size, kind) for (most, _), (_, size, kind) in zip(few, proof._PLACES, strict=True)]
            patched.setattr(proof, "_PLACES", sizes)
            patched.setattr(proof, "_NUMBERS", 30)
            stl.write_certificate(result, path)
            assert stl.certify(path) == bounds
        known = [part["known"] for part in read(path) if isinstance(part, dict) and "known" in part]
        assert max(known, default=0) <= 5


def test_sets_move_through_any_letter():
    rng = np.random.default_rng(7)
    for n in (1, 5, 64, 700):
        for after in (
            rng.integers(0, n, n),
            rng.permutation(n),
            np.minimum(np.arange(n) + 3, n - 1),
            np.zeros(n, dtype=int),
        ):
            letter = recheck.Letter(after.tolist())
            for density in (0, 0.1, 0.9, 1):
                ends = recheck.set_of(np.flatnonzero(rng.random(n) < density).tolist(), n)
                assert recheck.members(letter.before(ends)) == [q for q in range(n) if ends >> int(after[q]) & 1]


def test_a_forged_certificate_cannot_take_for_ever(tmp_path, monkeypatch):
    """Two states that follow one another, and a verdict on the last: what is certain changes at every step."""
    path, names = tmp_path / "c.jsonl", ("task", "formula", "encoding", "model", "policy")
    for horizon in (101, 10**15):
        parts = [
            {"format": recheck.FORMAT, "claim": "maximum", "nature": None, "horizon": horizon, **dict.fromkeys(names)},
            {"denominator": 1, "initial_denominator": 1}, [0, 1, 0, [1, 1]], [1, 0, 1, [0, 1]],
            {"states": 2, "letters": 2, "start": 0, "verdicts": [0, horizon]}, [0, 0], [1, 1], [-1, -1], [0, 1],
            {"layer": [0, horizon - 1], "scale": "1", "known": 0}, {"lower": "1", "upper": "1"},
        ]  # fmt: skip
        write(path, parts)
        if horizon == 101:
            assert (stl.certify(path)["pairs"], truth_of(parts[:-1])) == (0, (1, 1))
    monkeypatch.setattr(recheck, "WORK", 1000)
    with pytest.raises(RefusedError, match="step .*: it takes more work than the size of the file allows"):
        stl.certify(path)


def test_damaged_bytes_are_noticed(tmp_path, patrolling):
    path, rng = tmp_path / "c.jsonl", random.Random(8)
    stl.write_certificate(stl.check(patrolling), path)
    whole, packed = path.read_bytes(), gzip.compress(path.read_bytes())
    for _ in range(many(60)):
        damaged = bytearray(whole)
        i = rng.randrange(len(whole))
        damaged[i : i + rng.choice([0, 1, 1, 40])] = rng.choice([b"", b"0", b"\n", b"\xff", b"9" * 50, b"[1]"])
        if damaged != whole:
            path.write_bytes(damaged)
            with pytest.raises(CertificateError):
                stl.certify(path)
            path.write_bytes(packed[: i % len(packed)])
            with pytest.raises(CertificateError):
                stl.certify(path)


def test_engines_write_the_same(tmp_path, monkeypatch):
    few, words = tmp_path / "few.jsonl", tmp_path / "words.jsonl"
    for result in itertools.chain(
        results(seed=5, count=5), itertools.islice(interval_results(seed=13, count=1), 0, None, 5)
    ):
        stl.write_certificate(result, few)
        with monkeypatch.context() as patched:
            patched.setattr(proof, "layers_of", functools.partial(layers_of, engine="words"))
            stl.write_certificate(result, words)
        assert words.read_bytes() == few.read_bytes()


def entries(node, path=()):
    """The places of all numbers in a certificate's parts, hexadecimal ones and fractions too."""
    if isinstance(node, dict | list):
        for key, below in node.items() if isinstance(node, dict) else enumerate(node):
            yield from entries(below, (*path, key))
    elif isinstance(node, int) or (isinstance(node, str) and len(path) > 1 and path[0] > 0):
        yield path


def changed_entry(rng, entry):
    """Another number, or a text with another digit."""
    if isinstance(entry, int):
        return entry + rng.choice([-1, 1, 1, 7, -(10**6), 10**17])
    i = rng.randrange(len(entry))
    digits = "0123456789" if "/" in entry or entry in "01" else "0123456789abcdef"
    return entry[:i] + rng.choice([digit for digit in digits if digit != entry[i]]) + entry[i + 1 :]


def test_no_changed_entry_becomes_a_lie(tmp_path):
    """Entries are changed one by one. Unsealed, each is refused; resealed, what is still accepted is still true."""
    path, rng = tmp_path / "c.jsonl", random.Random(2)
    accepted = refused = 0
    count = many(4)
    mixed = itertools.chain(
        results(seed=3, denominators=(10, 16), count=count),
        itertools.islice(interval_results(seed=12, count=max(1, count // 4)), 0, None, 5),
    )
    for result in mixed:
        stl.write_certificate(result, path)
        parts = read(path)
        *content, seal = parts
        places = list(entries(content))
        for place in rng.sample(places, min(25, len(places))):
            changed = json.loads(json.dumps(content))
            node = changed
            for key in place[:-1]:
                node = node[key]
            node[place[-1]] = changed_entry(rng, node[place[-1]])
            unsealed = write(path, [*changed, seal], seal=False)
            with pytest.raises(CertificateError):
                stl.certify(unsealed)
            try:
                proved = stl.certify(write(path, changed))
            except CertificateError:
                refused += 1
                continue
            accepted += 1
            low, high = truth_of(changed[:-1])
            assert Fraction(proved["lower"]) <= low <= high <= Fraction(proved["upper"]), place
    assert refused > 75 * count
    assert accepted > 7 * count  # where bounds have slack, or unreached states are concerned


def test_what_is_certain_is_not_listed_and_cannot_be_lied_about(tmp_path):
    model = stl.MDP.from_arrays([[[0, 1], [0, 1]]], {"x": [0, 1]})
    result = stl.check(stl.build_product(model, stl.parse("F[0,2] x > 2")), exact=True)
    sure = stl.check(stl.build_product(model, stl.parse("F[0,2] x > 0")), exact=True)
    path = tmp_path / "c.jsonl"
    for honest, key, lie in ((result, "lower", 1), (sure, "upper", 0)):
        for worst in (honest, stl.check(honest.product, maximize=False)):
            assert stl.write_certificate(worst, path) == (honest.probability, honest.probability)
            assert stl.certify(path)["pairs"] == 0
            *parts, _ = read(path)
            for bounds in ({key: str(lie)}, {"lower": str(lie), "upper": str(lie)}):
                with pytest.raises(RefusedError, match=f"the claimed {key} bound is not proved$"):
                    stl.certify(write(path, [*parts[:-1], parts[-1] | bounds]))


def test_a_number_is_refused_where_the_verdict_is_known(tmp_path):
    """One that would make its pair more than certain."""
    model = stl.MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], {"x": [0, 1]})
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(stl.build_product(model, stl.parse("G[0,2] x < 1")), exact=True), path)
    *parts, _ = read(path)
    for number, part in enumerate(parts):
        if isinstance(part, list) and len(part) == 3 and isinstance(part[1], str):
            changed = json.loads(json.dumps(parts))
            changed[number] = [part[0], "3", 2 * part[2]]  # of both automaton states
            with pytest.raises(RefusedError, match="a number where the verdict is known"):
                stl.certify(write(path, changed))
            return
    raise AssertionError("no number is listed")


def test_steps_that_repeat_are_listed_once(tmp_path, patrolling, floor5):
    """The sweep becomes stationary: a certificate of a million steps is short."""
    path = tmp_path / "c.jsonl"
    for text in ("F[0,1000000] A", "F[900000,1000000] (A & x > 0.6)"):
        result = stl.check(stl.build_product(floor5, stl.parse(text)), keep_policy=False)
        stl.write_certificate(result, path)
        proved = stl.certify(path)
        assert proved["steps"] == 1000000
        assert Fraction(proved["lower"]) <= result.probability <= Fraction(proved["upper"])
        layers = [part["layer"] for part in read(path) if isinstance(part, dict) and "layer" in part]
        assert len(layers) < 500
        assert [first for first, _ in layers] == [last + 1 for _, last in layers[1:]] + [0]
        longest = max(range(len(layers)), key=lambda i: layers[i][1] - layers[i][0])
        first, last = layers[longest]
        *parts, _ = read(path)
        place = next(i for i, part in enumerate(parts) if isinstance(part, dict) and part.get("layer") == [first, last])
        parts[place] = parts[place] | {"layer": [first - 1, last]}  # which the layer before does not fit
        with pytest.raises(CertificateError):
            stl.certify(write(path, parts))


def test_a_layer_of_many_steps_must_fit_itself(tmp_path):
    """Numbers that hold for one step only are refused for two, and a step that is left out is missed."""
    model = stl.MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], {"x": [0, 1]})
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(stl.build_product(model, stl.parse("F[0,8] x > 0"))), path)
    *parts, _ = read(path)
    (first, (numbers, *rows)), (second, (more, *_)), *_ = [block for block in blocks_of(parts) if "layer" in block[0]]
    begin, end = parts.index(first), parts.index(second) + 3
    together = {**first, "layer": [second["layer"][0], first["layer"][1]]}
    with pytest.raises(RefusedError, match="bound is not proved; the largest distance is at step 5, model state 0"):
        stl.certify(write(path, [*parts[:begin], together, numbers, more, *rows, *parts[end:]]))
    with pytest.raises(RefusedError, match="expected steps that end with 6, found"):
        stl.certify(write(path, [*parts[: begin + 3], *parts[end:]]))


def test_what_numbers_are_off_by_counts_at_every_step(tmp_path):
    """One number for 50 steps, whose distance from what a step makes of it is a sixtieth."""
    model = stl.MDP.from_arrays([[["2/3", "1/3"], [0, 1]]], {"x": [0, 1]})
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(stl.build_product(model, stl.parse("F[0,50] x > 0"))), path)
    *parts, _ = read(path)
    begin = next(i for i, part in enumerate(parts) if isinstance(part, dict) and "layer" in part)
    truth, _ = truth_of(parts[:-1])
    state, mask, _ = next(part for part in parts[begin:] if isinstance(part, list) and len(part) == 3)
    number, little = Fraction(19, 20), Fraction(1, 10**9)
    lines = [*parts[:begin], {"layer": [0, 49], "scale": "14", "known": 0}, ["13"], [state, mask, "00"]]
    apart = [{**lines[begin], "layer": [49, 49]}, *lines[begin + 1 :]]
    for steps in ([48, 48], [0, 47]):
        apart += [{"layer": steps, "scale": "1", "known": 1}, [state, mask, "00"]]
    for listed in (lines, [*parts[:begin], *apart]):
        for upper in (number, number + Fraction(2, 60), number + Fraction(48, 60)):
            with pytest.raises(RefusedError, match="the claimed upper bound is not proved"):
                stl.certify(write(path, [*listed, {"lower": "0", "upper": str(min(upper, truth - little))}]))
    last = Fraction(1, 3)  # which is what the last step makes of the verdicts
    stl.certify(write(path, [*lines, {"lower": str(last - little), "upper": "1"}]))
    with pytest.raises(RefusedError, match="the claimed lower bound is not proved"):
        stl.certify(write(path, [*lines, {"lower": str(last + little), "upper": "1"}]))


def test_only_what_runs_reach_of_a_model_is_listed(tmp_path):
    """A floor of 14 400 cells, of which 8 steps reach few; what lies beyond may be different."""
    rows = ["." * 120 for _ in range(120)]
    rows[60] = "." * 60 + "S.A" + "." * 57
    kind = 'kind = "grid"\nmoves = "king"\nsuccess = "9/10"\nslip = "1/30"\n'
    (tmp_path / "large.toml").write_text(kind + 'map = """\n' + "\n".join(rows) + '\n"""\n')
    model, path = stl.load_model(tmp_path / "large.toml"), tmp_path / "c.jsonl"
    product = stl.build_product(model, stl.parse("F[0,8] A"))
    result = stl.check(product, exact=True)
    lower, upper = stl.write_certificate(result, path)
    assert lower == upper == result.fraction == truth_of(read(path)[:-2])[0]
    states = blocks_of(read(path))[1][1]
    assert len(states) == 17**2
    assert sum(len(choices) > 0 for _, _, _, *choices in states) == 15**2 - 1  # all but the goal, and the last steps
    stl.certify(path)
    require_certificate_of(path, product)
    other = stl.build_product(replace(model, name="other"), stl.parse("F[0,8] A"))
    require_certificate_of(path, other)
    *parts, _ = read(path)
    for place, what in enumerate(("model", "model", "automaton", "model")):
        changed = json.loads(json.dumps(parts))
        row = next(part for part in changed[2:] if len(part) > 3)
        if place < 3:
            row[place] += 1
        else:
            row[3][1] -= 1
        write(path, changed)
        with pytest.raises(CertificateError, match=f"for another {what}"):
            require_certificate_of(path, product)


def test_of_a_policy_the_choices_that_it_takes_are_listed(tmp_path, patrolling):
    path, policy = tmp_path / "c.jsonl", stl.check(patrolling).policy
    stl.write_certificate(stl.check(patrolling, policy), path)
    (_, _), (_, states), _, *blocks = blocks_of(read(path))
    taken = {(s, c) for head, rows in blocks if "policy" in head for s, _, c in rows}
    said = {(s, c) for s, _, _, *choices in states for c, choice in enumerate(choices) if choice}
    assert said == taken
    assert len(said) < patrolling.model.n_choices / 2


def test_nothing_is_known_beyond_states_without_choices(tmp_path):
    model = stl.MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], {"x": [0, 1]})
    path = tmp_path / "c.jsonl"
    product = stl.build_product(model, stl.parse("F[0,1] x > 2 | F[1,1] x > 0"))
    stl.write_certificate(stl.check(product, exact=True), path)
    *parts, _ = read(path)
    stl.certify(write(path, parts))
    row = next(part for part in parts if isinstance(part, list) and part[:1] == [0] and len(part) == 4)
    row.pop()
    with pytest.raises(RefusedError, match="not all of its choices are known"):
        stl.certify(write(path, parts))
    layer = next(i for i, part in enumerate(parts) if isinstance(part, dict) and "layer" in part)
    with pytest.raises(RefusedError, match="step 0, model state 0, automaton state .*: neither certain nor listed"):
        stl.certify(write(path, [*parts[: layer + 1], *parts[-1:]]))


CHANGES = [
    (lambda m: m.model[0][3].__setitem__(slice(None), [0, -10, 1, 310]), "a negative number"),
    (lambda m: m.model[0][3].__setitem__(slice(None), [-1, 300]), "a negative number"),
    (lambda m: m.model[0][3].__setitem__(slice(None), [10**6, 300]), "a successor is not listed"),
    (lambda m: m.model[0][3].append(1), "model state 0: a choice is not a list of pairs of integers"),
    (lambda m: m.model[0][3].clear(), "model state 0: not all of its choices are known|neither certain nor listed"),
    (lambda m: m.model[0].__setitem__(3, {}), "model state 0: a choice is not a list of pairs of integers"),
    (lambda m: m.model[0].__setitem__(1, -1), "model state 0: number, share or letter missing or invalid"),
    (lambda m: m.model[1].__setitem__(0, 0), "model state 0: not in ascending order"),
    (lambda m: m.model.clear(), "the model has no states"),
    (lambda m: m.denominators.__setitem__("denominator", -300), "the denominators are not positive integers"),
    (lambda m: m.denominators.__setitem__("initial_denominator", 0), "the denominators are not positive integers"),
    (lambda m: m.model[0].__setitem__(2, 99), "a letter is not one of the automaton's"),
    (lambda m: m.model[0].__setitem__(2, False), "number, share or letter missing or invalid"),
    (lambda m: m.automaton[0].__setitem__(0, -1), "leads to something that is not a state"),
    (lambda m: m.automaton[0].__setitem__(0, 10**6), "leads to something that is not a state"),
    (lambda m: m.automaton[0].pop(), "a row of the automaton needs one integer for each state"),
    (lambda m: m.automaton[-1].__setitem__(0, 2), "a verdict is not −1, 0 or 1"),
    (lambda m: m.automaton.pop(), "fewer or more verdicts than announced"),
    (lambda m: m.sizes.__setitem__("start", -1), "the automaton's first state is not one of its states"),
    (lambda m: m.sizes.__setitem__("letters", 99), "leads to something that is not a state"),
    (lambda m: m.sizes["verdicts"].reverse(), "do not ascend from 0"),
    (lambda m: m.header.__setitem__("claim", "median"), "unknown claim 'median'"),
    (lambda m: m.header.__setitem__("horizon", 9), "expected steps that end with 8, found"),
    (lambda m: m.header.__setitem__("horizon", -8), "is not a number of steps"),
    (lambda m: m.header.__setitem__("horizon", True), "is not a number of steps"),
    (lambda m: m.header.__setitem__("exact", 1), "expected an object with the keys"),
    (lambda m: m.header.__setitem__("policy", {}), "not printable"),
    (lambda m: m.header.__setitem__("task", "x\nproved"), "not printable"),
    (lambda m: m.layers[1][0].__setitem__("scale", "0"), "the scale is 0 or too large"),
    (lambda m: m.layers[1][0].__setitem__("scale", "-1"), "the scale is not a hexadecimal number"),
    (lambda m: m.layers[1][0].__setitem__("scale", 1), "the scale is not a hexadecimal number"),
    (lambda m: m.layers[1][0].__setitem__("scale", "f" * 300000), "the scale is not a hexadecimal number"),
    (lambda m: m.layers[1][0].__setitem__("known", -1), "keeps more numbers than there are"),
    (lambda m: m.layers[1][0].__setitem__("known", 10**6), "keeps more numbers than there are"),
    (lambda m: m.layers[1][0].__setitem__("layer", [9, 5]), "expected steps that end with"),
    (lambda m: m.layers[1][0].__setitem__("layer", [0.5, 5]), "0.5 is not an integer"),
    (lambda m: m.layers[2][1][0].__setitem__(0, "g"), "expected numbers of 14 digits"),
    (lambda m: m.layers[2][1][0].__setitem__(0, 7), "expected numbers of 14 digits"),
    (lambda m: m.layers[2][1].append(["0" * 14]), "a row does not consist of a model state, a set and places"),
    (lambda m: m.layers[2][1][1].__setitem__(0, 10**6), "no such state"),
    (lambda m: m.layers[2][1][1].__setitem__(0, True), "no such state"),
    (lambda m: m.layers[2][1].append(m.layers[2][1][1]), "not in ascending order"),
    (lambda m: m.layers[2][1][1].__setitem__(1, "0"), "not a set of automaton states"),
    (lambda m: m.layers[2][1][1].__setitem__(1, "f" * 14), "its set of automaton states is not a hexadecimal number"),
    (lambda m: m.layers[2][1][1].__setitem__(2, "FF"), "places of . digits in the table"),
    (lambda m: m.layers[2][1][1].__setitem__(2, ""), "places of . digits in the table"),
    (lambda m: m.layers[2][1][1].__setitem__(2, "f" * len(m.layers[2][1][1][2])), "no such number in the table"),
    (lambda m: m.conclusion.__setitem__("upper", "\u0661"), "is not a fraction"),
    (lambda m: m.conclusion.__setitem__("upper", "1e9"), "'1e9' is not a fraction"),
    (lambda m: m.conclusion.__setitem__("upper", "9" * 4000), "is not a fraction"),
    (lambda m: m.conclusion.__setitem__("upper", 1), "1 is not a fraction"),
    (lambda m: m.conclusion.__setitem__("claim", "minimum"), "expected an object with the keys lower, upper"),
]  # fmt: skip


class Members:
    """A certificate's parts by name, to be changed in place."""

    def __init__(self, parts):
        first, (self.denominators, self.model), (self.sizes, self.automaton), *self.layers, last = blocks_of(parts)
        (self.header, _), (self.conclusion, _) = first, last

    def parts(self):
        whole = [(self.header, []), (self.denominators, self.model), (self.sizes, self.automaton), *self.layers]
        return [part for head, rows in whole for part in (head, *rows)] + [self.conclusion]


def with_change(parts, change):
    members = Members(json.loads(json.dumps(parts)))
    change(members)
    return members.parts()


@pytest.mark.parametrize(("change", "says"), CHANGES)
def test_what_is_not_of_the_format_is_refused(tmp_path, patrolling, change, says):
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(patrolling), path)
    *parts, _ = read(path)
    with pytest.raises(CertificateError, match=says):
        stl.certify(write(path, with_change(parts, change)))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda m: m.layers[0][1][0].__setitem__(2, 9), "the policy of step 7, model state ..?: no such choice"),
        (lambda m: m.layers[0][1][0].__setitem__(2, [1]), "model state ..?: not a mixture of choices"),
        (lambda m: m.layers[0][1][0].__setitem__(2, [2, -1, *[0] * 7]), "not a mixture of choices"),
        (lambda m: m.layers[0][1][0].__setitem__(2, [0] * 9), "model state ..?: no choice"),
        (lambda m: m.layers[0][1].append(m.layers[0][1][-1]), "two choices for one pair"),
        (lambda m: m.layers[0][1].reverse(), "not in ascending order"),
        (lambda m: [c.clear() for c in m.model[-1][3:]], "model state ..?: nothing is known about the choice taken"),
        (lambda m: m.layers[0][1][0].__setitem__(0, 10**6), "no such state"),
        (lambda m: m.layers[0][0].__setitem__("policy", [6, 7]), "step 6: a policy out of place|neither certain nor"),
        (lambda m: m.layers.pop(0), "steps 7 to 7: there is no policy for the first of them"),
        (lambda m: m.header.__setitem__("claim", "maximum"), "a policy out of place"),
        (lambda m: m.layers[0][1].clear(), "a number where no choice is listed|neither certain nor listed"),
    ],
)  # fmt: skip
def test_what_is_not_a_policy_is_refused(tmp_path, patrolling, change, says):
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(patrolling, stl.check(patrolling).policy), path)
    *parts, _ = read(path)
    stl.certify(write(path, parts))
    with pytest.raises(CertificateError, match=says):
        stl.certify(write(path, with_change(parts, change)))


@pytest.mark.parametrize("key", ["lower", "upper"])
def test_a_conclusion_beyond_the_layers_is_refused(tmp_path, key):
    path = tmp_path / "c.jsonl"
    for result in results(seed=4, count=6):
        stl.write_certificate(result, path)
        *parts, _ = read(path)
        truth, _ = truth_of(parts[:-1])
        parts[-1][key] = str(truth + (Fraction(1, 10**30) if key == "lower" else -Fraction(1, 10**30)))
        with pytest.raises(RefusedError, match=f"the claimed {key} bound is not proved"):
            stl.certify(write(path, parts))


def test_lines_cannot_be_left_out_swapped_or_added(tmp_path, patrolling):
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(patrolling), path)
    *parts, seal = read(path)
    n = len(parts)
    for i in range(n):
        with pytest.raises(CertificateError):
            stl.certify(write(path, parts[:i] + parts[i + 1 :]))
    for i in range(n - 1):
        swapped = [*parts[:i], parts[i + 1], parts[i], *parts[i + 2 :]]
        with pytest.raises(CertificateError):
            stl.certify(write(path, swapped))
    for more, says in (([*parts, parts[-1]], "after the conclusion"), ([*parts, seal, parts[-1]], "after the seal")):
        with pytest.raises(CertificateError, match=says):
            stl.certify(write(path, more, seal=False))
    with pytest.raises(CertificateError, match="cut off: its seal is missing"):
        stl.certify(write(path, parts, seal=False))
    with pytest.raises(CertificateError, match="the seal does not match"):
        stl.certify(write(path, [*parts, {"sha256": "0" * 64}], seal=False))


@pytest.mark.parametrize("value", ["0.5", "NaN", "Infinity", "1e400"])
def test_only_integers_are_read(tmp_path, patrolling, value):
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(patrolling), path)
    text = path.read_text()
    path.write_text(text.replace('"verdicts":[', f'"verdicts":[{value},', 1))
    with pytest.raises(CertificateError, match=f"{value} is not an integer"):
        stl.certify(str(path))


@pytest.mark.parametrize("content", [b"", b"{}", b"[]\n", b"null\n", b"\x1f\x8bzip", b"\x00\xff", b"[" * 100_000])
def test_other_files_are_no_certificates(tmp_path, content):
    (tmp_path / "c").write_bytes(content)
    with pytest.raises(CertificateError, match="not a certificate|seal is missing|the file is empty"):
        stl.certify(str(tmp_path / "c"))


def test_what_is_refused_and_what_cannot_be_read_are_told_apart(tmp_path, patrolling):
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(patrolling), path)
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    with pytest.raises(RefusedError, match=r"c\.jsonl: refused: the file is cut off"):
        stl.certify(path)
    path.write_text("{}")
    with pytest.raises(CertificateError, match=r"c\.jsonl: not a certificate .* write one with") as error:
        stl.certify(path)
    assert not isinstance(error.value, RefusedError)
    with pytest.raises(FileError, match="this certificate does not exist"):
        stl.certify(tmp_path / "none.jsonl")
    with pytest.raises(FileError, match="this certificate cannot be read: Is a directory"):
        stl.certify(tmp_path)


def test_a_key_stands_once(tmp_path, patrolling):
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(patrolling), path)
    text = path.read_text().replace('"claim":', '"claim":"minimum","claim":', 1)
    path.write_text(text)
    with pytest.raises(CertificateError, match="a duplicate key"):
        stl.certify(str(path))


def test_numbers_of_any_length(tmp_path):
    """Beyond the 4300 digits that Python writes by itself."""
    rows = [[["0.99999999999999", "0.00000000000001"], ["0", "1"]]]
    model = stl.MDP.from_arrays(rows, {"x": [0, 1]})
    product = stl.build_product(model, stl.parse("F[0,320] x > 0"))
    result = stl.check(product, exact=True)
    assert result.fraction == 1 - Fraction(99999999999999, 10**14) ** 320
    assert len(check_data(result)["exact"]) > 8600
    lower, upper = stl.write_certificate(result, tmp_path / "c.jsonl")
    assert lower == upper == result.fraction
    assert recheck.certify(str(tmp_path / "c.jsonl"))["pairs"] > 0


def test_a_certificate_replaces_no_other_file(tmp_path, patrolling):
    result = stl.check(patrolling)
    result.policy.save(tmp_path / "p.npz")
    (tmp_path / "task.stl").write_text("a := F[0,3] A\n")
    (tmp_path / "r.json").write_text('{"format": "stltool-report-1"}\n')
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for path in before:
        with pytest.raises(
            FileError, match="this file does not contain a certificate that stltool wrote, and would be lost"
        ):
            stl.write_certificate(result, path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    for name in ("c", "c.json", "c.jsonl.gz"):  # any name; an old certificate makes way for a new one
        for _ in range(2):
            stl.write_certificate(result, tmp_path / name)
            stl.certify(str(tmp_path / name))


def test_rows_with_a_defect_are_certified_around_it(tmp_path):
    """Doubles that do not sum to 1: the bounds allow for what is missing, and the defect is reported."""
    third = 1 / 3
    model = stl.MDP.from_arrays([[[third, third, third], [0, 1, 0], [0.1, 0.2, 0.7000000001]]], {"x": [0, 1, 2]})
    product = stl.build_product(model, stl.parse("F[0,4] x == 1"))
    result = stl.check(product)
    path = tmp_path / "c.jsonl"
    stl.write_certificate(result, path)
    proved = stl.certify(str(path))
    assert 9e-11 < Fraction(proved["defect"]) < 2e-10
    lower, upper = Fraction(proved["lower"]), Fraction(proved["upper"])
    assert lower <= result.probability <= upper
    assert 1e-11 < upper - lower < 1e-9


def test_the_checker_stands_alone(tmp_path, patrolling):
    """The file runs in an interpreter that has neither stltool nor numpy; the packed form is read too."""
    path = tmp_path / "c.jsonl.gz"
    stl.write_certificate(stl.check(patrolling), path)
    first = path.read_bytes()
    stl.write_certificate(stl.check(patrolling), path)
    assert path.read_bytes() == first  # the same result, the same bytes
    script = [sys.executable, "-I", "-S", str(ROOT / "stltool" / "recheck.py"), str(path)]
    for command in (script, [script[0], *script[3:]]):  # the second as the page has it
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout.splitlines()[1])["pairs"] == 11
    path.write_bytes(gzip.compress(gzip.decompress(first).replace(b'"horizon":8', b'"horizon":7')))
    done = subprocess.run(script, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.startswith("refused: ")


def test_a_certificate_of_another_task_or_model_is_named(tmp_path, patrolling, floor5, floor10):
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(patrolling), path)
    require_certificate_of(path, patrolling)
    others = {
        r"the task of this certificate is G\[0,4\].*, not F\[0,8\] A": stl.build_product(floor5, stl.parse("F[0,8] A")),
        r"for another model .*floor-5x5, not floor-10x10": stl.build_product(floor10, patrolling.formula),
        "for another automaton": stl.build_product(floor5, patrolling.formula, encoding="history"),
    }
    for says, product in others.items():
        with pytest.raises(CertificateError, match=says):
            require_certificate_of(path, product)


def test_what_cannot_be_certified_is_said_first(tmp_path, patrolling):
    with pytest.raises(ArgumentError, match="write_certificate's progress is 3, not a function"):
        stl.write_certificate(stl.check(patrolling), tmp_path / "c.jsonl", progress=3)
    with pytest.raises(SizeError, match="certifying 468 product states over 8 steps would take"):
        stl.write_certificate(stl.check(patrolling), tmp_path / "c.jsonl", memory_limit=1000)
    (tmp_path / "folder.jsonl").mkdir()
    with pytest.raises(FileError, match="not a regular file"):
        stl.write_certificate(stl.check(patrolling), tmp_path / "folder.jsonl")
    assert list(tmp_path.iterdir()) == [tmp_path / "folder.jsonl"]


def test_a_certificate_of_a_policy_names_its_policy(tmp_path, patrolling, flagged):
    """Also of one that remembers another way: its certificate is of the joint memory."""
    path = tmp_path / "c.jsonl"
    uniform = np.full((*flagged.shape, 9), 1 / 9)
    policies = [stl.check(patrolling).policy, stl.Policy(flagged, uniform)]
    for policy in policies:
        result = stl.check(patrolling, policy)
        stl.write_certificate(result, path)
        stl.certify(str(path))
        require_certificate_of(path, patrolling, policy)
        other = stl.Policy(policy.home, np.zeros(policy.home.shape, dtype=np.int16))
        with pytest.raises(CertificateError, match=r"for another policy \(steps . to . differ\)"):
            require_certificate_of(path, patrolling, other)
    stl.write_certificate(stl.check(patrolling), path)
    with pytest.raises(CertificateError, match="the claim of this certificate is maximum, not policy"):
        require_certificate_of(path, patrolling, policies[0])
