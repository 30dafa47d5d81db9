"""How numba compiles our kernels: the same code in about half the time.

    calls     numba asks each of an operator's dozens of implementations whether it takes the arguments, for every call
              in a kernel; here, the one that took arguments of such types before is asked first
    flags     the compiler's flags are part of the keys of that search; numba compares their fifty values one by one
    parts     a function that only kernels call is compiled into its callers, and optimised there: it needs neither an
              entry for Python nor the second, expensive half of the optimisation
    literals  numba compiles a function again for each constant that a caller hands to it

All of this holds while a kernel of ours is compiled, and for nobody else's. These are no public names of numba: where
a version of it has other ones, it compiles as it always does.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from typing import Any

from numba.core import errors, types, utils
from numba.core.compiler import Compiler, Flags
from numba.core.registry import CPUDispatcher
from numba.core.target_extension import get_local_target
from numba.core.targetconfig import TargetConfig
from numba.core.types.functions import BaseFunction

_PLAIN = (types.Number, types.Boolean, types.Array, types.BaseTuple, types.NumberClass, types.DType, types.SliceType)
"""Types of arguments that say all there is to know: whether an implementation takes them does not change."""

_numbas_call_type: Callable[..., Any] = BaseFunction.get_call_type
_numbas_equal: Callable[..., Any] = TargetConfig.__eq__
_numbas_hash: Callable[..., int] = TargetConfig.__hash__
_hashes: dict[type, int] = {}


def _call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:
    """The signature of a call, as `BaseFunction.get_call_type` finds it."""
    if kws or not all(isinstance(arg, _PLAIN) for arg in args):
        return _numbas_call_type(self, context, args, kws)
    taken_by = vars(self).setdefault("_stltool_taken_by", {})  # of types, which numba keeps
    key = context, tuple(args)
    known = taken_by.get(key)
    if known is not None:
        signature = _asked(self, context, args, *known)
        if signature is not None:
            return signature
    for template in utils.order_by_target_specificity(get_local_target(context), self.templates, fnkey=self.key[0]):
        for literal in (True, False) if template.prefer_literal else (False, True):
            signature = _asked(self, context, args, template, literal)
            if signature is not None:
                taken_by[key] = template, literal
                return signature
    return _numbas_call_type(self, context, args, kws)  # for its message


def _asked(function: Any, context: Any, args: Any, template: Any, literal: bool) -> Any:
    asked = template(context)
    try:
        signature = asked.apply(args if literal else tuple(types.unliteral(arg) for arg in args), {})
    except errors.NumbaError:
        return None
    if signature is not None:
        function._impl_keys[signature.args] = asked.get_impl_key(signature)
    return signature


def _equal(self: Any, other: Any) -> Any:
    if self is other or (type(self) is type(other) and self._values == other._values):
        return True
    return _numbas_equal(self, other)


def _hash(self: Any) -> int:
    """That of numba, which is of the flags' names alone."""
    kind = type(self)
    if kind not in _hashes:
        _hashes[kind] = _numbas_hash(self)
    return _hashes[kind]


_quicker: list[tuple[Any, str, Callable[..., Any]]] = [(BaseFunction, "get_call_type", _call_type)]
if hasattr(Flags(), "_values") and hash(Flags()) == hash(tuple(sorted(Flags.options))):
    _quicker += [(TargetConfig, "__eq__", _equal), (TargetConfig, "__hash__", _hash)]
_depth = 0


@contextlib.contextmanager
def quickly() -> Iterator[None]:
    """Compiling in this block is quick; numba's lock is held."""
    global _depth
    if _depth == 0:
        before = [(owner, name, vars(owner)[name]) for owner, name, _ in _quicker]
        for owner, name, function in _quicker:
            setattr(owner, name, function)
    _depth += 1
    try:
        yield
    finally:
        _depth -= 1
        if _depth == 0:
            for owner, name, function in before:
                setattr(owner, name, function)


class KernelCompiler(Compiler):
    """Compiles a kernel that Python calls."""

    def compile_extra(self, func: Any) -> Any:
        with quickly():
            return super().compile_extra(func)  # type: ignore[no-untyped-call]


class PartCompiler(KernelCompiler):
    """Compiles a function that only kernels call."""

    def compile_extra(self, func: Any) -> Any:
        library = self.state.targetctx.codegen().create_library(func.__qualname__)
        library.enable_object_caching()
        library._optimize_final_module = functools.partial(_optimize_for_callers, library)
        self.state.library = library
        return super().compile_extra(func)


def _optimize_for_callers(library: Any) -> None:
    """The first half of `CPUCodeLibrary._optimize_final_module`, or all of it."""
    of = library._codegen
    try:
        passes, builder = of._module_pass_manager(
            loop_vectorize=of._loopvect, slp_vectorize=False, opt=of._opt_level, cost="cheap"
        )
        run = functools.partial(passes.run, library._final_module, builder)
    except (AttributeError, TypeError):
        run = functools.partial(type(library)._optimize_final_module, library)
    run()


class Kernel(CPUDispatcher):
    """What numba makes of a kernel."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """For callers that are compiled: 0 and False are numbers like any other, not types of their own."""
        return super().get_call_template(
            tuple(types.unliteral(arg) for arg in args), {name: types.unliteral(arg) for name, arg in kws.items()}
        )


class Part(Kernel):
    """What it makes of a function that only kernels call: Python has no entry to the code, and runs its Python."""

    def __call__(self, *args: Any, **kws: Any) -> Any:
        return self.py_func(*args, **kws)
