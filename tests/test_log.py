"""Progress in logs: with a clock that is set by hand, and once with the thread that watches."""

import threading
import time

import pytest

from stltool import log
from stltool.log import EVERY, Log
from stltool.reporting import terminal


class Clock:
    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def lines():
    return []


@pytest.fixture
def by_hand(clock, lines, monkeypatch):
    """The process's log, without its thread: `beat` speaks if a line is due."""
    found = Log(lines.append, clock, watched=False)
    monkeypatch.setattr(terminal, "LOG", found)
    return found


def test_never_more_than_ten_seconds_without_a_word(by_hand, clock, lines):
    """Whatever stages come and go: a line is due at the latest `EVERY` seconds after the last one."""
    with by_hand.stage("stltool run") as whole:
        clock.now += 4
        assert by_hand.beat() == EVERY - 4
        with by_hand.stage("checking") as stage:
            clock.now += 5
            assert by_hand.beat() == 1  # counted from the last word, not from the stage's beginning
            stage.note = "3 of 9"
            clock.now += 1
            assert by_hand.beat() == EVERY
            assert lines == ["checking: 3 of 9, 6 s so far"]
            clock.now += 9
            by_hand.say("a word")
            clock.now += 9
            assert (by_hand.beat(), lines[1:]) == (1, ["a word"])
        clock.now += 1
        assert by_hand.beat() == EVERY
        assert lines[2:] == ["stltool run: 29 s so far"]
        assert whole.title == "stltool run"
    clock.now += 1000
    assert (by_hand.beat(), len(lines)) == (float("inf"), 3)


def test_what_took_no_time_says_nothing(by_hand, clock, lines):
    for _ in range(100):
        with by_hand.stage("short"):
            clock.now += 0.05
            by_hand.beat()
    assert lines == []


def test_a_bar_in_a_log(by_hand, clock, lines):
    with terminal.progress_bar("learning (cfer)") as bar:
        bar(1, 1000, 18, None)
        clock.now += 10
        by_hand.beat()
        for episode in range(2, 1001):
            bar(episode, 1000, 18 * episode, 0.25)
        clock.now += 10
        by_hand.beat()
    assert lines[:2] == ["learning (cfer): 1 of 1000, 18 steps, 10 s so far",
                         "learning (cfer): 100 of 1000, 1800 steps, exact P 0.25"]  # fmt: skip
    assert len(lines) == 1 + 10 + 1
    assert lines[-1] == "learning (cfer): 1000 of 1000, 18000 steps, exact P 0.25, 20 s so far"


def test_quiet_means_no_tenths_but_a_sign_of_life(by_hand, clock, lines):
    with terminal.progress_bar("checking", quiet=True) as bar:
        for step in range(1, 1001):
            bar(step, 1000)
        assert lines == []
        clock.now += 10
        by_hand.beat()
    assert lines == ["checking: 1000 of 1000, 10 s so far"]


def test_a_sweep_in_a_log(by_hand, clock, lines):
    from stltool.learning.sweep import SweepProgress

    with terminal.sweep_bar() as bar:
        clock.now += 10
        by_hand.beat()
        assert lines == ["sweep: no run is finished yet, 10 s so far"]
        bar(SweepProgress(1, 20, 100, 0.05))
        assert len(lines) == 1
        clock.now += 10
        by_hand.beat()
        bar(SweepProgress(2, 20, 200, 0.1))
    assert [line.split(",")[0] for line in lines[1:]] == ["sweep: 1 of 20 runs", "sweep: 2 of 20 runs"]


def test_what_is_only_loaded_or_read(by_hand, clock, lines):
    with terminal.working("reading trace.csv"):
        clock.now += 2
        by_hand.beat()
        clock.now += 10
        by_hand.beat()
    assert lines == ["reading trace.csv …", "reading trace.csv: 12 s so far"]
    with terminal.working("reading trace.csv", quiet=True):
        clock.now += 9
        by_hand.beat()
    assert len(lines) == 2
    with terminal.kernels_ready(quiet=True):
        clock.now += 10
        by_hand.beat()
    assert lines[2:] == ["loading the numerical kernels: 10 s so far"]


def test_a_thread_watches(lines, monkeypatch):
    """A stage that never reports is heard of, and when the last one ends, so does the thread."""
    monkeypatch.setattr(log, "EVERY", 0.05)
    real = Log(lines.append)
    before = threading.active_count()
    with real.stage("silent"), real.stage("deep inside"):
        deadline = time.monotonic() + 30
        while len(lines) < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert all(line.startswith("deep inside") for line in lines[:3])
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert threading.active_count() == before
