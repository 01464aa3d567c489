"""The chain from a result and its truth to frames that can be compared."""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import builders
import numpy as np
import pytest
from frames import CONFIG, COVARIANCE, PERIOD_NS, PROVENANCE, RIG, START_NS, frame
from logging_state import kept_logging
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation
from small_scenario import write_small_scenario
from truth_messages import true_object, truth_message, visible_message

from lidcam import process
from lidcam.cli.simulation.simulate import simulate
from lidcam.evaluation.frames import EvaluationFrames
from lidcam.pipeline.core.detections import Source
from lidcam.pipeline.core.errors import FrameError
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.geometry.boxes import iou_xyxy, wrap_angle
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.ros.typestores import message_types
from lidcam.pipeline.core.settings.load import dump_config
from lidcam.pipeline.evaluation.evaluation_frame import EvaluationFrame, TruthBoxes2D, TruthBoxes3D
from lidcam.readers.messages.vision.detections3d import decode_detections3d
from lidcam.readers.messages.vision.track_ids import track_ids
from lidcam.readers.results.result import open_result
from lidcam.readers.rig.rig_file import rig_yaml
from lidcam.readers.truth.moment import moment_of
from lidcam.readers.truth.open import OpenTruth, open_truth
from lidcam.readers.truth.source import TruthSource
from lidcam.writers.mcap.writer import McapResultWriter
from lidcam.writers.outputs.transaction import OutputFile

BAGS = Path(__file__).resolve().parents[3] / "bags"


def result_file(path: Path, frames: Sequence[FrameResult], summary: str = "{}") -> Path:
    provenance = replace(PROVENANCE, config_yaml=dump_config(CONFIG), rig_yaml=rig_yaml(RIG), summary=lambda: summary)
    with McapResultWriter(OutputFile(path, path), RIG, CONFIG, provenance) as writer:
        for one in frames:
            writer.write(one)
    return path


def truth_file(path: Path, raws: Sequence[RawMessage]) -> Path:
    builders.write_mcap(path, list(raws))
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
    result = result_file(tmp_path / "out.mcap", [frame(index) for index in range(3)], summary)
    frames, of = compared(result, truth_file(tmp_path / "truth.mcap", cars()))
    assert [one.T_fixed_site is None for one in frames] == [is_adrift] * 3
    assert ("no speeds are compared: the sensors move, and where to is not recorded" in of.notes) == is_adrift


def cars(*, frame_id: str = "site", every_ns: int = PERIOD_NS, count: int = 40) -> list[RawMessage]:
    """A car ahead that drives along x, one behind, and a hidden van."""
    found = []
    for number in range(count):
        stamp_ns = START_NS + (number - 15) * every_ns
        x = 10 + (stamp_ns - START_NS) * 1e-8
        objects = [
            true_object("car", (x, 0, 0), name="a", counts={"image_pixels": 50}),
            true_object("car", (-20, 0, 0), name="b", counts={"image_pixels": 50}),
            true_object("van", (x + 20, 0, 0), name="c", counts={"image_pixels": 50, "image_pixels/left": 0}),
        ]
        found.append(truth_message(stamp_ns, objects, frame_id=frame_id))
    return found


def test_truth_in_the_site_frame(tmp_path: Path) -> None:
    result = result_file(tmp_path / "out.mcap", [frame(index) for index in range(3)])
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


def test_boxes_of_images_that_were_recorded(tmp_path: Path) -> None:
    result = result_file(tmp_path / "out.mcap", [frame(0), frame(1)])
    shown = visible_message(START_NS + 1_000_001, [("car", (1, 2, 3, 4), "a", 9)], log_time_ns=START_NS + 5)
    frames, _ = compared(result, truth_file(tmp_path / "truth.mcap", [*cars(), shown]))
    first, second = map(shown_in, frames)
    assert first.xyxy.tolist() == [[1, 2, 3, 4]]
    assert first.image_pixels.tolist() == [9]
    assert second.labels.tolist() == ["car"]  # none was recorded for this one: projected


def test_truth_in_a_frame_that_the_site_moves_in(tmp_path: Path) -> None:
    """`frame` drives to x = 2, 4, 6 m of odom, a metre in half a period."""
    result = result_file(tmp_path / "out.mcap", [frame(index, motion=True) for index in range(3)])
    still = [
        truth_message(m.stamp_ns, [true_object("car", (10, 3, 0), name="a", yaw=0.5)], frame_id="odom") for m in cars()
    ]
    frames, _ = compared(result, truth_file(tmp_path / "truth.mcap", still))
    for index, one in enumerate(frames):
        assert truth_of(one).frame_id == "site"
        np.testing.assert_allclose(truth_of(one).centers, [[10 - (index + 1), 3, 0]], atol=1e-6)
        np.testing.assert_allclose(truth_of(one).yaws, [0.5])


