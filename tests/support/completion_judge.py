"""Boxes completed by array operations over all clusters and kinds at once: the judge of the compiled loops."""

import numpy as np

from pipeline.core.arrays import F64, I64, Bools
from pipeline.core.settings.classes import ClassPrior
from pipeline.detectors.cluster.completion import CompletedBoxes
from pipeline.detectors.cluster.completion_kernels import (
    BOTH_ENDS_SHARE,
    BOTH_ENDS_WHOLE_SHARE,
    ROUND_ANCHOR,
    ROUND_SHARE,
    SHORT_LIMIT,
    SHORT_SHARE,
    SLENDER_SHARE,
    WHOLE_SHARE,
)
from pipeline.detectors.cluster.lshape import Rectangles

__all__ = ["judged_boxes"]


def judged_boxes(
    rectangles: Rectangles,
    top_m: F64,
    lidar_share: F64,
    lidar_xy: F64,
    priors: tuple[ClassPrior, ...],
    given_ids: I64 | None = None,
) -> CompletedBoxes:
    """As `completion.complete_boxes`, with the classes themselves."""
    axes, extent = rectangles.axes, rectangles.high - rectangles.low  # (C, axis, xy), (C, axis)
    middle = (rectangles.high + rectangles.low) / 2
    towards = np.einsum("cax,lx->cla", axes, lidar_xy) - middle[:, None]  # (C, L, axis)
    distance = np.maximum(np.linalg.norm(towards, axis=2, keepdims=True), 1e-9)
    # The extent along one axis is visible on the side whose normal is the other axis.
    seen = np.einsum("cl,cla->ca", lidar_share, np.abs(towards / distance))[:, ::-1]

    kind_class, size, size_max = _kinds(priors)
    turned = [[0, 1, 2], [1, 0, 2]]  # length along the first axis, or along the second
    mean, limit = size[:, turned].reshape(-1, 3), size_max[:, turned].reshape(-1, 3)  # (2K, 3), of K kinds
    measured = np.concatenate([extent, top_m[:, None]], 1)[:, None]  # (C, 1, 3)
    visible = np.concatenate([seen, np.ones((len(seen), 1))], 1)[:, None]
    long = np.maximum(measured - mean, 0) / np.maximum((limit - mean) / 2, 1e-9)
    short = np.minimum(visible * np.maximum(mean - measured, 0) / (SHORT_SHARE * mean), SHORT_LIMIT)
    misfit = ((long**2 + short**2) / 2).sum(2)  # (C, 2K)
    rarity = -np.log(np.repeat(np.array([p.frequency for p in priors])[kind_class], 2))
    cost = np.where((measured <= limit).all(2), misfit + rarity, np.inf)
    if given_ids is not None:
        is_given = np.repeat(kind_class, 2) == given_ids[:, None]
        cost = np.where(is_given, misfit, np.where(given_ids[:, None] < 0, cost, np.inf))
    choice = cost.argmin(1)
    rows = np.arange(len(choice))
    class_ids = np.where(np.isfinite(cost[rows, choice]), kind_class[choice // 2], -1)

    chosen, chosen_limit = mean[choice], limit[choice]
    is_slender = chosen[:, :2].min(1) <= SLENDER_SHARE * chosen[:, 2]
    limits = chosen[:, :2], chosen_limit[:, :2]
    center, full, std = _grow(extent, middle, *limits, seen, towards, lidar_share, is_slender)
    is_round = chosen[:, :2].min(1) > ROUND_SHARE * chosen[:, :2].max(1)
    anchored = np.where(is_slender, np.where(is_round, ROUND_ANCHOR, 0.0), 1.0)[:, None]
    center = middle + anchored * (center - middle)
    rides = is_slender & ~is_round
    std = np.where(is_slender[:, None], (full - extent) / 4, std)
    height = np.where(top_m >= WHOLE_SHARE * chosen[:, 2], top_m, chosen[:, 2])
    swap = (choice % 2 == 1)[:, None]
    yaw = rectangles.angle_rad + np.where(swap[:, 0], np.pi / 2, 0.0)
    faces = (seen * full).sum(1) * height
    return CompletedBoxes(
        class_ids,
        np.einsum("ca,cax->cx", center, axes),
        np.concatenate([np.where(swap, full[:, ::-1], full), height[:, None]], 1),
        np.where(yaw > np.pi / 2, yaw - np.pi, yaw),
        misfit[rows, choice],
        np.where(swap, std[:, ::-1], std),
        faces,
        is_slender,
        rides,
    )


def _kinds(priors: tuple[ClassPrior, ...]) -> tuple[I64, F64, F64]:
    """The class (K,), the typical and the largest size (K, 3) of every kind of the classes."""
    class_ids, sizes, largest = [], [], []
    for class_id, prior in enumerate(priors):
        growth = np.array(prior.max_size_m) / prior.size_m
        for size_m in (prior.size_m, *prior.kinds_m):
            class_ids.append(class_id)
            sizes.append(size_m)
            largest.append(np.minimum(size_m * growth, prior.max_size_m))
    return np.array(class_ids), np.array(sizes), np.array(largest)


def _grow(
    extent: F64,
    middle: F64,
    prior: F64,
    limit: F64,
    seen: F64,
    towards: F64,
    lidar_share: F64,
    is_slender: Bools,
) -> tuple[F64, F64, F64]:
    """Centre, extent and standard deviation of the centre along each axis (C, 2), grown away from the lidars."""
    # -1: the lidar is beyond the low end, 1: beyond the high end, between: beside the object.
    end = np.clip(towards / (np.maximum(extent, prior / 2) / 2)[:, None], -1, 1)
    both = np.minimum(np.einsum("cl,cla->ca", lidar_share, end > 0.5), np.einsum("cl,cla->ca", lidar_share, end < -0.5))
    whole = (both >= BOTH_ENDS_SHARE) & (extent >= BOTH_ENDS_WHOLE_SHARE * prior)
    whole |= (seen > 0.5) & (extent >= WHOLE_SHARE * prior)
    whole &= ~is_slender[:, None]
    missing = np.where(whole, 0.0, np.maximum(prior - extent, 0))
    anchor = np.einsum("cl,cla->ca", lidar_share, end)
    full = extent + missing
    # A grown side errs by the spread of the class; half of that moves the centre.
    std = np.where(missing > 0, np.minimum((limit - prior) / 4, missing), 0.0)
    return middle - anchor * missing / 2, full, std
