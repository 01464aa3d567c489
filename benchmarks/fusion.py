"""Fusion of 10 and of 50 objects on 8 cameras: milliseconds of processor time a frame, by stage.

    python benchmarks/fusion.py [--rounds 10]

A ring of cameras around a vehicle, cars at 6 to 40 m, 2D boxes that are off by 2 px, a cloud of 100 points an object.
The stages run in the order of `lidcam/build.py`. Beside them stands what the association used to be, in the same run,
alternating: each camera by itself, the best sum of IoU with a penalty for classes. Each figure is the median over the
frames; the ratio is that of the sum of association, refinement and belief to the plain association.
"""

import argparse
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from pipeline.core.arrays import F32
from pipeline.core.camera import CameraModel
from pipeline.core.clouds import CombinedCloud, Plane, PointCloud
from pipeline.core.detections import Boxes2D, Boxes3D, Hypotheses
from pipeline.core.frame import SensorBundle
from pipeline.core.geometry.boxes import box_corners, iou_xyxy, wrap_angle
from pipeline.core.geometry.transform import Transform
from pipeline.core.rig import CameraSensor, LidarSensor, Rig
from pipeline.core.settings.config import Config
from pipeline.fusion.belief.visibility import find_visibility
from pipeline.stages.associate import Associate
from pipeline.stages.believe import Believe
from pipeline.stages.refine import Refine

LENS = (-0.2, 0.05, 0.001, -0.001, 0.0)
LOOK_FORWARD = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
CAR_M = (4.0, 1.7, 1.6)
POINTS = 100


@dataclass(frozen=True, slots=True)
class Scene:
    """One frame."""

    boxes: Boxes3D
    found: Mapping[str, Boxes2D]
    combined: CombinedCloud


def ring(distortion: Sequence[float]) -> Rig:
    """Eight cameras of 77 degrees, 1.6 m above the ground, and a lidar."""
    cameras = []
    for number in range(8):
        cos, sin = np.cos(number * np.pi / 4), np.sin(number * np.pi / 4)
        matrix = np.eye(4)
        matrix[:3, :3] = LOOK_FORWARD @ [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]
        matrix[:3, 3] = matrix[:3, :3] @ [0, 0, -1.6]
        K = np.array([[400.0, 0, 319.5], [0, 400, 239.5], [0, 0, 1]])
        name = f"cam{number}"
        model = CameraModel(name, 640, 480, K, "plumb_bob", np.array(distortion))
        cameras.append(CameraSensor(name, f"/{name}", "", model, Transform(name, "site", matrix)))
    lidar = LidarSensor("lidar", "/lidar", Transform.identity("site", "lidar"))
    return Rig("site", (lidar,), tuple(cameras), (), 0.0)


def made_up(rig: Rig, count: int, seed: int) -> Scene:
    """A frame with so many cars."""
    random = np.random.default_rng(seed)
    range_m, bearing = random.uniform(6, 40, count), random.uniform(-np.pi, np.pi, count)
    true_xy = np.stack([range_m * np.cos(bearing), range_m * np.sin(bearing)], 1)
    yaws, sizes = random.uniform(-3, 3, count), np.tile(CAR_M, (count, 1))
    corners = box_corners(np.column_stack([true_xy, np.full(count, CAR_M[2] / 2)]), sizes, yaws)
    found = {}
    for camera in rig.cameras:
        shown = camera.project_boxes(corners, "site")
        shown = shown[np.isfinite(shown[:, 0])]
        shown += random.normal(0, 2, shown.shape).astype(np.float32)
        scores = random.uniform(0.3, 1, len(shown)).astype(np.float32)
        found[camera.name] = Boxes2D(1, camera.name, shown, scores, np.zeros(len(shown), np.int32))
    centers = np.column_stack([true_xy + random.normal(0, 0.15, (count, 2)), np.full(count, CAR_M[2] / 2)])
    boxes = Boxes3D(
        1,
        "site",
        centers,
        sizes,
        wrap_angle(yaws + random.normal(0, 0.1, count)),
        random.uniform(0.2, 1, count).astype(np.float32),
        np.zeros(count, np.int32),
        np.full(count, POINTS, np.int32),
        np.tile(np.diag([0.15**2, 0.15**2, 0.1**2]), (count, 1, 1)),
        np.zeros(count, np.uint8),
        np.ones(count, np.int64),
    )
    points = np.repeat(centers, POINTS, 0) + random.uniform(-0.8, 0.8, (count * POINTS, 3))
    return Scene(boxes, found, _combined(points.astype(np.float32)))


