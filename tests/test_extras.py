"""What a plain install brings, and what it says where a package of an extra is missing."""

import ast
import json
import re
import subprocess
import sys
import tomllib

import pytest

from stltool.errors import MissingExtraError
from stltool.extras import EXTRAS, require
from tests.conftest import ROOT
from tests.sources import sources

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# every module of stltool that imports a package of an extra when it is itself imported, or in a function
IMPORTERS = {
    "cluster.py": "distributed", "learning/pool.py": "distributed", "envs/model.py": "gymnasium",
    "envs/product.py": "gymnasium", "models/gymnasium/spaces.py": "gymnasium",
    "models/gymnasium/cells.py": "gymnasium", "models/gymnasium/vector.py": "gymnasium",
    "monitoring/logs/mcap.py": "mcap", "monitoring/logs/parquet.py": "pyarrow",
    "reporting/tensorboard.py": "tensorboard", "checking/readable.py": "sklearn",
    "testing/environments.py": "gymnasium",
}  # fmt: skip


INSTALLED = {"sklearn": "scikit-learn"}  # whose name on an index is another


def names(requirements):
    return {re.match(r"[\w-]+", requirement)[0] for requirement in requirements}


def third_party(source):
    """The packages that a module imports, but for annotations."""
    for node in source.imports:
        if node in source.hints:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module.split(".")[0]


def test_whatever_is_imported_is_brought_by_the_install_or_by_a_named_extra():
    found = {}
    for path, source in sources().items():
        for package in set(third_party(source)) - {"stltool", "__future__"} - set(sys.stdlib_module_names):
            found.setdefault(package, set()).add(path.as_posix())
    brought = names(PROJECT["dependencies"])
    assert (
        set(found) - set(EXTRAS) - {"llvmlite", "pytest"} == brought
    )  # none missing, none idle; numba brings llvmlite,
    # and pytest loads the module that imports it
    assert {module: package for package in EXTRAS for module in found.get(package, ())} == IMPORTERS
    for package, extra in EXTRAS.items():
        assert INSTALLED.get(package, package) in names(PROJECT["optional-dependencies"][extra])


DOORS = {
    "cma": "falsify(lambda inputs: {}, 'x > 0', {'a': (0, 1)}, method='cma')",
    "optuna": "falsify(lambda inputs: {}, 'x > 0', {'a': (0, 1)}, method='optuna')",
    "distributed": "stl.run_sweep(stl.load_sweep('examples/paper/small.toml'), folder, cluster='tcp://localhost:1')",
    "gymnasium": "stl.load_model('examples/frozenlake/lake.toml')",
    "mcap": "stl.load_trace(f'{folder}/trace.mcap')",
    "pyarrow": "stl.load_trace(f'{folder}/trace.parquet')",
    "sklearn": "stl.policy_tree(stl.build_product(stl.MDP.from_arrays([[[1]]], {}), stl.parse('true')))",
    "stormpy": "stl.load_model(f'{folder}/model.prism')",
    "tensorboard": "tensorboard.write_tensorboard(None, folder)",
}


WITHOUT = """
import json, sys
doors, folder = json.load(sys.stdin), sys.argv[1]
sys.modules.update(dict.fromkeys(doors))
import stltool as stl
from stltool.reporting import tensorboard
from stltool.testing import falsify
for door in doors.values():
    try:
        eval(door)
    except stl.StlToolError as error:
        print(error)
"""


@pytest.mark.soak(only=True)
def test_a_missing_package_is_told_with_its_extra(tmp_path):
    for name in ("trace.mcap", "trace.parquet", "model.prism"):
        (tmp_path / name).touch()
    command = [sys.executable, "-c", WITHOUT, tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, input=json.dumps(DOORS))
    assert (done.returncode, done.stderr) == (0, "")
    assert set(DOORS) == set(EXTRAS)
    for package, told in zip(DOORS, done.stdout.splitlines(), strict=True):
        assert re.match(rf".+ needs the package {package}, .+; pip install 'stltool\[{EXTRAS[package]}\]'", told)


def test_a_package_that_cannot_be_imported_says_why(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "tensorboard", raising=False)
    (tmp_path / "tensorboard.py").write_text("raise ImportError('no protobuf here')\n")
    with pytest.raises(MissingExtraError) as refusal:
        require("tensorboard", "a curve", "write a table")
    assert str(refusal.value) == (
        "a curve needs the package tensorboard, which cannot be imported (no protobuf here); "
        "pip install 'stltool[tensorboard]', or write a table"
    )
