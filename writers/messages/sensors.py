"""Clouds, images, the poses of sensors, and how cameras project, as ROS messages."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from lidcam.pipeline.core.camera import COEFFICIENTS
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import MessageError, is_short_memory
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import CameraSensor, Rig
from lidcam.pipeline.core.ros.messages import ROS2, RosMessages

COMPRESSED = "sensor_msgs/msg/CompressedImage"
IMAGE_TYPES = ("sensor_msgs/msg/Image", COMPRESSED)


def read_image(message: RawMessage) -> Any:
    """The recorded image, with its `data` a view into the message.

    Raises:
        MessageError: the type is another one, the bytes do not fit it, or the message could not be read.
    """
    msgtype, is_ros1 = message.channel.msgtype, message.channel.encoding == "ros1"
    if msgtype not in IMAGE_TYPES:
        raise MessageError(f"{message.topic}: expected {' or '.join(IMAGE_TYPES)}, found {msgtype}")
    if message.problem:
        raise MessageError(f"{message.topic}: {message.problem}")
    try:
        return RosMessages(1 if is_ros1 else 2).deserialize(memoryview(message.data), msgtype)
    except Exception as err:  # rosbags' generated decoders raise errors of several kinds
        if is_short_memory(err):
            raise
        raise MessageError(f"{message.topic}: {len(message.data)} bytes are not a valid {msgtype} ({err})") from err


def image_cdr(message: RawMessage, *, frame_id: str) -> bytes | memoryview:
    """The image as little-endian CDR with the message's stamp and the given frame in its header.

    The pixels are never decoded; a message that already has that form is passed through unchanged.

    Raises:
        MessageError: it is no image, or the bytes do not fit its type.
    """
    image, header = read_image(message), ROS2.header(message.stamp_ns, frame_id)
    if message.channel.encoding == "cdr" and message.data[1] == 1 and image.header == header:
        return message.data
    image.header = header
    return ROS2.serialize(image)


def static_transforms(rig: Rig, stamp_ns: int, others: Iterable[Transform] = ()) -> Any:
    """TFMessage from the site frame to every sensor's frame, each child once; the site frame itself needs none.

    `others` are T_site_frame of further frames.
    """
    edges = [lidar.T_site_lidar for lidar in rig.lidars]
    edges += [camera.T_camera_site.inverse() for camera in rig.cameras]
    by_child: dict[str, Transform] = {}
    for edge in (*edges, *others):
        if edge.src != edge.dst:
            by_child.setdefault(edge.src, edge)
    return ROS2.transforms(stamp_ns, by_child.values())


def camera_info(camera: CameraSensor, stamp_ns: int) -> Any:
    """CameraInfo with the intrinsics that were used, for an image that is not rectified."""
    model = camera.model
    missing = max(0, COEFFICIENTS[model.model] - len(model.distortion))
    return ROS2.camera_info(
        stamp_ns,
        camera.T_camera_site.dst,
        width=model.width_px,
        height=model.height_px,
        distortion_model=model.model,
        d=np.pad(model.distortion, (0, missing)),
        k=model.K.reshape(9),
    )


def cloud_message(cloud: PointCloud, *, stamp_ns: int, frame_id: str) -> Any:
    """PointCloud2, laid out as by Velodyne's driver: metres, intensity, ring, and `time` in s after `stamp_ns`."""
    x, y, z = cloud.xyz.T
    times_s = (cloud.time_offset_ns + float(cloud.stamp_ns - stamp_ns)) * 1e-9
    columns = {"x": x, "y": y, "z": z, "intensity": cloud.intensity, "ring": cloud.ring}
    return ROS2.cloud(stamp_ns, frame_id, {**columns, "time": times_s.astype(np.float32)})
