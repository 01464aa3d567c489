"""Base class of the settings, and their types."""

from collections.abc import Mapping
from typing import Annotated, ClassVar

from pydantic import BaseModel, ConfigDict, Field

from pipeline.core.settings.validation import Noun

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


class SettingsModel(BaseModel):
    """A section of the settings: immutable, rejects unknown keys and numbers that are not finite.

    Attributes:
        GONE: Advice by the name of a setting that earlier versions had.
    """

    GONE: ClassVar[Mapping[str, str]] = {}

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
