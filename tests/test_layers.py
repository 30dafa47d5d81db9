"""What the sources say: the direction of imports (text → formula → automaton → product → learn / check → report), and
where numba and consoles are used."""

import ast
import subprocess
import sys

from tests.conftest import ROOT
from tests.sources import sources

# each room may import itself and the rooms before it; kernels import nothing, nobody imports testing
ORDER = ["errors", "streams", "screen", "log", "arguments", "numbers", "display", "extras", "source", "files",
         "grammar", "arrays", "sizes", "cluster", "choices", "layered", "randomness", "logic", "automata", "monitoring",
         "diagnosis", "models", "product", "anatomy", "reached", "asked", "written", "policy", "transfer",
         "recheck", "checking", "envs", "gate", "learning", "exporting", "reporting", "starters", "doctor", "cli",
         "__main__"]  # fmt: skip
FORBIDDEN = {("automata", "models"), ("models", "automata"), ("models", "logic"), ("checking", "learning")}


def imports(source):
    for node in source.imports:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("stltool"):
            room = node.module.removeprefix("stltool").lstrip(".").split(".")[0]
            yield from [room] if room else [alias.name for alias in node.names]
        elif isinstance(node, ast.Import):
            yield from [a.name.split(".")[1] for a in node.names if a.name.startswith("stltool.")]


def test_imports_point_one_way():
    wrong, seen = [], 0
    for path, source in sources().items():
        room = path.parts[0].removesuffix(".py")
        if room in ("__init__", "testing", "pytest_plugin"):
            continue
        for target in imports(source):
            seen += 1
            if room in ("kernels", "recheck"):
                allowed = target == "kernels" == room
            else:
                allowed = target == "kernels" or ORDER.index(target) <= ORDER.index(room)
            if not allowed or (room, target) in FORBIDDEN:
                wrong.append(f"{path} imports {target}")
    assert seen > 50
    assert not wrong


# what reporting/ calls in other rooms: for the doors `report` and `explain`, for counts, texts, and what pictures shade
GATHERED = {"evidence_of", "tested", "take_apart", "recorded", "flag_states", "history_states", "monitor",
            "part_verdicts", "ranges_of"}  # fmt: skip
COMPUTING = {"anatomy", "automata", "checking", "diagnosis", "gate", "learning", "monitoring", "product"}


def test_reports_only_tell():
    """Apart from those, reporting/ takes classes from the rooms that compute."""
    called = set()
    for path, source in sources().items():
        for node in source.imports if path.parts[0] == "reporting" else ():
            room = node.module.split(".")[1:2] if isinstance(node, ast.ImportFrom) and node.module else []
            if room and room[0] in COMPUTING:
                called |= {alias.name for alias in node.names if alias.name[0].islower()}
    assert called == GATHERED


def test_importing_the_package_stays_light():
    heavy = {"numba", "cvxpy", "matplotlib", "gymnasium", "scipy", "lark", "hypothesis", "pyarrow"}
    code = f"import sys, stltool; print({heavy} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "set()\n"


def test_pytest_s_plugin_loads_nothing_of_the_package():
    """pytest loads it in every run of everybody who has stltool installed."""
    code = (
        "import sys, pytest; before = set(sys.modules); import stltool.pytest_plugin; print(set(sys.modules) - before)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name for name in ast.literal_eval(done.stdout) if name.startswith(("stltool.", "numpy", "hypothesis"))}
    assert loaded == {"stltool.pytest_plugin"}


def test_every_public_name_is_spelled_once():
    """The lazy loader reads the stub that type checkers read; `x as x` is how a stub exports."""
    import stltool

    names = [
        alias
        for node in ast.walk(ast.parse((ROOT / "stltool" / "__init__.pyi").read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    ]
    assert all(alias.asname == alias.name for alias in names)
    assert sorted(alias.name for alias in names) == sorted(stltool.__all__)
    assert len(names) == len(set(stltool.__all__)) > 60
    assert all(getattr(stltool, name) is not None for name in stltool.__all__)


def test_a_wrong_public_name_is_refused_with_a_near_miss():
    code = "import stltool; stltool.chek"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "module 'stltool' has no attribute 'chek'. Did you mean: 'check'?" in done.stderr


def test_numba_is_used_in_one_place():
    """So that no kernel is kept in another way; types and intrinsics of vectors compile nothing themselves."""
    users = set()
    for path, source in sources().items():
        for node in source.imports:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module:
                names += [f"{node.module}.{alias.name}" for alias in node.names]
            users |= {(path.name, name) for name in names if name.split(".")[0] == "numba"}
    declaring = {"types", "extending.intrinsic", "extending.models", "extending.overload", "extending.register_model",
                 "np.arrayobj.populate_array"}  # fmt: skip
    others = {(file, name) for file, name in users if name.removeprefix("numba.") not in declaring}
    assert {file for file, _ in others} == {"cache.py", "compiling.py", "jit.py"}
    assert {file for file, _ in users} == {
        "cache.py",
        "compiling.py",
        "jit.py",
        "lanes.py",
        "objects.py",
        "passes.py",
        "streams.py",
        "tiles.py",
        "twofold.py",
        "wide.py",
    }


def test_there_is_one_place_that_prints():
    """No module makes a console of its own; `print` is refused by ruff."""
    makers = {
        str(path) for path, source in sources().items()
        if any(isinstance(node, ast.ImportFrom) and node.module == "rich.console" for node in source.imports)
    }  # fmt: skip
    assert makers == {"screen.py"}
