"""Sum of weighted outer products in vector registers, with the bits of the plain loops.

Numba leaves such sums to scalar instructions. Each of them is added up in the order of the rows here too.
"""

from collections.abc import Callable

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

SIZE = 8
"""Number of columns."""

_LANE = ir.IntType(32)
_VECTOR = ir.VectorType(ir.DoubleType(), SIZE)
_UNSET = ir.Constant(_VECTOR, ir.Undefined)
_FIRST_LANES = ir.Constant(ir.VectorType(_LANE, SIZE), [0] * SIZE)


def _add_outer_products(typingctx, rows, weights, residuals, count, sums):
    """Add w J Jᵀ and w J r of the first ``count`` rows to ``sums``.

    Args:
        typingctx: given by Numba.
        rows: (n, 8) float64, J.
        weights, residuals: (n,) float64, w and r.
        count: int64.
        sums: (9, 8) float64, contiguous as the others: H, below it the gradient.
    """

    def generate(context, builder, signature, args):
        def pointer(k):
            return make_array(signature.args[k])(context, builder, args[k]).data

        def spread(number):
            lane = builder.insert_element(_UNSET, number, _LANE(0))
            return builder.shuffle_vector(lane, _UNSET, _FIRST_LANES)

        def add(total, a, b):
            builder.store(builder.fadd(builder.load(total), builder.fmul(a, b)), total)

        columns, vectors = pointer(0), builder.bitcast(pointer(0), _VECTOR.as_pointer())
        results = builder.bitcast(pointer(4), _VECTOR.as_pointer())
        totals = [cgutils.alloca_once(builder, _VECTOR) for _ in range(SIZE + 1)]
        for m, total in enumerate(totals):
            builder.store(builder.load(builder.gep(results, [_LANE(m)]), align=8), total)
        with cgutils.for_range(builder, args[3]) as loop:
            J = builder.load(builder.gep(vectors, [loop.index]), align=8)
            weight = spread(builder.load(builder.gep(pointer(1), [loop.index])))
            residual = spread(builder.load(builder.gep(pointer(2), [loop.index])))
            first = builder.mul(loop.index, loop.index.type(SIZE))
            for m, total in enumerate(totals[:SIZE]):
                J_m = builder.load(builder.gep(columns, [builder.add(first, first.type(m))]))
                add(total, builder.fmul(weight, spread(J_m)), J)
            add(totals[SIZE], builder.fmul(weight, J), residual)
        for m, total in enumerate(totals):
            builder.store(builder.load(total), builder.gep(results, [_LANE(m)]), align=8)
        return context.get_dummy_value()

    return types.void(rows, weights, residuals, count, sums), generate


add_outer_products: Callable[..., None] = intrinsic(_add_outer_products)
