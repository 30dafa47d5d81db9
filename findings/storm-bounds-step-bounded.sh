#!/usr/bin/env bash
# Storm 2.0.0 gives lower and upper bounds for a step-bounded probability, and the exact probability lies outside them.
#
# A result of stormpy 2.0.0 has get_lower_bound, get_upper_bound, and has_lower_bounds and has_upper_bounds, which are
# true for Pmax=? [F<=20 "a"] on a chain of two states whose rows are 9/10 and 1/10. Both bounds are the same double,
# the value itself: 0x1.c1c0b46927202p-1. The probability is 1 - (9/10)^20; Storm's own exact engine says so
# (build_model_from_drn[stormpy.Rational]), and it is below both. So a bound is present, and
# is what one computation happened to round to; who wants an enclosure must add the rounding of twenty steps, or use the
# rational engine.
#
# Exits nonzero if that is no longer so.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet --disable-pip-version-check stormpy==2.0.0

printf '%s\n' "@type: MDP" "@parameters" "" "@reward_models" "" "@nr_states" 2 "@nr_choices" 2 "@model" \
    "state 0 init" "	action stay" "		0 : 0.9" "		1 : 0.1" \
    "state 1 a" "	action stay" "		0 : 0.9" "		1 : 0.1" > "$work/chain.drn"

cat > "$work/bounds.py" <<'PYTHON'
import sys
from fractions import Fraction

import stormpy

(question,) = stormpy.parse_properties('Pmax=? [F<=20 "a"]')
double = stormpy.model_checking(stormpy.build_model_from_drn(sys.argv[1]), question)
rational = stormpy.model_checking(stormpy.build_model_from_drn[stormpy.Rational](sys.argv[1]), question)
exact = Fraction(str(rational.get_value(0)))
assert exact == 1 - Fraction(9, 10) ** 20
assert double.has_lower_bounds() and double.has_upper_bounds()
lower, upper = double.get_lower_bound(0), double.get_upper_bound(0)
print(f"lower {lower.hex()}, upper {upper.hex()}")
print(f"exact minus upper {float(exact - Fraction(upper)):.2g}")
assert lower == upper == double.get_value(0)
assert not Fraction(lower) <= exact <= Fraction(upper)
PYTHON
"$work/venv/bin/python" "$work/bounds.py" "$work/chain.drn"
