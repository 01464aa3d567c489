"""What is written comes back: through lidcam's readers and through rosbags."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from lidcam.bags.simulator.recorder.files import WriteMessage, recording_file, recording_names, ros_version_of
from lidcam.bags.simulator.recorder.messages import MessageFactory, TrueObject, ViewedObject, class_of, counted, seen_by
from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.camera_info import camera_model
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.detections import decode_detections2d
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.messages.objects import ObjectClasses
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2
from lidcam.readers.messages.tf import decode_odometry, decode_transforms
from lidcam.readers.open import open_recording
from lidcam.readers.velodyne.scan import parse_velodyne_scan
from lidcam.writers.outputs.marks import is_unchanged_text
from lidcam.writers.outputs.transaction import OutputTransaction

START_NS = 1_700_000_000 * 10**9
STAMP_NS = 2_345_678_901
TEXTS = {"rig.yaml": "site_frame: site\n", "scenario.yaml": "world: sandbox\n"}
K = np.array([[50.0, 0, 31.5], [0, 51.0, 23.5], [0, 0, 1]])
MODEL = CameraModel("cam", 64, 48, K, "plumb_bob", np.array([-0.1, 0.02, 0, 0, 0]))
POSE = Transform.from_quaternion("site", "car", [1.0, -2.0, 0.5], [0, 0, np.sin(0.4), np.cos(0.4)])
POINTS: dict[str, Array] = {
    **{name: np.array(values, np.float32) for name, values in (("x", [1, 2]), ("y", [3, 4]), ("z", [5, 6]))},
    "intensity": np.array([7.0, 255.0], np.float32),
    "ring": np.array([0, 15], np.uint16),
    "time": np.array([0.0, 0.0999], np.float32),
}
RGB = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
PAYLOAD = np.arange(2 * 1206, dtype=np.uint32).astype(np.uint8).reshape(2, 1206)
BOXES = ((10.0, 20.0, 30.0, 45.5), (0.0, 0.0, 5.0, 5.0))


def all_messages(make: MessageFactory) -> dict[str, Any]:
    each = (seen_by("lidar_points", 12, "top", 0), seen_by("image_pixels", 3456, "front", 2))
    counts = (class_of("van"), counted("lidar_points", 12), counted("image_pixels", 3456), *each)
    found = [
        ViewedObject("car1", 6, BOXES[0], (class_of("car", 0.9), counted("occlusion", 0.25))),
        ViewedObject("", -1, BOXES[1], (class_of("pedestrian", 0.4),)),
    ]
    return {
        "/tf_static": make.transforms(STAMP_NS, [POSE]),
        "/points": make.cloud(STAMP_NS, "lidar", POINTS),
        "/packets": make.scan(STAMP_NS, "lidar", np.array([STAMP_NS, STAMP_NS + 1_327_000]), PAYLOAD),
        "/image": make.rgb_image(STAMP_NS, "cam", RGB),
        "/image/compressed": make.jpeg(STAMP_NS, "cam", np.full((48, 64, 3), (200, 100, 50), np.uint8), 95),
        "/info": make.intrinsics(STAMP_NS, MODEL),
        "/odometry": make.odometry(STAMP_NS, POSE, (3.0, 0.1, 0.2)),
        "/drive": make.drive(STAMP_NS, "car", speed_m_s=0.5, steering_rad=-0.25),
        "/wheel": make.number(14.0),
        "/boxes": make.detections_2d(STAMP_NS, "cam", found),
        "/nothing": make.detections_2d(STAMP_NS, "cam", []),
        "/truth": make.truth(STAMP_NS, "site", [TrueObject("car1", 6, POSE, (4.0, 2.0, 1.5), counts)]),
    }


@contextmanager
def recording_at(path: Path) -> Iterator[WriteMessage]:
    rig, scenario = TEXTS.values()
    with (
        OutputTransaction(recording_names(path)) as outputs,
        recording_file(outputs, path, rig_yaml=rig, scenario_yaml=scenario) as write,
    ):
        yield write


@pytest.fixture(scope="module", params=["a.bag", "a.mcap"])
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("recording") / request.param
    make = MessageFactory(ros_version_of(path), START_NS)
    with recording_at(path) as write:
        for number, (topic, message) in enumerate(all_messages(make).items()):
            write(make.recorded(STAMP_NS + number, topic, STAMP_NS, message, latched=topic == "/tf_static"), START_NS)
    return path


def messages_of(path: Path) -> dict[str, RawMessage]:
    with open_recording([path]) as opened:
        assert opened.losses == ()
        return {message.topic: message._replace(data=bytes(message.data)) for message in opened.messages()}


def test_sensor_messages_come_back(recording: Path) -> None:
    found = messages_of(recording)
    stamped = {message.stamp_ns for topic, message in found.items() if topic not in {"/wheel", "/tf_static"}}
    assert stamped == {START_NS + STAMP_NS}
    cloud = decode_pointcloud2(found["/points"])
    np.testing.assert_array_equal(cloud.xyz, np.stack([POINTS["x"], POINTS["y"], POINTS["z"]], 1))
    assert cloud.ring is not None
    np.testing.assert_array_equal(cloud.ring, POINTS["ring"])
    packets = parse_velodyne_scan(found["/packets"])
    np.testing.assert_array_equal(packets.payload, PAYLOAD)
    assert packets.stamps_ns.tolist() == [START_NS + STAMP_NS, START_NS + STAMP_NS + 1_327_000]
    np.testing.assert_array_equal(decode_any_image(found["/image"]).rgb, RGB)
    jpeg = decode_any_image(found["/image/compressed"]).rgb.astype(int)
    assert np.abs(jpeg - (200, 100, 50)).max() <= 3
    model = camera_model(deserialize(found["/info"]))
    np.testing.assert_array_equal(model.K, MODEL.K)
    np.testing.assert_array_equal(model.distortion, MODEL.distortion)
    assert (model.width_px, model.height_px, model.model) == (64, 48, "plumb_bob")


def test_poses_boxes_and_commands_come_back(recording: Path) -> None:
    found = messages_of(recording)
    np.testing.assert_allclose(decode_odometry(found["/odometry"]).matrix, POSE.matrix, atol=1e-12)
    twist = deserialize(found["/odometry"]).twist.twist
    assert (twist.linear.x, twist.linear.y, twist.angular.z) == (3.0, 0.1, 0.2)
    [(stamp_ns, transform, _)] = decode_transforms(found["/tf_static"])
    assert stamp_ns == START_NS + STAMP_NS
    assert isinstance(transform, Transform)
    np.testing.assert_allclose(transform.matrix, POSE.matrix, atol=1e-12)
    labels = {"car": 0, "pedestrian": 1, "1": 0, "2": 1}
    boxes = decode_detections2d(found["/boxes"], ObjectClasses(labels)).boxes
    np.testing.assert_allclose(boxes.xyxy, BOXES, atol=1e-5)
    assert boxes.class_ids.tolist() == [0, 1]
    assert len(decode_detections2d(found["/nothing"], ObjectClasses(labels)).boxes) == 0
    drive = deserialize(found["/drive"]).drive
    assert (drive.speed, drive.steering_angle) == (0.5, -0.25)
    assert deserialize(found["/wheel"]).data == 14.0


def hypotheses(detection: Any) -> list[tuple[str | int, float]]:
    """Name or number, and score, of each hypothesis."""
    each = [getattr(one, "hypothesis", one) for one in detection.results]
    return [(one.class_id if hasattr(one, "class_id") else one.id, one.score) for one in each]


def test_truth_has_class_box_and_counts_by_name_or_number(recording: Path) -> None:
    found = messages_of(recording)
    [thing] = deserialize(found["/truth"]).detections
    ours, nobodys = deserialize(found["/boxes"]).detections
    size, center = thing.bbox.size, thing.bbox.center.position
    assert (size.x, size.y, size.z, center.x, center.y, center.z) == (4.0, 2.0, 1.5, 1.0, -2.0, 0.5)
    if recording.suffix == ".bag":
        counts = [(4, 1.0), (-1, 12.0), (-2, 3456.0), (-1000, 12.0), (-2002, 3456.0)]
        assert hypotheses(thing) == [*counts, (-3, 6.0)]
        assert [hypotheses(one) for one in (ours, nobodys)] == [[(1, 0.9), (-4, 0.25), (-3, 6.0)], [(2, 0.4), (-3, -1)]]
    else:
        counts_of = [("lidar_points/top", 12.0), ("image_pixels/front", 3456.0)]
        assert hypotheses(thing) == [("van", 1.0), ("lidar_points", 12.0), ("image_pixels", 3456.0), *counts_of]
        assert [one.id for one in (thing, ours, nobodys)] == ["car1", "car1", ""]


def test_other_readers_read_every_message_and_the_true_calibration(recording: Path) -> None:
    if recording.suffix == ".mcap":
        with recording.open("rb") as stream:
            reader = make_reader(stream)
            assert sum(1 for _ in reader.iter_messages()) == 12
            assert {one.name: one.data.decode() for one in reader.iter_attachments()} == TEXTS
        return
    with AnyReader([recording]) as bag:
        for connection, _, data in bag.messages():
            bag.deserialize(data, connection.msgtype)
        assert bag.message_count == 12
    for name, text in TEXTS.items():
        found = recording.with_name(f"{recording.name}.{name}").read_text()
        assert is_unchanged_text(found)
        assert found.split("\n", 1)[1] == text  # below the mark


def test_the_name_says_the_format() -> None:
    assert [ros_version_of(Path(name)) for name in ("a.bag", "a.mcap")] == [1, 2]
    with pytest.raises(OutputError, match=r"a\.txt: expected a name that ends in \.bag \(ROS 1\) or \.mcap \(ROS 2\)"):
        ros_version_of(Path("a.txt"))
