"""Hypotheses of a frame: the boxes of the lidars, and objects that only 2D boxes show."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools
from lidcam.pipeline.core.clouds import CombinedCloud
from lidcam.pipeline.core.detections import Boxes3D, Matches, Source
from lidcam.pipeline.core.geometry.overlaps import OVERLAP_SHARE, overlap_shares, without_overlaps
from lidcam.pipeline.core.geometry.rotated_iou import ious
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.classes import ClassPrior
from lidcam.pipeline.core.settings.detect import ClusterConfig
from lidcam.pipeline.detectors.cluster.fitting import BoxFitter
from lidcam.pipeline.fusion.cameras.placing import Placed
from lidcam.pipeline.fusion.cameras.sightings import Sightings
from lidcam.pipeline.fusion.proposals.bare import bare_shares
from lidcam.pipeline.fusion.proposals.fitted import ObjectFitter

MIN_SAME_IOU = 0.5
"""Minimum IoU of a box of the lidars and a proposed one that are the same object, matched or not."""

MAX_BARE_SHARE = 0.5
"""Maximum probability that an object without points would stand on ground that the lidars see."""

MAX_TALLER = 1.25
"""Maximum height of the 2D box of a person, on foot or riding, in heights of its partner there: a taller one shows
somebody nearer."""

MAX_UNMATCHED = 500
"""Maximum number of unmatched 2D boxes per frame that propose objects, those with the best scores."""

TOO_MANY = f"not among the {MAX_UNMATCHED} best without a 3D box in a frame"
"""Reason of an unmatched 2D box beyond `MAX_UNMATCHED`."""

OUT_OF_VIEW = "outside of the image, straight below the camera, or reaches beyond its lens model (as 90 degrees)"
"""Reason of an unmatched 2D box whose edges have no rays."""

TOO_VAGUE = "no lidar points there that fit, and distance unknown"
"""Reason of an unmatched 2D box whose object has no points, unlike others there perhaps, and an uncertain position."""

BARE = "bare ground there"
"""Reason of an unmatched 2D box whose object would stand where the lidars see the ground."""


@dataclass(frozen=True, slots=True, eq=False)
class Proposed:
    """Hypotheses of one frame."""

    boxes: Boxes3D  # The boxes of the lidars, then those that 2D boxes propose
    # Number of unmatched 2D boxes that propose no object, by reason
    left_out: Mapping[str, int]


class Propose:
    """The boxes of the lidars in their order, then objects of 2D boxes that have no partner among them.

    The points in the frustum of a 2D box become an object of source BOTH; without points, the object stays where the
    cameras place it, with source CAMERA. An object is left out if it overlaps with a matched box of the lidars, if the
    standard deviation of its position by the cameras exceeds half of the diagonal of the largest object of its class,
    or if the lidars see bare ground in its place.
    """

    def __init__(self, rig: Rig, fitter: BoxFitter, config: ClusterConfig, classes: Sequence[ClassPrior]) -> None:
        self._names = tuple(camera.name for camera in rig.cameras)
        max_size_m = np.array([prior.max_size_m for prior in classes])
        self._max_ground_m2 = max_size_m[:, 0] * max_size_m[:, 1]
        self._are_people = np.array([prior.is_upright for prior in classes])
        self._max_std_m = np.hypot(max_size_m[:, 0], max_size_m[:, 1]) / 2
        self._fit = ObjectFitter(rig, fitter, config, classes)

    def __call__(
        self, combined: CombinedCloud, lidar: Boxes3D, matches: Mapping[str, Matches], placed: Placed
    ) -> Proposed:
        """The hypotheses of a frame.

        Args:
            combined: The cloud.
            lidar: The boxes of the lidars.
            matches: By camera name; rows refer to `lidar`.
            placed: The 2D boxes, and the objects placed by cameras alone.
        """
        sightings = placed.sightings
        partner = find_partners(sightings, matches, self._names)
        paired = np.flatnonzero(partner >= 0)
        fits = self._fits(sightings.select(paired), lidar.select(partner[paired]))
        partner[paired[~fits]] = -1
        is_served = partner >= 0
        alone = np.flatnonzero(~is_served)
        left_out = Counter({OUT_OF_VIEW: placed.out_of_view, TOO_MANY: max(len(alone) - MAX_UNMATCHED, 0)})
        if not len(alone):
            return Proposed(lidar, +left_out)
        alone = np.sort(alone[np.argsort(-sightings.scores[alone], kind="stable")[:MAX_UNMATCHED]])
        is_matched = np.zeros(len(lidar), np.bool_)
        is_matched[partner[partner >= 0]] = True
        found = self._fit(combined, sightings.select(alone), placed.placements.select(alone))
        seen = alone[found.sighting]
        ranked = np.lexsort((seen, -found.worth))
        boxes = found.boxes.as_boxes(ranked, lidar.stamp_ns, lidar.frame_id, Source.BOTH)
        boxes = boxes.select(~_are_lidar_boxes(boxes, lidar, is_matched))
        new = boxes.select(without_overlaps(boxes))
        is_served[seen] = True
        unserved = np.zeros(len(placed.boxes), np.bool_)
        unserved[placed.objects[alone]] = True
        unserved[placed.objects[is_served]] = False
        is_vague = _largest_std_m(placed.boxes) > self._max_std_m[placed.boxes.class_ids]
        left_out[TOO_VAGUE] = int((unserved & is_vague)[placed.objects[alone]].sum())
        left = np.flatnonzero(unserved & ~is_vague)
        there = lidar.select(is_matched).joined(new)
        left = left[(overlap_shares(placed.boxes.select(left), there) <= OVERLAP_SHARE).all(1)]
        is_bare = bare_shares(placed.boxes.select(left), combined.ground_cloud.xyz) > MAX_BARE_SHARE
        left_out[BARE] = int(np.isin(placed.objects[alone], left[is_bare]).sum())
        more = new.joined(placed.boxes.select(left[~is_bare]))
        return Proposed(lidar.joined(more) if len(more) else lidar, +left_out)

    def _fits(self, sightings: Sightings, partners: Boxes3D) -> Bools:
        """(P,) whether each 2D box may show its partner: an object that its class allows, or a person as tall as it."""
        ground_m2, class_ids = partners.sizes[:, :2].prod(1), sightings.class_ids
        ahead, offset_m = sightings.T_camera_site[:, 2, :3], sightings.T_camera_site[:, 2, 3]
        depth_m = (ahead * partners.centers).sum(1) + offset_m - np.hypot(*partners.sizes[:, :2].T) / 2
        height_m = depth_m * np.linalg.norm(sightings.rays[:, 1] - sightings.rays[:, 5], axis=1)
        is_too_tall = self._are_people[class_ids] & (height_m > MAX_TALLER * partners.sizes[:, 2])
        return np.asarray((ground_m2 <= self._max_ground_m2[class_ids]) & ~is_too_tall)


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


def _are_lidar_boxes(boxes: Boxes3D, lidar: Boxes3D, is_matched: Bools) -> Bools:
    """(N,) whether each box is one of the lidars that a camera confirms, or that has about the same box."""
    bev = ious(boxes, lidar).bev
    rival = is_matched & (overlap_shares(boxes, lidar, bev) > OVERLAP_SHARE)
    same = (boxes.class_ids[:, None] == lidar.class_ids) & (bev > MIN_SAME_IOU)
    return np.asarray((rival | same).any(1))


def _largest_std_m(boxes: Boxes3D) -> F64:
    """(N,) largest standard deviation of each box's position in any direction."""
    a, b, c = boxes.covariances[:, 0, 0], boxes.covariances[:, 0, 1], boxes.covariances[:, 1, 1]
    return np.asarray(np.sqrt((a + c) / 2 + np.hypot((a - c) / 2, b)))
