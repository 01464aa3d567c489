"""What was made of other topics is used only where these were not recorded."""

from collections.abc import Iterable
from typing import Any

import pytest
from combined_messages import CAMERAS, CLOUDS, combined
from memory_recording import MemoryRecording
from rig_messages import cloud, image_message, static

from lidcam.pipeline.core.errors import CalibrationError, RecordingError
from lidcam.pipeline.core.geometry.transform_tree import TransformTree
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.messages.tf import RecordedTransforms
from lidcam.readers.rig.discovery import Discovery, discover_rig
from lidcam.readers.rig.first_messages import FirstMessages
from lidcam.readers.rig.sensor_topics import Findings
from lidcam.readers.rig.topics.cameras import find_camera_topics
from lidcam.readers.rig.topics.lidars import find_lidar_topics
from lidcam.readers.streams.per_sensor import sensor_messages

FUSED = cloud("/point_cloud_combined", "base")
LIST = combined("/pointcloud_list", CLOUDS, [cloud("/x", "a"), cloud("/y", "b")], 9, "cdr")
IMAGES = [image_message("/x", frame, size=(6, 4)) for frame in "cd"]
VIEWS = combined("/camera_msgs_combined", CAMERAS, IMAGES, 9, "cdr")
PARTS = ["/pointcloud_list/pointcloud_1", "/pointcloud_list/pointcloud_2"]


@pytest.mark.parametrize(
    ("messages", "used"),
    [
        ([FUSED], ["/point_cloud_combined"]),
        ([FUSED, cloud("/ground_cloud")], ["/ground_cloud", "/point_cloud_combined"]),
        ([FUSED, cloud("/ground_cloud"), cloud("/velodyne1_points")], ["/velodyne1_points"]),
        ([FUSED, LIST], PARTS),
        ([LIST], PARTS),
        ([FUSED, LIST, cloud("/velodyne1_points")], ["/velodyne1_points"]),
        ([FUSED, cloud("/velodyne1_points")], ["/velodyne1_points"]),
        ([FUSED, cloud("/camera/depth/points")], ["/point_cloud_combined"]),
        ([cloud("/camera/depth/points")], []),
    ],
)
def test_lidars(messages: list[RawMessage], used: list[str]) -> None:
    recording = sensor_messages(MemoryRecording(messages))
    findings = Findings()
    topics = find_lidar_topics(
        recording, Config().topics, FirstMessages(recording), findings, RecordedTransforms(TransformTree())
    )
    assert topics == used
    assert not findings.faults
    passed_over = {info.topic for info in recording.topics} - {*used}
    assert {note.split(":")[0] for note in findings.notes} - {"lidars"} == passed_over


@pytest.mark.parametrize(
    ("messages", "used"),
    [
        ([VIEWS], ["/camera_msgs_combined/camera_1", "/camera_msgs_combined/camera_2"]),
        ([VIEWS, image_message("/image_raw_11", "c")], ["/image_raw_11"]),
    ],
)
def test_cameras(messages: list[RawMessage], used: list[str]) -> None:
    recording = sensor_messages(MemoryRecording(messages))
    cameras = find_camera_topics(recording, Config().topics, FirstMessages(recording), Findings())
    assert [camera.image for camera in cameras] == used


def discover(messages: list[RawMessage], **topics: Any) -> Discovery:
    return discover_rig(sensor_messages(MemoryRecording(messages)), Config.model_validate({"topics": topics}))


def test_the_settings_have_the_last_word() -> None:
    both = [FUSED, cloud("/lidar", "base")]
    found = discover(both, lidars=["/lidar", "/point_cloud_combined"])
    assert {lidar.topic for lidar in found.rig.lidars} == {"/lidar", "/point_cloud_combined"}
    with pytest.raises(RecordingError, match=r"topics\.exclude"):
        discover([FUSED], exclude=["/point_cloud_combined"])


@pytest.mark.parametrize(
    ("stamps_ms", "log_ms", "note"),
    [
        (range(0, 1000, 10), range(0, 1000, 10), "/points: 100 clouds per second, so each is a piece of a sweep"),
        (range(0, 1000, 33), range(0, 1000, 33), ""),  # lidars turn as fast as that
        (range(0, 2000, 100), range(20), ""),  # a converter wrote log times of its own
        ([0] * 100, range(0, 1000, 10), ""),  # without stamps
        (range(0, 100, 10), range(0, 100, 10), ""),  # too few to tell
    ],
)
def test_clouds_that_are_pieces_of_sweeps_are_told(stamps_ms: Iterable[int], log_ms: Iterable[int], note: str) -> None:
    one = cloud()
    times = [(10**18 + stamp * 10**6, 10**18 + log * 10**6) for stamp, log in zip(stamps_ms, log_ms, strict=True)]
    found = discover([one._replace(stamp_ns=stamp_ns, log_time_ns=log_ns) for stamp_ns, log_ns in times])
    assert [text.split(";")[0] for text in found.notes] == [note] * bool(note)


def test_an_empty_list_of_topics_is_none_and_null_is_all() -> None:
    recorded = [cloud("/a"), static(("lidar", "c", (1, 0, 0))), image_message("/image_raw", "c")]
    assert [fault.sensor for fault in discover(recorded, cameras=None).faults] == ["camera"]  # has no calibration
    found = discover(recorded, cameras=[])
    assert found.notes == ("topics.cameras is empty: no camera is used",)
    assert not found.faults
    with pytest.raises(CalibrationError, match=r"topics\.lidars: \[\]`, no lidar: name one"):
        discover(recorded, lidars=[])
