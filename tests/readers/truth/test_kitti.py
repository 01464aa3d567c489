from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidcam.pipeline.core.camera import CameraModel
from lidcam.pipeline.core.errors import CalibrationError, RecordingError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor, LidarSensor, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.pipeline.evaluation.evaluation_frame import UNKNOWN, TruthBoxes3D
from lidcam.readers.truth.kitti import KittiTruth

K = np.array([[700.0, 0, 600], [0, 700, 180], [0, 0, 1]])
T_RECT_VELO = np.array([[0.0, -1, 0, 0.01], [0, 0, -1, -0.08], [1, 0, 0, -0.27], [0, 0, 0, 1]])
SHIFT_M = 0.06
"""Of camera 2 against camera 0: the last column of P2 over fx."""


def row(matrix: Any) -> str:
    return " ".join(f"{value:.12g}" for value in np.asarray(matrix).ravel())


P2 = np.c_[K, [700 * SHIFT_M, 0, 0]]
P0 = np.c_[K, np.zeros(3)]
CALIB = f"P0: {row(P0)}\nP2: {row(P2)}\nR0_rect: {row(np.eye(3))}\nTr_velo_to_cam: {row(T_RECT_VELO[:3])}\n"

TRACKING_CALIB = CALIB.replace("R0_rect:", "R_rect").replace("Tr_velo_to_cam:", "Tr_velo_cam")
"""As the tracking benchmark has it: with other names, and without colons."""

CAR = "Car 0.10 1 -1.57 500.0 150.0 600.0 220.0 1.50 1.80 4.20 2.0 1.6 20.0 -1.570796"
VAN = "Van 0.00 0 0.0 100.0 150.0 180.0 220.0 2.0 2.0 5.0 -8.0 1.6 15.0 0.0"
SITTING = "Person_sitting 0.00 0 0.0 100.0 150.0 180.0 220.0 1.2 0.6 0.8 -8.0 1.6 15.0 0.0"
PERSON = SITTING.replace("Person_sitting", "Person")
FAR = "Pedestrian 0.00 2 0.0 700.0 170.0 710.0 196.0 1.75 0.6 0.8 4.0 1.6 40.0 3.0"
TRAM = "Tram 0.60 0 0.0 100.0 150.0 180.0 220.0 3 2 15 -8.0 1.6 15.0 0.0"
NOBODY = "DontCare -1 -1 -10 10.0 20.0 30.0 40.0 -1 -1 -1 -1000 -1000 -1000 -10"


def rig() -> Rig:
    """A site in which the Velodyne stands 1.7 m high, with camera 2, and camera 3 half a metre beside it."""
    T_site_lidar = np.eye(4)
    T_site_lidar[:3, 3] = 0.5, 0.0, 1.7
    cameras = []
    for name, shift in (("left", SHIFT_M), ("right", SHIFT_M - 0.54)):
        T_camera_velo = T_RECT_VELO.copy()
        T_camera_velo[0, 3] += shift
        pose = Transform(name, "site", T_camera_velo @ np.linalg.inv(T_site_lidar))
        model = CameraModel(name, 1242, 375, K, "plumb_bob", np.zeros(0))
        cameras.append(CameraSensor(name, f"/{name}", "", model, pose))
    lidar = LidarSensor("velodyne", "/velodyne", Transform("site", "velodyne", T_site_lidar))
    return Rig("site", (lidar,), tuple(cameras), ())


def folder(tmp_path: Path, *files: str, calib: str = CALIB) -> Path:
    (tmp_path / "label_2").mkdir()
    (tmp_path / "calib").mkdir()
    for number, text in enumerate(files):
        (tmp_path / "label_2" / f"{number:06}.txt").write_text(text)
        (tmp_path / "calib" / f"{number:06}.txt").write_text(calib)
    return tmp_path


def boxes_of(path: Path, rig_: Rig | None = None, config: Config | None = None, *, frame: int = 0) -> TruthBoxes3D:
    found = KittiTruth(path, rig_ or rig(), config or Config()).at(123, frame=frame)
    assert found is not None
    return found


