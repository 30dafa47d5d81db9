"""Products for other tools: an MDP or a chain of their own, programs of the PRISM language; automata for Graphviz."""

from stltool.exporting.explicit import ProductMDP, Question, product_mdp
from stltool.exporting.targets import TARGETS, export

__all__ = ["TARGETS", "ProductMDP", "Question", "export", "product_mdp"]
