"""How numbers stand in tables."""

NONE = "-"
"""In place of a figure that is not defined."""


def number(value: float | None, digits: int) -> str:
    """With so many digits behind the point; no minus before a zero."""
    return NONE if value is None else f"{value:z.{digits}f}"


def signed(value: float | None, digits: int) -> str:
    """As `number`, with its sign; zero has a plus."""
    return NONE if value is None else f"{value:+z.{digits}f}"


def share(value: float | None) -> str:
    """A number that mostly lies between 0 and 1."""
    return number(value, 2)


def percent(value: float | None) -> str:
    """A share in whole percent."""
    return NONE if value is None else f"{100 * value:z.0f} %"
