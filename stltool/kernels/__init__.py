"""Numba loops: arrays in, arrays out; they import nothing from stltool. `.py_func` is the slow twin of each.

All are declared with `jit.kernel`: compiled once per machine, and again if a source here changes. Importing this
package loads nothing else.
"""

from stltool.kernels import jit  # first, so that it sees the sources before they are read

__all__ = ["jit", "warm_up"]


def warm_up(learning: bool = True, rollouts: bool = False) -> None:
    """Load the requested kernels; the first call on a machine compiles them, which takes some seconds.

    Those of checking are loaded when an induction is large enough to need them.
    """
    if learning:
        from stltool.kernels import learning as learners

        learners.warm_up()
    if rollouts:
        from stltool.kernels import rollout

        rollout.warm_up()
