"""Models: a model file or arrays → MDP; an MDP → an environment that can only be reset and stepped."""

from stltool.models.composition import compose
from stltool.models.costs import Cost
from stltool.models.gymnasium import from_gymnasium
from stltool.models.intervals import Intervals
from stltool.models.load import load_model
from stltool.models.mdp import MDP, GridLayout
from stltool.models.save import save_model

__all__ = ["MDP", "Cost", "GridLayout", "Intervals", "compose", "from_gymnasium", "load_model", "save_model"]
