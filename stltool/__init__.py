"""stltool: signal temporal logic tasks on Markov decision processes, learned and verified exactly. START HERE.

    >>> import stltool as stl
    >>> phi = stl.parse("G[0,5) (F[0,5) A & F[0,5) B)")         # text → Formula; str(phi) parses back
    >>> print(phi, stl.horizon(phi))
    G[0,4] ((F[0,4] A) & (F[0,4] B)) 8
    >>> stay = [[1, 0], [0, 1]]; swap = [[0.1, 0.9], [0.8, 0.2]]
    >>> model = stl.MDP.from_arrays([stay, swap], {"x": [0.0, 1.0]}, labels={"A": [1, 0], "B": [0, 1]})
    >>> product = stl.build_product(model, phi)                  # MDP × automaton of the task
    >>> best = stl.check(product)                                # exact optimum, with its policy and enclosure
    >>> print(f"{best.lower:.6f} <= {best.probability:.6f} <= {best.upper:.6f}")
    0.996815 <= 0.996815 <= 0.996815
    >>> run = stl.learn(product, episodes=100, seed=0)           # never sees the probabilities
    >>> stl.check(product, run.policy).probability <= best.upper
    True

The path through the package, and a map in reading order:

    logic/        text → Formula: grammar, parser, printer, rewriting, semantics (the oracle), the paper's fragment
    monitoring/   recorded traces → truth and robustness at every step
    automata/     Formula → TaskAutomaton: the memory needed to judge a run; whether a formula can hold and fail at all
    diagnosis/    why a trace satisfies a formula at a step, or violates it: causes, and reasons in sentences
    models/       a file, arrays or a Gymnasium environment → MDP; MDP → an environment to reset and step
    product.py    MDP × TaskAutomaton, never built as a matrix
    policy.py     a table over (t?, s, q), saved and loaded without pickle; written.py: as text that people edit
    transfer.py   a policy on another model with the same names
    checking/     the exact probability of the best policy, or of a given one, with bounds; estimates from runs
    gate.py       whether task files keep what they expect
    recheck.py    re-checks certificates of those bounds; imports nothing from stltool
    learning/     policies from experience only, and guarantees from its data
    exporting/    a product as an MDP of its own, for PRISM, Storm and other tools
    reporting/    results → JSON, HTML, terminal
    cli/          the same from the command line
    kernels/      numba loops; testing/  strategies and assertions for users' own tests; pytest_plugin.py  for pytest

"The paper" is [Wang24]: S. Wang, Xunyuan Yin, S. Li and Xiang Yin, Tractable Reinforcement Learning for Signal Temporal
Logic Tasks With Counterfactual Experience Replay, IEEE Control Systems Letters 8, 2024, DOI 10.1109/LCSYS.2024.3397844.
docs/references.md lists this and the other keys in brackets; docs/semantics.md has the definitions behind it all.
"""

import sys

import lazy_loader

__version__ = "0.1.0"

# __init__.pyi lists the public names and where each is loaded from on first use, so that `import stltool` stays light
_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name not in __all__:  # raised such that Python adds "Did you mean"
        raise AttributeError(f"module 'stltool' has no attribute {name!r}", name=name, obj=sys.modules[__name__])
    return _load(name)
