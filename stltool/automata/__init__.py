"""What must be remembered to judge a run: Formula → TaskAutomaton."""

from stltool.automata.automaton import FALSE, TRUE, UNDECIDED, Part, TaskAutomaton
from stltool.automata.compile import Encoding, compile_automaton

__all__ = ["FALSE", "TRUE", "UNDECIDED", "Encoding", "Part", "TaskAutomaton", "compile_automaton"]
