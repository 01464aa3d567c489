"""Value types of scenario settings."""

from typing import Annotated

from pydantic import Field

from pipeline.core.settings.validation import Noun

__all__ = ["Metres", "Name", "Topic", "Vector"]

Metres = Annotated[float, Field(ge=-1e5, le=1e5)]
"""A coordinate: further out, single precision cannot hold millimetres."""
Vector = tuple[float, float, float]
Topic = Annotated[
    str,
    Field(pattern=r"^/[A-Za-z_]\w*(/\w+)*$"),
    Noun("a topic that begins with /", "topics that begin with /", "/points"),
]
Name = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]
