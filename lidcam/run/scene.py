"""The scene of a recording by its first clouds: its size, the preset that suits it, a level frame for tilted lidars."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.clouds import CombinedCloud, Plane, PointCloud
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.rig import LidarSensor, Rig
from lidcam.pipeline.core.settings.combine import GroundConfig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.filters.ground import find_ground
from lidcam.pipeline.stages.odometry import MIN_MISFIT_RATIO, SAMPLE_POINTS, FindOdometry
from lidcam.readers.messages.tf import ODOMETRY
from lidcam.readers.recording import Recording
from lidcam.readers.rig.discovery import Discovery
from lidcam.readers.rig.lens import RIG_FILE
from lidcam.readers.rig.schema import Pose, RigFile
from lidcam.readers.streams.decoders import CloudDecoder
from lidcam.readers.streams.motion import FIXED_FRAMES, MotionBuffer, MotionSource, find_motion_source

CLOUDS = 3
"""Number of clouds taken of each lidar: the first sweep may be a part of one."""

MAX_WAIT_NS = 2_000_000_000
"""Longest wait for the other lidars, in log time after the first cloud."""

MAX_MESSAGES = 200
"""Most messages read where clouds cannot be decoded."""

MIDDLE = (5.0, 95.0)
"""Percentiles of a coordinate that bound the scene: a few far points do not make it larger."""

LAYER_SHARE = 0.005
"""Thickness of the ground as a share of the scene's diagonal: 5 cm for a table of 10 m."""
LAYER_M = (0.02, 0.2)
"""Limits of the thickness of the ground, metres."""

MAX_TILT_DEG = 30.0
"""Largest tilt of the ground in the site frame, which may be that of a tilted lidar."""

MODEL_LIDAR_M = 1.0
"""Largest height of the lidars of a model site above its ground, metres; full-size vehicles carry them higher."""

MODEL_EXTENT_M = 12.0
"""Largest length of the clouds of a model site, metres; in a street even a low lidar sees further."""

MAST_LIDAR_M = 3.0
"""Smallest height of lidars on masts, metres; of the vehicles only trucks are higher, which move."""

LOOKS = (0.0, 1 / 3, 2 / 3)
"""Times at which the clouds are looked at for motion and tilt, as shares of the recording: a truck may wait at its
beginning."""

MAX_ERROR_SHARE = 1 / 3
"""Maximum distance of a recorded motion from the one that clouds show, as a share of the longer one: worse odometry has
other axes, or counts in other units, or stands still."""

LOOK_CLOUDS, LOOK_STEP_NS = 5, 150_000_000
"""Number of these clouds, and the least time between two of them, nanoseconds."""


MIN_TILT_DEG = 6.0
"""Minimum tilt of the ground for which a level frame is made: roads have up to 4 degrees, and 6 cost no object."""

MAX_SPREAD_DEG = 2.0
"""Maximum angle between the ground at different times; a lidar that is carried by hand has no level frame."""

MIN_FLOOR_SHARE = 0.15
"""Minimum share of points on the ground above a lidar; in streets a third of all are, and on a roof few."""

TURNED_OVER = np.array([1.0, -1.0, -1.0])
"""Factors of coordinates that turn them over, about the x axis."""

SUFFIX = "_level"


@dataclass(frozen=True, slots=True)
class SceneSize:
    """The size of a scene."""

    # Length and width of the middle 90 % of the points along the axes of the site frame, the longer first
    extent_m: tuple[float, float]
    lidar_height_m: float | None  # Median height of the lidars above the ground; None where no ground was found


def measure_scene(recording: Recording, rig: Rig, config: Config) -> SceneSize | None:
    """The size of a recording's scene; None if its lidars have no points.

    Reads a few sweeps from the beginning of the recording, whatever part of it is processed.
    """
    xyz_site = _first_points(recording, rig, config)
    if not len(xyz_site):
        return None
    heights_m = _heights_m(xyz_site, rig)
    return SceneSize(_extent_m(xyz_site), None if heights_m is None else float(np.median(heights_m)))


def floor_of(xyz_site: F32, origins_site: F64) -> Plane | None:
    """The ground below lidars at origins (L, 3), tilted by up to `MAX_TILT_DEG`; None if there is none."""
    layer_m = LAYER_SHARE * float(np.hypot(*_extent_m(xyz_site)))
    ground = GroundConfig(distance_m=float(np.clip(layer_m, *LAYER_M)), max_tilt_deg=MAX_TILT_DEG)
    return find_ground(xyz_site, origins_site, config=ground)


