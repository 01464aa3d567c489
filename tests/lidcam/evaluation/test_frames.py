"""The chain from a result and its truth to frames that can be compared."""

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from builders import write_mcap
from frames import COVARIANCE, PERIOD_NS, START_NS, frame, written_result
from helpers import SANDBOX
from truth_messages import true_object, truth_message

import lidcam
from lidcam.evaluation.frames import EvaluationFrames
from lidcam.pipeline.core.arrays import F64, Bools
from lidcam.pipeline.core.detections import Source
from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import Zone, ZoneUse
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, TruthBoxes2D, TruthBoxes3D
from lidcam.readers.results.result import open_result
from lidcam.readers.rig.schema import parse_rig
from lidcam.readers.truth.open import open_truth


def truth_file(path: Path, raws: list[RawMessage]) -> Path:
    write_mcap(path, raws)
    return path


def compared(
    result: Path, *truth: Path, settings: Sequence[str] = ()
) -> tuple[list[EvaluationFrame], EvaluationFrames]:
    with open_result(result, settings) as opened, open_truth(opened, truth) as found:
        frames = EvaluationFrames(opened, found)
        return [*frames], frames


def truth_of(one: EvaluationFrame) -> TruthBoxes3D:
    assert one.truth is not None
    return one.truth


def shown_in(one: EvaluationFrame, camera: str = "left") -> TruthBoxes2D:
    """Truth of an image."""
    truth = one.images[camera].truth
    assert truth is not None
    return truth


@pytest.mark.parametrize(("topics", "is_adrift"), [([], True), (["/odom"], False)])
def test_sensors_whose_motion_only_the_clouds_tell_have_no_place(
    topics: list[str], is_adrift: bool, tmp_path: Path
) -> None:
    summary = json.dumps({"motion": {"topics": topics, "frames_from_clouds": 2}})
    result = written_result(tmp_path / "out.mcap", [frame(index) for index in range(3)], summary=lambda: summary)
    frames, of = compared(result, truth_file(tmp_path / "truth.mcap", cars()))
    assert [one.T_fixed_site is None for one in frames] == [is_adrift] * 3
    assert ("no speeds are compared: the sensors move, and where to is not recorded" in of.notes) == is_adrift


def cars(*, frame_id: str = "site", count: int = 40) -> list[RawMessage]:
    """A car ahead that drives along x, one behind, and a hidden van."""
    found = []
    for number in range(count):
        stamp_ns = START_NS + (number - 15) * PERIOD_NS
        x = 10 + (stamp_ns - START_NS) * 1e-8
        objects = [
            true_object("car", (x, 0, 0), name="a", counts={"image_pixels": 50}),
            true_object("car", (-20, 0, 0), name="b", counts={"image_pixels": 50}),
            true_object("van", (x + 20, 0, 0), name="c", counts={"image_pixels": 50, "image_pixels/left": 0}),
        ]
        found.append(truth_message(stamp_ns, objects, frame_id=frame_id))
    return found


def test_truth_with_another_clock(tmp_path: Path) -> None:
    result = written_result(tmp_path / "out.mcap", [frame(index) for index in range(3)])
    truth = truth_file(tmp_path / "truth.mcap", cars())
    frames, _ = compared(result, truth, settings=["evaluate.truth_offset_ms=250"])
    for index, one in enumerate(frames):
        assert (one.stamp_ns, truth_of(one).stamp_ns) == (START_NS + index * PERIOD_NS,) * 2
        np.testing.assert_allclose(truth_of(one).centers[:, 0], [12.5 + index, -20, 32.5 + index], atol=1e-6)


def test_truth_in_the_site_frame(tmp_path: Path) -> None:
    result = written_result(tmp_path / "out.mcap", [frame(index) for index in range(3)])
    frames, of = compared(result, truth_file(tmp_path / "truth.mcap", cars()))
    assert [one.index for one in frames] == [0, 1, 2]
    for index, one in enumerate(frames):
        assert (one.stamp_ns, truth_of(one).stamp_ns) == (START_NS + index * PERIOD_NS,) * 2
        np.testing.assert_allclose(truth_of(one).centers[:, 0], [10 + index, -20, 30 + index], atol=1e-6)
        assert [*one.sources] == ["lidar", "fused"]
        assert one.skew_ns == 5_000_000
        assert [*one.images] == ["left", "right"]
        assert [len(image.found) for image in one.images.values()] == [2, 0]
        left, right = shown_in(one, "left"), shown_in(one, "right")
        assert left.labels.tolist() == ["car"]  # the van is hidden there, and one car is behind
        assert left.image_pixels.tolist() == [-1]
        assert right.labels.tolist() == ["car", "van"]
        assert left.stamp_ns == one.stamp_ns + 1_000_001
    assert of.notes == ("truth: /ground_truth/objects of truth.mcap (by its name)",)


@pytest.mark.parametrize("use", ["ignore", "detect"])
def test_what_lies_where_nothing_is_reported_is_ignored(tmp_path: Path, use: ZoneUse) -> None:
    path, truth = written_result(tmp_path / "out.mcap", [frame()]), truth_file(tmp_path / "truth.mcap", cars())
    zone = Zone("near", np.array([[-15.0, -1e4], [15, -1e4], [15, 1e4], [-15, 1e4]]), use)
    with open_result(path) as result, open_truth(result, [truth]) as found:
        (plain,) = EvaluationFrames(result, found)
        result.rig = replace(result.rig, zones=(zone,))
        (one,) = EvaluationFrames(result, found)
    assert all(source.is_ignored is None for source in plain.sources.values())
    places: list[tuple[F64, Bools | None]] = [(truth_of(one).centers, truth_of(one).is_ignored)]
    places += [(source.boxes.centers, source.is_ignored) for source in one.sources.values()]
    for centers, is_ignored in places:
        expected = (np.abs(centers[:, 0]) <= 15) == (use == "ignore")
        assert (np.zeros(len(centers)) if is_ignored is None else is_ignored).tolist() == expected.tolist()


