"""Models whose probabilities nobody knows: what answers for them, what refuses, and that nothing is looked up."""

import inspect

import numpy as np
import pytest

import stltool as stl
from stltool.checking import require_certificate_of
from stltool.errors import ModelError, PolicyError, SettingsError
from stltool.models.environment import Environment, cumulated, simulator


def hidden(model, **changes):
    """The same states, actions, labels and signals; the probabilities only within an environment."""
    has = np.zeros((model.n_states, model.n_actions), dtype=bool)
    has[np.repeat(np.arange(model.n_states), np.diff(model.choice_start)), model.choice_action] = True
    options = {
        "environment": lambda rng: simulator(model, rng),
        "signals": model.signals,
        "labels": model.labels,
        "available": has,
        "state_names": [model.state_name(s) for s in range(model.n_states)],
        "name": "hidden",
    }
    return stl.MDP.black_box(model.n_states, model.action_names, **{**options, **changes})


@pytest.fixture
def known(floor5):
    return stl.build_product(floor5, stl.parse("F[0,6] (A & F[0,3] x < 0.5)"))


@pytest.fixture
def unknown(known):
    return stl.build_product(hidden(known.model), known.formula)


def test_a_black_box_is_learned_as_its_model_is(known, unknown):
    """The same random numbers, the same steps: to the bit, for every method."""
    assert simulator(unknown.model, np.random.default_rng(0)).tables is None
    for method in ("cfer", "naive", "naive-er", "model-based"):
        seen, blind = (stl.learn(product, method, episodes=30, seed=1) for product in (known, unknown))
        assert (seen.policy.table == blind.policy.table).all()
        assert [point.steps for point in seen.history] == [point.steps for point in blind.history]
        assert {point.probability for point in blind.history} == {None}
    assert (unknown.automaton.digest(), unknown.shape) == (known.automaton.digest(), known.shape)


def test_as_published_too(floor5):
    product = stl.build_product(hidden(floor5), stl.parse("G[0,5) F[0,5) A"))
    run = stl.learn(product, "cfer", faithful=True, episodes=5)
    assert stl.estimate(product, run.policy, runs=20).runs == 20


def test_estimates_contain_the_exact_probability(known, unknown):
    learned = stl.learn(unknown, episodes=60, seed=1).policy.table
    policy = stl.Policy(unknown, 0.8 * (learned[..., None] == np.arange(9)) + 0.2 / 9)  # now and then, any move
    exact = stl.check(known, stl.Policy(known, policy.table)).probability
    assert 0.1 < exact < 0.99
    found = stl.estimate(unknown, policy, runs=1500, seed=1)
    assert found.lower <= exact <= found.upper
    assert stl.estimate(unknown, policy, runs=1500, seed=1).satisfied == found.satisfied
    assert stl.sprt(unknown, policy, 0.05, seed=1).verdict == "holds"


def test_what_was_seen_while_learning_bounds_it_too(known, unknown):
    run = stl.learn(unknown, "model-based", episodes=600, seed=1)
    start = int(known.model.initial.argmax())
    bound = stl.guarantee(unknown, run.policy, run.counts, start=start)
    judged = stl.check(known, stl.Policy(known, run.policy.table))
    assert 0.3 < bound.lower <= judged.upper
    with pytest.raises(SettingsError, match="hidden is a black box, whose possible successors are not known"):
        stl.optimality_gap(unknown, run.policy, run.counts, start=start)
    model = known.model

    def successors(s, a):
        c = s * model.n_actions + a  # every state has every action
        return model.target[model.row_start[c] : model.row_start[c + 1]]

    gap = stl.optimality_gap(unknown, run.policy, run.counts, start=start, successors=successors)
    assert stl.check(known).lower - judged.upper <= gap.upper < 1
    with pytest.raises(SettingsError, match="hidden does not say where runs start"):
        stl.guarantee(unknown, run.policy, run.counts)
    with pytest.raises(SettingsError, match="the model does not say where this leads; use support='unknown'"):
        stl.guarantee(unknown, run.policy, run.counts, start=start, support="known")


