"""Requirements on figures: `fused.car.ap_bev_r40_50 >= 0.9`."""

import operator
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any

from lidcam.evaluation.figures import LABELS, NamedFigures
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.small_files import read_small_text
from lidcam.pipeline.evaluation.evaluation_frame import Figure

EXAMPLE = "fused.car.ap_bev_r40_50 >= 0.9"

OPERATORS: Mapping[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}

TRACKING = "tracking."
"""Beginning of the names of figures that only results with track ids have."""

MAX_REQUIREMENT_BYTES = 1 << 20
"""Largest size of a file of requirements: some twenty thousand."""

_FORM = re.compile(r"(?P<name>[^\s<>=!][^<>=!]*?)\s*(?P<sign>[<>=!]+)\s*(?P<limit>[^\s<>=!]+)")


class RequirementError(ConfigError):
    """A requirement is malformed or names an unknown figure, or a file of requirements cannot be read."""


@dataclass(frozen=True, slots=True)
class Requirement:
    """A limit for a figure."""

    name: str  # Its dotted name
    sign: str  # How the figure is compared with the limit; a key of `OPERATORS`
    limit: float  # In the unit of the figure

    @classmethod
    def parse(cls, text: str) -> "Requirement":
        """The requirement that a text states; raises RequirementError if that is malformed."""
        parts = _FORM.fullmatch(text.strip())
        if parts is None:
            raise RequirementError(f"expected a figure, a comparison and a number, as in {EXAMPLE!r}, found {text!r}")
        if parts["sign"] not in OPERATORS:
            raise RequirementError(f"{text!r}: expected one of {', '.join(OPERATORS)}, found {parts['sign']!r}")
        try:
            limit = float(parts["limit"])
        except ValueError:
            limit = float("nan")
        if not isfinite(limit):
            hint = "; shares are numbers from 0 to 1" if parts["limit"].endswith("%") else ""
            raise RequirementError(f"{text!r}: expected a number after {parts['sign']}, found {parts['limit']!r}{hint}")
        return cls(parts["name"], parts["sign"], limit)

    def check(self, figures: NamedFigures) -> "Outcome":
        """The outcome for some figures. A figure that is undefined or unknown fails the requirement."""
        expected = f"{self.name}: expected {self.sign} {self.limit:g}"
        if self.name.startswith(TRACKING) and self.name not in figures and not figures.tree.get(TRACKING.rstrip(".")):
            return Outcome(self, None, f"{expected}, found no tracks: result and truth need ids of tracks")
        if self.name not in figures:
            hint = figures.unknown(self.name).partition("': ")[2]
            return Outcome(self, None, f"{expected}, found no such figure: {hint}")
        found = figures[self.name]
        if found is None:
            return Outcome(self, None, f"{expected}, found that it is not defined{why_undefined(figures, self.name)}")
        if isinstance(found, str):
            return Outcome(self, found, f"{expected}, found the text {found!r}")
        if OPERATORS[self.sign](found, self.limit):
            return Outcome(self, found, "")
        return Outcome(self, found, f"{expected}, found {_apart(found, self.limit)}")


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a requirement."""

    requirement: Requirement  # The requirement
    found: Figure  # The figure; None if it is not defined, or there is none of that name
    failure: str  # Why it is not met, in one line; empty if it is

    def tree(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        named = {"figure": self.requirement.name, "comparison": self.requirement.sign, "limit": self.requirement.limit}
        return {**named, "found": self.found, "is_met": not self.failure}


def read_requirements(texts: Iterable[str]) -> tuple[Requirement, ...]:
    """Requirements as given on the command line; `@FILE` stands for those of a file.

    A file has one in a line; empty lines count for nothing, and neither does what follows a `#`. Raises
    RequirementError if a requirement is malformed, or a file cannot be read or holds none.
    """
    found: list[Requirement] = []
    for text in texts:
        found += _of_file(Path(text[1:])) if text.startswith("@") else [Requirement.parse(text)]
    return tuple(found)


def check_names(requirements: Sequence[Requirement], known: NamedFigures) -> None:
    """Raise RequirementError if there can be no figures of these names.

    `known` are those of a result without objects. It lacks figures named by the words of the truth, figures of tracks,
    which a result may not have, and some elements of lists.
    """
    for name in dict.fromkeys(one.name for one in requirements):
        depends = f".{LABELS}." in name or name.startswith(TRACKING) or any(map(str.isdecimal, name.split(".")))
        if name not in known and not depends:
            raise RequirementError(known.unknown(name))


def why_undefined(figures: NamedFigures, name: str) -> str:
    """The reason why a figure is undefined, after a colon; empty if no count beside it or above it is 0."""
    if figures.get("frames_with_truth") == 0:
        return ": there is no truth"
    for count, reason in _REASONS.items():
        if figures.nearest_count(name, count) == 0:
            return f": {reason}"
    return ""


_REASONS = {"truth": "there is no truth of it", "found": "nothing of it was found", "right": "nothing of it was right"}
"""Counts that leave the figures beside them undefined where they are 0."""


def _of_file(path: Path) -> list[Requirement]:
    lines = read_small_text(path, MAX_REQUIREMENT_BYTES, "requirements", RequirementError).splitlines()
    found = []
    for number, line in enumerate(lines, 1):
        if text := line.partition("#")[0].strip():
            try:
                found.append(Requirement.parse(text))
            except RequirementError as err:
                raise RequirementError(f"{path}, line {number}: {err}") from err
    if not found:
        raise RequirementError(f"{path}: expected at least one requirement, as {EXAMPLE!r}, found none")
    return found


def _apart(found: float, limit: float) -> str:
    """A figure with four digits, or with all of them if four would show the limit."""
    if isinstance(found, int):
        return str(found)
    short = f"{found:.4g}"
    return short if float(short) != limit else repr(found)
