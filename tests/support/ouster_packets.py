"""Packets of Ouster lidars, written by Ouster's own library from frames of random ranges."""

import json
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from builders import Encoding, raw

from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.ouster.sensor import missing_sdk, sdk

needs_sdk = pytest.mark.skipif(bool(missing_sdk()), reason=missing_sdk())

BOOT_NS, START_NS, TURN_NS = 50_000_000_000, 1_700_000_000_000_000_000, 100_000_000
TOPIC = "/ouster/lidar_packets"


@lru_cache
def metadata(
    profile: str = "RNG19_RFL8_SIG16_NIR16", serial: str = "122247000001", mode: str = "INTERNAL_OSC", port: int = 7502
) -> str:
    """The JSON of an OS-1-64 with 1024 columns at 10 Hz."""
    core = sdk()
    found = json.loads(core.SensorInfo.from_default(core.LidarMode._1024x10).to_json_string())
    found["config_params"] |= {"udp_port_lidar": port, "udp_port_imu": 7503, "timestamp_mode": f"TIME_FROM_{mode}"}
    found["config_params"]["udp_profile_lidar"] = found["lidar_data_format"]["udp_profile_lidar"] = profile
    found["sensor_info"] |= {"build_rev": "v3.1.0", "prod_sn": serial, "initialization_id": 7109744}
    return json.dumps(found)


def frame(text: str, number: int = 0, begin_ns: int = BOOT_NS, columns: slice = slice(None)) -> Any:
    """One turn as Ouster's library holds it: every third beam has no return; the columns have been measured."""
    core = sdk()
    info = core.SensorInfo(text)
    found, chance = core.LidarFrame(info), np.random.default_rng(number)
    ranges = chance.integers(1000, 30_000, (found.h, found.w)) * (chance.random((found.h, found.w)) > 0.3)
    found.field("RANGE")[:, columns] = (ranges // 8 * 8)[:, columns]  # the steps of the smallest profile
    found.field("REFLECTIVITY")[:, columns] = chance.integers(1, 256, (found.h, found.w))[:, columns]
    if found.has_field("SIGNAL"):
        found.field("SIGNAL")[:, columns] = chance.integers(1, 5000, (found.h, found.w))[:, columns]
    found.measurement_id[:] = np.arange(found.w)
    found.status[columns] = 1
    found.timestamp[columns] = (begin_ns + np.rint(np.arange(found.w) * TURN_NS / found.w).astype(np.uint64))[columns]
    found.frame_id = number
    return found


def packets(text: str, turn: Any) -> list[bytes]:
    """The packets of a turn."""
    core = sdk()
    info = core.SensorInfo(text)
    sent = core.frame_to_packets(turn, core.PacketFormat(info), info.init_id, int(info.sn))
    return [one.buf.tobytes() for one in sent if isinstance(one, core.LidarPacket)]


def recorded(
    sent: list[bytes],
    begin_ns: int = START_NS,
    topic: str = TOPIC,
    package: str = "ouster_sensor_msgs",
    encoding: Encoding = "cdr",
    order: int = 0,
) -> list[RawMessage]:
    """The messages of packets that are received evenly over a turn."""
    step_ns = TURN_NS // max(len(sent), 1)
    messages = (
        raw(topic, f"{package}/msg/PacketMsg", {"buf": np.frombuffer(one, np.uint8)}, at_ns, encoding=encoding)
        for at_ns, one in enumerate(sent)
    )
    times = (begin_ns + index * step_ns for index in range(len(sent)))
    return [
        message._replace(stamp_ns=at_ns, log_time_ns=at_ns, order=(0, order + index))
        for index, (message, at_ns) in enumerate(zip(messages, times, strict=True))
    ]


def description(text: str, topic: str = "/ouster/metadata", encoding: Encoding = "cdr") -> RawMessage:
    """The message with a sensor's JSON."""
    return raw(topic, "std_msgs/msg/String", {"data": text}, START_NS - 1, encoding=encoding, order=(0, -1))


def drive(text: str, turns: int = 3, clock_ns: int = BOOT_NS, **options: Any) -> list[RawMessage]:
    """The JSON and the packets of some turns."""
    encoding, messages = options.get("encoding", "cdr"), []
    for number in range(turns):
        turn = frame(text, number, clock_ns + number * TURN_NS)
        messages += recorded(packets(text, turn), START_NS + number * TURN_NS, order=1000 * number, **options)
    space = options.get("topic", TOPIC).rpartition("/")[0]
    return [description(text, f"{space}/metadata", encoding), *messages]
