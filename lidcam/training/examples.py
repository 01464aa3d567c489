"""Examples to learn from: clusters of simulated sweeps, their features, and what they truly are."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import NamedTuple, Self

import numpy as np

from lidcam.bags.simulator.worlds.draw import Family
from lidcam.bags.simulator.worlds.training_scenes import SWEEPS_PER_WORLD, TrainingSweep, sweep
from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.clouds import CombinedCloud, Plane, PointCloud
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.detect import Detect3DConfig
from lidcam.pipeline.detectors.cluster.features import FEATURES
from lidcam.pipeline.detectors.cluster.learned import FeatureFinder
from lidcam.pipeline.parallel.pool import process_pool
from lidcam.pipeline.stages.combine import Combine
from lidcam.pipeline.stages.detect3d import Detect3D
from lidcam.training.labelled import NAMES, LabelledFrame, Recordings

SWEEPS_OF_A_WORLD = 4  # Each by another lidar in another place: more add little, since the same objects stand there
MIN_POINTS = 3  # Points on a true object; one with fewer counts as absent

GATES_M = np.array([0.0, 2.0, 0.6, 0.9, 2.5])  # Maximum distance of a box from a true object, for each of `KINDS`
KIND_OF_CLASS = {"car": 1, "pedestrian": 2, "cyclist": 3, "van": 4, "truck": 4, "bus": 4}
KIND_OF_ROW = np.array([KIND_OF_CLASS[name] for name in NAMES])
SITE = "site"
CONFIG = Config(detect3d=Detect3DConfig(score="geometric"))


class Examples(NamedTuple):
    """N boxes."""

    features: F64  # (N, F) see `FEATURES`
    kinds: I64  # (N,) int64, rows of `KINDS`

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """All boxes of all parts."""
        empty = np.zeros((0, len(FEATURES))), np.zeros(0, np.int64)
        return cls(*(np.concatenate(arrays) for arrays in zip(empty, *parts, strict=True)))


def examples_of(source: Family | Recordings, numbers: range, *, workers: int) -> Iterator[Examples]:
    """The examples of each world of a family, or of as many frames drawn from recordings as a world has sweeps.

    They are in order, and the same for any number of processes.
    """
    make: Callable[[int], Examples]
    make = partial(_of_drawn_frames, source) if isinstance(source, Recordings) else partial(_of_world, source)
    if workers == 1:
        yield from map(make, numbers)
        return
    with process_pool(workers) as pool:
        yield from pool.map(make, numbers)


def examples_of_frame(frame: LabelledFrame) -> Examples:
    """The examples in the labelled part of a frame."""
    rig, count = rig_of(frame.origins), len(frame.position)
    rest = np.zeros(count, np.float32), np.zeros(count, np.uint16), np.zeros(count, np.int32)
    cloud, ground = PointCloud(0, SITE, frame.position.astype(np.float32), *rest), Plane(np.array([0.0, 0, 1]), 0.0)
    combined = CombinedCloud(cloud, cloud, frame.lidar, cloud.select(np.arange(0)), ground, {})
    found, true = Detect3D(rig, CONFIG)(combined), frame.true.select(frame.true.points >= MIN_POINTS)
    kinds = kinds_of_boxes(found.centers[:, :2], true.centers[:, :2], KIND_OF_ROW[true.classes])
    known = frame.is_labelled(found.centers[:, :2]) | (kinds > 0)
    if not known.any():
        return Examples.joined([])
    return Examples(FeatureFinder(rig, CONFIG)(combined, found.select(known)), kinds[known])


def _of_drawn_frames(recordings: Recordings, number: int) -> Examples:
    draw = np.random.Generator(np.random.PCG64(np.random.SeedSequence([number])))
    return Examples.joined([examples_of_frame(recordings.drawn(draw)) for _ in range(SWEEPS_OF_A_WORLD)])


def _of_world(family: Family, world: int) -> Examples:
    step = SWEEPS_PER_WORLD // SWEEPS_OF_A_WORLD
    found = [sweep(family, seed) for seed in range(world * SWEEPS_PER_WORLD, (world + 1) * SWEEPS_PER_WORLD, step)]
    # On masts, several lidars see one site: make one frame with a single lidar, and one with the others together.
    frames = [found[:1], found[1:]] if family == "crossing" else [[one] for one in found]
    return Examples.joined([_of_sweeps(frame) for frame in frames])


def _of_sweeps(frame: Sequence[TrainingSweep]) -> Examples:
    """The examples of a frame of sweeps that were taken at the same time."""
    rig = rig_of([one.origin for one in frame])
    clouds = {lidar.name: cloud_of(one, lidar.name) for lidar, one in zip(rig.lidars, frame, strict=True)}
    combined = Combine(rig, CONFIG.combine)(SensorBundle(0, 0, 0, {}), clouds)
    boxes = Detect3D(rig, CONFIG)(combined)
    if not len(boxes):
        return Examples.joined([])
    is_seen = np.sum([one.point_counts for one in frame], axis=0) >= MIN_POINTS
    kinds = np.array([KIND_OF_CLASS[name] for name in frame[0].class_names], np.int64)
    truth = kinds_of_boxes(boxes.centers[:, :2], frame[0].centers[is_seen, :2], kinds[is_seen])
    return Examples(FeatureFinder(rig, CONFIG)(combined, boxes), truth)


def rig_of(origins: Iterable[F64]) -> Rig:
    """Lidars at these places (3,), named by their numbers."""
    poses = (pose_matrix(np.eye(3), origin) for origin in origins)
    lidars = (LidarSensor(str(row), "", Transform(SITE, str(row), pose)) for row, pose in enumerate(poses))
    return Rig(SITE, tuple(lidars), (), ())


def cloud_of(taken: TrainingSweep, name: str) -> PointCloud:
    """The points of a sweep as its lidar delivers them."""
    count = len(taken.points)
    xyz = taken.points[:, :3] - taken.origin.astype(np.float32)
    rest = np.zeros(count, np.uint16), np.zeros(count, np.int32)
    return PointCloud(0, name, xyz, taken.points[:, 3].copy(), *rest)


def kinds_of_boxes(centers_xy: F64, true_xy: F64, true_kinds: I64) -> I64:
    """(B,) kind of the true object nearest to each box, measured in gates of the kind; 0 if none is within its gate.

    Args:
        centers_xy: (B, 2) centres of the boxes, metres.
        true_xy: (T, 2) centres of the objects, metres.
        true_kinds: (T,) rows of `KINDS`, none 0.
    """
    away = np.linalg.norm(centers_xy[:, None] - true_xy, axis=2) / GATES_M[true_kinds]
    away = np.column_stack([np.ones(len(centers_xy)), away])
    return np.asarray(np.append(0, true_kinds)[away.argmin(1)])
