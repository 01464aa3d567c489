"""The evaluation folder of the predecessor system as a recording.

`pcd/N.txt` has the points of its combined cloud, a line x y z intensity each; `img/N/0.jpg` to `7.jpg` are the images
of cameras 11, 12, 13, 14, 41, 42, 43 and 44. There are no stamps: frames are taken to be 0.1 s apart, from September
2001 on.
"""

from collections.abc import Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from lidcam.pipeline.core.errors import RecordingError, is_short_memory
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.pipeline.core.settings.recording import LimitsConfig
from lidcam.pipeline.core.text import one_line
from lidcam.readers.recording import Loss, RosVersion, TopicInfo

START_NS = 1_000_000_000 * 10**9
"""Stamp of frame 0: a round number, so that nobody takes it for a time of measurement."""

STEP_NS = 100_000_000

CLOUD_TOPIC = "/point_cloud_combined"
"""As the system publishes it."""

CLOUD_FRAME = "point_cloud"

CAMERAS = (11, 12, 13, 14, 41, 42, 43, 44)
"""Cameras in the order of `img/N/0.jpg` to `7.jpg`."""

_CLOUD, _IMAGE = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CompressedImage"
_COLUMNS = ("x", "y", "z", "intensity")


def is_evaluation_folder(path: Path) -> bool:
    """Whether a folder has `pcd/` with numbered clouds."""
    folder = path / "pcd"
    return folder.is_dir() and any(file.suffix == ".txt" and file.stem.isdecimal() for file in folder.iterdir())


class EvaluationFolder:
    """An open folder; see `RecordingFile`. Only the names of its files are in memory.

    Args:
        path: The folder.
        index: Its place in the recording.
        limits: How large a file may be.

    Raises:
        RecordingError: it has no clouds.
    """

    ros_version: RosVersion = "no ROS"
    losses: tuple[Loss, ...] = ()

    def __init__(self, path: Path, index: int, limits: LimitsConfig) -> None:
        self.path = path
        self._index, self._limits = index, limits
        clouds = _numbers(path / "pcd", ".txt")
        if not clouds:
            raise RecordingError(f"{path}: expected clouds pcd/0.txt, pcd/1.txt, ..., found none")
        rows = frozenset(range(len(CAMERAS)))
        images = {number: _numbers(path / "img" / str(number), ".jpg") & rows for number in _numbers(path / "img", "")}
        self._frames = sorted({*clouds, *images})
        self._clouds, self._images = clouds, images
        self._channels = {CLOUD_TOPIC: _channel(CLOUD_TOPIC, _CLOUD)}
        self._channels |= {topic: _channel(topic, _IMAGE) for topic in map(_image_topic, CAMERAS)}
        counts = {CLOUD_TOPIC: len(clouds)}
        for row, camera in enumerate(CAMERAS):
            counts[_image_topic(camera)] = sum(row in found for found in images.values())
        self.topics: tuple[TopicInfo, ...] = tuple(
            TopicInfo(topic, self._channels[topic].msgtype, count, (self._channels[topic],))
            for topic, count in sorted(counts.items())
            if count
        )
        self.message_count = sum(counts.values())
        self.start_ns, self.end_ns = (START_NS + number * STEP_NS for number in (self._frames[0], self._frames[-1]))

    def messages(
        self, topics: Collection[str] | None, *, start_ns: int | None, stop_ns: int | None
    ) -> Iterator[RawMessage]:
        """See `RecordingFile`."""
        for number in self._frames:
            stamp_ns = START_NS + number * STEP_NS
            if start_ns is not None and stamp_ns < start_ns:
                continue
            if stop_ns is not None and stamp_ns >= stop_ns:
                return
            if number in self._clouds and (topics is None or CLOUD_TOPIC in topics):
                yield self._message(CLOUD_TOPIC, self.path / "pcd" / f"{number}.txt", stamp_ns, number, 0)
            for row in sorted(self._images.get(number, ())):
                topic = _image_topic(CAMERAS[row])
                if topics is None or topic in topics:
                    path = self.path / "img" / str(number) / f"{row}.jpg"
                    yield self._message(topic, path, stamp_ns, number, row + 1)

    def close(self) -> None:
        """Nothing stays open."""

    def _message(self, topic: str, path: Path, stamp_ns: int, number: int, place: int) -> RawMessage:
        channel = self._channels[topic]
        data, problem = b"", ""
        try:
            with path.open("rb") as stream:
                content = stream.read(self._limits.max_message_bytes + 1)
            if len(content) > self._limits.max_message_bytes:
                problem = f"{path.name} is too large, see limit_scale"
            elif topic == CLOUD_TOPIC:
                data = bytes(ROS2.serialize(_cloud(content, stamp_ns)))
            else:
                jpeg = np.frombuffer(content, np.uint8)
                frame_id = f"cam{CAMERAS[place - 1]}"
                data = bytes(ROS2.serialize(ROS2.compressed_image(stamp_ns, frame_id, "jpeg", jpeg)))
        except (OSError, ValueError) as err:
            if is_short_memory(err):
                raise
            problem = f"{path.name} cannot be used: {one_line(err, max_characters=200)}"
        order = (self._index, number * (len(CAMERAS) + 1) + place)
        return RawMessage(stamp_ns, stamp_ns, order, data, channel, problem)


def _cloud(content: bytes, stamp_ns: int) -> Any:
    """The cloud of a text."""
    if content.strip():
        points = np.loadtxt(BytesIO(content), np.float32, ndmin=2, delimiter="," if b"," in content[:200] else None)
    else:
        points = np.zeros((0, len(_COLUMNS)), np.float32)
    if points.shape[1] != len(_COLUMNS):
        raise ValueError(f"expected {len(_COLUMNS)} columns ({' '.join(_COLUMNS)}), found {points.shape[1]}")
    columns = {name: np.ascontiguousarray(points[:, row]) for row, name in enumerate(_COLUMNS)}
    return ROS2.cloud(stamp_ns, CLOUD_FRAME, columns)


def _channel(topic: str, msgtype: str) -> Channel:
    return Channel(topic, msgtype, "cdr", ROS2.definition(msgtype), "ros2msg", "humble")


def _image_topic(camera: int) -> str:
    return f"/image_raw_{camera}/compressed"


def _numbers(folder: Path, suffix: str) -> frozenset[int]:
    """Numbers that are the names in a folder, without their ending."""
    if not folder.is_dir():
        return frozenset()
    stems = (path.name.removesuffix(suffix) for path in folder.iterdir() if path.name.endswith(suffix))
    return frozenset(int(stem) for stem in stems if stem.isdecimal() and str(int(stem)) == stem and len(stem) < 10)
