"""What stltool and other tools do with the same questions: `python bench/comparison.py`, for docs/comparison.md.

Each cell is what a run found; the runs compare values before they say "yes". Cells marked *read* are from the tool's
manual or its sources, which docs/comparison.md names; "–" was not looked up. A tool that is not installed is left out
of its column with the word "absent".
"""

from __future__ import annotations

import contextlib
import datetime
import importlib
import io
import re
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from fractions import Fraction
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

import stltool as stl

# two states, a holds in the second; "stay" in the first moves on with probability 1/2, "go" never does
ROWS = [[[0.5, 0.5], [0.75, 0.25]], [[1, 0], [0.75, 0.25]]]
DRN = """@type: MDP
@parameters

@reward_models

@nr_states
2
@nr_choices
3
@model
state 0 init
\taction stay
\t\t0 : {p}
\t\t1 : 0.5
\taction go
\t\t0 : 1
state 1 a
\taction stay
\t\t0 : 0.75
\t\t1 : 0.25
"""
NESTED = "G[0,3] F[0,2] a"
STORM_NESTED = 'Pmax=? [!(F<=3 !(F<=2 "a"))]'
TRACE = [0.2, 0.9, 0.4, 0.7, 0.1, 0.8]  # of x; robustness of G[0,3] F[0,2] (x > 0.5) at its start: by hand, below
ROBUSTNESS = min(max(TRACE[t : t + 3]) for t in range(4)) - 0.5
READ_NO = "no *read*"


def product(text: str) -> stl.Product:
    return stl.build_product(stl.MDP.from_arrays(ROWS, {}, labels={"a": [0, 1]}), stl.parse(text))


def storm(question: str, row: str = "0.5", exact: bool = False, tenths: bool = False, **settings: Any) -> Any:
    """Storm's result for the model, or for one whose rows are 9/10 and 1/10; RuntimeError if it refuses."""
    text = DRN.format(p=row)
    if tenths:
        text = re.sub(r"0 : 0\.7?5", "0 : 0.9", re.sub(r"1 : 0\.2?5", "1 : 0.1", text))
    return asked_of_storm(text, question, exact, **settings)


def asked_of_storm(text: str, question: str, exact: bool = False, **settings: Any) -> Any:
    import stormpy

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.drn"
        file.write_text(text)
        build = stormpy.build_model_from_drn
        model = build[stormpy.Rational](str(file)) if exact else build(str(file))
    (parsed,) = stormpy.parse_properties(question)
    return stormpy.model_checking(model, parsed, only_initial_states=True, **settings)


# ------------------------------------------------------------------------------------------------- what was run


def trace_stltool() -> str:
    found = stl.monitor(stl.parse("G[0,3] F[0,2] (x > 0.5)"), {"x": np.array([TRACE])})
    assert np.isclose(found.robustness[0, 0], ROBUSTNESS)
    return "yes"


def rtamt(kind: str) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import rtamt as library
    specification = getattr(library, f"StlDiscreteTime{kind}Specification")()
    specification.declare_var("x", "float")
    specification.spec = "always[0,3](eventually[0,2](x > 0.5))"
    specification.parse()
    return specification


def trace_rtamt() -> str:
    found = rtamt("Offline").evaluate({"time": list(range(len(TRACE))), "x": TRACE})
    assert np.isclose(found[0][1], ROBUSTNESS)
    return "yes"


def trace_sentil() -> str:
    import sentil

    trace = sentil.Trace.indexed(len(TRACE))
    trace.add_signal("x", np.array(TRACE))
    assert np.isclose(sentil.parse("always[0,3](eventually[0,2](x > 0.5))").robustness_signal(trace)[0], ROBUSTNESS)
    return "yes"


def online_stltool() -> str:
    monitor = stl.OnlineMonitor(stl.parse("G[0,3] F[0,2] (x > 0.5)"), wait=True)
    found = [decision.robustness for x in TRACE for decision in monitor.feed({"x": x})]
    assert np.allclose(found, [ROBUSTNESS])
    return "yes"


def online_rtamt() -> str:
    specification = rtamt("Online")
    specification.pastify()
    found = [specification.update(t, [("x", x)]) for t, x in enumerate(TRACE)]
    assert np.isclose(found[-1], ROBUSTNESS)
    return "yes"


def online_sentil() -> str:
    import sentil

    monitor = sentil.OnlineMonitor(sentil.parse("always[0,3](eventually[0,2](x > 0.5))"))
    found = [monitor.update(float(t), {"x": x}).value for t, x in enumerate(TRACE)]
    assert np.isclose(found[-1], ROBUSTNESS)
    return "yes"


