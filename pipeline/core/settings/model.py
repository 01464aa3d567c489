"""Base class of the settings, and their types."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator

from lidcam.pipeline.core.settings.validation import Noun, found

MIN_POSITIVE, MAX_NUMBER = 1e-9, 9e9
"""Seconds beyond do not fit into 64 bits of nanoseconds, and what is divided by less overflows."""


def _at_least_a_little(value: float) -> float:
    if value < MIN_POSITIVE:
        raise ValueError(f"expected a number of {MIN_POSITIVE:g} or more, found {found(value)}")
    return value


Positive = Annotated[float, Field(gt=0), AfterValidator(_at_least_a_little)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1)]
Topic = Annotated[str, Noun("a topic", "topics", "/velodyne_points")]
FrameName = Annotated[str, Noun("the name of a frame", "names of frames", "base_link")]
ZoneName = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
Corners = Annotated[tuple[tuple[float, float], ...], Field(min_length=3)]
Label = Annotated[str, Noun("a label", "labels", "car")]


class SettingsModel(BaseModel):
    """A section of the settings: immutable, rejects unknown keys and numbers that are too large.

    Attributes:
        GONE: Advice by the name of a setting that earlier versions had.
    """

    GONE: ClassVar[Mapping[str, str]] = {}

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __repr__(self) -> str:
        """What differs from the defaults."""
        return f"{type(self).__name__}({self.model_dump(exclude_defaults=True)})"

    __str__ = __repr__

    @field_validator("*")
    @classmethod
    def _number_is_usable(cls, value: Any) -> Any:
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, tuple):
                cls._number_is_usable(number)
            elif isinstance(number, (int, float)) and not abs(number) <= MAX_NUMBER:
                raise ValueError(f"expected a number of {MAX_NUMBER:g} or less in size, found {found(number)}")
        return value
