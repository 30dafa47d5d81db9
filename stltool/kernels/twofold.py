"""Sums of two doubles [Dekker71]."""

from __future__ import annotations

from typing import Any

from llvmlite import binding
from numba import types
from numba.extending import intrinsic

from stltool.kernels.jit import compiles, part

_SPLIT = 134217729.0  # 2^27 + 1
_FUSED = compiles() and bool(binding.get_host_cpu_features().get("fma", False))


def _rounded_once(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """a·b + c."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), generate


_fused: Any = intrinsic(_rounded_once)


@part
def product(a: float, b: float) -> tuple[float, float]:
    """a·b as a sum of two doubles, exactly, if nothing over- or underflows."""
    p = a * b
    if _FUSED:
        return p, _fused(a, b, -p)
    c = _SPLIT * a
    ah = c - (c - a)
    al = a - ah
    c = _SPLIT * b
    bh = c - (c - b)
    bl = b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl
