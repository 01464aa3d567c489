"""Messages of the sensors and transforms that a rig is made from, all stamped at 5 ns."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from builders import Fields, camera_info, detection2d_array, image, pointcloud2, raw, tf_message, transform_stamped
from memory_recording import MemoryRecording

from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.rig.discovery import Discovery, discover_rig
from lidcam.readers.rig.schema import RigFile

K = np.array([[500.0, 0, 32.0], [0, 500.0, 24.0], [0, 0, 1]])


def cloud(topic: str = "/points", frame: str = "lidar", **options: Any) -> RawMessage:
    """A cloud of one point."""
    return raw(topic, "sensor_msgs/msg/PointCloud2", pointcloud2([[1, 2, 3]], stamp_ns=5, frame_id=frame), 5, **options)


def image_message(
    topic: str, frame: str = "", *, size: tuple[int, int] = (64, 48), encoding: str = "mono8"
) -> RawMessage:
    """A black image of a width and height."""
    pixels = np.zeros(size[::-1], np.uint16 if encoding == "16UC1" else np.uint8)
    return raw(topic, "sensor_msgs/msg/Image", image(pixels, stamp_ns=5, frame_id=frame, encoding=encoding), 5)


def info(topic: str, frame: str = "", **options: Any) -> RawMessage:
    """The calibration of a camera of 64 x 48 px."""
    options = {"width_px": 64, "height_px": 48, **options}
    fields = camera_info(options.pop("K", K), stamp_ns=5, frame_id=frame, **options)
    return raw(topic, "sensor_msgs/msg/CameraInfo", fields, 5)


def boxes_2d(topic: str, frame: str) -> RawMessage:
    """One 2D box."""
    fields = detection2d_array([[1, 2, 3, 4]], class_names=["car"], scores=[0.9], stamp_ns=5, frame_id=frame)
    return raw(topic, "vision_msgs/msg/Detection2DArray", fields, 5)


def static(*edges: tuple[str, str, tuple[float, float, float]] | Fields) -> RawMessage:
    """Static transforms: parent, child and translation, or fields."""
    transforms = [
        edge if isinstance(edge, dict) else transform_stamped(edge[0], edge[1], stamp_ns=5, translation=edge[2])  # type: ignore[index]  # a tuple then
        for edge in edges
    ]
    return raw("/tf_static", "tf2_msgs/msg/TFMessage", tf_message(transforms), 5)


def discover(
    messages: Iterable[RawMessage], file: RigFile | Mapping[str, Any] | None = None, **sections: Any
) -> Discovery:
    """What is found in messages, with what a rig file says and with sections of the settings."""
    rig = None if file is None else RigFile.model_validate(file)
    return discover_rig(MemoryRecording(messages), Config.model_validate(sections), rig)


def reasons(found: Discovery) -> dict[str, str]:
    """Why sensors are left out, by their names."""
    return {fault.sensor: fault.reason for fault in found.faults}
