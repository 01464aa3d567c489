"""Base class of the settings, and their types."""

from functools import cache
from typing import Annotated, Any, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo, field_validator

MAX_NUMBER = 9e9
"""Largest number in settings: more seconds do not fit into 64 bits of nanoseconds."""

Positive = Annotated[float, Field(gt=0, le=MAX_NUMBER)]
NotNegative = Annotated[float, Field(ge=0, le=MAX_NUMBER)]
Share = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=1, le=int(MAX_NUMBER))]
CountFromZero = Annotated[int, Field(ge=0, le=int(MAX_NUMBER))]

OUTSIDE_ZONES = "outside"
"""Name of the rest of a site with zones."""


def _not_outside(name: str) -> str:
    if name == OUTSIDE_ZONES:
        raise ValueError(f"{OUTSIDE_ZONES!r} names what lies in no zone; expected another name")
    return name


ZoneName = Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$"), AfterValidator(_not_outside)]
Corners = Annotated[tuple[tuple[float, float], ...], Field(min_length=3)]


@cache
def _kinds(annotation: Any) -> frozenset[Any]:
    """A type, or the types of a union and of what is annotated."""
    parts = get_args(annotation)
    return frozenset().union(*map(_kinds, parts)) if parts else frozenset({annotation})


class SettingsModel(BaseModel):
    """A section of the settings: immutable, rejects unknown keys and numbers that are not finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _numbers_are_no_switches(cls, value: object, info: ValidationInfo) -> object:
        annotation: Any = cls.model_fields[info.field_name or ""].annotation
        kinds = _kinds(annotation)
        if isinstance(value, bool) and bool not in kinds and not kinds.isdisjoint({int, float}):
            raise ValueError("expected a number, found a switch (in YAML, on, off, yes and no are switches)")
        return value

    def __repr__(self) -> str:
        """Values that differ from the defaults."""
        return f"{type(self).__name__}({self.model_dump(exclude_defaults=True)})"

    __str__ = __repr__
