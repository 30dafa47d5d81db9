"""Compositions against Kronecker products, and the laws of robots that move independently."""

import functools
import itertools
from fractions import Fraction

import numpy as np
import pytest

import stltool as stl
from stltool.errors import (
    ArgumentError,
    FragmentError,
    ModelError,
    NameLookupError,
    SizeError,
    StlSyntaxError,
    StlToolError,
    TraceError,
)
from stltool.models.load import companions
from stltool.models.rows import Demand
from stltool.reporting import load_report
from tests.conftest import FACTORY, many
from tests.oracles import optimum, random_model, tied_optimum

MEET = {"meet": "r1.x == r2.x & r1.y == r2.y"}
FLOOR = 'kind = "grid"\nmap = "A.\\nS#"\nsuccess = "93/100"\nslip = "7/300"\n'
TEAM = 'kind = "composition"\n[members]\nr1 = "floor.toml"\nr2 = { model = "floor.toml", start = [1, 1] }\n'


def partial(rng, n_states, n_actions, denominator):
    """A random model in which some actions are not available in some states."""
    model = random_model(rng, denominator, n_states, n_actions)
    matrices = dense(model)
    without = rng.random((n_actions, n_states)) < 0.3
    without[int(rng.integers(n_actions))] = False
    matrices[without] = Fraction(0)
    start = [model.initial_share(s) for s in range(n_states)]
    return stl.MDP.from_arrays(matrices, dict(model.signals), start, dict(model.labels))


def dense(model):
    """(A, S, S) Fractions; a row of zeros is an action that a state has not."""
    found = np.full((model.n_actions, model.n_states, model.n_states), Fraction(0), dtype=object)
    rows, state = model.rows, np.repeat(np.arange(model.n_states), np.diff(model.choice_start))
    for c, (s, a) in enumerate(zip(state, model.choice_action, strict=True)):
        for k in range(rows.row_start[c], rows.row_start[c + 1]):
            found[a, s, rows.target[k]] += Fraction(int(rows.numerator[k]), rows.denominator)
    return found


@pytest.mark.parametrize("seed", range(6))
def test_rows_are_kronecker_products(seed):
    rng = np.random.default_rng(seed)
    shapes = [(3, 2, 6), (2, 3, 10), (4, 1, 3)][: 2 + seed % 2]
    models = [partial(rng, *shape) for shape in shapes]
    joint = stl.compose(models, {"both": "r1.A & r2.B", "same": "r1.x == r2.x | both"})
    assert joint.source.on_demand
    assert joint.n_states == np.prod([model.n_states for model in models])
    assert joint.n_transitions == np.prod([model.n_transitions for model in models]) == len(joint.target)
    wanted = [functools.reduce(np.kron, each) for each in itertools.product(*map(dense, models))]
    assert (dense(joint) == np.array(wanted)).all()
    assert joint.probability.tolist() == [
        float(Fraction(int(k), joint.rows.denominator)) for k in joint.rows.numerator.tolist()
    ]
    starts = [[model.initial_share(s) for s in range(model.n_states)] for model in models]
    wanted = [np.prod(each, initial=Fraction(1)) for each in itertools.product(*starts)]
    assert [joint.initial_share(s) for s in range(joint.n_states)] == wanted
    for s, each in enumerate(itertools.product(*(range(model.n_states) for model in models))):
        assert joint.state_name(s) == " ".join(f"r{i}={own}" for i, own in enumerate(each, start=1))
        x, a, b = (joint.signals["r1.x"][s], joint.labels["r1.A"][s], joint.labels["r2.B"][s])
        assert (x, a) == (models[0].signals["x"][each[0]], models[0].labels["A"][each[0]])
        assert joint.labels["both"][s] == (a and b)
        assert joint.labels["same"][s] == (x == joint.signals["r2.x"][s] or (a and b))
    assert joint.action_names[-1] == "+".join(f"r{i}.{m.n_actions - 1}" for i, m in enumerate(models, start=1))


