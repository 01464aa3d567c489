"""Association where it is hard, against the truth: scenes of the predecessor, hidden objects, wrong calibration."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from detections import boxes2d, boxes3d, camera_rig, forward_camera
from fusion_scenes import fusion_scenes
from fusion_stages import associate_of
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from lidcam.pipeline.core.arrays import F32, F64
from lidcam.pipeline.core.detections import Boxes2D, Boxes3D
from lidcam.pipeline.core.geometry.boxes import box_corners, iou_xyxy
from lidcam.pipeline.core.geometry.transform import Transform
from lidcam.pipeline.core.rig import CameraSensor
from lidcam.pipeline.fusion.matching.in_view import hidden_parts, project_into_views
from lidcam.pipeline.fusion.projection import CameraArrays

Key = tuple[str, int]
CAR, PEDESTRIAN, BUS = 0, 1, 4
SIZES = {CAR: (4.0, 1.8, 1.5), PEDESTRIAN: (0.6, 0.6, 1.7), BUS: (11.5, 2.5, 3.2)}


def associate(boxes: Boxes3D, found: Mapping[str, Boxes2D], views: Mapping[str, CameraSensor]) -> dict[Key, int]:
    """Row of the 3D box by camera and row of the 2D box."""
    matches = associate_of(camera_rig(*views.values()))(boxes, found, views)
    return {(name, int(j)): int(i) for name, part in matches.items() for i, j in part.pairs}


def seen_in(camera: CameraSensor, corners: F64) -> F32:
    return camera.model.project_boxes(camera.T_camera_site.apply(corners))


def plain(boxes: Boxes3D, found: Mapping[str, Boxes2D], views: Mapping[str, CameraSensor]) -> dict[Key, int]:
    """The same by the best sum of IoU in each camera, from 0.3 on."""
    corners, pairs = box_corners(boxes.centers, boxes.sizes, boxes.yaws), {}
    for name, part in found.items():
        iou = iou_xyxy(seen_in(views[name], corners), part.xyxy)
        iou[iou < 0.3] = 0
        for i, j in zip(*linear_sum_assignment(iou, maximize=True), strict=True):
            if iou[i, j]:
                pairs[name, int(j)] = int(i)
    return pairs


def counted(pairs: Mapping[Key, int], truth: Mapping[Key, int]) -> Counter[str]:
    right = sum(truth.get(key) == row for key, row in pairs.items())
    return Counter(right=right, wrong=len(pairs) - right, shown=len(truth))


# --- the scenes of the predecessor


def true_rows(camera: CameraSensor, truth: Boxes3D, seen: Boxes2D) -> dict[Key, int]:
    """Which object each 2D box shows, by the place of the truth in the image; boxes that show none have no entry.

    The 2D boxes are those around whole objects, clipped to the image: some are of objects of which it shows nothing.
    """
    size = camera.model.width_px, camera.model.height_px
    corners = box_corners(truth.centers, truth.sizes, truth.yaws)
    corner_K = camera.model.K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    P = corner_K @ camera.T_camera_site.matrix[:3]
    homogeneous = corners @ P[:, :3].T + P[:, 3]
    ahead = (homogeneous[..., 2] > 0.05).all(1) & np.isfinite(seen_in(camera, corners)).all(1)
    pixels = homogeneous[..., :2] / np.where(ahead[:, None], homogeneous[..., 2], 1.0)[..., None]
    rectangles = np.concatenate([np.clip(pixels.min(1), 0, size), np.clip(pixels.max(1), 0, size)], 1)
    overlaps = iou_xyxy(rectangles, seen.xyxy) * ahead[:, None]
    objects, shows = linear_sum_assignment(overlaps, maximize=True)
    pairs = zip(objects, shows, strict=True)
    return {(camera.name, int(j)): int(i) for i, j in pairs if overlaps[i, j] >= 0.5}


@pytest.mark.parametrize(("is_known", "most_wrong"), [(True, 3), (False, 5)])
def test_scenes_of_the_original(is_known: bool, most_wrong: int) -> None:
    """With the covariances of the 3D boxes and without; of the predecessor's 169 pairs, 2 were wrong."""
    rig, scenes = fusion_scenes()
    views, total = {camera.name: camera for camera in rig.cameras}, Counter[str]()
    for scene in scenes:
        boxes = scene.lidar if is_known else replace(scene.lidar, covariances=np.zeros((len(scene.lidar), 3, 3)))
        truth: dict[Key, int] = {}
        for camera in rig.cameras:
            truth |= true_rows(camera, scene.truth, scene.seen[camera.name])
        total += counted(associate(boxes, scene.seen, views), truth)
    assert total["shown"] == 325
    assert total["right"] >= 0.985 * 325
    assert total["wrong"] <= most_wrong


