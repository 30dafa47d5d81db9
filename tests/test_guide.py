"""docs/from-assert.md as its reader goes through it: files are saved, pytest runs, and says what stands there."""

import shlex

import pytest
from hypothesis import Phase, settings

from tests.guide import steps
from tests.test_pytest_plugin import loaded, run  # noqa: F401

pytest_plugins = ["pytester"]


@pytest.fixture
def unshrunk():
    """The reader waits some seconds until Hypothesis has the smallest failure, and why it fails; this test does not."""
    settings.register_profile("unshrunk", settings(), phases=[Phase.generate], database=None)
    before = settings.get_current_profile_name()
    settings.load_profile("unshrunk")
    yield
    settings.load_profile(before)


@pytest.mark.soak(only=True)
def test_the_guide_says_what_happens(pytester, loaded, unshrunk):  # noqa: F811
    runs = 0
    for name, content, options, shown in steps():
        if name:
            (pytester.path / name).write_text(content, encoding="utf-8")
            continue
        runs += 1
        text = run(pytester, *shlex.split(options)).stdout.str()
        assert [line for line in shown.splitlines() if line not in text] == []
    assert runs == 6
