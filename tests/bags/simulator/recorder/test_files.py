"""What is written comes back: through lidcam's readers and through rosbags."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from lidcam.bags.simulator.recorder.files import (
    FORMATS,
    RecordingFormat,
    WriteMessage,
    format_of,
    recording_file,
    recording_outputs,
    ros_version_of,
)
from lidcam.bags.simulator.recorder.messages import (
    MessageFactory,
    TrueObject,
    ViewedObject,
    class_of,
    counted,
    counted_by,
)
from lidcam.pipeline.core.arrays import Array
from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import OutputError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.readers.messages.camera_info import camera_model
from lidcam.readers.messages.deserialize import deserialize
from lidcam.readers.messages.image import decode_any_image
from lidcam.readers.messages.odometry import decode_odometry
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2
from lidcam.readers.messages.tf import decode_transforms
from lidcam.readers.messages.vision.detections2d import decode_detections2d
from lidcam.readers.open import open_recording
from lidcam.readers.velodyne.scan import parse_velodyne_scan
from lidcam.writers.outputs.marks import is_unchanged_text

START_NS = 1_700_000_000 * 10**9
STAMP_NS = 2_345_678_901
NAMES = {"ros1": "a.bag", "sqlite3": "a", "mcap": "a.mcap"}
MODEL = CameraModel(
    "cam", 64, 48, np.array([[50.0, 0, 31.5], [0, 51.0, 23.5], [0, 0, 1]]), "plumb_bob", np.array([-0.1, 0.02, 0, 0, 0])
)
POSE = Transform.from_quaternion("site", "car", [1.0, -2.0, 0.5], [0, 0, np.sin(0.4), np.cos(0.4)])
POINTS: dict[str, Array] = {
    "x": np.array([1.0, 2.0], np.float32),
    "y": np.array([3.0, 4.0], np.float32),
    "z": np.array([5.0, 6.0], np.float32),
    "intensity": np.array([7.0, 255.0], np.float32),
    "ring": np.array([0, 15], np.uint16),
    "time": np.array([0.0, 0.0999], np.float32),
}
RGB = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
PAYLOAD = np.arange(2 * 1206, dtype=np.uint32).astype(np.uint8).reshape(2, 1206)
BOXES = ((10.0, 20.0, 30.0, 45.5), (0.0, 0.0, 5.0, 5.0))


def all_messages(make: MessageFactory) -> dict[str, Any]:
    counts = (counted("lidar_points", 12), counted("image_pixels", 3456))
    each = (counted_by("lidar_points", 5, "top", 0), counted_by("lidar_points", 7, "side", 1))
    of_front = counted_by("image_pixels", 3456, "front", 2)
    thing = TrueObject("car1", 6, POSE, (4.0, 2.0, 1.5), (class_of("van"), *counts, *each, of_front))
    found = [
        ViewedObject("car1", 6, BOXES[0], (class_of("car", 0.9),)),
        ViewedObject("", -1, BOXES[1], (class_of("pedestrian", 0.4),)),
    ]
    shares = (counted("image_pixels", 70), counted("occlusion", 0.25), counted("truncation", 0.5))
    shown = [ViewedObject("bike", 3, BOXES[0], (class_of("cyclist"), *shares))]
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
        "/visible": make.detections_2d(STAMP_NS, "cam", shown),
        "/truth": make.truth(STAMP_NS, "site", [thing]),
    }


@contextmanager
def recording_at(
    path: Path, format: RecordingFormat, *, rig_yaml: str = "", scenario_yaml: str = ""
) -> Iterator[WriteMessage]:
    with (
        recording_outputs(path, format) as outputs,
        recording_file(outputs, path, format, rig_yaml=rig_yaml, scenario_yaml=scenario_yaml) as write,
    ):
        yield write


def write_all(path: Path, format: RecordingFormat) -> None:
    make = MessageFactory(ros_version_of(format), START_NS)
    with recording_at(path, format, rig_yaml="site_frame: site\n", scenario_yaml="world: sandbox\n") as write:
        for number, (topic, message) in enumerate(all_messages(make).items()):
            write(make.recorded(STAMP_NS + number, topic, STAMP_NS, message, latched=topic == "/tf_static"), START_NS)


@pytest.fixture(scope="module", params=FORMATS)
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / NAMES[request.param]
    write_all(path, request.param)
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


def test_poses_and_boxes_come_back(recording: Path) -> None:
    found = messages_of(recording)
    np.testing.assert_allclose(decode_odometry(found["/odometry"]).matrix, POSE.matrix, atol=1e-12)
    twist = deserialize(found["/odometry"]).twist.twist
    assert (twist.linear.x, twist.linear.y, twist.linear.z) == (3.0, 0.1, 0.0)
    assert (twist.angular.x, twist.angular.y, twist.angular.z) == (0.0, 0.0, 0.2)

    [(stamp_ns, transform, _)] = decode_transforms(found["/tf_static"])
    assert stamp_ns == START_NS + STAMP_NS
    assert isinstance(transform, Transform)
    np.testing.assert_allclose(transform.matrix, POSE.matrix, atol=1e-12)

    labels = {"car": 0, "pedestrian": 1, "1": 0, "2": 1}
    boxes = decode_detections2d(found["/boxes"], labels).boxes
    np.testing.assert_allclose(boxes.xyxy, BOXES, atol=1e-5)
    assert boxes.class_ids.tolist() == [0, 1]
    assert len(decode_detections2d(found["/nothing"], labels).boxes) == 0

    drive = deserialize(found["/drive"]).drive
    assert (drive.speed, drive.steering_angle) == (0.5, -0.25)
    assert deserialize(found["/wheel"]).data == 14.0


def test_truth_tells_class_box_and_how_often_it_was_hit(recording: Path) -> None:
    [thing] = deserialize(messages_of(recording)["/truth"]).detections
    size, center = thing.bbox.size, thing.bbox.center.position
    assert (size.x, size.y, size.z, center.x, center.y, center.z) == (4.0, 2.0, 1.5, 1.0, -2.0, 0.5)
    if recording.suffix == ".bag":
        totals, each = [(4, 1.0), (-1, 12.0), (-2, 3456.0)], [(-1000, 5.0), (-1001, 7.0), (-2002, 3456.0)]
        assert told(thing) == [*totals, *each, (-3, 6.0)]
    else:
        assert told(thing) == [
            *[("van", 1.0), ("lidar_points", 12.0), ("image_pixels", 3456.0)],
            *[("lidar_points/top", 5.0), ("lidar_points/side", 7.0), ("image_pixels/front", 3456.0)],
        ]
        assert thing.id == "car1"


def told(detection: Any) -> list[tuple[str | int, float]]:
    """Name or number, and score, of each hypothesis."""
    hypotheses = [getattr(one, "hypothesis", one) for one in detection.results]
    return [(one.class_id if hasattr(one, "class_id") else one.id, one.score) for one in hypotheses]


def test_boxes_in_images_tell_whose_they_are_and_how_much_is_seen(recording: Path) -> None:
    found = messages_of(recording)
    ours, nobodys = deserialize(found["/boxes"]).detections
    [shown] = deserialize(found["/visible"]).detections
    if recording.suffix == ".bag":
        assert told(ours) == [(1, 0.9), (-3, 6.0)]
        assert told(nobodys) == [(2, 0.4), (-3, -1.0)]
        assert told(shown) == [(3, 1.0), (-2, 70.0), (-4, 0.25), (-5, 0.5), (-3, 3.0)]
    else:
        assert [one.id for one in (ours, nobodys, shown)] == ["car1", "", "bike"]
        assert told(shown) == [("cyclist", 1.0), ("image_pixels", 70.0), ("occlusion", 0.25), ("truncation", 0.5)]


def test_rosbags_reads_every_message(recording: Path) -> None:
    if recording.suffix == ".mcap":
        with recording.open("rb") as stream:
            assert sum(1 for _ in make_reader(stream).iter_messages()) == 13
        return
    with AnyReader([recording]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
        assert reader.message_count == 13


def test_the_true_calibration_goes_with_it(recording: Path) -> None:
    if recording.suffix == ".mcap":
        with recording.open("rb") as stream:
            texts = {one.name: one.data.decode() for one in make_reader(stream).iter_attachments()}
    else:
        texts = {
            name: recording.with_name(f"{recording.name}.{name}").read_text() for name in ("rig.yaml", "scenario.yaml")
        }
    if recording.suffix != ".mcap":
        assert all(is_unchanged_text(text) for text in texts.values())
        texts = {name: text.split("\n", 1)[1] for name, text in texts.items()}  # without the mark
    assert texts == {"rig.yaml": "site_frame: site\n", "scenario.yaml": "world: sandbox\n"}


def test_a_folder_that_is_no_recording_is_kept(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "thesis.txt").write_text("mine")
    (tmp_path / "b" / "b.db3").mkdir(parents=True)
    (tmp_path / "b" / "metadata.yaml").touch()
    with pytest.raises(OutputError, match="exists and holds something other than a ROS 2 recording"):
        write_all(tmp_path / "b", "sqlite3")
    with pytest.raises(OutputError, match="exists and holds something other than a ROS 2 recording"):
        write_all(tmp_path / "a", "sqlite3")
    (tmp_path / "a" / "metadata.yaml").write_text("a recording, and more")
    with pytest.raises(OutputError, match="exists and holds something other than a ROS 2 recording"):
        write_all(tmp_path / "a", "sqlite3")
    assert (tmp_path / "a" / "thesis.txt").read_text() == "mine"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a", "b"]


@pytest.mark.parametrize(
    ("name", "wanted", "format"),
    [
        ("a.bag", None, "ros1"),
        ("a.mcap", None, "mcap"),
        ("a", None, "sqlite3"),
        ("a", "sqlite3", "sqlite3"),
        ("a", "ros1", "ros1"),
        ("a.recording", "mcap", "mcap"),
    ],
)
def test_the_name_says_the_format(name: str, wanted: RecordingFormat | None, format: RecordingFormat) -> None:
    assert format_of(Path(name), wanted) == format


@pytest.mark.parametrize(("name", "wanted"), [("a.txt", None), ("a.bag", "mcap"), ("a.mcap", "sqlite3")])
def test_a_name_that_fits_no_format(name: str, wanted: RecordingFormat | None) -> None:
    with pytest.raises(OutputError, match=f"{name}: expected"):
        format_of(Path(name), wanted)
