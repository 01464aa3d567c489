"""Selection of the reported objects by the zones of a rig."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.arrays import F64, I64, Bools, select_rows
from lidcam.pipeline.core.detections import Fused
from lidcam.pipeline.core.geometry.polygons import first_polygon_with
from lidcam.pipeline.core.rig import Zone, ZoneUse

OUTSIDE = "outside of all zones of use detect"
"""Reason of an object outside of all zones of use `detect`."""


def is_reported(centers: F64, zones: Sequence[Zone]) -> Bools:
    """Whether objects are reported: not in a zone of use `ignore`, and in one of use `detect` if there is any.

    Args:
        centers: (N, 2) or (N, 3) in the site frame, metres; one on the edge of a zone lies in it.
        zones: Zones of the rig, in any order: `ignore` overrides `detect`.
    """
    reported = _rows_in(centers, zones, "ignore") < 0
    if any(zone.use == "detect" for zone in zones):
        reported &= _rows_in(centers, zones, "detect") >= 0
    return np.asarray(reported)


def select_by_zones(fused: Fused, zones: Sequence[Zone]) -> Fused:
    """The reported objects, with the number of others by reason."""
    centers = fused.objects.centers
    kept = is_reported(centers, zones)
    left_out = dict(fused.left_out)
    ignored = _rows_in(centers, zones, "ignore")
    names = [f"in zone {zone.name} of use ignore" for zone in zones if zone.use == "ignore"]
    reasons = [OUTSIDE, *names]
    for row, count in enumerate(np.bincount(ignored[~kept] + 1, minlength=len(reasons)).tolist()):
        if count:
            left_out[reasons[row]] = left_out.get(reasons[row], 0) + count
    return replace(select_rows(fused, kept), left_out=left_out)


def _rows_in(centers: F64, zones: Sequence[Zone], use: ZoneUse) -> I64:
    """(N,) the first zone of a use that holds each centre, among those of that use; -1 without one."""
    return first_polygon_with([zone.polygon_site for zone in zones if zone.use == use], centers[:, :2])
