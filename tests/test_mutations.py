"""Faults put into the passes and kernels of a backward induction are found, by the tests named here."""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from stltool.kernels import jit
from tests.conftest import ROOT, some

PARAMETRIC = "tests/checking/test_parametric.py"
INDUCTION, CLUSTER = "tests/checking/test_induction.py", "tests/checking/test_cluster.py"
OPEN, AGREE, VALUES, POLICY = (
    f"{INDUCTION}::test_{name}" for name in (
        "what_is_open_and_sure_is_exact", "engines_agree_to_the_bit_and_so_do_any_number_of_threads",
        "every_arithmetic_and_engine_gives_the_dense_value", "every_arithmetic_and_engine_gives_a_policys_value",
    )
)  # fmt: skip
WORDS, TILES, EDGES, LANES, NATURE, PLANNING = (
    f"kernels/{name}.py" for name in ("words", "tiles", "edges", "lanes", "nature", "planning")
)
EIGHT = "tests/checking/test_robust.py::test_eight_at_a_time_give_the_bits_of_one_by_one"
SMALL = "tests/checking/test_small.py::test_natures_choice_is_the_kernels_to_the_bit"
RECHECK, CERTIFICATE = "recheck.py", "tests/checking/test_certificate.py"
NODES, LAYERS, REACHED, BLOCKS = (f"checking/induction/{name}.py" for name in ("nodes", "layers", "reached", "blocks"))

