"""The direction in which the points of a cluster seen from above are spread most.

A cyclist is no rectangle: thin wheels at both ends, a rider as wide as the handlebars in the middle. The rectangle to
whose sides the points lie closest runs along the lines from shoulder to wheel, 14 degrees off the heading in the
median of simulated recordings; the principal axis is 3 degrees off.
"""

import numpy as np

from pipeline.core.arrays import F64, I64
from pipeline.detectors.cluster.lshape_kernels import moments

__all__ = ["principal_axes"]


def principal_axes(xy: F64, starts: I64) -> tuple[F64, F64]:
    """(C,) angle about +z of the principal axis of each cluster, in (-pi/2, pi/2]; (C,) its roundness, in [0, 1].

    Roundness is the standard deviation across the axis, as a share of that along it; 1 for a single point.

    Args:
        xy: (N, 2 or more) of which x and y count, metres; sorted by cluster.
        starts: (C,) first row of each cluster; each has at least one.
    """
    xx, xy_, yy = moments(np.ascontiguousarray(xy), np.append(starts[1:], len(xy))).T
    apart = np.hypot((xx - yy) / 2, xy_)
    most, least = (xx + yy) / 2 + apart, np.maximum((xx + yy) / 2 - apart, 0.0)
    roundness = np.sqrt(np.divide(least, most, out=np.ones_like(most), where=most > 0))
    return np.arctan2(2 * xy_, xx - yy) / 2, roundness
