"""What of a frame is evaluated, and what is neither a miss nor an error."""

import numpy as np

from pipeline.core.arrays import F64, I32, Bools
from pipeline.core.geometry.polygons import first_polygon_with
from pipeline.core.settings.evaluate import EvaluateConfig
from pipeline.evaluation.records import UNKNOWN, TruthBoxes3D

__all__ = ["is_evaluated", "is_seen", "is_within"]


def is_within(centers: F64, config: EvaluateConfig) -> Bools:
    """Whether centres lie in the part of the site that is evaluated; truth and results outside it do not count.

    Args:
        centers: (N, 3) in the site frame, metres.
        config: `region` and `max_range_m`; the range is measured along the ground.

    Returns:
        (N,) bool; a centre on the edge of the region or at the limit of the range is within.
    """
    within = np.ones(len(centers), np.bool_)
    if config.region is not None:
        within &= first_polygon_with([np.array(config.region, np.float64)], centers[:, :2]) == 0
    if config.max_range_m is not None:
        within &= np.hypot(centers[:, 0], centers[:, 1]) <= config.max_range_m
    return within


def is_evaluated(truth: TruthBoxes3D, config: EvaluateConfig) -> Bools:
    """Whether each object has to be found.

    The others are ignored: who misses them has no miss, and a result that matches one of them is no error. These are
    objects marked as such, of no configured class, outside the region or the range, and those that no sensor saw: with
    fewer lidar points than `min_lidar_points` and fewer pixels than `min_image_pixels`.

    Returns:
        (N,) bool.
    """
    known = (truth.class_ids != UNKNOWN) & ~truth.is_ignored
    seen = is_seen(truth.lidar_points, truth.image_pixels, config)
    return np.asarray(known & seen & is_within(truth.centers, config))


def is_seen(lidar_points: I32, image_pixels: I32, config: EvaluateConfig) -> Bools:
    """Whether each object has as many lidar points or pixels as the settings ask for.

    A count that the truth does not give decides nothing; without any, the object is taken to be seen.

    Args:
        lidar_points: (N,) or `UNKNOWN`.
        image_pixels: (N,) or `UNKNOWN`.
        config: `min_lidar_points` and `min_image_pixels`.

    Returns:
        (N,) bool.
    """
    seen = (lidar_points >= config.min_lidar_points) | (image_pixels >= config.min_image_pixels)
    return np.asarray(seen | ((lidar_points == UNKNOWN) & (image_pixels == UNKNOWN)))
