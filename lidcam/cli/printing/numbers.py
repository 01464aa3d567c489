"""Formats of numbers in tables."""

from typing import Literal

Units = Literal["km/h", "m/s", "mph"]
"""Units of speeds that tables are printed in."""

PER_M_S: dict[Units, float] = {"km/h": 3.6, "m/s": 1.0, "mph": 3600 / 1609.344}
"""Factors from metres per second."""

NONE = "-"
"""Text for an undefined figure."""


def number(value: float | None, digits: int) -> str:
    """A number with `digits` decimals; zero has no minus."""
    return NONE if value is None else f"{value:z.{digits}f}"


def signed(value: float | None, digits: int) -> str:
    """A number with a sign; zero has a plus."""
    return NONE if value is None else f"{value:+z.{digits}f}"


def share(value: float | None) -> str:
    """A number that mostly lies between 0 and 1."""
    return number(value, 2)


def percent(value: float | None) -> str:
    """A share in whole percent."""
    return NONE if value is None else f"{100 * value:z.0f} %"
