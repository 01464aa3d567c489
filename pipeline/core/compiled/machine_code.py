"""What is kept of a compiled function: its machine code, and what has to be known to run it without a compiler."""

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

__all__ = ["Argument", "MachineCode", "undefined_symbols"]

COMMON = 0xFFF2
"""The section of numbers that the linker makes room for."""

_SYMBOL = np.dtype(
    [("name", "<u4"), ("info", "u1"), ("other", "u1"), ("section", "<u2"), ("value", "<u8"), ("size", "<u8")]
)


@dataclass(frozen=True)
class Argument:
    """What a compiled function takes in one place.

    Attributes:
        kind: "array", "integer", "real" or "boolean".
        dtype: Of an array, as `np.dtype` takes it.
        ndim: Of an array, its number of dimensions.
        flags: Of an array, the bits that its `flags.num` must have.
    """

    kind: str
    dtype: str = ""
    ndim: int = 0
    flags: int = 0


@dataclass(frozen=True)
class MachineCode:
    """A compiled function.

    Attributes:
        entry: Symbol of what is called, with Python's objects.
        environment: Symbol of what the function itself refers to.
        environments: Symbols of what it and its parts refer to, each with the names of the dtypes there.
        needed: Symbols that are not part of the code.
        arguments: What it takes.
        code: An object file.
    """

    entry: str
    environment: str
    environments: dict[str, list[str]]
    needed: list[str]
    arguments: list[Argument]
    code: bytes

    def to_bytes(self) -> bytes:
        """A line that describes it, and the object file."""
        described = asdict(self) | {"code": len(self.code)}
        return json.dumps(described).encode() + b"\n" + self.code

    @classmethod
    def from_bytes(cls, data: bytes) -> "MachineCode":
        """What `to_bytes` was made of."""
        line, _, code = data.partition(b"\n")
        described: dict[str, Any] = json.loads(line)
        described["arguments"] = [Argument(**argument) for argument in described["arguments"]]
        return cls(**(described | {"code": code}))


def undefined_symbols(symtab: bytes, strtab: bytes) -> tuple[list[str], list[str]]:
    """Symbols of an object file (ELF, 64 bits, little-endian) that are not in it, and those that wait for room.

    Args:
        symtab: Contents of the section of symbols.
        strtab: Contents of the section of names.
    """
    symbols = np.frombuffer(symtab, _SYMBOL)

    def in_section(section: int) -> list[str]:
        starts = symbols["name"][(symbols["section"] == section) & (symbols["name"] > 0)]
        return sorted(strtab[start : strtab.index(b"\0", start)].decode() for start in starts.tolist())

    return in_section(0), in_section(COMMON)
