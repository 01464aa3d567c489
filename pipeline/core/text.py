"""Text forms: records in short, for notebooks and debuggers, and in one line what comes from outside.

From outside are messages of libraries, and names and values of a file.
"""

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from reprlib import Repr
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # `--help` needs no numpy
    from lidcam.pipeline.core.arrays import Array


def one_line(found: object, *, max_characters: int | None = None) -> str:
    """The text of an error or of any other thing, with one blank in place of line ends and of several blanks."""
    return " ".join(str(found).split())[:max_characters]


def listed(names: Sequence[str], most: int = 10) -> str:
    """Names behind one another; of many the first ones, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def visible(text: str) -> str:
    r"""The text with `\x1b` and the like in place of all that is not printable, line ends and tabs too.

    Not printable are control characters (C0, C1), format characters (direction of writing, no width), separators other
    than the blank, surrogates (bytes of a file name that are no UTF-8), and what Unicode does not assign.
    """
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)


class _Brief(Repr):
    """`reprlib.Repr` that also knows arrays, bytes and records. It finds these methods by the name of the type."""

    def repr_ndarray(self, array: "Array", _level: int) -> str:
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
