"""What a frame shows of objects, in the fixed frame: the measurements that tracks are made of."""

from dataclasses import dataclass

import numpy as np

from lidcam.pipeline.core.arrays import F64, I32, I64, U8, Bools, Table
from lidcam.pipeline.tracking.motion import Priors


@dataclass(frozen=True, slots=True, eq=False)
class Sightings(Table):
    """N objects that a frame may show.

    Attributes:
        rows: (N,) int64, row of each one's hypothesis.
        boxes: (N, 3) float64, x, y of the centre and yaw, in the fixed frame.
        heights_m: (N,) float64, z of the centre.
        sizes: (N, 3) float64, length, width, height, metres.
        covariances: (N, 3, 3) float64 of `boxes`; zeros where unknown.
        later_s: (N,) float64, when it was seen, after the stamp of the frame.
        beliefs: (N,) float64, probability that there is an object of the class at this place.
        class_ids: (N,) int64.
        are_reported: (N,) bool, whether the frame by itself reports it.
        matched: (N,) int32, number of cameras that matched it.
        point_counts: (N,) int32.
        sources: (N,) uint8.
        sides: (N, 2) float64 in [-1, 1], where along its length and its width the lidars are: 1 beyond its front, or
            its left side.
        faces: (N, 2) float64, how well the lidars see its length and its width, 1/m^2.
        ends: (N, 2, 3) float64, the foremost and the rearmost of its points: x and y in the fixed frame, and how many
            seconds after the stamp they were measured; NaN where it has too few points.
    """

    rows: I64
    boxes: F64
    heights_m: F64
    sizes: F64
    covariances: F64
    later_s: F64
    beliefs: F64
    class_ids: I64
    are_reported: Bools
    matched: I32
    point_counts: I32
    sources: U8
    sides: F64
    faces: F64
    ends: F64


@dataclass(frozen=True, slots=True, eq=False)
class FrameSightings:
    """The sightings of one frame.

    Attributes:
        stamp_ns: Its time.
        T_fixed_site: (4, 4) float64.
        sightings: What it shows.
    """

    stamp_ns: int
    T_fixed_site: F64
    sightings: Sightings

    @property
    def turn_rad(self) -> float:
        """Yaw of the site frame in the fixed frame."""
        return float(np.arctan2(self.T_fixed_site[1, 0], self.T_fixed_site[0, 0]))


ALIKE = 4.0
"""So many measurements in a row say as much as one: neighbouring frames share most of their error."""

SHARED_ERROR = 0.5
"""Share of the variance of a measurement that all measurements of a track have in common, so that it stays."""

FRONT_SHARE = 0.75
"""What moved by this share of its length shows which end is its front; boxes of few points wander by half a length.
What moved by less gets the front that most of its boxes have, or offline the direction of the lane beside it."""

UNKNOWN_SIGMA_SHARE, UNKNOWN_SIGMA_RAD = 0.05, 0.1
"""Standard deviations of boxes whose covariance is unknown: of the place as a share of the length, of the yaw."""

YAW_SIGMA_RAD, NO_AXIS_VARIANCE = 0.03, 100.0
"""What is added to the deviation of yaws; variance of those of boxes that show no axis: they say nothing."""


def measured(sightings: Sightings, priors: Priors, jump_share: float) -> tuple[F64, F64]:
    """The boxes of sightings as measurements (N, 3) and their covariances (N, 3, 3).

    Args:
        sightings: N of them.
        priors: Of all classes.
        jump_share: Standard deviation that the completion of boxes adds to their places, as a share of the length of
            the class.
    """
    of_class = priors.select(sightings.class_ids)
    noise = sightings.covariances.copy()
    unknown = ~noise.any((1, 2))
    place = (UNKNOWN_SIGMA_SHARE * of_class.lengths_m[unknown]) ** 2
    noise[unknown, 0, 0] = noise[unknown, 1, 1] = place
    noise[unknown, 2, 2] = UNKNOWN_SIGMA_RAD**2
    jump = (jump_share * of_class.lengths_m) ** 2
    noise[:, 0, 0] += jump
    noise[:, 1, 1] += jump
    noise[:, 2, 2] = np.where(of_class.have_axis, noise[:, 2, 2] + YAW_SIGMA_RAD**2, NO_AXIS_VARIANCE)
    noise[:, :2, 2] = noise[:, 2, :2] = 0.0
    return sightings.boxes, noise
