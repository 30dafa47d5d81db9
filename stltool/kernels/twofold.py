"""Sums of two doubles [Dekker71]."""

from __future__ import annotations

from stltool.kernels.jit import kernel

_SPLIT = 134217729.0  # 2^27 + 1


@kernel
def product(a: float, b: float) -> tuple[float, float]:
    """a·b as a sum of two doubles, exactly, if nothing over- or underflows."""
    p = a * b
    c = _SPLIT * a
    ah = c - (c - a)
    al = a - ah
    c = _SPLIT * b
    bh = c - (c - b)
    bl = b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl
