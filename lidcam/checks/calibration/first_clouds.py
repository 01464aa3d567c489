"""Calibration that the first cloud of each lidar contradicts: stamps, lidar poses, cameras without points.

A pose stored the wrong way round puts a lidar as far below the site as it is above it, so the height of the ground
below each lidar is compared with the rig's ground height, else with that of most other lidars. If the mount of a lidar
that looks aside was forgotten, its ground is tilted in the site while that of another lidar is level; if that of one
that hangs upside down was, its ground is above it. A wrong heading leaves the ground as it is and is not found here.

No cloud is recorded before its last point was measured: then its stamp is not that from which its points' times count.
Log times before the stamps, or equal to them, are those of a converter or of another clock, and tell nothing.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import Plane, PointCloud
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.combine import CombineConfig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.filters.ground import find_ground
from lidcam.readers.rig.calibration import MIN_UP
from lidcam.readers.streams.decoders import CloudDecoder
from lidcam.run.warning import RunWarning

MAX_POINTS = 200_000
"""Maximum number of points kept per lidar, evenly thinned: the clouds are held for the whole run."""

MAX_PROJECTED_POINTS = 3000
"""Maximum number of points per lidar that are projected into the images."""

MIN_PROJECTED_POINTS = 500
"""Minimum number of projected points before a camera without any is reported."""

MIN_GROUND_OFFSET = 3.0
"""Minimum height offset, in units of `combine.ground.height_tolerance_m`, before ground counts as misplaced."""

MAX_TILT_DEG = 65.0
"""Maximum tilt of a floor in the site; anything steeper is a wall."""

MAX_EARLY_NS = 10_000_000
"""Longest time by which a cloud may be recorded before its last point was measured, nanoseconds: clocks differ."""

TURNED_OVER = np.diag([1.0, -1.0, -1.0, 1.0])
"""Half a turn about x, which a lidar that hangs upside down has."""


class FirstClouds:
    """The first cloud of each lidar, in the frame of the lidar, and the warnings that follow from them."""

    def __init__(self, rig: Rig, config: Config) -> None:
        self._rig, self._config = rig, config.combine
        self._decode = CloudDecoder(rig, config, on_bad="skip")
        self._missing = {lidar.topic: lidar for lidar in rig.lidars}
        self._clouds: dict[str, PointCloud] = {}
        self._early: list[RunWarning] = []

    def add_messages(self, messages: Iterable[RawMessage]) -> None:
        """Decode messages of lidars whose first cloud is still missing; others are ignored."""
        for message in messages:
            if message.topic in self._missing:
                bundle = SensorBundle(0, message.stamp_ns, message.log_time_ns, {message.topic: message})
                for name, cloud in self._decode(bundle).items():
                    if len(cloud):
                        stride = -(-len(cloud) // MAX_POINTS)
                        self._clouds[name] = cloud.select(np.arange(0, len(cloud), stride)) if stride > 1 else cloud
                        lidar = self._missing.pop(message.topic)
                        if warning := early_cloud(lidar, cloud, message.log_time_ns - message.stamp_ns):
                            self._early.append(warning)

    @property
    def lidar_warnings(self) -> tuple[RunWarning, ...]:
        """Warnings of lidars with wrong stamps, and of those whose extrinsics look inverted, else tilted."""
        arguments = self._rig, self._config, self._clouds
        return (*self._early, *(inverted_lidars(*arguments) or tilted_lidars(*arguments)))

    @property
    def camera_warnings(self) -> tuple[RunWarning, ...]:
        """Warnings of cameras without a lidar point in their images, once all lidars have a cloud."""
        if self._missing or not self._clouds:
            return ()
        poses = {lidar.name: lidar.T_site_lidar for lidar in self._rig.lidars}
        parts = [
            poses[name].apply(cloud.xyz[:: -(-len(cloud) // MAX_PROJECTED_POINTS)].astype(np.float64))
            for name, cloud in self._clouds.items()
        ]
        return cameras_without_points(self._rig, np.concatenate(parts))


def early_cloud(lidar: LidarSensor, cloud: PointCloud, delay_ns: int) -> RunWarning | None:
    """The warning of a lidar whose cloud was recorded, `delay_ns` after its stamp, before its last point was measured.

    A time offset in the rig is believed.
    """
    early_ns = int(cloud.time_offset_ns.max()) - delay_ns
    if delay_ns <= 0 or early_ns <= MAX_EARLY_NS or lidar.time_offset_ns:
        return None
    finding = f"its first cloud was recorded {early_ns / 1e6:.0f} ms before its last point was measured"
    remedy = "if its points' times do not count from its stamp, give the difference as time_offset_ms in a rig file"
    return RunWarning(lidar.name, finding, remedy)


def cameras_without_points(rig: Rig, xyz_site: F64) -> tuple[RunWarning, ...]:
    """Warnings of cameras into whose images none of the points (N, 3) falls."""
    if len(xyz_site) < MIN_PROJECTED_POINTS:
        return ()
    found = []
    for camera in rig.cameras:
        if _count_in_image(camera, camera.T_camera_site, xyz_site):
            continue
        finding = f"none of {len(xyz_site)} lidar points falls into its image"
        remedy = "check its extrinsics and the frame that they are given in"
        if camera.T_camera_site.matrix[2, 2] >= MIN_UP:
            finding += ", and it looks at the sky"
            remedy = "if its pose is that of its body (x forward), give that of its optical frame (z forward, x right)"
        elif inverse := _count_in_image(camera, _as_inverse(camera.T_camera_site), xyz_site):
            finding += f" ({inverse} do with the inverse of its extrinsics)"
            remedy += ", and whether T_camera_site (site to camera) and T_site_camera are mixed up"
        found.append(RunWarning(camera.name, finding, remedy))
    return tuple(found)


def _count_in_image(camera: CameraSensor, T_camera_site: Transform, xyz_site: F64) -> int:
    pixels, valid = camera.model.project(T_camera_site.apply(xyz_site))
    size = np.array([camera.model.width_px, camera.model.height_px])
    return int((valid & (pixels >= 0).all(-1) & (pixels < size).all(-1)).sum())


def _as_inverse(pose: Transform) -> Transform:
    """The pose as if its matrix had been stored the wrong way round."""
    return Transform(pose.dst, pose.src, pose.inverse().matrix)


def inverted_lidars(rig: Rig, config: CombineConfig, clouds: Mapping[str, PointCloud]) -> tuple[RunWarning, ...]:
    """Warnings of lidars whose extrinsics look inverted, from a cloud of each by name, in the frame of its lidar."""
    lidars = [lidar for lidar in rig.lidars if lidar.name in clouds]
    if len(lidars) < 2 and rig.ground_height_m is None:
        return ()
    heights_m = {lidar.name: _ground_height_m(lidar.T_site_lidar, clouds[lidar.name], config) for lidar in lidars}
    tolerance_m = config.ground.height_tolerance_m
    found: dict[str, tuple[float | None, float, float]] = {}
    for lidar in lidars:
        height_m, expected_m = heights_m[lidar.name], rig.ground_height_m
        if expected_m is None:
            others_m = [other_m for name, other_m in heights_m.items() if name != lidar.name and other_m is not None]
            expected_m = _majority_height_m(others_m, tolerance_m)
        if expected_m is None or (
            height_m is not None and abs(height_m - expected_m) < MIN_GROUND_OFFSET * tolerance_m
        ):
            continue
        inverse_m = _ground_height_m(_as_inverse(lidar.T_site_lidar), clouds[lidar.name], config)
        if inverse_m is not None and abs(inverse_m - expected_m) <= tolerance_m:
            found[lidar.name] = height_m, inverse_m, expected_m
    return tuple(_inverted_warning(name, *heights, [*found]) for name, heights in found.items())


def _inverted_warning(
    name: str, height_m: float | None, inverse_m: float, expected_m: float, inverted: Sequence[str]
) -> RunWarning:
    there = "is not to be found" if height_m is None else f"lies at z = {_rounded(height_m)} m"
    others = [other for other in inverted if other != name]
    either = f" (or those of {', '.join(others)}: they contradict each other)" if others else ""
    return RunWarning(
        name,
        f"its ground {there}, and with the inverse of its extrinsics at {_rounded(inverse_m)} m, where it belongs "
        f"({_rounded(expected_m)} m)",
        f"they look inverted{either}: T_site_lidar maps points of the lidar to the site",
    )


def tilted_lidars(rig: Rig, config: CombineConfig, clouds: Mapping[str, PointCloud]) -> tuple[RunWarning, ...]:
    """Warnings of lidars whose ground is above them, or tilted though that of another is level; arguments as above."""
    lidars = [lidar for lidar in rig.lidars if lidar.name in clouds]
    level = [lidar.name for lidar in lidars if _ground(lidar.T_site_lidar, clouds[lidar.name], config) is not None]
    steep = config.model_copy(update={"ground": config.ground.model_copy(update={"max_tilt_deg": MAX_TILT_DEG})})
    found = []
    for lidar in lidars:
        if lidar.name in level:
            continue
        pose, cloud = lidar.T_site_lidar, clouds[lidar.name]
        plane = _ground(pose, cloud, steep) if level else None
        if plane is not None:
            tilt_deg = np.degrees(np.arccos(np.clip(plane.normal[2], -1.0, 1.0)))
            finding = f"its ground is tilted by {tilt_deg:.0f} degrees in the site, and that of {level[0]} is level"
        elif _ground(replace(pose, matrix=pose.matrix @ TURNED_OVER), cloud, config) is not None:
            finding = "its ground is above it in the site"
        else:
            continue
        remedy = "check the roll and pitch of its extrinsics: how it is mounted may be missing in them"
        found.append(RunWarning(lidar.name, finding, remedy))
    return tuple(found)


def _rounded(height_m: float) -> str:
    return f"{round(height_m, 2) + 0.0:.2f}"  # never -0.00


def _majority_height_m(heights_m: Sequence[float], tolerance_m: float) -> float | None:
    """The height that most lidars have in common; None if there is none."""
    heights = np.array(heights_m, np.float64)
    agreeing = (np.abs(heights[:, None] - heights) <= tolerance_m).sum(1)
    if not len(heights) or 2 * agreeing.max() <= len(heights):
        return None
    return float(heights[agreeing.argmax()])


def _ground_height_m(T_site_lidar: Transform, cloud: PointCloud, config: CombineConfig) -> float | None:
    """Height of the ground below a lidar in the site frame; None if there is none."""
    plane = _ground(T_site_lidar, cloud, config)
    return None if plane is None else float(plane.height_m(T_site_lidar.translation[:2]))


def _ground(T_site_lidar: Transform, cloud: PointCloud, config: CombineConfig) -> Plane | None:
    """The ground that a lidar sees, in the site frame; None if there is none."""
    range_m = np.sqrt(np.einsum("nj,nj->n", cloud.xyz, cloud.xyz))
    near = cloud.xyz[(range_m > 0) & (range_m >= config.min_range_m) & (range_m <= config.max_range_m)]
    return find_ground(T_site_lidar.apply(near), T_site_lidar.translation[None], config=config.ground)