# --- objects behind others


def rows_of(places: Sequence[tuple[float, float, float, int]]) -> Boxes3D:
    """Boxes on the ground 1.5 m below the cameras, from x, y, yaw and class."""
    table = [(x, y, SIZES[c][2] / 2 - 1.5, *SIZES[c], yaw) for x, y, yaw, c in places]
    return boxes3d(table, class_ids=[c for *_, c in places])


def shown(boxes: Boxes3D, camera: CameraSensor) -> F64:
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)
    return np.asarray(seen_in(camera, corners), np.float64)


def test_what_is_left_to_see_of_a_hidden_car_is_its_own() -> None:
    camera = forward_camera()
    cars = rows_of([(10, 0, 0, CAR), (16, 0.8, 0, CAR)])
    near, far = shown(cars, camera)
    assert far[2] > near[0] > far[0]
    found = {"cam": boxes2d([(*near, 0.9, CAR), (far[0], far[1], near[0], far[3], 0.6, CAR)])}
    assert plain(cars, found, {"cam": camera}) == {("cam", 0): 0}
    assert associate(cars, found, {"cam": camera}) == {("cam", 0): 0, ("cam", 1): 1}


def test_a_hidden_object_does_not_take_the_box_of_the_one_before_it() -> None:
    camera = forward_camera()
    walkers = rows_of([(12, 0.15, 0, PEDESTRIAN), (13.5, 0.05, 0, PEDESTRIAN)])
    seen = shown(walkers, camera)[1] * 0.8 + shown(walkers, camera)[0] * 0.2
    found = {"cam": boxes2d([(*seen, 0.9, PEDESTRIAN)])}
    assert plain(walkers, found, {"cam": camera}) == {("cam", 0): 1}
    assert associate(walkers, found, {"cam": camera}) == {("cam", 0): 0}


# --- one object, several cameras


def test_cameras_agree_on_what_an_object_is() -> None:
    """A pedestrian beside a bus: where the first camera could have either, the second knows."""
    cameras = {name: forward_camera(name) for name in ("a", "b", "c")}
    at = rows_of([(14, 1.0, 0.0, PEDESTRIAN), (14.3, 0.7, 0.0, PEDESTRIAN)])
    at = replace(at, class_ids=np.array([PEDESTRIAN, BUS], np.int32))
    first, second = shown(at, cameras["a"])
    between = (first + second) / 2
    plainly = boxes2d([(*first, 0.9, PEDESTRIAN), (*second, 0.9, BUS)])
    found = {"a": boxes2d([(*between, 0.9, BUS)]), "b": plainly, "c": plainly}
    pairs = associate(at, found, cameras)
    assert pairs["a", 0] == 1
    swapped = {"a": boxes2d([(*between, 0.9, PEDESTRIAN)]), "b": plainly, "c": plainly}
    assert associate(at, swapped, cameras)["a", 0] == 0


