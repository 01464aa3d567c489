from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from detections import boxes2d, boxes3d, camera_rig, forward_camera, matches
from fusion_scenes import FusionScene, fusion_scenes
from fusion_stages import associate_of
from scipy.stats import chi2
from seen_boxes import camera_at, edges_in_view
from wrong_cameras import cuboids

from lidcam.pipeline.core.arrays import F64, Bools, join_rows
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D, Hypotheses, Matches, Source
from lidcam.pipeline.core.geometry.boxes import wrap_angle
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraFit, CameraSensor, EdgeHabits, LidarSensor, Rig
from lidcam.pipeline.core.settings.fuse import FuseConfig
from lidcam.pipeline.stages.refine import Refine

EXACT = CameraFit(direction_sigma_rad=1e-6, habit_sigma=1e-6)
BOX_PRIOR = "lidcam.pipeline.fusion.refining.box_prior"


@pytest.fixture(autouse=True)
def _exact_cuboids(monkeypatch: pytest.MonkeyPatch) -> None:
    """Objects that are cuboids of known size, which nothing hides, in images whose edges all err alike."""
    monkeypatch.setattr("lidcam.pipeline.stages.refine.rounded_outline", cuboids)
    monkeypatch.setattr(f"{BOX_PRIOR}.MAX_SIZE_SIGMA", 0.0)
    monkeypatch.setattr(f"{BOX_PRIOR}.HIDDEN_TOP_SIGMA", 1e-6)
    monkeypatch.setattr(f"{BOX_PRIOR}.SEEN_TOP_SIGMA", 1e-6)
    monkeypatch.setattr(f"{BOX_PRIOR}.HEADING_SIGMA_RAD", 0.0)
    monkeypatch.setattr("lidcam.pipeline.fusion.refining.edges.HIDDEN_SHARE", 0.0)
    monkeypatch.setattr("lidcam.pipeline.fusion.refining.edges.SIDE_NOISE", 1.0)
    monkeypatch.setattr("lidcam.pipeline.fusion.refining.edges.CROWDED_NOISE", 1.0)
    monkeypatch.setattr("lidcam.pipeline.fusion.matching.in_view.MIN_EDGE_SHARE", np.inf)


def errors(boxes: Boxes3D, truth: Boxes3D) -> F64:
    """(N, 3) of x, y, yaw."""
    return np.column_stack([boxes.centers[:, :2] - truth.centers[:, :2], wrap_angle(boxes.yaws - truth.yaws)])


def refined(rig: Rig, scene: FusionScene, pixel_sigma_px: float) -> Boxes3D:
    rig = known_as(rig, EXACT)
    matches = associate_of(rig)(scene.lidar, scene.seen, {camera.name: camera for camera in rig.cameras})
    return fitted(rig, Hypotheses(scene.lidar, matches, len(scene.lidar)), scene.seen, pixel_sigma_px=pixel_sigma_px)


@pytest.mark.parametrize(
    ("deviations", "most_m", "most_rad"), [(None, 0.0299, 0.102), ((0.07, 0.07, 0.2), 0.0305, 0.102)]
)
def test_scenes_of_the_original(deviations: tuple[float, float, float] | None, most_m: float, most_rad: float) -> None:
    # What is given: that objects are cuboids of known size; one pixel noise for all scenes; the noise of the lidar's
    # boxes by scene, as a calibrated detector tells it, or one for all scenes. With the right pairs, the pixel noise of
    # each scene, nothing said of hidden edges and no robust weights, the mean of the exact posterior errs by 0.0265 m.
    rig, scenes = fusion_scenes()
    by_noise: dict[tuple[float, float], list[F64]] = {}
    for scene in scenes:
        if deviations:
            covariances = np.tile(np.diag(np.square(deviations)), (len(scene.lidar), 1, 1))
            scene = replace(scene, lidar=replace(scene.lidar, covariances=covariances))
        found = refined(rig, scene, 3.0)
        before, after = errors(scene.lidar, scene.truth), errors(found, scene.truth)
        table = np.column_stack([place(before), heading(before), place(after), heading(after)])
        by_noise.setdefault((scene.position_noise_m, scene.pixel_noise_px), []).append(table[scene.judged])
    tables = [np.concatenate(rows) for rows in by_noise.values() if sum(map(len, rows))]
    everything = np.concatenate(tables)
    assert everything.shape == (139, 4)
    assert everything[:, :2].mean(0) == pytest.approx([0.083, 0.172], abs=6e-4)
    assert everything[:, 2].mean() < most_m
    assert everything[:, 3].mean() < most_rad
    for table in tables:
        assert table[:, 2].mean() <= table[:, 0].mean()
        assert table[:, 3].mean() <= table[:, 1].mean()


