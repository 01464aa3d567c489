"""Message definitions for recordings that carry none (sqlite3 before ROS 2 Iron), beyond those that rosbags brings."""

from functools import lru_cache

from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from pipeline.core.messages import Channel

__all__ = ["COMBINED_TYPES", "VELODYNE_MSGS", "VIDEO_TYPES", "release_types"]

# The original system's own.
COMBINED_TYPES = {
    "msgs/msg/MsgCamera": "std_msgs/Header header\nsensor_msgs/Image[] camera",
    "msgs/msg/ListPointCloud": "std_msgs/Header header\nsensor_msgs/PointCloud2[] pointcloud",
}

VELODYNE_MSGS = {
    "VelodyneScan": "std_msgs/Header header\nVelodynePacket[] packets",
    "VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data",
}

VIDEO_TYPES = {
    "foxglove_msgs/msg/CompressedVideo": (
        "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format"
    ),
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": (
        "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\n"
        "bool is_bigendian\nuint8[] data"
    ),
}

# vision_msgs 4, as in Humble and later; earlier releases laid hypotheses and 2D boxes out differently.
VISION_MSGS = {
    "Point2D": "float64 x\nfloat64 y",
    "Pose2D": "vision_msgs/Point2D position\nfloat64 theta",
    "BoundingBox2D": "vision_msgs/Pose2D center\nfloat64 size_x\nfloat64 size_y",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": "ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose",
    "Detection2D": "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox2D bbox\nstring id",
    "Detection2DArray": "std_msgs/Header header\nDetection2D[] detections",
    "Detection3D": "std_msgs/Header header\nObjectHypothesisWithPose[] results\nBoundingBox3D bbox\nstring id",
    "Detection3DArray": "std_msgs/Header header\nDetection3D[] detections",
}
BEFORE_VISION_MSGS_4 = {"crystal", "bouncy", "dashing", "eloquent", "foxy", "galactic"}


def release_types(channel: Channel) -> Typesdict:
    """The types of the ROS release that recorded the channel: the one it names, else Noetic or Humble."""
    return _release_types(channel.encoding, channel.distro.lower())


@lru_cache(maxsize=16)
def _release_types(encoding: str, distro: str) -> Typesdict:
    ros2 = next((store for store in Stores if store.value == f"ros2_{distro}"), Stores.ROS2_HUMBLE)
    types = dict(get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else ros2).fielddefs)
    for name, text in (COMBINED_TYPES | VIDEO_TYPES).items():
        types |= get_types_from_msg(text, name)
    for name, text in VELODYNE_MSGS.items():
        types |= get_types_from_msg(text, f"velodyne_msgs/msg/{name}")
    if encoding == "ros1":
        return types
    if distro not in BEFORE_VISION_MSGS_4:
        for name, text in VISION_MSGS.items():
            types |= get_types_from_msg(text, f"vision_msgs/msg/{name}")
    return types
