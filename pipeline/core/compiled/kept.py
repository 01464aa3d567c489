"""Where machine code is kept between processes, and for what it is valid.

It is kept beside the source, in `__pycache__`; where that cannot be written, in the user's cache; or in the folder that
`NUMBA_CACHE_DIR` names. It is read from any of these. A file is valid for one text of the source and of what that uses,
one version of the libraries and one processor; its first bytes say for which, and that it is whole.
"""

import hashlib
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from pipeline.core.compiled.machine_code import MachineCode

__all__ = ["Keeper"]

DIGEST = hashlib.sha256


class Keeper:
    """Keeps the machine code of a function."""

    def __init__(self, source: Path, function: str, made_for: str, used: bytes = b"") -> None:
        """Read the source.

        Args:
            source: Path of the file with the function.
            function: Its qualified name.
            made_for: What the machine code is for: what is kept for something else stays beside it.
            used: All else that it depends on beside the source.

        Raises:
            OSError: the source cannot be read.
        """
        self._source = source
        self._name = f"{source.stem}.{function}.{_short(made_for)}.code"
        self._key = DIGEST("\0".join((function, made_for, "")).encode() + source.read_bytes() + b"\0" + used).digest()

    def read(self) -> MachineCode | None:
        """What was kept; nothing if it is not there, damaged, or of another source."""
        for folder in self._folders():
            with suppress(OSError):
                data = (folder / self._name).read_bytes()
                size = len(self._key)
                key, digest, body = data[:size], data[size : 2 * size], data[2 * size :]
                if key == self._key and digest == DIGEST(body).digest():
                    return MachineCode.from_bytes(body)
        return None

    def write(self, code: MachineCode) -> bool:
        """Keep it, in the first place that can be written; whether there is one."""
        body = code.to_bytes()
        data = self._key + DIGEST(body).digest() + body
        for folder in self._folders():
            with suppress(OSError):
                folder.mkdir(parents=True, exist_ok=True)
                _replace(folder / self._name, data)
                return True
        return False

    def _folders(self) -> Iterator[Path]:
        apart = f"{self._source.parent.name}_{_short(str(self._source.parent))}"
        named = os.environ.get("NUMBA_CACHE_DIR")
        if named:
            yield Path(named) / apart
            return
        yield self._source.parent / "__pycache__"
        with suppress(RuntimeError):  # there is no home
            caches = os.environ.get("XDG_CACHE_HOME")
            yield (Path(caches) if caches else Path.home() / ".cache") / "lidcam" / apart


def _replace(path: Path, data: bytes) -> None:
    """Write a file so that other processes see it whole or not at all."""
    part = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        part.write_bytes(data)
        part.replace(path)
    except BaseException:
        with suppress(OSError):
            part.unlink()
        raise


def _short(text: str) -> str:
    return DIGEST(text.encode()).hexdigest()[:16]
