"""Parts of a data set: scenes of frames with a cloud, images and boxes; and the interface of its writers."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np

from lidcam.pipeline.core.arrays import F32, F64, I32, I64, U8, CheckedTable, Names
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.rig import CameraSensor, Rig

JPEG_QUALITY = 95


@dataclass(frozen=True, slots=True, eq=False)
class DatasetBoxes(CheckedTable):
    """N boxes of a frame in the site frame."""

    ROWS: ClassVar = {"centers": (3,), "sizes": (3,), "velocities": (2,)}

    names: Names  # (N,) str, in a writer's own words, or those of the settings
    centers: F64  # (N, 3) float64, box centre x, y, z in metres
    sizes: F64  # (N, 3) float64, length, width, height in metres
    yaws: F64  # (N,) float64, radians about +z in (-pi, pi]
    scores: F32  # (N,) float32 in [0, 1]; 1 of true objects
    tracks: I64  # (N,) int64, the same for the same object in all frames; -1 where there is none
    velocities: F64  # (N, 2) float64, over the ground, along x and y, m/s; NaN where it is not known
    point_counts: I32  # (N,) int32, lidar points in the box; -1 where nobody counted


@dataclass(frozen=True, slots=True, eq=False)
class DatasetScene:
    """The common part of the frames of one result."""

    name: str  # Of the result, without ending
    origin: str  # Text that no other result has, for identifiers
    rig: Rig  # Its sensors
    cameras: tuple[CameraSensor, ...]  # Those whose images it has
    T_site_cloud: F64  # (4, 4) float64, the frame of the clouds: of the only lidar, else the site frame
    cloud_frame_id: str  # Name of that frame


@dataclass(frozen=True, slots=True, eq=False)
class DatasetImage:
    """One image."""

    stamp_ns: int  # Its time
    rgb: U8  # (H, W, 3) uint8, red first, without distortion
    T_fixed_site: F64 | None  # (4, 4) float64, as of `DatasetFrame`, at its time


@dataclass(frozen=True, slots=True, eq=False)
class DatasetFrame:
    """One frame."""

    index: int  # Its number in the result, from 0
    stamp_ns: int  # Its time
    T_fixed_site: F64 | None  # (4, 4) float64, where the site frame is in a frame that does not move; None if not known
    cloud: PointCloud | None  # The points in the scene's frame of clouds, intensity from 0 to 1; None without
    images: Mapping[str, DatasetImage]  # By camera
    objects: DatasetBoxes  # What lidcam found
    truth: DatasetBoxes | None  # The true objects; None if they are not known


class FolderWriter:
    """Writes a data set into a new folder, of one camera if one is wanted.

    Attributes:
        written: How many `frames`, `images` and `boxes` were written; boxes are those of the labels.
        left_out: How many frames, images and boxes could not be written, by reason.
        remarks: What the user should know, a line each.
    """

    def __init__(self, folder: Path, camera: str = "") -> None:
        self.written, self.left_out, self.remarks = Counter[str](), Counter[str](), list[str]()
        self._folder, self._wanted = folder, camera

    def _file(self, *parts: str) -> Path:
        """A file below the folder; the folders between are made."""
        path = self._folder.joinpath(*parts)
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


class DatasetWriter(FolderWriter, ABC):
    """Writes scenes."""

    names: Mapping[str, str]  # Name of a class in this format, by words for it in lower case; empty: as in the settings

    @abstractmethod
    def begin(self, scene: DatasetScene) -> None:
        """Begin a scene, when the one before has ended.

        Raises:
            OutputError: the format cannot have it.
        """

    @abstractmethod
    def add_frame(self, frame: DatasetFrame) -> None:
        """Write the next frame of the scene."""

    @abstractmethod
    def finish(self) -> None:
        """Write what stands behind all scenes."""


def pinhole(model: CameraModel) -> CameraModel:
    """The same camera with a lens that does not distort."""
    return replace(model, model="plumb_bob", distortion=np.zeros(5))


def undistorted(rgb: U8, model: CameraModel) -> U8:
    """The image that `pinhole` of a camera would have seen; black where the camera saw nothing."""
    if model.is_straight:
        return rgb
    if model.model == "equidistant":
        coefficients = model.coefficients[:4]
        return np.asarray(cv2.fisheye.undistortImage(rgb, model.K, coefficients, Knew=model.K), np.uint8)
    return np.asarray(cv2.undistort(rgb, model.K, model.coefficients), np.uint8)


def write_image(path: Path, rgb: U8) -> None:
    """Write an image in the format that its ending names."""
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if path.suffix == ".jpg" else []
    ok, data = cv2.imencode(path.suffix, rgb[..., ::-1], quality)
    if not ok:
        raise OutputError(f"{path}: an image of {rgb.shape[1]} x {rgb.shape[0]} px cannot be written as {path.suffix}")
    path.write_bytes(data.tobytes())
