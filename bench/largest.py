"""A billion product states, every cell a start, policy on disk: `python bench/largest.py [N] [TAU] [--again]`.

The tiled floor: N × N free cells, king moves, blocks of 2 × 2 cells of A and of B in every 15 × 15 cells, runs begin
everywhere; G[0,τ) (F[0,τ) A & F[0,τ) B). The check runs in a process of its own, is killed (SIGKILL) once it is two
thirds through and has saved where it is, and a second process goes on with `resume=True`.

CPU is that of both processes together, peak the larger resident memory of the two.

`--again` does it once more without a kill, and compares the two policy files byte by byte.
"""

from __future__ import annotations

import argparse
import filecmp
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

PERIOD, SIDE = 15, 2


def tiled_floor(n: int) -> str:
    """The model file."""

    def cell(x: int, y: int) -> str:
        x, y, half = x % PERIOD, y % PERIOD, PERIOD // 2
        if x < SIDE and y < SIDE:
            return "A"
        return "B" if half <= x < half + SIDE and half <= y < half + SIDE else "."

    rows = "\n".join("".join(cell(x, y) for x in range(n)) for y in range(n))
    return f'kind = "grid"\nsuccess = "93/100"\nslip = "7/300"\nstart = [0, 0]\nmap = """\n{rows}\n"""\n'


def check(n: int, tau: int, policy: str, every: float, resume: bool) -> None:
    """One process: lines of progress, then one of results."""
    import stltool as stl

    Path("floor.toml").write_text(tiled_floor(n), encoding="utf-8")
    product = stl.build_product(stl.load_model("floor.toml"), stl.parse(f"G[0,{tau}) (F[0,{tau}) A & F[0,{tau}) B)"))
    Path("floor.toml").unlink()

    def progress(done: int, total: int) -> None:
        print(json.dumps({"done": done, "total": total, "saved": Path(f"{policy}.state").exists()}), flush=True)

    found = stl.check(product, values="all", policy_file=policy, save_every=every, resume=resume, progress=progress)
    assert found.values is not None
    result = {
        "states": product.n_states, "horizon": product.horizon, "lower": found.lower, "upper": found.upper,
        "least": found.values.least.value, "greatest": found.values.greatest.value, "policy": os.path.getsize(policy),
    }  # fmt: skip
    print(json.dumps({"result": result, **spent(resource.RUSAGE_SELF)}), flush=True)


def spent(whose: int) -> dict[str, float]:
    usage = resource.getrusage(whose)
    return {"cpu": usage.ru_utime + usage.ru_stime, "peak": usage.ru_maxrss * 1024}


def run(
    folder: str, policy: str, asked: argparse.Namespace, resume: bool = False, kill: bool = False
) -> dict[str, Any]:
    """What a process printed last, with its time, memory, and when it began to step back."""
    arguments = [
        sys.executable, __file__, str(asked.n), str(asked.tau), "--child", policy, "--save-every",
        str(asked.save_every), *(["--resume"] if resume else []),
    ]  # fmt: skip
    start, told = time.perf_counter(), time.perf_counter()
    last: dict[str, Any] = {}
    first_back = None
    with subprocess.Popen(arguments, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            last = json.loads(line)
            seconds = time.perf_counter() - start
            if "done" in last:
                if first_back is None and last["done"] > last["total"] // 2:
                    first_back = seconds
                if time.perf_counter() - told > 10:
                    told = time.perf_counter()
                    share = last["done"] / last["total"]
                    print(f"{share:.0%} after {seconds:.0f} s", file=sys.stderr)
                if kill and last["saved"] and last["done"] > last["total"] * 5 / 6:
                    process.send_signal(signal.SIGKILL)
                    break
        process.wait()
        if not kill:
            assert process.returncode == 0, process.returncode
    return {**last, "seconds": time.perf_counter() - start, "until back": first_back}


def facts(asked: argparse.Namespace) -> dict[str, str]:
    """The whole measurement."""
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        killed = run(folder, "best.policy", asked, kill=True)
        if "done" not in killed:
            sys.exit("it ended before it had saved anything; give a larger N, or less between saves")
        resumed = run(folder, "best.policy", asked, resume=True)
        found, children = resumed["result"], spent(resource.RUSAGE_CHILDREN)
        told = {
            "states": f"{found['states']:,}, {found['horizon']} steps",
            "P": f"{found['lower']!r} … {found['upper']!r} from the first cell",
            "all cells": f"{found['least']!r} … {found['greatest']!r}",
            "killed": f"after {killed['seconds']:.0f} s, {killed['done'] / killed['total']:.0%} done",
            "resumed": f"{resumed['seconds']:.0f} s more, {resumed['until back']:.0f} of them to get there again",
            "CPU": f"{children['cpu']:.0f} s in all",
            "peak": f"{children['peak'] / 1e9:.1f} GB resident",
            "policy": f"{found['policy'] / 1e9:.1f} GB on disk",
        }
        if asked.again:
            whole = run(folder, "whole.policy", asked)
            assert filecmp.cmp(Path(folder) / "best.policy", Path(folder) / "whole.policy", shallow=False)
            told["again"] = f"{whole['seconds']:.0f} s without a kill, {whole['cpu']:.0f} s CPU; the same policy file"
    return told


def table(quick: bool = False) -> list[str]:
    n, tau, save_every = (100, 15, 0.0) if quick else (1265, 25, 60.0)
    found = facts(argparse.Namespace(n=n, tau=tau, again=quick, save_every=save_every))
    return ["| what | figure |", "|---|---|", *(f"| {name} | {fact} |" for name, fact in found.items())]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("n", type=int, nargs="?", default=1265)
    parser.add_argument("tau", type=int, nargs="?", default=25)
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--save-every", type=float, default=60.0, metavar="SECONDS")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    parser.add_argument("--resume", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.child:
        check(asked.n, asked.tau, asked.child, asked.save_every, asked.resume)
        return
    for name, fact in facts(asked).items():
        print(f"{name:<11}{fact}")


if __name__ == "__main__":
    main()
