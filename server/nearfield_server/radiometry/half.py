"""Half floats inside numba kernels.

numba has no float16 arrays on the CPU. Pictures therefore enter kernels as addresses or uint16 views, and these
intrinsics let LLVM use the processor's own conversion instructions.
"""

from __future__ import annotations

from typing import Any, Final

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

HALF_MAX: Final = 65504.0

_F32: Final = ir.FloatType()
_HALF: Final = ir.HalfType()
_F32X4: Final = ir.VectorType(_F32, 4)
_I32: Final = ir.IntType(32)


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
