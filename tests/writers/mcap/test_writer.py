import hashlib
import json
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from builders import odometry, raw
from frames import CONFIG, COVARIANCE, PERIOD_NS, PROVENANCE, RIG, START_NS, frame, image_message, tracks_of
from mcap.reader import make_reader
from results import messages_of, topics_of
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.detections import Source
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import Channel, Drop, RawMessage
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.true_boxes import TrueBoxes
from lidcam.writers.foxglove.layout import layout_path
from lidcam.writers.mcap.writer import McapResultWriter, reserved_topics
from lidcam.writers.outputs.transaction import OutputFile, OutputTransaction

PER_CAMERA = {
    "camera_info": "sensor_msgs/msg/CameraInfo",
    "annotations": "foxglove_msgs/msg/ImageAnnotations",
    "detections": "vision_msgs/msg/Detection2DArray",
}
EACH_FRAME = {
    "/lidar_camera_fused": "msgs/msg/MsgLidCam",
    "/fused/detections": "vision_msgs/msg/Detection3DArray",
    "/fused/scene": "foxglove_msgs/msg/SceneUpdate",
    "/fused/markers": "visualization_msgs/msg/MarkerArray",
    "/lidar/detections": "vision_msgs/msg/Detection3DArray",
    "/point_cloud_combined": "sensor_msgs/msg/PointCloud2",
    "/ground_cloud": "sensor_msgs/msg/PointCloud2",
    "/left/image": "sensor_msgs/msg/Image",
    "/right/image/compressed": "sensor_msgs/msg/CompressedImage",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    **{f"/{camera}/{leaf}": msgtype for camera in ("left", "right") for leaf, msgtype in PER_CAMERA.items()},
}


def write(
    path: Path, frames: Iterable[FrameResult], *, config: Config = CONFIG, rig: Rig = RIG
) -> list[tuple[Drop, ...]]:
    with (
        OutputTransaction([path, *[layout_path(path)] * config.output.layout]) as outputs,
        McapResultWriter(outputs[path], rig, config, PROVENANCE, outputs.get(layout_path(path))) as writer,
    ):
        return [writer.write(result) for result in frames]


def logged(path: Path) -> list[tuple[Any, Any, Any]]:
    """Schema, channel and message of each message, in the order of the file."""
    with path.open("rb") as file:
        return list(make_reader(file).iter_messages(log_time_order=False))


def stamp_of(message: Any) -> int:
    stamp = message.timestamp if hasattr(message, "timestamp") else message.header.stamp
    return int(stamp.sec * 10**9 + stamp.nanosec)


@pytest.fixture(scope="module")
def two_frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("mcap") / "out.mcap"
    assert write(path, [frame(0, motion=True), frame(1, motion=True)]) == [(), ()]
    return path


def test_topics_and_types(two_frames: Path) -> None:
    expected = {topic: (msgtype, 2) for topic, msgtype in EACH_FRAME.items()}
    tf = "tf2_msgs/msg/TFMessage"
    assert topics_of(two_frames) == {"/tf_static": (tf, 1), "/tf": (tf, 2), **expected}


def test_log_time_is_that_of_the_reference_message(two_frames: Path) -> None:
    times = [(m.log_time, m.publish_time) for _, _, m in logged(two_frames)]
    expected = [START_NS + 7] * (len(EACH_FRAME) + 2) + [START_NS + PERIOD_NS + 7] * (len(EACH_FRAME) + 1)
    assert times == [(time, time) for time in expected]


@pytest.mark.parametrize("topic", sorted(EACH_FRAME))
def test_stamps_are_the_frame_s_or_the_image_s(two_frames: Path, topic: str) -> None:
    shift_ns = {"left": 1_000_001, "right": -2_000_003}.get(topic.split("/")[1], 0)
    messages = [message for _, message in messages_of(two_frames, topic)]
    if part := {"/fused/scene": "entities", "/fused/markers": "markers"}.get(topic):
        messages = [getattr(message, part)[0] for message in messages]
    assert [stamp_of(message) for message in messages] == [START_NS + shift_ns, START_NS + PERIOD_NS + shift_ns]


