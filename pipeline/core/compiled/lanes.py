"""Vectors of sixteen numbers, for compiled functions: LLVM unrolls plain loops over sixteen numbers instead.

In compiled functions they stay in the registers of the processor, and what is done with them is an instruction, or a
few. Without a compiler they are arrays. No number may be NaN.
"""

from typing import Any, TypeAlias

import numpy as np
from llvmlite import ir

from pipeline.core.arrays import F32, F64
from pipeline.core.compiled.lane_types import LANES, RANKS, lanes_type, operation, ranks_type, wide_type

__all__ = [
    "LANES",
    "RANKS",
    "Lanes",
    "Ranks",
    "WideLanes",
    "below",
    "highest",
    "larger",
    "last_rank",
    "load",
    "lowest_bit",
    "ranks_of",
    "replaced",
    "roots",
    "share",
    "smaller",
    "spread",
    "store",
    "store_ranks",
    "with_one_more",
]

Lanes: TypeAlias = F32
"""Sixteen numbers: in compiled functions in registers, else an array."""

WideLanes: TypeAlias = F64
"""Sixteen numbers in double precision: likewise."""

Ranks: TypeAlias = F32
"""Lanes of rising numbers, as many as `RANKS`: likewise."""


def _lane(number: int) -> Any:
    """The number of a lane, for LLVM."""
    return ir.IntType(32)(number)


def _shuffled(builder: Any, lanes: Any, numbers: list[int]) -> Any:
    """In each lane what was in the one of that number."""
    indices = ir.Constant(ir.VectorType(ir.IntType(32), LANES), numbers)
    return builder.shuffle_vector(lanes, ir.Constant(lanes_type(), ir.Undefined), indices)


def _spread_out(builder: Any, number: Any) -> Any:
    first = builder.insert_element(ir.Constant(lanes_type(), ir.Undefined), number, _lane(0))
    return _shuffled(builder, first, [0] * LANES)


def _place(builder: Any, numbers: Any, at: Any) -> Any:
    return builder.bitcast(builder.gep(numbers, [at]), lanes_type().as_pointer())


def _loaded(builder: Any, numbers: Any, at: Any) -> Any:
    return builder.load(_place(builder, numbers, at), align=4)


def _stored(builder: Any, numbers: Any, at: Any, lanes: Any) -> Any:
    return builder.store(lanes, _place(builder, numbers, at), align=4)


def _less(builder: Any, a: Any, b: Any) -> Any:
    return builder.fcmp_ordered("<", a, b)


def _less_bits(builder: Any, a: Any, b: Any) -> Any:
    return builder.zext(builder.bitcast(_less(builder, a, b), ir.IntType(LANES)), ir.IntType(64))


def _lower(builder: Any, a: Any, b: Any) -> Any:
    return _chosen(builder, "llvm.minnum", a, b)


def _upper(builder: Any, a: Any, b: Any) -> Any:
    return _chosen(builder, "llvm.maxnum", a, b)


def _chosen(builder: Any, name: str, a: Any, b: Any) -> Any:
    """One of two numbers in each lane, none of which is NaN.

    Not a comparison and a choice: where one of the two came from the place that the result is written to, LLVM would
    write only the lanes that change, and whoever reads them next waits for that.
    """
    kind = ir.FunctionType(lanes_type(), [lanes_type(), lanes_type()])
    function = builder.module.declare_intrinsic(f"{name}.v{LANES}f32", (), kind)
    return builder.call(function, [a, b], fastmath=("nnan",))


def _top(builder: Any, lanes: Any) -> Any:
    width = LANES
    while width > 1:
        width //= 2
        numbers = [lane + width if lane < width else lane for lane in range(LANES)]
        lanes = _upper(builder, lanes, _shuffled(builder, lanes, numbers))
    return builder.extract_element(lanes, _lane(0))


def _widened_roots(builder: Any, lanes: Any) -> Any:
    root = builder.module.declare_intrinsic(f"llvm.sqrt.v{LANES}f32", (), ir.FunctionType(lanes_type(), [lanes_type()]))
    return builder.fpext(builder.call(root, [lanes]), wide_type())


def _divided(builder: Any, wide: Any, number: Any) -> Any:
    undefined = ir.Constant(wide_type(), ir.Undefined)
    first = builder.insert_element(undefined, builder.sitofp(number, ir.DoubleType()), _lane(0))
    indices = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.fptrunc(builder.fdiv(wide, builder.shuffle_vector(first, undefined, indices)), lanes_type())


def _all_ranks(builder: Any, lanes: Any) -> Any:
    ranks = ir.Constant(ranks_type(), ir.Undefined)
    for rank in range(RANKS):
        ranks = builder.insert_value(ranks, lanes, rank)
    return ranks


