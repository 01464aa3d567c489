"""Clouds that nodes made of a lidar's: a robot that records everything has both.

Lidars that are triggered together, or simulated, have equal stamps as well; frames and points tell them apart. The
points of a filtered cloud are among the sensor's to a few millimetres. In the sensor's own frame, or in one above it,
points that were thinned out or corrected for motion lie near the sensor's.
"""

import math
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from lidcam.pipeline.core.arrays import F32, F64, I64, Array
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.pointcloud2 import INTENSITY_FIELDS, RING_FIELDS, TIME_FIELDS
from lidcam.readers.messages.tf import RecordedTransforms
from lidcam.readers.natural_order import natural_key
from lidcam.readers.ouster.packets import SWEEP
from lidcam.readers.recording import Recording, TopicInfo
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.sensor_topics import CLOUD
from lidcam.readers.rig.topics.contents import Contents, Pair
from lidcam.readers.velodyne.scan import SCAN

PACKETS = frozenset({SCAN, SWEEP})
"""Types of sweeps of a lidar's packets."""

WORLD_FRAMES = frozenset({"camera_init", "earth", "enu", "global", "local", "map", "odom", "utm", "world"})
"""Frames that vehicles move in (REP 105, and mapping programs), by their names or the first words of these."""

COMPUTED_FIELDS = frozenset({"normal_x", "normal_y", "normal_z", "curvature", "rgb", "rgba"})
"""Fields of clouds that no lidar measures: normals, and colours of a camera."""

RADAR_FIELDS = frozenset({"doppler", "doppler_velocity", "radial_velocity", "range_rate", "rcs", "velocity", "vx_comp"})
"""Fields of clouds of radars; lidars that measure speeds have times of points, too."""

SAMPLED = 2000
"""Number of points of a cloud that are sought in another one."""

SAME_M, NEAR_M = 0.001, 0.5
"""Cells in which, or beside which, the same point and one of the same surface are sought."""

MIN_SAME, MIN_NEAR = 0.9, 0.8
"""Smallest shares of the points of a cloud that are found in the one that it was made of."""

MIN_WIDER, MAX_THINNED = 1.4, 0.5
"""Smallest ratio of spreads, and largest of points, of a cloud that was thinned out: points near a lidar are dense."""

AXES = [0, 1, 2], [2, 0, 1]
"""Ahead, left and up among the axes of a cloud, and of those of LOAM: left, up, ahead."""

LEAVES_M = 0.05, 0.1, 0.15
"""Cells of which filters keep one point each (VoxelGrid); larger ones thin a cloud out."""

MAX_IN_ONE, MIN_IN_ONE = 0.01, 0.2
"""Largest share of points that share a cell with others after such a filter, and the smallest before it."""

RUN, MIN_SAMPLED_RUNS = 8, 50
"""Length of the runs of intensities by which copied points are recognised, and the fewest that say something."""

RUN_KEY = np.random.default_rng(0).integers(2**64, size=RUN, dtype=np.uint64)
"""(RUN,) factors that make one number of a run; regular ones give different runs of few values the same number."""

MIN_RUNS, MIN_RUNS_RATIO = 0.2, 2.0
"""Smallest share of runs that copied points keep, and its smallest ratio to that which another sweep has by chance."""

MIN_NOT_AMONG = 0.001
"""Smallest share of the intensities of copied points that another sweep lacks; the sensor's has all of them."""


def is_world_frame(frame: str, frames: Collection[str], transforms: RecordedTransforms, *, is_measured: bool) -> bool:
    """Whether sensors move in a frame, by its name, or by what moves below it.

    `frame` is that of a cloud, `frames` are those of all. `is_measured`: its points have times or rings, as vehicles
    carry lidars on trailers and arms, too.
    """
    others = {other for other in frames if other and other != frame}
    is_joined = any(transforms.are_joined(frame, other) for other in others)
    name = frame.rpartition("/")[2].lower()
    if name.startswith("base") or (is_measured and is_joined):
        return False
    is_named = not WORLD_FRAMES.isdisjoint({name, name.partition("_")[0]})
    if is_named or is_measured:
        return is_named
    if any(frame in _beyond_motion(other, transforms) for other in others):
        return True
    is_top = frame not in transforms.moving and transforms.fixed.parent(frame) is None
    return is_top and frame in transforms.moving.values() and not is_joined


