"""What images show of movers, against the image of ids and the projected corners of boxes."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_worlds import EvenPath, box_mover, scene

from lidcam.bags.simulator.recorder.stage import build_mover
from lidcam.bags.simulator.scenario.scenario import SunScenario, VehicleScenario
from lidcam.bags.simulator.scenario.sensors import CameraScenario, Detector2DScenario
from lidcam.bags.simulator.sensors.camera import Camera, CameraImage
from lidcam.bags.simulator.sensors.visibility import Detected, Visibility, detect, visibility, visible_boxes
from lidcam.bags.simulator.world.mesh import Mesh, box
from lidcam.bags.simulator.world.motion import FixedPath, MountedPath, Mover, Path, State, Trajectory, placed_vertices
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.boxes import box_corners

LENSES: dict[str, dict[str, Any]] = {
    "pinhole": {},
    "barrel": {"distortion": (-0.25, 0.08, 0.001, -0.0005, 0.0)},
    "fisheye": {"distortion_model": "equidistant", "distortion": (-0.02, 0.003, 0.0, 0.0)},
}
WIDTH, HEIGHT = 200, 150


def camera_at(
    movers: list[Mover], *, static: tuple[Mesh, ...] = (), carrier: Path | None = None, **changes: Any
) -> Camera:
    """A camera 1 m above the origin that looks along x."""
    values = {"width_px": WIDTH, "height_px": HEIGHT, "focal_px": (150.0, 150.0), "noise": 0.0} | changes
    scenario = CameraScenario(topic="/i", info_topic="/n", frame_id="optical", position_m=(0, 0, 1), **values)
    mount = scenario.T_carrier_body("carrier")
    body: Path = FixedPath(mount) if carrier is None else MountedPath(carrier, mount)
    return Camera("front", scenario, body, scene(static, movers), SunScenario(shadows=False), 1)


def seen(movers: list[Mover], *, time_ns: int = 0, **how: Any) -> tuple[CameraImage, Visibility]:
    camera = camera_at(movers, **how)
    image = camera.image(0, time_ns)
    return image, visibility(image, camera, tuple(movers), time_ns)


def box_of_ids(image: CameraImage, row: int) -> list[int]:
    rows, columns = np.nonzero(image.movers == row)
    return [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]


def outline(camera: Camera, center: tuple[float, float, float], size: tuple[float, float, float]) -> F64:
    """Box of the densely sampled edges of a box, projected: nothing of the code in question."""
    corners = box_corners(np.array([center]), np.array([size]), np.zeros(1))[0]
    first, second = np.triu_indices(8, 1)
    share = np.linspace(0, 1, 201)[:, None, None]
    points = (corners[first] * share + corners[second] * (1 - share)).reshape(-1, 3)
    pixels, valid = camera.model.project(camera.optical_pose(0).inverse().apply(points))
    assert valid.all()
    return np.concatenate([pixels.min(0), pixels.max(0)])


def test_the_hidden_part_is_counted_whatever_hides_it() -> None:
    far = box_mover("far", EvenPath((8.0, 0.0, 0.0)), (0.2, 2.0, 2.0))
    near = box_mover("near", EvenPath((4.0, -0.5, 0.0)), (0.2, 1.0, 2.5))  # before the right half
    post = box((4.0, -0.5, 1.25), (0.2, 1.0, 2.5), near.parts[0].mesh.palette[0])
    both, found = seen([far, near])
    _, behind = seen([far], static=(post,))
    assert found.occlusion[0] == behind.occlusion[0]
    alone = np.ptp(box_of_ids(seen([far])[0], 0)[::2]) * np.ptp(box_of_ids(seen([far])[0], 0)[1::2])
    assert found.occlusion[0] == 1 - (both.movers == 0).sum() / alone
    assert found.occlusion[0] == pytest.approx(0.5, abs=0.02)
    assert found.occlusion[1] == 0
    assert found.truncation[0] == 0
    np.testing.assert_array_equal(found.visible_xyxy[0], box_of_ids(both, 0))
    np.testing.assert_array_equal(found.whole_xyxy[0], behind.whole_xyxy[0])
    assert found.whole_xyxy[0, 2] - found.visible_xyxy[0, 2] > 15


@pytest.mark.parametrize("lens", LENSES)
@settings(max_examples=8)
@given(x=st.floats(2.5, 9.0), across=st.floats(-1.2, 1.2), height=st.floats(-1.0, 1.5))
def test_truncation_is_the_share_of_the_box_outside(lens: str, x: float, across: float, height: float) -> None:
    size = (0.8, 1.0, 0.9)
    center = (x, x * across * 0.6, 1.0 + 0.3 * x * height)
    mover = box_mover("a", EvenPath((center[0], center[1], center[2] - size[2] / 2)), size)
    image, found = seen([mover], **LENSES[lens])
    left, top, right, bottom = outline(camera_at([mover], **LENSES[lens]), center, size)
    inside = max(min(right, WIDTH) - max(left, 0), 0) * max(min(bottom, HEIGHT) - max(top, 0), 0)
    if not image.alone_px[0]:
        assert inside < 60  # only a corner of the box, which the body does not fill
        return
    whole = found.whole_xyxy[0]
    np.testing.assert_allclose(np.clip(whole, -WIDTH, 2 * WIDTH), [left, top, right, bottom], atol=1.5)
    assert found.truncation[0] == pytest.approx(1 - inside / ((right - left) * (bottom - top)), abs=0.06)
    assert (found.visible_xyxy[0, :2] >= whole[:2]).all()
    assert (found.visible_xyxy[0, 2:] <= whole[2:]).all()


@pytest.mark.parametrize("moves", [False, True], ids=["fixed", "driving"])
def test_whole_boxes_hold_the_vertices_of_people_and_cars(moves: bool) -> None:
    """Movers and camera are where they are at the time of the image."""
    time_ns = 400_000_000
    movers = []
    for row, (shape, x, y) in enumerate([("car", 12.0, 1.0), ("pedestrian", 6.0, -1.0), ("cyclist", 9.0, -2.5)]):
        path = Trajectory(0, State(x, y, 0.5 * row, 1.4, 0.1, 0.0))
        path.append(10**9, State(x + 1, y + 0.5, 0.5 * row, 1.4, 0.1, 1.1))
        movers.append(build_mover(shape, VehicleScenario.model_validate({"shape": shape}), path))
    carrier = EvenPath((0.0, 0.0, 0.0), (2.0, 0.0, 0.0), 0.0, 0.1) if moves else None
    camera = camera_at(movers, carrier=carrier)
    image = camera.image(0, time_ns)
    found = visibility(image, camera, tuple(movers), time_ns)
    to_camera = camera.optical_pose(time_ns).inverse()
    for row, mover in enumerate(movers):
        vertices = np.concatenate([placed_vertices(part, time_ns) for part in mover.parts])
        pixels, _ = camera.model.project(to_camera.apply(vertices))
        np.testing.assert_allclose(found.whole_xyxy[row], [*pixels.min(0), *pixels.max(0)], atol=0.6)
        assert found.visible_px[row] == (image.movers == row).sum() > 50
        np.testing.assert_array_equal(found.visible_xyxy[row], box_of_ids(image, row))


# --- what a 2D detector finds of it

CLASSES = ("car", "pedestrian", "truck")


def image_of(*, hidden: float = 0.0, height: int = 60) -> CameraImage:
    """A car of 80 x `height`, its left part hidden by a pedestrian, and a truck that is not seen."""
    movers = np.full((240, 320), -1, np.int16)
    movers[100 : 100 + height, 50:130] = 0
    edge = 50 + round(80 * hidden)
    movers[100 : 100 + height, 50:edge] = -1
    movers[90:170, 20:50] = 1
    boxes = np.array([[50.0, 100, 130, 100 + height], [20, 90, 50, 170], [np.nan] * 4])
    rgb = np.zeros((240, 320, 3), np.uint8)
    return CameraImage(rgb, movers, np.array([80 * height, 30 * 80, 0], np.int64), boxes)


def detected(shown: CameraImage, *, number: int = 0, **how: Any) -> Detected:
    settings = {"pixel_noise_px": 0.0, "miss_rate": 0.0, "false_per_image": 0.0} | how
    scenario = Detector2DScenario.model_validate({"topic": "/detections"} | settings)
    return detect(scenario, shown, CLASSES, name="front", number=number, seed=1)


def test_boxes_of_what_is_visible() -> None:
    shown = image_of(hidden=0.25)
    np.testing.assert_array_equal(visible_boxes(shown)[:2], [[70, 100, 130, 160], [20, 90, 50, 170]])
    assert np.isnan(visible_boxes(shown)[2]).all()
    found = detected(shown)
    np.testing.assert_array_equal(found.xyxy, visible_boxes(shown)[:2])
    np.testing.assert_array_equal(found.movers, [0, 1])
    assert found.class_names == ("car", "pedestrian")


@pytest.mark.parametrize(
    ("shown", "how", "movers"),
    [
        (image_of(hidden=0.6), {"min_visible": 0.3}, [0, 1]),
        (image_of(hidden=0.8), {"min_visible": 0.3}, [1]),
        (image_of(height=11), {"min_height_px": 12.0}, [1]),
        (image_of(), {"miss_rate": 1.0}, []),
        (image_of(), {"min_height_px": 300.0}, []),
    ],
    ids=["half hidden", "hidden", "small", "all missed", "all small"],
)
def test_what_is_not_found(shown: CameraImage, how: dict[str, Any], movers: list[int]) -> None:
    found = detected(shown, **how)
    np.testing.assert_array_equal(found.movers, movers)
    assert found.xyxy.shape == (len(movers), 4)
    assert found.scores.shape == (len(movers),)


def test_a_habit_moves_edges_outward_by_shares_of_each_box() -> None:
    found = detected(image_of(), edge_bias=(0.05, -0.1, 0.025, 0.1))
    np.testing.assert_allclose(found.xyxy, np.array([[46, 106, 132, 166], [18.5, 98, 50.75, 178]]))


def test_rates_and_noise_are_those_asked_for() -> None:
    found = [detected(image_of(), number=n, miss_rate=0.2, pixel_noise_px=1.5, false_per_image=0.5) for n in range(600)]
    true = [one.movers >= 0 for one in found]
    assert sum(rows.sum() for rows in true) / 1200 == pytest.approx(0.8, abs=0.04)
    assert sum((~rows).sum() for rows in true) / 600 == pytest.approx(0.5, abs=0.1)
    edges = np.concatenate([one.xyxy[one.movers == 0] for one in found]) - (50, 100, 130, 160)
    assert edges.std() == pytest.approx(1.5, rel=0.06)
    assert abs(edges.mean()) < 0.1
