"""The formats of data sets, one row each, and what a user may ask for."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from lidcam.readers.location import Location
from lidcam.writers.datasets.frame import DatasetWriter
from lidcam.writers.datasets.kitti import KittiTrackingWriter, KittiWriter
from lidcam.writers.datasets.nuscenes import NuScenesWriter
from lidcam.writers.datasets.openlabel import OpenLabelWriter


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What is exported.

    Attributes:
        confirmed: Whether only objects that a camera confirms are.
        every: Every how many frames.
        camera: Name of the camera where a format has one; empty: the first with images.
        truth: Recordings or labels with the truth; empty: the truth in the result.
    """

    confirmed: bool = False
    every: int = 1
    camera: str = ""
    truth: tuple[Location, ...] = ()


FORMATS: dict[str, Callable[[Path, ExportOptions], DatasetWriter]] = {
    "kitti": lambda folder, options: KittiWriter(folder, options.camera),
    "kitti-tracking": lambda folder, options: KittiTrackingWriter(folder, options.camera),
    "nuscenes": lambda folder, _: NuScenesWriter(folder),
    "openlabel": lambda folder, _: OpenLabelWriter(folder),
}
"""What writes each format."""
