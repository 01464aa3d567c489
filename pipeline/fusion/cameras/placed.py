"""What the cameras alone place, and the 2D boxes that each of it comes from."""

from typing import NamedTuple

from pipeline.core.arrays import I64
from pipeline.core.detections import Boxes3D
from pipeline.fusion.cameras.placing import Placements
from pipeline.fusion.cameras.sightings import Sightings

__all__ = ["Placed"]


class Placed(NamedTuple):
    """Objects that cameras place, and their sightings.

    Attributes:
        boxes: Of source CAMERA.
        sightings: The 2D boxes of all cameras.
        objects: (P,) int64 row of `boxes` that each sighting belongs to.
        placements: Where each sighting by itself sees its object.
        out_of_image: Number of other 2D boxes, of which nothing lies in the image.
    """

    boxes: Boxes3D
    sightings: Sightings
    objects: I64
    placements: Placements
    out_of_image: int = 0
