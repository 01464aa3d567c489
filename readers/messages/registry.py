"""The message types that lidcam reads, one row each: what asks for a kind of message finds its types and decoders here.

A decoder is imported when its first message comes.
"""

from importlib import import_module
from typing import Any, Literal, NamedTuple

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage

Kind = Literal[
    "cloud", "image", "camera info", "2D boxes", "3D boxes", "odometry", "transforms", "diagnostics", "tracks"
]


class MessageType(NamedTuple):
    """A type that lidcam reads."""

    kind: Kind  # Content of its messages
    decoder: str  # `module:function`; the module alone where no function of a message is enough, as for videos


_MESSAGES = "lidcam.readers.messages"
_COMPRESSED_CLOUD = f"{_MESSAGES}.compressed_cloud:decode_compressed_cloud"

TYPES: dict[str, MessageType] = {
    "sensor_msgs/msg/PointCloud2": MessageType("cloud", f"{_MESSAGES}.pointcloud2:decode_pointcloud2"),
    "sensor_msgs/msg/PointCloud": MessageType("cloud", f"{_MESSAGES}.pointcloud:decode_pointcloud"),
    "point_cloud_interfaces/msg/CompressedPointCloud2": MessageType("cloud", _COMPRESSED_CLOUD),
    "draco_point_cloud_transport/msg/CompressedPointCloud2": MessageType("cloud", _COMPRESSED_CLOUD),
    "foxglove_msgs/msg/CompressedPointCloud": MessageType("cloud", _COMPRESSED_CLOUD),
    "velodyne_msgs/msg/VelodyneScan": MessageType("cloud", "lidcam.readers.velodyne.scan"),
    "lidcam_msgs/msg/OusterSweep": MessageType("cloud", "lidcam.readers.ouster.decoder:decode_ouster"),
    "livox_interfaces/msg/CustomMsg": MessageType("cloud", f"{_MESSAGES}.pointcloud:decode_livox"),
    "livox_ros_driver/msg/CustomMsg": MessageType("cloud", f"{_MESSAGES}.pointcloud:decode_livox"),
    "livox_ros_driver2/msg/CustomMsg": MessageType("cloud", f"{_MESSAGES}.pointcloud:decode_livox"),
    "sensor_msgs/msg/Image": MessageType("image", f"{_MESSAGES}.image:decode_image"),
    "sensor_msgs/msg/CompressedImage": MessageType("image", f"{_MESSAGES}.image:decode_compressed_image"),
    "foxglove_msgs/msg/CompressedVideo": MessageType("image", "lidcam.readers.video.packets"),
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": MessageType("image", "lidcam.readers.video.packets"),
    "sensor_msgs/msg/CameraInfo": MessageType("camera info", f"{_MESSAGES}.camera_info"),
    "vision_msgs/msg/Detection2DArray": MessageType("2D boxes", f"{_MESSAGES}.detections:decode_detections2d"),
    "vision_msgs/msg/Detection3DArray": MessageType("3D boxes", f"{_MESSAGES}.detections:decode_detected_boxes"),
    "autoware_perception_msgs/msg/DetectedObjects": MessageType(
        "3D boxes", f"{_MESSAGES}.objects:decode_detected_objects"
    ),
    "autoware_auto_perception_msgs/msg/DetectedObjects": MessageType(
        "3D boxes", f"{_MESSAGES}.objects:decode_detected_objects"
    ),
    "nav_msgs/msg/Odometry": MessageType("odometry", f"{_MESSAGES}.tf:decode_odometry"),
    "tf/msg/tfMessage": MessageType("transforms", f"{_MESSAGES}.tf:decode_transforms"),
    "tf2_msgs/msg/TFMessage": MessageType("transforms", f"{_MESSAGES}.tf:decode_transforms"),
    "diagnostic_msgs/msg/DiagnosticArray": MessageType(
        "diagnostics", "lidcam.readers.results.result:decode_diagnostics"
    ),
    "lidcam_msgs/msg/TrackArray": MessageType("tracks", f"{_MESSAGES}.objects:decode_tracks"),
}
"""By name as rosbags writes it. Decoders of one kind take and return the same: a cloud's as `decode_pointcloud2`, an
image's as `decode_image`, one of 3D boxes as `decode_detected_objects`."""


def types_of(kind: Kind) -> frozenset[str]:
    """The types of a kind."""
    return frozenset(name for name, one in TYPES.items() if one.kind == kind)


def decode_as(kind: Kind, message: RawMessage, *arguments: Any, **options: Any) -> Any:
    """The content of a message, by the decoder of its type, which gets the further arguments."""
    msgtype = message.channel.msgtype
    decoders = {name: one.decoder for name, one in TYPES.items() if one.kind == kind and ":" in one.decoder}
    if msgtype not in decoders:
        raise MessageError(f"{message.topic}: expected {' or '.join(decoders)}, found {msgtype}")
    module, _, function = decoders[msgtype].partition(":")
    return getattr(import_module(module), function)(message, *arguments, **options)
