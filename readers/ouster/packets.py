"""Messages with an Ouster's packets, and the sweeps that are gathered from them.

ouster_ros publishes each packet on `<sensor>/lidar_packets`, and the sensor's JSON once on `<sensor>/metadata`. A sweep
is a message of lidcam's own type, which has that JSON, too: whoever decodes it needs nothing else.
"""

import struct
from collections.abc import Sequence

import numpy as np
from rosbags.interfaces import Nodetype

from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.ros.messages import ROS2
from lidcam.readers.messages.deserialize import cursor_of, damage_told

PACKETS = ("ouster_ros/msg/PacketMsg", "ouster_sensor_msgs/msg/PacketMsg", "ouster_msgs/msg/PacketMsg")
SWEEP = "lidcam_msgs/msg/OusterSweep"

LIDAR_PACKETS, METADATA = "lidar_packets", "metadata"
"""Ends of the topics of packets and of the JSON; packets of the IMU and of zones have the same type."""

STRING = "std_msgs/msg/String"

FRAME = "os_lidar"
"""The frame in which ouster-ros publishes clouds by default: the lidar's own."""


def is_lidar_packets(channel: Channel) -> bool:
    """Whether a channel has the packets of an Ouster's lidar."""
    return channel.msgtype in PACKETS and channel.topic.endswith(LIDAR_PACKETS)


def packet_channel(topic: str) -> Channel:
    """A channel of packets that were recorded without ROS."""
    return Channel(topic, PACKETS[1], "cdr", "uint8[] buf\n", "ros2msg")


def packet_message_data(packet: bytes) -> bytes:
    """A message of `packet_channel`."""
    return b"\0\1\0\0" + struct.pack("<I", len(packet)) + packet


def sweep_channel(topic: str) -> Channel:
    """The channel of the sweeps gathered from a topic's packets."""
    return Channel(topic, SWEEP, "cdr", ROS2.definition(SWEEP))


FIELDS = [("buf", (Nodetype.SEQUENCE, ((Nodetype.BASE, ("uint8", 0)), 0)))]
"""Fields of a message with a packet, as rosbags has them: `uint8[] buf`."""


def packet_data(message: RawMessage, size: int) -> bytes:
    """The packet of a message, which has `FIELDS`."""
    cursor = cursor_of(message, *PACKETS)
    with damage_told(message):
        count = cursor.uint32()
    packet = bytes(message.data[cursor.at : cursor.at + count])
    if len(packet) != count or count not in {size, size + 1}:  # old ouster-ros adds a byte
        raise MessageError(f"{message.topic}: expected a packet of {size} bytes, found {len(packet)} of {count} bytes")
    return packet[:size]


def sweep_data(
    stamp_ns: int, begin_ns: int, frame_id: str, metadata: str, packets: Sequence[bytes | memoryview]
) -> bytes:
    """A message of `sweep_channel` from packets of one size."""
    header = ROS2.header(stamp_ns, frame_id)
    data = np.frombuffer(b"".join(packets), np.uint8)
    return ROS2.serialize(ROS2.new(SWEEP, header=header, begin_ns=begin_ns, metadata=metadata, packets=data))
