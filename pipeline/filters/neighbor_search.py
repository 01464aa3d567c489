"""Exact distances to nearest neighbours, for all points of a cloud at once.

The points of a run look for neighbours together, each in a lane of a vector of sixteen numbers: a point of another run
is compared with all of them by a few instructions. Boxes that are farther away than the neighbours found so far are
left out. The ten nearest of each stay in registers. Compiled: see `pipeline.core.compiled`. Without the vectors, as
loops over sixteen numbers, it takes several times as long: the compiler unrolls such loops instead.
"""

import inspect
import operator
from collections.abc import Callable
from functools import cache
from typing import Any, TypeAlias

import numpy as np

from pipeline.core.arrays import F32, F64, I32, I64
from pipeline.core.compiled import compiled, compiled_as, inlined

__all__ = ["mean_distances"]

RUN = 16
"""Points of a run, and children of a box: those of `pipeline.filters.box_tree`."""

BOX = 6 * RUN
"""Numbers of a node of boxes: the lowest x of its children, their lowest y, z, and the highest."""

RANKS = 10
"""Nearest neighbours that are kept in registers; of 32 in all, and the default of `combine.outliers.neighbors`."""

LARGEST = np.float32(np.finfo(np.float32).max)
"""The square of all distances whose square is not below it."""


# --- vectors of sixteen numbers


Lanes: TypeAlias = F32
"""Sixteen numbers: in compiled functions in registers, else an array."""

WideLanes: TypeAlias = F64
"""Sixteen numbers in double precision: likewise."""

Ranks: TypeAlias = F32
"""Lanes of rising numbers, as many as `RANKS`: likewise."""


@cache
def _types() -> dict[str, Any]:
    """What operations take and return, for numba; it learns of lanes here, and of `a + b` and the like with them."""
    from numba.core import types
    from numba.core.datamodel import PrimitiveModel
    from numba.core.typing.templates import AbstractTemplate, infer_global, signature
    from numba.extending import lower_builtin, register_model

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

    lanes, wide, ranks = HeldType("Lanes", _vector()), HeldType("WideLanes", _wide()), HeldType("Ranks", _vectors())

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


