"""Vectors of sixteen numbers, for compiled functions: LLVM unrolls plain loops over sixteen numbers instead.

In compiled functions they stay in the registers of the processor, and what is done with them is an instruction, or a
few. Without a compiler they are arrays. No number may be NaN.
"""

import inspect
import operator
from collections.abc import Callable
from functools import cache
from typing import Any, ParamSpec, TypeAlias, TypeVar

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.core.datamodel import PrimitiveModel
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, register_model, type_callable

from pipeline.core.arrays import F32, F64

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

P = ParamSpec("P")
R = TypeVar("R")

LANES = 16
"""Numbers of a vector."""

RANKS = 10
"""Vectors of `Ranks`: what stays in registers, of 32 in all, and the default of `combine.outliers.neighbors`."""

Lanes: TypeAlias = F32
"""Sixteen numbers: in compiled functions in registers, else an array."""

WideLanes: TypeAlias = F64
"""Sixteen numbers in double precision: likewise."""

Ranks: TypeAlias = F32
"""Lanes of rising numbers, as many as `RANKS`: likewise."""


_LANES, _WIDE = ir.VectorType(ir.FloatType(), LANES), ir.VectorType(ir.DoubleType(), LANES)
_RANKS = ir.ArrayType(_LANES, RANKS)
"""For LLVM."""


@cache
def _types() -> dict[str, Any]:
    """What operations take and return, for numba; it learns of lanes here, and of `a + b` and the like with them."""

    class HeldType(types.Type):
        """What is held in registers, for numba."""

        def __init__(self, name: str, held: Any) -> None:
            super().__init__(name)
            self.held = held

    @register_model(HeldType)
    class HeldModel(PrimitiveModel):  # type: ignore[misc]  # mypy skips numba
        """How LLVM holds it."""

        def __init__(self, manager: Any, kind: HeldType) -> None:
            super().__init__(manager, kind, kind.held)

    lanes, wide, ranks = (
        HeldType("Lanes", _LANES),
        HeldType("WideLanes", _WIDE),
        HeldType("Ranks", _RANKS),
    )

    def arithmetic(symbol: Any, instruction: str, *kinds: Any) -> None:
        """Each lane is rounded as a single number is."""

        class Template(AbstractTemplate):  # type: ignore[misc]  # mypy skips numba
            def generic(self, arguments: tuple[Any, ...], _: Any) -> Any:
                a, b = arguments
                return signature(a, a, a) if a == b and a in kinds else None

        infer_global(symbol)(Template)
        for kind in kinds:
            lower_builtin(symbol, kind, kind)(lambda _, builder, __, values: getattr(builder, instruction)(*values))

    arithmetic(operator.add, "fadd", lanes, wide)
    arithmetic(operator.sub, "fsub", lanes)
    arithmetic(operator.mul, "fmul", lanes)
    numbers = types.Array(types.float32, 1, "C")
    return {
        "lanes": lanes,
        "wide": wide,
        "ranks": ranks,
        "numbers": numbers,
        "number": types.float32,
        "int": types.int64,
        "nothing": types.void,
    }