@pytest.mark.parametrize("seed", range(4))
def test_any_part_of_the_rows_is_a_part_of_all(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    joint = stl.compose([partial(rng, 5, 2, 6), stl.load_model(FACTORY / "floor-5x5.toml")])
    whole, kinds = joint.rows, joint.source.kinds
    assert (kinds.longest, kinds.widest, kinds.least) == (whole.longest, whole.widest, whole.least)
    assert kinds.defect == whole.defect == 0
    assert (joint.source.widest, joint.source.most_choices) == (whole.widest, whole.most_choices)
    assert joint.digest() == joint.with_rows().digest()
    monkeypatch.setattr("stltool.models.composition._BLOCK", 300)
    demand = Demand(joint.source)
    for _ in range(3):
        states = rng.permutation(joint.n_states)[: rng.integers(joint.n_states + 1)]
        numbers, part = demand.at(states), whole.some(states)
        demand_rows = demand.rows.some(numbers)
        for found in (joint.source.rows(states), demand_rows):
            for name in ("choice_start", "row_start", "target", "probability", "numerator"):
                assert np.array_equal(getattr(found, name), getattr(part, name)), name


@pytest.mark.parametrize("seed", range(many(30)))
def test_robots_with_separate_tasks_are_independent(seed):
    """P(φ1 & φ2) is the product of both, P(φ1) is that of the single robot: as fractions, at best and at worst."""
    rng = np.random.default_rng(seed)
    models = [partial(rng, 3, 2, 6), partial(rng, 2, 2, 10)]
    joint = stl.compose(dict(zip(("left", "right"), models, strict=True)))
    tasks = ["F[0,2] (A & F[0,1] !B)", "!B U[0,2] (A | x > 0)"]
    own = [stl.build_product(model, stl.parse(task)) for model, task in zip(models, tasks, strict=True)]
    renamed = ["F[0,2] (left.A & F[0,1] !left.B)", "!right.B U[0,2] (right.A | right.x > 0)"]
    for maximize in (True, False):
        single = [stl.check(product, maximize=maximize, exact=True).fraction for product in own]
        for task, value in zip(renamed, single, strict=True):
            alone = stl.check(stl.build_product(joint, stl.parse(task)), maximize=maximize, exact=True)
            assert alone.fraction == value
        together = stl.check(
            stl.build_product(joint, stl.parse(" & ".join(f"({task})" for task in renamed))),
            maximize=maximize, exact=True,
        )  # fmt: skip
        assert together.fraction == single[0] * single[1]
        assert together.lower <= together.fraction <= together.upper


def test_a_joint_task_against_the_tree_of_all_runs():
    rng = np.random.default_rng(4)
    joint = stl.compose([partial(rng, 2, 2, 6), partial(rng, 3, 1, 6)], {"meet": "r1.x == r2.x"})
    phi = stl.parse("F[0,2] (meet & r1.A) & G[0,1] !(meet & r2.B)")
    for maximize in (True, False):
        found = stl.check(stl.build_product(joint, phi), maximize=maximize, exact=True).fraction
        assert found == optimum(joint, phi, maximize)


@pytest.mark.parametrize("engine", ["nodes", "words"])
def test_engines_compute_rows_on_demand(engine, monkeypatch):
    monkeypatch.setattr("stltool.models.mdp._FEW", 0)
    monkeypatch.setattr("stltool.models.mdp.READ_EXACTLY", 0)
    floor = stl.load_model(FACTORY / "floor-5x5.toml")
    joint = stl.compose([floor, floor.starting_in("(3,1)")], MEET)
    phi = stl.parse("F[0,4] (r1.A & r2.A) & G[0,4] !meet")
    found = stl.check(stl.build_product(joint, phi), engine=engine)
    assert "rows" not in vars(joint)
    held = stl.check(stl.build_product(joint.with_rows(), phi), engine=engine)
    assert (found.probability, found.lower, found.upper) == (held.probability, held.lower, held.upper)


def test_doubles_are_multiplied_exactly():
    """A row of doubles means its decimals, or its binary values, as in the model itself; products are not rounded."""
    row = np.array([[[0.1, 0.9], [0.7, 0.3]]])
    joint = stl.compose([stl.MDP.from_arrays(row, {}, labels={"A": [0, 1]})] * 3)
    assert joint.rows.denominator == 1000
    phi = stl.parse("F[1,1] (r1.A & r2.A & r3.A)")
    assert stl.check(stl.build_product(joint, phi), exact=True).fraction == Fraction(729, 1000)
    binary = np.array([[[1 / 3, 2 / 3], [1 / 7, 6 / 7]]])
    joint = stl.compose([stl.MDP.from_arrays(binary, {}, labels={"A": [0, 1]})] * 2)
    assert dense(joint)[0, 0, 3] == Fraction(2 / 3) ** 2
    found = stl.check(stl.build_product(joint, stl.parse("F[1,1] (r1.A & r2.A)")))
    assert found.lower <= Fraction(2 / 3) ** 2 <= found.upper


def test_a_function_in_doubles_is_read_exactly():
    def step(s, a):
        return np.stack([1 - s, s], axis=1), np.tile([0.25, 0.75], (len(s), 1))

    swap = stl.MDP.from_function(2, 1, step, {}, labels={"A": [0, 1]})
    whole = stl.MDP.from_function(2, 1, lambda s, a: (step(s, a)[0], np.tile([1, 3], (len(s), 1))), denominator=4)
    assert (dense(stl.compose([swap, whole])) == np.array([np.kron(*[dense(m)[0] for m in (swap, whole)])])).all()


def test_one_member_may_depend_on_a_parameter():
    p = [["1-p", "p"], ["0", "1"]]
    slow = stl.MDP.from_arrays([p], {}, labels={"A": [0, 1]}, parameters={"p": (Fraction(1, 4), Fraction(3, 4))})
    other = random_model(np.random.default_rng(2), 6, 2, 2)
    for models in ([slow, other], [other, slow]):
        joint = stl.compose(models)
        (name,) = [f"r{i}" for i, model in enumerate(models, start=1) if model is slow]
        assert [one.name for one in joint.parameters] == ["p"]
        for value in (Fraction(1, 4), Fraction(2, 5)):
            at = [model.at(p=value) if model is slow else model for model in models]
            assert (dense(joint.at(p=value)) == dense(stl.compose(at))).all()
        phi = stl.parse(f"F[0,2] {name}.A")
        lower, upper = stl.parametric(stl.build_product(joint, phi)).at("2/5")
        wanted = stl.check(stl.build_product(slow.at(p="2/5"), stl.parse("F[0,2] A")), exact=True).fraction
        assert lower <= wanted <= upper < lower + 1e-6
        for nature in ("against", "with"):
            robust = stl.robust_check(stl.build_product(joint, phi), nature=nature)
            wanted = tied_optimum(joint, phi, True, nature == "against")
            assert robust.lower <= wanted <= robust.upper
    with pytest.raises(ModelError, match="members r1 and r2 depend on parameters, and products of these"):
        stl.compose([slow, slow])
    joint = stl.compose([slow, slow.at(p="1/2")])
    assert joint.parameters == slow.parameters
    valued = stl.compose([other, slow.at(p="1/2")])
    assert not valued.parameters
    assert [one.name for one in valued.family.parameters] == ["p"]
    assert (dense(valued.at(p="2/5")) == dense(stl.compose([other, slow.at(p="2/5")]))).all()
    assert stl.compose([slow.at(p="1/2"), slow.at(p="1/2")]).family is None
    assert stl.compose([stl.load_model(FACTORY / "floor-5x5.toml"), other]).family is None


@pytest.mark.parametrize("part", ["states", "choices", "transitions"])
def test_costs_are_those_of_the_members(part):
    """Each entry of the joint rows costs what the member's entry costs."""
    rng = np.random.default_rng(5)
    models = []
    for shape in ((2, 2), (3, 1)):
        size = {"states": shape[:1], "choices": shape, "transitions": (shape[1], shape[0], shape[0])}[part]
        amounts = rng.integers(0, 9, size)
        base = random_model(rng, 6, *shape)
        models.append((amounts, stl.MDP.from_arrays(dense(base), {}, costs={"energy": amounts})))
    joint = stl.compose([model for _, model in models])
    assert set(joint.costs) == {"r1.energy", "r2.energy"}
    assert joint.source.on_demand == (part != "transitions")
    for i, (amounts, _) in enumerate(models, start=1):
        found = joint.costs[f"r{i}.energy"]
        for s, own in enumerate(itertools.product(range(2), range(3))):
            if part == "states":
                assert found.states.values[s] == amounts[own[i - 1]]
            for c in range(joint.choice_start[s], joint.choice_start[s + 1]):
                action = divmod(int(joint.choice_action[c]), 1)[i - 1]  # of 2 · 1 actions
                if part == "choices":
                    assert found.choices.values[c] == amounts[own[i - 1], action]
                for k in range(joint.row_start[c], joint.row_start[c + 1]) if part == "transitions" else ():
                    target = divmod(int(joint.target[k]), 3)[i - 1]
                    assert found.transitions.values[k] == amounts[action, own[i - 1], target]


def test_compositions_are_composed():
    rng = np.random.default_rng(1)
    a, b, c = (partial(rng, 2, 2, 6) for _ in range(3))
    nested = stl.compose(
        {"team": stl.compose({"a": a, "b": b}, {"both": "a.A & b.A"}), "c": c}, {"all": "team.both & c.A"}
    )
    flat = stl.compose({"a": a, "b": b, "c": c}, {"all": "a.A & b.A & c.A"})
    assert (dense(nested) == dense(flat)).all()
    assert nested.labels["all"].tolist() == flat.labels["all"].tolist()
    assert set(nested.signals) == {"team.a.x", "team.b.x", "c.x"}
    assert nested.state_name(0) == "team=[a=0 b=0] c=0"


def test_runs_policies_and_reports(tmp_path):
    floor = stl.load_model(FACTORY / "floor-5x5.toml")
    joint = stl.compose([floor, floor.starting_in("(3,1)")], MEET)
    product = stl.build_product(joint, stl.parse("F[0,5] (r1.A & r2.A) & G[0,5] !meet"))
    best = stl.check(product)
    run = stl.learn(product, "cfer", episodes=20, seed=0)
    best.policy.save(tmp_path / "p.npz")
    again = stl.check(product, stl.load_policy(tmp_path / "p.npz", product))
    assert again.probability == best.probability
    stl.report([best], run, tmp_path / "r.html")
    page, data = (tmp_path / "r.html").read_text(), load_report(tmp_path / "r.json")
    assert [floor["member"] for floor in data["floors"]] == ["r1", "r2"]
    for floor, states in zip(
        data["floors"], zip(*[divmod(s, 18) for s in data["run"]["states"]], strict=True), strict=True
    ):
        assert [s // floor["stride"] % 18 for s in data["run"]["states"]] == list(states)
    for member in ("r1", "r2"):
        assert f'<p class="note">{member}</p>' in page
    assert "r1.E+r2.N" in page
    made = stl.sample_run(product, best.policy, seed=1)
    assert all(": " not in name and name.startswith("r1.") for name in made.actions)
    assert stl.estimate(product, best.policy, runs=20).runs == 20


def test_starting_elsewhere():
    model = random_model(np.random.default_rng(0), 6)
    assert model.starting_in(2).initial.tolist() == [0, 0, 1]
    assert model.starting_in(["1/3", "2/3", 0]).initial_share(1) == Fraction(2, 3)
    with pytest.raises(ModelError, match="the initial state 3 is not one of 0 … 2"):
        model.starting_in(3)
    with pytest.raises(ModelError, match="the initial distribution sums to"):
        model.starting_in(["1/3", "1/3", 0])


@pytest.mark.parametrize(
    ("labels", "error", "says"),
    [
        ({"m": "F[0,2] r1.A"}, FragmentError, "label m: F.* is about several steps; a label is a formula without"),
        ({"m": "r1.x[t-1] > 0"}, FragmentError, "is about several steps"),
        ({"m": "r1.Q"}, NameLookupError, r"m, line 1, column 1: there is no label r1.Q; did you mean r1.x or r1.B"),
        ({"m": "r1.A > 1"}, NameLookupError, "there is no signal r1.A; it is a label; use it without comparing"),
        ({"m": "r1.x"}, StlToolError, "r1.x"),
        ({"m": "r1.x >"}, StlSyntaxError, "m, line 1, column 7"),
        ({"m": "1 / r1.x > 1"}, TraceError, "label m: state 0: "),
        ({"r1.A": "r2.A"}, ModelError, "label r1.A: the composition has a name r1.A already; choose another"),
        ({"": "r2.A"}, ModelError, "cannot be a label's name"),
        ({"m": 3}, ArgumentError, "label m is 3, not a Formula; write one"),
    ],
)
def test_labels_that_are_none(labels, error, says):
    model = random_model(np.random.default_rng(0), 6)
    with pytest.raises(error, match=says):
        stl.compose([model, model], labels)


def test_what_cannot_be_composed():
    model = random_model(np.random.default_rng(0), 6)
    uncertain = stl.load_model(FACTORY / "floor-5x5-uncertain.toml")
    with pytest.raises(ModelError, match=r"the probabilities of member r2 are intervals; .*: r2.nominal\(\) in Python"):
        stl.compose([model, uncertain])
    assert stl.compose([model, uncertain.nominal()]).n_states == 3 * uncertain.n_states
    box = stl.MDP.black_box(2, 1, lambda rng: None, labels={"A": [0, 1]})
    with pytest.raises(ModelError, match="member box is a black box"):
        stl.compose({"box": box})
    with pytest.raises(ModelError, match="there is no model to compose"):
        stl.compose([])
    with pytest.raises(ArgumentError, match="one of compose's models are 'floor.toml', not an MDP; load it"):
        stl.compose(["floor.toml"])
    odd = stl.MDP.from_arrays([[[1]], [[1]]], {}, action_names=["a", "a+r2.a"])
    with pytest.raises(ModelError, match=r"two joint actions are called 'r1.a\+r2.a\+r2.a'"):
        stl.compose([odd, odd])
    for prefix in ("r 1", "", "1r", "a.b"):
        with pytest.raises(ModelError, match="a member's name begins its signals' names"):
            stl.compose({prefix: model})


def test_sizes_are_told_before_memory_is_taken():
    floor = stl.load_model(FACTORY / "floor-10x10.toml")
    with pytest.raises(SizeError, match=r"1934917632 states \(72 · 72 · 72 · 72 · 72\) with 59049 actions would take"):
        stl.compose([floor] * 5)
    with pytest.raises(SizeError, match=r"139314069504 states \(72 · .*\) are more than can be numbered"):
        stl.compose([floor] * 6)
    one = stl.MDP.from_arrays(np.ones((40, 1, 1)), {})
    with pytest.raises(SizeError, match="joint actions"):
        stl.compose([one] * 10)
    with pytest.raises(SizeError, match="compose at most 32"):
        stl.compose([stl.MDP.from_arrays([[[1]]], {})] * 33)
    many_doubles = stl.MDP.from_arrays(np.full((1, 1001, 1001), 1 / 1001), {})
    with pytest.raises(SizeError, match="the 1002001 probabilities of r1 are doubles, too many"):
        stl.compose([many_doubles])


# ---------------------------------------------------------------------------------------------------------------- files


def write(folder, **files):
    for name, text in files.items():
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")


def team(folder, text):
    head = "" if text.startswith("kind") else 'kind = "composition"\n'
    write(folder, floor=FLOOR, bad="x = 1\n", team=head + text)
    return folder / "team.toml"


def test_a_file_names_its_members_relative_to_itself(tmp_path, monkeypatch):
    (tmp_path / "sub").mkdir()
    write(tmp_path, floor=FLOOR)
    write(tmp_path / "sub", team=TEAM.replace("floor.toml", "../floor.toml") + '[labels]\nmeet = "r1.x == r2.x"\n')
    monkeypatch.chdir(tmp_path.parent)
    model = stl.load_model(tmp_path / "sub" / "team.toml")
    floor = stl.load_model(tmp_path / "floor.toml")
    assert (dense(model) == dense(stl.compose([floor, floor]))).all()
    assert model.name == "team"
    assert model.initial_text() == "r1=(0,0) r2=(1,1)"
    assert model.labels["meet"].tolist() == (model.signals["r1.x"] == model.signals["r2.x"]).tolist()
    assert [path.resolve() for path in companions(tmp_path / "sub" / "team.toml")] == [tmp_path / "floor.toml"]


def test_members_start_elsewhere_and_get_values(tmp_path):
    noisy = FLOOR.replace('"93/100"', '"p"').replace('"7/300"', '"(1-p)/3"') + "[parameters]\np = [0.5, 1]\n"
    write(tmp_path, floor=noisy, team=TEAM.replace("start = [1, 1]", 'start = "(0,1)", parameters = { p = 0.9 }'))
    model = stl.load_model(tmp_path / "team.toml")
    assert model.initial_text() == "r1=(0,0) r2=(0,1)"
    assert [one.name for one in model.parameters] == ["p"]
    floor = stl.load_model(tmp_path / "floor.toml")
    assert (dense(model.at(p=0.8)) == dense(stl.compose([floor.at(p=0.8), floor.at(p=0.9)]))).all()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('kind = "composition"\n', r"no members; write \[members\] and below it r1 = \"floor.toml\""),
        ('kind = "composition"\nmembers = 3\n', "line 2: members is 3; write"),
        ("[members]\nr1 = 3\n", "line 3: member r1 is 3; write the path of its model"),
        ("[members]\nr1 = { model = 3 }\n", "line 3: member r1 is .*; write the path of its model"),
        ('[members]\nr1 = "none.toml"\n', "line 3: member r1: .*none.toml: there is no such model file"),
        ('[members]\nr1 = "."\n', "line 3: member r1: "),
        (f'[members]\nr1 = "{"a" * 300}.toml"\n', "line 3: member r1: .*a.toml"),
        (f'[members]\nr1 = "{"a" * 300}.x"\n', "line 3: member r1: .*a.x: there is no such model file"),
        ('[members]\nr1 = "a\\u0000b"\n', "line 3: member r1 is "),
        ('[members]\nr1 = { model = "floor.toml", strat = 1 }\n', "member r1: unknown key strat; did you mean start"),
        ('[members]\nr1 = { model = "floor.toml", start = [1, 0] }\n', r"start = \[1, 0\] is blocked or off the map"),
        ('[members]\nr1 = { model = "floor.toml", start = [1, 99999999999999999999] }\n', "is blocked or off the map"),
        ('[members]\nr1 = { model = "floor.toml", start = [1] }\n', r"write start = \[column, row\]"),
        ('[members]\nr1 = { model = "floor.toml", start = 1.5 }\n', "start is 1.5; write the name of a state"),
        ('[members]\nr1 = { model = "floor.toml", start = "(9,9)" }\n', r"there is no initial state '\(9,9\)'"),
        ('[members]\nr1 = { model = "floor.toml", parameters = { p = 1 } }\n', "the model has no parameter p"),
        ('[members]\nr1 = { model = "floor.toml", parameters = 1 }\n', "parameters is 1; write"),
        ('[members]\nr1 = { model = "team.toml", start = [0, 0] }\n', "team.toml → team.toml: a composition cannot be"),
        ('[members]\n"r 1" = "floor.toml"\n', "line 2: member 'r 1': a member's name begins"),
        ('[members]\nr1 = "floor.toml"\n[labels]\nmeet = 3\n', 'line 5: label meet is 3; write a formula in quotes'),
        ('[members]\nr1 = "floor.toml"\n[labels]\nmeet = "r2.x > 0"\n', "line 5: meet, line 1, column 1: there is no"),
        ('[members]\nr1 = "floor.toml"\n[labels]\n"r1.A" = "r1.A"\n', "the composition has a name r1.A already"),
        ('[members]\nr1 = "floor.toml"\n[lables]\nmeet = "true"\n', "line 4: unknown key lables; did you mean labels"),
        ('labels = 3\n[members]\nr1 = "floor.toml"\n', r"line 2: labels is 3; write \[labels\]"),
        ('name = 3\n[members]\nr1 = "floor.toml"\n', "line 2: name is 3; write a text"),
        ('[members]\nr1 = "bad.toml"\n', "line 3: member r1: .*bad.toml: kind is None; write kind"),
    ],
)  # fmt: skip
def test_faults_are_told_with_their_lines(text, says, tmp_path):
    with pytest.raises(ModelError, match=says) as caught:
        stl.load_model(team(tmp_path, text))
    assert str(caught.value).startswith(str(tmp_path / "team.toml"))


