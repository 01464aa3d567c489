"""Rigs by path and by name; the predecessor system's rig has the poses that its cameras and lidars had."""

from pathlib import Path

import numpy as np
import pytest
from rig_messages import cloud, discover, image_message

import lidcam
from lidcam.pipeline.core.errors import CalibrationError
from lidcam.pipeline.core.settings.bundled import bundled
from lidcam.readers.rig.schema import RigFile
from lidcam.run.job import make_job, read_rig

CAMERAS = (11, 12, 13, 14, 41, 42, 43, 44)


def test_rigs_by_name_and_by_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path in bundled("rigs").glob("*.yaml"):
        assert read_rig(path.stem) == lidcam.load_rig(path.stem) == read_rig(path) != RigFile()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").touch()
    assert read_rig("mine") == RigFile()
    for name in ("orginal", "orginal.yaml", "rigs/original"):
        with pytest.raises(
            CalibrationError, match=rf"^{name}: expected a preset \(.*original.*did you mean 'original'\?"
        ):
            read_rig(name)


def test_several_rigs_of_a_job_are_one(tmp_path: Path) -> None:
    lens = tmp_path / "lens.yaml"
    lens.write_text("cameras: {cam11: {K: [500, 0, 320, 0, 500, 240, 0, 0, 1]}}\n")
    job = make_job("a.bag", rig=["original", lens])
    assert job.rig is not None
    assert job.rig == make_job("a.bag", rig=[read_rig("original") or RigFile(), str(lens)]).rig
    camera = (job.rig.cameras or {})["cam11"]
    assert (camera.K or ())[0] == 500
    assert camera.translation_m == (-0.143, 0.371, 0.393)
    with pytest.raises(CalibrationError, match=r"original\.yaml and rig 2: site_frame"):
        make_job("a.bag", rig=["original", RigFile(site_frame="elsewhere")])


def test_the_rig_of_the_predecessor_system() -> None:
    messages = [cloud(f"/velodyne{n}_points", f"v{n}") for n in (1, 2, 3)]
    messages += [image_message(f"/image_raw_{n}", f"camera_{n}", size=(640, 480)) for n in CAMERAS]
    found = discover(messages, read_rig("original"))
    assert found.rig.site_frame == "point_cloud"
    assert [lidar.topic for lidar in found.rig.lidars] == [f"/velodyne{n}_points" for n in (1, 2, 3)]
    np.testing.assert_allclose(found.rig.lidars[2].T_site_lidar.translation, [9.74248361e-04, -0.98929235, 0.191780397])
    assert [(fault.sensor, fault.reason) for fault in found.faults] == [
        ("cam12", "extrinsics are still TODO in original.yaml")
    ]
    assert [camera.topic for camera in found.rig.cameras] == [f"/image_raw_{n}" for n in CAMERAS if n != 12]
    poses = {camera.name: camera.T_camera_site.inverse().matrix for camera in found.rig.cameras}
    looks = {"cam11": (0, 1), "cam13": (-1, 0), "cam14": (1, 0), "cam41": (0, -1), "cam42": (1, 0), "cam43": (0, 1)}
    for name, (x, y) in (looks | {"cam44": (-1, 0)}).items():
        np.testing.assert_allclose(poses[name][:3, 2], [x, y, 0], atol=1e-12)
        np.testing.assert_allclose(poses[name][:3, 1], [0, 0, -1], atol=1e-12)  # upright
    np.testing.assert_allclose(poses["cam42"][:3, 3], [0.094, -1.0, 0.335])
    assert [zone.name for zone in found.rig.zones] == ["intersection", "circle"]
