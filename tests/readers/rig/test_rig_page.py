"""The page of the rig file names every key, and its example is a rig."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from builders import image, pointcloud2, raw
from helpers import ROOT
from memory_recording import MemoryRecording

from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.rig.discovery import discover_rig
from lidcam.readers.rig.rig_file import load_rig
from lidcam.readers.rig.schema import CameraEntry, LidarEntry, Pose, RigFile, TruthEntry

PAGE = (ROOT / "docs" / "rig.md").read_text(encoding="utf-8")
EXAMPLE = PAGE.split("```yaml\n")[1].split("```")[0]


def test_the_example_is_a_rig(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(EXAMPLE)
    lidars = [
        raw(topic, "sensor_msgs/msg/PointCloud2", pointcloud2([[1, 2, 3]], stamp_ns=5, frame_id=topic[1:5]), 5)
        for topic in ("/roof/points", "/bumper/points")
    ]
    fields: Any = image(np.zeros((720, 1280), np.uint8), stamp_ns=5, frame_id="", encoding="mono8")
    topics = ("/front/image_raw/compressed", "/left/image_raw", "/right/image_raw", "/rear/image_raw")
    cameras = [raw(topic, "sensor_msgs/msg/Image", fields, 5) for topic in topics]
    found = discover_rig(MemoryRecording([*lidars, *cameras]), Config(), load_rig(tmp_path / "rig.yaml"))
    assert [(fault.sensor, fault.reason) for fault in found.faults] == [
        ("rear", "extrinsics are still TODO in rig.yaml")
    ]
    assert [camera.name for camera in found.rig.cameras] == ["front", "left", "right"]
    forward = [camera.T_camera_site.inverse().matrix[:3, 2] for camera in found.rig.cameras]
    np.testing.assert_allclose(forward, [[1, 0, 0], [0, 1, 0], [0, -1, 0]], atol=1e-6)
    np.testing.assert_allclose(found.rig.lidars[1].T_site_lidar.translation, [3.6, 0, 0.5])
    assert found.transforms.are_joined("base_link", "imu_optical")


@pytest.mark.parametrize("model", [RigFile, LidarEntry, CameraEntry, Pose, TruthEntry])
def test_every_key_is_explained_and_shown(model: Any) -> None:
    explained = set(re.findall(r"`(\w+)`", PAGE.split("| key | meaning |")[1].split("\n\n")[0]))
    keys = {field.alias or name for name, field in model.model_fields.items()} - {"missing", "camera_info"}
    assert keys <= explained
    shown = yaml.safe_load(EXAMPLE)
    sensors = [entry for kind in ("lidars", "cameras", "truth") for entry in shown[kind].values()]
    assert keys <= {*shown, *(key for sensor in sensors for key in sensor)}
