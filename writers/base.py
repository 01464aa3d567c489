"""The protocol of result writers."""

from types import TracebackType
from typing import Protocol, Self

from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import Drop


class ResultWriter(Protocol):
    """Writes the frames of one run, in order.

    A context manager: what is written is complete when the block ends without error. It gets its name afterwards, with
    all other outputs of the run (`lidcam.writers.outputs.transaction`), or is discarded with them. Not thread-safe.

    Attributes:
        name: Short name of the kind of output, for timings and messages.
    """

    name: str

    def __enter__(self) -> Self:
        """Open the output.

        Raises:
            OutputError: it cannot be written.
        """
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the output, or give it up if the block ended with an exception.

        Raises:
            OutputError: it cannot be completed.
        """
        ...

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Write one frame.

        Returns:
            Messages of the frame that could not be written; the rest of the frame is.

        Raises:
            OutputError: the frame cannot be written.
        """
        ...