def _combined(xyz: F32) -> CombinedCloud:
    n = len(xyz)
    cloud = PointCloud(
        1, "site", xyz, np.zeros(n, np.float32), np.zeros(n, np.uint16), np.zeros(n, np.int32), has_time=False
    )
    owners, counts = np.zeros(n, np.uint8), {"input": n, "left": n}
    ground = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    return CombinedCloud(cloud, owners, cloud, owners, cloud.select(np.zeros(0, np.intp)), ground, counts)


def plain_association(scene: Scene, views: Mapping[str, CameraSensor]) -> None:
    """Each camera by itself: the best sum of IoU, less a penalty where the classes differ."""
    boxes = scene.boxes
    corners = box_corners(boxes.centers, boxes.sizes, boxes.yaws)
    for name, view in views.items():
        found, size = scene.found[name], [view.model.width_px, view.model.height_px]
        iou = iou_xyxy(view.project_boxes(corners, boxes.frame_id), np.clip(found.xyxy, 0, size * 2))
        worth = iou - 0.1 * (boxes.class_ids[:, None] != found.class_ids)
        linear_sum_assignment(np.where(iou >= 0.3, worth, 0.0), maximize=True)


def measure(rig: Rig, count: int, rounds: int) -> dict[str, float]:
    """Milliseconds by stage."""
    config, views = Config(), {camera.name: camera for camera in rig.cameras}
    associate, refine = Associate(rig, config.associate, config.classes), Refine(rig, config.fuse)
    motion = config.combine.motion
    believe = Believe(rig, config.fuse, config.classes, motion, scores_are_probabilities=False)
    scenes = [made_up(rig, count, seed) for seed in range(10)]
    taken: dict[str, list[float]] = {"plain association": [], "association": [], "refinement": [], "belief": []}

    for _ in range(rounds + 1):
        for scene in scenes:
            moment = SensorBundle(0, scene.boxes.stamp_ns, scene.boxes.stamp_ns, {})
            started = [time.process_time()]
            plain_association(scene, views)
            started.append(time.process_time())
            matches = associate(scene.boxes, scene.found, views)
            started.append(time.process_time())
            hypotheses = refine(Hypotheses(scene.boxes, matches, count), scene.found, views)
            started.append(time.process_time())
            believe(hypotheses, find_visibility(hypotheses, scene.found, views, scene.combined), moment)
            started.append(time.process_time())
            for values, seconds in zip(taken.values(), np.diff(started), strict=True):
                values.append(seconds * 1e3)
    return {stage: statistics.median(values[len(scenes) :]) for stage, values in taken.items()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=10)
    options = parser.parse_args()
    for lens, distortion in (("straight", ()), ("distorted", LENS)):
        rig = ring(distortion)
        for count in (10, 50):
            found = measure(rig, count, options.rounds)
            whole = sum(ms for stage, ms in found.items() if stage != "plain association")
            stages = ", ".join(f"{stage} {ms:.2f}" for stage, ms in found.items())
            ratio = whole / found["plain association"]
            print(f"{lens} lenses, {count} objects: {stages}; all three {whole:.2f} ms, {ratio:.2f} x plain")


if __name__ == "__main__":
    main()
