"""Certificates: what is proved is true, and no single entry can be changed into a lie."""

import gzip
import hashlib
import json
import random
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool import recheck
from stltool.checking import require_certificate_of
from stltool.errors import CertificateError, FileError, RefusedError, SettingsError, SizeError
from stltool.reporting import check_data
from tests import oracles
from tests.conftest import ROOT

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
        for policy, maximize in ((None, True), (None, False), (mixed, True)):
            for exact in (False, True):
                yield stl.check(product, policy, maximize=maximize, exact=exact)


def truth_of(parts):
    """The claimed quantity of a certificate's own model and automaton, a Fraction a pair, over all pairs."""
    header, model, automaton, *layers = parts
    horizon, D, Q = header["horizon"], model["denominator"], automaton["memory"]

    def verdict(t, q):
        return [row for start, row in automaton["verdicts"] if start <= t][-1][q]

    def enter(s, q):
        return automaton["delta"][automaton["letter"][s]][q]

    def step(values, s, q, t):
        if verdict(t, q) >= 0:
            return Fraction(verdict(t, q))
        options = [
            sum(Fraction(n, D) * values[s2, enter(s2, q)] for s2, n in zip(row[::2], row[1::2], strict=True))
            for row in model["choices"][s]
        ]
        if header["claim"] == "maximum":
            return max(options)
        if header["claim"] == "minimum":
            return min(options)
        layer = layers[horizon - 1 - t]
        if s * Q + q not in layer["at"]:
            return Fraction(0)  # not reached
        choice = layer["choice"][layer["at"].index(s * Q + q)]
        weights = choice if isinstance(choice, list) else [int(c == choice) for c in range(len(options))]
        return sum(w * v for w, v in zip(weights, options, strict=True)) / sum(weights)

    pairs = [(s, q) for s in range(len(model["choices"])) for q in range(Q)]
    values = {(s, q): Fraction(max(verdict(horizon, q), 0)) for s, q in pairs}
    for t in range(horizon - 1, -1, -1):
        values = {(s, q): step(values, s, q, t) for s, q in pairs}
    return sum(
        Fraction(n, model["initial_denominator"]) * values[s, enter(s, automaton["start"])] for s, n in model["initial"]
    )


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
    for result in results(seed=1):
        stl.write_certificate(result, path)
        proved = stl.certify(str(path))
        require_certificate_of(path, result.product)
        lower, upper = Fraction(proved["lower"]), Fraction(proved["upper"])
        truth = truth_of(read(path)[:-2])
        assert lower <= truth <= upper
        assert (proved["claim"], proved["defect"]) == (result.question, "0")
        if result.fraction is not None:
            assert lower == truth == upper == result.fraction
        else:
            assert upper - lower < 1e-13
            assert lower <= result.upper
            assert result.lower <= upper


def entries(node, path=()):
    """The places of all numbers in a certificate's parts."""
    if isinstance(node, dict | list):
        for key, below in node.items() if isinstance(node, dict) else enumerate(node):
            yield from entries(below, (*path, key))
    elif isinstance(node, int):
        yield path


def test_no_changed_entry_becomes_a_lie(tmp_path):
    """Entries are changed one by one. Unsealed, each is refused; resealed, what is still accepted is still true."""
    path, rng = tmp_path / "c.jsonl", random.Random(2)
    accepted = refused = 0
    for result in results(seed=3, denominators=(10, 16), count=8):
        stl.write_certificate(result, path)
        parts = read(path)
        *content, seal = parts
        places = list(entries(content))
        for place in rng.sample(places, min(30, len(places))):
            changed = json.loads(json.dumps(content))
            node = changed
            for key in place[:-1]:
                node = node[key]
            node[place[-1]] += rng.choice([-1, 1, 1, 7, -(10**6), 10**17])
            unsealed = write(path, [*changed, seal], seal=False)
            with pytest.raises(CertificateError):
                stl.certify(unsealed)
            try:
                proved = stl.certify(write(path, changed))
            except CertificateError:
                refused += 1
                continue
            accepted += 1
            assert Fraction(proved["lower"]) <= truth_of(changed[:-1]) <= Fraction(proved["upper"]), place
    assert refused > 700
    assert accepted > 30  # where bounds have slack, or unreached states are concerned