def test_frames_that_truth_does_not_cover(tmp_path: Path) -> None:
    result = result_file(tmp_path / "out.mcap", [frame(index) for index in range(3)])
    frames, of = compared(result, truth_file(tmp_path / "truth.mcap", cars(count=16)))
    assert [one.truth is None for one in frames] == [False, True, True]
    assert [one.images["left"].truth is None for one in frames] == [False, True, True]
    assert of.notes[-1] == "frames without truth at their time: 2"


def test_frames_at_which_the_motion_is_not_known(tmp_path: Path) -> None:
    late = [frame(0, motion=True), frame(1, motion=True), frame(8)]
    result = result_file(tmp_path / "out.mcap", late)
    frames, of = compared(result, truth_file(tmp_path / "truth.mcap", cars(frame_id="odom")))
    assert [one.truth is None for one in frames] == [False, False, True]
    assert of.notes[-1].startswith("frames without truth, because where the site frame was at their time is not rec")


def test_frames_of_reference_that_nothing_joins(tmp_path: Path) -> None:
    result = result_file(tmp_path / "out.mcap", [frame()])
    with pytest.raises(FrameError, match="truth's frame 'map' with the site frame 'site', found those of left, lidar2"):
        compared(result, truth_file(tmp_path / "truth.mcap", cars(frame_id="map")))


def test_a_result_without_truth(tmp_path: Path) -> None:
    frames, of = compared(result_file(tmp_path / "out.mcap", [frame(), frame(1)]))
    assert [one.truth for one in frames] == [None, None]
    assert [one.images["left"].truth for one in frames] == [None, None]
    assert len(of.notes) == 1
    assert re.fullmatch(r"no truth: .*out\.mcap: expected truth, .* found none; give .* \(--truth\)", of.notes[0])


class Still(TruthSource):
    """Truth of another kind, which knows nothing of images: a car that stands ahead."""

    description = "a car"
    notes = ("it stands",)

    def at(self, stamp_ns: int, *, frame: int) -> TruthBoxes3D | None:
        del frame
        message = truth_message(stamp_ns, [true_object("car", (10, 0, 0), name="a")])
        return moment_of(decode_detections3d(message), CONFIG.class_id_of_label).boxes


def test_truth_of_another_kind_is_projected_into_images(tmp_path: Path) -> None:
    with open_result(result_file(tmp_path / "out.mcap", [frame()])) as result:
        frames = EvaluationFrames(result, OpenTruth(Still(), "", ()))
        (one,) = frames
    shown = shown_in(one)
    assert (shown.stamp_ns, shown.labels.tolist()) == (START_NS + 1_000_001, ["car"])
    assert frames.notes == ("truth: a car", "it stands")


