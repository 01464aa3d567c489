from pathlib import Path

import numpy as np
import pytest
from frames import RIG

from lidcam.pipeline.core.errors import RecordingError
from lidcam.pipeline.core.rig import Rig, TruthVehicle
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.files.evaluation_folder import START_NS, STEP_NS
from lidcam.readers.truth.predecessor import CAR, PredecessorTruth

POSES = "1 2 0.1 0 0 0.6 0.8\n3 4 0.1 0 0 0 1\n"


def truth(tmp_path: Path, text: str = POSES, rig: Rig = RIG) -> PredecessorTruth:
    (tmp_path / "odom").mkdir(exist_ok=True)
    (tmp_path / "odom" / "30000.txt").write_text(text)
    return PredecessorTruth(tmp_path, rig, Config())


BUS = Rig("site", RIG.lidars, (), (), truth={"own": TruthVehicle("/odom", "bus", (10, 2, 3), (1, 0, 1))})


@pytest.mark.parametrize(
    ("text", "rig", "center", "size", "yaw"),
    [
        ("1 2 0.5", RIG, [1, 2, 0.112], CAR.size_m, 0.5),
        ("1, 2, 0.3, 0.5", RIG, [1, 2, 0.3], CAR.size_m, 0.5),
        ("1 2 0.3 0 0 0.6 0.8", RIG, [1, 2, 0.3], CAR.size_m, 2 * np.arctan2(0.6, 0.8)),
        ("# x y z\n\n1 2 0.3 0 0 0.6 0.8 1 2 3 4 5 6", RIG, [1, 2, 0.3], CAR.size_m, 2 * np.arctan2(0.6, 0.8)),
        ("1 2 0.3 4 2 1.5 0.5", RIG, [1, 2, 0.3], [4, 2, 1.5], 0.5),
        ("1 2 0.3 1.570796327", BUS, [1, 3, 1.3], [10, 2, 3], np.pi / 2),
    ],
)
def test_rows_in_every_form(
    tmp_path: Path, text: str, rig: Rig, center: list[float], size: list[float], yaw: float
) -> None:
    found = truth(tmp_path, text, rig).at(7, frame=0)
    assert found is not None
    assert (found.stamp_ns, found.frame_id, found.track_ids.tolist()) == (7, rig.site_frame, [0])
    assert found.labels.tolist() == ["bus" if rig is BUS else "car"]
    np.testing.assert_allclose(found.centers, [center], atol=1e-6)
    np.testing.assert_allclose(found.yaws, [yaw])
    np.testing.assert_allclose(found.sizes, [size])


def test_the_file_with_the_largest_number_holds_all(tmp_path: Path) -> None:
    (tmp_path / "odom").mkdir()
    with pytest.raises(RecordingError, match=r"odom: expected the car's odometry \(30000\.txt\), found no \.txt file"):
        PredecessorTruth(tmp_path, RIG, Config())
    (tmp_path / "odom" / "9.txt").write_text("9 9 9")
    source = truth(tmp_path, "1 2 0.5\n3 4 -0.5\n5 6 3\n")
    yaws = [found.yaws[0] for frame in range(3) if (found := source.at(0, frame=frame)) is not None]
    np.testing.assert_allclose(yaws, [0.5, -0.5, 3])


def test_frames_of_the_folder_are_known_by_their_stamps_and_others_by_their_place(tmp_path: Path) -> None:
    source = truth(tmp_path)
    for stamp_ns, frame, x in ((START_NS + STEP_NS, 0, 3), (START_NS, 5, 1), (123, 1, 3), (123, 0, 1)):
        found = source.at(stamp_ns, frame=frame)
        assert found is not None
        assert found.centers[0, 0] == x
    assert source.at(123, frame=2) is None
    assert source.at(START_NS + 2 * STEP_NS, frame=2) is None
    assert source.in_image("left", 123, frame=0) is None
    file = tmp_path / "odom" / "30000.txt"
    assert source.notes == (
        f"the car's odometry in {file}: 2 rows, one for each frame, a car of 0.33 x 0.22 x 0.21 m; it has no stamps",
    )


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "expected rows of numbers, found none"),
        ("1 2 3\n1 2\n", "expected rows of numbers, the same in all: the number of columns changed from 3 to 2"),
        ("1 2", "expected rows of 3 .* found 2"),
        ("1 2 x", "expected rows of numbers, .*: could not convert"),
        ("1 2 3\n1 2 nan", "row 1: expected finite numbers"),
        ("1 2 3 0 0 0 0", "expected a quaternion, or a size and a yaw, in columns 4 to 7, found neither"),
        ("1 2 3 1 1 1 1 0 0 0 0 0 0", "expected a quaternion in columns 4 to 7 of 13"),
    ],
)
def test_malformed_rows(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(RecordingError, match=rf"30000\.txt: {problem}"):
        truth(tmp_path, text)