def test_covariances_of_the_scenes_are_honest() -> None:
    rig, scenes = fusion_scenes()
    squared: list[float] = []
    for scene in scenes:
        if scene.judged.any():
            found = refined(rig, scene, scene.pixel_noise_px)
            squared.extend(squared_distances(found, scene.truth)[scene.judged])
    assert_honest(squared, 0.025)


def squared_distances(found: Boxes3D, truth: Boxes3D) -> F64:
    """(N,) errors in units of what the covariances say, squared."""
    error = errors(found, truth)
    return np.asarray(np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariances), error))


def assert_honest(squared: list[float], tail: float) -> None:
    low, high = (float(chi2.ppf(share, 3 * len(squared))) / len(squared) for share in (tail, 1 - tail))
    assert low <= float(np.mean(squared)) <= high


def place(error: F64) -> F64:
    return np.hypot(error[:, 0], error[:, 1])


def heading(error: F64) -> F64:
    return np.abs(error[:, 2])


# --- scenes of our own: a ring of cameras on poles around a crossing, cars seen by two or three of them

SIZE = (4.2, 1.8, 1.5)


def pole_camera(number: int, *, turned_deg: float = 0.0) -> CameraSensor:
    """One of four cameras at the corners of a square, 5 m high, that look at its middle."""
    x, y = ((20.0, 20.0), (-20.0, 20.0), (-20.0, -20.0), (20.0, -20.0))[number]
    away_deg, down_deg = turned_deg + np.degrees(np.arctan2(-y, -x)), float(np.degrees(np.arctan2(5, 28)))
    camera = camera_at(f"{number}", (x, y, 5.0), yaw_deg=away_deg, pitch_deg=down_deg, distortion=(-0.1, 0.02))
    return replace(camera, model=camera.model.zoomed(7 / 9), fit=EXACT)


def made_up(
    seed: int,
    count: int = 8,
    *,
    noise: tuple[float, float, float] = (0.2, 0.2, 0.1),
    size: tuple[float, float, float] = SIZE,
    turned_deg: float = 0.0,
) -> tuple[Any, ...]:
    """Boxes of cars as lidars give them, the truth, and 2D boxes of what the cameras show, all matched.

    The cameras are turned by angles of the deviation `turned_deg`, of which their rig does not know.
    """
    random = np.random.default_rng(seed)
    place = np.column_stack([random.uniform(-9, 9, (count, 2)), np.full(count, size[2] / 2)])
    rows = np.column_stack([place, np.tile(size, (count, 1)), random.uniform(-3, 3, count)])
    moved = rows.copy()
    moved[:, [0, 1, 6]] += random.normal(size=(count, 3)) * noise
    truth, lidar = boxes3d(rows), boxes3d(moved, deviations=noise)
    turns_deg = turned_deg * np.random.default_rng([seed, 1]).normal(size=4)
    cameras = [pole_camera(number, turned_deg=turn_deg) for number, turn_deg in enumerate(turns_deg)]
    seen, matched = {}, {}
    for camera in cameras:
        edges = edges_in_view(truth.centers, truth.sizes, truth.yaws, camera)
        limits = np.array([1280, 720] * 2)
        shown = np.flatnonzero(edges.valid & (edges.xyxy > 0).all(1) & (edges.xyxy < limits).all(1))
        xyxy = edges.xyxy[shown] + random.normal(0, 1.5, (len(shown), 4))
        seen[camera.name] = boxes2d(np.column_stack([xyxy, np.full((len(shown), 2), [0.9, 0])]))
        pairs = np.column_stack([shown, np.arange(len(shown))])
        matched[camera.name] = matches(pairs, edges.xyxy, overlaps=1.0)
    return camera_rig(*map(pole_camera, range(4))), Hypotheses(lidar, matched, count), seen, truth