# --- simulated and sample recordings


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A recording of an ego vehicle that turns, and the result of it, which carries the truth."""
    folder = tmp_path_factory.mktemp("ego")
    bend = {"points_m": [[-1.6, 1.85], [-0.9, 1.3], [0.0, 1.2], [0.6, 0.6]]}
    vehicle = {"shape": "model_car", "odometry": True}
    scenario = write_small_scenario(
        folder / "ego.yaml",
        site_frame="odom",
        routes={"bend": bend},
        vehicles={
            "parked": {**vehicle, "start": [0.3, 0.9, -1.5]},
            "ego": {**vehicle, "route": "bend", "speed_m_s": 1.0, "start": [-1.4, 1.69, -0.66], "ego": True},
        },
        lidars__top__mounted_on="ego",
        lidars__top__position_m=[0.1, 0.0, 0.35],
        cameras__front__mounted_on="ego",
        cameras__front__position_m=[0.25, 0.0, 0.3],
        cameras__front__rpy_deg=[0, 10, 0],
    )
    with kept_logging():
        simulate(str(scenario), folder / "ego.mcap", duration_s=1.0, workers=1)
    process(folder / "ego.mcap", folder / "out.mcap", config="sandbox")
    return folder / "ego.mcap", folder / "out.mcap"


def read(path: Path, topic: str) -> Iterator[Any]:
    with AnyReader([path], default_typestore=message_types(2)) as reader:
        for connection, _, data in reader.messages([c for c in reader.connections if c.topic == topic]):
            yield reader.deserialize(data, connection.msgtype)


def pose_of(message: Any) -> tuple[int, np.ndarray[Any, np.dtype[np.float64]]]:
    """Stamp in ns, and (4, 4) pose, of an Odometry or a box."""
    stamp, pose = message.header.stamp, message.pose.pose if hasattr(message, "pose") else message.bbox.center
    matrix, turn = np.eye(4), pose.orientation
    matrix[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    matrix[:3, 3] = [pose.position.x, pose.position.y, pose.position.z]
    return stamp.sec * 10**9 + stamp.nanosec, matrix


@pytest.mark.parametrize("truth_is", ["carried by the result", "in the recording"])
def test_truth_in_odom_and_results_of_a_vehicle(truth_is: str, simulated: tuple[Path, Path]) -> None:
    """Against the poses that the simulator recorded, multiplied out here."""
    recording, result = simulated
    frames, _ = compared(result, *([recording] if truth_is == "in the recording" else []))
    ego = dict(map(pose_of, read(recording, "/odom")))
    (parked, *_), *_ = (message.detections for message in read(recording, "/ground_truth/objects"))
    assert parked.id == "parked"
    _, T_odom_parked = pose_of(parked)
    stamps = np.array([*ego])
    assert len(frames) == 10
    turned, near_m = [], []
    for one in frames:
        truth = truth_of(one)
        assert truth.frame_id == "base_link"
        near = int(stamps[np.abs(stamps - one.stamp_ns).argmin()])
        expected = np.linalg.inv(ego[near]) @ T_odom_parked
        row = truth.track_ids.tolist().index(int(track_ids(np.array(["parked"]))[0]))
        tolerance_m = 1.5 * abs(near - one.stamp_ns) * 1e-9 + 1e-6  # at 1 m/s and while it turns
        np.testing.assert_allclose(truth.centers[row], expected[:3, 3], atol=tolerance_m)
        heading = np.arctan2(expected[1, 0], expected[0, 0])
        assert abs(wrap_angle(truth.yaws[row] - heading)) < 4 * tolerance_m
        turned.append(np.arctan2(ego[near][1, 0], ego[near][0, 0]))
        fused = one.sources["fused"].boxes.centers
        off_m = np.linalg.norm(fused[:, :2] - truth.centers[row, :2], axis=1)
        near_m.append(off_m.min(initial=np.inf))
    assert sum(off_m < 0.1 for off_m in near_m) >= 7  # a model car of 0.5 m
    assert turned[0] < -0.5
    assert np.ptp(turned) > 0.1
    images = [image for one in frames for image in one.images.values()]
    shown = [shown_in(one, camera) for one in frames for camera in one.images]
    assert [len(boxes) for boxes in shown] == [1] * 10
    found = [image.found.xyxy for image in images]
    ious = [iou_xyxy(ours.xyxy, theirs).max(initial=0) for ours, theirs in zip(shown, found, strict=True)]
    assert np.median(ious) > 0.7
    assert all((boxes.image_pixels > 0).all() for boxes in shown)  # as recorded for each image, not projected


def test_truth_when_the_lidars_measured_it(simulated: tuple[Path, Path]) -> None:
    """The other car is parked: it is at one place at both times."""
    _, result = simulated
    at_stamp, _ = compared(result)
    measured, of = compared(result, settings=["evaluate.truth_time=points"])
    assert of.notes == ("truth: /ground_truth/objects_when_measured of out.mcap (by its name)",)
    for one, other in zip(at_stamp, measured, strict=True):
        np.testing.assert_allclose(truth_of(other).centers, truth_of(one).centers, atol=1e-6)


def test_what_the_cameras_place_is_a_source_of_its_own(tmp_path: Path) -> None:
    sources = [Source.LIDAR, Source.CAMERA, Source.BOTH]
    result = result_file(tmp_path / "out.mcap", [frame(0), frame(1, sources=sources)])
    first, second = compared(result)[0]
    assert ({*first.sources}, {*second.sources}) == ({"lidar", "fused"}, {"lidar", "cameras", "fused"})
    boxes = second.sources["cameras"].boxes
    np.testing.assert_array_equal(boxes.centers, frame(1).fused.objects.centers[[1]])
    np.testing.assert_array_equal(boxes.covariances, [COVARIANCE])
