"""2D boxes that have an object already, and clusters of several objects that 2D boxes split."""

from collections.abc import Mapping

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, Bools, first_of_runs
from lidcam.pipeline.core.detections import Boxes3D, Matches
from lidcam.pipeline.core.geometry.boxes import iou_xyxy
from lidcam.pipeline.core.geometry.regions import points_in_footprints
from lidcam.pipeline.fusion.cameras.sightings import Sightings
from lidcam.pipeline.fusion.proposals.frustums import FrustumPoints

DUPLICATE_IOU = 0.6
"""Minimum IoU with a matched 2D box of the same image before a 2D box counts as its duplicate."""

MIN_ENCLOSED_SHARE = 0.5
"""Minimum share of an object's points in a box before the box holds the object."""

BOX_MARGIN = 0.1
"""Margin of a box at either side, as a share of its size, within which points belong to it."""

MIN_KEPT_IOU = 0.8
"""Minimum IoU of the remaining part of a split cluster with its 2D box, as a share of the IoU before."""

MIN_GROUND_SHARE = 0.75
"""Minimum ground of a split cluster, as a share of that of its objects by their classes: one car behind another does
not cover half of that."""


def find_partners(sightings: Sightings, matches: Mapping[str, Matches], names: tuple[str, ...]) -> tuple[I64, F64]:
    """(P,) row of the 3D box matched with each 2D box, -1 for none; and (P,) their overlap.

    `matches` are by camera name; `names` are the names of the cameras by their number.
    """
    partner, iou = np.full(len(sightings), -1, np.int64), np.zeros(len(sightings))
    for camera in set(sightings.cameras.tolist()):
        of_camera = matches[names[camera]]
        is_pair = (sightings.cameras == camera)[:, None] & (sightings.rows[:, None] == of_camera.pairs[:, 1])
        sighting, pair = is_pair.nonzero()
        partner[sighting], iou[sighting] = of_camera.pairs[pair, 0], of_camera.iou[pair]
    return partner, iou


def find_duplicates(sightings: Sightings, partner: I64) -> Bools:
    """(P,) whether each 2D box has no partner, but nearly covers one of the same image with one."""
    duplicates = np.zeros(len(sightings), np.bool_)
    for camera in set(sightings.cameras[partner < 0].tolist()):
        mine = np.flatnonzero((sightings.cameras == camera) & (partner < 0))
        others = np.flatnonzero((sightings.cameras == camera) & (partner >= 0))
        duplicates[mine] = (iou_xyxy(sightings.xyxy[mine], sightings.xyxy[others]) > DUPLICATE_IOU).any(1)
    return duplicates


def find_enclosing(xyz: F32, rows: I64, starts: I64, boxes: Boxes3D) -> I64:
    """(G,) row of the box that holds most of the points of each object; -1 where none holds more than half of them.

    Args:
        xyz: (N, 3) the cloud.
        rows: (P,) rows of the points of the objects, object after object.
        starts: (G,) first of `rows` of each object.
        boxes: Boxes that may hold them.
    """
    counts = np.diff(starts, append=len(rows))
    if not len(boxes) or not len(counts):
        return np.full(len(counts), -1)
    points, sizes = xyz[rows], boxes.sizes * (1 + 2 * BOX_MARGIN)
    point, box = points_in_footprints(points, boxes.centers[:, :2], sizes[:, :2], boxes.yaws)
    is_within = np.abs(points[point, 2] - boxes.centers[box, 2]) <= sizes[box, 2] / 2
    cell = np.repeat(np.arange(len(counts)), counts)[point] * len(boxes) + box
    held = np.bincount(cell[is_within], minlength=len(counts) * len(boxes)).reshape(len(counts), len(boxes))
    return np.where(held.max(1) > MIN_ENCLOSED_SHARE * counts, held.argmax(1), -1)


def find_merged(sightings: Sightings, partner: I64, seen: I64, clusters: I64) -> I64:
    """(G,) 2D box matched with the cluster of each object in the camera that shows the object; -1 without one.

    Such a cluster holds two objects: that of its own 2D box, and the other one.

    Args:
        sightings: All 2D boxes.
        partner: Their partners, as from `find_partners`.
        seen: (G,) row of the 2D box of each object.
        clusters: (G,) as from `find_enclosing`.
    """
    same = (sightings.cameras[seen][:, None] == sightings.cameras) & (clusters[:, None] == partner) & (partner >= 0)
    return np.where(same.any(1), same.argmax(1), -1).astype(np.int64)


def share_points(found: FrustumPoints, owner: I64) -> I64:
    """Rows of the points, rising; each point in one frustum of an owner only, nearest to its middle.

    Frustums of the same owner (F,) look into one cluster by one camera.
    """
    order = np.lexsort([np.abs(found.share_x - 0.5), found.rows, owner[found.group]])
    owners, rows = owner[found.group[order]], found.rows[order]
    return np.sort(order[first_of_runs(owners) | first_of_runs(rows)])


def has_room(cluster_ground_m2: F64, clusters: I64, needed_m2: F64) -> Bools:
    """(G,) whether each of these of N clusters covers enough of the ground that its objects need."""
    if not len(cluster_ground_m2):
        return np.zeros(len(clusters), np.bool_)
    return np.asarray(cluster_ground_m2[clusters] >= MIN_GROUND_SHARE * needed_m2)


def choose_parts(
    iou: F64, row: I64, owner: I64, ground_m2: F64, partner: I64, partner_iou: F64, cluster_ground_m2: F64
) -> tuple[I64, I64]:
    """The parts into which clusters are split.

    Args:
        iou: (G,) overlap of the box of each part with its 2D box.
        row: (G,) that 2D box, among all.
        owner: (G,) 2D box matched with the cluster; `row` for the part that the cluster keeps.
        ground_m2: (G,) ground of an object of the part's class.
        partner: (P,) row of the cluster of every 2D box.
        partner_iou: (P,) its overlap with that 2D box.
        cluster_ground_m2: (N,) ground of every cluster's box.

    Returns:
        (K,) the parts that the clusters keep, at most one for each cluster; and the other parts of those clusters. Of
        several cameras, the one that sees most objects in a cluster splits it.
    """
    is_kept = row == owner
    others = np.bincount(owner[~is_kept], minlength=len(partner))
    needed_m2 = np.bincount(owner, ground_m2, minlength=len(partner)).astype(np.float64)
    sound = is_kept & (iou >= MIN_KEPT_IOU * partner_iou[row]) & (others[owner] > 0)
    best = np.flatnonzero(sound)
    best = best[has_room(cluster_ground_m2, partner[row[best]], needed_m2[owner[best]])]
    best = best[np.lexsort((row[best], -others[owner[best]], partner[row[best]]))]
    best = best[first_of_runs(partner[row[best]])]
    return best, np.flatnonzero(~is_kept & np.isin(owner, row[best]))
