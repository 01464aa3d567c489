"""Clusters in which several objects have been merged, parted by the 2D boxes that look into them."""

import numpy as np

from pipeline.core.arrays import F32, F64, I64, Bools
from pipeline.core.detections import Boxes3D
from pipeline.fusion.begun.beginning import Begun
from pipeline.fusion.begun.frustums import FrustumPoints
from pipeline.fusion.begun.parting_kernels import boxes_that_hold, nearest_of_team
from pipeline.fusion.cameras.sightings import Sightings

__all__ = ["choose_parts", "find_hosts", "find_merged", "has_room", "share_points"]

HOST_SHARE = 0.5
"""A box that holds more than this share of an object's points holds the object."""

MARGIN_SHARE = 0.1
"""Points lie in a box that is this share of its size larger."""

KEPT_IOU_SHARE = 0.8
"""A cluster is parted only if its own part overlaps its 2D box by at least this share of what all of it did."""

ROOM_SHARE = 0.75
"""A cluster is parted only if it covers this share of the ground that its objects take up by their classes: one car
behind another one is not a half of that."""


def find_hosts(xyz: F32, begun: Begun, boxes: Boxes3D) -> I64:
    """(G,) row of the box that holds most of the points of each object; -1 where none holds more than half of them.

    Args:
        xyz: (N, 3) the cloud.
        begun: G objects.
        boxes: In which they may be.
    """
    half, ends = boxes.sizes * (0.5 + MARGIN_SHARE), np.append(begun.starts[1:], len(begun.rows))[: len(begun.sighting)]
    xyz, cosines, sines = np.ascontiguousarray(xyz), np.cos(boxes.yaws), np.sin(boxes.yaws)
    return boxes_that_hold(xyz, begun.rows, ends, boxes.centers, half, cosines, sines, HOST_SHARE)


def find_merged(sightings: Sightings, partner: I64, seen: I64, hosts: I64) -> I64:
    """(G,) 2D box by which the host of each object is matched in the camera that shows the object; -1 where none is.

    Such a host holds two objects: that of its own 2D box, and the other one.

    Args:
        sightings: All 2D boxes.
        partner: Of them, see `find_partners`.
        seen: (G,) row of the 2D box of each object.
        hosts: (G,) see `find_hosts`.
    """
    same = (sightings.cameras[seen][:, None] == sightings.cameras) & (hosts[:, None] == partner) & (partner >= 0)
    return np.where(same.any(1), same.argmax(1), -1).astype(np.int64)


def share_points(found: FrustumPoints, team: I64) -> I64:
    """Rows of the points, rising; of one that lies in several frustums of a team, where its middle is nearest to it.

    Args:
        found: P points in F frustums.
        team: (F,) frustums of one number look into one cluster by one camera.
    """
    return nearest_of_team(found.rows, found.group, np.abs(found.share_x - 0.5), team)


def has_room(host_ground_m2: F64, hosts: I64, needed_m2: F64) -> Bools:
    """(G,) whether each of the given clusters, of N, covers enough of the ground that its objects need."""
    if not len(host_ground_m2):
        return np.zeros(len(hosts), np.bool_)
    return np.asarray(host_ground_m2[hosts] >= ROOM_SHARE * needed_m2)


def choose_parts(
    iou: F64, row: I64, team: I64, ground_m2: F64, partner: I64, partner_iou: F64, host_ground_m2: F64
) -> tuple[I64, I64]:
    """Which boxes fitted to the parts of clusters are taken.

    Args:
        iou: (G,) overlap of the box of each part with its own 2D box.
        row: (G,) that 2D box, in the table of all.
        team: (G,) 2D box that the cluster is matched with; it is `row` for the part that the cluster keeps.
        ground_m2: (G,) ground that an object of the part's class takes up.
        partner: (P,) row of the cluster of every 2D box.
        partner_iou: (P,) its overlap with that 2D box.
        host_ground_m2: (N,) ground of every cluster's box.

    Returns:
        (K,) the parts that the clusters keep, at most one for each cluster; and the other parts of those clusters. A
        cluster that several cameras part is parted by the one that sees most in it.
    """
    is_owner = row == team
    others = np.bincount(team[~is_owner], minlength=len(partner))
    needed_m2 = np.bincount(team, ground_m2, minlength=len(partner)).astype(np.float64)
    sound = is_owner & (iou >= KEPT_IOU_SHARE * partner_iou[row]) & (others[team] > 0)
    best = np.flatnonzero(sound)
    host = partner[row[best]]
    best = best[has_room(host_ground_m2, host, needed_m2[team[best]])]
    host = partner[row[best]]
    best = best[np.lexsort((row[best], -others[team[best]], host))]
    best = best[np.flatnonzero(np.diff(partner[row[best]], prepend=-1))]
    return best, np.flatnonzero(~is_owner & np.isin(team, row[best]))
