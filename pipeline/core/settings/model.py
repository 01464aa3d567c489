"""Base class of the settings, and their types."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

MAX_NUMBER = 9e9
"""Largest number in settings: more seconds do not fit into 64 bits of nanoseconds."""

Positive = Annotated[float, Field(gt=0, le=MAX_NUMBER)]
NotNegative = Annotated[float, Field(ge=0, le=MAX_NUMBER)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1, le=int(MAX_NUMBER))]
ZoneName = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
Corners = Annotated[tuple[tuple[float, float], ...], Field(min_length=3)]


class SettingsModel(BaseModel):
    """A section of the settings: immutable, rejects unknown keys and numbers that are not finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __repr__(self) -> str:
        """Values that differ from the defaults."""
        return f"{type(self).__name__}({self.model_dump(exclude_defaults=True)})"

    __str__ = __repr__
