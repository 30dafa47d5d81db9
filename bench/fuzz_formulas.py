"""`make fuzz`: coverage-guided fuzzing of the reader of formulas and task files (atheris, libFuzzer underneath).

Whatever the bytes: only StlToolError comes out; what parses prints as text that parses back to it; what is laid out
keeps its meaning and is final. Runs until stopped, or as libFuzzer's options say (`-max_total_time=600`); a failing
input is written to the working folder.
"""

from __future__ import annotations

import sys

import atheris

with atheris.instrument_imports(include=["stltool", "lark"]):
    import stltool as stl
    from stltool.errors import StlToolError
    from stltool.logic import format, lint, parser

VOCABULARY = """
G F U alw_ ev_ until always eventually [0,3] (0..T) [0:2s) inf x[t] x A := and or -> <-> xor not ! < <= == + - * / ^
abs( min( , ) ( ; 1e-3 0.5 true 2ms § //c #c "f.toml" param signal step = model T y 3 0.1s
"""
WORDS = [*VOCABULARY.split(), "\n", "\r\n", "\t", "# c\n", "// c\n", "\nparam T = 3\n", "\nr := "]


def text_of(data: bytes) -> str:
    """Bytes as words of the language and raw characters, so that most inputs get past the first token."""
    provider = atheris.FuzzedDataProvider(data)
    pieces = []
    while provider.remaining_bytes():
        if provider.ConsumeBool():
            pieces += [WORDS[provider.ConsumeIntInRange(0, len(WORDS) - 1)], " "]
        else:
            pieces.append(provider.ConsumeUnicodeNoSurrogates(3))
    return "".join(pieces)


def one_input(data: bytes) -> None:
    text = text_of(data)
    for unbounded in (False, True):
        try:
            phi = stl.parse(text, {"T": 3}, step="0.5s", unbounded=unbounded, unit="step")
        except StlToolError:
            continue
        assert stl.parse(str(phi), unbounded=True) == phi
    try:
        laid_out = format.format_task(text)
    except StlToolError:
        laid_out = None
    else:
        assert format.format_task(laid_out) == laid_out
    for read in (lambda t: stl.parse_task(t), lambda t: parser.parse_task(t, {"T": "2s"}, unbounded=True)):
        try:
            task = read(text)
        except StlToolError:
            continue
        lint.ambiguities(task.document)
        assert laid_out is not None
        assert read(laid_out).formula == task.formula


if __name__ == "__main__":
    atheris.Setup(sys.argv, one_input)
    atheris.Fuzz()
