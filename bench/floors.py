"""Optimum and policy on growing floors: stltool, Storm, and an older stltool, side by side, results compared first.

open floor (n, τ)    n × n free cells, the nine king moves of [Wang24] with its noise, A the bottom-right block of
                     2k × 2k cells, B the top-left one, k = max(1, n // 5), start in the middle
tiled floor (n, τ)   the same with blocks of A and B all over and every cell a start: nothing is far away
task                 G[0,τ) (F[0,τ) A & F[0,τ) B)

Storm gets the product as a PRISM program: a and b count down what is left to reach A and B; 1 − Pmin [F<=2τ−2 "bad"].
Each cell is measured in a process of its own, so that peaks of memory are its own; the fastest of some runs counts.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OPEN = ((30, 15), (30, 40), (100, 15), (100, 31))
OLDER = "fdc09f8"  # the commit that `--older` compares with
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
    import stltool as stl

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "floor.toml"
        file.write_text(open_floor(n))
        started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        best: dict[str, float] = {}
        for _ in range(repeat + 1):  # the first loads machine code
            times = [time.perf_counter()]
            model = stl.load_model(file)
            phi = stl.parse(task(tau))
            times.append(time.perf_counter())
            product = stl.build_product(model, phi)
            times.append(time.perf_counter())
            result = stl.check(product)
            times.append(time.perf_counter())
            found = {"load": times[1] - times[0], "product": times[2] - times[1], "check": times[3] - times[2]}
            found["total"] = times[3] - times[0]
            if not best or found["total"] < best["total"]:
                best = found
            first = best.setdefault("P", result.probability)
            assert abs(first - result.probability) < 1e-12
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {**best, "P": result.probability, "GB": (peak - started) / 1e6, "peak GB": peak / 1e6}


def storm(n: int, tau: int, repeat: int) -> dict[str, float]:
    import stormpy

    started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    best: dict[str, float] = {}
    for _ in range(repeat):
        start = time.perf_counter()
        with tempfile.NamedTemporaryFile("w", suffix=".nm") as file:
            file.write(prism_program(n, tau))
            file.flush()
            program = stormpy.parse_prism_program(file.name)
        properties = stormpy.parse_properties(f'Pmin=? [ F<={2 * tau - 2} "bad" ]', program)
        model = stormpy.build_model(program, properties)
        built = time.perf_counter()
        result = stormpy.model_checking(model, properties[0], only_initial_states=True)
        value = 1 - float(result.get_value(model.initial_states[0]))
        done = time.perf_counter()
        if not best or done - start < best["total"]:
            best = {"build": built - start, "check": done - built, "total": done - start, "P": value}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {**best, "GB": (peak - started) / 1e6, "peak GB": peak / 1e6}


def measured(what: str, n: int, tau: int, repeat: int, path: str | None = None) -> dict[str, float]:
    """One cell, in a fresh process; `path` is where another stltool is."""
    environment = {**os.environ, **({"PYTHONPATH": path} if path else {})}
    command = [sys.executable, __file__, "--cell", what, str(n), str(tau), str(repeat)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def older_build(folder: str) -> str:
    """The older commit's sources in a folder; numba compiles them there."""
    archive = subprocess.run(
        ["git", "archive", OLDER, "stltool", "grammars"], cwd=ROOT, capture_output=True, check=True
    )
    subprocess.run(["tar", "x", "-C", folder], input=archive.stdout, check=True)
    return folder


def table(older: bool = True, repeat: int = 5) -> list[str]:
    lines = [
        "| open floor | P | stltool: load + product + check, s | of it check | Storm: build + check, s | "
        f"Storm / stltool | check, {OLDER} / now | peak above start, GB: Storm / stltool |",
        "|---|---|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = older_build(folder) if older else None
        for n, tau in OPEN:
            mine, theirs = measured("ours", n, tau, repeat), measured("storm", n, tau, 3)
            assert abs(mine["P"] - theirs["P"]) < 1e-9, (mine, theirs)
            before = measured("ours", n, tau, 2, path) if path else None
            assert before is None or abs(before["P"] - mine["P"]) < 1e-12
            ratio = f"{before['check'] / mine['check']:.3g} ×" if before else "–"
            lines.append(
                f"| ({n},{tau}) | {mine['P']:.12g} | {mine['total']:.4g} | {mine['check']:.4g} | "
                f"{theirs['total']:.4g} | {theirs['total'] / mine['total']:.3g} × | {ratio} | "
                f"{theirs['GB']:.3g} / {mine['GB']:.3g} |"
            )
    return lines


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--cell", nargs=4)
    parser.add_argument("--no-older", action="store_true")
    given = parser.parse_args()
    if given.cell:
        what, *numbers = given.cell
        print(json.dumps({"ours": ours, "storm": storm}[what](*map(int, numbers))))
    else:
        print("\n".join(table(not given.no_older)))
