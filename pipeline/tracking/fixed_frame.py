"""Between the frames of a run and tracks: sightings in the fixed frame, and tracks back in the site frame.

The fixed frame is that of the odometry, of the clouds or recorded; without any it is the site frame, standing still.
"""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.arrays import F64, join_rows
from lidcam.pipeline.core.detections import NO_HYPOTHESIS, Boxes3D, Fused, Source
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.rig import Rig, Zone
from lidcam.pipeline.core.tracks import Tracks
from lidcam.pipeline.fusion.zones import select_by_zones
from lidcam.pipeline.tracking.motion import HEADING, SPEED, TURN
from lidcam.pipeline.tracking.rows import TrackRows
from lidcam.pipeline.tracking.sightings import FrameSightings, Sightings

NO_TRACK_REASON = "part of no track that is probable enough"
"""Why an object that a frame by itself would report is left out."""

LEAST_BELIEF = 0.1
"""Hypotheses that are less probable are not looked at."""


class SightingsOf:
    """The sightings of frames, which come in order."""

    def __init__(self, rig: Rig, class_count: int) -> None:
        self._site_frame, self._class_count = rig.site_frame, class_count
        self._lidars = np.array([lidar.T_site_lidar.matrix[:2, 3] for lidar in rig.lidars]).reshape(-1, 2)

    def __call__(self, frame: FrameResult) -> FrameSightings:
        """What a frame shows."""
        boxes, beliefs = frame.hypotheses.boxes, frame.beliefs
        T_fixed_site = _pose(frame, self._site_frame)
        are_reported = np.zeros(len(boxes), np.bool_)
        reported = frame.fused.objects.class_ids < self._class_count
        are_reported[frame.fused.rows[reported]] = True
        rows = np.flatnonzero(are_reported | (beliefs >= LEAST_BELIEF))
        ends = np.full((len(boxes), 2, 3), np.nan)
        if frame.ends is not None:
            ends[frame.fused.rows] = frame.ends
        chosen, turn = boxes.select(rows), T_fixed_site[:2, :2]
        centers = chosen.centers @ T_fixed_site[:3, :3].T + T_fixed_site[:3, 3]
        yaws = wrap_angle(chosen.yaws + np.arctan2(turn[1, 0], turn[0, 0]))
        rotation = np.eye(3)
        rotation[:2, :2] = turn
        sides, faces = _seen_from(chosen, self._lidars)
        ends_fixed = ends[rows].copy()
        ends_fixed[..., :2] = ends[rows, :, :2] @ turn.T + T_fixed_site[:2, 3]
        sightings = Sightings(
            rows,
            np.column_stack([centers[:, :2], yaws]),
            centers[:, 2],
            chosen.sizes,
            rotation @ chosen.covariances @ rotation.T,
            (chosen.measured_ns - frame.bundle.stamp_ns) / 1e9,
            beliefs[rows],
            chosen.class_ids.astype(np.int64),
            are_reported[rows],
            frame.hypotheses.matched[rows],
            chosen.point_counts,
            chosen.sources,
            sides,
            faces,
            ends_fixed,
        )
        return FrameSightings(frame.bundle.stamp_ns, T_fixed_site, sightings)


def _pose(frame: FrameResult, site_frame: str) -> F64:
    """(4, 4) T_fixed_site at the time of a frame: as the clouds say, else as recorded, else it stands still."""
    if frame.odometry is not None:
        return frame.odometry.T_fixed_site
    recorded = frame.bundle.pose_of(site_frame)
    return np.eye(4) if recorded is None else recorded


