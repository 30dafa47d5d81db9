"""The one backward induction (induct.py): engines define where to compute, arithmetics define how."""

from stltool.checking.induction.allowed import EVERYTHING, Allowed, Among, Following, Silent
from stltool.checking.induction.arithmetic import (
    Arithmetic,
    Digits,
    Doubles,
    ExactNature,
    Fixed,
    Integers,
    Nature,
    Probabilities,
    Values,
)
from stltool.checking.induction.blocks import ClusterWay, solve_on_cluster
from stltool.checking.induction.edges import OPEN, REST, SURE, Edges
from stltool.checking.induction.graph import Game, Single
from stltool.checking.induction.induct import Engine, Solution, Way, induct, layers_of, solve
from stltool.checking.induction.layers import Budget, Layers, Progress
from stltool.checking.induction.reached import Stretch
from stltool.checking.induction.recording import OnDisk, Passed, Recorder, files_beside, key_of, stopped_in
from stltool.checking.induction.tied import At, Bernstein, ExactAt, ExactBernstein, Tied
from stltool.checking.induction.words import Words

__all__ = [
    "EVERYTHING", "OPEN", "REST", "SURE", "Allowed", "Among", "Arithmetic", "At", "Bernstein", "Budget", "ClusterWay",
    "Digits", "Doubles", "Edges", "Engine", "ExactAt", "ExactBernstein", "ExactNature", "Fixed", "Following", "Game",
    "Integers", "Layers", "Nature", "OnDisk", "Passed", "Probabilities", "Progress", "Recorder", "Silent", "Single",
    "Solution", "Stretch", "Tied", "Values", "Way", "Words", "files_beside", "induct", "key_of", "layers_of", "solve",
    "solve_on_cluster", "stopped_in",
]  # fmt: skip
