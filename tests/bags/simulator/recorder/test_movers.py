import numpy as np
import pytest
from meshes import open_edges, signed_volume
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from lidcam.bags.simulator.recorder.stage import build_mover
from lidcam.bags.simulator.scenario.scenario import VehicleScenario
from lidcam.bags.simulator.world.bodies.dimensions import SHAPES, shape_of
from lidcam.bags.simulator.world.bodies.people import CRANK_CYCLE_M, CYCLE_M
from lidcam.bags.simulator.world.motion import Mover, State, Trajectory, placed_vertices
from lidcam.pipeline.core.arrays import F64

SECOND_NS = 10**9
MOMENTS = [int(t) for t in np.linspace(0, SECOND_NS, 25)]
CENTIMETRE = 0.01
VANS = ("car", "van", "truck", "bus")


def mover_of(name: str, *, steering: float = 0.0, speed: float = 1.4, yaw: float = 0.0) -> Mover:
    """A shape that covers a whole cycle of its legs within one second, without leaving its place."""
    cycle = CRANK_CYCLE_M if name == "cyclist" else CYCLE_M
    trajectory = Trajectory(0, State(0.0, 0.0, yaw, speed, steering, 0.0))
    trajectory.append(SECOND_NS, State(0.0, 0.0, yaw, speed, steering, cycle))
    return build_mover(name, VehicleScenario.model_validate({"shape": name}), trajectory)


def vertices(mover: Mover, part: int, time_ns: int) -> F64:
    pose = mover.parts[part].path.poses(np.array([time_ns], np.int64))
    return np.asarray(mover.parts[part].mesh.vertices @ pose.rotation[0].T + pose.translation[0])


def extent(mover: Mover) -> tuple[F64, F64]:
    points = [vertices(mover, part, t) for part in range(len(mover.parts)) for t in MOMENTS]
    return np.concatenate(points).min(0), np.concatenate(points).max(0)


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_fill_their_boxes_and_do_not_reach_out(name: str) -> None:
    shape = SHAPES[name]
    mover = mover_of(name)
    assert (mover.class_name, mover.size_m, mover.box_center_m) == (shape.class_name, shape.size_m, shape.box_center_m)
    low, high = extent(mover)
    middle, half = np.array(shape.box_center_m), np.array(shape.size_m) / 2
    assert np.abs(low - (middle - half)).max() <= CENTIMETRE + 1e-9
    assert np.abs(high - (middle + half)).max() <= CENTIMETRE + 1e-9
    assert low[2] == pytest.approx(0.0, abs=2e-3)  # it stands on the ground


def bodies(mover: Mover, time_ns: int) -> list[F64]:
    """The vertices of each closed surface of a mover."""
    found = []
    for part in mover.parts:
        points, corners = placed_vertices(part, time_ns), part.mesh.triangles
        edges = np.concatenate([corners[:, :2], corners[:, 1:]])
        links = coo_matrix((np.ones(len(edges)), edges.T), shape=(len(points),) * 2)
        count, body = connected_components(links, directed=False)
        found += [points[body == number] for number in range(count)]
    return found


@pytest.mark.parametrize(("name", "tolerance_m"), [("model_car", 1e-3), *((n, CENTIMETRE) for n in VANS)])
def test_a_vehicles_box_ends_at_its_body(name: str, tolerance_m: float) -> None:
    mover, shape = mover_of(name), SHAPES[name]
    box = mover.body_at(0)
    assert box == mover.body_at(SECOND_NS)
    assert (box.center_m, box.size_m[::2]) == (shape.box_center_m, shape.size_m[::2])
    low, high = np.array(box.center_m) - np.array(box.size_m) / 2, np.array(box.center_m) + np.array(box.size_m) / 2
    everything = bodies(mover, 0)
    beside = [body for body in everything if np.abs(body[:, 1]).max() > box.size_m[1] / 2 + tolerance_m]
    # Only mirrors reach further: pairs high up on both sides in the front half, small beside the body.
    assert len(beside) == 4
    for side in (-1, 1):
        mirror = np.concatenate([body for body in beside if side * body[:, 1].mean() > 0])
        assert len(mirror) == sum(map(len, beside)) / 2
        assert mirror[:, 0].min() > mover.box_center_m[0]
        assert mirror[:, 2].min() > 0.45 * shape.size_m[2]
        assert (np.ptp(mirror, axis=0) < 0.26 * np.array([1.0, 1.1, 1.0]) * shape.size_m[2]).all()
    hull = np.concatenate([body for body in everything if not any(body is one for one in beside)])
    # The model car's box begins above the table, as in the predecessor system.
    np.testing.assert_allclose(hull.min(0)[:2], low[:2], atol=tolerance_m)
    np.testing.assert_allclose(hull.max(0)[:2], high[:2], atol=tolerance_m)
    np.testing.assert_allclose([hull[:, 2].min(), hull[:, 2].max()], [low[2], high[2]], atol=CENTIMETRE)


