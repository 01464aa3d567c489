"""What a scenario asks for is in the recording, and the same every time."""

import hashlib
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from logging_state import kept_logging
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation
from small_scenario import SMALL, write_small_scenario

from lidcam.bags.simulator.scenario.scenario import Scenario, controller_topics
from lidcam.cli.simulation.simulate import simulate as record
from lidcam.pipeline.core.ros.typestores import message_types
from lidcam.readers.messages.pointcloud2 import decode_pointcloud2
from lidcam.readers.open import open_recording

MS = 1_000_000
START_NS = 1_700_000_000 * 10**9

Simulate = Callable[..., Path]


def simulated(path: Path, *, duration: float = 1.0, seed: int | None = None, workers: int = 1, **changes: Any) -> Path:
    """The small scenario with changes, recorded by one process: another one takes longer to start than to record."""
    scenario = write_small_scenario(path.with_name("small.yaml"), **changes)
    with kept_logging():
        record(str(scenario), path, duration_s=duration, seed=seed, workers=workers)
    return path


@pytest.fixture
def simulate(tmp_path: Path) -> Simulate:
    return lambda name="out.mcap", **changes: simulated(tmp_path / name, **changes)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small scenario as it is."""
    return simulated(tmp_path_factory.mktemp("plain") / "out.bag")


def stamped(path: Path, topic: str) -> list[tuple[int, Any]]:
    """(log time, message) of a topic, both counted from the scenario's start where they are times."""
    version = 1 if path.suffix == ".bag" else 2
    with AnyReader([path], default_typestore=message_types(version)) as reader:
        wanted = [connection for connection in reader.connections if connection.topic == topic]
        return [(t - START_NS, reader.deserialize(data, c.msgtype)) for c, t, data in reader.messages(wanted)]


def stamp_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec * 10**9 + stamp.nanosec - START_NS)


