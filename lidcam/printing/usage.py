"""Wrong usage, told as Typer tells it."""

import io
import sys
from contextlib import suppress

from typer.exceptions import TyperException

from lidcam.printing.escaping import visible, visible_lines

__all__ = ["print_usage_error"]


def print_usage_error(error: TyperException) -> None:
    """Print the usage of a command and what is wrong with its arguments, which are quoted and made visible."""
    message = error.format_message()
    if not message.startswith("Usage: "):  # the whole help, where a command without arguments prints that
        vars(error)["format_message"] = lambda: visible(message)
    told = io.StringIO()
    error.show(told)  # type: ignore[attr-defined]  # of all that Typer raises
    with suppress(OSError):  # nobody reads it
        sys.stderr.write(visible_lines(told.getvalue()))
