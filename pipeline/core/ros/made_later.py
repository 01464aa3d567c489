"""A dict whose values are made when they are asked for."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar, cast

__all__ = ["MadeLater"]

V = TypeVar("V")


class _Maker:
    def __init__(self, make: Callable[[], object]) -> None:
        self.make = make


class MadeLater(dict[str, V]):
    """A dict whose values are made when they are asked for, each once; copies have them made.

    Args:
        values: Those that are there already; those of another such dict are made when they are asked for.
        makers: Of the other values.
    """

    def __init__(self, values: Mapping[str, V], makers: Mapping[str, Callable[[], V]] | None = None) -> None:
        super().__init__(values.raw() if isinstance(values, MadeLater) else values)
        super().update({key: cast("V", _Maker(make)) for key, make in (makers or {}).items()})

    def raw(self) -> dict[str, V]:
        """A copy, with what makes values in their places."""
        return {key: super(MadeLater, self).__getitem__(key) for key in self}

    def __getitem__(self, key: str) -> V:
        value = super().__getitem__(key)
        if isinstance(value, _Maker):
            value = self[key] = cast("V", value.make())
        return value

    def __iter__(self) -> Iterator[str]:  # without it, copies would be made of what is inside
        return super().__iter__()

    def get(self, key: str, default: Any = None) -> Any:
        """As a dict does."""
        try:
            return self[key]
        except KeyError:
            return default

    def items(self) -> Any:
        """As a dict does; all values are made."""
        return {key: self[key] for key in self}.items()

    def values(self) -> Any:
        """As a dict does; all values are made."""
        return {key: self[key] for key in self}.values()
