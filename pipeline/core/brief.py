"""Short text forms of records, for notebooks and debuggers: what is in them, not the numbers."""

from dataclasses import fields, is_dataclass
from reprlib import Repr
from typing import Any

from pipeline.core.arrays import Array

__all__ = ["brief"]


class _Brief(Repr):
    """`reprlib.Repr` that also knows arrays, bytes and records. It finds these methods by the name of the type."""

    def repr_ndarray(self, array: Array, _level: int) -> str:
        return f"{array.dtype}{list(array.shape)}"

    def repr_bytes(self, data: bytes, _level: int) -> str:
        return f"<{len(data)} bytes>"

    repr_mappingproxy = Repr.repr_dict

    def repr_instance(self, value: Any, level: int) -> str:
        if is_dataclass(value) and not isinstance(value, type):
            names = [field.name for field in fields(value)]
        elif isinstance(value, tuple) and hasattr(value, "_fields"):
            names = list(value._fields)
        else:
            return super().repr_instance(value, level)
        if level <= 0:
            return f"{type(value).__name__}(...)"
        inside = (f"{name}={self.repr1(getattr(value, name), level - 1)}" for name in names)
        return f"{type(value).__name__}({', '.join(inside)})"


_BRIEF = _Brief()
_BRIEF.maxlevel, _BRIEF.maxtuple, _BRIEF.maxother = 2, 3, 60


def brief(record: Any) -> str:
    """The `__repr__` of records: shape and dtype of arrays, the size of bytes, and records in records to some depth."""
    return _BRIEF.repr_instance(record, _BRIEF.maxlevel)