def probability_stltool() -> str:
    return f"{stl.check(product(NESTED)).probability}"


def probability_storm() -> str:
    found = storm(STORM_NESTED).get_value(0)
    assert np.isclose(found, stl.check(product(NESTED)).probability)
    return f"{found}, as `{STORM_NESTED[8:-1]}`"


WINDOWS = (12, 14)  # of a ring of four states, where two labels are to be seen again and again


def seconds(function: Callable[[], Any]) -> float:
    start = time.process_time()
    function()
    return time.process_time() - start


def ring_stltool(tau: int) -> float:
    rows = np.array([np.eye(4), 0.25 * np.eye(4) + 0.75 * np.roll(np.eye(4), 1, axis=1)])
    model = stl.MDP.from_arrays(rows, {}, labels={"a": [0, 1, 0, 0], "b": [0, 0, 0, 1]})
    phi = stl.parse(f"G[0,{2 * tau}] (F[0,{tau}] a & F[0,{tau}] b)")
    return stl.check(stl.build_product(model, phi)).probability


def ring_storm(tau: int) -> float:
    lines = [*DRN.splitlines()[:6], "4", "@nr_choices", "8", "@model"]
    for i, label in enumerate(("init", "a", "", "b")):
        there = sorted({i: 0.25, (i + 1) % 4: 0.75}.items())
        lines += [f"state {i} {label}".rstrip(), "\taction stay", f"\t\t{i} : 1", "\taction go"]
        lines += [f"\t\t{j} : {p}" for j, p in there]
    text = f'Pmax=? [!(F<={2 * tau} !((F<={tau} "a") & (F<={tau} "b")))]'
    return float(asked_of_storm("\n".join(lines) + "\n", text).get_value(0))


def long_stltool() -> str:
    ring_stltool(2)  # what is loaded when it is first needed does not count
    return ", ".join(f"{seconds(lambda tau=tau: ring_stltool(tau)):.2g}" for tau in WINDOWS)


def long_storm() -> str:
    found: list[float] = []
    took = [f"{seconds(lambda tau=tau: found.append(ring_storm(tau))):.2g}" for tau in WINDOWS]
    assert np.allclose(found, [ring_stltool(tau) for tau in WINDOWS])
    return ", ".join(took)


def policy_stltool() -> str:
    best = stl.check(product("F[0,3] a"))
    assert best.policy is not None
    assert stl.check(product("F[0,3] a"), best.policy).probability == best.probability
    return "yes"


def policy_storm() -> str:
    bounded, unbounded = (storm(f'Pmax=? [{f} "a"]', extract_scheduler=True).has_scheduler() for f in ("F<=3", "F"))
    assert unbounded
    return "yes" if bounded else "no, only of unbounded ones"


def fraction_stltool() -> str:
    return str(stl.check(product(NESTED), exact=True).fraction)


def fraction_storm() -> str:
    found = Fraction(str(storm(STORM_NESTED, exact=True).get_value(0)))
    assert found == stl.check(product(NESTED), exact=True).fraction
    return str(found)


def enclosure_stltool() -> str:
    rows = [[[0.9, 0.1], [0.9, 0.1]], [[1, 0], [0.9, 0.1]]]
    asked = stl.build_product(stl.MDP.from_arrays(rows, {}, labels={"a": [0, 1]}), stl.parse("F[0,20] a"))
    best, exact = stl.check(asked), stl.check(asked, exact=True).fraction
    assert exact == 1 - Fraction(9, 10) ** 20
    assert best.lower <= exact <= best.upper
    return "yes"


def enclosure_storm() -> str:
    found = storm('Pmax=? [F<=20 "a"]', tenths=True)
    exact = Fraction(str(storm('Pmax=? [F<=20 "a"]', tenths=True, exact=True).get_value(0)))
    assert exact == 1 - Fraction(9, 10) ** 20
    lower, upper = found.get_lower_bound(0), found.get_upper_bound(0)
    if lower <= exact <= upper:
        return "yes"
    return "no: both are the same double, which is not the value" if lower == upper else "no"


def sums_stltool() -> str:
    try:
        stl.MDP.from_arrays([[[0.7, 0.5], [0.75, 0.25]]], {})
    except stl.StlToolError:
        return "yes"
    return "no"


