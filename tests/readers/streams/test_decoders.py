import numpy as np
import pytest
from builders import detection2d_array, image, pointcloud2, raw
from velodyne import random_packets, scan

from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import MessageError
from lidcam.pipeline.core.frame import Decoded, SensorBundle
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.optics.images import Image
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.core.settings.load import load_config
from lidcam.pipeline.core.settings.recording import RecordingLimits
from lidcam.readers.streams.decoders import CloudDecoder, ImageDecoder, RecordedBoxes

TOPIC = "/velodyne_packets"


def bundle(message: RawMessage) -> SensorBundle:
    return SensorBundle(0, message.stamp_ns, message.log_time_ns, {message.topic: message})


def decoder(topic: str, on_bad: str = "skip", *, time_offset_ns: int = 0) -> CloudDecoder:
    lidar = LidarSensor("top", topic, Transform.identity("site", "velo_link"), time_offset_ns)
    return CloudDecoder(Rig("site", (lidar,), (), (), None), Config(), on_bad=on_bad)  # type: ignore[arg-type]  # one of two words


def packets(frame_id: str) -> RawMessage:
    return scan(*random_packets("VLP-16", packets=3), frame_id=frame_id)


@pytest.mark.parametrize(("frame_id", "expected"), [("", "velo_link"), ("velodyne", "velodyne")])
def test_a_cloud_without_a_frame_has_that_of_its_lidar(frame_id: str, expected: str) -> None:
    cloud = raw("/points", "sensor_msgs/msg/PointCloud2", pointcloud2([[1, 2, 3]], stamp_ns=5, frame_id=frame_id), 5)
    for message in (packets(frame_id), cloud):
        decoded = decoder(message.topic)(bundle(message))
        assert decoded["top"].frame_id == expected
        assert decoded.drops == ()


def test_parts_that_took_no_part_are_drops_of_their_own() -> None:
    payload, stamps_ns = random_packets("VLP-16", packets=5)
    payload[1] = 0
    message = lacking(scan(payload, stamps_ns), "short")
    decoded = decoder(TOPIC)(bundle(message))
    assert len(decoded["top"])
    assert [(drop.reason, drop.parts) for drop in decoded.drops] == [
        ("packets that cannot be decoded", 1),
        ("packets with blocks that a VLP-16 does not send", 1),
    ]


def test_a_message_that_cannot_be_decoded_is_one_drop() -> None:
    message = lacking(packets("")._replace(data=b"short"), "short")
    decoded = decoder(TOPIC)(bundle(message))
    assert dict(decoded) == {}
    assert [(drop.reason, drop.parts) for drop in decoded.drops] == [("cannot be decoded", 0)]
    with pytest.raises(MessageError, match="that is cut off"):
        decoder(TOPIC, "fail")(bundle(message))


def lacking(message: RawMessage, *reasons: str) -> RawMessage:
    return message._replace(defects=reasons)


@pytest.mark.parametrize("offset_ns", [0, 80_000_000, -3_000_000_000])
def test_times_of_points_move_with_the_corrected_stamp(offset_ns: int) -> None:
    """Packets and fields of absolute time are by the same clock as the stamp in the header."""
    seconds = np.array([1e3, 1e3 + 0.05])
    fields = pointcloud2([[1, 2, 3], [4, 5, 6]], stamp_ns=10**12, frame_id="lidar", timestamp=seconds)
    for recorded in (packets("velodyne"), raw("/points", "sensor_msgs/msg/PointCloud2", fields, 10**12)):
        plain = decoder(recorded.topic)(bundle(recorded))["top"]
        corrected = recorded._replace(stamp_ns=recorded.stamp_ns - offset_ns)
        cloud = decoder(recorded.topic, time_offset_ns=offset_ns)(bundle(corrected))["top"]
        assert plain.has_time
        assert cloud.has_time
        assert cloud.stamp_ns == plain.stamp_ns - offset_ns
        np.testing.assert_array_equal(cloud.time_offset_ns, plain.time_offset_ns)


NUMBERS = ["0", "1", "2", "3", "4", "5", "6", "7", "79", "80", "truck", "person"]


def classes_of(settings: dict[str, str]) -> tuple[dict[str, str], dict[str, int]]:
    """Class by recorded label, and the labels that are not used."""
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    model = CameraModel("cam", 640, 480, K, "plumb_bob", np.zeros(0))
    camera = CameraSensor("cam", "", "/boxes", model, Transform.identity("cam", "site"))
    config = load_config(None, settings)
    found: dict[str, str] = {}
    unused: dict[str, int] = {}
    for label in NUMBERS:
        array = detection2d_array([[0, 0, 5, 5]], class_names=[label], scores=[0.9], stamp_ns=5)
        message = raw("/boxes", "vision_msgs/msg/Detection2DArray", array, 5)
        decoded = RecordedBoxes(Rig("site", (), (camera,), ()), config, on_bad="skip")(bundle(message))
        for row in decoded["cam"].class_ids.tolist():
            found[label] = config.class_names[row]
        unused |= decoded.unused_boxes
    return found, unused