def sums(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(("name", "workers"), [("out.bag", 3), ("out.mcap", 1)])
def test_same_seed_same_bytes_whatever_the_workers(simulate: Simulate, name: str, workers: int) -> None:
    first = sums(simulate(name, duration=0.35))
    assert sums(simulate(name, workers=workers, duration=0.35)) == first
    assert sums(simulate(name, seed=2, duration=0.35)) != first


def test_topics_rates_and_order(plain: Path) -> None:
    with AnyReader([plain]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        times = [time for _, time, _ in reader.messages()]
    assert times == sorted(times)
    assert counts["/tf_static"] == 1
    assert counts["/points"] == 10  # the tenth ends after the end
    assert counts["/image/compressed"] == counts["/info"] == counts["/boxes"] == 10
    for name in ("car1", "car2"):
        assert counts[f"/{name}/base_pose_ground_truth"] == 51
        topics = [f"/{name}/ackermann_cmd_mux/output", *controller_topics(name)]
        assert {counts[topic] for topic in topics} == {21}
    # At 1.0 s nothing measures.
    assert counts["/ground_truth/objects"] == counts["/ground_truth/objects_when_measured"] == 10
    assert counts["/ground_truth/front/visible"] == counts["/ground_truth/front/whole"] == 10


def test_a_car_moves_as_its_commands_say(plain: Path) -> None:
    odometry = stamped(plain, "/car2/base_pose_ground_truth")
    x = np.array([message.pose.pose.position.x for _, message in odometry])
    np.testing.assert_allclose(x[-1] - x[0], 0.5, atol=0.02)
    still = stamped(plain, "/car1/base_pose_ground_truth")
    assert len({message.pose.pose.position.x for _, message in still}) == 1
    [*_, (_, drive)] = stamped(plain, "/car2/ackermann_cmd_mux/output")
    [*_, (_, wheel)] = stamped(plain, "/car2/left_rear_wheel_velocity_controller/command")
    assert wheel.data == pytest.approx(28 * drive.drive.speed)


def scores(detection: Any) -> dict[str, float]:
    """The score of each hypothesis of a detection, by name."""
    return {one.hypothesis.class_id: one.hypothesis.score for one in detection.results}


def test_counts_of_each_sensor_are_those_that_add_up(simulate: Simulate) -> None:
    """A second camera beside the first sees nothing else, and one that looks away sees nothing at all."""
    front = SMALL["cameras"]["front"] | {"detector": None}
    more = {
        name: front | {"topic": f"/{name}", "info_topic": f"/{name}/info", "frame_id": name, "rpy_deg": rpy_deg}
        for name, rpy_deg in (("twin", front["rpy_deg"]), ("away", [0, 15, -150]))
    }
    path = simulate(duration=0.35, cameras={"front": front} | more)
    for _, truth in stamped(path, "/ground_truth/objects"):
        assert [one.id for one in truth.detections] == ["car1", "car2"]
        for counts in map(scores, truth.detections):
            each = ["lidar_points/top", *(f"image_pixels/{name}" for name in ("away", "front", "twin"))]
            assert list(counts)[3:] == each  # in the order of the file, which is sorted
            assert counts["lidar_points"] == counts["lidar_points/top"] > 0
            assert counts["image_pixels"] == 2 * counts["image_pixels/front"] == 2 * counts["image_pixels/twin"]
            assert counts["image_pixels/away"] == 0
    assert counts["image_pixels"] > 0


@pytest.mark.parametrize("timing", [{"jitter_ms": 8.0}, {"motion_blur": True}, {"phase_ms": 40.0}], ids=str)
def test_each_moment_has_one_image_of_each_camera(simulate: Simulate, timing: dict[str, Any]) -> None:
    """A camera of 5 Hz, and truth at 10 Hz: what stands has the same number of pixels at each time."""
    path = simulate(duration=0.5, cameras={"front": SMALL["cameras"]["front"] | {"rate_hz": 5.0, **timing}})
    counts = [scores(truth.detections[0])["image_pixels"] for _, truth in stamped(path, "/ground_truth/objects")]
    assert min(counts) > 0.9 * max(counts) > 0


def x_of(message: Any) -> float:
    return float(message.detections[1].bbox.center.position.x)


@pytest.mark.parametrize("others", [[], [("late", 60.0, 10.0), ("fast", 0.0, 20.0)]])
def test_the_truth_at_the_time_of_the_points_is_where_they_lie(
    simulate: Simulate, others: list[tuple[str, float, float]]
) -> None:
    """Judged by the clouds and the odometry: the points in a car's box at their own times, and their mean time.

    As in a frame of the pipeline: at the stamp of the first lidar's sweep, with the nearest sweep of each other one.
    """
    top = SMALL["lidars"]["top"] | {"firing_stride": 2}
    lidars = {"a_top": top} | {
        name: top | {"topic": f"/{name}", "frame_id": name, "phase_ms": phase_ms, "rate_hz": rate_hz}
        for name, phase_ms, rate_hz in others
    }
    path = simulate(lidars=lidars, cameras={}, vehicles__car2__speed_m_s=1.5)
    with open_recording([path]) as recording:
        clouds = {
            topic: {one.stamp_ns - START_NS: decode_pointcloud2(one) for one in recording.messages([topic])}
            for topic in ("/points", *(f"/{name}" for name, _, _ in others))
        }
    topics = ("/ground_truth/objects", "/ground_truth/objects_when_measured")
    steady, moved = ({stamp_ns(one): one for _, one in stamped(path, topic)} for topic in topics)
    assert steady.keys() == moved.keys()
    for moment, message in steady.items():
        assert asdict(message.detections[0].bbox) == asdict(moved[moment].detections[0].bbox)  # it stands still
        assert scores(message.detections[1]) == scores(moved[moment].detections[1])
    way = np.array([(stamp_ns(m), m.pose.pose.position.x) for _, m in stamped(path, "/car2/base_pose_ground_truth")])
    expected = np.array([(moment, x_of(message)) for moment, message in moved.items()])
    y_m = steady[0].detections[1].bbox.center.position.y
    checked = 0
    for time_ns in clouds["/points"]:
        if not 80 * MS <= time_ns <= expected[-1, 0]:  # by then every lidar measures
            continue
        times_ns = []
        for sweeps in clouds.values():
            nearest_ns = min(sweeps, key=lambda other_ns: abs(other_ns - time_ns))
            cloud = sweeps[nearest_ns]
            at_ns = nearest_ns + cloud.time_offset_ns
            x, y, z = (cloud.xyz + np.array([0.0, 0.3, 0.4])).T  # the lidars stand upright at (0, 0.3, 0.4)
            own = (np.abs(y - y_m) < 0.14) & (z > 0.012) & (z < 0.24) & (np.abs(x - np.interp(at_ns, *way.T)) < 0.19)
            times_ns.append(at_ns[own])
        found = float(np.interp(time_ns, *expected.T))
        assert found == pytest.approx(np.interp(np.concatenate(times_ns).mean(), *way.T), abs=6e-3)
        checked += 1
    assert checked >= 8


def edges_of(detection: Any) -> list[float]:
    center, x, y = detection.bbox.center.position, detection.bbox.size_x, detection.bbox.size_y
    return [center.x - x / 2, center.y - y / 2, center.x + x / 2, center.y + y / 2]


def test_every_image_has_its_truth_and_boxes_say_whose_they_are(simulate: Simulate) -> None:
    """An exact detector finds what the truth calls visible."""
    exact = {"pixel_noise_px": 0.0, "miss_rate": 0.0, "min_visible": 0.0, "min_height_px": 0.0}
    detector = {"topic": "/boxes", "false_per_image": 1.0, **exact}
    path = simulate(cameras__front__detector=detector, vehicles__car1__start=[-0.9, 1.35, 0], duration=0.6)
    topics = ("/image/compressed", "/boxes", "/ground_truth/front/visible", "/ground_truth/front/whole")
    images, boxes, visible, whole = ([message for _, message in stamped(path, topic)] for topic in topics)
    assert len(images) == 6
    for messages in (boxes, visible, whole):
        assert [(one.header.stamp, one.header.frame_id) for one in messages] == [
            (image.header.stamp, "front") for image in images
        ]
    false_boxes = 0
    for found, shown, complete in zip(boxes, visible, whole, strict=True):
        false_boxes += sum(one.id == "" for one in found.detections)
        own = [one for one in found.detections if one.id]
        np.testing.assert_allclose([edges_of(one) for one in own], [edges_of(one) for one in shown.detections])
        assert [one.id for one in own] == [one.id for one in shown.detections]
        assert [one.id for one in shown.detections] == [one.id for one in complete.detections] == ["car1", "car2"]
        for part, all_of_it in zip(shown.detections, complete.detections, strict=True):
            inside, around = edges_of(part), edges_of(all_of_it)
            assert around[0] <= inside[0] < inside[2] <= around[2]
            assert around[1] <= inside[1] < inside[3] <= around[3]
            assert [*scores(part)] == ["car", "image_pixels", "occlusion", "truncation"]
            assert [*scores(all_of_it)] == ["car", "image_pixels"]
    assert false_boxes > 0


def test_drawn_errors_are_in_what_is_recorded_of_equal_measurements(plain: Path, tmp_path: Path) -> None:
    wrong, again = tmp_path / "wrong.bag", tmp_path / "again.bag"
    beside = wrong.with_name("wrong.bag.scenario.yaml")
    with kept_logging():
        record(str(plain.with_name("small.yaml")), wrong, duration_s=0.35, workers=1, errors=True)
        record(str(beside), again, workers=1)
    assert sums(again) == sums(wrong)
    drawn = Scenario.model_validate(yaml.safe_load(beside.read_text(encoding="utf-8"))).cameras["front"]
    exact_images, images = (stamped(path, "/image/compressed") for path in (plain, wrong))
    for (_, exact), (_, image) in zip(exact_images[:4], images, strict=True):
        assert stamp_ns(image) - stamp_ns(exact) == round(drawn.clock_offset_ms * MS) != 0
        assert image.data.tobytes() == exact.data.tobytes()


@pytest.mark.parametrize(
    ("sensor", "turned_deg", "moved_m"),
    [
        ("lidars__top", [0, 0, 2.0], [0.05, 0, 0]),
        ("cameras__front", [0, -2.0, 0], [0, 0, 0.05]),  # up and ahead of the body, in the optical frame
    ],
)
def test_miscalibration_of_the_body_is_in_tf(
    simulate: Simulate, plain: Path, sensor: str, turned_deg: list[float], moved_m: list[float]
) -> None:
    error = {"rpy_deg": [0.0, 0.0, 2.0], "xyz_cm": [5.0, 0.0, 0.0]}
    wrong = simulate("wrong.bag", duration=0.1, **{f"{sensor}__miscalibration": error})
    poses = []
    for path in (plain, wrong):
        [(_, message)] = stamped(path, "/tf_static")
        [one] = [one.transform for one in message.transforms if one.child_frame_id == sensor.rpartition("__")[2]]
        shift, turn = one.translation, one.rotation
        poses.append(((shift.x, shift.y, shift.z), Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])))
    between = poses[0][1].inv() * poses[1][1]
    np.testing.assert_allclose(between.as_euler("xyz", degrees=True), turned_deg, atol=1e-9)
    moved = poses[0][1].inv().apply(np.subtract(poses[1][0], poses[0][0]))
    np.testing.assert_allclose(moved, moved_m, atol=1e-9)
