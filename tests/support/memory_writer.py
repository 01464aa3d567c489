"""A writer of results that keeps the frames."""

from types import TracebackType
from typing import Self

from pipeline.core.frame import FrameResult
from pipeline.core.messages import Drop

__all__ = ["MemoryWriter"]


class MemoryWriter:
    name = "memory"

    def __init__(self) -> None:
        self.results: list[FrameResult] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        self.results.append(result)
        return ()
