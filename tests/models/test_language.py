"""Programs in PRISM's language and in JANI, which Storm builds: `pip install stltool[storm]`."""

import json
from fractions import Fraction

import pytest

import stltool as stl

stormpy = pytest.importorskip("stormpy", reason="programs need stormpy (pip install stltool[storm])")

PROGRAM = """mdp
const int N;
const double p;
module robot
  x : [0..N] init 0;
  wet : bool init true;
  [go] x < N -> p : (x'=x+1) + (1-p) : (x'=x) & (wet'=!wet);
  [wait] true -> 1/3 : (wet'=false) + 2/3 : true;
endmodule
label "there" = x=N & !wet;
rewards "energy" [go] true : 1/2; wet : 0.1; endrewards
"""


def written(folder, text=PROGRAM, name="robot.prism"):
    (folder / name).write_text(text)
    return folder / name


def test_a_program_becomes_a_model(tmp_path):
    model = stl.load_model(written(tmp_path), constants={"N": 2, "p": "1/3"})
    assert model.state_name(0) == "wet=true, x=0"
    assert set(model.action_names) == {"go", "wait"}
    assert (model.signals["x"].min(), model.signals["x"].max()) == (0, 2)
    assert model.labels["there"].sum() == 1
    assert {model.costs["energy"].parts["choices"].exact[c] for c in range(model.n_choices)} == {0, Fraction(1, 2)}
    theirs = stormpy.parse_prism_program(str(tmp_path / "robot.prism"))
    theirs, formulas = stormpy.io.instantiate_constants(
        theirs, "N=2,p=1/3", stormpy.parse_properties('Pmax=? [F<=5 "there"]', theirs)
    )
    built = stormpy.build_model[stormpy.Rational](theirs, formulas)
    value = stormpy.model_checking(built, formulas[0]).get_value(built.initial_states[0])
    mine = stl.check(stl.build_product(model, stl.parse("F[0,5] there")), exact=True)
    assert mine.fraction == Fraction(str(value)) > 0


def test_labels_that_hold_nowhere_are_labels(tmp_path):
    text = PROGRAM.replace("endmodule\n", 'endmodule\nlabel "lost" = x > N;\n')
    for constants in ({"N": 1, "p": "1/3"}, {"N": 1}):  # a model, a family
        model = stl.load_model(written(tmp_path, text), constants=constants)
        assert model.labels["lost"].tolist() == [False] * model.n_states
        assert model.labels["there"].any()
    product = stl.build_product(
        stl.load_model(tmp_path / "robot.prism", constants={"N": 1, "p": 1}), stl.parse("F[0,2] lost")
    )
    assert stl.check(product, exact=True).fraction == 0


@pytest.mark.parametrize("as_jani", [False, True])
@pytest.mark.parametrize("value", [5, -1])
def test_values_out_of_bounds_are_refused(tmp_path, as_jani, value):
    """Storm, if not asked to check, goes to x = 1 instead of 5."""
    text = f"dtmc module m\n x: [0..1] init 0;\n [] x=0 -> 1/2 : (x'={value}) + 1/2 : true;\nendmodule\n"
    path = written(tmp_path, text)
    if as_jani:
        path = written(tmp_path, str(stormpy.parse_prism_program(str(path)).to_jani([])[0]), "robot.jani")
    with pytest.raises(stl.errors.ModelError, match=rf"{path.name}: .*out-of-bounds value \({value}\)"):
        stl.load_model(path)


def test_rounded_sums_are_rescaled_on_request(tmp_path):
    path = written(
        tmp_path, "dtmc module m\n x: [0..1] init 0;\n [] true -> 0.333333 : (x'=1) + 0.666666 : true;\nendmodule\n"
    )
    with pytest.raises(
        stl.errors.ModelError,
        match="robot.prism, as Storm builds it: state 0, choice 0: .*sum to 0.999999, not 1; rows that miss 1",
    ):
        stl.load_model(path)
    assert "rescaled 2 of 2" in stl.load_model(path, normalize=True).notes["normalize"]


