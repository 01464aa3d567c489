"""The base of result writers."""

from abc import ABC, abstractmethod
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import Drop
from lidcam.writers.outputs.errors import output_errors


class ResultWriter(ABC):
    """Writes the frames of one run, in order; raises OutputError where it cannot.

    A context manager: what is written is complete when the block ends without error. It gets its name afterwards, with
    all other outputs of the run (`lidcam.writers.outputs.transaction`), or is discarded with them. Not thread-safe.
    """

    name: str  # Short name of the kind of output, for timings and messages
    path: Path  # The output in error messages

    def __enter__(self) -> Self:
        """Open the output."""
        with output_errors(self.path), ExitStack() as resources:
            self._open(resources)
            self._resources = resources.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the output, or give it up if the block ended with an exception."""
        if kind is not None:
            with suppress(OSError):  # what is written is discarded
                self._resources.__exit__(kind, error, trace)
            return
        with output_errors(self.path), self._resources:
            self._finish()

    @abstractmethod
    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Write one frame; returns messages of it that could not be written, as the rest is."""

    def _open(self, resources: ExitStack) -> None:  # noqa: B027
        """Open the output; `resources` end with the block."""

    def _finish(self) -> None:  # noqa: B027
        """Write the end of the output."""
