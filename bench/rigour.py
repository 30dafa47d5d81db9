"""Numbers one can stand on: enclosures, exact fractions and intervals beside doubles and Storm, in CPU seconds.

enclosure  `check` with its enclosure (fixed point) against the induction in doubles alone, horizon 1000
robust     `robust_check` of a model with intervals against `check` of the nominal one
exact      QComp's resource-gathering (F<=200 success) as a fraction, against Storm's exact engine on the same model
"""

from __future__ import annotations

import sys
import tempfile
import time
from fractions import Fraction
from pathlib import Path

import stltool as stl
from stltool.checking.induction import Doubles, Game, induct

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT))

from tests import qcomp  # noqa: E402


def enclosure_row(runs: int) -> str:
    model = stl.load_model(ROOT / "examples" / "factory" / "floor-10x10.toml")
    product = stl.build_product(model, stl.parse("G[0,991] (F[0,9] A & F[0,9] B)"))
    assert product.horizon == 1000

    def plain() -> float:
        return float(induct(Game.of(product), Doubles(maximize=True)).entry[0])

    def enclosed() -> stl.CheckResult:
        return stl.check(product, keep_policy=False, arithmetic="fixed")

    result = enclosed()
    exact = stl.check(product, keep_policy=False, exact=True).fraction
    assert exact is not None
    assert result.lower <= exact <= result.upper
    assert abs(plain() - exact) < 1e-9
    seconds = _paired(plain, enclosed, runs)
    what = f"enclosure, 10 × 10 floor, horizon 1000, width {result.upper - result.lower:.1g}"
    return f"| {what} | the plain sweep | {seconds[1] / seconds[0]:.2f} × its time |"


def robust_row(runs: int) -> str:
    """Of one floor with its noise known up to intervals, against the floor inside them."""
    text = (ROOT / "examples" / "factory" / "floor-10x10.toml").read_text()
    lines = [line for line in text.splitlines() if not line.startswith(("success", "slip"))]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "floor.toml"
        file.write_text("\n".join([*lines, "success = [0.9, 0.96]", "slip = [0.01, 0.04]"]))
        model = stl.load_model(file)
    phi = stl.parse("G[0,29] (F[0,29] A & F[0,29] B)")
    robust, plain = stl.build_product(model, phi), stl.build_product(model.nominal(), phi)
    assert stl.robust_check(robust).lower <= stl.check(plain).upper
    seconds = _paired(lambda: stl.check(plain, engine="words"), lambda: stl.robust_check(robust, engine="words"), runs)
    return (
        f"| robust check, 10 × 10 floor, T = τ = 30 ({seconds[1]:.3f} s) | the nominal model's check "
        f"({seconds[0]:.3f} s) | {seconds[1] / seconds[0]:.1f} × its time |"
    )


def exact_row(runs: int) -> str:
    with tempfile.TemporaryDirectory() as folder:
        model = stl.load_model(qcomp.resource_gathering(Path(folder)))
    product = stl.build_product(model, stl.parse("F[0,200] success"))

    def ours() -> Fraction | None:
        return stl.check(product, exact=True, keep_policy=False).fraction

    try:
        import stormpy
    except ImportError:
        return "| exact fraction, resource-gathering | Storm's exact engine | not measured: stormpy is not installed |"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.drn"
        file.write_text(_drn(model))
        storm = stormpy.build_model_from_drn[stormpy.Rational](str(file))
    (prop,) = stormpy.parse_properties('Pmax=? [F<=200 "success"]')
    results = []

    def theirs() -> None:
        results.append(stormpy.model_checking(storm, prop, only_initial_states=True))

    seconds = _paired(ours, theirs, runs)
    assert ours() == Fraction(str(results[0].get_value(storm.initial_states[0])))
    return (
        f"| exact fraction, resource-gathering ({seconds[0]:.2f} s) | Storm's exact engine ({seconds[1]:.2f} s), "
        f"models loaded | {seconds[1] / seconds[0]:.0f} × faster |"
    )


def _paired(first, second, n: int) -> tuple[float, float]:
    """The shortest of n runs of each, taken in turn."""
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(n):
        for action, kept in zip((first, second), times, strict=True):
            start = time.process_time()
            action()
            kept.append(time.process_time() - start)
    return min(times[0]), min(times[1])


def _drn(model: stl.MDP) -> str:
    exact = model.exact()
    lines = ["@type: MDP", "@value_type: rational", "@parameters", "", "@reward_models", ""]
    lines += ["@nr_states", str(model.n_states), "@nr_choices", str(model.n_choices), "@model"]
    for s in range(model.n_states):
        lines.append(" ".join(["state", str(s), *(name for name, values in model.labels.items() if values[s])]))
        for i, c in enumerate(range(model.choice_start[s], model.choice_start[s + 1])):
            lines.append(f"\taction {i}")
            for k in range(model.row_start[c], model.row_start[c + 1]):
                lines.append(f"\t\t{model.target[k]} : {Fraction(int(exact.numerator[k]), exact.denominator)}")
    return "\n".join(lines) + "\n"


def table(quick: bool = False) -> list[str]:
    runs = 1 if quick else 9
    return [
        "| what | against | figure |",
        "|---|---|---|",
        *(row(runs) for row in (enclosure_row, robust_row, exact_row)),
    ]


if __name__ == "__main__":
    print("\n".join(table()))
