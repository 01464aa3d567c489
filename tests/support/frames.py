"""Whole FrameResults: two lidars, two cameras, a handful of objects; and results of such frames."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from builders import header, image, raw
from detections import boxes3d, forward_camera, matches

from lidcam.pipeline.core.clouds import CombinedCloud, Plane, PointCloud
from lidcam.pipeline.core.detections import (
    NO_HYPOTHESIS,
    Boxes2D,
    Boxes3D,
    Detections,
    Fused,
    Hypotheses,
    Matches,
    Source,
)
from lidcam.pipeline.core.frame import FrameResult, SensorBundle
from lidcam.pipeline.core.geometry.boxes import box_corners
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import Channel, Drop, RawMessage
from lidcam.pipeline.core.rig import LidarSensor, Rig, Zone
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import dump_config
from lidcam.pipeline.core.tracks import Tracks
from lidcam.readers.rig.rig_file import rig_yaml
from lidcam.writers.mcap.writer import McapResultWriter
from lidcam.writers.outputs.transaction import OutputFile
from lidcam.writers.provenance import Provenance

START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 100_000_000
CONFIG = Config()
COVARIANCE = np.array([[4.0, 1.2, 0.0], [1.2, 1.0, 0.0], [0.0, 0.0, 0.25]])
"""Of the place and heading of objects whose sources are given."""

PROVENANCE = Provenance(
    "1.2.3",
    ({"name": "a.bag", "size": "12"}, {"name": "b.mcap", "url": "https://host/b.mcap"}, {"name": "c.bag", "size": "0"}),
    lambda: "ff" * 32,
    lambda: {"input.0.sha256": "aa" * 32, "input.2.sha256": "cc" * 32},
    "as given",
    "fuse: {}\n",
    "site_frame: site\n",
    START_NS,
)


def through_cdr(message: Any) -> Any:
    """A message after a trip through its bytes."""
    return ROS2.deserialize(ROS2.serialize(message), message.__msgtype__)


def _rig() -> Rig:
    tilted = Transform.from_quaternion("site", "lidar2", (1.0, -2.0, 0.5), (0.0, 0.1, 0.0, 0.995))
    north = np.array([[-50.0, 0.0], [50.0, 0.0], [50.0, 50.0], [-50.0, 50.0]])
    return Rig(
        "site",
        (
            LidarSensor("lidar1", "/lidar1", Transform.identity("site", "site")),
            LidarSensor("lidar2", "/lidar2", tilted),
        ),
        (forward_camera("left", distortion=(0.1, -0.05)), forward_camera("right")),
        (Zone("intersection", north), Zone("circle", north * [1, -1])),
        -1.5,
    )


RIG = _rig()


def image_message(
    topic: str,
    stamp_ns: int,
    *,
    frame_id: str,
    encoding: Literal["ros1", "cdr"] = "cdr",
    compressed: bool = False,
    seed: int = 0,
) -> RawMessage:
    """A recorded image of 64 x 48 px, or of bytes that only look like a PNG if compressed."""
    pixels = np.random.default_rng(seed).integers(0, 255, (48, 64, 3), np.uint8)
    if compressed:
        data = np.concatenate([np.frombuffer(b"\x89PNG\r\n\x1a\n", np.uint8), pixels.reshape(-1)[:1001]])
        fields = {"header": header(stamp_ns, frame_id), "format": "png", "data": data}
        return raw(topic, "sensor_msgs/msg/CompressedImage", fields, stamp_ns, encoding=encoding)
    fields = dict(image(pixels, stamp_ns=stamp_ns, frame_id=frame_id))
    return raw(topic, "sensor_msgs/msg/Image", fields, stamp_ns, encoding=encoding)


def frame(
    index: int = 0,
    *,
    drops: tuple[Drop, ...] = (),
    objects: int = 3,
    motion: bool = False,
    sources: Sequence[Source] | None = None,
    tracks: Tracks | None = None,
) -> FrameResult:
    """Frame `index` of a run: `left` has an Image in ROS 1 bytes, `right` a CompressedImage in CDR, stamps differ.

    With `sources`, one for each object, those of `Source.CAMERA` are also what the cameras place, and those of
    `Source.PREDICTED`, which come last, are no hypotheses. `tracks` are those of the objects.
    """
    stamp_ns = START_NS + index * PERIOD_NS
    lidar = [
        RawMessage(stamp_ns + skew, stamp_ns + 7, (0, index), b"", Channel(topic, "sensor_msgs/msg/PointCloud2", "cdr"))
        for topic, skew in (("/lidar1", 0), ("/lidar2", 3_000_000))
    ]
    left = image_message("/left/image", stamp_ns + 1_000_001, frame_id="recorded", encoding="ros1", seed=index)
    right = image_message("/right/image", stamp_ns - 2_000_003, frame_id="right", compressed=True, seed=index)
    messages = {message.topic: message for message in (*lidar, left, right)}
    poses = np.stack([np.eye(4)] * 2)
    poses[1, 0, 3] = 2.0 * (index + 1)
    samples = PoseSamples("site", "odom", np.array([stamp_ns - 10**8, stamp_ns + 10**8], np.int64), poses)
    table = [[10.0, 1.5, 0.1, 4.2, 1.8, 1.5, 0.3], [15, 0, 0, 0.6, 0.6, 1.7, np.pi], [9, -60, 0, 8, 2.5, 3, -1]]
    found = replace(
        boxes3d(table[:objects], scores=[0.9, 0.5, 0.25][:objects], class_ids=[0, 1, 3][:objects]),
        stamp_ns=stamp_ns,
        measured_ns=np.full(objects, stamp_ns),
    )
    placed, rows = None, np.arange(objects, dtype=np.int64)
    if sources is not None:
        found = replace(found, sources=np.array(sources, np.uint8), covariances=np.tile(COVARIANCE, (objects, 1, 1)))
        placed = found.select(found.sources == Source.CAMERA)
        rows[found.sources == Source.PREDICTED] = NO_HYPOTHESIS
    seen = found.select(rows != NO_HYPOTHESIS)
    boxes = {"left": _boxes2d(left.stamp_ns, "left"), "right": Boxes2D.empty(right.stamp_ns, "right")}
    return FrameResult(
        SensorBundle(index, stamp_ns, stamp_ns + 7, messages, samples if motion else None),
        _combined(stamp_ns, index),
        Detections(seen.select(seen.sources != Source.CAMERA), boxes, placed),
        {camera.name: camera for camera in RIG.cameras},
        Hypotheses(
            seen,
            {camera.name: _matches(row == 0 and objects > 0, seen, row) for row, camera in enumerate(RIG.cameras)},
            len(seen) if placed is None else len(seen) - len(placed),
        ),
        seen.scores.astype(np.float64),
        Fused(found, np.arange(objects, dtype=np.int32)[::-1].copy(), rows, tracks=tracks),
        drops,
    )


def written_result(
    path: Path, frames: Iterable[FrameResult], *, rig: Rig = RIG, config: Config = CONFIG, **said: Any
) -> Path:
    """Write a result of frames; `said` replaces parts of its provenance."""
    told = {"config_yaml": dump_config(config), "rig_yaml": rig_yaml(rig)} | said
    with McapResultWriter(OutputFile(path, path), rig, config, replace(PROVENANCE, **told)) as writer:
        for one in frames:
            writer.write(one)
    return path


def tracks_of(
    numbers: Sequence[int], velocities: npt.ArrayLike = (0.0, 0.0), fronts_known: bool | Sequence[bool] = (False,)
) -> Tracks:
    """Tracks of these numbers, of existence 0.75 and 1.25 s old; 0 belongs to none."""
    n = len(numbers)
    return Tracks(
        np.array(numbers, np.int64),
        np.array(np.broadcast_to(velocities, (n, 2)), np.float64),
        np.tile(np.array([[0.25, 0.125], [0.125, 0.5]]), (n, 1, 1)),
        np.full(n, 0.5),
        np.full(n, 0.0625),
        np.full(n, 0.75),
        np.full(n, 1.25),
        np.array(np.broadcast_to(fronts_known, n), np.bool_),
    )


def _combined(stamp_ns: int, seed: int) -> CombinedCloud:
    random = np.random.default_rng(seed)

    def cloud(n: int) -> PointCloud:
        return PointCloud(
            stamp_ns,
            "site",
            random.normal(0, 10, (n, 3)).astype(np.float32),
            random.random(n, np.float32),
            random.integers(0, 64, n).astype(np.uint16),
            random.integers(-(10**8), 10**8, n).astype(np.int32),
            has_time=True,
        )

    kept, ground = cloud(500), cloud(200)
    counts = {"input": 710, "nan": 0, "range": 0, "outliers": 10, "ground": 200, "left": 500}
    plane = Plane(np.array([0.0, 0.0, 1.0]), 1.5)
    return CombinedCloud(kept, kept, np.zeros(500, np.uint8), ground, plane, counts, ("lidar1",))


def _boxes2d(stamp_ns: int, frame_id: str) -> Boxes2D:
    xyxy = np.array([[200.5, 150, 300.25, 250], [10, 20, 30, 60]], np.float32)
    return Boxes2D(stamp_ns, frame_id, xyxy, np.array([0.75, 0.5], np.float32), np.array([0, 1], np.int32))


def _matches(matched: bool, found: Boxes3D, row: int) -> Matches:
    camera = RIG.cameras[row]
    corners = box_corners(found.centers, found.sizes, found.yaws)
    projected = camera.model.project_boxes(camera.T_camera_site.apply(corners))
    return matches(np.zeros((int(matched), 2)), projected, overlaps=0.625)