def test_truth_in_a_frame_that_the_site_moves_in(tmp_path: Path) -> None:
    """`frame` drives to x = 2, 4, 6 m of odom, a metre in half a period."""
    result = written_result(tmp_path / "out.mcap", [frame(index, motion=True) for index in range(3)])
    still = [
        truth_message(m.stamp_ns, [true_object("car", (10, 3, 0), name="a", yaw=0.5)], frame_id="odom") for m in cars()
    ]
    frames, _ = compared(result, truth_file(tmp_path / "truth.mcap", still))
    for index, one in enumerate(frames):
        assert truth_of(one).frame_id == "site"
        np.testing.assert_allclose(truth_of(one).centers, [[10 - (index + 1), 3, 0]], atol=1e-6)
        np.testing.assert_allclose(truth_of(one).yaws, [0.5])


def test_frames_that_truth_does_not_cover(tmp_path: Path) -> None:
    result = written_result(tmp_path / "out.mcap", [frame(index) for index in range(3)])
    frames, of = compared(result, truth_file(tmp_path / "truth.mcap", cars(count=16)))
    assert [one.truth is None for one in frames] == [False, True, True]
    assert [one.images["left"].truth is None for one in frames] == [False, True, True]
    assert of.notes[-1] == "frames without truth at their time: 2"


def test_frames_at_which_the_motion_is_not_known(tmp_path: Path) -> None:
    late = [frame(0, motion=True), frame(1, motion=True), frame(8)]
    result = written_result(tmp_path / "out.mcap", late)
    frames, of = compared(result, truth_file(tmp_path / "truth.mcap", cars(frame_id="odom")))
    assert [one.truth is None for one in frames] == [False, False, True]
    assert of.notes[-1].startswith("frames without truth, because where the site frame was at their time is not rec")


def test_frames_of_reference_that_nothing_joins(tmp_path: Path) -> None:
    result = written_result(tmp_path / "out.mcap", [frame()])
    with pytest.raises(FrameError, match="truth's frame 'map' with the site frame 'site', found those of left, lidar2"):
        compared(result, truth_file(tmp_path / "truth.mcap", cars(frame_id="map")))


def test_a_result_without_truth(tmp_path: Path) -> None:
    frames, of = compared(written_result(tmp_path / "out.mcap", [frame(), frame(1)]))
    assert [one.truth for one in frames] == [None, None]
    assert [one.images["left"].truth for one in frames] == [None, None]
    assert len(of.notes) == 1
    assert re.fullmatch(r"no truth: .*out\.mcap: expected truth, .* found none; give .* \(--truth\)", of.notes[0])


# --- simulated and sample recordings


def test_what_the_cameras_place_is_a_source_of_its_own(tmp_path: Path) -> None:
    sources = [Source.LIDAR, Source.CAMERA, Source.BOTH]
    result = written_result(tmp_path / "out.mcap", [frame(0), frame(1, sources=sources)])
    first, second = compared(result)[0]
    assert ({*first.sources}, {*second.sources}) == ({"lidar", "fused"}, {"lidar", "cameras", "fused"})
    boxes = second.sources["cameras"].boxes
    np.testing.assert_array_equal(boxes.centers, frame(1).fused.objects.centers[[1]])
    np.testing.assert_array_equal(boxes.covariances, [COVARIANCE])


TRUTH = {
    name: {"topic": f"/{name}/base_pose_ground_truth", "size_m": [0.33, 0.22, 0.21], "class": "car"}
    for name in ("car1", "car2")
}


def test_it_agrees_with_the_simulators_objects(tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    rig = parse_rig({"truth": TRUTH}, Path("rig.yaml"))
    settings = {"output.images": False, "output.clouds": False, "output.layout": False}
    summary = lidcam.process(
        SANDBOX, out, config="sandbox", rig=rig, settings=settings, start_s=0.5, duration_s=0.6
    ).summary
    assert {*summary.inputs.copied} >= {"/ground_truth/objects", *(entry["topic"] for entry in TRUTH.values())}
    with (
        open_result(out) as opened,
        open_truth(opened) as of_odometry,
        open_result(out) as again,
        open_truth(again, topic="/ground_truth/objects") as of_topic,
    ):
        assert {*opened.rig.truth} == {*TRUTH}
        pairs = list(zip(EvaluationFrames(opened, of_odometry), EvaluationFrames(again, of_topic), strict=True))
    assert len(pairs) >= 5
    for first, second in pairs:
        assert first.truth is not None
        assert second.truth is not None
        order = np.argsort(second.truth.centers[:, 0])
        mine = np.argsort(first.truth.centers[:, 0])
        np.testing.assert_allclose(first.truth.centers[mine], second.truth.centers[order], atol=0.005)
        turn = first.truth.yaws[mine] - second.truth.yaws[order]
        np.testing.assert_allclose(np.sin(turn), 0, atol=0.02)
        assert (np.cos(turn) > 0).all()
        assert first.truth.labels.tolist() == second.truth.labels.tolist() == ["car", "car"]
