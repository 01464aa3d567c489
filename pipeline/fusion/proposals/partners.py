"""2D boxes that have an object already."""

from collections.abc import Mapping

import numpy as np

from lidcam.pipeline.core.arrays import I64, Bools
from lidcam.pipeline.core.detections import Matches
from lidcam.pipeline.core.geometry.boxes import iou_xyxy
from lidcam.pipeline.fusion.cameras.sightings import Sightings

DUPLICATE_IOU = 0.6
"""Minimum IoU with a matched 2D box of the same image before a 2D box counts as its duplicate."""


def find_partners(sightings: Sightings, matches: Mapping[str, Matches], names: tuple[str, ...]) -> I64:
    """(P,) row of the 3D box matched with each 2D box, -1 for none.

    `matches` are by camera name; `names` are the names of the cameras by their number.
    """
    partner = np.full(len(sightings), -1, np.int64)
    for camera in set(sightings.cameras.tolist()):
        of_camera = matches[names[camera]]
        is_pair = (sightings.cameras == camera)[:, None] & (sightings.rows[:, None] == of_camera.pairs[:, 1])
        sighting, pair = is_pair.nonzero()
        partner[sighting] = of_camera.pairs[pair, 0]
    return partner


def find_duplicates(sightings: Sightings, partner: I64) -> Bools:
    """(P,) whether each 2D box has no partner, but nearly covers one of the same image with one."""
    duplicates = np.zeros(len(sightings), np.bool_)
    for camera in set(sightings.cameras[partner < 0].tolist()):
        mine = np.flatnonzero((sightings.cameras == camera) & (partner < 0))
        others = np.flatnonzero((sightings.cameras == camera) & (partner >= 0))
        duplicates[mine] = (iou_xyxy(sightings.xyxy[mine], sightings.xyxy[others]) > DUPLICATE_IOU).any(1)
    return duplicates
