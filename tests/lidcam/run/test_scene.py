"""The size of a scene, from clouds of a known floor."""

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import lidar_scene
import numpy as np
import pytest
from builders import odometry, pointcloud2, raw, tf_message, transform_stamped
from memory_recording import MemoryRecording
from rig_messages import static

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import Rig
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.rig.discovery import discover_rig
from lidcam.readers.rig.schema import RigFile
from lidcam.run.scene import (
    MAX_MESSAGES,
    SceneSize,
    clouds_show_motion,
    find_motion,
    looks,
    measure_scene,
    on_level_site,
)

START_NS = 1_600_000_000_000_000_000
PERIOD_NS = 100_000_000


class Counting(MemoryRecording):
    """Counts the messages that are read."""

    read = 0

    def messages(
        self, topics: Collection[str] | None = None, *, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[RawMessage]:
        for message in super().messages(topics, start_ns=start_ns, stop_ns=stop_ns):
            self.read += 1
            yield message


def rig(*heights_m: float, ground_height_m: float | None = None) -> Rig:
    """Lidars `lidar0`, `lidar1`, ... this high above the site's origin."""
    return replace(lidar_scene.rig(*((0.0, 0.0, one) for one in heights_m)), ground_height_m=ground_height_m)


def floor(length_m: float, width_m: float, height_m: float) -> F32:
    """A floor this far below the lidar, evenly covered, with a tenth of walls."""
    rng = np.random.default_rng(1)
    points = rng.uniform((-length_m / 2, -width_m / 2, 0), (length_m / 2, width_m / 2, 0), (6000, 3))
    points[::10, 2] = rng.uniform(0, 0.1 * length_m, 600)
    points[:, 2] -= height_m
    return points.astype(np.float32)


def cloud(lidar: int, xyz: F32, number: int = 0) -> RawMessage:
    stamp_ns = START_NS + number * PERIOD_NS
    return raw(f"/lidar{lidar}", "sensor_msgs/msg/PointCloud2", pointcloud2(xyz, stamp_ns=stamp_ns), stamp_ns)


def measured(messages: Sequence[RawMessage], of: Rig) -> SceneSize:
    found = measure_scene(MemoryRecording(messages), of, Config())
    assert found is not None
    return found


@pytest.mark.parametrize(("length_m", "width_m", "height_m"), [(8, 4, 0.3), (80, 60, 1.8), (60, 100, 6.5)])
def test_extent_and_height(length_m: float, width_m: float, height_m: float) -> None:
    found = measured([cloud(0, floor(length_m, width_m, height_m))], rig(height_m + 2))
    assert found.extent_m == pytest.approx((0.9 * max(length_m, width_m), 0.9 * min(length_m, width_m)), rel=0.05)
    assert found.lidar_height_m == pytest.approx(height_m, abs=0.02 + 0.01 * height_m)


def test_a_ground_that_the_rig_knows_is_not_sought() -> None:
    wall = np.array([[1, y, z] for y in range(9) for z in range(9)], np.float32)
    assert measured([cloud(0, wall)], rig(2.0)).lidar_height_m is None
    assert measured([cloud(0, wall)], rig(2.0, ground_height_m=-1.5)).lidar_height_m == 3.5


@pytest.mark.parametrize(
    "messages",
    [
        [],
        [cloud(0, np.zeros((0, 3), np.float32))],
        [cloud(0, np.zeros((9, 3), np.float32))],
        [cloud(1, floor(1, 1, 1))],
    ],
    ids=["no message", "no points", "no returns", "another topic"],
)
def test_nothing_to_measure(messages: list[RawMessage]) -> None:
    assert measure_scene(MemoryRecording(messages), rig(1.0), Config()) is None


@pytest.mark.parametrize(("late", "read"), [([], 3), (range(50, 60), 23)], ids=["first clouds", "a late lidar"])
def test_no_more_is_read_than_is_needed_and_no_lidar_is_waited_for_long(late: Sequence[int], read: int) -> None:
    xyz = floor(8, 4, 0.3)
    recording = Counting([cloud(0, xyz, n) for n in range(60)] + [cloud(1, xyz, n) for n in late])
    assert measure_scene(recording, rig(*[0.3] * (1 + bool(late))), Config()) is not None
    assert recording.read == read


def test_the_effort_is_bounded_where_no_cloud_can_be_decoded() -> None:
    whole = cloud(0, floor(8, 4, 0.3))
    broken = whole._replace(data=whole.data[:-5])
    recording = Counting([broken._replace(log_time_ns=START_NS + n) for n in range(300)])
    assert measure_scene(recording, rig(0.3), Config()) is None
    assert recording.read == MAX_MESSAGES


def street() -> F32:
    """Ground and sixty boxes, evenly covered."""
    rng = np.random.default_rng(2)
    points = [np.c_[rng.uniform(-60, 60, (60_000, 2)), np.zeros(60_000)]]
    for x, y in rng.uniform(-60, 60, (60, 2)):
        sides = rng.uniform((-2, -1, 0), (2, 1, 3), (2000, 3))
        sides[:1000, 0], sides[1000:, 1] = rng.choice([-2, 2], 1000), rng.choice([-1, 1], 1000)
        points.append(np.add(sides, [x, y, 0]))
    return np.concatenate(points).astype(np.float32)


@cache
def drive(*, speed_m_s: float, begins: int = 0, count: int = 60) -> tuple[RawMessage, ...]:
    """Clouds of a lidar that drives along the street from some message on."""
    world, rng = street(), np.random.default_rng(3)
    messages = []
    for number in range(count):
        x_m = speed_m_s * 0.1 * max(number - begins, 0) - 40
        seen = (world - [x_m, 0, 3.2]).astype(np.float32)
        seen = seen[rng.random(len(seen)) < np.minimum(64 / np.vecdot(seen, seen), 1)]
        messages.append(cloud(0, seen, number))
    return (*messages,)


@pytest.mark.parametrize(
    ("begins", "speed_m_s", "moves"), [(0, 0, False), (0, 3, True), (0, 20, True), (35, 8, True), (0, 0.1, False)]
)
def test_clouds_show_whether_a_lidar_is_on_a_mast_or_on_a_truck(begins: int, speed_m_s: float, moves: bool) -> None:
    recording = MemoryRecording(drive(speed_m_s=speed_m_s, begins=begins))
    assert clouds_show_motion(recording, rig(3.2), Config()) == moves


@pytest.mark.parametrize(
    ("speed_m_s", "recorded_m_s", "topic", "settings", "is_used"),
    [
        (8, 6.5, "/odom", {}, True),  # it may be poor
        (8, 6.5, "/tf", {}, True),
        (8, 0.1, "/odom", {}, False),
        (8, 0, "/odom", {}, False),
        (8, -8, "/odom", {}, False),  # its axis points backwards
        (8, -8, "/tf", {}, False),
        (8, 16, "/odom", {}, False),  # it counts in other units
        (0, 0, "/odom", {}, True),  # it stands
        (8, 0, "/odom", {"combine": {"motion": {"topic": "/odom"}}}, True),
    ],
)
def test_motion_that_contradicts_the_clouds(
    speed_m_s: float, recorded_m_s: float, topic: str, settings: dict[str, Any], is_used: bool
) -> None:
    messages = [*drive(speed_m_s=speed_m_s, count=20)]
    for message in messages[:]:
        place = recorded_m_s * (message.stamp_ns - START_NS) / 1e9, 0, 0
        pose = odometry(stamp_ns=message.stamp_ns, child_frame_id="lidar", position=place)
        transform = transform_stamped("odom", "lidar", stamp_ns=message.stamp_ns, translation=place)
        said = (
            ("nav_msgs/msg/Odometry", pose) if topic == "/odom" else ("tf2_msgs/msg/TFMessage", tf_message([transform]))
        )
        messages.append(raw(topic, *said, message.stamp_ns))
    recording, config = MemoryRecording(messages), Config.model_validate(settings)
    motion, found = find_motion(recording, config, discover_rig(recording, config))
    assert (motion is not None) is is_used
    assert sum("its poses do not follow the motion of the clouds" in note for note in found.notes) == (not is_used)


@pytest.mark.parametrize(
    ("speed_m_s", "frames", "remedy"),
    [
        (8, ("odom", "base_footprint"), r"'base_footprint', not of the site frame: .* in a rig file \(transforms\)"),
        (8, ("odom", ""), r"if it is, --set combine.motion.topic=/odom$"),
        (8, ("", "lidar"), "pose of 'lidar' in ''"),
        (8, ("lidar", "car1"), ""),  # where a car is in the scene
        (0, ("odom", "car1"), ""),
        (8, ("odom", "tf"), r"tf: 'tf' moves in 'odom', .* in a rig file \(transforms\)"),
        (8, ("lidar", "tf"), ""),
    ],
)
def test_odometry_that_may_be_of_a_moving_rig_is_named_with_a_remedy(
    speed_m_s: float, frames: tuple[str, str], remedy: str
) -> None:
    frame_id, child = frames
    poses = [odometry(stamp_ns=START_NS + n, frame_id=frame_id, child_frame_id=child) for n in range(2)]
    messages = [raw("/odom", "nav_msgs/msg/Odometry", pose, START_NS + n) for n, pose in enumerate(poses)]
    if child == "tf":
        moves = [transform_stamped(frame_id, child, stamp_ns=START_NS, translation=(x, 0, 0)) for x in (0, 1)]
        messages = [raw("/tf", "tf2_msgs/msg/TFMessage", tf_message([one]), START_NS) for one in moves]
    recording = MemoryRecording([*drive(speed_m_s=speed_m_s, count=20), *messages])
    motion, found = find_motion(recording, Config(), discover_rig(recording, Config()))
    assert motion is None
    notes = [note for note in found.notes if note.startswith("recorded motion is not used")]
    assert len(notes) == bool(remedy)
    assert all(re.search(remedy, note) for note in notes)


@pytest.mark.parametrize(
    ("start_s", "stop_s", "expected"), [(None, None, 0.0), (4.5, 5.5, 4.5), (4.5, None, 4.5), (None, 1.0, 0.0)]
)
def test_clouds_are_looked_at_within_the_part_that_is_processed(
    start_s: float | None, stop_s: float | None, expected: float
) -> None:
    messages = [
        raw("/odom", "nav_msgs/msg/Odometry", odometry(stamp_ns=START_NS), START_NS + s * 10**9) for s in (0, 6)
    ]
    start_ns, stop_ns = (None if one is None else START_NS + round(one * 1e9) for one in (start_s, stop_s))
    found_s = (np.array(looks(MemoryRecording(messages), start_ns, stop_ns)) - START_NS) / 1e9
    assert found_s[0] == pytest.approx(expected)
    assert len(found_s) > 1
    assert found_s[-1] < (stop_s or 6.0)


def turn(roll_deg: float, pitch_deg: float) -> F64:
    """T_level_lidar of a lidar that is rolled about x, then pitched about y."""
    (cr, cp), (sr, sp) = np.cos(np.radians([roll_deg, pitch_deg])), np.sin(np.radians([roll_deg, pitch_deg]))
    pitched = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.asarray(pitched @ [[1, 0, 0], [0, cr, -sr], [0, sr, cr]], np.float64)


def tilted_cloud(number: int, T_level_lidar: F64, *, floor: bool = True) -> RawMessage:
    """A floor 1.7 m below the lidar, and a wall ahead; without floor the wall alone."""
    rng = np.random.default_rng(number)
    ground = rng.uniform((-30, -30, -1.7), (30, 30, -1.7), (4000 * floor, 3))
    wall = rng.uniform((15, -20, -1.7), (15.2, 20, 6), (1500, 3))
    xyz = np.concatenate([ground, wall]) @ T_level_lidar
    stamp_ns = number * PERIOD_NS
    return raw(
        "/points", "sensor_msgs/msg/PointCloud2", pointcloud2(xyz.astype(np.float32), stamp_ns=stamp_ns), stamp_ns
    )


def level(messages: list[RawMessage], file: dict[str, Any] | None = None, **sections: Any) -> F64 | None:
    """(3, 3) rotation from the lidar to the level frame; None if there is none."""
    recording, config = MemoryRecording(messages), Config.model_validate(sections)
    rig = None if file is None else RigFile.model_validate(file)
    discover = partial(discover_rig, recording, config)
    found = discover(rig)
    told = on_level_site(found, recording, config, rig, discover)
    if told is found:
        return None
    assert told.sources[0].extrinsics == f"{'rig file' if rig else 'ground'}: lidar_level <- lidar"
    assert told.notes[-1].startswith("lidar: the ground is tilted by ")
    (lidar,) = told.rig.lidars
    assert (lidar.T_site_lidar.dst, lidar.T_site_lidar.translation.tolist()) == ("lidar_level", [0, 0, 0])
    return lidar.T_site_lidar.matrix[:3, :3]


@pytest.mark.parametrize("count", [1, 2, 9])
@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(0, 7), (0, -25), (-12, 3), (10, 20)])
def test_the_ground_is_level_afterwards(count: int, roll_deg: float, pitch_deg: float) -> None:
    T_level_lidar = turn(roll_deg, pitch_deg)
    found = level([tilted_cloud(number, T_level_lidar) for number in range(count)])
    assert found is not None
    up_lidar = T_level_lidar.T @ [0, 0, 1]
    np.testing.assert_allclose(found @ up_lidar, [0, 0, 1], atol=np.radians(0.3))
    assert np.degrees(np.arccos((np.trace(found) - 1) / 2)) == pytest.approx(
        np.degrees(np.arccos(up_lidar[2])), abs=0.3
    ), "turned no further"


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(180, 0), (170, 5), (0, 180)])
def test_a_lidar_that_hangs_upside_down(roll_deg: float, pitch_deg: float) -> None:
    T_level_lidar = turn(roll_deg, pitch_deg)
    found = level([tilted_cloud(number, T_level_lidar) for number in range(3)])
    assert found is not None
    np.testing.assert_allclose(found @ T_level_lidar.T @ [0, 0, 1], [0, 0, 1], atol=np.radians(0.3))
    assert found[0, 0] > 0.9, "ahead stays ahead"


