#!/usr/bin/env bash
# Storm's Python interface builds a wrong model, without a message, from a program that gives a variable a value out of
# its bounds, unless it is asked for checks.
#
# stormpy 2.0.0, Python 3.11. The program has x: [0..1] and the update (x'=5). By default Storm keeps
# the last bit of 5 and goes to x = 1, as if (x'=1) had been written: two states, no message.
#   - BuilderOptions.set_exploration_checks(True) refuses it, in programs and in JANI.
#   - BuilderOptions.set_add_out_of_bounds_state(True) adds a state for such values in programs; in JANI it changes
#     nothing, and says nothing.
# Exits with 1 if any of this changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet stormpy==2.0.0
cat > program.prism <<'X'
dtmc
module m
  x : [0..1] init 0;
  [] x=0 -> 1/2 : (x'=5) + 1/2 : true;
endmodule
X
cat > look.py <<'X'
import stormpy

program = stormpy.parse_prism_program("program.prism")
jani, _ = program.to_jani([])


def built(model, checks=False, state=False):
    options = stormpy.BuilderOptions(build_full=True)
    options.set_exploration_checks(checks)
    options.set_add_out_of_bounds_state(state)
    try:
        found = stormpy.build_model[stormpy.Rational](model, options=options)
    except Exception as error:
        return str(error)
    return found.nr_states, "out_of_bounds" in found.labeling.get_labels()


for model in (program, jani):
    assert built(model) == (2, False), built(model)
    assert "out-of-bounds value (5)" in built(model, checks=True), built(model, checks=True)
asked = built(program, state=True), built(jani, state=True)
print(asked)
assert asked == ((2, True), (2, False)), asked  # x=0 and the added state; x=0 and x=1
X
venv/bin/python look.py
