"""`make fuzz WHAT=explicit`: coverage-guided fuzzing of the reader of PRISM's and Storm's explicit files.

Whatever the bytes: only StlToolError comes out, and it names a file; the two readers, line by line and by the kernel,
say the same; the rows of what is read are distributions. Inputs are mutations of small files of each kind; see
bench/fuzz_formulas.py.
"""

from __future__ import annotations

import gzip
import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["stltool"]):
    import stltool as stl
    from stltool.errors import StlToolError
    from stltool.models import load  # noqa: F401  # which would be loaded later, without instruments
    from stltool.models.formats import explicit, lines

FOLDER = Path(tempfile.mkdtemp())
_ROWS = b"# Transitions (MDP)\n3 4 6\n0 2/5:0 3/5:1 east\n0 1E-1:1 0.9:2 south\n1 1.0:2 stuck\n2 1:2 stuck\n"
SEEDS: list[dict[str, bytes]] = [
    {
        "tra": b"# Transitions (MDP)\n3 3 5\n0 0 0 2/5 east\n0 0 1 3/5 east\n0 1 1 1E-1\n0 1 2 0.9\n1 0 2 1.0 go\n",
        "lab": b'0="init" 1="deadlock" 2="goal"\n0: 0\n2: 1 2\n',
        "sta": b"(s,up)\n0:(0,true)\n1:(-1,false)\n2:(2,true)\n",
        "srew": b'# Reward structure "time"\n3 2\n0 1\n2 -1/3\n',
        "trew": b"3 3 2\n0 0 1 2\n1 0 2 1E-3\n",
    },
    {"tra": _ROWS, "trew": b"3 4 3\n0 1:0 2:1\n0\n1 3.5:2\n2\n"},
    {"tra": b"2 3\n0 0 [0.1,0.5] a\n0 1 [1/3,1] b\n1 1 [1,1]\n", "lab": b'0="init"\n0: 0\n1: 0\n'},
    {
        "tra": b"mdp\n0 0 1 0.4\n0 0 2 0.6\n0 1 0 1\n1 0 2 1\n2 0 2 1\n",
        "lab": b"#DECLARATION\ninit goal\n#END\n0 init\n2 goal\n",
        "srew": b"0 1.5\n",
    },
]
VOCABULARY = """
# § : [ ] [0,1] 0.33333333333333333333333 1e-999 1e999 1/0 2/3 -1 nan 99999999999 1_0 0x1 mdp dtmc ctmc true ( ) , = "
"init" #DECLARATION #END #§Transitions§(LTS) \t \\0
"""
WORDS = [word.replace("§", "\n") for word in VOCABULARY.split()]


def mutated(data: bytes) -> tuple[dict[str, bytes], bool]:
    """Files with pieces of one of them cut out, replaced and put in, and whether they are packed."""
    provider = atheris.FuzzedDataProvider(data)
    files = dict(SEEDS[provider.ConsumeIntInRange(0, len(SEEDS) - 1)])
    packed = provider.ConsumeIntInRange(0, 20) == 0
    while provider.remaining_bytes():
        ending = list(files)[provider.ConsumeIntInRange(0, len(files) - 1)]
        found = bytearray(files[ending])
        at, cut = provider.ConsumeIntInRange(0, len(found)), provider.ConsumeIntInRange(0, 12)
        if provider.ConsumeBool():
            piece = WORDS[provider.ConsumeIntInRange(0, len(WORDS) - 1)].encode()
        else:
            piece = provider.ConsumeBytes(3)
        found[at : at + cut] = piece
        files[ending] = bytes(found)
    return files, packed


def content(path: Path, large: int) -> tuple[str, ...]:
    """What a reader makes of the files."""
    lines.LARGE = explicit.LARGE = large
    try:
        model = stl.load_model(path, initial="uniform")
    except StlToolError as error:
        assert str(FOLDER) in str(error), str(error)
        return (str(error),)
    rows = model.rows
    rows.require_distributions(str, str)
    shares = "" if model.uncertain else f"{rows.numerator.tolist()} / {rows.denominator}"
    return model.digest(), shares, *model.action_names, *map(model.state_name, range(model.n_states))


def one_input(data: bytes) -> None:
    files, packed = mutated(data)
    for ending in ("tra", "lab", "sta", "srew", "trew"):
        for name in (f"m.{ending}", f"m.{ending}.gz"):
            (FOLDER / name).unlink(missing_ok=True)
    for ending, text in files.items():
        (FOLDER / (f"m.{ending}.gz" if packed else f"m.{ending}")).write_bytes(gzip.compress(text) if packed else text)
    path = FOLDER / ("m.tra.gz" if packed else "m.tra")
    assert content(path, 0) == content(path, 1 << 60)


if __name__ == "__main__":
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
