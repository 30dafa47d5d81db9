"""Optimum and policy on growing floors: stltool, Storm, and an older stltool, side by side, results compared first.

open floor (n, τ)    n × n free cells, the nine king moves of [Wang24] with its noise, A the bottom-right block of
                     2k × 2k cells, B the top-left one, k = max(1, n // 5), start in the middle
tiled floor (n, τ)   the same with blocks of A and B all over, and values of every cell: nothing is far away
task                 G[0,τ) (F[0,τ) A & F[0,τ) B)

Storm gets the product as a PRISM program: a and b count down what is left to reach A and B; 1 − Pmin [F<=2τ−2 "bad"].
Ours is from text to optimum, enclosure and policy, Storm's from text to optimum: it keeps no policy of a bounded
property. CPU seconds of the fastest of some runs, each floor in a process of its own; memory is by what the process's
peak rises. `python bench/floors.py` prints the tables, and draws bench/scaling.svg: time and memory over product states
n² · τ², whose slopes are least squares through the points that both have.
"""

from __future__ import annotations

import argparse
import inspect
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from older import COMMIT, older_sources

OPEN = ((30, 15), (30, 40), (100, 15), (100, 31))
SCALING = ((10, 15), (15, 20), (20, 25), (25, 32), (30, 40))
LARGER = ((45, 45), (60, 50), (100, 60))  # ours alone
TILED = ((30, 25), (60, 25), (120, 25), (240, 25))
PICTURE = Path(__file__).parent / "scaling.svg"
MOVES = {
    "stay": (0, 0), "N": (0, 1), "S": (0, -1), "W": (-1, 0), "E": (1, 0),
    "NW": (-1, 1), "SW": (-1, -1), "NE": (1, 1), "SE": (1, -1),
}  # fmt: skip
CIRCLE = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")


