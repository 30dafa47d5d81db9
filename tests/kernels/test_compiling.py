"""Kernels are compiled quickly, and into what numba makes of them."""

import operator

import numpy as np
import pytest
from numba.core import types
from numba.core.compiler import Flags
from numba.core.registry import cpu_target
from numba.core.targetconfig import TargetConfig
from numba.core.types.functions import BaseFunction

from stltool.kernels import cache, compiling, jit

OPERATORS = [
    operator.add,
    operator.floordiv,
    operator.truediv,
    operator.lshift,
    operator.lt,
    operator.eq,
    operator.and_,
]
NUMBERS = [types.int64, types.int32, types.uint64, types.float64, types.boolean, types.literal(3)]
ROW = types.Array(types.float64, 1, "C")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Where the kernels of these tests are kept."""
    monkeypatch.setattr(cache, "_folders", lambda: ([tmp_path], tmp_path))


@pytest.fixture
def context():
    found = cpu_target.typing_context
    found.refresh()
    return found


def asked(context, function, args):
    """The signature of a call and what implements it, or the kind of the error."""
    try:
        signature = function.get_call_type(context, args, {})
    except Exception as fault:
        return type(fault)
    return signature, function.get_impl_key(signature)


@pytest.mark.parametrize("function", OPERATORS, ids=lambda function: function.__name__)
def test_calls_are_what_numba_says(context, function):
    kind = context.resolve_value_type(function)
    calls = [(a, b) for a in NUMBERS for b in [*NUMBERS, ROW]]
    wanted = [asked(context, kind, args) for args in calls]
    for _ in range(2):  # found out, and known
        with compiling.quickly():
            assert [asked(context, kind, args) for args in calls] == wanted
    assert any(isinstance(found, tuple) for found in wanted)


def test_flags_are_equal_when_numba_says_so():
    kinds = [Flags() for _ in range(5)]
    kinds[1].nrt, kinds[2].nrt, kinds[3].no_cfunc_wrapper, kinds[4].release_gil = True, False, True, True
    wanted = [[(one == other, hash(one) == hash(other)) for other in kinds] for one in kinds]
    hashes = [hash(one) for one in kinds]
    with compiling.quickly():
        assert [[(one == other, hash(one) == hash(other)) for other in kinds] for one in kinds] == wanted
        assert [hash(one) for one in kinds] == hashes
        assert kinds[0] != "flags"


def test_numba_is_left_as_it_was():
    def numbas():
        return BaseFunction.get_call_type, TargetConfig.__eq__, TargetConfig.__hash__

    before = numbas()
    with compiling.quickly():
        assert all(mine is not other for mine, other in zip(numbas(), before, strict=True))
        with compiling.quickly():
            pass
        assert numbas() != before
    assert numbas() == before
    with pytest.raises(ZeroDivisionError), compiling.quickly():
        raise ZeroDivisionError
    assert numbas() == before
    assert whole(3) == 7
    assert numbas() == before


@jit.part
def _twice(x, more):
    return 2 * x + more


@jit.kernel
def whole(x):
    return _twice(x, 1)


@jit.kernel
def both(x):
    return _twice(x, 1) + _twice(x, 2) + _twice(x, x)


def test_a_part_is_for_kernels():
    assert both(np.int64(5)) == 38
    assert len(_twice.signatures) == 1  # whatever constants its callers hand to it
    assert (_twice(2, 1), _twice(2.5, more=1)) == (5, 6)  # by Python
    assert both.py_func(5) == 38
    assert len(_twice.signatures) == 1


def test_a_numba_of_other_names_compiles_as_it_does():
    done = []

    class Library:
        def __init__(self, codegen):
            self._codegen = codegen

        def _optimize_final_module(self):
            done.append(self)

    for codegen in (None, types):  # without its parts
        library = Library(codegen)
        compiling._optimize_for_callers(library)
        assert done.pop() is library
