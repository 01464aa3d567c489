"""A rig to start from names every sensor; what is not known is `TODO`, and the file is read back as it stands."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rig_messages
import yaml
from memory_recording import MemoryRecording
from rig_messages import K, boxes_2d, discover, reasons, static

from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.rig.draft import draft_yaml
from lidcam.readers.rig.rig_file import load_rig
from lidcam.readers.rig.schema import RigFile, parse_rig
from lidcam.readers.rig.search import find_sensors


def cloud(number: int, frame: str | None = None) -> RawMessage:
    return rig_messages.cloud(f"/velodyne{number}_points", f"velodyne{number}" if frame is None else frame)


def image_message(number: int, frame: str = "") -> RawMessage:
    return rig_messages.image_message(f"/image_raw_{number}", frame)


def info(number: int, frame: str = "", **options: int) -> RawMessage:
    return rig_messages.info(f"/camera_info_{number}", frame, **options)


def boxes(number: int, frame: str) -> RawMessage:
    return boxes_2d(f"/detections_{number}", frame)


UNCALIBRATED = [cloud(1), cloud(2), image_message(11), image_message(12, "camera_12"), boxes(12, "camera_12")]


def draft(messages: list[RawMessage], rig: RigFile | None = None) -> str:
    found = find_sensors(MemoryRecording(messages), Config(), rig, start_ns=None, stop_ns=None)
    return draft_yaml(found, found.zones)


def read(text: str, tmp_path: Path) -> RigFile:
    (tmp_path / "rig.yaml").write_text(text)
    return load_rig(tmp_path / "rig.yaml")


def test_a_recording_without_calibration() -> None:
    assert draft(UNCALIBRATED).split("\n", 3)[3] == (
        """\
site_frame: velodyne1 # the frame of velodyne1
lidars:
  velodyne1:
    topic: /velodyne1_points # sensor_msgs/msg/PointCloud2, 1 points in the first message
    frame_id: velodyne1
    T_site_lidar:
    - [1.0, 0.0, 0.0, 0.0]
    - [0.0, 1.0, 0.0, 0.0]
    - [0.0, 0.0, 1.0, 0.0]
    - [0.0, 0.0, 0.0, 1.0]
  velodyne2:
    topic: /velodyne2_points # sensor_msgs/msg/PointCloud2, 1 points in the first message
    frame_id: velodyne2
    T_site_lidar: TODO # TODO 4 x 4, metres; or translation_m and rpy_deg in its place (no transform joins frame \
'velodyne2' with 'velodyne1'; frames with a fixed transform: none at all; name \
the file with /tf_static beside this one, give its pose in a rig file (--rig), or --set 'topics.exclude=[TOPIC]')
cameras:
  cam11:
    topic: /image_raw_11 # sensor_msgs/msg/Image
    width_px: 64
    height_px: 48
    K: TODO # TODO 3 x 3, pixels; then distortion_model and distortion (the recording has no CameraInfo of it: give \
its K in a rig file (--rig; inspect --write-rig drafts one))
    T_camera_site: TODO # TODO 4 x 4, metres; or translation_m and rpy_deg in its place (no message of it names its \
frame: give its pose in a rig file (--rig))
  cam12:
    topic: /image_raw_12 # sensor_msgs/msg/Image
    boxes_topic: /detections_12
    frame_id: camera_12
    width_px: 64
    height_px: 48
    K: TODO # TODO 3 x 3, pixels; then distortion_model and distortion (the recording has no CameraInfo of it: give \
its K in a rig file (--rig; inspect --write-rig drafts one))
    T_camera_site: TODO # TODO 4 x 4, metres; or translation_m and rpy_deg in its place (no transform joins frame \
