"""A sample as Python has it, read and judged in one compiled call: `OnlineMonitor.feed` of a dict of floats.

numba's own calls convert arguments and results, which takes longer than a sample does. `feed_sample` has the signature
of a C function of Python, f(self, arguments, their number, names of keywords) → object, and uses the functions of
Python's C API; `bound` makes a built-in function of it, whose `self` is a tuple:

    address of the root (streams.py), dict, float, bool, True, False, None, Decision, Decisions, "_runs",
    the method for all else, names …

Whatever is not a dict of floats and truth values, or is refused, goes to that method, with nothing changed. Objects of
Python are integers here: their addresses. A returned object belongs to the caller; PyTuple_GetItem and
PyDict_GetItemWithError lend theirs; PyTuple_SetItem and PyList_SetItem take theirs.

Needs a Python whose objects begin with a count and a type, and whose tuples have nothing but a size before their items
(CPython up to 3.13, not the free-threaded one), on a 64-bit system: elsewhere `bound` returns None.
"""

from __future__ import annotations

import ctypes
import functools
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types

from stltool.kernels import streams as k
from stltool.kernels.streams import _doubles, _integers, _sets, entry, part
from stltool.kernels.told import FULL, NOTHING, REFUSED

ROOT, DICT, FLOAT, BOOL, TRUE, FALSE, NONE, DECISION, DECISIONS, RUNS, METHOD, NAMES = range(12)  # items of `self`
_object, _size, _int = types.intp, types.intp, types.int32


def _python(name: str, result: Any, *arguments: Any) -> Any:
    """A function of Python's C API."""
    return types.ExternalFunction(name, result(*arguments))


_tuple_item = _python("PyTuple_GetItem", _object, _object, _size)
_set_tuple_item = _python("PyTuple_SetItem", _int, _object, _size, _object)
_dict_item = _python("PyDict_GetItemWithError", _object, _object, _object)
_clear_error = _python("PyErr_Clear", types.void)
_address_in = _python("PyLong_AsVoidPtr", types.intp, _object)
_double_in = _python("PyFloat_AsDouble", types.float64, _object)
_list = _python("PyList_New", _object, _size)
_set_list_item = _python("PyList_SetItem", _int, _object, _size, _object)
_allocated = _python("PyType_GenericAlloc", _object, _object, _size)
_integer = _python("PyLong_FromLongLong", _object, types.int64)
_float = _python("PyFloat_FromDouble", _object, types.float64)
_bytes = _python("PyBytes_FromStringAndSize", _object, types.intp, _size)
_set_attribute = _python("PyObject_SetAttr", _int, _object, _object, _object)
_keep = _python("Py_IncRef", types.void, _object)
_drop = _python("Py_DecRef", types.void, _object)
_called = _python("PyObject_Vectorcall", _object, _object, types.intp, _size, _object)


@part
def _type_of(x: int) -> Any:
    return _integers(x, 2)[1]


@part
def _decision(given: int, code: int, margin: float) -> Any:
    """A Decision of a code (streams.py); 0 with an exception set, if there is no memory."""
    made = _allocated(_tuple_item(given, DECISION), 3)
    if made == 0:
        return made
    step = _integer(code >> 3)
    verdict = _tuple_item(given, TRUE if code & 2 != 0 else FALSE)
    _keep(verdict)
    if code & 4 != 0:
        robustness = _float(margin)
    else:
        robustness = _tuple_item(given, NONE)
        _keep(robustness)
    _set_tuple_item(made, 0, step)
    _set_tuple_item(made, 1, verdict)
    _set_tuple_item(made, 2, robustness)
    return made


