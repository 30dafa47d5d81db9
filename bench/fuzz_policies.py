"""`make fuzz WHAT=policies`: coverage-guided fuzzing of the readers of policies (.csv, .json, .npz).

Whatever the bytes: only StlToolError comes out, it names the file, and what is read is saved and read again as the same
policy. Inputs are mutations of a small policy's files; see bench/fuzz_formulas.py.
"""

from __future__ import annotations

import sys
import tempfile
import zipfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["stltool"]):
    import stltool as stl
    from stltool import policy, written  # noqa: F401  # which would be loaded later, without instruments
    from stltool.errors import StlToolError

FOLDER = Path(tempfile.mkdtemp())
MODEL = stl.MDP.from_arrays(
    [[[0.5, 0.5], [0, 1]], [[0, 1], [0.25, 0.75]]], {}, labels={"A": [0, 1]}, action_names=["go", "a, b"],
    state_names=["(0,1)", "here"],
)  # fmt: skip
PRODUCT = stl.build_product(MODEL, stl.parse("F[0,3] (!A & F[0,2] A)"))
KINDS = ("csv", "json", "npz")
VOCABULARY = """
from,to state remembered action weight 0 1 3 -1 1/3 0.25 1e-9 nan "(0,1)" here go "a,§b" #§format #§task #§define
{ } [ ] : , "rules" "elsewhere" "from" "action" null true
"""
WORDS = [word.replace("§", " ") for word in VOCABULARY.split()]


def seeds() -> dict[str, bytes]:
    """The files of a small policy."""
    best = stl.check(PRODUCT).policy
    assert best is not None
    for kind in KINDS:
        best.save(FOLDER / f"seed.{kind}")
    return {kind: (FOLDER / f"seed.{kind}").read_bytes() for kind in KINDS}


SEEDS = seeds()


def mutated(data: bytes) -> tuple[str, bytes]:
    """A kind of file, and a seed of that kind with pieces cut out, replaced and put in."""
    provider = atheris.FuzzedDataProvider(data)
    kind = KINDS[provider.ConsumeIntInRange(0, len(KINDS) - 1)]
    found = bytearray(SEEDS[kind])
    while provider.remaining_bytes():
        at = provider.ConsumeIntInRange(0, len(found))
        cut = provider.ConsumeIntInRange(0, 30)
        if provider.ConsumeBool():
            piece = WORDS[provider.ConsumeIntInRange(0, len(WORDS) - 1)].encode()
        else:
            piece = provider.ConsumeBytes(3)
        found[at : at + cut] = piece
    return kind, bytes(found)


def unpacked(data: bytes) -> bytes:
    """An archive whose checksums are right again, so that mutations get past them."""
    path = FOLDER / "again.npz"
    try:
        with zipfile.ZipFile(FOLDER / "seed.npz") as archive:
            names = archive.namelist()
        with zipfile.ZipFile(path, "w") as archive:
            for i, name in enumerate(names):
                archive.writestr(name, data[i * len(data) // len(names) : (i + 1) * len(data) // len(names)])
    except ValueError:
        return data
    return path.read_bytes()


def one_input(data: bytes) -> None:
    kind, content = mutated(data)
    if kind == "npz" and data and data[-1] % 2:
        content = unpacked(content)
    path = FOLDER / f"p.{kind}"
    path.write_bytes(content)
    try:
        found = stl.load_policy(path, PRODUCT)
    except StlToolError as error:
        assert str(path) in str(error), str(error)
        return
    again = FOLDER / f"again.{kind}"
    again.unlink(missing_ok=True)
    found.save(again)
    loaded = stl.load_policy(again, PRODUCT)
    other = again.with_name(f"other.{kind}")
    other.unlink(missing_ok=True)
    loaded.save(other)
    assert again.read_bytes() == other.read_bytes()


if __name__ == "__main__":
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
