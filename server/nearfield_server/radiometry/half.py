"""Half floats inside numba kernels.

numba has no float16 arrays on the CPU. Pictures therefore enter kernels as addresses or uint16 views, and these
intrinsics let LLVM use the processor's own conversion instructions.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

HALF_MAX: Final = 65504.0
FRACTION_STEPS: Final = 255
"""Bilinear fractions are stored as whole numbers of 1 / 255."""

_F32: Final = ir.FloatType()
_HALF: Final = ir.HalfType()
_HALF8: Final = ir.VectorType(_HALF, 8)
_F32X8: Final = ir.VectorType(_F32, 8)
_F32X4: Final = ir.VectorType(_F32, 4)
_I32: Final = ir.IntType(32)


def as_uint16(pixels: NDArray[np.float16]) -> NDArray[np.uint16]:
    """The same memory as uint16, for kernels."""
    return pixels.view(np.uint16)


@intrinsic  # type: ignore[untyped-decorator]
def half_to_float(typingctx: Any, bits: Any) -> Any:
    """float32 value of a half given as uint16 bits."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.fpext(builder.bitcast(args[0], _HALF), _F32)

    return types.float32(types.uint16), codegen


@intrinsic  # type: ignore[untyped-decorator]
def float_to_half(typingctx: Any, value: Any) -> Any:
    """uint16 bits of the nearest half (ties to even) of a float32; values above 65519 become infinite."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(builder.fptrunc(args[0], _HALF), ir.IntType(16))

    return types.uint16(types.float32), codegen


@intrinsic  # type: ignore[untyped-decorator]
def pack_plain_rgb(typingctx: Any, address: Any) -> Any:
    """Three float32 at an address (int64) as a word of four halves (uint64), alpha 1, and whether all lie in [0, HALF_MAX].

    The word means something only if they do; -0 becomes +0.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = builder.inttoptr(args[0], _F32.as_pointer())
        values = ir.Constant(_F32X4, [0.0, 0.0, 0.0, 1.0])
        for channel in range(3):
            value = builder.load(builder.gep(pointer, [_I32(channel)]), align=4)
            values = builder.insert_element(values, value, _I32(channel))
        zero = ir.Constant(_F32X4, [0.0] * 4)
        values = builder.fadd(values, zero)
        inside = builder.and_(
            builder.fcmp_ordered(">=", values, zero),
            builder.fcmp_ordered("<=", values, ir.Constant(_F32X4, [HALF_MAX] * 4)),
        )
        all_inside = builder.icmp_unsigned("==", builder.bitcast(inside, ir.IntType(4)), ir.IntType(4)(15))
        word = builder.bitcast(builder.fptrunc(values, ir.VectorType(_HALF, 4)), ir.IntType(64))
        return context.make_tuple(builder, signature.return_type, [word, all_inside])

    return types.Tuple((types.uint64, types.boolean))(types.int64), codegen


@intrinsic  # type: ignore[untyped-decorator]
def float_bits(typingctx: Any, value: Any) -> Any:
    """The 32 bits of a float32 as uint32: for values >= 0 they sort like the values."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], _I32)

    return types.uint32(types.float32), codegen


@intrinsic  # type: ignore[untyped-decorator]
def prefetch(typingctx: Any, address: Any) -> Any:
    """Ask for the cache line at an address (int64). Any address is allowed; it is a hint."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer_type = ir.IntType(8).as_pointer()
        signature_type = ir.FunctionType(ir.VoidType(), [pointer_type, _I32, _I32, _I32])
        function = builder.module.declare_intrinsic("llvm.prefetch", [pointer_type], signature_type)
        pointer = builder.inttoptr(args[0], pointer_type)
        builder.call(function, [pointer, _I32(0), _I32(3), _I32(1)])
        return context.get_dummy_value()

    return types.void(types.int64), codegen


def _splat(builder: Any, value: Any, vector_type: Any) -> Any:
    single = builder.insert_element(ir.Constant(vector_type, ir.Undefined), value, _I32(0))
    lanes = ir.VectorType(_I32, vector_type.count)
    return builder.shuffle_vector(
        single, ir.Constant(vector_type, ir.Undefined), ir.Constant(lanes, [0] * vector_type.count)
    )


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
    alpha_lanes = ir.Constant(ir.VectorType(_I32, 8), [3, 3, 3, 3, 7, 7, 7, 7])
    return builder.fmul(values, builder.shuffle_vector(values, values, alpha_lanes))


@intrinsic  # type: ignore[untyped-decorator]
def accumulate_taps(
    typingctx: Any, row0: Any, row1: Any, fraction_x: Any, fraction_y: Any, weight: Any, total: Any
) -> Any:
    """Add a weighted bilinear blend of 2x2 RGBA half pixels to a running (r, g, b, valid weight).

    Args of the call in a kernel:
        row0, row1: int64 addresses of the left pixels of the two rows; 16 bytes are read at each.
        fraction_x, fraction_y: float32 in steps, 0 to FRACTION_STEPS; whole numbers keep `1 - fraction` exact.
        weight: float32.
        total: 4 float32. Invalid pixels (alpha 0) add nothing; divide colour by the last component at the end.
    """
    quad = types.UniTuple(types.float32, 4)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        address0, address1, x, y, pair_weight, running = args
        upper = _load_row(builder, address0)
        lower = _load_row(builder, address1)
        # (1 - y) upper + y lower, not upper + y (lower - upper): a fraction of exactly 1 must leave nothing of a
        # bright upper pixel behind.
        steps = ir.Constant(_F32, float(FRACTION_STEPS))
        rest = builder.fsub(steps, y)
        rows = builder.fadd(
            builder.fmul(_splat(builder, rest, _F32X8), upper),
            builder.fmul(_splat(builder, y, _F32X8), lower),
        )
        right = builder.fmul(x, pair_weight)
        left = builder.fmul(builder.fsub(steps, x), pair_weight)
        first = ir.Constant(ir.VectorType(_I32, 4), [0, 1, 2, 3])
        second = ir.Constant(ir.VectorType(_I32, 4), [4, 5, 6, 7])
        blended = builder.fadd(
            builder.fmul(builder.shuffle_vector(rows, rows, first), _splat(builder, left, _F32X4)),
            builder.fmul(builder.shuffle_vector(rows, rows, second), _splat(builder, right, _F32X4)),
        )
        result = running
        for lane in range(4):
            added = builder.fadd(
                builder.extract_value(running, lane), builder.extract_element(blended, _I32(lane))
            )
            result = builder.insert_value(result, added, lane)
        return result

    signature = quad(types.int64, types.int64, types.float32, types.float32, types.float32, quad)
    return signature, codegen