def fitted(rig: Rig, hypotheses: Hypotheses, seen: Mapping[str, Boxes2D], **settings: float) -> Boxes3D:
    config = FuseConfig.model_validate({"outline_sigma": 0.0, **settings})
    views = {camera.name: camera for camera in rig.cameras}
    return Refine(rig, config)(hypotheses, seen, views).boxes


def known_as(rig: Rig, fit: CameraFit) -> Rig:
    return replace(rig, cameras=tuple(replace(camera, fit=fit) for camera in rig.cameras))


@pytest.mark.parametrize(
    ("noise", "turned_deg", "share_m", "share_rad", "tail"),
    [((0.2, 0.2, 0.1), 0.0, 0.4, 0.6, 0.005), ((0.1, 0.1, 0.05), 1.0, 1.0, np.inf, 0.001)],
    ids=["edges that err alone", "an error of direction that all edges share"],
)
def test_boxes_come_nearer_to_the_truth_and_say_how_near(
    noise: tuple[float, float, float], turned_deg: float, share_m: float, share_rad: float, tail: float
) -> None:
    before, after, squared = [], [], list[float]()
    for seed in range(12):
        rig, hypotheses, seen, truth = made_up(seed, noise=noise, turned_deg=turned_deg)
        fit = replace(EXACT, direction_sigma_rad=max(EXACT.direction_sigma_rad, np.deg2rad(turned_deg)))
        found = fitted(known_as(rig, fit), hypotheses, seen)
        before.append(errors(hypotheses.boxes, truth))
        after.append(errors(found, truth))
        squared.extend(squared_distances(found, truth))
    first, last = np.concatenate(before), np.concatenate(after)
    assert place(last).mean() <= share_m * place(first).mean()
    assert heading(last).mean() <= share_rad * heading(first).mean()
    assert_honest(squared, tail)


@pytest.mark.parametrize(("height_m", "lidar_m", "share"), [(1.2, 1.0, 0.3), (2.0, 1.0, 0.3), (1.2, 15.0, 1.0)])
def test_cameras_show_heights_that_lidars_do_not(
    monkeypatch: pytest.MonkeyPatch, height_m: float, lidar_m: float, share: float
) -> None:
    monkeypatch.setattr(f"{BOX_PRIOR}.HIDDEN_TOP_SIGMA", 0.2)
    rig, hypotheses, seen, truth = made_up(8, noise=(0.05, 0.05, 0.02))
    T_site_lidar = np.eye(4)
    T_site_lidar[2, 3] = lidar_m
    rig = replace(rig, lidars=(LidarSensor("lidar", "/lidar", Transform("site", "lidar", T_site_lidar)),))
    sizes, centers = hypotheses.boxes.sizes.copy(), hypotheses.boxes.centers.copy()
    sizes[:, 2], centers[:, 2] = height_m, height_m / 2
    found = fitted(rig, replace(hypotheses, boxes=replace(hypotheses.boxes, sizes=sizes, centers=centers)), seen)
    left_m = np.abs(found.sizes[:, 2] - truth.sizes[:, 2]).mean()
    assert 0.9 * (share == 1) <= left_m / abs(height_m - SIZE[2]) <= share
    np.testing.assert_allclose(found.centers[:, 2], found.sizes[:, 2] / 2, atol=1e-12)


def test_habits_of_a_detector_are_taken_off() -> None:
    rig, hypotheses, seen, _ = made_up(5)
    habits = EdgeHabits(0.06, 0.03, -0.02, 1.5)
    exact = fitted(rig, hypotheses, seen)
    wider = {}
    for name, one in seen.items():
        width, height = (one.xyxy[:, 2:] - one.xyxy[:, :2]).T
        sides, top, bottom = habits.sides * width + 1.5, habits.top * height + 1.5, habits.bottom * height + 1.5
        wider[name] = replace(one, xyxy=one.xyxy + np.column_stack([-sides, -top, sides, bottom]).astype(np.float32))
    found = fitted(known_as(rig, replace(EXACT, habits=habits)), hypotheses, wider)
    left = fitted(rig, hypotheses, wider)
    assert place(errors(found, exact)).max() < 0.3 * place(errors(left, exact)).max()


