"""Results kept in memory, for callers that want records instead of files."""

from types import TracebackType
from typing import Self

from pipeline.core.frame import FrameResult
from pipeline.core.messages import Drop

__all__ = ["MemoryWriter"]


class MemoryWriter:
    """Keeps every frame.

    The frames hold their recorded messages and clouds: memory grows with the length of the recording.

    Attributes:
        results: The frames so far; emptied when the block ends with an exception.
    """

    name = "memory"

    def __init__(self) -> None:
        self.results: list[FrameResult] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.results.clear()

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Keep one frame."""
        self.results.append(result)
        return ()
