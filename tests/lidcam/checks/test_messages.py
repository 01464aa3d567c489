"""Lidars that send messages without points are named."""

from collections.abc import Mapping
from dataclasses import replace

import pytest
from frames import RIG, frame

from lidcam.checks.messages import LidarCheck
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.messages import Drop


def measured(points: Mapping[str, int]) -> FrameResult:
    """A frame to which each lidar sent a message."""
    result = frame()
    return replace(result, combined=replace(result.combined, points_by_lidar=points))


def without_messages(result: FrameResult, topic: str) -> FrameResult:
    messages = {name: message for name, message in result.bundle.messages.items() if name != topic}
    return replace(result, bundle=replace(result.bundle, messages=messages))


@pytest.mark.parametrize(
    ("frames", "subjects"),
    [
        ([], []),
        ([measured({"lidar1": 5, "lidar2": 7})], []),
        ([measured({"lidar1": 5, "lidar2": 0})], ["lidar2"]),
        ([measured({"lidar1": 5, "lidar2": 0}), measured({"lidar1": 0, "lidar2": 1})], []),
        ([measured({}), measured({})], ["lidar1", "lidar2"]),
        ([without_messages(measured({"lidar1": 5}), "/lidar2")], []),
    ],
)
def test_lidars_without_a_point_are_named(frames: list[FrameResult], subjects: list[str]) -> None:
    check = LidarCheck(RIG)
    for result in frames:
        check.add_frame(result)
    assert [warning.subject for warning in check.warnings] == subjects


def test_messages_that_cannot_be_decoded_are_not_called_empty() -> None:
    check, result = LidarCheck(RIG), measured({"lidar1": 5})
    bad = result.bundle.messages["/lidar2"]
    check.add_frame(replace(result, drops=(Drop("/lidar2", bad.stamp_ns, "cannot be decoded"),)))
    assert [str(warning) for warning in check.warnings] == [
        "lidar2: none of its 1 messages can be decoded; -v lists the reasons"
    ]


@pytest.mark.parametrize(
    ("points", "text"),
    [
        ([5, 5, 0, 0, 0], "3 of 5 messages without a single point in range, in frames 2 to 4"),
        ([0] * 3 + [5] * 28, None),  # less than a tenth
        ([0] * 3, "3 messages without a single point in range"),
    ],
)
def test_a_lidar_that_is_empty_for_a_time_is_named(points: list[int], text: str | None) -> None:
    check = LidarCheck(RIG)
    for index, count in enumerate(points):
        result = measured({"lidar1": 5, "lidar2": count})
        check.add_frame(replace(result, bundle=replace(result.bundle, index=index)))
    remedy = "the lidar may be covered, or its motor may stand still; else see combine.min_range_m and max_range_m"
    assert [str(warning) for warning in check.warnings] == ([f"lidar2: {text}; {remedy}"] if text else [])