def test_static_transforms_come_first_and_reach_every_sensor(two_frames: Path) -> None:
    _, first, _ = logged(two_frames)[0]
    assert first.topic == "/tf_static"
    assert yaml.safe_load(first.metadata["offered_qos_profiles"])[0]["durability"] == "transient_local"
    ((_, message),) = messages_of(two_frames, "/tf_static")
    assert {t.header.frame_id for t in message.transforms} == {"site"}
    assert [t.child_frame_id for t in message.transforms] == ["lidar2", "left", "right"]  # lidar1 is the site frame
    assert {stamp_of(t) for t in message.transforms} == {START_NS - 2_000_003}  # the oldest message of the set
    expected = [RIG.lidars[1].T_site_lidar, *(camera.T_camera_site.inverse() for camera in RIG.cameras)]
    for found, transform in zip(message.transforms, expected, strict=True):
        q, t = found.transform.rotation, found.transform.translation
        turn = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        np.testing.assert_allclose(turn, transform.matrix[:3, :3], atol=1e-12)
        np.testing.assert_allclose([t.x, t.y, t.z], transform.translation)


def test_ego_motion_is_tf_at_the_frame_s_stamp(two_frames: Path, tmp_path: Path) -> None:
    for index, (_, message) in enumerate(messages_of(two_frames, "/tf")):
        (found,) = message.transforms
        assert (found.header.frame_id, found.child_frame_id) == ("odom", "site")
        assert stamp_of(found) == START_NS + index * PERIOD_NS
        assert found.transform.translation.x == pytest.approx(index + 1)  # half way between the samples
    write(tmp_path / "still.mcap", [frame()])
    assert "/tf" not in topics_of(tmp_path / "still.mcap")


def test_calibration_is_the_one_used(two_frames: Path) -> None:
    (_, left), _ = messages_of(two_frames, "/left/camera_info")
    model = RIG.cameras[0].model
    assert (left.width, left.height, left.distortion_model) == (640, 480, "plumb_bob")
    np.testing.assert_array_equal(left.d, [0.1, -0.05, 0, 0, 0])
    np.testing.assert_array_equal(left.k.reshape(3, 3), model.K)
    np.testing.assert_array_equal(left.p.reshape(3, 4), np.c_[model.K, np.zeros(3)])


def test_provenance(two_frames: Path) -> None:
    with two_frames.open("rb") as file:
        reader = make_reader(file)
        header = reader.get_header()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachments = {a.name: a for a in reader.iter_attachments()}
    assert (header.profile, header.library) == ("ros2", "lidcam")
    config, rig = b"fuse: {}\n", b"site_frame: site\n"
    inputs = {"0.name": "a.bag", "0.size": "12", "1.name": "b.mcap", "1.url": "https://host/b.mcap"}
    inputs |= {"2.name": "c.bag", "2.size": "0"}
    hashes = {f"{name}.sha256": hashlib.sha256(text).hexdigest() for name, text in (("config", config), ("rig", rig))}
    of_inputs = {f"input.{key}": value for key, value in inputs.items()}
    assert metadata["lidcam"] == {"version": "1.2.3", "settings": "as given", **of_inputs, **hashes}
    assert metadata["lidcam.inputs"] == {"input.0.sha256": "aa" * 32, "input.2.sha256": "cc" * 32}
    found = {name: a.data for name, a in attachments.items()}
    assert found == {"lidcam.yaml": config, "rig.yaml": rig, "summary.json": b"{}"}
    assert {(a.create_time, a.log_time) for a in attachments.values()} == {(START_NS, START_NS)}


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_the_same_results_give_the_same_bytes(tmp_path: Path, compression: str) -> None:
    config = Config.model_validate({"output": {"compression": compression}})
    for name in ("one", "two"):
        write(tmp_path / name, (frame(index, motion=True) for index in range(4)), config=config)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    with (tmp_path / "one").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert {chunk.compression for chunk in summary.chunk_indexes} == {compression.replace("none", "")}


def test_what_the_cameras_place_is_written_where_a_camera_looks(tmp_path: Path) -> None:
    placed = frame(1, sources=[Source.LIDAR, Source.CAMERA, Source.CAMERA])
    write(tmp_path / "out.mcap", [frame(0), placed, frame(2, sources=[Source.LIDAR] * 3)])
    written = [message for _, message in messages_of(tmp_path / "out.mcap", "/cameras/detections")]
    assert [len(message.detections) for message in written] == [2, 0]
    assert [stamp_of(message) for message in written] == [START_NS + PERIOD_NS, START_NS + 2 * PERIOD_NS]
    (first, second), objects = written[0].detections, placed.fused.objects
    assert [one.results[0].hypothesis.class_id for one in (first, second)] == ["pedestrian", "truck"]
    assert first.bbox.center.position.x == objects.centers[1, 0]
    covariance = first.results[0].pose.covariance.reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]
    np.testing.assert_array_equal(covariance, COVARIANCE)
    scenes = [message for _, message in messages_of(tmp_path / "out.mcap", "/cameras/scene")]
    assert [len(message.entities) for message in scenes] == [2, 0]
    shown = json.loads(layout_path(tmp_path / "out.mcap").read_text())["configById"]["3D!scene"]["topics"]
    assert shown["/cameras/scene"]["visible"] is False