# what is broken: file, a text that it has once, what stands there instead, where a test must fail
MUTATIONS = {
    "zero, one by one": (NODES, "slot != REST", "slot == SURE", OPEN),
    "one, one by one: some successor instead of all": (
        NODES, "makes_sure = np.logical_and", "makes_sure = np.logical_or", OPEN,
    ),
    "what mixtures may take, one by one": (NODES, "np.logical_and if self", "np.logical_or if self", OPEN),
    "reach, one by one: a verdict too early": (NODES, "verdicts(t + 1)[child", "verdicts(t)[child", OPEN),
    "layers that differ are taken for the same": (LAYERS, "and self._same_settled(here, ahead)", "", AGREE),
    "steps that reach the same, though a policy or a verdict changes": (
        LAYERS, "min(game.automaton.alike(t + 1)[1], self.allowed.last_alike(t) + 1, h - 1)", "h - 1", INDUCTION,
    ),
    "layers made again from the wrong one": (
        REACHED, "in self._steps[begin + 1 :", "in self._steps[begin :", INDUCTION,
    ),
    "reach: the union along the choices allowed is its last part": (
        WORDS, "rows[j * width + d] |= going", "rows[j * width + d] = going", OPEN,
    ),
    "reach: what is decided": (WORDS, "x = at(image, w) & at(undecided, w)", "x = at(image, w)", OPEN),
    "rows for all ranges: the last ones are not filled": (
        "checking/induction/words.py", "[*itertools.pairwise(cuts)]", "[*itertools.pairwise(cuts)][:-1]",
        f"{INDUCTION}::test_ranges_of_states_are_put_together_in_order",
    ),
    "a block forgets its own": (BLOCKS, "sent.get(block.number, _NOTHING)", "sent.get(-1, _NOTHING)", CLUSTER),
    "reach: the last word is forgotten": (
        WORDS, "n_words + 1)):\n                x = at(image, w)", "n_words)):\n                x = at(image, w)",
        AGREE,
    ),
    "reach: bits that move into the next word are lost": (
        WORDS, "if offset != ZERO and going >> (np.uint64(64) - offset) != ZERO:", "if False:", AGREE,
    ),
    "reach: the union is its last part": (
        WORDS, "put(rows, d, at(rows, d) | at(bits, k))", "put(rows, d, at(bits, k))", AGREE,
    ),
    "zero: all that is reached": (WORDS, "                live &= here\n", "                live |= here\n", OPEN),
    "zero: what lies ahead in the next word": (WORDS, "y |= at(ahead, d + 1) << back", "pass", AGREE),
    "one: some successor instead of all": (
        WORDS, "                        x &= at(certain,", "                        x |= at(certain,", OPEN,
    ),
    "one: what mixtures may take": (WORDS, "left &= taking | ~at(", "left &= taking & ~at(", OPEN),
    "one: the last choice instead of the first": (WORDS, "left &= ~x\n", "left &= left\n", AGREE),
    "lanes that are not active get numbers": (
        TILES, "select(open_lanes, _settle(x, divisor, inverse), other)", "_settle(x, divisor, inverse)", POLICY,
    ),
    "sure lanes are like the rest": (TILES, "select(mask(at(certain, r)), sures, rests)", "rests", AGREE),
    "lanes that are not listed are read": (
        TILES, "mask(np.uint8((listed >> np.uint64(q)) & _BYTE))", "mask(np.uint8(_BYTE))", AGREE,
    ),
    "gather at an edge: one lane beside": (
        TILES, "splat_at(row, PAD + np.int64(at(constant, e)))", "splat_at(row, PAD - 1 + np.int64(at(constant, e)))",
        AGREE,
    ),
    "gather at an edge: a lane that is neither": (
        TILES, "simple[letter, b] = most >= hi - lo", "simple[letter, b] = most >= hi - lo - 1", AGREE,
    ),
    "polynomials: the weights of the two ends exchanged": (
        "checking/induction/tied.py", "((i + 1 if lift else n - i) / n)", "((n - i if lift else i + 1) / n)",
        PARAMETRIC,
    ),
    "digits: the least instead of the greatest": (EDGES, "out[i, d]) == maximize", "out[i, d]) != maximize", VALUES),
    "fixed point is not rounded up": (
        LANES, "    return sub(y, _to_integer(greater(sub(mul(y, d), x), sub(d, splat(np.int64(1))))))",
        "    return sub(y, _to_integer(greater(mul(y, d), x)))",
        "tests/checking/test_exact.py::test_no_enclosure_ever_misses_the_exact_value",
    ),
    "the checker of certificates: some successor is sure instead of all": (
        RECHECK, "                    all_of_them &= self.sure_before[x]\n                every",
        "                    all_of_them |= self.sure_before[x]\n                every", CERTIFICATE,
    ),
    "the checker: what follows a state without choices is impossible": (
        RECHECK, "return self.automaton.all, 0", "return 0, 0", CERTIFICATE,
    ),
    "the checker: what a policy does where nothing is listed is impossible": (
        RECHECK, "return some | unknown, every", "return some, every", CERTIFICATE,
    ),
    "the checker: distances downwards are forgotten": (
        RECHECK, "(max(off), -min(off))", "(max(off), max(off))", CERTIFICATE,
    ),
    "the checker: a layer is not compared with itself": (
        RECHECK, "wanted = here.keys() if passed < 2 else", "wanted = here.keys() if passed < 1 else", CERTIFICATE,
    ),
    "the checker: distances of steps that repeat count once": (
        RECHECK, "far * growth + n * distance", "far * growth + distance", CERTIFICATE,
    ),
    "the checker: numbers where the verdict is known": (
        RECHECK, "require(not those & ~undecided,", "require(True,", CERTIFICATE,
    ),
    "the checker: what rows are missing is forgotten": (
        RECHECK, "model.missing + model.excess), model.D)", "model.excess), model.D)", CERTIFICATE,
    ),
    "the checker: outcomes of other values are taken": (
        RECHECK, "{*keys}.difference(outcomes)", "{*keys} if not outcomes else set()", CERTIFICATE,
    ),
    "the checker: sets of the step before stay": (
        RECHECK, "again = {s for x in self.changed for s in self.leading_to[x]}", "again = set()", CERTIFICATE,
    ),
    "sums: a verdict's reward is forgotten": (
        EDGES, "p * (value[m] + paid[m])", "p * value[m]", "tests/checking/test_tradeoff.py",
    ),
    "flows: a mixture's weights": (
        "checking/unfold.py", "flow = flow * edges.weight", "pass", "tests/checking/test_sensitivity.py",
    ),
    "choices left are counted among those left": (
        "checking/induction/induct.py", "if not layers.allowed.everything:", "if False:",
        "tests/checking/test_surrogate.py",
    ),
    "plans: paradise is as good as what is sure": (
        "learning/model_based.py", "self._arithmetic.worth(t - 1)", "1.0", "tests/learning/test_planner.py",
    ),
    "plans: the later of equal choices": (
        PLANNING, "total[j] > best[j]", "total[j] >= best[j]", "tests/learning/test_planner.py",
    ),
    "plans: a success counts at the horizon alone": (
        PLANNING, "row[q] = 1.0 if verdicts[t, q] == 1 else 0.0", "row[q] = 0.0", "tests/learning/test_planner.py",
    ),
    "stationary: half of the branches": (
        "checking/stationary.py", "for alone in (True, False):", "for alone in (True,):",
        "tests/checking/test_stationary.py",
    ),
    "nature spends more than there is": (
        EDGES, "take = min(width[entry[first + k]], left)", "take = width[entry[first + k]]", SMALL,
    ),
    "nature by tiles spends more than there is": (
        NATURE, "                                left = sub(left, w1)\n", " " * 32 + "pass\n", EIGHT,
    ),
    "nature by tiles always minimises": (NATURE, "1.0 if ascending else -1.0", "1.0", EIGHT),
    "nature by tiles: equal values in another order": (
        NATURE, "m = greater(x, y)\n", "m = greater(add(x, splat(1e-15)), y)\n", EIGHT,
    ),
    "nature by tiles: one lane speaks for all": (NATURE, "if not any_bit(m):", "if any_bit(m):", EIGHT),
    "nature by tiles: lanes whose policy takes another choice": (
        NATURE, "maximize, restricted, bits, q)", "maximize, False, bits, q)", EIGHT,
    ),
    "nature by tiles: the last entry takes what it can hold": (
        NATURE, "_least(w3, sub(left, w2))", "w3", EIGHT,
    ),
}  # fmt: skip
PROGRAM = """
import sys
sys.path.insert(0, sys.argv.pop(1))
import stltool, pytest
from stltool.kernels import jit
assert stltool.__file__.startswith(sys.path[0])
jit.SOURCES = sys.argv.pop(1)
sys.exit(pytest.main(sys.argv[1:]))
"""