def test_a_box_stands_where_the_calibration_puts_it(tmp_path: Path) -> None:
    found = boxes_of(folder(tmp_path, CAR))
    assert (found.stamp_ns, found.frame_id, found.labels.tolist()) == (123, "site", ["Car"])
    # 20 m ahead of the camera, 2 m to its right; the bottom 1.6 m below it, the centre 0.75 m above that
    expected = [20 + 0.27 + 0.5, -(2 - 0.01), -(1.6 - 0.75) - 0.08 + 1.7]
    np.testing.assert_allclose(found.centers, [expected], atol=1e-9)
    np.testing.assert_allclose(found.sizes, [[4.2, 1.8, 1.5]])
    np.testing.assert_allclose(found.yaws, [0.0], atol=1e-6)  # rotation_y of -90 degrees looks ahead
    assert Config().class_names[found.class_ids[0]] == "car"
    assert (found.track_ids[0], found.lidar_points[0], found.is_ignored[0]) == (UNKNOWN, UNKNOWN, False)


def test_neutral_classes_and_others(tmp_path: Path) -> None:
    text = "\n".join([CAR, VAN, SITTING, TRAM, NOBODY])
    found = boxes_of(folder(tmp_path, text))
    image = KittiTruth(tmp_path, rig(), Config()).in_image("left", 7, frame=0)
    assert image is not None
    names = ["Car", "Van", "Person_sitting", "Tram"]
    assert found.labels.tolist() == names
    assert found.is_ignored.tolist() == [False, True, True, False]
    assert found.class_ids[2:].tolist() == [1, UNKNOWN]
    assert image.labels.tolist() == [*names, "DontCare"]
    assert image.is_ignored.tolist() == [False, True, True, False, True]
    assert image.xyxy[4].tolist() == [10, 20, 30, 40]
    assert image.stamp_ns == 7


@pytest.mark.parametrize(
    ("level", "ignored"),
    [(None, []), ("easy", ["Car", "Pedestrian", "Tram"]), ("moderate", ["Pedestrian", "Tram"]), ("hard", ["Tram"])],
)
def test_levels_of_difficulty(tmp_path: Path, level: str | None, ignored: list[str]) -> None:
    config = Config.model_validate({"evaluate": {"kitti_difficulty": level}})
    found = boxes_of(folder(tmp_path, "\n".join([CAR, FAR, TRAM])), config=config)
    assert found.labels[found.is_ignored].tolist() == ignored


def test_only_images_of_the_labelled_camera_have_boxes(tmp_path: Path) -> None:
    truth = KittiTruth(folder(tmp_path, CAR), rig(), Config())
    assert truth.in_image("left", 0, frame=0) is not None
    assert truth.in_image("right", 0, frame=0) is None
    assert truth.in_image("none", 0, frame=0) is None
    behind = rig()
    turned = Transform("left", "site", np.diag([-1.0, 1, -1, 1]) @ behind.cameras[0].T_camera_site.matrix)
    behind = replace(behind, cameras=(replace(behind.cameras[0], T_camera_site=turned),))
    assert KittiTruth(tmp_path, behind, Config()).in_image("left", 0, frame=0) is None
    calib = tmp_path / "calib" / "000000.txt"
    calib.write_text("\n".join(line for line in CALIB.splitlines() if not line.startswith("P2")))
    assert len(boxes_of(tmp_path)) == 1
    assert KittiTruth(tmp_path, rig(), Config()).in_image("left", 0, frame=0) is None


def test_files_belong_to_frames_in_their_order(tmp_path: Path) -> None:
    truth = KittiTruth(folder(tmp_path, CAR, "", f"{CAR}\n\n{VAN}\n") / "label_2", rig(), Config())
    assert [len(found) for k in (0, 1, 2, 0) if (found := truth.at(0, frame=k)) is not None] == [1, 0, 2, 1]
    assert truth.notes == (
        f"KITTI labels of {tmp_path / 'label_2'}: 3 files, matched with the frames of the result in their order",
        f"KITTI labels of {tmp_path / 'label_2'}: only what camera 2 sees is labelled, and boxes elsewhere are false; "
        "leave them out with evaluate.region=[[0,0],[70,59],[70,-59]]",
    )
    assert truth.at(0, frame=3) is None
    assert truth.in_image("left", 0, frame=3) is None
    assert truth.notes[-1] == f"KITTI labels of {tmp_path / 'label_2'}: frames of the result from 3 on have no labels"
    config = Config.model_validate({"evaluate": {"region": [[0, 0], [70, 59], [70, -59]]}})
    assert len(KittiTruth(tmp_path, rig(), config).notes) == 1
    one = tmp_path / "label_2" / "000002.txt"
    assert boxes_of(one).labels.tolist() == ["Car", "Van"]
    assert KittiTruth(one, rig(), Config()).at(0, frame=1) is None


