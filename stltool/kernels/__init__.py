"""Numba loops: arrays in, arrays out; they import nothing of stltool. `.py_func` is each one's slow twin.

Compiled once per machine (`cache=True`); importing this package alone loads nothing.
"""


def warm_up() -> None:
    """Load every kernel; the first call on a machine compiles them, some seconds."""
    from stltool.kernels import learning, sweep

    sweep.warm_up()
    learning.warm_up()