def test_tracks_have_a_topic_in_every_frame_where_objects_are_tracked(tmp_path: Path) -> None:
    write(tmp_path / "out.mcap", [frame(0, tracks=tracks_of([3, 0, 4])), frame(1, objects=0, tracks=tracks_of([]))])
    written = [message for _, message in messages_of(tmp_path / "out.mcap", "/tracks")]
    assert [[one.id for one in message.tracks] for message in written] == [[3, 4], []]
    assert [stamp_of(message) for message in written] == [START_NS, START_NS + PERIOD_NS]
    (_, boxes), _ = messages_of(tmp_path / "out.mcap", "/fused/detections")
    assert [one.id for one in boxes.detections] == ["3", "", "4"]
    assert "/tracks" in reserved_topics(RIG)


def topics_in(layout: str) -> set[str]:
    return set(re.findall(r'"(/[^".]+)', layout))


OPTIONAL = {
    "images": {"/left/image", "/right/image/compressed"},
    "clouds": {"/point_cloud_combined", "/ground_cloud"},
    "ground": {"/ground_cloud"},
}


@pytest.mark.parametrize("names", [(), ("images",), ("clouds",), ("ground",), ("images", "clouds")])
def test_what_is_left_out_of_file_and_layout(tmp_path: Path, names: tuple[str, ...]) -> None:
    config = Config.model_validate({"output": dict.fromkeys(names, False)})
    write(tmp_path / "out.mcap", [frame(), frame(1)], config=config)
    topics, named = topics_of(tmp_path / "out.mcap"), topics_in((tmp_path / "out.foxglove.json").read_text())
    left_out = set().union(*(OPTIONAL[name] for name in names))
    assert set(topics) == {"/tf_static", *EACH_FRAME} - left_out
    assert named <= {topic for topic, (_, count) in topics.items() if count}
    assert {"/fused/scene", "/diagnostics", "/left/camera_info", "/left/image", "/ground_cloud"} - left_out <= named
    (_, info), _ = messages_of(tmp_path / "out.mcap", "/left/camera_info")
    assert stamp_of(info) == START_NS + 1_000_001


def test_no_frames_is_a_readable_file(tmp_path: Path) -> None:
    write(tmp_path / "out.mcap", [])
    assert {count for _, count in topics_of(tmp_path / "out.mcap").values()} == {0}
    assert topics_in((tmp_path / "out.foxglove.json").read_text()) == {"/diagnostics"}


def with_messages(result: FrameResult, **messages: Any) -> FrameResult:
    kept = {topic: m for topic, m in {**result.bundle.messages, **messages}.items() if m is not None}
    return replace(result, bundle=replace(result.bundle, messages=kept))


def test_a_camera_without_image_or_boxes_is_left_out_of_the_frame(tmp_path: Path) -> None:
    bare = with_messages(frame(), **{"/left/image": None})
    detections, hypotheses = replace(bare.detections, cameras={}), replace(bare.hypotheses, matches={})
    write(tmp_path / "out.mcap", [replace(bare, detections=detections, hypotheses=hypotheses)])
    counts = {topic: count for topic, (_, count) in topics_of(tmp_path / "out.mcap").items()}
    assert [counts[f"/left/{leaf}"] for leaf in PER_CAMERA] == [0, 0, 0]
    assert [counts[f"/right/{leaf}"] for leaf in PER_CAMERA] == [1, 1, 0]
    assert counts["/right/image/compressed"] == 1


def test_recorded_boxes_without_an_image_give_the_stamp(tmp_path: Path) -> None:
    write(tmp_path / "out.mcap", [with_messages(frame(), **{"/left/image": None})])
    for leaf in PER_CAMERA:
        ((_, message),) = messages_of(tmp_path / "out.mcap", f"/left/{leaf}")
        assert stamp_of(message) == START_NS + 1_000_001


def test_an_image_that_was_dropped_is_not_copied(tmp_path: Path) -> None:
    dropped = Drop("/left/image", START_NS + 1_000_001, "cannot be decoded")
    assert write(tmp_path / "out.mcap", [frame(drops=(dropped,))]) == [()]
    assert "/left/image" not in topics_of(tmp_path / "out.mcap")


