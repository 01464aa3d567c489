"""What every writer of results can do."""

from types import TracebackType
from typing import Protocol, Self

from pipeline.core.frame import FrameResult
from pipeline.core.messages import Drop

__all__ = ["ResultWriter"]


class ResultWriter(Protocol):
    """Takes the frames of one run, in order.

    A context manager: the output appears when the block ends well; when it ends with an exception nothing is left.
    Not safe for calls from several threads at once.

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
        """Complete the output, or discard it if the block ended with an exception.

        Raises:
            OutputError: it cannot be completed.
        """
        ...

    def write(self, result: FrameResult) -> tuple[Drop, ...]:
        """Write one frame.

        Returns:
            Messages of the frame that could not be copied; the rest of the frame is written.

        Raises:
            OutputError: the frame cannot be written.
        """
        ...
