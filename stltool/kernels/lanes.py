"""Vectors of eight numbers as values in numba kernels: `Lanes`, and their operations.

numba keeps the best value and the best choice of an inner loop in memory, however it vectorises the loop; as `Lanes`
they stay in registers. LLVM maps eight lanes to the processor's registers: one AVX-512 register, two of AVX2, four of
SSE2. Products and sums are not contracted into one rounding, so results are the same on every machine.

    load, store          eight numbers of an array from index i on       at, put       one number
    splat, splat_at      one number in every lane                        gather        arr[index[i]], …, arr[index[i+7]]
    mul, add, sub, both  x·y, x+y, x−y; m ∧ n of masks                   greater       x > y, a mask
    select               x where the mask holds, y elsewhere             mask          a byte, bit i for lane i
    narrow_where         arr[i …] = integers, where the mask holds, in the array's own type
    any_bit              whether any lane is not 0           greatest      of the eight numbers, none of them NaN
    ceil_div             ⌈x / d⌉ of integers without a division, since processors have no vector division
    popcount, trailing   of one 64-bit word; `trailing` of 0 is undefined

Indices are not wrapped around and not checked: callers keep them within the array.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, register_model

from stltool.kernels.jit import kernel

N = 8
_BIT, _BYTE, _WORD = ir.IntType(1), ir.IntType(8), ir.IntType(64)
_ELEMENTS = {types.float64: ir.DoubleType(), types.int64: _WORD, types.uint64: _WORD, types.boolean: _BIT}


class Lanes(types.Type):
    """Eight numbers of one type; `elem` boolean is a mask."""

    def __init__(self, elem: Any) -> None:
        self.elem = elem
        super().__init__(name=f"Lanes({elem}, {N})")


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, lanes: Lanes) -> None:
        super().__init__(manager, lanes, ir.VectorType(_ELEMENTS[lanes.elem], N))


_MASK, _INTEGERS, _DOUBLES = Lanes(types.boolean), Lanes(types.int64), Lanes(types.float64)


def _is_double(signature: Any) -> bool:
    return bool(signature.args[0].elem == types.float64)


def _pointer(context: Any, builder: Any, kind: Any, array: Any, index: Any, to: Any = None) -> Any:
    """The address of array[index], as one of vectors of type `to`."""
    start = context.make_array(kind)(context, builder, array).data
    address = builder.gep(start, [index])
    return address if to is None else builder.bitcast(address, to.as_pointer())


def _all_lanes(builder: Any, vector: Any, number: Any) -> Any:
    one = builder.insert_element(ir.Constant(vector, ir.Undefined), number, ir.IntType(32)(0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), N), [0] * N)
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), zeros)


@intrinsic
def load(typing, arr, i):
    signature = Lanes(arr.dtype)(arr, types.intp)

    def generate(context, builder, sig, args):
        vector = context.get_value_type(sig.return_type)
        return builder.load(_pointer(context, builder, sig.args[0], args[0], args[1], vector), align=8)

    return signature, generate


@intrinsic
def store(typing, arr, i, x):
    signature = types.void(arr, types.intp, x)

    def generate(context, builder, sig, args):
        vector = context.get_value_type(sig.args[2])
        builder.store(args[2], _pointer(context, builder, sig.args[0], args[0], args[1], vector), align=8)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def at(typing, arr, i):
    signature = arr.dtype(arr, types.intp)

    def generate(context, builder, sig, args):
        stored = builder.load(_pointer(context, builder, sig.args[0], args[0], args[1]))
        return context.data_model_manager[sig.return_type].from_data(builder, stored)  # a Boolean takes a byte

    return signature, generate


@intrinsic
def put(typing, arr, i, x):
    signature = types.void(arr, types.intp, arr.dtype)

    def generate(context, builder, sig, args):
        builder.store(args[2], _pointer(context, builder, sig.args[0], args[0], args[1]))
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def splat(typing, x):
    signature = Lanes(x)(x)

    def generate(context, builder, sig, args):
        return _all_lanes(builder, context.get_value_type(sig.return_type), args[0])

    return signature, generate


@intrinsic
def splat_at(typing, arr, i):
    signature = Lanes(arr.dtype)(arr, types.intp)

    def generate(context, builder, sig, args):
        number = builder.load(_pointer(context, builder, sig.args[0], args[0], args[1]))
        return _all_lanes(builder, context.get_value_type(sig.return_type), number)

    return signature, generate


@intrinsic
def gather(typing, arr, index, i):
    signature = Lanes(arr.dtype)(arr, index, types.intp)

    def generate(context, builder, sig, args):
        result = ir.Constant(context.get_value_type(sig.return_type), ir.Undefined)
        for lane in range(N):
            which = builder.add(args[2], _WORD(lane))
            place = builder.load(_pointer(context, builder, sig.args[1], args[1], which))
            place = place if place.type == _WORD else builder.zext(place, _WORD)
            number = builder.load(_pointer(context, builder, sig.args[0], args[0], place))
            result = builder.insert_element(result, number, ir.IntType(32)(lane))
        return result

    return signature, generate


def _arithmetic(double: str, integer: str) -> Any:
    @intrinsic
    def operation(typing, x, y):
        def generate(context, builder, sig, args):
            return getattr(builder, double if _is_double(sig) else integer)(*args)

        return x(x, y), generate

    return operation


mul, add, sub = _arithmetic("fmul", "mul"), _arithmetic("fadd", "add"), _arithmetic("fsub", "sub")
both = _arithmetic("", "and_")


@intrinsic
def greater(typing, x, y):
    def generate(context, builder, sig, args):
        return builder.fcmp_ordered(">", *args) if _is_double(sig) else builder.icmp_signed(">", *args)

    return _MASK(x, y), generate


@intrinsic
def select(typing, mask, x, y):
    def generate(context, builder, sig, args):
        return builder.select(*args)

    return x(mask, x, y), generate


@intrinsic
def mask(typing, byte):
    def generate(context, builder, sig, args):
        return builder.bitcast(args[0], ir.VectorType(_BIT, N))

    return _MASK(types.uint8), generate


@intrinsic
def any_bit(typing, x):
    def generate(context, builder, sig, args):
        nonzero = builder.icmp_unsigned("!=", args[0], ir.Constant(args[0].type, None))
        return builder.icmp_unsigned("!=", builder.bitcast(nonzero, _BYTE), _BYTE(0))

    return types.boolean(x), generate


@intrinsic
def greatest(typing, x):
    def generate(context, builder, sig, args):
        found, width = args[0], N // 2
        while width:
            order = ir.Constant(ir.VectorType(ir.IntType(32), N), [(lane + width) % N for lane in range(N)])
            other = builder.shuffle_vector(found, found, order)
            found = builder.select(builder.fcmp_ordered(">", found, other), found, other)
            width //= 2
        return builder.extract_element(found, ir.IntType(32)(0))

    return x.elem(x), generate


@intrinsic
def narrow_where(typing, arr, i, where, x):
    signature = types.void(arr, types.intp, where, x)

    def generate(context, builder, sig, args):
        element = context.get_value_type(sig.args[0].dtype)
        vector = ir.VectorType(element, N)
        address = _pointer(context, builder, sig.args[0], args[0], args[1], vector)
        narrow = builder.trunc(args[3], vector) if element.width < 64 else args[3]
        old = builder.load(address, align=1)
        builder.store(builder.select(args[2], narrow, old), address, align=1)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def _to_double(typing, x):
    def generate(context, builder, sig, args):
        return builder.sitofp(args[0], context.get_value_type(sig.return_type))

    return _DOUBLES(x), generate


@intrinsic
def _to_integer(typing, x):
    def generate(context, builder, sig, args):
        kind = builder.zext if sig.args[0] == _MASK else builder.fptosi
        return kind(args[0], context.get_value_type(sig.return_type))

    return _INTEGERS(x), generate


@intrinsic
def popcount(typing, word):
    def generate(context, builder, sig, args):
        return builder.ctpop(args[0])

    return types.int64(types.uint64), generate


@intrinsic
def trailing(typing, word):
    def generate(context, builder, sig, args):
        return builder.cttz(args[0], _BIT(1))

    return types.int64(types.uint64), generate


@kernel
def ceil_div(x, d, inverse):
    """⌈x / d⌉ for 0 ≤ x < 2^62 and 0 < d < 2^31, d and the double 1/d in every lane.

    Two quotients in doubles leave a remainder below 2·d, resolved by comparisons.
    """
    y = _to_integer(mul(_to_double(x), inverse))
    y = add(y, _to_integer(mul(_to_double(sub(x, mul(y, d))), inverse)))
    zero = sub(d, d)
    y = add(y, _to_integer(greater(sub(x, mul(y, d)), zero)))
    y = add(y, _to_integer(greater(sub(x, mul(y, d)), zero)))
    return sub(y, _to_integer(greater(sub(mul(y, d), x), sub(d, splat(np.int64(1))))))
