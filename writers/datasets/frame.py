"""What a data set is made of: scenes of frames with a cloud, images and boxes; and what writes one."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F32, F64, I32, I64, U8, Table, check_array
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.rig import CameraSensor, Rig

JPEG_QUALITY = 95


@dataclass(frozen=True, slots=True, eq=False)
class DatasetBoxes(Table):
    """N boxes of a frame in the site frame.

    Attributes:
        names: (N,) str, in a writer's own words, or those of the settings.
        centers: (N, 3) float64, box centre x, y, z in metres.
        sizes: (N, 3) float64, length, width, height in metres.
        yaws: (N,) float64, radians about +z in (-pi, pi].
        scores: (N,) float32 in [0, 1]; 1 of true objects.
        tracks: (N,) int64, the same for the same object in all frames; -1 where there is none.
        velocities: (N, 2) float64, over the ground, along x and y, m/s; NaN where it is not known.
        point_counts: (N,) int32, lidar points in the box; -1 where nobody counted.
    """

    names: npt.NDArray[np.str_]
    centers: F64
    sizes: F64
    yaws: F64
    scores: F32
    tracks: I64
    velocities: F64
    point_counts: I32

    def __post_init__(self) -> None:
        n = len(self.names)
        check_array("centers", self.centers, (n, 3), np.float64)
        check_array("sizes", self.sizes, (n, 3), np.float64)
        check_array("yaws", self.yaws, (n,), np.float64)
        check_array("scores", self.scores, (n,), np.float32)
        check_array("tracks", self.tracks, (n,), np.int64)
        check_array("velocities", self.velocities, (n, 2), np.float64)
        check_array("point_counts", self.point_counts, (n,), np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class DatasetScene:
    """What the frames of one result have in common.

    Attributes:
        name: Of the result, without ending.
        origin: Text that no other result has, for identifiers.
        rig: Its sensors.
        cameras: Those whose images it has.
        T_site_cloud: (4, 4) float64, the frame of the clouds: of the only lidar, else the site frame.
        cloud_frame_id: Name of that frame.
    """

    name: str
    origin: str
    rig: Rig
    cameras: tuple[CameraSensor, ...]
    T_site_cloud: F64
    cloud_frame_id: str


@dataclass(frozen=True, slots=True, eq=False)
class DatasetImage:
    """One image.

    Attributes:
        stamp_ns: Its time.
        rgb: (H, W, 3) uint8, red first, without distortion.
        T_fixed_site: (4, 4) float64, as of `DatasetFrame`, at its time.
    """

    stamp_ns: int
    rgb: U8
    T_fixed_site: F64 | None


@dataclass(frozen=True, slots=True, eq=False)
class DatasetFrame:
    """One frame.

    Attributes:
        index: Its number in the result, from 0.
        stamp_ns: Its time.
        T_fixed_site: (4, 4) float64, where the site frame is in a frame that does not move; None if not known.
        cloud: The points in the scene's frame of clouds, intensity from 0 to 1; None without.
        images: By camera.
        objects: What lidcam found.
        truth: The true objects; None if they are not known.
    """

    index: int
    stamp_ns: int
    T_fixed_site: F64 | None
    cloud: PointCloud | None
    images: Mapping[str, DatasetImage]
    objects: DatasetBoxes
    truth: DatasetBoxes | None


class DatasetWriter(Protocol):
    """Writes scenes into a folder.

    Attributes:
        names: Name of a class in this format, by words for it in lower case.
        left_out: How many objects and frames could not be written, by reason.
        remarks: What the user should know, a line each.
    """

    names: Mapping[str, str]
    left_out: Counter[str]
    remarks: list[str]

    def begin(self, scene: DatasetScene) -> None:
        """Begin a scene, when the one before has ended.

        Raises:
            OutputError: the format cannot have it.
        """

    def add(self, frame: DatasetFrame) -> None:
        """Write the next frame of the scene."""

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
    """Write an image in the format that its ending names.

    Raises:
        OSError: it cannot be written.
    """
    quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if path.suffix == ".jpg" else []
    ok, data = cv2.imencode(path.suffix, rgb[..., ::-1], quality)
    if not ok:
        raise OutputError(f"{path}: an image of {rgb.shape[1]} x {rgb.shape[0]} px cannot be written as {path.suffix}")
    path.write_bytes(data.tobytes())
