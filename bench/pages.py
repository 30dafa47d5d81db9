"""Figures of README and docs/ that no other program of bench/ measures: `python bench/pages.py NAME [EPISODES]`.

scenarios   the table of docs/reproduction.md, from examples/paper/table.toml
sweep       README and docs/sweeps.md: what a finished sweep in out/table took, and how its seeds differ
guarantees  the table of docs/guarantees.md: bounds from learning data and from fresh runs, up to EPISODES
tied        the second one there: bounds if one parameter governs all rows
alarm       the third one there: after how many steps a wrong tie is refused
robust      docs/robust.md: a robust check beside an ordinary one
tradeoff    docs/tradeoffs.md: a linear programme of a large task
why         docs/why.md: the most probable runs and the derivatives of a long shift
spread      docs/testing.md: at which steps the violations begin that Hypothesis draws
"""

from __future__ import annotations

import json
import math
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

import stltool as stl
from stltool import kernels
from stltool.automata import TRUE
from stltool.checking.induction import Doubles
from stltool.checking.unfold import Unfolding, flows
from stltool.learning.tied import Evidence
from stltool.models.environment import simulator

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
FACTORY, PAPER = EXAMPLES / "factory", EXAMPLES / "paper"
T = TypeVar("T")


def product(task: str, model: str = "floor-5x5", **params: int) -> stl.Product:
    return stl.build_product(stl.load_model(FACTORY / f"{model}.toml"), stl.load_task(FACTORY / task, params))


def fastest(action: Callable[[], object]) -> float:
    """Wall seconds: the first loads what is compiled."""
    return min(timed(action)[1] for _ in range(5))


def timed(action: Callable[[], T]) -> tuple[T, float]:
    """What an action returns, and its seconds; it has run once before, so that nothing is compiled."""
    action()
    start = time.perf_counter()
    return action(), time.perf_counter() - start


