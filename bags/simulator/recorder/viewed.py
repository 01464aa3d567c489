"""Recorded 2D boxes of the movers in an image: those of the simulated detector, and the truth."""

from collections.abc import Sequence

import numpy as np

from bags.simulator.recorder.hypotheses import class_of, counted
from bags.simulator.recorder.messages import ViewedObject
from bags.simulator.sensors.detector2d import NO_MOVER, Detected
from bags.simulator.sensors.visibility import Visibility
from bags.simulator.world.mover import Mover
from pipeline.core.arrays import F64
from pipeline.core.ros.vision_numbers import IMAGE_PIXELS

__all__ = ["detected_objects", "visible_objects", "whole_objects"]


def detected_objects(found: Detected, movers: Sequence[Mover]) -> list[ViewedObject]:
    """Boxes of the simulated detector in an image of a scene with these movers."""
    return [
        ViewedObject("" if row == NO_MOVER else movers[row].name, row, _box(xyxy), (class_of(class_name, score),))
        for xyxy, score, class_name, row in zip(
            found.xyxy, found.scores.tolist(), found.class_names, found.movers.tolist(), strict=True
        )
    ]


def visible_objects(shown: Visibility, movers: Sequence[Mover]) -> list[ViewedObject]:
    """The movers that an image shows."""
    hidden, outside = shown.occlusion.tolist(), shown.truncation.tolist()
    return [
        _viewed(row, shown, shown.visible_xyxy, movers, occlusion=hidden[row], truncation=outside[row])
        for row in np.flatnonzero(shown.visible_px).tolist()
    ]


def whole_objects(shown: Visibility, movers: Sequence[Mover]) -> list[ViewedObject]:
    """The movers that an image would show if nothing hid them."""
    rows = np.flatnonzero(np.isfinite(shown.truncation)).tolist()
    return [_viewed(row, shown, shown.whole_xyxy, movers) for row in rows]


def _viewed(row: int, shown: Visibility, boxes: F64, movers: Sequence[Mover], **shares: float) -> ViewedObject:
    mover, pixels = movers[row], counted(IMAGE_PIXELS, int(shown.visible_px[row]))
    hypotheses = (class_of(mover.class_name), pixels, *(counted(name, share) for name, share in shares.items()))
    return ViewedObject(mover.name, row, _box(boxes[row]), hypotheses)


def _box(xyxy: F64) -> tuple[float, float, float, float]:
    left, top, right, bottom = xyxy.tolist()
    return left, top, right, bottom
