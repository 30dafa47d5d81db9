"""Policies learned without the model: one learner per file; they share a schedule, a replay memory and a trainer."""

from stltool.learning.cfer import Cfer, PublishedCfer
from stltool.learning.cfper import PublishedCfper
from stltool.learning.counts import Counts
from stltool.learning.episode import Episode
from stltool.learning.gap import Gap, optimality_gap
from stltool.learning.guarantee import Guarantee, guarantee
from stltool.learning.kept import Kept
from stltool.learning.learn import Training, learn
from stltool.learning.learner import Learner
from stltool.learning.markov import MarkovTest, markov_test
from stltool.learning.methods import LEARNERS, METHODS
from stltool.learning.model_based import ModelBased
from stltool.learning.naive import Naive, PublishedNaive
from stltool.learning.naive_er import NaiveER, PublishedNaiveER
from stltool.learning.problem import Problem
from stltool.learning.settings import Budget, setting
from stltool.learning.sweep import Sweep, SweepResult, run_sweep
from stltool.learning.sweep_file import load_sweep

__all__ = [
    "LEARNERS", "METHODS", "Budget", "Cfer", "Counts", "Episode", "Gap", "Guarantee", "Kept", "Learner",
    "MarkovTest", "ModelBased", "Naive", "NaiveER", "Problem", "PublishedCfer", "PublishedCfper", "PublishedNaive",
    "PublishedNaiveER", "Sweep", "SweepResult", "Training", "guarantee", "learn", "load_sweep", "markov_test",
    "optimality_gap", "run_sweep", "setting",
]  # fmt: skip
