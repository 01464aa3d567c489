"""Requirements on the command line that are none."""

from collections.abc import Iterator
from contextlib import contextmanager

import typer

from pipeline.core.errors import ConfigError

__all__ = ["requirement_errors"]


@contextmanager
def requirement_errors() -> Iterator[None]:
    """Turn requirements that are none, or name no figure, into wrong usage.

    Raises:
        typer.BadParameter: one is.
    """
    try:
        yield
    except ConfigError as err:
        from lidcam.evaluation.requirement import RequirementError  # mostly nothing is required

        if not isinstance(err, RequirementError):
            raise
        raise typer.BadParameter(str(err), param_hint="--require") from err
