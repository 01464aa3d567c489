"""Conversion between the frames of a run and tracks: sightings in the fixed frame, and tracks in the site frame.

The fixed frame is that of the odometry, from the clouds or recorded; without any, the site frame is taken to stand. It
stays the same for a whole run: recorded poses that begin late go on from where the rig was.
"""

from collections.abc import Sequence

import numpy as np

from lidcam.pipeline.core.arrays import F64, join_rows
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import NO_HYPOTHESIS, Boxes3D, Fused, Source
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.regions import points_in_footprints
from lidcam.pipeline.core.rig import Rig, Zone
from lidcam.pipeline.core.tracks import Tracks
from lidcam.pipeline.fusion.zones import select_by_zones
from lidcam.pipeline.tracking.motion import HEADING, SPEED, TURN
from lidcam.pipeline.tracking.sightings import FrameSightings, Sightings, TrackRows

NO_TRACK_REASON = "no confident track"
"""Reason of an object that the frame by itself would report and that is left out."""

MIN_BELIEF = 0.1
"""Minimum probability of a hypothesis that becomes a sighting."""


class SightingsOf:
    """The sightings of frames, which come in order."""

    def __init__(self, rig: Rig, class_count: int, *, lidars_show_front: bool = True) -> None:
        """Make one for a rig and its classes; the lidars' boxes may not tell front from rear, as those of clusters."""
        self._site_frame, self._class_count = rig.site_frame, class_count
        self._lidars_show_front = lidars_show_front
        self._lidars = rig.lidar_xyz[:, :2]
        self._T_fixed_site: F64 | None = None  # At the last frame
        self._T_fixed_recorded: F64 | None = None

    def __call__(self, frame: FrameResult) -> FrameSightings:
        """The sightings of the next frame."""
        boxes, beliefs = frame.hypotheses.boxes, frame.beliefs
        T_fixed_site = self._pose(frame)
        are_reported = np.zeros(len(boxes), np.bool_)
        reported = frame.fused.objects.class_ids < self._class_count
        are_reported[frame.fused.rows[reported]] = True
        rows = np.flatnonzero(are_reported | (beliefs >= MIN_BELIEF))
        chosen, turn = boxes.select(rows), T_fixed_site[:2, :2]
        centers = chosen.centers @ T_fixed_site[:3, :3].T + T_fixed_site[:3, 3]
        yaws = wrap_angle(chosen.yaws + np.arctan2(turn[1, 0], turn[0, 0]))
        rotation = np.eye(3)
        rotation[:2, :2] = turn
        sides, side_views = _seen_from(chosen, self._lidars, frame.combined)
        sightings = Sightings(
            rows=rows,
            boxes=np.column_stack([centers[:, :2], yaws]),
            heights_m=centers[:, 2],
            sizes=chosen.sizes,
            covariances=rotation @ chosen.covariances @ rotation.T,
            later_s=(chosen.measured_ns - frame.bundle.stamp_ns) / 1e9,
            beliefs=beliefs[rows],
            class_ids=chosen.class_ids.astype(np.int64),
            are_reported=are_reported[rows],
            matched=frame.hypotheses.matched[rows],
            point_counts=chosen.point_counts,
            sources=chosen.sources,
            sides=sides,
            side_views=side_views,
            show_front=(rows < frame.hypotheses.lidar_count) & self._lidars_show_front,
        )
        return FrameSightings(frame.bundle.stamp_ns, T_fixed_site, sightings)

    def _pose(self, frame: FrameResult) -> F64:
        """(4, 4) T_fixed_site at the time of a frame: by the clouds, else as recorded, else as before."""
        recorded = frame.bundle.pose_of(self._site_frame)
        if recorded is not None and self._T_fixed_recorded is None:
            before = self._T_fixed_site
            self._T_fixed_recorded = np.eye(4) if before is None else np.asarray(before @ np.linalg.inv(recorded))
        if frame.odometry is not None:
            pose = frame.odometry.T_fixed_site
        elif recorded is not None and self._T_fixed_recorded is not None:
            pose = np.asarray(self._T_fixed_recorded @ recorded)
        else:
            pose = np.eye(4) if self._T_fixed_site is None else self._T_fixed_site
        self._T_fixed_site = pose
        return pose


