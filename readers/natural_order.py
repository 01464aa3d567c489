"""The order of names with numbers in them."""

import re


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sorts `cam2` before `cam10`; total over all strings."""
    parts = re.split(r"(\d{1,640})", name)  # Python reads no numbers that are much longer
    return (*((1, int(part), part) if part.isdecimal() else (0, 0, part) for part in parts), (0, 0, name))
