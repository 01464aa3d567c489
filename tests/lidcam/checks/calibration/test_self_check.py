"""A wrong camera is named with what is wrong, and put right; a good one is not, nor one of which little was seen."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from detections import forward_camera
from wrong_cameras import CAMERA, cuboids, passing, without_tracks

from lidcam.checks.calibration.self_check import SelfCheck
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.printing.rig_check import check_tree, print_check
from lidcam.printing.terminal import console

RIG = Rig("site", (), (CAMERA, forward_camera("silent")), ())
CONFIG = Config()
DEGREE = np.pi / 180


@pytest.fixture(autouse=True, scope="module")
def _objects_are_cuboids() -> Iterator[None]:
    with patch("lidcam.pipeline.calibration.camera_error.rounded_outline", cuboids):
        yield


def checked(frames: Sequence[FrameResult]) -> SelfCheck:
    check = SelfCheck(RIG, CONFIG)
    for frame in frames:
        check.add(frame)
    return check


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ((0, 0.03, 0, 0, 0, 0, 0), " degrees further left"),
        ((0, -0.03, 0, 0, 0, 0, 0), " degrees further right"),
        ((0.03, 0, 0, 0, 0, 0, 0), " degrees further down"),
        ((0, 0, -0.03, 0, 0, 0, 0), " degrees clockwise"),
        ((0, 0, 0, 0, 0, 0, 0.09), " ms later than their stamps say"),
        ((0, 0, 0, 0, 0, 0, -0.09), " ms earlier than their stamps say"),
    ],
)
def test_what_is_wrong_is_told_and_put_right(values: tuple[float, ...], told: str) -> None:
    check = checked(passing(values, noise=0.3))
    [warning] = check.warnings
    assert warning.subject == "cam"
    assert told in warning.finding
    assert " and " not in warning.finding
    camera, silent = check.corrected().cameras
    assert silent is RIG.cameras[1]
    turn = camera.T_camera_site.matrix @ np.linalg.inv(CAMERA.T_camera_site.matrix)
    np.testing.assert_allclose([turn[2, 1], turn[0, 2], turn[1, 0]], values[:3], atol=0.004)
    assert camera.time_offset_ns == pytest.approx(-values[6] * 1e9, abs=6e6)


@pytest.mark.parametrize(
    "frames",
    [passing(), passing(speed_m_s=8.0), passing((0, 0.003, 0, 0, 0, 0, 0.005)), without_tracks(passing()), []],
    ids=["good", "good, driving", "too small to matter", "no tracks", "nothing"],
)
def test_nothing_is_said_of_others(frames: list[FrameResult]) -> None:
    check = checked(frames)
    assert check.warnings == ()
    assert check.corrected().cameras == RIG.cameras


def test_a_long_run_is_looked_at_all_over() -> None:
    frames = passing(frames=20, noise=0.3)
    late = [replace(one, fused=replace(one.fused, tracks=None)) for one in frames]
    check = checked(late * 45 + frames * 20)
    judged, _ = check.cameras
    assert 200 < judged.pairs < 4 * 800


def test_it_is_printed_and_written_as_values(capsys: pytest.CaptureFixture[str]) -> None:
    check = checked(passing((0, 0.03, 0, 0, 0, 0, 0), noise=0.3))
    print_check(console(), check)
    printed = capsys.readouterr().out
    assert "not judged" in printed
    assert "warning: cam: by " in printed
    tree = check_tree(check)
    yaw = tree["cameras"]["cam"]["errors"]["yaw_deg"]
    assert yaw["is_told"]
    assert yaw["value"] == pytest.approx(0.03 / DEGREE, abs=0.2)
    assert tree["cameras"]["silent"] == {"pairs": 0, "tracks": 0, "errors": None}
    assert tree["lidars"] == []
