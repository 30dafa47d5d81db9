"""The two rows of the paper's story beside its learning curves, for its twelve scenarios.

surrogate  P of the surrogate's optimal policies against P*                                     docs/surrogate.md
encodings  what flags, exact automaton and histories take; P* once more on the histories that fit
memory     what the size costs a learner: exact P by episodes and seconds a run, on flags and on histories, with one
           entry of Q updated a step (naive) or every entry that the transition speaks for (cfer)

    python bench/story.py [surrogate] [encodings] [memory]
"""

from __future__ import annotations

import sys
from pathlib import Path
from statistics import median

import stltool as stl
from stltool import kernels
from stltool.checking.encodings import compare_encodings
from stltool.reporting import encoding_data, encoding_rows, surrogate_data, surrogate_rows

FACTORY = Path(__file__).resolve().parent.parent / "examples" / "factory"
SCENARIOS = {
    **{f"R{i}": ("reaching", n, 10, tau) for i, (n, tau) in enumerate([(5, 5), (5, 10), (10, 5), (10, 10)], start=1)},
    **{f"C{i}": ("charging", n, 10, tau) for i, (n, tau) in enumerate([(5, 5), (5, 10), (10, 5), (10, 10)], start=1)},
    **{f"P{i}": ("patrolling", n, T, T) for i, (n, T) in enumerate([(5, 10), (5, 15), (10, 10), (10, 15)], start=1)},
}
SEEDS = range(10)
LEARNERS = {"naive": {"episodes": 12000, "decay": 3000}, "cfer": {"episodes": 400}}  # on a task with two starts


def product(name: str, n: int, T: int, tau: int, encoding: str = "exact") -> stl.Product:
    task = stl.load_task(FACTORY / f"{name}.stl", params={"T": T, "tau": tau})
    return stl.build_product(stl.load_model(FACTORY / f"floor-{n}x{n}.toml"), task, encoding)


def surrogate_table() -> list[str]:
    scenarios = {}
    for name, scenario in SCENARIOS.items():
        own = product(*scenario)
        results = (stl.surrogate_optimum(own, reading) for reading in ("discounted", "episode"))
        scenarios[name] = [surrogate_data(result) for result in results]
    return markdown(surrogate_rows(scenarios))


def encoding_table() -> list[str]:
    found = {name: compare_encodings(product(*scenario)) for name, scenario in SCENARIOS.items()}
    return markdown(encoding_rows({name: encoding_data(encodings) for name, encodings in found.items()}))


def memory_table() -> list[str]:
    """Both learners corrected; the same updates and exploration, only what is remembered differs."""
    rows, seconds = [], []
    for method, settings in LEARNERS.items():
        for encoding, memory in (("paper", "flags"), ("history", "histories of letters")):
            own = product("patrolling", 5, 2, 7, encoding)
            quarter = settings["episodes"] // 4
            runs = [stl.learn(own, method, seed=seed, evaluate_every=quarter, **settings) for seed in SEEDS]
            row = {"method": method, "memory": memory, "automaton states": str(own.automaton.n_states)}
            for i in range(4):
                episode = runs[0].history[i].episode
                row[f"quarter {i + 1}"] = f"{median(r.history[i].probability for r in runs):.4f} @ {episode}"
            seconds.append(median(r.seconds for r in runs))
            row["seconds a run"] = f"{seconds[-1]:.2g}"
            row["P*"] = f"{stl.check(own).probability:.4f}"
            rows.append(row)
    return [
        *markdown(rows),
        "",
        f"histories take {seconds[3] / seconds[2]:.1f} times the computing time of flags (cfer)",
    ]


def markdown(rows: list[dict[str, str]]) -> list[str]:
    lines = [" | ".join(rows[0]).join(("| ", " |")).replace("|Σ|", "\\|Σ\\|"), "|---" * len(rows[0]) + "|"]
    return lines + [" | ".join(row.values()).join(("| ", " |")) for row in rows]


TABLES = {"surrogate": surrogate_table, "encodings": encoding_table, "memory": memory_table}

if __name__ == "__main__":
    kernels.warm_up("published", "clocked")
    for title in sys.argv[1:] or TABLES:
        print(f"\n{title.capitalize()}\n", *TABLES[title](), sep="\n", flush=True)
