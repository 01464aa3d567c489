"""The sample of the crossing: raw packets and distorted cameras in, the road users of the truth out."""

from pathlib import Path

import numpy as np
import pytest
from command import Lidcam
from results import Found, fused_objects, messages_of

from lidcam.evaluation.frames import EvaluationFrames
from readers.results.result import open_result
from readers.truth.open import open_truth

ROOT = Path(__file__).resolve().parents[2]
LABELS = {
    "car": "car",
    "van": "truck",
    "truck": "truck",
    "bus": "bus",
    "cyclist": "bicycle",
    "pedestrian": "pedestrian",
}
"""What the classes of the truth are called in the default settings."""

Truth = dict[int, list[tuple[str, float, float, float, float]]]


@pytest.fixture(scope="module")
def truth() -> Truth:
    """Class, x, y, lidar points and image pixels of what is there, by stamp."""
    found: Truth = {}
    for _, message in messages_of(ROOT / "bags" / "crossing.mcap", "/ground_truth/objects"):
        stamp = message.header.stamp
        found[stamp.sec * 10**9 + stamp.nanosec] = [
            (
                thing.results[0].hypothesis.class_id,
                thing.bbox.center.position.x,
                thing.bbox.center.position.y,
                thing.results[1].hypothesis.score,
                thing.results[2].hypothesis.score,
            )
            for thing in message.detections
        ]
    return found


@pytest.fixture(scope="module")
def output(lidcam: Lidcam, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("crossing") / "out.mcap"
    run = lidcam("process", ROOT / "bags" / "crossing.mcap", out, "--config", "crossing")
    assert run.code == 0, run.err
    return out


@pytest.fixture(scope="module")
def frames(output: Path) -> dict[int, list[Found]]:
    """Fused objects by stamp."""
    return fused_objects(output)


@pytest.fixture(scope="module")
def seen_frames(output: Path) -> dict[int, list[Found]]:
    """Those of the frames with images, of which the cameras have half as many as the lidars have sweeps."""
    log_times_ns = {log_time_ns for log_time_ns, _ in messages_of(output, "/camera_north_east/detections")}
    of_sets = [log_time_ns in log_times_ns for log_time_ns, _ in messages_of(output, "/fused/detections")]
    found = fused_objects(output)
    return {stamp_ns: found[stamp_ns] for stamp_ns, has_images in zip(found, of_sets, strict=True) if has_images}


def test_road_users_are_found(truth: Truth, frames: dict[int, list[Found]]) -> None:
    assert len(frames) >= 6
    hits: dict[str, list[bool]] = {}
    for stamp_ns, objects in frames.items():
        nearest_ns = min(truth, key=lambda time_ns: abs(time_ns - stamp_ns))
        for class_name, x, y, points, pixels in truth[nearest_ns]:
            if points < 15 or pixels < 150:
                continue
            label = LABELS[class_name]
            distances_m = [np.hypot(one.x - x, one.y - y) for one in objects if one.label == label]
            hits.setdefault(label, []).append(min(distances_m, default=np.inf) < 1.6)
    assert set(hits) == set(LABELS.values())
    assert len(hits["car"]) >= 15
    for label, found in hits.items():
        assert np.mean(found) >= 0.75, label


def test_what_the_cameras_see_and_is_reported_is_there(truth: Truth, seen_frames: dict[int, list[Found]]) -> None:
    assert len(seen_frames) >= 6
    real = []
    for stamp_ns, objects in seen_frames.items():
        nearest_ns = min(truth, key=lambda time_ns: abs(time_ns - stamp_ns))
        places = np.array([(x, y) for _, x, y, _, _ in truth[nearest_ns]])
        real += [bool(np.hypot(*(places - (one.x, one.y)).T).min() < 3.0) for one in objects]
    assert np.mean(real) >= 0.9


def test_fused_cars_lie_where_the_truth_has_them(output: Path) -> None:
    """Stamps and frames of reference are right; along its way a car moves within a sweep."""
    with open_result(output) as result, open_truth(result) as truth:
        frames = [*EvaluationFrames(result, truth)]
        across_m, along_m, boxes = [], [], 0
        for frame in frames:
            assert frame.truth is not None
            names = np.array(result.config.class_names)
            objects = frame.sources["fused"].boxes
            cars = objects.select(names[objects.class_ids] == "car")
            of_truth = frame.truth.select((frame.truth.labels == "car") & (frame.truth.lidar_points >= 30))
            for center, yaw in zip(of_truth.centers, of_truth.yaws, strict=True):
                offsets_m = cars.centers[:, :2] - center[:2]
                nearest = offsets_m[np.linalg.norm(offsets_m, axis=1).argsort()[:1]]
                near = nearest[np.linalg.norm(nearest, axis=1) < 2.5]
                along_m += (near @ [np.cos(yaw), np.sin(yaw)]).tolist()
                across_m += np.abs(near @ [-np.sin(yaw), np.cos(yaw)]).tolist()
            boxes += sum(len(image.truth) for image in frame.images.values() if image.truth is not None)
    assert len(frames) >= 14
    assert len(across_m) >= 25
    assert np.median(across_m) < 0.15
    assert np.median(np.abs(along_m)) < 0.9
    assert boxes >= 100
