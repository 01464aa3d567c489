"""Lidars that send messages without points are named, and cameras that repeat an image or see nothing."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from frames import RIG, frame

from lidcam.checks.messages import CameraCheck, GroundCheck, LidarCheck, MotionCheck
from lidcam.pipeline.core.clouds import Plane
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.messages import Drop
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.combine import GroundConfig


def measured(points: Mapping[str, int], index: int = 0) -> FrameResult:
    """A frame to which each lidar sent a message."""
    result = frame(index)
    return replace(result, combined=replace(result.combined, points_by_lidar=points))


def without_messages(result: FrameResult, topic: str) -> FrameResult:
    messages = {name: message for name, message in result.bundle.messages.items() if name != topic}
    return replace(result, bundle=replace(result.bundle, messages=messages))


def of_lidar2(*points: int) -> list[FrameResult]:
    """Frames with so many points of it."""
    return [measured({"lidar1": 5, "lidar2": count}, index) for index, count in enumerate(points)]


EMPTY = "without a single point in range"
UNREADABLE = replace(measured({"lidar1": 5}), drops=(Drop("/lidar2", 1, "cannot be decoded"),))


@pytest.mark.parametrize(
    ("frames", "told"),
    [
        ([], []),
        (of_lidar2(7), []),
        (of_lidar2(0), [f"lidar2: 1 messages {EMPTY}"]),
        ([*of_lidar2(0), measured({"lidar1": 0, "lidar2": 1})], []),
        ([measured({}), measured({})], [f"{name}: 2 messages {EMPTY}" for name in ("lidar1", "lidar2")]),
        ([without_messages(measured({"lidar1": 5}), "/lidar2")], []),
        (of_lidar2(5, 5, 0, 0, 0), [f"lidar2: 3 of 5 messages {EMPTY}, in frames 2 to 4"]),
        (of_lidar2(*[0] * 3, *[5] * 28), []),  # less than a tenth
        ([UNREADABLE], ["lidar2: none of its 1 messages can be decoded"]),
    ],
)
def test_lidars_without_a_point_are_named(frames: list[FrameResult], told: list[str]) -> None:
    check = LidarCheck(RIG)
    for result in frames:
        check.add_frame(result)
    empty = "the lidar may be covered, or its motor may stand still; else see combine.min_range_m and max_range_m"
    remedies = ["-v lists the reasons" if "decoded" in one else empty for one in told]
    assert [*map(str, check.warnings)] == [f"{one}; {remedy}" for one, remedy in zip(told, remedies, strict=True)]


STILL = "a" * 12
FROZEN = "10 messages in a row, to frame 11, have the points of the one before"


@pytest.mark.parametrize(
    ("clouds", "others", "told"),
    [
        ("abcdefgh", {}, ""),
        ("abbcdeefghhi", {}, "3 of 12 messages have the points of the one before under a new stamp, in frames 2 to 10"),
        ("abbcdefghiijkl", {}, ""),  # twice
        ("abcdddddefgh", {}, ""),  # a simulated scene without noise may be still for a while
        (STILL, {"/lidar1": STILL, "/left/image": STILL}, ""),
        (STILL, {"/lidar1": "abcdefghiiii"}, ""),  # for less than ten messages
        ("abbbbbbbbbbb", {"/lidar1": "abcdefghijkl"}, FROZEN),
        ("abbbbbbbbbbb", {"/left/image": "abcdefghijkl"}, FROZEN),
    ],
)
def test_lidars_that_repeat_clouds_of_a_changing_scene_are_named(
    clouds: str, others: dict[str, str], told: str
) -> None:
    check = LidarCheck(RIG)
    for index in range(len(clouds)):
        result = measured({"lidar1": 5, "lidar2": 5}, index)
        contents = {topic: row[index].encode() for topic, row in {"/lidar2": clouds, **others}.items()}
        messages = {
            topic: message._replace(data=bytes([index] * 12) + b"\0" * 20 + contents.get(topic, b""))
            for topic, message in result.bundle.messages.items()
        }
        check.add_frame(replace(result, bundle=replace(result.bundle, messages=messages)))
    assert [f"{one.subject}: {one.finding}" for one in check.warnings] == [f"lidar2: {told}"] * bool(told)


@pytest.mark.parametrize(
    ("unknown", "rig", "remedy"),
    [
        ([], RIG, None),
        ([5, 6], RIG, None),
        ([*range(20, 30)], RIG, "go by the clouds alone"),
        ([0, 7, 29], replace(RIG, lidars=()), "parked cars seem to drive"),
    ],
)
def test_frames_at_whose_time_the_odometry_tells_nothing(unknown: list[int], rig: Rig, remedy: str | None) -> None:
    check, result = MotionCheck(rig, ["/odom"]), frame()
    for number in range(30):
        stamps_ns = result.bundle.stamp_ns + np.array([0, 10**8]) + 10**10 * (number in unknown)
        motion = PoseSamples("site", "odom", stamps_ns, np.tile(np.eye(4), (2, 1, 1)))
        check.add_frame(replace(result, bundle=replace(result.bundle, index=number, motion=motion)))
    found = [str(warning) for warning in check.warnings]
    assert len(found) == (remedy is not None)
    if remedy:
        span = f"in {len(unknown)} of 30 frames, in frames {unknown[0]} to {unknown[-1]}; "
        assert f"/odom: the rig's motion is not known {span}" in found[0]
        assert remedy in found[0]


@pytest.mark.parametrize(
    ("frames", "groundless", "is_told"), [(0, 0, False), (1, 1, False), (2, 2, True), (30, 2, False), (30, 3, True)]
)
def test_clouds_without_ground_are_told(frames: int, groundless: int, *, is_told: bool) -> None:
    check = GroundCheck(GroundConfig())
    for number in range(frames):
        plane = None if number < groundless else Plane(np.array([0.0, 0.0, 1.0]), 1.7)
        check.add_frame(replace(frame(), combined=replace(frame().combined, plane=plane, counts={"left": 9})))
    empty = replace(frame().combined, plane=None, counts={"left": 0})
    check.add_frame(replace(frame(), combined=empty))
    told = [f"none was found in {groundless} of {frames} frames, and"] * is_told
    assert [warning.finding[: len(told[0])] for warning in check.warnings] == told


def repeated(index: int, *topics: str) -> FrameResult:
    """A frame with the pictures of frame 0 on some topics, and stamps of their own."""
    result, first = frame(index), frame(0).bundle.messages
    again = {topic: first[topic]._replace(data=bytes([index] * 12) + first[topic].data[12:]) for topic in topics}
    messages = {**result.bundle.messages, **again}
    return replace(result, bundle=replace(result.bundle, messages=messages))


def seeing(result: FrameResult, name: str, *, objects: bool = True) -> FrameResult:
    """The frame with the 2D boxes of `left` for a camera; with or without objects."""
    cameras = {**result.detections.cameras, name: result.detections.cameras["left"]}
    fused = result.fused if objects else frame(objects=0).fused
    return replace(result, detections=replace(result.detections, cameras=cameras), fused=fused)


@pytest.mark.parametrize(
    ("frames", "named"),
    [
        ([], []),
        ([frame(row) for row in range(19)], []),
        ([frame(row) for row in range(20)], ["right: no 2D box in 20 images, with 20 objects in its view"]),
        ([seeing(frame(row), "right") if row == 7 else frame(row) for row in range(25)], []),
        (
            [seeing(frame(row), "right") if row < 7 else frame(row) for row in range(30)],
            ["right: no 2D box in 23 images in a row, in frames 7 to 29, with 23 objects in its view"],
        ),
        ([seeing(frame(row), "right") if row < 30 else frame(row) for row in range(49)], []),
        (
            [seeing(frame(row), "right") if row < 250 else frame(row) for row in range(270)],
            ["right: 2D boxes of 0 of 270 objects in its view"],
        ),
        ([seeing(frame(row), "left", objects=False) for row in range(25)], []),
        ([without_messages(frame(row), "/right/image") for row in range(25)], []),
        ([repeated(row, "/left/image") for row in range(9)], []),
        ([repeated(row, "/left/image") for row in range(10)], ["left: 9 of 10 images are the same as the one before"]),
        ([repeated(row, *["/left/image"] * (row > 3)) for row in range(13)], []),  # repeats 8 of 12
        (
            [repeated(row, *["/left/image"] * (row > 5)) for row in range(18)],
            ["left: 11 images in a row, to frame 17, are the same as the one before"],
        ),
        ([repeated(row, *["/left/image"] * (row % 9 > 0)) for row in range(18)], []),  # never for long
        (
            [repeated(row, "/left/image", "/right/image") for row in range(30)],
            [f"{name}: 29 of 30 images are the same as the one before" for name in ("left", "right")],
        ),
    ],
)
def test_cameras_that_see_nothing_or_repeat_an_image_are_named(frames: list[FrameResult], named: list[str]) -> None:
    check = CameraCheck(RIG)
    for result in frames:
        check.add_frame(result)
    assert [f"{warning.subject}: {warning.finding}" for warning in check.warnings] == named
    assert all("topics.exclude=[/" in warning.remedy for warning in check.warnings)
