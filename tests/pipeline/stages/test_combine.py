from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.clouds import CombinedCloud, PointCloud
from lidcam.pipeline.core.frame import SensorBundle
from lidcam.pipeline.core.geometry.pose_samples import PoseSamples
from lidcam.pipeline.core.geometry.rotations import pose_matrix
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import LidarSensor, Rig
from lidcam.pipeline.core.settings.combine import CombineConfig, GroundConfig, MotionConfig, OutlierConfig
from lidcam.pipeline.stages.combine import Combine

Triple = tuple[float, float, float]
MS = 1_000_000
STAMP_NS = 1_600_000_000_000_000_000
RAW = CombineConfig(
    motion=MotionConfig(enabled=False), outliers=OutlierConfig(enabled=False), ground=GroundConfig(enabled=False)
)
MOVED = RAW.model_copy(update={"motion": MotionConfig()})


def pose(translation: Triple = (0, 0, 0), euler_deg: Triple = (0, 0, 0)) -> F64:
    return pose_matrix(Rotation.from_euler("xyz", euler_deg, degrees=True).as_matrix(), translation)


def rig(**extrinsics: F64) -> Rig:
    lidars = [LidarSensor(name, f"/{name}", Transform("site", name, T)) for name, T in extrinsics.items()]
    return Rig("site", tuple(lidars), (), ())


def sweep(
    xyz: npt.ArrayLike,
    *,
    stamp_ns: int = STAMP_NS,
    offsets_ns: npt.ArrayLike | None = None,
    first_id: int = 0,
    nan_dropped: int = 0,
) -> PointCloud:
    """A cloud whose points can be told apart by intensity and ring."""
    points = np.array(xyz, np.float32).reshape(-1, 3)
    ids = first_id + np.arange(len(points))
    offsets = np.zeros(len(points), np.int32) if offsets_ns is None else np.array(offsets_ns, np.int32)
    return PointCloud(
        stamp_ns,
        "lidar",
        points,
        ids.astype(np.float32),
        ids.astype(np.uint16),
        offsets,
        has_time=offsets_ns is not None,
        nan_dropped=nan_dropped,
    )


def frame(motion: PoseSamples | None = None) -> SensorBundle:
    return SensorBundle(0, STAMP_NS, STAMP_NS, {}, motion)


def driving(*stamps_ms: int) -> PoseSamples:
    """10 m/s along x."""
    poses = np.array([pose((10.0 * ms / 1000, 0, 0)) for ms in stamps_ms])
    return PoseSamples("site", "odom", STAMP_NS + np.array(stamps_ms, np.int64) * MS, poses)


def street() -> F64:
    """A floor with a block on it, and one stray point as the last."""
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-20, 20, (8000, 2)), rng.normal(-1.7, 0.01, 8000)])
    block = rng.uniform((5, -1, -1.4), (9, 1, -0.2), (3000, 3))
    return np.concatenate([floor, block, [[0, 90, 40]]])


def assert_consistent(combined: CombinedCloud) -> None:
    counts = combined.counts
    assert list(counts) == ["input", "nan", "range", "outliers", "ground", "left"]
    assert counts["input"] == sum(counts[step] for step in ("nan", "range", "outliers", "ground", "left"))
    assert counts["left"] == len(combined.cloud)
    assert counts["ground"] == len(combined.ground_cloud)


# --- order, fields, extrinsics