TILTED = turn(0, 15)


@pytest.mark.parametrize(
    ("messages", "options"),
    [
        pytest.param([tilted_cloud(0, turn(3, 3))], {}, id="a road of some degrees"),
        pytest.param([tilted_cloud(0, TILTED, floor=False)], {}, id="no floor"),
        pytest.param([tilted_cloud(0, turn(0, 60))], {}, id="a wall would be a floor"),
        pytest.param([tilted_cloud(0, turn(180, 0), floor=False)], {}, id="upside down without a floor"),
        pytest.param([tilted_cloud(row, turn(0, 15 + 3 * row)) for row in range(6)], {}, id="carried by hand"),
        pytest.param([tilted_cloud(0, TILTED)], {"file": {"site_frame": "lidar"}}, id="named by the rig file"),
        pytest.param([tilted_cloud(0, TILTED)], {"rig": {"site_frame": "lidar"}}, id="named by the settings"),
        pytest.param(
            [tilted_cloud(0, TILTED)], {"file": {"ground_height_m": -1.7}}, id="with the height of the ground"
        ),
        pytest.param([static(("base_link", "lidar", (0, 0, 1.7))), tilted_cloud(0, TILTED)], {}, id="in a frame of tf"),
        pytest.param([static(("lidar", "lidar_level", (0, 0, 0))), tilted_cloud(0, TILTED)], {}, id="there is one"),
    ],
)
def test_the_site_frame_stays(messages: list[RawMessage], options: dict[str, Any]) -> None:
    assert level(messages, **options) is None
