"""Faults in a user's input: a base class, and a child per kind.

Every message states where (file, line, column, the line and a caret), what (the value), and what to write instead.
The command line prints the message and ends with exit code 2; nobody sees a traceback for a typing error.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Sequence

MOST_FAULTS = 20  # faults of a text that are listed


class StlToolError(Exception):
    """The user's input is at fault. `str(error)` is the whole message, ready to print.

    Arguments that it names (`named`) are spelled as in Python; `reworded` changes the spelling.
    """

    def __init__(self, message: object = "") -> None:
        self._marked = str(message)
        super().__init__(_NAMED.sub(r"\2", self._marked))


_NAMED = re.compile("\x02(\\w+)\x1f([^\x03]*)\x03")


def reworded(error: StlToolError, spell: Callable[[str, str], str]) -> str:
    """An error's message with `spell(argument, text)` in place of every text that names an argument."""
    return _NAMED.sub(lambda found: spell(found[1], found[2]), error._marked)


def marked(error: StlToolError) -> str:
    """An error's message for the message of another error, which then spells the named arguments, too."""
    return error._marked


def named(argument: str, text: str | None = None) -> str:
    """An argument of a public function in a message: its name, or `text`, such as "resume=True".

    A longer text ("use keep_policy=False, or ") is advice, which is not shown to users who have no such option.
    """
    return f"\x02{argument}\x1f{argument if text is None else text}\x03"


class ArgumentError(StlToolError, TypeError):
    """An argument of a public function is of the wrong type."""


class StlSyntaxError(StlToolError):
    """A formula or a task file does not parse, or parses to something ill-typed."""


class NameLookupError(StlToolError):
    """A formula names a signal or a label that nothing defines."""


class TraceError(StlToolError):
    """A trace is too short for the formula, or its samples are not usable."""


class FragmentError(StlToolError):
    """A formula is outside the fragment that the chosen encoding covers exactly."""


class ModelError(StlToolError):
    """A model file or a model's arrays do not describe an MDP."""


class TieError(StlToolError):
    """Data contradict the assumption that a parameter is the same in all rows."""


class PolicyError(StlToolError):
    """A policy does not fit the product it is to be used on."""


class CertificateError(StlToolError):
    """A certificate is not one, or belongs to another task or model."""


class RefusedError(CertificateError):
    """A certificate does not prove its bounds."""


class SizeError(StlToolError):
    """The request would not fit into memory; raised before any memory is allocated."""


class SettingsError(StlToolError):
    """A setting of a learner or of a command is out of range."""


class InfeasibleError(StlToolError):
    """No policy, or no trace, meets the given constraints."""


class SolverError(StlToolError):
    """A numerical solver ended without an answer."""


class MissingExtraError(StlToolError):
    """A package is needed that a plain installation of stltool does not include."""


class FileError(StlToolError):
    """A file cannot be read or written, or its content does not match its name."""


class InexactEncodingWarning(UserWarning):
    """The chosen encoding, the flags of [Wang24], approximates the formula and may disagree with it."""


class UnusedTimeWarning(UserWarning):
    """A trace has a column of times that is not used, since no step is declared: its rows are taken as steps."""


def all_told(messages: Sequence[str], count: int | None = None) -> str:
    """The faults of a text, one below the other: the first `MOST_FAULTS`, and their number.

    `count` is the total if `messages` are only the first of them.
    """
    count = len(messages) if count is None else count
    shown = list(messages[:MOST_FAULTS])
    if count > 1:
        more = f"; the first {len(shown)} are shown" if count > len(shown) else ""
        shown.append(f"{count} errors{more}")
    return "\n".join(shown)


def near_misses(name: str, known: Iterable[str], shown: Callable[[str], str] = str) -> str:
    """A hint: the existing names that `name` may have meant, each as `shown` writes it."""
    names = sorted(set(known))
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.6)
    close += [n for n in names if n.lower() == name.lower() and n not in close]
    if close:
        return f"did you mean {' or '.join(map(shown, close))}?"
    if names:
        listed = ", ".join(map(shown, names[:12])) + (", …" if len(names) > 12 else "")
        return f"known names: {listed}"
    return "no names are defined"