def test_circles_of_files_are_refused(tmp_path):
    for name, other in (("a", "b"), ("b", "c"), ("c", "a")):
        write(tmp_path, **{name: f'kind = "composition"\n[members]\nr = "{other}.toml"\n'})
    with pytest.raises(ModelError, match=r"a.toml → b.toml → c.toml → a.toml: a composition cannot be its own member"):
        stl.load_model(tmp_path / "a.toml")
    assert {path.name for path in companions(tmp_path / "a.toml")} == {"b.toml", "c.toml"}
    (tmp_path / "loop.toml").symlink_to(tmp_path / "loop.toml")
    write(tmp_path, a='kind = "composition"\n[members]\nr = "loop.toml"\n')
    with pytest.raises(ModelError, match=r"member r: .*loop.toml"):
        stl.load_model(tmp_path / "a.toml")


def test_files_that_double_at_every_level_are_read_once_and_refused(tmp_path):
    write(tmp_path, f0='kind = "grid"\nmap = "S"\n')
    for k in range(1, 30):
        write(tmp_path, **{f"f{k}": f'kind = "composition"\n[members]\na = "f{k - 1}.toml"\nb = "f{k - 1}.toml"\n'})
    with pytest.raises(SizeError, match="joint actions"):
        stl.load_model(tmp_path / "f9.toml")
    with pytest.raises(StlToolError, match="compositions of compositions, 10 levels and more"):
        stl.load_model(tmp_path / "f29.toml")
    write(tmp_path, f0="kind = 3")
    with pytest.raises(ModelError, match="kind is 3") as caught:
        stl.load_model(tmp_path / "f9.toml")
    assert str(caught.value).count("its faults are told above") == 9
    assert len(str(caught.value)) < 5000
    assert len(companions(tmp_path / "f29.toml")) == 29


@pytest.mark.soak(only=True)
def test_companions_of_many_members_are_found_in_linear_time(tmp_path):
    """Twenty files, each with a thousand lines that name the next one: 10^60 ways."""
    for k in range(20):
        lines = "".join(f'm{i} = "f{k + 1}.toml"\n' for i in range(1000))
        write(tmp_path, **{f"f{k}": f'kind = "composition"\n[members]\n{lines}'})
    write(tmp_path, f20='kind = "grid"\nmap = "S"\n')
    assert len(companions(tmp_path / "f0.toml")) == 20
