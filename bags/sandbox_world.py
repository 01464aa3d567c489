"""The sandbox of the sample recording: a table with roads, two cars, three lidars, eight cameras; about 1:14.

Places and sizes are those of the original's site; what it does not say (heights of the masts, walls, camera 12) is
chosen here. The original's combined cloud has its origin above the table; `LIDAR_BASE_HEIGHT_M` puts the third lidar
right above the four cameras that share its mast.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from bags.raycast import Box
from pipeline.camera import CameraModel
from pipeline.geometry import Transform

__all__ = [
    "CAMERAS",
    "CAR_SIZE_M",
    "LIDARS",
    "STATIC_BOXES",
    "TABLE",
    "CarPath",
    "camera_model",
    "car_boxes",
    "ground_rgb",
]

F64 = npt.NDArray[np.float64]

SITE_FRAME = "site"
LIDAR_BASE_HEIGHT_M = 0.25
TABLE = (-2.0, 2.0, -5.0, 2.9)  # x from, x to, y from, y to
CAR_SIZE_M = (0.33, 0.22, 0.21)
CAR_CENTER_Z_M = 0.112
WIDTH_PX, HEIGHT_PX = 640, 480
FOCAL_PX, CENTER_PX = 504.78216005824515, (320.5, 240.5)

# name: offset of the original's combiner, then roll, pitch, yaw in degrees (the third lidar hangs a little askew)
LIDARS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "velodyne1": ((-0.55740706, 1.25432157, 0.006), (0.0, 0.0, 0.0)),
    "velodyne2": ((0.43254243, 0.26437207, 0.006), (0.0, 0.0, 120.0)),
    "velodyne3": ((9.74248361e-04, -0.989292350, 0.191780397), (0.5, -1.0, -90.0)),
}

# name: place in the site frame, viewing direction in the plane (degrees from +x), and downward tilt
CAMERAS: dict[str, tuple[tuple[float, float, float], float, float]] = {
    "11": ((-0.143, 0.371, 0.393), 90.0, 18.0),
    "12": ((0.05, 0.70, 0.393), -90.0, 18.0),
    "13": ((0.198, 0.549, 0.401), 180.0, 18.0),
    "14": ((-0.291, 0.856, 0.439), 0.0, 18.0),
    "41": ((0.0, -1.109, 0.335), -90.0, 14.0),
    "42": ((0.094, -1.0, 0.335), 0.0, 14.0),
    "43": ((0.0, -0.906, 0.335), 90.0, 14.0),
    "44": ((-0.094, -1.0, 0.335), 180.0, 14.0),
}

_WALL, _POLE, _BLOCK = (0.55, 0.42, 0.33), (0.25, 0.25, 0.28), (0.62, 0.52, 0.36)
STATIC_BOXES: tuple[Box, ...] = (
    Box((-1.98, -1.05, 0.06), (0.04, 7.9, 0.12), rgb=_WALL),
    Box((1.98, -1.05, 0.06), (0.04, 7.9, 0.12), rgb=_WALL),
    Box((0.0, -4.98, 0.06), (4.0, 0.04, 0.12), rgb=_WALL),
    Box((0.0, 2.88, 0.06), (4.0, 0.04, 0.12), rgb=_WALL),
    Box((1.30, 2.40, 0.22), (0.8, 0.6, 0.44), rgb=_BLOCK),
    Box((-1.35, 2.50, 0.18), (0.7, 0.5, 0.36), 0.1, rgb=(0.36, 0.5, 0.58)),
    Box((1.5, -0.6, 0.20), (0.6, 0.7, 0.40), rgb=(0.58, 0.36, 0.36)),
    Box((-1.55, -1.2, 0.20), (0.6, 0.6, 0.40), rgb=_BLOCK),
    Box((-0.55740706, 1.25432157, 0.10), (0.03, 0.03, 0.20), rgb=_POLE),
    Box((0.43254243, 0.26437207, 0.10), (0.03, 0.03, 0.20), rgb=_POLE),
    Box((0.0, -3.0, 0.025), (0.3, 0.3, 0.05), 0.5, rgb=(0.2, 0.5, 0.25)),
)


@dataclass(frozen=True, slots=True)
class CarPath:
    """How one car moves: straight on, or round a circle.

    Attributes:
        start: x, y and yaw at time 0.
        speed_m_s: Along the yaw.
        turn_rad_s: Change of yaw; 0 goes straight on.
        rgb: Colour.
    """

    start: tuple[float, float, float]
    speed_m_s: float
    turn_rad_s: float
    rgb: tuple[float, float, float]

    def pose(self, seconds: npt.NDArray[np.floating] | float) -> tuple[F64, F64]:
        """Centre (..., 3) and yaw (...) at the given times."""
        time = np.asarray(seconds, np.float64)
        x, y, yaw0 = self.start
        yaw = yaw0 + self.turn_rad_s * time
        if self.turn_rad_s == 0.0:
            x_now, y_now = x + self.speed_m_s * time * np.cos(yaw0), y + self.speed_m_s * time * np.sin(yaw0)
        else:
            radius = self.speed_m_s / self.turn_rad_s
            x_now, y_now = x + radius * (np.sin(yaw) - np.sin(yaw0)), y - radius * (np.cos(yaw) - np.cos(yaw0))
        return np.stack([x_now, y_now, np.full_like(time, CAR_CENTER_Z_M)], -1), yaw


CARS: dict[str, CarPath] = {
    "car1": CarPath((-1.45, 1.85, 0.0), 0.5, 0.0, (0.75, 0.10, 0.10)),
    "car2": CarPath((0.95, -3.0, np.pi / 2), 0.4, 0.4 / 0.95, (0.10, 0.25, 0.70)),
}


def car_boxes(path: CarPath) -> tuple[tuple[F64, F64, tuple[float, float, float]], ...]:
    """Parts of a car: offset of the centre and size in its own frame, and colour; together they fill `CAR_SIZE_M`."""
    length, width, height = CAR_SIZE_M
    body, cabin = 0.6 * height, 0.4 * height
    dark = (0.55 * path.rgb[0] + 0.05, 0.55 * path.rgb[1] + 0.05, 0.55 * path.rgb[2] + 0.08)
    return (
        (np.array([0.0, 0.0, -cabin / 2]), np.array([length, width, body]), path.rgb),
        (np.array([-0.04 * length, 0.0, body / 2]), np.array([0.62 * length, 0.94 * width, cabin]), dark),
    )


def lidar_pose(name: str) -> Transform:
    """T_site_lidar."""
    offset, rpy_deg = LIDARS[name]
    quaternion = Rotation.from_euler("xyz", rpy_deg, degrees=True).as_quat()
    place = np.array([offset[0], offset[1], offset[2] + LIDAR_BASE_HEIGHT_M])
    return Transform.from_quaternion(SITE_FRAME, name, place, quaternion)


def camera_pose(name: str) -> Transform:
    """T_site_camera; the camera frame is optical (z forward, x right, y down)."""
    place, heading_deg, tilt_deg = CAMERAS[name]
    heading, tilt = np.deg2rad(heading_deg), np.deg2rad(tilt_deg)
    forward = np.array([np.cos(heading) * np.cos(tilt), np.sin(heading) * np.cos(tilt), -np.sin(tilt)])
    right = np.array([np.sin(heading), -np.cos(heading), 0.0])
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], 1)
    matrix[:3, 3] = place
    return Transform(SITE_FRAME, f"camera_{name}_optical", matrix)


def camera_model(name: str) -> CameraModel:
    """Intrinsics: those of the original, without distortion."""
    k = np.array([[FOCAL_PX, 0, CENTER_PX[0]], [0, FOCAL_PX, CENTER_PX[1]], [0, 0, 1.0]])
    return CameraModel(f"camera_{name}_optical", WIDTH_PX, HEIGHT_PX, k, "plumb_bob", np.zeros(5))


def ground_rgb(xy: F64) -> F64:
    """Colour of the table at points (N, 2): an intersection at y >= 0 and a roundabout at y < 0."""
    x, y = xy[:, 0], xy[:, 1]
    radius = np.hypot(x, y + 3.0)
    crossing = (np.abs(x) < 0.45) & (y > -1.9) | (np.abs(y - 1.6) < 0.5) & (y > 0)
    road = crossing | (np.abs(radius - 0.95) < 0.4)
    dash = (np.floor(6 * y) % 2 == 0) & (np.abs(x) < 0.015) & (np.abs(y - 1.6) > 0.5)
    dash |= (np.floor(6 * x) % 2 == 0) & (np.abs(y - 1.6) < 0.015) & (np.abs(x) > 0.45)
    dash |= (np.abs(radius - 0.95) < 0.012) & (np.floor(12 * np.arctan2(y + 3, x)) % 2 == 0)
    rgb = np.tile(np.array([0.45, 0.55, 0.35]), (len(xy), 1))
    rgb[road] = (0.33, 0.33, 0.35)
    rgb[road & dash & ~((np.abs(x) < 0.45) & (np.abs(y - 1.6) < 0.5))] = (0.92, 0.92, 0.88)
    return rgb