@pytest.mark.parametrize(
    ("settings", "classes"),
    [
        ({}, ["", "car", "pedestrian", "bicycle", "truck", "truck", "bus", ""]),
        ({"detect2d.class_numbers": "coco"}, ["pedestrian", "bicycle", "car", "bicycle", "", "bus", "", "truck"]),
    ],
    ids=["of the predecessor system and of the simulator", "of COCO"],
)
def test_what_numbers_mean(settings: dict[str, str], classes: list[str]) -> None:
    found, unused = classes_of(settings)
    expected = dict(zip(NUMBERS, [*classes, "", "", "truck", "pedestrian"], strict=True))
    assert found == {label: name for label, name in expected.items() if name}
    assert unused == {f"class {label!r} is not configured": 1 for label, name in expected.items() if not name}


def lidars(count: int) -> Rig:
    pose = Transform.identity("site", "lidar")
    return Rig("site", tuple(LidarSensor(f"l{i}", f"/l{i}", pose) for i in range(count)), (), ())


def clouds(*counts: int) -> SensorBundle:
    messages = {
        f"/l{i}": raw(f"/l{i}", "sensor_msgs/msg/PointCloud2", pointcloud2(np.ones((n, 3)), stamp_ns=1), 1)
        for i, n in enumerate(counts)
    }
    return SensorBundle(0, 1, 1, messages)


DEFAULT_LIMITS = "lidcam.pipeline.core.settings.config.DEFAULT_LIMITS"


def test_the_clouds_of_a_frame_share_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DEFAULT_LIMITS, RecordingLimits(max_points=50, max_frame_points=60))
    config = Config()
    found = CloudDecoder(lidars(4), config, on_bad="skip")(clouds(40, 51, 30, 20))
    assert {name: len(cloud) for name, cloud in found.items()} == {"l0": 40, "l3": 20}
    assert [drop.detail for drop in found.drops] == [
        "/l1: 1 x 51 points, expected at most 50: raise limit_scale",
        "/l2: 1 x 30 points, and 40 in other clouds of the frame, expected at most 60 in all: raise limit_scale",
    ]
    with pytest.raises(MessageError, match=r"raise limit_scale"):
        CloudDecoder(lidars(2), config, on_bad="fail")(clouds(40, 30))


def decoded_images(sizes_px: list[tuple[int, int]], calibrated_px: list[tuple[int, int]]) -> Decoded[Image]:
    """Images (width, height) of cameras c0, c1 and so on."""
    models = [CameraModel("c", *size, np.diag([500.0, 500, 1]), "plumb_bob", np.zeros(5)) for size in calibrated_px]
    pose = Transform.identity("c", "site")
    cameras = tuple(CameraSensor(f"c{i}", f"/c{i}", "", model, pose) for i, model in enumerate(models))
    images = [image(np.zeros((height, width, 3), np.uint8), stamp_ns=1) for width, height in sizes_px]
    messages = {f"/c{i}": raw(f"/c{i}", "sensor_msgs/msg/Image", one, 1) for i, one in enumerate(images)}
    return ImageDecoder(Rig("site", (), cameras, ()), Config(), on_bad="skip")(SensorBundle(0, 1, 1, messages))


def test_images_of_another_size_than_the_calibration_are_dropped() -> None:
    found = decoded_images(
        [(1242, 375), (1224, 370), (621, 188), (1242, 360)], [(1242, 375)] * 4
    )  # the second: KITTI's
    assert [*found] == ["c0", "c1"]
    assert [drop.detail for drop in found.drops] == [
        f"{topic}: an image of {size} px, expected 1242 x 375 px, as of its calibration: split the recording where the "
        "size changes"
        for topic, size in (("/c2", "621 x 188"), ("/c3", "1242 x 360"))
    ]


def test_the_images_of_a_frame_share_a_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(DEFAULT_LIMITS, RecordingLimits(max_frame_mpx=1e-4))
    sizes_px = [(10, 8), (10, 9), (10, 2)]
    found = decoded_images(sizes_px, sizes_px)
    assert [*found] == ["c0", "c2"]
    (drop,) = found.drops
    assert drop.detail == (
        "/c1: an image of 10 x 9 px, and 80 in other images of the frame, expected at most 0.0001 million pixels in "
        "all: raise limit_scale"
    )
