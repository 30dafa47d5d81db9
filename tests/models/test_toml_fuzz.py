"""Model files in TOML whose values are anything: a model with distributions, or a StlToolError that names the file."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import stltool as stl
from stltool.errors import StlToolError
from tests.conftest import many

NUMBERS = st.sampled_from(
    ["0", "1", "-1", "0.9", "2", "1e999", "nan", "inf", "true", '"p"', '"9/10"', '"1/30"', '"1/0"', '"(1-p)/3"',
     "[0.5, 1]", "[1, 0.5]", '"[1/2, 1]"', "99999999999999999999", "1e-320", '"x"', "1979-05-27", '""', '"1-p"'],
)  # fmt: skip
CELLS = st.sampled_from(
    ["[0, 0]", "[1, 1]", "[0, 0, 1, 1]", "[[0, 0], [1, 0, 1, 1]]", "[9, 9]", "[]", "[[]]", "3",
     "[0, 99999999999999999999]", "[-1, 0]", "[0.5, 0]", "[true, 0]", "{}", '"A"', "[1, 0, 0, 1]"],
)  # fmt: skip
MAPS = st.sampled_from(
    ['"A.\\nS."', '"AB\\n.S\\n#."', '"S"', '"##"', '""', "3", '"A?\\nS"', '"SSS\\nS"', '"ab\\ncS\\n"']
)
NAMES = st.sampled_from(["A", "B", "wet", "x", "S", '""', '"a b"', '"\\u0000"', '"\\n"', "E", "NW", "stay"])
MOVES = st.sampled_from(['"king"', '"cross"', '["stay"]', '["E", "N"]', "[]", "3", '["E", "E"]', '["fly"]', '[["E"]]'])
ANYTHING = NUMBERS | CELLS | MAPS | MOVES


def tables(keys, values):
    return st.dictionaries(keys, values | ANYTHING, max_size=3).map(
        lambda table: "{ " + ", ".join(f"{key} = {value}" for key, value in table.items()) + " }"
    )


NOISE = tables(st.sampled_from(["success", "slip", "else"]), NUMBERS)
GRID = {
    "map": MAPS, "moves": MOVES, "success": NUMBERS, "slip": NUMBERS, "cell": NUMBERS, "start": CELLS,
    "regions": tables(NAMES, CELLS), "noise": tables(NAMES, NOISE), "one_way": tables(NAMES, CELLS),
    "parameters": tables(st.sampled_from(["p", "q"]), NUMBERS), "normalize": st.sampled_from(["true", "3"]),
    "name": st.sampled_from(['"n"', "3", '"\\u001b"']),
}  # fmt: skip
FILES = st.sampled_from(
    ['"floor.toml"', '"other.toml"', '"model.toml"', '"none.toml"', '"."', '""', '"floor.tra"', "3"]
)
MEMBER = st.one_of(FILES, tables(st.sampled_from(["model", "start", "parameters"]), FILES | CELLS))
FORMULAS = st.sampled_from(
    ['"a.x == b.x"', '"a.A"', '"F[0,2] a.A"', '"1 / a.x > 0"', '"a.x >"', '"true"', '"r"', '"sqrt(a.x - 9) > 0"', '""',
     '"a.x[t+1] > 0"', "3"],
)  # fmt: skip
TEAM = {
    "members": tables(st.sampled_from(["a", "b", '"a.b"', '""', "G"]), MEMBER),
    "labels": tables(st.sampled_from(["r", "meet", '"a.A"', '"\\n"']), FORMULAS),
    "name": GRID["name"], "normalize": GRID["normalize"],
}  # fmt: skip


def texts(kind, keys):
    """Files with the first key, and any of the others."""
    first, *others = keys
    known = {key: keys[key] | ANYTHING for key in others}
    return st.fixed_dictionaries({first: keys[first]}, optional=known | {"other": ANYTHING}).map(
        lambda table: f'kind = "{kind}"\n' + "".join(f"{key} = {value}\n" for key, value in table.items())
    )


PARAMETERS = "parameters = { p = [0.5, 1] }\n"
MEMBERS = 'kind = "composition"\nmembers = { a = "floor.toml", b = { model = "other.toml", start = [0, 0] } }\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("models")
    (found / "floor.toml").write_text('kind = "grid"\nmap = "A.\\nS#"\nsuccess = "9/10"\n')
    (found / "other.toml").write_text('kind = "grid"\nmap = "AS"\nsuccess = "p"\n[parameters]\np = [0.5, 1]\n')
    return found


@given(texts("grid", GRID) | texts("composition", TEAM))
@settings(max_examples=many(400))
@example(f'kind = "grid"\nmap = "A.\\nS#"\nsuccess = "9/10"\nnoise = {{ A = {{ success = "p" }} }}\n{PARAMETERS}')
@example('kind = "grid"\nmap = "A.\\nS#"\nparameters = {}\n')
@example(f"{MEMBERS}labels = {{ r = 'a.A' }}\n")
def test_a_file_of_anything_is_a_model_or_refused(folder, text):
    path = folder / "model.toml"
    path.write_text(text, encoding="utf-8")
    try:
        model = stl.load_model(path)
    except StlToolError as error:
        assert str(path) in str(error)
        return
    rows = model.source.rows(np.arange(model.n_states))
    rows.require_distributions(str, str)
    assert model.uncertain or rows.defect == 0
    assert all(len(values) == model.n_states for values in (*model.signals.values(), *model.labels.values()))