def clouds_show_motion(recording: Recording, rig: Rig, config: Config) -> bool:
    """Whether the clouds of the first lidar show that the rig moves, at the beginning or later."""
    if not rig.lidars:
        return False
    return any(_seen_motion(recording, rig, config, begin_ns) is not None for begin_ns in looks(recording))


def looks(recording: Recording, start_ns: int | None = None, stop_ns: int | None = None) -> list[int]:
    """The log times at which the clouds are looked at, of a recording or of a part of it."""
    first_ns = recording.start_ns if start_ns is None else max(start_ns, recording.start_ns)
    last_ns = recording.end_ns if stop_ns is None else min(stop_ns, recording.end_ns)
    return sorted({first_ns + round(share * max(last_ns - first_ns, 0)) for share in LOOKS})


def find_motion(recording: Recording, config: Config, found: Discovery) -> tuple[MotionSource | None, Discovery]:
    """The source of the site frame's motion, and the rig with notes about odometry that is not used.

    Drivers publish zeros where nothing measures the motion. Odometry that the settings name is believed. Where there is
    none at all, that of other frames is named if the clouds show that the rig moves. Errors as of `find_motion_source`.
    """
    unused, site = list[str](), found.rig.site_frame
    source = find_motion_source(
        recording, found.rig, found.transforms, config, usual_delay_ns=found.usual_delay_ns, on_unused=unused.append
    )
    if source is None and unused and clouds_show_motion(recording, found.rig, config):
        notes = (
            f"recorded motion is not used, though the clouds show that the rig moves: {reason}" for reason in unused
        )
        return None, replace(found, notes=(*found.notes, *notes))
    if source is None and config.combine.motion.enabled and not found.rig.lidars and site not in FIXED_FRAMES:
        note = (
            f"{site}: neither clouds nor odometry or tf tell whether this frame moves, so it counts as standing still; "
            "on a vehicle, parked cars would seem to drive"
        )
        return None, replace(found, notes=(*found.notes, note, *unused))
    if source is None or config.combine.motion.topic or not _contradicts(source, recording, found, config):
        return source, found
    odometry = {info.topic for info in recording.topics if info.msgtype == ODOMETRY}
    name = next((topic for topic in source.topics if topic in odometry), "tf")
    remedy = "check its axes and units" if name == "tf" else f"--set combine.motion.topic={name} uses it"
    note = f"{name}: its poses do not follow the motion of the clouds, so it is not used ({remedy})"
    return None, replace(found, notes=(*found.notes, note))


