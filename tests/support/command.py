"""A finished command of lidcam."""

from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Lidcam", "Run"]


@dataclass(frozen=True)
class Run:
    """A finished command."""

    code: int
    out: str
    err: str

    @property
    def error_line(self) -> str:
        """The one line that says what went wrong."""
        assert "Traceback" not in self.err, self.err
        lines = [line for line in self.err.splitlines() if line.startswith("lidcam: error:")]
        assert len(lines) == 1, self.err
        return lines[0]


Lidcam = Callable[..., Run]