def test_fresh_runs_share_no_random_number_with_the_training(known):
    """The same seed everywhere, and yet other generators than the training's and the known model's runs'."""
    begun = []

    def environment(rng):
        begun.append(rng.bit_generator.state["state"]["state"])
        return simulator(known.model, rng)

    product = stl.build_product(hidden(known.model, environment=environment), known.formula)
    policy = stl.learn(product, episodes=1, seed=7).policy
    stl.estimate(product, policy, runs=1, seed=7)
    stl.estimate(product, policy, runs=1, seed=7)
    children = [np.random.default_rng(s).bit_generator.state for s in np.random.SeedSequence(7).spawn(50)]
    assert begun[0] == children[0]["state"]["state"]
    assert begun[1] == begun[2]
    assert begun[1] not in {state["state"]["state"] for state in children}


def test_sampled_runs_are_the_models(known, unknown):
    policy = stl.learn(unknown, episodes=60, seed=1).policy
    for seed in range(5):
        seen = stl.sample_run(known, stl.Policy(known, policy.table), seed=seed)
        assert stl.sample_run(unknown, policy, seed=seed) == seen


def test_policies_are_saved_and_belong_to_their_black_box(known, unknown, tmp_path):
    policy = stl.learn(unknown, episodes=20).policy
    policy.save(tmp_path / "p.npz")
    loaded = stl.load_policy(tmp_path / "p.npz", stl.build_product(hidden(known.model), known.formula))
    assert (loaded.table == policy.table).all()
    for other in (
        known,
        stl.build_product(
            hidden(known.model, labels=known.model.labels | {"D": known.model.labels["A"]}), known.formula
        ),
    ):
        with pytest.raises(PolicyError, match="is for the model hidden .*, not for"):
            stl.load_policy(tmp_path / "p.npz", other)


def test_what_needs_probabilities_refuses_black_boxes(known, unknown, tmp_path):
    model = unknown.model
    policy = stl.Policy(unknown, np.zeros(unknown.shape, dtype=int))
    joint = stl.build_joint_product(model, {"one": stl.parse("F[0,3] A"), "two": stl.parse("F[0,3] B")})
    stl.write_certificate(stl.check(known), tmp_path / "proof.jsonl")
    for ask in (
        lambda: stl.check(unknown),
        lambda: stl.check(unknown, policy),
        lambda: stl.check(unknown, engine="nodes"),
        lambda: stl.check(unknown, exact=True),
        lambda: stl.robust_check(unknown),
        lambda: model.matrix(),
        lambda: model.exact(),
        lambda: model.nominal().require_points(),
        lambda: stl.likely_runs(unknown, policy),
        lambda: stl.sensitivity(unknown, policy),
        lambda: stl.policy_tree(unknown, policy),
        lambda: stl.pareto(joint),
        lambda: stl.tradeoff(joint, "one"),
        lambda: stl.stationary(unknown),
        lambda: stl.parametric(unknown),
        lambda: stl.expected_cost(unknown, "x"),
        lambda: stl.long_run(unknown),
        lambda: stl.cost_distribution(unknown, "x", 3),
        lambda: stl.robustness_distribution(unknown.model, unknown.formula),
        lambda: stl.time_distribution(unknown.model, unknown.formula, 1),
        lambda: stl.largest_margin(unknown.model, unknown.formula, 0.5),
        lambda: stl.shield(unknown, at_least=0.5),
        lambda: stl.counterfactual(unknown, ([0, 0], ["0"]), policy=policy),
        lambda: stl.save_model(unknown.model, tmp_path / "saved.umb"),
        lambda: stl.product_mdp(unknown),
        lambda: stl.export(unknown, tmp_path / "product.prism"),
        lambda: stl.frontier(unknown.model, stl.parse_task("param n = 1\nr := F[0,n] B"), 0.5, {"n": [1]}),
        lambda: stl.surrogate_optimum(stl.build_product(model, stl.parse("F[0,3] F[0,2] A"), encoding="paper")),
        lambda: require_certificate_of(tmp_path / "proof.jsonl", unknown),
    ):
        with pytest.raises(
            SettingsError, match="of hidden are unknown: it is a black box; use stl.learn and stl.estim"
        ):
            ask()
    with pytest.raises(SettingsError, match="stop_gap needs the exact optimum, and the model is a black box"):
        stl.learn(unknown, stop_gap=0.01)


