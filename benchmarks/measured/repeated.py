"""Recordings of any length: a ROS 1 recording several times in a row."""

import struct
from pathlib import Path

from rosbags.rosbag1 import Reader, Writer

WITHOUT_HEADER = {"tf2_msgs/msg/TFMessage", "std_msgs/msg/Float64"}
"""Types of the recordings here that do not begin with a header."""

PAUSE_NS = 100_000_000
"""Pause between the last message and the first of the next time."""


def repeated(recording: Path, times: int, out: Path) -> Path:
    """Write a ROS 1 recording played several times in a row to `out`, stamps and log times moved on."""
    with Reader(recording) as reader, Writer(out) as writer:
        span_ns = reader.end_time - reader.start_time + PAUSE_NS
        connections = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, md5sum=c.digest)
            for c in reader.connections
        }
        for turn in range(times):
            shift_ns = turn * span_ns
            for connection, log_ns, data in reader.messages():
                if connection.msgtype not in WITHOUT_HEADER:
                    seconds, nanoseconds = struct.unpack_from("<II", data, 4)
                    stamp_ns = seconds * 10**9 + nanoseconds + shift_ns
                    data = data[:4] + struct.pack("<II", *divmod(stamp_ns, 10**9)) + data[12:]
                writer.write(connections[connection.id], log_ns + shift_ns, data)
    return out
