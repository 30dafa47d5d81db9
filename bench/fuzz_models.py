"""`make fuzz WHAT=models`: coverage-guided fuzzing of the readers of model files in TOML: grids and compositions.

Whatever the bytes: only StlToolError comes out, and it names the file; the rows of what is read are distributions.
Inputs are mutations of examples' files; see bench/fuzz_formulas.py.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris
import numpy as np

with atheris.instrument_imports(include=["stltool"]):
    import stltool as stl
    from stltool.errors import StlToolError
    from stltool.models import load  # noqa: F401  # which would be loaded later, without instruments

FOLDER = Path(tempfile.mkdtemp())
EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
SEEDS = [
    (EXAMPLES / place).read_bytes()
    for place in ("team/floor.toml", "team/team.toml", "factory/floor-5x5-p.toml", "factory/floor-5x5-uncertain.toml")
]
VOCABULARY = """
kind = "grid" "composition" map moves "king" ["stay","N"] success slip start [regions] [noise] [one_way] [members]
[labels] [parameters] p [0,1] [0,0,1,1] [[0,0],[1,1]] 9/10 "p" "(1-p)/3" 0.9 -1 1e999 nan inf true wet E { } [ ] , .
r1 = "floor.toml" "model.toml" "r1.x == r1.y" "F[0,2] r1.P" "1 / r1.x > 0" normalize name S # § ''' \\u0000 99999999999
"""
WORDS = [word.replace("§", "\n") for word in VOCABULARY.split()]


def mutated(data: bytes) -> bytes:
    """A seed with pieces cut out, replaced and put in."""
    provider = atheris.FuzzedDataProvider(data)
    found = bytearray(SEEDS[provider.ConsumeIntInRange(0, len(SEEDS) - 1)])
    while provider.remaining_bytes():
        at = provider.ConsumeIntInRange(0, len(found))
        cut = provider.ConsumeIntInRange(0, 30)
        if provider.ConsumeBool():
            piece = WORDS[provider.ConsumeIntInRange(0, len(WORDS) - 1)].encode()
        else:
            piece = provider.ConsumeBytes(3)
        found[at : at + cut] = piece
    return bytes(found)


def one_input(data: bytes) -> None:
    path = FOLDER / "model.toml"
    path.write_bytes(mutated(data))
    try:
        model = stl.load_model(path)
    except StlToolError as error:
        assert str(path) in str(error), str(error)
        return
    states = np.unique(np.linspace(0, model.n_states - 1, 5).astype(np.int64))
    rows = model.source.rows(states)
    rows.require_distributions(str, str)
    if not model.uncertain:
        assert rows.defect == 0


if __name__ == "__main__":
    (FOLDER / "floor.toml").write_bytes(SEEDS[0])
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
