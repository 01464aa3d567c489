"""Which 2D boxes have an object already, and clusters in which several objects have been merged, parted by 2D boxes."""

from collections.abc import Mapping

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I64, Bools, first_of_runs
from lidcam.pipeline.core.detections import Boxes3D, Matches
from lidcam.pipeline.core.geometry.boxes import iou_xyxy
from lidcam.pipeline.core.geometry.regions import points_in_footprints
from lidcam.pipeline.fusion.cameras.sightings import Sightings
from lidcam.pipeline.fusion.proposals.frustums import FrustumPoints

DUPLICATE_IOU = 0.6
"""A 2D box that overlaps a matched one of its image as much shows the same object."""

ENCLOSED_SHARE = 0.5
"""A box that holds more than this share of an object's points holds the object."""

MARGIN_SHARE = 0.1
"""Points lie in a box that is this share of its size larger."""

KEPT_IOU_SHARE = 0.8
"""A cluster is parted only if its own part overlaps its 2D box by at least this share of what all of it did."""

ROOM_SHARE = 0.75
"""A cluster is parted only if it covers this share of the ground that its objects take up by their classes: one car
behind another one is not a half of that."""


def find_partners(sightings: Sightings, matches: Mapping[str, Matches], names: tuple[str, ...]) -> tuple[I64, F64]:
    """(P,) row of the 3D box that each 2D box is matched with, -1 where there is none; and (P,) their overlap.

    Args:
        sightings: P 2D boxes.
        matches: By camera name.
        names: Of the cameras, by their number.
    """
    partner, iou = np.full(len(sightings), -1, np.int64), np.zeros(len(sightings))
    for camera in set(sightings.cameras.tolist()):
        own = matches[names[camera]]
        is_pair = (sightings.cameras == camera)[:, None] & (sightings.rows[:, None] == own.pairs[:, 1])
        sighting, pair = is_pair.nonzero()
        partner[sighting], iou[sighting] = own.pairs[pair, 0], own.iou[pair]
    return partner, iou


def find_duplicates(sightings: Sightings, partner: I64) -> Bools:
    """(P,) whether each 2D box has no partner, but nearly covers one of the same image that has."""
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
        boxes: In which they may be.
    """
    counts = np.diff(starts, append=len(rows))
    if not len(boxes) or not len(counts):
        return np.full(len(counts), -1)
    points, sizes = xyz[rows], boxes.sizes * (1 + 2 * MARGIN_SHARE)
    point, box = points_in_footprints(points, boxes.centers[:, :2], sizes[:, :2], boxes.yaws)
    is_within = np.abs(points[point, 2] - boxes.centers[box, 2]) <= sizes[box, 2] / 2
    cell = np.repeat(np.arange(len(counts)), counts)[point] * len(boxes) + box
    held = np.bincount(cell[is_within], minlength=len(counts) * len(boxes)).reshape(len(counts), len(boxes))
    return np.where(held.max(1) > ENCLOSED_SHARE * counts, held.argmax(1), -1)


def find_merged(sightings: Sightings, partner: I64, seen: I64, clusters: I64) -> I64:
    """(G,) 2D box by which the cluster of each object is matched in the camera that shows the object; -1 without one.

    Such a cluster holds two objects: that of its own 2D box, and the other one.

    Args:
        sightings: All 2D boxes.
        partner: Of them, see `find_partners`.
        seen: (G,) row of the 2D box of each object.
        clusters: (G,) see `find_enclosing`.
    """
    same = (sightings.cameras[seen][:, None] == sightings.cameras) & (clusters[:, None] == partner) & (partner >= 0)
    return np.where(same.any(1), same.argmax(1), -1).astype(np.int64)


def share_points(found: FrustumPoints, owner: I64) -> I64:
    """Rows of the points, rising; of one in several frustums of one owner, that where its middle is nearest.

    Args:
        found: P points in F frustums.
        owner: (F,) frustums of one owner look into one cluster by one camera.
    """
    order = np.lexsort([np.abs(found.share_x - 0.5), found.rows, owner[found.group]])
    owners, rows = owner[found.group[order]], found.rows[order]
    return np.sort(order[first_of_runs(owners) | first_of_runs(rows)])


def has_room(cluster_ground_m2: F64, clusters: I64, needed_m2: F64) -> Bools:
    """(G,) whether each of the given clusters, of N, covers enough of the ground that its objects need."""
    if not len(cluster_ground_m2):
        return np.zeros(len(clusters), np.bool_)
    return np.asarray(cluster_ground_m2[clusters] >= ROOM_SHARE * needed_m2)


def choose_parts(
    iou: F64, row: I64, owner: I64, ground_m2: F64, partner: I64, partner_iou: F64, cluster_ground_m2: F64
) -> tuple[I64, I64]:
    """Which boxes fitted to the parts of clusters are taken.

    Args:
        iou: (G,) overlap of the box of each part with its own 2D box.
        row: (G,) that 2D box, in the table of all.
        owner: (G,) 2D box that the cluster is matched with; it is `row` for the part that the cluster keeps.
        ground_m2: (G,) ground that an object of the part's class takes up.
        partner: (P,) row of the cluster of every 2D box.
        partner_iou: (P,) its overlap with that 2D box.
        cluster_ground_m2: (N,) ground of every cluster's box.

    Returns:
        (K,) the parts that the clusters keep, at most one for each cluster; and the other parts of those clusters. A
        cluster that several cameras part is parted by the one that sees most in it.
    """
    is_kept = row == owner
    others = np.bincount(owner[~is_kept], minlength=len(partner))
    needed_m2 = np.bincount(owner, ground_m2, minlength=len(partner)).astype(np.float64)
    sound = is_kept & (iou >= KEPT_IOU_SHARE * partner_iou[row]) & (others[owner] > 0)
    best = np.flatnonzero(sound)
    best = best[has_room(cluster_ground_m2, partner[row[best]], needed_m2[owner[best]])]
    best = best[np.lexsort((row[best], -others[owner[best]], partner[row[best]]))]
    best = best[first_of_runs(partner[row[best]])]
    return best, np.flatnonzero(~is_kept & np.isin(owner, row[best]))