def test_what_hides_an_edge_does_not_draw_the_box(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lidcam.pipeline.fusion.refining.edges.HIDDEN_SHARE", 0.15)
    rig, hypotheses, seen, truth = made_up(6, noise=(0.1, 0.1, 0.05))
    hidden = {name: replace(one, xyxy=one.xyxy + np.array([25, 0, 0, 0], np.float32)) for name, one in seen.items()}
    found = fitted(rig, hypotheses, hidden)
    assert place(errors(found, truth)).mean() < 1.1 * place(errors(hypotheses.boxes, truth)).mean()
    assert place(errors(found, fitted(rig, hypotheses, seen))).max() < 0.15


def test_a_2d_box_that_swallows_its_neighbour_draws_less(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, hypotheses, seen, _ = made_up(6, noise=(0.1, 0.1, 0.05))
    swallowing = {name: replace(one, xyxy=one.xyxy - np.array([8, 0, 0, 0], np.float32)) for name, one in seen.items()}
    neighbours = {name: with_neighbours(one) for name, one in swallowing.items()}
    moved = {}
    for noise in (1.0, 2.0):
        monkeypatch.setattr("lidcam.pipeline.fusion.refining.edges.CROWDED_NOISE", noise)
        exact = fitted(rig, hypotheses, seen)
        moved[noise] = place(errors(fitted(rig, hypotheses, neighbours), exact)).mean()
    assert moved[2.0] < 0.7 * moved[1.0]


def with_neighbours(found: Boxes2D) -> Boxes2D:
    """The same, and a box at the left edge of each."""
    left, top, _, bottom = found.xyxy.T
    rows = np.column_stack([left - 10, top, left + 25, bottom, found.scores, found.class_ids])
    return join_rows(found, boxes2d(rows))


def with_pairs(matches: Matches, rows: Bools) -> Matches:
    """The same with some of the pairs."""
    return replace(matches, pairs=matches.pairs[rows], iou=matches.iou[rows])


def test_what_is_not_matched_stays() -> None:
    rig, hypotheses, seen, _ = made_up(3)
    alone = {name: with_pairs(one, np.zeros(len(one.pairs), np.bool_)) for name, one in hypotheses.matches.items()}
    same = replace(hypotheses, matches=alone)
    assert fitted(rig, same, seen) is same.boxes
    assert fitted(rig, hypotheses, {}) is hypotheses.boxes
    assert fitted(rig, hypotheses, seen, refine=False) is hypotheses.boxes


def test_sources_and_what_is_not_refined() -> None:
    rig, hypotheses, seen, _ = made_up(4)
    sources = np.zeros(8, np.uint8)
    sources[0] = Source.CAMERA
    boxes = replace(hypotheses.boxes, sources=sources)
    found = fitted(rig, replace(hypotheses, boxes=boxes), seen)
    moved = (found.centers != boxes.centers).any(1)
    assert moved.sum() >= 7
    np.testing.assert_array_equal(found.sources[moved][1:], Source.BOTH)
    assert found.sources[0] == Source.CAMERA
    np.testing.assert_allclose(found.sizes[1:, 2], boxes.sizes[1:, 2])
    np.testing.assert_array_equal(found.scores, boxes.scores)
    assert (np.cos(found.yaws - boxes.yaws) > 0).all()


def test_a_moving_object_is_where_the_images_show_it_at_their_time() -> None:
    rig, hypotheses, seen, truth = made_up(7)
    late = {name: replace(found, stamp_ns=found.stamp_ns - 50_000_000) for name, found in seen.items()}
    speed = 8.0 * np.column_stack([np.cos(truth.yaws), np.sin(truth.yaws), np.zeros(8)])
    ahead = replace(hypotheses.boxes, centers=hypotheses.boxes.centers + 0.05 * speed)
    found = fitted(rig, replace(hypotheses, boxes=ahead), late)
    seconds = (found.measured_ns - truth.measured_ns) / 1e9 + 0.05
    at_its_time = replace(truth, centers=truth.centers + seconds[:, None] * speed)
    assert (found.measured_ns < truth.measured_ns).all()
    when_seen = replace(truth, centers=truth.centers + 0.05 * speed)
    assert place(errors(found, at_its_time)).mean() < 0.7 * place(errors(ahead, when_seen)).mean()


@pytest.mark.parametrize("turned_deg", [0.0, 40.0, 90.0])
def test_images_show_the_heading_of_riders_of_whom_points_do_not(turned_deg: float) -> None:
    near = []
    for seed in range(4):
        rig, hypotheses, seen, truth = made_up(seed, size=(1.8, 0.6, 1.7), noise=(0.05, 0.05, 0.05))
        found = fitted(rig, replace(hypotheses, boxes=unsure_of_heading(hypotheses.boxes, truth, turned_deg)), seen)
        off = heading(errors(found, truth)) % np.pi
        near.append(np.minimum(off, np.pi - off) < np.deg2rad(20))
    assert np.mean(near) > 0.9


def unsure_of_heading(boxes: Boxes3D, truth: Boxes3D, turned_deg: float) -> Boxes3D:
    covariances = boxes.covariances.copy()
    covariances[:, 2, 2] = np.pi**2 / 12
    return replace(boxes, yaws=wrap_angle(truth.yaws + np.deg2rad(turned_deg)), covariances=covariances)


@pytest.mark.parametrize(("length_m", "deviation", "turns"), [(1.8, 0.9, True), (1.8, 0.1, False), (0.6, 0.9, False)])
def test_only_long_boxes_of_unknown_heading_are_turned(length_m: float, deviation: float, turns: bool) -> None:
    """Beside others of known heading, and one without a 2D box."""
    rig, hypotheses, seen, truth = made_up(0, size=(length_m, 0.6, 1.7), noise=(0.02, 0.02, 0.02))
    boxes, rows = hypotheses.boxes, [2, 5, 7]
    yaws, covariances = boxes.yaws.copy(), boxes.covariances.copy()
    yaws[rows] = wrap_angle(truth.yaws[rows] + np.pi / 2)
    covariances[rows, 2, 2] = deviation**2
    unsure = replace(boxes, yaws=yaws, covariances=covariances)
    kept = {name: with_pairs(one, one.pairs[:, 0] != 7) for name, one in hypotheses.matches.items()}
    found = fitted(rig, replace(hypotheses, boxes=unsure, matches=kept), seen)
    is_turned = np.abs(np.cos(found.yaws - unsure.yaws)) < 0.5
    assert is_turned.tolist() == [turns and row in (2, 5) for row in range(8)]


def test_no_boxes() -> None:
    rig, hypotheses, seen, _ = made_up(9, count=0)
    assert len(fitted(rig, hypotheses, seen)) == 0


@pytest.mark.parametrize("seed", [0, 1])
def test_a_box_beside_a_camera_whose_edges_the_border_cuts(seed: int) -> None:
    random, camera, count = np.random.default_rng(seed), forward_camera(), 60
    size = np.column_stack([random.uniform(1, 12, count), random.uniform(0.5, 2.6, count), random.uniform(1, 3, count)])
    yaw = random.uniform(-3, 3, count)
    behind_m = (size[:, 0] * np.abs(np.cos(yaw)) + size[:, 1] * np.abs(np.sin(yaw))) / 2
    ahead_m = behind_m + 10 ** random.uniform(-3, 0, count)
    place = np.column_stack([ahead_m, random.uniform(-6, 6, count), random.uniform(-1, 1, count)])
    boxes = boxes3d(np.column_stack([place, size, yaw]), deviations=(0.3, 0.3, 0.3))
    shown = edges_in_view(boxes.centers, boxes.sizes, boxes.yaws, camera).xyxy.clip(0, [640, 480] * 2)
    seen = {"cam": boxes2d(np.column_stack([shown, np.full((count, 2), [0.9, 0])]))}
    matched = {"cam": matches(np.column_stack([np.arange(count)] * 2), shown, overlaps=1.0)}
    found = fitted(camera_rig(camera), Hypotheses(boxes, matched, count), seen)
    assert np.isfinite(found.centers).all()
    assert np.isfinite(found.covariances).all()
