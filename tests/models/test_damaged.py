"""Model files that are damaged at random are refused by name, or read; bench/fuzz_formats.py is guided by coverage."""

import gzip
import io
import lzma
import tarfile

import numpy as np
import pytest

import stltool as stl
from tests.conftest import many

VOCABULARY = """
0 1 3 -1 1/3 0.25 nan inf 18446744073709551615 [0.4,0.9] [ ] { } : , = " ! & // $x @model @nr_states @parameters
@type:§DTMC state§0 action§go init //[!b§&§x=3] "rational" "double" "size":§256 "type" "bool" null true "#states":§
"""
WORDS = [word.replace("§", " ").encode() for word in VOCABULARY.split()]


def model():
    return stl.MDP.from_arrays(
        [[["1/3", "2/3"], [0, 1]], [[0, 1], ["1/4", "3/4"]]], {"x": [0, 0.5], "b": [0, 1]}, labels={"A": [0, 1]},
        action_names=["go", "stay"], state_names=["(0,1)", "here"],
        costs={"toll": {"states": [1, 2], "choices": [[1, 0], [0, "1/3"]]}},
    )  # fmt: skip


def damaged(rng, content):
    found = bytearray(content)
    for _ in range(rng.integers(1, 4)):
        at, cut = int(rng.integers(len(found) + 1)), int(rng.integers(25))
        match int(rng.integers(4)):
            case 0:
                found[at : at + 1] = rng.bytes(1)
            case 1:
                del found[at : at + cut]
            case 2:
                found[at : at + cut] = WORDS[rng.integers(len(WORDS))]
            case 3:
                found[at:at] = found[at : at + cut]
    return bytes(found)


def repacked(rng, content):
    """A UMB file with one of its files damaged or missing, so that the container is sound."""
    out = io.BytesIO()
    with tarfile.open(fileobj=io.BytesIO(content)) as seed, tarfile.open(fileobj=out, mode="w") as tar:
        members = seed.getmembers()
        chosen, missing = int(rng.integers(len(members))), rng.random() < 0.2
        for number, member in enumerate(members):
            piece = seed.extractfile(member).read()
            if number == chosen:
                if missing:
                    continue
                piece = damaged(rng, piece)
                member.size = len(piece)
            tar.addfile(member, io.BytesIO(piece))
    return out.getvalue()


CHANGES = {
    "container": (".umb", damaged),
    "packed": (".umb", lambda rng, content: damaged(rng, gzip.compress(content))),
    "xz": (".umb", lambda rng, content: damaged(rng, lzma.compress(content))),
    "content": (".umb", repacked),
    "text": (".drn", damaged),
    "archive": (".drn.gz", damaged),
}


@pytest.mark.soak
@pytest.mark.parametrize("change", list(CHANGES))
def test_whatever_is_damaged_is_refused_or_read(tmp_path, change):
    ending, made = CHANGES[change]
    path, again = tmp_path / f"m{ending}", tmp_path / "again.umb"
    stl.save_model(model(), path)
    whole, rng, refused, n = path.read_bytes(), np.random.default_rng(0), 0, many(150)
    for _ in range(n):
        path.write_bytes(made(rng, whole))
        try:
            found = stl.load_model(path)
        except stl.StlToolError as error:
            assert str(path) in str(error)
            refused += 1
            continue
        if not found.parameters:
            stl.save_model(found, again)
            assert stl.load_model(again).digest() == found.digest()
    assert refused > n / 3
