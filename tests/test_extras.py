"""What a plain install brings, and what it says where a package of an extra is missing."""

import ast
import re
import subprocess
import sys
import tomllib

import pytest

from stltool.errors import MissingExtraError
from stltool.extras import EXTRAS, require
from tests.conftest import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# every module of stltool that imports a package of an extra when it is itself imported, or in a function
IMPORTERS = {
    "cluster.py": "distributed", "learning/pool.py": "distributed", "envs/model.py": "gymnasium",
    "envs/product.py": "gymnasium", "models/gymnasium/spaces.py": "gymnasium",
    "models/gymnasium/cells.py": "gymnasium", "models/gymnasium/vector.py": "gymnasium",
    "monitoring/files.py": "pyarrow",
    "reporting/tensorboard.py": "tensorboard", "checking/readable.py": "sklearn",
}  # fmt: skip


INSTALLED = {"sklearn": "scikit-learn"}  # whose name on an index is another


def names(requirements):
    return {re.match(r"[\w-]+", requirement)[0] for requirement in requirements}


def third_party(path):
    """The packages that a module imports, but for annotations."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    hints = [node for node in ast.walk(tree) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)]
    only_hints = {below for node in hints for below in ast.walk(node)}
    for node in ast.walk(tree):
        if node in only_hints:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module.split(".")[0]


def test_whatever_is_imported_is_brought_by_the_install_or_by_a_named_extra():
    found = {}
    for path in (ROOT / "stltool").rglob("*.py"):
        for package in set(third_party(path)) - {"stltool", "__future__"} - set(sys.stdlib_module_names):
            found.setdefault(package, set()).add(path.relative_to(ROOT / "stltool").as_posix())
    brought = names(PROJECT["dependencies"])
    assert set(found) - set(EXTRAS) - {"llvmlite"} == brought  # none missing, none idle; numba brings llvmlite
    assert {module: package for package in EXTRAS for module in found.get(package, ())} == IMPORTERS
    for package, extra in EXTRAS.items():
        assert INSTALLED.get(package, package) in names(PROJECT["optional-dependencies"][extra])


DOORS = {
    "distributed": "stl.run_sweep(stl.load_sweep('examples/paper/small.toml'), folder, cluster='tcp://localhost:1')",
    "gymnasium": "stl.load_model('examples/frozenlake/lake.toml')",
    "pyarrow": "stl.load_trace(f'{folder}/trace.parquet')",
    "sklearn": "stl.policy_tree(stl.build_product(stl.MDP.from_arrays([[[1]]], {}), stl.parse('true')))",
    "tensorboard": "tensorboard.write_tensorboard(None, folder)",
}


@pytest.mark.parametrize("package", EXTRAS)
def test_a_missing_package_is_told_with_its_extra(package, tmp_path):
    (tmp_path / "trace.parquet").touch()
    code = f"""
import sys
sys.modules[{package!r}], folder = None, sys.argv[1]
import stltool as stl
from stltool.reporting import tensorboard
try:
    {DOORS[package]}
except stl.StlToolError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code, tmp_path], capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    says = rf".+ needs the package {package}, .+; pip install 'stltool\[{EXTRAS[package]}\]'"
    assert re.match(says, done.stdout)


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