def changed_kernels(file, old):
    """The kernels that have a text and those that call them, as module.name: the others need not be compiled again."""
    callers, changed = {}, set()
    for path in (ROOT / "stltool" / "kernels").glob("*.py"):
        source = path.read_text(encoding="utf-8")
        for node in ast.parse(source).body:
            if isinstance(node, ast.FunctionDef):
                name = f"{path.stem}.{node.name}"
                used = {getattr(below, "id", getattr(below, "attr", None)) for below in ast.walk(node)}
                callers[name] = used
                if path.name == Path(file).name and old in ast.get_source_segment(source, node):
                    changed.add(name)
    if file == LANES:  # whose callers numba finds by types
        return set(callers)
    while more := {
        name for name, used in callers.items() if used & {one.split(".")[1] for one in changed}
    } - changed:  # fmt: skip
        changed |= more
    return changed


@pytest.mark.parametrize("name", MUTATIONS)
def test_every_mutation_changes_one_place(name):
    file, old, new, _ = MUTATIONS[name]
    source = (ROOT / "stltool" / file).read_text(encoding="utf-8")
    assert source.count(old) == 1
    assert new not in (old, source)


@pytest.mark.soak(only=True)
@pytest.mark.parametrize("name", some(MUTATIONS))
def test_a_mutation_is_found(name, tmp_path):
    """In a copy of stltool; each takes seconds."""
    file, old, new, tests = MUTATIONS[name]
    shutil.copytree(ROOT / "stltool", tmp_path / "stltool")  # with the machine code
    shutil.copytree(ROOT / "grammars", tmp_path / "grammars")
    changed = tmp_path / "stltool" / file
    changed.write_text(changed.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    if file.startswith("kernels/"):
        kernels = changed_kernels(file, old)
        assert kernels
        for kept in (tmp_path / "stltool" / "kernels").glob("__pycache__/numba-*/*"):
            if kept.name.partition("-")[0] in kernels:
                kept.unlink()
    options = ["-x", "-n", "0", "-p", "no:cacheprovider", "--tb", "line", tests]
    settings = {key: value for key, value in os.environ.items() if not key.startswith(("STLTOOL_", "PYTEST_"))}
    settings["STLTOOL_MORE"] = "1"  # some faults take more instances to be seen than `make test` has
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, tmp_path, jit.SOURCES, *options],
        cwd=ROOT,
        env=settings,
        capture_output=True,
        text=True,
    )
    if done.returncode >= 0:  # below: a kernel went beyond its arrays, which ended the process
        assert done.returncode == 1, f"{done.stdout[-3000:]}{done.stderr[-3000:]}"  # pytest's for "tests failed"
        assert "1 failed" in done.stdout
