"""A process for test_warm_up.py: after the warm-up, everything is done, and no kernel may be asked for other types."""

import numpy as np

import stltool as stl
from stltool import kernels
from stltool.kernels.cache import KernelCache
from stltool.models.environment import simulator
from tests.conftest import FACTORY

METHODS = [
    ("cfer", False), ("cfer", True), ("cfper", True), ("naive", False), ("naive", True), ("naive-er", False),
    ("naive-er", True), ("model-based", False),
]  # fmt: skip


class Watched:
    """Called with a question and its arguments: the answer, unless a kernel was compiled or loaded for it."""

    def __init__(self) -> None:
        self.loaded: list[str] = []
        load = KernelCache.load_overload

        def told(cache, sig, context):
            self.loaded.append(f"{cache._name}{sig}")
            return load(cache, sig, context)

        KernelCache.load_overload = told

    def __call__(self, question, *arguments, **options):
        result = question(*arguments, **options)
        assert not self.loaded, f"{question.__name__}, {options}: {self.loaded}"
        return result


def main():
    kernels.warm_up(learning=True, rollouts=True, intervals=True, exact=True)
    ask = Watched()
    floor = stl.load_model(FACTORY / "floor-5x5.toml")
    task = stl.load_task(FACTORY / "patrolling.stl", params={"T": 2, "tau": 2})
    product = stl.build_product(floor, task)
    best = ask(stl.check, product)
    for policy in (None, best.policy):
        for options in ({}, {"arithmetic": "double"}, {"exact": True}, {"maximize": False}):
            ask(stl.check, product, policy, **options)
    ask(stl.estimate, product, best.policy, epsilon=0.2)
    ask(stl.surrogate_optimum, product)
    ask(stl.sensitivity, product)

    unknown = stl.MDP.black_box(
        floor.n_states, floor.action_names, lambda rng: simulator(floor, rng, 3), signals=floor.signals,
        labels=floor.labels,
    )  # fmt: skip
    for model in (floor, unknown):
        here = stl.build_product(model, task)
        for method, faithful in METHODS:
            run = ask(stl.learn, here, method, faithful=faithful, episodes=2, seed=0)
            ask(stl.estimate, here, run.policy, epsilon=0.2)
            if model is floor:
                ask(stl.check, here, run.policy)
            if not faithful:
                ask(stl.guarantee, here, None, run.counts, start=0)

    joint = stl.build_joint_product(floor, {"a": stl.parse("F[0,2] A"), "b": stl.parse("F[0,2] B")})
    ask(stl.pareto, joint)
    lower, upper = [[[0.1, 0.2], [0.3, 0.4]]], [[[0.7, 0.9], [0.8, 0.9]]]
    model = stl.MDP.from_intervals(lower, upper, {}, labels={"A": [False, True]})
    uncertain = stl.build_product(model, stl.parse("F[0,3] A"))
    worst = ask(stl.robust_check, uncertain)
    for policy in (worst.policy, stl.Policy(uncertain, np.ones((*uncertain.shape, 1)))):
        ask(stl.robust_check, uncertain, policy)
    for encoding in ("paper", "history"):
        other = stl.build_product(floor, stl.parse("F[0,2] G[0,1] A"), encoding)
        policy = ask(stl.check, other).policy
        ask(stl.estimate, other, policy, epsilon=0.2)


if __name__ == "__main__":
    main()
    print("no other type was needed")