def test_cameras_agree_on_where_an_object_is() -> None:
    """The lidar is unsure of a car's place, and the first camera shows two cars; the second shows which it is."""
    back = np.array([[0.0, 1, 0, 0], [0, 0, -1, 0], [-1, 0, 0, 30], [0, 0, 0, 1]])  # looks back from x = 30
    views = {"front": forward_camera("front")}
    views["back"] = replace(forward_camera("back"), T_camera_site=Transform("back", "site", back))
    unsure = replace(rows_of([(15.0, 0.0, 0.0, CAR)]), covariances=np.diag([0.1, 1.0, 0.01])[None])
    true, other = (rows_of([(15.0, y, 0.0, CAR)]) for y in (1.0, -0.9))
    front = boxes2d([(*shown(boxes, views["front"])[0], 0.9, CAR) for boxes in (true, other)])
    assert associate(unsure, {"front": front}, views) == {("front", 1): 0}, "the nearer"
    found = {"front": front, "back": boxes2d([(*shown(true, views["back"])[0], 0.9, CAR)])}
    assert associate(unsure, found, views) == {("front", 0): 0, ("back", 0): 0}


# --- what the calibration or the motion has wrong


def crowd(seed: int) -> Boxes3D:
    """A dozen cars and pedestrians ahead, some metres apart."""
    random, places = np.random.default_rng(seed), list[tuple[float, float, float, int]]()
    while len(places) < 12:
        x, aside = random.uniform(7, 35), random.uniform(-0.6, 0.6)
        kind = CAR if random.random() < 0.5 else PEDESTRIAN
        if all(np.hypot(x - a, x * aside - b) > (5 if CAR in (kind, k) else 2) for a, b, _, k in places):
            places.append((x, x * aside, random.uniform(-3, 3), kind))
    return rows_of(places)


def seen_boxes(truth: Boxes3D, camera: CameraSensor, seed: int) -> tuple[dict[str, Boxes2D], dict[Key, int]]:
    """2D boxes of what is not hidden in the main, off by 1.5 px, in any order; and whose they are."""
    random = np.random.default_rng(seed)
    arrays = CameraArrays.of([camera])
    seen = project_into_views(truth, [camera], arrays)
    hidden, _, _ = hidden_parts(truth, seen, camera.T_camera_site.inverse().translation[None])
    rows = random.permutation(np.flatnonzero(hidden < 0.6))
    table = [
        (*seen.xyxy[row] + random.normal(0, 1.5, 4), random.uniform(0.4, 1), truth.class_ids[seen.rows[row]])
        for row in rows
    ]
    return {camera.name: boxes2d(table)}, {(camera.name, k): int(seen.rows[row]) for k, row in enumerate(rows)}


def measured(truth: Boxes3D, seed: int) -> Boxes3D:
    """As a lidar sees them: off by 0.1 m and 0.1 rad."""
    random = np.random.default_rng(seed)
    noise = random.normal(0, 1, (len(truth), 3)) * [0.1, 0.1, 0.1]
    moved = np.column_stack([truth.centers[:, :2] + noise[:, :2], truth.centers[:, 2]])
    covariances = np.tile(np.diag([0.01, 0.01, 0.01]), (len(truth), 1, 1))
    return replace(truth, centers=moved, yaws=truth.yaws + noise[:, 2] * 0.9, covariances=covariances)


def test_a_camera_that_looks_two_degrees_aside() -> None:
    camera, ours, old = forward_camera(), Counter[str](), Counter[str]()
    turned = Transform.from_quaternion("cam", "cam", (0, 0, 0), Rotation.from_euler("y", 2, degrees=True).as_quat())
    wrong = {"cam": replace(camera, T_camera_site=turned @ camera.T_camera_site)}
    for seed in range(20):
        truth = crowd(seed)
        found, whose = seen_boxes(truth, camera, seed)
        ours += counted(associate(measured(truth, seed), found, wrong), whose)
        old += counted(plain(measured(truth, seed), found, wrong), whose)
    assert ours["right"] >= 0.9 * ours["shown"]
    assert ours["wrong"] <= 0.02 * ours["shown"]
    assert old["right"] < 0.7 * old["shown"]
