"""Figures by their dotted names."""

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any

from lidcam.pipeline.evaluation.evaluation_frame import Figure, Figures

LEFT_OUT = "sources."
"""The beginning of a name that may be left out: `fused.car.recall` is `sources.fused.car.recall`."""

LABELS = "labels"
"""The part of a name after which the truth's own words follow, which are not known before it is read."""

MAX_NEAREST = 3
LIKENESS = 0.6


class NamedFigures(Mapping[str, Figure]):
    """A tree of figures, looked up by dotted names: `sources.fused.car.recall`, or without `sources.`.

    The elements of a list are named by their numbers, from 0.

    Attributes:
        tree: The figures as JSON has them.
    """

    def __init__(self, tree: Figures) -> None:
        self.tree = tree
        self._found = dict(_flat(tree))

    def __getitem__(self, name: str) -> Figure:
        key = self._key(name)
        if key is None:
            raise KeyError(self.unknown(name))
        return self._found[key]

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self._key(name) is not None

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def unknown(self, name: str) -> str:
        """The message for an unknown name: with the nearest names, or the known sections."""
        is_short = not any(name.startswith(f"{first}.") for first in self.tree)
        known = [key.removeprefix(LEFT_OUT) if is_short else key for key in self._found]
        if under := [key.removeprefix(f"{name}.") for key in known if key.startswith(f"{name}.")]:
            return f"{name!r} names {len(under)} figures: expected one of them, such as {f'{name}.{under[0]}'!r}"
        longer = [key for key in known if name and key.startswith(name)]
        if nearest := longer[:MAX_NEAREST] or get_close_matches(name, known, n=MAX_NEAREST, cutoff=LIKENESS):
            *others, last = map(repr, nearest)
            return f"unknown figure {name!r}: did you mean {' or '.join(filter(None, (', '.join(others), last)))}?"
        sections = dict.fromkeys(key.partition(".")[0] for key in self._found)
        return f"unknown figure {name!r}: known are those of {', '.join(sections)}"

    def nearest_count(self, name: str, count: str) -> Figure:
        """The figure of a given last name in the section of a figure, or else in the closest section around it."""
        section = self._key(name) or name
        while section := section.rpartition(".")[0]:
            if f"{section}.{count}" in self._found:
                return self._found[f"{section}.{count}"]
        return None

    def _key(self, name: str) -> str | None:
        return next((key for key in (name, LEFT_OUT + name) if key in self._found), None)


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, Figure]]:
    if not isinstance(value, dict | list | tuple):
        yield name, value
        return
    for key, element in value.items() if isinstance(value, dict) else enumerate(value):
        yield from _flat(element, f"{name}.{key}" if name else str(key))
