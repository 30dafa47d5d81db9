"""`stltool check --values`: P from each start, and bounds on each."""

import json

import stltool as stl
from tests.checking.test_values import COIN


def test_the_command_reports_them_and_judges_bounds_on_each(tmp_path, stltool):
    (tmp_path / "coin.drn").write_text(COIN)
    (tmp_path / "task.stl").write_text('model "coin.drn"\nsoon := F[0,4] done\n')
    asked = ["check", tmp_path / "task.stl", "--initial", "0", "--initial", "2", "--values", "initial"]
    code, out, err = stltool(*asked, "--exact", "--at-least", "0.9")
    assert (code, err) == (1, "")
    rows = [line.split() for line in out.splitlines()]
    assert [row[0] for row in rows if row[:1] in (["0"], ["2"])] == ["0", "2"]
    assert "P >= 0.9 from every initial state  does not hold" in out
    code, out, _ = stltool(*asked, "--json", "--report", tmp_path / "page")
    assert code == 0
    product = stl.build_product(stl.load_model(tmp_path / "coin.drn", initial=[0, 2]), stl.parse("F[0,4] done"))
    ours = stl.check(product, values="initial").values
    found = json.loads(out)["values"]
    assert [(each["state"], each["lower"], each["upper"]) for each in found] == [
        (each.name, each.lower, each.upper) for each in ours
    ]
    assert "P by the state that runs start in" in (tmp_path / "page" / "report.html").read_text()
    code, _, err = stltool(*asked[:-1], "some")
    assert code == 2
    assert "--values is 'some'; choose initial or all" in err
    code, _, err = stltool(*asked, "--cost", "done")
    assert code == 2
    assert "--values is not supported with --cost" in err