def test_points_come_in_the_order_of_the_rig_with_all_fields() -> None:
    stage = Combine(rig(a=pose(), b=pose((10, 0, 0)), c=pose((0, 0, 2))), RAW)
    clouds = {
        "c": sweep([[7, 7, 7]], first_id=50),
        "a": sweep([[1, 2, 3], [4, 5, 6]], first_id=10, offsets_ns=[5, -6], stamp_ns=STAMP_NS + 100),
        "b": sweep([[1, 1, 1]], first_id=30, stamp_ns=STAMP_NS - 40 * MS),
    }
    combined = stage(frame(), clouds)
    cloud = combined.cloud
    assert cloud.xyz.tolist() == [[1, 2, 3], [4, 5, 6], [11, 1, 1], [7, 7, 9]]
    assert cloud.intensity.tolist() == [10, 11, 30, 50]
    assert cloud.ring.tolist() == [10, 11, 30, 50]
    assert cloud.time_offset_ns.tolist() == [105, 94, -40 * MS, 0]  # from the frame's time
    assert combined.detection_lidar_index.tolist() == [0, 0, 1, 2]
    assert (cloud.stamp_ns, cloud.frame_id, cloud.has_time) == (STAMP_NS, "site", False)
    assert combined.plane is None
    assert combined.compensated == ()
    assert_consistent(combined)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        pytest.param(None, None, None, id="none has them"),
        pytest.param([1, 3], [2], [1, 3, 2], id="both have them"),
        pytest.param(None, [2], [0, 0, 2], id="one has them"),
    ],
)
def test_return_types_are_kept(first: list[int] | None, second: list[int] | None, expected: list[int] | None) -> None:
    clouds = {
        name: replace(sweep(xyz), return_type=None if types is None else np.array(types, np.uint8))
        for name, xyz, types in (("a", [[1, 2, 3], [4, 5, 6]], first), ("b", [[7, 8, 9]], second))
    }
    return_type = Combine(rig(a=pose(), b=pose()), RAW)(frame(), clouds).cloud.return_type
    assert (None if return_type is None else return_type.tolist()) == expected


def test_missing_lidars_and_no_lidars() -> None:
    stage = Combine(rig(a=pose(), b=pose()), CombineConfig())
    one = stage(frame(), {"b": sweep([[1, 2, 3]])})
    assert one.detection_lidar_index.tolist() == [1]
    assert_consistent(one)
    none = stage(frame(), {})
    assert len(none.cloud) == 0
    assert none.cloud.frame_id == "site"
    assert set(none.counts.values()) == {0}
    empty = stage(frame(driving(-100, 100)), {"a": sweep([], offsets_ns=[], nan_dropped=3)})
    assert empty.counts["input"] == empty.counts["nan"] == 3
    assert_consistent(empty)


def test_range_is_from_the_lidar_and_a_point_at_the_lidar_is_none() -> None:
    config = RAW.model_copy(update={"min_range_m": 1.0, "max_range_m": 50.0})
    xyz = np.array([[0, 0, 0], [0.99, 0, 0], [1, 0, 0], [0, 30, 40], [0, 30, 40.1], [1e30, 0, 0]])
    combined = Combine(rig(a=pose((100, 0, 0))), config)(frame(), {"a": sweep(xyz, nan_dropped=2)})
    assert combined.cloud.ring.tolist() == [2, 3]
    assert combined.counts == {"input": 8, "nan": 2, "range": 4, "outliers": 0, "ground": 0, "left": 2}
    open_gate = Combine(rig(a=pose()), RAW)(frame(), {"a": sweep(xyz[:2])})
    assert open_gate.cloud.ring.tolist() == [1]


# --- motion compensation


def test_each_point_is_moved_to_the_frames_time() -> None:
    # The lidar looks back (yaw 180): what it saw 5 m behind the site 50 ms ago is 5.5 m behind now.
    stage = Combine(rig(a=pose((0, 0, 2), (0, 0, 180))), MOVED)
    cloud = sweep([[5, 0, 0], [5, 0, 0]], stamp_ns=STAMP_NS - 50 * MS, offsets_ns=[0, 50 * MS])
    combined = stage(frame(driving(-100, 0, 100)), {"a": cloud})
    np.testing.assert_allclose(combined.cloud.xyz, np.array([[-5.5, 0, 2], [-5, 0, 2]]), atol=1e-5)
    assert combined.cloud.time_offset_ns.tolist() == [-50 * MS, 0]  # still when they were measured
    assert combined.cloud.has_time
    assert combined.compensated == ("a",)


def test_a_cloud_without_times_of_points_is_moved_rigidly_by_its_stamp() -> None:
    stage = Combine(rig(a=pose(), b=pose()), MOVED)
    clouds = {"a": sweep([[5, 0, 0]]), "b": sweep([[5, 0, 0]], stamp_ns=STAMP_NS + 30 * MS)}
    combined = stage(frame(driving(-100, 100)), clouds)
    np.testing.assert_allclose(combined.cloud.xyz, np.array([[5, 0, 0], [5.3, 0, 0]]), atol=1e-5)
    assert combined.compensated == ("b",)


