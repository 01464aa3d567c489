from typing import Any

import cv2
import numpy as np
import pytest
import small_worlds
from small_worlds import EvenPath

from lidcam.bags.simulator.scenario.scenario import SunScenario
from lidcam.bags.simulator.scenario.sensors import CameraScenario
from lidcam.bags.simulator.sensors.camera import FRACTION, Camera, CameraImage, Film
from lidcam.bags.simulator.world.mesh import Material, Mesh, box, merged, polygon
from lidcam.bags.simulator.world.motion import FixedPath, MountedPath, Mover, Path, State, Trajectory
from lidcam.bags.simulator.world.scene import Scene
from lidcam.pipeline.core.arrays import F64
from lidcam.pipeline.core.geometry.transform import Transform

GROUND = Material("ground", (0.55, 0.55, 0.55))
BLACK = Material("black", (0.05, 0.05, 0.05))
PALE = Material("pale", (0.95, 0.95, 0.95))
BARREL: dict[str, Any] = {"distortion": (-0.25, 0.08, 0.001, -0.0005, 0.0)}
FISHEYE: dict[str, Any] = {"distortion_model": "equidistant", "distortion": (-0.02, 0.003, 0.0, 0.0)}
MS = 1_000_000


def ground() -> Mesh:
    h = 30.0
    return polygon([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]], GROUND)


def camera_at(
    scene: Scene,
    *,
    sun: SunScenario | None = None,
    carrier: Path | None = None,
    **settings: Any,
) -> Camera:
    """1.5 m above the ground, looking down by 12 degrees."""
    place = {"position_m": (0.0, 0.0, 1.5), "rpy_deg": (0.0, 12.0, 0.0)}
    settings = {"width_px": 320, "height_px": 240, "focal_px": (260.0, 260.0), "noise": 0.0} | place | settings
    scenario = CameraScenario(topic="/image", info_topic="/info", frame_id="optical", **settings)
    mount = scenario.T_carrier_body("carrier")
    body: Path = FixedPath(mount) if carrier is None else MountedPath(carrier, mount)
    return Camera("front", scenario, body, scene, sun or SunScenario(azimuth_deg=160, elevation_deg=45), 3)


def box_mover(
    *,
    start: tuple[float, float, float] = (5.0, 0.4, 0.3),
    speed_m_s: float = 0.0,
    size: tuple[float, float, float] = (1.2, 0.9, 0.8),
    name: str = "box",
    material: Material = PALE,
) -> Mover:
    x, y, yaw = start
    velocity_m_s = float(speed_m_s * np.cos(yaw)), float(speed_m_s * np.sin(yaw)), 0.0
    return small_worlds.box_mover(name, EvenPath((x, y, 0.0), velocity_m_s, yaw), size, material)


def brightness(image: CameraImage) -> F64:
    return np.asarray(image.rgb.astype(np.float64).mean(2))


def where(camera: Camera, point: tuple[float, float, float]) -> tuple[int, int]:
    """Row and column of the pixel that a point of the world is in."""
    pose = camera.optical_pose(0).inverse()
    (u, v), _ = (value[0] for value in camera.model.project(pose.apply(np.array([point]))))
    return int(v), int(u)


# --- geometry


@pytest.mark.parametrize(
    ("lens", "moves"),
    [({}, False), (BARREL, True), (FISHEYE, False), (FISHEYE, True)],
    ids=["pinhole", "barrel, moves", "fisheye", "fisheye, moves"],
)
def test_edges_of_a_box_are_where_they_are_projected(lens: dict[str, Any], moves: bool) -> None:
    size, place, yaw = (1.0, 1.4, 1.2), (5.0, -0.6), 0.4
    if moves:
        scene = Scene(ground(), [box_mover(start=(*place, yaw), size=size, material=BLACK)])
    else:
        scene = Scene(merged(ground(), box((*place, size[2] / 2), size, BLACK, yaw=yaw)), [])
    camera = camera_at(scene, sun=SunScenario(shadows=False), **lens)
    values = (brightness(camera.image(0, 0)) / 255) ** 2.2
    cos, sin = np.cos(yaw), np.sin(yaw)
    outer = [(place[0] + x * cos - y * sin, place[1] + x * sin + y * cos) for x in (-0.5, 0.5) for y in (-0.7, 0.7)]
    bearings = [y / x for x, y in outer]
    checked = 0
    for x, y in (outer[int(np.argmin(bearings))], outer[int(np.argmax(bearings))]):  # the outline's upright edges
        for height in (0.5, 0.7, 0.9):
            point = np.array([[x, y, height]])
            (u, v), _ = (value[0] for value in camera.model.project(camera.optical_pose(0).inverse().apply(point)))
            assert abs(_edge_column(values, float(u), float(v)) - u) < 0.4
            checked += 1
    assert checked == 6


def _edge_column(values: F64, u: float, v: float) -> float:
    """Where brightness steps, near a place, to a part of a pixel: how far along the profile the left side reaches."""
    first = int(u) - 6
    rows = np.clip([int(np.floor(v - 0.5)), int(np.floor(v - 0.5)) + 1], 0, len(values) - 1)
    share = v - 0.5 - np.floor(v - 0.5)
    profile = values[rows[0], first : first + 13] * (1 - share) + values[rows[1], first : first + 13] * share
    left, right = profile[:3].mean(), profile[-3:].mean()
    assert abs(left - right) > 0.1
    return float(first + ((profile - right) / (left - right)).sum())


