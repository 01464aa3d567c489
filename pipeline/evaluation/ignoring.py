"""Rules for the objects of a frame that are evaluated; the others are neither misses nor errors."""

import numpy as np

from lidcam.pipeline.core.arrays import F64, Bools
from lidcam.pipeline.core.geometry.polygons import first_polygon_with
from lidcam.pipeline.core.settings.evaluate import EvaluateConfig
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, TruthBoxes3D


def is_within(centers: F64, config: EvaluateConfig) -> Bools:
    """(N,) whether centres (N, 3) lie in `region` and `max_range_m`; their limits are within.

    Truth and results outside do not count. The range is measured along the ground, from the origin of the site frame.
    """
    within = np.ones(len(centers), np.bool_)
    if isinstance(config.region, tuple):
        within &= first_polygon_with([np.array(config.region, np.float64)], centers[:, :2]) == 0
    if config.max_range_m is not None:
        within &= np.hypot(centers[:, 0], centers[:, 1]) <= config.max_range_m
    return within


def is_evaluated(truth: TruthBoxes3D, config: EvaluateConfig) -> Bools:
    """(N,) whether each object has to be found; the others are neither misses nor, where matched, errors.

    Ignored are objects that are marked so, of no configured class or not `is_within`, and those that no sensor saw:
    with fewer lidar points than `min_lidar_points` and without a pixel. A count that the truth lacks decides nothing;
    without any, the object is taken to be seen.
    """
    lidar_points, image_pixels = truth.lidar_points, truth.image_pixels
    seen = (lidar_points >= config.min_lidar_points) | (image_pixels > 0) | (config.min_lidar_points == 0)
    seen |= (lidar_points == UNKNOWN) & (image_pixels == UNKNOWN)
    return np.asarray(seen & (truth.class_ids != UNKNOWN) & ~truth.is_ignored & is_within(truth.centers, config))
