"""What every part of a scenario is built from."""

from typing import Annotated

from pydantic import Field

__all__ = ["Metres", "Name", "Topic", "Vector"]

Metres = Annotated[float, Field(ge=-1e5, le=1e5)]
"""Of places: further out, single precision knows no millimetres."""
Vector = tuple[float, float, float]
Topic = Annotated[str, Field(pattern=r"^/[A-Za-z_]\w*(/\w+)*$")]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]