@entry
def feed_sample(given: int, arguments: int, n: int, keywords: int) -> Any:
    """The decisions that a sample yields: a list of at most one, or Decisions; 0 if an exception is set.

    The call has n arguments, which begin at an address, and names those of `keywords`, a tuple, if it is not 0.
    """
    method = _tuple_item(given, METHOD)
    if n != 1 or keywords != 0:
        return _called(method, arguments, n, keywords)
    sample = _integers(arguments, 1)[0]
    t = _integers(_address_in(_tuple_item(given, ROOT)), k.ROOT)
    N, F = _integers(t[0], t[1]), _doubles(t[2], t[3])
    if _type_of(sample) != _tuple_item(given, DICT):
        return _called(method, arguments, 1, 0)
    is_float, is_bool, true = _tuple_item(given, FLOAT), _tuple_item(given, BOOL), _tuple_item(given, TRUE)
    values = N[k.VALUES]
    for i in range(N[k.N_NAMES]):
        value = _dict_item(sample, _tuple_item(given, NAMES + i))
        if value == 0:
            _clear_error()
            return _called(method, arguments, 1, 0)
        kind = _type_of(value)
        if kind == is_float:
            F[values + i] = _double_in(value)
        elif kind == is_bool:
            F[values + i] = 1.0 if value == true else 0.0
        else:
            return _called(method, arguments, 1, 0)
    code = k.advance(N, F, _sets(t[4], t[5]))
    if code == NOTHING:
        return _list(0)
    margin = F[N[k.MARGIN] + N[k.RESULT]]
    if code > 0:
        found = _list(1)
        if found != 0:
            made = _decision(given, code, margin)
            if made == 0:
                _drop(found)
                return made
            _set_list_item(found, 0, made)
        return found
    if code in (REFUSED, FULL):
        return _called(method, arguments, 1, 0)
    # more than one: runs of them, which are decoded when they are looked at
    runs = _bytes(8 * N[k.TOLD_NOW] + t[0], 16 * N[k.TOLD])
    if runs == 0:
        return runs
    found = _allocated(_tuple_item(given, DECISIONS), 0)
    if found != 0:
        _set_attribute(found, _tuple_item(given, RUNS), runs)
    _drop(runs)
    return found


class _Definition(ctypes.Structure):
    """PyMethodDef."""

    _fields_ = (
        ("name", ctypes.c_char_p), ("function", ctypes.c_void_p), ("flags", ctypes.c_int), ("doc", ctypes.c_char_p),
    )  # fmt: skip


_FAST = 0x80 | 0x02  # METH_FASTCALL | METH_KEYWORDS


def _has_the_layout() -> bool:
    """Whether objects and tuples are laid out as `feed_sample` takes for granted."""
    if sys.implementation.name != "cpython" or np.dtype(np.intp).itemsize != 8:
        return False
    if object.__basicsize__ != 16 or tuple.__basicsize__ != 24:
        return False
    return ctypes.c_void_p.from_address(id(1.5) + 8).value == id(float)


def bound(self: tuple[Any, ...], doc: str) -> Callable[[Any], Any] | None:
    """`feed_sample` of this `self` as a function of Python; None where it cannot be made."""
    definition = _defined(doc) if hasattr(feed_sample, "py_func") and _has_the_layout() else None
    if definition is None:
        return None
    make = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p)(
        ("PyCFunction_NewEx", ctypes.pythonapi)
    )
    # the definition must outlive the function
    made: Callable[[Any], Any] = make(ctypes.addressof(definition), (*self, definition), None)
    return made


@functools.cache
def _defined(doc: str) -> _Definition | None:
    address = _address()
    return None if address is None else _Definition(b"feed", address, _FAST, doc.encode())


def _address() -> int | None:
    """Where the code of `feed_sample` is, as C calls it; None if numba does not say."""
    compiled: Any = feed_sample
    signature = (types.intp,) * 4
    compiled.compile(signature)
    try:
        overload = compiled.overloads[signature]
        return int(overload.library.get_pointer_to_function(overload.fndesc.llvm_cfunc_wrapper_name))
    except AttributeError:  # these are no public names
        return None
