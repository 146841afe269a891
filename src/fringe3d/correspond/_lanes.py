"""One step of the aggregation for eight labels at once: one vector instruction for each line.

Numba does not vectorise loops that are as short as a list of fringe orders.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 8
BITS = ir.IntType(16)
LABELS = ir.VectorType(BITS, LANES)


@intrinsic
def carry(  # type: ignore[no-untyped-def]
    _typing, _paths, _same, _above, _below, _costs, _total, _place, _to, _step, _jump, _least
):
    """Carry the evidence for LANES orders from a pixel to its neighbour; return the least.

    In words, for each label: ``best = min(jump, paths[same], paths[above] + step, paths[below] +
    step)``; ``paths[to] = costs[place] + best - least``; ``total[place] += paths[to]``. All arrays
    are flat uint16; same, above, below, to, place: where the first label stands; jump: the least
    of the paths and the price of any jump.
    """
    array, number = types.Array(types.uint16, 1, "C"), types.int64
    penalty = types.uint16
    signature = penalty(array, number, number, number, array, array, number, number,
                        penalty, penalty, penalty)  # fmt: skip
    return signature, _carry


def _carry(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    paths, same, above, below, costs, total, place, to, step, jump, least = args

    def pointer(array: Any, number: int, at: Any) -> Any:
        data = context.make_array(signature.args[number])(context, builder, array).data
        return builder.bitcast(builder.gep(data, [at]), LABELS.as_pointer())

    def loaded(where: Any) -> Any:
        value = builder.load(where)
        value.align = 2
        return value

    def spread(value: Any) -> Any:
        one = builder.insert_element(ir.Constant(LABELS, ir.Undefined), value, cgutils.int32_t(0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
        return builder.shuffle_vector(one, one, zeros)

    def smaller(a: Any, b: Any) -> Any:
        return builder.select(builder.icmp_unsigned("<", a, b), a, b)

    stepped = smaller(loaded(pointer(paths, 0, above)), loaded(pointer(paths, 0, below)))
    best = smaller(loaded(pointer(paths, 0, same)), builder.add(stepped, spread(step)))
    best = builder.sub(smaller(best, spread(jump)), spread(least))
    carried = builder.add(loaded(pointer(costs, 4, place)), best)
    builder.store(carried, pointer(paths, 0, to)).align = 2
    sum_at = pointer(total, 5, place)
    builder.store(builder.add(loaded(sum_at), carried), sum_at).align = 2
    reduce = cgutils.get_or_insert_function(  # type: ignore[no-untyped-call]
        builder.module, ir.FunctionType(BITS, [LABELS]), f"llvm.vector.reduce.umin.v{LANES}i16"
    )
    return builder.call(reduce, [carried])
