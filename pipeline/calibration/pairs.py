"""Pairs of a box by the lidars alone and the matched 2D box of a camera, kept for the end of a run.

The boxes are those before refinement (`Detections.lidar`), since refined ones already follow the 2D boxes. The motion
of the track, estimated over many frames, moves each to the time of the image.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, CheckedTable
from lidcam.pipeline.core.camera import BORDER_PX
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.tracks import NO_TRACK

MAX_HIDDEN = 0.3
"""Maximum hidden share of an object; pairs beyond, and those at the border of the image, have wrong edges."""

STEP_NS = 50_000_000
"""Half-width of the interval over which the rig's own speed at an image is measured, nanoseconds."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackedPairs(CheckedTable):
    """P pairs of a lidar's box and a 2D box of one camera."""

    ROWS: ClassVar = {
        **{"xyxy": (4,), "centers": (3,), "sizes": (3,), "covariances": (3, 3), "velocities": (2,)},
        **{"velocity_covariances": (2, 2), "T_camera_site": (4, 4), "own_motion": (6,)},
    }

    xyxy: F64  # (P, 4) float64 left, top, right, bottom of the 2D box, pixels
    centers: F64  # (P, 3) float64 of the lidar's box, metres in the site frame at the frame's time
    sizes: F64  # (P, 3) float64 length, width, height, metres
    yaws: F64  # (P,) float64 radians
    covariances: F64  # (P, 3, 3) float64 of x, y, yaw; zeros where unknown
    later_s: F64  # (P,) float64, time of the image after that of the box, seconds
    velocities: F64  # (P, 2) float64 of the object over the ground, m/s along x and y of the site frame
    velocity_covariances: F64  # (P, 2, 2) float64
    yaw_rates: F64  # (P,) float64 of the object over the ground, rad/s
    T_camera_site: F64  # (P, 4, 4) float64, the camera where it took the image
    own_motion: F64  # (P, 6) float64 of the site frame at that time, along and about its axes, m/s and rad/s
    tracks: I64  # (P,) int64 number of the object's track
    stamps_ns: I64  # (P,) int64 time of the image


def tracked_pairs(frame: FrameResult) -> Iterator[tuple[str, TrackedPairs]]:
    """The pairs of each camera that has some in one frame, by its name; none without tracks."""
    fused, tracks, boxes = frame.fused, frame.fused.tracks, frame.detections.lidar
    if tracks is None:
        return
    known = np.flatnonzero((fused.rows >= 0) & (fused.rows < len(boxes)) & (tracks.ids != NO_TRACK))
    object_of = np.full(len(boxes), -1, np.int64)
    object_of[fused.rows[known]] = known
    for name, matches in frame.matches.items():
        found = frame.detections.cameras.get(name)
        if found is None or not len(matches):
            continue
        view = frame.views[name]
        rows, rows2d = matches.pairs[matches.pairs[:, 0] < len(boxes)].T
        xyxy = found.xyxy[rows2d].astype(np.float64)
        limit_px = np.array([view.model.width_px, view.model.height_px]) - BORDER_PX
        whole = (xyxy[:, :2] > BORDER_PX).all(1) & (xyxy[:, 2:] < limit_px).all(1)
        used = whole & (object_of[rows] >= 0) & (matches.hidden[rows] <= MAX_HIDDEN)
        if not used.any():
            continue
        rows, xyxy = rows[used], xyxy[used]
        objects, chosen, n = object_of[rows], boxes.select(rows), len(rows)
        motion = _own_motion(frame.bundle.motion, found.stamp_ns)
        yield (
            name,
            TrackedPairs(
                xyxy=xyxy,
                centers=chosen.centers,
                sizes=chosen.sizes,
                yaws=chosen.yaws,
                covariances=chosen.covariances,
                later_s=np.asarray((found.stamp_ns - chosen.measured_ns) * 1e-9, np.float64),
                velocities=tracks.velocities[objects],
                velocity_covariances=tracks.velocity_covariances[objects],
                yaw_rates=tracks.yaw_rates[objects],
                T_camera_site=np.repeat(view.T_camera_site.matrix[None], n, 0),
                own_motion=np.repeat(motion[None], n, 0),
                tracks=tracks.ids[objects],
                stamps_ns=np.full(n, found.stamp_ns, np.int64),
            ),
        )


def _own_motion(motion: PoseSamples | None, stamp_ns: int) -> F64:
    """(6,) velocity of the site frame in itself, m/s and rad/s; zeros where unknown."""
    if motion is None or len(motion) < 2:
        return np.zeros(6)
    before, after = motion.at(stamp_ns - STEP_NS, stamp_ns + STEP_NS)
    step = np.linalg.inv(before) @ after
    turn = np.array([step[2, 1] - step[1, 2], step[0, 2] - step[2, 0], step[1, 0] - step[0, 1]]) / 2
    return np.concatenate([step[:3, 3], turn]) / (2e-9 * STEP_NS)