def test_an_image_says_which_mover_each_pixel_shows() -> None:
    near, far = box_mover(start=(4.0, 0.0, 0.0), name="near"), box_mover(start=(7.0, 0.5, 0.0), name="far")
    camera = camera_at(Scene(ground(), [far, near]))
    image = camera.image(0, 0)
    assert image.movers[where(camera, (4.0 - 0.6, 0.0, 0.4))] == 1
    assert image.movers[where(camera, (7.0 - 0.6, 0.85, 0.6))] == 0
    assert image.movers[where(camera, (3.0, 1.5, 0.0))] == -1
    np.testing.assert_array_equal(image.seen_px, [(image.movers == row).sum() for row in (0, 1)])
    assert image.alone_px[1] == image.seen_px[1]
    assert 0 < image.seen_px[0] < image.alone_px[0]
    alone = camera_at(Scene(ground(), [far])).image(0, 0)
    assert image.alone_px[0] == alone.seen_px[0]
    rows, columns = np.nonzero(alone.movers == 0)
    expected = [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]
    np.testing.assert_array_equal(image.alone_xyxy[0], expected)


# --- light


@pytest.mark.parametrize("azimuth_deg", [30.0, 90.0, 210.0])
def test_shadow_of_a_mover_is_that_of_the_same_thing_standing_still(azimuth_deg: float) -> None:
    sun, size = SunScenario(azimuth_deg=azimuth_deg, elevation_deg=35), (1.2, 0.9, 0.8)
    wall = box((8.0, 0.0, 1.0), (0.2, 9.0, 2.0), GROUND)
    stands = Scene(merged(ground(), wall, box((5.0, 0.4, 0.4), size, PALE, yaw=0.3)), [])
    moves = Scene(merged(ground(), wall), [box_mover(size=size)])
    first = brightness(camera_at(stands, sun=sun).image(0, 0))
    second = brightness(camera_at(moves, sun=sun).image(0, 0))
    away = cv2.dilate((camera_at(moves, sun=sun).image(0, 0).movers >= 0).astype(np.uint8), np.ones((5, 5))) == 0
    dark, also_dark = (values < 0.72 * np.median(values[200:, :100]) for values in (first, second))
    dark, also_dark = dark & away, also_dark & away
    assert dark.sum() > 150
    union = (dark | also_dark).sum()
    assert (dark & also_dark).sum() > 0.85 * union


# --- exposure


def test_noise_is_as_strong_as_asked_for_and_another_one_in_each_image() -> None:
    scene = Scene(ground(), [])
    clean = camera_at(scene).image(0, 0).rgb.astype(int)
    camera = camera_at(scene, noise=2.5)
    first, second = (camera.image(number, 0).rgb.astype(int) for number in (0, 1))
    middle = (clean > 15) & (clean < 240)
    assert (first - clean)[middle].std() == pytest.approx(2.5, rel=0.05)
    assert abs((first - clean)[middle].mean()) < 0.1
    assert abs(np.corrcoef((first - clean)[middle], (second - clean)[middle])[0, 1]) < 0.05


def test_strong_noise_leaves_no_black_pixels_in_white() -> None:
    white = np.full((240, 320, 3), 255 * FRACTION, np.int16)
    scenario = CameraScenario(
        topic="/image", info_topic="/info", frame_id="optical", position_m=(0, 0, 1), focal_px=(260, 260), noise=150.0
    ).model_copy(update={"width_px": 320, "height_px": 240})
    assert Film(scenario, "front", 3, 1.0).read_out(white, 0).min() > 0


def test_motion_blur_spreads_what_moves_over_its_way() -> None:
    scene = Scene(ground(), [box_mover(start=(6.0, -1.0, np.pi / 2), speed_m_s=8.0, size=(1, 1, 1), material=BLACK)])
    settings: dict[str, Any] = {"exposure_ms": 40.0, "sun": SunScenario(shadows=False)}
    sharp = brightness(camera_at(scene, **settings).image(1, 100 * MS))
    camera = camera_at(scene, motion_blur=True, **settings)
    blurred = brightness(camera.image(1, 100 * MS))
    row = where(camera, (5.5, 0.0, 0.8))[0]
    widths = [int((np.abs(np.diff(values[row])) > 2).sum()) for values in (sharp, blurred)]
    # 8 m/s for 40 ms are 0.32 m: at 5.5 m, and 260 px of focal length, 15 px at both sides.
    assert widths[0] <= 10
    assert 18 <= widths[1] <= 40
    assert np.abs(sharp - blurred)[:, :60].max() < 3  # what stands still stays sharp


# --- on a vehicle


def test_camera_on_a_vehicle_sees_what_a_fixed_one_sees_from_there() -> None:
    static = merged(ground(), box((9.0, 1.0, 0.5), (1, 1, 1), PALE), box((12.0, -2.0, 1.0), (1, 1, 2), GROUND))
    scene = Scene(static, [box_mover(start=(7.0, -0.5, 0.5))])
    carrier = Trajectory(0, State(0.0, 0.0, 0.0))
    carrier.append(10**9, State(2.0, 0.0, 0.2))
    mounted = camera_at(scene, carrier=carrier, **BARREL)
    turn = np.eye(4)
    turn[:2, :2], turn[:2, 3] = [[np.cos(0.2), -np.sin(0.2)], [np.sin(0.2), np.cos(0.2)]], (2.0, 0.0)
    fixed = camera_at(scene, carrier=FixedPath(Transform("world", "carrier", turn)), **BARREL)
    np.testing.assert_array_equal(mounted.image(0, 10**9).rgb, fixed.image(0, 10**9).rgb)
    assert (mounted.image(0, 0).rgb != mounted.image(0, 10**9).rgb).mean() > 0.2
    blurred = camera_at(scene, carrier=carrier, motion_blur=True, exposure_ms=50.0).image(0, 500 * MS)
    assert blurred.rgb.shape == (240, 320, 3)
