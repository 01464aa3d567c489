"""Calibration that cannot be right is said after a run and, where one message tells, by an inspection."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from builders import pointcloud2, raw
from detections import forward_camera
from frames import frame
from helpers import CLUSTERS, SANDBOX

import lidcam
from lidcam.checks.calibration.rig_check import CalibrationCheck
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import CameraFit, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config


def test_the_sample_as_calibrated_gives_no_warning() -> None:
    assert lidcam.process(SANDBOX, config="sandbox", settings=[CLUSTERS]).summary.warnings == ()
    assert lidcam.inspect(SANDBOX).warnings == ()


def test_an_inverted_lidar_is_named_and_not_the_cameras(tmp_path: Path) -> None:
    tree = yaml.safe_load(SANDBOX.with_name("sandbox.bag.rig.yaml").read_text())
    del tree["ground_height_m"]
    lidar = tree["lidars"]["velodyne3"]
    lidar["T_site_lidar"] = np.linalg.inv(lidar["T_site_lidar"]).tolist()
    rig = tmp_path / "rig.yaml"
    rig.write_text(yaml.safe_dump(tree))
    report = lidcam.process(SANDBOX, config="sandbox", settings=[CLUSTERS], rig=rig).summary
    by_subject = {warning.subject: str(warning) for warning in report.warnings}
    assert by_subject.keys() == {"ground", "velodyne3"}
    assert by_subject["velodyne3"].startswith(
        "velodyne3: its ground lies at z = -0.87 m, and with the inverse of its extrinsics at 0.00 m"
    )
    # On one sweep: the defaults are for metres, not for a model of 1:14.
    of_model = {"combine.ground.height_tolerance_m": 0.1, "combine.ground.distance_m": 0.02}
    [warning] = lidcam.inspect(SANDBOX, rig=rig, settings=of_model).warnings
    assert warning.subject == "velodyne3"


def ground_message(sensor: LidarSensor, *, stamp_ns: int) -> RawMessage:
    """Flat ground around a lidar, in the lidar's frame."""
    random = np.random.default_rng(1)
    xyz = np.c_[random.uniform(-15, 15, (1500, 2)), np.full(1500, -sensor.T_site_lidar.translation[2])]
    fields = pointcloud2(xyz.astype(np.float32), stamp_ns=stamp_ns, frame_id=sensor.name)
    return raw(sensor.topic, "sensor_msgs/msg/PointCloud2", fields, stamp_ns)


def test_a_lidar_that_begins_late_is_looked_at_too() -> None:
    """It is in the last two of five frames. Cameras are told only where they are not used."""
    places = {"a": (0.0, 0.0, 1.8), "b": (0.0, 3.0, 2.4), "late": (0.0, -3.0, 1.2)}
    *others, late = (
        LidarSensor(name, f"/{name}", Transform.from_quaternion("site", name, place, (0, 0, 0, 1)))
        for name, place in places.items()
    )
    inverted = replace(late, T_site_lidar=Transform("site", late.name, late.T_site_lidar.inverse().matrix))
    unused = replace(forward_camera("unused"), fit=CameraFit(is_used=False))
    check = CalibrationCheck(Rig("site", (*others, inverted), (forward_camera("sound"), unused), ()), Config())
    for index in range(5):
        lidars = [*others, late] if index >= 3 else others
        messages = {lidar.topic: ground_message(lidar, stamp_ns=10**9 + index) for lidar in lidars}
        whole = frame(index)
        check.add_frame(replace(whole, bundle=replace(whole.bundle, messages=messages)))
    assert [warning.subject for warning in check.warnings] == ["late", "unused"]
