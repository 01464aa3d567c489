"""Boxes of a 3D detector in the recording, end to end: lidcam's own given back to it, and those of a moving vehicle."""

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from builders import in_order, odometry, raw, write_mcap, write_rosbag1
from helpers import CLUSTERS
from object_messages import Recorded, boxes_message, objects_message
from results import fused_objects, topics_of
from rich.console import Console
from summaries import printed

from lidcam.cli.printing.console import print_inspection
from lidcam.inspection import inspect_recording
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.processing import process_recording
from lidcam.readers.messages.detections import decode_detections3d
from lidcam.readers.open import open_recording
from lidcam.run.choice import SettingsChoice
from lidcam.run.job import make_job
from lidcam.run.summary import RunSummary, summary_tree

SECONDS = 0.5
SMALL = ("output.images=false", "output.clouds=false", "output.layout=false", "fuse.min_score=0")
RECORDED = (*SMALL, "detect3d.method=recorded")
DETECTOR, LATE_NS = "/detector/objects", 70_000_000


def process(recording: Path, out: Path, *settings: str, config: str | None = None, workers: int = 1) -> RunSummary:
    return process_recording(make_job(recording, out, config=config, settings=settings, workers=workers))


def given_back(result: Path) -> list[RawMessage]:
    """What the lidars saw in a result, as a detector would have recorded it: in ROS 1, after the clouds."""
    messages = []
    with open_recording([result]) as recording:
        for message in recording.messages(["/lidar/detections"]):
            boxes = decode_detections3d(message)
            objects = []
            for row, label in enumerate(boxes.labels.tolist()):
                covariance = np.diag([0.0, 0.0, 0.1, 0.1, 0.1, 0.0])
                covariance[np.ix_([0, 1, 5], [0, 1, 5])] = boxes.covariances[row]
                half = boxes.yaws[row] / 2
                turn = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
                score = float(boxes.scores[row])
                objects.append(Recorded(boxes.centers[row], label, score, boxes.sizes[row], turn, covariance))
            log_time_ns = message.log_time_ns + LATE_NS
            messages.append(
                boxes_message("ros1", message.stamp_ns, objects, frame_id=boxes.frame_id, log_time_ns=log_time_ns)
            )
    return messages


def of_sandbox(sandbox: Path, *, without: str = "no such topic") -> list[RawMessage]:
    with open_recording([sandbox]) as recording:
        stop_ns = recording.start_ns + round(SECONDS * 1e9)
        messages = recording.messages(stop_ns=stop_ns)
        kept = [message for message in messages if not message.topic.startswith(("/ground_truth", "/car", without))]
        return [message._replace(data=bytes(message.data)) for message in kept]


def write(path: Path, *parts: Iterable[RawMessage]) -> Path:
    write_rosbag1(path, in_order(*parts))
    return path


