"""Hypotheses of a frame: the boxes of the lidars, and objects that only 2D boxes show."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D, Matches, Source
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.overlaps import OVERLAP_SHARE, overlap_shares, without_overlaps
from lidcam.pipeline.core.geometry.rotated_iou import ious
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.detect import ClusterConfig
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.detectors.protocols import Candidates3D
from lidcam.pipeline.fusion.cameras.placing import Placed
from lidcam.pipeline.fusion.cameras.sightings import Sightings
from lidcam.pipeline.fusion.proposals.fitted import ObjectFitter
from lidcam.pipeline.fusion.proposals.parting import (
    choose_parts,
    find_duplicates,
    find_enclosing,
    find_merged,
    find_partners,
    has_room,
)

SAME_IOU = 0.5
"""A box of the lidars and one proposed by a 2D box that overlap as much are one, matched or not."""

MAX_ALONE = 500
"""Of more 2D boxes without a partner in a frame, so many with the best scores propose objects; the others are noise."""

TOO_MANY = f"not among the {MAX_ALONE} best without a 3D box in a frame"
OUT_OF_IMAGE = "nothing of it lies in the image"
TOO_VAGUE = "without points, and cameras cannot tell where its object stands"
"""Why 2D boxes without a partner propose no object."""


@dataclass(frozen=True, slots=True, eq=False)
class Proposed:
    """Hypotheses of one frame.

    Attributes:
        boxes: The boxes of the lidars, then those that 2D boxes propose.
        left_out: Number of 2D boxes that propose no object though they have no partner, by reason.
    """

    boxes: Boxes3D
    left_out: Mapping[str, int] = field(default_factory=dict)


class Propose:
    """The boxes of the lidars in their order, then objects of 2D boxes that have no partner among them.

    The points where a 2D box looks become an object of source BOTH; without points, the object stays where the cameras
    place it, with source CAMERA. Where a 2D box looks into a cluster that another 2D box of the same camera is matched
    with, the cluster holds two objects: it is parted. An object is left out if the standard deviation of where the
    cameras place it is larger than half of the diagonal of the largest object of its class: nobody could say which one
    it is.
    """

    def __init__(self, rig: Rig, fitter: BoxFitter, config: ClusterConfig, classes: Sequence[ClassPrior]) -> None:
        self._names = tuple(camera.name for camera in rig.cameras)
        max_size_m = np.array([prior.max_size_m for prior in classes])
        self._ground_m2 = np.array([prior.size_m[0] * prior.size_m[1] for prior in classes])
        self._max_ground_m2 = max_size_m[:, 0] * max_size_m[:, 1]
        self._max_std_m = np.hypot(max_size_m[:, 0], max_size_m[:, 1]) / 2
        self._fit = ObjectFitter(rig, fitter, config, classes)

    def __call__(
        self, combined: CombinedCloud, lidar: Boxes3D, matches: Mapping[str, Matches], placed: Placed
    ) -> Proposed:
        """The hypotheses of a frame.

        Args:
            combined: The cloud, in which objects are sought where 2D boxes look.
            lidar: The boxes of the lidars.
            matches: By camera name; rows refer to `lidar`.
            placed: The 2D boxes, and the objects that cameras alone place.
        """
        sightings = placed.sightings
        partner, iou = find_partners(sightings, matches, self._names)
        too_large = self._is_too_large(lidar, sightings, partner)
        partner[too_large], iou[too_large] = -1, 0.0
        is_served = (partner >= 0) | find_duplicates(sightings, partner)
        alone = np.flatnonzero(~is_served)
        left_out = Counter({OUT_OF_IMAGE: placed.out_of_image, TOO_MANY: max(len(alone) - MAX_ALONE, 0)})
        if not len(alone):
            return Proposed(lidar, +left_out)
        alone = np.sort(alone[np.argsort(-sightings.scores[alone], kind="stable")[:MAX_ALONE]])
        is_matched = np.zeros(len(lidar), np.bool_)
        is_matched[partner[partner >= 0]] = True
        found = self._fit(combined, sightings.select(alone), placed.placements.select(alone))
        seen = alone[found.sighting]
        clusters = find_enclosing(combined.detection_cloud.xyz, found.rows, found.starts, lidar)
        merged = find_merged(sightings, partner, seen, clusters)
        needed_m2 = self._ground_m2[sightings.class_ids[seen]] + self._ground_m2[sightings.class_ids[merged]]
        within = np.flatnonzero((merged >= 0) & has_room(_ground_m2(lidar), clusters, needed_m2))
        lidar, parts, parted = self._parted(combined, lidar, placed, (partner, iou), seen[within], merged[within])
        free = np.lexsort((seen, -found.worth))
        free = free[merged[free] < 0]
        boxes = _as_boxes(found.boxes, lidar)
        boxes = parts.joined(boxes.select(free[~_is_known(boxes, lidar, is_matched)[free]]))
        new = boxes.select(without_overlaps(boxes))
        is_served[seen[merged < 0]] = True
        is_served[parted] = True
        unserved = np.zeros(len(placed.boxes), np.bool_)
        unserved[placed.objects[alone]] = True
        unserved[placed.objects[is_served]] = False
        is_vague = _largest_std_m(placed.boxes) > self._max_std_m[placed.boxes.class_ids]
        left_out[TOO_VAGUE] = int((unserved & is_vague)[placed.objects[alone]].sum())
        left = placed.boxes.select(unserved & ~is_vague)
        there = lidar.select(is_matched).joined(new)
        apart = np.flatnonzero((overlap_shares(left, there) <= OVERLAP_SHARE).all(1))
        return Proposed(lidar.joined(new, left.select(apart)), +left_out)

    def _is_too_large(self, lidar: Boxes3D, sightings: Sightings, partner: I64) -> Bools:
        """(P,) whether the partner of each 2D box covers more ground than anything of the class of the 2D box can.

        Such a cluster is something else, or holds more than what the 2D box shows.
        """
        too_large = np.zeros(len(partner), np.bool_)
        rows = np.flatnonzero(partner >= 0)
        too_large[rows] = _ground_m2(lidar)[partner[rows]] > self._max_ground_m2[sightings.class_ids[rows]]
        return too_large

    def _parted(
        self,
        combined: CombinedCloud,
        lidar: Boxes3D,
        placed: Placed,
        partners: tuple[I64, F64],
        seen: I64,
        owners: I64,
    ) -> tuple[Boxes3D, Boxes3D, I64]:
        """The boxes of the lidars, with those that hold several objects left to one; the other ones; their 2D boxes.

        Args:
            combined: The cloud.
            lidar: The boxes of the lidars.
            placed: The 2D boxes, and where they place their objects.
            partners: Row of the 3D box that each 2D box is matched with, and their overlap.
            seen: (U,) 2D boxes that look into a cluster of another 2D box.
            owners: (U,) that other 2D box.
        """
        partner, iou = partners
        rows = np.union1d(seen, owners)
        if not len(rows):
            return lidar, lidar.select(rows), rows
        owner = rows.copy()
        owner[np.searchsorted(rows, seen)] = owners
        sightings = placed.sightings.select(rows)
        found = self._fit(combined, sightings, placed.placements.select(rows), owner)
        row, ground_m2 = rows[found.sighting], self._ground_m2[sightings.class_ids[found.sighting]]
        kept, other = choose_parts(found.iou, row, owner[found.sighting], ground_m2, partner, iou, _ground_m2(lidar))
        boxes = _as_boxes(found.boxes, lidar)
        return _with_rows(lidar, partner[row[kept]], boxes.select(kept)), boxes.select(other), row[other]


def _as_boxes(found: Candidates3D, lidar: Boxes3D) -> Boxes3D:
    count = len(found.scores)
    return Boxes3D(
        lidar.stamp_ns,
        lidar.frame_id,
        found.centers,
        found.sizes,
        wrap_angle(found.yaws),
        found.scores.astype(np.float32),
        found.class_ids.astype(np.int32),
        found.point_counts.astype(np.int32),
        found.covariances,
        np.full(count, Source.BOTH, np.uint8),
        lidar.stamp_ns + found.time_offsets_ns,
    )


def _is_known(boxes: Boxes3D, lidar: Boxes3D, is_matched: Bools) -> Bools:
    """(N,) whether each box is one of the lidars, which a camera confirms, or which is much the same."""
    same_class = boxes.class_ids[:, None] == lidar.class_ids
    bev = ious(boxes, lidar).bev
    rival = is_matched & (overlap_shares(boxes, lidar, bev) > OVERLAP_SHARE)
    same = same_class & (bev > SAME_IOU)
    return np.asarray((rival | same).any(1))


def _ground_m2(boxes: Boxes3D) -> F64:
    return np.asarray(boxes.sizes[:, 0] * boxes.sizes[:, 1])


def _largest_std_m(boxes: Boxes3D) -> F64:
    """(N,) standard deviation of each box's place in the direction in which it is largest."""
    a, b, c = boxes.covariances[:, 0, 0], boxes.covariances[:, 0, 1], boxes.covariances[:, 1, 1]
    return np.asarray(np.sqrt((a + c) / 2 + np.hypot((a - c) / 2, b)))


def _with_rows(boxes: Boxes3D, rows: I64, new: Boxes3D) -> Boxes3D:
    """The boxes, the given rows of which are the new ones."""
    order = np.arange(len(boxes))
    order[rows] = len(boxes) + np.arange(len(rows))
    return boxes.joined(new).select(order)
