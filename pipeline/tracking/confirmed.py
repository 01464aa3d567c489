"""Which tracks the cameras confirm: what each of them said last holds until it says something else.

A camera that is slower than the frames says nothing in most of them, and by that takes nothing back.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.arrays import I64
from lidcam.pipeline.core.detections import Fused
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.tracks import NO_TRACK
from lidcam.pipeline.fusion.belief.memory import MAX_AGE_S


def matched_rows(frame: FrameResult) -> dict[str, I64]:
    """By name of each camera with 2D boxes in a frame, the rows (M,) of the hypotheses that it matched."""
    return {name: frame.matches[name].pairs[:, 0] for name in frame.detections.cameras}


class Confirmations:
    """The last word of each camera. It is forgotten when its evidence is, after `MAX_AGE_S`."""

    def __init__(self) -> None:
        self._words: dict[str, tuple[int, I64]] = {}

    def held(self, fused: Fused, stamp_ns: int, said: Mapping[str, I64]) -> Fused:
        """The objects of the next frame with the number of cameras that confirm the track of each.

        Args:
            fused: The objects, with tracks; `matched` of those without one stays.
            stamp_ns: Of the frame.
            said: What the cameras say in it, as `matched_rows` has it.
        """
        if (tracks := fused.tracks) is None:
            return fused
        self._words |= {name: (stamp_ns, tracks.ids[np.isin(fused.rows, rows)]) for name, rows in said.items()}
        matched = np.zeros(len(tracks), np.int32)
        for since_ns, ids in self._words.values():
            if 0 <= stamp_ns - since_ns <= MAX_AGE_S * 1e9:
                matched += np.isin(tracks.ids, ids)
        return replace(fused, matched=np.where(tracks.ids == NO_TRACK, fused.matched, matched))
