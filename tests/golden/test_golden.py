"""Help texts, messages, terminal output and pages are those of the golden files."""

import pytest

from tests.golden.renew import KINDS, path_of, text_of


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_said_is_what_the_golden_file_has(kind):
    found, kept = text_of(kind).splitlines(), path_of(kind).read_text(encoding="utf-8").splitlines()
    assert found == kept, f"if the change is meant: python -m tests.golden.renew {kind}"


def test_every_golden_file_is_of_a_kind_and_says_how_it_is_renewed():
    assert {path.stem for path in path_of("help").parent.glob("*.txt")} == set(KINDS)
    for kind in KINDS:
        assert path_of(kind).read_text(encoding="utf-8").startswith(f"# python -m tests.golden.renew {kind}\n")
