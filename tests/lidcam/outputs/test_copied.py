from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from builders import header, odometry, raw
from frames import RIG
from memory_recording import MemoryRecording

from lidcam.outputs.copied import choose_copied, choose_drawn, truth_frames
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.geometry.transform_tree import TransformTree
from lidcam.pipeline.core.messages import Channel, RawMessage
from lidcam.pipeline.core.rig import TruthVehicle
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.messages.tf import RecordedTransforms
from lidcam.readers.recording import TopicInfo
from lidcam.readers.rig.discovery import Discovery

OUT = [Path("out.mcap"), Path("out.rrd")]
ODOM, BOXES = "nav_msgs/msg/Odometry", "vision_msgs/msg/Detection3DArray"
TRUTH, MAP, FUSED = "/ground_truth/objects", "/ground_truth/map", "/fused/detections"


def recording(*more: RawMessage) -> MemoryRecording:
    boxes = [raw(topic, BOXES, {}, 1) for topic in (TRUTH, FUSED, "/radar/objects", "/labels/gt")]
    odom = [raw(topic, ODOM, odometry(stamp_ns=1), 1) for topic in ("/odom", MAP, "/left/image", "/truth")]
    return MemoryRecording([*boxes, *odom, *more])


def chosen(patterns: Any, *more: RawMessage, outputs: list[Path] = OUT) -> tuple[tuple[str, ...], tuple[str, ...]]:
    config = Config.model_validate({"output": {"copy_topics": patterns}})
    return choose_copied(outputs, recording(*more), RIG, config)


def test_odometry_that_the_rig_calls_truth() -> None:
    rig = replace(RIG, truth={"car1": TruthVehicle("/odom", "car", (4, 2, 1))})
    assert choose_copied(OUT, recording(), rig, Config())[0] == (MAP, TRUTH, "/labels/gt", "/odom")


@pytest.mark.parametrize(
    ("patterns", "topics"),
    [(None, (MAP, TRUTH, "/labels/gt")), ([], ()), (["/od*", "/ground_truth/m?p"], (MAP, "/odom"))],
)
def test_topics_of_truth_or_those_asked_for(patterns: Any, topics: tuple[str, ...]) -> None:
    assert chosen(patterns) == (topics, ())
    assert chosen(patterns, outputs=[Path("out.rrd")]) == ((), ())


def test_a_pattern_without_topic_is_named_once() -> None:
    topics, notes = chosen(["/odom", "/odometry", "/odometry"])
    assert topics == ("/odom",)
    assert notes == ("output.copy_topics: no topic with messages is called /odometry",)


def test_what_cannot_be_copied_is_named() -> None:
    grid = RawMessage(1, 1, (0, 0), b"{}", Channel("/grid", "foxglove.Grid", "json"))
    reason = "its messages are json, expected ROS messages"
    assert chosen(["/grid"], grid) == ((), (f"/grid is not copied to the output: {reason}",))
    found = recording()
    found.topics = (TopicInfo("/gt/lost", BOXES, 3, (), "its chunk index is damaged"), *found.topics)
    _, notes = choose_copied(OUT, found, RIG, Config())
    assert notes == ("/gt/lost is not copied to the output: its chunk index is damaged",)


def test_which_truth_is_drawn() -> None:
    measured = raw("/ground_truth/objects_when_measured", BOXES, {}, 1)
    found = recording(measured)
    copied, _ = choose_copied(OUT, found, RIG, Config())
    assert measured.topic in copied
    assert choose_drawn(found, copied) == (TRUTH, "/labels/gt")
    assert choose_drawn(found, ("/odom", FUSED)) == ()


def test_what_a_result_has_drawn_is_drawn_anew() -> None:
    channel = Channel("/ground_truth/objects/scene", "foxglove_msgs/msg/SceneUpdate", "cdr")
    drawn = RawMessage(1, 1, (0, 0), b"", channel)
    assert chosen(None, drawn) == ((MAP, TRUTH, "/labels/gt"), ())
    assert chosen(["/ground_truth/o*"], drawn) == (
        (TRUTH,),
        ("/ground_truth/objects/scene is not copied to the output: the result has a topic of that name",),
    )
    assert chosen(["/ground_truth/objects/*"], drawn) == (("/ground_truth/objects/scene",), ())


def test_fixed_frames_of_the_truth_are_known() -> None:
    tree = TransformTree()
    tree.add_static(Transform.from_quaternion("map", RIG.site_frame, [1, 2, 3], [0, 0, 0, 1]))
    found = Discovery(RIG, (), (), (), RecordedTransforms(tree))
    boxes = [
        raw(f"/gt/{frame}", BOXES, {"header": header(1, frame)}, 1)
        for frame in ("map", RIG.site_frame, RIG.lidars[0].T_site_lidar.src, "unknown")
    ]
    odom = raw("/odom", ODOM, odometry(stamp_ns=1, frame_id="map"), 1)
    messages = MemoryRecording([*boxes, odom])
    copied = {info.topic for info in messages.topics}
    (frame,) = truth_frames(messages, copied, found, Config())
    assert (frame.dst, frame.src, frame.translation.tolist()) == (RIG.site_frame, "map", [-1, -2, -3])
    assert truth_frames(messages, (), found, Config()) == ()
    later = MemoryRecording([raw("/image", "sensor_msgs/msg/Image", {"header": header(1, "map")}, 1)])
    assert truth_frames(later, {"/image"}, found, Config()) == ()
