"""How a command ends that has done its work: whole, incomplete, or short of what --strict asks for."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from lidcam.pipeline.core.errors import CheckError, IncompleteError

DONE = 0
"""Exit code: nothing is missing."""

FAILED = 1
"""Exit code: nothing was written, or a check failed."""

INCOMPLETE = 3
"""Exit code: the outputs are complete, but part of the recording could not be used. 2 is wrong usage."""

MAX_LISTED = 4
"""Reasons in the line."""


class Verdict(NamedTuple):
    """How a command ends that has done its work.

    Attributes:
        failures: Why it failed, although its outputs are there, one line each; empty if it did not.
        incomplete: Parts of the recording that could not be used, one line each.
    """

    failures: tuple[str, ...] = ()
    incomplete: Sequence[str] = ()

    @property
    def exit_code(self) -> int:
        """The exit code of the program."""
        return FAILED if self.failures else INCOMPLETE if self.incomplete else DONE

    def tree(self) -> dict[str, Any]:
        """As plain values, for JSON."""
        return {"failure": "; ".join(self.failures), "incomplete": [*self.incomplete], "exit_code": self.exit_code}

    def end(self) -> None:
        """End the command.

        Raises:
            CheckError: it failed, and its outputs are there.
            IncompleteError: part of the recording could not be used.
        """
        if self.failures:
            raise CheckError(*self.failures)
        if self.incomplete:
            raise IncompleteError(first_of(self.incomplete))


def first_of(reasons: Sequence[str]) -> str:
    """The first reasons in one line, and how many more there are."""
    more = f"; and {len(reasons) - MAX_LISTED} more" if len(reasons) > MAX_LISTED else ""
    return f"{'; '.join(reasons[:MAX_LISTED])}{more}"
