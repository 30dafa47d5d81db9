#!/usr/bin/env bash
# What Storm's Python package does with model files that one would not expect. Seen with stormpy 2.0.0 and
# umbi 0.2.5; exits with 1 if one of these is no longer so.
#
# 1. A DRN text compressed with gzip, m.drn.gz, is not read: Storm takes archives for compressed DRN, and reads the same
#    text from a tar.gz of one file, whatever its name.
#        gzip: not read        tar.gz: 2 states
# 2. The comments with the values of variables in exported DRN leave out the name of a Boolean that is true:
#        //[!b	& x=0]
#        //[	& x=1]
# 3. A model in rational numbers cannot be exported as UMB, although the format has rationals and Storm reads them:
#        UnexpectedException: Unable to export rational vector ... Rational values must be encoded prior to export.
# 4. UMB files with an annotation of type "string", which the specification has and umbi writes, are not read:
#        WrongFormatException: Invalid enum value 'string'.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check 'stormpy==2.0.0' 'umbi==0.2.5' 'bitstring<5'
cd "$folder"
cat > look.py <<'EOF'
import gzip
import io
import json
import sys
import tarfile

import stormpy

DRN = """@type: DTMC
@parameters

@reward_models

@nr_states
2
@nr_choices
2
@model
state 0 init
\taction 0
\t\t1 : 1
state 1
\taction 0
\t\t1 : 1
"""
PROGRAM = """dtmc
module m
  b : bool init false;
  x : [0..1] init 0;
  [] true -> 1/3 : (b'=true) & (x'=1) + 2/3 : true;
endmodule
"""
as_seen = []


def read(build, path):
    try:
        return f"{build(path).nr_states} states"
    except Exception as error:
        return f"not read: {type(error).__name__}"


# 1
with gzip.open("m.drn.gz", "wt") as file:
    file.write(DRN)
with tarfile.open("archive.drn.gz", "w:gz") as tar:
    entry = tarfile.TarInfo("m.drn")
    entry.size = len(DRN)
    tar.addfile(entry, io.BytesIO(DRN.encode()))
packed, archive = (read(stormpy.build_model_from_drn, name) for name in ("m.drn.gz", "archive.drn.gz"))
print("1. gzip:", packed, "  tar.gz:", archive)
as_seen.append(packed.startswith("not read") and archive == "2 states")

# 2
with open("m.prism", "w") as file:
    file.write(PROGRAM)
program = stormpy.parse_prism_program("m.prism")
built = stormpy.build_model[stormpy.Rational](program, options=stormpy.BuilderOptions(build_full=True))
stormpy.io.export_to_drn(built, "exported.drn")
comments = [line for line in open("exported.drn").read().splitlines() if line.startswith("//[")]
print("2.", comments)
as_seen.append(comments == ["//[!b\t& x=0]", "//[\t& x=1]"])

# 3
try:
    stormpy.io.export_to_umb(built, "rational.umb")
    said = "exported"
except RuntimeError as error:
    said = str(error)
print("3.", said)
as_seen.append("Rational values must be encoded prior to export" in said)

# 4
stormpy.io.export_to_umb(stormpy.build_model(program), "plain.umb")
with tarfile.open("plain.umb") as old, tarfile.open("texts.umb", "w") as new:
    for member in old:
        content = old.extractfile(member).read() if member.isfile() else b""
        if member.name == "index.json":
            index = json.loads(content)
            annotation = {"applies-to": ["states"], "type": {"type": "string", "size": 64}, "#strings": 2}
            index.setdefault("annotations", {})["names"] = {"state": annotation}
            content = json.dumps(index).encode()
            member.size = len(content)
        new.addfile(member, io.BytesIO(content))
    where = "annotations/names/state/states/"
    for name, content in (
        ("values.bin", bytes(8) + b"\1" + bytes(7)),
        ("string-mapping.bin", bytes(8) + b"\1" + bytes(7) + b"\2" + bytes(7)),
        ("strings.bin", b"ab"),
    ):
        entry = tarfile.TarInfo(where + name)
        entry.size = len(content)
        new.addfile(entry, io.BytesIO(content))
import umbi

names = umbi.umb.read("texts.umb").annotations["names"]["state"]["states"]
try:
    stormpy.build_model_from_umb("texts.umb")
    said = "read"
except RuntimeError as error:
    said = str(error)
print("4. umbi reads", names, "  Storm:", said)
as_seen.append(names == ["a", "b"] and "Invalid enum value 'string'" in said)

sys.exit(0 if all(as_seen) else 1)
EOF
"$folder/venv/bin/python" look.py