def test_a_lie_as_small_as_can_be(tmp_path):
    """Where all is certain, one unit is all: D = 1 and one = 1."""
    model = stl.MDP.from_arrays([[[0, 1], [0, 1]]], {"x": [0, 1]})
    result = stl.check(stl.build_product(model, stl.parse("F[0,2] x > 2")), exact=True)
    sure = stl.check(stl.build_product(model, stl.parse("F[0,2] x > 0")), exact=True)
    path = tmp_path / "c.jsonl"
    for honest, key, lie in ((result, "lower", 1), (sure, "upper", 0)):
        stl.write_certificate(honest, path)
        *parts, _ = read(path)
        assert parts[-2]["one"] == 1
        parts[-2][key] = [lie] * len(parts[-2][key])
        parts[-1][key] = str(lie)
        with pytest.raises(CertificateError, match="bound is (above|below) what a step gives"):
            stl.certify(write(path, parts))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda parts: parts[1]["choices"][0].__setitem__(0, [0, -10, 1, 310]), "no probability"),
        (lambda parts: parts[1]["choices"][0].__setitem__(0, [-1, parts[1]["denominator"]]), "no probability"),
        (lambda parts: parts[1]["choices"].__setitem__(0, []), "no choice"),
        (lambda parts: parts[1].__setitem__("denominator", -300), "no probability"),
        (lambda parts: parts[1]["initial"].__setitem__(0, [-1, 1]), "no distribution"),
        (lambda parts: parts[1].__setitem__("initial", [[0, -1], [1, 2]]), "no distribution"),
        (lambda parts: parts[2]["letter"].__setitem__(0, -1), "none of the automaton's"),
        (lambda parts: parts[2]["letter"].pop(), "no letter"),
        (lambda parts: parts[2]["delta"][0].__setitem__(0, -1), "table is not whole"),
        (lambda parts: parts[2].__setitem__("start", -1), "start is not whole"),
        (lambda parts: parts[2]["verdicts"][0][1].__setitem__(0, 2), "verdicts are not whole"),
        (lambda parts: parts[0].__setitem__("claim", "median"), "unknown claim 'median'"),
        (lambda parts: parts[0].__setitem__("horizon", 9), "layer 8 is missing"),
        (lambda parts: parts[3].__setitem__("one", 0), "layer 7 is missing"),
        (lambda parts: parts[3]["choice"].__setitem__(0, 9), "no such choice"),
        (lambda parts: parts[3]["choice"].__setitem__(0, [2, -1, *[0] * 7]), "no such choice"),
        (lambda parts: parts[4]["at"].__setitem__(1, parts[4]["at"][0]), "listed twice"),
        (lambda parts: parts[4]["upper"].__setitem__(1, "9"), "layer 6: no whole numbers"),
        (lambda parts: parts[4]["upper"].__setitem__(1, True), "layer 6: no whole numbers"),
        (lambda parts: parts[4].__setitem__("at", ""), "layer 6: no whole numbers"),
        (lambda parts: parts[1]["choices"].__setitem__(0, {}), "more than whole numbers"),
        (lambda parts: parts[2]["letter"].__setitem__(0, False), "more than whole numbers"),
        (lambda parts: parts[0].__setitem__("exact", 1), "other keys than those of the format"),
        (lambda parts: parts[0].__setitem__("policy", {}), "not printable"),
        (lambda parts: parts[-1].__setitem__("upper", "\u0661"), "is no fraction"),
        (lambda parts: parts[0].__setitem__("horizon", -8), "is no number of steps"),
        (lambda parts: parts[0].__setitem__("horizon", True), "is no number of steps"),
        (lambda parts: parts[0].__setitem__("task", "x\nproved"), "not printable"),
        (lambda parts: parts[2]["verdicts"].reverse(), "do not ascend from 0"),
        (lambda parts: parts[-1].__setitem__("claim", "minimum"), "no lower and upper bound"),
        (lambda parts: parts[-1].__setitem__("upper", "1e9"), "'1e9' is no fraction"),
        (lambda parts: parts[-1].__setitem__("upper", 1), "1 is no fraction"),
    ],
)  # fmt: skip
def test_what_is_no_model_or_automaton_is_refused(tmp_path, patrolling, change, says):
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(patrolling), path)
    *parts, _ = read(path)
    change(parts)
    with pytest.raises(CertificateError, match=says):
        stl.certify(write(path, parts))


@pytest.mark.parametrize("key", ["lower", "upper"])
def test_a_conclusion_beyond_the_layers_is_refused(tmp_path, key):
    path = tmp_path / "c.jsonl"
    for result in results(seed=4, count=6):
        stl.write_certificate(result, path)
        *parts, _ = read(path)
        step = Fraction(1, 10**30) if key == "lower" else -Fraction(1, 10**30)
        parts[-1][key] = str(Fraction(parts[-1][key]) + step)
        with pytest.raises(CertificateError, match=f"the claimed {key} bound is"):
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
    with pytest.raises(CertificateError, match="the seal does not fit"):
        stl.certify(write(path, [*parts, {"sha256": "0" * 64}], seal=False))


@pytest.mark.parametrize("value", ["0.5", "NaN", "Infinity", "1e400"])
def test_only_whole_numbers_are_read(tmp_path, patrolling, value):
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(patrolling), path)
    text = path.read_text()
    path.write_text(text.replace('"upper":[', f'"upper":[{value},', 1))
    with pytest.raises(CertificateError, match="no whole number"):
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
    with pytest.raises(FileError, match="there is no such certificate"):
        stl.certify(tmp_path / "none.jsonl")
    with pytest.raises(FileError, match="this certificate cannot be read: Is a directory"):
        stl.certify(tmp_path)


def test_a_key_stands_once(tmp_path, patrolling):
    path = tmp_path / "c.jsonl"
    stl.write_certificate(stl.check(patrolling), path)
    text = path.read_text().replace('"claim":', '"claim":"minimum","claim":', 1)
    path.write_text(text)
    with pytest.raises(CertificateError, match="one key twice"):
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
        with pytest.raises(FileError, match="this file does not contain a certificate, and would be lost"):
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
    done = subprocess.run(script, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[1])["pairs"] == 198
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
        r"of another model .*called floor-5x5, here floor-10x10": stl.build_product(floor10, patrolling.formula),
        "of another automaton": stl.build_product(floor5, patrolling.formula, encoding="history"),
    }
    for says, product in others.items():
        with pytest.raises(CertificateError, match=says):
            require_certificate_of(path, product)


def test_what_cannot_be_certified_is_said_first(tmp_path, patrolling):
    with pytest.raises(SettingsError, match="keep_policy=True"):
        stl.write_certificate(stl.check(patrolling, keep_policy=False), tmp_path / "c.jsonl")
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
        with pytest.raises(CertificateError, match=r"of another policy \(step . differs\)"):
            require_certificate_of(path, patrolling, other)
    stl.write_certificate(stl.check(patrolling), path)
    with pytest.raises(CertificateError, match="the claim of this certificate is maximum, not policy"):
        require_certificate_of(path, patrolling, policies[0])
