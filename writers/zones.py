"""The zones of a rig as they are drawn on the ground, with the numbers of objects in them."""

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.polygons import clipped_polygon
from lidcam.pipeline.core.rig import Rig
from lidcam.writers.viewpoint import SceneSurvey


def drawn_zones(survey: SceneSurvey) -> tuple[list[F64], F64]:
    """The zones of the rig of a survey, cut to what the lidars see where they reach into it.

    Returns:
        Corners (K, 3) of each on the ground, the first once more at the end, and the middle (N, 3) of each.
    """
    bounds = survey.bounds
    flat = [(clipped_polygon(zone.polygon_site, *bounds), zone.polygon_site) for zone in survey.rig.zones]
    shown = [clipped if len(clipped) else whole for clipped, whole in flat]
    middles = np.array([(corners.min(0) + corners.max(0)) / 2 for corners in shown]).reshape(-1, 2)
    on_ground = [np.pad(xy, ((0, 0), (0, 1)), constant_values=survey.ground_m) for xy in (*shown, middles)]
    return [np.concatenate([corners, corners[:1]]) for corners in on_ground[:-1]], on_ground[-1]


def zone_texts(rig: Rig, centers: F64) -> list[str]:
    """The text of each zone of a rig: its name, and how many objects, of centres (N, 3), it has."""
    rows = rig.place_rows(centers)
    counts = {zone.name: int((rows == row).sum()) for row, zone in enumerate(rig.counted_zones)}
    return [f"{zone.name}: {counts.get(zone.name, 'ignored')}" for zone in rig.zones]
