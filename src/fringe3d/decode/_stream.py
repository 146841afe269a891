"""Copies to memory past the caches: a line that is written whole need not be read before."""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

PLAIN_MEMORY: dict[str, Any] = {"cache": True, "_nrt": False}
"""For functions that take arrays and make none: counting references locks the memory, and a locked
operation waits until all that was streamed has arrived."""

VECTOR_BYTES = 32


@intrinsic
def _address(_typing: Any, array: types.Array) -> Any:
    """Return the address of the first element."""

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.ptrtoint(data, ir.IntType(64))

    return types.int64(array), build


@intrinsic
def _store_vectors(_typing: Any, _target: Any, _source: Any, _n: Any) -> Any:
    """Copy n vectors between two addresses, that of the target a multiple of their size."""

    def build(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        vectors = ir.VectorType(ir.IntType(32), VECTOR_BYTES // 4).as_pointer()
        to, start = (builder.inttoptr(address, vectors) for address in arguments[:2])
        hint = builder.module.add_metadata([ir.Constant(ir.IntType(32), 1)])
        with cgutils.for_range(builder, arguments[2]) as loop:
            vector = builder.load(builder.gep(start, [loop.index]))
            vector.align = 1
            store = builder.store(vector, builder.gep(to, [loop.index]))
            store.align = VECTOR_BYTES
            store.set_metadata("nontemporal", hint)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), build


@intrinsic
def finish_stores(_typing: Any) -> Any:
    """Make all that was streamed visible to other threads."""

    def build(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), build


ADDRESS: Any = _address
STORE: Any = _store_vectors


@njit(**PLAIN_MEMORY)
def stream(source, target):  # type: ignore[no-untyped-def]
    """Copy as many elements as `target` (1d, contiguous) holds. Then call `finish_stores`."""
    n, size = len(target), target.itemsize
    to, start = ADDRESS(target), ADDRESS(source)
    head = min(-to % VECTOR_BYTES // size, n)
    n_vectors = (n - head) * size // VECTOR_BYTES
    tail = head + n_vectors * (VECTOR_BYTES // size)
    for x in range(head):
        target[x] = source[x]
    STORE(to + head * size, start + head * size, n_vectors)
    for x in range(tail, n):
        target[x] = source[x]
