#!/usr/bin/env bash
# Lark.lex() builds a new lexer in every call if the instance has a parser.
#
# Version: lark 1.3.1 (CPython 3.11).
# The documentation calls Lark.lex "only relevant when lexer='basic'". With Lark(grammar, lexer="basic", parser="lalr") the
# parser owns a BasicLexer, but lex() does not use it: it makes another one each time, whose scanner compiles the regular
# expressions of all terminals and matches every literal against every pattern. With Lark(grammar, parser=None,
# lexer="basic") one lexer is made and kept. The parser's own lexer gives the same tokens through
# parse_interactive(text).lexer_thread.lex(None), without a new one.
# Output seen: lexers built by 50 calls: lex() with a parser 50, without 0, by the parser's own 0; with 120 keywords a call
# of lex() took some 20 times as long as the parser's own (663 us, 34 us).
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check lark==1.3.1
"$folder/venv/bin/python" - <<'PYTHON'
import time

import lark
from lark.lexer import BasicLexer

built = 0
original = BasicLexer.__init__


def counted(self, *arguments, **options):
    global built
    built += 1
    original(self, *arguments, **options)


BasicLexer.__init__ = counted
words = " | ".join(f'"word{i}"' for i in range(120))
grammar = f"""
start: (WORD | NAME)+
WORD: {words}
NAME: /[a-z]+[0-9]*/
{chr(10).join(f'W{i}: "key{i}"' for i in range(120))}
other: {" ".join(f"W{i}" for i in range(120))}
%ignore " "
"""


def calls(lex, text="a word7 key3 b"):
    global built
    tokens = list(lex(text))
    before, started = built, time.process_time()
    for _ in range(50):
        assert list(lex(text)) == tokens
    return built - before, time.process_time() - started, tokens


with_parser = lark.Lark(grammar, parser="lalr", lexer="basic", start=["start", "other"])
alone = lark.Lark(grammar, parser=None, lexer="basic", start=["start", "other"])
found = {
    "lex() with a parser": calls(with_parser.lex),
    "lex() without a parser": calls(alone.lex),
    "the parser's own": calls(lambda text: with_parser.parse_interactive(text, start="start").lexer_thread.lex(None)),
}
for name, (number, seconds, _) in found.items():
    print(f"{name}: {number} lexers built by 50 calls, {1e6 * seconds / 50:.0f} us a call")
assert [number for number, _, _ in found.values()] == [50, 0, 0]
assert len({tuple(tokens) for _, _, tokens in found.values()}) == 1
PYTHON
