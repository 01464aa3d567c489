"""Boxes of 3D detectors in the recording of a moving vehicle, end to end."""

import re
from pathlib import Path

import numpy as np
import pytest
from builders import in_order, odometry, raw, write_mcap
from object_messages import Recorded, objects_message
from results import fused_objects, messages_of, stamp_of
from rich.console import Console
from summaries import printed

from lidcam.cli.printing.console import print_inspection
from lidcam.inspection import inspect_recording
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.settings.config import Config
from lidcam.processing import process_recording
from lidcam.run.choice import SettingsChoice
from lidcam.run.job import make_job
from lidcam.run.summary import RunSummary, summary_tree

RECORDED = ("output.layout=false", "fuse.min_score=0", "detect3d.method=recorded")
DETECTOR = "/detector/objects"
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


def process(recording: Path, out: Path, *settings: str, workers: int = 1) -> RunSummary:
    return process_recording(make_job(recording, out, settings=(*RECORDED, *settings), workers=workers))


def test_two_detectors_on_a_vehicle_without_clouds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidcam.pipeline.parallel.run.START_S", 0.0)  # no recording is too short for two processes
    write_mcap(tmp_path / "in.mcap", drive())
    settings = f"sync.reference={DETECTOR}", f"sync.required=[{DETECTOR}]"
    for workers in (2, 1):
        summary = process(tmp_path / "in.mcap", tmp_path / f"{workers}.mcap", *settings, workers=workers)
    out = tmp_path / "1.mcap"
    assert out.read_bytes() == (tmp_path / "2.mcap").read_bytes()
    assert (summary.sensors.rig.site_frame, summary.frames.count, summary.sensors.faults) == ("base_link", COUNT, ())
    for _, message in messages_of(out, "/lidar/detections"):
        shift_m, places = vehicle_x_m(stamp_of(message)), [one.bbox.center.position for one in message.detections]
        expected = [[30 - shift_m, 3], [45 - shift_m, -4], [60 - shift_m, 8]]
        np.testing.assert_allclose([[place.x, place.y] for place in places], expected, atol=1e-6)
    kinds = {one.label for objects in fused_objects(out).values() for one in objects}
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
    notes = process(tmp_path / "in.mcap", tmp_path / "out.mcap").notes
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