'velodyne1' with 'camera_12'; frames with a fixed transform: none at all; name \
the file with /tf_static beside this one, give its pose in a rig file (--rig), or --set 'topics.exclude=[TOPIC]')
zones: {}
"""
    )


def test_what_is_still_to_do_is_told(tmp_path: Path) -> None:
    found = discover(UNCALIBRATED, read(draft(UNCALIBRATED), tmp_path))
    assert [lidar.name for lidar in found.rig.lidars] == ["velodyne1"]
    assert reasons(found) == {
        "velodyne2": "extrinsics are still TODO in rig.yaml",
        "cam11": "intrinsics and extrinsics are still TODO in rig.yaml",
        "cam12": "intrinsics and extrinsics are still TODO in rig.yaml",
    }


def test_a_completed_draft_is_a_rig(tmp_path: Path) -> None:
    text = draft(UNCALIBRATED)
    given = {"K": f"K: {K.tolist()}", "T_site_lidar": "translation_m: [1, 2, 3]", "T_camera_site": "rpy_deg: [0, 0, 9]"}
    for key, value in given.items():
        text = re.sub(rf"\b{key}: TODO.*", value, text)
    assert "TODO" not in text
    rig = read(text, tmp_path)
    found = discover(UNCALIBRATED, rig)
    assert found.faults == ()
    assert [lidar.T_site_lidar.translation.tolist() for lidar in found.rig.lidars] == [[0, 0, 0], [1, 2, 3]]
    again = read(draft(UNCALIBRATED, rig), tmp_path)
    same = discover(UNCALIBRATED, again)
    assert same.faults == ()
    for one, other in zip(found.rig.cameras, same.rig.cameras, strict=True):
        np.testing.assert_allclose(one.T_camera_site.matrix, other.T_camera_site.matrix, atol=1e-15)


def test_what_is_known_is_written_beside_what_is_not(tmp_path: Path) -> None:
    messages = [cloud(1), image_message(11, "c11"), info(11, "c11")]
    messages += [image_message(12, "c12"), info(12, "c12", width_px=32)]
    messages += [static(("site", "velodyne1", (1, 2, 3)), ("site", "c12", (1, 2, 3)))]
    tree = yaml.safe_load(draft(messages))
    assert tree["site_frame"] == "site"
    assert tree["cameras"]["cam11"]["K"] == K.tolist()
    assert tree["cameras"]["cam11"]["T_camera_site"] == "TODO"
    assert (tree["cameras"]["cam12"]["width_px"], tree["cameras"]["cam12"]["K"]) == (64, "TODO")
    assert np.shape(tree["cameras"]["cam12"]["T_camera_site"]) == (4, 4)
    found = discover(messages, read(draft(messages), tmp_path))
    assert reasons(found) == {
        "cam11": "extrinsics are still TODO in rig.yaml",
        "cam12": "intrinsics are still TODO in rig.yaml",
    }


def test_cameras_of_a_rig_without_a_site_frame_keep_their_poses() -> None:
    rig = RigFile.model_validate({"cameras": {"cam11": {"K": K.tolist(), "translation_m": [1, 2, 3]}}})
    tree = yaml.safe_load(draft([cloud(1), image_message(11, "c")], rig))
    assert tree["site_frame"] == "site"
    assert tree["lidars"]["velodyne1"]["T_site_lidar"] == "TODO"
    assert np.shape(tree["cameras"]["cam11"]["T_camera_site"]) == (4, 4)


@pytest.mark.parametrize(
    ("messages", "known", "expected"),
    [
        ([boxes(12, "c"), info(12, "c")], {}, (64, 48)),
        ([boxes(12, "c")], {}, ("TODO", "TODO")),
        ([boxes(12, "c")], {"K": K.tolist(), "width_px": 32, "height_px": 24}, (32, 24)),
        ([boxes(12, "c")], {"K": K.tolist()}, ("TODO", "TODO")),
    ],
)
def test_the_size_of_images(messages: list[RawMessage], known: dict[str, Any], expected: tuple[Any, Any]) -> None:
    entry = {"boxes_topic": "/detections_12", **known}
    text = draft([cloud(1), *messages], RigFile.model_validate({"site_frame": "s", "cameras": {"c": entry}}))
    camera = yaml.safe_load(text)["cameras"]["c"]
    assert (camera["width_px"], camera["height_px"]) == expected
    assert ("does not say how large its images are" in text) == ("K" in known and expected[0] == "TODO")


def test_what_a_rig_file_says_is_kept() -> None:
    tree = {
        "ground_height_m": 1.5,
        "lidars": {"velodyne1": {"time_offset_ms": 12.5}},
        "cameras": {"image11": {"time_offset_ms": -35}},
        "zones": {},
        "transforms": {"base": {"velodyne1": {"translation_m": (0.0, 0.0, 2.0)}, "imu": {"rpy_deg": (0.0, 0.0, 90.0)}}},
        "default_transforms": {"imu": {"gnss": {}}},
        "truth": {"car1": {"topic": "/odom", "size_m": [4, 2, 1.5], "class": "van"}},
    }
    rig = RigFile.model_validate(tree)
    again = parse_rig(yaml.safe_load(draft([cloud(1), image_message(11)], rig)), Path("rig.yaml"))
    assert (again.site_frame, again.ground_height_m, again.zones, again.vehicles) == ("base", 1.5, {}, rig.vehicles)
    assert (again.transforms, again.default_transforms) == (rig.transforms, rig.default_transforms)
    sensors = [*(again.lidars or {}).values(), *(again.cameras or {}).values()]
    assert [one.time_offset_ms for one in sensors] == [12.5, -35]
    bare = draft([cloud(1)])
    assert not any(word in bare for word in ("transforms", "time_offset_ms", "truth", "ground_height_m"))
    assert yaml.safe_load(bare)["cameras"] == {}
