"""A memory fence for the sequence locks of shared memory."""

from __future__ import annotations

from typing import Any

from numba import njit, types
from numba.extending import intrinsic


@intrinsic  # type: ignore[untyped-decorator]
def _emit_fence(_typing_context: Any) -> Any:
    """LLVM `fence seq_cst`."""

    def codegen(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), codegen


@njit(cache=True)  # type: ignore[untyped-decorator]
def full_fence() -> None:
    """Order all memory accesses before the call before all those after it, on every CPU architecture.

    Plain numpy stores are ordered on x86 but not on ARM; the sequence locks of `frame_ring` need the order.
    """
    _emit_fence()
