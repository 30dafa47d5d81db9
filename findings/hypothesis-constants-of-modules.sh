#!/usr/bin/env bash
# Hypothesis: with derandomize=True, the examples of a test depend on which other modules of the project are loaded.
#
# Version: hypothesis 6.170.17 (CPython 3.11).
# derandomize=True is documented as making a test's examples deterministic, seeded by the test function. Hypothesis also collects
# the numbers and strings written in all local modules (those of the project, not of the library folders) in sys.modules, and now and
# then draws one of them instead of a random value. So a test that is not touched gets other examples once a module beside it
# is imported that it never uses, or once a constant is edited there: a suite run whole, one file of it, and one process of several
# differ, and what failed in one may pass in another.
# Output seen: two runs: the same 400 examples; with a module more, which holds nothing but a list of numbers, 351 of the 400
# differ, and 3 are numbers of that list.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check hypothesis==6.170.17
mkdir "$folder/project"
cd "$folder/project"
cat > drawn.py <<'PYTHON'
import importlib
import sys

for name in sys.argv[1:]:
    importlib.import_module(name)

from hypothesis import given, settings, strategies as st

found = []


@settings(derandomize=True, database=None, max_examples=400)
@given(st.integers(0, 10**9))
def test(n):
    found.append(n)


test()
print(*found)
PYTHON
echo "numbers = [123456789, 222222222, 987654321]" > beside.py
"$folder/venv/bin/python" drawn.py > once
"$folder/venv/bin/python" drawn.py > again
"$folder/venv/bin/python" drawn.py beside > with_module
cmp once again
echo "two runs: the same $(wc -w < once) examples"
if cmp -s once with_module; then
    echo "the same examples with a module more: this has changed"
    exit 1
fi
"$folder/venv/bin/python" - <<'PYTHON'
once, beside = (open(name).read().split() for name in ("once", "with_module"))
differ = sum(a != b for a, b in zip(once, beside))
print(f"with a module more: {differ} of {len(once)} differ; numbers of that module among them:",
      sum(n in ("123456789", "222222222", "987654321") for n in beside))
PYTHON