def test_the_tracking_benchmark_numbers_frames_and_objects(tmp_path: Path) -> None:
    text = "\n".join([f"0 -1 {NOBODY}", f"0 3 {CAR}", f"2 3 {CAR}", f"2 5 {VAN}", f"3 6 {FAR}", f"3 7 {PERSON}"])
    path = folder(tmp_path, text, calib=TRACKING_CALIB) / "label_2" / "000000.txt"
    truth = KittiTruth(path, rig(), Config())
    found = [truth.at(0, frame=k) for k in range(5)]
    assert [None if one is None else one.track_ids.tolist() for one in found] == [[3], [], [3, 5], [6, 7], None]
    assert found[3] is not None
    assert found[3].is_ignored.tolist() == [False, True], "one who sits"
    image = truth.in_image("left", 0, frame=0)
    assert image is not None
    assert image.track_ids.tolist() == [-1, 3]


@pytest.mark.parametrize(
    ("files", "problem"),
    [
        ([CAR + " 0.9"], "expected 15 columns as in label_2 or 17 as in label_02, the same in all lines, found 16"),
        ([f"{CAR}\n{CAR[:-9]}"], "line 2: expected 15 columns"),
        ([CAR.replace(" 20.0", " x")], "line 1: expected a KITTI label, found could not convert string to float: 'x'"),
        ([CAR.replace(" 20.0", " nan")], "numbers that are not finite"),
        ([CAR.replace(" 20.0", " 1e300")], "a number beyond 1e+15"),
        ([CAR.replace(" 600.0", " 1e16")], "a number beyond 1e+15"),
        ([CAR.replace("4.20", "0")], "a Car of 0 x 1.8 x 1.5 m"),
        ([CAR.replace("600.0", "500.0")], "an image box from 500, 150 to 500, 220"),
        ([f"-1 2 {CAR}"], "the frame -1"),
        ([f"0 {10**30} {CAR}"], f"the track {10**30}"),
        ([f"0 2 {CAR}", f"0 2 {CAR}"], "one file a sequence: name the file of the sequence"),
        ([], "expected KITTI labels (000000.txt, ...), found none"),
    ],
)
def test_malformed_labels(tmp_path: Path, files: list[str], problem: str) -> None:
    with pytest.raises(RecordingError) as caught:
        KittiTruth(folder(tmp_path, *files), rig(), Config())
    assert problem in str(caught.value)


def test_calibration_is_needed_and_all_files_are_of_one_benchmark(tmp_path: Path) -> None:
    (tmp_path / "b" / "calib").mkdir(parents=True)
    (tmp_path / "b" / "calib" / "7.txt").write_text(CALIB)
    (tmp_path / "b" / "7.txt").write_text(CAR)
    assert len(boxes_of(tmp_path / "b" / "7.txt")) == 1
    (tmp_path / "b" / "8.txt").write_text(f"0 2 {CAR}")
    (tmp_path / "b" / "calib" / "8.txt").write_text(CALIB)
    with pytest.raises(RecordingError, match=r"8\.txt: expected labels as in 7\.txt, found the tracking"):
        boxes_of(tmp_path / "b", frame=1)
    path = folder(tmp_path, CAR)
    (path / "calib" / "000000.txt").write_text("nothing")
    with pytest.raises(RecordingError, match=r"calib/000000\.txt: expected a calibration of KITTI"):
        KittiTruth(path, rig(), Config()).at(0, frame=0)
    (path / "calib" / "000000.txt").unlink()
    with pytest.raises(RecordingError, match=r"expected its calibration .*calib/000000\.txt, found no such file"):
        KittiTruth(path, rig(), Config()).at(0, frame=0)


@pytest.mark.parametrize(
    ("number", "problem"), [("nan", "expected numbers of 9e"), ("1e300", "expected numbers of 9e"), ("0", "rotations")]
)
def test_a_calibration_that_is_none(tmp_path: Path, number: str, problem: str) -> None:
    calib = "".join(f"{name}: {' '.join([number] * 12)}\n" for name in ("P2", "Tr_velo_to_cam"))
    path = folder(tmp_path, CAR, calib=f"{calib}R0_rect: {' '.join([number] * 9)}\n")
    with pytest.raises((RecordingError, CalibrationError), match=rf"000000\.txt.*{problem}"):
        boxes_of(path)