def _beyond_motion(frame: str, transforms: RecordedTransforms) -> set[str]:
    """The frames above one that it moves in."""
    found, passed, moves = set[str](), set[str](), False
    while frame and frame not in passed:
        passed.add(frame)
        moves = moves or frame in transforms.moving
        frame = transforms.moving.get(frame) or transforms.fixed.parent(frame) or ""
        if moves and frame:
            found.add(frame)
    return found


def has_fields(topic: str, first: FirstMessages, fields: frozenset[str]) -> bool:
    """Whether clouds have one of some fields, and no times and rings: lidars with a camera have colours, too."""
    found = not first.missing(topic, CLOUD) and fields & _fields(first.decoded(topic, CLOUD))
    return bool(found) and not is_measured(topic, first)


def _fields(content: Any) -> set[str]:
    return {str(field.name).lower() for field in getattr(content, "fields", ())}


def cloud_sources(
    recording: Recording, infos: Sequence[TopicInfo], first: FirstMessages, transforms: RecordedTransforms
) -> dict[str, str]:
    """The topic that each topic of clouds was made of; empty for the rawest of each lidar.

    Rawest are packets, then clouds with times, rings and intensities of points, of one lidar, in a frame below that of
    others, at the full rate, with the most points, received first.
    """
    packets = {info.topic for info in infos if info.msgtype in PACKETS}  # no node makes them
    topics, most = [info.topic for info in infos], max((info.message_count for info in infos), default=0)
    is_rare = {info.topic: info.message_count < most / 2 for info in infos}

    def decode(message: RawMessage) -> PointCloud:
        cloud = first.cloud(message)
        return cloud.select((cloud.xyz != 0).any(1))  # beams without a return say nothing

    contents = Contents(recording, topics, CLOUD, first, decode)
    frames = {topic: first.frame(topic, CLOUD) for topic in topics}
    counts = {topic: math.prod(first.image_size(topic, CLOUD) or (0, 0)) for topic in topics}

    def rawness(topic: str) -> tuple[object, ...]:
        lacks = tuple(not one for one in _measures(topic, first))
        is_above = any(_is_above(frames[topic], frame, transforms) for frame in frames.values())
        order = -counts[topic], contents.delay_ns(topic), natural_key(topic)
        return topic not in packets, lacks, is_merged(topic), is_above, is_rare[topic], *order

    def is_merged(topic: str) -> bool:
        """Whether the points of a smaller cloud in another frame, of a lidar beside it, are among a topic's."""
        frame = frames[topic]
        beside = [
            one
            for one in topics
            if counts[one] < counts[topic]
            and frames[one] != frame
            and transforms.are_joined(frames[one], frame)
            and not _is_above(frames[one], frame, transforms)
        ]
        for pair in (pair for pairs in contents.pairs(topic, beside).values() for pair in pairs[:1]):
            with suppress(MessageError):
                both, part = contents.at(topic, pair.log_ns), contents.at(pair.sensor, pair.sensor_log_ns)
                points = _in_frame_of(part, both, transforms)
                if _found(part.xyz, points, SAME_M) >= MIN_SAME > _found(points, part.xyz, SAME_M):
                    return True
        return False

    def is_made_of(pair: Pair) -> bool | None:
        frame, other = frames[pair.topic], frames[pair.sensor]
        is_beside = frame != other and transforms.are_joined(frame, other) and not _is_above(frame, other, transforms)
        if pair.topic in packets or (is_beside and not pair.is_stamped):
            return False

        def is_copied() -> bool:
            if pair.other_log_ns is None:
                return False
            another: PointCloud = contents.at(pair.sensor, pair.other_log_ns)
            if not _not_among(made, cloud) and _not_among(made, another) >= MIN_NOT_AMONG:
                return True
            return _shared_runs(made, cloud) >= max(MIN_RUNS, MIN_RUNS_RATIO * _shared_runs(made, another))

        made, cloud = contents.at(pair.topic, pair.log_ns), contents.at(pair.sensor, pair.sensor_log_ns)
        if min(len(made), len(cloud)) < RUN:
            return None
        if not pair.is_stamped:  # by its points alone
            return _is_same(_in_frame_of(cloud, made, transforms), cloud.xyz)
        measured = is_measured(pair.topic, first), is_measured(pair.sensor, first)
        if not transforms.are_joined(cloud.frame_id, made.frame_id):
            return _is_unjoined_cloud_of(made, cloud, transforms, measured, is_copied=is_copied)
        return _is_cloud_of(made, cloud, transforms, is_poor=measured == (False, True), is_copied=is_copied)

    return contents.sources(sorted(topics, key=rawness), is_made_of)


