"""Camera intrinsics: projection of points and boxes into an image, with lens distortion.

Distortion models as defined by ROS and OpenCV (docs.opencv.org, "Camera Calibration and 3D Reconstruction" and
"Fisheye camera model"): `plumb_bob` k1 k2 p1 p2 k3; `rational_polynomial` k1 k2 p1 p2 k3 k4 k5 k6; `equidistant`
(also `kannala_brandt`, `fisheye`) k1 k2 k3 k4. In lidcam's boxes, pixel (0, 0) is the top left corner of the top left
pixel; the principal point of a calibration counts from pixel centres, as in OpenCV and ROS. So half a pixel is added on
projection.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Self

import numpy as np
import numpy.typing as npt

from lidcam.pipeline.core.arrays import F32, F64, Bools
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.geometry.box_edges import edge_samples
from lidcam.pipeline.native.kernels import pixels_of_points

DistortionModel = Literal["plumb_bob", "rational_polynomial", "equidistant"]

COEFFICIENTS: Mapping[str, int] = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
"""Number of coefficients by distortion model."""

BORDER_PX = 2.0
"""An edge this near to the border of its image may be the border's own: the object may go on beyond it."""

NEAR_M = 0.01
"""Least depth of a point that is projected; edges of boxes are cut there."""


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Intrinsics of one camera."""

    frame_id: str  # Optical frame (z forward, x right, y down)
    width_px: int  # Image width
    height_px: int  # Image height
    K: F64  # (3, 3) float64 camera matrix, pixels
    model: DistortionModel  # Distortion model
    distortion: F64  # (k,) float64 coefficients; missing ones are zero

    def __post_init__(self) -> None:
        if self.model not in COEFFICIENTS:
            raise CalibrationError(f"distortion model {self.model!r} is not one of {', '.join(COEFFICIENTS)}")
        if self.K.shape != (3, 3) or not np.isfinite(self.K).all():
            raise CalibrationError("camera matrix K: expected nine finite numbers")
        if np.any(self.K[[1, 2, 2], [0, 0, 1]]) or self.K[2, 2] != 1:
            raise CalibrationError(
                f"camera matrix K: expected zeros below the diagonal and 1 at its end, got {self.K.tolist()}"
            )
        if self.width_px <= 0 or self.height_px <= 0:
            raise CalibrationError(f"image size {self.width_px} x {self.height_px} px: expected positive numbers")
        focal = (float(self.K[0, 0]), float(self.K[1, 1]))
        # No camera has a view of over 178 or under 0.3 degrees; zero means "not calibrated" (sensor_msgs/CameraInfo).
        if not all(0.01 < f / self.width_px < 200 for f in focal):
            raise CalibrationError(
                f"focal length {focal[0]:g}, {focal[1]:g} px is impossible for an image {self.width_px} px wide"
            )
        if not np.isfinite(self.distortion).all():
            raise CalibrationError("distortion coefficients: expected finite numbers")
        count = COEFFICIENTS[self.model]
        if np.any(self.distortion[count:]):
            raise CalibrationError(
                f"distortion model {self.model} has {count} coefficients, found {len(self.distortion)}"
            )
        self.K.flags.writeable = False
        self.distortion.flags.writeable = False

    def zoomed(self, factor: float) -> Self:
        """The same camera with other focal lengths."""
        return self if factor == 1.0 else replace(self, K=self.K * [[factor, factor, 1], [1, factor, 1], [1, 1, 1]])

    @cached_property
    def coefficients(self) -> F64:
        """(8,) float64, the distortion coefficients with zeros for missing ones."""
        return np.concatenate([self.distortion[:8], np.zeros(8)])[:8]

    @cached_property
    def is_straight(self) -> bool:
        """Whether the image shows straight lines straight."""
        return self.model != "equidistant" and not self.coefficients.any()

    @cached_property
    def radius_limit(self) -> float:
        """Largest undistorted radius (tangent of the angle; equidistant: the angle) at which the model is one-to-one.

        Beyond it the polynomial folds back, and points far outside the view would land in the image.
        """
        radius = np.linspace(0.0, np.pi if self.model == "equidistant" else 20.0, 4001)
        grown = radius * self._radial(radius**2)
        falling = np.flatnonzero(np.diff(grown) <= 0)
        return float(radius[falling[0]]) if len(falling) else np.inf

    @cached_property
    def view_angle_rad(self) -> float:
        """Half the angle of a cone about the optical axis that holds all that the image may show, and some more."""
        wide = np.pi if self.model == "equidistant" else 20.0
        radius = np.linspace(0.0, min(wide, self.radius_limit), 4001)
        tangential = 0.0 if self.model == "equidistant" else 3 * float(np.abs(self.coefficients[2:4]).sum())
        least = radius * self._radial(radius**2) - tangential * radius**2
        corners = np.array([[0, 0], [self.width_px, 0], [0, self.height_px], [self.width_px, self.height_px]])
        offsets = (corners - 0.5 - self.K[:2, 2]) / np.diag(self.K)[:2]
        offsets[:, 0] -= self.K[0, 1] / self.K[0, 0] * offsets[:, 1]
        inside = np.flatnonzero(least < np.sqrt((offsets**2).sum(1)).max())
        widest = float(radius[min(inside[-1] + 1, len(radius) - 1)])
        if inside[-1] == len(radius) - 1 and widest == wide:
            return np.pi
        return widest if self.model == "equidistant" else float(np.arctan(widest))

    def _radial(self, r2: F64) -> F64:
        k = self.coefficients
        if self.model == "equidistant":
            return np.asarray(1 + r2 * (k[0] + r2 * (k[1] + r2 * (k[2] + r2 * k[3]))))
        top = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
        return np.asarray(top / (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))))

    def project(self, points_camera: npt.NDArray[np.floating]) -> tuple[F64, Bools]:
        """Pixels of points (..., 3) in the optical frame, metres, and whether they are valid.

        Returns (..., 2) pixels, and (...) whether each point is in front of the camera and within the range of the lens
        model; the other pixels are meaningless. Points outside the image are kept.
        """
        points = np.ascontiguousarray(points_camera, np.float64)
        is_equidistant, limit = np.array([self.model == "equidistant"]), np.array([self.radius_limit])
        pixels, valid = pixels_of_points(
            points.reshape(1, -1, 3), np.array([self.K]), self.coefficients[None], is_equidistant, limit
        )
        return pixels.reshape(*points.shape[:-1], 2), valid.reshape(points.shape[:-1])

    def project_boxes(self, corners_camera: F64) -> F32:
        """(N, 4) smallest upright rectangles around what the image shows of projected boxes; NaN where that is nothing.

        Left, top, right, bottom in pixels. Boxes have corners (N, 8, 3) in the order of `geometry.box_corners`, metres
        in the optical frame; those that reach behind the camera are cut at `NEAR_M` first.
        """
        found = np.full((len(corners_camera), 4), np.nan, np.float32)
        ahead = np.flatnonzero((corners_camera[..., 2] >= NEAR_M).any(1))
        points, is_ahead = edge_samples(corners_camera[ahead], NEAR_M)
        pixels, valid = self.project(points)
        sizes = np.array([[self.width_px, self.height_px]], np.float64)
        found[ahead] = rectangles_around(pixels, valid & is_ahead, sizes)
        return found


def rectangles_around(pixels: F64, valid: Bools, image_sizes: F64) -> F64:
    """(N, 4) upright rectangles around what images show of areas without dents; NaN where nothing is.

    An image shows the corners of an area that lie in it, and of its own border what lies between the lines that cross
    it: of a car that the border cuts, a roof that would be beside the image counts for nothing.

    Args:
        pixels: (N, L, S, 2) points along L lines around or within each area.
        valid: (N, L, S) which of them count.
        image_sizes: (N, 2) widths and heights of the images, or (1, 2) of all.
    """
    by_axis = np.ascontiguousarray(pixels.T)  # (2, S, L, N): numpy is fastest along many areas
    low, high = np.where(valid.T, by_axis, np.inf).min((1, 2)).T, np.where(valid.T, by_axis, -np.inf).max((1, 2)).T
    may_show = ((low <= image_sizes) & (high >= 0)).all(1)
    found = np.where(may_show[:, None], np.concatenate([low, high], 1), np.nan)
    cut = np.flatnonzero(((found[:, :2] < 0) | (found[:, 2:] > image_sizes)).any(1))
    if len(cut):
        found[cut] = _cut_rectangles(pixels[cut], valid[cut], np.broadcast_to(image_sizes, (len(found), 2))[cut])
    is_seen = (found[:, 2] > found[:, 0]) & (found[:, 3] > found[:, 1])
    return np.where(is_seen[:, None], found, np.nan)


def _cut_rectangles(pixels: F64, valid: Bools, image_sizes: F64) -> F64:
    """(N, 4) rectangles of `rectangles_around` of areas that borders of their images may cut."""
    is_inside = valid & ((pixels >= 0) & (pixels <= image_sizes[:, None, None])).all(3)
    inside = np.where(is_inside[..., None], pixels, np.nan)
    parts = [np.stack([np.fmin.reduce(inside, (1, 2)), np.fmax.reduce(inside, (1, 2))], 1)]
    for axis in (0, 1):
        for border in (np.zeros(1), image_sizes[:, axis]):
            parts.append(_between_crossings(pixels, valid, axis, border, image_sizes[:, 1 - axis]))
    shown = np.concatenate(parts, 1)
    return np.concatenate([np.fmin.reduce(shown, 1), np.fmax.reduce(shown, 1)], 1)


def _between_crossings(pixels: F64, valid: Bools, axis: int, border: F64, length: F64) -> F64:
    """(N, 2, 2) ends of the part of a border that lies in an area; NaN of none. See `rectangles_around`.

    The border is where the coordinate `axis` is `border`, and the other one is between 0 and `length`; (N,) or (1,).
    """
    beyond, place = pixels[..., axis] - border[:, None, None], pixels[..., 1 - axis]
    crosses = valid[..., :-1] & valid[..., 1:] & ((beyond[..., :-1] < 0) != (beyond[..., 1:] < 0))
    share = beyond[..., :-1] / np.where(crosses, -np.diff(beyond), 1.0)
    crossings = np.where(crosses, place[..., :-1] + share * np.diff(place), np.nan)
    first, last = np.fmin.reduce(crossings, (1, 2)).clip(0), np.fmax.reduce(crossings, (1, 2)).clip(None, length)
    ends = np.full((len(pixels), 2, 2), np.nan)
    ends[..., axis], ends[..., 1 - axis] = border[:, None], np.stack([first, last], 1)
    return np.where((first < last)[:, None, None], ends, np.nan)
