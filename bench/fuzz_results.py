"""`make fuzz WHAT=results`: coverage-guided fuzzing of the readers of logs and of what stltool itself has written.

Logs (.csv, .npz, .parquet), a report's data, a certificate, a checkpoint and a shield. Whatever the bytes: only
StlToolError comes out, and it names the file. Inputs are mutations of small files; see bench/fuzz_formulas.py.
"""

from __future__ import annotations

import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import atheris
from mutated import mutated

with atheris.instrument_imports(include=["stltool"]):
    import numpy as np
    import pyarrow
    import pyarrow.parquet

    import stltool as stl
    from stltool import recheck  # noqa: F401  # which would be loaded later, without instruments
    from stltool.errors import StlToolError
    from stltool.learning import checkpoint  # noqa: F401
    from stltool.monitoring import logs  # noqa: F401
    from stltool.reporting.page import load_report

FOLDER = Path(tempfile.mkdtemp())
MODEL = stl.MDP.from_arrays([[[0.5, 0.5], [0, 1]], [[0, 1], [0.25, 0.75]]], {}, labels={"A": [0, 1]})
PRODUCT = stl.build_product(MODEL, stl.parse("F[0,3] (!A & F[0,2] A)"))
VOCABULARY = """
0 1 3 -1 1_0 1e999 nan inf null true [] {} [[[[ "" , ; : \\n time x "format" "claim" "maximum" (1,) '<f8' '|O' False
18446744073709551616 2020-01-01T00:00:00Z <script> é
"""
WORDS = [word.encode() for word in VOCABULARY.split()]
SIGNALS = {"x": [0, 0.25, 1], "time": [0.0, 1, 2]}


def learned(path: Path, resume: bool = True) -> None:
    stl.learn(PRODUCT, "naive", seed=1, episodes=3, evaluate_every=1, checkpoint=path, resume=resume)


def seeds() -> dict[str, bytes]:
    """Small files of each kind."""
    found = stl.check(PRODUCT)
    (FOLDER / "seed.csv").write_text("time,x\n0,0\n1,0.25\n2,1\n")
    np.savez(FOLDER / "seed.npz", **SIGNALS)
    pyarrow.parquet.write_table(pyarrow.table(SIGNALS), FOLDER / "seed.parquet")
    stl.report(found, path=FOLDER / "seed.html")
    stl.write_certificate(found, FOLDER / "seed.jsonl")
    learned(FOLDER / "seed.checkpoint", resume=False)
    stl.shield(PRODUCT, at_least=0.5).save(FOLDER / "seed.mask.npz")
    return {kind: (FOLDER / f"seed.{kind}").read_bytes() for kind in READERS}


READERS: dict[str, Callable[[Path], Any]] = {
    "csv": stl.load_trace,
    "npz": stl.load_trace,
    "parquet": stl.load_trace,
    "json": load_report,
    "jsonl": stl.certify,
    "checkpoint": learned,
    "mask.npz": lambda path: stl.Shield.load(path, PRODUCT),
}
KINDS = tuple(READERS)
SEEDS = seeds()


def repacked(provider: atheris.FuzzedDataProvider, kind: str) -> bytes:
    """An archive of which one member is mutated, with checksums that are right."""
    path = FOLDER / "again.zip"
    with zipfile.ZipFile(FOLDER / f"seed.{kind}") as archive, zipfile.ZipFile(path, "w") as again:
        names = archive.namelist()
        chosen = names[provider.ConsumeIntInRange(0, len(names) - 1)]
        for name in names:
            content = archive.read(name)
            again.writestr(name, mutated(provider, WORDS, content) if name == chosen else content)
    return path.read_bytes()


def one_input(data: bytes) -> None:
    provider = atheris.FuzzedDataProvider(data)
    kind = KINDS[provider.ConsumeIntInRange(0, len(KINDS) - 1)]
    packed = zipfile.is_zipfile(FOLDER / f"seed.{kind}") and provider.ConsumeBool()
    content = repacked(provider, kind) if packed else mutated(provider, WORDS, SEEDS[kind])
    path = FOLDER / f"f.{kind}"
    path.write_bytes(content)
    try:
        READERS[kind](path)
    except StlToolError as error:
        assert str(path) in str(error), str(error)


if __name__ == "__main__":
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