def _contradicts(source: MotionSource, recording: Recording, found: Discovery, config: Config) -> bool:
    """Whether clouds show motion, and recorded poses another one or none wherever they do; not without lidars."""
    contradictions = 0
    for begin_ns in looks(recording) if found.rig.lidars else ():
        seen = _seen_motion(recording, found.rig, config, begin_ns)
        if seen is None:
            continue
        buffer = MotionBuffer(source, limits=config.limits)
        buffer.read_ahead(recording, begin_ns + MAX_WAIT_NS)
        stamps_ns = [stamp_ns + source.offset_ns for stamp_ns in seen.stamps_ns]
        poses = buffer.window(sum(stamps_ns) // 2)
        if not poses.covers(*stamps_ns):
            continue
        first, last = poses.at(*stamps_ns)
        T_first_last = np.linalg.inv(first) @ last
        recorded, shown = T_first_last[:3, 3], seen.T_first_last[:3, 3]
        longer_m = max(np.linalg.norm(recorded), np.linalg.norm(shown))
        if np.linalg.norm(recorded - shown) <= MAX_ERROR_SHARE * longer_m:
            return False
        if seen.misfit(T_first_last) <= MIN_MISFIT_RATIO * seen.misfit(seen.T_first_last):
            return False  # as along a wall
        contradictions += 1
    return contradictions > 0


class _Motion(NamedTuple):
    """The motion of the site frame from one cloud to a later one."""

    T_first_last: F64  # (4, 4) the site frame at the later one, in the site frame at the earlier one
    stamps_ns: tuple[int, int]  # Stamps of both
    misfit: Callable[[F64], float]  # Misfit of the later one to the earlier one by such a motion


def _seen_motion(recording: Recording, rig: Rig, config: Config, begin_ns: int) -> _Motion | None:
    """The motion that some clouds after a log time show; None if they show none."""
    lidar, odometry, stamps_ns = rig.lidars[0], FindOdometry(), list[int]()
    decode, last_ns, moved = CloudDecoder(rig, config, on_bad="skip"), -LOOK_STEP_NS, 0
    for message in recording.messages([lidar.topic], start_ns=begin_ns, stop_ns=begin_ns + MAX_WAIT_NS):
        if message.log_time_ns - last_ns < LOOK_STEP_NS:
            continue
        bundle = SensorBundle(0, message.stamp_ns, message.log_time_ns, {message.topic: message})
        for cloud in decode(bundle).values():
            site = replace(cloud, xyz=lidar.T_site_lidar.apply(cloud.xyz))
            none = site.select(np.zeros(len(site), np.bool_))
            combined = CombinedCloud(site, none, np.zeros(0, np.uint8), none, None, {})
            pose = odometry(combined, message.log_time_ns)
            stamps_ns.append(message.stamp_ns - lidar.time_offset_ns)
            moved = moved + 1 if pose else 0
            if pose and moved == 2:
                sample = site.xyz[:: len(site) // SAMPLE_POINTS + 1].astype(np.float64)
                return _Motion(pose.T_fixed_site, (stamps_ns[0], stamps_ns[-1]), partial(odometry.misfit, sample))
        last_ns = message.log_time_ns
        if len(stamps_ns) == LOOK_CLOUDS:
            break
    return None


def judge(size: SceneSize, *, moves: bool) -> str:
    """The preset that suits a scene of this size; `moves`: the site frame is known to move."""
    height_m = size.lidar_height_m
    if moves or height_m is None:
        return "road"
    if height_m < MODEL_LIDAR_M and size.extent_m[0] < MODEL_EXTENT_M:
        return "sandbox"
    return "crossing" if height_m > MAST_LIDAR_M else "road"


def scene_text(size: SceneSize, *, moves: bool) -> str:
    """The size of a scene in words."""
    length_m, width_m = size.extent_m
    digits = 1 if length_m < 10 else 0
    seen = [f"clouds of {length_m:.{digits}f} x {width_m:.{digits}f} m"]
    if size.lidar_height_m is None:
        seen.append("no ground found")
    else:
        seen.append(f"lidars {size.lidar_height_m:.1f} m above the ground")
    return ", ".join([*seen, "moving"] if moves else seen)


def _first_points(recording: Recording, rig: Rig, config: Config) -> F32:
    """(N, 3) points of the first clouds of every lidar, in the site frame."""
    lidars = {lidar.topic: lidar for lidar in rig.lidars}
    decode = CloudDecoder(rig, config, on_bad="skip")
    points: list[F32] = []
    found: Counter[str] = Counter()
    first_ns: int | None = None
    for number, message in enumerate(recording.messages(lidars), 1):
        first_ns = message.log_time_ns if first_ns is None and points else first_ns
        bundle = SensorBundle(0, message.stamp_ns, message.log_time_ns, {message.topic: message})
        for name, cloud in decode(bundle).items():
            xyz = cloud.xyz[(cloud.xyz != 0).any(1)]  # some drivers write beams without a return as (0, 0, 0)
            if len(xyz) and found[name] < CLOUDS:
                points.append(lidars[message.topic].T_site_lidar.apply(xyz))
                found[name] += 1
        waited_ns = 0 if first_ns is None else message.log_time_ns - first_ns
        if sum(found.values()) == CLOUDS * len(lidars) or waited_ns > MAX_WAIT_NS or number == MAX_MESSAGES:
            break
    return np.concatenate([np.zeros((0, 3), np.float32), *points])


def _extent_m(xyz_site: F32) -> tuple[float, float]:
    """Length and width of the middle 90 % of points (N, 3)."""
    low, high = np.percentile(xyz_site[:, :2], MIDDLE, axis=0)
    width_m, length_m = sorted((high - low).tolist())
    return length_m, width_m


def _heights_m(xyz_site: F32, rig: Rig) -> F64 | None:
    """Height of each lidar above the ground, metres; None without a ground."""
    origins = rig.lidar_xyz
    if rig.ground_height_m is not None:
        return origins[:, 2] - rig.ground_height_m
    plane = floor_of(xyz_site, origins)
    return None if plane is None else origins @ plane.normal + plane.offset_m


def on_level_site(
    found: Discovery,
    recording: Recording,
    config: Config,
    rig_file: RigFile | None,
    discover: Callable[[RigFile], Discovery],
) -> Discovery:
    """The rig in a level site frame, discovered anew, if its site frame is a lidar's own and tilted; else the same.

    A site frame that the settings or the rig file name stays, and so does one that zones or the height of the ground
    are given in.
    """
    file, rig, site = rig_file or RigFile(), found.rig, found.rig.site_frame
    lidar = next((one for one in rig.lidars if one.T_site_lidar.src == site), None)
    is_named = config.rig.site_frame or file.site_frame or rig.zones or rig.ground_height_m is not None
    level = f"{site}{SUFFIX}"
    if lidar is None or is_named or level in found.transforms.fixed.frames:
        return found
    up = _up(recording, rig, lidar, config)
    if up is None:
        return found
    edges = {**file.transforms.get(site, {}), level: Pose(rotation_xyzw=_turning_up_to(up))}
    again = discover(file.model_copy(update={"site_frame": level, "transforms": {**file.transforms, site: edges}}))
    source = "ground" if rig_file is None else RIG_FILE
    sources = (replace(one, extrinsics=one.extrinsics.replace(RIG_FILE, source)) for one in again.sources)
    note = (
        f"{lidar.name}: the ground is tilted by {np.degrees(np.arccos(up[2])):.0f} degrees in its frame, so objects "
        f"are in the level frame {level}; --set rig.site_frame={site} keeps them in its own"
    )
    return replace(again, sources=tuple(sources), notes=(*again.notes, note))


def _turning_up_to(up: F64) -> tuple[float, float, float, float]:
    """The quaternion (x, y, z, w) that turns the z axis to a unit vector; one that points down by half a turn first."""
    half_way = np.array([0.0, 0.0, 1.0]) + (up if up[2] >= 0 else up * TURNED_OVER)
    x, y, _, w = (np.append(np.cross([0.0, 0.0, 1.0], half_way), half_way[2]) / np.linalg.norm(half_way)).tolist()
    return (x, y, 0.0, w) if up[2] >= 0 else (w, 0.0, y, -x)


def _up(recording: Recording, rig: Rig, lidar: LidarSensor, config: Config) -> F64 | None:
    """(3,) normal of the ground in the lidar's frame if that is tilted, alike at all times; else None."""
    normals: list[F64] = []
    for begin_ns in looks(recording):
        cloud = _first_cloud(recording, rig, lidar, config, begin_ns)
        if cloud is None:
            continue
        normal = _floor_normal(cloud.xyz)
        if normal is None or normal[2] > np.cos(np.radians(MIN_TILT_DEG)):
            return None
        normals.append(normal)
    if not normals:
        return None
    mean = np.mean(normals, 0)
    mean /= np.linalg.norm(mean)
    return mean if (np.array(normals) @ mean >= np.cos(np.radians(MAX_SPREAD_DEG))).all() else None


def _floor_normal(xyz: F32) -> F64 | None:
    """The normal of the ground below a lidar, or above one that hangs upside down; None if there is neither."""
    below, share = _floor(xyz)
    if share < MIN_FLOOR_SHARE:
        above, share = _floor(xyz * TURNED_OVER.astype(np.float32))
        if above is not None and share >= MIN_FLOOR_SHARE:
            return np.asarray(above.normal * TURNED_OVER)
    return None if below is None else below.normal


def _floor(xyz: F32) -> tuple[Plane | None, float]:
    """The ground below a lidar at the origin, and the share of the points on it."""
    plane = floor_of(xyz, np.zeros((1, 3)))
    if plane is None:
        return None, 0.0
    return plane, float((np.abs(xyz @ plane.normal + plane.offset_m) < LAYER_M[1]).mean())


def _first_cloud(
    recording: Recording, rig: Rig, lidar: LidarSensor, config: Config, begin_ns: int
) -> PointCloud | None:
    """The first cloud with points after a log time."""
    decode = CloudDecoder(rig, config, on_bad="skip")
    for message in recording.messages([lidar.topic], start_ns=begin_ns, stop_ns=begin_ns + MAX_WAIT_NS):
        bundle = SensorBundle(0, message.stamp_ns, message.log_time_ns, {message.topic: message})
        for cloud in decode(bundle).values():
            if (cloud.xyz != 0).any():
                return cloud.select((cloud.xyz != 0).any(1))
    return None
