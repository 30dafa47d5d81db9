"""Formula → TaskAutomaton: the memory needed to judge a run."""

from stltool.automata.automaton import FALSE, TRUE, UNDECIDED, Part, Remembered, TaskAutomaton, Text, Track
from stltool.automata.compile import Encoding, compile_automaton
from stltool.automata.joint import JointAutomaton, join_automata

__all__ = [
    "FALSE", "TRUE", "UNDECIDED", "Encoding", "JointAutomaton", "Part", "Remembered", "TaskAutomaton", "Text", "Track",
    "compile_automaton", "join_automata",
]  # fmt: skip