def _put(builder: Any, ranks: Any, distance: Any) -> Any:
    before = [builder.extract_value(ranks, rank) for rank in range(RANKS)]
    ranks = builder.insert_value(ranks, _lower(builder, before[0], distance), 0)
    for rank in range(1, RANKS):
        passed_on = _upper(builder, before[rank - 1], distance)
        ranks = builder.insert_value(ranks, _lower(builder, before[rank], passed_on), rank)
    return ranks


def _last(builder: Any, ranks: Any) -> Any:
    return builder.extract_value(ranks, RANKS - 1)


def _stored_ranks(builder: Any, numbers: Any, ranks: Any) -> Any:
    for rank in range(RANKS):
        _stored(builder, numbers, ir.IntType(64)(rank * LANES), builder.extract_value(ranks, rank))


def _inserted(builder: Any, lanes: Any, lane: Any, number: Any) -> Any:
    return builder.insert_element(lanes, number, builder.trunc(lane, ir.IntType(32)))


def _trailing_zeros(builder: Any, bits: Any) -> Any:
    return builder.cttz(bits, ir.IntType(1)(1))


@operation("lanes", "number", emit=_spread_out)
def spread(number: float | np.float32) -> Lanes:
    """A number in every lane."""
    return np.full(LANES, number, np.float32)


@operation("lanes", "numbers", "int", emit=_loaded)
def load(numbers: F32, at: int) -> Lanes:
    """Sixteen numbers of an array, from `at` on."""
    return numbers[at : at + LANES].copy()


@operation("nothing", "numbers", "int", "lanes", emit=_stored)
def store(numbers: F32, at: int, lanes: Lanes) -> None:
    """Writes them to an array, from `at` on."""
    numbers[at : at + LANES] = lanes


@operation("lanes", "lanes", "lanes", emit=_lower)
def smaller(a: Lanes, b: Lanes) -> Lanes:
    """In each lane the smaller number."""
    return np.where(a < b, a, b)


@operation("lanes", "lanes", "lanes", emit=_upper)
def larger(a: Lanes, b: Lanes) -> Lanes:
    """In each lane the larger number."""
    return np.where(a < b, b, a)


@operation("int", "lanes", "lanes", emit=_less_bits)
def below(a: Lanes, b: Lanes) -> int:
    """A bit for each lane, the lowest for the first: whether a < b."""
    return int(np.packbits(a < b, bitorder="little").view("<u2")[0])


@operation("number", "lanes", emit=_top)
def highest(lanes: Lanes) -> np.float32:
    """The highest number of all lanes."""
    highest: np.float32 = lanes.max()
    return highest


@operation("lanes", "lanes", "int", "number", emit=_inserted)
def replaced(lanes: Lanes, lane: int, number: float | np.float32) -> Lanes:
    """The lanes with another number in one of them."""
    replaced = lanes.copy()
    replaced[lane] = number
    return replaced


@operation("wide", "lanes", emit=_widened_roots)
def roots(lanes: Lanes) -> WideLanes:
    """The square roots, rounded to single precision."""
    return np.sqrt(lanes).astype(np.float64)


@operation("lanes", "wide", "int", emit=_divided)
def share(total: WideLanes, count: int) -> Lanes:
    """Numbers divided by another one, rounded to single precision then."""
    return (total / count).astype(np.float32)


@operation("ranks", "lanes", emit=_all_ranks)
def ranks_of(lanes: Lanes) -> Ranks:
    """The same numbers in all ranks."""
    return np.tile(lanes, (RANKS, 1))


@operation("ranks", "ranks", "lanes", emit=_put)
def with_one_more(ranks: Ranks, distance: Lanes) -> Ranks:
    """The least of the numbers in the ranks and another one, in order: the largest of each lane goes."""
    return np.sort(np.concatenate([ranks, distance[None]]), axis=0)[:RANKS]


@operation("lanes", "ranks", emit=_last)
def last_rank(ranks: Ranks) -> Lanes:
    """The largest number of each lane."""
    last: Lanes = ranks[-1]
    return last


@operation("nothing", "numbers", "ranks", emit=_stored_ranks)
def store_ranks(numbers: F32, ranks: Ranks) -> None:
    """Writes them to the beginning of an array."""
    numbers[: ranks.size] = ranks.ravel()


@operation("int", "int", emit=_trailing_zeros)
def lowest_bit(bits: int) -> int:
    """The place of the lowest bit that is set; of a number that is not 0."""
    return (int(bits) & -int(bits)).bit_length() - 1
