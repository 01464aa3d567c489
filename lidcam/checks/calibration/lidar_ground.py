"""Lidars whose extrinsics look inverted or tilted, by the ground below them.

A pose that was stored the other way round puts a lidar as far below the site as it is above it. So the
height of the ground below each lidar is compared with the rig's ground height, else with that of most other lidars.

The mount of a lidar that looks aside is easily forgotten: then its ground stands askew in the site, where that of
another lidar is level. A wrong heading leaves the ground as it is, and is not told here.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from lidcam.pipeline.core.clouds import Plane, PointCloud
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import LidarSensor, Rig
from lidcam.pipeline.core.settings.combine import CombineConfig
from lidcam.pipeline.filters.ground import find_ground
from lidcam.run.warning import RunWarning

FAR = 3.0
"""Ground that is this many tolerances (`combine.ground.height_tolerance_m`) away is somewhere else."""

MAX_TILT_DEG = 65.0
"""A floor that is steeper in the site is a wall."""


def inverted_lidars(rig: Rig, config: CombineConfig, clouds: Mapping[str, PointCloud]) -> tuple[RunWarning, ...]:
    """Warnings of lidars whose extrinsics look inverted, from a cloud of each by name, in the frame of its lidar."""
    lidars = [lidar for lidar in rig.lidars if lidar.name in clouds]
    if len(lidars) < 2 and rig.ground_height_m is None:
        return ()
    given = {lidar.name: _ground_m(lidar.T_site_lidar, clouds[lidar.name], config) for lidar in lidars}
    tolerance_m = config.ground.height_tolerance_m
    found: dict[str, tuple[float, float, float]] = {}
    for lidar in lidars:
        others_m = [height_m for name, height_m in given.items() if name != lidar.name and height_m is not None]
        known_m = rig.ground_height_m
        expected_m, height_m = _expected_m(others_m, tolerance_m) if known_m is None else known_m, given[lidar.name]
        if expected_m is None or (height_m is not None and abs(height_m - expected_m) < FAR * tolerance_m):
            continue
        inverse_m = _ground_m(_as_inverse(lidar), clouds[lidar.name], config)
        if inverse_m is not None and abs(inverse_m - expected_m) <= tolerance_m:
            found[lidar.name] = (np.nan if height_m is None else height_m, inverse_m, expected_m)
    return tuple(_warning(name, *heights, doubtful=[*found]) for name, heights in found.items())


def tilted_lidars(rig: Rig, config: CombineConfig, clouds: Mapping[str, PointCloud]) -> tuple[RunWarning, ...]:
    """Warnings of lidars whose ground stands askew though that of another lidar is level; arguments as above."""
    lidars = [lidar for lidar in rig.lidars if lidar.name in clouds]
    level = [lidar.name for lidar in lidars if _ground(lidar.T_site_lidar, clouds[lidar.name], config) is not None]
    steep = config.model_copy(update={"ground": config.ground.model_copy(update={"max_tilt_deg": MAX_TILT_DEG})})
    found = []
    for lidar in lidars if level else ():
        plane = None if lidar.name in level else _ground(lidar.T_site_lidar, clouds[lidar.name], steep)
        if plane is not None:
            tilt_deg = np.degrees(np.arccos(np.clip(plane.normal[2], -1.0, 1.0)))
            found.append(
                RunWarning(
                    lidar.name,
                    f"its ground is tilted by {tilt_deg:.0f} degrees in the site, and that of {level[0]} is level",
                    "check the roll and pitch of its extrinsics: how it is mounted may be missing in them",
                )
            )
    return tuple(found)


def _warning(name: str, height_m: float, inverse_m: float, expected_m: float, *, doubtful: list[str]) -> RunWarning:
    there = "is not to be found" if np.isnan(height_m) else f"lies at z = {_rounded(height_m)} m"
    others = [other for other in doubtful if other != name]
    either = f" (or those of {', '.join(others)}: they contradict each other)" if others else ""
    return RunWarning(
        name,
        f"its ground {there}, and with the inverse of its extrinsics at {_rounded(inverse_m)} m, where it belongs "
        f"({_rounded(expected_m)} m)",
        f"they look inverted{either}: T_site_lidar maps points of the lidar to the site",
    )


def _rounded(height_m: float) -> str:
    return f"{round(height_m, 2) + 0.0:.2f}"  # never -0.00


def _expected_m(others_m: Sequence[float], tolerance_m: float) -> float | None:
    """The height that most of the other lidars have in common; None if there is none."""
    heights_m = np.array(others_m, np.float64)
    agreeing = (np.abs(heights_m[:, None] - heights_m) <= tolerance_m).sum(1)
    if not len(heights_m) or 2 * agreeing.max() <= len(heights_m):
        return None
    return float(heights_m[agreeing.argmax()])


def _as_inverse(lidar: LidarSensor) -> Transform:
    T_lidar_site = lidar.T_site_lidar.inverse()
    return Transform(T_lidar_site.src, T_lidar_site.dst, T_lidar_site.matrix)


def _ground_m(T_site_lidar: Transform, cloud: PointCloud, config: CombineConfig) -> float | None:
    """Height of the ground below a lidar in the site frame; None if there is none."""
    plane = _ground(T_site_lidar, cloud, config)
    return None if plane is None else float(plane.height_m(T_site_lidar.translation[:2]))


def _ground(T_site_lidar: Transform, cloud: PointCloud, config: CombineConfig) -> Plane | None:
    """The ground that a lidar sees, in the site frame; None if there is none."""
    range_m = np.sqrt(np.einsum("nj,nj->n", cloud.xyz, cloud.xyz))
    near = cloud.xyz[(range_m > 0) & (range_m >= config.min_range_m) & (range_m <= config.max_range_m)]
    return find_ground(T_site_lidar.apply(near), T_site_lidar.translation[None], config=config.ground)
