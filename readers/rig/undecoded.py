"""Data of lidars that lidcam does not decode: what they are, and what can be done.

Hesai's and RoboSense's packets need the correction file of each unit, and have no well-kept library in Python
(hydra4 0.2 on PyPI reads two models of Hesai). Their own drivers, and Nebula, make clouds of recorded packets.
"""

import re
from collections.abc import Iterable

from lidcam.readers.ouster.packets import PACKETS as OUSTER_PACKETS
from lidcam.readers.recording import Recording, TopicInfo

_NEBULA = "play the recording into Nebula (launch_hw:=false) and record its PointCloud2"
_HESAI = (
    "play the recording into Hesai's ROS driver (source_type: 3, with the correction file) and record /lidar_points"
)
_PANDAR = "play the recording into Nebula (launch_hw:=false) or Hesai's ROS driver and record its PointCloud2"
_ROBOSENSE = "play the recording into rslidar_sdk (msg_source: 2) and record /rslidar_points"
_SEYOND = "turn them into PointCloud2 with Tier IV's bag_converter, or play the recording into Seyond's ROS driver"
_OUSTER = "rename the topic to .../lidar_packets, beside .../metadata (ros2 bag play --remap)"
_FLAT = "scans of a 2D lidar", "lidcam needs the clouds of a 3D one"

UNDECODED = {
    "hesai_lidar/msg/PandarScan": ("packets of a Hesai", _PANDAR),
    "hesai_ros_driver/msg/UdpFrame": ("packets of a Hesai", _HESAI),
    "innovusion_msgs/msg/InnovusionScan": ("packets of a Seyond", _NEBULA),
    "nebula_msgs/msg/NebulaPackets": ("packets of a lidar, by Nebula", _NEBULA),
    "ouster_msgs/msg/OusterScan": ("packets of an Ouster, by Nebula", _NEBULA),
    **dict.fromkeys(OUSTER_PACKETS, ("packets of an Ouster", _OUSTER)),
    "pandar_msgs/msg/PandarScan": ("packets of a Hesai", _PANDAR),
    "robosense_msgs/msg/RobosenseScan": ("packets of a RoboSense", _NEBULA),
    "rslidar_msg/msg/RslidarPacket": ("packets of a RoboSense", _ROBOSENSE),
    "rslidar_msg/msg/RslidarScan": ("packets of a RoboSense", _ROBOSENSE),
    "rslidar_msg/msg/rslidarScan": ("packets of a RoboSense", _ROBOSENSE),
    "rslidar_msgs/msg/rslidarScan": ("packets of a RoboSense", _ROBOSENSE),
    "rslidar_msgs/msg/RslidarScan": ("packets of a RoboSense", _ROBOSENSE),
    "sensor_msgs/msg/LaserScan": _FLAT,
    "sensor_msgs/msg/MultiEchoLaserScan": _FLAT,
    "seyond/msg/SeyondScan": ("packets of a Seyond", _SEYOND),
}
"""Content of the messages, and the remedy, by type."""


HESAI = {
    b"\xee\xff\x01\x03": "Pandar128",
    b"\xee\xff\x01\x04": "Pandar128 or OT128",
    b"\xee\xff\x01\x08": "JT16",
    b"\xee\xff\x03\x01": "PandarQT",
    b"\xee\xff\x03\x02": "QT128",
    b"\xee\xff\x04\x01": "AT128",
    b"\xee\xff\x04\x03": "AT128",
    b"\xee\xff\x04\x07": "ATX",
    b"\xee\xff\x06\x01": "PandarXT",
    b"\xee\xff\x07\x02": "FT120",
    b"\xee\xff\x40\x06": "Pandar64",
}
"""Models by the first bytes of a packet: those of the protocol and its version.

Source: UdpParser of github.com/HesaiTechnology/HesaiLidar_SDK_2.0; a Pandar64's have the numbers of lasers and blocks.
"""

ROBOSENSE = re.compile(rb"\x55\xaa\x05(?:\x0a\x5a\xa5\x50\xa0.{22}|\x5a.{27})(.)", re.DOTALL)
ROBOSENSE_MODELS = (
    "",
    "RS-LiDAR-16",
    "RS-LiDAR-32",
    "RS-Bpearl",
    "RS-Ruby",
    "RS-Ruby Lite or Plus",
    "RS-Helios",
    "RS-Helios-16P",
)
"""Models by the byte behind the head of a packet (manuals of RS-Bpearl and RS-Helios, section MSOP)."""

LOOKED_AT = 512
"""Number of bytes of a message in which its first packet begins."""


def undecoded(recording: Recording, topics: Iterable[TopicInfo]) -> list[str]:
    """A line for each of the topics with such messages, with the model of the lidar where its packets say it."""
    return [
        f"{info.topic}: {_named(what, recording, info.topic)} ({info.msgtype.replace('/msg/', '/')}), which lidcam "
        f"does not read; {remedy}"
        for info in topics
        if info.message_count and info.msgtype in UNDECODED and not info.topic.endswith("/imu_packets")
        for what, remedy in [UNDECODED[info.msgtype]]
    ]


def _named(what: str, recording: Recording, topic: str) -> str:
    """`what`, with the model that the topic's first message is of."""
    message = next(recording.messages([topic]), None)
    head = b"" if message is None else bytes(message.data[:LOOKED_AT])
    model = next((f"Hesai {name}" for start, name in HESAI.items() if start in head), "")
    found = ROBOSENSE.search(head)
    if found and 0 < (number := found[1][0]) < len(ROBOSENSE_MODELS):
        model = f"RoboSense {ROBOSENSE_MODELS[number]}"
    return re.sub(r"of a \w+", f"of a {model}", what) if model else what
