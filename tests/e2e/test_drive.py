"""`lidcam drive` by a script of keys; tests/bags/simulator/drive has a terminal."""

from pathlib import Path
from typing import Any

from command import Lidcam
from rosbags.highlevel import AnyReader
from small_scenario import write_small_scenario

from lidcam.pipeline.core.ros.typestores import message_types

LIDAR_ALONE: dict[str, Any] = {"cameras": {}}
"""One sensor is measured without another process, which takes three seconds to start."""


def drives(path: Path, car: str) -> list[tuple[float, float]]:
    """Speed and steering of a car's commands, each once as long as it holds."""
    with AnyReader([path], default_typestore=message_types(1)) as reader:
        wanted = [c for c in reader.connections if c.topic == f"/{car}/ackermann_cmd_mux/output"]
        found: list[Any] = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(wanted)]
    told = [
        (round(float(one.speed), 3), round(float(one.steering_angle), 3))
        for one in (message.drive for message in found)
    ]
    return [one for number, one in enumerate(told) if number == 0 or told[number - 1] != one]


def test_scripted_keys_give_the_same_bytes_each_time(lidcam: Lidcam, tmp_path: Path) -> None:
    scenario = write_small_scenario(tmp_path / "small.yaml", **LIDAR_ALONE)
    for name in ("a.mcap", "b.mcap"):
        done = lidcam("drive", scenario, tmp_path / name, "--keys", "wa2w", "--key-interval", 0.3)
        assert done.code == 0, done.err
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    done = lidcam("drive", scenario, tmp_path / "c.bag", "--keys", "wdoww", "--key-interval", 0.3)
    assert done.code == 0, done.err
    assert "0.6 s" in done.err  # nothing after the key to quit
    assert drives(tmp_path / "c.bag", "car1") == [(0.3, 0.0), (0.3, -0.49)]
