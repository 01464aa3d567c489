"""Courses of tracks over time: which are false, and how often they turn around.

A track is false if more than half of its boxes match no object.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools, Indices, join_rows
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.evaluation.scales import is_flip
from lidcam.pipeline.evaluation.tracking.table import TrackTable


@dataclass(frozen=True, slots=True, eq=False)
class Courses:
    """Tracks of one or all classes."""

    truth_tracks: int  # Number of true tracks
    durations_s: F64  # (H,) float64, from the first box of each track found to its last
    is_false: Bools  # (H,) bool, whether it is false
    heading_flips: int  # Turns of more than 90 degrees that an object did not make


def follow(table: TrackTable, matches: Indices) -> Courses:
    """Follow the tracks of one class; `matches` as of `match_clear`."""
    found = table.found
    first = np.unique(found.tracks, return_index=True)[1]
    last = len(found) - 1 - np.unique(found.tracks[::-1], return_index=True)[1]  # frames rise
    boxes = np.bincount(found.tracks)
    matched = np.bincount(found.tracks[table.pairs.found[matches]], minlength=len(boxes))
    return Courses(
        truth_tracks=table.truth.track_count,
        durations_s=(table.stamps_ns[found.frames[last]] - table.stamps_ns[found.frames[first]]) / 1e9,
        is_false=2 * matched < boxes,
        heading_flips=_flips(table, matches),
    )


def total_courses(parts: Sequence[Courses]) -> Courses:
    """The tracks of all classes together."""
    return replace(
        join_rows(*parts),
        truth_tracks=sum(part.truth_tracks for part in parts),
        heading_flips=sum(part.heading_flips for part in parts),
    )


def course_figures(courses: Courses) -> dict[str, float | int | None]:
    """Figures of the tracks; None where there are none."""
    return {
        "truth_tracks": courses.truth_tracks,
        "found_tracks": len(courses.durations_s),
        "false_tracks": int(courses.is_false.sum()),
        "false_track_s_mean": float(courses.durations_s[courses.is_false].mean()) if courses.is_false.any() else None,
        "heading_flips": courses.heading_flips,
    }


def _flips(table: TrackTable, matches: Indices) -> int:
    """How often a track has turned by more than 90 degrees since its last match, but not its object."""
    truth, found = table.pairs.truth[matches], table.pairs.found[matches]
    order = np.lexsort((table.found.frames[found], table.found.tracks[found]))
    truth, found = truth[order], found[order]
    same = (np.diff(table.found.tracks[found]) == 0) & (np.diff(table.truth.tracks[truth]) == 0)
    turns_rad = wrap_angle(np.diff(table.found.yaws[found]))
    true_turns_rad = wrap_angle(np.diff(table.truth.yaws[truth]))
    return int((same & is_flip(turns_rad) & ~is_flip(true_turns_rad)).sum())