def test_labels_and_rewards_of_jani_are_no_signals(tmp_path):
    """Files that Storm made from programs have a transient variable for each."""
    program = written(tmp_path, PROGRAM.replace("const int N;\nconst double p;", "const int N=1;\nconst double p=1/3;"))
    text = str(stormpy.parse_prism_program(str(program)).to_jani([])[0])
    model, read = stl.load_model(program), stl.load_model(written(tmp_path, text, "robot.jani"))
    assert not {"there", "energy"} & set(read.signals)
    assert "there" in read.labels
    assert set(read.costs) == {"energy"}
    phi = stl.parse("F[0,4] there")
    values = [stl.check(stl.build_product(one, phi), exact=True).fraction for one in (model, read)]
    assert values[0] == values[1] > 0


def test_constants_of_probabilities_may_stay_open(tmp_path):
    model = stl.load_model(written(tmp_path), constants={"N": 1})
    assert [(one.name, one.domain) for one in model.parameters] == [("p", "[0, 1]")]
    phi = stl.parse("F[0,4] there")
    other = stl.load_model(tmp_path / "robot.prism", constants={"N": 1, "p": "1/7"})
    values = [stl.check(stl.build_product(one, phi), exact=True).fraction for one in (model.at(p="1/7"), other)]
    assert values[0] == values[1]


def test_booleans_that_stay_true_keep_their_names(tmp_path):
    text = "dtmc module m\n a: bool init true; b: bool init true; x: [0..1] init 0;\n [] true -> (x'=1-x);\nendmodule\n"
    model = stl.load_model(written(tmp_path, text))
    assert {name: values.tolist() for name, values in model.signals.items()} == {
        "a": [1, 1], "b": [1, 1], "x": [0, 1]
    }  # fmt: skip


def test_a_jani_file(tmp_path):
    location = {"name": "here"}
    edges = [{
        "location": "here", "guard": {"exp": {"op": "<", "left": "x", "right": 3}},
        "destinations": [
            {"location": "here", "probability": {"exp": {"op": "/", "left": 1, "right": 4}},
             "assignments": [{"ref": "x", "value": {"op": "+", "left": "x", "right": 1}}]},
            {"location": "here", "probability": {"exp": {"op": "/", "left": 3, "right": 4}}, "assignments": []},
        ],
    }]  # fmt: skip
    variable = {"name": "x", "type": {"kind": "bounded", "base": "int", "lower-bound": 0, "upper-bound": 3},
                "initial-value": 0}  # fmt: skip
    automaton = {"name": "m", "locations": [location], "initial-locations": ["here"], "edges": edges}
    model = {
        "jani-version": 1, "name": "m", "type": "dtmc", "features": [], "variables": [variable], "properties": [],
        "automata": [automaton], "system": {"elements": [{"automaton": "m"}]},
    }  # fmt: skip
    (tmp_path / "m.jani").write_text(json.dumps(model))
    read = stl.load_model(tmp_path / "m.jani")
    result = stl.check(stl.build_product(read, stl.parse("F[0,4] x > 1.5")), exact=True)
    assert result.fraction == 1 - Fraction(3, 4) ** 4 - 4 * Fraction(1, 4) * Fraction(3, 4) ** 3


@pytest.mark.parametrize(
    ("text", "constants", "message"),
    [
        (PROGRAM, {}, "no value is given for N and p; give one: -p N=…, in Python constants={'N': …}"),
        (PROGRAM, {"M": 1}, "there is no constant M without a value; known names: N, p"),
        (PROGRAM, {"N": "two"}, "constant N: 'two' is not a number"),
        (PROGRAM, {"N": 2, "p": 1.5}, "robot.prism: "),
        (PROGRAM.replace("mdp", "ctmc"), {"N": 1, "p": 1}, "the model is a CTMC; Markov chains (DTMC) and MDPs"),
        (PROGRAM.replace("init 0", "init 9"), {"N": 1, "p": 1}, "Storm does not build this model: "),
        ("mdp module", {}, "Storm does not build this model: "),
        ("mdp\0", {}, "contains binary data"),
        ("", {}, "Storm does not build this model: "),
    ],
)  # fmt: skip
def test_faults(tmp_path, capfd, text, constants, message):
    with pytest.raises(stl.StlToolError) as caught:
        stl.load_model(written(tmp_path, text), constants=constants)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_constants_are_of_programs(tmp_path):
    (tmp_path / "m.toml").write_text("")
    with pytest.raises(stl.errors.SettingsError, match="only programs in PRISM's language or JANI have constants"):
        stl.load_model(tmp_path / "m.toml", constants={"N": 1})
