"""Frames of small scenes with tracks: each object a car's size, moving along x."""

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from detections import boxes3d
from frames import PERIOD_NS, START_NS, frame

from lidcam.pipeline.core.detections import Fused
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.tracks import Tracks


class Seen(NamedTuple):
    """A tracked object in one frame."""

    track: int
    x: float
    y: float
    speed_m_s: float = 0.0
    class_id: int = 0


def tracked_frame(index: int, *seen: Seen, is_tracked: bool = True) -> FrameResult:
    """Frame `index` with these objects, seen by one camera each."""
    count = len(seen)
    boxes = boxes3d([[one.x, one.y, 0.5, 4, 2, 1.5, 0.25] for one in seen], class_ids=[one.class_id for one in seen])
    tracks = replace(
        Tracks.none(count),
        ids=np.array([one.track for one in seen], np.int64),
        velocities=np.array([[one.speed_m_s, 0.0] for one in seen]).reshape(-1, 2),
        existence=np.full(count, 0.75),
        ages_s=np.full(count, index / 10),
        yaw_rates=np.full(count, 0.125),
        fronts_known=np.ones(count, np.bool_),
    )
    stamp_ns, empty = START_NS + index * PERIOD_NS, _empty()
    boxes = replace(boxes, stamp_ns=stamp_ns)
    fused = Fused(boxes, np.ones(count, np.int32), np.arange(count), tracks=tracks if is_tracked else None)
    return replace(empty, fused=fused, bundle=replace(empty.bundle, index=index, stamp_ns=stamp_ns))


@cache
def _empty() -> FrameResult:
    """Made once: its images and clouds take a while."""
    return frame(objects=0)
