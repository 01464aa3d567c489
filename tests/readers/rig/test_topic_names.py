import pytest
from hypothesis import given
from hypothesis import strategies as st

from lidcam.readers.rig.topic_names import is_truth, sensor_names

TOPIC = st.from_regex(r"(/[a-z0-9_]{1,8}){1,4}", fullmatch=True)


@pytest.mark.parametrize(
    ("topics", "kind", "names"),
    [
        ([], "lidar", []),
        (["/velodyne_points"], "lidar", ["velodyne"]),
        (["/points_raw"], "lidar", ["lidar"]),
        (["/sensing/lidar/left/points", "/sensing/lidar/right/points"], "lidar", ["left", "right"]),
        (["/camera/image_raw"], "camera", ["camera"]),
        (["/image_raw_11", "/image_raw_12/compressed"], "camera", ["cam11", "cam12"]),
        (["/a/image_raw", "/a/image_color"], "camera", ["a_camera", "a"]),
        (["/fused/image"], "camera", ["fused_camera"]),
        (["/image.left"], "camera", ["image_left"]),
    ],
)
def test_names(topics: list[str], kind: str, names: list[str]) -> None:
    assert [*sensor_names(topics, kind, taken={"fused"}).values()] == [
        dict(zip(topics, names, strict=True))[t] for t in sensor_names(topics, kind)
    ]


@given(st.lists(TOPIC, unique=True, max_size=8), st.sets(st.sampled_from(["camera", "cam1", "lidar"])))
def test_names_are_unique_and_fit_for_topics(topics: list[str], taken: set[str]) -> None:
    names = sensor_names(topics, "camera", taken=taken)
    assert set(names) == set(topics)
    assert len(set(names.values()) | taken) == len(topics) + len(taken)
    assert all(name.isidentifier() for name in names.values())


@pytest.mark.parametrize(
    ("topic", "msgtype", "expected"),
    [
        ("/ground_truth/objects", "vision_msgs/msg/Detection3DArray", True),
        ("/ground_truth/map", "nav_msgs/msg/OccupancyGrid", True),
        ("/ground_truth", "nav_msgs/msg/Odometry", False),
        ("/groundtruth/left", "vision_msgs/msg/Detection2DArray", True),
        ("/left/detections_GT", "vision_msgs/msg/Detection2DArray", True),
        ("/left/detections", "vision_msgs/msg/Detection2DArray", False),
        ("/gtx_camera/detections", "vision_msgs/msg/Detection2DArray", False),
    ],
)
def test_truth_is_told_by_name_and_type(topic: str, msgtype: str, expected: bool) -> None:
    assert is_truth(topic, msgtype) is expected