def test_a_broken_image_is_reported_and_the_rest_written(tmp_path: Path) -> None:
    whole = image_message("/left/image", START_NS, frame_id="left")
    broken = whole._replace(data=whole.data[:100])
    ((drop,),) = write(tmp_path / "out.mcap", [with_messages(frame(), **{"/left/image": broken})])
    assert (drop.topic, drop.stamp_ns, drop.reason) == ("/left/image", START_NS, "the image cannot be copied")
    assert "100 bytes are not a valid sensor_msgs/msg/Image" in drop.detail
    topics = topics_of(tmp_path / "out.mcap")
    assert "/left/image" not in topics
    assert topics["/left/annotations"][1] == topics["/fused/detections"][1] == 1
    ((_, diagnostics),) = messages_of(tmp_path / "out.mcap", "/diagnostics")
    assert diagnostics.status[3].values[0].key == "/left/image"


@pytest.mark.parametrize(
    ("name", "stamp_ns", "error"),
    [
        *((name, 0, f"two outputs are called /{name}/detections; rename the camera") for name in ("lidar", "cameras")),
        *(("left", ns, f"frame 0: a stamp does not fit a ROS 2 header, {ns} ns lies") for ns in (-1, 2**31 * 10**9)),
    ],
)
def test_what_ros_cannot_hold_is_one_clear_line(tmp_path: Path, name: str, stamp_ns: int, error: str) -> None:
    rig = replace(RIG, cameras=(replace(RIG.cameras[0], name=name),))
    message = image_message("/left/image", START_NS, frame_id="left")._replace(stamp_ns=stamp_ns)
    with pytest.raises(OutputError, match=error):
        write(tmp_path / "out.mcap", [with_messages(frame(), **{"/left/image": message})], rig=rig)
    assert list(tmp_path.iterdir()) == []


def test_copied_messages_keep_bytes_definition_and_time(tmp_path: Path) -> None:
    result = frame(0)
    at_ns = result.bundle.log_time_ns
    recorded = [raw("/truth", "nav_msgs/msg/Odometry", odometry(stamp_ns=at), at) for at in (at_ns - 5, at_ns + 5)]
    idl = Channel("/idl", "own_msgs/msg/Thing", "cdr", "module own_msgs {};", "ros2idl")
    recorded.append(RawMessage(at_ns, at_ns, (0, 0), b"\x00\x01\x00\x00", idl))
    result = replace(result, bundle=replace(result.bundle, copied=tuple(recorded)))
    write(tmp_path / "out.mcap", [result])
    found = logged(tmp_path / "out.mcap")
    written = {(c.topic, m.log_time): (m.data, s.name, s.encoding, s.data) for s, c, m in found}
    for one in recorded:
        definition = one.channel.msgtype, one.channel.definition_format, one.channel.definition.encode()
        assert written[one.topic, one.log_time_ns] == (one.data, *definition)
    order = [channel.topic for _, channel, _ in found]
    assert order[:3] == ["/truth", "/idl", "/tf_static"]
    assert order[-1] == "/truth"


def test_truth_is_drawn_beside_its_messages(tmp_path: Path) -> None:
    result = frame(0)
    at_ns = result.bundle.log_time_ns
    copied = [raw("/gt", "vision_msgs/msg/Detection3DArray", {}, at, at) for at in (at_ns - 5, at_ns + 5)]
    nothing = np.zeros((0, 3))
    stamp_ns = result.bundle.stamp_ns
    truth = [TrueBoxes("/gt", stamp_ns + at, at_ns + at, "site", nothing, nothing, np.zeros(0), ()) for at in (-5, 5)]
    result = replace(result, bundle=replace(result.bundle, copied=tuple(copied), truth=tuple(truth)))
    write(tmp_path / "out.mcap", [result])
    found = [(c.topic, m.log_time) for _, c, m in logged(tmp_path / "out.mcap")]
    assert found[:2] == [("/gt", at_ns - 5), ("/tf_static", at_ns)]
    assert found[-3:] == [("/gt/scene", at_ns), ("/gt", at_ns + 5), ("/gt/scene", at_ns)]
    layout = json.loads(layout_path(tmp_path / "out.mcap").read_text())
    assert layout["configById"]["3D!scene"]["topics"]["/gt/scene"]["visible"]


def test_frames_of_the_truth_are_joined_with_the_site(tmp_path: Path) -> None:
    path, frames = tmp_path / "out.mcap", [Transform.from_quaternion("site", "map", [1, 2, 3], [0, 0, 0, 1])]
    with McapResultWriter(OutputFile(path, path), RIG, CONFIG, PROVENANCE, frames=frames) as writer:
        writer.write(frame(0))
    ((_, message),) = messages_of(path, "/tf_static")
    last = message.transforms[-1]
    assert (last.header.frame_id, last.child_frame_id, last.transform.translation.z) == (RIG.site_frame, "map", 3)
