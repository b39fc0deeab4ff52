"""The innermost steps of the gather as vector instructions, for numba kernels.

LLVM does not find these by itself: a 2x2 neighbourhood of RGBA half pixels is two vectors of eight floats, one per row.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from nearfield_server.radiometry.half import HALF_MAX

ACCUMULATOR_BYTES: Final = 32
"""Of one texel: eight float32, the left and the right pixel's (r, g, b, valid weight)."""
TAP_BYTES: Final = 8
"""Four uint16 weights per pair: top left, top right, bottom left, bottom right."""

_F32: Final = ir.FloatType()
_F64: Final = ir.DoubleType()
_I32: Final = ir.IntType(32)
_I64: Final = ir.IntType(64)
_I4: Final = ir.IntType(4)
_HALF8: Final = ir.VectorType(ir.HalfType(), 8)
_F32X8: Final = ir.VectorType(_F32, 8)
_F32X4: Final = ir.VectorType(_F32, 4)
_F64X4: Final = ir.VectorType(_F64, 4)
_I16X4: Final = ir.VectorType(ir.IntType(16), 4)
_I32X8: Final = ir.VectorType(_I32, 8)
_I64X4: Final = ir.VectorType(_I64, 4)
_FUSED: Final = ("contract",)
# Adding it to a double of magnitude below 2^51 leaves the nearest integer in the lower bits of the sum.
_ROUNDER: Final = 1.5 * 2.0**52


def _shuffle(builder: Any, vector: Any, lanes: list[int]) -> Any:
    order = ir.Constant(ir.VectorType(_I32, len(lanes)), lanes)
    return builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), order)


def _load_row(builder: Any, address: Any) -> Any:
    """Two RGBA half pixels as eight floats, cleaned, colour multiplied by validity."""
    halves = builder.load(builder.inttoptr(address, _HALF8.as_pointer()), align=2)
    values = builder.fpext(halves, _F32X8)
    zero = ir.Constant(_F32X8, [0.0] * 8)
    largest = ir.Constant(_F32X8, [HALF_MAX] * 8)
    # Ordered comparisons: NaN and negative become 0, infinity becomes the largest half. Ingest has removed them
    # already; this keeps one broken pixel from ever spreading. Compiles to one max and one min.
    values = builder.select(builder.fcmp_ordered(">", values, zero), values, zero)
    values = builder.select(builder.fcmp_ordered("<", values, largest), values, largest)
    return builder.fmul(values, _shuffle(builder, values, [3, 3, 3, 3, 7, 7, 7, 7]))


@intrinsic  # type: ignore[untyped-decorator]
def accumulate_pair(typingctx: Any, upper: Any, lower: Any, taps: Any, accumulator: Any) -> Any:
    """Add the weighted 2x2 RGBA half pixels of one texel-camera pair to the texel's accumulator.

    Args of the call in a kernel, all int64 addresses:
        upper, lower: left pixels of the two rows; 16 bytes are read at each.
        taps: `TAP_BYTES` of weights. A weight of 0 leaves nothing of its pixel.
        accumulator: `ACCUMULATOR_BYTES`, aligned. Invalid pixels (alpha 0) add nothing.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        upper_address, lower_address, tap_address, target_address = args
        weights = builder.load(builder.inttoptr(tap_address, _I16X4.as_pointer()), align=2)
        target = builder.inttoptr(target_address, _F32X8.as_pointer())
        total = builder.load(target, align=32)
        for address, left in ((upper_address, 0), (lower_address, 2)):
            lanes = _shuffle(builder, weights, [left] * 4 + [left + 1] * 4)
            weight = builder.uitofp(builder.zext(lanes, _I32X8), _F32X8)
            product = builder.fmul(_load_row(builder, address), weight, flags=_FUSED)
            total = builder.fadd(total, product, flags=_FUSED)
        builder.store(total, target, align=32)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic  # type: ignore[untyped-decorator]
def take_blend(typingctx: Any, accumulator: Any, texel: Any) -> Any:
    """Write the colour of an accumulator divided by its valid weight, 0 without any, to a texel, and clear the accumulator.

    Args of the call in a kernel, int64 addresses:
        accumulator: `ACCUMULATOR_BYTES`, aligned.
        texel: three float32; four are read.

    Returns:
        (r, g, b) float32 and whether one of them is another than before, as uint8.
    """
    result = types.Tuple((types.float32, types.float32, types.float32, types.uint8))

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        source = builder.inttoptr(args[0], _F32X8.as_pointer())
        total = builder.load(source, align=32)
        builder.store(ir.Constant(_F32X8, [0.0] * 8), source, align=32)
        folded = builder.fadd(_shuffle(builder, total, [0, 1, 2, 3]), _shuffle(builder, total, [4, 5, 6, 7]))
        weight = builder.extract_element(folded, _I32(3))
        zero, one = ir.Constant(_F32, 0.0), ir.Constant(_F32, 1.0)
        scale = builder.select(builder.fcmp_ordered(">", weight, zero), builder.fdiv(one, weight), zero)
        factor = builder.insert_element(ir.Constant(_F32X4, ir.Undefined), scale, _I32(0))
        colour = builder.fmul(folded, _shuffle(builder, factor, [0] * 4))
        old = builder.load(builder.inttoptr(args[1], _F32X4.as_pointer()), align=4)
        differs = builder.bitcast(builder.fcmp_unordered("!=", colour, old), _I4)
        differs = builder.icmp_unsigned("!=", builder.and_(differs, _I4(7)), _I4(0))
        builder.store(
            _shuffle(builder, colour, [0, 1]),
            builder.inttoptr(args[1], ir.VectorType(_F32, 2).as_pointer()),
            align=4,
        )
        blue = builder.extract_element(colour, _I32(2))
        builder.store(blue, builder.inttoptr(builder.add(args[1], _I64(8)), _F32.as_pointer()), align=4)
        members = [builder.extract_element(colour, _I32(lane)) for lane in range(2)]
        members += [blue, builder.zext(differs, ir.IntType(8))]
        return context.make_tuple(builder, result, members)

    return result(types.int64, types.int64), codegen


@intrinsic  # type: ignore[untyped-decorator]
def to_fixed_point(typingctx: Any, red: Any, green: Any, blue: Any, scale: Any) -> Any:
    """Three int64: float32 values times a float64 scale, rounded to the nearest integer; products stay below 2^51."""
    triple = types.UniTuple(types.int64, 3)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        colour = ir.Constant(_F32X4, [0.0] * 4)
        for lane in range(3):
            colour = builder.insert_element(colour, args[lane], _I32(lane))
        factor = builder.insert_element(ir.Constant(_F64X4, ir.Undefined), args[3], _I32(0))
        # No fast-math flags here: the two roundings are what makes the integer.
        product = builder.fmul(builder.fpext(colour, _F64X4), _shuffle(builder, factor, [0] * 4))
        sums = builder.bitcast(builder.fadd(product, ir.Constant(_F64X4, [_ROUNDER] * 4)), _I64X4)
        offset = int(np.float64(_ROUNDER).view(np.int64))
        whole = builder.sub(sums, ir.Constant(_I64X4, [offset] * 4))
        result = context.get_constant_undef(triple)
        for lane in range(3):
            result = builder.insert_value(result, builder.extract_element(whole, _I32(lane)), lane)
        return result

    return triple(types.float32, types.float32, types.float32, types.float64), codegen
