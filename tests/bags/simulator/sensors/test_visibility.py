"""What images show of movers, against the image of ids and the projected corners of boxes."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_worlds import EvenPath, box_mover, scene

from lidcam.bags.simulator.recorder.stage import build_mover
from lidcam.bags.simulator.scenario.scenario import SunScenario, VehicleScenario
from lidcam.bags.simulator.scenario.sensors import CameraScenario
from lidcam.bags.simulator.sensors.camera import Camera, CameraImage
from lidcam.bags.simulator.sensors.visibility import Visibility, visibility
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
