"""Base class of the settings, and their types."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, field_validator

from pipeline.core.settings.validation import Noun, found

__all__ = [
    "Corners",
    "Count",
    "FrameName",
    "Label",
    "NotNegative",
    "Positive",
    "SettingsModel",
    "Share",
    "Topic",
    "ZoneName",
]


Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
Topic = Annotated[str, Noun("a topic", "topics", "/velodyne_points")]
FrameName = Annotated[str, Noun("the name of a frame", "names of frames", "base_link")]
ZoneName = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
Corners = Annotated[tuple[tuple[float, float], ...], Field(min_length=3)]
Label = Annotated[str, Noun("a label", "labels", "car")]


MIN_NUMBER, MAX_NUMBER = 1e-9, 1e9
"""Sizes of numbers: seconds beyond do not fit into 64 bits of nanoseconds, and what is divided by less overflows."""


class SettingsModel(BaseModel):
    """A section of the settings: immutable, rejects unknown keys, and numbers that are too large or too near to 0.

    Attributes:
        GONE: Advice by the name of a setting that earlier versions had.
    """

    GONE: ClassVar[Mapping[str, str]] = {}

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*")
    @classmethod
    def _number_is_usable(cls, value: Any) -> Any:
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, tuple):
                cls._number_is_usable(number)
            elif isinstance(number, (int, float)) and number and not MIN_NUMBER <= abs(number) <= MAX_NUMBER:
                limits = f"{MIN_NUMBER:g} to {MAX_NUMBER:g}"
                raise ValueError(f"expected 0, or a number of {limits} in size, found {found(number)}")
        return value