def _seen_from(boxes: Boxes3D, lidars: F64, combined: CombinedCloud) -> tuple[F64, F64]:
    """`Sightings.sides` and `side_views` of boxes for lidars (L, 2) in the same frame.

    A lidar weighs as many points as it has on a box, as something may hide it; on boxes without points, near ones weigh
    more.
    """
    count = len(lidars)
    if not count:
        return np.zeros((len(boxes), 2)), np.ones((len(boxes), 2))
    offsets = lidars[None] - boxes.centers[:, None, :2]
    cos, sin = np.cos(boxes.yaws)[:, None], np.sin(boxes.yaws)[:, None]
    along = np.stack([offsets[..., 0] * cos + offsets[..., 1] * sin, offsets[..., 1] * cos - offsets[..., 0] * sin], -1)
    distances = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-6)
    weights = distances**-2
    if count > 1:
        placed = boxes.centers[:, :2], boxes.sizes[:, :2], boxes.yaws
        rows, box = points_in_footprints(combined.detection_cloud.xyz, *placed)
        points = np.bincount(box * count + combined.detection_lidar_index[rows], minlength=len(boxes) * count)
        points = points.reshape(weights.shape)
        weights = np.where(points.sum(1, keepdims=True) > 0, points, weights)
    side = np.clip(along / (boxes.sizes[:, None, :2] / 2), -1, 1)
    sides = (weights * side).sum(1) / weights.sum(1)
    # The length is visible from the side, the width from the front or the back.
    faces = np.maximum((weights * np.abs(along[..., ::-1]) / distances).max(1), 1e-9)
    return sides, faces / np.hypot(*faces.T)[:, None]


def with_tracks(fused: Fused, seen: FrameSightings, rows: TrackRows, zones: Sequence[Zone]) -> Fused:
    """The objects of the tracks of a frame, followed by those without a class, which have no track.

    Args:
        fused: Objects that the frame by itself reports.
        seen: Its sightings.
        rows: Its tracks.
        zones: Zones that limit what is reported.
    """
    tracked = _in_site(fused.objects.frame_id, seen, rows)
    reported = seen.sightings.rows[seen.sightings.are_reported]
    has_class = np.isin(fused.rows, reported)
    left_out = dict(fused.left_out)
    if lost := int((~np.isin(reported, tracked.rows)).sum()):
        left_out[NO_TRACK_REASON] = lost
    others = np.flatnonzero(~has_class)
    joined = Fused(
        objects=tracked.objects.joined(fused.objects.select(others)),
        matched=np.concatenate([tracked.matched, fused.matched[others]]),
        rows=np.concatenate([tracked.rows, fused.rows[others]]),
        left_out=left_out,
        tracks=join_rows(tracked.tracks or Tracks.none(0), Tracks.none(len(others))),
    )
    return select_by_zones(joined, zones)


def _in_site(frame_id: str, seen: FrameSightings, rows: TrackRows) -> Fused:
    """The tracks of a frame as objects in its site frame."""
    T_site_fixed = np.linalg.inv(seen.T_fixed_site)
    turn_rad = np.arctan2(T_site_fixed[1, 0], T_site_fixed[0, 0])
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
        stamp_ns=seen.stamp_ns,
        frame_id=frame_id,
        centers=centers,
        sizes=rows.sizes,
        yaws=wrap_angle(rows.states[:, HEADING] + turn_rad),
        scores=rows.existence.astype(np.float32),
        class_ids=rows.class_ids.astype(np.int32),
        point_counts=point_counts,
        covariances=rotation @ rows.covariances[:, :3, :3] @ rotation.T,
        sources=sources,
        measured_ns=np.full(n, seen.stamp_ns, np.int64),
    )
    headings, speeds = rows.states[:, HEADING] + turn_rad, rows.states[:, SPEED]
    cos, sin, rear_m = np.cos(headings), np.sin(headings), rows.rear_m
    # The speed is that of the rear axle, about which the centre turns.
    across = rear_m * rows.states[:, TURN]
    velocities = np.stack([speeds * cos - across * sin, speeds * sin + across * cos], -1)
    by_heading = np.stack([-velocities[:, 1], velocities[:, 0]], -1)
    slopes = np.stack([by_heading, np.stack([cos, sin], -1), np.stack([-rear_m * sin, rear_m * cos], -1)], -1)
    covariances = rows.covariances[:, HEADING:, HEADING:]  # the same in any frame
    tracks = Tracks(
        ids=rows.ids,
        velocities=velocities,
        velocity_covariances=slopes @ covariances @ slopes.swapaxes(1, 2),
        yaw_rates=rows.states[:, TURN].copy(),
        yaw_rate_variances=rows.covariances[:, TURN, TURN].copy(),
        existence=rows.existence,
        ages_s=rows.ages_s,
        fronts_known=rows.fronts_known,
    )
    return Fused(objects, matched, hypotheses, tracks=tracks)
