"""A run without objects says what each step left; causes are brought about on a sample recording."""

import re
from dataclasses import replace

import numpy as np
import pytest
from frames import CONFIG, RIG, frame
from helpers import SANDBOX
from memory_recording import MemoryRecording

import lidcam
from lidcam.checks.no_objects import MODEL_CARS, REMEDY, ObjectCheck
from lidcam.pipeline.core.detections import Fused
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import RecordedDetector, Rig
from lidcam.run.choice import AS_GIVEN, UsedSettings
from lidcam.run.scene import SceneSize
from lidcam.run.warning import RunWarning

LOOKS_LIKE = "clouds of 5.5 x 3.9 m, lidars 0.3 m above the ground: try --config sandbox if this is a model site; else "


def warning_of(config: str | None, *settings: str) -> RunWarning:
    """Of the lidars alone: cameras would place objects that they do not find."""
    alone = ["output.images=false", "detect2d.method=none", *settings]
    run = lidcam.process(SANDBOX, config=config, settings=alone, duration_s=0.4, workers=1)
    assert len(run.objects) == 0
    (warning,) = (one for one in run.summary.warnings if one.subject == "no objects")
    return warning


@pytest.mark.parametrize(
    ("config", "settings", "finding", "remedy"),
    [
        ("road", ["combine.max_range_m=0.05"], r"of them outside of combine\.min_range_m and max_r", LOOKS_LIKE),
        ("road", [], r", 0 boxes of at least detect3d\.min_score 0\.07", LOOKS_LIKE),
        ("sandbox", ["fuse.min_score=1"], r"the most probable 0\.\d\d, of fuse\.min_score 1$", MODEL_CARS),
    ],
    ids=["range", "scale", "fuse"],
)
def test_each_step_is_told(config: str | None, settings: list[str], finding: str, remedy: str) -> None:
    warning = warning_of(config, *settings)
    assert re.search(finding, warning.finding)
    assert warning.remedy == remedy + REMEDY


def warnings_of(*frames: FrameResult, rig: Rig = RIG, used: UsedSettings = AS_GIVEN) -> tuple[RunWarning, ...]:
    check = ObjectCheck(MemoryRecording([]), rig, CONFIG, used, moves=False)
    for one in frames:
        check.add_frame(one)
    return tuple(check.warnings)


def test_clouds_in_millimetres() -> None:
    used = replace(AS_GIVEN, size=SceneSize((78000.0, 40000.0), None))
    (warning,) = warnings_of(flat(1000), used=used)
    assert warning.remedy == "clouds of 78000 x 40000 m are probably in millimetres: record them in metres (REP 103)"


def flat(count: int) -> FrameResult:
    """A frame in which the ground takes every point."""
    result = frame()
    none = result.detections.lidar.select(np.zeros(0, np.intp))
    outliers = min(count, 1)
    counts = {"input": count, "nan": 0, "range": 0, "outliers": outliers, "ground": count - outliers, "left": 0}
    return replace(
        result,
        combined=replace(
            result.combined,
            counts=counts,
            detection_cloud=result.combined.detection_cloud.select(np.zeros(0, np.intp)),
            detection_lidar_index=np.zeros(0, np.uint8),
        ),
        detections=replace(result.detections, lidar=none),
        hypotheses=replace(result.hypotheses, boxes=none, lidar_count=0),
        beliefs=np.zeros(0),
        fused=Fused(none, np.zeros(0, np.int32), np.zeros(0, np.int64)),
    )


def test_a_frame_of_ground_alone() -> None:
    (warning,) = warnings_of(flat(100))
    steps = "100 points, 0 of them outside of combine.min_range_m and max_range_m, 99 of the ground (combine.ground)"
    assert warning.finding == f"frame 0 came closest: {steps}, 0 boxes of at least detect3d.min_score 0.07"


def test_recorded_boxes_that_become_no_objects() -> None:
    """Of a recorded detector without lidars."""
    rig = replace(RIG, lidars=(), detectors=(RecordedDetector("objects", "/objects", "site", {}),))
    heard = replace(frame().bundle, messages={"/objects": next(iter(frame().bundle.messages.values()))})
    other = replace(flat(0), bundle=heard, unused_boxes3d={"box without a volume": 2})
    (warning,) = warnings_of(flat(0), other, rig=rig)
    assert warning.finding.endswith(", 1 messages of recorded 3D boxes, 2 box without a volume")


def test_objects_that_no_zone_lets_be_reported() -> None:
    result = flat(100)
    left_out = replace(result, fused=replace(result.fused, left_out={"in zone yard of use ignore": 2}))
    (warning,) = warnings_of(left_out, result)
    assert warning.finding.endswith(", 2 in zone yard of use ignore")
