"""The recipe of docs/architecture.md for a message type, followed with one that is thrown away."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from builders import write_mcap
from message_layouts import message_of_layout
from results import messages_of
from small_drive import small_drive

from pipeline.core.messages import RawMessage
from readers.messages.pointcloud2 import decode_pointcloud2

CLOUD = "toy_msgs/msg/Spheres"
DEFINITIONS = {
    "toy_msgs/msg/Sphere": "geometry_msgs/Point32 center\nfloat32 radius",
    CLOUD: "std_msgs/Header header\nSphere[] spheres",
}
DECODER = '''
import numpy as np

from pipeline.core.clouds import PointCloud
from pipeline.core.settings.recording import DEFAULT_LIMITS
from readers.messages.boundary.decoding import decoder
from readers.messages.deserialize import deserialize


@decoder
def decode_spheres(message, *, limits=DEFAULT_LIMITS, others=0):
    """The centre of each sphere, its radius as intensity."""
    read = deserialize(message, limits=limits)
    rows = np.array([(s.center.x, s.center.y, s.center.z, s.radius) for s in read.spheres], np.float32).reshape(-1, 4)
    none = np.zeros(len(rows), np.uint16), np.zeros(len(rows), np.int32)
    return PointCloud(message.stamp_ns, read.header.frame_id, rows[:, :3].copy(), rows[:, 3].copy(), *none)
'''
PROGRAM = """
import sys
from readers.messages.registry import TYPES, MessageType

TYPES["toy_msgs/msg/Spheres"] = MessageType("cloud", "toy_spheres:decode_spheres")
sys.argv[0] = "lidcam"
from lidcam.__main__ import main
main()
"""


def as_spheres(message: RawMessage, *, radius: str = "radius") -> RawMessage:
    """A cloud as a message of the type that is thrown away."""
    cloud = decode_pointcloud2(message)
    names = {**DEFINITIONS, "toy_msgs/msg/Sphere": f"geometry_msgs/Point32 center\nfloat32 {radius}"}
    spheres = [
        {"center": dict(zip("xyz", xyz, strict=True)), radius: strength}
        for xyz, strength in zip(cloud.xyz.tolist(), cloud.intensity.tolist(), strict=True)
    ]
    stamp = {"sec": message.stamp_ns // 10**9, "nanosec": message.stamp_ns % 10**9}
    body = {"header": {"stamp": stamp, "frame_id": cloud.frame_id}, "spheres": spheres}
    made = message_of_layout(CLOUD, names, "cdr", body, topic=message.topic, stamp_ns=message.stamp_ns)
    return made._replace(log_time_ns=message.log_time_ns)


def process(folder: Path, **options: str) -> subprocess.CompletedProcess[str]:
    """`lidcam process` with one row more in the table of message types."""
    (folder / "toy_spheres.py").write_text(DECODER, encoding="utf-8")
    drive = small_drive("cdr", motion="none", kinds=("boxes",))
    recorded = [as_spheres(one, **options) if one.topic == "/points" else one for one in drive]
    write_mcap(folder / "in.mcap", recorded)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}
    command = [sys.executable, "-c", PROGRAM, "process", "in.mcap", "out.mcap", "--workers", "1"]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)


def test_a_message_type_of_clouds(tmp_path: Path) -> None:
    done = process(tmp_path)
    assert done.returncode == 0, done.stderr
    clouds = messages_of(tmp_path / "out.mcap", "/point_cloud_combined")
    assert len(clouds) > 5
    for _, cloud in clouds:
        points = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_step)[:, :16].copy().view(np.float32)
        assert len(points) > 50
        np.testing.assert_allclose(points[:, 0], points[:, 3], atol=1e-5)  # x was recorded as the intensity


def test_a_definition_without_a_field_that_is_read(tmp_path: Path) -> None:
    done = process(tmp_path, radius="size")
    assert done.returncode == 3
    assert "/points: 12 messages dropped: cannot be decoded" in done.stderr
