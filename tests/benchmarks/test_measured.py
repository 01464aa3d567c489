"""What the scripts that measure are given."""

from pathlib import Path

import numpy as np
import pytest
from belief_fit import labelled_boxes, weighed
from held_out_worlds import look_at_world, named_settings
from labelled_frames import labelled_frames

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.geometry.transform import Transform

CALIBRATION = "\n".join(
    [f"P{camera}: 700 0 600 0 0 700 180 0 0 0 1 0" for camera in range(4)]
    + ["R0_rect: 1 0 0 0 1 0 0 0 1", "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0", ""]
)
DONT_CARE = "DontCare -1 -1 -10 10 20 30 40 -1 -1 -1 -1000 -1000 -1000 -10\n"
PNG = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + (1242).to_bytes(4, "big") + (375).to_bytes(4, "big")


def test_a_labelled_frame_without_objects(tmp_path: Path) -> None:
    for name, content in {"calib/0.txt": CALIBRATION, "label_2/0.txt": DONT_CARE}.items():
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(content)
    (tmp_path / "image_2").mkdir()
    (tmp_path / "image_2" / "0.png").write_bytes(PNG)
    (frame,) = labelled_frames(tmp_path)
    assert (frame.camera.width_px, frame.camera.height_px) == (1242, 375)
    assert frame.unlabelled_xyxy.tolist() == [[10, 20, 30, 40]]
    assert len(labelled_boxes(frame.labels, Transform("site", "velodyne", np.eye(4)), ("car",))) == 0


def test_a_folder_without_labelled_frames_is_a_recording(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=str(tmp_path)):
        weighed(str(tmp_path), tmp_path, ())


@pytest.mark.parametrize(
    ("given", "settings"),
    [
        ("a:", ()),
        ("a:x.y=1", ("x.y=1",)),
        ("a:x=[1,2],lidars.*.z={a: 1,b: 2},y=c=d", ("x=[1,2]", "lidars.*.z={a: 1,b: 2}", "y=c=d")),
    ],
)
def test_settings_of_a_detector(given: str, settings: tuple[str, ...]) -> None:
    assert named_settings(given) == ("a", settings)


def test_each_detector_gets_the_cloud_that_its_settings_combine() -> None:
    clusters = "detect3d.method=cluster"
    found = look_at_world("sandbox", {"no": (clusters, "combine.max_range_m=0.1"), "all": (clusters,)}, 3)
    assert {name: any(len(boxes[name]) for _, boxes in found) for name in ("no", "all")} == {"no": False, "all": True}
