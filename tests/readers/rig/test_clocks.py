import pytest
from builders import odometry, raw
from memory_recording import MemoryRecording
from rig_messages import cloud, discover, image_message, info

from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.rig.clocks import clock_offsets, usual_delay_ns
from lidcam.readers.streams.motion import find_motion_source

S = 10**9
NOW_NS = 1_700_000_000 * S
BOOT_NS = NOW_NS - 40 * S
"""Offset of a clock that counts from 40 s before the recording."""


@pytest.mark.parametrize(
    ("delays_s", "usual_s"),
    [
        ([], 0),
        ([3], 3),
        ([0.1, 0.05, 60], 0.1),
        ([1.7e9, 1.7e9, 0.1], 0.1),  # two clocks that were not set
        ([1.7e9, 1.7e9], 1.7e9),  # simulated time
        ([-50, -50, 80], -50),
    ],
)
def test_usual_delay(delays_s: list[float], usual_s: float) -> None:
    assert usual_delay_ns(round(one * S) for one in delays_s) == round(usual_s * S)


def at(message: RawMessage, index: int, *, behind_ns: int, late_ns: int = 0) -> RawMessage:
    log_ns = NOW_NS + index * S // 10
    return message._replace(stamp_ns=log_ns - late_ns - behind_ns, log_time_ns=log_ns)


@pytest.mark.parametrize(
    ("behind_s", "offset_s"),
    [
        ([0] * 5, None),
        ([60], -60),
        ([60, 60.1, 60, 59.9, 60.05], -60),
        ([-60] * 9, 60),
        ([60, 0, 0, 0], None),  # set after the first message
        ([5] * 5, None),  # may be recorded late
    ],
)
def test_offset_of_a_steady_clock(behind_s: list[float], offset_s: float | None) -> None:
    messages = [at(cloud("/a"), row, behind_ns=round(one * S)) for row, one in enumerate(behind_s)]
    found = clock_offsets(MemoryRecording(messages), {"/a": messages[0].log_time_ns - messages[0].stamp_ns}, 0)
    assert found == ({} if offset_s is None else {"/a": pytest.approx(offset_s * S, abs=S // 50)})


@pytest.mark.parametrize("first_ns", [None, 0])
def test_a_clock_beside_sensors_without_stamps(first_ns: int | None) -> None:
    """Of those, the times at which messages were recorded are used; a first stamp of 0 is none."""
    images = [at(image_message("/cam/image_raw", "cam"), row, behind_ns=0)._replace(stamp_ns=0) for row in range(5)]
    clouds = [at(cloud("/points"), row, behind_ns=BOOT_NS) for row in range(5)]
    clouds[0] = clouds[0] if first_ns is None else clouds[0]._replace(stamp_ns=first_ns)
    file = {"site_frame": "lidar", "cameras": {"cam": {"T_camera_site": EXTRINSICS}}}
    messages = [at(info("/cam/camera_info", "cam"), 0, behind_ns=0), *images, *clouds]
    (lidar,) = discover(messages, file).rig.lidars
    assert lidar.time_offset_ns == -BOOT_NS


EXTRINSICS = [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
ODOM = raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=5, child_frame_id="lidar"), 5)


@pytest.mark.parametrize(
    ("behind_ns", "rig", "moved"),
    [
        ({}, {}, {}),
        ({"/points": BOOT_NS, "/odom": BOOT_NS}, {}, {"lidar": -BOOT_NS, "odom": -BOOT_NS}),
        ({"/cam/image_raw": 60 * S}, {}, {"cam": -60 * S}),
        ({"/cam/image_raw": 60 * S}, {"time_offset_ms": 0}, {}),  # as given
        ({"/cam/image_raw": 60 * S, "/points": 60 * S, "/odom": 60 * S}, {}, {}),  # all alike
    ],
)
def test_clocks_of_a_recording(behind_ns: dict[str, int], rig: dict[str, int], moved: dict[str, int]) -> None:
    sensors = cloud("/points"), image_message("/cam/image_raw", "cam"), ODOM
    messages = [at(info("/cam/camera_info", "cam"), 0, behind_ns=0)]
    messages += [at(one, row, behind_ns=behind_ns.get(one.topic, 0)) for row in range(5) for one in sensors]
    found = discover(messages, {"site_frame": "lidar", "cameras": {"cam": {"T_camera_site": EXTRINSICS, **rig}}})
    recording, delay_ns = MemoryRecording(messages), found.usual_delay_ns
    motion = find_motion_source(recording, found.rig, found.transforms, Config(), usual_delay_ns=delay_ns)
    assert motion is not None
    offsets_ns = {one.name: one.time_offset_ns for one in found.rig.lidars}
    offsets_ns |= {one.name: one.time_offset_ns for one in found.rig.cameras}
    assert {name: ns for name, ns in (offsets_ns | {"odom": motion.offset_ns}).items() if ns} == moved
    assert {one.sensor: round(one.time_offset_ms * 1e6) for one in found.sources} == offsets_ns
    assert [note.split(":")[0] for note in found.notes if "its clock is" in note] == [*moved][:1]
