"""What can be wrong with a user's input: one base class, one child per kind.

Every message says where (file, line, column, the line and a caret), what (the value), and what to write instead.
The command line prints the message and leaves with exit code 2; nobody sees a traceback for a typing slip.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Sequence

MOST_FAULTS = 20  # of a text that are told


class StlToolError(Exception):
    """The user's input is at fault. `str(error)` is the whole message, ready to print.

    Arguments that it names (`named`) are spelled as Python spells them; `reworded` spells them as others do.
    """

    def __init__(self, message: object = "") -> None:
        self._marked = str(message)
        super().__init__(_NAMED.sub(r"\2", self._marked))


_NAMED = re.compile("\x02(\\w+)\x1f([^\x03]*)\x03")


def reworded(error: StlToolError, spell: Callable[[str, str], str]) -> str:
    """An error's message with `spell(argument, text)` in the place of every text that names an argument."""
    return _NAMED.sub(lambda found: spell(found[1], found[2]), error._marked)


def named(argument: str, text: str | None = None) -> str:
    """An argument of a public function in a message: its name, or `text`, such as "resume=True".

    A text that is more than that ("use keep_policy=False, or ") is advice; it is not shown to those who cannot follow
    it, for they have no such option.
    """
    return f"\x02{argument}\x1f{argument if text is None else text}\x03"


class ArgumentError(StlToolError, TypeError):
    """A public function was given something of another kind than it takes."""


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


class PolicyError(StlToolError):
    """A policy does not fit the product it is to be used on."""


class CertificateError(StlToolError):
    """A certificate is not one, or belongs to another task or model."""


class RefusedError(CertificateError):
    """A certificate does not prove its bounds."""


class SizeError(StlToolError):
    """What was asked for would not fit; raised before any memory is taken."""


class SettingsError(StlToolError):
    """A setting of a learner or of a command is out of range."""


class InfeasibleError(StlToolError):
    """No policy meets the constraints that were asked for."""


class SolverError(StlToolError):
    """A numerical solver ended without an answer."""


class MissingExtraError(StlToolError):
    """A package is needed that a plain install of stltool does not bring."""


class FileError(StlToolError):
    """A file cannot be read or written, or holds something else than its name says."""


class InexactEncodingWarning(UserWarning):
    """The chosen encoding, the flags of [Wang24], approximates the formula and may disagree with it."""


def all_told(messages: Sequence[str], count: int | None = None) -> str:
    """What is wrong with a text, one fault below the other: the first `MOST_FAULTS`, and how many there are.

    `count` is their number where `messages` are only the first of them.
    """
    count = len(messages) if count is None else count
    shown = list(messages[:MOST_FAULTS])
    if count > 1:
        more = f"; the first {len(shown)} are shown" if count > len(shown) else ""
        shown.append(f"{count} errors{more}")
    return "\n".join(shown)


def near_misses(name: str, known: Iterable[str]) -> str:
    """A sentence that helps: what `name` may have meant among the names there are."""
    names = sorted(set(known))
    close = difflib.get_close_matches(name, names, n=3, cutoff=0.6)
    close += [n for n in names if n.lower() == name.lower() and n not in close]
    if close:
        return f"did you mean {' or '.join(close)}?"
    if names:
        shown = ", ".join(names[:12]) + (", …" if len(names) > 12 else "")
        return f"known names: {shown}"
    return "there are no names to choose from"
