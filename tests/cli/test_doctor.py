"""`stltool doctor`: it finds what is there, and what is missing, too old or broken."""

import importlib
import json
import tomllib
from importlib import metadata

import pytest

from stltool import doctor
from stltool.extras import EXTRAS
from tests.conftest import ROOT


def test_this_installation_is_sound(stltool):
    code, text, _ = stltool("doctor")
    data = json.loads(stltool("doctor", "--json")[1])
    assert (code, data["faults"]) == (0, [])
    assert text.rstrip().endswith("faults  none")
    assert data["version"] == metadata.version("stltool")
    packages = {one["name"]: one for one in data["packages"]}
    assert packages["numpy"]["version"] == metadata.version("numpy")
    assert packages["numpy"]["extra"] is None
    assert packages["gymnasium"]["extra"] == "gymnasium"
    assert {one["name"] for one in data["packages"]}.isdisjoint({"ruff", "mypy"})
    assert 0 < data["memory"]["most_used"] <= data["memory"]["available"] <= data["memory"]["total"]
    assert all(f"{name} " in text for name in ("numpy", "numba", "gymnasium", "a small check"))


def test_every_extra_that_a_user_may_need_is_listed(stltool, monkeypatch):
    """Those that a feature asks for; of pyproject's others, all but what serves developers and comparisons."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(EXTRAS.values()) <= set(doctor.PURPOSES)
    assert set(doctor.PURPOSES) == set(project["optional-dependencies"]) - {"test", "dev", "bench", "fuzz", "peers"}
    listed = {one.name: one for one in doctor.diagnose().packages if one.extra is not None}
    for package, extra in EXTRAS.items():
        name = {"sklearn": "scikit-learn"}.get(package, package)
        assert (listed[name].extra, listed[name].status) == (extra, "ok")
    text = stltool("doctor")[1]
    assert all(f"\n{extra} " in text for extra in doctor.PURPOSES)


def test_metadata_that_are_older_than_the_sources_are_not_believed(stltool, monkeypatch):
    """An editable install: pyproject.toml has what the metadata lacked when they were made; and where it is absent."""
    listed = doctor._of_sources(ROOT)
    written = [one.replace("lazy_loader", "lazy-loader") for one in listed if "stltool[" not in one]  # as by hatchling
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: written)
    assert doctor.diagnose().stale is None
    old = [one for one in listed if "extra" not in one]
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: old)
    code, text, _ = stltool("doctor")
    assert (code, f"which were used here; pip install -e {ROOT}" in text) == (0, True)
    assert "not listed" not in text
    assert json.loads(stltool("doctor", "--json")[1])["extras"]["trees"]["packages"] == ["scikit-learn"]
    monkeypatch.setattr(doctor, "_of_sources", lambda folder: None)
    text = stltool("doctor")[1]
    assert "as installed, which is not this code: pip install --upgrade 'stltool[trees]'" in text


def broken(monkeypatch, *, missing=(), old=(), failing=()):
    """An installation in which some packages are not as they should be."""
    version, load = metadata.version, importlib.import_module

    def of(name):
        if name in missing:
            raise metadata.PackageNotFoundError(name)
        return "0.0.1" if name in old else version(name)

    def imported(name, package=None):
        if name in failing:
            raise ImportError("libsomething.so: cannot open\nshared object")
        return load(name, package)

    monkeypatch.setattr(doctor.metadata, "version", of)
    monkeypatch.setattr(doctor.importlib, "import_module", imported)


@pytest.mark.parametrize(
    ("kinds", "fault"),
    [
        ({"missing": ["lark"]}, r"lark is not installed; pip install 'lark"),
        ({"old": ["rich"]}, r"rich 0.0.1 is too old; pip install --upgrade 'rich"),
        (
            {"failing": ["networkx"]},
            "networkx cannot be imported (ImportError: libsomething.so: cannot open); pip install",
        ),
        ({"old": ["gymnasium"]}, "gymnasium 0.0.1 is too old; pip install --upgrade 'gymnasium>="),
    ],
)
def test_what_is_wrong_is_found(stltool, monkeypatch, kinds, fault):
    broken(monkeypatch, **kinds)
    code, text, _ = stltool("doctor")
    assert code == 1
    assert fault in text
    assert "fault 1" in text
    assert "fault 2" not in text


def test_extras_that_are_not_there_are_no_fault(stltool, monkeypatch):
    broken(monkeypatch, missing=["gymnasium", "pyarrow"])
    code, text, _ = stltool("doctor")
    assert code == 0
    assert "missing: pip install 'stltool[gymnasium]'" in text
    assert "missing: pip install 'stltool[parquet]'" in text
    assert "missing: pip install 'stltool[cluster]'" not in text


def test_a_cache_that_cannot_be_written_and_a_wrong_result_are_faults(stltool, monkeypatch):
    monkeypatch.setattr(doctor, "_cache", lambda: (None, 0))
    monkeypatch.setattr(doctor, "_small_check", lambda: "its result is 7/8 instead of 15/16")
    code, text, _ = stltool("doctor")
    assert code == 1
    assert "fault 1" in text
    assert "set NUMBA_CACHE_DIR to a writable folder" in text
    assert "fault 2" in text
    assert "a small check went wrong: its result is 7/8 instead of 15/16" in text


def test_the_small_check_notices_a_wrong_result(monkeypatch):
    assert doctor._small_check() is None
    monkeypatch.setattr("stltool.check", lambda *_, **__: 1 / 0)
    assert doctor._small_check().startswith("ZeroDivisionError")
