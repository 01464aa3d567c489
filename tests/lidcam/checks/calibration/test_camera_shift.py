"""A camera whose 2D boxes all lie beside the objects by the same step is named; one whose boxes only vary is not."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from detections import boxes2d, boxes3d, camera_rig, forward_camera
from frames import frame

from lidcam.checks.calibration.camera_shift import MAX_FRAMES, MIN_FRAMES, CameraShift
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.detections import Detections, Hypotheses, Matches
from lidcam.pipeline.core.frame import FrameResult

SIZE = np.array([60.0, 40.0])
PX_PER_DEG = 500 * np.pi / 180


def passing(number: int, *, speed_px: float = 12.0) -> F64:
    """(2, 4) rectangles of two cars that pass each other."""
    middles = np.array([[120 + speed_px * number, 200], [520 - speed_px * number, 300]])
    return np.concatenate([middles - SIZE / 2, middles + SIZE / 2], 1)


def seen(
    projected: F64, step_px: npt.ArrayLike = (0, 0), *, by_lidar: bool = True, hidden: Sequence[float] = (0, 0)
) -> FrameResult:
    """A frame in which each projected box is matched with a 2D box beside it."""
    n = len(projected)
    measured = projected + np.tile(np.asarray(step_px, np.float64).reshape(-1, 2), 2)
    found = boxes2d(np.c_[measured, np.full(n, 0.9), np.zeros(n)])
    matches = Matches(
        np.stack([np.arange(n)] * 2, 1),
        np.full(n, 0.5, np.float32),
        projected.astype(np.float32),
        np.array(hidden[:n], np.float32),
    )
    boxes = boxes3d([(10.0, 0, 0.75, 4.2, 1.8, 1.5, 0)] * n)
    return replace(
        frame(),
        detections=Detections(boxes, {"cam": found}),
        hypotheses=Hypotheses(boxes, {"cam": matches}, n if by_lidar else 0),
    )


def warned(frames: Sequence[FrameResult]) -> list[str]:
    check = CameraShift(camera_rig(forward_camera("cam"), forward_camera("silent")))
    for result in frames:
        check.add(result)
    return [str(warning) for warning in check.warnings]


@pytest.mark.parametrize(
    ("step_deg", "told"),
    [
        ((2, 0), "17 px (2.0 degrees) to the right of the objects of the lidars, in 12 of the 12 frames looked at; "),
        ((-2, 0.5), "17 px (2.0 degrees) to the left of the objects of the lidars, "),
        ((0, 2), "17 px (2.0 degrees) below the objects"),
        ((0.5, -2), "17 px (2.0 degrees) above the objects"),
        ((-2, 3), "17 px (2.0 degrees) to the left of and 26 px (3.0 degrees) below the objects of the lidars, in 12 "),
    ],
)
def test_the_side_and_the_size_of_the_step_are_told(step_deg: tuple[float, float], told: str) -> None:
    [line] = warned([seen(passing(n), np.array(step_deg) * PX_PER_DEG) for n in range(12)])
    assert line.startswith(f"cam: its 2D boxes lie {told}")
    assert line.endswith("; check its extrinsics, or see whether its clock is off (time_offset_ms in the rig file)")


def test_a_small_step_is_not_told_nor_one_that_is_small_for_the_objects() -> None:
    assert warned([seen(passing(n), (0.9 * PX_PER_DEG, 0)) for n in range(12)]) == []
    wide = [passing(n) + np.array([-100, 0, 100, 0]) for n in range(4, 12)]
    assert warned([seen(one, (2 * PX_PER_DEG, 0)) for one in wide]) == []
    assert len(warned([seen(one, (3 * PX_PER_DEG, 0)) for one in wide])) == 1


def test_steps_to_both_sides_are_no_fault_of_the_camera() -> None:
    random = np.random.default_rng(0)
    assert warned([seen(passing(n), random.normal(0, 3 * PX_PER_DEG, 2)) for n in range(30)]) == []
    # Of two objects in each frame, one lies on the left, one on the right.
    both = [passing(n) for n in range(12)]
    frames = [seen(one, np.array([[20, 0], [-20, 0]])) for one in both]
    assert warned(frames) == []


def test_three_frames_are_enough() -> None:
    [line] = warned([seen(passing(4 * n), (25, 0)) for n in range(3)])
    assert "25 px (2.9 degrees) to the right of the objects of the lidars, in 3 of the 3 frames" in line


def test_a_step_in_some_frames_is_told_if_they_are_most() -> None:
    step = (3 * PX_PER_DEG, 0)
    assert warned([seen(passing(n), step if n % 3 else (0, 0)) for n in range(12)]) == []
    [line] = warned([seen(passing(n), step if n % 6 else (0, 0)) for n in range(12)])
    assert "in 10 of the 12 frames" in line


@pytest.mark.parametrize(
    "frames",
    [
        [],
        [seen(passing(n), (50, 0)) for n in range(MIN_FRAMES - 1)],
        [seen(passing(n), (50, 0), by_lidar=False) for n in range(12)],
        [seen(passing(n), (50, 0), hidden=(0.5, 0.9)) for n in range(12)],
        [seen(np.array([[-10.0, 100, 60, 140], [600, 100, 639, 140]]) + n, (50, 0)) for n in range(12)],
        [seen(passing(0, speed_px=0)[:1] + n % 2, (50, 0)) for n in range(12)],
        [seen(np.zeros((0, 4)), (50, 0)) for _ in range(12)],
    ],
    ids=["nothing", "few", "begun by cameras", "hidden", "cut", "one that is parked", "no pairs"],
)
def test_what_says_nothing_of_the_camera(frames: list[FrameResult]) -> None:
    assert warned(frames) == []


def test_a_long_run_is_looked_at_all_over() -> None:
    frames = [seen(passing(n % 20), (3 * PX_PER_DEG, 0) if n < 900 else (0, 0)) for n in range(1000)]
    [line] = warned(frames)
    kept = int(line.split(" frames")[0].split()[-1])
    assert MAX_FRAMES / 2 <= kept <= MAX_FRAMES
    assert f"in {round(0.9 * kept)} of the {kept} frames" in line
