"""Sweeps of Ouster packets; Ouster's own library, which makes points of whole frames, is the judge."""

import sqlite3
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import Encoding, pointcloud2, raw, tf_message, transform_stamped, write_mcap
from captures import ethernet, fragments, ip_packet, pcap
from memory_recording import MemoryRecording
from ouster_packets import (
    BOOT_NS,
    START_NS,
    TOPIC,
    TURN_NS,
    description,
    drive,
    frame,
    metadata,
    needs_sdk,
    packets,
    recorded,
)

from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.open import open_recording
from lidcam.readers.ouster import sensor
from lidcam.readers.ouster.decoder import decode_ouster
from lidcam.readers.ouster.description import ports
from lidcam.readers.ouster.packets import SWEEP
from lidcam.readers.rig.discovery import Discovery, discover_rig
from lidcam.readers.streams.per_sensor import sensor_messages

PROFILES = ["LEGACY", "RNG19_RFL8_SIG16_NIR16", "RNG19_RFL8_SIG16_NIR16_DUAL", "RNG15_RFL8_NIR8"]


def sweeps(messages: list[RawMessage], **window: Any) -> list[RawMessage]:
    with sensor_messages(MemoryRecording(messages)) as recording:
        return [one for one in recording.messages(**window) if one.channel.msgtype == SWEEP]


def discover(messages: list[RawMessage]) -> Discovery:
    with sensor_messages(MemoryRecording(messages)) as recording:
        return discover_rig(recording, Config())


def judged(text: str, turn: Any) -> dict[str, Any]:
    """The points of a frame by Ouster's library, moved from the sensor's frame to the lidar's, in ouster-ros' order."""
    core = sensor.sdk()
    info = core.SensorInfo(text)
    shape = (turn.h, turn.w)
    to_sensor = info.lidar_to_sensor_transform * np.array([[1, 1, 1, 1e-3]] * 3 + [[1] * 4])
    points = core.dewarp(core.XYZLut(info)(turn), np.broadcast_to(np.linalg.inv(to_sensor), (turn.w, 4, 4)).copy())
    times = np.broadcast_to((turn.timestamp - turn.timestamp[0]).astype(np.int64), shape)
    columns = {"xyz": points, "time_offset_ns": times, "intensity": turn.field("REFLECTIVITY").astype(float)}
    columns["signal"] = turn.field("SIGNAL" if turn.has_field("SIGNAL") else "REFLECTIVITY").astype(float)
    columns["ring"] = np.broadcast_to(np.arange(turn.h)[:, None], shape)
    hit = core.destagger(info, turn.field("RANGE").astype(np.uint32)) > 0
    return {name: core.destagger(info, np.ascontiguousarray(one))[hit] for name, one in columns.items()}


def same(found: PointCloud, expected: dict[str, Any]) -> None:
    np.testing.assert_allclose(found.xyz, expected["xyz"], rtol=0, atol=1e-5)
    for name in ("time_offset_ns", "intensity", "ring"):
        np.testing.assert_array_equal(getattr(found, name), expected[name])


@needs_sdk
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(
    ("package", "encoding"), [("ouster_ros", "ros1"), ("ouster_ros", "cdr"), ("ouster_sensor_msgs", "cdr")]
)
def test_points_and_times_are_those_of_ousters_library(profile: str, package: str, encoding: Encoding) -> None:
    text = metadata(profile)
    found = sweeps(drive(text, package=package, encoding=encoding))
    assert [one.stamp_ns for one in found] == [START_NS, START_NS + TURN_NS, START_NS + 2 * TURN_NS]
    for number, sweep in enumerate(found):
        cloud = decode_ouster(sweep)
        assert (cloud.frame_id, cloud.stamp_ns, cloud.has_time) == ("os_lidar", sweep.stamp_ns, True)
        assert len(cloud) + cloud.nan_dropped == 64 * 1024
        expected = judged(text, frame(text, number, BOOT_NS + number * TURN_NS))
        same(cloud, expected)
        np.testing.assert_array_equal(decode_ouster(sweep, calibrated=False).intensity, expected["signal"])


@needs_sdk
@pytest.mark.parametrize(
    ("mode", "clock_ns", "stamp_ns"),
    [
        ("INTERNAL_OSC", BOOT_NS, START_NS),  # it counts from when it was switched on
        ("SYNC_PULSE_IN", START_NS - 20_000_000, START_NS - 20_000_000),
        ("PTP_1588", START_NS - 20_000_000, START_NS - 20_000_000),
        ("PTP_1588", START_NS + 36_980_000_000, START_NS - 20_000_000),  # atomic time
    ],
)
def test_stamps_are_by_the_sensors_clock_if_it_was_set(mode: str, clock_ns: int, stamp_ns: int) -> None:
    assert sweeps(drive(metadata(mode=mode), clock_ns=clock_ns))[0].stamp_ns == stamp_ns


