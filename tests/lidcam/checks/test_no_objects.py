"""A run without objects says which step left nothing; each cause is brought about on a sample recording."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from frames import CONFIG, RIG, frame
from memory_recording import MemoryRecording

import lidcam
from lidcam.checks.no_objects import ObjectCheck
from lidcam.pipeline.core.detections import Fused
from lidcam.pipeline.core.frame import FrameResult
from lidcam.pipeline.core.rig import RecordedDetector, Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.run.choice import AS_GIVEN, UsedSettings
from lidcam.run.warning import RunWarning

ROOT = Path(__file__).resolve().parents[3]
SANDBOX = ROOT / "bags" / "sandbox.bag"
LOOKS_LIKE = "clouds of 5.5 x 3.9 m, lidars 0.3 m above the ground: try --config sandbox; else "


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
        (
            "road",
            ["combine.max_range_m=0.05"],
            "points are nearer or further than combine.min_range_m and max_range_m allow, 0 to 0.05 m",
            LOOKS_LIKE + "set other limits",
        ),
        (
            "crossing",
            ["detect3d.cluster.min_height_m=2", "detect3d.method=cluster"],
            "no cluster of the",
            LOOKS_LIKE + "see detect3d.cluster and the sizes of classes, unless there is nothing to detect",
        ),
        ("road", [], "less than detect3d.min_score, 0.07", LOOKS_LIKE + "a smaller detect3d.min_score shows them"),
        ("sandbox", ["fuse.min_score=1"], "than fuse.min_score, 1", "a smaller fuse.min_score shows them"),
    ],
    ids=["range", "clusters", "scale", "fuse"],
)
def test_the_step_that_left_nothing_is_named(
    config: str | None, settings: list[str], finding: str, remedy: str
) -> None:
    warning = warning_of(config, *settings)
    assert finding in warning.finding
    assert warning.remedy == remedy


def warnings_of(
    *frames: FrameResult, rig: Rig = RIG, config: Config = CONFIG, used: UsedSettings = AS_GIVEN
) -> tuple[RunWarning, ...]:
    check = ObjectCheck(MemoryRecording([]), rig, config, used, moves=False)
    for one in frames:
        check.add_frame(one)
    return check.warnings


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


@pytest.mark.parametrize(
    ("count", "finding", "remedy"),
    [
        (
            100,
            "of 100 points in range, 99 were removed as ground, which leaves none to detect in",
            "a smaller combine.ground.distance_m than 0.2 may help",
        ),
        (0, "its clouds have no points", "see the lidars and their drivers"),
    ],
)
def test_frames_without_points(count: int, finding: str, remedy: str) -> None:
    (warning,) = warnings_of(flat(count))
    assert (warning.finding, warning.remedy) == (f"frame 0 came closest: {finding}", remedy)


BELIEVED = frame().hypotheses
MESSAGES = {"/objects": next(iter(frame().bundle.messages.values()))}


@pytest.mark.parametrize(
    ("changes", "finding", "remedy"),
    [
        (
            {"bundle": replace(frame().bundle, messages=MESSAGES), "combined": flat(1).combined},
            "the messages of /objects have no boxes",
            "see that detector, or topics.boxes3d",
        ),
        (
            {"hypotheses": BELIEVED, "beliefs": np.full(len(BELIEVED.boxes), 0.25)},
            f"the most probable of its {len(BELIEVED.boxes)} boxes has a probability of 0.25, less than "
            "fuse.min_score, 0.5",
            "a smaller fuse.min_score shows them",
        ),
    ],
    ids=["no boxes", "not believed"],
)
def test_recorded_boxes_that_become_no_objects(changes: dict[str, object], finding: str, remedy: str) -> None:
    """Of a recorded detector without lidars."""
    rig = replace(RIG, lidars=(), detectors=(RecordedDetector("objects", "/objects", "site", {}),))
    config = Config.model_validate({"detect3d": {"method": "recorded"}})
    other = replace(flat(0), **changes)  # type: ignore[arg-type]  # fields of a frame
    (warning,) = warnings_of(flat(0), other, rig=rig, config=config)
    assert (warning.finding.partition(": ")[2], warning.remedy) == (finding, remedy)


def test_objects_that_no_zone_lets_be_reported() -> None:
    result = flat(100)
    left_out = replace(result, fused=replace(result.fused, left_out={"in zone yard of use ignore": 2}))
    (warning,) = warnings_of(left_out, result)
    assert warning.finding == "frame 0 came closest: its objects are not reported: 2 in zone yard of use ignore"
    assert warning.remedy == "see the zones of the rig file, or rig.zones"
