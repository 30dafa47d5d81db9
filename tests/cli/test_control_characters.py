"""Names, files and options with control characters: readers refuse them, and whatever is printed shows them."""

import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.text import Text

import stltool as stl
from stltool.errors import ModelError, StlSyntaxError, TraceError
from stltool.screen import Screen
from stltool.streams import control_character, escaped, say

OBEYED = "\x1b]0;title\x07\x1b[31m\x9b\u202e"  # retitles, rings, recolours, and turns letters around


def calm(text):
    return control_character(text) == ""


@pytest.mark.parametrize(
    "command", ["check", "explain", "fmt", "lint", "monitor", "run", "report", "verify", "certify"]
)
@pytest.mark.parametrize("place", ["file", "text", "quoted", "param", "model"])
def test_nothing_printed_is_obeyed(stltool, tmp_path, monkeypatch, command, place):
    monkeypatch.chdir(tmp_path)
    name = f"a{OBEYED}.stl" if place == "file" else "a.stl"
    inside = {"text": f"d := F[0,3] A {OBEYED}\n", "quoted": f'd := F[0,3] "{OBEYED}"\n'}.get(place, "d := F[0,3 A\n")
    (tmp_path / name).write_text(inside, encoding="utf-8")
    (tmp_path / "log.csv").write_text(f'x,"{OBEYED}"\n1,2\n2,3\n3,4\n4,5\n', encoding="utf-8")
    extra = {"param": ["-p", f"T={OBEYED}"], "model": ["--model", f"{OBEYED}.toml"]}.get(place, [])
    given = [name, *(["log.csv"] if command == "monitor" else ["a.json"] if command == "certify" else []), *extra]
    code, out, err = stltool(command, *given)
    assert code == 2
    assert calm(out)
    assert calm(err)


def test_readers_refuse_them_in_names(tmp_path):
    with pytest.raises(StlSyntaxError, match=r"column 12: this name has the control character U\+001B"):
        stl.parse('F[0,3] A & "\x1b[31m" & B')
    stay = [np.eye(1)]
    for names in ({"labels": {"a\x1b": [True]}}, {"signals": {"a\x1b": [1.0]}}, {"action_names": ["a\x1b"]}):
        with pytest.raises(ModelError, match=r"the name 'a\\x1b' has the control character U\+001B; rename it"):
            stl.MDP.from_arrays(stay, **{"signals": {}, "labels": {}, **names})
    log = tmp_path / "log.csv"
    log.write_text("x,y\x1b[31m\n1,2\n")
    with pytest.raises(TraceError, match=r"log.csv: the column 'y\\x1b\[31m' has the control character U\+001B"):
        stl.load_trace(log)


def test_a_grid_with_a_label_that_recolours_is_refused_with_its_file(stltool, tmp_path):
    (tmp_path / "g.toml").write_text('kind = "grid"\nmap = "SA"\nlabels = {"\\u001b[31m" = "A"}\n')
    (tmp_path / "t.stl").write_text("t := F[0,3] A\n")
    code, out, err = stltool("check", tmp_path / "t.stl", "--model", tmp_path / "g.toml")
    assert (code, out) == (2, "")
    assert "g.toml" in err
    assert calm(err)


@given(st.text(max_size=20))
def test_escaped_texts_are_calm_and_calm_texts_stay(text):
    assert calm(escaped(text))
    assert escaped(escaped(text)) == escaped(text)
    if calm(text):
        assert escaped(text) == text


def test_a_screen_shows_them_and_keeps_its_own_colours(capsys):
    file = io.StringIO()
    Screen(file=file, force_terminal=True, color_system="standard").print(Text("a\x1b[31mb", "bold"))
    assert file.getvalue() == "\x1b[1ma\\x1b[31mb\x1b[0m\n"
    say("a\x1b[31mb\tc\nd")
    assert capsys.readouterr().out == "a\\x1b[31mb\tc\nd\n"
