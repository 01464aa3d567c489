"""What a scenario asks for is in the recording, and the same every time."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from logging_state import kept_logging
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation
from small_scenario import SMALL, write_small_scenario

from lidcam.bags.simulator.scenario.traffic import controller_topics
from lidcam.commands.simulation.simulate import simulate as record
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.ros.typestores import message_types

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
    """Record the small scenario with changes; 1 s unless told."""
    return lambda name="out.bag", **changes: simulated(tmp_path / name, **changes)


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
    files = [path] if path.is_file() else sorted(path.iterdir())
    return "".join(hashlib.sha256(file.read_bytes()).hexdigest() for file in files)


@pytest.mark.parametrize(("name", "workers"), [("out.bag", 3), ("out.mcap", 1), ("folder", 1)])
def test_same_seed_same_bytes_whatever_the_workers(simulate: Simulate, name: str, workers: int) -> None:
    first = sums(simulate(name, duration=0.35))
    assert sums(simulate(name, workers=workers, duration=0.35)) == first
    assert sums(simulate(name, seed=2, duration=0.35)) != first


def test_topics_rates_and_order(simulate: Simulate) -> None:
    path = simulate(recording__truth_rate_hz=5.0)
    with AnyReader([path]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        times = [time for _, time, _ in reader.messages()]
    assert times == sorted(times)
    assert counts["/tf_static"] == 1
    assert counts["/points"] == 10  # the tenth ends after the end
    assert counts["/image/compressed"] == counts["/info"] == counts["/boxes"] == 10
    for name in ("car1", "car2"):
        assert counts[f"/{name}/base_pose_ground_truth"] == 51
        assert counts[f"/{name}/ackermann_cmd_mux/output"] == 21
        for topic in controller_topics(name):
            assert counts[topic] == 21
    assert counts["/ground_truth/objects"] == 5  # at 0.0 ... 0.8 s: at 1.0 s nothing measures
    assert counts["/ground_truth/objects_when_measured"] == 5
    assert counts["/ground_truth/front/visible"] == counts["/ground_truth/front/whole"] == 10


def test_a_car_that_is_driven_by_itself_moves_as_its_commands_say(plain: Path) -> None:
    odometry = stamped(plain, "/car2/base_pose_ground_truth")
    x = np.array([message.pose.pose.position.x for _, message in odometry])
    np.testing.assert_allclose(x[-1] - x[0], 0.5, atol=0.02)
    still = stamped(plain, "/car1/base_pose_ground_truth")
    assert len({message.pose.pose.position.x for _, message in still}) == 1
    [*_, (_, drive)] = stamped(plain, "/car2/ackermann_cmd_mux/output")
    [*_, (_, wheel)] = stamped(plain, "/car2/left_rear_wheel_velocity_controller/command")
    assert wheel.data == pytest.approx(28 * drive.drive.speed)


def told(detection: Any) -> dict[int | str, float]:
    """The score of each hypothesis of a detection, by number or name."""
    hypotheses = [getattr(one, "hypothesis", one) for one in detection.results]
    return {one.class_id if hasattr(one, "class_id") else one.id: one.score for one in hypotheses}


def test_counts_of_each_sensor_are_those_that_add_up(simulate: Simulate) -> None:
    """A second camera beside the first sees nothing else, and one that looks away sees nothing at all."""
    front = SMALL["cameras"]["front"]
    more = {
        name: front | {"topic": f"/{name}", "info_topic": f"/{name}/info", "frame_id": name, "rpy_deg": rpy_deg}
        for name, rpy_deg in (("twin", front["rpy_deg"]), ("away", [0, 15, -150]))
    }
    more["twin"]["detector"] = more["away"]["detector"] = None
    path = simulate("out.mcap", duration=0.35, cameras={"front": front} | more)
    for _, truth in stamped(path, "/ground_truth/objects"):
        assert [one.id for one in truth.detections] == ["car1", "car2"]
        for one in truth.detections:
            counts = told(one)
            each = ["lidar_points/top", *(f"image_pixels/{name}" for name in ("away", "front", "twin"))]
            assert list(counts)[3:] == each  # in the order of the file, which is sorted
            assert counts["lidar_points"] == counts["lidar_points/top"] > 0
            assert counts["image_pixels"] == 2 * counts["image_pixels/front"] == 2 * counts["image_pixels/twin"]
            assert counts["image_pixels/away"] == 0
    assert counts["image_pixels"] > 0


def placed(detection: Any) -> list[float]:
    center, size = detection.bbox.center.position, detection.bbox.size
    return [center.x, center.y, center.z, size.x, size.y, size.z]


@pytest.mark.parametrize("others", [[], [("late", 60.0, 10.0)], [("later", 20.0, 10.0), ("fast", 0.0, 20.0)]])
def test_the_truth_at_the_time_of_the_points_is_where_they_lie(
    simulate: Simulate, others: list[tuple[str, float, float]]
) -> None:
    """Judged by the clouds and the odometry: the points in a car's box at their own times, and their mean time.

    As in a frame of the pipeline: at the stamp of the first lidar's sweep, with the nearest sweep of each other one.
    """
    top = SMALL["lidars"]["top"] | {"firing_stride": 2}
    more = {
        name: top | {"topic": f"/{name}", "frame_id": name, "phase_ms": phase_ms, "rate_hz": rate_hz}
        for name, phase_ms, rate_hz in others
    }
    changes = {"lidars": {"a_top": top} | more, "cameras": {}, "vehicles__car2__speed_m_s": 1.5}
    path = simulate("out.mcap", **changes)
    clouds = [
        {stamp_ns(one): fields_of(one) for _, one in stamped(path, topic)}
        for topic in ("/points", *(f"/{o[0]}" for o in others))
    ]
    steady, moved = (
        {stamp_ns(message): message for _, message in stamped(path, topic)}
        for topic in ("/ground_truth/objects", "/ground_truth/objects_when_measured")
    )
    assert steady.keys() == moved.keys()
    for moment, message in steady.items():
        (still, now), (still_then, then) = message.detections, moved[moment].detections
        assert placed(still) == placed(still_then)
        assert (now.id, told(now)) == ("car2", told(then))
        assert placed(now)[1:] == pytest.approx(placed(then)[1:], abs=1e-6)
    way = np.array([(stamp_ns(m), m.pose.pose.position.x) for _, m in stamped(path, "/car2/base_pose_ground_truth")])
    expected = np.array([(moment, placed(message.detections[1])[0]) for moment, message in moved.items()])
    checked = 0
    for time_ns in clouds[0]:
        if not 80 * MS <= time_ns <= expected[-1, 0]:  # by then every lidar measures
            continue
        times_ns = []
        for sweeps in clouds:
            nearest_ns = min(sweeps, key=lambda other_ns: abs(other_ns - time_ns))
            cloud = sweeps[nearest_ns]
            at_ns = nearest_ns + cloud["time"] * 1e9
            y, z = cloud["y"] + 0.3, cloud["z"] + 0.4  # the lidars stand upright at (0, 0.3, 0.4)
            own = (np.abs(y - placed(now)[1]) < 0.14) & (z > 0.012) & (z < 0.24)
            own &= np.abs(cloud["x"] - np.interp(at_ns, *way.T)) < 0.19
            times_ns.append(at_ns[own])
        found = float(np.interp(time_ns, *expected.T))
        assert found == pytest.approx(np.interp(np.concatenate(times_ns).mean(), *way.T), abs=6e-3)
        checked += 1
    assert checked >= 8


def fields_of(cloud: Any) -> dict[str, F64]:
    kinds = {4: "<u2", 7: "<f4"}
    dtype = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "formats": [kinds[field.datatype] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    points = np.frombuffer(bytes(cloud.data), dtype)
    return {name: points[name].astype(np.float64) for name in dtype.names or ()}


def edges_of(detection: Any) -> list[float]:
    box = detection.bbox
    center, x, y = getattr(box.center, "position", box.center), box.size_x, box.size_y
    return [center.x - x / 2, center.y - y / 2, center.x + x / 2, center.y + y / 2]


@pytest.mark.parametrize("name", ["out.bag", "out.mcap"])
def test_every_image_has_its_truth_and_boxes_say_whose_they_are(simulate: Simulate, name: str) -> None:
    """An exact detector finds what the truth calls visible."""
    exact = {"pixel_noise_px": 0.0, "miss_rate": 0.0, "min_visible": 0.0, "min_height_px": 0.0}
    detector = {"topic": "/boxes", "false_per_image": 1.0, **exact}
    path = simulate(name, cameras__front__detector=detector, vehicles__car1__start=[-0.9, 1.35, 0], duration=0.6)
    topics = ("/image/compressed", "/boxes", "/ground_truth/front/visible", "/ground_truth/front/whole")
    images, boxes, visible, whole = ([message for _, message in stamped(path, topic)] for topic in topics)
    assert len(images) == 6
    times = [[(stamp_ns(one), one.header.frame_id) for one in messages] for messages in (boxes, visible, whole)]
    assert times == [[(stamp_ns(image), "front") for image in images]] * 3
    false_boxes = 0
    for found, shown, complete in zip(boxes, visible, whole, strict=True):
        who = [told(one).get(-3, getattr(one, "id", None)) for one in found.detections]
        nobody = -1.0 if name == "out.bag" else ""
        false_boxes += who.count(nobody)
        own = [one for one, owner in zip(found.detections, who, strict=True) if owner != nobody]
        assert [edges_of(one) for one in own] == [pytest.approx(edges_of(one)) for one in shown.detections]
        assert len(shown.detections) == len(complete.detections) == 2
        for part, all_of_it in zip(shown.detections, complete.detections, strict=True):
            inside, around = edges_of(part), edges_of(all_of_it)
            assert around[0] <= inside[0] < inside[2] <= around[2]
            assert around[1] <= inside[1] < inside[3] <= around[3]
            if name == "out.mcap":
                assert part.id == all_of_it.id in {"car1", "car2"}
                assert [*told(part)] == ["car", "image_pixels", "occlusion", "truncation"]
                assert [*told(all_of_it)] == ["car", "image_pixels"]
            else:
                assert [*told(part)] == [1, -2, -4, -5, -3]
                assert [*told(all_of_it)] == [1, -2, -3]
    assert false_boxes > 0


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
    [(_, true)] = stamped(plain, "/tf_static")
    wrong_path = simulate("wrong.bag", duration=0.1, **{f"{sensor}__miscalibration": error})
    [(_, wrong)] = stamped(wrong_path, "/tf_static")
    frame = sensor.rpartition("__")[2]
    poses = []
    for message in (true, wrong):
        [one] = [one.transform for one in message.transforms if one.child_frame_id == frame]
        shift, turn = one.translation, one.rotation
        poses.append(((shift.x, shift.y, shift.z), Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])))
    between = poses[0][1].inv() * poses[1][1]
    np.testing.assert_allclose(between.as_euler("xyz", degrees=True), turned_deg, atol=1e-9)
    moved = poses[0][1].inv().apply(np.subtract(poses[1][0], poses[0][0]))
    np.testing.assert_allclose(moved, moved_m, atol=1e-9)
