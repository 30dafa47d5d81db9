"""Sizes and compile times of task automata: `make bench` writes them to bench/results.md, `… readme` README's rows.

    exact        encoding="exact": states and seconds
    flags        the paper's flag product, Π (τ_i + 1), for formulas of its fragment (* not exact: windows differ)
    history      the τ-MDP encoding, Σ |Λ|^i over the inner horizon; over model states it is larger still
    progression  residual formulas reached by plain progression, simplified alike, no watches, not minimised

Formulas: ARCH-COMP falsification requirements in whole steps (the step chosen so that bounds are whole), the paper's
twelve scenarios, response and persistence patterns.
"""

from __future__ import annotations

import math
import sys
import time

import stltool as stl
from stltool.automata.compile import all_valuations, atoms_of
from stltool.automata.history import history_states
from stltool.automata.machines import Exploration
from stltool.automata.residuals import Progression, Residuals
from stltool.errors import FragmentError, SizeError

BUDGET = 20_000  # progression states tried

FORMULAS = {
    "AT1": "G[0,20] (speed < 120)",
    "AT51, steps of 0.1 s": "G[0,300] ((!g & F[1,1] g) -> F[1,1] G[0,25] g)",
    "AT6a": "(G[0,30] (rpm < 3000)) -> (G[0,4] (speed < 35))",
    "CC2": "G[0,70] F[0,30] (y5 - y4 >= 15)",
    "CC3": "G[0,80] (G[0,20] (y2 - y1 <= 20) | F[0,20] (y5 - y4 >= 40))",
    "CC4": "G[0,65] F[0,30] G[0,5] (y5 - y4 >= 8)",
    "CC5": "G[0,72] F[0,8] (G[0,5] (y2 - y1 >= 9) -> G[5,20] (y5 - y4 >= 9))",
    "CCx": "G[0,50] (a > 7.5) & G[0,50] (b > 7.5) & G[0,50] (c > 7.5) & G[0,50] (d > 7.5)",
    "NN": "G[1,37] (far -> F[0,2] G[0,1] !far)",
    "NNx, steps of 0.5 s": "F[0,2] (pos > 3.2) & F[2,3] G[0,1] inside & G[4,6] close",
    "AFC27, steps of 1 s": "G[11,50] ((low & F[0,1] high) | (high & F[0,1] low) -> G[1,5] calm)",
    "WT4": "G[30,630] F[0,5] near",
    "PM": "G[0,10] (y <= 15) & F[0,10] (y >= 8)",
    **{f"R, T = 10, τ = {tau} (two floors)": f"F[0,10) F[0,{tau}) A" for tau in (5, 10)},
    **{f"C, T = 10, τ = {tau} (two floors)": f"F[0,10) G[0,{tau}) C" for tau in (5, 10)},
    **{f"P, T = τ = {tau} (two floors)": f"G[0,{tau}) (F[0,{tau}) A & F[0,{tau}) B)" for tau in (10, 15)},
    "charge and patrol": "F[0,10) G[0,5) C & G[0,10) (F[0,10) A & F[0,10) B)",
    "response 100": "G[0,100] (a -> F[0,100] b)",
    "response, until 50": "G[0,100] (a -> (b U[0,50] c))",
    "persistence 10": "G[0,100] (a -> G[0,10] b)",
    "persistence 100": "G[0,100] (a -> G[0,100] b)",
    "recurrence 100": "G[0,99] (F[0,99] a & F[0,99] b)",
    "sequence": "F[0,10] (a & F[0,10] (b & F[0,10] c))",
    "docs/semantics.md §2": "F[0,3) (F[0,2) a & G[0,4) b)",
}  # fmt: skip


def exact(phi: stl.Formula) -> tuple[str, str]:
    start = time.perf_counter()
    try:
        states = f"{stl.compile_automaton(phi).n_states}"
    except SizeError:
        states = "refused"
    return states, f"{time.perf_counter() - start:.2f}"


def flags(phi: stl.Formula) -> str:
    try:
        fragment = stl.check_fragment(phi)
    except FragmentError:
        return "–"
    return f"{number(math.prod(part.tau + 1 for part in fragment.parts))}{'' if fragment.uniform else '*'}"


def progression(phi: stl.Formula) -> str:
    atoms = atoms_of(phi)
    table = Residuals(atoms)
    letters = [tuple(row) for row in all_valuations(len(atoms)).tolist()]
    search = Exploration(table.residual(phi), Progression(table, letters))
    return str(len(search.states)) if search.grow(BUDGET) else f"> {BUDGET}"


def number(n: float) -> str:
    return str(n) if n < 10**6 else f"{float(n):.2g}"


def readme() -> list[str]:
    """The rows of README."""
    rows = {
        "P, T = τ = 15 (two floors)": "the paper's P4",
        "charge and patrol": "charge and patrol",
        "CC4": "ARCH-COMP CC4",
        "response 100": "response",
    }
    lines = ["| formula | exact | flags | history |", "|---|---:|---:|---:|"]
    for name, shown in rows.items():
        phi = stl.parse(FORMULAS[name])
        history = number(history_states(phi, 2 ** len(atoms_of(phi))))
        text = FORMULAS[name].replace("(y5 - y4 >= 8)", "p").replace("|", r"\|")
        lines.append(f"| `{text}`, {shown} | {exact(phi)[0]} | {flags(phi)} | {history} |")
    return lines


def table(quick: bool = False) -> list[str]:
    lines = ["| formula | exact | seconds | flags | history | progression |", "|---|---:|---:|---:|---:|---:|"]
    for name, text in list(FORMULAS.items())[: 5 if quick else None]:
        phi = stl.parse(text)
        states, seconds = exact(phi)
        history = number(history_states(phi, 2 ** len(atoms_of(phi))))
        shown = text.replace("|", r"\|")
        lines.append(f"| {name}: `{shown}` | {states} | {seconds} | {flags(phi)} | {history} | {progression(phi)} |")
    return lines


if __name__ == "__main__":
    print("\n".join(readme() if sys.argv[1:] == ["readme"] else table()))
