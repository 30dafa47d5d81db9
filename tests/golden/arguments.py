"""Refusals of the library's public functions: of every parameter something of another kind, and values out of range."""

import warnings
from pathlib import Path

import stltool as stl
from stltool import numbers
from stltool.errors import StlToolError
from tests import test_doors, test_numbers
from tests.checking import test_likely, test_statistical, test_surrogate, test_tradeoff
from tests.conftest import FACTORY
from tests.golden.capture import refusal, rows
from tests.learning import test_guarantee, test_learning
from tests.logic import test_semantics

KINDS = ("object", "text", "None", "negative int")  # the first that a parameter refuses is shown


def entries():
    yield from kinds()
    yield from values()
    yield from questions()
    yield from sizes()


def kinds():
    world = test_doors.World(Path())
    world.policy.save("policy.npz")
    stl.write_certificate(world.result, "certificate.jsonl")
    doors, seen = test_doors.doors(), set()
    for name in test_doors.CALLS:
        for parameter in test_doors.parameters(doors[name]):
            for kind in KINDS:
                given = {**test_doors.CALLS[name](world), parameter: world.kinds[kind] if kind != "object" else Other()}
                try:
                    doors[name](**given)
                except StlToolError as error:
                    if str(error) not in seen:
                        seen.add(str(error))
                        yield f"{name}, {parameter} = {described(kind)}", str(error)
                    break


def values():
    for value, _ in rows(test_numbers.test_what_is_wrong_is_told):
        yield f"number {numbers.described(value)}", refusal(numbers.exact, value)
    for text, signal, _ in rows(test_semantics.test_samples_that_cannot_be_judged):
        yield f"satisfies {text} on {signal}", refusal(stl.satisfies, stl.parse(text), signal)
    product, policy = test_statistical.coin(0.5)
    for options, _ in rows(test_statistical.test_settings_of_an_estimate_are_checked):
        yield f"estimate {options}", refusal(stl.estimate, product, policy, **options)
    for options, _ in rows(test_statistical.test_settings_of_a_sequential_test_are_checked):
        yield f"sprt {options}", refusal(stl.sprt, product, policy, **{"at_least": 0.5, **options})
    model = stl.load_model(FACTORY / "floor-5x5.toml")
    product = stl.build_product(model, stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5}))
    for options, _ in rows(test_likely.test_numbers_out_of_range):
        yield f"likely_runs {options}", refusal(stl.likely_runs, product, **options)
    for options, _ in rows(test_surrogate.test_impossible_settings_are_refused):
        yield f"surrogate_optimum {options}", refusal(stl.surrogate_optimum, product, **options)
    for options, _ in rows(test_learning.test_impossible_settings_are_refused):
        yield f"learn {options}", refusal(stl.learn, product, **options)
    counts = test_guarantee.Counts(model.n_choices, model.n_states)
    for options, _ in rows(test_guarantee.test_settings_out_of_range_are_refused):
        yield f"guarantee {options}", refusal(stl.guarantee, product, None, counts, **options)
    shift = stl.build_joint_product(model, [test_tradeoff.factory(name) for name in ("charging", "patrolling")])
    for options, *_ in rows(test_tradeoff.test_bad_arguments):
        yield f"tradeoff {options}", refusal(stl.tradeoff, shift, **{"objective": "charging", **options})
    for options in ({"points": 1}, {"tolerance": 0}):
        yield f"pareto {options}", refusal(stl.pareto, shift, **options)
    yield "pareto of one task", refusal(stl.pareto, stl.build_joint_product(model, [test_tradeoff.factory("charging")]))
    for tasks in ([], [stl.parse("F[0,3] A")], [test_tradeoff.factory("charging")] * 2):
        yield f"build_joint_product of {len(tasks)} tasks", refusal(stl.build_joint_product, model, tasks)
    for formula in ("F[0,2] D", "F[0,2] (A > 0)", "F[0,2] x"):
        yield f"build_product with {formula}", refusal(stl.build_product, model, stl.parse(formula))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        stl.build_product(model, stl.load_task(FACTORY / "patrolling.stl", params={"T": 3, "tau": 9}), "paper")
        stl.compile_automaton(stl.parse("G[0,5] (F[0,3] a & F[0,2] b)"), "paper")
    yield "warnings of the flags", "\n".join(str(warning.message) for warning in caught)


