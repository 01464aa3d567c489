"""The sample of the crossing: raw packets and distorted cameras in, the road users of the truth out."""

from pathlib import Path

import numpy as np
import pytest
from command import Lidcam
from results import Found, fused_objects, messages_of, stamp_of

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
        found[stamp_of(message)] = [
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


def test_what_is_reported_with_images_is_there(truth: Truth, output: Path, frames: dict[int, list[Found]]) -> None:
    """The cameras have half as many images as the lidars have sweeps."""
    with_images = {log_time_ns for log_time_ns, _ in messages_of(output, "/camera_north_east/detections")}
    logged_ns = [log_time_ns for log_time_ns, _ in messages_of(output, "/fused/detections")]
    assert len(with_images) >= 6
    real = []
    for log_time_ns, (stamp_ns, objects) in zip(logged_ns, frames.items(), strict=True):
        nearest_ns = min(truth, key=lambda time_ns: abs(time_ns - stamp_ns))
        places = np.array([(x, y) for _, x, y, _, _ in truth[nearest_ns]])
        if log_time_ns in with_images:
            real += [bool(np.hypot(*(places - (one.x, one.y)).T).min() < 3.0) for one in objects]
    assert np.mean(real) >= 0.9