@pytest.fixture(scope="module")
def clusters(sandbox: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of the sample's beginning, by clusters."""
    folder = tmp_path_factory.mktemp("clusters")
    out = folder / "out.mcap"
    process(write(folder / "in.bag", of_sandbox(sandbox)), out, *SMALL, CLUSTERS, "track.mode=none", config="sandbox")
    assert topics_of(out)["/lidar/detections"][1] >= 3
    return out


def lidar_boxes(path: Path) -> dict[int, list[list[float]]]:
    """x, y, yaw, length, width, score of the boxes of the lidars, by header stamp."""
    with open_recording([path]) as recording:
        found = [decode_detections3d(message) for message in recording.messages(["/lidar/detections"])]
    return {one.stamp_ns: np.column_stack([one.centers, one.yaws, one.sizes, one.scores]).tolist() for one in found}


def same(one: dict[int, list[list[float]]], other: dict[int, list[list[float]]]) -> None:
    assert [*one] == [*other]
    for stamp_ns, rows in one.items():
        np.testing.assert_allclose(rows, other[stamp_ns], rtol=0, atol=1e-6)


def test_boxes_of_lidars_and_cameras_without_any_cloud(
    clusters: Path, sandbox: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lidcam.pipeline.parallel.run.START_S", 0.0)  # no recording is too short for two processes
    boxes = given_back(clusters)
    source = write(tmp_path / "in.bag", of_sandbox(sandbox, without="/velodyne"), boxes[:1] + boxes[2:])
    summaries = [
        process(source, tmp_path / f"{workers}.mcap", *RECORDED, config="sandbox", workers=workers)
        for workers in (1, 2)
    ]
    assert (tmp_path / "1.mcap").read_bytes() == (tmp_path / "2.mcap").read_bytes()
    summary = summaries[0]
    assert (summary.sensors.rig.lidars, summary.frames.count) == ((), len(boxes) - 1)
    assert summary.frames.confirmed > 0
    kept = lidar_boxes(clusters)
    del kept[boxes[1].stamp_ns]
    same(kept, lidar_boxes(tmp_path / "1.mcap"))
    assert summary.frames.points["input"] == 0
    assert all(sensor.topic != DETECTOR for sensor in summary.sensors.missing)


# --- a moving vehicle

START_NS, PERIOD_NS, COUNT = 1_600_000_000_000_000_000, 100_000_000, 6
CARS = ((30.0, 3.0, 0.8), (45.0, -4.0, 0.8))
"""Standing cars, in the frame `map`."""
SPEED_M_S = 12.0


def vehicle_x_m(stamp_ns: int) -> float:
    return SPEED_M_S * (stamp_ns - START_NS) / 1e9


def drive() -> list[RawMessage]:
    """Boxes of a detector that hangs 40 ms behind its stamps, and of one in the frame `map`."""
    messages = []
    for step in range(-10, 10 * COUNT):
        stamp_ns = START_NS + step * PERIOD_NS // 5
        pose = odometry(stamp_ns=stamp_ns, position=(vehicle_x_m(stamp_ns), 0, 0), frame_id="map")
        messages.append(raw("/odom", "nav_msgs/msg/Odometry", pose, stamp_ns))
    at_map = [Recorded(CARS[0], "car", 0.5), Recorded((60.0, 8.0, 0.8), "bus", 0.6, (11, 2.5, 3))]
    for stamp_ns in range(START_NS, START_NS + COUNT * PERIOD_NS, PERIOD_NS):
        seen = [Recorded((x - vehicle_x_m(stamp_ns), y, z), "car", 0.8) for x, y, z in CARS]
        late = {"frame_id": "base_link", "log_time_ns": stamp_ns + 40_000_000}
        messages.append(objects_message("autoware", stamp_ns, seen, **late))
        messages.append(objects_message("humble", stamp_ns + 20_000_000, at_map, frame_id="map", topic="/other"))
    return in_order(messages)


def test_two_detectors_on_a_vehicle_without_clouds(tmp_path: Path) -> None:
    write_mcap(tmp_path / "in.mcap", drive())
    settings = (*RECORDED, f"sync.reference={DETECTOR}", f"sync.required=[{DETECTOR}]")
    summary = process(tmp_path / "in.mcap", tmp_path / "out.mcap", *settings)
    assert (summary.sensors.rig.site_frame, summary.frames.count, summary.sensors.faults) == ("base_link", COUNT, ())
    for stamp_ns, rows in lidar_boxes(tmp_path / "out.mcap").items():
        shift_m = vehicle_x_m(stamp_ns)
        expected = [[30 - shift_m, 3], [45 - shift_m, -4], [60 - shift_m, 8]]
        np.testing.assert_allclose(np.array(rows)[:, :2], expected, atol=1e-6)
    kinds = {one.label for objects in fused_objects(tmp_path / "out.mcap").values() for one in objects}
    assert kinds == {"car", "bus"}
    assert summary.inputs.messages_used[DETECTOR] == summary.frames.count
    assert re.search(rf"3D boxes +recorded from {DETECTOR}, /other$", printed(summary), re.MULTILINE)
    assert summary_tree(summary)["boxes3d_topics"] == [DETECTOR, "/other"]


@pytest.mark.parametrize(("frame_id", "is_named"), [("base_link", True), ("map", False)])
def test_boxes_without_anything_that_tells_whether_they_move_are_named(
    tmp_path: Path, frame_id: str, is_named: bool
) -> None:
    stamps_ns = range(START_NS, START_NS + 10 * PERIOD_NS, PERIOD_NS)
    seen = [Recorded((30.0, 3.0, 0.8), "car", 0.8)]
    write_mcap(tmp_path / "in.mcap", [objects_message("humble", one, seen, frame_id=frame_id) for one in stamps_ns])
    notes = process(tmp_path / "in.mcap", tmp_path / "out.mcap", *RECORDED).notes
    assert any(note.startswith(f"{frame_id}: neither clouds nor odometry") for note in notes) == is_named


def test_an_inspection_tells_of_the_boxes(tmp_path: Path) -> None:
    write_mcap(tmp_path / "in.mcap", drive())
    config = Config.model_validate({"detect3d": {"method": "recorded"}})
    inspection = inspect_recording([tmp_path / "in.mcap"], SettingsChoice(config))
    console = Console(record=True, width=200, force_terminal=False)
    print_inspection(console, inspection)
    text = console.export_text()
    assert f"3D boxes: recorded from {DETECTOR}, /other" in text
    assert re.search(rf"detector_objects +{DETECTOR} +base_link +its frame is the site frame", text)
    assert re.search(r"other +/other +map +motion of base_link in map", text)
    assert (inspection.problem, inspection.incomplete, inspection.box_source_3d) == ("", (), "recorded")
