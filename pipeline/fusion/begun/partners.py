"""Which 2D boxes are spoken for: by a 3D box, or by another 2D box of the same object."""

from collections.abc import Mapping

import numpy as np

from pipeline.core.arrays import F64, I64, Bools
from pipeline.core.detections import Matches
from pipeline.core.geometry.boxes import iou_xyxy
from pipeline.fusion.cameras.sightings import Sightings

__all__ = ["find_echoes", "find_partners"]

ECHO_IOU = 0.6
"""A 2D box that overlaps a matched one of its image as much shows the same object."""


def find_partners(sightings: Sightings, matches: Mapping[str, Matches], names: tuple[str, ...]) -> tuple[I64, F64]:
    """(P,) row of the 3D box that each 2D box is matched with, -1 where there is none; and (P,) their overlap.

    Args:
        sightings: P 2D boxes.
        matches: By camera name.
        names: Of the cameras, by their number.
    """
    partner, iou = np.full(len(sightings), -1, np.int64), np.zeros(len(sightings))
    tables = [matches[name] for name in names]
    pairs = np.concatenate([np.zeros((0, 2), np.int64), *(table.pairs for table in tables)])
    cameras = np.repeat(np.arange(len(names)), [len(table) for table in tables])
    width = int(max(sightings.rows.max(initial=-1), pairs[:, 1].max(initial=-1))) + 1
    pair = np.full(len(names) * width, -1, np.int64)  # by camera and 2D box
    pair[cameras * width + pairs[:, 1]] = np.arange(len(pairs))
    of_sighting = pair[sightings.cameras * width + sightings.rows]
    found = np.flatnonzero(of_sighting >= 0)
    partner[found] = pairs[of_sighting[found], 0]
    iou[found] = np.concatenate([np.zeros(0), *(table.iou for table in tables)])[of_sighting[found]]
    return partner, iou


def find_echoes(sightings: Sightings, partner: I64) -> Bools:
    """(P,) whether each 2D box has no partner, but nearly covers one of the same image that has."""
    echoes = np.zeros(len(sightings), np.bool_)
    for camera in np.unique(sightings.cameras[partner < 0]):
        mine = np.flatnonzero((sightings.cameras == camera) & (partner < 0))
        others = np.flatnonzero((sightings.cameras == camera) & (partner >= 0))
        echoes[mine] = (iou_xyxy(sightings.xyxy[mine], sightings.xyxy[others]) > ECHO_IOU).any(1)
    return echoes
