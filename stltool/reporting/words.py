"""A task and a run in plain sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict, assert_never

from stltool.logic.formula import (
    Always,
    And,
    Comparison,
    Constant,
    Eventually,
    Formula,
    Historically,
    Iff,
    Implies,
    Interval,
    Label,
    Not,
    Once,
    Or,
    Release,
    Rise,
    Since,
    Trigger,
    Until,
    is_temporal,
)
from stltool.logic.printer import Text
from stltool.numbers import probability_text

_LONG = 10  # states of a run that a sentence names
_DEEPEST = 40  # levels of a sentence; below, formulas stand as they are


class SentenceRecord(TypedDict):
    """A sentence and what it introduces: "at every step from 0 to 9:" and two parts."""

    text: str
    parts: list[SentenceRecord]


def sentences(phi: Formula, text: Text = str) -> SentenceRecord:
    """A formula as nested sentences, judged at step 0; steps below a temporal operator are counted from its own."""
    return _sentence(phi, text, at_start=True, depth=0)


def sentence_text(sentence: SentenceRecord) -> str:
    """Nested sentences in one line."""
    parts = [sentence_text(part) for part in sentence["parts"]]
    if not parts:
        return sentence["text"]
    joint = "; or " if sentence["text"].startswith("at least one") else "; and "
    return f"{sentence['text']} {parts[0] if len(parts) == 1 else f'({joint.join(parts)})'}"


def _sentence(phi: Formula, text: Text, at_start: bool, depth: int) -> SentenceRecord:
    if isinstance(phi, Comparison) or not is_temporal(phi) or depth > _DEEPEST:
        return _plain(_holds(phi, text))

    def below(part: Formula, start: bool) -> SentenceRecord:
        return _sentence(part, text, start, depth + 1)

    match phi:
        case Always(interval, arg):
            return _introduced(_always(interval.a, interval.last, at_start), below(arg, False))
        case Eventually(interval, arg):
            return _introduced(_eventually(interval.a, interval.last, at_start), below(arg, False))
        case Until(interval, left, right):
            goal, before = below(right, False), below(left, False)
            when = _eventually(interval.a, interval.last, at_start)
            if goal["parts"] or before["parts"]:
                until = _introduced("at every step until then,", before)
                return {"text": f"both, {when.rstrip(',')}:", "parts": [goal, until]}
            return _plain(f"{when} {goal['text']}, and at every step until then {before['text']}")
        case Release(interval, left, right):
            goal, before = below(right, False), below(left, False)
            when = _always(interval.a, interval.last, at_start)
            return _exempt(when, goal, before, "at an earlier step")
        case Once(interval, arg):
            return _introduced(_once(interval), below(arg, False))
        case Historically(interval, arg):
            return _introduced(_historically(interval), below(arg, False))
        case Since(interval, left, right):
            goal, ever_since = below(right, False), below(left, False)
            when = _once(interval)
            if goal["parts"] or ever_since["parts"]:
                since = _introduced("at every step since then,", ever_since)
                return {"text": f"both, {when.rstrip(',')}:", "parts": [goal, since]}
            return _plain(f"{when} {goal['text']}, and at every step since then {ever_since['text']}")
        case Trigger(interval, left, right):
            goal, after = below(right, False), below(left, False)
            return _exempt(_historically(interval), goal, after, "at a later step up to now")
        case Rise(Not(arg)):
            return _began(below(arg, at_start), "fall")
        case Rise(arg):
            return _began(below(arg, at_start), "rise")
        case And(args):
            return {"text": "all of these:", "parts": [below(arg, at_start) for arg in args]}
        case Or(args):
            return {"text": "at least one of these:", "parts": [below(arg, at_start) for arg in args]}
        case Not(arg):
            return {"text": "it is not the case that", "parts": [below(arg, at_start)]}
        case Implies(left, right):
            condition, result = below(left, at_start), below(right, at_start)
            if condition["parts"]:
                return {"text": "if the first, then the second:", "parts": [condition, result]}
            return _introduced(f"if {condition['text']}, then", result)
        case Iff(left, right):
            return {"text": "both or neither of these:", "parts": [below(left, at_start), below(right, at_start)]}
        case Constant() | Label():
            raise AssertionError("a formula without temporal operators")
        case _:
            assert_never(phi)


def _exempt(when: str, goal: SentenceRecord, other: SentenceRecord, where: str) -> SentenceRecord:
    """Release and trigger: at every step of a window, unless something else held in between."""
    if goal["parts"] or other["parts"]:
        unless = _introduced(f"unless, {where},", other)
        return {"text": f"{when.rstrip(',')}, the first, unless the second:", "parts": [goal, unless]}
    return _plain(f"{when} {goal['text']}, unless {where} {other['text']}")


def _began(arg: SentenceRecord, kind: Literal["rise", "fall"]) -> SentenceRecord:
    """rise, fall: what holds now but did not at the step before, or the other way round."""
    if arg["parts"]:
        start = "this begins to hold:" if kind == "rise" else "this does not hold, and did at the step before:"
        return {"text": start, "parts": [arg]}
    text = arg["text"]
    if kind == "rise":
        return _plain(f"{text}, and did not at the step before")
    ended = text.removesuffix(" holds")
    now = f"{ended} does not hold" if ended != text else f"it is not the case that {text}"
    return _plain(f"{now}, and did at the step before if there was one")


def _plain(text: str) -> SentenceRecord:
    return {"text": text, "parts": []}


def _introduced(start: str, rest: SentenceRecord) -> SentenceRecord:
    """ "within the next 9 steps" and "A holds" in one; what has parts of its own stays below it."""
    if not rest["parts"]:
        return _plain(f"{start} {rest['text']}")
    if rest["text"] == "all of these:":
        return {"text": f"{start.rstrip(',')}:", "parts": rest["parts"]}
    return {"text": f"{start.rstrip(',')}:", "parts": [rest]}


def _holds(phi: Formula, text: Text) -> str:
    match phi:
        case Constant(value):
            return "nothing is required" if value else "the impossible happens"
        case Not(Label() as label):
            return f"{text(label)} does not hold"
        case _:
            return f"{text(phi)} holds"


def _once(interval: Interval) -> str:
    a, b = interval.a, interval.b
    if b is None:
        return "now or earlier" if a == 0 else f"at least {_steps(a)} ago"
    if b == 0:
        return "now"
    if a == b:
        return f"{_steps(a)} before,"
    return f"now or within the last {_steps(b)}" if a == 0 else f"at some step from {b} to {a} before,"


def _historically(interval: Interval) -> str:
    a, b = interval.a, interval.b
    if b is None:
        return "now and at every earlier step" if a == 0 else f"at every step up to {_steps(a)} ago"
    if b == 0:
        return "now"
    if a == b:
        return f"{_steps(a)} before, if there was such a step,"
    return f"now and at the last {_steps(b)}" if a == 0 else f"at every step from {b} to {a} before,"


def _always(a: int, b: int, at_start: bool) -> str:
    if a == b:
        return _at(a, at_start)
    if at_start:
        return f"at every step from {a} to {b},"
    if a == 0:
        return f"now and at the next {_steps(b)},"
    return f"at every step from {a} to {b} later,"


def _eventually(a: int, b: int, at_start: bool) -> str:
    if a == b:
        return _at(a, at_start)
    if at_start:
        return f"at some step from {a} to {b},"
    if a == 0:
        return f"within the next {_steps(b)}"
    return f"at some step from {a} to {b} later,"


def _at(step: int, at_start: bool) -> str:
    if at_start:
        return f"at step {step}"
    return "now" if step == 0 else f"{_steps(step)} later"


def _steps(n: int) -> str:
    return f"{n} step{'s'[: n != 1]}"


# ------------------------------------------------------------------------------------------------------------ findings


def run_sentences(why: Mapping[str, Any], count: int = 3) -> list[str]:
    """The most probable violations (`likely_data`) in sentences, the first ones."""
    return [_run_sentence(why, number) for number in range(min(count, len(why["runs"])))]


def _run_sentence(why: Mapping[str, Any], number: int) -> str:
    run = why["runs"][number]
    verdict = "satisfies" if run["satisfied"] else "violates"
    which = "The most probable run that" if number == 0 else f"Number {number + 1}: a run that"
    share = f", {100 * run['share']:.3g} % of all of them" if run["share"] is not None else ""
    ways = _way(run["states"])
    decided = f"it is decided at step {run['step']}"
    if run["certain_from"] < run["step"]:
        decided += f", and cannot be averted under this policy from step {run['certain_from']} on"
    before = f" Just before: {run['remembered']}." if run["remembered"] is not None else ""
    return (
        f"{which} {verdict} the task has probability {probability_text(run['probability'])}{share}. It goes {ways}; "
        f"{decided}.{before}"
    )


def _way(states: Sequence[str]) -> str:
    """ "from (1,0) over (2,1), where it stays for 3 steps, to (3,1)"; a long way in its beginning and end."""
    stays: list[tuple[str, int]] = []
    for state in states:
        if stays and stays[-1][0] == state:
            stays[-1] = (state, stays[-1][1] + 1)
        else:
            stays.append((state, 1))
    if len(stays) == 1:
        return f"nowhere: it stays in {stays[0][0]}"
    texts = [state if n == 1 else f"{state} (for {_steps(n)})" for state, n in stays]
    if len(texts) > _LONG:
        texts = [*texts[: _LONG // 2], "…", *texts[-_LONG // 2 :]]
    if len(texts) == 2:
        return f"from {texts[0]} to {texts[1]}"
    return f"from {texts[0]} over {', '.join(texts[1:-1])} to {texts[-1]}"


def sensitivity_sentences(rows: Sequence[Mapping[str, Any]], count: int = 2) -> list[str]:
    """The states on which P depends most (`sensitivity_data`) in sentences, the first ones."""
    told: list[str] = []
    for row in rows[:count]:
        action = max(row["actions"], key=lambda one: abs(one["derivative"]))
        told.append(
            f"P depends {'most' if not told else 'next'} on state {row['name']}: one more percentage point of success "
            f"there would change P by about {row['derivative'] / 100:.2g}, mostly through {action['action']} to "
            f"{action['intended']}, which now succeeds with probability {action['success']:.4g}."
        )
    return told
