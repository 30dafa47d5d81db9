"""Numba loops: arrays in, arrays out; they import nothing of stltool. `.py_func` is each one's slow twin.

All are declared with `jit.kernel`: compiled once per machine, again when a source here changes. Importing this package
alone loads nothing else.
"""

from stltool.kernels import jit  # first, so that it sees the sources before they are read

__all__ = ["jit", "warm_up"]


def warm_up(learning: bool = True, rollouts: bool = False) -> None:
    """Load the kernels asked for; the first call on a machine compiles them, some seconds.

    Those of checking are loaded when an induction is large enough to want them.
    """
    if learning:
        from stltool.kernels import learning as learners

        learners.warm_up()
    if rollouts:
        from stltool.kernels import rollout

        rollout.warm_up()
