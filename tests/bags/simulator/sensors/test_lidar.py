from typing import Any

import numpy as np
import pytest
from small_worlds import GLASS, GREY, RETRO, WHITE, EvenPath, box_mover, fixed_at, scene, wall
from velodyne import assert_as_judged, judged, scan

from lidcam.bags.simulator.scenario.sensors import LidarScenario
from lidcam.bags.simulator.sensors.lidar import Lidar, Sweep
from lidcam.bags.simulator.world.mesh import Material, box, polygon
from lidcam.bags.simulator.world.motion import MountedPath, Path
from lidcam.bags.simulator.world.scene import Scene
from lidcam.pipeline.core.arrays import F64, I64
from lidcam.pipeline.core.clouds import PointCloud
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.settings.recording import VelodyneConfig
from lidcam.readers.velodyne.decoder import VelodyneDecoder

EXACT: dict[str, Any] = {"range_noise_m": 0.0, "dropout": 0.0}
NARROW: dict[str, Any] = {**EXACT, "divergence_mrad": 0.0}
GROUND = polygon([[-60, -60, 0], [60, -60, 0], [60, 60, 0], [-60, 60, 0]], GREY)


def settings(**values: object) -> LidarScenario:
    defaults = {"topic": "/points", "packets_topic": "/packets", "frame_id": "lidar", "position_m": (0, 0, 0)}
    return LidarScenario.model_validate({**defaults, **values})


def lidar(world: Scene, path: Path | None = None, *, seed: int = 1, **values: object) -> Lidar:
    return Lidar("lidar", settings(**values), path or fixed_at((0, 0, 0)), world, seed)


def ranges_m(sweep: Sweep) -> F64:
    return np.asarray(np.linalg.norm(sweep.xyz.astype(np.float64), axis=1))


def azimuth_deg(sweep: Sweep) -> F64:
    """Counter-clockwise from the front."""
    return np.asarray(np.rad2deg(np.arctan2(sweep.xyz[:, 1], sweep.xyz[:, 0])))


def times_ns(sweep: Sweep) -> I64:
    return sweep.begin_ns + sweep.time_offset_ns


def decode(sweep: Sweep) -> PointCloud:
    assert sweep.packets is not None
    return VelodyneDecoder(VelodyneConfig())(scan(sweep.packets.payload, sweep.packets.stamps_ns))


def yard() -> Scene:
    """Ground, walls, posts with wide gaps behind them, and a car that passes by."""
    posts = [box((8 * np.cos(angle), 8 * np.sin(angle), 1), (0.2, 0.2, 2), GREY) for angle in np.arange(0, 6.2, 0.3)]
    car = box_mover("car", EvenPath((6, -3, 0), (0, 10, 0), np.pi / 2))
    return scene([GROUND, wall(15, WHITE), wall(-20, GREY), box((0, 12, 1), (3, 1, 2), RETRO), *posts], [car])