@needs_sdk
def test_a_turn_that_lacks_its_begin_has_its_times() -> None:
    text = metadata()
    turn = frame(text)
    [sweep] = sweeps([description(text), *recorded(packets(text, turn)[20:], START_NS + 31_250_000)])
    cloud = decode_ouster(sweep)
    assert sweep.stamp_ns == START_NS
    assert cloud.time_offset_ns.min() == 31_250_000
    expected = judged(text, turn)
    later = expected["time_offset_ns"] >= 31_250_000
    same(cloud, {name: one[later] for name, one in expected.items()})


@needs_sdk
def test_a_window_has_whole_turns() -> None:
    messages = drive(metadata(), 6)
    every = sweeps(messages)
    window = sweeps(messages, start_ns=START_NS + 150_000_000, stop_ns=START_NS + 450_000_000)
    assert window == [one for one in every if START_NS + 150_000_000 <= one.log_time_ns < START_NS + 450_000_000]


@needs_sdk
def test_packets_that_cannot_be_used_are_counted() -> None:
    text = metadata()
    (first, second), other = (packets(text, frame(text, number)) for number in (0, 1)), b"short"
    messages = recorded([*first[:10], other, *first[10:], second[0], first[0], *second[1:], second[5] + b"\0"])
    one, two = sweeps([description(text), *messages])
    assert [len(sweep.defects) for sweep in (one, two)] == [1, 1]
    assert "expected a packet of 12544 bytes, found 5 of 5 bytes" in one.defects[0]
    assert "a packet of turn 0 within turn 1" in two.defects[0]
    same(decode_ouster(one), judged(text, frame(text)))


@needs_sdk
def test_damaged_and_hostile_sweeps() -> None:
    sweep = sweeps(drive(metadata(), 1))[0]
    for end in range(0, len(sweep.data), 40_001):
        with pytest.raises(MessageError, match=TOPIC):
            decode_ouster(sweep._replace(data=sweep.data[:end]))
    with pytest.raises(MessageError, match="64 x 1024 points, expected at most 50000"):
        decode_ouster(sweep, limits=RecordingLimits(max_points=50_000))
    for text in ("", "{}", "[1]", "{" * 5000, "x" * (1 << 19)):
        found = discover_fault([description(text), *drive(metadata(), 1)[1:]])
        assert "expected the JSON of an Ouster" in found


@needs_sdk
@pytest.mark.parametrize("profile", PROFILES)
def test_any_bytes_are_counted_or_decoded(profile: str) -> None:
    text, chance = metadata(profile), np.random.default_rng(0)
    sent = packets(text, frame(text))[::8]
    for _ in range(40):
        damaged = [bytearray(one) for one in sent]
        for one in damaged:
            for at in chance.integers(0, 64, 4):
                one[at] = int(chance.integers(256))
        for sweep in sweeps([description(text), *recorded([bytes(one) for one in damaged])]):
            with suppress(MessageError):
                assert np.isfinite(decode_ouster(sweep).xyz).all()


def discover_fault(messages: list[RawMessage]) -> str:
    """Why the Ouster beside another lidar is left out."""
    other = raw("/other", "sensor_msgs/msg/PointCloud2", pointcloud2(np.eye(3), stamp_ns=START_NS), START_NS)
    [fault] = discover([other, *messages]).faults
    return fault.reason


@needs_sdk
def test_packets_without_their_json_are_left_out_with_a_line() -> None:
    messages = drive(metadata(), 1)[1:]
    assert "without its JSON, which ouster-ros publishes on /ouster/metadata: put it" in discover_fault(messages)


def test_without_ousters_library_a_lidar_is_left_out_with_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sensor, "version", lambda _: "0.13.1")
    messages = recorded([bytes(100)])
    assert "need its library: pip install --no-deps 'ouster-sdk>=1.0'" in discover_fault(messages)
    cloud = raw("/ouster/points", "sensor_msgs/msg/PointCloud2", pointcloud2(np.eye(3), stamp_ns=START_NS), START_NS)
    found = discover([cloud, *messages])
    assert [lidar.topic for lidar in found.rig.lidars] == ["/ouster/points"]
    assert f"{TOPIC}: packets of the same lidar as /ouster/points, not used" in found.notes