def in_a(n: int, x: int, y: int) -> bool:
    k = max(1, n // 5)
    return x >= n - 2 * k and y < 2 * k


def in_b(n: int, x: int, y: int) -> bool:
    k = max(1, n // 5)
    return x < 2 * k and y >= n - 2 * k


def open_floor(n: int) -> str:
    """The model file."""
    rows = [
        "".join(
            "S" if (x, y) == (n // 2, n // 2) else "A" if in_a(n, x, y) else "B" if in_b(n, x, y) else "."
            for x in range(n)
        )
        for y in range(n - 1, -1, -1)
    ]
    return _file(rows)


def tiled_floor(n: int) -> str:
    def cell(x: int, y: int) -> str:
        return "A" if x % 15 < 2 and y % 15 < 2 else "B" if x % 15 in (8, 9) and y % 15 in (8, 9) else "."

    return "start = [0, 0]\n" + _file(["".join(cell(x, y) for x in range(n)) for y in range(n)])


def task(tau: int) -> str:
    return f"G[0,{tau}) (F[0,{tau}) A & F[0,{tau}) B)"


def _file(rows: list[str]) -> str:
    text = "\n".join(rows)
    return f'kind = "grid"\nmoves = "king"\nsuccess = "93/100"\nslip = "7/300"\nmap = """\n{text}\n"""\n'


def prism_program(n: int, tau: int) -> str:
    """The open floor's product, as a model checker reads it."""
    k = max(1, n // 5)
    lines = ["mdp"]
    for name, (dx, dy) in MOVES.items():
        free = f"(x+{dx}>=0 & x+{dx}<={n - 1} & y+{dy}>=0 & y+{dy}<={n - 1})"
        lines.append(f"formula x{name} = {free} ? x+{dx} : x;")
        lines.append(f"formula y{name} = {free} ? y+{dy} : y;")
        lines.append(f"formula a{name} = (x{name}>={n - 2 * k} & y{name}<{2 * k}) ? {tau} : a-1;")
        lines.append(f"formula b{name} = (x{name}<{2 * k} & y{name}>={n - 2 * k}) ? {tau} : b-1;")
    middle = n // 2
    a, b = (tau if inside(n, middle, middle) else tau - 1 for inside in (in_a, in_b))
    lines += ["module robot", f"  x : [0..{n - 1}] init {middle};", f"  y : [0..{n - 1}] init {middle};"]
    lines += [f"  a : [0..{tau}] init {a};", f"  b : [0..{tau}] init {b};"]
    for name in MOVES:
        outcomes = [("1", name)]
        if name != "stay":
            i = CIRCLE.index(name)
            others = ("stay", CIRCLE[i - 1], CIRCLE[(i + 1) % 8])
            outcomes = [("93/100", name), *(("7/300", other) for other in others)]
        updates = " + ".join(f"{p}:(x'=x{d})&(y'=y{d})&(a'=a{d})&(b'=b{d})" for p, d in outcomes)
        lines.append(f"  [{name}] a>0 & b>0 -> {updates};")
    lines += ["  [] a=0 | b=0 -> true;", "endmodule", 'label "bad" = a=0 | b=0;']
    return "\n".join(lines) + "\n"


# ------------------------------------------------------------------------------ one measurement, in its own process


def ours(n: int, tau: int, repeat: int) -> dict[str, float]:
    return _ours(open_floor(n), tau, repeat, {})


def tiled(n: int, tau: int, repeat: int) -> dict[str, float]:
    return _ours(tiled_floor(n), tau, repeat, {"values": "all"})


def _ours(floor: str, tau: int, repeat: int, options: dict[str, str]) -> dict[str, float]:
    import stltool as stl

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "floor.toml"
        file.write_text(open_floor(10))
        first = stl.build_product(stl.load_model(file), stl.parse(task(12)))
        for engine in ({}, {"engine": "words"}) if _has_engines(stl) else ({},):
            stl.check(first, **engine)  # loads machine code
        file.write_text(floor)
        started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        best: dict[str, float] = {}
        for _ in range(repeat):
            times = [time.process_time()]
            model = stl.load_model(file)
            phi = stl.parse(task(tau))
            times.append(time.process_time())
            product = stl.build_product(model, phi)
            times.append(time.process_time())
            result = stl.check(product, **options)
            times.append(time.process_time())
            assert best.setdefault("P", result.probability) == result.probability
            found = {"load": times[1] - times[0], "product": times[2] - times[1], "check": times[3] - times[2]}
            found["total"] = times[3] - times[0]
            best.update({name: min(value, best.get(name, value)) for name, value in found.items()})
            del model, product, result
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {**best, "GB": (peak - started) / 1e6}


def _has_engines(stl: Any) -> bool:
    return "engine" in inspect.signature(stl.check).parameters


def storm(n: int, tau: int, repeat: int) -> dict[str, float]:
    import stormpy

    started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    best: dict[str, float] = {}
    for _ in range(repeat):
        start = time.process_time()
        with tempfile.NamedTemporaryFile("w", suffix=".nm") as file:
            file.write(prism_program(n, tau))
            file.flush()
            program = stormpy.parse_prism_program(file.name)
        properties = stormpy.parse_properties(f'Pmin=? [ F<={2 * tau - 2} "bad" ]', program)
        model = stormpy.build_model(program, properties)
        built = time.process_time()
        result = stormpy.model_checking(model, properties[0], only_initial_states=True)
        value = 1 - float(result.get_value(model.initial_states[0]))
        done = time.process_time()
        if not best or done - start < best["total"]:
            best = {"build": built - start, "check": done - built, "total": done - start, "P": value}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {**best, "GB": (peak - started) / 1e6}


def measured(what: str, n: int, tau: int, repeat: int, path: str | None = None) -> dict[str, float]:
    """One cell, in a fresh process; `path` is where another stltool is."""
    environment = {**os.environ, **({"PYTHONPATH": path} if path else {})}
    command = [sys.executable, __file__, "--cell", what, str(n), str(tau), str(repeat)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def table(quick: bool = False, older: bool = True) -> list[str]:
    repeat = 1 if quick else 5
    lines = [
        "| open floor | P | stltool: load + product + check, CPU s | of it check | Storm: build + check, CPU s | "
        f"Storm / stltool | check, {COMMIT} / now | peak above start, GB: Storm / stltool |",
        "|---|---|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = older_sources(folder) if older else None
        for n, tau in OPEN[: 1 if quick else None]:
            mine, theirs = measured("ours", n, tau, repeat), measured("storm", n, tau, min(repeat, 3))
            assert abs(mine["P"] - theirs["P"]) < 1e-9, (mine, theirs)
            before = measured("ours", n, tau, min(repeat, 2), path) if path else None
            assert before is None or abs(before["P"] - mine["P"]) < 1e-12
            ratio = f"{before['check'] / mine['check']:.3g} ×" if before else "–"
            lines.append(
                f"| ({n},{tau}) | {mine['P']:.12g} | {mine['total']:.4g} | {mine['check']:.4g} | "
                f"{theirs['total']:.4g} | {theirs['total'] / mine['total']:.3g} × | {ratio} | "
                f"{theirs['GB']:.3g} / {mine['GB']:.3g} |"
            )
            print(lines[-1], file=sys.stderr, flush=True)
    return lines


def scaling(quick: bool = False) -> list[str]:
    """The table of growing floors, drawn as well; not the smallest ones alone."""
    lines = [
        "| floor | product states | stltool, CPU s | GB | Storm, CPU s | GB | Storm / stltool |",
        "|---|---|---|---|---|---|---|",
    ]
    mine: dict[tuple[int, int], dict[str, float]] = {}
    theirs: dict[tuple[int, int], dict[str, float]] = {}
    everywhere: dict[tuple[int, int], dict[str, float]] = {}
    opened = SCALING[:2] if quick else SCALING + LARGER
    for kind, floors in (("open", opened), ("tiled", TILED[: 2 if quick else None])):
        for n, tau in floors:
            found = measured("ours" if kind == "open" else "tiled", n, tau, 3 if n < 100 else 1)
            (mine if kind == "open" else everywhere)[n, tau] = found
            cells = [f"{kind} ({n},{tau})", f"{_states(n, tau):.3g}", f"{found['total']:.3g}", f"{found['GB']:.3g}"]
            if kind == "open" and (n, tau) in SCALING:
                other = theirs[n, tau] = measured("storm", n, tau, 1)
                assert abs(found["P"] - other["P"]) < 1e-9, (found, other)
                cells += [f"{other['total']:.3g}", f"{other['GB']:.3g}", f"{other['total'] / found['total']:.3g} ×"]
            else:
                cells += ["–"] * 3
            lines.append("| " + " | ".join(cells) + " |")
            print(lines[-1], file=sys.stderr, flush=True)
    curves = {"stltool, open": mine, "Storm, open": theirs, "stltool, tiled, every cell": everywhere}
    common = {name: {at: curve[at] for at in curve if name.endswith("cell") or at in theirs} for name, curve in
              curves.items()}  # fmt: skip
    lines += ["", "Slopes (time, memory), log to log: " + "; ".join(
        f"{name} {_slope(curve, 'total'):.2f}, {_slope(curve, 'GB'):.2f}" for name, curve in common.items()
    ) + "."]  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        _draw(curves, Path(folder) / PICTURE.name if quick else PICTURE)
    return lines


def _states(n: int, tau: int) -> int:
    return n * n * tau * tau


def _slope(curve: dict[tuple[int, int], dict[str, float]], what: str) -> float:
    points = [(_states(*at), max(found[what], 1e-4)) for at, found in curve.items()]
    x, y = np.log(np.array(points)).T
    return float(np.polyfit(x, y, 1)[0])


def _draw(curves: dict[str, dict[tuple[int, int], dict[str, float]]], picture: Path) -> None:
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    for axis, what, title in zip(axes, ("total", "GB"), ("CPU seconds", "peak above start, GB"), strict=True):
        for (name, curve), mark in zip(curves.items(), "os^", strict=True):
            points = sorted((_states(*at), max(found[what], 1e-4)) for at, found in curve.items())
            axis.loglog(*zip(*points, strict=True), marker=mark, label=name)
        axis.set(xlabel="product states", ylabel=title)
        axis.grid(visible=True, alpha=0.3)
    axes[0].legend()
    figure.savefig(picture, metadata={"Date": None})


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--cell", nargs=4)
    parser.add_argument("--no-older", action="store_true")
    parser.add_argument("--no-scaling", action="store_true")
    parser.add_argument("--quick", action="store_true", help="the smallest floors, one run; nothing is drawn")
    given = parser.parse_args()
    if given.cell:
        what, *numbers = given.cell
        print(json.dumps({"ours": ours, "storm": storm, "tiled": tiled}[what](*map(int, numbers))))
    else:
        found = table(given.quick, not given.no_older)
        print("\n".join([*found, *([] if given.no_scaling else ["", *scaling(given.quick)])]))