def guarantees(most: int = 100_000) -> None:
    print("| task | episodes | steps | support unknown | support known | fresh runs | exact P |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for task in ("patrolling", "reaching"):
        own = product(f"{task}.stl", T=5, tau=5)
        for episodes in (n for n in (100, 1000, 10_000, 100_000) if n <= most):
            run = stl.learn(own, "model-based", episodes=episodes, evaluate_every=episodes, seed=0)
            bounds = [
                stl.guarantee(own, run.policy, run.counts, confidence=0.99).lower,
                stl.guarantee(own, run.policy, run.counts, confidence=0.99, support="known").lower,
                stl.estimate(own, run.policy, runs=episodes, confidence=0.99, side="lower", seed=0).lower,
                stl.check(own, run.policy).lower,
            ]
            cut = [f"{math.floor(bound * 10**4) / 10**4:.4f}" for bound in bounds]  # a bound is never rounded up
            print("|", " | ".join([task, spaced(episodes), spaced(run.environment_steps), *cut]), "|", flush=True)


def tied(most: int = 10_000) -> None:
    print("| T = τ | episodes | steps | support unknown | support known | tied | fresh runs | exact P |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for T, affordable in ((5, 10_000), (10, 1000)):
        own = product("patrolling.stl", T=T, tau=T)
        for episodes in (n for n in (100, 1000, 10_000) if n <= min(most, affordable)):
            run = stl.learn(own, "model-based", episodes=episodes, evaluate_every=episodes, seed=0)
            bounds = [
                *(stl.guarantee(own, run.policy, run.counts, **how).lower for how in
                  ({}, {"support": "known"}, {"parameters": "model"})),
                stl.estimate(own, run.policy, runs=episodes, side="lower", seed=0).lower,
                stl.check(own, run.policy).lower,
            ]  # fmt: skip
            cut = [f"{math.floor(bound * 10**4) / 10**4:.4f}" for bound in bounds]
            print("|", " | ".join([str(T), spaced(episodes), spaced(run.environment_steps), *cut]), "|", flush=True)


def alarm() -> None:
    """Uniform random moves on the 5 × 5 floor; one cell, (4,3), succeeds less often than the others."""
    floor, every, odd = stl.load_model(FACTORY / "floor-5x5.toml"), 250, 8
    rows = slice(*floor.row_start[floor.choice_start[odd : odd + 2]].tolist())
    print("| one cell succeeds with | runs | refused | after steps: least | median | greatest |")
    print("|---|---:|---:|---:|---:|---:|")
    for success, runs in (("0.5", 10), ("0.6", 10), ("0.8", 10), ("0.93", 20)):
        probability = floor.probability.copy()
        probability[rows] = floor.at(success=success).probability[rows]
        strange, steps = floor.with_rows(probability=probability, exact=None), []
        for seed in range(runs):
            rng = np.random.default_rng(seed)
            env, counts = simulator(strange, rng), stl.Counts(floor.n_choices, floor.n_states)
            state = env.reset()
            for n in range(every, 100_001, every):
                for i in rng.integers(9, size=every).tolist():
                    choice, state = int(floor.choice_start[state]) + i, env.step(i)
                    counts.add_one(choice, state, 0)
                if Evidence(floor.family, counts).against_the_tie[0] >= math.log(100):
                    steps.append(n)
                    break
        times = [spaced(min(steps)), spaced(round(float(np.median(steps)))), spaced(max(steps))] if steps else ["–"] * 3
        shown = success if success != "0.93" else "0.93, as all do"
        print(f"| {shown} | {runs} | {len(steps)} | {' | '.join(times)} |", flush=True)


def scenarios() -> None:
    """As docs/reproduction.md groups them: neighbours that differ in τ alone share a row."""
    sweep = tomllib.loads((PAPER / "table.toml").read_text(encoding="utf-8"))
    print("| scenario | cells | task | T | τ | decay | memory | batch | episodes |")
    print("|---|---|---|---|---|---|---|---|---|")
    rows: list[tuple[list[str], list[str], list[str]]] = []
    texts = {
        "reaching": "`F[0,T) F[0,τ) A`", "charging": "`F[0,T) G[0,τ) C`",
        "patrolling": "`G[0,T) (F[0,τ) A & F[0,τ) B)`",
    }  # fmt: skip
    said = None
    for scenario in sweep["scenario"]:
        settings = {**sweep["sweep"]["settings"], **scenario.get("settings", {})}
        text = texts[Path(scenario["task"]).stem]
        cells = Path(scenario["model"]).stem.removeprefix("floor-").replace("x", " × ")
        knobs = [str(settings[name]) for name in ("decay", "memory", "batch", "episodes")]
        T, tau = str(scenario["params"]["T"]), str(scenario["params"]["tau"])
        if rows and rows[-1][2] == [text, cells, T, *knobs]:
            rows[-1][0].append(scenario["id"])
            rows[-1][1].append(tau)
        else:
            rows.append(([scenario["id"]], [tau], [text, cells, T, *knobs]))
    for ids, taus, (text, cells, T, *knobs) in rows:
        shown, said = "the same" if text == said else text, text
        print("|", " | ".join([", ".join(ids), cells, shown, T, ", ".join(taus), *knobs]), "|")


def sweep() -> None:
    data = json.loads(Path("out/table/report.json").read_text(encoding="utf-8"))
    runs = [json.loads(path.read_text()) for path in Path("out/table/runs").glob("*/*/*.time.json")]
    print(f"{sum(run['seconds'] for run in runs) / 60:.1f} minutes of runs")
    (result,) = (r for r in data["results"] if (r["scenario"], r["method"]) == ("P1", "cfer"))
    print(f"P1, cfer: {result['least']:.3f} … {result['greatest']:.3f}, published {result['published']:.3f}")


def spaced(n: int) -> str:
    return f"{n:,}".replace(",", " ")


def robust() -> None:
    certain = (FACTORY / "floor-10x10.toml").read_text(encoding="utf-8")
    uncertain = certain.replace('success = "93/100"', "success = [0.9, 0.95]").replace(
        'slip = "7/300"', "slip = [0.01, 0.04]"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "floor.toml"
        path.write_text(uncertain, encoding="utf-8")
        model = stl.load_model(path)
    phi = stl.load_task(FACTORY / "patrolling.stl", {"T": 25, "tau": 25}).formula
    own, ordinary = stl.build_product(model, phi), stl.build_product(model.nominal(), phi)
    slow = fastest(lambda: stl.robust_check(own, keep_policy=False))
    fast = fastest(lambda: stl.check(ordinary, keep_policy=False))
    states = own.model.n_states * own.automaton.n_states
    print(f"{spaced(states)} product states, {own.horizon} steps: robust {slow:.3f} s, ordinary {fast:.3f} s")


def tradeoff() -> None:
    names = ("charging", "patrolling")
    tasks = [stl.load_task(FACTORY / "tradeoff.stl", {"T": 15, "tau": 12}, name) for name in names]
    joint = stl.build_joint_product(stl.load_model(tasks[0].model), tasks)
    start = time.perf_counter()
    result = stl.tradeoff(joint, "charging", at_least={"patrolling": 0.5})
    print(f"{result.size['variables']} variables, {time.perf_counter() - start:.0f} s")


def why() -> None:
    own = product("shift.stl", "floor-10x10", T=60, tau=20)
    best = stl.check(own).policy
    assert best is not None
    print(f"{own.shape[0]} × {own.shape[1]} product states, {own.horizon} steps")
    print(f"{own.n_states * own.horizon / 1e6:.1f} million (t, s, q)")
    for name, policy in (("optimal", best), ("uniform", stl.Policy(own, np.full((*own.shape, 9), 1 / 9)))):
        unfolded = Unfolding(own, policy, Doubles(True), TRUE, live=False)
        steps = flows(unfolded.layers, unfolded.stretches, unfolded.start)
        edges = sum(len(part.child) for _, part, _, _ in steps) / 1e6
        _, runs = timed(lambda policy=policy: stl.likely_runs(own, policy, count=1000))
        _, derivatives = timed(lambda policy=policy: stl.sensitivity(own, policy))
        places = spaced(unfolded.layers.size()[1])
        print(f"{name}: {places} places, {edges:.0f} million edges, runs {runs:.2f} s, derivatives {derivatives:.2f} s")
    satisfying = stl.likely_runs(own, best, satisfied=True, mass=0.9, most=10_000)
    print(f"10000 satisfying runs cover {satisfying.covered:.2f}")


def spread() -> None:
    from hypothesis import HealthCheck, Phase, given, seed, settings

    from stltool.testing import Trace, violating_traces

    phi, every = stl.parse("G[0,9] x < 5"), list(HealthCheck)
    found: list[int] = []

    @settings(max_examples=1000, database=None, phases=[Phase.generate], suppress_health_check=every)
    @given(violating_traces(phi, {"x": (0, 9)}))
    def collect(trace: Trace) -> None:
        found.append(int((trace["x"] >= 5).argmax()))

    counts = []
    for start in range(5):
        found.clear()
        seed(start)(collect)()
        counts += np.bincount(found, minlength=10).tolist()
    print(f"of 1000 traces at least {min(counts)} and at most {max(counts)} at a step")


if __name__ == "__main__":
    programs = {f.__name__: f for f in (alarm, guarantees, robust, scenarios, spread, sweep, tied, tradeoff, why)}
    if sys.argv[1] not in ("scenarios", "spread", "sweep"):
        kernels.warm_up("published", "clocked")
    programs[sys.argv[1]](*map(int, sys.argv[2:]))