def _operation(result: str, *arguments: str, emit: Callable[..., Any]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A function of lanes: in compiled functions what `emit` writes with LLVM's builder, else the decorated one.

    Args:
        result: Its type, one of `_types`.
        arguments: Types of its arguments.
        emit: Gets the builder and the values, for an array the pointer to its numbers.
    """
    returned, taken = _types()[result], tuple(_types()[argument] for argument in arguments)

    def code(context: Any, builder: Any, _: Any, values: tuple[Any, ...]) -> Any:
        plain = [
            context.make_array(kind)(context, builder, value).data if argument == "numbers" else value
            for argument, kind, value in zip(arguments, taken, values, strict=True)
        ]
        written = emit(builder, *plain)
        return context.get_dummy_value() if result == "nothing" else written

    def known(function: Callable[P, R]) -> Callable[P, R]:
        def typed(_: Any) -> Callable[..., Any]:
            def typer(*given: Any) -> Any:
                return returned if given == taken else None

            vars(typer)["__signature__"] = inspect.signature(function)  # numba matches arguments with it
            return typer

        type_callable(function)(typed)
        lower_builtin(function, *taken)(code)
        return function

    return known


def _lane(number: int) -> Any:
    """The number of a lane, for LLVM."""
    return ir.IntType(32)(number)


def _shuffled(builder: Any, lanes: Any, numbers: list[int]) -> Any:
    """In each lane what was in the one of that number."""
    indices = ir.Constant(ir.VectorType(ir.IntType(32), LANES), numbers)
    return builder.shuffle_vector(lanes, ir.Constant(_LANES, ir.Undefined), indices)


def _spread_out(builder: Any, number: Any) -> Any:
    first = builder.insert_element(ir.Constant(_LANES, ir.Undefined), number, _lane(0))
    return _shuffled(builder, first, [0] * LANES)


def _place(builder: Any, numbers: Any, at: Any) -> Any:
    return builder.bitcast(builder.gep(numbers, [at]), _LANES.as_pointer())


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
    kind = ir.FunctionType(_LANES, [_LANES, _LANES])
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
    root = builder.module.declare_intrinsic(f"llvm.sqrt.v{LANES}f32", (), ir.FunctionType(_LANES, [_LANES]))
    return builder.fpext(builder.call(root, [lanes]), _WIDE)


def _divided(builder: Any, wide: Any, number: Any) -> Any:
    undefined = ir.Constant(_WIDE, ir.Undefined)
    first = builder.insert_element(undefined, builder.sitofp(number, ir.DoubleType()), _lane(0))
    indices = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.fptrunc(builder.fdiv(wide, builder.shuffle_vector(first, undefined, indices)), _LANES)


def _all_ranks(builder: Any, lanes: Any) -> Any:
    ranks = ir.Constant(_RANKS, ir.Undefined)
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


@_operation("lanes", "number", emit=_spread_out)
def spread(number: float | np.float32) -> Lanes:
    """A number in every lane."""
    return np.full(LANES, number, np.float32)


@_operation("lanes", "numbers", "int", emit=_loaded)
def load(numbers: F32, at: int) -> Lanes:
    """Sixteen numbers of an array, from `at` on."""
    return numbers[at : at + LANES].copy()


@_operation("nothing", "numbers", "int", "lanes", emit=_stored)
def store(numbers: F32, at: int, lanes: Lanes) -> None:
    """Writes them to an array, from `at` on."""
    numbers[at : at + LANES] = lanes


@_operation("lanes", "lanes", "lanes", emit=_lower)
def smaller(a: Lanes, b: Lanes) -> Lanes:
    """In each lane the smaller number."""
    return np.where(a < b, a, b)


@_operation("lanes", "lanes", "lanes", emit=_upper)
def larger(a: Lanes, b: Lanes) -> Lanes:
    """In each lane the larger number."""
    return np.where(a < b, b, a)


@_operation("int", "lanes", "lanes", emit=_less_bits)
def below(a: Lanes, b: Lanes) -> int:
    """A bit for each lane, the lowest for the first: whether a < b."""
    return int(np.packbits(a < b, bitorder="little").view("<u2")[0])


@_operation("number", "lanes", emit=_top)
def highest(lanes: Lanes) -> np.float32:
    """The highest number of all lanes."""
    highest: np.float32 = lanes.max()
    return highest


@_operation("lanes", "lanes", "int", "number", emit=_inserted)
def replaced(lanes: Lanes, lane: int, number: float | np.float32) -> Lanes:
    """The lanes with another number in one of them."""
    replaced = lanes.copy()
    replaced[lane] = number
    return replaced


@_operation("wide", "lanes", emit=_widened_roots)
def roots(lanes: Lanes) -> WideLanes:
    """The square roots, rounded to single precision."""
    return np.sqrt(lanes).astype(np.float64)


@_operation("lanes", "wide", "int", emit=_divided)
def share(total: WideLanes, count: int) -> Lanes:
    """Numbers divided by another one, rounded to single precision then."""
    return (total / count).astype(np.float32)


@_operation("ranks", "lanes", emit=_all_ranks)
def ranks_of(lanes: Lanes) -> Ranks:
    """The same numbers in all ranks."""
    return np.tile(lanes, (RANKS, 1))


@_operation("ranks", "ranks", "lanes", emit=_put)
def with_one_more(ranks: Ranks, distance: Lanes) -> Ranks:
    """The least of the numbers in the ranks and another one, in order: the largest of each lane goes."""
    return np.sort(np.concatenate([ranks, distance[None]]), axis=0)[:RANKS]


@_operation("lanes", "ranks", emit=_last)
def last_rank(ranks: Ranks) -> Lanes:
    """The largest number of each lane."""
    last: Lanes = ranks[-1]
    return last


@_operation("nothing", "numbers", "ranks", emit=_stored_ranks)
def store_ranks(numbers: F32, ranks: Ranks) -> None:
    """Writes them to the beginning of an array."""
    numbers[: ranks.size] = ranks.ravel()


@_operation("int", "int", emit=_trailing_zeros)
def lowest_bit(bits: int) -> int:
    """The place of the lowest bit that is set; of a number that is not 0."""
    return (int(bits) & -int(bits)).bit_length() - 1