def is_measured(topic: str, first: FirstMessages) -> bool:
    """Whether a topic's points have times or rings, which nodes seldom hand on."""
    return any(_measures(topic, first)[:2])


def _measures(topic: str, first: FirstMessages) -> tuple[bool, ...]:
    """Whether a topic's points have times, rings and intensities; packets, and points of a driver, have all of them."""
    content = None if first.missing(topic, CLOUD) else first.decoded(topic, CLOUD)
    names = _fields(content)
    is_driven = content is not None and not hasattr(content, "fields")
    return tuple(is_driven or not names.isdisjoint(one) for one in (TIME_FIELDS, RING_FIELDS, INTENSITY_FIELDS))


def _is_above(frame: str, other: str, transforms: RecordedTransforms) -> bool:
    """Whether a frame is fixed above another one."""
    return frame != other and transforms.are_joined(frame, other) and frame in transforms.fixed.chain(other)


def _is_cloud_of(
    made: PointCloud, cloud: PointCloud, transforms: RecordedTransforms, *, is_poor: bool, is_copied: Callable[[], bool]
) -> bool:
    """Whether a cloud was made of that of a sensor at the same stamp; in doubt it was not.

    `is_poor`: it has neither times nor rings, the sensor has; `is_copied`: runs of its intensities are the sensor's.
    """
    points = _in_frame_of(cloud, made, transforms)
    if _is_same(points, cloud.xyz):
        return True
    if made.frame_id != cloud.frame_id and not _is_above(made.frame_id, cloud.frame_id, transforms):
        return False  # another lidar's
    is_few = len(made) < MAX_THINNED * len(cloud) or not made.intensity.any()
    is_thinned = (is_poor and is_few) or _spread_m(made.xyz) >= MIN_WIDER * _spread_m(cloud.xyz)
    is_thinned = is_thinned or (len(made) < len(cloud) and _is_grid(made.xyz, cloud.xyz))
    return (is_thinned or is_copied()) and _found(points, cloud.xyz, NEAR_M) >= MIN_NEAR


def _is_unjoined_cloud_of(
    made: PointCloud,
    cloud: PointCloud,
    transforms: RecordedTransforms,
    measured: tuple[bool, bool],
    *,
    is_copied: Callable[[], bool],
) -> bool:
    """The same of a cloud in a frame that no transform joins with the sensor's: it cannot be used in any case.

    Points without times and rings were made of those of a sensor if they lie near these, as if the frames were one. In
    a frame that tf lacks, equal stamps suffice where the sensor has them. `measured`: whether both topics have them.
    """
    is_unknown = made.frame_id not in transforms.fixed.frames and made.frame_id not in transforms.moving
    if measured == (False, True) and is_unknown:
        return True
    is_near = not measured[0] and any(_found(made.xyz[:, axes], cloud.xyz, NEAR_M) >= MIN_NEAR for axes in AXES)
    return is_near or _is_same(made.xyz, cloud.xyz) or is_copied()


