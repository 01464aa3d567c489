"""What the self-check says of the sensors, in numbers and in words."""

from typing import NamedTuple

import numpy as np

from lidcam.pipeline.calibration.camera_error import CameraError
from lidcam.pipeline.calibration.lidar_error import LidarError
from lidcam.pipeline.core.arrays import Bools
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor
from lidcam.run.warning import RunWarning

REMEDY = "see what `lidcam inspect --check` says of it, or calibrate it again"


class CameraJudged(NamedTuple):
    """What is said of one camera.

    Attributes:
        camera: As it is calibrated.
        pairs: Number of pairs of boxes that there were.
        tracks: Number of tracks they are of.
        error: Its error, where something is told with nothing else wrong; None if there are too few pairs.
        wrong: (7,) which of its values are told.
    """

    camera: CameraSensor
    pairs: int
    tracks: int
    error: CameraError | None
    wrong: Bools


class LidarsJudged(NamedTuple):
    """What is said of two lidars.

    Attributes:
        first: The one that is taken for right.
        second: The other.
        error: The error of the second; None if they see too little in common.
        wrong: (6,) which of its values are told.
    """

    first: LidarSensor
    second: LidarSensor
    error: LidarError | None
    wrong: Bools


_DIRECTIONS = (
    ("looks", "degrees", "further down", "further up"),
    ("looks", "degrees", "further left", "further right"),
    ("is turned", "degrees", "counter-clockwise", "clockwise"),
    ("stands", "m", "further left", "further right"),
    ("stands", "m", "higher", "lower"),
    ("stands", "m", "further back", "further ahead"),
    ("took its images", "ms", "later than their stamps say", "earlier than their stamps say"),
)
"""Where a camera really looks and stands if a value is positive, and if it is negative: what lies further right in the
image than was thought is seen by a camera that looks further left."""

SCALES = np.array([*np.degrees([1.0, 1.0, 1.0]), 1.0, 1.0, 1.0, 1000.0])
"""Degrees, metres and milliseconds from radians, metres and seconds."""


def camera_warning(judged: CameraJudged) -> RunWarning:
    """The warning of a camera that has an error."""
    assert judged.error is not None
    values, sigmas = judged.error.values * SCALES, judged.error.sigmas * SCALES
    parts = []
    for row in np.flatnonzero(judged.wrong):
        verb, unit, positive, negative = _DIRECTIONS[row]
        parts.append(f"{verb} {_figure(values[row], sigmas[row], unit)} {positive if values[row] > 0 else negative}")
    finding = f"by {judged.error.pairs} boxes of {judged.error.tracks} objects it {', and '.join(parts)}"
    return RunWarning(judged.camera.name, finding, REMEDY)


def lidars_warning(judged: LidarsJudged) -> RunWarning:
    """The warning of two lidars that disagree."""
    assert judged.error is not None
    values, sigmas = judged.error.values * SCALES[:6], judged.error.sigmas * SCALES[:6]
    names = ("about x", "about y", "about z", "along x", "along y", "along z")
    parts = [
        f"{_figure(values[row], sigmas[row], 'degrees' if row < 3 else 'm')} {names[row]}"
        for row in np.flatnonzero(judged.wrong)
    ]
    finding = f"what it sees lies beside what {judged.first.name} sees, by {' and '.join(parts)}: one of them is off"
    return RunWarning(judged.second.name, finding, REMEDY)


def _figure(value: float, sigma: float, unit: str) -> str:
    digits = 0 if unit == "ms" else 2
    return f"{abs(value):.{digits}f} ± {sigma:.{digits}f} {unit}"