@pytest.mark.parametrize(
    ("model", "mode"), [("VLP-16", "dual"), ("Puck Hi-Res", "last"), ("HDL-32E", "strongest"), ("VLP-32C", "dual")]
)
def test_packets_hold_the_same_points(model: str, mode: str) -> None:
    """By lidcam's decoder, and by that of velodyne-decoder."""
    sweep = lidar(yard(), fixed_at((0, 0, 1.8)), model=model, return_mode=mode, output="both", phase_ms=20.0).sweep(3)
    cloud, packets = decode(sweep), sweep.packets
    assert packets is not None
    assert_as_judged(cloud, judged(model, packets.payload, packets.stamps_ns), model)
    assert len(sweep) == len(cloud) > 5000
    decoded_ns = cloud.stamp_ns + cloud.time_offset_ns.astype(np.int64)
    types = np.zeros(len(sweep), np.uint8) if sweep.return_type is None else sweep.return_type
    assert cloud.return_type is not None
    found = np.zeros(len(sweep), np.uint8) if sweep.return_type is None else cloud.return_type
    # The firing's own time: decoded ones differ by less than the microsecond that packets are rounded to.
    ours = np.lexsort((types, sweep.ring, (times_ns(sweep) + 500) // 1000))
    theirs = np.lexsort((found, cloud.ring, (decoded_ns + 500) // 1000))
    same = np.flatnonzero(sweep.ring[ours] != cloud.ring[theirs])
    assert len(same) == 0
    np.testing.assert_allclose(times_ns(sweep)[ours], decoded_ns[theirs], atol=1000)
    error_m = np.linalg.norm(sweep.xyz[ours] - cloud.xyz[theirs], axis=1)
    np.testing.assert_array_less(error_m, 0.002 + np.deg2rad(0.01) * ranges_m(sweep)[ours])
    # As the azimuths are those that packets tell, hardly anything is left but the rounding of the turn rate.
    assert np.median(error_m) < 0.001
    np.testing.assert_array_equal(sweep.intensity[ours], cloud.intensity[theirs])
    np.testing.assert_array_equal(types[ours], found[theirs])


def test_a_car_is_skewed_by_its_motion_during_the_sweep() -> None:
    # The face of a wide thing at x = 20 m + 10 m/s t, seen over 90 degrees, so for a quarter of 100 ms: the sensor
    # turns clockwise, so what is right is seen 25 ms after what is left, and 0.25 m further away.
    face = box_mover("car", EvenPath((21, 0, -5), (10, 0, 0)), (2, 42, 10), WHITE)
    sweep = lidar(scene([], [face]), model="VLP-16", start_azimuth_deg=180.0, **NARROW).sweep(0)
    seconds = times_ns(sweep) * 1e-9
    np.testing.assert_allclose(sweep.xyz[:, 0], 20 + 10 * seconds, atol=0.0035)
    level = sweep.ring == 8
    left = np.argmin(np.abs(azimuth_deg(sweep) - 45) + 1e3 * ~level)
    right = np.argmin(np.abs(azimuth_deg(sweep) + 45) + 1e3 * ~level)
    assert sweep.xyz[right, 0] - sweep.xyz[left, 0] == pytest.approx(0.25, abs=0.005)
    # Straight ahead it is after half a turn: 20.5 m.
    ahead = np.argmin(np.abs(azimuth_deg(sweep)) + 1e3 * ~level)
    assert sweep.xyz[ahead, 0] == pytest.approx(20.5, abs=0.004)


def test_a_moving_carrier_sees_a_wall_where_it_stands() -> None:
    carrier = EvenPath((0, 0, 0), (10, 3, 0), 0.2, 1.5)
    mount = Transform.from_quaternion("car", "lidar", np.array([1.0, 0.5, 1.8]), np.array([0, 0.02, 0.3, 0.95]))
    path = MountedPath(carrier, mount)
    sweep = lidar(scene([wall(15, WHITE), GROUND]), path, model="HDL-32E", output="points", **NARROW).sweep(4)
    world = path.poses(times_ns(sweep)).apply(sweep.xyz.astype(np.float64))
    off_m = np.minimum(np.abs(world[:, 0] - 15), np.abs(world[:, 2]))
    # Half a step of range, half a hundredth of a degree, and the way of the sensor in half a firing.
    np.testing.assert_array_less(off_m, 0.0015 + np.deg2rad(0.006) * ranges_m(sweep))
    assert (np.abs(world[:, 0] - 15) < 0.02).sum() > 500


def test_noise_and_dropouts_are_as_asked_for() -> None:
    world = scene([wall(20, WHITE)])
    values: dict[str, Any] = {"model": "HDL-32E", "range_noise_m": 0.05}
    exact = lidar(world, **{**values, "range_noise_m": 0.0, "dropout": 0.0}).sweep(0)
    noisy = lidar(world, **{**values, "dropout": 0.0}).sweep(0)
    assert len(noisy) == len(exact)
    error_m = ranges_m(noisy) - ranges_m(exact)
    assert error_m.std() == pytest.approx(0.05, rel=0.05)
    assert abs(error_m.mean()) < 0.002
    lossy = lidar(world, **values, dropout=0.2).sweep(0)
    assert len(lossy) / len(exact) == pytest.approx(0.8, abs=0.02)


@pytest.mark.parametrize(
    ("reflectivity", "reach_m"), [(1.0, 100.0), (0.25, 50.0), (0.04, 20.0), (4.0, 131.0)], ids=lambda value: str(value)
)
def test_darker_surfaces_are_seen_less_far(reflectivity: float, reach_m: float) -> None:
    material = Material("surface", (0.5, 0.5, 0.5), reflectivity)
    seen = []
    for distance_m in (0.85 * reach_m, min(1.2 * reach_m, 140.0)):
        target = wall(distance_m, material, half_m=0.2 * distance_m)
        sweep = lidar(scene([target]), model="VLP-16", max_range_m=100.0, **NARROW).sweep(0)
        seen.append(len(sweep))
        assert not len(sweep) or sweep.intensity.mean() == pytest.approx(
            min(100 * reflectivity, 255 - 154 / max(reflectivity, 1)) if reflectivity != 4 else 216, rel=0.1
        )
    assert seen[0] > 500
    assert seen[1] == 0


def test_beams_pass_through_glass() -> None:
    world = scene([wall(10, GLASS), wall(20, WHITE)])
    sweep = lidar(world, model="VLP-16", divergence_mrad=0.0, dropout=0.0).sweep(0)
    assert (sweep.xyz[:, 0] > 19).mean() > 0.99
    # Through two panes and back 0.8^4 of the light is left.
    two = lidar(scene([wall(10, GLASS), wall(11, GLASS), wall(20, WHITE)]), model="VLP-16", dropout=0.0).sweep(0)
    ahead = np.abs(two.xyz[:, 1:]).max(1) < 2
    assert two.intensity[ahead].mean() == pytest.approx(100 * 0.8**4, rel=0.1)


def posts() -> Scene:
    angles = np.deg2rad(np.arange(-60, 60, 3.0))
    thin = [box((5 * np.cos(angle), 5 * np.sin(angle), 0), (0.1, 0.1, 8), GREY, yaw=float(angle)) for angle in angles]
    return scene([wall(12, WHITE), *thin])


def test_edges_make_two_returns() -> None:
    world = posts()
    values: dict[str, Any] = {"model": "VLP-16", "divergence_mrad": 3.0, "max_range_m": 100.0, **EXACT}
    dual, strongest, last = (
        lidar(world, **values, return_mode=mode).sweep(0) for mode in ("dual", "strongest", "last")
    )
    assert dual.return_type is not None
    assert strongest.return_type is None
    assert last.return_type is None
    count = np.bincount(dual.return_type, minlength=4)
    assert count[0] == 0
    assert count[1] == count[2] > 200
    assert len(strongest) == len(last) == count[3] + count[2]
    first, second = (ranges_m(dual)[dual.return_type == kind] for kind in (1, 2))
    assert (second - first > 0.5).all()
    assert np.mean(first < 5.2) > 0.99
    assert np.sum(ranges_m(last) > 6) > np.sum(ranges_m(strongest) > 6)


def test_points_are_counted_for_the_movers_that_they_lie_on() -> None:
    near, hidden = (
        box_mover("near", EvenPath((10, 0, -1)), (2, 2, 2), WHITE),
        box_mover("hidden", EvenPath((20, 0, -1)), (2, 2, 1), WHITE),
    )
    behind = box_mover("behind", EvenPath((-10, 0, -1), (0, 2, 0)), (2, 2, 2), WHITE)
    sweep = lidar(scene([wall(30, WHITE)], [near, hidden, behind]), model="VLP-16", divergence_mrad=0.0).sweep(0)
    x = sweep.xyz[:, 0]
    assert sweep.hits_per_mover.tolist() == [((x > 8) & (x < 12)).sum(), 0, (x < 0).sum()]
    assert min(sweep.hits_per_mover[[0, 2]]) > 100
    offsets = sweep.time_offset_ns
    assert sweep.hit_offsets_ns.tolist() == [offsets[(x > 8) & (x < 12)].sum(), 0, offsets[x < 0].sum()]
    assert lidar(scene([wall(30, WHITE)]), model="VLP-16").sweep(0).hits_per_mover.tolist() == []