@pytest.mark.parametrize(
    ("config", "motion"),
    [
        (RAW, driving(-100, 100)),
        (MOVED, None),
        (MOVED, driving(0)),
        (MOVED, driving(-400, -251)),  # the frame's time is 251 ms beyond the last pose
        (MOVED, driving(151, 400)),  # the point's time is 201 ms before the first
    ],
    ids=["off", "no odometry", "one pose", "old odometry", "late odometry"],
)
def test_without_known_motion_points_stay_and_the_lidar_is_not_listed(
    config: CombineConfig, motion: PoseSamples | None
) -> None:
    cloud = sweep([[5, 0, 0]], stamp_ns=STAMP_NS - 50 * MS, offsets_ns=[0])
    combined = Combine(rig(a=pose()), config)(frame(motion), {"a": cloud})
    assert combined.cloud.xyz.tolist() == [[5, 0, 0]]
    assert combined.compensated == ()


# --- outliers and ground


def test_objects_are_detected_in_what_outlier_removal_takes_but_not_in_the_ground() -> None:
    far = np.column_stack([np.full(30, 60.0), np.linspace(-19, 19, 30), np.tile([-1.2, -0.8, -0.4], 10)])
    combined = Combine(rig(a=pose(), b=pose()), CombineConfig())(
        frame(), {"a": sweep(street()[:-1]), "b": sweep(far, first_id=20_000)}
    )
    cloud, lidar = combined.detection_cloud, combined.detection_lidar_index
    assert not (combined.cloud.ring >= 20_000).any()
    assert (cloud.ring >= 20_000).sum() == 30
    assert ((cloud.ring >= 20_000) == (lidar == 1)).all()
    assert set(combined.cloud.ring) <= set(cloud.ring)
    assert combined.plane is not None
    assert np.abs(cloud.xyz[:, 2] - combined.plane.height_m(cloud.xyz[:, :2])).min() > CombineConfig().ground.distance_m


@pytest.mark.parametrize("drops", [0, 600])
def test_rain_is_left_out_of_detection_and_counted(drops: int) -> None:
    rng = np.random.default_rng(3)
    ground = np.column_stack([rng.uniform(-12, 12, (120_000, 2)), rng.normal(-1.7, 0.01, 120_000)])
    rain = rng.uniform((-6, -6, -1), (3, 6, 2), (drops, 3))
    found = Combine(rig(a=pose()), CombineConfig())(frame(), {"a": sweep(np.concatenate([ground, rain]))})
    removed = found.counts.get("rain or snow", 0)
    assert removed == drops - (found.detection_cloud.xyz[:, 2] > -1.1).sum()
    assert removed >= 0.8 * drops


@pytest.mark.parametrize("outliers", [True, False])
@pytest.mark.parametrize("ground", [True, False])
def test_each_step_can_be_switched_off(outliers: bool, ground: bool) -> None:
    config = CombineConfig(outliers=OutlierConfig(enabled=outliers), ground=GroundConfig(enabled=ground))
    combined = Combine(rig(a=pose()), config)(frame(), {"a": sweep(street())})
    assert (combined.counts["outliers"] > 0) is outliers
    assert (combined.counts["ground"] > 0) is ground
    assert (combined.plane is not None) is ground
    assert_consistent(combined)


def test_a_slope_is_ground_for_detection_and_not_for_what_is_written() -> None:
    rng = np.random.default_rng(2)
    near = np.column_stack([rng.uniform(-20, 15, 20_000), rng.uniform(-20, 20, 20_000), rng.normal(-1.7, 0.01, 20_000)])
    far = np.column_stack([rng.uniform(15, 30, 6000), rng.uniform(-20, 20, 6000), np.zeros(6000)])
    far[:, 2] = -1.7 + 0.05 * (far[:, 0] - 15)
    found = Combine(rig(a=pose()), CombineConfig())(frame(), {"a": sweep(np.concatenate([near, far]))})
    assert len(found.cloud) > 2500, "what is written goes by the plane"
    assert len(found.detection_cloud) < 300
    z = found.ground_m(np.array([[25.0, 0.0], [0.0, 0.0]]), level_m=9.0)
    assert z == pytest.approx([-1.2, -1.7], abs=0.04)
