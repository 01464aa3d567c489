"""Trails: where the tracks of a frame have been in the last seconds, to be drawn behind the objects.

On a rig that moves, the past is carried along: a trail lies where its object was on the ground, seen from the rig as it
stands now.
"""

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.frame import FrameResult, own_motion
from lidcam.pipeline.core.settings.combine import MotionConfig
from lidcam.pipeline.core.tracks import NO_TRACK

TRAIL_S = 3.0
"""Length of a trail."""

_NO_PLACES = np.zeros((0, 3))


class Trails:
    """Keeps the places of the tracks of the last `TRAIL_S`. Frames must come in order."""

    def __init__(self, site_frame: str, motion: MotionConfig) -> None:
        self._site_frame, self._motion = site_frame, motion
        self._last_ns = 0
        self._stamps_ns, self._numbers = np.zeros(0, np.int64), np.zeros(0, np.int64)
        self._places = _NO_PLACES

    def add_frame(self, result: FrameResult) -> list[F64]:
        """Take a frame in, and give the trail of each of its objects.

        Where the rig moves and how is not known, the trails begin anew.

        Returns:
            For each fused object (K, 3) the middle of its bottom in the site frame, from its oldest place to that in
            this frame; (0, 3) where that is the only one, and of objects without a track.
        """
        objects, tracks, now_ns = result.fused.objects, result.fused.tracks, result.bundle.stamp_ns
        numbers = np.full(len(objects), NO_TRACK, np.int64) if tracks is None else tracks.ids
        moved = own_motion(result.bundle, self._last_ns, self._site_frame, self._motion)
        age_s = (now_ns - self._stamps_ns) / 1e9
        kept = (age_s > 0) & (age_s <= TRAIL_S) & (moved is not None)
        before = self._places[kept] if moved is None else self._places[kept] @ moved[:3, :3].T + moved[:3, 3]
        rows = np.flatnonzero(numbers != NO_TRACK)
        places = objects.centers[rows] - [0.0, 0.0, 0.5] * objects.sizes[rows]
        self._last_ns = now_ns
        self._stamps_ns = np.concatenate([self._stamps_ns[kept], np.full(len(rows), now_ns)])
        self._numbers = np.concatenate([self._numbers[kept], numbers[rows]])
        self._places = np.concatenate([before, places])
        return [self._trail(number) for number in numbers.tolist()]

    def _trail(self, number: int) -> F64:
        places = self._places[self._numbers == number] if number != NO_TRACK else _NO_PLACES
        return places if len(places) > 1 else _NO_PLACES
