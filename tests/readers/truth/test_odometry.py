from collections.abc import Sequence

import numpy as np
import pytest
from builders import odometry, pointcloud2, raw
from hypothesis import given
from hypothesis import strategies as st
from memory_recording import MemoryRecording
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.errors import ConfigError, RecordingError
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.geometry.transform_tree import TransformTree
from lidcam.pipeline.core.messages import RawMessage
from lidcam.pipeline.core.rig import TruthVehicle
from lidcam.pipeline.core.settings.config import Config
from lidcam.readers.messages.tf import RecordedTransforms
from lidcam.readers.truth.odometry import MAX_GAP_NS, MAX_LEAD_NS, OdometryTruth

MS = 1_000_000
START_NS = 1_700_000_000 * 10**9
STEP_NS = 50 * MS
ODOM = "nav_msgs/msg/Odometry"
CAR = TruthVehicle("/car1/odom", "car", (4.0, 2.0, 1.5), (1.0, 0.0, 0.75))
VAN = TruthVehicle("/car2/odom", "van", (6.0, 2.2, 2.5))
NO_TF = RecordedTransforms(TransformTree())


def pose(topic: str, k: int, *, frame_id: str = "map", late_ns: int = 0) -> RawMessage:
    """A vehicle at 10 m/s along x that turns by 0.1 rad a step, 50 ms apart."""
    turn = Rotation.from_euler("z", 0.1 * k).as_quat().tolist()
    stamp_ns = START_NS + k * STEP_NS
    fields = odometry(
        stamp_ns=stamp_ns, position=(0.5 * k, 1, 0), orientation_xyzw=turn, frame_id=frame_id, child_frame_id="car"
    )
    return raw(topic, ODOM, fields, stamp_ns, stamp_ns + late_ns)


def truth(
    messages: Sequence[RawMessage],
    vehicles: dict[str, TruthVehicle] | None = None,
    transforms: RecordedTransforms = NO_TF,
) -> OdometryTruth:
    return OdometryTruth(MemoryRecording(messages), vehicles or {"car1": CAR}, transforms, Config())


def test_the_box_is_where_the_pose_and_its_offset_put_it() -> None:
    found = truth([pose(CAR.topic, k) for k in range(4)]).at(START_NS + 2 * STEP_NS, frame=0)
    assert found is not None
    assert (found.frame_id, found.labels.tolist(), found.track_ids.tolist()) == ("map", ["car"], [0])
    np.testing.assert_allclose(found.centers, [[1 + np.cos(0.2), 1 + np.sin(0.2), 0.75]])
    np.testing.assert_allclose(found.sizes, [CAR.size_m])
    np.testing.assert_allclose(found.yaws, [0.2])
    assert not found.is_ignored.any()


def test_a_time_is_covered_if_all_vehicles_are_known() -> None:
    messages = [pose(CAR.topic, k) for k in range(2, 8)] + [pose(VAN.topic, k) for k in range(6)]
    source = truth(messages, {"car1": CAR, "van": VAN})
    found = [source.at(START_NS + k * STEP_NS, frame=k) for k in range(9)]
    labels = [None if one is None else one.labels.tolist() for one in found]
    assert labels == [*[None] * 2, *[["car", "van"]] * 4, *[None] * 3]
    assert found[3] is not None
    assert [Config().class_names[row] for row in found[3].class_ids.tolist()] == ["car", "truck"]


def test_a_long_pause_covers_nothing() -> None:
    pause = MAX_GAP_NS // STEP_NS + 3
    source = truth([pose(CAR.topic, k) for k in (0, 1, 1 + pause, 2 + pause)])
    assert source.at(START_NS + 3 * STEP_NS, frame=0) is None
    assert source.at(START_NS + (1 + pause) * STEP_NS, frame=0) is not None


def test_a_vehicle_that_fell_silent_does_not_make_the_others_pile_up() -> None:
    lead = MAX_LEAD_NS // STEP_NS
    messages = [pose(CAR.topic, k) for k in range(3 * lead)] + [pose(VAN.topic, k) for k in range(10)]
    source = truth(messages, {"car1": CAR, "van": VAN})
    for k in range(0, 2 * lead, 7):
        source.at(START_NS + k * STEP_NS, frame=0)
        assert max(len(track.stamps_ns) for track in source._tracks.values()) <= lead + 60


def test_frames_are_joined_by_fixed_transforms() -> None:
    tree = TransformTree()
    tree.add_static(Transform.from_quaternion("map", "odom2", [100, 0, 0], [0, 0, 1, 0]))
    messages = [pose(CAR.topic, k) for k in range(3)] + [pose(VAN.topic, k, frame_id="odom2") for k in range(3)]
    found = truth(messages, {"car1": CAR, "van": VAN}, RecordedTransforms(tree)).at(START_NS + STEP_NS, frame=0)
    assert found is not None
    assert found.frame_id == "map"
    np.testing.assert_allclose(found.centers[1], [99.5, -1, 0])
    np.testing.assert_allclose(found.yaws[1], 0.1 - np.pi)
    with pytest.raises(RecordingError, match="move in 'map' and 'odom2', which no fixed transform joins"):
        truth(messages, {"car1": CAR, "van": VAN}).at(START_NS + STEP_NS, frame=0)


def test_messages_that_cannot_be_used_are_counted() -> None:
    broken = pose(CAR.topic, 1)
    messages = [
        pose(CAR.topic, 0),
        broken._replace(data=bytes(broken.data)[:40]),
        pose(CAR.topic, 2, frame_id="odom"),
        pose(CAR.topic, 0, late_ns=5 * STEP_NS),
        pose(CAR.topic, 6),
    ]
    source = truth(messages)
    assert source.at(START_NS + 3 * STEP_NS, frame=0) is not None
    (note,) = source.notes
    assert note.startswith("messages of /car1/odom that are not used: 3, the first: /car1/odom: 40 bytes")


@pytest.mark.parametrize(
    ("vehicle", "problem"),
    [
        (TruthVehicle("/none", "car", (1, 1, 1)), "expected nav_msgs/msg/Odometry on /none, found no such topic"),
        (TruthVehicle("/points", "car", (1, 1, 1)), "found sensor_msgs/msg/PointCloud2; recorded odometry: /car1/odom"),
        (TruthVehicle(CAR.topic, "tractor", (1, 1, 1)), "truth.own.class of the rig: expected a class of the settings"),
    ],
)
def test_vehicles_that_cannot_be_truth(vehicle: TruthVehicle, problem: str) -> None:
    cloud = raw("/points", "sensor_msgs/msg/PointCloud2", pointcloud2([[1, 2, 3]], stamp_ns=1, frame_id="l"), 1)
    with pytest.raises((RecordingError, ConfigError)) as caught:
        truth([pose(CAR.topic, 0), cloud], {"own": vehicle})
    assert problem in str(caught.value)


@given(st.integers(0, 19 * 50), st.integers(0, 400))
def test_poses_at_any_time_are_those_of_the_motion(at_ms: int, late_ms: int) -> None:
    source = truth([pose(CAR.topic, k, late_ns=late_ms * MS) for k in range(21)])
    found = source.at(START_NS + at_ms * MS, frame=0)
    assert found is not None
    np.testing.assert_allclose(found.yaws[0], (0.1 * at_ms / 50 + np.pi) % (2 * np.pi) - np.pi, atol=1e-9)
