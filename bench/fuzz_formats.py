"""`make fuzz WHAT=formats`: coverage-guided fuzzing of the readers of other tools' model files: .umb, .drn, .tra.

Whatever the bytes: only StlToolError comes out, it names the file, and what is read is saved and read again as the same
model. Inputs are mutations of a small model's files; see bench/fuzz_formulas.py.
"""

from __future__ import annotations

import io
import sys
import tarfile
import tempfile
from pathlib import Path

import atheris
from mutated import mutated

with atheris.instrument_imports(include=["stltool"]):
    import stltool as stl
    from stltool.errors import StlToolError
    from stltool.models.formats import drn, explicit, umb  # noqa: F401  # which would be loaded later

FOLDER = Path(tempfile.mkdtemp())
KINDS = (".umb", ".drn", ".tra", ".lab", ".sta", ".srew", ".trew")
VOCABULARY = """
0 1 2 3 -1 1/3 0.25 1e-9 nan inf 18446744073709551615 9223372036854775808 [0.4,0.9] [ ] ( ) { } : , = " ! & § // # $x
@model @nr_states @nr_choices @parameters @placeholders @type:§MDP @type:§DTMC @value_type:§double-interval state§0
action§go init __NOLABEL__ //[!b§&§x=3] "rational" "double" "size":§64 "size":§256 "type" "bool" "uint" "string" null
true "#states":§ "#choices":§ "#branches":§ "is-optional":§true, "offset":§-3, "padding":§3 "alias":§"a"
"""
WORDS = [word.replace("§", " ").encode() for word in VOCABULARY.split()]


def seeds() -> dict[str, bytes]:
    """The files of a small model."""
    model = stl.MDP.from_arrays(
        [[["1/3", "2/3"], [0, 1]], [[0, 1], ["1/4", "3/4"]]], {"x": [0, 0.5], "b": [0, 1]}, labels={"A": [0, 1]},
        action_names=["go", "stay"], state_names=["(0,1)", "here"],
        costs={"toll": {"states": [1, 2], "choices": [[1, 0], [0, "1/3"]]}},
    )  # fmt: skip
    for kind in (".umb", ".drn", ".tra"):
        stl.save_model(model, FOLDER / f"seed{kind}")
    return {kind: (FOLDER / f"seed{kind}").read_bytes() for kind in KINDS}


SEEDS = seeds()
for name in KINDS:
    (FOLDER / f"m{name}").write_bytes(SEEDS[name])


def archive_of(provider: atheris.FuzzedDataProvider) -> bytes:
    """The UMB seed with one of its files mutated or left out, so that mutations get past the container."""
    out = io.BytesIO()
    with tarfile.open(fileobj=io.BytesIO(SEEDS[".umb"])) as seed, tarfile.open(fileobj=out, mode="w") as tar:
        members = seed.getmembers()
        chosen, left_out = provider.ConsumeIntInRange(0, len(members) - 1), provider.ConsumeBool()
        for number, member in enumerate(members):
            file = seed.extractfile(member)
            content = file.read() if file is not None else b""
            if number == chosen:
                if left_out and number:
                    continue
                content = mutated(provider, WORDS, content)
                member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    return out.getvalue()


def one_input(data: bytes) -> None:
    provider = atheris.FuzzedDataProvider(data)
    kind = KINDS[provider.ConsumeIntInRange(0, len(KINDS) - 1)]
    content = (
        archive_of(provider) if kind == ".umb" and provider.ConsumeBool() else mutated(provider, WORDS, SEEDS[kind])
    )
    path = FOLDER / f"m{kind}"
    path.write_bytes(content)
    try:
        found = stl.load_model(path if kind in (".umb", ".drn") else FOLDER / "m.tra")
    except StlToolError as error:
        assert str(FOLDER / "m") in str(error), str(error)
        return
    finally:
        path.write_bytes(SEEDS[kind])
    again = FOLDER / "again.umb"
    again.unlink(missing_ok=True)
    try:
        stl.save_model(found, again)
    except StlToolError:  # parameters, several initial states
        return
    assert stl.load_model(again).digest() == found.digest()


if __name__ == "__main__":
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