def _seen_from(boxes: Boxes3D, lidars: F64) -> tuple[F64, F64]:
    """`Sightings.sides` and `Sightings.faces` of boxes, of lidars (L, 2) in the same frame; near lidars count more."""
    if not len(lidars):
        return np.zeros((len(boxes), 2)), np.ones((len(boxes), 2))
    away = lidars[None] - boxes.centers[:, None, :2]
    cos, sin = np.cos(boxes.yaws)[:, None], np.sin(boxes.yaws)[:, None]
    along = np.stack([away[..., 0] * cos + away[..., 1] * sin, away[..., 1] * cos - away[..., 0] * sin], -1)
    distances = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-6)
    weights = distances**-2
    side = np.clip(along / (boxes.sizes[:, None, :2] / 2), -1, 1)
    sides = (weights * side).sum(1) / weights.sum(1)
    # The length is seen from the side, the width from the front or the back.
    faces = (weights * np.abs(along[..., ::-1]) / distances).max(1)
    return sides, np.maximum(faces, 1e-9)


def with_tracks(fused: Fused, seen: FrameSightings, rows: TrackRows, zones: Sequence[Zone]) -> Fused:
    """The objects of a frame as its tracks have them; those of no class, which have none, stand behind them.

    Args:
        fused: The objects that the frame by itself reports.
        seen: Its sightings.
        rows: Its tracks.
        zones: They say what is reported.
    """
    tracked = _in_site(fused.objects.frame_id, seen, rows)
    reported = seen.sightings.rows[seen.sightings.are_reported]
    has_class = np.isin(fused.rows, reported)
    left_out = dict(fused.left_out)
    if lost := int((~np.isin(reported, tracked.rows)).sum()):
        left_out[NO_TRACK_REASON] = lost
    others = np.flatnonzero(~has_class)
    joined = Fused(
        tracked.objects.joined(fused.objects.select(others)),
        np.concatenate([tracked.matched, fused.matched[others]]),
        np.concatenate([tracked.rows, fused.rows[others]]),
        left_out,
        join_rows(tracked.tracks or Tracks.none(0), Tracks.none(len(others))),
    )
    return select_by_zones(joined, zones)


def _in_site(frame_id: str, seen: FrameSightings, rows: TrackRows) -> Fused:
    """The tracks of a frame as objects in its site frame."""
    T_site_fixed = np.linalg.inv(seen.T_fixed_site)
    turn_rad = -seen.turn_rad
    rotation = np.eye(3)
    rotation[:2, :2] = T_site_fixed[:2, :2]
    centers = np.column_stack([rows.states[:, :2], rows.heights_m]) @ T_site_fixed[:3, :3].T + T_site_fixed[:3, 3]
    is_seen, n = rows.are_seen, len(rows)
    sightings = seen.sightings.select(rows.seen[is_seen])
    sources = np.full(n, Source.PREDICTED.value, np.uint8)
    point_counts, matched = np.zeros(n, np.int32), np.zeros(n, np.int32)
    hypotheses = np.full(n, NO_HYPOTHESIS, np.int64)
    sources[is_seen], point_counts[is_seen] = sightings.sources, sightings.point_counts
    matched[is_seen], hypotheses[is_seen] = sightings.matched, sightings.rows
    objects = Boxes3D(
        seen.stamp_ns,
        frame_id,
        centers,
        rows.sizes,
        wrap_angle(rows.states[:, HEADING] + turn_rad),
        rows.existence.astype(np.float32),
        rows.class_ids.astype(np.int32),
        point_counts,
        rotation @ rows.covariances[:, :3, :3] @ rotation.T,
        sources,
        np.full(n, seen.stamp_ns, np.int64),
    )
    headings, speeds = rows.states[:, HEADING] + turn_rad, rows.states[:, SPEED]
    cos, sin = np.cos(headings), np.sin(headings)
    # Of heading and speed, whose covariance is the same in any frame.
    slopes = np.stack([np.stack([-speeds * sin, cos], -1), np.stack([speeds * cos, sin], -1)], -2)
    of_motion = rows.covariances[:, HEADING : SPEED + 1, HEADING : SPEED + 1]
    tracks = Tracks(
        rows.ids,
        np.stack([speeds * cos, speeds * sin], -1),
        slopes @ of_motion @ slopes.swapaxes(1, 2),
        rows.states[:, TURN].copy(),
        rows.covariances[:, TURN, TURN].copy(),
        rows.existence,
        rows.ages_s,
        rows.fronts_known,
    )
    return Fused(objects, matched, hypotheses, tracks=tracks)
