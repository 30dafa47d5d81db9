"""What must be remembered to judge a run: Formula → TaskAutomaton."""

from stltool.automata.automaton import FALSE, TRUE, UNDECIDED, Part, TaskAutomaton
from stltool.automata.compile import Encoding, compile_automaton
from stltool.automata.joint import JointAutomaton, join_automata

__all__ = [
    "FALSE", "TRUE", "UNDECIDED", "Encoding", "JointAutomaton", "Part", "TaskAutomaton", "compile_automaton",
    "join_automata",
]  # fmt: skip