SCALE = (1.2, 0.9, 1.1)


@pytest.mark.parametrize("name", [name for name in SHAPES if name != "pedestrian"])
def test_a_scaled_shape_fills_its_box(name: str) -> None:
    scaled = VehicleScenario.model_validate({"shape": name, "scale": SCALE, "body": "saloon"})
    mover, shape = build_mover(name, scaled, Trajectory(0, State(0, 0, 0))), shape_of(name, SCALE)
    plain = build_mover(name, VehicleScenario.model_validate({"shape": name}), Trajectory(0, State(0, 0, 0)))
    box = mover.body_at(0)
    assert (box.center_m, box.size_m, mover.size_m) == (shape.box_center_m, shape.body_size_m, shape.size_m)
    np.testing.assert_allclose(box.size_m, np.multiply(plain.body_at(0).size_m, SCALE))
    points, before = (np.concatenate([placed_vertices(part, 0) for part in one.parts]) for one in (mover, plain))
    np.testing.assert_allclose(points.max(0), before.max(0) * SCALE, atol=0.02)
    np.testing.assert_allclose(points.min(0), before.min(0) * SCALE, atol=0.02)


@pytest.mark.parametrize(("speed", "yaw"), [(0.0, 0.0), (1.4, 2.3)])
def test_a_pedestrians_box_follows_the_body(speed: float, yaw: float) -> None:
    mover = mover_of("pedestrian", speed=speed, yaw=yaw)
    lengths = []
    for time_ns in MOMENTS:
        box = mover.body_at(time_ns)
        points = np.concatenate([vertices(mover, part, time_ns) for part in range(len(mover.parts))])
        own = points @ Rotation.from_euler("z", yaw).as_matrix()
        np.testing.assert_allclose(own.min(0), np.array(box.center_m) - np.array(box.size_m) / 2, atol=1e-9)
        np.testing.assert_allclose(own.max(0), np.array(box.center_m) + np.array(box.size_m) / 2, atol=1e-9)
        lengths.append(box.size_m[0])
    if speed:
        assert min(lengths) < 0.55 < 0.85 < max(lengths)
    else:
        assert max(lengths) < 0.4
        assert np.ptp(lengths) < 1e-9


@pytest.mark.parametrize("name", [name for name, shape in SHAPES.items() if shape.wheel_base_m])
def test_steered_wheels_stay_in_the_box(name: str) -> None:
    shape = SHAPES[name]
    low, high = extent(mover_of(name, steering=shape.max_steering_rad))
    middle, half = np.array(shape.box_center_m), np.array(shape.size_m) / 2
    assert (low >= middle - half - CENTIMETRE).all()
    assert (high <= middle + half + CENTIMETRE).all()


@pytest.mark.parametrize("name", SHAPES)
def test_every_part_is_closed_and_faces_outwards(name: str) -> None:
    for part in mover_of(name).parts:
        assert open_edges(part.mesh) == 0
        assert signed_volume(part.mesh) > 0


def test_kerbs_lift_pedestrians() -> None:
    trajectory = Trajectory(0, State(-2.0, 0.0, 0.0, 1.0, 0.0, 0.0))
    trajectory.append(4 * SECOND_NS, State(2.0, 0.0, 0.0, 1.0, 0.0, 4.0))
    scenario = VehicleScenario(shape="pedestrian")
    mover = build_mover("p", scenario, trajectory, height=lambda xy: np.where(xy[:, 0] > 0, 0.12, 0.0))
    z = mover.path.poses(np.arange(0, 4 * SECOND_NS + 1, SECOND_NS // 20)).translation[:, 2]
    assert (z[0], z[-1]) == (0.0, pytest.approx(0.12))
    assert (np.diff(z) >= 0).all()
    assert np.diff(z).max() < 0.04
    low = np.concatenate([vertices(mover, part, 4 * SECOND_NS) for part in range(len(mover.parts))]).min(0)
    assert low[2] == pytest.approx(0.12, abs=2e-3)
