"""The main job on the sample recording: the right objects, in every container, with the same bytes every time."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import Lidcam, Run
from helpers import CLUSTERS, ROOT, SANDBOX
from results import fused_objects, messages_of, stamp_of, topics_of
from rosbags.highlevel import AnyReader

Process = Callable[..., Run]


@pytest.fixture(scope="module")
def process(lidcam: Lidcam) -> Process:
    """Process the sample with its settings and more options, by clusters."""

    def run(out: Path, *options: object) -> Run:
        done = lidcam("process", SANDBOX, out, "--config", "sandbox", "--set", CLUSTERS, *options)
        assert done.code == 0, done.err
        return done

    return run


@pytest.fixture(scope="module")
def whole(lidcam: Lidcam, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of the whole sample as its settings are; with a Rerun recording, a table of the objects."""
    out = tmp_path_factory.mktemp("whole") / "out.mcap"
    more = ("--rerun", out.with_suffix(".rrd"), "--objects", out.with_suffix(".csv"))
    run = lidcam("process", SANDBOX, out, "--config", "sandbox", *more)
    assert run.code == 0, run.err
    assert "objects" in run.out
    assert "frames" in run.out
    assert out.with_suffix(".rrd").stat().st_size > 100_000
    out.with_suffix(".txt").write_text(run.out, encoding="utf-8")
    return out


@pytest.fixture(scope="module")
def truth() -> dict[str, list[tuple[int, float, float, float]]]:
    """(stamp, x, y, yaw) of each car, from the ground truth odometry."""
    found: dict[str, list[tuple[int, float, float, float]]] = {"car1": [], "car2": []}
    with AnyReader([SANDBOX]) as reader:
        for car, poses in found.items():
            wanted = [c for c in reader.connections if c.topic == f"/{car}/base_pose_ground_truth"]
            for connection, _, data in reader.messages(wanted):
                message: Any = reader.deserialize(data, connection.msgtype)
                pose = message.pose.pose
                yaw = 2 * np.arctan2(pose.orientation.z, pose.orientation.w)
                poses.append((stamp_of(message), pose.position.x, pose.position.y, float(yaw)))
    return found


def test_the_readme_shows_what_is_printed(whole: Path) -> None:
    """By the command of the demo, which `make gate` runs."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    table = readme.split("and prints what it found:\n\n```\n")[1].split("...\n```")[0]
    assert "road users" in table
    printed = whole.with_suffix(".txt").read_text(encoding="utf-8")
    first, rest = (re.sub(r"in [\d.]+ s, [\d.]+ per", "per", text) for text in (table, printed))
    assert rest.startswith(first)


def test_both_cars_are_found_and_confirmed(
    whole: Path, truth: dict[str, list[tuple[int, float, float, float]]]
) -> None:
    frames = fused_objects(whole)
    assert len(frames) >= 18
    for car, poses in truth.items():
        stamps = np.array([stamp for stamp, *_ in poses])
        errors = []
        for stamp_ns, objects in frames.items():
            _, x, y, _ = poses[int(np.abs(stamps - stamp_ns).argmin())]
            distances_m = [float(np.hypot(o.x - x, o.y - y)) for o in objects if o.label == "car"]
            errors += [nearest_m for nearest_m in sorted(distances_m)[:1] if nearest_m < 0.15]
        assert len(errors) >= 0.9 * len(frames), f"{car}: found in {len(errors)} of {len(frames)} frames"
        assert np.median(errors) < 0.08, car


def test_json_summary_and_same_bytes_with_any_name(process: Process, tmp_path: Path) -> None:
    out, other = tmp_path / "out.mcap", tmp_path / "other_name.mcap"
    summary = json.loads(process(out, "--duration", "0.6", "--workers", "1", "--json").out)
    process(other, "--duration", "0.6", "--workers", "2")
    assert out.read_bytes() == other.read_bytes()
    assert summary["frames"] >= 4
    assert summary["box_source"] == "recorded"
    assert summary["timing"]["frames_per_second"] > 0
    stages = {*summary["timing"]["stage_ms"]}
    assert {"combine", "detect 3D", "refine", "write mcap"} <= stages
    assert stages.isdisjoint({"collect", "unused", "detections", "no 2D boxes", "no recorded 3D boxes"})
    used, dropped = summary["messages_used"], summary["drops"]
    assert set(used) >= {"/velodyne1_points", "/image_raw_11/compressed", "/detections_44"}
    assert all(drop["reason"] for drop in dropped)
    nothing = {"topics": [], "compensated_frames": 0, "frames_from_clouds": 0, "frames_predicted": 0}
    assert summary["motion"] == nothing
    assert "/car1/base_pose_ground_truth" in summary["unused_topics"]
    assert not set(summary["unused_topics"]) & {*used, *summary["copied"]}
    truth = {f"/ground_truth/{name}" for name in ("objects", "objects_when_measured")}
    truth |= {f"/ground_truth/cam{n}/{kind}" for n in (11, 12, 13, 14, 41, 42, 43, 44) for kind in ("visible", "whole")}
    # Of the second, and of the two after it at most.
    assert summary["copied"] == dict.fromkeys(sorted(truth), 20)


def test_lidar_only_says_so_and_draws_its_boxes_over_the_images(process: Process, tmp_path: Path) -> None:
    out, one_camera = tmp_path / "o.mcap", "topics.cameras=[/image_raw_43/compressed]"
    options = ("--set", "detect2d.method=none", "--set", one_camera, "--duration", "0.3")
    run = process(out, *options, "--print-detections", "--print-matches")
    assert [topic for topic in topics_of(out) if topic.endswith("/annotations")] == ["/cam43/annotations"]
    assert "lidar-only" in run.out
    assert "lidar detections" in run.out
    assert any(fused_objects(out).values())
    assert all(len(message.points) > 0 for _, message in messages_of(out, "/cam43/annotations"))
    assert not messages_of(out, "/cam43/detections"), "no detector has looked"
