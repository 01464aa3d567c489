"""The ends of objects: how far their points reach, for the length of their tracks."""

from itertools import pairwise

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Fused
from lidcam.pipeline.core.geometry.regions import points_in_footprints

AROUND_SHARE = 0.62, 0.72, 0.6
"""Points within these shares of length, width and height of the centre of a box belong to it: also what it misses."""

BEYOND_SHARE = 0.2
"""So much of the width is added to that of the length."""

STRAY_SHARE = 0.005
"""Points beyond the end of an object, as a share of its points: stray ones."""

FEWEST_POINTS = 8


def find_ends(fused: Fused, combined: CombinedCloud) -> F64:
    """(N, 2, 3) the foremost and the rearmost point of each object, along the yaw of its box.

    Of each x, y in the site frame and seconds after the cloud's stamp; NaN where it has too few points.
    """
    objects, cloud = fused.objects, combined.detection_cloud
    sizes = objects.sizes * (2 * np.array(AROUND_SHARE))
    sizes[:, 0] += 2 * BEYOND_SHARE * objects.sizes[:, 1]
    rows, box = points_in_footprints(cloud.xyz, objects.centers[:, :2], sizes[:, :2], objects.yaws)
    away = cloud.xyz.take(rows, 0) - objects.centers.take(box, 0)
    level = np.abs(away[:, 2]) < (sizes[:, 2] / 2).take(box)
    rows, box, away = rows[level], box[level], away[level]
    along = away[:, 0] * np.cos(objects.yaws).take(box) + away[:, 1] * np.sin(objects.yaws).take(box)
    bounds = np.searchsorted(box, np.arange(len(objects) + 1))
    ends = np.full((len(objects), 2, 3), np.nan)
    for index, (first, last) in enumerate(pairwise(bounds.tolist())):
        count = last - first
        if count >= FEWEST_POINTS:
            stray = int(STRAY_SHARE * count)
            places, of_object = [count - 1 - stray, stray], along[first:last]
            found = rows[first + (of_object == np.partition(of_object, places)[places, None]).argmax(1)]
            ends[index, :, :2], ends[index, :, 2] = cloud.xyz[found, :2], cloud.time_offset_ns[found] / 1e9
    return ends