@needs_sdk
def test_the_json_beside_a_recording_is_found_by_its_serial_number(tmp_path: Path) -> None:
    mine, other = metadata(serial="122247000001"), metadata(serial="99")
    for name, text in (("drive_0.json", other), ("drive_1.json", mine), ("else.json", mine)):
        (tmp_path / name).write_text(text)
    write_mcap(tmp_path / "drive.mcap", drive(mine, 2)[1:])
    with sensor_messages(open_recording([tmp_path / "drive.mcap"])) as recording:
        clouds = [decode_ouster(one) for one in recording.messages([TOPIC])]
    same(clouds[0], judged(mine, frame(mine)))
    (tmp_path / "drive_1.json").unlink()
    with sensor_messages(open_recording([tmp_path / "drive.mcap"])) as recording:
        [info] = recording.topics
    assert info.unreadable == "packets of an Ouster that drive_0.json beside the recording does not describe"


def test_a_json_beside_a_capture_that_is_no_description(tmp_path: Path) -> None:
    for name, text in (("deep", "[" * 100_000), ("none", "no JSON"), ("list", "[1]")):
        (tmp_path / f"drive_{name}.json").write_text(text)
    assert ports(tmp_path / "drive.pcap") == {7502}


def captured(text: str, turns: int = 2, port: int = 7502) -> list[tuple[int, bytes]]:
    """What a sensor sends in some turns: each packet is too long for a frame of Ethernet."""
    frames, number = list[tuple[int, bytes]](), 0
    for turn in range(turns):
        for data in packets(text, frame(text, turn, BOOT_NS + turn * TURN_NS)):
            parts = fragments(ip_packet(data, "192.168.1.5", port, id=number % 0xFFFF))
            frames += [(START_NS + number * 1_562_500 + index, part) for index, part in enumerate(parts)]
            number += 1
    return frames


@needs_sdk
@pytest.mark.parametrize("port", [7502, 7602])
def test_captures(tmp_path: Path, port: int) -> None:
    text = metadata(port=port)
    frames = captured(text, port=port)
    swapped = [*frames[3:0:-1], frames[0], *frames[4:-1]]  # fragments in any order, and one is missing
    (tmp_path / "drive.json").write_text(text)
    foreign = [
        (START_NS - 2, ethernet(ip_packet(bytes(size), "192.168.1.5", port))) for size in (48, 200)
    ]  # IMU, damage
    (tmp_path / "drive.pcap").write_bytes(pcap([*foreign, *swapped]))
    with sensor_messages(open_recording([tmp_path / "drive.pcap"])) as recording:
        clouds = [decode_ouster(one) for one in recording.messages()]
        topics = {info.topic: info.message_count for info in recording.topics}
        rig = discover_rig(recording, Config()).rig
    name = "ouster_192_168_1_5" + ("" if port == 7502 else "_7602")
    assert topics == {f"/{name}/lidar_packets": 128, "/other_traffic/fragments": 8, "/other_traffic/other_size": 1}
    assert [(one.name, one.T_site_lidar.src) for one in rig.lidars] == [(name, "os_lidar")]
    core = sensor.sdk()
    source = import_module("ouster.sdk").open_source(str(tmp_path / "drive.pcap"), meta=[str(tmp_path / "drive.json")])
    judges = [one for frame_set in source for one in frame_set if one is not None]
    assert len(clouds) == len(judges) == 2
    for cloud, judge in zip(clouds, judges, strict=True):
        assert isinstance(judge, core.LidarFrame)
        same(cloud, judged(text, judge))


@needs_sdk
def test_lidars_of_a_robot() -> None:
    text = metadata()
    tree = tf_message([transform_stamped("os_sensor", "os_lidar", stamp_ns=START_NS)])
    single = discover([raw("/tf_static", "tf2_msgs/msg/TFMessage", tree, START_NS), *drive(text, 1)])
    assert [(one.name, one.T_site_lidar.src) for one in single.rig.lidars] == [("ouster", "os_lidar")]
    assert single.rig.site_frame == "os_sensor"
    cloud = pointcloud2(np.eye(3), stamp_ns=START_NS, frame_id="os_lidar")
    both = discover([*drive(text, 1), raw("/points", "sensor_msgs/msg/PointCloud2", cloud, START_NS)])
    assert [lidar.topic for lidar in both.rig.lidars] == ["/points"]
    pair = sweeps([*drive(text, 1, topic="/left/lidar_packets"), *drive(text, 1, topic="/right/lidar_packets")])
    assert {decode_ouster(one).frame_id for one in pair} == {"left/os_lidar", "right/os_lidar"}


@needs_sdk
def test_the_library_changes_nothing_of_sqlite() -> None:
    sensor.sdk()
    assert sqlite3.connect.__module__ in {"sqlite3", "_sqlite3"}
