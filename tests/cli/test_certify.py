"""`stltool certify`: what it says of files that are no certificates, damaged, or about another task."""

import gzip
import json

import pytest

import stltool as stl


@pytest.mark.parametrize("name", ["task.stl", "policy.npz", "report.json", "check.json", "cut.gz", "older.jsonl"])
def test_what_is_no_certificate_is_told_in_words(stltool, tmp_path, patrolling, name):
    path = tmp_path / name
    match name:
        case "task.stl":
            path.write_text("reach := F[0,3] A\n")
        case "policy.npz":
            stl.check(patrolling).policy.save(path)
        case "report.json":
            path.write_text(json.dumps({"format": "stltool-report-1", "checks": []}, indent=1))
        case "check.json":
            path.write_text(json.dumps({"task": "reach", "probability": 0.5}))
        case "cut.gz":
            path.write_bytes(gzip.compress(b'{"format":"stltool-certificate-3"}\n')[:12])
        case "older.jsonl":
            path.write_text('{"format":"stltool-certificate-1"}\n')
    code, out, err = stltool("certify", path)
    assert (code, out) == (2, "")
    assert f"{path}: not a certificate (stltool-certificate-3)" in err
    assert "Error" not in err


def test_the_same_damage_is_refused_alike_packed_and_unpacked(stltool, tmp_path, patrolling):
    """Cut anywhere after the first line, or with a byte that is not text: exit code 1; in the first line: 2."""
    path, packed = tmp_path / "c.jsonl", tmp_path / "c.jsonl.gz"
    stl.write_certificate(stl.check(patrolling), path)
    whole = path.read_bytes()
    first, half = whole.index(b"\n") + 1, len(whole) // 2
    line = whole.rindex(b"\n", 0, half) + 1
    for damaged, expected in (
        (whole[:half], 1), (whole[:line], 1), (whole[:-1] + b"\xff\n", 1), (whole[:half] + b"\xff" + whole[half:], 1),
        (whole[:line] + b"7\n" + whole[line:], 1), (whole[: first // 2], 2), (b"\xff" + whole, 2), (b"", 2),
    ):  # fmt: skip
        path.write_bytes(damaged)
        packed.write_bytes(gzip.compress(damaged))
        found = [stltool("certify", one) for one in (path, packed)]
        assert [one[0] for one in found] == [expected, expected]
        assert found[0][2].replace(str(path), "") == found[1][2].replace(str(packed), "")
        assert "Error" not in found[0][2]
    packed.write_bytes(gzip.compress(whole)[:-20])
    code, _, err = stltool("certify", packed)
    assert code == 1
    assert "refused: the file is cut off: its compressed data end after line " in err
    packed.write_bytes(gzip.compress(whole)[:-8] + bytes(8))
    code, _, err = stltool("certify", packed)
    assert code == 1
    assert "refused: its compressed data are damaged after line " in err


def test_certificates_of_another_definition_name_it(stltool, tmp_path):
    (tmp_path / "coin.toml").write_text('kind = "grid"\nmap = "SA"\ncell = 1\nmoves = "cross"\nsuccess = 0.5\n')
    task, path = tmp_path / "t.stl", tmp_path / "c.jsonl"
    task.write_text('model "coin.toml"\nsoon := F[0,1] A\nlater := F[0,3] A\n')
    policy = tmp_path / "p.npz"
    done = stltool("check", task, "--task", "soon", "--certificate", path, "--save-policy", policy)
    assert done[0] == 0
    code, _, err = stltool("certify", path, task)
    assert code == 2
    assert "is F[0,1] A, not F[0,3] A; that is soon of the same file: add --task soon" in err
    assert stltool("certify", path, task, "--task", "soon")[0] == 0
    code, _, err = stltool("certify", path, task, "--task", "soon", "--policy", policy)
    assert code == 2
    assert "the claim of this certificate is maximum, not policy; leave out --policy" in err
