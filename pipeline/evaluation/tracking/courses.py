"""Courses of tracks over time: how long they are, how soon an object has one, and how often they turn around.

A track is false if more than half of its boxes match no object.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64, Bools, Indices, join_rows
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.evaluation.scales import is_flip
from lidcam.pipeline.evaluation.tracking.clear import Matches
from lidcam.pipeline.evaluation.tracking.table import TrackTable
from lidcam.pipeline.evaluation.true_motion import has_moved


@dataclass(frozen=True, slots=True, eq=False)
class Courses:
    """Tracks of one or all classes."""

    boxes: I64  # (H,) int64, boxes of each track found
    durations_s: F64  # (H,) float64, from its first box to its last
    is_false: Bools  # (H,) bool, whether it is false
    delays_s: F64  # (T,) float64, from a true track's first frame to its first match; NaN if there is none
    heading_flips: int  # Turns of more than 90 degrees that an object did not make
    heading_flips_moving: int  # Those of objects that move in the recording
    heading_flips_standing: int  # Those of objects that stand
    without_track: int  # Boxes found that are part of no track


def follow(table: TrackTable, matches: Matches) -> Courses:
    """Follow the tracks of one class."""
    first_ns, last_ns = _spans(table, table.found.tracks, table.found.frames)
    start_ns, _ = _spans(table, table.truth.tracks, table.truth.frames)
    rows = table.pairs.truth[matches.pairs]
    matched_tracks, earliest = np.unique(table.truth.tracks[rows], return_index=True)
    delays_s = np.full(len(start_ns), np.nan)
    matched_ns = table.stamps_ns[table.truth.frames[rows[earliest]]]
    delays_s[matched_tracks] = (matched_ns - start_ns[matched_tracks]) / 1e9
    boxes = np.bincount(table.found.tracks).astype(np.int64)
    matched = np.bincount(table.found.tracks[table.pairs.found[matches.pairs]], minlength=len(boxes))
    flipped = _flipped(table, matches)
    one_class = np.zeros(len(table.truth), np.int32)
    moves, stands = has_moved(one_class, table.truth.tracks, table.truth.poses, np.array([table.length_m]))
    return Courses(
        boxes=boxes,
        durations_s=(last_ns - first_ns) / 1e9,
        is_false=2 * matched < boxes,
        delays_s=delays_s,
        heading_flips=len(flipped),
        heading_flips_moving=int(moves[flipped].sum()),
        heading_flips_standing=int(stands[flipped].sum()),
        without_track=table.without_track,
    )


def total_courses(parts: Sequence[Courses]) -> Courses:
    """The tracks of all classes together."""
    return replace(
        join_rows(*parts),
        heading_flips=sum(part.heading_flips for part in parts),
        heading_flips_moving=sum(part.heading_flips_moving for part in parts),
        heading_flips_standing=sum(part.heading_flips_standing for part in parts),
        without_track=sum(part.without_track for part in parts),
    )


def course_figures(courses: Courses) -> dict[str, float | int | None]:
    """Figures of the tracks; None where there are none."""
    matched = courses.delays_s[~np.isnan(courses.delays_s)]
    some, has_false = len(courses.boxes) > 0, bool(courses.is_false.any())
    return {
        "truth_tracks": len(courses.delays_s),
        "found_tracks": len(courses.boxes),
        "boxes_without_track": courses.without_track,
        "track_frames_mean": float(courses.boxes.mean()) if some else None,
        "track_frames_median": float(np.median(courses.boxes)) if some else None,
        "track_s_mean": float(courses.durations_s.mean()) if some else None,
        "track_s_median": float(np.median(courses.durations_s)) if some else None,
        "false_tracks": int(courses.is_false.sum()),
        "false_track_frames_mean": float(courses.boxes[courses.is_false].mean()) if has_false else None,
        "false_track_s_mean": float(courses.durations_s[courses.is_false].mean()) if has_false else None,
        "first_match_s_mean": float(matched.mean()) if len(matched) else None,
        "never_matched": len(courses.delays_s) - len(matched),
        "heading_flips": courses.heading_flips,
        "heading_flips_moving": courses.heading_flips_moving,
        "heading_flips_standing": courses.heading_flips_standing,
    }


def _spans(table: TrackTable, tracks: I64, frames: I32) -> tuple[I64, I64]:
    """Times of the first and of the last row of each track; frames rise."""
    first = np.unique(tracks, return_index=True)[1]
    last = len(tracks) - 1 - np.unique(tracks[::-1], return_index=True)[1]
    return table.stamps_ns[frames[first]], table.stamps_ns[frames[last]]


def _flipped(table: TrackTable, matches: Matches) -> Indices:
    """Rows of the truth where a track has turned by more than 90 degrees since its last match, but not its object."""
    truth, found = table.pairs.truth[matches.pairs], table.pairs.found[matches.pairs]
    order = np.lexsort((table.found.frames[found], table.found.tracks[found]))
    truth, found = truth[order], found[order]
    same = (np.diff(table.found.tracks[found]) == 0) & (np.diff(table.truth.tracks[truth]) == 0)
    turns_rad = wrap_angle(np.diff(table.found.yaws[found]))
    true_turns_rad = wrap_angle(np.diff(table.truth.yaws[truth]))
    return np.asarray(truth[1:][same & is_flip(turns_rad) & ~is_flip(true_turns_rad)])
