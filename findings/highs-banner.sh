#!/usr/bin/env bash
# highspy 1.16.0 prints its banner when a solver object is made, before any option can be set, on file descriptor 1.
#
# Up to 1.15.1 the constructor is silent, and `output_flag = False` or `silent()` afterwards keeps it so. From 1.16.0
#
#     Running HiGHS 1.16.0 (git hash: f3f113d): Copyright (c) 2026 under MIT licence terms
#     Includes third-party software components, see THIRD_PARTY_NOTICES.md for full details
#
# comes out of `highspy.Highs()` itself. Through cvxpy (1.9.2, solver HIGHS) neither `verbose=False` nor highs_options
# with output_flag and log_to_console switched off can reach it, and `contextlib.redirect_stdout` does not either, since
# it is written in C++: a program that prints JSON on stdout has two lines before it. scipy's own HiGHS
# (`linprog(method="highs-ds")`, or cvxpy's solver SCIPY) prints nothing.
#
# Exits nonzero if that is no longer so.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
install() { "$work/venv/bin/pip" install --quiet --disable-pip-version-check "$@"; }
install cvxpy==1.9.2 highspy==1.16.0 scipy==1.17.1 numpy==2.4.6

cat > "$work/made.py" <<'PYTHON'
import highspy

highspy.Highs().silent()
PYTHON

cat > "$work/solved.py" <<'PYTHON'
import contextlib
import io
import sys

import cvxpy as cp

x = cp.Variable(2, nonneg=True)
problem = cp.Problem(cp.Maximize(x[0] + x[1]), [x[0] + 2 * x[1] <= 4, 3 * x[0] + x[1] <= 6])
with contextlib.redirect_stdout(io.StringIO()):
    if sys.argv[1] == "HIGHS":
        off = {"output_flag": False, "log_to_console": False}
        problem.solve(solver=cp.HIGHS, verbose=False, highs_options=off)
    else:
        problem.solve(solver=cp.SCIPY, verbose=False, scipy_options={"method": "highs-ds"})
print(f'{{"value": {problem.value:.1f}}}')
PYTHON

python() { "$work/venv/bin/python" "$@"; }
fail() { echo "changed: $*"; exit 1; }

banner="Running HiGHS 1.16.0"
[[ $(python "$work/made.py" | head -1) == "$banner"* ]] || fail "the constructor of 1.16.0 is silent"
out=$(python "$work/solved.py" HIGHS)
echo "$out"
[[ $(sed -n 1p <<< "$out") == "$banner"* && $(sed -n 3p <<< "$out") == '{"value": 2.8}' ]] || fail "no banner before the JSON"
[[ $(python "$work/solved.py" SCIPY) == '{"value": 2.8}' ]] || fail "scipy's HiGHS prints something"

install highspy==1.15.1
[[ -z $(python "$work/made.py") ]] || fail "the constructor of 1.15.1 prints something"
[[ $(python "$work/solved.py" HIGHS) == '{"value": 2.8}' ]] || fail "1.15.1 prints something through cvxpy"
echo "as described"