def _in_frame_of(cloud: PointCloud, made: PointCloud, transforms: RecordedTransforms) -> F32:
    """The points of a cloud in the frame of another one; as they are where nothing joins the frames."""
    if not made.frame_id or not transforms.are_joined(cloud.frame_id, made.frame_id):
        return made.xyz
    return transforms.lookup(cloud.frame_id, made.frame_id).apply(made.xyz)


def _is_same(points: F32, others: F32) -> bool:
    """Whether nearly all points of one cloud are among those of another one."""
    return max(_found(points, others, SAME_M), _found(others, points, SAME_M)) >= MIN_SAME


def _is_grid(made: F32, points: F32) -> bool:
    """Whether a filter left one point in each cell."""
    return any(_in_one(made, leaf) <= MAX_IN_ONE and _in_one(points, leaf) >= MIN_IN_ONE for leaf in LEAVES_M)


def _in_one(points: F32, cell_m: float) -> float:
    """Share of points in cells that have one already."""
    return np.count_nonzero(np.diff(np.sort(_keys(points, cell_m))) == 0) / len(points)


def _spread_m(points: F32) -> float:
    """Median distance from the middle of points."""
    return float(np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1)))


def _shared_runs(made: PointCloud, cloud: PointCloud) -> float:
    """Share of the runs of intensities of a cloud that another one has, too: where points were moved, but copied."""
    if min(len(made), len(cloud)) < RUN:
        return 0.0
    by_ring = cloud.intensity[np.argsort(cloud.ring, kind="stable")]  # the order of images of ranges, either way round
    orders = made.intensity, cloud.intensity, by_ring, by_ring[::-1]
    runs, *of_cloud = (sliding_window_view(one, RUN) for one in orders)
    sample = runs[:: max(len(runs) // SAMPLED, 1)]
    sample = sample[(np.diff(np.sort(sample, 1)) > 0).sum(1) >= RUN // 2]  # others are found anywhere
    if len(sample) < MIN_SAMPLED_RUNS:
        return 0.0
    keys, *known = (one.copy().view(np.uint32).astype(np.uint64) @ RUN_KEY for one in (sample, *of_cloud))
    return float(_is_among(keys, np.concatenate(known)).mean())


def _not_among(made: PointCloud, cloud: PointCloud) -> float:
    """Share of the intensities of a cloud that another one has not, or less often, in any order."""
    _, values = np.unique(np.concatenate([made.intensity, cloud.intensity]), return_inverse=True)
    counts = (np.bincount(of, minlength=values.max() + 1) for of in np.split(values, [len(made)]))
    return float(np.maximum(np.subtract(*counts), 0).sum() / len(made))


def _found(points: F32, others: F32, cell_m: float) -> float:
    """Share of points (N, 3) with one of the others (M, 3) in the same cell, or in one beside it."""
    if not len(points) or not len(others):
        return 0.0
    sample = points[:: max(len(points) // SAMPLED, 1)]
    beside = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), -1).reshape(-1, 3)
    sought = _keys(sample[:, None] + cell_m * beside, cell_m)
    return float(_is_among(sought, _keys(others, cell_m)).any(1).mean())


def _is_among(sought: Array, known: Array) -> Array:
    """Whether numbers are among others, of which there is at least one; `np.isin` takes ten times as long."""
    in_order = np.sort(known)
    return np.asarray(in_order.take(np.searchsorted(in_order, sought), mode="clip") == sought)


def _keys(points: F32 | F64, cell_m: float) -> I64:
    """One number for the cell of each point (..., 3)."""
    cells = np.clip(np.floor(points.astype(np.float64) / cell_m), -(2**19), 2**19).astype(np.int64)
    x, y, z = np.moveaxis(cells, -1, 0)
    return np.asarray((x << 42) + (y << 21) + z, np.int64)
