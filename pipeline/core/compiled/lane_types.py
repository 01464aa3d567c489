"""How numba learns of vectors of sixteen numbers, and of what can be done with them: see `lanes`."""

import inspect
import operator
from collections.abc import Callable
from functools import cache
from typing import Any, ParamSpec, TypeVar

from llvmlite import ir
from numba.core import types
from numba.core.datamodel import PrimitiveModel
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import lower_builtin, register_model, type_callable

__all__ = ["LANES", "RANKS", "lanes_type", "operation", "ranks_type", "wide_type"]

P = ParamSpec("P")
R = TypeVar("R")

LANES = 16
"""Numbers of a vector."""

RANKS = 10
"""Vectors of `Ranks`: what stays in registers, of 32 in all, and the default of `combine.outliers.neighbors`."""


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
        HeldType("Lanes", lanes_type()),
        HeldType("WideLanes", wide_type()),
        HeldType("Ranks", ranks_type()),
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


def operation(result: str, *arguments: str, emit: Callable[..., Any]) -> Callable[[Callable[P, R]], Callable[P, R]]:
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


@cache
def lanes_type() -> Any:
    """Of `Lanes`, for LLVM."""
    return ir.VectorType(ir.FloatType(), LANES)


@cache
def wide_type() -> Any:
    """Of `WideLanes`, for LLVM."""
    return ir.VectorType(ir.DoubleType(), LANES)


@cache
def ranks_type() -> Any:
    """Of `Ranks`, for LLVM."""
    return ir.ArrayType(lanes_type(), RANKS)
