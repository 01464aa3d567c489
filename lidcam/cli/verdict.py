"""The end of a command that has done its work: complete, incomplete, or short of a check."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from lidcam.pipeline.core.errors import CheckError, IncompleteError

DONE, FAILED, INCOMPLETE = 0, 1, 3
"""Exit codes: done; failed, or a check failed; done, but part of the recording could not be used."""

MAX_LISTED = 4
"""Reasons in the line."""


class Verdict(NamedTuple):
    """The end of a command that has done its work.

    Attributes:
        failures: Failed checks, one line each; the outputs are kept.
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
            CheckError: a check failed.
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
