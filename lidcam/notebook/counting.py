"""Road users that cross lines."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.writers.tables.objects import Objects

Line = Sequence[Sequence[float]]
"""((x, y), (x, y)), the ends of a line on the ground, metres."""


@dataclass(frozen=True, slots=True)
class LineCount:
    """The road users of one class that crossed a line.

    Left and right are those of who looks from the first end of the line to the second.
    """

    line: str  # Its name
    class_name: str  # Their class
    to_left: int  # Number that came from the right and went to the left
    to_right: int  # Number that came from the left and went to the right


def count_lines(objects: Objects, places: F64, lines: Mapping[str, Line]) -> tuple[LineCount, ...]:
    """Count each track once: a road user that goes to and fro, and ends on the side where it began, is not counted.

    Args:
        objects: The objects of a run, N.
        places: (N, 2) x and y of their centres in a frame that does not move, metres; NaN where it is not known.
        lines: By name, in that frame.

    Raises:
        ConfigError: a line is none.
    """
    order = np.lexsort((objects.frames, objects.tracks))
    order = order[(objects.tracks[order] > NO_TRACK) & np.isfinite(places[order]).all(1)]
    tracks, xy = objects.tracks[order], places[order]
    numbers, rows = np.unique(tracks, return_inverse=True)
    classes = _classes(rows, objects.class_ids[order].astype(np.int64), len(objects.class_names), len(numbers))
    goes_on = tracks[1:] == tracks[:-1]
    found = []
    for name, ends in ends_of_lines(lines).items():
        steps = np.where(goes_on, _crossings(xy[:-1], xy[1:], ends), 0)
        nets = np.bincount(rows[1:], steps, len(numbers)) if len(numbers) else np.zeros(0)
        for class_id in np.unique(classes[nets != 0]).tolist():
            own = nets[classes == class_id]
            counts = int((own > 0).sum()), int((own < 0).sum())
            found.append(LineCount(name, objects.class_names[class_id], *counts))
    return tuple(found)


def ends_of_lines(lines: Mapping[str, Line]) -> dict[str, F64]:
    """(2, 2) the ends of each line by its name, metres.

    Raises:
        ConfigError: lines have no names, or one has not two different ends.
    """
    if not isinstance(lines, Mapping):
        raise ConfigError(f"lines: expected lines by name, {{'gate': ((x, y), (x, y))}}, found {lines}")
    found = {}
    for name, line in lines.items():
        try:
            ends = np.array(line, np.float64)
        except (TypeError, ValueError):
            ends = np.zeros(0)
        if ends.shape != (2, 2) or not np.isfinite(ends).all() or (ends[0] == ends[1]).all():
            raise ConfigError(f"lines: {name}: expected two different ends ((x, y), (x, y)) in metres, found {line}")
        found[name] = ends
    return found


def _classes(rows: I64, class_ids: I64, class_count: int, track_count: int) -> I64:
    """(T,) the class of most frames of each track; of equals, the first."""
    frames = np.bincount(rows * class_count + class_ids, minlength=track_count * class_count)
    return np.asarray(frames.reshape(track_count, class_count).argmax(1), np.int64)


def _crossings(before: F64, after: F64, ends: F64) -> I64:
    """(N,) 1 for each step from (N, 2) to (N, 2) that crosses the line to its left, -1 to its right, else 0."""
    along = ends[1] - ends[0]
    first, last = (
        along[0] * (place[:, 1] - ends[0, 1]) - along[1] * (place[:, 0] - ends[0, 0]) for place in (before, after)
    )
    signs = (last >= 0).astype(np.int64) - (first >= 0)
    share = first / np.where(signs == 0, 1.0, first - last)
    at = before + share[:, None] * (after - before)
    within = (at - ends[0]) @ along / (along @ along)
    return np.asarray(np.where((within >= 0) & (within <= 1), signs, 0), np.int64)