def _operation(
    result: str, *arguments: str, emit: Callable[..., Any]
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """A function of lanes: in compiled functions what `emit` writes with LLVM's builder, else the decorated one.

    Args:
        result: Its type, one of `_types`.
        arguments: Types of its arguments.
        emit: Gets the builder and the values, for an array the pointer to its numbers.
    """

    def deciding(function: Callable[..., Any]) -> Callable[..., Any]:
        return compiled_as(lambda: _intrinsic(function, result, arguments, emit))(function)

    return deciding


def _intrinsic(function: Callable[..., Any], result: str, arguments: tuple[str, ...], emit: Callable[..., Any]) -> Any:
    from numba.extending import intrinsic

    returned, taken = _types()[result], tuple(_types()[argument] for argument in arguments)

    def code(context: Any, builder: Any, _: Any, values: tuple[Any, ...]) -> Any:
        plain = [
            context.make_array(kind)(context, builder, value).data if argument == "numbers" else value
            for argument, kind, value in zip(arguments, taken, values, strict=True)
        ]
        written = emit(builder, *plain)
        return context.get_dummy_value() if result == "nothing" else written

    def typed(_: Any, *given: Any) -> Any:
        return (returned(*taken), code) if given == taken else None

    named = inspect.signature(function).parameters.values()
    context = inspect.Parameter("context", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    vars(typed)["__signature__"] = inspect.Signature([context, *named])  # numba matches arguments with it
    return intrinsic(typed)


@cache
def _vector() -> Any:
    """The type of sixteen numbers, for LLVM."""
    from llvmlite import ir

    return ir.VectorType(ir.FloatType(), RUN)


@cache
def _wide() -> Any:
    """The type of sixteen numbers in double precision, for LLVM."""
    from llvmlite import ir

    return ir.VectorType(ir.DoubleType(), RUN)


@cache
def _vectors() -> Any:
    """The type of ranks, for LLVM."""
    from llvmlite import ir

    return ir.ArrayType(_vector(), RANKS)


def _lane(number: int) -> Any:
    """The number of a lane, for LLVM."""
    from llvmlite import ir

    return ir.IntType(32)(number)


def _shuffled(builder: Any, lanes: Any, numbers: list[int]) -> Any:
    """In each lane what was in the one of that number."""
    from llvmlite import ir

    indices = ir.Constant(ir.VectorType(ir.IntType(32), RUN), numbers)
    return builder.shuffle_vector(lanes, ir.Constant(_vector(), ir.Undefined), indices)


def _spread_out(builder: Any, number: Any) -> Any:
    from llvmlite import ir

    first = builder.insert_element(ir.Constant(_vector(), ir.Undefined), number, _lane(0))
    return _shuffled(builder, first, [0] * RUN)


def _place(builder: Any, numbers: Any, at: Any) -> Any:
    return builder.bitcast(builder.gep(numbers, [at]), _vector().as_pointer())


def _loaded(builder: Any, numbers: Any, at: Any) -> Any:
    return builder.load(_place(builder, numbers, at), align=4)


def _stored(builder: Any, numbers: Any, at: Any, lanes: Any) -> Any:
    return builder.store(lanes, _place(builder, numbers, at), align=4)


def _less(builder: Any, a: Any, b: Any) -> Any:
    return builder.fcmp_ordered("<", a, b)


def _less_bits(builder: Any, a: Any, b: Any) -> Any:
    from llvmlite import ir

    return builder.zext(builder.bitcast(_less(builder, a, b), ir.IntType(RUN)), ir.IntType(64))


def _lower(builder: Any, a: Any, b: Any) -> Any:
    return _chosen(builder, "llvm.minnum", a, b)


def _upper(builder: Any, a: Any, b: Any) -> Any:
    return _chosen(builder, "llvm.maxnum", a, b)


def _chosen(builder: Any, name: str, a: Any, b: Any) -> Any:
    """One of two numbers in each lane, none of which is NaN.

    Not a comparison and a choice: where one of the two came from the place that the result is written to, LLVM would
    write only the lanes that change, and whoever reads them next waits for that.
    """
    from llvmlite import ir

    kind = ir.FunctionType(_vector(), [_vector(), _vector()])
    function = builder.module.declare_intrinsic(f"{name}.v{RUN}f32", (), kind)
    return builder.call(function, [a, b], fastmath=("nnan",))


def _top(builder: Any, lanes: Any) -> Any:
    width = RUN
    while width > 1:
        width //= 2
        numbers = [lane + width if lane < width else lane for lane in range(RUN)]
        lanes = _upper(builder, lanes, _shuffled(builder, lanes, numbers))
    return builder.extract_element(lanes, _lane(0))


def _widened_roots(builder: Any, lanes: Any) -> Any:
    from llvmlite import ir

    root = builder.module.declare_intrinsic(f"llvm.sqrt.v{RUN}f32", (), ir.FunctionType(_vector(), [_vector()]))
    return builder.fpext(builder.call(root, [lanes]), _wide())


def _divided(builder: Any, wide: Any, number: Any) -> Any:
    from llvmlite import ir

    undefined = ir.Constant(_wide(), ir.Undefined)
    first = builder.insert_element(undefined, builder.sitofp(number, ir.DoubleType()), _lane(0))
    indices = ir.Constant(ir.VectorType(ir.IntType(32), RUN), [0] * RUN)
    return builder.fptrunc(builder.fdiv(wide, builder.shuffle_vector(first, undefined, indices)), _vector())


def _all_ranks(builder: Any, lanes: Any) -> Any:
    from llvmlite import ir

    ranks = ir.Constant(_vectors(), ir.Undefined)
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
    from llvmlite import ir

    for rank in range(RANKS):
        _stored(builder, numbers, ir.IntType(64)(rank * RUN), builder.extract_value(ranks, rank))


def _inserted(builder: Any, lanes: Any, lane: Any, number: Any) -> Any:
    from llvmlite import ir

    return builder.insert_element(lanes, number, builder.trunc(lane, ir.IntType(32)))


def _trailing_zeros(builder: Any, bits: Any) -> Any:
    from llvmlite import ir

    return builder.cttz(bits, ir.IntType(1)(1))


@_operation("lanes", "number", emit=_spread_out)
def _spread(number: float) -> Lanes:
    """A number in every lane."""
    return np.full(RUN, number, np.float32)


@_operation("lanes", "numbers", "int", emit=_loaded)
def _load(numbers: F32, at: int) -> Lanes:
    """Sixteen numbers of an array, from `at` on."""
    return numbers[at : at + RUN].copy()


@_operation("nothing", "numbers", "int", "lanes", emit=_stored)
def _store(numbers: F32, at: int, lanes: Lanes) -> None:
    """Writes them to an array, from `at` on."""
    numbers[at : at + RUN] = lanes


@_operation("lanes", "lanes", "lanes", emit=_lower)
def _smaller(a: Lanes, b: Lanes) -> Lanes:
    """In each lane the smaller number."""
    return np.where(a < b, a, b)


@_operation("lanes", "lanes", "lanes", emit=_upper)
def _larger(a: Lanes, b: Lanes) -> Lanes:
    """In each lane the larger number."""
    return np.where(a < b, b, a)


@_operation("int", "lanes", "lanes", emit=_less_bits)
def _below(a: Lanes, b: Lanes) -> int:
    """A bit for each lane, the lowest for the first: whether a < b."""
    return int(np.packbits(a < b, bitorder="little").view("<u2")[0])


@_operation("number", "lanes", emit=_top)
def _highest(lanes: Lanes) -> np.float32:
    """The highest number of all lanes."""
    highest: np.float32 = lanes.max()
    return highest


@_operation("lanes", "lanes", "int", "number", emit=_inserted)
def _replaced(lanes: Lanes, lane: int, number: float) -> Lanes:
    """The lanes with another number in one of them."""
    replaced = lanes.copy()
    replaced[lane] = number
    return replaced


@_operation("wide", "lanes", emit=_widened_roots)
def _roots(lanes: Lanes) -> WideLanes:
    """The square roots, rounded to single precision."""
    return np.sqrt(lanes).astype(np.float64)


@_operation("lanes", "wide", "int", emit=_divided)
def _share(total: WideLanes, count: int) -> Lanes:
    """Numbers divided by another one, rounded to single precision then."""
    return (total / count).astype(np.float32)


@_operation("ranks", "lanes", emit=_all_ranks)
def _ranks_of(lanes: Lanes) -> Ranks:
    """The same numbers in all ranks."""
    return np.tile(lanes, (RANKS, 1))


@_operation("ranks", "ranks", "lanes", emit=_put)
def _with_one_more(ranks: Ranks, distance: Lanes) -> Ranks:
    """The least of the numbers in the ranks and another one, in order: the largest of each lane goes."""
    return np.sort(np.concatenate([ranks, distance[None]]), axis=0)[:RANKS]


@_operation("lanes", "ranks", emit=_last)
def _last_rank(ranks: Ranks) -> Lanes:
    """The largest number of each lane."""
    last: Lanes = ranks[-1]
    return last


@_operation("nothing", "numbers", "ranks", emit=_stored_ranks)
def _store_ranks(numbers: F32, ranks: Ranks) -> None:
    """Writes them to the beginning of an array."""
    numbers[: ranks.size] = ranks.ravel()


@_operation("int", "int", emit=_trailing_zeros)
def _lowest_bit(bits: int) -> int:
    """The place of the lowest bit that is set; of a number that is not 0."""
    return (int(bits) & -int(bits)).bit_length() - 1


# --- the search


@inlined
def _beyond(low: Lanes, lowest: Lanes, highest: Lanes, high: Lanes) -> Lanes:
    """The square of how far [low, high] is from [lowest, highest] along an axis."""
    gap = _larger(_larger(low - highest, lowest - high), _spread(np.float32(0)))
    squared: Lanes = gap * gap
    return squared


@inlined
def _insert(others: F32, count: int, distance: Lanes) -> None:
    """Puts distances in order among so many ranks of sixteen numbers each; the largest of each lane goes."""
    row = (count - 1) * RUN
    after = _load(others, row)
    while row > 0:
        row -= RUN
        before = _load(others, row)
        _store(others, row + RUN, _smaller(after, _larger(before, distance)))
        after = before
    _store(others, 0, _smaller(after, distance))


@inlined
def _squared(x: Lanes, y: Lanes, z: Lanes, xs: F32, ys: F32, zs: F32, i: int) -> Lanes:
    """Squared distances of points to another one."""
    dx, dy, dz = x - _spread(xs[i]), y - _spread(ys[i]), z - _spread(zs[i])
    squared: Lanes = dx * dx + dy * dy + dz * dz
    return squared


@compiled("float32[::1](float32[:, ::1], float32[:, :, ::1], int64[::1], int32[::1], int64)")
def mean_distances(points: F32, boxes: F32, first: I64, order: I32, neighbors: int) -> F32:
    """(N,) mean distance of each point to its nearest neighbours, other than itself, as PCL rounds it.

    Squares of distances, their sums and roots in float32, the sum over the neighbours, nearest first, in float64.

    Args:
        points: As `pipeline.filters.box_tree.box_tree` returns them.
        boxes: Likewise.
        first: Likewise.
        order: (N,) row of the result for each point.
        neighbors: At least 1, below N.
    """
    count, levels, runs = len(order), len(first) - 1, points.shape[1] // RUN
    xs, ys, zs, corners = points[0], points[1], points[2], boxes.reshape(boxes.size)
    means = np.empty(count, np.float32)
    beyond = max(neighbors - RANKS, 0)  # neighbours that the registers do not hold
    nearest, others = np.empty(max(neighbors, RANKS) * RUN, np.float32), np.empty((beyond + 1) * RUN, np.float32)
    squares, gaps = np.empty(RUN * RUN, np.float32), np.empty(RUN, np.float32)
    # Boxes still to look at: each puts at most sixteen smaller ones in its place. Not in the order of their distance:
    # fewer would be looked at, but sorting takes longer than that.
    box_gap = np.empty((levels + 1) * RUN, np.float32)
    box_level, box_number = np.empty((levels + 1) * RUN, np.int64), np.empty((levels + 1) * RUN, np.int64)

    for run in range(runs):
        begin = run * RUN
        x, y, z = _load(xs, begin), _load(ys, begin), _load(zs, begin)
        ranks = _ranks_of(_spread(LARGEST))
        for row in range(0, beyond * RUN, RUN):
            _store(others, row, _spread(LARGEST))
        for j in range(min(RUN, count - begin)):
            distance = _replaced(_squared(x, y, z, xs, ys, zs, begin + j), j, LARGEST)  # not to itself
            if beyond > 0:
                _insert(others, beyond, _larger(_last_rank(ranks), distance))
            ranks = _with_one_more(ranks, distance)
        at = run // RUN * BOX + run % RUN
        x_low, y_low, z_low = _spread(corners[at]), _spread(corners[at + RUN]), _spread(corners[at + 2 * RUN])
        at += 3 * RUN
        x_high, y_high, z_high = _spread(corners[at]), _spread(corners[at + RUN]), _spread(corners[at + 2 * RUN])
        farthest = _last_rank(ranks) if beyond == 0 else _load(others, (beyond - 1) * RUN)
        limit = _highest(farthest)

        # Those before and behind it on the curve, which are near as a rule; then from the run upwards: the other boxes
        # of its node, then those of the node above, and so on.
        waiting, above, climbed, beside = 0, run, 0, 2
        while waiting > 0 or climbed < levels:
            if beside > 0:
                beside -= 1
                level, node, left_out = -1, run - 1 + 2 * beside, 0
                if node < 0 or node >= runs:
                    continue
            elif waiting > 0:
                waiting -= 1
                if box_gap[waiting] >= limit:
                    continue
                level, node, left_out = box_level[waiting] - 1, box_number[waiting], 0
                if level < 0 and abs(node - run) == 1:
                    continue
                at = (first[level + 1] + node // RUN) * BOX + node % RUN
                gap = _beyond(_spread(corners[at]), x, x, _spread(corners[at + 3 * RUN]))
                gap = gap + _beyond(_spread(corners[at + RUN]), y, y, _spread(corners[at + 4 * RUN]))
                gap = gap + _beyond(_spread(corners[at + 2 * RUN]), z, z, _spread(corners[at + 5 * RUN]))
                if _below(gap, farthest) == 0:
                    continue
            else:
                level, node, left_out = climbed, above // RUN, 1 << (above % RUN)
                above, climbed = node, climbed + 1

            if level < 0:
                begin_other, nearer = node * RUN, 0
                for j in range(RUN):
                    distance = _squared(x, y, z, xs, ys, zs, begin_other + j)
                    _store(squares, j * RUN, distance)
                    nearer |= (1 if _below(distance, farthest) != 0 else 0) << j
                if begin_other + RUN > count:
                    nearer &= (1 << (count - begin_other)) - 1  # the others are copies of the last point
                if nearer != 0:
                    while nearer != 0:
                        distance = _load(squares, _lowest_bit(nearer) * RUN)
                        if beyond > 0:
                            _insert(others, beyond, _larger(_last_rank(ranks), distance))
                        ranks = _with_one_more(ranks, distance)
                        nearer &= nearer - 1
                    farthest = _last_rank(ranks) if beyond == 0 else _load(others, (beyond - 1) * RUN)
                    limit = _highest(farthest)
                continue

            at = (first[level] + node) * BOX
            gap = _beyond(_load(corners, at), x_low, x_high, _load(corners, at + 3 * RUN))
            gap = gap + _beyond(_load(corners, at + RUN), y_low, y_high, _load(corners, at + 4 * RUN))
            gap = gap + _beyond(_load(corners, at + 2 * RUN), z_low, z_high, _load(corners, at + 5 * RUN))
            _store(gaps, 0, gap)
            near = _below(gap, _spread(limit)) & ~left_out
            while near != 0:
                child = _lowest_bit(near)
                near &= near - 1
                box_gap[waiting], box_level[waiting], box_number[waiting] = gaps[child], level, node * RUN + child
                waiting += 1

        _store_ranks(nearest, ranks)
        for i in range(beyond * RUN):
            nearest[RANKS * RUN + i] = others[i]
        total = _roots(_load(nearest, 0))
        for row in range(RUN, neighbors * RUN, RUN):
            total = total + _roots(_load(nearest, row))
        _store(gaps, 0, _share(total, neighbors))
        for j in range(min(RUN, count - begin)):
            means[order[begin + j]] = gaps[j]
    return means
