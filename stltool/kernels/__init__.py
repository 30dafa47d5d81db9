"""Numba loops: arrays in, arrays out; they import nothing from stltool. `.py_func` is the slow twin of each.

All are declared with `jit.kernel`, or `jit.part` if only kernels call them: compiled once per machine, and again if a
source here changes. Importing this package loads nothing else.
"""

from typing import Literal, TypeAlias

from stltool.kernels import jit  # first, so that it sees the sources before they are read

__all__ = ["Group", "jit", "warm_up"]

Group: TypeAlias = Literal["published", "clocked", "plans", "rollouts"]
"""Kernels that are needed together: those of the methods as published, of tables with the clock, of plans over counted
transitions, of fresh runs."""


def warm_up(*groups: Group) -> None:
    """Load the requested kernels; the first call on a machine compiles them, which takes some seconds.

    Those of checking are loaded when an induction is large enough to need them.
    """
    for group in groups:
        if group == "rollouts":
            from stltool.kernels import rollout

            rollout.warm_up()
        elif group == "plans":
            from stltool.kernels import exploring, planning

            planning.warm_up()
            exploring.warm_up()
        else:
            from stltool.kernels import learning

            learning.WARM_UP[group]()
