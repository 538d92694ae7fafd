"""Sums of small products over the camera blocks of normal equations, in vector registers.

Numba leaves them to scalar instructions. Each number is computed by the same operations in the same order as
in the plain loops, so that it has the same bits.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

_SIZE = 6
_LANE = ir.IntType(32)
_WIDTHS = ((0, 4), (4, 2))  # first column and number of columns of the two vectors of a row


class _Block:
    """Rows of six numbers that follow an address, each read and written as two vectors."""

    def __init__(self, builder: ir.IRBuilder, address: ir.Value) -> None:
        self._builder = builder
        self._address = address

    def scalar(self, number: int) -> ir.Value:
        """One number."""
        return self._builder.load(self._builder.gep(self._address, [_LANE(number)]))

    def vectors(self, stride: ir.Value | int, row: int) -> list[Any]:
        """Addresses of the two vectors of a row, rows being ``stride`` numbers apart."""
        builder = self._builder
        if isinstance(stride, int):
            begin = builder.gep(self._address, [_LANE(stride * row)])
        else:
            begin = builder.gep(self._address, [builder.mul(stride, stride.type(row))])
        double = ir.DoubleType()
        return [
            builder.bitcast(builder.gep(begin, [_LANE(c)]), ir.VectorType(double, n).as_pointer())
            for c, n in _WIDTHS
        ]

    def row(self, row: int) -> list[Any]:
        """The two vectors of a row of six."""
        return [self._builder.load(vector, align=8) for vector in self.vectors(_SIZE, row)]


def _spread(builder: ir.IRBuilder, number: ir.Value) -> list[ir.Value]:
    """A number in every lane of both vectors."""
    spread = []
    for _, n in _WIDTHS:
        unset = ir.Constant(ir.VectorType(ir.DoubleType(), n), ir.Undefined)
        lanes = ir.Constant(ir.VectorType(_LANE, n), [0] * n)
        spread.append(builder.shuffle_vector(builder.insert_element(unset, number, _LANE(0)), unset, lanes))
    return spread


def _at(context, builder, signature, args, array, *index):
    """The address of an element, and the length of the array's last dimension."""
    found = make_array(signature.args[array])(context, builder, args[array])
    lengths = cgutils.unpack_tuple(builder, found.shape)
    offset = index[0]
    for length, further in zip(lengths[1:], index[1:], strict=True):
        offset = builder.add(builder.mul(offset, length), further)
    return builder.gep(found.data, [offset]), lengths[-1]


def _subtract_products(typingctx, S, row, column, Y, W, j):
    """``S[row:row+6, column:column+6] -= Yᵀ W[j]``, a row's three products added up from the first.

    Args:
        typingctx: given by Numba.
        S: (n, n) float64.
        row, column: int64.
        Y: (3, 6) float64.
        W: (k, 3, 6) float64.
        j: int64.
    """

    def generate(context, builder, signature, args):
        zero = ir.IntType(64)(0)
        target, stride = _at(context, builder, signature, args, 0, args[1], args[2])
        left, _ = _at(context, builder, signature, args, 3, zero, zero)
        right, _ = _at(context, builder, signature, args, 4, args[5], zero, zero)
        target, left, right = (_Block(builder, address) for address in (target, left, right))
        w = [right.row(k) for k in range(3)]
        y = [[left.scalar(_SIZE * k + r) for k in range(3)] for r in range(_SIZE)]
        for r in range(_SIZE):
            y_0, y_1, y_2 = (_spread(builder, number) for number in y[r])
            for half, place in enumerate(target.vectors(stride, r)):
                total = builder.fmul(y_0[half], w[0][half])
                total = builder.fadd(total, builder.fmul(y_1[half], w[1][half]))
                total = builder.fadd(total, builder.fmul(y_2[half], w[2][half]))
                builder.store(builder.fsub(builder.load(place, align=8), total), place, align=8)
        return context.get_dummy_value()

    return types.void(S, row, column, Y, W, j), generate


def _add_outer_products(typingctx, U, f, Ju, Jv, weight):
    """``U[f] += weight (Ju Juᵀ + Jv Jvᵀ)``, the factors of each term multiplied in this order.

    Args:
        typingctx: given by Numba.
        U: (F, 6, 6) float64.
        f: int64.
        Ju, Jv: (6,) float64.
        weight: float64.
    """

    def generate(context, builder, signature, args):
        zero = ir.IntType(64)(0)
        target = _Block(builder, _at(context, builder, signature, args, 0, args[1], zero, zero)[0])
        u, v = (_Block(builder, _at(context, builder, signature, args, k, zero)[0]) for k in (2, 3))
        row_u, row_v = u.row(0), v.row(0)
        scaled = [[builder.fmul(args[4], block.scalar(r)) for block in (u, v)] for r in range(_SIZE)]
        for r in range(_SIZE):
            w_u, w_v = (_spread(builder, number) for number in scaled[r])
            for half, place in enumerate(target.vectors(_SIZE, r)):
                total = builder.fadd(
                    builder.fmul(w_u[half], row_u[half]), builder.fmul(w_v[half], row_v[half])
                )
                builder.store(builder.fadd(builder.load(place, align=8), total), place, align=8)
        return context.get_dummy_value()

    return types.void(U, f, Ju, Jv, weight), generate


subtract_products: Callable[..., None] = intrinsic(_subtract_products)
add_outer_products: Callable[..., None] = intrinsic(_add_outer_products)