def sums_storm() -> str:
    try:
        return f"no: answers {storm(chr(34).join(['Pmax=? [F<=3 ', 'a', ']']), row='0.7').get_value(0):.4g}"
    except RuntimeError:
        return "yes"


def learn_stltool() -> str:
    asked = product(NESTED)
    run = stl.learn(asked, "model-based", episodes=60, seed=0)
    assert stl.check(asked, run.policy).probability == stl.check(asked).probability
    return "yes"


def certificate_stltool() -> str:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "proof.jsonl"
        stl.write_certificate(stl.check(product(NESTED), exact=True), file)
        assert stl.certify(file)["lower"] == fraction_stltool()
    return "yes"


def guarantee_stltool() -> str:
    asked = product(NESTED)
    run = stl.learn(asked, "model-based", episodes=300, seed=0)
    assert 0 < stl.guarantee(asked, run.policy, run.counts).lower <= stl.check(asked, run.policy).upper
    return "yes"


TOOLS = {"stltool": "stltool", "Storm": "stormpy", "PRISM": "", "RTAMT": "rtamt", "SENTIL": "sentil", "Breach": ""}
Cell = Callable[[], str] | str
_MODEL_CHECKERS: dict[str, Cell] = {"Storm": READ_NO, "PRISM": READ_NO}
_MONITOR: dict[str, Cell] = {**_MODEL_CHECKERS, "Breach": "yes *read*"}
_CHECKER: dict[str, Cell] = {"RTAMT": READ_NO, "SENTIL": READ_NO, "Breach": READ_NO}
QUESTIONS: list[tuple[str, dict[str, Cell]]] = [
    ("robustness of `G[0,3] F[0,2] (x > 0.5)` on a trace",
     {"stltool": trace_stltool, "RTAMT": trace_rtamt, "SENTIL": trace_sentil, **_MONITOR}),
    ("the same, sample by sample",
     {"stltool": online_stltool, "RTAMT": online_rtamt, "SENTIL": online_sentil, **_MONITOR,
      "Breach": "yes, in Simulink *read*"}),
    (f"the maximal probability of `{NESTED}` on an MDP",
     {"stltool": probability_stltool, "Storm": probability_storm, "PRISM": "no: no bounds below other operators *read*",
      **_CHECKER}),
    ("CPU seconds for `G[0,2τ] (F[0,τ] a & F[0,τ] b)`, four states, τ = " + ", ".join(map(str, WINDOWS)),
     {"stltool": long_stltool, "Storm": long_storm, "PRISM": READ_NO, **_CHECKER}),
    ("the policy that attains a step-bounded maximum",
     {"stltool": policy_stltool, "Storm": policy_storm, "PRISM": "yes *read*", **_CHECKER}),
    ("the probability as a fraction",
     {"stltool": fraction_stltool, "Storm": fraction_storm, "PRISM": "no, only of unbounded ones *read*", **_CHECKER}),
    ("bounds that include rounding",
     {"stltool": enclosure_stltool, "Storm": enclosure_storm, "PRISM": READ_NO, **_CHECKER}),
    ("refuses a row of a model that sums to 1.2",
     {"stltool": sums_stltool, "Storm": sums_storm, "PRISM": "yes *read*", **_CHECKER}),
    ("learns a policy from resets and steps alone", {"stltool": learn_stltool, **_CHECKER, **_MODEL_CHECKERS}),
    ("bounds a policy's probability from its learning data",
     {"stltool": guarantee_stltool, **_CHECKER, **_MODEL_CHECKERS}),
    ("a certificate that a separate checker proves",
     {"stltool": certificate_stltool, "PRISM": READ_NO, **_CHECKER}),
]  # fmt: skip


def shown(tool: str, cell: Cell) -> str:
    if isinstance(cell, str):
        return cell
    with contextlib.redirect_stderr(io.StringIO()):
        return cell() if version(tool) else "absent"


def version(tool: str) -> str | None:
    try:
        importlib.import_module(TOOLS[tool])
        return metadata.version(TOOLS[tool])
    except ImportError:
        return None


def table() -> list[str]:
    heads = [f"{tool} {version(tool)}" if TOOLS[tool] else tool for tool in TOOLS]
    lines = ["| | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    for question, cells in QUESTIONS:
        lines.append(f"| {question} | " + " | ".join(shown(tool, cells.get(tool, "–")) for tool in TOOLS) + " |")
    return lines


def main() -> None:
    print("\n".join(table()))
    print(f"\nMeasured on {datetime.date.today()}.", file=sys.stderr)


if __name__ == "__main__":
    main()
