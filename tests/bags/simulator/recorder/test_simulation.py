"""What a scenario asks for is in the recording, and the same every time."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation
from small_scenario import write_small_scenario

from lidcam.commands.simulate import SimulateOptions, run_simulate
from pipeline.core.ros.typestores import message_types

MS = 1_000_000
START_NS = 1_700_000_000 * 10**9

Simulate = Callable[..., Path]


@pytest.fixture
def simulate(tmp_path: Path) -> Simulate:
    """Record the small scenario with changes; 1 s unless told."""

    def run(name: str = "out.bag", duration: float = 1.0, **changes: Any) -> Path:
        options = {key: changes.pop(key) for key in ("seed", "workers") if key in changes}
        scenario = write_small_scenario(tmp_path / "small.yaml", **changes)
        run_simulate(SimulateOptions(str(scenario), tmp_path / name, duration_s=duration, **options))
        return tmp_path / name

    return run


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


@pytest.mark.parametrize("name", ["out.bag", "out.mcap", "folder"])
def test_same_seed_same_bytes_whatever_the_workers(simulate: Simulate, name: str) -> None:
    first = sums(simulate(name, workers=1, duration=0.35))
    assert sums(simulate(name, workers=3, duration=0.35)) == first
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
        for controller in (
            "left_rear_wheel_velocity_controller",
            "right_rear_wheel_velocity_controller",
            "left_front_wheel_velocity_controller",
            "right_front_wheel_velocity_controller",
            "left_steering_hinge_position_controller",
            "right_steering_hinge_position_controller",
        ):
            assert counts[f"/{name}/{controller}/command"] == 21
    assert counts["/ground_truth/objects"] == 5  # at 0.0 ... 0.8 s: at 1.0 s nothing measures


def test_a_car_that_is_driven_by_itself_moves_as_its_commands_say(simulate: Simulate) -> None:
    path = simulate()
    odometry = stamped(path, "/car2/base_pose_ground_truth")
    x = np.array([message.pose.pose.position.x for _, message in odometry])
    np.testing.assert_allclose(x[-1] - x[0], 0.5, atol=0.02)
    still = stamped(path, "/car1/base_pose_ground_truth")
    assert len({message.pose.pose.position.x for _, message in still}) == 1
    [*_, (_, drive)] = stamped(path, "/car2/ackermann_cmd_mux/output")
    [*_, (_, wheel)] = stamped(path, "/car2/left_rear_wheel_velocity_controller/command")
    assert wheel.data == pytest.approx(28 * drive.drive.speed)


def test_the_truth_tells_how_often_things_are_hit(simulate: Simulate) -> None:
    path = simulate()
    [(_, truth), *_] = stamped(path, "/ground_truth/objects")
    told = {one.results[3].score: {result.id: result.score for result in one.results} for one in truth.detections}
    assert set(told) == {0.0, 1.0}
    for counts in told.values():
        assert counts[1] == 1.0  # a car
        assert counts[-1] > 0  # lidar points
    assert told[0.0][-2] + told[1.0][-2] > 0  # image pixels


def test_clock_offset_and_death(simulate: Simulate) -> None:
    path = simulate(lidars__top__clock_offset_ms=40.0, cameras__front__dies_at_s=0.5)
    plain = simulate("plain.bag")
    late = [stamp_ns(message) for _, message in stamped(path, "/points")]
    assert late == [stamp_ns(message) + 40 * MS for _, message in stamped(plain, "/points")]
    images = [stamp_ns(message) for _, message in stamped(path, "/image/compressed")]
    assert images == [(10 + 100 * number) * MS for number in range(5)]
    assert len(stamped(plain, "/image/compressed")) == 10


def test_drop_rate(simulate: Simulate) -> None:
    changes = {"cameras__front__rate_hz": 50.0, "cameras__front__drop_rate": 0.4, "cameras__front__detector": None}
    path = simulate(duration=2.0, **changes, lidars__top__rate_hz=5.0)
    assert 40 <= len(stamped(path, "/image/compressed")) <= 80  # of 100
    whole = simulate("whole.bag", duration=2.0, **(changes | {"cameras__front__drop_rate": 0.0}))
    kept = {stamp_ns(m): bytes(m.data) for _, m in stamped(path, "/image/compressed")}
    all_of_them = {stamp_ns(m): bytes(m.data) for _, m in stamped(whole, "/image/compressed")}
    assert kept.items() <= all_of_them.items()  # the others are what they were


def test_log_delay(simulate: Simulate) -> None:
    path = simulate(cameras__front__log_delay_ms=70.0)
    for log_ns, message in stamped(path, "/image/compressed"):
        assert log_ns - stamp_ns(message) == 70 * MS


@pytest.mark.parametrize(
    ("sensor", "turned_deg", "moved_m"),
    [
        ("lidars__top", [0, 0, 2.0], [0.05, 0, 0]),
        ("cameras__front", [0, -2.0, 0], [0, 0, 0.05]),  # up and ahead of the body, in the optical frame
    ],
)
def test_miscalibration_of_the_body_is_in_tf(
    simulate: Simulate, sensor: str, turned_deg: list[float], moved_m: list[float]
) -> None:
    error = {"rpy_deg": [0.0, 0.0, 2.0], "xyz_cm": [5.0, 0.0, 0.0]}
    [(_, true)] = stamped(simulate("true.bag"), "/tf_static")
    [(_, wrong)] = stamped(simulate("wrong.bag", **{f"{sensor}__miscalibration": error}), "/tf_static")
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