def test_every_public_function_on_products_knows_of_black_boxes():
    """A function that is new here must answer for black boxes or refuse them, with a line in the tests above."""
    refusing = {"check", "robust_check", "likely_runs", "sensitivity", "pareto", "tradeoff", "surrogate_optimum",
                "stationary", "parametric", "policy_tree", "expected_cost", "long_run", "frontier",
                "robustness_distribution",
                "largest_margin", "shield", "counterfactual", "cost_distribution", "time_distribution", "save_model",
                "product_mdp", "export"}  # fmt: skip
    fit = {"learn", "guarantee", "estimate", "sprt", "sample_run", "build_product", "build_joint_product",
           "to_gymnasium", "explain", "report", "optimality_gap"}  # fmt: skip
    found = {name: getattr(stl, name) for name in stl.__all__ if inspect.isfunction(getattr(stl, name))}
    models = {"product", "model", "joint"}
    asks = {name for name, ask in found.items() if models & set(inspect.signature(ask).parameters)}
    assert asks - {"load_policy", "certify"} == refusing | fit


def test_an_environment_of_black_boxes(unknown, known):
    seen, blind = (stl.to_gymnasium(product.model) for product in (known, unknown))
    for env in (seen, blind):
        env.reset(seed=3)
    assert [seen.step(a)[0] for a in range(9)] == [blind.step(a)[0] for a in range(9)]


def test_states_that_lack_actions_count_their_own():
    taken = []

    class Robot:
        def reset(self):
            return 0

        def step(self, i):
            taken.append(i)
            return 1

    model = stl.MDP.black_box(
        2, ["stay", "go"], lambda rng: Robot(), available=[[False, True], [True, True]], labels={"B": [0, 1]}
    )
    assert (model.n_choices, model.place(0)) == (3, "state 0, action go")
    product = stl.build_product(model, stl.parse("F[0,1] B"))
    run = stl.sample_run(product, stl.Policy(product, np.zeros(product.shape, dtype=int)), seed=0)
    assert (run.actions, run.satisfied, taken) == (("go",), True, [0])
    with pytest.raises(SettingsError, match="the environment's random numbers are known"):
        stl.learn(product, episodes=1, checkpoint="never.npz")


@pytest.mark.parametrize("wrong", [2, -1, 1.0, None, "1"])
def test_environments_that_return_no_state(wrong, known):
    def product_of(reset, step):
        model = stl.MDP.black_box(
            2, 1, lambda rng: Environment(lambda: reset, lambda i: step, rng), labels={"B": [0, 1]}
        )
        return stl.build_product(model, stl.parse("F[0,1] B"))

    for product, call in ((product_of(wrong, 0), r"reset\(\)"), (product_of(0, wrong), r"step\(0\)")):
        policy = stl.Policy(product, np.zeros(product.shape, dtype=int))
        for ask in (
            lambda p=product: stl.learn(p, episodes=1),
            lambda p=product, policy=policy: stl.estimate(p, policy, runs=1),
            lambda p=product, policy=policy: stl.sample_run(p, policy, seed=0),
        ):
            with pytest.raises(ModelError, match=f"{call}.* returned .*, which is not a state of"):
                ask()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"n_states": 0}, "n_states is 0; it must be an integer from 1"),
        ({"n_states": 2.0}, "n_states is 2.0"),
        ({"actions": 0}, "the model has no action"),
        ({"actions": ["a", "a"]}, "action names repeat"),
        ({"environment": None}, "environment is None; give a function"),
        ({"available": [[True]]}, r"available has shape \(1, 1\), not \(2, 2\)"),
        ({"available": [[True, True], [False, False]]}, "state 1 has no action"),
        ({"labels": {"A": [True]}}, r"A has shape \(1,\)"),
        ({"signals": {"x": [0, np.nan]}}, "signal x is nan in state 1"),
        ({"state_names": ["one"]}, "1 state names for 2 states"),
    ],
)
def test_black_boxes_that_are_none_are_refused(changes, says):
    options = {"n_states": 2, "actions": 2, "environment": lambda rng: None} | changes
    with pytest.raises((ModelError, SettingsError), match=says):
        stl.MDP.black_box(options.pop("n_states"), options.pop("actions"), options.pop("environment"), **options)


def test_a_black_box_has_no_rows(floor5):
    from dataclasses import replace

    with pytest.raises(ModelError, match="a black box has no rows"):
        replace(floor5, blackbox=lambda rng, steps: None)
    model = hidden(floor5)
    assert (model.n_transitions, len(model.row_start), model.n_choices) == (0, floor5.n_choices + 1, floor5.n_choices)
    assert len(cumulated(floor5)) > 0
    assert model.digest() == hidden(floor5).digest() != floor5.digest()
    assert model.digest() != hidden(floor5, signals={}).digest()
