"""Data of lidars that lidcam does not decode: what they are, and what can be done.

Hesai's and RoboSense's packets need the correction file of each unit, and have no well-kept library in Python
(hydra4 0.2 on PyPI reads two models of Hesai). Their own drivers, and Nebula, make clouds of recorded packets.
"""

from collections.abc import Iterable

from lidcam.readers.recording import TopicInfo

_NEBULA = "play the recording into Nebula (launch_hw:=false) and record its PointCloud2"
_HESAI = (
    "packets of a Hesai",
    "play the recording into Hesai's ROS driver (source_type: 3, with the correction file) and record /lidar_points",
)
_PANDAR = (
    "packets of a Hesai",
    "play the recording into Nebula (launch_hw:=false) or Hesai's ROS driver and record its PointCloud2",
)
_ROBOSENSE = (
    "packets of a RoboSense",
    "play the recording into rslidar_sdk (msg_source: 2) and record /rslidar_points",
)
_SEYOND = (
    "packets of a Seyond",
    "turn them into PointCloud2 with Tier IV's bag_converter, or play the recording into Seyond's ROS driver",
)
_FLAT = ("scans of a 2D lidar", "lidcam needs the clouds of a 3D one")

UNDECODED = {
    "hesai_lidar/msg/PandarScan": _PANDAR,
    "hesai_ros_driver/msg/UdpFrame": _HESAI,
    "innovusion_msgs/msg/InnovusionScan": ("packets of a Seyond", _NEBULA),
    "nebula_msgs/msg/NebulaPackets": ("packets of a lidar, by Nebula", _NEBULA),
    "ouster_msgs/msg/OusterScan": ("packets of an Ouster, by Nebula", _NEBULA),
    "pandar_msgs/msg/PandarScan": _PANDAR,
    "robosense_msgs/msg/RobosenseScan": ("packets of a RoboSense", _NEBULA),
    "rslidar_msg/msg/RslidarPacket": _ROBOSENSE,
    "rslidar_msg/msg/RslidarScan": _ROBOSENSE,
    "rslidar_msg/msg/rslidarScan": _ROBOSENSE,
    "rslidar_msgs/msg/rslidarScan": _ROBOSENSE,
    "sensor_msgs/msg/LaserScan": _FLAT,
    "sensor_msgs/msg/MultiEchoLaserScan": _FLAT,
    "seyond/msg/SeyondScan": _SEYOND,
}
"""What the messages of a type are, and what to do, by type."""


def undecoded(topics: Iterable[TopicInfo]) -> list[str]:
    """A line for each of the topics with such messages."""
    return [
        f"{info.topic}: {what} ({info.msgtype.replace('/msg/', '/')}), which lidcam does not read; {remedy}"
        for info in topics
        if info.message_count and info.msgtype in UNDECODED
        for what, remedy in [UNDECODED[info.msgtype]]
    ]
