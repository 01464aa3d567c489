"""Errors on their way between processes."""

import traceback
from dataclasses import dataclass

from pipeline.core.errors import LidcamError, is_short_memory
from pipeline.parallel.transfer import arrived

__all__ = ["Failure", "WorkerTraceback", "failure_of"]


class WorkerTraceback(Exception):
    """Where an error came from, in another process; the cause of the error here."""


@dataclass(frozen=True, slots=True)
class Failure:
    """An error as it travels.

    Attributes:
        error: The error, with its notes; it can be pickled.
        trace: Its traceback as text.
    """

    error: Exception
    trace: str

    def raised(self) -> Exception:
        """The error, to be raised in this process."""
        self.error.__cause__ = WorkerTraceback(f"\n{self.trace}")
        return self.error


def failure_of(err: Exception) -> Failure:
    """An error as it travels; one that cannot be pickled becomes a `RuntimeError` with its type and text."""
    return Failure(_portable(err), "".join(traceback.format_exception(err)))


def _portable(err: Exception) -> Exception:
    if is_short_memory(err) and not isinstance(err, LidcamError):
        return _noted(MemoryError(str(err)), err)  # whatever a library says with an error of its own
    try:
        copy = arrived(err)
    except Exception:
        copy = None
    if type(copy) is type(err) and str(copy) == str(err):
        return err
    return _noted(RuntimeError(f"{type(err).__qualname__}: {err}"), err)


def _noted(error: Exception, original: Exception) -> Exception:
    for note in getattr(original, "__notes__", ()):
        error.add_note(note)
    return error
