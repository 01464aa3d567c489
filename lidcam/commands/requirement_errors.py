"""Requirements on the command line that are none."""

from collections.abc import Iterator
from contextlib import contextmanager

import typer

from lidcam.evaluation.requirement import RequirementError

__all__ = ["requirement_errors"]


@contextmanager
def requirement_errors() -> Iterator[None]:
    """Turn requirements that are none, or name no figure, into wrong usage.

    Raises:
        typer.BadParameter: one is.
    """
    try:
        yield
    except RequirementError as err:
        raise typer.BadParameter(str(err), param_hint="--require") from err