def questions():
    """Of models that a question is not about."""
    phi, two = stl.parse("F[0,3] A"), {"one": stl.parse("F[0,3] A"), "two": stl.parse("F[0,3] B")}
    floor = stl.load_model(FACTORY / "floor-5x5.toml")
    blurred = stl.load_model(FACTORY / "floor-5x5-uncertain.toml")
    hidden = stl.MDP.black_box(2, 1, lambda rng: None, labels={"A": [0, 1], "B": [1, 0]}, name="hidden")
    for what, model in (("intervals", blurred), ("a black box", hidden)):
        product, joint = stl.build_product(model, phi), stl.build_joint_product(model, two)
        yield f"check on {what}", refusal(stl.check, product)
        yield f"check exactly on {what}", refusal(stl.check, product, exact=True)
        yield f"likely_runs on {what}", refusal(stl.likely_runs, product)
        yield f"pareto on {what}", refusal(stl.pareto, joint)
        yield f"surrogate_optimum on {what}", refusal(stl.surrogate_optimum, product)
    yield "learn on intervals", refusal(stl.learn, stl.build_product(blurred, phi), episodes=1)
    yield "estimate on intervals", refusal(stl.estimate, stl.build_product(blurred, phi), runs=1)
    yield "estimate on a black box without a policy", refusal(stl.estimate, stl.build_product(hidden, phi), runs=1)
    yield "stop_gap on a black box", refusal(stl.learn, stl.build_product(hidden, phi), stop_gap=0.1)
    yield "robust_check without intervals", refusal(stl.robust_check, stl.build_product(floor, phi))
    robust = stl.build_product(blurred, phi)
    for options in ({"nature": "kind"}, {"engine": "cuda"}, {"memory_limit": 100}):
        yield f"robust_check {options}", refusal(stl.robust_check, robust, **options)
    product = stl.build_product(floor, stl.parse("F[0,3] A & G[0,3] !B"))
    patrolling = stl.build_product(floor, stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5}))
    policy = stl.check(patrolling).policy
    yield "policy of another task", refusal(stl.check, product, policy)
    yield "without flags", refusal(stl.surrogate_optimum, stl.build_product(floor, stl.parse("A U[0,3] B")))
    yield "the paper's encoding outside the fragment", refusal(stl.compile_automaton, stl.parse("A U[0,3] B"), "paper")
    for name, needs in (("one", 1.0), ("two", 0.999)):
        joint = stl.build_joint_product(floor, {"one": stl.parse("F[0,1] A"), "two": stl.parse("F[0,1] B")})
        yield f"tradeoff with P({name}) >= {needs}", refusal(stl.tradeoff, joint, "one", at_least={name: needs})


def sizes():
    """What would not fit."""
    floor = stl.load_model(FACTORY / "floor-5x5.toml")
    for text, encoding in (("G[0,5] F[0,10^12) A", "exact"), ("G[0,60) (F[0,60) A & F[0,60) B)", "history")):
        yield f"{text}, {encoding}", refusal(stl.compile_automaton, stl.parse(text), encoding)
    product = stl.build_product(floor, stl.load_task(FACTORY / "patrolling.stl", params={"T": 5, "tau": 5}))
    for limit in (100, -1, "much"):
        yield f"check with memory_limit={limit!r}", refusal(stl.check, product, memory_limit=limit)
    yield "check exactly with memory_limit=100", refusal(stl.check, product, exact=True, memory_limit=100)
    yield "learn with a large memory", refusal(stl.learn, product, "naive-er", memory=10**14)
    yield "an integer of another kind", refusal(stl.sample_run, product, seed=True)


class Other:
    """Of no kind that a parameter takes."""


def described(kind):
    return {"object": "another object", "text": "'text'", "negative int": "-1"}.get(kind, kind)
